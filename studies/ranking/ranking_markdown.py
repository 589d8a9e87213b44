"""``ranking.md``: the ranking to be read in a repository, an issue or a chat, as GitHub-flavoured Markdown."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from studies.ranking.markdown_text import markdown_table, markdown_text
from studies.ranking.ranking import SCORE, failures, marks, ranking_sentences
from studies.storage.files import write_text

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking

MOST_ROWS: Final = 50
"""First designs of the ranking that are listed; those with a mark of their own follow."""

_MOST_TAGGED: Final = 50
"""Designs behind these that are listed for their mark."""


@dataclasses.dataclass(frozen=True)
class StudyHead:
    """What stands above the ranking. Plain text; it is escaped.

    Attributes
    ----------
    title, name : str
        Of the study.
    model : str
        The scenario model and its content hash.
    synthetic : bool
        Whether that model was fitted to invented driving.
    left, right : int
        Scenarios.
    seed : int
    """

    title: str
    name: str
    model: str
    synthetic: bool
    left: int
    right: int
    seed: int


def write_markdown(rankings: Sequence[Ranking], path: str | Path, head: StudyHead) -> None:
    """Write rankings as one Markdown file, whole or not at all.

    Parameters
    ----------
    rankings : sequence of Ranking
        The primary case first: its table is written, of the others a line.
    path : path
    head : StudyHead

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    write_text(Path(path), ranking_markdown(rankings, head))


def ranking_markdown(rankings: Sequence[Ranking], head: StudyHead) -> str:
    """The text of ``ranking.md``; the same rankings give the same text.

    Parameters
    ----------
    rankings : sequence of Ranking
    head : StudyHead

    Returns
    -------
    str
    """
    return "\n".join(_blocks(rankings, head))


def listed_places(ranking: Ranking) -> list[int]:
    """Places of the designs that are listed: the first ones, and behind them those with a mark of their own."""
    named = [place for place in (ranking.winner, ranking.baseline) if place is not None]
    tagged = dict.fromkeys((*named, *ranking.best_of_each_law(), *np.flatnonzero(ranking.pareto).tolist()))
    behind = [place for place in tagged if place >= MOST_ROWS][:_MOST_TAGGED]
    return sorted({*range(min(MOST_ROWS, len(ranking))), *behind})


def _blocks(rankings: Sequence[Ranking], head: StudyHead) -> Iterator[str]:
    first = rankings[0]
    yield f"# {markdown_text(head.title)}\n"
    synthetic = "; synthetic, not fitted to recorded driving" if head.synthetic else ""
    facts = (
        f"Study: {head.name}",
        f"Scenario model: {head.model}{synthetic}",
        f"Scenarios: {head.left + head.right:,} ({head.left:,} left, {head.right:,} right), seed {head.seed}",
        f"Case: {first.case.label}",
        *(ranking_sentences(first)),
    )
    yield "".join(f"- {markdown_text(fact)}\n" for fact in facts)
    for warning in first.warnings:
        yield f"> **Warning:** {markdown_text(warning)}\n"
    places = listed_places(first)
    yield _table(first, places)
    if len(places) < len(first):
        yield f"{len(places):,} of {len(first):,} designs; all of them are in `ranking.csv`.\n"
    window = "the whole departure" if first.case.window == "departure" else "the time under control"
    yield (
        f"{markdown_text(SCORE)}. Here it is taken over {window}. Intervals stand in parentheses, for all designs of a "
        "column at once. Reduction: against no control, on the scenarios that designs were chosen on. Failed: "
        "scenarios, which count at least as bad as without control.\n"
    )
    if first.failed:
        yield "## Failed designs\n"
        yield "".join(f"- {markdown_text(one.sentence)}\n" for one in first.failed[:MOST_ROWS])
        if len(first.failed) > MOST_ROWS:
            yield f"And {len(first.failed) - MOST_ROWS:,} more, see `ranking.csv`.\n"
    if len(rankings) > 1:
        yield "## Other cases\n"
        yield "".join(
            f"- {markdown_text(f'{one.case.label}: {next(ranking_sentences(one))}')}\n" for one in rankings[1:]
        )


def _table(ranking: Ranking, places: Sequence[int]) -> str:
    fresh = bool(ranking.fresh_scenarios)
    headings = ["Rank", "Design", "Mean S [m s]", "To the best [m s]", "Reduction", "Left S [m s]", "Right S [m s]",
                f"Deeper than {ranking.D_y:g} m", "Failed"]  # fmt: skip
    headings += ["Fresh S [m s]"] if fresh else []
    right = [name != "Design" for name in headings]
    headings, right = [*map(markdown_text, headings), "Marks"], [*right, False]
    return markdown_table(headings, right, (_row(ranking, place, fresh=fresh) for place in places))


def _row(ranking: Ranking, i: int, *, fresh: bool) -> list[str]:
    rank = int(ranking.rank[i])
    away = math.nan if i == 0 else ranking.difference[i]
    cells = [
        str(rank) if rank else "–",  # noqa: RUF001 - a dash, not a minus sign
        markdown_text(f"{ranking.designs[i].label} ({ranking.designs[i].id})"),
        _interval(ranking.S[i], ranking.S_low[i], ranking.S_high[i]),
        _interval(away, ranking.difference_low[i], ranking.difference_high[i], signed=True),
        _percent(ranking.reduction[i]),
        _number(ranking.S_left[i]),
        _number(ranking.S_right[i]),
        _percent(ranking.deeper[i]),
        str(failures(ranking, i)),
    ]
    if fresh:
        cells.append(_interval(ranking.fresh_S[i], ranking.fresh_low[i], ranking.fresh_high[i]))
    return [*cells, markdown_text(", ".join(marks(ranking, i)))]


def _interval(value: float, low: float, high: float, *, signed: bool = False) -> str:
    form = "+.4f" if signed else ".4f"
    if not np.isfinite(value):
        return "–"  # noqa: RUF001
    return f"{value:{form}} ({low:{form}} to {high:{form}})" if np.isfinite(low + high) else f"{value:{form}}"


def _number(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else "–"  # noqa: RUF001


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %" if np.isfinite(value) else "–"  # noqa: RUF001
