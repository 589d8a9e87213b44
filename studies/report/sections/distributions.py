"""Distributions over the departures: scores with and without control, left and right."""

from __future__ import annotations

from collections.abc import Iterator

from ldctoolkit.departures import LEFT, RIGHT
from studies.report.context import Context
from studies.report.figures.curves import score_curves
from studies.report.figures.examples import SIDE_NAMES
from studies.report.figures.scores import distribution_figure, sides_figure, sides_limit
from studies.report.rendering import render
from studies.report.section import Drawing, Section


def section(context: Context) -> Section:
    """The section."""
    sides, distribution = tuple(_sides(context)), tuple(_distribution(context))
    body = render("sections/distributions.html", sides=sides, distribution=distribution)
    return Section("distributions", "Distributions", body, (*sides, *distribution))


def _present(context: Context) -> list[int]:
    return [side for side in (LEFT, RIGHT) if (context.scenarios.side == side).any()]


def _sides(context: Context) -> Iterator[Drawing]:
    """The paper's bar figure."""
    rows, paper, of = list(context.shown), context.primary.paper_design, context.scenarios.side
    if paper is not None and paper.index not in {row.index for row in rows}:
        rows.append(paper)
    curves = {side: score_curves(context, rows, of == side) for side in _present(context)}
    limit = max(sides_limit(some) for some in curves.values())
    for side, some in curves.items():
        title = f"{SIDE_NAMES[side]} departures ({int((of == side).sum()):,})"
        name = f"score-{SIDE_NAMES[side].lower()}"
        yield Drawing(name, f"Mean and spread of S, {title}", sides_figure(some, title, limit))


def _distribution(context: Context) -> Iterator[Drawing]:
    """Distribution of S over the departures of each side."""
    for side in _present(context):
        title = f"{SIDE_NAMES[side]} departures"
        figure = distribution_figure(score_curves(context, context.shown, context.scenarios.side == side), title)
        yield Drawing(f"distribution-{SIDE_NAMES[side].lower()}", f"Distribution of S, {title}", figure)
