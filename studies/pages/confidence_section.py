"""How sure the ranking is: intervals of the best designs, fresh scenarios, and whether there are enough departures."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray

from ..ranking.ranking import Ranking
from ..ranking.verdict import design_name, optimism_text, recordings_text
from ..tables import Cell, Column, Row, Table, to_html
from ..text import DASH, difference_text, percent, plural
from .charts import LEFT_IS_BETTER, Axis, Chart, Dot, Series, Style, dots
from .context import Context
from .shell import Section, figure, paragraphs

MOST: Final = 12


def section(context: Context) -> Section:
    """The section."""
    charts = tuple(_interval_charts(context))
    body = paragraphs(*_confidence_sentences(context))
    body += figure(
        charts,
        f"First chart: rank, design, and mean S with its {percent(context.ranking.confidence, 0)} interval, for all "
        f"designs at once{'; open: on the fresh scenarios' if context.ranking.fresh.scenarios else ''}. Second "
        "chart: mean S over the first scenarios, with a band of 1.96 standard errors.",
    )
    if context.ranking.fresh.scenarios:
        body += to_html(_finalists(context.ranking))
    return Section("confidence", "Confidence", body, charts, printed=True)


def _confidence_sentences(context: Context) -> Iterator[str]:
    ranking = context.ranking
    level = percent(ranking.confidence, 0)
    yield context.model_sentence
    if recordings := recordings_text(ranking, "m\u00b7s"):
        yield recordings
    rivals = [i for i in range(1, ranking.ranked) if math.isfinite(ranking.inference.difference[i])]
    if not rivals:
        return
    second = rivals[0]
    name = design_name(ranking.designs[second])
    inference = ranking.inference
    intervals = inference.difference, inference.difference_low, inference.difference_high
    away, low, high = (float(values[second]) for values in intervals)
    scale, unit = ranking.scale_and_unit("m\u00b7s")
    interval = f" ({level} interval {difference_text(scale * low)} to {difference_text(scale * high)})"
    between = interval if math.isfinite(low + high) else ""
    separated = not inference.set_of_best[second]
    yield (
        f"Second: {name}, {difference_text(scale * away)} {unit} from rank 1{between}; "
        f"{'the scenarios separate the two' if separated else 'the scenarios do not separate the two'}."
    )
    if not separated and abs(away) > 1e-6 and math.isfinite(low + high):
        half = 0.5 * (high - low)
        needed = context.scenarios.n * (half / away) ** 2
        about = f"about {_two_digits(needed):,}" if needed < 1e7 else "more than ten million"
        yield f"If this difference is the true one, {about} scenarios separate the two with a probability of 50 %."
    rival_law = next((i for i in rivals if ranking.designs[i].law != ranking.designs[0].law), second)
    if rival_law != second:
        apart = "not separated from" if inference.set_of_best[rival_law] else "separated from"
        yield (
            f"Best of another law: {design_name(ranking.designs[rival_law])}, "
            f"{difference_text(scale * float(inference.difference[rival_law]))} {unit} from rank 1, {apart} it."
        )
    winner = ranking.winner
    if winner is not None and math.isfinite(ranking.fresh.optimism[winner]):
        yield optimism_text(ranking, winner, "m\u00b7s")


def _two_digits(count: float) -> int:
    step = int(10 ** max(0, math.floor(math.log10(max(count, 1.0))) - 1))
    return math.ceil(count / step) * step


def _interval_charts(context: Context) -> Iterator[Chart]:
    ranking = context.ranking
    shown = list(dict.fromkeys((context.shown, *range(min(6, len(ranking))), *context.best_of_each_law)))[:MOST]
    rows = []
    for i in sorted(shown):
        name, style = f"{int(ranking.rank[i]) or DASH}: {design_name(ranking.designs[i])}", context.style(i)
        S, low, high = (float(v[i]) for v in (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high))
        dots_of_row = [Dot(name, S, low, high, style)]
        if math.isfinite(ranking.fresh.S[i]):
            S, low, high = (float(v[i]) for v in (ranking.fresh.S, ranking.fresh.low, ranking.fresh.high))
            dots_of_row.append(Dot(name, S, low, high, style, open=True))
        rows.append(dots_of_row)
    ends = [value for row in rows for dot in row for value in (dot.value, dot.low, dot.high)]
    level = float(ranking.metrics.S_uncorrected[context.shown])
    near = [level] if level < 2.0 * max((v for v in ends if math.isfinite(v)), default=0.0) else []
    yield dots("intervals", "Mean S with intervals, better to the left", rows,
               Axis.around(f"Mean S [m\u00b7s]{LEFT_IS_BETTER}", ends, near),
               upright=(level, "no control") if near else None)  # fmt: skip
    if context.scenarios.n > 2:
        shown = sorted(dict.fromkeys((context.shown, *context.best_of_each_law[:3])))
        curves = [(design_name(ranking.designs[i]), context.S(i), context.style(i)) for i in shown]
        yield convergence(curves, context.scenarios.side)


def convergence(curves: Sequence[tuple[str, FloatArray, Style]], side: IntArray) -> Chart:
    """Mean of values (n,) over the first scenarios, left and right ones interleaved, with 1.96 standard errors."""
    order, series = interleaved(side), []
    least = max(1, min(10, order.size // 2))  # means of fewer are far away
    for name, values, style in curves:
        count, mean, error = running_mean(values[order])
        x, mean, error = (column[count >= least].astype(np.float64) for column in (count, mean, error))
        series.append(Series(name, x, mean, style, mean - error, mean + error))
    axis = Axis("Number of scenarios", float(least), max(order.size, 2.0), log=True)
    y = Axis.around("Mean S [m\u00b7s]", *(curve.y for curve in series))
    return Chart("convergence", "Mean S over the first scenarios", axis, y, series)


def interleaved(side: IntArray) -> IntArray:
    """An order of the scenarios in which every stretch holds left and right ones in their overall proportion."""
    position = np.empty(side.size)
    for value in np.unique(side):
        rows = np.flatnonzero(side == value)
        position[rows] = (np.arange(rows.size) + 0.5) / rows.size
    return np.lexsort((np.arange(side.size), position))


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


def _finalists(ranking: Ranking) -> Table:
    """The finalists on the fresh scenarios, and on recorded departures."""
    interval = f"{percent(ranking.confidence, 0)} interval"
    columns = [
        Column("Rank"), Column("Finalist", text=True), Column("Mean S", "m\u00b7s", ".3f"),
        Column("Fresh S", "m\u00b7s", ".3f"), Column(interval, "m\u00b7s", ".3f"),
        Column("Difference from rank 1", "m\u00b7s", difference_text),
        Column("Requirements missed on fresh scenarios", text=True),
    ]  # fmt: skip
    title = f"Finalists on {plural(ranking.fresh.scenarios, 'fresh scenario')}"
    if ranking.replayed.departures:
        title += f", and on {plural(ranking.replayed.departures, 'replayed departure')}"
        columns += [Column("Replayed S", "m\u00b7s", ".3f"), Column(interval, "m\u00b7s", ".3f"),
                    Column("Reduction", "%", ".1f")]  # fmt: skip
    numbers = np.stack([
        ranking.metrics.S, ranking.fresh.S, ranking.fresh.low, ranking.fresh.high, ranking.fresh.difference,
        ranking.replayed.S, ranking.replayed.low, ranking.replayed.high, 100.0 * ranking.replayed.reduction,
    ], axis=1)  # fmt: skip
    rows = []
    for i in np.flatnonzero(np.isfinite(ranking.fresh.S)).tolist():
        S, fresh, low, high, to_first, *replayed = numbers[i].tolist()
        unmet = ", ".join(ranking.fresh.unmet[i])
        cells = [
            int(ranking.rank[i]) or DASH, design_name(ranking.designs[i]), S, fresh, (low, high), to_first,
            Cell(unmet or "none", bad=bool(unmet)),
        ]  # fmt: skip
        if ranking.replayed.departures:
            cells += [replayed[0], (replayed[1], replayed[2]), replayed[3]]
        rows.append(Row(cells, "winner" if i == ranking.winner else ""))
    return Table(title, columns, rows, head=1)
