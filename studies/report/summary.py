"""The numbers of the report: one row per design and case, and what follows from them."""

from __future__ import annotations

import dataclasses
import math
import statistics
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit import controller_class
from ldctoolkit.metrics import share_deeper
from studies.design import Design
from studies.report.landscape import swept_axes
from studies.report.text import compact, unit_text
from studies.results import Case, CaseResults, StudyResults

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

PAPER_LAW = "preview_proportional"
_PAPER_DESIGN = {"y_s": 0.2, "K_y": -0.005, "K_psi": -0.2, "T_lp": 2.0}
"""Table I of the paper."""


@dataclasses.dataclass(frozen=True)
class Interval:
    """An estimate and the interval around it."""

    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Side:
    """Scores on the departures to one side: mean S [m s] and its reduction against no control."""

    S: float
    reduction: float


@dataclasses.dataclass(frozen=True)
class Row:
    """One design in one case.

    Attributes
    ----------
    index : int
        Of the design in the study.
    rank : int
    design : Design
    title : str
        The law's name for people.
    gains : tuple of (name, value, unit)
        As text: what the study sweeps in this law, and what differs from its default.
    S : Interval [m s]
        Mean and its interval.
    reduction : Interval
        1 - mean S / mean S_uncorrected.
    left, right : Side or None
        None: the study has no such departures.
    difference : Interval [m s]
        Paired difference of mean S to the best design.
    tied : bool
        Not told apart from the best.
    triggered, deeper : float
        Share of departures that were taken over, and share deeper than D_y.
    solver_failed, diverged, timed_out, invalid : int
        Departures with that status.
    failed_solves : int
        Commands that came from a law's fallback.
    """

    index: int
    rank: int
    design: Design
    title: str
    gains: tuple[tuple[str, str, str], ...]
    S: Interval
    reduction: Interval
    left: Side | None
    right: Side | None
    difference: Interval
    tied: bool
    triggered: float
    deeper: float
    solver_failed: int
    diverged: int
    timed_out: int
    invalid: int
    failed_solves: int

    @property
    def failures(self) -> int:
        """Departures that did not run as designed."""
        return self.solver_failed + self.diverged + self.timed_out + self.invalid


@dataclasses.dataclass(frozen=True)
class CaseTable:
    """All designs of one case by rank.

    Attributes
    ----------
    case : Case
    rows : tuple of Row
    uncorrected : float [m s]
        Mean S without control, over the window of the best design.
    uncorrected_deeper : float
        Share of the departures deeper than D_y without control.
    D_y : float [m]
    confidence : float
        Of every interval.
    bootstrap : int
        Resamples behind the intervals of the ranking.
    warnings : tuple of str
        Of the ranking.
    """

    case: Case
    rows: tuple[Row, ...]
    uncorrected: float
    uncorrected_deeper: float
    D_y: float
    confidence: float
    bootstrap: int
    warnings: tuple[str, ...]

    @property
    def winner(self) -> Row:
        """Rank 1."""
        return self.rows[0]

    @property
    def tied(self) -> int:
        """How many other designs are not told apart from the best."""
        return sum(row.tied for row in self.rows[1:])

    def best_of(self, law: str) -> Row | None:
        """The best design of a law."""
        return next((row for row in self.rows if row.design.law == law), None)

    @property
    def best_of_each_law(self) -> tuple[Row, ...]:
        """By rank."""
        return tuple({row.design.law: row for row in reversed(self.rows)}[law] for law in
                     dict.fromkeys(row.design.law for row in self.rows))  # fmt: skip

    @property
    def paper_design(self) -> Row | None:
        """The design of the paper's Table I, if the study holds it."""
        for row in self.rows:
            values = {"y_s": row.design.y_s, **dict(row.design.gains)}
            if row.design.law == PAPER_LAW and all(values.get(k) == v for k, v in _PAPER_DESIGN.items()):
                return row
        return None

    @property
    def failed(self) -> tuple[Row, ...]:
        """Designs with anything to report, by rank."""
        return tuple(row for row in self.rows if row.failures or row.failed_solves)


