"""A ranking as text: one table of columns and the verdict, for terminals, Markdown files and notebooks."""

from __future__ import annotations

import dataclasses
import html
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.metrics import METRICS
from ldctoolkit.notebook import CELL
from studies.ranking.ranked_designs import SCORE, RankedDesigns
from studies.ranking.requirements import metric_values
from studies.ranking.verdict import Verdict, design_name, value_text
from studies.storage.files import write_text

_ENTITIES: Final = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_MARKS: Final = frozenset("\\`*_[]|~#$")
_ADDRESS: Final = re.compile(r"(?i)\b(www)(\.)|()(:)(?=\S)")
_START: Final = re.compile(r"^(\d{1,9})([.)])|^([-+=])")


def markdown_text(text: str) -> str:
    r"""One line of text that a reader of GitHub-flavoured Markdown shows as it is."""
    line = re.sub(r"[\x00-\x20\x7f\x85\u2028\u2029]+", " ", text).strip()
    # halves of characters, and what turns the direction of the text that follows
    line = re.sub("[\ud800-\udfff\u202a-\u202e\u2066-\u2069]", "\ufffd", line)
    shown = "".join(_ENTITIES.get(one, f"\\{one}" if one in _MARKS else one) for one in line)
    # no address, emoji or mention: a mark inside the word ends what would be one
    shown = _ADDRESS.sub(lambda m: f"{m[1] or ''}\\{m[2] or m[4]}", shown).replace("@", "@<!-- -->")
    return _START.sub(lambda m: f"{m[1]}\\{m[2]}" if m[1] else f"\\{m[3]}", shown)


