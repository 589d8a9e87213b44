"""Confidence: how mean S and paired differences settle with the number of scenarios."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from studies.report.context import MOST_CURVES, Context
from studies.report.figures.curves import score_curves
from studies.report.figures.scores import Curve, convergence_figure, interleaved
from studies.report.look.style import LineStyle
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.tables.row import Row, is_baseline
from studies.report.words.prose import rank_text
from studies.report.words.text import printable


def section(context: Context) -> Section:
    """The section."""
    drawings = tuple(_convergence(context))
    body = render("sections/confidence.html", primary=context.primary, convergence=drawings)
    return Section("confidence", "Confidence", body, drawings)


def _convergence(context: Context) -> Iterator[Drawing]:
    """Running mean of S, and of the paired difference to the best."""
    n, table = context.scenarios.n, context.primary
    if n < 2:
        return
    order = interleaved(context.scenarios.side)
    curves = score_curves(context, context.shown or (table.best,), np.ones(n, dtype=bool), recorded=False)
    figure = convergence_figure(curves, order, "Mean score", "Mean S [m·s]")
    yield Drawing("convergence-mean", "Running mean of S with a 95 % band", figure)
    S_best = context.S(table.best)
    others = [row for row in _rivals(context) if row.index != table.best.index]
    if others:
        named = [
            Curve(f"{printable(row.title)}, {rank_text(row)}", style, context.S(row) - S_best)
            for row, style in zip(others, _rival_styles(context, others), strict=True)
        ]
        title, label = f"Paired difference to {table.best_name}", "Mean paired difference of S [m·s]"
        figure = convergence_figure(named, order, title, label)
        yield Drawing("convergence-difference", f"Running mean of the paired difference to {table.best_name}", figure)


def _rivals(context: Context) -> tuple[Row, ...]:
    """The first design of the ranking beside the best, and the best of each other law."""
    second = [row for row in context.primary.rows if row is not context.primary.best][:1]
    chosen = {row.index: row for row in (*second, *context.shown[1:]) if not is_baseline(row)}
    return tuple(sorted(chosen.values(), key=lambda row: row.place))[:MOST_CURVES]


def _rival_styles(context: Context, rows: list[Row]) -> list[LineStyle]:
    """Each law's own style; a second design of a law gets another dash."""
    seen: dict[str, int] = {}
    styles = []
    for row in rows:
        style = context.styles[row.design.law]
        again = seen.get(row.design.law, 0)
        styles.append(dataclasses.replace(style, dash=(1.0, 1.0)) if again else style)
        seen[row.design.law] = again + 1
    return styles
