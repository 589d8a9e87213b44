"""Failures and limitations: where the winner is worst, what did not run as designed, what the study does not say."""

from __future__ import annotations

from typing import Final

from studies.fit_page.style import MEANINGS, UNITS
from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.tables.worst_departures import WORST, worst_departures
from studies.report.words import prose

_MOST: Final = 100
"""Rows of a table here."""


def section(context: Context) -> Section:
    """The section."""
    race = context.report.results.race
    body = render(
        "sections/failures.html",
        report=context.report,
        primary=context.primary,
        tables=context.tables,
        worst=worst_departures(context.scenarios, context.S(context.primary.best)),
        share=WORST,
        meanings=MEANINGS,
        units=UNITS,
        given_up=race.dropped[::-1][:_MOST] if race is not None else (),
        most=_MOST,
        limitations=prose.limitations(context.report, context.primary),
    )
    return Section("failures", "Failures and limitations", body)
