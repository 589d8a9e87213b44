"""The Pareto front: designs that no other design beats in one figure without being worse in another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from studies.ranking.figures import figure, figure_values

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_FEW: Final = 64
"""Rows up to which all pairs are compared at once."""


def pareto_costs(names: Sequence[str], *sources: Any) -> FloatArray:
    """Figures as costs: those of which more is better change their sign.

    Parameters
    ----------
    names : sequence of str
        k figures, as `studies.ranking.figures.figure` takes them.
    *sources : Mapping or object
        As for `studies.ranking.figures.figure_values`.

    Returns
    -------
    (d, k)
        One row a design; smaller is better in every column.

    Raises
    ------
    UnknownNameError
        For an unknown figure.
    InputError
        If there are no names, or no source has a figure.

    Examples
    --------
    >>> import numpy as np
    >>> pareto_costs(["S", "reduction"], {"S": np.array([2.0, 1.0]), "reduction": np.array([0.1, 0.6])})
    array([[ 2. , -0.1],
           [ 1. , -0.6]])
    """
    if not names:
        raise InputError("Pareto front: no figures; allowed: one or more")
    signs = {"less": 1.0, "more": -1.0}
    return np.stack([signs[figure(name).better] * figure_values(name, *sources) for name in names], axis=1)


def pareto_front(costs: npt.ArrayLike) -> BoolArray:
    """Which rows are not dominated: no other row is at most as large in every column and smaller in one.

    Parameters
    ----------
    costs : (d, k)
        Smaller is better. A row with a NaN is never in the front and dominates nothing; infinite costs are allowed.

    Returns
    -------
    (d,) bool
        Rows with equal costs are in it all or none.

    Raises
    ------
    InputError
        For an array of another shape, or without columns.

    Notes
    -----
    Exact, in O(d log(d)^max(1, k - 2)) steps and O(d k) memory: the divide and conquer of Kung, Luccio and Preparata,
    "On finding the maxima of a set of vectors", Journal of the ACM 22 (1975).

    Examples
    --------
    >>> pareto_front([[1.0, 2.0], [2.0, 1.0], [2.0, 2.0]])
    array([ True,  True, False])
    """
    values = np.asarray(costs, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] < 1:
        raise InputError(f"costs: shape {values.shape}; allowed: (d, k) with k >= 1")
    front = np.zeros(values.shape[0], dtype=np.bool_)
    rows = np.flatnonzero(~np.isnan(values).any(axis=1))
    if not rows.size:
        return front
    rows = rows[np.lexsort(values[rows].T[::-1])]  # by the first column, then the second, ...
    ordered = values[rows]
    # equal rows share their fate; without them a row that is at most as large everywhere is smaller somewhere
    first = np.r_[True, (ordered[1:] != ordered[:-1]).any(axis=1)]
    kept = np.zeros(int(first.sum()), dtype=np.bool_)
    kept[_front(ordered[first])] = True
    front[rows] = kept[np.cumsum(first) - 1]
    return front


def _front(rows: FloatArray) -> npt.NDArray[np.intp]:
    """Positions of the front among different rows in lexicographic order."""
    n = rows.shape[0]
    if n <= _FEW:
        # every row covers itself
        return np.flatnonzero(np.all(rows[:, None] <= rows[None], axis=2).sum(axis=0) == 1)
    if rows.shape[1] == 1:
        return np.array([0])
    half = n // 2
    before, after = _front(rows[:half]), half + _front(rows[half:])
    # no row of the second half is smaller in the first column: only the others decide
    return np.concatenate([before, after[~_covered(rows[after, 1:], rows[before, 1:])]])


def _covered(rows: FloatArray, by: FloatArray) -> BoolArray:
    """For which of some rows a row of `by` is at most as large in every column."""
    if not rows.shape[0] or not by.shape[0]:
        return np.zeros(rows.shape[0], dtype=np.bool_)
    if rows.shape[1] == 1:
        return np.asarray(rows[:, 0] >= by[:, 0].min())
    if rows.shape[1] == 2:
        return _covered_in_two(rows, by)
    if rows.shape[0] * by.shape[0] <= _FEW * _FEW:
        return np.asarray(np.any(np.all(by[None] <= rows[:, None], axis=2), axis=1))
    values = np.concatenate([rows[:, 0], by[:, 0]])
    middle = np.partition(values, values.size // 2)[values.size // 2]  # one of the values: the mean of two may be NaN
    if middle == values.max():  # half of them or more are equal: the split has to be below
        lower = values[values < middle]
        if not lower.size:
            return _covered(rows[:, 1:], by[:, 1:])
        middle = lower.max()
    low, by_low = rows[:, 0] <= middle, by[:, 0] <= middle
    covered = np.empty(rows.shape[0], dtype=np.bool_)
    covered[low] = _covered(rows[low], by[by_low])
    covered[~low] = _covered(rows[~low], by[~by_low])
    open_ = np.flatnonzero(~low & ~covered)
    covered[open_] = _covered(rows[open_, 1:], by[by_low, 1:])
    return covered


def _covered_in_two(rows: FloatArray, by: FloatArray) -> BoolArray:
    """For two columns: the least second one among all of `by` up to the first one."""
    order = np.argsort(by[:, 0], kind="stable")
    least = np.r_[np.inf, np.minimum.accumulate(by[order, 1])]
    position = np.searchsorted(by[order, 0], rows[:, 0], side="right")
    return np.asarray((position > 0) & (least[position] <= rows[:, 1]))
