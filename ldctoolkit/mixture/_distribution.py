"""A bounded Gaussian mixture in the data's units: transform, density, margins and draws."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture._expectation import Components, log_density, log_terms, shares
from ldctoolkit.mixture.checks import column_name
from ldctoolkit.mixture.truncated_normal import Sampler, TruncatedNormal

Kind = Literal["none", "log", "logit"]

KINDS: Final = ("none", "log", "logit", "auto")


@dataclasses.dataclass(frozen=True)
class Transform:
    """One monotone, increasing map a dimension."""

    kinds: tuple[Kind, ...]
    lower: FloatArray  # (d,): the box in the data's units
    upper: FloatArray  # (d,): the box in the data's units

    @classmethod
    def of(cls, wanted: str | Sequence[str] | None, lower: FloatArray, upper: FloatArray) -> Transform:
        """The caller's wish, checked against the bounds."""
        d = lower.size
        names = (
            ["none"] * d if wanted is None else [wanted] * d if isinstance(wanted, str) else [str(w) for w in wanted]
        )
        if len(names) != d:
            raise InputError("transform", f"{len(names)} names", allowed=f"one name, or {d}, one per column")
        for name in names:
            if name not in KINDS:
                raise InputError("transform", value=name, allowed=KINDS)
        ends = np.isfinite(lower).astype(int) + np.isfinite(upper)
        kinds: list[Kind] = []
        for j, name in enumerate(names):
            if name == "auto":
                name = ("none", "log", "logit")[ends[j]]
            if name == "log" and ends[j] != 1:
                raise InputError(
                    "transform", f"'log' for column {j} with {ends[j]} finite bounds", allowed="exactly one"
                )
            if name == "logit" and ends[j] != 2:
                raise InputError("transform", f"'logit' for column {j} with {ends[j]} finite bounds", allowed="two")
            kinds.append("log" if name == "log" else "logit" if name == "logit" else "none")
        return cls(tuple(kinds), lower, upper)

    @property
    def identity(self) -> bool:
        """Whether nothing is mapped."""
        return all(kind == "none" for kind in self.kinds)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """The box in the new coordinates: a mapped dimension is open."""
        mapped = np.array([kind != "none" for kind in self.kinds])
        return np.where(mapped, -np.inf, self.lower), np.where(mapped, np.inf, self.upper)

    def forward(self, x: FloatArray) -> FloatArray:
        """Rows (n, d) in the new coordinates; a value on a bound is infinite, one outside NaN."""
        if self.identity:
            return x
        out = x.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    out[:, j] = np.log(x[:, j] - low) - np.log(high - x[:, j])
                elif kind == "log":
                    out[:, j] = np.log(x[:, j] - low) if np.isfinite(low) else -np.log(high - x[:, j])
        return out

    def inverse(self, y: FloatArray) -> FloatArray:
        """Rows in the data's units, strictly inside the box."""
        if self.identity:
            return y
        out = y.copy()
        with np.errstate(over="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    share = 1.0 / (1.0 + np.exp(-np.abs(y[:, j])))
                    near = (high - low) * (1.0 - share)
                    out[:, j] = np.where(y[:, j] < 0.0, low + near, high - near)
                elif kind == "log":
                    out[:, j] = low + np.exp(y[:, j]) if np.isfinite(low) else high - np.exp(-y[:, j])
        inside: FloatArray = np.clip(out, np.nextafter(self.lower, np.inf), np.nextafter(self.upper, -np.inf))
        return inside

    def log_slope(self, x: FloatArray) -> FloatArray:
        """Logarithm of the maps' derivatives, (n,): what a density in the new coordinates gains in the data's."""
        out = np.zeros(x.shape[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    out += np.log(high - low) - np.log(x[:, j] - low) - np.log(high - x[:, j])
                elif kind == "log":
                    out -= np.log(x[:, j] - low) if np.isfinite(low) else np.log(high - x[:, j])
        return out


Conditions = Mapping[str, object] | Mapping[int, object] | Mapping[str | int, object]
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


def intervals(given: Conditions, names: Sequence[str] | None, transform: Transform) -> tuple[FloatArray, FloatArray]:
    """The box's part that meets the conditions; both ends equal where a value is given."""
    if not isinstance(given, Mapping):
        raise InputError("given", value=given, allowed="a mapping from columns to values or (lower, upper)")
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
            raise InputError("given", f"column {key!r}, but the columns have no names", allowed=f"numbers 0 to {d - 1}")
        if key not in names:
            raise InputError("given", "is no column", value=key, allowed=names)
        return list(names).index(key)
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and 0 <= key < d:
        return int(key)
    also = "" if names is None else f", or a name of {', '.join(names)}"
    raise InputError("given", f"column {key!r}", allowed=f"a number 0 to {d - 1}{also}")


def _ends(wanted: object, where: str) -> tuple[float, float]:
    """(lower, upper), equal for a value."""
    allowed = "allowed: a number, or (lower, upper) with lower < upper and None where open"
    if _is_number(wanted):
        value = float(wanted)  # type: ignore[arg-type]
        if not math.isfinite(value):
            raise InputError(where, value=value, hint=allowed)
        return value, value
    if not isinstance(wanted, tuple | list | np.ndarray) or len(wanted) != 2:
        raise InputError(where, value=wanted, hint=allowed)
    ends: list[float] = []
    for end, fill in zip(wanted, (-math.inf, math.inf), strict=True):
        if end is not None and not _is_number(end):
            raise InputError(where, value=wanted, hint=allowed)
        ends.append(fill if end is None else float(end))
    if not ends[0] < ends[1]:
        raise InputError(where, f"({ends[0]!r}, {ends[1]!r})", hint=allowed)
    return ends[0], ends[1]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


SAMPLE_BLOCK: Final = 8192
"""Events drawn from one random stream; fixed, so that the first m of n samples do not depend on n."""


@dataclasses.dataclass(frozen=True)
class Distribution:
    """Density sum_k eta_k g_k/P_k in the coordinates of a transform."""

    weights: FloatArray  # (K,) eta_k
    truncated: TruncatedNormal  # The components, in the transform's coordinates
    transform: Transform  # From the data's units; it holds the box in them

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return int(self.truncated.mu.shape[1])

    @property
    def n_parameters(self) -> int:
        """Free parameters: K means, K covariances, K - 1 weights."""
        K, d = self.truncated.mu.shape
        return int(K * (d + d * (d + 1) // 2) + K - 1)

    def own_units(self) -> tuple[Components, FloatArray, FloatArray]:
        """Components, location and scale in units of their own spread: the features x_i x_j would otherwise cancel."""
        t = self.truncated
        location = self.weights @ t.mu
        scale = np.sqrt(self.weights @ np.diagonal(t.Sigma, axis1=1, axis2=2))
        scaled = Components(
            self.weights, (t.mu - location) / scale, t.Sigma / (scale[:, None] * scale), t.log_probability
        )
        return scaled, location, scale

    def inside(self, x: FloatArray) -> BoolArray:
        """Which rows lie in the closed box, (n,)."""
        out: BoolArray = np.all((x >= self.transform.lower) & (x <= self.transform.upper), axis=1)
        return out

    def _columns(self, x: FloatArray) -> FloatArray:
        """The columns that `truncated` and `transform` speak of."""
        return x

    def has_density(self, x: FloatArray) -> BoolArray:
        """Which rows lie in the box and not on a bound that is mapped to infinity, (n,)."""
        out: BoolArray = self.inside(x) & np.isfinite(self.transform.forward(self._columns(x))).all(axis=1)
        return out

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log-density of each row, (n,); -inf outside the box, and on a bound that is mapped to infinity."""
        inside = self.has_density(x)
        if not inside.all():
            out = np.full(x.shape[0], -np.inf)
            if inside.any():
                out[inside] = self.log_density(x[inside])
            return out
        scaled, location, scale = self.own_units()
        own = self._columns(x)
        values = log_density(self.transform.forward(own), scaled, location, scale) - float(np.log(scale).sum())
        return values if self.transform.identity else values + self.transform.log_slope(own)

    def shares(self, x: FloatArray) -> FloatArray:
        """Share of each component in each row, (n, K); rows inside the box."""
        scaled, location, scale = self.own_units()
        return shares(log_terms((self.transform.forward(self._columns(x)) - location) / scale, scaled))

    def condition(self, given: Conditions, names: Sequence[str] | None = None) -> Conditional:
        """The distribution given intervals or values of some columns, exactly.

        Raises `InputError` for an unknown column, an interval that is reversed or misses the box, a value that is not
        strictly inside it, what is not a number, or values for all columns.

        Parameters
        ----------
        given : mapping
            Column number, or name -> (lower, upper), either None or infinite where open, or a value.
        names : sequence of str, optional
            Column names.

        Returns
        -------
        Conditional
            A distribution too: its rows have all columns.

        Notes
        -----
        Given an interval, component k keeps mu and Sigma, and its share becomes eta_k P_k(interval)/P_k; given a
        value, its share is multiplied by its marginal density there, and mu and Sigma become those of the regression
        on it. All shares are logarithms until they are normalised, so a condition may be as rare as it likes.
        """
        if isinstance(self, Conditional):
            raise InputError("given", "the distribution has conditions already", allowed="all conditions at once")
        lower, upper = intervals(given, names, self.transform)
        fixed, free = np.flatnonzero(lower == upper), np.flatnonzero(lower < upper)
        if free.size == 0:
            raise InputError("given", "values for all columns", allowed="at least one column left to draw")
        t = self.truncated
        with np.errstate(divide="ignore"):
            log_weights = np.log(self.weights) - t.log_probability
        ends = self.transform.forward(np.array([lower, upper]))  # a bound is mapped to infinity
        mu, Sigma, log_marginal = given_values(t.mu, t.Sigma, fixed, free, ends[0, fixed])
        inner = TruncatedNormal(mu, Sigma, ends[0, free], ends[1, free])
        log_weights = log_weights + log_marginal + inner.log_probability
        peak = float(log_weights.max())
        weights = np.exp(log_weights - peak)
        log_mass = peak + math.log(weights.sum())
        if fixed.size:
            log_mass += float(part_of(self.transform, fixed).log_slope(lower[None, fixed])[0])
        rest = part_of(self.transform, free)
        return Conditional(weights / weights.sum(), inner, rest, lower, upper, free, log_mass)

    @functools.cached_property
    def _samplers(self) -> dict[int, Sampler]:
        """Components that can be drawn; made when first wanted."""
        return {}

    def sample_block(self, seed: int, key: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """`SAMPLE_BLOCK` events and their components, from the random stream named by (seed, key)."""
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
        label = rng.choice(self.weights.size, size=SAMPLE_BLOCK, p=self.weights / self.weights.sum())
        y = np.empty((SAMPLE_BLOCK, self.truncated.mu.shape[1]))
        for k in range(self.weights.size):
            rows = np.flatnonzero(label == k)
            if rows.size:
                y[rows] = self._draw(k, rows.size, rng)
        return self._own_columns(self.transform.inverse(y)), label.astype(np.int64)

    def _draw(self, k: int, n: int, rng: np.random.Generator) -> FloatArray:
        if k not in self._samplers:
            self._samplers[k] = self.truncated.sampler(k)
        try:
            return self._samplers[k].draw(n, rng)
        except ModelError as error:
            raise ModelError(f"component {k}", f"{error}") from None

    def _own_columns(self, x: FloatArray) -> FloatArray:
        """Drawn rows as the distribution's rows."""
        return x

    def sample(self, n: int, seed: int) -> tuple[FloatArray, IntArray]:
        """Draw n events (n, d) and their components (n,); the first m of n do not depend on n."""
        x, label = np.empty((n, self.dimension)), np.empty(n, dtype=np.int64)
        # one after the other: threads gain nothing, so short are the array operations between which they take turns
        for block in range(-(-n // SAMPLE_BLOCK)):
            rows = slice(block * SAMPLE_BLOCK, min(n, (block + 1) * SAMPLE_BLOCK))
            drawn, component = self.sample_block(seed, (block,))
            x[rows], label[rows] = drawn[: rows.stop - rows.start], component[: rows.stop - rows.start]
        return x, label

    def check_samplable(self) -> None:
        """Draw from every component: a `ModelError` here rather than in a later `sample`."""
        for k in np.flatnonzero(self.weights > 0.0):
            self._draw(int(k), 4, np.random.default_rng(0))


@dataclasses.dataclass(frozen=True)
class Conditional(Distribution):
    """A distribution given intervals or values of some columns; its rows have all columns.

    `weights` and `truncated` are those of the columns that are left to draw, `transform` maps these columns.
    """

    # (d,) The box and the intervals' common part, in the data's units; equal in a column with a given value
    lower: FloatArray
    upper: FloatArray
    free: IntArray  # (d - fixed,) Columns that are left to draw
    log_mass: float  # Logarithm of the condition's probability; where values are given, of its density at them

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
