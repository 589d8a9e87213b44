"""Trips that hold planted departures one after the other, as they truly were: no sensor yet.

Before and after each departure the vehicle is inside its lane. From a crossing at the lateral speed s it comes to rest
beside the line within at most `LONGEST_APPROACH`, on a quintic without bend at the line; between two such rests it
moves over smoothly, to the other line where the next departure is on the other side. Speed and curvature go on as
cubics that leave one departure with its slope and enter the next with that one's. Trips hold departures of similar
speed."""

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import DepartureParameters

from .planted import STEP, Planted, plant

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

VEHICLE_WIDTH = 1.82
LANE_WIDTH, WIDTH_SWING, WIDTH_PERIOD = 3.6, 0.1, 97.0
"""The lane's width [m] swings slowly: mean, amplitude, period [s]."""

LONGEST_APPROACH = 2.0  # s, between the line and the rest beside it
REST = (0.1, 0.6)  # distance from the line [m] at rest: least, most
CROSSING_OVER = (2.0, 4.0)  # s, from one rest to the next
LEAD = 6.0  # s, before a trip's first departure and after its last
HELD = 1.0  # s for which the curvature stays outside a departure where it is said to be held


@dataclasses.dataclass(frozen=True)
class Drive:
    """Trips of m samples in all, road frame of ISO 8855; and the n departures in them.

    Attributes
    ----------
    trip : (m,) int
        Number of each sample's trip, from 0.
    tick : (m,) int
        Time on the trip's clock in steps of 0.1 s.
    lane_offset, lane_width, speed, curvature : (m,)
        SI units, positive to the left.
    planted : Planted
        The departures.
    event_trip : (n,) int
        Trip of each departure.
    start_time : (n,) [s]
        Crossing outwards, on the trip's clock.
    """

    trip: IntArray
    tick: IntArray
    lane_offset: FloatArray
    lane_width: FloatArray
    speed: FloatArray
    curvature: FloatArray
    planted: Planted
    event_trip: IntArray
    start_time: FloatArray


