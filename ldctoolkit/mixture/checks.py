"""Events with weights, and the checks of what a fit is given."""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, unmasked
from ldctoolkit.declared import checked_seed, checked_whole
from ldctoolkit.errors import InputError
from ldctoolkit.surroundings import usable_cores

Part = TypeVar("Part")
Work = Callable[[FloatArray, FloatArray | None], Part]  # from the rows (m, d) of a block and their weights (m,), if any
BLOCK: Final = 8192  # rows of a block; the last one may be shorter


@dataclasses.dataclass(frozen=True)
class Events:
    """Events in memory; they are not copied."""

    x: FloatArray  # (n, d): one row an event
    weight: FloatArray | None = None  # (n,): events that each row stands for
    threads: int | None = None  # blocks worked on at a time

    @classmethod
    def of(cls, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None, threads: int | None) -> Events:
        """Events from the arguments of a fit, which must hold rows and columns; `threads` is called n_jobs there."""
        if threads is not None:
            checked_whole("n_jobs", threads, lower=1)
        x = as_matrix(X)
        if x.size == 0:
            raise InputError("X", "no columns" if x.shape[0] else "no rows")
        return cls(x, check_sample_weight(sample_weight, x.shape[0]), threads)

    @property
    def rows(self) -> int:
        """Number of rows n."""
        return int(self.x.shape[0])

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return int(self.x.shape[1])

    def map_blocks(self, work: Work[Part]) -> list[Part]:
        """What `work` gives for each block of `BLOCK` rows, in order."""

        def block(first: int) -> Part:
            weight = None if self.weight is None else self.weight[first : first + BLOCK]
            # row by row in memory, whatever the array's order: the last digits of sums depend on it
            return work(np.ascontiguousarray(self.x[first : first + BLOCK]), weight)

        firsts = range(0, self.rows, BLOCK)
        threads = min(usable_cores() if self.threads is None else self.threads, len(firsts))
        if threads <= 1:
            return [block(first) for first in firsts]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(block, firsts))

    def take(self, rows: BoolArray | IntArray) -> Events:
        """The chosen rows, by a mask or by their numbers."""
        x = np.ascontiguousarray(self.x[rows])
        return dataclasses.replace(self, x=x, weight=None if self.weight is None else self.weight[rows])


def sums_of(events: Events, location: FloatArray, scale: FloatArray, theta: FloatArray) -> tuple[float, FloatArray]:
    """Log-likelihood and feature sums (K, F) of all rows: the work of one E-step."""
    from ldctoolkit.mixture._kernels import statistics_of_rows  # here: the compiler is slow to import

    total, sums = 0.0, np.zeros_like(theta)
    for value, part in events.map_blocks(lambda x, weight: statistics_of_rows(x, weight, location, scale, theta)):
        total += value
        sums += part
    return total, sums


@dataclasses.dataclass(frozen=True)
class Profile:
    """What a fit must know of the events before its first pass; profiles of blocks add up."""

    rows: int
    used: int  # rows with a weight above zero
    events: float  # sum of the weights; the number of rows without any
    mean: FloatArray  # (d,): weighted mean
    square: FloatArray  # (d,): weighted sum of squares about the mean
    least: FloatArray  # (d,): smallest value
    most: FloatArray  # (d,): largest value

    @classmethod
    def of_block(cls, x: FloatArray, weight: FloatArray | None) -> Profile:
        """The profile of a block of at least one row."""
        w = np.ones(x.shape[0]) if weight is None else weight
        events, used = float(w.sum()), int(np.count_nonzero(w))
        # here, since a caller's settings do not reach other threads: what overflows is refused by its size
        with np.errstate(over="ignore", invalid="ignore"):
            mean = _weighted(w, x) / events if events > 0 else np.zeros(x.shape[1])
            square = _weighted(w, (x - mean) ** 2)
        return cls(x.shape[0], used, events, mean, square, x.min(axis=0), x.max(axis=0))

    def __add__(self, other: Profile) -> Profile:
        events = self.events + other.events
        share = other.events / events if events > 0 else 0.0
        gap = other.mean - self.mean
        return Profile(
            self.rows + other.rows,
            self.used + other.used,
            events,
            self.mean + share * gap,
            self.square + other.square + self.events * share * gap**2,
            np.minimum(self.least, other.least),
            np.maximum(self.most, other.most),
        )

    @property
    def scale(self) -> FloatArray:
        """Standard deviations (d,)."""
        return np.asarray(np.sqrt(self.square / self.events))


def _weighted(w: FloatArray, x: FloatArray) -> FloatArray:
    """Sums (d,) of the rows times their weights; not by BLAS, whose last digits depend on its threads."""
    return np.asarray(np.einsum("i,ij->j", w, x))


