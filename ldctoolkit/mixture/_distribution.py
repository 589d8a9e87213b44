"""A bounded Gaussian mixture in the data's units: transform, density, conditions and draws."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.declared import is_number
from ldctoolkit.errors import InputError, ModelError, plain
from ldctoolkit.mixture.truncated_normal import Sampler, TruncatedNormal

Kind = Literal["none", "log", "logit"]

KINDS: Final = ("none", "log", "logit", "auto")
_BY_ENDS: Final[tuple[Kind, ...]] = ("none", "log", "logit")  # what "auto" takes, by the number of finite bounds


@dataclasses.dataclass(frozen=True)
class Transform:
    """A monotone, increasing map for each column."""

    kinds: tuple[Kind, ...]
    lower: FloatArray  # (d,): the box in the data's units
    upper: FloatArray  # (d,)

    @classmethod
    def of(
        cls,
        transform: str | Sequence[str] | None,
        lower: FloatArray,
        upper: FloatArray,
        names: Sequence[str] | None = None,
    ) -> Transform:
        """One kind for all columns or one each, checked against the bounds."""
        d = lower.size
        transform = "none" if transform is None else transform
        words = [transform] * d if isinstance(transform, str) else list(transform)
        if len(words) != d:
            raise InputError("transform", f"{len(words)} names", allowed=f"one name, or {d}, one per column")
        kinds: list[Kind] = []
        for j, (name, ends) in enumerate(zip(words, np.isfinite(lower).astype(int) + np.isfinite(upper), strict=True)):
            path = f"transform[{j if names is None else names[j]!r}]"
            if name not in KINDS:
                raise InputError("transform" if name is transform else path, value=name, allowed=KINDS)
            kind: Kind = _BY_ENDS[ends] if name == "auto" else name  # type: ignore[assignment]
            if kind not in ("none", _BY_ENDS[ends]):
                allowed = f"for columns with {_BY_ENDS.index(kind)}"
                raise InputError(path, f"with {ends} finite bounds", value=kind, allowed=allowed)
            kinds.append(kind)
        return cls(tuple(kinds), lower, upper)

    @property
    def identity(self) -> bool:
        """Whether no column is mapped."""
        return all(kind == "none" for kind in self.kinds)

    def part(self, columns: IntArray) -> Transform:
        """The transform of these columns alone."""
        return Transform(tuple(self.kinds[j] for j in columns), self.lower[columns], self.upper[columns])

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
                    distance = (high - low) * (1.0 - share)
                    out[:, j] = np.where(y[:, j] < 0.0, low + distance, high - distance)
                elif kind == "log":
                    out[:, j] = low + np.exp(y[:, j]) if np.isfinite(low) else high - np.exp(-y[:, j])
        return np.asarray(np.clip(out, np.nextafter(self.lower, np.inf), np.nextafter(self.upper, -np.inf)))

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


@dataclasses.dataclass(frozen=True)
class Components:
    """Parameters of K components in the coordinates of the data."""

    weights: FloatArray  # (K,): eta_k, the share of events
    mu: FloatArray  # (K, d): means before truncation
    Sigma: FloatArray  # (K, d, d): covariances before truncation
    log_p: FloatArray  # (K,): logarithm of the probability of the box


def natural(c: Components) -> FloatArray:
    """Coefficients (K, features) of ln(eta_k g_k/P_k), linear in the features (1, x_i, x_i x_j)."""
    d = c.mu.shape[1]
    i, j = np.triu_indices(d)
    precision = np.linalg.inv(c.Sigma)
    linear = (precision @ c.mu[:, :, None])[:, :, 0]
    _, log_det = np.linalg.slogdet(c.Sigma)
    with np.errstate(divide="ignore"):
        constant = np.log(c.weights) - c.log_p
    constant = constant - 0.5 * (d * np.log(2.0 * np.pi) + log_det + np.sum(c.mu * linear, axis=1))
    quadratic = -precision[:, i, j] * np.where(i == j, 0.5, 1.0)
    return np.concatenate([np.maximum(constant, -1e300)[:, None], linear, quadratic], axis=1)


def log_terms(z: FloatArray, c: Components) -> FloatArray:
    """Terms ln(eta_k g_k(z)/P_k), (n, K), without a check that z is inside the box."""
    i, j = np.triu_indices(z.shape[1])
    features = np.concatenate([np.ones((z.shape[0], 1)), z, z[:, i] * z[:, j]], axis=1)
    return np.asarray(features @ natural(c).T)


def shares(logits: FloatArray) -> FloatArray:
    """Row-wise shares (n, K), summing to one."""
    share = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(share / share.sum(axis=1, keepdims=True))


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
    mean = mu[:, free] + (slope.transpose(0, 2, 1) @ gap)[:, :, 0]
    rest = Sigma[:, free[:, None], free] - slope.transpose(0, 2, 1) @ slope
    log_root = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
    log_density = -0.5 * np.sum(gap[:, :, 0] ** 2, axis=1) - log_root - 0.5 * fixed.size * np.log(2.0 * np.pi)
    return mean, 0.5 * (rest + rest.transpose(0, 2, 1)), log_density


def intervals(given: Conditions, names: Sequence[str] | None, transform: Transform) -> tuple[FloatArray, FloatArray]:
    """The box's part that meets the conditions; both ends equal where a value is given."""
    if not isinstance(given, Mapping):
        raise InputError("given", value=given, allowed="a mapping from columns to values or (lower, upper)")
    lower, upper = transform.lower.copy(), transform.upper.copy()
    seen: set[int] = set()
    for key, condition in given.items():
        j = _column(key, names, lower.size)
        path = f"given[{j if names is None else names[j]!r}]"
        if j in seen:
            raise InputError(path, "is given twice, by name and by number", allowed="once")
        seen.add(j)
        low, high = interval_of(path, condition)
        box = f"the bounds {transform.lower[j]:g} and {transform.upper[j]:g}"
        if low == high:
            if not transform.lower[j] < low < transform.upper[j]:
                raise InputError(path, value=low, allowed=f"strictly between {box}")
        elif max(low, transform.lower[j]) >= min(high, transform.upper[j]):
            raise InputError(path, value=condition, allowed=f"an interval that overlaps {box}")
        lower[j], upper[j] = max(low, transform.lower[j]), min(high, transform.upper[j])
    return lower, upper


