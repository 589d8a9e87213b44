"""Departures that are kept with their signals, to be looked at: the deepest, and some drawn by lot."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterable, Sequence
from typing import Final, TypeVar

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, RIGHT, Departures, DepartureSignals

T = TypeVar("T")

KEPT: Final = 12
"""Departures of each kind that are kept of each source and side."""


@dataclasses.dataclass(frozen=True)
class DrawnEvent:
    """One departure with its signals, outward frame.

    Attributes
    ----------
    source, recording : str
        Where it was found.
    side : int
        `LEFT` or `RIGHT`.
    start_time : float [s]
        Of the crossing outwards, on the recording's clock.
    parameters : (8,)
        In the order of `PARAMETER_NAMES`.
    t, y, v, c : (k,) [s], [m], [m/s], [1/m]
        From crossing to crossing.
    lot : int
        Decides which departures are drawn by lot; from recording and time alone, so no split of the work matters.
    """

    source: str
    recording: str
    side: int
    start_time: float
    parameters: FloatArray
    t: FloatArray
    y: FloatArray
    v: FloatArray
    c: FloatArray
    lot: int

    @property
    def depth(self) -> tuple[float, str, float]:
        """Sorts the deepest first."""
        return (-float(self.parameters[1]), self.recording, self.start_time)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Departures to look at.

    Attributes
    ----------
    deepest : tuple of DrawnEvent
        Up to 12 of each source and side, deepest first; left before right.
    by_lot : tuple of DrawnEvent
        Up to 12 of each source and side, in the order of their lots; left before right.
    """

    deepest: tuple[DrawnEvent, ...] = ()
    by_lot: tuple[DrawnEvent, ...] = ()


def drawn_of(departures: Departures, signals: DepartureSignals, sources: list[str]) -> Drawn:
    """The departures to keep of n found ones."""
    found = list(zip(departures.recording.tolist(), departures.start_time.tolist(), strict=True))
    lots = [_lot(name, time) for name, time in found]
    depths = [(-depth, name, time) for depth, (name, time) in zip(departures.d_y.tolist(), found, strict=True)]
    matrix = departures.matrix()

    def event(i: int) -> DrawnEvent:
        rows = slice(int(signals.offsets[i]), int(signals.offsets[i + 1]))
        return DrawnEvent(
            sources[i],
            str(departures.recording[i]),
            int(departures.side[i]),
            float(departures.start_time[i]),
            matrix[i].copy(),
            signals.t[rows].copy(),
            signals.y[rows].copy(),
            signals.v[rows].copy(),
            signals.c[rows].copy(),
            lots[i],
        )

    deepest: list[DrawnEvent] = []
    by_lot: list[DrawnEvent] = []
    for places in _grouped(list(range(len(sources))), sources, departures.side.tolist()):
        deepest += [event(i) for i in sorted(places, key=depths.__getitem__)[:KEPT]]
        by_lot += [event(i) for i in sorted(places, key=lambda i: (lots[i], depths[i]))[:KEPT]]
    return Drawn(tuple(deepest), tuple(by_lot))


def joined_drawn(parts: Iterable[Drawn]) -> Drawn:
    """The departures to keep of several shares of the work."""
    given = list(parts)
    return Drawn(
        _best([event for part in given for event in part.deepest], lambda event: event.depth),
        _best([event for part in given for event in part.by_lot], lambda event: (event.lot, *event.depth)),
    )


def _best(events: list[DrawnEvent], key: Callable[[DrawnEvent], tuple[object, ...]]) -> tuple[DrawnEvent, ...]:
    groups = _grouped(events, [event.source for event in events], [event.side for event in events])
    return tuple(event for found in groups for event in sorted(found, key=key)[:KEPT])


def _grouped(items: Sequence[T], sources: Sequence[str], sides: Sequence[int]) -> list[list[T]]:
    """Items by source and side: sources as they first come, left before right."""
    groups: dict[str, dict[int, list[T]]] = {}
    for item, source, side in zip(items, sources, sides, strict=True):
        groups.setdefault(source, {LEFT: [], RIGHT: []})[side].append(item)
    return [found for both in groups.values() for found in both.values() if found]


def _lot(recording: str, start_time: float) -> int:
    digest = hashlib.blake2b(f"{recording}|{float(start_time)!r}".encode(), digest_size=7)
    return int.from_bytes(digest.digest(), "big")
