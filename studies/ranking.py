"""The ranking of a study: designs by mean S, with paired differences to the best and bootstrap intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError
from studies.bootstrap import bootstrap_means, percentile_interval
from studies.design import Design
from studies.failed_commands import warnings_of
from studies.release import ReleaseFigures
from studies.results import Case, CaseResults, FailedDesign, StudyResults
from studies.spec import Study

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


_SAME = 1e-6
"""Differences of mean S [m s] below this are solver tolerance, not design."""


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking:
    """Designs of one case, best first; every array has one entry a design in that order.

    Failed and diverged scenarios count in every mean with the S that they got. Scenarios that cannot be driven under
    some design have no S: they are left out for all designs, counted in `invalid`, and a warning says so.

    Attributes
    ----------
    case : Case
        Window and convention.
    designs : tuple of Design
        d designs, smallest mean S first; equal ones in the study's order.
    index : (d,) int
        Position of each in `StudyResults.designs`.
    rank : (d,) int
        1 for the best; designs with the same mean S share a rank.
    S, S_left, S_right : (d,) [m s]
        Mean over all scenarios and over those of a side; NaN for a side without scenarios.
    S_low, S_high : (d,) [m s]
        Bootstrap interval of the mean S.
    S_uncorrected : (d,) [m s]
        Mean without control, over the same window.
    reduction, reduction_left, reduction_right : (d,)
        1 - mean S / mean S_uncorrected.
    difference, difference_low, difference_high : (d,) [m s]
        Mean S minus that of the best, paired on the scenarios, and its bootstrap interval.
    tied_with_best : (d,) bool
        The interval of the difference comes within 1e-6 m s of 0, the accuracy of an iterative solver.
    triggered : (d,)
        Share of scenarios in which the design took over.
    deeper : (d,)
        Share of scenarios deeper than D_y.
    solver_failed, diverged, timed_out, invalid : (d,) int
        Scenarios with that status.
    failed_solves : (d,) int
        Commands that were not finite, or came from a fallback.
    release : ReleaseFigures
        What is reported beside S.
    D_y : float [m]
    bootstrap : int
        Resamples.
    confidence : float
        Of the intervals.
    warnings : tuple of str
        What a reader must know before comparing designs.
    failed : tuple of FailedDesign
        Designs whose law failed: they have no rank and no figures.
    """

    case: Case
    designs: tuple[Design, ...]
    index: IntArray
    rank: IntArray
    S: FloatArray
    S_left: FloatArray
    S_right: FloatArray
    S_low: FloatArray
    S_high: FloatArray
    S_uncorrected: FloatArray
    reduction: FloatArray
    reduction_left: FloatArray
    reduction_right: FloatArray
    difference: FloatArray
    difference_low: FloatArray
    difference_high: FloatArray
    tied_with_best: BoolArray
    triggered: FloatArray
    deeper: FloatArray
    solver_failed: IntArray
    diverged: IntArray
    timed_out: IntArray
    invalid: IntArray
    failed_solves: IntArray
    release: ReleaseFigures
    D_y: float
    bootstrap: int
    confidence: float
    warnings: tuple[str, ...]
    failed: tuple[FailedDesign, ...] = ()

    def __len__(self) -> int:
        return len(self.designs)

    def __repr__(self) -> str:
        best = f"best {self.designs[0].label!r}, mean S {self.S[0]:.4g} m s"
        return f"<Ranking of {len(self)} designs, {self.case.label}: {best}>"

    @classmethod
    def of(
        cls,
        results: StudyResults,
        case: CaseResults,
        *,
        seed: int = 0,
        bootstrap: int = 2000,
        confidence: float = 0.95,
        D_y: float = 0.5,
    ) -> Ranking:
        """Rank the designs of one case.

        Parameters
        ----------
        results : StudyResults
            Designs and scenarios.
        case : CaseResults
            One of its cases.
        seed : int
            Of the bootstrap.
        bootstrap : int
            Resamples, drawn within each side; all designs see the same ones.
        confidence : float
            Of the percentile intervals, between 0 and 1.
        D_y : float [m]
            Depth that counts as deep.

        Returns
        -------
        Ranking

        Raises
        ------
        InputError
            For settings outside what is allowed, or scores that are not finite.
        """
        every, drivable, scenarios = case.status, case.drivable, results.scenarios
        if not drivable.any():
            raise InputError("results: no scenario could be driven under every design; there is nothing to rank")
        if not drivable.all():
            case, scenarios = case.take(drivable), scenarios.take(np.flatnonzero(drivable))
        if not np.isfinite(case.S).all():
            raise InputError("results: S is not finite in some scenario; a mean would drop or hide it")
        left, right = (scenarios.side == side for side in (LEFT, RIGHT))
        S = _mean(case.S, left | right)
        order = np.argsort(S, kind="stable")
        sorted_S = S[order]
        means = bootstrap_means(case.S[order], scenarios.side, samples=bootstrap, seed=seed)
        S_low, S_high = percentile_interval(means, confidence)
        best = case.S[order[0]]
        difference = np.array([(case.S[i] - best).mean() for i in order])
        means -= means[:, :1].copy()
        difference_low, difference_high = percentile_interval(means, confidence)
        # exact for a design whose scores equal the best's: rounding of the product must not untie it
        same = difference == 0.0
        difference_low[same] = np.minimum(difference_low[same], 0.0)

        def share(values: BoolArray) -> FloatArray:
            result: FloatArray = values.mean(axis=1)[order]
            return result

        def count(status: EventStatus) -> IntArray:
            result: IntArray = (every == status).sum(axis=1)[order].astype(np.int64)
            return result

        return cls(
            case=case.case,
            designs=tuple(results.designs[i] for i in order),
            index=order.astype(np.int64),
            rank=np.searchsorted(sorted_S, sorted_S, side="left").astype(np.int64) + 1,
            S=sorted_S,
            S_left=_mean(case.S, left)[order],
            S_right=_mean(case.S, right)[order],
            S_low=S_low,
            S_high=S_high,
            S_uncorrected=_mean(case.S_uncorrected, left | right)[order],
            reduction=_reduction(case, left | right)[order],
            reduction_left=_reduction(case, left)[order],
            reduction_right=_reduction(case, right)[order],
            difference=difference,
            difference_low=difference_low,
            difference_high=difference_high,
            tied_with_best=(difference_low <= _SAME) & (difference_high >= -_SAME),
            triggered=share(case.status != EventStatus.NEVER_TRIGGERED),
            deeper=share(case.companions.deepest > D_y),
            solver_failed=count(EventStatus.SOLVER_FAILED),
            diverged=count(EventStatus.DIVERGED),
            timed_out=count(EventStatus.TIMED_OUT),
            invalid=count(EventStatus.INVALID),
            failed_solves=case.failed_solves.sum(axis=1)[order].astype(np.int64),
            release=ReleaseFigures.of(case, results.designs, scenarios.d_y, order=order.tolist(), D_y=D_y),
            D_y=D_y,
            bootstrap=bootstrap,
            confidence=confidence,
            warnings=tuple(_warnings(case, results.designs, int((~drivable).sum()))),
            failed=results.failed,
        )

    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of every law, best law first."""
        first: dict[str, int] = {}
        for i, design in enumerate(self.designs):
            first.setdefault(design.law, i)
        return tuple(first.values())


