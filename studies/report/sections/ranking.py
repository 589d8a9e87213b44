"""Ranking: all designs of every case, with intervals, requirements and failures."""

from __future__ import annotations

from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row


def _bar(row: Row, table: CaseTable) -> str:
    """Width of the bar of S in per cent; full is 1.2 times no control."""
    full = 1.2 * table.uncorrected
    share = row.S.value / full if full > 0 else 0.0
    return f"{100.0 * min(share, 1.0):.1f}"


def section(context: Context) -> Section:
    """The section."""
    body = render(
        "sections/ranking.html",
        report=context.report,
        tables=context.tables,
        primary=context.primary,
        bar=_bar,
    )
    return Section("ranking", "Ranking", body, scripts=("ranking.js",))
