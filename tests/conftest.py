"""Fixtures for all tests."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.bits import load_profile
from ldctoolkit import metrics, registry

load_profile()

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Real recordings that are not part of the project; they lie beside the checkout where there are any."""


@pytest.fixture(autouse=True)
def _parts_of_one_test() -> Iterator[None]:
    """A law or metric that a test makes known is forgotten after it, so that the order of tests does not matter."""
    tables: list[dict[str, Any]] = [registry._registered, metrics._user_rows]
    before = [dict(table) for table in tables]
    yield
    for table, content in zip(tables, before, strict=True):
        table.clear()
        table.update(content)


@pytest.fixture(scope="session")
def ngsim_recordings() -> Path:
    """Lane offsets of NGSIM US-101, 10 Hz; skips where the data is absent."""
    path = SHARED_DATA / "ngsim-us101-recordings" / "recordings.csv.gz"
    if not path.is_file():
        pytest.skip("the NGSIM recordings are not beside this checkout (../shared/data)")
    return path
