"""The ranking of a study: designs by mean S, with paired differences to the best and bootstrap intervals."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, controller_class
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError
from ldctoolkit.gains import GainValue
from studies.bootstrap import bootstrap_means, percentile_interval
from studies.design import Design
from studies.files import write_text
from studies.results import Case, CaseResults, StudyResults
from studies.spec import Study

if TYPE_CHECKING:
    from rich.table import Table

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


_SAME = 1e-6
"""Differences of mean S [m s] below this are solver tolerance, not design."""


@dataclasses.dataclass(frozen=True, repr=False)
class Ranking:
    """Designs of one case, best first; every array has one entry a design in that order.

    Failed and diverged scenarios count in every mean with the S that they got.

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
    solver_failed, diverged, timed_out : (d,) int
        Scenarios with that status.
    failed_solves : (d,) int
        Commands that came from a fallback.
    D_y : float [m]
    bootstrap : int
        Resamples.
    confidence : float
        Of the intervals.
    warnings : tuple of str
        What a reader must know before comparing designs.
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
    failed_solves: IntArray
    D_y: float
    bootstrap: int
    confidence: float
    warnings: tuple[str, ...]

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
        if not np.isfinite(case.S).all():
            raise InputError("results: S is not finite in some scenario; a mean would drop or hide it")
        left, right = (results.scenarios.side == side for side in (LEFT, RIGHT))
        S = case.S.mean(axis=1)
        order = np.argsort(S, kind="stable")
        sorted_S = S[order]
        means = bootstrap_means(case.S[order], results.scenarios.side, samples=bootstrap, seed=seed)
        S_low, S_high = percentile_interval(means, confidence)
        difference = (case.S[order] - case.S[order[0]]).mean(axis=1)
        means -= means[:, :1].copy()
        difference_low, difference_high = percentile_interval(means, confidence)
        # exact for a design whose scores equal the best's: rounding of the product must not untie it
        same = difference == 0.0
        difference_low[same] = np.minimum(difference_low[same], 0.0)

        def share(values: BoolArray) -> FloatArray:
            result: FloatArray = values[order].mean(axis=1)
            return result

        def count(status: EventStatus) -> IntArray:
            result: IntArray = (case.status[order] == status).sum(axis=1).astype(np.int64)
            return result

        return cls(
            case=case.case,
            designs=tuple(results.designs[i] for i in order),
            index=order.astype(np.int64),
            rank=np.searchsorted(sorted_S, sorted_S, side="left").astype(np.int64) + 1,
            S=sorted_S,
            S_left=_mean(case.S[order], left),
            S_right=_mean(case.S[order], right),
            S_low=S_low,
            S_high=S_high,
            S_uncorrected=case.S_uncorrected[order].mean(axis=1),
            reduction=_reduction(case, order, left | right),
            reduction_left=_reduction(case, order, left),
            reduction_right=_reduction(case, order, right),
            difference=difference,
            difference_low=difference_low,
            difference_high=difference_high,
            tied_with_best=(difference_low <= _SAME) & (difference_high >= -_SAME),
            triggered=share(case.status != EventStatus.NEVER_TRIGGERED),
            deeper=share(case.deepest > D_y),
            solver_failed=count(EventStatus.SOLVER_FAILED),
            diverged=count(EventStatus.DIVERGED),
            timed_out=count(EventStatus.TIMED_OUT),
            failed_solves=case.failed_solves[order].sum(axis=1).astype(np.int64),
            D_y=D_y,
            bootstrap=bootstrap,
            confidence=confidence,
            warnings=tuple(_warnings(case, results.designs)),
        )

    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of every law, best law first."""
        first: dict[str, int] = {}
        for i, design in enumerate(self.designs):
            first.setdefault(design.law, i)
        return tuple(first.values())

    def table(self, top: int = 10) -> Table:
        """The first `top` designs and the best of each law, for a terminal."""
        from rich.table import Table

        shown = sorted({*range(min(top, len(self))), *self.best_of_each_law()})
        percent = f"{100 * self.confidence:g}%"
        table = Table(title=f"{len(self)} designs by mean S, {self.case.label}", title_justify="left")
        for heading in ("#", "law", "y_s\n[m]", "gains that differ\nfrom defaults"):
            table.add_column(heading, justify="right" if heading in ("#", "y_s\n[m]") else "left")
        headings = ("mean S\n[m s]", f"{percent}\ninterval", "to the best\n[m s]", "reduction", "left", "right")
        for heading in (*headings, f"deeper\n{self.D_y:g} m", "failed"):
            table.add_column(heading, justify="right")
        for previous, i in zip([-1, *shown], shown, strict=False):
            if i > previous + 1:
                table.add_section()
            table.add_row(*self._cells(i), style="bold" if i == 0 else None)
        return table

    def _cells(self, i: int) -> list[str]:
        design = self.designs[i]
        gains = ", ".join(f"{name}={_text(value)}" for name, value in design.changed)
        tie = " =" if i and self.tied_with_best[i] else ""
        failed = int(self.solver_failed[i] + self.diverged[i] + self.timed_out[i])
        return [
            str(self.rank[i]),
            controller_class(design.law).title,
            f"{design.y_s:g}",
            gains,
            f"{self.S[i]:.4f}",
            f"{self.S_low[i]:.3f} .. {self.S_high[i]:.3f}",
            f"+{self.difference[i]:.4f}{tie}",
            *(_percent(values[i]) for values in (self.reduction, self.reduction_left, self.reduction_right)),
            _percent(self.deeper[i]),
            str(failed) if failed else "-",
        ]

    def to_csv(self, path: str | Path) -> None:
        """Write this ranking alone as CSV; see `write_csv`."""
        write_csv([self], path)


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
    # contiguous rows: the sum of a design does not depend on how many designs stand beside it
    means: FloatArray = np.ascontiguousarray(values[:, rows]).mean(axis=1)
    return means


def _reduction(case: CaseResults, order: IntArray, rows: BoolArray) -> FloatArray:
    S, before = _mean(case.S[order], rows), _mean(case.S_uncorrected[order], rows)
    out = np.where(np.isnan(before), np.nan, 0.0)  # nothing to reduce
    return 1.0 - np.divide(S, before, out=1.0 - out, where=before > 0)


def _warnings(case: CaseResults, designs: Sequence[Design]) -> Iterator[str]:
    if case.case.window == "control" and len({design.y_s for design in designs}) > 1:
        yield (
            "S over the control window starts at the trigger, which moves with y_s: a later trigger gives a smaller S. "
            "Designs with different y_s are not comparable here; use the departure window."
        )


def _percent(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"


def _text(value: GainValue) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def write_csv(rankings: Sequence[Ranking], path: str | Path) -> None:
    """Write rankings as one CSV file, whole or not at all; window and convention name the case.

    Parameters
    ----------
    rankings : sequence of Ranking
    path : path

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    gains = _gain_columns(rankings)
    text = io.StringIO()
    rows = [row for ranking in rankings for row in _rows(ranking, gains)]
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(Path(path), text.getvalue())


