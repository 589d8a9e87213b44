"""How sure the ranking is: intervals of the best designs, fresh scenarios, and whether there are enough departures."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray, IntArray

from ..ranking.ranking import Ranking
from ..ranking.verdict import optimism_text
from .charts import Axis, Chart, Dot, Series, Style, dots
from .context import Context, interval, name_of
from .shell import Cell, Column, Section, TableRow, figure, paragraphs, table
from .text import difference_text, number, percent, plural

MOST: Final = 12


def section(context: Context) -> Section:
    """The section."""
    charts = tuple(_charts(context))
    body = paragraphs(*_sentences(context))
    body += figure(
        charts,
        f"Left: mean S with its {percent(context.ranking.confidence, 0)} interval, for all designs at once"
        f"{'; open: on the fresh scenarios' if context.ranking.fresh_scenarios else ''}. Right: mean S over the first "
        "scenarios, with 1.96 standard errors of each point.",
    )
    if context.ranking.fresh_scenarios:
        body += _finalists(context)
    return Section("confidence", "Confidence", body, charts)


def _sentences(context: Context) -> Iterator[str]:
    ranking = context.ranking
    level = percent(ranking.confidence, 0)
    yield context.model_sentence
    rivals = [i for i in range(1, ranking.ranked) if math.isfinite(ranking.difference[i])]
    if not rivals:
        return
    second = rivals[0]
    name = name_of(ranking.designs[second])
    away, low, high = (
        float(one[second]) for one in (ranking.difference, ranking.difference_low, ranking.difference_high)
    )
    between = (
        f" ({level} interval {difference_text(low)} to {difference_text(high)})" if math.isfinite(low + high) else ""
    )
    separated = not ranking.set_of_best[second]
    yield (
        f"Second: {name}, {difference_text(away)} m\u00b7s from rank 1{between}; "
        f"{'the scenarios separate the two' if separated else 'the scenarios do not separate the two'}."
    )
    if not separated and abs(away) > 1e-6 and math.isfinite(low + high):
        half = 0.5 * (high - low)
        needed = context.scenarios.n * (half / away) ** 2
        about = f"about {_two_digits(needed):,}" if needed < 1e7 else "more than ten million"
        yield f"If the difference seen is the true one, {about} scenarios separate them with even chances."
    other = next((i for i in rivals if ranking.designs[i].law != ranking.designs[0].law), None)
    if other is not None and other != second:
        apart = "separated from" if not ranking.set_of_best[other] else "not separated from"
        yield (
            f"Best of another law: {name_of(ranking.designs[other])}, "
            f"{difference_text(float(ranking.difference[other]))} "
            f"m\u00b7s from rank 1, {apart} it."
        )
    i = ranking.winner
    if i is not None and math.isfinite(ranking.optimism[i]):
        yield optimism_text(ranking, i, "m\u00b7s")


def _two_digits(count: float) -> int:
    step = int(10 ** max(0, math.floor(math.log10(max(count, 1.0))) - 1))
    return math.ceil(count / step) * step


def _charts(context: Context) -> Iterator[Chart]:
    ranking = context.ranking
    shown = list(dict.fromkeys((context.shown, *range(min(6, len(ranking))), *context.best_of_each_law)))[:MOST]
    rows = []
    for i in sorted(shown):
        name, style = name_of(ranking.designs[i]), context.style(i)
        own = [Dot(name, float(ranking.S[i]), float(ranking.S_low[i]), float(ranking.S_high[i]), style)]
        if math.isfinite(ranking.fresh_S[i]):
            S, low, high = (float(one[i]) for one in (ranking.fresh_S, ranking.fresh_low, ranking.fresh_high))
            own.append(Dot(name, S, low, high, style, open=True))
        rows.append(own)
    ends = [value for row in rows for one in row for value in (one.value, one.low, one.high)]
    level = float(ranking.S_uncorrected[context.shown])
    near = [level] if level < 2.0 * max((v for v in ends if math.isfinite(v)), default=0.0) else []
    yield dots("intervals", "Mean S with intervals", rows, Axis.around("Mean S [m\u00b7s]", ends, near),
               at=level if near else None, at_text="no control")  # fmt: skip
    if context.scenarios.n > 2:
        shown = sorted(dict.fromkeys((context.shown, *context.best_of_each_law[:3])))
        curves = [(name_of(ranking.designs[i]), context.S(i), context.style(i)) for i in shown]
        yield convergence(curves, context.scenarios.side)


def convergence(curves: Sequence[tuple[str, FloatArray, Style]], side: IntArray) -> Chart:
    """Mean of values (n,) over the first scenarios, left and right ones interleaved, with 1.96 standard errors."""
    order, series = interleaved(side), []
    for name, values, style in curves:
        count, mean, error = running_mean(values[order])
        series.append(Series(name, count.astype(np.float64), mean, style, mean - error, mean + error))
    x = Axis("Number of scenarios", 2.0, float(max(order.size, 3)), log=True)
    y = Axis.around("Mean S [m\u00b7s]", *(curve.y[curve.x >= min(20, order.size)] for curve in series))
    return Chart("convergence", "Mean S over the first scenarios", x, y, series)


def interleaved(side: IntArray) -> IntArray:
    """An order of the scenarios in which every stretch holds left and right ones in their overall proportion."""
    place = np.empty(side.size)
    for value in np.unique(side):
        rows = np.flatnonzero(side == value)
        place[rows] = (np.arange(rows.size) + 0.5) / rows.size
    return np.lexsort((np.arange(side.size), place))


def running_mean(values: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Mean of the first k values and 1.96 standard errors of it, at up to 160 counts k from 2 to n."""
    n = values.size
    if n < 2:
        return np.arange(1, n + 1), values.copy(), np.full(n, np.nan)
    counts = np.unique(np.round(np.geomspace(2, n, 160)).astype(np.int64))
    shifted = values - values.mean()  # else the difference of two large sums would lose the small variance
    total, squares = np.cumsum(shifted)[counts - 1], np.cumsum(shifted**2)[counts - 1]
    variance = np.maximum(squares - total**2 / counts, 0.0) / (counts - 1)
    return counts, total / counts + values.mean(), 1.96 * np.sqrt(variance / counts)


