"""What commands on result folders share: a ranking on the terminal and in files, and the report."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from ..pages.ranking_section import write_markdown
from ..ranking.ranking import Ranking, rank_study, write_csv
from ..ranking.verdict import Verdict, listed_places, more_lines, ranking_table, verdict_lines
from ..results import StudyResults
from ..storage.manifest import Manifest
from ..study_file import Study
from ._console import console, print_table, progress_bar, say

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures

    from ..design import Design
    from ..robustness import Robustness


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """What the command line says of the report."""

    source: Departures | None = None  # what the scenario model was fitted to
    robustness: bool = True  # whether to drive designs on other plants where no numbers of them are stored
    figures: bool = True  # whether to write the charts as files
    departures: tuple[int, ...] = ()  # scenario numbers to be put into the explorer
    designs: tuple[str, ...] = ()  # beginnings of ids of designs to be put into the explorer

    @classmethod
    def of(cls, args: argparse.Namespace, departures: Sequence[int] = (), designs: Sequence[str] = ()) -> Self:
        """Read what the options name."""
        source = None
        if args.source:
            from ldctoolkit.recordings import read_all_departures

            source = read_all_departures(args.source)[0]
        return cls(source, not args.no_robustness, not args.no_figures, tuple(departures), tuple(designs))

    def robustness_of(self, folder: Path, study: Study, results: StudyResults, ranking: Ranking) -> Robustness | None:
        """What DIR/robustness.json holds, worked out first where need be and wanted; None where there is nothing."""
        if not self.robustness or not results.designs or not results.on_drivable().scenarios.n:
            return stored_robustness(folder, study, results, ranking)
        from ..robustness import RobustnessTask, robustness_of

        return robustness_of(folder, RobustnessTask.of(results, ranking, study.setup()))


def write_study_report(
    folder: Path, study: Study, manifest: Manifest, results: StudyResults, ranking: Ranking,
    options: ReportOptions, robustness: Robustness | None,
) -> Path:  # fmt: skip
    """Write DIR/report.html and DIR/figures/."""
    from ..pages.report import report_input, write_report

    report = report_input(
        folder, study, manifest, results, ranking, source=options.source, departures=options.departures,
        shown_designs=options.designs, robustness=robustness,
    )  # fmt: skip
    path = folder / "report.html"
    return write_report(report, path, figures=folder / "figures" if options.figures else None)


def stored_robustness(folder: Path, study: Study, results: StudyResults, ranking: Ranking) -> Robustness | None:
    """What DIR/robustness.json holds of these results; None where there is nothing."""
    if not results.designs or not results.on_drivable().scenarios.n:
        return None
    from ..robustness import RobustnessTask, stored_of

    return stored_of(folder, RobustnessTask.of(results, ranking, study.setup()))


@dataclasses.dataclass(frozen=True)
class Judged:
    """The study of a folder with results, ranked and judged."""

    manifest: Manifest
    study: Study
    results: StudyResults
    ranking: Ranking
    verdict: Verdict

    @property
    def design(self) -> Design:
        """The design that the verdict names."""
        return self.ranking.designs[self.verdict.place]


def judged(folder: str | Path) -> Judged:
    """Read a folder that ldc run wrote."""
    from ..ranking.verdict import verdict
    from ..storage.store import Store

    store = Store.open(folder)
    with progress_bar("ranking"):
        study, results = store.manifest.read_study(), store.results()
        ranking = rank_study(results, study)
    return Judged(store.manifest, study, results, ranking, verdict(ranking, results, study.setup()))


_MOST_FAILED = 20


def print_ranking(ranking: Ranking, top: int, judgement: Verdict) -> None:
    """The table, the verdict, and what else a reader should know."""
    out = console()
    print_table(ranking_table(ranking, listed_places(ranking, top)), narrow=True)
    title, *others = verdict_lines(judgement)
    style = "bold green" if judgement.usable and ranking.winner is not None else "bold red"
    out.print(title, style=style, markup=False, emoji=False, highlight=False)
    for line in (*others, *more_lines(ranking)):
        out.print(line, markup=False, emoji=False, highlight=False)
    for warning in ranking.warnings:
        out.print(f"Warning: {warning}", style="yellow", markup=False, emoji=False, highlight=False)
    out.print()
    _print_failed(ranking)


def _print_failed(ranking: Ranking) -> None:
    """Designs that have no rank, and why; a law's words are no markup."""
    out, failed = console(), ranking.failed
    if not failed:
        return
    out.print(f"{len(failed)} design{'s' if len(failed) > 1 else ''} failed and {'are' if len(failed) > 1 else 'is'} "
              "not ranked:", style="yellow")  # fmt: skip
    say(out, *(f"  {failure.sentence}" for failure in failed[:_MOST_FAILED]))
    if len(failed) > _MOST_FAILED:
        out.print(f"  and {len(failed) - _MOST_FAILED} more, see ranking.csv")
    out.print()


