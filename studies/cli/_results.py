"""What commands on result folders share: a ranking on the terminal and in files, and the report."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from ldctoolkit.errors import InputError

from ..design import Design, named_designs
from ..pages.ranking_section import write_markdown
from ..ranking.ranking import Ranking, rank_study, write_csv
from ..ranking.verdict import (
    STEP_TEXT,
    StepTimes,
    Verdict,
    listed_positions,
    more_lines,
    ranking_table,
    verdict,
    verdict_lines,
)
from ..results import StudyResults
from ..storage.manifest import Manifest
from ..storage.store import Store
from ..study_file import Study, load_study
from ._console import console, print_table, progress_bar, say

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures
    from ldctoolkit.scenario_model import ScenarioModel

    from ..robustness import Robustness


@dataclasses.dataclass(frozen=True)
class Judged:
    """The study of a folder with results, ranked and judged."""

    folder: Path
    manifest: Manifest
    study: Study
    results: StudyResults
    ranking: Ranking
    robustness: Robustness | None  # None where there are no numbers on other plants
    verdict: Verdict

    @classmethod
    def of(
        cls, folder: Path, manifest: Manifest, study: Study, results: StudyResults, *,
        model: ScenarioModel | None = None, drive_plants: bool = False, show: bool = True,
    ) -> Self:  # fmt: skip
        """Rank and judge results, with what DIR/robustness.json holds of them, or what `drive_plants` puts there.

        `show` says whether a terminal shows progress.
        """
        with progress_bar("ranking", show=show):
            ranking = rank_study(results, study)
        robustness = None
        if results.designs and results.drivable.any():
            from ..robustness import RobustnessTask, robustness_of, stored_of

            with progress_bar("driving the best on other plants", show=show and drive_plants):
                task = RobustnessTask.of(results, ranking, study.setup(), vehicles=study.vehicles)
                robustness = (robustness_of if drive_plants else stored_of)(folder, task)
        judgement = verdict(ranking, results, study.setup(), robustness, model)
        return cls(folder, manifest, study, results, ranking, robustness, judgement)

    @classmethod
    def read(cls, folder: str | Path) -> Self:
        """Read a folder that ldc run wrote."""
        store = Store.open(folder)
        return cls.of(Path(folder), store.manifest, store.manifest.read_study(), store.results())

    def named(self, labels: Sequence[str] | None) -> list[Design]:
        """The designs of these labels or starts of ids; without any the one that the verdict names."""
        return named_designs(self.ranking.designs, labels) if labels else [self.ranking.designs[self.verdict.position]]


def study_of(name: str, labels: Sequence[str] | None) -> tuple[Study, list[Design], Judged | None]:
    """The study of a file, of the catalog or of a folder that ldc run wrote, its designs, and what the folder holds.

    The designs are those of the labels or starts of ids; without any all of a study, and the one that the verdict on a
    folder names.
    """
    if is_folder(name):
        judged = Judged.read(name)
        return judged.study, judged.named(labels), judged
    study = load_study(name)
    if not study.designs:
        raise InputError(f"study {study.name}", "searches its designs", hint="give the folder that ldc run wrote")
    return study, named_designs(study.designs, labels) if labels else list(study.designs), None


def is_folder(name: str) -> bool:
    """Whether a name on the command line is that of a folder that ldc run wrote; raises nothing, whatever the name."""
    return os.path.isfile(f"{name}/manifest.json")  # noqa: PTH113


def source_departures(paths: Sequence[str] | None) -> Departures | None:
    """What ``--source`` names: the departures that the scenario model was fitted to."""
    if not paths:
        return None
    from ldctoolkit.recordings import read_all_departures

    return read_all_departures(paths)[0]


def write_files(
    judged: Judged, *, source: Departures | None, figures: bool, departures: Sequence[int] = (),
    designs: Sequence[str] = (),
) -> dict[str, Path]:  # fmt: skip
    """Write the ranking, DIR/report.html, DIR/figures/ and, where the study asks for it, DIR/paper.html.

    `departures` are scenario numbers and `designs` starts of ids, for the explorer. Returns the main files by name.
    """
    from ..pages.paper_page import write_paper_page
    from ..pages.report import report_input, write_report

    report = report_input(
        judged.folder, judged.study, judged.manifest, judged.results, judged.ranking, source=source,
        departures=departures, shown_designs=designs, robustness=judged.robustness,
    )  # fmt: skip
    folder, files = judged.folder, {"ranking": write_ranking(judged)}
    files["report"] = write_report(report, folder / "report.html", figures=folder / "figures" if figures else None)
    if judged.study.report.paper:
        return files | {"paper": write_paper_page(report, folder / "paper.html")}
    (folder / "paper.html").unlink(missing_ok=True)  # of an earlier run
    return files


_MOST_FAILED = 20


def print_ranking(judged: Judged, top: int, times: StepTimes | None = None) -> None:
    """The table, with the times of steps that are given, the verdict, and what else a reader should know."""
    out, ranking = console(), judged.ranking
    print_table(ranking_table(ranking, listed_positions(ranking, top), times), narrow=True)
    if times:
        say(out, STEP_TEXT)
    title, *others = verdict_lines(judged.verdict)
    style = "bold green" if judged.verdict.usable and ranking.winner is not None else "bold red"
    out.print(title, style=style, markup=False, emoji=False, highlight=False)
    for line in (*others, *more_lines(ranking)):
        out.print(line, markup=False, emoji=False, highlight=False)
    if judged.manifest.extended:
        say(out, f"Added beyond the ends of sweeps: {'; '.join(judged.manifest.extended)}.")
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


def write_ranking(judged: Judged) -> Path:
    """Write DIR/ranking.csv and, to be read, DIR/ranking.md."""
    path = judged.folder / "ranking.csv"
    write_csv(judged.ranking, path)
    write_markdown(judged.ranking, judged.folder / "ranking.md", judged.study, judged.manifest, judged.verdict)
    return path


def json_summary(judged: Judged, files: Mapping[str, Path]) -> str:
    """The last line of ``ldc run --json``."""
    manifest = judged.manifest
    content = {"event": "done"} | _summary(judged)
    content |= {
        "wall_time_s": round(manifest.wall_time_s, 3),
        "executor": manifest.executor,
        "workers": manifest.workers,
    } | {name: str(path) for name, path in files.items()}
    return json.dumps(content)


def rank_summary(judged: Judged, ranking_csv: Path | None, times: StepTimes | None = None) -> str:
    """The one line of ``ldc rank --json``: the result, the settings that it was ranked with, and times of steps."""
    ranking, content = judged.ranking, {"event": "ranked"} | _summary(judged)
    baseline, winner = ranking.baseline, ranking.winner
    of_winner = ranking.inference.baseline_difference
    content |= {
        "baseline": None if baseline is None else ranking.designs[baseline].id,
        "rank_by": ranking.ranked_by.of[0] if ranking.criterion else "S",
        ranking.ranked_by.column_of("baseline_difference"): None if winner is None else _number(of_winner[winner]),
        "require": list(ranking.require),
        "not_ranked": [design.id for design, missed in zip(ranking.designs, ranking.unmet, strict=True) if missed],
        "pareto": list(ranking.pareto_metrics),
        "pareto_front": [ranking.designs[i].id for i in range(len(ranking)) if ranking.pareto[i]],
        "confidence": ranking.confidence,
        "warnings": list(ranking.warnings),
        "ranking": None if ranking_csv is None else str(ranking_csv),
    }  # fmt: skip
    if times is not None:
        content["step_time_s"] = {id: {"median": median, "p99": p99} for id, (median, p99) in times.items()}
    return json.dumps(content)


def _summary(judged: Judged) -> dict[str, Any]:
    ranking, results, judgement = judged.ranking, judged.results, judged.verdict
    return {
        "study": judged.manifest.study.get("name", ""),
        "study_hash": judged.manifest.study_hash,
        "designs": len(results.designs),
        "scenarios": len(results.scenarios),
        "failed_designs": len(results.failed),
        "winner": None if ranking.winner is None else _design_json(ranking, ranking.winner),
        "set_of_best": [ranking.designs[i].id for i in range(len(ranking)) if ranking.inference.set_of_best[i]],
        "verdict": judgement.title,
        "sentences": list(judgement.sentences),
        "usable": judgement.usable,
        "lights": {light.name: light.state for light in judgement.lights},
        "binding": [limit.requirement.text for limit in judgement.binding],
        **{
            name: [{"name": item.gain.name, "value": item.value, "text": item.text} for item in items]
            for name, items in (("sweep_ends", judgement.ends), ("blocked", judgement.blocked))
        },
        "extended": list(judged.manifest.extended),
    }


def _design_json(ranking: Ranking, i: int) -> dict[str, Any]:
    design = ranking.designs[i]
    S_low, S_high = ranking.inference.S_low[i], ranking.inference.S_high[i]
    scores = {"S": ranking.metrics.S[i], "S_low": S_low, "S_high": S_high, "S_fresh": ranking.fresh.S[i]}
    recordings = {name: _number(values[i]) for name, values in vars(ranking.recordings).items()
                  if isinstance(values, np.ndarray)}  # fmt: skip
    return {
        "design": design.id,
        "law": design.law,
        "y_s_m": design.y_s,
        "gains": dict(design.gains),
        **{f"{name}_m_s": _number(value) for name, value in scores.items()},
        "needless_share": _number(ranking.needless(i)),
        "recordings": recordings | {"from": ranking.recordings.text, "refits": ranking.recordings.refits},
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
