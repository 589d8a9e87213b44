"""What is said below a printed ranking."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from studies.ranking.ranking import Ranking


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
