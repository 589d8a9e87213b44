"""The study file: what it may say, checked as a whole before anything runs."""
