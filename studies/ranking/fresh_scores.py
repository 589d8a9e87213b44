"""Finalists on fresh scenarios: what is left of a score once luck in the search is gone."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from studies.ranking.case_figures import DrivableCase
from studies.ranking.resampled import Resampled, simultaneous_interval
from studies.results import Case, StudyResults

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

_STREAM = 1
"""Of the resamples; the search has stream 0."""


@dataclasses.dataclass(frozen=True)
class FreshScores:
    """Mean S of the finalists on scenarios that no design was chosen on, arrays of d; NaN for designs that are none.

    Attributes
    ----------
    fresh_S : (d,) [m s]
        Mean S.
    fresh_low, fresh_high : (d,) [m s]
        Its interval, for all finalists at once.
    optimism : (d,) [m s]
        `fresh_S` minus S of the search: what choosing the best of many had made of luck (the winner's curse).
    fresh_scenarios : int
        How many; 0 for none.
    fresh_best : int or None
        Position of the finalist with the smallest `fresh_S`.
    winner : int or None
        Position of the design to take: of the finalists in the set of best the one with the smallest `fresh_S`; without
        fresh scenarios the first of the ranking. None where no design is ranked.
    """

    fresh_S: FloatArray
    fresh_low: FloatArray
    fresh_high: FloatArray
    optimism: FloatArray
    fresh_scenarios: int
    fresh_best: int | None
    winner: int | None


def no_fresh_scores(d: int, ranked: int) -> FreshScores:
    """No fresh scenarios were run."""
    nothing = np.full(d, np.nan)
    return FreshScores(nothing, nothing, nothing, nothing, 0, None, 0 if ranked else None)


def fresh_scores(
    drivable: DrivableCase,
    positions: IntArray,
    S: FloatArray,
    set_of_best: BoolArray,
    *,
    ranked: int,
    seed: int,
    samples: int,
    confidence: float,
) -> FreshScores:
    """Score the finalists.

    Parameters
    ----------
    drivable : DrivableCase
        Of the finalists on the fresh scenarios.
    positions : (f,) int
        Position of each finalist in the ranking.
    S : (d,) [m s]
        Of the search, by position.
    set_of_best : (d,) bool
    ranked : int
        So many first designs are ranked.
    seed, samples, confidence
        As for `studies.ranking.inference.infer`.
    """
    resampled = Resampled.of(drivable.counted, drivable.scenarios.side, seed=seed, samples=samples, stream=_STREAM)
    interval = simultaneous_interval(resampled, confidence)

    def spread(values: FloatArray) -> FloatArray:
        result = np.full(S.size, np.nan)
        result[positions] = values
        return result

    fresh_S = spread(resampled.mean)
    finalist = np.isfinite(fresh_S) & (np.arange(S.size) < ranked)
    in_set = finalist & set_of_best
    return FreshScores(
        fresh_S=fresh_S,
        fresh_low=spread(interval.low),
        fresh_high=spread(interval.high),
        optimism=fresh_S - S,
        fresh_scenarios=len(drivable.scenarios),
        fresh_best=_smallest(fresh_S, finalist),
        winner=_smallest(fresh_S, in_set) if in_set.any() else 0 if ranked else None,
    )


def _smallest(values: FloatArray, among: BoolArray) -> int | None:
    return int(np.argmin(np.where(among, values, np.inf))) if among.any() else None


def fresh_case(fresh: StudyResults, case: Case) -> DrivableCase:
    """A case of the finalists' results, on the fresh scenarios that can be driven."""
    return DrivableCase.of(next(one for one in fresh.cases if one.case == case), fresh.scenarios)
