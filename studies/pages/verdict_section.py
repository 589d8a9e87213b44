"""The first screen, verdict and lights; and the trade-offs: what a small score is paid for with."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.metrics import A_Y_LIMIT, METRICS

from ..ranking.design_metrics import pareto_front
from ..ranking.verdict import law_title
from ..requirements import metric
from .charts import Axis, Chart, Cloud, legend, scatter
from .context import Context, metric_text, name_of
from .shell import Cell, Column, Section, TableRow, bullets, figure, paragraphs, render, table
from .text import number, plural

SYMBOLS: Final = {"good": "\u2713", "warning": "!", "bad": "\u2715", "unknown": "?"}
STATES: Final = {"good": "good", "warning": "caution", "bad": "not met", "unknown": "not known"}
ACROSS: Final = ("jerk_added_peak_p95", "needless", "effort_mean", "within_dtle")
MOST_ROWS: Final = 15
MOST_POINTS: Final = 1500
"""Designs in a chart of points; of more, those that rank first and an even share of the others."""


def section(context: Context) -> Section:
    """The section."""
    chart = trade_off(context, "a_y_added_peak_p95", "S", "trade-off")
    body = render(
        "verdict.html",
        verdict=context.verdict,
        symbols_of=SYMBOLS,
        states=STATES,
        chart=chart.svg,
        key=cloud_legend(context),
        warnings=bullets(_warnings(context), "warnings"),
        scenarios=context.scenario_text(),
        fresh=context.ranking.fresh_scenarios,
        model=context.model_sentence,
    )
    return Section("verdict", "Verdict", body, (chart,), printed=True)


def _warnings(context: Context) -> Iterator[str]:
    report = context.report
    if report.synthetic:
        yield "The scenario model is synthetic: it was fitted to invented driving, not to recordings."
    yield from dict.fromkeys((*report.warnings, *context.ranking.warnings))


def trade_offs(context: Context) -> Section:
    """The section of trade-offs."""
    ranking = context.ranking
    charts = tuple(
        trade_off(context, name, "S", f"trade-off-{name.replace('_', '-')}")
        for name in ACROSS
        if np.isfinite(context.values(name)).any()
    )
    front = np.flatnonzero(ranking.pareto)
    sentence = (
        f"Pareto front over {', '.join(metric(name).title for name in ranking.pareto_metrics)}: "
        f"{plural(front.size, 'design')} that no other ranked design beats in one metric without being worse "
        "in another."
        if ranking.pareto_metrics and ranking.ranked
        else "There is no Pareto front: no design is ranked."
        if ranking.pareto_metrics
        else ""
    )
    body = paragraphs(sentence) + figure(
        charts,
        "Mean S against another metric, one point a design; filled: meets all requirements. The line is the front of "
        "these two metrics alone.",
        cloud_legend(context),
    )
    if front.size:
        names = [name for name in ranking.pareto_metrics if name != "S"]
        columns = [
            Column("Rank"), Column("Design", text=True), Column("Mean S", "m\u00b7s"),
            *(Column(metric(name).title, metric(name).shown_unit) for name in names),
        ]  # fmt: skip
        rows = [
            TableRow(
                (
                    str(ranking.rank[i]),
                    name_of(ranking.designs[i]),
                    number(float(ranking.S[i])),
                    *(Cell(metric_text(name, context.metric(name, i), unit=False)) for name in names),
                ),
                "winner" if i == ranking.winner else "",
            )
            for i in front[:MOST_ROWS].tolist()
        ]
        more = f", the first {MOST_ROWS} of {front.size}" if front.size > MOST_ROWS else ""
        body += table(f"The Pareto front{more}", columns, rows, head=1)
    return Section("trade-offs", "Trade-offs", body, charts)


def trade_off(context: Context, across: str, up: str, name: str) -> Chart:
    """Two metrics of all designs against each other."""
    ranking = context.ranking
    of_x, of_y = METRICS[across], METRICS[up]
    x, y = of_x.scale * context.values(across), of_y.scale * context.values(up)
    known = np.isfinite(x) & np.isfinite(y)
    places = np.flatnonzero(known)
    if places.size > MOST_POINTS:
        first = places[: MOST_POINTS // 2]
        rest = places[MOST_POINTS // 2 :]
        places = np.concatenate([first, rest[:: max(1, rest.size // (MOST_POINTS // 2))]])
    admissible = np.array([not missed for missed in ranking.missed])
    laws = np.array([design.law for design in ranking.designs])
    clouds = []
    for law, style in context.styles.items():
        own = places[laws[places] == law]
        if own.size:
            tips = tuple(
                f"{name_of(ranking.designs[i])}: {of_y.title} {metric_text(up, y[i] / of_y.scale)}, "
                f"{of_x.title} {metric_text(across, x[i] / of_x.scale)}"
                for i in own
            )
            clouds.append(Cloud(x[own], y[own], style, admissible[own], tips))
    signs = np.array([1.0 if one.better == "less" else -1.0 for one in (of_x, of_y)])
    contenders = np.flatnonzero(known & (admissible if (known & admissible).any() else known))
    front = contenders[pareto_front(np.stack([x, y], axis=1)[contenders] * signs)]
    front = front[np.argsort(x[front], kind="stable")]
    limit = limit_of(context, across)
    # far points would squeeze the rest: beyond the limit a logarithm
    wide = known.any() and float(x[known].max()) > 8.0 * max(float(np.median(x[known])), 1e-12)
    log = bool(wide and (x[known] > 0).all())
    ends = x if limit is None else np.append(x, limit * of_x.scale)
    axis = Axis.around(of_x.label, ends[np.isfinite(ends)], log=log, zero=not log)
    i = context.shown
    return scatter(
        name, f"{of_y.title} against {of_x.title}, one point a design", clouds, axis,
        Axis.around(of_y.label, y[known]), limit=None if limit is None else (limit * of_x.scale, "limit"),
        front=(x[front], y[front]), ring=(float(x[i]), float(y[i])),
    )  # fmt: skip


def limit_of(context: Context, name: str) -> float | None:
    """The upper limit of a metric among the requirements; of added acceleration always that of ISO 11270."""
    for one in context.ranking.requirements:
        if one.metric.name == name and one.operator in ("<=", "<"):
            return one.limit
    return A_Y_LIMIT if name == "a_y_added_peak_p95" else None


def cloud_legend(context: Context) -> Markup:
    """Laws of the points, what filling and ring mean."""
    laws = {design.law: design for design in context.ranking.designs}
    shown = [(law_title(design), context.styles[law]) for law, design in laws.items() if not design.is_baseline]
    return legend(shown, points=True)
