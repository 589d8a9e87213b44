"""The ranking of a study, printed and written, as several commands need it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studies.cli._console import console
from studies.cli._ranking_notes import ranking_notes
from studies.cli._ranking_table import ranking_table
from studies.ranking.ranking import Ranking
from studies.ranking.ranking_csv import write_csv
from studies.ranking.ranking_markdown import StudyHead, write_markdown
from studies.results import Race, StudyResults
from studies.storage.manifest import Manifest
from studies.study_file.spec import Study

_TOP_OF_OTHER_CASES = 3
_MOST_FAILED = 20


def print_rankings(rankings: Sequence[Ranking], top: int) -> None:
    """The primary case in full, the others in short."""
    out = console()
    for i, ranking in enumerate(rankings):
        out.print(ranking_table(ranking, top if i == 0 else min(top, _TOP_OF_OTHER_CASES)))
        for note in ranking_notes(ranking):
            out.print(note, markup=False, emoji=False, highlight=False)
        for warning in ranking.warnings:
            out.print(f"Warning: {warning}", style="yellow", markup=False, emoji=False)
        out.print()
    _print_failed(rankings[0])


def _print_failed(ranking: Ranking) -> None:
    """Designs that have no rank, and why; a law's words are no markup."""
    out, failed = console(), ranking.failed
    if not failed:
        return
    out.print(f"{len(failed)} design{'s' if len(failed) > 1 else ''} failed and {'are' if len(failed) > 1 else 'is'} "
              "not ranked:", style="yellow")  # fmt: skip
    for one in failed[:_MOST_FAILED]:
        out.print(f"  {one.sentence}", markup=False, emoji=False, highlight=False, soft_wrap=True)
    if len(failed) > _MOST_FAILED:
        out.print(f"  and {len(failed) - _MOST_FAILED} more, see ranking.csv")
    out.print()


def print_race(race: Race) -> None:
    """One line a round, and what the race saved."""
    out = console()
    before = len(race.dropped) + race.alive[-1]
    for i, (size, alive) in enumerate(zip(race.rounds, race.alive, strict=True), start=1):
        given_up = f"{before - alive} of {before} design{'' if before == 1 else 's'} given up"
        out.print(f"round {i}: {size:,} scenario{'' if size == 1 else 's'}, {given_up}", highlight=False)
        before = alive
    share = 100 * race.runs / race.full_runs
    number = len(race.dropped)
    were = "1 design was" if number == 1 else f"{number} designs were"
    out.print(
        f"race: {race.runs:,} scenario runs, {share:.1f} % of the full study's; {were} separable from the best and "
        f"{'was' if number == 1 else 'were'} given up, see ranking.csv\n",
        highlight=False,
        soft_wrap=True,
    )


def write_ranking(
    folder: Path, study: Study, manifest: Manifest, results: StudyResults, rankings: Sequence[Ranking]
) -> Path:
    """Write DIR/ranking.csv and, to be read, DIR/ranking.md."""
    path = folder / "ranking.csv"
    write_csv(rankings, path, results.race)
    write_markdown(rankings, folder / "ranking.md", study_head(study, manifest))
    return path


def study_head(study: Study, manifest: Manifest) -> StudyHead:
    """What stands above a ranking that is read by itself."""
    return StudyHead(
        title=study.title or study.name,
        name=study.name,
        model=f"{manifest.model} (content {manifest.model_hash[:12]})",
        synthetic=manifest.model_synthetic,
        left=study.scenarios.left,
        right=study.scenarios.right,
        seed=study.seed,
    )
