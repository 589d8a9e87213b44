"""Failures and limitations: where the winner is worst, what did not run as designed, what the study does not say."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit import EventStatus
from studies.fit_page.style import MEANINGS, UNITS
from studies.report.context import Context
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.tables.row import is_baseline
from studies.report.tables.worst_departures import WORST, worst_departures
from studies.report.words import prose
from studies.results import FAILED_STATUSES

_MOST: Final = 100
"""Rows of a table here."""


def section(context: Context) -> Section:
    """The section."""
    race = context.report.results.race
    status, best = context.case.status, context.primary.best
    took_over = np.asarray(status[best.index] != EventStatus.NEVER_TRIGGERED)
    failed = np.isin(status[best.index], list(FAILED_STATUSES))
    worst = worst_departures(context.scenarios, context.S(best), took_over, failed)
    body = render(
        "sections/failures.html",
        report=context.report,
        primary=context.primary,
        tables=context.tables,
        worst=worst,
        named=[int(context.scenarios.index[row]) for row in worst.first] if worst else (),
        acts=not is_baseline(best) and bool(took_over.any()),
        share=WORST,
        meanings=MEANINGS,
        units=UNITS,
        given_up=race.dropped[::-1][:_MOST] if race is not None else (),
        most=_MOST,
        limitations=prose.limitations(context.report, context.primary),
    )
    return Section("failures", "Failures and limitations", body)
