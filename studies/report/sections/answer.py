"""Answer: which design wins, by how much, and how sure that is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from studies.report.context import Context
from studies.report.figures.law_intervals import Line, law_intervals_figure
from studies.report.rendering import render
from studies.report.section import Drawing, Section, Tile
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row, is_baseline
from studies.report.words import prose, text
from studies.report.words.answer import answer

_MOST_LAWS: Final = 12


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
        tiles.append(_against_no_control(best))
        deep = f"of departures deeper than {text.compact(table.D_y)}\u00a0m{_where(best)}"
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
        others = len(table.set_of_best) - best.in_set
        holds = f"the truly best is in it with {text.percent(table.confidence, 0)} confidence"
        what = "design" if others == 1 else "designs"
        said = f"other {what} in the set of best" if best.in_set else f"{what} in the set of best, without the winner"
        tiles.append(Tile(f"{others:,}", "", said, holds))
    return tiles


def _where(best: Row) -> str:
    """What to say of figures beside a fresh score that are not fresh."""
    return ", where designs were chosen" if best.fresh is not None else ""


def _against_no_control(best: Row) -> Tile:
    """On fresh departures where there are some."""
    change = best.fresh_reduction or best.reduction
    known = math.isfinite(change.low) and math.isfinite(change.high)
    ends = f"{text.number(-100 * change.high, 1)} to {text.number(-100 * change.low, 1)}" if known else "not known"
    detail, where = f"interval {ends}", _where(best)
    if best.fresh_reduction is not None:
        detail += f"; {text.change(best.reduction.value)} where designs were chosen"
        where = " on the fresh departures"
    return Tile(text.signed(-100 * change.value, 1), "%", f"against no control{where}", detail)


def _comfort(context: Context) -> Iterator[Tile]:
    """What the score is paid for with."""
    figures, place = context.ranking.release, context.primary.best.place
    share, where = float(figures.comfortable[place]), _where(context.primary.best)
    if math.isfinite(share):
        most = text.number(float(figures.a_y_added_peak_max[place]), 1)
        said = f"up to {most}\u00a0m/s\u00b2 more than the recorded path"
        yield Tile(
            text.number(100 * share, 1), "%", f"of interventions within the comfort limits of ISO 11270{where}", said
        )


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


def _caption(table: CaseTable) -> str:
    """Of the figure of laws."""
    shown = [row for row in table.best_of_each_law if not is_baseline(row)]
    rule = "ranks first" if table.ranked else "has the lowest mean S"
    which = f"Of each law the design that {rule}"
    if table.winner is not None and table.winner.place:
        which += ", of the winner\u2019s law the winner"
    if table.ranked and not all(row.rank for row in shown):
        which += " (where none of a law meets the requirements, the one with the lowest mean S)"
    interval = f"mean S with its {text.percent(table.confidence, 0)} interval"
    fresh = ", and below it, open, mean S on the fresh departures" if table.fresh_scenarios else ""
    return f"{which}: {interval}{fresh}; in brackets the change against no control, the dashed line."


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
        caption=_caption(primary),
    )
    return Section("answer", "Answer", body, laws)