def ratio_interval(S: FloatArray, S_0: FloatArray, side: IntArray, confidence: float = 0.95) -> Interval:
    """Reduction 1 - mean S / mean S_0 of paired scores, with its interval by linearisation.

    Parameters
    ----------
    S, S_0 : (n,) [m s]
    side : (n,) int
        The two sides are strata: how many departures go to each is part of the study, not chance.
    confidence : float
        Of the interval.

    Returns
    -------
    Interval
        Zero width where there was nothing to reduce.

    Notes
    -----
    The standard error of a ratio r of means is that of the mean of S - r S_0, divided by mean S_0 (Cochran, *Sampling
    Techniques*, 3rd ed., section 6.4).

    Examples
    --------
    >>> ratio_interval(np.array([1.0, 2.0]), np.array([2.0, 4.0]), np.array([1, 1]))
    Interval(value=0.5, low=0.5, high=0.5)
    """
    total = float(np.mean(S_0))
    if not total > 0:
        return Interval(0.0, 0.0, 0.0)
    ratio = float(np.mean(S)) / total
    z = statistics.NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    error = z * standard_error(S - ratio * S_0, side) / total
    return Interval(1.0 - ratio, 1.0 - ratio - error, 1.0 - ratio + error)


def standard_error(values: FloatArray, side: IntArray) -> float:
    """Standard error of the mean, stratified by side; a side with one departure adds nothing."""
    strata = [values[side == one] for one in np.unique(side)]
    variance = sum(part.size * float(np.var(part, ddof=1)) for part in strata if part.size > 1)
    return math.sqrt(variance) / values.size


def case_table(results: StudyResults, position: int, ranking: Ranking) -> CaseTable:
    """The rows of one case.

    Parameters
    ----------
    results : StudyResults
    position : int
        Which case.
    ranking : Ranking
        Of that case.

    Returns
    -------
    CaseTable
    """
    case = results.cases[position]
    members: dict[str, list[Design]] = {}
    for design in results.designs:
        members.setdefault(design.law, []).append(design)
    swept = {law: [axis.name for axis in swept_axes(designs)] for law, designs in members.items()}
    rows = tuple(_row(results, case, ranking, place, swept[design.law]) for place, design in enumerate(ranking.designs))
    # residuals make a recorded path deeper than its parameter d_y says
    deeper = [float(share) for design, share in zip(ranking.designs, ranking.deeper, strict=True) if design.is_baseline]
    return CaseTable(
        case=case.case,
        rows=rows,
        uncorrected=float(ranking.S_uncorrected[0]),
        uncorrected_deeper=deeper[0] if deeper else share_deeper(results.scenarios.d_y, ranking.D_y),
        D_y=ranking.D_y,
        confidence=ranking.confidence,
        bootstrap=ranking.bootstrap,
        warnings=ranking.warnings,
    )


def gain_texts(design: Design, swept: list[str]) -> tuple[tuple[str, str, str], ...]:
    """Name, value and unit of the gains that are swept or differ from their defaults."""
    declared = {g.name: g for g in controller_class(design.law).gains()}
    named = {*swept, *(name for name, _ in design.changed)}
    return tuple(
        (name, compact(value), unit_text(declared[name].unit)) for name, value in design.gains if name in named
    )


def _row(results: StudyResults, case: CaseResults, ranking: Ranking, place: int, swept: list[str]) -> Row:
    index = int(ranking.index[place])
    design = results.designs[index]

    def side(S: FloatArray, reduction: FloatArray) -> Side | None:
        return Side(float(S[place]), float(reduction[place])) if np.isfinite(S[place]) else None

    return Row(
        index=index,
        rank=int(ranking.rank[place]),
        design=design,
        title=controller_class(design.law).title,
        gains=gain_texts(design, swept),
        S=Interval(float(ranking.S[place]), float(ranking.S_low[place]), float(ranking.S_high[place])),
        reduction=ratio_interval(case.S[index], case.S_uncorrected[index], results.scenarios.side, ranking.confidence),
        left=side(ranking.S_left, ranking.reduction_left),
        right=side(ranking.S_right, ranking.reduction_right),
        difference=Interval(
            float(ranking.difference[place]),
            float(ranking.difference_low[place]),
            float(ranking.difference_high[place]),
        ),
        tied=bool(ranking.tied_with_best[place]),
        triggered=float(ranking.triggered[place]),
        deeper=float(ranking.deeper[place]),
        solver_failed=int(ranking.solver_failed[place]),
        diverged=int(ranking.diverged[place]),
        timed_out=int(ranking.timed_out[place]),
        invalid=int(ranking.invalid[place]),
        failed_solves=int(ranking.failed_solves[place]),
    )


def is_baseline(row: Row) -> bool:
    """Whether the design never intervenes."""
    return row.design.is_baseline
