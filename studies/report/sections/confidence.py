"""Confidence: how results settle with the number of scenarios, how many are needed, and what fresh ones say."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from studies.report.context import MOST_CURVES, Context
from studies.report.figures.curves import score_curves
from studies.report.figures.law_intervals import Finalist, finalists_figure
from studies.report.figures.precision import measured_errors
from studies.report.figures.precision_figure import WidthCurve, precision_figure
from studies.report.figures.scores import Curve, convergence_figure, interleaved
from studies.report.look.style import LineStyle
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.tables.finalists import FinalistRow, finalist_rows
from studies.report.tables.rivals import Rival, rivals
from studies.report.tables.row import Row, is_baseline
from studies.report.words.enough_scenarios import enough_sentence
from studies.report.words.prose import between_differences, rank_text
from studies.report.words.text import difference_text, printable

MOST_OF_SET: Final = 12
"""Designs of the set of best in the table of frequencies."""

_MEAN = LineStyle("#333333", (), "X")


@dataclasses.dataclass(frozen=True)
class Frequency:
    """How often a design leads when the scenarios are drawn again."""

    row: Row
    share: float


def section(context: Context) -> Section:
    """The section."""
    table, n = context.primary, len(context.scenarios)
    against, finalists = rivals(context), finalist_rows(table)
    convergence = tuple(_convergence(context))
    precision = tuple(_precision(context, against))
    fresh = tuple(_fresh(table.fresh_scenarios, finalists))
    often = sorted((_frequency(context, row) for row in table.set_of_best), key=lambda one: -one.share)
    first = "the first of the ranking" if table.ranked else "the design with the lowest mean S"
    body = render(
        "sections/confidence.html",
        primary=table,
        n=n,
        convergence=convergence,
        precision=precision,
        sentences=[enough_sentence(one, first, n) for one in against],
        fresh=fresh,
        finalists=finalists,
        often=often[:MOST_OF_SET],
        rest=often[MOST_OF_SET:],
        rest_share=math.fsum(one.share for one in often[MOST_OF_SET:]),
        difference_text=difference_text,
        between_differences=between_differences,
        outside=1.0 - math.fsum(one.share for one in often),
    )
    drawings = (*convergence, *precision, *fresh)
    return Section("confidence", "Confidence", body, drawings, styles=("confidence.css",))


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
    others = [row for row in _beside(context) if row.index != table.best.index]
    if others:
        named = [
            Curve(f"{printable(row.title)}, {rank_text(row)}", style, context.S(row) - S_best)
            for row, style in zip(others, _styles(context, others), strict=True)
        ]
        beside = table.best_name if table.ranked or table.winner else "the lowest mean S"
        title, label = f"Paired difference to {beside}", "Mean paired difference of S [m·s]"
        figure = convergence_figure(named, order, title, label)
        yield Drawing("convergence-difference", f"Running mean of the paired difference to {table.best_name}", figure)


def _beside(context: Context) -> tuple[Row, ...]:
    """The first design of the ranking beside the best, and the best of each other law."""
    second = [row for row in context.primary.rows if row is not context.primary.best][:1]
    chosen = {row.index: row for row in (*second, *context.shown[1:]) if not is_baseline(row)}
    return tuple(sorted(chosen.values(), key=lambda row: row.place))[:MOST_CURVES]


def _styles(context: Context, rows: list[Row]) -> list[LineStyle]:
    """Each law's own style; a second design of a law gets another dash."""
    seen: dict[str, int] = {}
    styles = []
    for row in rows:
        style = context.styles[row.design.law]
        again = seen.get(row.design.law, 0)
        styles.append(dataclasses.replace(style, dash=(1.0, 1.0)) if again else style)
        seen[row.design.law] = again + 1
    return styles


def _precision(context: Context, against: tuple[Rival, ...]) -> Iterator[Drawing]:
    """Half widths over the number of scenarios."""
    first = context.primary.first
    half = 0.5 * (first.S.high - first.S.low)
    curves = [_width(context, f"mean S, {printable(first.title)}", _MEAN, context.S(first), half)]
    styles = _styles(context, [first, *(one.row for one in against)])[1:]
    for one, style in zip(against, styles, strict=True):
        label = f"difference to {printable(one.row.title)}, {rank_text(one.row)}"
        curve = _width(context, label, style, one.values, one.half_width)
        if curve is not None and not one.same:
            curve = dataclasses.replace(curve, difference=abs(one.difference.value), needed=one.needed.even)
        curves.append(None if one.same else curve)
    drawn = [curve for curve in curves if curve is not None]
    if drawn:
        title = "Half width of intervals"
        yield Drawing("precision", f"{title} over the number of scenarios", precision_figure(drawn, title))


def _width(
    context: Context, label: str, style: LineStyle, values: npt.NDArray[np.float64], half: float
) -> WidthCurve | None:
    """Measured half widths with the critical value of all scenarios; None where there is no spread."""
    count, error = measured_errors(values, context.scenarios.side)
    if count.size == 0 or not (0.0 < half < math.inf) or not np.all(error > 0.0):
        return None
    return WidthCurve(label, style, count, error * (half / error[-1]))


def _fresh(scenarios: int, finalists: tuple[FinalistRow, ...]) -> Iterator[Drawing]:
    """Search and fresh scores of the finalists."""
    if finalists:
        some = [Finalist(f"{one.row.rank}  {printable(one.row.title)}", one.row.S, one.fresh) for one in finalists]
        title = f"Finalists on {scenarios:,} fresh departures"
        yield Drawing("finalists", f"{title} and where they were chosen", finalists_figure(some, title))


def _frequency(context: Context, row: Row) -> Frequency:
    return Frequency(row, float(context.ranking.best_frequency[row.place]))
