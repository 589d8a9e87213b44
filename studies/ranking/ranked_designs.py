"""Designs of one case, best first, with all that is known of them: what verdicts and texts are made from."""

from __future__ import annotations

import dataclasses
from typing import Final

from ldctoolkit.arrays import BoolArray, IntArray
from studies.design import Design
from studies.ranking.case_figures import CaseFigures
from studies.ranking.fresh_scores import FreshScores
from studies.ranking.requirements import Miss, Requirement
from studies.ranking.simultaneous import Inference
from studies.results import Case, FailedDesign

SCORE: Final = (
    "S is the integral over time of |e_y|, the distance of the vehicle's centre from the lane's centre: less is better"
)
"""What every score means; no full stop, the window may follow."""


@dataclasses.dataclass(frozen=True, repr=False)
class RankedDesigns(CaseFigures, Inference, FreshScores):
    """Designs of one case, best first; every array has one entry a design in that order. Beside the fields below it
    has those of `CaseFigures` (means, tails, reductions, shares, counts and `release`), of `Inference` (intervals,
    set of best) and of `FreshScores` (the finalists and the winner).
    """

    case: Case  # Window and convention
    # d designs: those that meet all requirements, smallest mean S first, equal ones in the study's order; then the
    # others in the same way
    designs: tuple[Design, ...]
    index: IntArray  # (d,) Position of each in `StudyResults.designs`
    # (d,) 1 for the best; designs with the same mean S share a rank. 0 for a design that misses a requirement: it is
    # not ranked
    rank: IntArray
    missed: tuple[tuple[Miss, ...], ...]  # For each design, the requirements that it misses, and its values
    requirements: tuple[Requirement, ...]
    # The requirements, and behind them those of the sets ``stable``, ``comfort`` and ``physical``
    limits: tuple[Requirement, ...]
    baseline: int | None  # Position of the design behind `baseline_difference`
    # (d,) Ranked designs that no other ranked design beats in one figure of `pareto_figures` without being worse in
    # another
    pareto: BoolArray
    pareto_figures: tuple[str, ...]
    scenarios: int  # Study scenarios that could be driven under every design
    D_y: float  # [m]
    bootstrap: int  # Resamples
    confidence: float  # Of every family of intervals, and of the set of best
    warnings: tuple[str, ...]  # What a reader must know before comparing designs
    failed: tuple[FailedDesign, ...] = ()  # Designs whose law failed: they have no rank and no figures
    given_up: int = 0  # Designs that a race gave up before: they have no rank and no figures either
    # Whether that race was run by this case's S. If not, `set_of_best` and the other comparisons are of the survivors
    # of another race only, and there is no winner
    raced: bool = True

    def __len__(self) -> int:
        return len(self.designs)

    def __repr__(self) -> str:
        best = f"best {self.designs[0].label!r}, mean S {self.S[0]:.4g} m s" if self.ranked else "none is ranked"
        return f"<Ranking of {len(self)} designs, {self.case.label}: {best}>"

    @property
    def ranked(self) -> int:
        """Number of designs that have a rank; they are the first ones."""
        return int((self.rank > 0).sum())

    @property
    def require(self) -> tuple[str, ...]:
        """The requirements as text."""
        return tuple(one.text for one in self.requirements)

    @property
    def unmet(self) -> tuple[tuple[str, ...], ...]:
        """For each design, the requirements that it misses, as text."""
        return tuple(tuple(miss.requirement.text for miss in some) for some in self.missed)

    @property
    def survivors_only(self) -> bool:
        """Whether designs were given up by S of another case, which may have been the best of this one."""
        return self.given_up > 0 and not self.raced

    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of every law, best law first."""
        first: dict[str, int] = {}
        for i, design in enumerate(self.designs):
            first.setdefault(design.law, i)
        return tuple(first.values())
