"""Extraction of departures from recordings of any size: part by part, in parallel, stored on the way."""

from studies.extraction.runner import NothingReadError, run_extraction

__all__ = ["NothingReadError", "run_extraction"]