def write_ranking(folder: Path, study: Study, manifest: Manifest, ranking: Ranking, judgement: Verdict) -> Path:
    """Write DIR/ranking.csv and, to be read, DIR/ranking.md."""
    path = folder / "ranking.csv"
    write_csv(ranking, path)
    write_markdown(ranking, folder / "ranking.md", study, manifest, judgement)
    return path


def json_summary(
    results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path, report: Path, judgement: Verdict
) -> str:
    """The last line of ``ldc run --json``."""
    content = {"event": "done"} | _summary(results, ranking, manifest) | _judged(judgement)
    content |= {
        "wall_time_s": round(manifest.wall_time_s, 3),
        "executor": manifest.executor,
        "workers": manifest.workers,
        "ranking": str(ranking_csv),
        "report": str(report),
    }
    return json.dumps(content)


def _judged(judgement: Verdict) -> dict[str, Any]:
    return {
        "verdict": judgement.title,
        "usable": judgement.usable,
        "lights": {light.name: light.state for light in judgement.lights},
    }


def rank_summary(
    results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path | None, judgement: Verdict
) -> str:
    """The one line of ``ldc rank --json``: what was found, and with which settings."""
    baseline, winner = ranking.baseline, ranking.winner
    content = {"event": "ranked"} | _summary(results, ranking, manifest) | _judged(judgement)
    content |= {
        "baseline": None if baseline is None else ranking.designs[baseline].id,
        "baseline_difference_m_s": None if winner is None else _number(ranking.inference.baseline_difference[winner]),
        "require": list(ranking.require),
        "not_ranked": [design.id for design, missed in zip(ranking.designs, ranking.unmet, strict=True) if missed],
        "pareto": list(ranking.pareto_metrics),
        "pareto_front": [ranking.designs[i].id for i in range(len(ranking)) if ranking.pareto[i]],
        "confidence": ranking.confidence,
        "warnings": list(ranking.warnings),
        "ranking": None if ranking_csv is None else str(ranking_csv),
    }  # fmt: skip
    return json.dumps(content)


def _summary(results: StudyResults, ranking: Ranking, manifest: Manifest) -> dict[str, Any]:
    return {
        "study": manifest.study.get("name", ""),
        "study_hash": manifest.study_hash,
        "designs": len(results.designs),
        "scenarios": len(results.scenarios),
        "failed_designs": len(results.failed),
        "winner": None if ranking.winner is None else _design(ranking, ranking.winner),
        "set_of_best": [ranking.designs[i].id for i in range(len(ranking)) if ranking.inference.set_of_best[i]],
    }


def _design(ranking: Ranking, i: int) -> dict[str, Any]:
    design = ranking.designs[i]
    S_low, S_high = ranking.inference.S_low[i], ranking.inference.S_high[i]
    scores = {"S": ranking.metrics.S[i], "S_low": S_low, "S_high": S_high, "S_fresh": ranking.fresh.S[i]}
    return {
        "design": design.id,
        "law": design.law,
        "y_s_m": design.y_s,
        "gains": dict(design.gains),
        **{f"{name}_m_s": _number(value) for name, value in scores.items()},
        "limits": [
            {
                "limit": estimate.requirement.text,
                "required": estimate.required,
                "met": estimate.met,
                "uncertain": estimate.uncertain,
            }
            | {"fresh": estimate.fresh, **{name: _number(getattr(estimate, name)) for name in ("value", "low", "high")}}
            for estimate in ranking.estimates(i)
        ],
    }


def _number(value: float) -> float | None:
    """JSON has no word for what is not a number."""
    return float(value) if math.isfinite(value) else None
