"""Finalists: what they scored where designs were chosen, and what on fresh scenarios."""

from __future__ import annotations

import dataclasses

from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Interval, Row
from studies.report.words.metric_text import requirement_text


@dataclasses.dataclass(frozen=True)
class FinalistRow:
    """One finalist.

    Attributes
    ----------
    row : Row
    fresh, optimism : Interval [m s]
    verdict : str
        What the fresh scenarios say of it.
    winner : bool
    """

    row: Row
    fresh: Interval
    optimism: Interval
    verdict: str
    winner: bool


def finalist_rows(table: CaseTable) -> tuple[FinalistRow, ...]:
    """All finalists in the order of the ranking; none without fresh scenarios."""
    return tuple(
        FinalistRow(row, row.fresh, row.optimism, _verdict(row, row.optimism), row is table.winner)
        for row in table.rows
        if row.fresh is not None and row.optimism is not None
    )


def _verdict(row: Row, optimism: Interval) -> str:
    if optimism.low > 0.0:
        said = "the search flattered it"
    elif optimism.high < 0.0:
        said = "better on the fresh departures"
    else:
        said = "within chance"
    return "; ".join((said, *(f"misses {requirement_text(text)} there" for text in row.fresh_unmet)))
