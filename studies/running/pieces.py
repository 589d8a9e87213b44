"""How the scenarios of a study are cut: nested prefixes of both sides, and batches that are driven as one.

A batch's extent follows from the study and the law alone. So no number can depend on how the work is split between
processes, not even in the last bit of a law whose sums depend on how many scenarios stand beside each other.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import IntArray
from ldctoolkit.errors import InputError

FIRST_ROUND: Final = 100
"""Scenarios of the first round: with fewer, tails as far out as many designs need are guesswork."""

_WORTH_A_ROUND = 1.5
"""A round is held where it leaves out a third of all scenarios or more; a later one would save little."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Scenarios that are driven as one batch."""

    number: int  # its place among the pieces of its batch size
    rows: IntArray  # (m,): row numbers of the scenarios, rising


@dataclasses.dataclass(frozen=True, eq=False)
class Prefixes:
    """Nested prefixes of a study's scenarios, each side in proportion."""

    side: IntArray  # (n,): of all scenarios
    stops: tuple[int, ...]  # sizes of the prefixes, rising; the last is n

    def rows(self, size: int) -> IntArray:
        """Row numbers of the first `size` scenarios, rising: about the same share of each side."""
        return prefix_rows(self.side, size)

    def pieces(self, batch: int) -> tuple[Piece, ...]:
        """All scenarios in pieces of at most `batch`, none across the end of a prefix."""
        found: list[Piece] = []
        for first, last in zip((0, *self.stops), self.stops, strict=False):
            before = self.rows(first) if first else np.zeros(0, dtype=np.int64)
            new = np.setdiff1d(self.rows(last), before, assume_unique=True)
            count = -(-new.size // batch)
            # even shares of both sides would change no number; stretches are simpler to name
            found += [Piece(len(found) + i, rows) for i, rows in enumerate(np.array_split(new, count))]
        return tuple(found)


def schedule(n: int) -> tuple[int, ...]:
    """Number of scenarios after each round of a race over n: 100, then twice as many every time, and all at the end."""
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise InputError(f"n: {n!r}; allowed: a whole number >= 1")
    sizes, size = [], FIRST_ROUND
    while size * _WORTH_A_ROUND <= n:
        sizes.append(size)
        size *= 2
    return (*sizes, int(n))


def prefix_rows(side: IntArray, m: int) -> IntArray:
    """The scenarios of a round: the first ones of each side, as many as is its share."""
    side = np.asarray(side)
    if not 1 <= m <= side.size:
        raise InputError(f"m: {m!r}; allowed: 1 to {side.size}, the number of scenarios")
    which, counts = np.unique(side, return_counts=True)
    # cumulative shares, rounded: each count rises with m, and together they make m
    ends = np.floor(np.cumsum(counts) * m / side.size + 0.5).astype(np.int64)
    taken = np.diff(ends, prepend=0)
    rows = [np.flatnonzero(side == one)[:count] for one, count in zip(which, taken, strict=True)]
    return np.sort(np.concatenate(rows))
