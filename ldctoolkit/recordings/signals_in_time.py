"""Signals of one clock at the times of another: interpolation and slopes that never reach across a gap."""

from __future__ import annotations

import bisect
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray

ROUNDING: Final = 1e-6
"""Times [s] are compared with this allowance: 10.1 - 7.6 is not quite 2.5."""

MOST_NEIGHBOURS: Final = 50
"""A slope takes at most so many samples to either side; it bounds the work for absurd clocks."""

LEAST_SPREAD: Final = 1e-4
"""Sum of squared distances [s^2] from the mean time that a slope needs: two samples 0.014 s apart."""


def merge_repeated(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One sample a time: the mean of those that share it."""
    if t.size < 2 or (t[1:] > t[:-1]).all():
        return t, values
    first = np.flatnonzero(np.append(True, t[1:] > t[:-1]))
    return t[first], np.add.reduceat(values, first) / np.diff(np.append(first, t.size))


def values_at(at: FloatArray, t: FloatArray, values: FloatArray, *, longest: float, beyond: float) -> FloatArray:
    """Linear interpolation in time that knows where nothing is known."""
    if t.size == 0:
        return np.full(at.shape, np.nan)
    right = np.searchsorted(t, at, side="right")
    left = np.maximum(right - 1, 0)
    right = np.minimum(right, t.size - 1)
    within = (t[left] <= at) & (at <= t[right]) & (t[right] - t[left] <= longest + ROUNDING)
    nearest = np.where(np.abs(at - t[left]) <= np.abs(t[right] - at), left, right)
    held = np.abs(at - t[nearest]) <= beyond + ROUNDING
    return np.where(within, np.interp(at, t, values), np.where(held, values[nearest], np.nan))


def local_slope(t: FloatArray, values: FloatArray, *, half: float, longest: float) -> FloatArray:
    """Slope of the straight line, by least squares, through the samples around each sample."""
    gap = np.diff(t) > longest + ROUNDING
    stretch = np.append(0, np.cumsum(gap)) if t.size else np.empty(0, dtype=np.int64)
    count = np.ones(t.size)
    sums = np.zeros((4, t.size))  # of s, y, s s, s y; s and y are distances from the sample itself

    for lag in range(1, min(MOST_NEIGHBOURS, t.size - 1) + 1):
        s = t[lag:] - t[:-lag]
        together = (s <= half + ROUNDING) & (stretch[lag:] == stretch[:-lag])
        if not together.any():
            break
        s, y = np.where(together, s, 0.0), np.where(together, values[lag:] - values[:-lag], 0.0)
        for rows, sign in ((slice(None, -lag), 1.0), (slice(lag, None), -1.0)):
            count[rows] += together
            sums[:, rows] += sign * s, sign * y, s * s, s * y
    spread = sums[2] - sums[0] ** 2 / count
    enough: BoolArray = spread > LEAST_SPREAD
    return np.where(enough, (sums[3] - sums[0] * sums[1] / count) / np.where(enough, spread, 1.0), np.nan)


def rising_rows(t: FloatArray) -> BoolArray:
    """As many rows as possible whose times do not fall; of several choices the one with the earliest rows."""
    kept = np.ones(t.size, dtype=bool)
    if (t[1:] >= t[:-1]).all():
        return kept
    # a row that is in order with every other one is in each longest choice; only the rest needs the search
    odd = np.flatnonzero((t < np.maximum.accumulate(t)) | (t > np.minimum.accumulate(t[::-1])[::-1]))
    kept[odd] = _longest(t[odd].tolist())
    return kept


def _longest(times: list[float]) -> list[bool]:
    """The same by patience sorting from the end, n log n."""
    latest: list[float] = []  # minus the latest time that a choice of each length can begin with
    lengths = []  # of the longest choice that begins with the row; from the end
    for time in reversed(times):
        length = bisect.bisect_right(latest, -time)
        lengths.append(length + 1)
        latest[length : length + 1] = [-time]
    needed, before = len(latest), -float("inf")
    kept = []
    for time, length in zip(times, reversed(lengths), strict=True):
        taken = length == needed and time >= before
        kept.append(taken)
        if taken:
            needed, before = needed - 1, time
    return kept
