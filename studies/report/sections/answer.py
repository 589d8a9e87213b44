"""Answer: which design wins, by how much, and how sure that is."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

from studies.report.context import Context
from studies.report.figures.law_intervals import Line, law_intervals_figure
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.tables.row import is_baseline
from studies.report.words import prose, text
from studies.report.words.answer import answer

_MOST_LAWS: Final = 12


@dataclasses.dataclass(frozen=True)
class Tile:
    """One large number at the top of the page."""

    value: str
    unit: str
    text: str
    detail: str


def _tiles(context: Context) -> list[Tile]:
    table, shown = context.primary, text.number
    best = table.best
    interval = f"{text.percent(table.confidence, 0)} interval {prose.between(best.fresh or best.S)}"
    if best.fresh is not None:
        scenarios = f"mean score S of {table.best_name} on {table.fresh_scenarios:,} fresh departures"
        tiles = [
            Tile(
                shown(best.fresh.value),
                "m·s",
                scenarios,
                f"{interval}; {shown(best.S.value)} where designs were chosen",
            )
        ]
    else:
        tiles = [Tile(shown(best.S.value), "m·s", f"mean score S of {table.best_name}", interval)]
    if not is_baseline(best):
        change = best.reduction
        interval = f"interval {shown(-100 * change.high, 1)} to {shown(-100 * change.low, 1)}"
        tiles.append(Tile(text.signed(-100 * change.value, 1), "%", "against no control", interval))
        deep = f"of departures deeper than {text.compact(table.D_y)}\u00a0m"
        before = f"{text.percent(table.uncorrected_deeper)} without control"
        tiles.append(Tile(shown(100 * best.deeper, 1), "%", deep, before))
        tiles += _comfort(context)
    if table.winner is None:
        of = f"of {text.plural(len(table.rows), 'design')}"
        ranked = f"{of}, {table.ranked:,} where designs were chosen"
        what = (
            "finalists meet the requirements on fresh departures" if table.ranked else "designs meet the requirements"
        )
        tiles.append(Tile("0", "", what, ranked if table.ranked else of))
    elif len(table.rows) > 1:
        others = len(table.set_of_best) - 1
        holds = f"the truly best is in it with {text.percent(table.confidence, 0)} confidence"
        tiles.append(
            Tile(f"{others:,}", "", f"other {'design' if others == 1 else 'designs'} in the set of best", holds)
        )
    return tiles


def _comfort(context: Context) -> Iterator[Tile]:
    """What the score is paid for with."""
    figures, place = context.ranking.release, context.primary.best.place
    share = float(figures.comfortable[place])
    if math.isfinite(share):
        said = f"lateral acceleration up to {text.number(float(figures.a_y_peak_max[place]), 1)}\u00a0m/s\u00b2"
        yield Tile(text.number(100 * share, 1), "%", "of interventions within the comfort limits of ISO 11270", said)


def _laws(context: Context) -> Iterator[Drawing]:
    """The first design of each law, and the paper's controller."""
    table = context.primary
    rows = [row for row in table.best_of_each_law if not is_baseline(row)][:_MOST_LAWS]
    paper = table.paper_design
    if paper is not None and paper not in rows:
        rows.append(paper)
    if not rows:
        return
    lines = [
        Line(
            text.printable(row.title) + (" (Table I)" if row is paper else ""),
            context.styles[row.design.law],
            row.S,
            row.fresh,
            row.reduction.value,
            row is table.winner,
        )
        for row in sorted(rows, key=lambda row: row.place)
    ]
    yield Drawing(
        "best-of-each-law", "Mean S law by law, with intervals, against no control",
        law_intervals_figure(lines, table.uncorrected),
    )  # fmt: skip


def section(context: Context) -> Section:
    """The section."""
    laws = tuple(_laws(context))
    report, primary = context.report, context.primary
    elsewhere = {warning for table in context.tables[1:] for warning in table.warnings}  # told beside their own tables
    warnings = dict.fromkeys((*report.warnings, *primary.warnings))
    body = render(
        "sections/answer.html",
        report=report,
        tables=context.tables,
        primary=primary,
        warnings=[one for one in warnings if one not in elsewhere or one in primary.warnings],
        tiles=_tiles(context),
        answer=answer(context),
        plant=prose.plant(report),
        laws=laws,
    )
    return Section("answer", "Answer", body, laws)
