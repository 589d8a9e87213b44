"""Exact intervals of probabilities and quantiles, and whether one design has an event more often than another."""

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
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
    low, high = binomial_interval(count, n, LEVEL)
    return float(low), float(high)


def binomial_interval(count: npt.ArrayLike, n: npt.ArrayLike, level: float) -> tuple[FloatArray, FloatArray]:
    """The same for arrays, whose numbers need not be whole: of weighted events, n is their effective number."""
    from scipy.special import betaincinv

    events, trials, outside = np.asarray(count), np.asarray(n), (1.0 - level) / 2.0
    rest = np.maximum(trials - events, 0.0)
    low = betaincinv(np.maximum(events, 1e-300), rest + 1.0, outside)
    high = betaincinv(events + 1.0, np.maximum(rest, 1e-300), 1.0 - outside)
    return np.where(events > 0, low, 0.0), np.where(rest > 0, high, 1.0)


def order_statistics(n: npt.ArrayLike, share: float, level: float) -> tuple[IntArray, IntArray]:
    """Places, from 1 on, of the ordered values that a quantile of what n independent ones come from lies between.

    Whatever the distribution is, it does so with the probability `level` at least (David and Nagaraja, *Order
    Statistics*, 2003, 7.1). Place 0 or n + 1: there is no such value.
    """
    from scipy.stats import binom

    outside = (1.0 - level) / 2.0
    low, high = (np.asarray(binom.ppf(end, n, share)).astype(np.int64) for end in (outside, 1.0 - outside))
    return low, high + 1


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
