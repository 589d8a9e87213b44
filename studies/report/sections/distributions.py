"""Distributions over the departures: scores with and without control, left and right, and of what has a limit."""

from __future__ import annotations

from collections.abc import Iterator

from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.metrics import A_Y_LIMIT, DTLE_LIMIT, JERK_LIMIT
from studies.report.context import Context
from studies.report.figures.curves import score_curves
from studies.report.figures.limit_figure import axle_curves, comfort_curves, depth_curves, limit_figure
from studies.report.figures.scores import distribution_figure, sides_figure, sides_limit
from studies.report.rendering import render
from studies.report.replay.picks import SIDE_NAMES
from studies.report.section import Drawing, Section
from studies.report.tables.row import is_baseline
from studies.report.words.text import compact


def section(context: Context) -> Section:
    """The section."""
    sides, distribution, limits = (tuple(make(context)) for make in (_sides, _distribution, _limits))
    held = any(is_baseline(row) for row in context.primary.rows)
    body = render(
        "sections/distributions.html",
        sides=sides,
        distribution=distribution,
        limits=limits,
        own_change=_OWN_CHANGE.format(best=context.primary.best_name) if _own_windows(context) else "",
        own_window=_OWN_WINDOW.format(best=context.primary.best_name) if _own_windows(context) else "",
        how_limits=_how_limits(context, held=held),
        interventions=any(drawing.name == "distribution-a-y" for drawing in limits),
    )
    return Section("distributions", "Distributions", body, (*sides, *distribution, *limits))


_OWN_CHANGE = " over the design's own window, from its trigger on; the bar without control is over that of {best}"
_OWN_WINDOW = " The curve without control is over the window of {best}, from its trigger on."


def _own_windows(context: Context) -> bool:
    return context.case.case.window == "control"


def _how_limits(context: Context, *, held: bool) -> str:
    """How the panels with limits are read, and which point of the vehicle each is about."""
    without = "" if held else " Without such a design, the depth without control is that of the fitted path."
    return (
        "Share of departures (depth) or of interventions (acceleration, jerk) with less than the value on the "
        "horizontal axis; the dash-dotted line is the limit, and the legend tells the share beyond it. Depth is how "
        "far the vehicle\u2019s outer edge is beyond the lane line at most, negative if it stays inside. It is taken "
        f"at the centre of gravity for D_y = {compact(context.primary.D_y)} m, and at the front axle, where the "
        f"foremost outer tyre stands, for the {compact(-DTLE_LIMIT)} m that Euro NCAP and Regulation (EU) 2021/646 "
        f"allow.{without} Acceleration and jerk are what control adds to the recorded path, jerk as its mean over half "
        "a second; their limits are those of ISO 11270. "
        "Departures that failed are in as their path came out; an axis ends before a few far values. The limits are "
        "those of tests with prescribed manoeuvres and prove no conformity here."
    )


def _present(context: Context) -> list[int]:
    return [side for side in (LEFT, RIGHT) if (context.scenarios.side == side).any()]


def _sides(context: Context) -> Iterator[Drawing]:
    """The paper's bar figure."""
    rows, paper, of = list(context.shown), context.primary.paper_design, context.scenarios.side
    if paper is not None and paper.index not in {row.index for row in rows}:
        rows.append(paper)
    curves = {side: score_curves(context, rows, of == side) for side in _present(context)}
    limit = max(sides_limit(some) for some in curves.values())
    for side, some in curves.items():
        title = f"{SIDE_NAMES[side]} departures ({int((of == side).sum()):,})"
        name = f"score-{SIDE_NAMES[side].lower()}"
        yield Drawing(name, f"Mean and spread of S, {title}", sides_figure(some, title, limit))


def _distribution(context: Context) -> Iterator[Drawing]:
    """Distribution of S over the departures of each side."""
    for side in _present(context):
        title = f"{SIDE_NAMES[side]} departures"
        figure = distribution_figure(score_curves(context, context.shown, context.scenarios.side == side), title)
        yield Drawing(f"distribution-{SIDE_NAMES[side].lower()}", f"Distribution of S, {title}", figure)


def _limits(context: Context) -> Iterator[Drawing]:
    """Distribution of what a limit stands against: depth at two points of the vehicle, acceleration, jerk."""
    D_y = compact(context.primary.D_y)
    depth, axle = "Edge beyond the line, centre of gravity", "Edge beyond the line, front axle"
    for name, title, xlabel, curves, limit, limit_name in (
        ("deepest", depth, "Deepest crossing [m]", depth_curves(context), context.primary.D_y, f"D_y = {D_y} m"),
        (
            "axle", axle, "Deepest crossing [m]", axle_curves(context), -DTLE_LIMIT,
            f"{compact(-DTLE_LIMIT)} m, Euro NCAP and EU 2021/646",
        ),
        (
            "a-y", "Added lateral acceleration", "Added peak |a| [m/s²]", comfort_curves(context, "a_y_added_peak"),
            A_Y_LIMIT, f"{compact(A_Y_LIMIT)} m/s², ISO 11270",
        ),
        (
            "jerk", "Added lateral jerk", "Added peak |jerk| over 0.5 s [m/s³]",
            comfort_curves(context, "jerk_added_peak"), JERK_LIMIT, f"{compact(JERK_LIMIT)} m/s³, ISO 11270",
        ),
    ):  # fmt: skip
        if curves:
            figure = limit_figure(curves, title, xlabel, limit, limit_name)
            yield Drawing(f"distribution-{name}", f"Distribution: {title}", figure)
