"""Figures of merit in sentences: what people call them, and requirements with their unit."""

from __future__ import annotations

from studies.ranking.figures import parse_requirement
from studies.report.embedded.shown_figures import shown_figure
from studies.report.words.text import unit_text

_BEFORE = ("mean", "largest", "median")
"""What a title ends with and a sentence begins with."""


def figure_name(name: str) -> str:
    """What a sentence calls a figure.

    Parameters
    ----------
    name : str
        As in `studies.ranking.figures.FIGURES`.

    Examples
    --------
    >>> figure_name("a_y_peak_mean"), figure_name("a_y_peak_p95"), figure_name("S")
    ('mean peak a_y', 'peak a_y (95 % quantile)', 'mean S')
    """
    title, _, rest = shown_figure(name).title.partition(", ")
    if title[1:2].islower():
        title = title[0].lower() + title[1:]
    if rest in _BEFORE:
        return f"{rest} {title}"
    return f"{title} ({rest})" if rest else title


def requirement_text(requirement: str) -> str:
    """A requirement with the unit of its limit; shares and counts have none.

    Parameters
    ----------
    requirement : str
        As `studies.ranking.figures.parse_requirement` takes it.

    Examples
    --------
    >>> requirement_text("a_y_peak_p95 <= 3"), requirement_text("deeper <= 0.1")
    ('a_y_peak_p95 <= 3 m/s²', 'deeper <= 0.1')
    """
    parsed = parse_requirement(requirement)
    unit = "" if parsed.figure.unit in ("share", "count") else unit_text(parsed.figure.unit)
    return f"{parsed.text} {unit}".rstrip()
