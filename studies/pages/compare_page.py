"""The page that compares two studies: winner against winner first, then every design of both."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.version import __version__

from ..comparison.comparison import PHRASES, Comparison, design_table, interval_cell, verdict_cell, winners_sentence
from ..comparison.paired import THRESHOLD, Verdict
from ..storage.folder_files import write_text
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import difference_text, percent, plural, symbols
from .charts import LEFT_IS_BETTER, Axis, Chart, Dot, Series, Style, dots
from .shell import Section, bullets, details, figure, make_page, pairs, paragraphs, render

FIRST_ROWS: Final = 20
MOST_ROWS: Final = 1000
MOST_CHANGED: Final = 15
MOST_LISTED: Final = 100

_STYLES: Final = {
    Verdict.BETTER: Style(2, "", "v"),
    Verdict.WORSE: Style(1, "", "^"),
    Verdict.NOT_SEPARATED: Style(0, "", "o"),
    Verdict.SAME: Style(-1, "2 2.5", "|"),
}


def write_compare_page(comparison: Comparison, path: str | Path) -> Path:
    """Write a comparison of two studies, as `ldctoolkit.compare` returns it, to the file `path`: one HTML page that
    needs nothing else, whole or not at all. Raises `StoreError` if it cannot be written.
    """
    write_text(Path(path), compare_page(comparison))
    return Path(path)


def compare_page(comparison: Comparison) -> str:
    """The page as one HTML document; the same comparison gives the same text."""
    shared = comparison.shared
    return make_page(
        kind="Lane departure correction: comparison of two studies",
        title=f"{comparison.old_name} and {comparison.new_name}: comparison",
        heading=f"{comparison.old_name} \u2192 {comparison.new_name}",
        facts=[
            f"{shared.n:,} shared scenarios ({shared.left:,} left, {shared.right:,} right)",
            f"{plural(len(comparison), 'design')} in both",
            _title(comparison.label),
        ],
        sections=[
            _verdict_section(comparison),
            _differences_section(comparison),
            _designs_section(comparison),
            _changes_section(comparison),
            _only_one_section(comparison),
            _settings_section(comparison),
        ],
        footer=f"ldctoolkit {__version__}. Old: {comparison.old}. New: {comparison.new}.",
    )


# ------------------------------------------------------------------------------------------------ the verdict


def _verdict_section(comparison: Comparison) -> Section:
    winners = comparison.winners
    body = Markup('<p class="verdict">{}</p>').format(symbols(winners_sentence(winners)))
    if winners:
        change = 100.0 * winners.difference / winners.S_old if winners.S_old > 0 else math.nan
        small = winners.is_small and winners.verdict in (Verdict.BETTER, Verdict.WORSE)
        unit, which = "m\u00b7s", "fresh" if winners.fresh else "study"
        columns = [
            Column("On", text=True), Column("Old winner", unit, ".4f"), Column("New winner", unit, ".4f"),
            Column("New \u2212 old", unit, difference_text), Column("Change", "%", "+.1f"),
            Column("Interval", unit, difference_text), Column("Verdict", text=True),
        ]  # fmt: skip
        cells: list[Cell | Value] = [
            f"{winners.scenarios:,} {which} scenarios", winners.S_old, winners.S_new, winners.difference, change,
            interval_cell(winners.low, winners.high),
            verdict_cell(winners.verdict, ", too little to matter" if small else ""),
        ]  # fmt: skip
        title = f"Mean S of the winners; differences from {THRESHOLD:g} m\u00b7s on matter in practice"
        body += to_html(Table(title, columns, [Row(cells)]))
    if len(comparison):
        body += paragraphs(
            f"{plural(len(comparison), 'design')} in both studies: {comparison.counts}. Intervals hold for all "
            f"designs at once, with {percent(comparison.confidence, 0)} confidence."
        )
    else:
        body += paragraphs("No design is in both studies: nothing but their winners can be compared.")
    failed = len(comparison.new_failures)
    if failed:
        body += Markup('<p class="bad">{}</p>').format(
            f"{plural(failed, 'design')} that ran before {'fails' if failed == 1 else 'fail'} now."
        )
    body += bullets(comparison.warnings, "warnings")
    return Section("verdict", "Verdict", body, printed=True)


# ------------------------------------------------------------------------------------------------ sections


def _differences_section(comparison: Comparison) -> Section:
    body = bullets(text.replace(" -> ", " \u2192 ") for text in comparison.differences) or paragraphs(
        "The inputs are the same: what differs below is in the code of a law, or in the machine."
    )
    return Section("differences", "What differs", body)


def _title(label: str) -> str:
    return label.replace(" -> ", " \u2192 ")


def _designs_section(comparison: Comparison) -> Section:
    table = design_table(comparison, comparison.order[:MOST_ROWS])
    rows = [dataclasses.replace(row, later=k >= FIRST_ROWS) for k, row in enumerate(table.rows)]
    html = to_html(dataclasses.replace(table, rows=rows), id="designs-1", sortable=True)
    body = paragraphs("No design is in both studies.")
    if rows:
        body = render(
            "compare.html", id="designs-1", table=html, count=len(comparison), listed=len(rows),
            later=max(0, len(rows) - FIRST_ROWS),
        )  # fmt: skip
    return Section("designs", "Designs", body, scripts=("table.js",))


def _changes_section(comparison: Comparison) -> Section:
    charts = list(_difference_charts(comparison))
    body = figure(
        charts,
        "First chart: the largest differences of mean S, new minus old, with their intervals. Second chart: mean S in "
        "the old study against that in the new one; on the line nothing changed, below it the new one is better.",
    )
    return Section("changes", "Largest changes", body or paragraphs("No design is in both studies."), tuple(charts))


def _difference_charts(comparison: Comparison) -> Iterator[Chart]:
    S = comparison.S
    if not len(comparison):
        return
    label = _title(comparison.label)
    order = np.argsort(-np.abs(S.difference), kind="stable")[:MOST_CHANGED]
    if (order := order[S.difference[order] != 0]).size:
        rows = []
        for i in order[np.argsort(S.difference[order], kind="stable")].tolist():
            difference, low, high = (float(values[i]) for values in (S.difference, S.low, S.high))
            rows.append([Dot(comparison.designs[i].label, difference, low, high, _STYLES[S.verdict[i]])])
        ends = S.difference[order], S.low[order], S.high[order], [0.0]
        axis = Axis.around(f"New \u2212 old mean S [m\u00b7s]{LEFT_IS_BETTER}", *ends)
        title = f"{label}: differences of mean S, better to the left"
        yield dots("changes", title, rows, axis, upright=(0.0, "no change"))
    clouds = []
    for verdict, style in _STYLES.items():
        rows_of_verdict = np.array([i for i in range(len(comparison)) if S.verdict[i] is verdict], dtype=np.int64)
        if rows_of_verdict.size:
            tips = tuple(f"{comparison.designs[i].label}: {PHRASES[verdict]}" for i in rows_of_verdict)
            old, new = S.S_old[rows_of_verdict], S.S_new[rows_of_verdict]
            clouds.append(Series(PHRASES[verdict], old, new, style, kind="points", tips=tips))
    both = Axis.around("", S.S_old, S.S_new)
    x, y = Axis("Old mean S [m\u00b7s]", both.low, both.high), Axis("New mean S [m\u00b7s]", both.low, both.high)
    title = f"{label}: old against new mean S"
    yield Chart("scatter", title, x, y, clouds, diagonal=True, height=290.0)


def _only_one_section(comparison: Comparison) -> Section:
    body = Markup()
    for title, designs in (("old", comparison.only_old), ("new", comparison.only_new)):
        if designs:
            more = [f"and {len(designs) - MOST_LISTED:,} more"] if len(designs) > MOST_LISTED else []
            listed = bullets([*(design.label for design in designs[:MOST_LISTED]), *more])
            body += details(f"Only in the {title} study: {plural(len(designs), 'design')}", listed)
    for title, failed in (
        ("Fails now, ran before", comparison.new_failures),
        ("Runs now, failed before", comparison.repaired),
        ("Fails in both", comparison.failed_in_both),
    ):
        if failed:
            body += Markup("<h3>{}</h3>").format(title) + bullets(failure.sentence for failure in failed[:MOST_LISTED])
    return Section(
        "only", "In one study, and failures", body or paragraphs("Both studies hold the same designs, and none failed.")
    )


def _settings_section(comparison: Comparison) -> Section:
    return Section(
        "settings",
        "How it was compared",
        pairs(
            [
                ("Old", f"{comparison.old} ({comparison.old_name})"),
                ("New", f"{comparison.new} ({comparison.new_name})"),
                ("Resamples", f"{comparison.bootstrap:,}"),
                ("Confidence", percent(comparison.confidence, 0)),
            ]
        )
        + paragraphs(
            "Designs are matched by law, gains and threshold. Each mean counts a failed departure at least as bad as "
            "without control. Better, worse: the interval of the difference leaves 0 out; the same: within "
            "1e-6 m\u00b7s."
        ),
    )
