"""Medians of many windows of a column at once."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray

MAX_JUMP: Final = 0.6
"""Offsets [m] further apart are a jump: no value between them is made up, so that it is seen as one later on."""


class WindowMedians:
    """One value a window ``low:high`` of samples; the windows are laid once for all columns.

    Parameters
    ----------
    low, high : (k,) int
        First sample of each window, and the one after its last.
    filled : (k,) bool
        Windows that hold samples.
    bridged : (k,) bool
        Empty windows whose value is interpolated between the samples around, ``low - 1`` and ``low``.
    centre : (k,) [s]
        Times in the middle of the windows.

    Examples
    --------
    >>> windows = WindowMedians(np.array([0, 3]), np.array([3, 5]), np.ones(2, bool), np.zeros(2, bool), np.arange(2.0))
    >>> windows.of(np.array([1.0, 9.0, 2.0, 0.5, 0.25]), np.arange(5.0), None).tolist()
    [2.0, 0.375]
    """

    def __init__(
        self, low: IntArray, high: IntArray, filled: BoolArray, bridged: BoolArray, centre: FloatArray
    ) -> None:
        self._low, self._filled = low, filled
        self._bridged, self._centre = bridged, centre[bridged]
        count = np.where(filled, high - low, 0)
        self._single = bool((count <= 1).all())
        if not self._single:
            self._window = np.repeat(np.arange(low.size), count)
            begin = np.cumsum(count) - count
            self._place = low[self._window] + np.arange(self._window.size) - begin[self._window]
            self._below, self._above = (begin + (count - 1) // 2)[filled], (begin + count // 2)[filled]

    def of(self, values: FloatArray, t: FloatArray, near: FloatArray | None, max_jump: float = MAX_JUMP) -> FloatArray:
        """Value of each window.

        Parameters
        ----------
        values : (m,)
            The column.
        t : (m,) [s]
            Times of its samples.
        near : (k,), optional
            Where the two middle values of a window are more than `max_jump` apart, the one nearer to this is taken
            instead of their mean.
        max_jump : float
            In the unit of the values.

        Returns
        -------
        (k,)
            NaN where a window is neither filled nor bridged.
        """
        result = np.full(self._low.size, np.nan)
        filled, bridged = self._filled, self._bridged
        if self._single:
            result[filled] = values[self._low[filled]]
        else:
            inside = values[self._place]
            ordered = inside[np.lexsort((inside, self._window))]
            below, above = ordered[self._below], ordered[self._above]
            middle = np.where(below == above, below, 0.5 * (below + above))
            if near is not None:
                beside = np.where(np.abs(below - near[filled]) <= np.abs(above - near[filled]), below, above)
                middle = np.where(above - below > max_jump, beside, middle)
            result[filled] = middle
        if bridged.any():
            after = self._low[bridged]
            share = (self._centre - t[after - 1]) / (t[after] - t[after - 1])
            result[bridged] = values[after - 1] + share * (values[after] - values[after - 1])
        return result
