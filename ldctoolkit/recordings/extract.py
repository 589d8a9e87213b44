"""From recordings to departures: every candidate is either a departure or refused for one counted reason."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures, DepartureSignals, reduce_signals
from ldctoolkit.recordings.curvature import HALF_WINDOW, curvature_from_yaw_rate
from ldctoolkit.recordings.events import (
    ACCEPTED,
    CODE,
    GAP_FLOOR,
    GAP_STEPS,
    LARGEST_ACCELERATION,
    REASONS,
    breaks,
    find_runs,
    median_steps,
    signals_of_runs,
)
from ldctoolkit.recordings.read import Recordings
from ldctoolkit.recordings.result import Criteria, Extraction, Provenance, Refused
from ldctoolkit.recordings.table import BoolArray, FloatArray, IntArray, RecordingTable
from ldctoolkit.recordings.units import UnitCheck


def extract_departures(
    recordings: Iterable[RecordingTable],
    *,
    vehicle_width: float = 1.9,
    min_duration: float = 0.5,
    max_duration: float = 10.0,
    min_speed: float = 5.0,
    max_gap: float | None = None,
    max_jump: float = 0.6,
) -> Extraction:
    """Find the lane departures in driving recordings and reduce each to its eight parameters.

    Parameters
    ----------
    recordings : iterable of RecordingTable
        From `read_recordings`, or tables made by `RecordingTable.from_arrays`.
    vehicle_width : float [m]
        Width of the vehicle.
    min_duration, max_duration : float [s]
        Allowed durations, ends included.
    min_speed : float [m/s]
        The mean speed must lie above.
    max_gap : float [s], optional
        Longest time step that is not a gap; by default 2.5 median steps of the recording, at least 0.25 s.
    max_jump : float [m]
        Largest step of the offset from one sample to the next.

    Returns
    -------
    Extraction
        Departures, refused candidates by reason, hours, warnings.

    Raises
    ------
    InputError
        For a criterion outside its range.
    RecordingError
        For recordings that cannot be used.

    Notes
    -----
    A departure begins where the edge, y = +-lane_offset + (vehicle_width - lane_width)/2, crosses the line outwards and
    ends where it comes back inside the same lane; both crossings are interpolated linearly. The criteria are those
    of Zhao, Wang, LeBlanc (2017), section III.

    Examples
    --------
    >>> t = np.arange(0, 10, 0.1)
    >>> beyond = np.clip(0.3 - 0.3 * (t - 5) ** 2, -0.5, None)
    >>> table = RecordingTable.from_arrays(recording=["a"] * t.size, t=t, lane_offset=beyond + 0.85, lane_width=3.6,
    ...                                    speed=25.0, curvature=0.0)
    >>> found = extract_departures([table])
    >>> len(found.departures), found.refused.total, round(float(found.departures.T[0]), 2)
    (1, 0, 2.0)
    """
    criteria = Criteria(vehicle_width, min_duration, max_duration, min_speed, max_gap, max_jump)
    found: list[Departures] = [_no_departures()]
    counts = np.zeros(ACCEPTED + 1, dtype=np.int64)
    seconds: list[FloatArray] = []
    check = UnitCheck(vehicle_width)
    kinds: set[str] = set()
    lanes = True
    samples = invalid = 0
    for table in recordings:
        departures, reasons, driven, usable = _extract_table(table, criteria, check)
        found.append(departures)
        counts += np.bincount(reasons, minlength=ACCEPTED + 1)
        seconds.append(driven)
        samples += table.samples
        invalid += int(np.sum(~usable))
        kinds.add("measured" if table.curvature is not None else "none" if table.yaw_rate is None else "yaw_rate")
        lanes = lanes and table.lane is not None
    warnings = list(check.messages())
    if "none" in kinds:
        warnings.append("no column 'curvature' or 'yaw_rate': the lane's curvature is taken as 0 (c_0 = dc = 0)")
    if not lanes:
        warnings.append("no column 'lane': a lane change is seen only as a jump of the offset by about a lane width")
    provenance = Provenance(
        criteria=criteria,
        refused=Refused(**{reason: int(counts[code]) for code, reason in enumerate(REASONS)}),
        sources=recordings.sources if isinstance(recordings, Recordings) else (),
        recordings=sum(driven.size for driven in seconds),
        samples=samples,
        invalid_samples=invalid,
        # fsum is exact, so the hours do not depend on how the recordings were split
        hours=math.fsum(value for driven in seconds for value in driven.tolist()) / 3600.0,
        curvature="none" if not kinds else kinds.pop() if len(kinds) == 1 else "mixed",
        warnings=tuple(warnings),
    )
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in found])
        for field in dataclasses.fields(Departures)
    }
    return Extraction(Departures(**columns), provenance)


def _no_departures() -> Departures:
    numbers = dict.fromkeys((*PARAMETER_NAMES, "start_time"), np.empty(0))
    return Departures(
        side=np.empty(0, dtype=np.int64),
        recording=np.empty(0, dtype=np.str_),
        samples=np.empty(0, dtype=np.int64),
        **numbers,
    )


def _extract_table(
    table: RecordingTable, criteria: Criteria, check: UnitCheck
) -> tuple[Departures, IntArray, FloatArray, BoolArray]:
    """Departures of one table, the reason of each candidate, seconds driven in each recording, usable samples."""
    usable = table.usable
    if not usable.all():  # infinities and absurd numbers would only raise floating point warnings further on
        table = table.blanked(usable)
    place = np.flatnonzero(usable)
    median_step = median_steps(table)
    check.add(table, usable, median_step)
    limit = np.fmax(GAP_STEPS * median_step, GAP_FLOOR)
    if criteria.max_gap is not None:
        limit = np.full_like(limit, criteria.max_gap)
    if place.size == 0:
        return _no_departures(), np.empty(0, dtype=np.int64), np.zeros(table.names.size), usable
    same, cause = breaks(table, place, limit, criteria.max_jump)

    owner = table.recording_index[place]
    step = np.diff(table.t[place])
    drove = same & (np.diff(place) == 1) & (step <= limit[owner[1:]])
    driven: FloatArray = np.bincount(owner[1:][drove], weights=step[drove], minlength=table.names.size).astype(float)

    margin = 0.5 * (criteria.vehicle_width - table.lane_width)
    edges = {LEFT: table.lane_offset + margin, RIGHT: -table.lane_offset + margin}
    runs = find_runs(table, place, edges, same, cause)
    reason = runs.reason.copy()

    chosen = np.flatnonzero(reason == ACCEPTED)
    curvature = _curvature(table, usable, median_step, limit)
    signals, start_time, source = signals_of_runs(table, runs, chosen, edges, curvature)
    verdict = _judge(table, runs.side[chosen], signals, source, criteria)
    reason[chosen] = verdict

    good = np.flatnonzero(verdict == ACCEPTED)
    rows = np.repeat(verdict == ACCEPTED, np.diff(signals.offsets))
    length = np.diff(signals.offsets)[good]
    kept = dataclasses.replace(
        signals,
        offsets=np.concatenate([[0], np.cumsum(length)]),
        **{name: getattr(signals, name)[rows] for name in ("t", "y", "v", "c")},
    )
    run = chosen[good]
    parameters = reduce_signals(kept, runs.side[run])
    plausible = np.abs(parameters.a_mean) <= LARGEST_ACCELERATION
    reason[run[~plausible]] = CODE["implausible"]
    departures = Departures(
        **{field.name: getattr(parameters, field.name) for field in dataclasses.fields(parameters)},
        recording=table.names[table.recording_index[runs.first[run]]],
        start_time=start_time[good],
        samples=kept.samples,
    ).take(plausible)
    # a candidate's reason is the strongest of its runs'
    by_candidate: IntArray = np.full(int(runs.candidate.max(initial=-1)) + 1, ACCEPTED, dtype=np.int64)
    np.minimum.at(by_candidate, runs.candidate, reason)
    return departures, by_candidate, driven, usable


def _judge(
    table: RecordingTable, side: IntArray, signals: DepartureSignals, source: IntArray, criteria: Criteria
) -> IntArray:
    """Index into `REASONS`, or `ACCEPTED`, of events that have both crossings; "implausible" is seen only later."""
    starts, last = signals.offsets[:-1], signals.offsets[1:] - 1
    verdict = np.full(signals.n, ACCEPTED)
    if signals.n == 0:
        return verdict
    T = signals.t[last]
    step = np.diff(signals.t, append=0.0) * 0.5 * (signals.v + np.append(signals.v[1:], 0.0))
    step[last] = 0.0
    d_x = np.add.reduceat(step, starts)
    # the weakest first: a stronger reason overwrites it
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
    return verdict


def _curvature(table: RecordingTable, usable: BoolArray, median_step: FloatArray, limit: FloatArray) -> FloatArray:
    """Curvature of the lane, (m,) [1/m]: recorded, or estimated from the yaw rate, or 0."""
    if table.curvature is not None:
        return table.curvature
    if table.yaw_rate is None:
        return np.zeros(table.samples)
    recording = table.recording_index
    first = np.ones(table.samples, dtype=bool)
    # a step next to a sample without a time is NaN: no gap by itself, for that sample is not usable anyway
    first[1:] = (recording[1:] != recording[:-1]) | (np.diff(table.t) > limit[recording[1:]])
    width = np.rint(HALF_WINDOW / np.fmax(median_step, 1e-6))
    half_width = np.nan_to_num(width).astype(np.int64)[recording]
    return curvature_from_yaw_rate(table.yaw_rate, table.speed, usable, first, half_width)
