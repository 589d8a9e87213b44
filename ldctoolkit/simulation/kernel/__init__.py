"""The closed loop compiled: the plant's steps, what the law sees, and the loops over scenarios and samples.

The compiler takes a while to import: only `data` may be imported at the top of a module outside.
"""
