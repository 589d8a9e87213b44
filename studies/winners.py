"""The winners of two studies against each other: has anything been found that beats what was best before?"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from studies.comparable import FinishedStudy
from studies.design import Design
from studies.paired_verdicts import PairedDifferences, Verdict, paired_differences
from studies.results import Case, CaseResults, StudyResults
from studies.shared_scenarios import SharedScenarios

FloatArray = npt.NDArray[np.float64]

_RIVALS: Final = 30
"""Designs of each study that could have won: all their pairs share the confidence."""

_MOST_ENTRIES: Final = 20_000_000
"""Differences of pairs held at once (160 MB); fewer rivals where there are more scenarios."""


@dataclasses.dataclass(frozen=True)
class Winners:
    """The new study's winner against the old study's.

    Attributes
    ----------
    old, new : Design
        The design with the smallest mean S over its own study's scenarios, on the fresh ones where the study has them.
    S_old, S_new : float [m s]
        Mean over the shared scenarios.
    difference, low, high : float [m s]
        S_new - S_old, and its interval, valid although both were chosen by their scores; NaN as in
        `PairedDifferences`.
    verdict : Verdict
    scenarios : int
        How many scenarios they were compared on.
    fresh : bool
        Whether these are fresh scenarios of both studies, on which no design was chosen.
    """

    old: Design
    new: Design
    S_old: float
    S_new: float
    difference: float
    low: float
    high: float
    verdict: Verdict
    scenarios: int
    fresh: bool

    @property
    def same_design(self) -> bool:
        """The same design won both."""
        return self.old.id == self.new.id


def compare_winners(
    before: FinishedStudy,
    after: FinishedStudy,
    case: Case,
    shared: SharedScenarios,
    fresh: SharedScenarios | None,
    *,
    bootstrap: int,
    confidence: float,
) -> Winners:
    """Compare the winners of two studies in one case.

    Parameters
    ----------
    before, after : FinishedStudy
    case : Case
        One that both have.
    shared : SharedScenarios
        Of the studies' own scenarios.
    fresh : SharedScenarios or None
        Of their fresh scenarios, if both have some.
    bootstrap : int
    confidence : float

    Returns
    -------
    Winners

    Notes
    -----
    Winners are chosen by their scores, so an interval for one pair that was fixed beforehand would be too narrow. The
    interval here holds for all pairs of a design that could have won the old study and one that could have won the new
    one: those that score best, up to 30 of each.
    """
    results = (before.results, after.results)
    # finalists are those of the primary case
    if any(one.cases[0].case != case for one in results):
        fresh = None
    if fresh is not None and before.results.fresh is not None and after.results.fresh is not None:
        results, shared = (before.results.fresh, after.results.fresh), fresh
    cases = [_find(one, case) for one in results]
    orders = [_best_first(one) for one in cases]
    rivals = max(1, min(_RIVALS, int((_MOST_ENTRIES / shared.n) ** 0.5)))
    scores_old, scores_new = (
        one.counted[order[:rivals]][:, rows]
        for one, order, rows in zip(cases, orders, (shared.old, shared.new), strict=True)
    )
    old, new = (one.designs[order[0]] for one, order in zip(results, orders, strict=True))
    pairs = _pairs(scores_old, scores_new, shared, seed=after.study.seed, bootstrap=bootstrap, confidence=confidence)
    return Winners(
        old=old,
        new=new,
        S_old=float(pairs.S_old[0]),
        S_new=float(pairs.S_new[0]),
        difference=float(pairs.difference[0]),
        low=float(pairs.low[0]),
        high=float(pairs.high[0]),
        verdict=pairs.verdict[0],
        scenarios=shared.n,
        fresh=fresh is not None,
    )


def _find(results: StudyResults, case: Case) -> CaseResults:
    return next(one for one in results.cases if one.case == case)


def _best_first(case: CaseResults) -> npt.NDArray[np.int64]:
    """Designs by mean S over all scenarios that could be driven."""
    counted, driven = case.counted, case.drivable
    means = np.array([row[driven].mean() for row in counted])
    return np.argsort(means, kind="stable").astype(np.int64)


def _pairs(
    old: FloatArray, new: FloatArray, shared: SharedScenarios, *, seed: int, bootstrap: int, confidence: float
) -> PairedDifferences:
    """All pairs, the one of the winners first."""
    return paired_differences(
        np.repeat(old, len(new), axis=0),
        np.tile(new, (len(old), 1)),
        shared.side,
        seed=seed,
        bootstrap=bootstrap,
        confidence=confidence,
    )
