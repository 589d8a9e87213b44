"""Conditions on the columns of a mixture: what a caller may write, and components at given values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture._transform import Transform
from ldctoolkit.mixture.checks import column_name

Given = Mapping[str, object] | Mapping[int, object] | Mapping[str | int, object]
"""Column name or number -> a value, or (lower, upper) with None or an infinite number where open."""


def given_values(
    mu: FloatArray, Sigma: FloatArray, fixed: IntArray, free: IntArray, value: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means and covariances of the free columns at given values of the others, and those values' log-density, (K,)."""
    if fixed.size == 0:
        return mu, Sigma, np.zeros(mu.shape[0])
    L = np.linalg.cholesky(Sigma[:, fixed[:, None], fixed])
    gap = np.linalg.solve(L, (value - mu[:, fixed])[:, :, None])
    slope = np.linalg.solve(L, Sigma[:, fixed[:, None], free])
    there = mu[:, free] + (slope.transpose(0, 2, 1) @ gap)[:, :, 0]
    rest = Sigma[:, free[:, None], free] - slope.transpose(0, 2, 1) @ slope
    log_root = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
    log_density = -0.5 * np.sum(gap[:, :, 0] ** 2, axis=1) - log_root - 0.5 * fixed.size * np.log(2.0 * np.pi)
    return there, 0.5 * (rest + rest.transpose(0, 2, 1)), log_density


def part_of(transform: Transform, columns: IntArray) -> Transform:
    """The maps of some columns."""
    kinds = tuple(transform.kinds[j] for j in columns)
    return Transform(kinds, transform.lower[columns], transform.upper[columns])


def intervals(given: Given, names: Sequence[str] | None, transform: Transform) -> tuple[FloatArray, FloatArray]:
    """The box's part that meets the conditions; both ends equal where a value is given."""
    if not isinstance(given, Mapping):
        raise InputError(f"given: {given!r}; allowed: a mapping from columns to values or (lower, upper)")
    lower, upper = transform.lower.copy(), transform.upper.copy()
    seen: set[int] = set()
    for key, wanted in given.items():
        j = _column(key, names, lower.size)
        where = f"given: {column_name(j, names)}"
        if j in seen:
            raise InputError(f"{where} is given twice, by name and by number; allowed: once")
        seen.add(j)
        low, high = _ends(wanted, where)
        box = f"the bounds {transform.lower[j]:g} and {transform.upper[j]:g}"
        if low == high:
            if not transform.lower[j] < low < transform.upper[j]:
                raise InputError(f"{where} = {low!r}; allowed: strictly between {box}")
        elif max(low, transform.lower[j]) >= min(high, transform.upper[j]):
            raise InputError(f"{where} in ({low:g}, {high:g}); allowed: an interval that overlaps {box}")
        lower[j], upper[j] = max(low, transform.lower[j]), min(high, transform.upper[j])
    return lower, upper


def _column(key: object, names: Sequence[str] | None, d: int) -> int:
    """Number of a column given by name or number."""
    if isinstance(key, str):
        if names is None:
            raise InputError(f"given: column {key!r}, but the columns have no names; allowed: numbers 0 to {d - 1}")
        if key not in names:
            raise InputError(f"given: no column {key!r}; {nearest(key, names)}")
        return list(names).index(key)
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and 0 <= key < d:
        return int(key)
    also = "" if names is None else f", or a name of {', '.join(names)}"
    raise InputError(f"given: column {key!r}; allowed: a number 0 to {d - 1}{also}")


def _ends(wanted: object, where: str) -> tuple[float, float]:
    """(lower, upper), equal for a value."""
    allowed = "allowed: a number, or (lower, upper) with lower < upper and None where open"
    if _is_number(wanted):
        value = float(wanted)  # type: ignore[arg-type]
        if not math.isfinite(value):
            raise InputError(f"{where}: {value!r}; {allowed}")
        return value, value
    if not isinstance(wanted, tuple | list | np.ndarray) or len(wanted) != 2:
        raise InputError(f"{where}: {wanted!r}; {allowed}")
    ends: list[float] = []
    for end, fill in zip(wanted, (-math.inf, math.inf), strict=True):
        if end is not None and not _is_number(end):
            raise InputError(f"{where}: {wanted!r}; {allowed}")
        ends.append(fill if end is None else float(end))
    if not ends[0] < ends[1]:
        raise InputError(f"{where}: ({ends[0]!r}, {ends[1]!r}); {allowed}")
    return ends[0], ends[1]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
