"""``ranking.md``: a ranking to be read by itself, in Markdown."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from ..ranking.ranked_designs import SCORE
from ..ranking.ranking import Ranking
from ..ranking.verdict import (
    COLUMNS_TEXT,
    Verdict,
    listed_places,
    more_lines,
    other_cases,
    ranking_table,
    verdict_lines,
)
from ..storage.files import write_text
from ..storage.manifest import Manifest
from ..study_file import Study
from ..tables import markdown_text, to_markdown

MOST_ROWS: Final = 50  # designs of a Markdown file; those that are named follow


def write_markdown(rankings: Sequence[Ranking], path: Path, study: Study, manifest: Manifest, found: Verdict) -> None:
    """Write rankings as one Markdown file, whole or not at all."""
    write_text(path, ranking_markdown(rankings, study, manifest, found))


def ranking_markdown(rankings: Sequence[Ranking], study: Study, manifest: Manifest, found: Verdict) -> str:
    """The text of ``ranking.md``; the same rankings give the same text."""
    return "\n".join(_blocks(rankings, study, manifest, found))


def _blocks(rankings: Sequence[Ranking], study: Study, manifest: Manifest, found: Verdict) -> Iterator[str]:
    first = rankings[0]
    yield f"# {markdown_text(study.title or study.name)}\n"
    title, *others = verdict_lines(found)
    yield f"**{markdown_text(title)}**\n"
    yield "".join(f"- {markdown_text(line)}\n" for line in (*others, *more_lines(first)))
    for warning in first.warnings:
        yield f"> **Warning:** {markdown_text(warning)}\n"
    places = listed_places(first, MOST_ROWS)
    yield to_markdown(ranking_table(first, places))
    if len(places) < len(first):
        yield f"{len(places):,} of {len(first):,} designs; all of them are in `ranking.csv`.\n"
    window = "the whole departure" if first.case.window == "departure" else "the time under control"
    about = f"{SCORE}. Here it is taken over {window}. Intervals hold for all designs at once. {COLUMNS_TEXT}"
    yield f"{markdown_text(about)}\n"
    n_left, n_right = study.scenarios.counts
    synthetic = "; synthetic, not fitted to recorded driving" if manifest.model_synthetic else ""
    facts = (
        f"Study: {study.name}",
        f"{study.scenarios.source}: {manifest.model} (content {manifest.model_hash[:12]}){synthetic}",
        f"Scenarios: {n_left + n_right:,} ({n_left:,} left, {n_right:,} right), seed {study.seed}",
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
        yield "".join(f"- {markdown_text(line)}\n" for line in other_cases(rankings))