def _finalists(context: Context) -> Markup:
    ranking = context.ranking
    level = percent(ranking.confidence, 0)
    columns = [
        Column("Rank"), Column("Finalist", text=True), Column("Mean S", "m\u00b7s"), Column("Fresh S", "m\u00b7s"),
        Column(f"{level} interval", "m\u00b7s"), Column("Difference from rank 1", "m\u00b7s"),
        Column("Requirements missed on fresh scenarios", text=True),
    ]  # fmt: skip
    replayed = ranking.replayed_departures
    if replayed:
        columns += [Column("Replayed S", "m\u00b7s"), Column(f"{level} interval", "m\u00b7s"), Column("Less", "%")]
    rows = []
    for i in np.flatnonzero(np.isfinite(ranking.fresh_S)).tolist():
        to_first = float(ranking.fresh_difference[i])
        rows.append(
            TableRow(
                (
                    str(ranking.rank[i]) if ranking.rank[i] else "\u2013",
                    name_of(ranking.designs[i]),
                    number(float(ranking.S[i])),
                    number(float(ranking.fresh_S[i])),
                    interval(float(ranking.fresh_low[i]), float(ranking.fresh_high[i])) or "\u2013",
                    difference_text(to_first) if math.isfinite(to_first) else "\u2013",
                    Cell(", ".join(ranking.fresh_unmet[i]) or "nothing", bad=bool(ranking.fresh_unmet[i])),
                    *(_on_replayed(ranking, i) if replayed else ()),
                ),
                "winner" if i == ranking.winner else "",
            )
        )
    title = f"Finalists on {plural(ranking.fresh_scenarios, 'fresh scenario')}"
    title += f", and on {plural(replayed, 'replayed departure')}" if replayed else ""
    return table(title, columns, rows, head=1)


def _on_replayed(ranking: Ranking, i: int) -> tuple[str, str, str]:
    between = interval(float(ranking.replayed_low[i]), float(ranking.replayed_high[i])) or "\u2013"
    return number(float(ranking.replayed_S[i])), between, number(100.0 * float(ranking.replayed_reduction[i]), 1)
