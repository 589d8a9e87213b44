"""What many tests share: the command line in this process, comparison bit for bit, the depth of property tests."""
