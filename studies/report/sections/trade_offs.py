"""Trade-offs: what designs cost beside S."""

from __future__ import annotations

from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.tables.release_table import against_limits, limits_table


def section(context: Context) -> Section:
    """The section."""
    body = render(
        "sections/trade-offs.html",
        primary=context.primary,
        limits=limits_table(context.report, context.primary, context.ranking),
        against_limits=against_limits(context.report, context.primary, context.ranking),
    )
    return Section("trade-offs", "Trade-offs", body)
