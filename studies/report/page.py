"""The page: all sections in their order, with styles, script and data, in one file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

from markupsafe import Markup

from studies.report.context import Context
from studies.report.embedded.packed import script_json
from studies.report.inputs import ReportInput
from studies.report.rendering import asset, render
from studies.report.section import Drawing, Section
from studies.report.sections import (
    answer,
    confidence,
    departures,
    distributions,
    failures,
    landscape,
    ranking,
    robustness,
    scenario_model,
    settings,
    trade_offs,
)
from studies.report.words import prose

SECTIONS: Final[tuple[Callable[[Context], Section], ...]] = (
    answer.section,
    ranking.section,
    trade_offs.section,
    landscape.section,
    departures.section,
    distributions.section,
    confidence.section,
    scenario_model.section,
    robustness.section,
    failures.section,
    settings.section,
)
"""What makes each section, in the order of the page: who wins, how sure, at what cost, how made."""


@dataclasses.dataclass(frozen=True)
class Page:
    """A report that was made.

    Attributes
    ----------
    html : str
        The whole document; the same input gives the same text.
    sections : tuple of Section
    """

    html: str
    sections: tuple[Section, ...]

    @property
    def drawings(self) -> tuple[Drawing, ...]:
        """All figures, in the order of the page."""
        return tuple(drawing for section in self.sections for drawing in section.drawings)


def make_page(report: ReportInput) -> Page:
    """Make the report.

    Parameters
    ----------
    report : ReportInput

    Returns
    -------
    Page

    Raises
    ------
    InputError
        If the results hold no design, scenario or case, or the rankings do not belong to the cases.
    """
    context = Context.of(report)
    sections = tuple(make(context) for make in SECTIONS)
    scripts = dict.fromkeys(("ldc.js", *(name for section in sections for name in section.scripts)))
    styles = dict.fromkeys(name for section in sections for name in section.styles)
    html = render(
        "report.html",
        report=context.report,
        primary=context.primary,
        tables=context.tables,
        every=context.every,
        plant=prose.plant(context.report),
        sections=sections,
        style=Markup("\n").join((asset("report.css"), *(asset(f"css/{name}") for name in styles))),
        script=Markup("\n").join(asset(f"js/{name}") for name in scripts),
        data=Markup(script_json({section.id: section.data for section in sections if section.data is not None})),
    )
    return Page(str(html), sections)
