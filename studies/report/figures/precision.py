"""How wide an interval is with fewer scenarios, and how many would be needed to tell two designs apart."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.ranking.standard_error import error_parts, lengths
from studies.report.figures.scores import interleaved

SIZES: Final = tuple(m * 10**k for k in range(1, 8) for m in (1, 2, 5))[1:]
"""Numbers of scenarios that are looked at: 20, 50, 100, ..."""

_MOST_PARTS = 40

NINE_IN_TEN: Final = 1.2816
"""90 % quantile of the standard normal distribution."""


def measured_errors(values: FloatArray, side: IntArray) -> tuple[IntArray, FloatArray]:
    """Standard error of the mean with fewer scenarios, from parts of those that there are.

    Parameters
    ----------
    values : (n,)
        Scores or paired differences.
    side : (n,) int

    Returns
    -------
    count : (k,) int
        20, 50, 100, ... below n, and n.
    error : (k,)
        Root mean square over up to 40 parts without a common scenario, left and right in their overall proportion. Not
        for sizes that leave a side with fewer than two scenarios.
    """
    order, n = interleaved(side), values.size
    found: list[tuple[int, float]] = []
    for size in (*(size for size in SIZES if size < n), n):
        parts = [order[k * size : (k + 1) * size] for k in range(min(n // size, _MOST_PARTS))]
        if all((np.unique(side[part], return_counts=True)[1] > 1).all() for part in parts):
            squares = [float(lengths(error_parts(values[None, part], side[part]))[0]) ** 2 for part in parts]
            found.append((size, math.sqrt(float(np.mean(squares)))))
    return np.array([size for size, _ in found], dtype=np.int64), np.array([error for _, error in found])


@dataclasses.dataclass(frozen=True)
class Needed:
    """Numbers of scenarios at which the interval of a difference is expected to leave zero out.

    Attributes
    ----------
    even : float
        With even chances: the half width equals the difference.
    likely : float
        In nine of ten repetitions.
    """

    even: float
    likely: float


def needed_scenarios(n: int, difference: float, half_width: float, error: float) -> Needed:
    """By the law that half widths fall with the square root of the number of scenarios.

    Parameters
    ----------
    n : int
        Scenarios that there are.
    difference : float
        Between two designs, taken as the true one.
    half_width, error : float
        Of its interval, and its standard error, with n scenarios.

    Returns
    -------
    Needed
        Infinite for a difference of 0 or an interval without end.

    Examples
    --------
    >>> needed_scenarios(100, 0.5, 1.0, 0.5)
    Needed(even=400.0, likely=1076.889856)
    """
    if difference == 0.0 or not math.isfinite(half_width):
        return Needed(math.inf, math.inf)
    even = n * (half_width / difference) ** 2
    return Needed(even, n * ((half_width + NINE_IN_TEN * error) / difference) ** 2)


def two_digits(count: float) -> int:
    """A number of scenarios as exact as it can be meant, rounded up.

    Examples
    --------
    >>> two_digits(1234.0), two_digits(7.2)
    (1300, 8)
    """
    step = int(10 ** max(0, math.floor(math.log10(max(count, 1.0))) - 1))
    return math.ceil(count / step) * step
