"""Recordings made for the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import polars as pl
import pytest

from ldctoolkit.recordings import Extraction, RecordingTable

MakeTable = Callable[..., RecordingTable]


def bump_table(**changes: Any) -> RecordingTable:
    """One recording at 10 Hz, 25 m/s, lane 3.6 m; with a vehicle of 1.8 m the left edge is beyond the line by

    y = 0.3 (1 - ((t - 5)/0.95)^2) around t = 5 s, that is for 1.9 s, and well inside before and after.
    """
    t = np.arange(100) * 0.1
    y = np.clip(0.3 * (1.0 - ((t - 5.0) / 0.95) ** 2), -0.4, None)
    columns: dict[str, Any] = {"recording": ["a"] * 100, "t": t, "lane_offset": 0.9 + y, "lane_width": 3.6}
    columns |= {"speed": 25.0, "curvature": 0.0, "lane": np.ones(100, dtype=int)}
    return RecordingTable.from_arrays(**(columns | changes))


@pytest.fixture(scope="session")
def bump() -> MakeTable:
    return bump_table


def frame_of(table: RecordingTable) -> pl.DataFrame:
    """The table as a file would hold it."""
    columns: dict[str, Any] = {
        "recording": table.names[table.recording_index].tolist(),
        "t": table.t,
        "lane_offset": table.lane_offset,
        "lane_width": table.lane_width,
        "speed": table.speed,
        "valid": table.valid,
    }
    for name in ("curvature", "yaw_rate", "lane", "turn_signal"):
        if getattr(table, name) is not None:
            columns[name] = getattr(table, name)
    return pl.DataFrame(columns)


@pytest.fixture(scope="session")
def to_frame() -> Callable[[RecordingTable], pl.DataFrame]:
    return frame_of


def check_same(left: Extraction, right: Extraction) -> None:
    """Bit-identical departures and equal accounts (sources aside)."""
    for name in ("recording", "side", "samples", "start_time"):
        np.testing.assert_array_equal(getattr(left.departures, name), getattr(right.departures, name))
    np.testing.assert_array_equal(left.departures.matrix(), right.departures.matrix())
    assert left.refused == right.refused
    assert (left.hours, left.recordings, left.warnings) == (right.hours, right.recordings, right.warnings)
    assert left.provenance.invalid_samples == right.provenance.invalid_samples


@pytest.fixture(scope="session")
def assert_same() -> Callable[[Extraction, Extraction], None]:
    return check_same