def markdown_table(headings: Sequence[str], right: Sequence[bool], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are escaped already."""
    rule = ["---:" if number else "---" for number in right]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (headings, rule, *rows))


TOP: Final = 20
"""Rows of a notebook; the winner and the baseline follow where they are further down."""

MOST_ROWS: Final = 50
"""Designs of a Markdown file; those that are named follow."""

_DIGITS: Final = {"reduction": 1, "a_y_added_peak_p95": 2, "jerk_added_peak_p95": 2, "needless": 0}
"""Metrics of the table, and their decimals in the unit of a page."""

_DASH: Final = "\u2013"
_MINUS: Final = re.compile(r"(?<![\w.])-(?=\d)")
_LEFT: Final = f"text-align:left;{CELL}"
_RIGHT: Final = f"text-align:right;white-space:nowrap;{CELL}"


@dataclasses.dataclass(frozen=True)
class TextColumn:
    """One column of a ranking: heading, unit, and whether it stands to the left."""

    title: str
    unit: str = ""
    left: bool = False


def ranking_columns(ranking: RankedDesigns) -> tuple[TextColumn, ...]:
    """The columns of every text that shows a ranking, in their order."""
    return (
        TextColumn("#"),
        TextColumn("law", left=True),
        TextColumn("y_s", "m"),
        TextColumn("gains", left=True),
        TextColumn(f"S, {100 * ranking.confidence:g} %", "m s"),
        TextColumn("less", "%"),
        TextColumn("a_y", "m/s2"),
        TextColumn("jerk", "m/s3"),
        TextColumn("needless", "%"),
        TextColumn("verdict", left=True),
    )


COLUMNS_TEXT: Final = (
    "less: reduction of S against no control. a_y, jerk: 95 % quantile of what control adds to the recorded "
    "path. needless: "
    "share of departures with an intervention that stay within 0.3 m by themselves."
)
"""What the short headings mean."""


def ranking_cells(ranking: RankedDesigns, i: int) -> list[str]:
    """The cells of one design, in the order of `ranking_columns`."""
    design = ranking.designs[i]
    low, high = float(ranking.S_low[i]), float(ranking.S_high[i])
    return [
        str(ranking.rank[i]) if ranking.rank[i] else _DASH,
        controller_class(design.law).title,
        f"{design.y_s:g}",
        ", ".join(f"{name} {value_text(value)}" for name, value in design.changed),
        f"{ranking.S[i]:.3f}" + (f" {low:.2f}..{high:.2f}" if math.isfinite(low + high) else ""),
        *(
            _number(METRICS[name].scale * float(metric_values(name, ranking)[i]), digits)
            for name, digits in _DIGITS.items()
        ),
        judged(ranking, i),
    ]  # fmt: skip


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else _DASH


def judged(ranking: RankedDesigns, place: int) -> str:
    """What a design is called in one phrase: winner, what it breaks, failures, baseline."""
    found = ["winner"] if place == ranking.winner else []
    if place == ranking.baseline:
        found.append("baseline")
    if ranking.missed[place]:
        sets = dict.fromkeys(miss.requirement.set or miss.requirement.text for miss in ranking.missed[place])
        most = max((miss.excess for miss in ranking.missed[place] if miss.requirement.limit), default=0.0)
        by = f" +{100 * most:.0f}%" if 0.005 <= most < 10 else ""
        found.append(f"breaks {', '.join(sets)}{by}")
    elif ranking.requirements:
        found.append("meets all")
    failed = failures(ranking, place)
    if failed:
        found.append(f"failed in {failed:,}")
    if not ranking.missed[place] and place not in (ranking.winner, ranking.baseline) and ranking.set_of_best[place]:
        found.append("not separated")
    if ranking.pareto[place]:
        found.append("Pareto")
    return ", ".join(found)


def failures(ranking: RankedDesigns, place: int) -> int:
    """Scenarios of a design in which its law did not do its work."""
    counts = (ranking.solver_failed, ranking.diverged, ranking.timed_out, ranking.crashed)
    return sum(int(count[place]) for count in counts)


def listed_places(ranking: RankedDesigns, most: int) -> list[int]:
    """Places of the first designs, the winner, the baseline and the best of each law."""
    named = {place for place in (ranking.winner, ranking.baseline) if place is not None}
    return sorted({*range(min(most, len(ranking))), *named, *ranking.best_of_each_law()[:most]})


def verdict_lines(found: Verdict) -> list[str]:
    """The verdict in its title, two sentences, its red and yellow lights, and what to try."""
    lights = [f"{light.name}: {light.text}" for light in found.lights if light.state in ("bad", "warning")]
    return [f"{found.title}.", *found.sentences, *lights, *found.try_next]


def more_lines(ranking: RankedDesigns) -> Iterator[str]:
    """What else a reader should know: the set of best, fresh scenarios, failures, a race."""
    size, level = int(ranking.set_of_best.sum()), f"{100 * ranking.confidence:g} % confidence"
    if ranking.ranked and not ranking.survivors_only and size > 1:
        yield (
            f"Not separated by these scenarios: {size:,} designs; with {level} the best of those ranked is among them."
        )
    i, b = ranking.winner, ranking.baseline
    if i is not None and b is not None and b != i:
        fresh = bool(np.isfinite(ranking.fresh_baseline_difference[i]))
        name = "fresh_baseline_difference" if fresh else "baseline_difference"
        value, low, high = (float(getattr(ranking, name + end)[i]) for end in ("", "_low", "_high"))
        if math.isfinite(low):
            where = "fresh" if fresh else "study"
            yield (
                f"Winner minus baseline ({design_name(ranking.designs[b])}): {value:+.4f} m s ({low:+.4f} .. "
                f"{high:+.4f}) on the {where} scenarios."
            )
    if i is not None and ranking.fresh_scenarios and not np.isfinite(ranking.fresh_S[i]):
        yield "The winner of this case was no finalist; it has no fresh score."
    if i is not None and np.isfinite(ranking.optimism[i]):
        low, high = ranking.optimism_low[i], ranking.optimism_high[i]
        chance = "within chance" if low <= 0 <= high else "more than chance"
        yield (
            f"The study scenarios flattered the winner by {ranking.optimism[i]:+.4f} m s ({low:+.4f} .. "
            f"{high:+.4f}), {chance}."
        )
    if i is not None and ranking.fresh_difference[i] < 0 and ranking.fresh_difference_high[i] < 0:
        yield "It was not the first on the study scenarios: fresh scenarios separate the two."
    if ranking.ranked < len(ranking):
        left = len(ranking) - ranking.ranked
        yield f"{left:,} of {len(ranking):,} designs break a requirement and are not ranked."
    if ranking.pareto_figures and ranking.pareto.any():
        yield (
            f"Pareto front over {', '.join(ranking.pareto_figures)}: {int(ranking.pareto.sum())} designs, "
            "see ranking.csv."
        )
    if ranking.failed:
        yield f"{len(ranking.failed):,} design{'' if len(ranking.failed) == 1 else 's'} failed, without metrics."
    if ranking.given_up:
        yield f"{ranking.given_up:,} of {ranking.given_up + len(ranking):,} designs were given up in a race before."


# ------------------------------------------------------------------------------------------------ Markdown


@dataclasses.dataclass(frozen=True)
class StudyHead:
    """What stands above the ranking. Plain text; it is escaped."""

    # Of the study
    title: str
    name: str
    model: str  # The scenario model and its content hash
    synthetic: bool  # Whether that model was fitted to invented driving
    # Scenarios
    left: int
    right: int
    seed: int


def write_markdown(rankings: Sequence[RankedDesigns], path: str | Path, head: StudyHead, found: Verdict) -> None:
    """Write rankings as one Markdown file, whole or not at all."""
    write_text(Path(path), ranking_markdown(rankings, head, found))


def ranking_markdown(rankings: Sequence[RankedDesigns], head: StudyHead, found: Verdict) -> str:
    """The text of ``ranking.md``; the same rankings give the same text."""
    return "\n".join(_blocks(rankings, head, found))


def _blocks(rankings: Sequence[RankedDesigns], head: StudyHead, found: Verdict) -> Iterator[str]:
    first = rankings[0]
    yield f"# {markdown_text(head.title)}\n"
    title, *others = verdict_lines(found)
    yield f"**{markdown_text(title)}**\n"
    yield "".join(f"- {markdown_text(line)}\n" for line in (*others, *more_lines(first)))
    for warning in first.warnings:
        yield f"> **Warning:** {markdown_text(warning)}\n"
    places = listed_places(first, MOST_ROWS)
    columns = ranking_columns(first)
    headings = [markdown_text(f"{one.title}{f' [{one.unit}]' if one.unit else ''}") for one in columns]
    rows = ([markdown_text(cell) for cell in ranking_cells(first, place)] for place in places)
    yield markdown_table(headings, [not one.left for one in columns], rows)
    if len(places) < len(first):
        yield f"{len(places):,} of {len(first):,} designs; all of them are in `ranking.csv`.\n"
    window = "the whole departure" if first.case.window == "departure" else "the time under control"
    about = f"{SCORE}. Here it is taken over {window}. Intervals hold for all designs at once. {COLUMNS_TEXT}"
    yield f"{markdown_text(about)}\n"
    synthetic = "; synthetic, not fitted to recorded driving" if head.synthetic else ""
    facts = (
        f"Study: {head.name}",
        f"Scenario model: {head.model}{synthetic}",
        f"Scenarios: {head.left + head.right:,} ({head.left:,} left, {head.right:,} right), seed {head.seed}",
        f"Case: {first.case.label}",
    )
    yield "".join(f"- {markdown_text(fact)}\n" for fact in facts)
    if first.failed:
        yield "## Failed designs\n"
        yield "".join(f"- {markdown_text(one.sentence)}\n" for one in first.failed[:MOST_ROWS])
        if len(first.failed) > MOST_ROWS:
            yield f"And {len(first.failed) - MOST_ROWS:,} more, see `ranking.csv`.\n"
    if len(rankings) > 1:
        yield "## Other cases\n"
        yield "".join(f"- {markdown_text(other_case(one))}\n" for one in rankings[1:])


def other_case(ranking: RankedDesigns) -> str:
    """A case that is not the primary one, in a line."""
    if ranking.winner is None:
        return f"{ranking.case.label}: no winner."
    i = ranking.winner
    return f"{ranking.case.label}: {design_name(ranking.designs[i])}, mean S {ranking.S[i]:.3f} m s."


# ------------------------------------------------------------------------------------------------ notebooks


def ranking_html(ranking: RankedDesigns, top: int = TOP) -> str:
    """A ranking as HTML without script; everything in it is escaped."""
    places = listed_places(ranking, top)
    head = "".join(
        f'<th scope="col" style="{_LEFT if one.left else _RIGHT}">{html.escape(one.title)}'
        f"{f'<br>[{html.escape(one.unit)}]' if one.unit else ''}</th>"
        for one in ranking_columns(ranking)
    )
    rows = "".join(_html_row(ranking, place) for place in places)
    if ranking.winner is not None:
        best = f"Winner: {design_name(ranking.designs[ranking.winner])}."
    else:
        best = "No winner." if ranking.ranked else "None meets the requirements."
    texts = "<br>".join(html.escape(_MINUS.sub("\u2212", text)) for text in (best, *more_lines(ranking)))
    warnings = "".join(f"<br><b>Warning:</b> {html.escape(text)}" for text in ranking.warnings)
    title = f"{len(ranking):,} design{'' if len(ranking) == 1 else 's'} by mean S, {ranking.case.label}"
    more = len(ranking) - len(places)
    foot = f"<div>and {more:,} more</div>" if more > 0 else ""
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b><br>{texts}{warnings}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table>{foot}</div>"
    )


def _html_row(ranking: RankedDesigns, place: int) -> str:
    bold = ";font-weight:bold" if place == ranking.winner else ""
    cells = zip(ranking_columns(ranking), ranking_cells(ranking, place), strict=True)
    return (
        "<tr>"
        + "".join(
            f'<td style="{_LEFT if one.left else _RIGHT}{bold}">{html.escape(_MINUS.sub(chr(0x2212), cell))}</td>'
            for one, cell in cells
        )
        + "</tr>"
    )
