"""Tables of a report from results and rankings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import share_deeper
from studies.design import Design
from studies.ranking.case_figures import DrivableCase
from studies.ranking.fresh_scores import fresh_case
from studies.report.figures.landscape import swept_axes
from studies.report.tables.case_table import CaseTable
from studies.report.tables.reduction import ratio_interval
from studies.report.tables.row import Interval, Row, Side
from studies.report.words.text import compact, unit_text
from studies.results import CaseResults, StudyResults

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking


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
    fresh = _FreshDepartures.of(results, case)
    rows = tuple(
        _row(results, case, fresh, ranking, place, swept[design.law]) for place, design in enumerate(ranking.designs)
    )
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


@dataclasses.dataclass(frozen=True)
class _FreshDepartures:
    """One case on the fresh departures, and where each design stands in it."""

    case: DrivableCase
    position: Mapping[str, int]

    @classmethod
    def of(cls, results: StudyResults, case: CaseResults) -> Self | None:
        """None without finalists."""
        if results.fresh is None or not results.fresh.designs:
            return None
        position = {design.id: i for i, design in enumerate(results.fresh.designs)}
        return cls(fresh_case(results.fresh, case.case), position)

    def against_no_control(self, design: Design, confidence: float) -> tuple[float, Interval]:
        """Mean S without control, and the reduction against it."""
        i = self.position[design.id]
        S_0 = self.case.case.S_uncorrected[i]
        found = ratio_interval(self.case.counted[i], S_0, self.case.scenarios.side, confidence)
        return float(np.mean(S_0)), found


def _row(
    results: StudyResults,
    case: CaseResults,
    again: _FreshDepartures | None,
    ranking: Ranking,
    place: int,
    swept: list[str],
) -> Row:
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
    uncorrected, reduction = None, None
    if again is not None and design.id in again.position and math.isfinite(fresh.value):
        uncorrected, reduction = again.against_no_control(design, ranking.confidence)
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
        fresh_uncorrected=uncorrected,
        fresh_reduction=reduction,
        fresh_unmet=ranking.fresh_unmet[place],
        optimism=known("optimism"),
        triggered=float(ranking.triggered[place]),
        deeper=float(ranking.deeper[place]),
        solver_failed=int(ranking.solver_failed[place]),
        diverged=int(ranking.diverged[place]),
        timed_out=int(ranking.timed_out[place]),
        crashed=int(ranking.crashed[place]),
        beyond_delta_max=int(ranking.beyond_delta_max[place]),
        invalid=int(ranking.invalid[place]),
        failed_solves=int(ranking.failed_solves[place]),
    )