def _gain_columns(rankings: Iterable[Ranking]) -> list[str]:
    laws = dict.fromkeys(design.law for ranking in rankings for design in ranking.designs)
    return list(dict.fromkeys(column for law in sorted(laws) for column in _columns_of(law)))


def _columns_of(law: str) -> list[str]:
    """Column of every gain of a law; a gain of one name and unit shares its column between laws."""
    units = {"1": "", "samples": ""}
    return [
        g.name + (f"_{unit}" if (unit := units.get(g.unit, g.unit.replace("/", "_per_").replace("^", ""))) else "")
        for g in controller_class(law).gains()
    ]


def _rows(ranking: Ranking, gains: Sequence[str]) -> Iterator[dict[str, Any]]:
    numbers = {
        "S_m_s": ranking.S,
        "S_low_m_s": ranking.S_low,
        "S_high_m_s": ranking.S_high,
        "S_left_m_s": ranking.S_left,
        "S_right_m_s": ranking.S_right,
        "S_uncorrected_m_s": ranking.S_uncorrected,
        "reduction": ranking.reduction,
        "reduction_left": ranking.reduction_left,
        "reduction_right": ranking.reduction_right,
        "difference_to_best_m_s": ranking.difference,
        "difference_low_m_s": ranking.difference_low,
        "difference_high_m_s": ranking.difference_high,
        "tied_with_best": ranking.tied_with_best,
        "triggered_share": ranking.triggered,
        "deeper_than_D_y_share": ranking.deeper,
        "solver_failed": ranking.solver_failed,
        "diverged": ranking.diverged,
        "timed_out": ranking.timed_out,
        "failed_solves": ranking.failed_solves,
    }
    for i, design in enumerate(ranking.designs):
        values = dict.fromkeys(gains, "") | dict(
            zip(_columns_of(design.law), (_field(value) for _, value in design.gains), strict=True)
        )
        yield {
            "window": ranking.case.window,
            "convention": ranking.case.convention,
            "rank": int(ranking.rank[i]),
            "design": design.id,
            "law": design.law,
            "y_s_m": repr(design.y_s),
            **{f"gain_{name}": value for name, value in values.items()},
            **{name: _field(column[i].item()) for name, column in numbers.items()},
        }


def _field(value: Any) -> str:
    """Numbers in full precision, truth values in lower case, nothing for NaN."""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value != value else str(value)