def rank_study(results: StudyResults, study: Study) -> tuple[Ranking, ...]:
    """Rank every case of a study with the study's own settings.

    Parameters
    ----------
    results : StudyResults
    study : Study

    Returns
    -------
    tuple of Ranking
        In the order of the cases; the first is the primary one.
    """
    return tuple(
        Ranking.of(
            results,
            case,
            seed=study.seed,
            bootstrap=study.ranking.bootstrap,
            confidence=study.ranking.confidence,
            D_y=study.report.D_y,
        )
        for case in results.cases
    )


def _mean(values: FloatArray, rows: BoolArray) -> FloatArray:
    if not rows.any():
        return np.full(values.shape[0], np.nan)
    # design by design: no copy of everything, and a sum that does not depend on how many designs stand beside it
    return np.array([row[rows].mean() for row in values])


def _reduction(case: CaseResults, rows: BoolArray) -> FloatArray:
    S, before = _mean(case.S, rows), _mean(case.S_uncorrected, rows)
    out = np.where(np.isnan(before), np.nan, 0.0)  # nothing to reduce
    return 1.0 - np.divide(S, before, out=1.0 - out, where=before > 0)


def _warnings(case: CaseResults, designs: Sequence[Design], left_out: int) -> Iterator[str]:
    if left_out:
        yield (
            f"{left_out} of {left_out + case.status.shape[1]} scenarios cannot be driven (a parameter is not finite "
            "or has the wrong sign, or the speed leaves 1 to 90 m/s); no figure of any design counts them."
        )
    if case.case.window == "control" and len({design.y_s for design in designs}) > 1:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Designs with different y_s are not comparable here; use the departure window."
        )
    yield from warnings_of(case, designs)
