"""What a ranking says, in short plain sentences: for files and notebooks that hold nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking

SCORE: Final = (
    "S is the integral over time of |e_y|, the distance of the vehicle's centre from the lane's centre: less is better"
)
"""What every score means; no full stop, the window may follow."""


def ranking_sentences(ranking: Ranking) -> Iterator[str]:
    """The winner and its score, its gain over no control and over the baseline, the set of best, what is not ranked.

    Parameters
    ----------
    ranking : Ranking

    Yields
    ------
    str
        Plain text, not escaped; it holds titles of laws.
    """
    yield _winner(ranking)
    if ranking.winner is not None:
        yield from _gains(ranking, ranking.winner)
    yield from _set_of_best(ranking)
    if ranking.ranked < len(ranking):
        left = len(ranking) - ranking.ranked
        yield f"{_count(left, 'design')} of {len(ranking):,} not ranked: a requirement is missed."
    if ranking.failed:
        yield f"{_count(len(ranking.failed), 'design')} failed, without figures."
    if ranking.given_up:
        yield f"{_count(ranking.given_up, 'design')} given up in a race before."


def failures(ranking: Ranking, place: int) -> int:
    """Scenarios of a design in which its law did not do its work."""
    counts = (ranking.solver_failed, ranking.diverged, ranking.timed_out, ranking.crashed)
    return sum(int(count[place]) for count in counts)


def marks(ranking: Ranking, place: int) -> tuple[str, ...]:
    """What a design is called beside its rank: winner, set of best, Pareto, baseline, and what it misses."""
    found = []
    if place == ranking.winner:
        found.append("winner")
    elif ranking.set_of_best[place]:
        found.append("set of best")
    if ranking.pareto[place]:
        found.append("Pareto")
    if place == ranking.baseline:
        found.append("baseline")
    return (*found, *(f"misses {text}" for text in ranking.unmet[place]))


def _winner(ranking: Ranking) -> str:
    i, level = ranking.winner, f"{100.0 * ranking.confidence:g} % interval"
    if i is None:
        if not ranking.ranked:
            return "No design meets the requirements: none is ranked and none wins."
        if ranking.survivors_only:
            return "There is no winner: this case was not raced, and the best design may have been given up."
        return "There is no winner: no finalist meets the requirements on the fresh scenarios."
    label = ranking.designs[i].label
    if np.isfinite(ranking.fresh_S[i]):
        return (
            f"Winner: {label}, mean S {ranking.fresh_S[i]:.4f} m s on {ranking.fresh_scenarios:,} fresh scenarios "
            f"({level} {ranking.fresh_low[i]:.4f} to {ranking.fresh_high[i]:.4f})."
        )
    between = f" ({level} {ranking.S_low[i]:.4f} to {ranking.S_high[i]:.4f})" if np.isfinite(ranking.S_low[i]) else ""
    return f"Winner: {label}, mean S {ranking.S[i]:.4f} m s{between}."


def _gains(ranking: Ranking, i: int) -> Iterator[str]:
    b, fresh_share = ranking.baseline, float(ranking.fresh_reduction[i])
    known = b is not None and b != i and np.isfinite(fresh_share)
    if b is not None and known:
        other = "no control" if ranking.designs[b].is_baseline else ranking.designs[b].label
        yield f"On the same scenarios that is {_change(fresh_share)} than {other} ({ranking.fresh_S[b]:.4f} m s)."
    share = float(ranking.reduction[i])
    told = b is not None and known and ranking.designs[b].is_baseline
    if np.isfinite(share) and not told and not ranking.designs[i].is_baseline:
        if np.isfinite(ranking.fresh_S[i]):
            yield (
                f"On the scenarios that designs were chosen on it has mean S {ranking.S[i]:.4f} m s, {_change(share)} "
                f"than no control ({ranking.S_uncorrected[i]:.4f} m s)."
            )
        else:
            yield f"That is {_change(share)} than no control ({ranking.S_uncorrected[i]:.4f} m s)."
    if b is None or b == i:
        return
    fresh = bool(np.isfinite(ranking.fresh_baseline_difference[i]))
    name = "fresh_baseline_difference" if fresh else "baseline_difference"
    value, low, high = (float(getattr(ranking, name + end)[i]) for end in ("", "_low", "_high"))
    if np.isfinite(low):
        where = "on the fresh scenarios" if fresh else "for all designs at once"
        yield (
            f"Difference to the baseline, {ranking.designs[b].label}: {value:+.4f} m s (interval {low:+.4f} to "
            f"{high:+.4f}, {where})."
        )


def _set_of_best(ranking: Ranking) -> Iterator[str]:
    size = int(ranking.set_of_best.sum())
    if not ranking.ranked or ranking.survivors_only or len(ranking) == 1:
        return
    level = f"{100.0 * ranking.confidence:g} % confidence"
    if size > 1:
        yield f"Set of best: {size:,} designs, which these scenarios do not tell apart; it holds the best with {level}."
    else:
        yield f"Set of best: one design; with {level} no other ranked design is better."


def _change(reduction: float) -> str:
    return f"{100.0 * abs(reduction):.1f} % {'less' if reduction >= 0 else 'more'}"


def _count(number: int, one: str) -> str:
    return f"{number:,} {one}{'' if number == 1 else 's'}"
