"""Joining rows of two tables by trip and time: the nearest row, within a tolerance, all trips at once."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray


def nearest_rows(
    trip: IntArray, t: FloatArray, other_trip: IntArray, other_t: FloatArray, tolerance: float
) -> IntArray:
    """For each row, the row of the other table of the same trip that is nearest in time.

    Parameters
    ----------
    trip, t : (m,) int, (m,)
        Trip and time of each row, sorted by both.
    other_trip, other_t : (k,) int, (k,)
        The same of the other table, sorted by both.
    tolerance : float
        Largest distance in time, itself included; in the unit of the times.

    Returns
    -------
    (m,) int
        Row of the other table; -1 where none is near. Of two that are as near the earlier one counts, of rows with one
        time the first.

    Examples
    --------
    >>> one = np.zeros(3, dtype=int)
    >>> nearest_rows(one, np.array([0.0, 10.0, 20.0]), one, np.array([1.0, 2.0, 14.0]), 5.0).tolist()
    [0, 2, -1]
    """
    none = np.full(t.size, -1, dtype=np.int64)
    if t.size == 0 or other_t.size == 0:
        return none
    # each trip gets a span of its own on one long clock; times that are out of reach of a trip wait at its span's ends
    first = np.concatenate([[0], np.flatnonzero(np.diff(trip)) + 1])
    last = np.append(first[1:], t.size) - 1
    length = t[last] - t[first] + 6.0 * tolerance + 1.0
    place = np.concatenate([[0.0], np.cumsum(length)])
    own = np.repeat(np.arange(first.size), last - first + 1)
    clock = t - t[first][own] + place[own]
    theirs = np.searchsorted(trip[first], other_trip)
    theirs_or_last = np.minimum(theirs, first.size - 1)
    known = trip[first][theirs_or_last] == other_trip
    rows = np.flatnonzero(known)
    theirs = theirs_or_last[rows]
    away = other_t[rows] - t[first][theirs]
    reach = 2.0 * tolerance
    other_clock = np.clip(away, -reach, t[last][theirs] - t[first][theirs] + reach) + place[theirs]
    if rows.size == 0:
        return none
    # rows with one time: the first stands for all
    new = np.concatenate([[True], (np.diff(other_clock) > 0.0)])
    rows, other_clock = rows[new], other_clock[new]
    after = np.searchsorted(other_clock, clock)
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, rows.size - 1)

    def distance(candidate: IntArray) -> FloatArray:
        # between the times themselves: the long clock has fewer digits
        row = rows[candidate]
        apart: FloatArray = np.where(other_trip[row] == trip, np.abs(other_t[row] - t), np.inf)
        return apart

    to_before, to_after = distance(before), distance(after)
    chosen = np.where(to_before <= to_after, before, after)
    return np.where(np.minimum(to_before, to_after) <= tolerance, rows[chosen], -1)
