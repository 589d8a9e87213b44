"""The report in words: numbers, names, sentences."""
