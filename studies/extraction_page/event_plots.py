"""One departure as recorded and as its eight parameters have it: y with the parabola, v and c with their lines."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, DepartureParameters, curvature, lateral, speed
from ldctoolkit.recordings.drawn import KEPT, DrawnEvent
from studies.extraction_page.counts import SIDES
from studies.extraction_page.svg_plot import CURVATURE_SCALE, CURVATURE_UNIT, Axis, Frame, picture
from studies.report.words.text import number, shorten

MOST_DOTS = 80
"""Samples drawn of one departure; of more, every k-th is drawn, the first and the last among them."""

MOST_EVENTS = 288
"""Departures drawn source by source, of both kinds and sides together; with many sources there are fewer of each."""

MOST_DOTS_OF_SOURCE = 40
"""As `MOST_DOTS`, source by source, where there are many drawings."""

_PARABOLA_POINTS = 33
_SIDES = tuple(zip(SIDES, (LEFT, RIGHT), strict=True))
_LEFT, _WIDTH = 46.0, 262.0


@dataclasses.dataclass(frozen=True)
class EventPanel:
    """A drawing and its words."""

    side: str  # ``left`` or ``right``
    values: str  # d_y and T
    place: str  # recording and start time
    source: str
    svg: Markup


def event_panel(event: DrawnEvent, most_dots: int = MOST_DOTS) -> EventPanel:
    """Draw a departure and say which one it is."""
    values = dict(zip(PARAMETER_NAMES, event.parameters.tolist(), strict=True))
    side = "left" if event.side == LEFT else "right"
    said = f"d_y = {number(values['d_y'], 2)} m, T = {number(values['T'], 1)} s"
    place = f"{shorten(event.recording, 200)}, from {number(event.start_time, 1)} s"
    alt = (
        f"Departure to the {side}, {said}, recording {place}: samples and fit of lateral position, speed "
        f"{number(values['v_mean'], 1)} m/s on average, and curvature."
    )
    return EventPanel(side, said, place, event.source, _picture(event, alt, most_dots))


def _picture(event: DrawnEvent, alt: str, most_dots: int) -> Markup:
    side = np.array([event.side])
    fit = DepartureParameters(side, *(event.parameters[i : i + 1] for i in range(len(PARAMETER_NAMES))))
    finite = np.isfinite(event.t) & np.isfinite(event.y) & np.isfinite(event.v) & np.isfinite(event.c)
    rows = np.flatnonzero(finite)[_thinned(int(finite.sum()), most_dots)]
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


def _thinned(count: int, most: int) -> npt.NDArray[np.int64]:
    """At most `most` rows of `count`, evenly spread, ends included."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)


@dataclasses.dataclass(frozen=True)
class SideEvents:
    """Departures to one side, drawn; ``side`` is ``left`` or ``right``."""

    side: str
    panels: tuple[EventPanel, ...]


@dataclasses.dataclass(frozen=True)
class SourceEvents:
    """Departures of one source, drawn; sides without any are left out."""

    source: str
    deepest: tuple[SideEvents, ...]
    by_lot: tuple[SideEvents, ...]

    @property
    def counts(self) -> tuple[int, int]:
        """Drawings of the deepest, and of those by lot."""
        deepest, by_lot = (sum(len(one.panels) for one in kind) for kind in (self.deepest, self.by_lot))
        return deepest, by_lot


def deepest_of_all(events: Sequence[DrawnEvent]) -> tuple[SideEvents, ...]:
    """The deepest ones of all sources together, side by side, deepest first."""
    return _by_side(sorted(events, key=lambda event: event.depth), KEPT)


def by_lot_of_all(events: Sequence[DrawnEvent]) -> tuple[SideEvents, ...]:
    """Those of all sources together that the lot falls on first: every departure of a side has the same chance."""
    return _by_side(sorted(events, key=lambda event: (event.lot, *event.depth)), KEPT)


def most_of_source(sources: int) -> int:
    """Departures of each kind and side that are drawn of each of so many sources: as many as keep the page light."""
    return min(KEPT, max(1, MOST_EVENTS // (4 * max(sources, 1))))


def by_source(
    deepest: Sequence[DrawnEvent], by_lot: Sequence[DrawnEvent], sources: Sequence[str]
) -> tuple[SourceEvents, ...]:
    """Both kinds, source by source and side by side; of each as many as `most_of_source` says."""
    most = most_of_source(len(sources))
    found = []
    for source in sources:
        kinds = ([event for event in kind if event.source == source] for kind in (deepest, by_lot))
        panels = [_by_side(events, most, MOST_DOTS_OF_SOURCE) for events in kinds]
        if any(panels):
            found.append(SourceEvents(source, *panels))
    return tuple(found)


def _by_side(events: Sequence[DrawnEvent], most: int, most_dots: int = MOST_DOTS) -> tuple[SideEvents, ...]:
    """The first `most` of each side, left before right."""
    sides = [(name, [event for event in events if event.side == side][:most]) for name, side in _SIDES]
    return tuple(SideEvents(name, tuple(event_panel(one, most_dots) for one in some)) for name, some in sides if some)
