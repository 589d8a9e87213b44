"""Lane curvature for recordings that hold a yaw rate only."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray

HALF_WINDOW: Final = 0.2
"""Half the smoothing window [s]. A longer one takes in the road before and after a departure, which flattens dc where
the curvature does not go on; c_0 and dc are fitted over all of a departure anyway, which averages the noise."""

SPEED_FLOOR: Final = 2.0
"""Below about this speed [m/s] the estimate fades to zero instead of dividing by a small speed."""


def curvature_from_yaw_rate(
    yaw_rate: FloatArray, speed: FloatArray, usable: BoolArray, first_of_stretch: BoolArray, half_width: IntArray
) -> FloatArray:
    """Curvature that explains the yaw rate best, by least squares over a moving window.

    Parameters
    ----------
    yaw_rate, speed : (m,) [rad/s], [m/s]
        Signals, positive to the left.
    usable : (m,) bool
        Samples that may be used; the result is NaN elsewhere.
    first_of_stretch : (m,) bool
        True where nothing before this sample may be used with it (a recording starts, or a gap ends).
    half_width : (m,) int
        Samples to either side that the window takes.

    Returns
    -------
    (m,) [1/m]
        Curvature, positive to the left.

    Notes
    -----
    The model is r = c v with c constant over the window, so c = sum(r v) / sum(v^2). Each sample weighs with its v^2,
    hence slow samples, whose r/v is noise, hardly count, and the sum of v^2 is not allowed below that of
    `SPEED_FLOOR`. The window shrinks at a stretch's ends and never reaches across them. The yaw rate is the
    vehicle's, not the lane's: during a departure it holds the vehicle's own turning too, which the window averages.

    Examples
    --------
    >>> r, v = np.full(5, 0.02), np.full(5, 20.0)
    >>> on, first = np.ones(5, bool), np.array([True, False, False, False, False])
    >>> curvature_from_yaw_rate(r, v, on, first, np.full(5, 2)).round(6).tolist()
    [0.001, 0.001, 0.001, 0.001, 0.001]
    """
    result = np.full(yaw_rate.shape, np.nan)
    place = np.flatnonzero(usable)
    if place.size == 0:
        return result
    # a stretch also ends where an unusable sample was left out
    starts = np.zeros(place.size, dtype=bool)
    stretch = np.cumsum(first_of_stretch | ~usable)[place]
    starts[0] = True
    starts[1:] = stretch[1:] != stretch[:-1]
    begin = np.flatnonzero(starts)
    length = np.diff(np.append(begin, place.size))
    low = np.repeat(begin, length)
    high = np.repeat(begin + length, length)
    here = np.arange(place.size)
    low = np.maximum(here - half_width[place], low)
    high = np.minimum(here + half_width[place] + 1, high)
    v, r = speed[place], yaw_rate[place]
    # reduceat over (low, high) pairs: every second sum is a window; each is summed on its own, so no rounding is
    # carried from one recording into the next. The appended zero lets `high` point past the last sample.
    pairs = np.column_stack([low, high]).ravel()
    top = np.add.reduceat(np.append(r * v, 0.0), pairs)[::2]
    bottom = np.add.reduceat(np.append(v * v, 0.0), pairs)[::2]
    result[place] = top / np.maximum(bottom, (high - low) * SPEED_FLOOR**2)
    return result
