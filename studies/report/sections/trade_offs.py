"""Trade-offs: any two figures of all designs against each other, and what a release asks for beside S."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import METRICS
from studies.report.context import Context
from studies.report.figures.trade_off_figure import Group, front_of_two, trade_off_figure
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.tables.release_table import against_limits, limits_table
from studies.report.words.metric_text import shown_values
from studies.report.words.text import printable

MOST_POINTS = 600
"""Designs in the figure that stands without script; more make the page heavy and cannot be told apart."""


def section(context: Context) -> Section:
    """The section."""
    x, y = default_axes(context)
    drawing, drawn, places = _scatter(context, x, y)
    body = render(
        "sections/trade-offs.html",
        primary=context.primary,
        limits=limits_table(context.report, context.primary, context.ranking),
        against_limits=against_limits(context.report, context.primary, context.ranking),
        scatter=drawing,
        drawn=drawn,
        finite=len(places),
        limited=bool(context.ranking.require) and bool((context.ranking.rank[places] > 0).any()),
        x=METRICS[x],
        y=METRICS[y],
    )
    return Section(
        "trade-offs",
        "Trade-offs",
        body,
        () if drawing is None else (drawing,),
        data={"x": x, "y": y},
        scripts=("designs.js", "table-columns.js", "details.js", "trade-off-axes.js", "trade-offs.js"),
        styles=("details.css", "trade-offs.css"),
    )


def default_axes(context: Context) -> tuple[str, str]:
    """Two figures of the study's Pareto front that tell designs apart; without one, S and what passengers feel."""
    figures = tuple(dict.fromkeys(context.ranking.pareto_figures))
    if len(figures) < 2:
        return ("S", "a_y_peak_p95") if figures in ((), ("S",)) else ("S", figures[0])
    apart = [name for name in figures[1:] if 2 * _different(context, name) > len(context.ranking)]
    return figures[0], (apart or figures[1:])[0]


def _different(context: Context, name: str) -> int:
    values = shown_values(name, context.ranking)
    return int(np.unique(values[np.isfinite(values)]).size)


def _scatter(context: Context, x: str, y: str) -> tuple[Drawing | None, int, npt.NDArray[np.int64]]:
    """The figure, how many designs are in it, and which have both figures."""
    table, ranking = context.primary, context.ranking
    shown = METRICS[x], METRICS[y]
    values = np.stack([shown_values(name, ranking) * one.scale for name, one in zip((x, y), shown, strict=True)])
    finite = np.flatnonzero(np.isfinite(values).all(axis=0))
    if not finite.size:
        return None, 0, finite
    front = front_of_two(values, ranking.rank > 0, shown[0].better, shown[1].better)
    special = [row.place for row in (table.best, table.baseline, *table.best_of_each_law) if row is not None]
    step = -(-finite.size // MOST_POINTS)
    drawn = np.intersect1d(finite, np.unique(np.concatenate([finite[::step], front, special])))
    groups = []
    for law, style in context.styles.items():
        places = np.array([k for k in drawn if ranking.designs[k].law == law], dtype=np.int64)
        if places.size:
            title = printable(table.rows[int(places[0])].title)
            groups.append(Group(title, style, values[0, places], values[1, places]))
    marked = {
        name: (float(values[0, row.place]), float(values[1, row.place]))
        for name, row in (("winner", table.winner), ("baseline", table.baseline))
        if row is not None and row.place in finite
    }
    figure = trade_off_figure(groups, values[:, front], marked, (shown[0].label, shown[1].label))
    return Drawing("trade-offs", f"{shown[1].title} over {shown[0].title}", figure), drawn.size, finite
