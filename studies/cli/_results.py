"""The ranking of a study, printed and written, as several commands need it."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ldctoolkit import controller_class
from studies.cli._console import add_row, console, gain_text, new_table
from studies.ranking.ranking import Ranking
from studies.ranking.ranking_csv import write_csv
from studies.ranking.ranking_markdown import StudyHead, write_markdown
from studies.results import Race, StudyResults
from studies.storage.manifest import Manifest
from studies.study_file.spec import Study

if TYPE_CHECKING:
    from rich.table import Table


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


def ranking_notes(ranking: Ranking) -> Iterator[str]:
    """Sentences on the set of best, the baseline, fresh scenarios, requirements and the Pareto front."""
    others = int(ranking.set_of_best.sum()) - 1
    if ranking.survivors_only:
        yield f"=: not told apart from the best of the {len(ranking)} survivors of another case's race; no winner here"
    elif others > 0:
        yield (
            f"=: not told apart from the best on these scenarios ({others} design{'s' if others > 1 else ''}); the "
            f"truly best one is among these with {100 * ranking.confidence:g} % confidence"
        )
    if ranking.given_up and not ranking.survivors_only:
        yield f"{ranking.given_up} of {ranking.given_up + len(ranking)} designs were given up in the race before"
    yield from _baseline(ranking)
    yield from _fresh(ranking)
    missed = Counter(text for texts in ranking.unmet for text in texts)
    if missed:
        listed = ", ".join(f"{text} ({number})" for text, number in missed.items())
        yield f"Not ranked: {len(ranking) - ranking.ranked} of {len(ranking)} designs, which miss {listed}"
    if ranking.pareto_figures and ranking.pareto.any():
        number = int(ranking.pareto.sum())
        yield (
            f"Pareto front over {', '.join(ranking.pareto_figures)}: {number} design{'s' if number > 1 else ''}, "
            "see ranking.csv"
        )


def _baseline(ranking: Ranking) -> Iterator[str]:
    """On the search's scenarios, where there are no fresh ones."""
    winner, baseline = ranking.winner, ranking.baseline
    if winner is None or baseline is None or winner == baseline or not np.isnan(ranking.fresh_S[winner]):
        return
    low, high = ranking.baseline_difference_low[winner], ranking.baseline_difference_high[winner]
    yield (
        f"Winner against the baseline ({ranking.designs[baseline].label}): "
        f"{ranking.baseline_difference[winner]:+.4f} m s ({low:+.4f} .. {high:+.4f})"
    )


def _fresh(ranking: Ranking) -> Iterator[str]:
    i, baseline = ranking.winner, ranking.baseline
    if not ranking.fresh_scenarios or i is None:
        return
    if np.isnan(ranking.fresh_S[i]):
        yield "The winner of this case was no finalist; it has no fresh score"
        return
    text = (
        f"On {ranking.fresh_scenarios:,} fresh scenarios the winner (# {ranking.rank[i]}, {ranking.designs[i].label}) "
        f"has S {ranking.fresh_S[i]:.4f} m s ({ranking.fresh_low[i]:.4f} .. {ranking.fresh_high[i]:.4f})"
    )
    if baseline is not None and i != baseline and not np.isnan(ranking.fresh_baseline_difference[i]):
        share = 100 * ranking.fresh_reduction[i]
        text += (
            f", {abs(share):.1f} % {'less' if share >= 0 else 'more'} than {ranking.designs[baseline].label} "
            f"(difference {_signed(ranking, 'fresh_baseline_difference', i)})"
        )
    yield text
    if ranking.fresh_difference[i] < 0 and ranking.fresh_difference_high[i] < 0:
        yield (
            "It was not the first of the search: fresh scenarios part the two "
            f"(difference {_signed(ranking, 'fresh_difference', i)})"
        )
    yield from _optimism(ranking, i)


def _optimism(ranking: Ranking, i: int) -> Iterator[str]:
    value, low, high = ranking.optimism[i], ranking.optimism_low[i], ranking.optimism_high[i]
    if np.isnan(value):
        return
    had = (
        f"difference to the baseline {ranking.baseline_difference[i]:+.4f}"
        if ranking.optimism_paired
        else f"S {ranking.S[i]:.4f}"
    )
    verdict = "within chance" if low <= 0 <= high else "more than chance"
    size = f"{abs(value):.4f} too {'low' if value >= 0 else 'high'}"
    yield f"The search had {had} m s: {size} ({low:+.4f} .. {high:+.4f}), {verdict}"


def _signed(ranking: Ranking, name: str, i: int) -> str:
    value, low, high = (getattr(ranking, name + end)[i] for end in ("", "_low", "_high"))
    return f"{value:+.4f} m s, {low:+.4f} .. {high:+.4f}"


