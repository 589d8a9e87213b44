"""Tests of regulations and Euro NCAP: the grid of cells with its lights, score, and what could not be assessed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import INTENTS
from ldctoolkit.version import __version__

from ..assessment import QUANTITIES, Assessment, LightName, stored_assessment
from ..ranking.verdict import design_name
from ..standards import KM_H, QuantityName, standard_names
from ..storage.folder_files import write_text
from ..tables import Cell, Column, Row, Table, to_html
from ..text import number, percent, plural, symbols
from .context import Context
from .shell import Section, bullets, make_page, paragraphs

MOST_REASONS: Final = 40
USUAL_BATCH: Final = 1000  # departures that a law drives together; one that takes long asks for fewer

_SHOWN: Final[dict[LightName, tuple[str, str, str]]] = {
    "green": ("good", "\u2713", "passes at every corner"),
    "amber": ("warning", "!", "passes as stated, fails at a corner"),
    "red": ("bad", "\u2715", "fails as stated"),
}


def section(context: Context) -> Section | None:
    """The tests that the study requires, of the design that the page speaks of; nothing where it requires none."""
    required = [requirement.metric.name for requirement in context.ranking.requirements]
    names = [name for name in dict.fromkeys(required) if name in standard_names()]
    design, setup = context.ranking.designs[context.shown], context.report.setup
    if not names:
        return None
    body = paragraphs(f"{design_name(design)}, on the study's plant.")
    if design in context.results.unsafe:
        return Section("standards", "Standards", body + paragraphs("It ended or held up its process: not driven here."))
    slow = design.batch < USUAL_BATCH
    if slow:
        body += paragraphs("As stated only, since the law takes long: ldc assess drives the corners too.")
    for name in names:
        try:
            assessment = stored_assessment(context.report.folder, design, name, setup, tolerances=not slow)
        except LdcError as error:
            body += paragraphs(f"{name}: {error}.")
        else:
            body += Markup("<h3>{}</h3>").format(assessment.standard.title) + assessed(assessment)
    return Section("standards", "Standards", body, printed=True)


def assessed(assessment: Assessment) -> Markup:
    """One design in one test."""
    standard = assessment.standard
    return (
        paragraphs(*_assessment_sentences(assessment))
        + Markup("").join(_grids(assessment))
        + bullets(_reasons(assessment))
        + bullets(f"Not assessable: {part.what}. Why: {part.why}." for part in standard.not_assessable)
        + paragraphs(f"Source{' (second hand)' if standard.second_hand else ''}: {standard.source}.")
    )


def score_text(assessment: Assessment) -> str:
    """The scores in a line."""
    tested = len(assessment.variants) > 1
    robust = f", {percent(assessment.robust_score, 0)} at every corner" if tested else ""
    extended = assessment.extended_score
    points = "" if math.isnan(extended) else f"; extended range {percent(extended, 0)} of its points"
    return f"{percent(assessment.score, 0)} of the standard cells pass as stated{robust}{points}"


_DRIVEN: Final[dict[QuantityName, str]] = {
    "driver_torque_peak": "the overriding torque is the largest one of a driver who means to leave the lane (against)",
    "against_parallel": "the time against the driver is the longest of all these intents in the cell",
}


def condition_sentences(assessment: Assessment) -> Iterator[str]:
    """How many conditions hold where not all have to, and with which driver those on a driver's torque are assessed."""
    conditions, held, driver = assessment.standard.condition, assessment.held, assessment.driver
    if (required := assessment.standard.required) is not None:
        least, total = required
        yield (
            f"{least} of {total} conditions have to hold. {len(conditions)} can be assessed, and {held} of these hold "
            f"in every standard cell as stated: {least} are {'reached' if held >= least else 'not reached'}."
        )
    if asked := {condition.quantity for condition in conditions} & _DRIVEN.keys():
        shares = zip(INTENTS, driver.shares, strict=True)
        intents = ", ".join(f"{name} {percent(share, 0)}" for name, share in shares if share)
        yield (
            f"With the driver model of [plant.driver] ({driver.model}; {intents}): "
            f"{', '.join(text for name, text in _DRIVEN.items() if name in asked)}. The other conditions are assessed "
            "without a driver."
        )


def _assessment_sentences(assessment: Assessment) -> Iterator[str]:
    yield f"{score_text(assessment)}."
    yield from condition_sentences(assessment)
    if len(assessment.variants) > 1:
        yield (
            f"Corners: {plural(len(assessment.variants) - 1, 'variant')} of speed, lateral velocity, vehicle and "
            "camera noise. In each cell stand the value as stated and, in brackets, the worst one; a dash where the "
            "condition does not apply."
        )
    if solves := int(assessment.failed_solves.sum()):
        yield f"{plural(solves, 'command')} came from a law's fallback."


