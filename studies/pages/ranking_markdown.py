"""``ranking.md``: a ranking to be read by itself, in Markdown."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ..ranking.ranked_designs import SCORE
from ..ranking.ranking import Ranking
from ..ranking.verdict import COLUMNS_TEXT, Verdict, listed_places, more_lines, ranking_table, verdict_lines
from ..storage.files import write_text
from ..storage.manifest import Manifest
from ..study_file import Study
from ..tables import markdown_text, to_markdown

MOST_ROWS: Final = 50  # designs of a Markdown file; those that are named follow


def write_markdown(ranking: Ranking, path: Path, study: Study, manifest: Manifest, found: Verdict) -> None:
    """Write a ranking as a Markdown file, whole or not at all."""
    write_text(path, ranking_markdown(ranking, study, manifest, found))


def ranking_markdown(ranking: Ranking, study: Study, manifest: Manifest, found: Verdict) -> str:
    """The text of ``ranking.md``; the same ranking gives the same text."""
    return "\n".join(_blocks(ranking, study, manifest, found))


def _blocks(ranking: Ranking, study: Study, manifest: Manifest, found: Verdict) -> Iterator[str]:
    yield f"# {markdown_text(study.title or study.name)}\n"
    title, *others = verdict_lines(found)
    yield f"**{markdown_text(title)}**\n"
    yield "".join(f"- {markdown_text(line)}\n" for line in (*others, *more_lines(ranking)))
    for warning in ranking.warnings:
        yield f"> **Warning:** {markdown_text(warning)}\n"
    places = listed_places(ranking, MOST_ROWS)
    yield to_markdown(ranking_table(ranking, places))
    if len(places) < len(ranking):
        yield f"{len(places):,} of {len(ranking):,} designs; all of them are in `ranking.csv`.\n"
    window = "the whole departure" if ranking.window == "departure" else "the time under control"
    about = f"{SCORE}. Here it is taken over {window}. Intervals hold for all designs at once. {COLUMNS_TEXT}"
    yield f"{markdown_text(about)}\n"
    n_left, n_right = study.scenarios.counts
    synthetic = "; synthetic, not fitted to recorded driving" if manifest.model_synthetic else ""
    facts = (
        f"Study: {study.name}",
        f"{study.scenarios.source}: {manifest.model} (content {manifest.model_hash[:12]}){synthetic}",
        f"Scenarios: {n_left + n_right:,} ({n_left:,} left, {n_right:,} right), seed {study.seed}",
        f"S: {ranking.label}",
    )
    yield "".join(f"- {markdown_text(fact)}\n" for fact in facts)
    if ranking.failed:
        yield "## Failed designs\n"
        yield "".join(f"- {markdown_text(one.sentence)}\n" for one in ranking.failed[:MOST_ROWS])
        if len(ranking.failed) > MOST_ROWS:
            yield f"And {len(ranking.failed) - MOST_ROWS:,} more, see `ranking.csv`.\n"
