"""The comparison report: one self-contained HTML file, and its charts as files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from markupsafe import Markup

from ldctoolkit.declared import Declaration, declarations
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.setup import Setup, simulation_options
from ldctoolkit.version import __version__

from ..ranking.verdict import listed_positions
from ..sensitivity.sensitivity import sensitivity
from ..step_time import step_times
from ..storage.folder_files import write_text
from ..storage.scenario_source import read_model
from ..study_file import toml_text
from ..text import plural, printable
from . import (
    assessment_section,
    confidence_section,
    explorer,
    landscape_section,
    model_section,
    ranking_section,
    robustness_section,
    verdict_section,
)
from .charts import Chart
from .context import Context, ReportInput
from .shell import Section, bullets, details, make_page, pairs

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures

    from ..ranking.ranking import Ranking
    from ..results import StudyResults
    from ..robustness import Robustness
    from ..storage.manifest import Manifest
    from ..study_file import Study

MOST_FAILED: Final = 50


def settings_section(context: Context) -> Section:
    """What failed, how the study was run, and the command and the file that make it again."""
    report, failed = context.report, context.report.results.failed
    body = explorer.failures(context)
    if failed:
        listed = [failure.sentence for failure in failed[:MOST_FAILED]]
        if len(failed) > MOST_FAILED:
            listed.append(f"and {len(failed) - MOST_FAILED} more, see ranking.csv")
        body += Markup("<p>{} failed and {} not ranked:</p>{}").format(
            plural(len(failed), "design"), "is" if len(failed) == 1 else "are", bullets(listed)
        )
    facts = [*report.settings, *report.versions]
    body += details("All settings, versions and the machine", pairs(facts))
    if report.command:
        body += Markup("<p>The study again: <code>{}</code></p>").format(printable(report.command))
    if report.study_file:
        body += details(
            "The study file with every default", Markup("<pre>{}</pre>").format(printable(report.study_file))
        )
    return Section("settings", "Failures and settings", body)


SECTIONS: Final[tuple[Callable[[Context], Section | None], ...]] = (
    verdict_section.section,
    ranking_section.section,
    ranking_section.limits_section,
    assessment_section.section,
    verdict_section.trade_offs,
    landscape_section.section,
    explorer.section,
    robustness_section.section,
    robustness_section.driver_section,
    confidence_section.section,
    model_section.section,
    settings_section,
)
"""What makes each section, in the order of the page; one may have nothing to show."""


def report_page(report: ReportInput) -> tuple[str, tuple[Chart, ...]]:
    """The report as one HTML document, and its charts."""
    context = Context.of(report)
    sections = tuple(section for make in SECTIONS if (section := make(context)) is not None)
    ranking = context.ranking
    html = make_page(
        kind="Lane departure correction: comparison of designs",
        title=f"{report.title}: comparison report",
        heading=report.title,
        facts=(
            plural(len(ranking) + len(ranking.failed), "design"),
            f"{context.every:,} departures" + (f" of {report.model_name}" if report.model_name else ""),
            ranking.label,
            _plant(report),
        ),
        sections=sections,
        footer=f"Study {report.study_name}. ldctoolkit {__version__}.",
    )
    return html, tuple(chart for section in sections for chart in section.charts)


def _plant(report: ReportInput) -> str:
    """What of the plant is not ideal: ``plant with actuator, sensors``."""
    parts = [declaration.name for declaration in not_ideal(report.setup.options)]
    return f"plant with {', '.join(parts)}" if parts else "ideal plant"


def write_report(report: ReportInput, path: str | Path, *, figures: str | Path | None = None) -> Path:
    """Write the report of a study as one HTML file that needs nothing else."""
    html, charts = report_page(report)
    write_text(Path(path), html)
    if figures is not None:
        folder = Path(figures)
        folder.mkdir(parents=True, exist_ok=True)
        written = {folder / f"{chart.name}.svg" for chart in charts}
        for old in (*folder.glob("*.svg"), *folder.glob("*.png")):  # of an earlier report of other designs
            if old not in written:
                old.unlink()
        for chart in charts:
            write_text(folder / f"{chart.name}.svg", chart.document)
    return Path(path)


def report_input(
    folder: Path,
    study: Study,
    manifest: Manifest,
    results: StudyResults,
    ranking: Ranking,
    *,
    source: Departures | None = None,
    departures: Sequence[int] = (),
    shown_designs: Sequence[str] = (),
    robustness: Robustness | None = None,
) -> ReportInput:
    """Gather what a report shows of a study that was run."""
    timed = [ranking.designs[i] for i in sorted({*listed_positions(ranking, 3), *ranking.best_of_each_law()})]
    warnings = "; ".join(manifest.model_warnings)
    fit_warnings = (f"Of the scenario model: {warnings}.",) if warnings else ()
    others = manifest.other_versions()
    old = (f"This study was run with {others}; paths that are driven for this page may differ.",) if others else ()
    return ReportInput(
        title=study.title or study.name,
        study_name=study.name,
        results=results,
        ranking=ranking,
        setup=study.setup(),
        settings=tuple(_study_settings(study, manifest)),
        versions=tuple(_versions(manifest)),
        model_notes=manifest.model_notes,
        warnings=tuple(dict.fromkeys((*old, *fit_warnings, *ranking.warnings))),
        synthetic=manifest.model_synthetic,
        command=manifest.command,
        sensitivity=sensitivity(results, study),
        robustness=robustness,
        step_times=step_times(results, study.setup(), timed, folder),
        study_file=toml_text(study),
        model=read_model(folder, manifest),
        model_name=f"the model {manifest.model}" if study.scenarios.model else f"{manifest.model}, replayed",
        given=study.scenarios.given,
        source_departures=source,
        folder=folder,
        departures=tuple(departures),
        shown_designs=tuple(shown_designs),
    )


def _study_settings(study: Study, manifest: Manifest) -> Iterator[tuple[str, str]]:
    yield "study", f"{study.name} (content {manifest.study_hash})"
    yield study.scenarios.source.lower(), f"{manifest.model} (content {manifest.model_hash[:16]})"
    yield "scenarios", "{} left, {} right".format(*study.scenarios.counts)
    yield "seed", str(study.seed)
    yield "designs", str(len(study.designs))
    yield "added beyond the ends of sweeps", "; ".join(manifest.extended) or "none"
    yield "window of S", study.simulation.window
    yield "convention", study.simulation.convention.replace("_", " ")
    yield from simulation_settings(study.setup())
    yield "plant", "ideal" if study.plant.ideal else "not ideal"
    yield from ((f"plant.{key}", value) for key, value in plant_settings(study.plant))
    units = {"C_af": "N/rad", "C_ar": "N/rad", "m": "kg", "I_z": "kg m^2", "steering_ratio": "(hand to road wheels)"}
    for field in dataclasses.fields(study.vehicle):
        yield f"vehicle {field.name}", f"{getattr(study.vehicle, field.name):g} {units.get(field.name, 'm')}"
    yield "deep departures, D_y", f"{study.report.D_y:g} m"
    yield "bootstrap", f"{study.ranking.bootstrap} resamples, {100 * study.ranking.confidence:g} % intervals"
    yield "baseline", study.ranking.baseline or "no control, where it is among the designs"
    yield "requirements", ", ".join(study.ranking.require) or "none"
    yield "Pareto front over", ", ".join(study.ranking.pareto) or "none"
    yield "finalists on fresh scenarios", f"{study.ranking.finalists} at most"
    yield "finished", manifest.finished or "not finished"
    yield "wall time", f"{manifest.wall_time_s:.1f} s, {manifest.workers} worker processes"


def _versions(manifest: Manifest) -> Iterator[tuple[str, str]]:
    yield from manifest.versions.items()
    yield "Python", manifest.python
    machine = manifest.machine
    yield "machine", f"{machine.system}, {machine.architecture}, {machine.processor}, {machine.cores} cores"


_ALWAYS_SHOWN: Final = ("tyres", "sensors.kalman", "residuals")
"""Tables whose defaults say something as soon as the table is used."""


def not_ideal(options: PlantOptions) -> Iterator[Declaration]:
    """The declarations of what differs from the ideal plant."""
    ideal = PlantOptions()
    for name, declaration in declarations(PlantOptions).items():
        if getattr(options, name) != getattr(ideal, name):
            yield declaration


def simulation_settings(setup: Setup) -> Iterator[tuple[str, str]]:
    """What each option of the simulation is, and its value with its unit."""
    for declaration in simulation_options():
        yield declaration.description, _option_text(getattr(setup, declaration.name), declaration)


def plant_settings(options: PlantOptions) -> Iterator[tuple[str, str]]:
    """Key and value, with its unit, of everything that differs from the ideal plant."""
    for declaration in not_ideal(options):
        value = getattr(options, declaration.name)
        if declaration.kind:
            yield from _shown_options(value, declaration.name)
        else:
            yield declaration.name, _option_text(value, declaration)


def _shown_options(part: Any, path: str) -> Iterator[tuple[str, str]]:
    """Options that are not at their default, or always shown, with their keys."""
    for declaration in declarations(part.__class__).values():
        value, key = getattr(part, declaration.name), f"{path}.{declaration.name}"
        if declaration.kind and value is not None:
            yield from _shown_options(value, key)
        elif value is not None and (path in _ALWAYS_SHOWN or value != declaration.default):
            yield key, _option_text(value, declaration)


def _option_text(value: Any, declaration: Declaration) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    return f"{value:g} {declaration.unit}".removesuffix(" 1") if isinstance(value, float) else str(value)
