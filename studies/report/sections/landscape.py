"""Gain landscape: mean S over threshold and gains, law by law, and which gain matters."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np
from markupsafe import Markup

from studies.report.context import Context
from studies.report.figures.landscape import color_range
from studies.report.figures.landscape_figures import Landscape, heat_map, profile
from studies.report.figures.landscape_panels import PANELS_OF_A_LAW, Panels, landscape_panels
from studies.report.figures.sample_figure import MOST_POINTS, sample_figure
from studies.report.figures.sensitivity_figure import IndexBar, sensitivity_figure
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.words import prose
from studies.report.words.sensitivity import by_weight, law_of, sensitivity_sentence, weights

if TYPE_CHECKING:
    from studies.sensitivity.sensitivity import BlockSensitivity

MOST_BAR_FIGURES: Final = 8


@dataclasses.dataclass(frozen=True)
class IndexRow:
    """One quantity of one law in the table of indices."""

    law: str
    name: str
    first: tuple[float, float, float]
    total: tuple[float, float, float]
    designs: int
    over: str


def section(context: Context) -> Section:
    """The section."""
    primary, blocks = context.primary, context.report.sensitivity
    panels = _panels(context)
    drawings, bars = tuple(_drawings(context, panels)), tuple(_bars(blocks))
    body = render(
        "sections/landscape.html",
        primary=primary,
        raced=_raced(context),
        landscape=drawings,
        how=_how(context, panels),
        cells=bool(panels.maps),
        panels_of_a_law=PANELS_OF_A_LAW,
        left_out=panels.left_out,
        partial=prose.partial_grids(context.report),
        blocks=blocks,
        sentences=_sentences(blocks),
        bars=bars,
        indices=tuple(_table(blocks)),
    )
    return Section("landscape", "Gain landscape", body, (*drawings, *bars))


def _panels(context: Context) -> Panels:
    known: dict[str, dict[str, float]] = {}
    for block in context.report.sensitivity:
        if block.indices is not None:  # of several tables of a law the first counts
            known.setdefault(block.law, dict(zip(block.names, weights(block).tolist(), strict=True)))
    return landscape_panels(
        context.report.results.designs,
        context.ranking.S[context.ranking.index.argsort()],
        context.primary.best.index,
        [row.index for row in context.primary.best_of_each_law],
        known,
    )


def _raced(context: Context) -> bool:
    race = context.primary.race
    return race is not None and bool(race.dropped)


def _how(context: Context, panels: Panels) -> str:
    """How the panels are read."""
    said = ["Mean S over what the study sweeps; darker is better, on one colour scale for all panels in colour."]
    star = f"the star {context.primary.best_name}"
    if any(isinstance(panel, Landscape) and panel.y is None for panel in panels.shown):
        said.append(f"On a line the marked point is the best design of its law, {star}.")
    if panels.maps:
        missing = "were not run" + (", or given up in the race" if _raced(context) else "")
        said.append(
            "Each value is the least over everything that its panel does not show. A frame marks the best design of "
            f"a law, {star}. Grey, struck-out cells are worse than no control; white ones {missing}."
        )
    if panels.samples:
        said.append(
            "In panels of points every point is one design, for nearly every one has values of its own; its other "
            f"gains are not shown. A ring marks the best design of a law, {star}. Grey crosses are worse than no "
            "control." + (" Designs that the race gave up are not there." if _raced(context) else "")
        )
    if panels.thinned:
        half = MOST_POINTS // 2
        said.append(
            f"Of more than {MOST_POINTS} designs the best {half} are drawn, and {half} others at even steps of the "
            "rank."
        )
    if context.primary.require:
        said.append("Designs that miss a requirement are shown too; a mark takes one only where its law has no other.")
    return " ".join(said)


def _drawings(context: Context, panels: Panels) -> Iterator[Drawing]:
    table = context.primary
    low, high = color_range(panels.shown, table.uncorrected) if panels.shown else (0.0, 1.0)
    for i, one in enumerate(panels.shown, 1):
        name = f"Mean S of {one.title} over {one.x.name}" + (f" and {one.y.name}" if one.y else "")
        if not isinstance(one, Landscape):
            figure = sample_figure(one, low, high, table.uncorrected)
        elif one.y is None:
            figure = profile(one, context.styles[one.law], table.uncorrected)
        else:
            figure = heat_map(one, low, high, table.uncorrected)
        yield Drawing(f"landscape-{i}", name, figure)


def _sentences(blocks: tuple[BlockSensitivity, ...]) -> list[Markup]:
    return [sensitivity_sentence(block, law_of(block, blocks)) for block in blocks]


def _bars(blocks: tuple[BlockSensitivity, ...]) -> Iterator[Drawing]:
    """One figure for each of the first laws with indices."""
    found = [block for block in blocks if block.indices is not None]
    for i, block in enumerate(found[:MOST_BAR_FIGURES], 1):
        title = law_of(block, blocks)
        rows = [IndexBar(row.name, np.array(row.first), np.array(row.total)) for row in _table((block,))]
        yield Drawing(f"sensitivity-{i}", f"Sobol indices of mean S, {title}", sensitivity_figure(rows, title))


def _table(blocks: tuple[BlockSensitivity, ...]) -> Iterator[IndexRow]:
    for block in blocks:
        found = block.indices
        if found is None:
            continue
        for i in by_weight(block).tolist():
            first, total = (
                (float(value[i]), float(low[i]), float(high[i]))
                for value, low, high in (
                    (found.first, found.first_low, found.first_high),
                    (found.total, found.total_low, found.total_high),
                )
            )
            title = law_of(block, blocks)
            yield IndexRow(title, block.names[i], first, total, block.designs, block.interval_over)
