"""How rare is an event: exact intervals of its probability, and whether one design has it more often than another."""

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import TAIL

LEVEL = 0.95


def exact_interval(count: int, n: int) -> tuple[float, float]:
    """Interval of a probability after Clopper and Pearson, 95 %, from `count` events in `n` independent trials.

    It covers the true probability in 95 % of the cases at least. Without any event it ends near 3.7/n; of no trials it
    is 0 to 1.

    Examples
    --------
    >>> low, high = exact_interval(0, 100)
    >>> low, round(high, 4)
    (0.0, 0.0362)
    """
    from scipy.stats import beta

    outside = (1.0 - LEVEL) / 2.0
    low = float(beta.ppf(outside, count, n - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(1.0 - outside, count + 1, n - count)) if count < n else 1.0
    return low, high


def paired_sign(b: int, c: int) -> int:
    """1 where a design has an event more often than its reference on the same trials, -1 where less often, else 0.

    Of b trials only the design has the event, of c only the reference. McNemar's exact test, two-sided at 5 %: where
    both are alike, each of these trials is as likely one of the b as one of the c.
    """
    from scipy.stats import binomtest

    if b == c or binomtest(b, b + c).pvalue > 1.0 - LEVEL:
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
