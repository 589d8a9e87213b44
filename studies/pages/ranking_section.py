"""The ranking as a table, and the limits: what each asks, and what the designs have."""

import math
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.metrics import METRICS

from ..ranking.verdict import RANKING_METRICS, gains_text, judged, law_title, set_of_best_line
from ..requirements import metric
from .context import Context, interval, metric_text
from .shell import Cell, Column, Section, TableRow, render, table
from .text import compact, number, percent, plural, true_minus

MOST_ROWS: Final = 1000  # designs of the table; all of them are in ranking.csv
FIRST_ROWS: Final = 20  # rows that are shown before all are requested, and those that are printed


def section(context: Context) -> Section:
    """The section."""
    ranking = context.ranking
    named = [place for place in (ranking.winner, ranking.baseline) if place is not None]
    kept = {*named, *context.best_of_each_law, *np.flatnonzero(ranking.pareto)[:100].tolist()}
    places = [i for i in range(len(ranking)) if i < MOST_ROWS or i in kept]
    level = percent(ranking.confidence, 0)
    columns = [
        Column("Rank", key="rank"),
        Column("Law", text=True),
        Column("y_s", "m", key="y_s", about="Trigger threshold"),
        Column("Gains", text=True, about="Gains that differ from their defaults"),
        Column("Mean S", "m\u00b7s", key="S"),
        Column(f"{level} interval", "m\u00b7s", about="Of mean S, for all designs at once"),
        Column("Reduction", "%", key="reduction", about="Of mean S against no control"),
        Column("a_y p95", "m/s\u00b2", key="a_y", about=METRICS["a_y_added_peak_p95"].title),
        Column("Jerk p95", "m/s\u00b3", key="jerk", about=METRICS["jerk_added_peak_p95"].title),
        Column("Needless", "%", key="needless", about=METRICS["needless"].title),
    ]
    if ranking.fresh_scenarios:
        columns.append(Column("Fresh S", "m\u00b7s", key="fresh", about="Mean S on the fresh scenarios"))
    columns.append(Column("Verdict", text=True))
    rows = table(
        f"{plural(len(ranking), 'design')}, {ranking.label}", columns,
        (_line(context, place, place in named) for place in places), id="designs", sortable=True, head=1,
    )  # fmt: skip
    body = render(
        "ranking.html",
        table=rows,
        count=len(ranking),
        listed=len(places),
        later=len(places) - sum(_shown_first(place, place in named) for place in places),
        set_of_best=set_of_best_line(ranking),
    )
    return Section("ranking", "Ranking", body, scripts=("table.js",), printed=True)


def _shown_first(place: int, named: bool) -> bool:
    return named or place < FIRST_ROWS


def _line(context: Context, i: int, named: bool) -> TableRow:
    ranking, design = context.ranking, context.ranking.designs[i]
    missed = {miss.requirement.metric.name for miss in ranking.missed[i]}
    cells: list[Cell | str] = [
        Cell(str(ranking.rank[i]) if ranking.rank[i] else "\u2013", float(ranking.rank[i]) or math.nan),
        law_title(design),
        Cell(compact(design.y_s), design.y_s),
        true_minus(gains_text(design, "\u00a0=\u00a0")),
        Cell(number(float(ranking.S[i]), METRICS["S"].digits), float(ranking.S[i])),
        Cell(interval(float(ranking.S_low[i]), float(ranking.S_high[i])) or "\u2013", float(ranking.S_low[i])),
    ]
    for name in RANKING_METRICS:
        value = context.metric(name, i)
        shown = Cell(metric_text(name, value, unit=False), METRICS[name].scale * value, bad=name in missed)
        cells.append(shown)
    if ranking.fresh_scenarios:
        fresh = float(ranking.fresh_S[i])
        cells.append(Cell(number(fresh, METRICS["S"].digits), fresh))
    cells.append(Cell(judged(ranking, i), bad=bool(missed)))
    kinds = ["winner" if i == ranking.winner else "", "baseline" if i == ranking.baseline else ""]
    kinds += ["kept"] if named else ["far"] if i >= FIRST_ROWS else []
    return TableRow(tuple(cells), " ".join(filter(None, kinds)), later=not _shown_first(i, named))


# ------------------------------------------------------------------------------------------------ limits


def limits_section(context: Context) -> Section:
    """What each requirement asks, what the shown design and no control have, and how many designs meet it."""
    ranking, i, without = context.ranking, context.shown, context.no_control
    columns = [
        Column("Metric", text=True),
        Column("Limit"),
        Column("Set", text=True),
        Column(_title(context)),
        Column("No control"),
        Column("Designs that meet it"),
    ]

    def value(name: str, place: int | None) -> str:
        return "\u2013" if place is None else metric_text(name, context.metric(name, place))

    rows, ends = [], []
    for one, there in zip(ranking.limits, ranking.estimates(i), strict=True):
        met = one.met(context.values(one.metric.name))
        own = Cell(value(one.metric.name, i), bad=not met[i], good=bool(met[i]))
        limit = f"{_operator(one.operator)} {_limit_text(one.metric.name, one.limit)}"
        origin = (one.set or "own") if there.required else f"{one.set} (not required)"
        cells = one.metric.title, limit, origin, own, value(one.metric.name, without), f"{int(met.sum()):,}"
        rows.append(TableRow(cells))
        if there.interval:
            shown = Cell(metric_text(one.metric.name, there.value), bad=not there.met, good=not there.uncertain)
            ends.append(TableRow((one.metric.title, limit, shown, there.interval)))
    caption = f"{_title(context)} on {ranking.sample(i)}, each metric with an interval of its own"
    heads = [*columns[:2], Column("Value"), Column(f"{percent(ranking.confidence, 0)} interval")]
    body = render(
        "limits.html",
        table=table("Limits", columns, rows),
        certainty=table(caption, heads, ends) if ends else "",
        metrics=_named_metrics(context),
        recorded=context.verdict.recorded,
        recorded_text=percent(context.verdict.recorded),
    )
    return Section("limits", "Limits", body, printed=True)


def _operator(operator: str) -> str:
    return {"<=": "\u2264", ">=": "\u2265"}.get(operator, operator)


def _limit_text(name: str, limit: float) -> str:
    one = metric(name)
    unit = f"\u00a0{one.shown_unit}" if one.shown_unit else ""
    return f"{compact(float(f'{one.scale * limit:.4g}'))}{unit}"


def _title(context: Context) -> str:
    return "Winner" if context.ranking.winner is not None else "First design"


def _named_metrics(context: Context) -> Markup:
    """Every metric of the shown design beside no control and the baseline."""
    ranking, i = context.ranking, context.shown
    others = [("No control", context.no_control)]
    if ranking.baseline is not None and ranking.baseline not in (i, context.no_control):
        others.append(("Baseline", ranking.baseline))
    columns = [Column("Metric", text=True), Column(_title(context)), *(Column(name) for name, _ in others)]
    rows = []
    for name, one in METRICS.items():
        try:
            values = [context.metric(name, i), *(math.nan if j is None else context.metric(name, j) for _, j in others)]
        except LookupError:
            continue
        if any(math.isfinite(value) for value in values):
            rows.append(TableRow((one.title, *(metric_text(name, value) for value in values))))
    return table("All metrics", columns, rows)
