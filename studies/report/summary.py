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
from studies.results import Case, CaseResults, Race, StudyResults

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
    place : int
        Position in the ranking, from 0.
    rank : int
        0 for a design that misses a requirement.
    unmet : tuple of str
        The requirements that it misses.
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
        Paired difference of mean S to the first design of the ranking.
    to_baseline : Interval or None [m s]
        The same to the baseline, where there is one.
    in_set : bool
        In the set of best.
    pareto : bool
        On the Pareto front.
    fresh : Interval or None [m s]
        Mean S on fresh scenarios, of a finalist.
    fresh_difference, fresh_to_baseline : Interval or None [m s]
        Paired differences there, to the first design of the ranking and to the baseline.
    fresh_unmet : tuple of str
        Requirements that it misses there.
    optimism : Interval or None [m s]
        How much better the score was on the scenarios that designs were chosen on.
    triggered, deeper : float
        Share of departures that were taken over, and share deeper than D_y.
    solver_failed, diverged, timed_out, crashed, invalid : int
        Departures with that status.
    failed_solves : int
        Commands that came from a law's fallback.
    """

    index: int
    place: int
    rank: int
    unmet: tuple[str, ...]
    design: Design
    title: str
    gains: tuple[tuple[str, str, str], ...]
    S: Interval
    reduction: Interval
    left: Side | None
    right: Side | None
    difference: Interval
    to_baseline: Interval | None
    in_set: bool
    pareto: bool
    fresh: Interval | None
    fresh_difference: Interval | None
    fresh_to_baseline: Interval | None
    fresh_unmet: tuple[str, ...]
    optimism: Interval | None
    triggered: float
    deeper: float
    solver_failed: int
    diverged: int
    timed_out: int
    crashed: int
    invalid: int
    failed_solves: int

    @property
    def failures(self) -> int:
        """Departures that did not run as designed."""
        return self.solver_failed + self.diverged + self.timed_out + self.crashed + self.invalid


@dataclasses.dataclass(frozen=True)
class CaseTable:
    """All designs of one case in the order of the ranking.

    Attributes
    ----------
    case : Case
    rows : tuple of Row
    uncorrected : float [m s]
        Mean S without control, over the window of the first design.
    uncorrected_deeper : float
        Share of the departures deeper than D_y without control.
    D_y : float [m]
    winner : Row or None
        The design to take, if there is one.
    baseline : Row or None
    require, pareto_figures : tuple of str
    fresh_scenarios : int
        On which the finalists were scored again; 0 for none.
    optimism_paired : bool
        Whether optimism is that of the difference to the baseline, or of S.
    tried : int
        Designs of the study, with those that failed or were given up in a race.
    race : Race or None
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
    winner: Row | None
    baseline: Row | None
    require: tuple[str, ...]
    pareto_figures: tuple[str, ...]
    fresh_scenarios: int
    optimism_paired: bool
    tried: int
    race: Race | None
    confidence: float
    bootstrap: int
    warnings: tuple[str, ...]

    @property
    def first(self) -> Row:
        """The first of the ranking; where nothing is ranked, the lowest mean S."""
        return self.rows[0]

    @property
    def best(self) -> Row:
        """What figures follow: the winner, and where there is none, the first."""
        return self.first if self.winner is None else self.winner

    @property
    def best_name(self) -> str:
        """What to call `best` in a sentence."""
        if self.winner is not None:
            return "the winner"
        return "the first of the ranking" if self.ranked else "the design with the lowest mean S"

    @property
    def ranked(self) -> int:
        """How many designs have a rank."""
        return sum(row.rank > 0 for row in self.rows)

    @property
    def set_of_best(self) -> tuple[Row, ...]:
        """By rank; empty where nothing is ranked."""
        return tuple(row for row in self.rows if row.in_set)

    def best_of(self, law: str) -> Row | None:
        """The winner if it is of this law, else the law's first design."""
        if self.winner is not None and self.winner.design.law == law:
            return self.winner
        return next((row for row in self.rows if row.design.law == law), None)

    @property
    def best_of_each_law(self) -> tuple[Row, ...]:
        """`best_of` every law: the winner, then the others in the order of the ranking."""
        laws = dict.fromkeys(row.design.law for row in (self.best, *self.rows))
        return tuple(row for law in laws if (row := self.best_of(law)) is not None)

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
        """Designs with anything to report, in the order of the ranking."""
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
    for design in tried(results):
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
        winner=None if ranking.winner is None else rows[ranking.winner],
        baseline=None if ranking.baseline is None else rows[ranking.baseline],
        require=ranking.require,
        pareto_figures=ranking.pareto_figures,
        fresh_scenarios=ranking.fresh_scenarios,
        optimism_paired=ranking.optimism_paired,
        tried=len(tried(results)),
        race=results.race,
        warnings=ranking.warnings,
    )


def tried(results: StudyResults) -> tuple[Design, ...]:
    """All designs of the study: those with results first, then those that a race gave up, then those that failed."""
    given_up = () if results.race is None else tuple(one.design for one in results.race.dropped)
    return (*results.designs, *given_up, *(one.design for one in results.failed))


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

    def interval(name: str) -> Interval:
        return Interval(*(float(getattr(ranking, f"{name}{end}")[place]) for end in ("", "_low", "_high")))

    def known(name: str) -> Interval | None:
        found = interval(name)
        return found if math.isfinite(found.value) else None

    fresh = Interval(*(float(v[place]) for v in (ranking.fresh_S, ranking.fresh_low, ranking.fresh_high)))
    return Row(
        index=index,
        place=place,
        rank=int(ranking.rank[place]),
        unmet=ranking.unmet[place],
        design=design,
        title=controller_class(design.law).title,
        gains=gain_texts(design, swept),
        S=interval("S"),
        reduction=ratio_interval(
            case.counted[index], case.S_uncorrected[index], results.scenarios.side, ranking.confidence
        ),
        left=side(ranking.S_left, ranking.reduction_left),
        right=side(ranking.S_right, ranking.reduction_right),
        difference=interval("difference"),
        to_baseline=known("baseline_difference"),
        in_set=bool(ranking.set_of_best[place]),
        pareto=bool(ranking.pareto[place]),
        fresh=fresh if math.isfinite(fresh.value) else None,
        fresh_difference=known("fresh_difference"),
        fresh_to_baseline=known("fresh_baseline_difference"),
        fresh_unmet=ranking.fresh_unmet[place],
        optimism=known("optimism"),
        triggered=float(ranking.triggered[place]),
        deeper=float(ranking.deeper[place]),
        solver_failed=int(ranking.solver_failed[place]),
        diverged=int(ranking.diverged[place]),
        timed_out=int(ranking.timed_out[place]),
        crashed=int(ranking.crashed[place]),
        invalid=int(ranking.invalid[place]),
        failed_solves=int(ranking.failed_solves[place]),
    )


def is_baseline(row: Row) -> bool:
    """Whether the design never intervenes."""
    return row.design.is_baseline
