"""Gain landscape: mean S over threshold and gains, law by law."""

from __future__ import annotations

from collections.abc import Iterator

from studies.report.context import Context
from studies.report.figures.landscape import color_range, landscapes
from studies.report.figures.landscape_figures import heat_map, profile
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.words import prose


def section(context: Context) -> Section:
    """The section."""
    primary = context.primary
    drawings = tuple(_drawings(context))
    body = render(
        "sections/landscape.html",
        primary=primary,
        raced=primary.race is not None and bool(primary.race.dropped),
        landscape=drawings,
        partial=prose.partial_grids(context.report),
    )
    return Section("landscape", "Gain landscape", body, drawings)


def _drawings(context: Context) -> Iterator[Drawing]:
    designs, table = context.report.results.designs, context.primary
    S_mean = context.ranking.S[context.ranking.index.argsort()]
    framed = [row.index for row in table.best_of_each_law]
    every = list(landscapes(designs, S_mean, table.best.index, framed))
    low, high = color_range(every, table.uncorrected) if every else (0.0, 1.0)
    for i, one in enumerate(every, 1):
        name = f"Mean S of {one.title} over {one.x.name}" + (f" and {one.y.name}" if one.y else "")
        if one.y is None:
            figure = profile(one, context.styles[one.law], table.uncorrected)
        else:
            figure = heat_map(one, low, high, table.uncorrected)
        yield Drawing(f"landscape-{i}", name, figure)