def _grids(assessment: Assessment) -> Iterator[Markup]:
    """A table for each set of columns: speeds down, lateral velocities or accelerations across."""
    cells, cell_numbers = assessment.cells, {}
    for i in range(cells.n):
        cell_numbers[float(cells.speed[i]), float(cells.second[i])] = i
    shapes: dict[tuple[float, ...], list[float]] = {}
    for speed in np.unique(cells.speed).tolist():
        seconds = tuple(sorted(second for speed_of_cell, second in cell_numbers if speed_of_cell == speed))
        shapes.setdefault(seconds, []).append(speed)
    for seconds, speeds in shapes.items():
        unit = "m/s\u00b2" if cells.bend[cell_numbers[speeds[0], seconds[0]]] else "m/s"
        columns = [Column("Speed", "km/h"), *(Column(f"{second:g}", unit) for second in seconds)]
        numbers = [[cell_numbers[speed, second] for second in seconds] for speed in speeds]
        rows = [
            Row([f"{speed / KM_H:.0f}", *(_cell(assessment, i) for i in row)])
            for speed, row in zip(speeds, numbers, strict=True)
        ]
        titles = (
            f"{QUANTITIES[condition.quantity].title} [{QUANTITIES[condition.quantity].unit}]"
            for condition in assessment.standard.condition
        )
        yield to_html(Table("; ".join(titles), columns, rows))


def _cell(assessment: Assessment, i: int) -> Cell:
    kind, symbol, meaning = _SHOWN[assessment.lights[i]]
    parts = []
    for c, condition in enumerate(assessment.standard.condition):
        digits, value = QUANTITIES[condition.quantity].digits, float(assessment.values[0, c, i])
        worst = float(assessment.worst(c)[0][i])
        several = len(assessment.variants) > 1 and math.isfinite(worst)
        in_brackets = f"\u00a0({number(worst, digits)})" if several else ""
        parts.append(number(value, digits) + in_brackets)
    mark = Markup('<span class="light {}" role="img" aria-label="{}">{}</span> {}')
    return Cell(text=mark.format(kind, meaning, symbol, symbols("; ".join(parts))))


def _reasons(assessment: Assessment) -> Iterator[str]:
    """Why cells are not green, red ones first."""
    for light in ("red", "amber"):
        cells = [i for i in range(assessment.cells.n) if assessment.lights[i] == light]
        for i in cells[:MOST_REASONS]:
            extended = ", extended" if assessment.cells.extended[i] else ""
            yield f"{assessment.cells.name(i)}{extended}: {light}. {assessment.reason(i)}."
        if len(cells) > MOST_REASONS:
            yield f"And {len(cells) - MOST_REASONS} more {light} cells."


def scores(assessments: Sequence[tuple[str, Assessment]], *, titles: bool = False) -> Table:
    """The scores of named designs in tests, at the corners too where these were driven; tests by name or title."""
    columns = [
        Column("Design", text=True), Column("Test", text=True), Column("Standard cells", "%", ".0f"),
        Column("At every corner", "%", ".0f"), Column("Extended points", "%", ".0f"), Column("Green"), Column("Amber"),
        Column("Red"),
    ]  # fmt: skip
    rows = []
    for name, assessment in assessments:
        robust = assessment.robust_score if len(assessment.variants) > 1 else math.nan
        shares = [100.0 * share for share in (assessment.score, robust, assessment.extended_score)]
        test = assessment.standard.title if titles else assessment.standard.name
        rows.append(Row([name, test, *shares, *(assessment.lights.count(light) for light in _SHOWN)]))
    return Table("Each design in each test", columns, rows)


def write_assessment_page(assessments: Sequence[tuple[str, Assessment]], path: str | Path) -> Path:
    """Write the page of named designs in tests: one HTML file that needs nothing else, whole or not at all."""
    sections = [Section("verdict", "Scores", to_html(scores(assessments, titles=True)))]
    several = len({name for name, _ in assessments}) > 1
    for k, (name, assessment) in enumerate(assessments, 1):
        title = f"{name}: {assessment.standard.title}" if several else assessment.standard.title
        sections.append(Section(f"test-{k}", title, assessed(assessment)))
    html = make_page(
        kind="Lane departure correction: tests of regulations and Euro NCAP",
        title="Tests of designs",
        heading="Tests of designs",
        facts=(plural(len({name for name, _ in assessments}), "design"), plural(len(assessments), "assessment")),
        sections=sections,
        footer=f"Predicted by simulation. ldctoolkit {__version__}.",
    )
    write_text(Path(path), html)
    return Path(path)
