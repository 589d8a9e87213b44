"""Where the events of a fit lie: an array here, or blocks that are worked on one after the other or elsewhere.

A fit asks a source for little: what some work gives on each block of rows, and a few rows to start from. Blocks hold
`BLOCK` rows, counted from the first row, and results are added in the order of the blocks; so a number depends neither
on the threads nor on where a block was worked on.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Final, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._transform import Transform

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Part = TypeVar("Part")
Work = Callable[[FloatArray, FloatArray | None], Part]
"""From the rows (m, d) of a block and their weights (m,), if any. It can be pickled where a source sends it away."""

BLOCK: Final = 8192
"""Rows of a block; the last one may be shorter."""


@runtime_checkable
class EventSource(Protocol):
    """Events of a fit: n rows of d numbers, each with a weight if it stands for more or less than one event."""

    @property
    def dimension(self) -> int:
        """Number of columns d."""

    def map_blocks(self, work: Work[Part]) -> Iterable[Part]:
        """What `work` gives for each block of `BLOCK` rows, in order."""

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Rows (m, d) by their ascending numbers, and their weights."""

    def blocks(self) -> Iterator[FloatArray]:
        """The rows of each block, in order."""


@dataclasses.dataclass(frozen=True)
class ArrayEvents:
    """Events in memory; they are not copied.

    Attributes
    ----------
    x : (n, d)
        Events, at least one.
    weight : (n,), optional
        Events that each row stands for.
    threads : int, optional
        Blocks worked on at a time; all cores this process may use by default. It changes no number.

    Examples
    --------
    >>> import numpy as np
    >>> profile_of(ArrayEvents(np.array([[1.0], [3.0]]))).mean.tolist()
    [2.0]
    """

    x: FloatArray
    weight: FloatArray | None = None
    threads: int | None = None

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return int(self.x.shape[1])

    def map_blocks(self, work: Work[Part]) -> Iterable[Part]:
        """What `work` gives for each block of `BLOCK` rows, in order."""

        def block(first: int) -> Part:
            weight = None if self.weight is None else self.weight[first : first + BLOCK]
            # row by row in memory, whatever the array's order: the last digits of sums depend on it
            return work(np.ascontiguousarray(self.x[first : first + BLOCK]), weight)

        firsts = range(0, self.x.shape[0], BLOCK)
        threads = min(usable_cores() if self.threads is None else self.threads, len(firsts))
        if threads <= 1:
            return [block(first) for first in firsts]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(block, firsts))

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Rows (m, d) by their ascending numbers, and their weights."""
        return np.ascontiguousarray(self.x[rows]), None if self.weight is None else self.weight[rows]

    def blocks(self) -> Iterator[FloatArray]:
        """The rows of each block, in order."""
        for first in range(0, self.x.shape[0], BLOCK):
            yield self.x[first : first + BLOCK]


@dataclasses.dataclass(frozen=True)
class _Mapped(Generic[Part]):
    """Work on transformed rows."""

    transform: Transform
    work: Work[Part]

    def __call__(self, x: FloatArray, weight: FloatArray | None) -> Part:
        return self.work(self.transform.forward(x), weight)


@dataclasses.dataclass(frozen=True)
class TransformedEvents:
    """A source seen through a transform, block by block."""

    source: EventSource
    transform: Transform

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return self.source.dimension

    def map_blocks(self, work: Work[Part]) -> Iterable[Part]:
        """What `work` gives for each block of transformed rows, in order."""
        return self.source.map_blocks(_Mapped(self.transform, work))

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Transformed rows (m, d) by their ascending numbers, and their weights."""
        x, weight = self.source.take(rows)
        return self.transform.forward(x), weight

    def blocks(self) -> Iterator[FloatArray]:
        """The transformed rows of each block, in order."""
        return map(self.transform.forward, self.source.blocks())


def transformed(source: EventSource, transform: Transform) -> EventSource:
    """The source in the transform's coordinates; an array is transformed once, a stream at every pass."""
    if transform.identity:
        return source
    if isinstance(source, ArrayEvents):
        return dataclasses.replace(source, x=transform.forward(source.x))
    return TransformedEvents(source, transform)


@dataclasses.dataclass(frozen=True)
class Pass:
    """Work of one E-step.

    Attributes
    ----------
    location, scale : (d,)
        The components live in (x - location)/scale.
    theta : (K, F)
        Coefficients of the features in ln(eta_k g_k/P_k).
    """

    location: FloatArray
    scale: FloatArray
    theta: FloatArray

    def __call__(self, x: FloatArray, weight: FloatArray | None) -> tuple[float, FloatArray]:
        """Log-likelihood and feature sums (K, F) of one block."""
        from ldctoolkit.mixture._kernels import statistics_of_rows  # here: the compiler is slow to import

        return statistics_of_rows(x, weight, self.location, self.scale, self.theta)


def sums_of(source: EventSource, work: Pass) -> tuple[float, FloatArray]:
    """Log-likelihood and feature sums (K, F) of all rows."""
    total, sums = 0.0, np.zeros_like(work.theta)
    for value, part in source.map_blocks(work):
        total += value
        sums += part
    return total, sums


@dataclasses.dataclass(frozen=True)
class Profile:
    """What a fit must know of the events before its first pass; profiles of blocks add up.

    Attributes
    ----------
    rows, used : int
        Rows, and those with a weight above zero.
    events : float
        Sum of the weights; the number of rows without any.
    mean, square : (d,)
        Weighted mean, and weighted sum of squares about it.
    least, most : (d,)
        Smallest and largest value.
    """

    rows: int
    used: int
    events: float
    mean: FloatArray
    square: FloatArray
    least: FloatArray
    most: FloatArray

    @classmethod
    def of_block(cls, x: FloatArray, weight: FloatArray | None) -> Profile:
        """Of some rows, at least one."""
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
        out: FloatArray = np.sqrt(self.square / self.events)
        return out


def _weighted(w: FloatArray, x: FloatArray) -> FloatArray:
    """Sums (d,) of the rows times their weights; not by BLAS, whose last digits depend on its threads."""
    out: FloatArray = np.einsum("i,ij->j", w, x)
    return out


def used_rows(source: EventSource, profile: Profile) -> IntArray:
    """Numbers of the rows with a weight above zero, ascending."""
    if profile.used == profile.rows:
        return np.arange(profile.rows)
    return np.flatnonzero(np.concatenate(list(source.map_blocks(_is_used))))


def _is_used(x: FloatArray, weight: FloatArray | None) -> npt.NDArray[np.bool_]:
    return np.ones(x.shape[0], dtype=bool) if weight is None else weight > 0.0


def profile_of(source: EventSource) -> Profile:
    """Counts, means, spreads and ranges of all rows.

    Raises
    ------
    InputError
        If there is no row, or no row with a weight above zero.
    """
    parts = iter(source.map_blocks(Profile.of_block))
    first = next(parts, None)
    if first is None:
        raise InputError("X: no rows; allowed: at least one event")
    profile = functools.reduce(operator.add, parts, first)
    if profile.events == 0.0:
        raise InputError(f"X: the weights of all {profile.rows} rows are zero; allowed: at least one event")
    return profile


def usable_cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        return os.cpu_count() or 1
