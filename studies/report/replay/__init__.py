"""Departures that are driven again to get their paths: which ones, of which designs, and their motion."""
