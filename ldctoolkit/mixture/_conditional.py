"""A mixture under conditions: some columns within intervals, some at given values, exactly."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture._checks import column_name
from ldctoolkit.mixture._distribution import BoolArray, Distribution, IntArray
from ldctoolkit.mixture._expectation import FloatArray
from ldctoolkit.mixture._transform import Transform
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

Given = Mapping[str, object] | Mapping[int, object] | Mapping[str | int, object]
"""Column name or number -> a value, or (lower, upper) with None or an infinite number where open."""


@dataclasses.dataclass(frozen=True)
class Conditional(Distribution):
    """A distribution given intervals or values of some columns; its rows have all columns.

    `weights` and `truncated` are those of the columns that are left to draw, `transform` maps these columns.

    Attributes
    ----------
    lower, upper : (d,)
        The box and the intervals' common part, in the data's units; equal in a column with a given value.
    free : (d - fixed,) int
        Columns that are left to draw.
    log_mass : float
        Logarithm of the condition's probability; where values are given, of its density at them.
    """

    lower: FloatArray
    upper: FloatArray
    free: IntArray
    log_mass: float

    @property
    def dimension(self) -> int:
        """Number of columns d, those with given values included."""
        return int(self.lower.size)

    def inside(self, x: FloatArray) -> BoolArray:
        """Which rows meet the conditions, (n,)."""
        out: BoolArray = np.all((x >= self.lower) & (x <= self.upper), axis=1)
        return out

    def _columns(self, x: FloatArray) -> FloatArray:
        return np.asarray(x[:, self.free])

    def _own_columns(self, x: FloatArray) -> FloatArray:
        out = np.empty((x.shape[0], self.dimension))
        out[:] = self.lower
        low, high = np.nextafter(self.lower, np.inf)[self.free], np.nextafter(self.upper, -np.inf)[self.free]
        out[:, self.free] = np.clip(x, low, high)  # a map back to the data's units rounds
        return out


def condition(whole: Distribution, given: Given, names: Sequence[str] | None) -> Conditional:
    """See `Distribution.condition`."""
    if isinstance(whole, Conditional):
        raise InputError("given: the distribution has conditions already; allowed: all conditions at once")
    lower, upper = _intervals(given, names, whole.transform)
    fixed, free = np.flatnonzero(lower == upper), np.flatnonzero(lower < upper)
    if free.size == 0:
        raise InputError("given: values for all columns; allowed: at least one column left to draw")
    t = whole.truncated
    with np.errstate(divide="ignore"):
        log_weights = np.log(whole.weights) - t.log_probability
    ends = whole.transform.forward(np.array([lower, upper]))  # a bound is mapped to infinity
    mu, Sigma, log_marginal = _given_values(t.mu, t.Sigma, fixed, free, ends[0, fixed])
    inner = TruncatedNormal(mu, Sigma, ends[0, free], ends[1, free])
    log_weights = log_weights + log_marginal + inner.log_probability
    peak = float(log_weights.max())
    weights = np.exp(log_weights - peak)
    log_mass = peak + math.log(weights.sum())
    if fixed.size:
        log_mass += float(_part(whole.transform, fixed).log_slope(lower[None, fixed])[0])
    rest = _part(whole.transform, free)
    return Conditional(weights / weights.sum(), inner, rest, lower, upper, free, log_mass)


def _given_values(
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


def _part(transform: Transform, columns: IntArray) -> Transform:
    """The maps of some columns."""
    kinds = tuple(transform.kinds[j] for j in columns)
    return Transform(kinds, transform.lower[columns], transform.upper[columns])


def _intervals(given: Given, names: Sequence[str] | None, transform: Transform) -> tuple[FloatArray, FloatArray]:
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
