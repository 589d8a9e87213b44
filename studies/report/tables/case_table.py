"""All designs of one case in the order of the ranking, and what follows from them."""

from __future__ import annotations

import dataclasses

from studies.paper_design import is_paper_design
from studies.report.tables.row import Row
from studies.results import Case, Race


@dataclasses.dataclass(frozen=True)
class CaseTable:
    """All designs of one case in the order of the ranking.

    Attributes
    ----------
    case : Case
    rows : tuple of Row
    uncorrected : float [m s]
        Mean S without control, over the window of the first design.
    uncorrected_deeper : float
        Share of the departures deeper than D_y without control.
    D_y : float [m]
    winner : Row or None
        The design to take, if there is one.
    baseline : Row or None
    require, pareto_figures : tuple of str
    fresh_scenarios : int
        On which the finalists were scored again; 0 for none.
    optimism_paired : bool
        Whether optimism is that of the difference to the baseline, or of S.
    tried : int
        Designs of the study, with those that failed or were given up in a race.
    race : Race or None
    confidence : float
        Of every interval.
    bootstrap : int
        Resamples behind the intervals of the ranking.
    warnings : tuple of str
        Of the ranking.
    """

    case: Case
    rows: tuple[Row, ...]
    uncorrected: float
    uncorrected_deeper: float
    D_y: float
    winner: Row | None
    baseline: Row | None
    require: tuple[str, ...]
    pareto_figures: tuple[str, ...]
    fresh_scenarios: int
    optimism_paired: bool
    tried: int
    race: Race | None
    confidence: float
    bootstrap: int
    warnings: tuple[str, ...]

    @property
    def first(self) -> Row:
        """The first of the ranking; where nothing is ranked, the lowest mean S."""
        return self.rows[0]

    @property
    def best(self) -> Row:
        """What figures follow: the winner, and where there is none, the first."""
        return self.first if self.winner is None else self.winner

    @property
    def best_name(self) -> str:
        """What to call `best` in a sentence."""
        if self.winner is not None:
            return "the winner"
        return "the first of the ranking" if self.ranked else "the design with the lowest mean S"

    @property
    def ranked(self) -> int:
        """How many designs have a rank."""
        return sum(row.rank > 0 for row in self.rows)

    @property
    def set_of_best(self) -> tuple[Row, ...]:
        """By rank; empty where nothing is ranked."""
        return tuple(row for row in self.rows if row.in_set)

    def best_of(self, law: str) -> Row | None:
        """The winner if it is of this law, else the law's first design."""
        if self.winner is not None and self.winner.design.law == law:
            return self.winner
        return next((row for row in self.rows if row.design.law == law), None)

    @property
    def best_of_each_law(self) -> tuple[Row, ...]:
        """`best_of` every law: the winner, then the others in the order of the ranking."""
        laws = dict.fromkeys(row.design.law for row in (self.best, *self.rows))
        return tuple(row for law in laws if (row := self.best_of(law)) is not None)

    @property
    def paper_design(self) -> Row | None:
        """The design of the paper's Table I, if the study holds it."""
        return next((row for row in self.rows if is_paper_design(row.design)), None)

    @property
    def failed(self) -> tuple[Row, ...]:
        """Designs with anything to report, in the order of the ranking."""
        return tuple(row for row in self.rows if row.failures or row.failed_solves)