def profile_of(events: Events) -> Profile:
    """Counts, means, spreads and ranges of all rows."""
    parts = events.map_blocks(Profile.of_block)
    if not parts:
        raise InputError("X", "no rows", allowed="at least one event")
    profile = functools.reduce(operator.add, parts)
    if profile.events == 0.0:
        raise InputError("X", f"the weights of all {profile.rows} rows are zero", allowed="at least one event")
    return profile


RandomState = int | np.random.Generator | None

_FLAT: Final = 1e-12  # a column whose range is this small beside its values is constant
LARGEST: Final = 1e100
"""Squares and their sums must not overflow; nor may the squares of spreads below its inverse vanish."""


def column_name(j: int, names: Sequence[str] | None) -> str:
    """The column as messages call it: by its name, or by its number."""
    return f"column {j}" if names is None else f"column {names[j]!r}"


def as_matrix(X: npt.ArrayLike) -> FloatArray:
    """A float matrix (n, d), not copied where it is one; its numbers are not looked at."""
    try:
        x = np.asarray(unmasked(X), dtype=float)
    except (TypeError, ValueError):
        raise InputError("X", "not a table of numbers", allowed="an array of shape (n, d)") from None
    if x.ndim != 2:
        raise InputError("X", f"shape {x.shape}", allowed="(n, d), one row an event")
    return x


def check_matrix(X: npt.ArrayLike, dimension: int, names: Sequence[str] | None) -> FloatArray:
    """A finite float matrix (n, dimension)."""
    x = as_matrix(X)
    if x.shape[1] != dimension:
        raise InputError("X", f"{x.shape[1]} columns", allowed=f"{dimension}, as many as there are bounds")
    if x.size and not (x.min() >= -LARGEST and x.max() <= LARGEST):  # NaN is neither
        _refuse(x, ~(np.abs(x) <= LARGEST), f"finite numbers, at most {LARGEST:g} in size", names)
    return x


def _refuse(x: FloatArray, bad: BoolArray, allowed: str, names: Sequence[str] | None) -> None:
    """Raise for the first column with a bad entry, if there is any: its first row and the number of such rows."""
    columns = np.flatnonzero(bad.any(axis=0)).tolist()
    if not columns:
        return
    j, *others = columns
    row = int(np.argmax(bad[:, j]))
    also_in = f", also in {', '.join(column_name(k, names) for k in others)}" if others else ""
    raise InputError(
        f"X: {column_name(j, names)}, row {row}",
        f"({int(bad[:, j].sum())} of {x.shape[0]} rows{also_in})",
        value=float(x[row, j]),
        allowed=allowed,
    )


def check_events(events: Events, K: int, lower: FloatArray, upper: FloatArray, names: Sequence[str] | None) -> Profile:
    """The profile of events that can be fitted: inside the box, enough of them, and no column without spread."""
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(events)
    x, d = events.x, events.dimension
    check_matrix(x, d, names)
    if profile.used < K * (d + 1):
        allowed = f"at least K (d + 1) = {K * (d + 1)} for K = {K}, d = {d}"
        raise InputError("X", f"{profile.used} rows", allowed=allowed)
    spread = profile.most - profile.least
    for j in np.flatnonzero(~((profile.least > lower) & (profile.most < upper))).tolist():
        bad = np.zeros(x.shape, dtype=bool)
        bad[:, j] = ~((x[:, j] > lower[j]) & (x[:, j] < upper[j]))
        _refuse(x, bad, f"strictly between the bounds {lower[j]:g} and {upper[j]:g}", names)
    for j, size in enumerate(np.maximum(np.abs(profile.most), np.abs(profile.least)).tolist()):
        path = f"X: {column_name(j, names)}"
        if not spread[j] > _FLAT * size:
            problem = f"is constant ({float(profile.least[j])!r} in all {profile.rows} rows)"
            raise InputError(path, problem, hint="leave it out of the fit")
        if not profile.square[j] > 0.0 or spread[j] < 1.0 / LARGEST:
            raise InputError(path, f"spreads over {spread[j]:g}", allowed=f"{1.0 / LARGEST:g} or more")
    return profile


def check_weights(weights: npt.ArrayLike, rows: int, name: str, row: str = "row") -> FloatArray:
    """Weights (rows,), finite and not negative; messages call them `name`, each of them that of a `row`."""
    try:
        weight = np.asarray(unmasked(weights), dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, "not numbers", allowed=f"one number >= 0 a {row}") from None
    if weight.shape != (rows,):
        raise InputError(name, f"shape {weight.shape}", allowed=f"({rows},), one number a {row}")
    bad = ~(np.isfinite(weight) & (weight >= 0.0))
    if bad.any():
        index = int(np.argmax(bad))
        raise InputError(f"{name}: {row} {index}", value=float(weight[index]), allowed="finite numbers >= 0")
    return weight


