"""The events of a fit: rows with weights, worked on in blocks by threads.

Blocks hold `BLOCK` rows, counted from the first row, and results are added in the order of the blocks; so no number
depends on the threads.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError

Part = TypeVar("Part")
Work = Callable[[FloatArray, FloatArray | None], Part]
"""From the rows (m, d) of a block and their weights (m,), if any."""

BLOCK: Final = 8192
"""Rows of a block; the last one may be shorter."""


@dataclasses.dataclass(frozen=True)
class Events:
    """Events in memory; they are not copied."""

    x: FloatArray  # (n, d): one row an event
    weight: FloatArray | None = None  # (n,): events that each row stands for
    threads: int | None = None  # blocks worked on at a time

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

    def take(self, rows: npt.NDArray[np.bool_] | IntArray) -> Events:
        """The chosen rows, by a mask or by ascending numbers."""
        x = np.ascontiguousarray(self.x[rows])
        return dataclasses.replace(self, x=x, weight=None if self.weight is None else self.weight[rows])

    def used_rows(self) -> IntArray:
        """Numbers of the rows with a weight above zero, ascending."""
        return np.arange(self.rows) if self.weight is None else np.flatnonzero(self.weight > 0.0)


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

    rows: int  # rows, and those with a weight above zero
    used: int
    events: float  # sum of the weights; the number of rows without any
    mean: FloatArray  # (d,): weighted mean, and weighted sum of squares about it
    square: FloatArray  # (d,)
    least: FloatArray  # (d,): smallest and largest value
    most: FloatArray  # (d,): smallest and largest value

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


def profile_of(events: Events) -> Profile:
    """Counts, means, spreads and ranges of all rows."""
    parts = events.map_blocks(Profile.of_block)
    if not parts:
        raise InputError("X: no rows; allowed: at least one event")
    profile = functools.reduce(operator.add, parts)
    if profile.events == 0.0:
        raise InputError(f"X: the weights of all {profile.rows} rows are zero; allowed: at least one event")
    return profile


def usable_cores() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not Linux
        return os.cpu_count() or 1
