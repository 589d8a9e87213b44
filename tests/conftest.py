"""Fixtures for all tests."""

from pathlib import Path

import pytest

from helpers.bits import load_profile

load_profile()

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings that are not part of the project; they lie beside the checkout where there are any."""


@pytest.fixture(scope="session")
def ngsim_recordings() -> Path:
    """Lane offsets of NGSIM US-101, 10 Hz; skips where the data is absent."""
    path = SHARED_DATA / "ngsim-us101-recordings" / "recordings.csv.gz"
    if not path.is_file():
        pytest.skip("the NGSIM recordings are not beside this checkout (../shared/data)")
    return path
