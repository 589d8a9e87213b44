"""Departures: example paths with and without control."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from markupsafe import Markup

from studies.report.context import Context
from studies.report.figures.examples import Replay, replay
from studies.report.figures.path_figures import path_figure, path_limits
from studies.report.look.style import RECORDED
from studies.report.look.svg import line_sample
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.words.prose import design_text
from studies.report.words.text import percent, printable, symbols


@dataclasses.dataclass(frozen=True)
class Legend:
    """One entry of a legend outside the figures."""

    sample: Markup
    text: Markup


def section(context: Context) -> Section:
    """The section."""
    replayed = _replay(context)
    drawings = tuple(_paths(replayed))
    body = render(
        "sections/departures.html", report=context.report, replayed=replayed, paths=drawings, legend=_legend(context)
    )
    return Section("departures", "Departures", body, drawings)


def _replay(context: Context) -> Replay:
    """The example departures, driven again."""
    shown = [(row.index, row.design, printable(row.title), context.styles[row.design.law]) for row in context.shown]
    # where no control won, context.shown begins with the best design that intervenes
    return replay(context.report, context.case, shown) if shown else Replay((), 0.0)


def _paths(replayed: Replay) -> Iterator[Drawing]:
    limits = path_limits(replayed.examples) if replayed.examples else None
    for example in replayed.examples:
        yield Drawing(
            f"departure-{example.side}-{example.role}".lower().replace(" ", "-"),
            f"{example.side} departure, {example.role}: lateral position and steering angle over time",
            path_figure(example, limits),
            symbols(f"{example.facts}; S {_change(example.reduction)}"),
        )


def _legend(context: Context) -> list[Legend]:
    entries = [Legend(line_sample(RECORDED.color, RECORDED.dash), Markup("uncorrected path, no control"))]
    for row in context.shown:
        style = context.styles[row.design.law]
        entries.append(Legend(line_sample(style.color, style.dash), design_text(row)))
    return entries


def _change(reduction: float) -> str:
    return f"{'falls' if reduction >= 0 else 'rises'} by {percent(abs(reduction))}"
