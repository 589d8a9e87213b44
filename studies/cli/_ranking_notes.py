"""What is said below a printed ranking."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from studies.ranking.ranking import Ranking


def ranking_notes(ranking: Ranking) -> Iterator[str]:
    """Sentences on the set of best, the baseline, fresh scenarios, requirements and the Pareto front."""
    others = int(ranking.set_of_best.sum()) - 1
    if others > 0:
        yield (
            f"=: not told apart from the best on these scenarios ({others} design{'s' if others > 1 else ''}); the "
            f"truly best one is among these with {100 * ranking.confidence:g} % confidence"
        )
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
    winner, baseline = ranking.winner, ranking.baseline
    if winner is None or baseline is None or winner == baseline:
        return
    low, high = ranking.baseline_difference_low[winner], ranking.baseline_difference_high[winner]
    yield (
        f"Winner against the baseline ({ranking.designs[baseline].label}): "
        f"{ranking.baseline_difference[winner]:+.4f} m s ({low:+.4f} .. {high:+.4f})"
    )


def _fresh(ranking: Ranking) -> Iterator[str]:
    if not ranking.fresh_scenarios or ranking.winner is None:
        return
    i = ranking.winner
    yield (
        f"Winner on {ranking.fresh_scenarios:,} fresh scenarios: # {ranking.rank[i]}, {ranking.designs[i].label}, "
        f"fresh S {ranking.fresh_S[i]:.4f} m s ({ranking.fresh_low[i]:.4f} .. {ranking.fresh_high[i]:.4f}); the search "
        f"had {ranking.S[i]:.4f}, {abs(ranking.optimism[i]):.4f} too {'low' if ranking.optimism[i] >= 0 else 'high'}"
    )
