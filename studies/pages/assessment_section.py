"""Tests of regulations and Euro NCAP: the grid of cells with its lights, score, and what could not be assessed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.errors import LdcError
from ldctoolkit.version import __version__

from ..assessment import QUANTITIES, Assessment, LightName, stored_assessment
from ..ranking.verdict import design_name
from ..standards import KM_H, standard_names
from ..storage.files import write_text
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
    required = [one.metric.name for one in context.ranking.requirements]
    names = [name for name in dict.fromkeys(required) if name in standard_names()]
    design, setup = context.ranking.designs[context.shown], context.report.setup
    if not names:
        return None
    body = paragraphs(f"{design_name(design)}, on the study's plant.")
    slow = design.batch < USUAL_BATCH
    if slow:
        body += paragraphs("As stated only, since the law takes long: ldc assess drives the corners too.")
    for name in names:
        try:
            found = stored_assessment(context.report.folder, design, name, setup, tolerances=not slow)
        except LdcError as error:
            body += paragraphs(f"{name}: {error}.")
        else:
            body += Markup("<h3>{}</h3>").format(found.standard.title) + assessed(found)
    return Section("standards", "Standards", body, printed=True)


def assessed(found: Assessment) -> Markup:
    """One design in one test."""
    standard = found.standard
    return (
        paragraphs(*_sentences(found))
        + Markup("").join(_grids(found))
        + bullets(_reasons(found))
        + bullets(f"Not assessable: {one.what}. Why: {one.why}." for one in standard.not_assessable)
        + paragraphs(f"Source{' (second hand)' if standard.second_hand else ''}: {standard.source}.")
    )


def score_text(found: Assessment) -> str:
    """The scores in a line."""
    tested = len(found.variants) > 1
    robust = f", {percent(found.robust_score, 0)} at every corner" if tested else ""
    extended = found.extended_score
    points = "" if math.isnan(extended) else f"; extended range {percent(extended, 0)} of its points"
    return f"{percent(found.score, 0)} of the standard cells pass as stated{robust}{points}"


def _sentences(found: Assessment) -> Iterator[str]:
    yield f"{score_text(found)}."
    if len(found.variants) > 1:
        yield (
            f"Corners: {plural(len(found.variants) - 1, 'variant')} of speed, lateral velocity, vehicle and camera "
            "noise. In each cell stand the value as stated and, in brackets, the worst one; a dash where the condition "
            "does not apply."
        )
    if solves := int(found.failed_solves.sum()):
        yield f"{plural(solves, 'command')} came from a law's fallback."


def _grids(found: Assessment) -> Iterator[Markup]:
    """A table for each set of columns: speeds down, lateral velocities or accelerations across."""
    cells, place = found.cells, {}
    for i in range(cells.n):
        place[float(cells.speed[i]), float(cells.second[i])] = i
    shapes: dict[tuple[float, ...], list[float]] = {}
    for speed in np.unique(cells.speed).tolist():
        own = tuple(sorted(second for other, second in place if other == speed))
        shapes.setdefault(own, []).append(speed)
    for seconds, speeds in shapes.items():
        unit = "m/s\u00b2" if cells.bend[place[speeds[0], seconds[0]]] else "m/s"
        columns = [Column("Speed", "km/h"), *(Column(f"{second:g}", unit) for second in seconds)]
        rows = [Row([f"{speed / KM_H:.0f}", *(_cell(found, place[speed, v]) for v in seconds)]) for speed in speeds]
        titles = (
            f"{QUANTITIES[one.quantity].title} [{QUANTITIES[one.quantity].unit}]" for one in found.standard.condition
        )
        yield to_html(Table("; ".join(titles), columns, rows))


def _cell(found: Assessment, i: int) -> Cell:
    kind, symbol, meaning = _SHOWN[found.lights[i]]
    parts = []
    for c, one in enumerate(found.standard.condition):
        digits, value = QUANTITIES[one.quantity].digits, float(found.values[0, c, i])
        worst = float(found.worst(c)[0][i])
        more = f"\u00a0({number(worst, digits)})" if len(found.variants) > 1 and math.isfinite(worst) else ""
        parts.append(number(value, digits) + more)
    mark = Markup('<span class="light {}" role="img" aria-label="{}">{}</span> {}')
    return Cell(text=mark.format(kind, meaning, symbol, symbols("; ".join(parts))))


def _reasons(found: Assessment) -> Iterator[str]:
    """Why cells are not green, red ones first."""
    for light in ("red", "amber"):
        some = [i for i in range(found.cells.n) if found.lights[i] == light]
        for i in some[:MOST_REASONS]:
            extended = ", extended" if found.cells.extended[i] else ""
            yield f"{found.cells.name(i)}{extended}: {light}. {found.reason(i)}."
        if len(some) > MOST_REASONS:
            yield f"And {len(some) - MOST_REASONS} more {light} cells."


def scores(found: Sequence[tuple[str, Assessment]]) -> Table:
    """The scores of named designs in tests; at every corner of the tolerances, where they were driven."""
    columns = [
        Column("Design", text=True), Column("Test", text=True), Column("Standard cells", "%", ".0f"),
        Column("At every corner", "%", ".0f"), Column("Extended points", "%", ".0f"), Column("Green"), Column("Amber"),
        Column("Red"),
    ]  # fmt: skip
    rows = []
    for name, one in found:
        robust = one.robust_score if len(one.variants) > 1 else math.nan
        shares = [100.0 * share for share in (one.score, robust, one.extended_score)]
        rows.append(Row([name, one.standard.name, *shares, *(one.lights.count(light) for light in _SHOWN)]))
    return Table("Each design in each test", columns, rows)


def write_assessment_page(found: Sequence[tuple[str, Assessment]], path: str | Path) -> Path:
    """Write the page of named designs in tests: one HTML file that needs nothing else, whole or not at all."""
    sections = [Section("verdict", "Scores", to_html(scores(found)))]
    several = len({name for name, _ in found}) > 1
    for k, (name, one) in enumerate(found, 1):
        title = f"{name}: {one.standard.title}" if several else one.standard.title
        sections.append(Section(f"test-{k}", title, assessed(one)))
    html = make_page(
        kind="Lane departure correction: tests of regulations and Euro NCAP",
        title="Tests of designs",
        heading="Tests of designs",
        facts=(plural(len({name for name, _ in found}), "design"), plural(len(found), "assessment")),
        sections=sections,
        footer=f"Predicted by simulation. ldctoolkit {__version__}.",
    )
    write_text(Path(path), html)
    return Path(path)
