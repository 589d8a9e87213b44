"""The first screen, verdict and lights; and the trade-offs: what a small score is paid for with."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.metrics import A_Y_LIMIT

from ..ranking.design_metrics import pareto_front
from ..ranking.ranking import Ranking
from ..ranking.verdict import Light, design_name, law_title
from ..requirements import metric, metric_values
from ..tables import Column, Row, Table, to_html
from ..text import plural
from .charts import Axis, Chart, Series, Style, legend
from .context import Context, metric_text
from .shell import Section, bullets, figure, paragraphs, render

SYMBOLS: Final = {"good": "\u2713", "warning": "!", "bad": "\u2715", "unknown": "?"}
STATES: Final = {"good": "good", "warning": "caution", "bad": "not met", "unknown": "not known"}
ACROSS: Final = ("jerk_added_peak_p95", "needless", "effort_mean", "within_dtle")
MOST_ROWS: Final = 15
MOST_POINTS: Final = 1500
"""Designs in a chart of points; of more, those that rank first and an even share of the others."""


def section(context: Context) -> Section:
    """The section."""
    chart = trade_off(context, "a_y_added_peak_p95", "trade-off")
    body = render(
        "verdict.html",
        verdict=context.verdict,
        lights=lights_list(context.verdict.lights),
        chart=chart.svg,
        key=cloud_legend(context),
        warnings=bullets(_report_warnings(context), "warnings"),
        scenarios=context.scenario_text(),
        fresh=context.ranking.fresh.scenarios,
        model=context.model_sentence,
    )
    return Section("verdict", "Verdict", body, (chart,), printed=True)


def lights_list(lights: Sequence[Light]) -> Markup:
    """Lights with their reasons; nothing without one."""
    return render("lights.html", lights=lights, symbols_of=SYMBOLS, states=STATES) if lights else Markup()


def _report_warnings(context: Context) -> Iterator[str]:
    report = context.report
    if report.synthetic:
        yield "The scenario model is synthetic: it was fitted to invented driving, not to recordings."
    yield from dict.fromkeys((*report.warnings, *context.ranking.warnings))


def trade_offs(context: Context) -> Section:
    """The section of trade-offs."""
    ranking = context.ranking
    charts = tuple(
        trade_off(context, name, f"trade-off-{name.replace('_', '-')}")
        for name in ACROSS
        if np.isfinite(context.values(name)).any()
    )
    front = np.flatnonzero(ranking.pareto)
    sentence = (
        f"Pareto front over {'; '.join(metric(name).title for name in ranking.pareto_metrics)}: "
        f"{plural(front.size, 'design')} to which no other ranked design is better in one of these metrics without "
        "being worse in another."
        if ranking.pareto_metrics and ranking.ranked
        else "There is no Pareto front: no design is ranked."
        if ranking.pareto_metrics
        else ""
    )
    body = paragraphs(sentence) + figure(
        charts,
        "One point per design: mean S against another metric. Filled points meet all requirements. The line is the "
        "Pareto front of these two metrics alone.",
        cloud_legend(context),
    )
    if front.size:
        names = ["S", *(name for name in ranking.pareto_metrics if name != "S")]
        columns = [Column("Rank"), Column("Design", text=True)]
        columns += [Column(of.title, of.shown_unit, f".{of.digits}f") for of in map(metric, names)]
        numbers = np.stack([metric(name).scale * context.values(name) for name in names], axis=1)
        rows = [
            Row([int(ranking.rank[i]), design_name(ranking.designs[i]), *numbers[i].tolist()],
                "winner" if i == ranking.winner else "")
            for i in front[:MOST_ROWS].tolist()
        ]  # fmt: skip
        more = f", the first {MOST_ROWS} of {front.size}" if front.size > MOST_ROWS else ""
        body += to_html(Table(f"The Pareto front{more}", columns, rows, head=1))
    return Section("trade-offs", "Trade-offs", body, charts, printed=True)


def trade_off(context: Context, across: str, name: str) -> Chart:
    """Mean S of all designs against another metric, with its limit."""
    limit = limit_of(context, across)
    chart = scatter_of_metrics(context.ranking, across, "S", context.styles, context.shown, limit, MOST_POINTS)
    return dataclasses.replace(chart, name=name)


def scatter_of_metrics(
    ranking: Ranking, across: str, up: str, styles: Mapping[str, Style], marked: int | None,
    limit: float | None = None, most: int | None = None,
) -> Chart:  # fmt: skip
    """Two metrics of all designs, or of `most`, against each other, with the Pareto front of the two."""
    of_x, of_y = metric(across), metric(up)
    x, y = (of.scale * metric_values(of.name, ranking) for of in (of_x, of_y))
    finite = np.isfinite(x) & np.isfinite(y)
    positions = np.flatnonzero(finite)
    if most is not None and positions.size > most:
        rest = positions[most // 2 :]
        positions = np.concatenate([positions[: most // 2], rest[:: max(1, rest.size // (most // 2))]])
    admissible = np.array([not missed for missed in ranking.missed])
    laws = np.array([design.law for design in ranking.designs])
    clouds = []
    for law, style in styles.items():
        rows = positions[laws[positions] == law]
        if rows.size:
            tips = tuple(
                f"{design_name(ranking.designs[i])}: {of_y.title} {metric_text(up, y[i] / of_y.scale)}, "
                f"{of_x.title} {metric_text(across, x[i] / of_x.scale)}"
                for i in rows
            )
            title = law_title(ranking.designs[rows[0]])
            clouds.append(Series(title, x[rows], y[rows], style, kind="points", filled=admissible[rows], tips=tips))
    signs = np.array([1.0 if of.better == "less" else -1.0 for of in (of_x, of_y)])
    contenders = np.flatnonzero(finite & (admissible if (finite & admissible).any() else finite))
    costs = np.stack([x, y], axis=1) * signs
    front = contenders[pareto_front(costs[contenders])]
    front = front[np.lexsort(costs[front].T[::-1])]
    # far points would squeeze the rest: beyond the limit a logarithm
    wide = finite.any() and float(x[finite].max()) > 8.0 * max(float(np.median(x[finite])), 1e-12)
    log = bool(wide and (x[finite] > 0).all())
    ends = x if limit is None else np.append(x, limit * of_x.scale)
    return Chart(
        "trade-off", f"{of_y.title} against {of_x.title}, one point a design",
        Axis.around(f"{of_x.label}, {of_x.better} is better", ends[np.isfinite(ends)], log=log, zero=not log),
        Axis.around(f"{of_y.label}, {of_y.better} is better", y[finite]), clouds, height=290.0,
        limit=None if limit is None else (limit * of_x.scale, "limit"), front=(x[front], y[front]),
        ring=None if marked is None else (float(x[marked]), float(y[marked]), "winner"),
    )  # fmt: skip


def limit_of(context: Context, name: str) -> float | None:
    """The upper limit of a metric among the requirements; of added acceleration always that of ISO 11270."""
    for requirement in context.ranking.requirements:
        if requirement.metric.name == name and requirement.operator in ("<=", "<"):
            return requirement.limit
    return A_Y_LIMIT if name == "a_y_added_peak_p95" else None


def cloud_legend(context: Context) -> Markup:
    """Laws of the points, what filling and ring mean."""
    laws = {design.law: design for design in context.ranking.designs}
    shown = [(law_title(design), context.styles[law]) for law, design in laws.items() if not design.is_baseline]
    return legend(shown, points=True)
