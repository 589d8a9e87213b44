"""Departures: an explorer of paths with and without control, and examples without script."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

from markupsafe import Markup

from ldctoolkit import EventStatus
from studies.paper_design import PAPER_LAW
from studies.report.context import Context
from studies.report.embedded.departures import fitted_departures
from studies.report.figures.examples import examples
from studies.report.figures.path_figures import Example, path_figure, path_limits
from studies.report.look.style import RECORDED, LineStyle
from studies.report.look.svg import line_sample
from studies.report.rendering import render
from studies.report.replay.picks import Chosen, chosen_designs, most_departures
from studies.report.section import Drawing, Section
from studies.report.tables.row import Row
from studies.report.words.prose import design_text
from studies.report.words.text import percent, printable, symbols

_ALIKE: tuple[tuple[float, ...], ...] = (
    (1.0, 1.2), (8.0, 1.5, 1.0, 1.5, 1.0, 1.5), (3.0, 3.0), (10.0, 4.0), (5.0, 1.5), (1.0, 3.0), (12.0, 2.0, 4.0, 2.0),
)  # fmt: skip
"""Dashes of further designs of one law."""


@dataclasses.dataclass(frozen=True)
class Legend:
    """One entry of a legend outside the figures."""

    sample: Markup
    text: Markup


@dataclasses.dataclass(frozen=True)
class Choice:
    """One design that the explorer offers."""

    sample: Markup
    text: Markup
    why: str
    checked: bool


def section(context: Context) -> Section:
    """The section."""
    designs = chosen_designs(context)
    took_over = [one for one in designs if (context.case.status[one.row.index] != EventStatus.NEVER_TRIGGERED).any()]
    if not took_over:
        body = render("sections/departures.html", report=context.report, replayed=None)
        return Section("departures", "Departures", body)
    every, replayed, data = fitted_departures(context, designs)
    designs = tuple(paths.chosen for paths in replayed.designs)
    styles = _styles(context, designs)
    found = examples(context, replayed)
    drawings = tuple(_drawings(found))
    body = render(
        "sections/departures.html",
        report=context.report,
        replayed=replayed,
        paths=drawings,
        legend=_legend(context),
        choices=_choices(context, designs, styles),
        recorded=line_sample(RECORDED.color, RECORDED.dash),
        every=every,
        total=context.scenarios.n,
        low=int(context.scenarios.index.min()),
        high=int(context.scenarios.index.max()),
        few=[(one.row.title, most) for one in designs if (most := most_departures(one)) and most < len(replayed.picks)],
        reference=context.primary.best_name if designs[0].row is context.primary.best else f"the {designs[0].why}",
    )
    data["designs"] = [_design(one, style) for one, style in zip(designs, styles, strict=True)]
    data["line"] = {"color": RECORDED.color, "dash": list(RECORDED.dash)}
    return Section(
        "departures",
        "Departures",
        body,
        drawings,
        data=data,
        scripts=("departure-paths.js", "departure-plot.js", "departures.js"),
        styles=("departures.css",),
    )


def _styles(context: Context, designs: tuple[Chosen, ...]) -> list[LineStyle]:
    """Each law's own; further designs of a law have its colour and another dash."""
    seen: dict[str, int] = {}
    styles = []
    for one in designs:
        style, again = context.styles[one.row.design.law], seen.get(one.row.design.law, 0)
        styles.append(dataclasses.replace(style, dash=_ALIKE[(again - 1) % len(_ALIKE)]) if again else style)
        seen[one.row.design.law] = again + 1
    return styles


def _choices(context: Context, designs: tuple[Chosen, ...], styles: list[LineStyle]) -> list[Choice]:
    """The first one is drawn from the start, and beside it the paper's controller or what differs otherwise."""
    shown = {0, _beside(context, designs)}
    return [
        Choice(line_sample(style.color, style.dash), design_text(one.row), one.why, k in shown)
        for k, (one, style) in enumerate(zip(designs, styles, strict=True))
    ]


def _beside(context: Context, designs: tuple[Chosen, ...]) -> int:
    """Table I, else the best of the paper's law, else the baseline, else the next law, else the next design."""
    paper, baseline, law = context.primary.paper_design, context.primary.baseline, designs[0].row.design.law
    rules: tuple[Callable[[Row], bool], ...] = (
        lambda row: paper is not None and row.index == paper.index,
        lambda row: row.design.law == PAPER_LAW != law,
        lambda row: baseline is not None and row.index == baseline.index,
        lambda row: row.design.law != law,
    )
    others = [(k, one.row) for k, one in enumerate(designs)][1:]
    return next((k for rule in rules for k, row in others if rule(row)), min(1, len(others)))


def _design(one: Chosen, style: LineStyle) -> dict[str, object]:
    """What the script knows of a design: its place in the ranking, its name and its line."""
    return {
        "place": one.row.place,
        "title": printable(one.row.title),
        "id": one.row.design.id,
        "y_s": one.row.design.y_s,
        "color": style.color,
        "dash": list(style.dash),
    }


def _drawings(found: tuple[Example, ...]) -> Iterator[Drawing]:
    limits = path_limits(found) if found else None
    for example in found:
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
