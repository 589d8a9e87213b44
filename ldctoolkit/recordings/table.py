"""Driving recordings as flat arrays: many whole recordings, one after the other."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.recordings.recording import Recording

__all__ = ["LARGEST", "BoolArray", "FloatArray", "IntArray", "RecordingTable", "measured", "usable_samples"]

LARGEST: Final = 1e9
"""A number of this size or more is not a measurement in any unit; its sample is invalid."""


def measured(values: FloatArray) -> FloatArray:
    """NaN for numbers of absurd size, which are none; sums of such would overflow."""
    kept: FloatArray = np.where(np.abs(values) < LARGEST, values, np.nan)
    return kept


def usable_samples(samples: RecordingTable | Recording) -> BoolArray:
    """Samples that the source allows and whose numbers that take part are there, (m,); times are not looked at."""
    usable: BoolArray = samples.valid & (samples.lane_width > 0.0)
    bend = samples.curvature if samples.curvature is not None else samples.yaw_rate
    for column in (samples.lane_offset, samples.lane_width, samples.speed, bend):
        if column is not None:
            usable &= np.abs(column) < LARGEST  # False for NaN
    return usable


@dataclasses.dataclass(frozen=True)
class RecordingTable:
    """r whole recordings of m samples in all, in flat arrays.

    Attributes
    ----------
    names : (r,) str
        Identifier of each recording.
    offsets : (r + 1,) int
        Recording i owns the samples ``offsets[i]:offsets[i + 1]``.
    t : (m,) [s]
        Time on the recording's own clock, not falling inside a recording.
    lane_offset : (m,) [m]
        Vehicle's centre from the lane's centre, positive to the left.
    lane_width : (m,) [m]
        Width of the lane that the vehicle is in.
    speed : (m,) [m/s]
        Speed along the road.
    valid : (m,) bool
        False where the source itself says that the sample cannot be used.
    curvature : (m,) [1/m] or None
        Lane curvature, positive to the left (ISO 8855).
    yaw_rate : (m,) [rad/s] or None
        Yaw rate, positive to the left; used only where `curvature` is None.
    lane : (m,) int or None
        Label of the lane; only equality counts.
    turn_signal : (m,) int or None
        +1 left, -1 right, 0 none.
    """

    names: npt.NDArray[np.str_]
    offsets: IntArray
    t: FloatArray
    lane_offset: FloatArray
    lane_width: FloatArray
    speed: FloatArray
    valid: BoolArray
    curvature: FloatArray | None = None
    yaw_rate: FloatArray | None = None
    lane: IntArray | None = None
    turn_signal: IntArray | None = None

    @property
    def samples(self) -> int:
        """Number of samples, m."""
        return int(self.t.size)

    @property
    def recording_index(self) -> IntArray:
        """Index of the recording that each sample belongs to, (m,)."""
        return np.repeat(np.arange(self.names.size), np.diff(self.offsets))


MISSING: Final = ("", "null", "nan", "na", "n/a", "none", "-nan", "#n/a")
"""In lower case, without blanks around them."""
