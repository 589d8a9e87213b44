"""Driving recordings as flat arrays: many whole recordings, one after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import BoolArray, FloatArray, IntArray, Recording

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

    Built with `from_arrays`, which checks them.

    Attributes
    ----------
    names : (r,) str
        Identifier of each recording.
    offsets : (r + 1,) int
        Recording i owns the samples ``offsets[i]:offsets[i + 1]``.
    t : (m,) [s]
        Time on the recording's own clock, strictly increasing inside a recording; NaN marks a sample without a time.
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

    @classmethod
    def from_arrays(
        cls,
        *,
        recording: Sequence[str] | npt.NDArray[np.str_],
        t: npt.ArrayLike,
        lane_offset: npt.ArrayLike,
        lane_width: npt.ArrayLike,
        speed: npt.ArrayLike,
        valid: npt.ArrayLike = True,
        curvature: npt.ArrayLike | None = None,
        yaw_rate: npt.ArrayLike | None = None,
        lane: npt.ArrayLike | None = None,
        turn_signal: npt.ArrayLike | None = None,
    ) -> RecordingTable:
        """Build and check a table from columns, one value a sample (all but `recording` and `t` may be scalars).

        Parameters
        ----------
        recording : (m,) str
            Recording that each sample belongs to; a recording's samples are consecutive.
        t, lane_offset, lane_width, speed, valid, curvature, yaw_rate, lane, turn_signal : (m,) or scalar
            As the attributes of the class.

        Returns
        -------
        RecordingTable
            The samples, grouped by recording.

        Raises
        ------
        RecordingError
            If columns differ in length, a recording comes in two pieces, or its times do not increase.

        Examples
        --------
        >>> table = RecordingTable.from_arrays(recording=["a", "a", "b"], t=[0, 0.1, 0], lane_offset=0.2,
        ...                                    lane_width=3.6, speed=25.0)
        >>> table.names.tolist(), table.offsets.tolist()
        (['a', 'b'], [0, 2, 3])
        """
        labels = np.asarray(recording, dtype=np.str_)
        if labels.ndim != 1 or labels.size == 0:
            raise RecordingError(f"recording: shape {labels.shape}; allowed: one label a sample, at least one sample")

        def column(name: str, values: npt.ArrayLike) -> FloatArray:
            given = np.asarray(values, dtype=np.float64)
            if given.shape not in ((), labels.shape):
                raise RecordingError(f"{name}: shape {given.shape}; allowed: a scalar or {labels.shape}")
            return np.array(np.broadcast_to(given, labels.shape))

        def optional(name: str, values: npt.ArrayLike | None) -> FloatArray | None:
            return None if values is None else column(name, values)

        signal = optional("turn_signal", turn_signal)
        if signal is not None and not np.isin(signal, (-1.0, 0.0, 1.0)).all():
            row = int(np.argmax(~np.isin(signal, (-1.0, 0.0, 1.0))))
            raise RecordingError(f"turn_signal[{row}] = {signal[row]!r}; allowed: -1 (right), 0 (none), 1 (left)")
        lanes = None if lane is None else np.unique(np.broadcast_to(lane, labels.shape), return_inverse=True)[1]
        starts = np.concatenate([[0], np.flatnonzero(labels[1:] != labels[:-1]) + 1])
        table = cls(
            names=labels[starts],
            offsets=np.concatenate([starts, [labels.size]]).astype(np.int64),
            t=column("t", t),
            lane_offset=column("lane_offset", lane_offset),
            lane_width=column("lane_width", lane_width),
            speed=column("speed", speed),
            valid=column("valid", valid).astype(bool),
            curvature=optional("curvature", curvature),
            yaw_rate=optional("yaw_rate", yaw_rate),
            lane=None if lanes is None else lanes.astype(np.int64),
            turn_signal=None if signal is None else signal.astype(np.int64),
        )
        unique, count = np.unique(table.names, return_counts=True)
        if (count > 1).any():
            raise RecordingError(
                f"recording {str(unique[count > 1][0])!r} comes in {count[count > 1][0]} separate pieces; "
                "allowed: consecutive samples"
            )
        _check_times(table)
        return table


def _check_times(table: RecordingTable) -> None:
    """Refuse times that do not increase inside a recording; samples without a time are passed over."""
    timed = np.flatnonzero(np.isfinite(table.t))
    t, recording = table.t[timed], table.recording_index[timed]
    bad = np.flatnonzero((np.diff(t) <= 0) & (recording[1:] == recording[:-1])) + 1
    if bad.size:
        i = int(bad[0])
        raise RecordingError(
            f"row {timed[i]}: column 't', recording {str(table.names[recording[i]])!r}: t = {float(t[i])!r} s comes "
            f"after t = {float(t[i - 1])!r} s; allowed: times that increase inside a recording"
        )