def drive(p: DepartureParameters, seed: int, *, events_a_trip: int = 40, curvature_held: bool = False) -> Drive:
    """Drive departures.

    Parameters
    ----------
    p : DepartureParameters
        n departures, in any order.
    seed : int
        Draws the order inside trips, the times between departures, their phase to the clock, the residuals' modes.
    events_a_trip : int
        Departures in a trip.
    curvature_held : bool
        Outside a departure the lane's curvature stays for one second what it was at the crossing instead of going on.
    """
    rng = np.random.default_rng(seed)
    event_trip = np.arange(p.n) // events_a_trip
    by_speed = np.argsort(p.v_mean, kind="stable")
    planted = plant(p.take(by_speed[np.lexsort((rng.random(p.n), event_trip))]), STEP * (1.0 - rng.random(p.n)), rng)
    T = planted.parameters.T
    approach = np.minimum(LONGEST_APPROACH, 2.0 * REST[1] / np.abs(planted.slope))
    # one long clock of whole steps; each event's first sample lies on one
    closes = np.append(event_trip[1:] != event_trip[:-1], True)
    gap = approach[:, 1] + np.append(approach[1:, 0], 0.0) + rng.uniform(*CROSSING_OVER, p.n)
    span = np.ceil((T + np.where(closes, 3.0 * LEAD, gap)) / STEP).astype(np.int64) + 1
    first_tick = int(2.0 * LEAD / STEP) + np.cumsum(span) - span
    start = first_tick * STEP - planted.first
    opens = np.concatenate([[True], closes[:-1]])
    begin = np.floor((start[opens] - LEAD) / STEP).astype(np.int64)
    samples = np.ceil((start + T + LEAD)[closes] / STEP).astype(np.int64) - begin
    trip = np.repeat(np.arange(begin.size), samples)
    tick = np.arange(trip.size) - np.repeat(np.cumsum(samples) - samples, samples)
    clock = (tick + begin[trip]) * STEP

    width = LANE_WIDTH + WIDTH_SWING * np.sin(2.0 * np.pi * clock / WIDTH_PERIOD)
    margin = 0.5 * (width - VEHICLE_WIDTH)
    # every sample as if it were between two departures; then the samples inside departures are put in their places
    before = np.searchsorted(start, clock, "right") - 1
    here = np.maximum(before, 0)
    alone = (before < 0) | (event_trip[here] != trip)  # before the trip's first departure
    last = closes[here] & ~alone  # after its last
    here, there = np.where(alone, before + 1, here), np.where(last, before, before + 1)
    since, until = np.where(alone, np.inf, clock - (start + T)[here]), np.where(last, np.inf, start[there] - clock)
    inside = since < 0.0
    since, until = np.maximum(since, 0.0), np.maximum(until, 0.0)
    side = planted.parameters.side
    left_behind = side[here] * (margin - _away(since, planted.slope[here, 1], approach[here, 1]))
    ahead = side[there] * (margin - _away(until, planted.slope[there, 0], approach[there, 0]))
    over = _share(since - approach[here, 1], until - approach[there, 0])
    offset = left_behind + (ahead - left_behind) * (10.0 - 15.0 * over + 6.0 * over**2) * over**3
    q, a = planted.parameters, planted.parameters.a_mean
    speed = _cubic(since, until, (planted.v_ends[here, 1], planted.v_ends[there, 0]), (a[here], a[there]))
    change = side * q.dc / T * (0.0 if curvature_held else 1.0)
    held = HELD if curvature_held else 0.0
    ends = ((side * (q.c_0 + q.dc))[here], (side * q.c_0)[there])
    curvature = _cubic(
        np.maximum(since - held, 0.0), np.maximum(until - held, 0.0), ends, (change[here], change[there])
    )

    event, j = np.nonzero(planted.inside)
    row = np.flatnonzero(inside)
    if row.size != event.size:  # each sample inside a departure has one row, in the same order
        raise RuntimeError(f"{row.size} rows for {event.size} samples")
    offset[row] = side[event] * (planted.y[event, j] + margin[row])
    speed[row] = planted.v[event, j]
    curvature[row] = side[event] * planted.c[event, j]
    return Drive(trip, tick, offset, width, speed, curvature, planted, event_trip, start - begin[event_trip] * STEP)


def _away(u: FloatArray, slope: FloatArray, approach: FloatArray) -> FloatArray:
    """Distance from the line, u seconds from a crossing: at rest after the approach."""
    slope = np.abs(slope)
    rest = np.clip(0.5 * slope * approach, *REST)
    s = np.minimum(u / approach, 1.0)
    moving = slope * approach * (s - 6.0 * s**3 + 8.0 * s**4 - 3.0 * s**5)
    return np.asarray(moving + rest * (10.0 - 15.0 * s + 6.0 * s**2) * s**3)


def _share(since: FloatArray, until: FloatArray) -> FloatArray:
    """Share of the way between two ends, 0 before and 1 after it; 0 or 1 where one end is infinitely far."""
    since, until = np.maximum(since, 0.0), np.maximum(until, 0.0)
    away = np.isinf(since)
    total = np.where(away, 1.0, since) + until
    share = np.where(np.isinf(until), 0.0, np.where(away, 1.0, since) / np.where(total > 0.0, total, 1.0))
    return np.where(away, 1.0, share)


def _cubic(
    since: FloatArray, until: FloatArray, ends: tuple[FloatArray, FloatArray], slopes: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """The cubic between two ends with their slopes; constant where one end is infinitely far."""
    s = _share(since, until)
    span = np.where(np.isinf(since) | np.isinf(until), 0.0, since + until)
    line = ends[0] + (ends[1] - ends[0]) * (3.0 - 2.0 * s) * s**2
    return np.asarray(line + span * (s * (1.0 - s) ** 2 * slopes[0] - s**2 * (1.0 - s) * slopes[1]))
