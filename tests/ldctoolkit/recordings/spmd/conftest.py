"""Tables of SPMD for the tests."""

from pathlib import Path

import pytest

SAMPLE = Path(__file__).parents[4].parent / "shared" / "data" / "spmd-20row-heads"


@pytest.fixture(scope="session")
def sample() -> Path:
    """Folder of the real tables' first lines."""
    if not SAMPLE.is_dir():
        pytest.skip(f"the sample of the real tables is not there: {SAMPLE.name}")
    return SAMPLE
