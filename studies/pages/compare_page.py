"""The page that compares two studies: winner against winner first, then every design of both."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.version import __version__

from ..comparison.comparison import PHRASES, Comparison
from ..comparison.paired import Verdict, Winners
from ..storage.files import write_text
from ..tables import Cell, Column, Row, Table, to_html
from ..text import difference_text, number, percent, plural, signed, symbols
from .charts import Axis, Chart, Dot, Series, Style, dots
from .settings_section import pairs
from .shell import Section, bullets, details, figure, make_page, paragraphs, render

THRESHOLD: Final = 0.01  # differences of mean S [m s] below this do not matter in practice: 1 cm over 1 s

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
            _verdict(comparison),
            _differences(comparison),
            _designs(comparison),
            _changes(comparison),
            _only_one(comparison),
            _settings(comparison),
        ],
        footer=f"ldctoolkit {__version__}. Old: {comparison.old}. New: {comparison.new}.",
    )


# ------------------------------------------------------------------------------------------------ the verdict


def winners_sentence(winners: Winners) -> str:
    """Whether the new winner is better, and whether that matters."""
    which = "fresh" if winners.fresh else "study"
    matters = abs(winners.difference) >= THRESHOLD
    size = f"{difference_text(abs(winners.difference)).removeprefix('+')} m\u00b7s"
    small = "" if matters else f", less than the {THRESHOLD:g} m\u00b7s that matter in practice"
    if winners.same_design:
        start = f"{winners.new.label} is the winner of both studies; on shared {which} scenarios its mean S "
        end = {
            Verdict.BETTER: f"falls by {size}{small}.",
            Verdict.WORSE: f"rises by {size}{small}.",
            Verdict.SAME: "is the same.",
            Verdict.NOT_SEPARATED: "changes within sampling error.",
        }
        return start + end[winners.verdict]
    start = f"On shared {which} scenarios the new winner, {winners.new.label}, is "
    end = {
        Verdict.BETTER: f"better than the old one, {winners.old.label}, by {size}{small}.",
        Verdict.WORSE: f"worse than the old one, {winners.old.label}, by {size}{small}.",
        Verdict.SAME: f"as good as the old one, {winners.old.label}.",
        Verdict.NOT_SEPARATED: f"not separated from the old one, {winners.old.label}.",
    }
    return start + end[winners.verdict]


def _verdict(comparison: Comparison) -> Section:
    winners = comparison.winners
    lead = winners_sentence(winners) if winners else NO_WINNERS
    body = Markup('<p class="verdict">{}</p>').format(symbols(lead))
    if winners:
        change = signed(100.0 * winners.difference / winners.S_old, 1) if winners.S_old > 0 else "\u2013"
        phrase = PHRASES[winners.verdict]
        small = winners.verdict in (Verdict.BETTER, Verdict.WORSE) and abs(winners.difference) < THRESHOLD
        cells = (
            f"{winners.scenarios:,} {'fresh' if winners.fresh else 'study'} scenarios",
            number(winners.S_old, 4),
            number(winners.S_new, 4),
            difference_text(winners.difference),
            change,
            interval_text(winners.low, winners.high),
            Cell(
                (f"{phrase}, too little to matter" if small else phrase),
                bad=winners.verdict is Verdict.WORSE,
                good=winners.verdict is Verdict.BETTER,
            ),
        )
        columns = [
            Column("On", text=True), Column("Old winner", "m\u00b7s"), Column("New winner", "m\u00b7s"),
            Column("New \u2212 old", "m\u00b7s"), Column("Change", "%"), Column("Interval", "m\u00b7s"),
            Column("Verdict", text=True),
        ]  # fmt: skip
        title = f"Mean S of the winners; differences from {THRESHOLD:g} m\u00b7s on matter in practice"
        body += to_html(Table(title, columns, [Row(cells)]))
    if len(comparison):
        body += paragraphs(
            f"{plural(len(comparison), 'design')} in both studies: {counts_text(comparison)}. Intervals hold for all "
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


def counts_text(comparison: Comparison) -> str:
    """How many designs are better, worse, not separated, the same."""
    return ", ".join(f"{comparison.count(verdict):,} {PHRASES[verdict]}" for verdict in Verdict)


NO_WINNERS: Final = "No design of one of the studies meets its requirements: there is no winner to compare."


def interval_text(low: float, high: float) -> str:
    """Both ends of an interval, or why there is none."""
    if math.isnan(low) or math.isnan(high):
        return "too few departures changed"
    if math.isinf(low) or math.isinf(high):
        return "too few departures"
    return f"{difference_text(low)} to {difference_text(high)}"


# ------------------------------------------------------------------------------------------------ sections


def _differences(comparison: Comparison) -> Section:
    if not comparison.differences:
        body = paragraphs("The inputs are the same: what differs below is in the code of a law, or in the machine.")
    else:
        columns = [Column("Input", text=True), Column("Old \u2192 new", text=True)]
        rows = [
            Row((key, value.replace(" -> ", " \u2192 ")))
            for key, _, value in (one.partition(": ") for one in comparison.differences)
        ]
        body = to_html(Table("What decides the numbers and differs", columns, rows))
    return Section("differences", "What differs", body)


def _title(label: str) -> str:
    return label.replace(" -> ", " \u2192 ")


def _designs(comparison: Comparison) -> Section:
    body = _design_table(comparison) if len(comparison) else paragraphs("No design is in both studies.")
    return Section("designs", "Designs", body, scripts=("table.js",))


def _design_table(comparison: Comparison) -> Markup:
    S, shared, id = comparison.S, comparison.shared, "designs-1"
    columns = [
        Column("Verdict", text=True), Column("Design", text=True), Column("Old S", "m\u00b7s", ".4f", key="old"),
        Column("New S", "m\u00b7s", ".4f", key="new"), Column("New \u2212 "
            "old", "m\u00b7s", difference_text, key="difference"), Column("Interval", "m\u00b7s"),
        Column("Scenarios changed", key="changed"), Column("Largest change", "m\u00b7s"), Column("Failed, old / new"),
    ]  # fmt: skip
    numbers = np.stack([S.S_old, S.S_new, S.difference], axis=1)
    rows = []
    for k, i in enumerate(comparison.order[:MOST_ROWS]):
        changed, failed = int(S.changed[i]), (comparison.failed_old[i], comparison.failed_new[i])
        at = f" (no. {int(shared.new[S.largest_at[i]])})"
        verdict = S.verdict[i]
        cells = (
            Cell(PHRASES[verdict], bad=verdict is Verdict.WORSE, good=verdict is Verdict.BETTER),
            comparison.designs[i].label,
            *numbers[i].tolist(),
            interval_text(float(S.low[i]), float(S.high[i])),
            changed,
            f"{difference_text(float(S.largest[i]))}{at}" if changed else "\u2013",
            f"{failed[0]:,} / {failed[1]:,}" if any(failed) else "\u2013",
        )
        rows.append(Row(cells, later=k >= FIRST_ROWS))
    table = Table(f"{_title(comparison.label)}: {counts_text(comparison)}", columns, rows, head=1)
    return render(
        "compare.html", id=id, table=to_html(table, id=id, sortable=True), count=len(comparison), listed=len(rows),
        later=max(0, len(rows) - FIRST_ROWS),
    )  # fmt: skip


def _changes(comparison: Comparison) -> Section:
    charts = list(_charts(comparison))
    body = figure(
        charts,
        "Left: the largest differences of mean S, new minus old, with their intervals. Right: mean S in the old study "
        "against that in the new one; on the line nothing changed.",
    )
    return Section("changes", "Largest changes", body or paragraphs("No design is in both studies."), tuple(charts))


def _charts(comparison: Comparison) -> Iterator[Chart]:
    S = comparison.S
    if not len(comparison):
        return
    label = _title(comparison.label)
    order = [i for i in np.argsort(-np.abs(S.difference), kind="stable").tolist() if S.difference[i] != 0][
        :MOST_CHANGED
    ]
    if order:
        rows = [
            [
                Dot(
                    comparison.designs[i].label,
                    float(S.difference[i]),
                    float(S.low[i]),
                    float(S.high[i]),
                    _STYLES[S.verdict[i]],
                )
            ]
            for i in sorted(order, key=lambda i: float(S.difference[i]))
        ]
        ends = [value for (one,) in rows for value in (one.value, one.low, one.high)]
        axis = Axis.around("New \u2212 old mean S [m\u00b7s]", ends, [0.0])
        yield dots("changes", f"{label}: differences of mean S", rows, axis, at=0.0, at_text="no change")
    clouds = []
    for verdict, style in _STYLES.items():
        own = np.array([i for i in range(len(comparison)) if S.verdict[i] is verdict], dtype=np.int64)
        if own.size:
            tips = tuple(f"{comparison.designs[i].label}: {PHRASES[verdict]}" for i in own)
            clouds.append(Series(PHRASES[verdict], S.S_old[own], S.S_new[own], style, kind="points", tips=tips))
    both = Axis.around("", S.S_old, S.S_new)
    x, y = Axis("Old mean S [m\u00b7s]", both.low, both.high), Axis("New mean S [m\u00b7s]", both.low, both.high)
    title = f"{label}: old against new mean S"
    yield Chart("scatter", title, x, y, clouds, diagonal=True, height=290.0)


def _only_one(comparison: Comparison) -> Section:
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
            body += Markup("<h3>{}</h3>").format(title) + bullets(one.sentence for one in failed[:MOST_LISTED])
    return Section(
        "only", "In one study, and failures", body or paragraphs("Both studies hold the same designs, and none failed.")
    )


def _settings(comparison: Comparison) -> Section:
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
