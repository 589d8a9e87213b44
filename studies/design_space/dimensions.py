"""One dimension of a design space: a list of values, or a range that holds every value between its ends."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

from ldctoolkit.gains import GainValue


@dataclasses.dataclass(frozen=True)
class Choices:
    """A list of values, one or more.

    Attributes
    ----------
    values : tuple of float, int, str or bool
        Different values, in the order written.

    Examples
    --------
    >>> Choices(("osqp", "daqp")).at(0.7)
    'daqp'
    """

    values: tuple[GainValue, ...]

    @property
    def size(self) -> int:
        """Number of different values."""
        return len(self.values)

    def at(self, share: float) -> GainValue:
        """The value at a share of the list, every value over an equal part.

        Parameters
        ----------
        share : float
            From 0 to 1.
        """
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


@dataclasses.dataclass(frozen=True)
class Span:
    """Every number between two ends, or every whole one; both ends belong to it.

    Attributes
    ----------
    first, last : float
        The ends as written, in either order, different.
    scale : {"linear", "log"}
        What is even: the numbers, or their logarithms (then both ends have one sign).
    whole : bool
        Whole numbers only; the ends are whole.

    Examples
    --------
    >>> Span(0.01, 1.0, "log").at(0.5)
    0.1
    >>> [Span(1, 3, "linear", whole=True).at(share) for share in (0.0, 0.5, 1.0)]
    [1, 2, 3]
    """

    first: float
    last: float
    scale: Literal["linear", "log"] = "linear"
    whole: bool = False

    @property
    def low(self) -> float:
        """The smaller end."""
        return min(self.first, self.last)

    @property
    def high(self) -> float:
        """The larger end."""
        return max(self.first, self.last)

    @property
    def size(self) -> int | None:
        """Number of different values; None where there is no end to them."""
        return int(self.high - self.low) + 1 if self.whole else None

    def at(self, share: float) -> GainValue:
        """The value at a share of the way from the first end to the last.

        Parameters
        ----------
        share : float
            From 0 to 1.
        """
        a, b = float(self.first), float(self.last)
        if self.whole:
            # half a number beyond each end: the ends get as much room as the others
            low, high = (a - 0.5, b + 0.5) if a < b else (a + 0.5, b - 0.5)
            return int(min(max(round(_between(low, high, share, self.scale)), self.low), self.high))
        return min(max(rounded(_between(a, b, share, self.scale)), self.low), self.high)


Dimension = Choices | Span


def rounded(value: float) -> float:
    """A number with twelve significant digits: 0.3 and not 0.30000000000000004 in names and identities.

    Examples
    --------
    >>> rounded(0.1 + 0.2)
    0.3
    """
    return float(f"{value:.12g}") + 0.0


def _between(a: float, b: float, share: float, scale: Literal["linear", "log"]) -> float:
    if scale == "linear":
        return a * (1 - share) + b * share
    logarithm = math.log(abs(a)) * (1 - share) + math.log(abs(b)) * share
    return math.copysign(math.exp(logarithm), a)
