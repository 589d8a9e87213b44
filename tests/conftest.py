"""Fixtures for all tests."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.bits import load_profile
from ldctoolkit import registry

load_profile()

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings that are not part of the project; they lie beside the checkout where there are any."""


@pytest.fixture(autouse=True)
def _laws_of_one_test() -> Iterator[None]:
    """A law that a test registers is forgotten after it, so that the order of tests does not matter."""
    before = dict(registry._registered)
    yield
    registry._registered.clear()
    registry._registered.update(before)


@pytest.fixture(scope="session")
def ngsim_recordings() -> Path:
    """Lane offsets of NGSIM US-101, 10 Hz; skips where the data is absent."""
    path = SHARED_DATA / "ngsim-us101-recordings" / "recordings.csv.gz"
    if not path.is_file():
        pytest.skip("the NGSIM recordings are not beside this checkout (../shared/data)")
    return path
