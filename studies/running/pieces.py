"""How the scenarios of a study are cut: nested prefixes of both sides, and batches that are driven as one.

A batch's extent follows from the study and the law alone. So no number can depend on how the work is split between
processes, not even in the last bit of a law whose sums depend on how many scenarios stand beside each other.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from studies.racing.race_rounds import prefix_rows

IntArray = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Scenarios that are driven as one batch.

    Attributes
    ----------
    number : int
        Its place among the pieces of its batch size.
    rows : (m,) int
        Row numbers of the scenarios, rising.
    """

    number: int
    rows: IntArray


@dataclasses.dataclass(frozen=True, eq=False)
class Prefixes:
    """Nested prefixes of a study's scenarios, each side in proportion.

    Attributes
    ----------
    side : (n,) int
        Of all scenarios.
    stops : tuple of int
        Sizes of the prefixes, rising; the last is n.
    """

    side: IntArray
    stops: tuple[int, ...]

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
