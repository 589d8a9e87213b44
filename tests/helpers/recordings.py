"""A recording with one departure, to be changed, and comparison of extractions."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
import polars as pl

from helpers.bits import assert_same_bits
from ldctoolkit.recordings import Extraction, Recording

T = np.arange(100) * 0.1
OFFSET = 0.9 + np.clip(0.3 * (1.0 - ((T - 5.0) / 0.95) ** 2), -0.4, None)
"""With a vehicle of 1.8 m in a lane of 3.6 m the left edge is beyond the line by y = 0.3 (1 - ((t - 5)/0.95)^2) around
t = 5 s, that is for 1.9 s, and well inside before and after."""


def drive(name: str = "a", t: Any = T, **columns: Any) -> Recording:
    """One recording at 10 Hz, 25 m/s, straight, in one lane; columns may be scalars, None takes one away."""
    n = len(t)
    given: dict[str, Any] = {"lane_offset": OFFSET, "lane_width": 3.6, "speed": 25.0, "valid": True}
    given |= {"curvature": 0.0, "lane": 1} | columns
    kinds = {"valid": bool, "lane": np.int64, "turn_signal": np.int64, "yaw_rate_measured": bool}
    for column in {*given} & {*Recording.COLUMNS}:
        if given[column] is not None:
            given[column] = np.array(np.broadcast_to(given[column], n), dtype=kinds.get(column, np.float64))
    return Recording(name, np.array(t, dtype=np.float64), **given)


def frame_of(recordings: Iterable[Recording]) -> pl.DataFrame:
    """Recordings as a file would hold them."""
    names = ("t", "lane_offset", "lane_width", "speed", "valid", "curvature", "yaw_rate", "lane", "turn_signal")
    frames = []
    for one in recordings:
        columns = {name: getattr(one, name) for name in names if getattr(one, name) is not None}
        frames.append(pl.DataFrame({"recording": [one.name] * one.samples} | columns))
    return pl.concat(frames)


def assert_same(left: Extraction, right: Extraction) -> None:
    """The same departures, counts and warnings; sources and columns of the source's own aside."""
    one, other = (dataclasses.replace(found.departures, extra=()) for found in (left, right))
    assert_same_bits(one, other, "departures")
    assert left.refused == right.refused
    assert (left.hours, left.recordings, left.warnings) == (right.hours, right.recordings, right.warnings)
    assert left.provenance.invalid_samples == right.provenance.invalid_samples