def check_sample_weight(sample_weight: npt.ArrayLike | None, rows: int) -> FloatArray | None:
    """Weights (rows,), finite, not negative, not all zero; None is one each."""
    if sample_weight is None:
        return None
    weight = check_weights(sample_weight, rows, "sample_weight")
    if not weight.sum() > 0.0:
        raise InputError("sample_weight", "all zero", allowed="at least one event")
    return weight


def check_bound_array(value: npt.ArrayLike | None, name: str, fill: float, dimension: int) -> FloatArray:
    """Bounds as (d,) floats; a scalar is repeated, None is open."""
    try:
        out = np.asarray(fill if value is None else unmasked(value), dtype=float)
    except (TypeError, ValueError):
        raise InputError(name, value=value, allowed=f"a number or {dimension} numbers, inf included") from None
    if out.ndim == 0:
        out = np.full(dimension, float(out))
    if out.shape != (dimension,):
        raise InputError(name, f"shape {out.shape}", allowed=f"a number or ({dimension},), one per column")
    return out


def check_components(components: Iterable[int]) -> list[int]:
    """The numbers of components K to try, each once, in ascending order."""
    if isinstance(components, str) or not isinstance(components, Iterable):
        raise InputError("components", value=components, allowed="a whole number >= 1, or several of them")
    tried = sorted({checked_whole("components", K, lower=1) for K in components})
    if not tried:
        raise InputError("components", "an empty range", allowed="at least one number of components")
    return tried


def seed_of(random_state: RandomState) -> int:
    """An integer seed; None gives a fresh one, a Generator is advanced once."""
    generator = np.random.default_rng() if random_state is None else random_state
    if isinstance(generator, np.random.Generator):
        return int(generator.integers(2**63))
    return checked_seed(generator, "random_state")


_STEP: Final = 1e-3  # a value on a bound moves inside by at most this part of the column's spread


@dataclasses.dataclass(frozen=True)
class InsideBounds:
    """Events without constant columns and without values on a bound."""

    events: Events  # the d' columns that vary, in order
    profile: Profile  # of all d columns as they were
    varies: BoolArray  # (d,): columns that are in `events`
    moved: IntArray  # (d,): values of each column that were on a bound


def inside_bounds(
    events: Events,
    lower: FloatArray,
    upper: FloatArray,
    names: Sequence[str] | None = None,
    *,
    keep_constant: bool = False,
) -> InsideBounds:
    """Leave constant columns out, and move values exactly on a bound inside.

    A value moves by half the smallest other distance to that bound, at most a thousandth of the standard deviation.
    Values outside a bound or not finite stay as they are: a fit names them.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(events)
        size = np.maximum(np.abs(profile.least), np.abs(profile.most))
        varies = ~(profile.most - profile.least <= _FLAT * size)  # NaN varies: the fit is to name it
        scale = profile.scale
    varies |= keep_constant
    outside = ~varies & ((profile.least < lower) | (profile.most > upper))
    if outside.any():
        j = int(np.argmax(outside))
        path, value = f"X: {column_name(j, names)}", float(profile.least[j])
        raise InputError(path, f"in all {profile.rows} rows", value=value, allowed=f"{lower[j]:g} to {upper[j]:g}")
    moved = np.zeros(lower.size, dtype=np.int64)
    on_bound = varies & ((profile.least == lower) | (profile.most == upper))
    if varies.all() and not on_bound.any():
        return InsideBounds(events, profile, varies, moved)
    x = np.array(events.x[:, varies], order="C")
    for column, j in enumerate(np.flatnonzero(varies).tolist()):
        if on_bound[j]:
            for bound, inwards in ((lower[j], 1.0), (upper[j], -1.0)):
                moved[j] += _move_inside(x[:, column], bound, inwards, _STEP * float(scale[j]))
    return InsideBounds(dataclasses.replace(events, x=x), profile, varies, moved)


def _move_inside(column: FloatArray, bound: float, inwards: float, most: float) -> int:
    """Move the values of a column that lie on a bound, in place, by at most `most`; how many these were."""
    distance = inwards * (column - bound)
    on_bound = distance == 0.0
    if on_bound.any():
        nearest = float(np.min(distance[distance > 0.0], initial=np.inf))
        moved = bound + inwards * min(0.5 * nearest, most)
        column[on_bound] = moved if inwards * (moved - bound) > 0.0 else np.nextafter(bound, inwards * np.inf)
    return int(on_bound.sum())
