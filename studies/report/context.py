"""What every section of a report is made from, worked out once."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.errors import InputError
from studies.ranking.ranking import Ranking
from studies.report.inputs import ReportInput
from studies.report.look.style import LineStyle, law_styles
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row, is_baseline
from studies.report.tables.tabulate import case_table
from studies.results import CaseResults

MOST_CURVES = 5
"""Designs in one figure; more cannot be told apart."""


@dataclasses.dataclass(frozen=True)
class Context:
    """A report's input and its tables.

    Attributes
    ----------
    report : ReportInput
        With the scenarios that can be driven under every design only.
    tables : tuple of CaseTable
        One a case, the primary one first.
    every : int
        Number of scenarios, those that cannot be driven included.
    """

    report: ReportInput
    tables: tuple[CaseTable, ...]
    every: int

    @classmethod
    def of(cls, report: ReportInput) -> Self:
        """Check the input and make the tables.

        Parameters
        ----------
        report : ReportInput

        Raises
        ------
        InputError
            If the results hold no design, scenario or case, or the rankings do not belong to the cases.
        """
        results = report.results
        if not results.designs or not results.cases or results.scenarios.n == 0:
            raise InputError(
                "report: the results hold no designs, no cases or no scenarios; allowed: at least one of each"
            )
        if len(report.rankings) != len(results.cases):
            raise InputError(
                f"report: {len(report.rankings)} rankings for {len(results.cases)} cases; allowed: one per case"
            )
        every, results = results.scenarios.n, results.drivable()
        if results.scenarios.n == 0:
            raise InputError("report: no scenario could be driven under every design; there is nothing to report on")
        report = dataclasses.replace(report, results=results)
        tables = tuple(case_table(results, i, ranking) for i, ranking in enumerate(report.rankings))
        return cls(report, tables, every)

    @property
    def primary(self) -> CaseTable:
        """The table of the primary case."""
        return self.tables[0]

    @property
    def ranking(self) -> Ranking:
        """Of the primary case."""
        return self.report.rankings[0]

    @property
    def case(self) -> CaseResults:
        """Results of the primary case."""
        return self.report.results.cases[0]

    @property
    def scenarios(self) -> Scenarios:
        """The n scenarios that can be driven."""
        return self.report.results.scenarios

    @cached_property
    def styles(self) -> dict[str, LineStyle]:
        """One style a law; the winner's line is solid."""
        return law_styles(row.design.law for row in self.primary.best_of_each_law)

    @cached_property
    def shown(self) -> tuple[Row, ...]:
        """The best design of each law that intervenes, the winner first: what figures compare."""
        return tuple(row for row in self.primary.best_of_each_law if not is_baseline(row))[:MOST_CURVES]

    def S(self, row: Row) -> npt.NDArray[np.float64]:
        """Scores of a design as they count, (n,) [m s]."""
        result: npt.NDArray[np.float64] = self.case.counted[row.index]
        return result

    def S_uncorrected(self, row: Row) -> npt.NDArray[np.float64]:
        """Scores without control over the same window, (n,) [m s]."""
        result: npt.NDArray[np.float64] = self.case.S_uncorrected[row.index]
        return result