def ranking_table(ranking: Ranking, top: int = 10) -> Table:
    """The first `top` designs, the best of each law, the winner and the baseline."""
    named = {place for place in (ranking.winner, ranking.baseline) if place is not None}
    shown = sorted({*range(min(top, len(ranking))), *ranking.best_of_each_law(), *named})
    headings = ["#", "law", "y_s\n[m]", "gains that differ\nfrom defaults", "mean S\n[m s]",
                f"{100 * ranking.confidence:g}%\ninterval", "to the best\n[m s]", "reduction", "left", "right",
                f"deeper\n{ranking.D_y:g} m", "failed"]  # fmt: skip
    if ranking.fresh_scenarios:
        headings.append("fresh S\n[m s]")
    table = new_table(f"{len(ranking)} designs by mean S, {ranking.case.label}", headings, left=(1, 3))
    for previous, i in zip([-1, *shown], shown, strict=False):
        if i > previous + 1:
            table.add_section()
        add_row(table, _cells(ranking, i), "bold" if i == ranking.winner else None)
    return table


def _cells(ranking: Ranking, i: int) -> list[str]:
    design = ranking.designs[i]
    gains = ", ".join(f"{name}={gain_text(value)}" for name, value in design.changed)
    tie = " =" if i and ranking.set_of_best[i] else ""
    failed = int(ranking.solver_failed[i] + ranking.diverged[i] + ranking.timed_out[i] + ranking.crashed[i])
    fresh = "-" if np.isnan(ranking.fresh_S[i]) else f"{ranking.fresh_S[i]:.4f}"
    return [
        str(ranking.rank[i]) if ranking.rank[i] else "-",
        controller_class(design.law).title,
        f"{design.y_s:g}",
        gains,
        f"{ranking.S[i]:.4f}",
        f"{ranking.S_low[i]:.3f} .. {ranking.S_high[i]:.3f}" if np.isfinite(ranking.S_low[i]) else "-",
        f"{ranking.difference[i]:+.4f}{tie}",
        *(_percent(values[i]) for values in (ranking.reduction, ranking.reduction_left, ranking.reduction_right)),
        _percent(ranking.deeper[i]),
        str(failed) if failed else "-",
        *([fresh] if ranking.fresh_scenarios else []),
    ]


def _percent(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"


def json_summary(results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path, report: Path) -> str:
    """The last line of ``ldc run --json``."""
    content = {"event": "done"} | _found(results, ranking, manifest)
    content |= {
        "wall_time_s": round(manifest.wall_time_s, 3),
        "executor": manifest.executor,
        "workers": manifest.workers,
        "ranking": str(ranking_csv),
        "report": str(report),
    }
    return json.dumps(content)


def rank_summary(results: StudyResults, ranking: Ranking, manifest: Manifest, ranking_csv: Path | None) -> str:
    """The one line of ``ldc rank --json``: what was found, and with which settings."""
    baseline = ranking.baseline
    content = {"event": "ranked"} | _found(results, ranking, manifest)
    content |= {
        "baseline": None if baseline is None else ranking.designs[baseline].id,
        "baseline_difference_m_s": None if ranking.winner is None else _number(
            ranking.baseline_difference[ranking.winner]
        ),
        "require": list(ranking.require),
        "not_ranked": [design.id for design, missed in zip(ranking.designs, ranking.unmet, strict=True) if missed],
        "pareto": list(ranking.pareto_figures),
        "pareto_front": [ranking.designs[i].id for i in range(len(ranking)) if ranking.pareto[i]],
        "confidence": ranking.confidence,
        "warnings": list(ranking.warnings),
        "ranking": None if ranking_csv is None else str(ranking_csv),
    }  # fmt: skip
    return json.dumps(content)


def _found(results: StudyResults, ranking: Ranking, manifest: Manifest) -> dict[str, Any]:
    race = results.race
    return {
        "study": manifest.study.get("name", ""),
        "study_hash": manifest.study_hash,
        "designs": len(results.designs),
        "scenarios": len(results.scenarios),
        "failed_designs": len(results.failed),
        "winner": None if ranking.winner is None else _design(ranking, ranking.winner),
        "set_of_best": [ranking.designs[i].id for i in range(len(ranking)) if ranking.set_of_best[i]],
        "race": race and {"dropped": len(race.dropped), "runs": race.runs, "full_runs": race.full_runs},
    }


def _design(ranking: Ranking, i: int) -> dict[str, Any]:
    design = ranking.designs[i]
    figures = {
        "S_m_s": ranking.S[i],
        "S_low_m_s": ranking.S_low[i],
        "S_high_m_s": ranking.S_high[i],
        "S_fresh_m_s": ranking.fresh_S[i],
    }
    return {
        "design": design.id,
        "law": design.law,
        "y_s_m": design.y_s,
        "gains": dict(design.gains),
        **{name: _number(value) for name, value in figures.items()},
    }


def _number(value: float) -> float | None:
    """JSON has no word for what is not a number."""
    return float(value) if math.isfinite(value) else None