def _column(key: object, names: Sequence[str] | None, d: int) -> int:
    """Number of a column given by name or number."""
    number = plain(key)
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < d:
        return number
    if names is not None and isinstance(key, str):
        if key not in names:
            raise InputError("given", "no such column", value=key, allowed=names)
        return list(names).index(key)
    also = "; the columns have no names" if names is None else f", or a name of {', '.join(names)}"
    raise InputError("given", "is not a column", value=key, allowed=f"a number 0 to {d - 1}{also}")


def interval_of(path: str, condition: object) -> tuple[float, float]:
    """(lower, upper) of a condition, infinite where open; both equal for a value."""
    pair = (condition, condition) if is_number(plain(condition)) else condition
    if isinstance(pair, tuple | list | np.ndarray) and len(pair) == 2:
        ends = [fill if end is None else plain(end) for end, fill in zip(pair, (-math.inf, math.inf), strict=True)]
        if all(isinstance(end, int | float) and not isinstance(end, bool) for end in ends):
            low, high = map(float, ends)
            if low < high or (low == high and math.isfinite(low)):
                return low, high
    allowed = "a number, or (lower, upper) with lower < upper and None where open"
    raise InputError(path, value=condition, allowed=allowed)


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

    def inside(self, x: FloatArray) -> BoolArray:
        """Which rows lie in the closed box, (n,)."""
        return np.asarray(np.all((x >= self.transform.lower) & (x <= self.transform.upper), axis=1))

    def _free_columns(self, x: FloatArray) -> FloatArray:
        """The columns that `truncated` and `transform` describe."""
        return x

    def _has_density(self, x: FloatArray) -> BoolArray:
        return np.asarray(self.inside(x) & np.isfinite(self.transform.forward(self._free_columns(x))).all(axis=1))

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log-density of each row, (n,); -inf outside the box, and on a bound that is mapped to infinity."""
        inside = self._has_density(x)
        if not inside.all():
            out = np.full(x.shape[0], -np.inf)
            if inside.any():
                out[inside] = self.log_density(x[inside])
            return out
        from ldctoolkit.mixture._kernels import log_density_of_rows  # here: the compiler is slow to import

        # in units of the components' own spread: the features x_i x_j would otherwise cancel
        t = self.truncated
        location = self.weights @ t.mu
        scale = np.sqrt(self.weights @ np.diagonal(t.Sigma, axis1=1, axis2=2))
        Sigma = t.Sigma / (scale[:, None] * scale)
        theta = natural(Components(self.weights, (t.mu - location) / scale, Sigma, t.log_probability))
        free = self._free_columns(x)
        values = log_density_of_rows(self.transform.forward(free), location, scale, theta) - float(np.log(scale).sum())
        return values if self.transform.identity else values + self.transform.log_slope(free)

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
            log_mass += float(self.transform.part(fixed).log_slope(lower[None, fixed])[0])
        rest = self.transform.part(free)
        return Conditional(weights / weights.sum(), inner, rest, lower, upper, free, log_mass)

    @functools.cached_property
    def _samplers(self) -> dict[int, Sampler]:
        return {}  # of the components drawn so far

    def sample_block(self, seed: int, key: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """`SAMPLE_BLOCK` events and their components, from the random stream named by (seed, key)."""
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
        label = rng.choice(self.weights.size, size=SAMPLE_BLOCK, p=self.weights / self.weights.sum())
        y = np.empty((SAMPLE_BLOCK, self.truncated.mu.shape[1]))
        for k in range(self.weights.size):
            rows = np.flatnonzero(label == k)
            if rows.size:
                y[rows] = self._draw(k, rows.size, rng)
        return self._all_columns(self.transform.inverse(y)), label.astype(np.int64)

    def _draw(self, k: int, n: int, rng: np.random.Generator) -> FloatArray:
        if k not in self._samplers:
            self._samplers[k] = Sampler(self.truncated, k)
        try:
            return self._samplers[k].draw(n, rng)
        except ModelError as error:
            raise error.at(f"component {k}") from None

    def _all_columns(self, x: FloatArray) -> FloatArray:
        """Rows with all columns of the distribution, from drawn rows."""
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
        return np.asarray(np.all((x >= self.lower) & (x <= self.upper), axis=1))

    def _free_columns(self, x: FloatArray) -> FloatArray:
        return np.asarray(x[:, self.free])

    def _all_columns(self, x: FloatArray) -> FloatArray:
        out = np.empty((x.shape[0], self.dimension))
        out[:] = self.lower
        low, high = np.nextafter(self.lower, np.inf)[self.free], np.nextafter(self.upper, -np.inf)[self.free]
        out[:, self.free] = np.clip(x, low, high)  # a map back to the data's units rounds
        return out
