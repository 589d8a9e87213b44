"""The designs of a ranking that are driven on other plants: chosen by their places, by nobody's hand."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from studies.paper_design import is_paper_design

if TYPE_CHECKING:
    from studies.design import Design
    from studies.ranking.ranking import Ranking

MOST: Final = 10
"""Designs that steer; no control comes on top, it costs nothing."""

SLOW_BATCH: Final = 100
"""A law whose batches are smaller takes too long to be driven a dozen times more."""


@dataclasses.dataclass(frozen=True)
class ChosenDesigns:
    """What is driven, and what is not.

    Attributes
    ----------
    designs : tuple of Design
        d of them, the reference first: the winner, or where there is none the first of the ranking. Then the others in
        the order of the ranking.
    contends : tuple of bool
        Whether each has a rank among the others: not if it misses a requirement, unless all do.
    slow : tuple of str
        Registry names of laws that take too long.
    unsafe : tuple of str
        Labels of designs whose law ended or held up its process in the study: they are not run in this one.
    more : int
        Designs beyond `MOST` that were left out.
    """

    designs: tuple[Design, ...]
    contends: tuple[bool, ...]
    slow: tuple[str, ...]
    unsafe: tuple[str, ...]
    more: int


def chosen_designs(ranking: Ranking) -> ChosenDesigns:
    """Winner, baseline, the paper's Table I, and the best design of each law.

    Parameters
    ----------
    ranking : Ranking

    Returns
    -------
    ChosenDesigns
        Without designs where every law takes too long.
    """
    places = list(dict.fromkeys(_places(ranking)))
    of = {place: ranking.designs[place] for place in places}
    slow = dict.fromkeys(of[place].law for place in places if of[place].batch < SLOW_BATCH)
    unsafe = [place for place in places if ranking.crashed[place] or ranking.timed_out[place]]
    quick = [place for place in places if of[place].law not in slow and place not in unsafe]
    steering = [place for place in quick if not of[place].is_baseline]
    kept = {place for place in quick if of[place].is_baseline} | set(steering[:MOST])
    first = [place for place in places[:1] if place in kept]
    order = [*first, *sorted(kept - set(first))]
    anything = ranking.ranked > 0
    return ChosenDesigns(
        designs=tuple(of[place] for place in order),
        contends=tuple(bool(ranking.rank[place]) or not anything for place in order),
        slow=tuple(slow),
        unsafe=tuple(of[place].label for place in unsafe),
        more=len(steering[MOST:]),
    )


def _places(ranking: Ranking) -> list[int]:
    """Positions in the ranking, the most wanted first."""
    best = 0 if ranking.winner is None else ranking.winner
    first_of_law: dict[str, int] = {ranking.designs[best].law: best}
    for place, design in enumerate(ranking.designs):
        first_of_law.setdefault(design.law, place)
    paper = [place for place, design in enumerate(ranking.designs) if is_paper_design(design)]
    baseline = [] if ranking.baseline is None else [ranking.baseline]
    return [best, *baseline, *paper, *sorted(first_of_law.values())]
