"""Rows of trips in the order of time."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.recordings.rising_times import rising_rows


def pieces_in_time(trip: IntArray, piece: IntArray, t: FloatArray) -> IntArray:
    """Order of the rows that puts the pieces of each trip in the order of their median times.

    One time far ahead at the begin of a piece does not move it. Trips whose times never fall from one piece to the next
    stay as they are.

    Parameters
    ----------
    trip, piece : (m,) int
        Numbers of each row's trip and piece; neither ever falls.
    t : (m,)
        Times, finite.

    Examples
    --------
    >>> pieces_in_time(np.zeros(4, dtype=int), np.array([1, 1, 2, 2]), np.array([20.0, 30.0, 0.0, 10.0])).tolist()
    [2, 3, 0, 1]
    """
    order = np.arange(t.size)
    falls = (t[1:] < t[:-1]) & (trip[1:] == trip[:-1])
    moved = np.isin(trip, trip[1:][falls & (piece[1:] != piece[:-1])])
    if not moved.any():
        return order
    rows = np.flatnonzero(moved)
    begins = np.flatnonzero(np.diff(piece[rows], prepend=-1))
    counts = np.diff(begins, append=rows.size)
    middle = np.lexsort((t[rows], piece[rows]))[begins + (counts - 1) // 2]
    pieces = np.lexsort((t[rows][middle], trip[rows[begins]]))  # stable: equal ones stay in the order of the file
    place = np.empty_like(pieces)
    place[pieces] = np.arange(pieces.size)
    order[rows] = rows[np.argsort(np.repeat(place, counts), kind="stable")]
    return order


def forward_rows(trip: IntArray, t: FloatArray) -> tuple[BoolArray, list[tuple[int, int]]]:
    """Which rows to keep so that the times of no trip fall.

    Parameters
    ----------
    trip : (m,) int
        Number of each row's trip; never falls.
    t : (m,)
        Times, finite.

    Returns
    -------
    keep : (m,) bool
        False for rows that must go so that as many as possible of the trip stay: a time that jumps ahead does not cost
        the rest of the trip.
    back : list of (int, int)
        First row left out of each trip, and how many.

    Examples
    --------
    >>> keep, back = forward_rows(np.zeros(5, dtype=int), np.array([0.0, 10.0, 900.0, 30.0, 40.0]))
    >>> keep.tolist(), back
    ([True, True, False, True, True], [(2, 1)])
    """
    keep = np.ones(t.size, dtype=bool)
    falls = np.flatnonzero((t[1:] < t[:-1]) & (trip[1:] == trip[:-1]))
    back: list[tuple[int, int]] = []
    for one in np.unique(trip[falls + 1]):
        low, high = np.searchsorted(trip, one), np.searchsorted(trip, one, side="right")
        good = rising_rows(t[low:high])
        keep[low:high] = good
        back.append((int(low + np.argmin(good)), int(np.sum(~good))))
    return keep, back
