"""One departure as recorded and as its eight parameters have it: y with the parabola, v and c with their lines."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, DepartureParameters, curvature, lateral, speed
from ldctoolkit.recordings.drawn import KEPT, DrawnEvent
from studies.extraction_page.axis_ticks import Axis
from studies.extraction_page.quantities import CURVATURE_SCALE, CURVATURE_UNIT
from studies.extraction_page.svg_plot import Frame, picture
from studies.report.words.text import number, shorten

FloatArray = npt.NDArray[np.float64]

MOST_DOTS = 80
"""Samples drawn of one departure; of more, every k-th is drawn, the first and the last among them."""

MOST_EVENTS = 144
"""Departures drawn source by source, of both kinds together; with many sources there are fewer of each."""

_PARABOLA_POINTS = 33
_LEFT, _WIDTH = 46.0, 262.0


@dataclasses.dataclass(frozen=True)
class EventPanel:
    """A drawing and its words.

    Attributes
    ----------
    side : str
        ``left`` or ``right``.
    values : str
        d_y and T.
    place : str
        Recording and start time.
    source : str
    svg : Markup
    """

    side: str
    values: str
    place: str
    source: str
    svg: Markup


def event_panel(event: DrawnEvent) -> EventPanel:
    """Draw a departure and say which one it is."""
    values = dict(zip(PARAMETER_NAMES, event.parameters.tolist(), strict=True))
    side = "left" if event.side == LEFT else "right"
    said = f"d_y = {number(values['d_y'], 2)} m, T = {number(values['T'], 1)} s"
    place = f"{shorten(event.recording, 200)}, from {number(event.start_time, 1)} s"
    alt = (
        f"Departure to the {side}, {said}, recording {place}: samples and fit of lateral position, speed "
        f"{number(values['v_mean'], 1)} m/s on average, and curvature."
    )
    return EventPanel(side, said, place, event.source, _picture(event, alt))


def _picture(event: DrawnEvent, alt: str) -> Markup:
    side = np.array([event.side])
    fit = DepartureParameters(side, *(event.parameters[i : i + 1] for i in range(len(PARAMETER_NAMES))))
    finite = np.isfinite(event.t) & np.isfinite(event.y) & np.isfinite(event.v) & np.isfinite(event.c)
    rows = np.flatnonzero(finite)[_thinned(int(finite.sum()))]
    t, duration = event.t[rows], float(fit.T[0])
    ends, fine = np.array([0.0, duration]), np.linspace(0.0, duration, _PARABOLA_POINTS)
    c, fitted_c = CURVATURE_SCALE * event.c[rows], CURVATURE_SCALE * curvature(fit, ends)
    panels = (
        (24.0, 104.0, event.y[rows], fine, lateral(fit, fine), "y [m]", 0.1, 4),
        (158.0, 58.0, event.v[rows], ends, speed(fit, ends), "v [m/s]", 1.0, 4),
        (246.0, 58.0, c, ends, fitted_c, f"c [{CURVATURE_UNIT}]", 0.5, 4),
    )
    kind = "left" if event.side == LEFT else "right"
    parts = []
    for i, (top, height, values, at, fitted, label, least, ticks) in enumerate(panels):
        y = Axis.around(np.concatenate([values, fitted]), least=least)
        frame = Frame(_LEFT, top, _WIDTH, height, Axis(0.0, duration), y)
        last = i == len(panels) - 1
        parts += [
            frame.grid(x_ticks=5, y_ticks=ticks, x_label="Time since the crossing [s]" if last else "", y_label=label),
            frame.dots(t, values, f"dots {kind}"),
            frame.line(at, fitted, "fit"),
        ]
    return picture(320, 342, alt, *parts)


def _thinned(count: int) -> npt.NDArray[np.int64]:
    """At most `MOST_DOTS` rows of `count`, evenly spread, ends included."""
    return np.linspace(0, count - 1, min(count, MOST_DOTS)).round().astype(np.int64)


@dataclasses.dataclass(frozen=True)
class SourceEvents:
    """Departures of one source, drawn."""

    source: str
    deepest: tuple[EventPanel, ...]
    by_lot: tuple[EventPanel, ...]


def deepest_of_all(events: Sequence[DrawnEvent]) -> tuple[EventPanel, ...]:
    """The deepest ones of all sources together, deepest first."""
    return tuple(map(event_panel, sorted(events, key=lambda event: event.depth)[:KEPT]))


def by_lot_of_all(events: Sequence[DrawnEvent]) -> tuple[EventPanel, ...]:
    """Those of all sources together that the lot falls on first: every departure has the same chance."""
    return tuple(map(event_panel, sorted(events, key=lambda event: (event.lot, *event.depth))[:KEPT]))


def by_source(
    deepest: Sequence[DrawnEvent], by_lot: Sequence[DrawnEvent], sources: Sequence[str]
) -> tuple[SourceEvents, ...]:
    """Both kinds, source by source; of each as many as keep the page light.

    Parameters
    ----------
    deepest, by_lot : sequence of DrawnEvent
        In their order.
    sources : sequence of str
        Those to draw, in this order; one without departures is left out.
    """
    most = min(KEPT, max(1, MOST_EVENTS // (2 * max(len(sources), 1))))
    found = []
    for source in sources:
        kinds = ([event for event in kind if event.source == source][:most] for kind in (deepest, by_lot))
        panels = [tuple(map(event_panel, events)) for events in kinds]
        if any(panels):
            found.append(SourceEvents(source, *panels))
    return tuple(found)
