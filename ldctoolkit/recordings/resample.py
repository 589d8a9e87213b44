"""Resampling to a common time step: local medians of usable samples, nothing invented across a gap."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.recordings.recording import BoolArray, FloatArray, IntArray, Recording

MAX_GAP: Final = 0.25
"""Longest time [s] between two usable samples that is bridged."""

_SLACK: Final = 1e-6
"""Of a step: a sample on the edge of a window is in it, however its time was rounded."""

_NUMBERS: Final = ("lane_offset", "lane_width", "speed", "curvature", "yaw_rate")
_NAMES: Final = ("lane", "turn_signal", "heading")
"""Columns of which no mean or median is taken: the value nearest to the middle of the window counts."""


def resample(recording: Recording, step: float, max_gap: float = MAX_GAP) -> Recording:
    """The same recording at multiples of a time step after its first sample.

    Parameters
    ----------
    recording : Recording
        m samples.
    step : float [s]
        New time step.
    max_gap : float [s]
        Longest time between two usable samples that values are interpolated across.

    Returns
    -------
    Recording
        Each value is the median of the usable samples within half a step to either side, ends included. Where there is
        none, it is interpolated linearly if the usable samples around are at most `max_gap` apart; else the sample is
        not valid if the source has unusable samples there, and left out if it has nothing.

    Raises
    ------
    InputError
        If the step or the gap is not positive.

    Notes
    -----
    Samples that already lie at the multiples keep their values to the last bit.

    Examples
    --------
    >>> t = np.array([0.0, 0.03, 0.07, 0.1, 0.2])
    >>> x = np.array([0.0, 9.0, 1.0, 1.0, 2.0])
    >>> one = Recording("a", t, x, np.full(5, 3.6), np.full(5, 25.0), np.ones(5, bool))
    >>> resample(one, 0.1).lane_offset.tolist()
    [4.5, 1.0, 2.0]
    """
    for name, value in (("step", step), ("max_gap", max_gap)):
        if not 0.0 < value < np.inf:
            raise InputError(f"{name}: {value!r} s; allowed: more than 0, finite")
    if recording.samples == 0:
        return recording
    usable = _usable(recording)
    origin = recording.t[0]
    t = recording.t - origin
    grid = _occupied(t, step, max_gap)
    centre: FloatArray = np.asarray(grid * step, dtype=np.float64)
    half = (0.5 + _SLACK) * step
    tu = t[usable]
    low, high = np.searchsorted(tu, centre - half, "left"), np.searchsorted(tu, centre + half, "right")
    filled = high > low
    before = np.where(filled, low, low - 1)
    bridged = np.zeros(grid.size, dtype=bool)
    inside = ~filled & (low > 0) & (low < tu.size)
    bridged[inside] = tu[low[inside]] - tu[low[inside] - 1] <= max_gap * (1.0 + _SLACK)
    seen = np.searchsorted(t, centre + half, "right") > np.searchsorted(t, centre - half, "left")
    kept = filled | bridged | seen
    good = (filled | bridged)[kept]
    low, high, before, centre = low[kept], high[kept], before[kept], centre[kept]
    medians = _Medians(low, high, filled[kept])

    columns: dict[str, Any] = {}
    for name in _NUMBERS:
        values = getattr(recording, name)
        columns[name] = None if values is None else medians.of(values[usable], tu, centre, bridged[kept])
    middle = np.where(filled[kept], (low + high - 1) // 2, np.maximum(before, 0))
    for name in _NAMES:
        values = getattr(recording, name)
        columns[name] = None if values is None else _taken(values[usable], middle)
    return dataclasses.replace(recording, t=origin + centre, valid=good, **columns)


def _taken(values: npt.NDArray[Any], middle: IntArray) -> npt.NDArray[Any]:
    """Values at some places, the last one beyond them; zeros where there are none at all."""
    if values.size == 0:
        return np.zeros(middle.size, dtype=values.dtype)
    taken: npt.NDArray[Any] = values[np.minimum(middle, values.size - 1)]
    return taken


def _usable(recording: Recording) -> BoolArray:
    """Samples that the source allows and whose numbers that take part are there."""
    usable: BoolArray = recording.valid & (recording.lane_width > 0.0)
    bend = recording.curvature if recording.curvature is not None else recording.yaw_rate
    for column in (recording.lane_offset, recording.lane_width, recording.speed, bend):
        if column is not None:
            usable &= np.isfinite(column)
    return usable


def _occupied(t: FloatArray, step: float, max_gap: float) -> IntArray:
    """Multiples of the step that lie within reach of a sample; a long gap costs nothing."""
    cut = np.flatnonzero(np.diff(t) > max_gap + step)
    first = np.concatenate([t[:1], t[cut + 1]])
    last = np.concatenate([t[cut], t[-1:]])
    low = np.floor(first / step).astype(np.int64)
    high = np.ceil(last / step).astype(np.int64)
    low[1:] = np.maximum(low[1:], high[:-1] + 1)
    count = np.maximum(high - low + 1, 0)
    starts = np.cumsum(count) - count
    grid: IntArray = np.repeat(low, count) + np.arange(count.sum()) - np.repeat(starts, count)
    inside: IntArray = grid[grid * step <= t[-1] + 0.5 * step]
    return inside


class _Medians:
    """Medians of windows ``low:high`` of a column; the windows are the same for all columns."""

    def __init__(self, low: IntArray, high: IntArray, filled: BoolArray) -> None:
        self._low, self._filled = low, filled
        self._count = np.where(filled, high - low, 0)
        self._single = bool((self._count <= 1).all())
        if not self._single:
            self._window = np.repeat(np.arange(low.size), self._count)
            self._begin = np.cumsum(self._count) - self._count
            self._place = low[self._window] + np.arange(self._window.size) - self._begin[self._window]

    def of(self, values: FloatArray, t: FloatArray, centre: FloatArray, bridged: BoolArray) -> FloatArray:
        """Median of each window; interpolated where it is `bridged`, NaN elsewhere."""
        result = np.full(self._low.size, np.nan)
        filled = self._filled
        if self._single:
            result[filled] = values[self._low[filled]]
        else:
            inside = values[self._place]
            ordered = inside[np.lexsort((inside, self._window))]
            begin, count = self._begin[filled], self._count[filled]
            below, above = ordered[begin + (count - 1) // 2], ordered[begin + count // 2]
            result[filled] = np.where(below == above, below, 0.5 * (below + above))
        if bridged.any():
            after = self._low[bridged]
            share = (centre[bridged] - t[after - 1]) / (t[after] - t[after - 1])
            result[bridged] = values[after - 1] + share * (values[after] - values[after - 1])
        return result
