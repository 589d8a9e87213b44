"""Failures and limitations: what did not run as designed, and what the study does not say."""

from __future__ import annotations

from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.words import prose


def section(context: Context) -> Section:
    """The section."""
    body = render(
        "sections/failures.html",
        report=context.report,
        tables=context.tables,
        limitations=prose.limitations(context.report, context.primary),
    )
    return Section("failures", "Failures and limitations", body)
