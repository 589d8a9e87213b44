"""Departures of one table of recordings, and the fate of every other candidate."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT, Departures, DepartureSignals, reduce_signals
from ldctoolkit.recordings.criteria import Criteria
from ldctoolkit.recordings.curvature import HALF_WINDOW, curvature_from_yaw_rate
from ldctoolkit.recordings.events import (
    ACCEPTED,
    CODE,
    GAP_FLOOR,
    GAP_STEPS,
    LANE_JUMP,
    LARGEST_ACCELERATION,
    REASONS,
    breaks,
    find_runs,
    median_steps,
    signals_of_runs,
)
from ldctoolkit.recordings.joined import no_departures
from ldctoolkit.recordings.table import RecordingTable, usable_samples

__all__ = ["ACCEPTED", "REASONS", "Found", "find_departures"]


@dataclasses.dataclass(frozen=True)
class Found:
    """What was found in a table of m samples of r recordings.

    Attributes
    ----------
    departures : Departures
        n departures.
    owner : (n,) int
        Index of the recording of each.
    signals : DepartureSignals
        Of the n departures.
    reason, side, recording : (c,) int
        Of each candidate: index into `REASONS` or `ACCEPTED`; side of its first crossing; index of its recording.
    read, driven : (r,) [s]
        Time between neighbours, and between usable neighbours, without gaps.
    usable : (m,) bool
        Samples that could be used.
    median_step : (r,) [s]
        Median time step; NaN for a recording with fewer than two times.
    """

    departures: Departures
    owner: IntArray
    signals: DepartureSignals
    reason: IntArray
    side: IntArray
    recording: IntArray
    read: FloatArray
    driven: FloatArray
    usable: BoolArray
    median_step: FloatArray


def find_departures(table: RecordingTable, criteria: Criteria, gap_limit: float | None = None) -> Found:
    """Find the departures of one table.

    Parameters
    ----------
    table : RecordingTable
        m samples of r recordings.
    criteria : Criteria
        What counts as a departure.
    gap_limit : float [s], optional
        Longest time step that is no gap; from the criteria, or from each recording's median step by default.

    Returns
    -------
    Found
        Departures, candidates, times.
    """
    usable = usable_samples(table)
    if not usable.all():  # infinities and absurd numbers would only raise floating point warnings further on
        table = _blanked(table, usable)
    place = np.flatnonzero(usable)
    median_step = median_steps(table)
    limit = _gap_limit(median_step, criteria, gap_limit)
    read = _seconds(table, np.arange(table.samples), limit, adjacent=False)
    none = np.empty(0, dtype=np.int64)
    if place.size == 0:
        no_signals = DepartureSignals(np.zeros(1, dtype=np.int64), *([np.empty(0)] * 4))
        driven = np.zeros(table.names.size)
        return Found(no_departures(), none, no_signals, none, none, none, read, driven, usable, median_step)
    same, cause = breaks(table, place, limit, criteria.max_jump)

    margin = 0.5 * (criteria.vehicle_width - table.lane_width)
    edges = {LEFT: table.lane_offset + margin, RIGHT: -table.lane_offset + margin}
    runs = find_runs(table, place, edges, same, cause)
    reason = runs.reason.copy()

    chosen = np.flatnonzero(reason == ACCEPTED)
    curvature = _curvature(table, usable, median_step, limit)
    signals, start_time, source = signals_of_runs(table, runs, chosen, edges, curvature)
    verdict = _judge(table, runs.side[chosen], signals, source, criteria)
    reason[chosen] = verdict

    run, kept, start_time = (
        chosen[verdict == ACCEPTED],
        _only(signals, verdict == ACCEPTED),
        start_time[verdict == ACCEPTED],
    )
    parameters = reduce_signals(kept, runs.side[run])
    plausible = (np.abs(parameters.a_mean) <= LARGEST_ACCELERATION) & (_lateral(kept) <= LARGEST_ACCELERATION)
    reason[run[~plausible]] = CODE["implausible"]
    owner = table.recording_index[runs.first[run]]
    departures = Departures(
        **{field.name: getattr(parameters, field.name) for field in dataclasses.fields(parameters)},
        recording=table.names[owner],
        start_time=start_time,
        samples=kept.samples,
    ).take(plausible)
    # a candidate's reason is the strongest of its runs', its side and recording are those of the first
    count = int(runs.candidate.max(initial=-1)) + 1
    by_candidate: IntArray = np.full(count, ACCEPTED, dtype=np.int64)
    np.minimum.at(by_candidate, runs.candidate, reason)
    _, first = np.unique(runs.candidate, return_index=True)
    return Found(
        departures=departures,
        owner=owner[plausible],
        signals=_only(kept, plausible),
        reason=by_candidate,
        side=runs.side[first],
        recording=table.recording_index[runs.first[first]],
        read=read,
        driven=_seconds(table, place, limit, adjacent=True),
        usable=usable,
        median_step=median_step,
    )


def _blanked(table: RecordingTable, usable: BoolArray) -> RecordingTable:
    """The same table with NaN for the numbers of unusable samples."""
    names = ("lane_offset", "lane_width", "speed", "curvature", "yaw_rate")
    changed: dict[str, Any] = {}
    for name in names:
        values = getattr(table, name)
        changed[name] = None if values is None else np.where(usable, values, np.nan)
    return dataclasses.replace(table, **changed)


def _gap_limit(median_step: FloatArray, criteria: Criteria, gap_limit: float | None) -> FloatArray:
    if gap_limit is None:
        gap_limit = criteria.max_gap
    if gap_limit is not None:
        return np.full(median_step.shape, gap_limit)
    return np.fmax(GAP_STEPS * median_step, GAP_FLOOR)


def _seconds(table: RecordingTable, place: IntArray, limit: FloatArray, *, adjacent: bool) -> FloatArray:
    """Sum of the steps between chosen samples of each recording, (r,) [s], without gaps."""
    owner, step = table.recording_index[place], np.diff(table.t[place])
    counted = (owner[1:] == owner[:-1]) & (step <= limit[owner[1:]])
    if adjacent:
        counted &= np.diff(place) == 1
    return np.bincount(owner[1:][counted], weights=step[counted], minlength=table.names.size).astype(float)


def _lateral(signals: DepartureSignals) -> FloatArray:
    """Largest lateral acceleration that the curvature asks for, (n,) [m/s^2]."""
    if signals.n == 0:
        return np.empty(0)
    largest: FloatArray = np.maximum.reduceat(signals.v**2 * np.abs(signals.c), signals.offsets[:-1])
    return largest


def _only(signals: DepartureSignals, chosen: BoolArray) -> DepartureSignals:
    rows = np.repeat(chosen, np.diff(signals.offsets))
    length = np.diff(signals.offsets)[chosen]
    return dataclasses.replace(
        signals,
        offsets=np.concatenate([[0], np.cumsum(length)]),
        **{name: getattr(signals, name)[rows] for name in ("t", "y", "v", "c")},
    )


def _judge(
    table: RecordingTable, side: IntArray, signals: DepartureSignals, source: IntArray, criteria: Criteria
) -> IntArray:
    """Index into `REASONS`, or `ACCEPTED`, of events that have both crossings; accelerations are judged later."""
    starts, last = signals.offsets[:-1], signals.offsets[1:] - 1
    verdict = np.full(signals.n, ACCEPTED)
    if signals.n == 0:
        return verdict
    T = signals.t[last]
    step = np.diff(signals.t, append=0.0) * 0.5 * (signals.v + np.append(signals.v[1:], 0.0))
    step[last] = 0.0
    d_x = np.add.reduceat(step, starts)
    # the weakest first: a stronger reason overwrites it
    # no lane that a vehicle fits into: one of the lines is not the lane's
    narrow = table.lane_width[source] <= criteria.vehicle_width
    verdict[np.logical_or.reduceat(narrow, starts)] = CODE["implausible"]
    if table.turn_signal is not None:
        towards = table.turn_signal[source] == np.repeat(side, np.diff(signals.offsets))
        towards[last] = False  # back inside: a signal set only then says nothing of the departure
        verdict[np.logical_or.reduceat(towards, starts)] = CODE["intended"]
    # a vehicle that stops or reverses covers no distance the parabola could be fitted over
    stands = np.minimum.reduceat(signals.v, starts) <= 0.0
    verdict[stands | ~(d_x > criteria.min_speed * T)] = CODE["slow"]
    verdict[signals.samples < 3] = CODE["too_few_samples"]
    verdict[criteria.max_duration < T] = CODE["too_long"]
    verdict[criteria.min_duration > T] = CODE["too_short"]
    if table.lane is None:
        # the tracker may hold on to the lane that was left: so far out, most of the vehicle is in the next one
        outside = np.abs(table.lane_offset[source]) >= LANE_JUMP[0] * table.lane_width[source]
        verdict[np.logical_or.reduceat(outside, starts)] = CODE["lane_change"]
    return verdict


def _curvature(table: RecordingTable, usable: BoolArray, median_step: FloatArray, limit: FloatArray) -> FloatArray:
    """Curvature of the lane, (m,) [1/m]: recorded, or estimated from the yaw rate, or 0."""
    if table.curvature is not None:
        return table.curvature
    if table.yaw_rate is None:
        return np.zeros(table.samples)
    recording = table.recording_index
    first = np.ones(table.samples, dtype=bool)
    first[1:] = (recording[1:] != recording[:-1]) | (np.diff(table.t) > limit[recording[1:]])
    width = np.rint(HALF_WINDOW / np.fmax(median_step, 1e-6))
    half_width = np.nan_to_num(width).astype(np.int64)[recording]
    return curvature_from_yaw_rate(table.yaw_rate, table.speed, usable, first, half_width)
