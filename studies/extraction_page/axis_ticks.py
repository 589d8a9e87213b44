"""Round numbers along an axis, and ranges that are never empty."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.report.words.text import figure, number

_LARGEST_PLAIN = 1e5


@dataclasses.dataclass(frozen=True)
class Axis:
    """Range of an axis.

    Attributes
    ----------
    low, high : float
        Finite, low < high.
    """

    low: float
    high: float

    @classmethod
    def around(cls, values: FloatArray, *, least: float, margin: float = 0.05) -> Axis:
        """All finite values with a margin; at least `least` wide, also for none.

        Parameters
        ----------
        values : (n,)
        least : float
            So that noise does not fill the height.
        margin : float
            Share of the width on either side.

        Examples
        --------
        >>> Axis.around(np.array([2.0, 2.0]), least=1.0, margin=0.0)
        Axis(low=1.5, high=2.5)
        """
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        width = max(high - low, least, 1e-9 * max(abs(low), abs(high)))
        middle, half = 0.5 * (low + high), (0.5 + margin) * width
        return cls(middle - half, middle + half)

    def ticks(self, most: int) -> tuple[float, ...]:
        """At most `most` + 1 round numbers inside, evenly spaced.

        Examples
        --------
        >>> Axis(0.5, 10.0).ticks(4)
        (5.0, 10.0)
        """
        step = self.step(most)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return tuple(k * step for k in range(first, min(last, first + most) + 1))

    def label(self, tick: float, most: int) -> str:
        """A tick as text, with the decimals that its step needs.

        Examples
        --------
        >>> Axis(0.0, 0.4).label(0.1, 5)
        '0.1'
        """
        if max(abs(self.low), abs(self.high)) >= _LARGEST_PLAIN:
            return figure(tick)
        return number(tick, max(0, -math.floor(math.log10(self.step(most)) + 1e-9)))

    def step(self, most: int) -> float:
        """The round number 1, 2 or 5 times a power of ten that is passed at most `most` times.

        Examples
        --------
        >>> Axis(0.0, 0.9).step(4)
        0.5
        """
        least = (self.high - self.low) / most
        base = 10.0 ** math.floor(math.log10(least))
        return next(k * base for k in (1, 2, 5, 10, 20) if k * base >= least * (1.0 - 1e-9))
