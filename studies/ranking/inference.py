"""What a sample of scenarios allows to say of the designs of a ranking, all of them together."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from studies.ranking.resampled import Resampled, simultaneous_interval
from studies.ranking.simultaneous import compare_with_best

_BLOCK_ENTRIES = 500_000
"""Resampled means looked at at once (4 MB)."""


@dataclasses.dataclass(frozen=True)
class Inference:
    """Simultaneous intervals of d designs, arrays of d: each family holds for all its designs at once.

    Attributes
    ----------
    S_low, S_high : (d,) [m s]
        Interval of the mean S.
    difference, difference_low, difference_high : (d,) [m s]
        Mean S minus that of the best design, paired on the scenarios, and its interval, which holds whichever design
        came out best.
    baseline_difference, baseline_difference_low, baseline_difference_high : (d,) [m s]
        The same to the baseline; NaN without one.
    set_of_best : (d,) bool
        The truly best of the ranked designs is in this set with the confidence at least. A design within 1e-6 m s of
        the best, the accuracy of an iterative solver, always is.
    best_frequency : (d,)
        Share of resamples in which the design has the smallest mean of the ranked ones; equal ones share it. It is not
        the probability that the design is the best.
    references, may_be_best : int
        Designs that the critical values of the comparisons with the best were worked out for, and those that they stand
        for; fewer references make intervals too short.
    """

    S_low: FloatArray
    S_high: FloatArray
    difference: FloatArray
    difference_low: FloatArray
    difference_high: FloatArray
    baseline_difference: FloatArray
    baseline_difference_low: FloatArray
    baseline_difference_high: FloatArray
    set_of_best: BoolArray
    best_frequency: FloatArray
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
    """Compare designs.

    Parameters
    ----------
    scores : (d, n) [m s]
    side : (n,) int
        Stratum of each scenario.
    ranked : int
        So many first designs are ranked; of 0 the comparisons are with the smallest mean, and the set is empty.
    baseline : int, optional
    seed : int
    samples : int
        Resamples.
    confidence : float
        Between 0 and 1.
    rows : (d,) int, optional
        Where the designs stand in `scores`, best mean first among the ranked ones; in this order by default.

    Raises
    ------
    InputError
        For settings outside what is allowed.
    """
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
