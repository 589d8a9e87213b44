"""Which rows to keep so that times do not fall."""

from __future__ import annotations

import bisect

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray


def rising_rows(t: FloatArray) -> BoolArray:
    """As many rows as possible whose times do not fall; of several such choices the one that keeps the earliest rows.

    Parameters
    ----------
    t : (n,) [s] or any other unit
        Times in the order of the rows, finite.

    Returns
    -------
    (n,) bool
        True for rows to keep.

    Examples
    --------
    >>> rising_rows(np.array([0.0, 1.0, 90.0, 91.0, 2.0, 2.0, 1.5, 3.0])).tolist()
    [True, True, False, False, True, True, False, True]
    """
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
