"""Comparisons with the best design that are valid although the data choose which design that is."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from studies.ranking.bootstrap import check_confidence
from studies.ranking.resampled import Resampled, critical_value, simultaneous_interval
from studies.ranking.standard_error import half_widths, skewed_widths

_BLOCK_ENTRIES = 500_000
"""Resampled means looked at at once (4 MB)."""


@dataclasses.dataclass(frozen=True)
class Inference:
    """Simultaneous intervals of d designs, arrays of d: each family holds for all its designs at once."""

    # (d,) [m s] Interval of the mean S
    S_low: FloatArray
    S_high: FloatArray
    # (d,) [m s] Mean S minus that of the best design, paired on the scenarios, and its interval, which holds whichever
    # design came out best
    difference: FloatArray
    difference_low: FloatArray
    difference_high: FloatArray
    # (d,) [m s] The same to the baseline; NaN without one
    baseline_difference: FloatArray
    baseline_difference_low: FloatArray
    baseline_difference_high: FloatArray
    # (d,) The truly best of the ranked designs is in this set with the confidence at least. A design within 1e-6 m s of
    # the best, the accuracy of an iterative solver, always is
    set_of_best: BoolArray
    # (d,) Share of resamples in which the design has the smallest mean of the ranked ones; equal ones share it. It is
    # not the probability that the design is the best
    best_frequency: FloatArray
    # Designs that the critical values of the comparisons with the best were worked out for, and those that they stand
    # for; fewer references make intervals too short
    references: int
    may_be_best: int


def infer(
    scores: FloatArray,
    side: IntArray,
    *,
    ranked: int,
    baseline: int | None,
    seed: int,
    samples: int,
    confidence: float,
    rows: IntArray | None = None,
) -> Inference:
    """Compare designs."""
    resampled = Resampled.of(scores, side, seed=seed, samples=samples, rows=rows)
    d = resampled.mean.size
    contenders = ranked or d
    means = simultaneous_interval(resampled, confidence)
    best = compare_with_best(resampled, confidence, contenders)
    among = np.arange(d) < ranked
    nothing = np.full(d, np.nan)
    to_baseline = None if baseline is None else simultaneous_interval(resampled, confidence, baseline)
    return Inference(
        S_low=means.low,
        S_high=means.high,
        difference=best.difference,
        difference_low=best.low_of_all,
        difference_high=best.high_of_all,
        baseline_difference=nothing if to_baseline is None else to_baseline.centre,
        baseline_difference_low=nothing if to_baseline is None else to_baseline.low,
        baseline_difference_high=nothing if to_baseline is None else to_baseline.high,
        set_of_best=~best.clear & among,
        best_frequency=np.where(among, best_frequency(resampled, contenders), 0.0),
        references=best.references,
        may_be_best=best.may_be_best,
    )


def best_frequency(resampled: Resampled, contenders: int) -> FloatArray:
    """Share of resamples in which each design has the smallest mean of the first `contenders`, (d,)."""
    mean, deviations = resampled.mean[:contenders], resampled.deviations[:, :contenders]
    frequency = np.zeros(resampled.mean.size)
    size = max(1, _BLOCK_ENTRIES // contenders)
    for first in range(0, len(deviations), size):
        block = deviations[first : first + size] + mean
        smallest = block == block.min(axis=1, keepdims=True)
        # whole numbers of resamples by the number of equals: thirds are no sum of rounded thirds
        equals = smallest.sum(axis=1)
        for number in np.unique(equals).tolist():
            frequency[:contenders] += smallest[equals == number].sum(axis=0) / number
    return frequency / len(deviations)


SAME = 1e-6
"""Differences of mean S [m s] up to this are a solver's tolerance, not design."""

_MOST_TERMS = 300_000_000
"""Resampled differences that are looked at: references x designs x resamples."""

_MOST_SCORES = 100_000_000
"""Paired scores that are looked at: references x designs x scenarios."""


