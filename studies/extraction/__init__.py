"""Extraction of departures from recordings of any size: part by part, in parallel, stored on the way."""

from studies.extraction.runner import NothingReadError, run_extraction
from studies.extraction.work_folder import parts_folder

__all__ = ["NothingReadError", "parts_folder", "run_extraction"]
