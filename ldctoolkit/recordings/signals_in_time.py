"""Signals of one clock at the times of another: interpolation and slopes that never reach across a gap."""

from __future__ import annotations

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
    """One sample a time: the mean of those that share it.

    Parameters
    ----------
    t : (n,) [s]
        Times that do not fall.
    values : (n,)
        Finite.

    Returns
    -------
    t, values : (k,)
        Times that increase.

    Examples
    --------
    >>> t, values = merge_repeated(np.array([0.0, 1.0, 1.0]), np.array([5.0, 6.0, 8.0]))
    >>> t.tolist(), values.tolist()
    ([0.0, 1.0], [5.0, 7.0])
    """
    if t.size < 2 or (t[1:] > t[:-1]).all():
        return t, values
    first = np.flatnonzero(np.append(True, t[1:] > t[:-1]))
    return t[first], np.add.reduceat(values, first) / np.diff(np.append(first, t.size))


def values_at(at: FloatArray, t: FloatArray, values: FloatArray, *, longest: float, beyond: float) -> FloatArray:
    """Linear interpolation in time that knows where nothing is known.

    Parameters
    ----------
    at : (m,) [s]
        Times asked for.
    t : (k,) [s]
        Times that increase.
    values : (k,)
        Finite.
    longest : float [s]
        Longest step of `t` that is interpolated over.
    beyond : float [s]
        So far beyond a sample, where nothing can be interpolated, its value holds.

    Returns
    -------
    (m,)
        NaN where nothing is known.

    Examples
    --------
    >>> at = np.array([0.5, 1.2, 5.0])
    >>> values_at(at, np.array([0.0, 1.0, 9.0]), np.array([20.0, 22.0, 30.0]), longest=2.5, beyond=0.5).tolist()
    [21.0, 22.0, nan]
    """
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
    """Slope of the straight line, by least squares, through the samples around each sample.

    Parameters
    ----------
    t : (k,) [s]
        Times that increase.
    values : (k,)
        Finite.
    half : float [s]
        Half the window.
    longest : float [s]
        A longer step of `t` is a gap; no window reaches across it.

    Returns
    -------
    (k,) [1/s]
        Slope; NaN where a window holds one time only.

    Examples
    --------
    >>> t = np.array([0.0, 0.1, 0.2, 5.0])
    >>> local_slope(t, 3.0 * t, half=0.25, longest=0.5).round(9).tolist()
    [3.0, 3.0, 3.0, nan]
    """
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
