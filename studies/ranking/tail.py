"""How rare is an event: exact intervals of its probability, and whether one design has it more often than another."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import TAIL

LEVEL = 0.95


def exact_interval(count: int, n: int, level: float = LEVEL) -> tuple[float, float]:
    """Interval of a probability after Clopper and Pearson, from `count` events in `n` independent trials.

    It covers the true probability at least as often as `level` says, however rare the event is: without any event it
    ends near 3.7/n at 95 %.

    Raises `InputError` for counts that no trials can give.

    Parameters
    ----------
    count : int
        Trials with the event.
    n : int
        All trials; without any, nothing is known: 0 to 1.
    level : float
        Confidence level.

    Returns
    -------
    low, high : float

    Examples
    --------
    >>> low, high = exact_interval(0, 100)
    >>> low, round(high, 4)
    (0.0, 0.0362)
    """
    from scipy.stats import beta

    if not 0 <= count <= n or not 0.0 < level < 1.0:
        raise InputError(f"interval: {count} of {n} at {level:g}; allowed: 0 <= count <= n, a level between 0 and 1")
    outside = (1.0 - level) / 2.0
    low = float(beta.ppf(outside, count, n - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(1.0 - outside, count + 1, n - count)) if count < n else 1.0
    return low, high


def paired_sign(b: int, c: int, level: float = LEVEL) -> int:
    """Whether an event is more frequent with a design than with its reference, on the same trials.

    An exact two-sided test (McNemar's): where both are alike, a trial in which only one of them has the event is as
    likely that of the design as that of the reference.

    Raises `InputError` for negative counts.

    Parameters
    ----------
    b, c : int
        Trials in which only the design, and only the reference has the event.
    level : float
        Confidence level.

    Returns
    -------
    int
        1 where the design has it more often, -1 where less often, 0 where the trials do not tell.

    Examples
    --------
    >>> paired_sign(9, 1), paired_sign(4, 2), paired_sign(0, 20)
    (1, 0, -1)
    """
    from scipy.stats import binomtest

    if b < 0 or c < 0 or not 0.0 < level < 1.0:
        raise InputError(f"pairs: {b} and {c} at {level:g}; allowed: counts >= 0, a level between 0 and 1")
    if b == c or binomtest(b, b + c).pvalue > 1.0 - level:
        return 0
    return 1 if b > c else -1


def tail_text(deepest: FloatArray, uncorrected: FloatArray) -> str:
    """Whether a design is worse than no control in the tail, from depths (n,) [m] of both on the same departures.

    Empty where that is not significant.
    """
    own, without = deepest > TAIL, uncorrected > TAIL
    if paired_sign(int(np.sum(own & ~without)), int(np.sum(without & ~own))) <= 0:
        return ""
    return (
        f"worse than no control beyond {TAIL:g} m: {own.sum():,} of {own.size:,} departures get so deep, without "
        f"control {without.sum():,}"
    )
