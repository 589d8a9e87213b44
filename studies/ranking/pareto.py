"""The Pareto front: designs that no other design beats in one figure without being worse in another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import InputError
from studies.ranking.requirements import metric, metric_values

_BLOCK: Final = 64
"""Rows that are compared with the front at once."""


def pareto_costs(names: Sequence[str], *sources: Any) -> FloatArray:
    """Figures as costs: those of which more is better change their sign.

    Parameters
    ----------
    names : sequence of str
        k figures, as `studies.ranking.requirements.metric` takes them.
    *sources : Mapping or object
        As for `studies.ranking.requirements.metric_values`.

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
    return np.stack([signs[metric(name).better] * metric_values(name, *sources) for name in names], axis=1)


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
    rows = rows[np.lexsort(values[rows].T[::-1])]  # now no row dominates one before it
    kept = rows[:0]
    for first in range(0, rows.size, _BLOCK):
        block = rows[first : first + _BLOCK]
        block = block[~_dominated(values[block], values[kept])]
        kept = np.concatenate([kept, block[~_dominated(values[block], values[block])]])
    front[kept] = True
    return front


def _dominated(rows: FloatArray, by: FloatArray) -> BoolArray:
    """For which of some rows a row of `by` is at most as large in every column and smaller in one."""
    no_larger, smaller = (np.full((len(rows), len(by)), start) for start in (True, False))
    for values, others in zip(rows.T, by.T, strict=True):
        no_larger &= others <= values[:, None]
        smaller |= others < values[:, None]
    return np.asarray((no_larger & smaller).any(axis=1))
