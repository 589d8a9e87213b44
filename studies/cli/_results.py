"""Ranking and report of a study's folder, as several commands need them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

from ldctoolkit.departures import Departures
from ldctoolkit.errors import StoreError
from studies.cli._console import console
from studies.cli._ranking_notes import ranking_notes
from studies.cli._ranking_table import ranking_table
from studies.ranking.ranking import Ranking
from studies.ranking.ranking_csv import write_csv
from studies.ranking.ranking_markdown import StudyHead, write_markdown
from studies.report import ReportInput, write_report
from studies.results import StudyResults
from studies.robustness.robustness import Robustness
from studies.sensitivity.sensitivity import sensitivity
from studies.storage.manifest import Manifest
from studies.storage.model_notes import WARNING
from studies.storage.stored_model import read_model
from studies.study_file.plant_table import plant_settings
from studies.study_file.spec import Study
from studies.study_file.toml_text import toml_text

_TOP_OF_OTHER_CASES = 3
_MOST_FAILED = 20


def print_rankings(rankings: Sequence[Ranking], top: int) -> None:
    """The primary case in full, the others in short."""
    out = console()
    for i, ranking in enumerate(rankings):
        out.print(ranking_table(ranking, top if i == 0 else min(top, _TOP_OF_OTHER_CASES)))
        for note in ranking_notes(ranking):
            out.print(note, markup=False, emoji=False, highlight=False)
        for warning in ranking.warnings:
            out.print(f"Warning: {warning}", style="yellow", markup=False, emoji=False)
        out.print()
    _print_failed(rankings[0])


def _print_failed(ranking: Ranking) -> None:
    """Designs that have no rank, and why; a law's words are no markup."""
    out, failed = console(), ranking.failed
    if not failed:
        return
    out.print(f"{len(failed)} design{'s' if len(failed) > 1 else ''} failed and {'are' if len(failed) > 1 else 'is'} "
              "not ranked:", style="yellow")  # fmt: skip
    for one in failed[:_MOST_FAILED]:
        out.print(f"  {one.sentence}", markup=False, emoji=False, highlight=False, soft_wrap=True)
    if len(failed) > _MOST_FAILED:
        out.print(f"  and {len(failed) - _MOST_FAILED} more, see ranking.csv")
    out.print()


def write_ranking(
    folder: Path, study: Study, manifest: Manifest, results: StudyResults, rankings: Sequence[Ranking]
) -> Path:
    """Write DIR/ranking.csv and, to be read, DIR/ranking.md."""
    path = folder / "ranking.csv"
    write_csv(rankings, path, results.race)
    write_markdown(rankings, folder / "ranking.md", study_head(study, manifest))
    return path


def study_head(study: Study, manifest: Manifest) -> StudyHead:
    """What stands above a ranking that is read by itself."""
    return StudyHead(
        title=study.title or study.name,
        name=study.name,
        model=f"{manifest.model} (content {manifest.model_hash[:12]})",
        synthetic=manifest.model_synthetic,
        left=study.scenarios.left,
        right=study.scenarios.right,
        seed=study.seed,
    )


def write_study_report(
    folder: Path,
    study: Study,
    manifest: Manifest,
    results: StudyResults,
    rankings: tuple[Ranking, ...],
    source_departures: Departures | None = None,
    *,
    departures: Sequence[int] = (),
    shown_designs: Sequence[str] = (),
    robustness: Robustness | None = None,
) -> Path:
    """Write DIR/report.html and DIR/figures/."""
    report = ReportInput(
        title=study.title or study.name,
        study_name=study.name,
        results=results,
        rankings=rankings,
        vehicle=study.vehicle,
        dt=study.simulation.dt,
        initial_yaw_rate=study.simulation.initial_yaw_rate,
        options=study.plant,
        settle=study.simulation.settle,
        seed=study.seed,
        settings=tuple(_settings(study, manifest)),
        versions=tuple(_versions(manifest)),
        model_notes=manifest.model_notes,
        warnings=tuple(dict.fromkeys((*_of_the_model(manifest), *(w for r in rankings for w in r.warnings)))),
        synthetic=manifest.model_synthetic,
        command=manifest.command,
        sensitivity=sensitivity(results, study),
        robustness=robustness,
        study_file=toml_text(study),
        model=read_model(folder, manifest),
        model_name=manifest.model,
        given=study.scenarios.given,
        source_departures=source_departures,
        departures=tuple(departures),
        shown_designs=tuple(shown_designs),
    )
    path = folder / "report.html"
    try:
        return write_report(report, path, figures=folder / "figures")
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def source_departures(paths: Sequence[str] | None) -> Departures | None:
    """The departures of the option --departures, several tables as one; None without it."""
    if not paths:
        return None
    from ldctoolkit.scenario_model import read_all_departures

    return read_all_departures(paths)[0]


def _of_the_model(manifest: Manifest) -> Iterator[str]:
    """What the fit of the scenario model warned of, in one sentence."""
    notes = [note.removeprefix(WARNING) for note in manifest.model_notes if note.startswith(WARNING)]
    if notes:
        yield f"Of the scenario model: {'; '.join(notes)}."


def _settings(study: Study, manifest: Manifest) -> Iterator[tuple[str, str]]:
    yield "study", f"{study.name} (content {manifest.study_hash})"
    yield "scenario model", f"{manifest.model} (content {manifest.model_hash[:16]})"
    yield "scenarios", f"{study.scenarios.left} left, {study.scenarios.right} right"
    yield "seed", str(study.seed)
    yield "designs", str(len(study.designs))
    yield "sample time dt", f"{study.simulation.dt:g} s"
    yield "windows of S", ", ".join(study.simulation.window)
    yield "conventions", ", ".join(name.replace("_", " ") for name in study.simulation.convention)
    yield "initial yaw rate", study.simulation.initial_yaw_rate
    yield "settling after the end", f"{study.simulation.settle:g} s"
    yield "plant", "ideal" if study.plant.ideal else "not ideal"
    yield from ((f"plant.{key}", value) for key, value in plant_settings(study.plant))
    units = {"C_af": "N/rad", "C_ar": "N/rad", "m": "kg", "I_z": "kg m^2"}
    for field in dataclasses.fields(study.vehicle):
        yield f"vehicle {field.name}", f"{getattr(study.vehicle, field.name):g} {units.get(field.name, 'm')}"
    yield "deep departures, D_y", f"{study.report.D_y:g} m"
    yield "bootstrap", f"{study.ranking.bootstrap} resamples, {100 * study.ranking.confidence:g} % intervals"
    yield "baseline", study.ranking.baseline or "no control, where it is among the designs"
    yield "requirements", ", ".join(study.ranking.require) or "none"
    yield "Pareto front over", ", ".join(study.ranking.pareto) or "none"
    yield "finalists on fresh departures", f"{study.ranking.finalists} at most"
    yield "race", "yes" if study.race else "no"
    yield "finished", manifest.finished or "not finished"
    yield "wall time", f"{manifest.wall_time_s:.1f} s, {manifest.workers} worker processes"


def _versions(manifest: Manifest) -> Iterator[tuple[str, str]]:
    yield from manifest.versions.items()
    yield "Python", manifest.python
    machine = manifest.machine
    yield "machine", f"{machine.system}, {machine.architecture}, {machine.processor}, {machine.cores} cores"
