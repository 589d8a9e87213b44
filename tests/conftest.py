"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

WORKER = os.environ.get("PYTEST_XDIST_WORKER")
if WORKER:
    # Numba decides what to inline by what its cache holds at that moment. Two processes that fill one empty cache side by
    # side may keep code that differs in the last bit, so each worker, with all that it starts, has a cache of its own.
    os.environ["NUMBA_CACHE_DIR"] = str(Path(__file__).resolve().parents[1] / ".pytest_cache" / "numba" / WORKER)

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings that are not part of the project; they lie beside the checkout where there are any."""


@pytest.fixture(scope="session")
def ngsim_recordings() -> Path:
    """Lane offsets of NGSIM US-101, 10 Hz; skips where the data is absent."""
    path = SHARED_DATA / "ngsim-us101-recordings" / "recordings.csv.gz"
    if not path.is_file():
        pytest.skip("the NGSIM recordings are not beside this checkout (../shared/data)")
    return path