@dataclasses.dataclass(frozen=True)
class Separation:
    """How far k designs are from the best of them."""

    mean: FloatArray  # (k,) [m s] Mean score
    best: int  # The design with the smallest one; the first of equal ones
    difference: FloatArray  # (k,) [m s] Mean minus that of `best`
    error: FloatArray  # (k,) [m s] Standard error of the difference
    # (k,) [m s] Lower bound of how much a design is worse than the truly best one, by multiple comparisons with the
    # best: the truly best design has a bound above 0 with a probability of at most 1 - confidence, however many designs
    # there are
    low: FloatArray
    # (k,) [m s] Interval of the difference to the design `best`; all k hold at once, whichever design came out best
    low_of_all: FloatArray
    high_of_all: FloatArray
    # Standard errors behind `low`, and behind the interval where scores have no skewness
    critical: float
    critical_of_all: float
    # Designs that critical values were worked out for, and those that they stand for
    references: int
    may_be_best: int

    @property
    def clear(self) -> BoolArray:
        """Designs that are worse than the best by more than a solver's tolerance, (k,): all but the set of best."""
        result: BoolArray = self.low > SAME
        return result


def separable(
    scores: FloatArray, side: IntArray, *, seed: int, confidence: float, samples: int, stream: int = 0
) -> Separation:
    """Compare k designs with the best of them on common scenarios.

    Design r is tested against all others as if it were the best, and is `clear` when some design beats it by more
    than c_r standard errors of their paired difference; c_r is the quantile of the largest studentised difference
    to r (Hsu 1984). Only the test of the truly best design can do harm, so the choice of r costs nothing. One
    critical value serves all: the largest c_r of the designs that may be best. Where these are very many, c_r is
    worked out for some of them, evenly over the ranks. Differences count in both directions, though only one is
    tested: scores are skewed, and resampled means are skewed the other way than studentised ones. The interval of
    the difference to the design that came out best needs more: its critical value is the quantile of the largest
    difference over all these r at once. Of skewed scores it is wider, see
    `studies.ranking.standard_error.skewed_widths`; `low` is not, for the test of one design is conservative.
    """
    return compare_with_best(Resampled.of(scores, side, seed=seed, samples=samples, stream=stream), confidence)


def compare_with_best(resampled: Resampled, confidence: float, contenders: int | None = None) -> Separation:
    """As `separable`, of scores that are resampled already."""
    check_confidence(confidence)
    k = resampled.mean.size if contenders is None else contenders
    best = int(np.argmin(resampled.mean[:k]))
    difference, error = resampled.differences(best), resampled.errors(best)
    may = _may_be_best(difference[:k], error[:k], resampled.df, confidence)
    wanted = may.size
    most = max(
        2, min(_MOST_TERMS // resampled.deviations.size, _MOST_SCORES // (resampled.mean.size * resampled.side.size))
    )
    if may.size > most:
        may = may[np.unique(np.linspace(0, may.size - 1, most).astype(np.int64))]

    critical, of_every = 0.0, np.zeros(resampled.deviations.shape[0])
    errors = np.empty((may.size, error.size))
    for r, row in zip(may.tolist(), errors, strict=True):
        row[:] = resampled.errors(r)
        # for r to be the best it is held against the other contenders, for its intervals against all designs
        contending, largest = resampled.extremes(row, r, k)
        critical = max(critical, critical_value(contending, confidence, resampled.df))
        np.maximum(of_every, largest, out=of_every)
    of_all = critical_value(of_every, confidence, resampled.df)
    low = np.full(error.size, -np.inf)
    for r, row in zip(may.tolist(), errors, strict=True):
        others = np.arange(error.size) != r
        np.maximum(low, resampled.mean - resampled.mean[r] - half_widths(critical, row), out=low, where=others)
    below, above = skewed_widths(of_all, error, resampled.cubes(best))
    low = np.where(error == 0, difference, low)  # the best itself among them: exactly 0
    return Separation(
        mean=resampled.mean,
        best=best,
        difference=difference,
        error=error,
        low=low,
        low_of_all=difference - below,
        high_of_all=difference + above,
        critical=critical,
        critical_of_all=of_all,
        references=int(may.size),
        may_be_best=int(wanted),
    )


def _may_be_best(difference: FloatArray, error: FloatArray, df: int, confidence: float) -> IntArray:
    """Designs that even Bonferroni's bound does not part from the best, by rank; the best is the first."""
    from scipy.special import stdtrit

    bound = float(-stdtrit(df, (1.0 - confidence) / (2 * max(1, difference.size - 1))))
    order = np.argsort(difference, kind="stable")
    result: IntArray = order[difference[order] <= bound * error[order] + SAME].astype(np.int64)
    return result
