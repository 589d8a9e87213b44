"""What the first of the ranking is measured against: the next design, one that may be the best, one of another law."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from studies.ranking.standard_error import error_parts, lengths
from studies.report.context import Context
from studies.report.figures.precision import Needed, needed_scenarios
from studies.report.tables.row import Interval, Row, is_baseline

_SAME = 1e-6
"""Differences of mean S [m s] up to this are solver tolerance, as in the set of best."""


@dataclasses.dataclass(frozen=True)
class Rival:
    """A design beside the first of the ranking.

    Attributes
    ----------
    row : Row
    other_law : bool
        Whether it is the best one of another law, or just the next design.
    values : (n,) [m s]
        Paired differences of S to the first.
    difference : Interval [m s]
        Their mean, with the ranking's own interval, which holds for all designs at once.
    error : float [m s]
        Standard error of the mean.
    needed : Needed
    """

    row: Row
    other_law: bool
    values: npt.NDArray[np.float64]
    difference: Interval
    error: float
    needed: Needed

    @property
    def half_width(self) -> float:
        """Of the interval [m s]."""
        return 0.5 * (self.difference.high - self.difference.low)

    @property
    def same(self) -> bool:
        """Whether the two cannot be told from one another at all: no difference, in mean or in any departure."""
        unchanging = self.error == 0.0 and math.isfinite(self.half_width)
        return abs(self.difference.value) <= _SAME or unchanging

    @property
    def apart(self) -> bool:
        """Whether the interval leaves zero out."""
        return self.difference.low > 0.0 or self.difference.high < 0.0


def rivals(context: Context) -> tuple[Rival, ...]:
    """The second of the ranking, the first other design of the set of best, and the best design of another law.

    Some may be the same one; there are none for one design. While anything is ranked, all of them are.
    """
    first, *others = context.primary.rows
    others = [row for row in others if row.rank or not first.rank]
    may_be_best = [row for row in others if row.in_set][:1]
    other_law = [row for row in others if row.design.law != first.design.law and not is_baseline(row)][:1]
    chosen = list({row.place: row for row in (*others[:1], *may_be_best, *other_law)}.values())
    side, S = context.scenarios.side, context.S(first)
    found = []
    for row in chosen:
        values = context.S(row) - S
        error = float(lengths(error_parts(values[None], side))[0])
        half = 0.5 * (row.difference.high - row.difference.low)
        needed = needed_scenarios(len(context.scenarios), row.difference.value, half, error)
        found.append(Rival(row, row.design.law != first.design.law, values, row.difference, error, needed))
    return tuple(found)
