"""Lane departures in a recording: stretches beyond the line, and the eight parameters of each."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.declared import check_declared, declared
from ldctoolkit.departures import LEFT, RIGHT, Departures, DepartureSignals, Plausibility, reduce_signals
from ldctoolkit.errors import CheckedArguments, InputError
from ldctoolkit.recordings.preparation import MAX_JUMP, ROUNDING, middle_two
from ldctoolkit.recordings.recording import (
    MAX_LANE_WIDTH,
    MIN_LANE_WIDTH,
    RecordingTable,
    changed_columns,
    usable_samples,
)


@dataclasses.dataclass(frozen=True)
class Refused:
    """Refused candidates, counted by reason. One candidate has one reason: the first that holds, in this order."""

    # Something broke into the manoeuvre: the lane changed, samples were invalid, time or offset jumped
    lane_change: int = 0
    invalid: int = 0
    gap: int = 0
    jump: int = 0
    cut_by_end: int = 0  # The recording started or ended with the edge beyond the line
    # Four criteria that were not met; fewer than three samples cannot be reduced to the eight parameters
    too_short: int = 0
    too_long: int = 0
    too_few_samples: int = 0
    slow: int = 0
    engaged: int = 0  # A system was steering
    intended: int = 0  # The turn signal was on towards the departed side
    # The mean acceleration, or speed and curvature together, are beyond 9.81 m/s^2, more than tyres can do: noise. Or
    # the lane is no wider than the vehicle: one of its lines is not the lane's.
    implausible: int = 0

    @property
    def total(self) -> int:
        """All refused candidates."""
        return sum(count for _, count in self.items())

    def items(self) -> Iterator[tuple[str, int]]:
        """Reason and count, in order of precedence."""
        return ((reason, getattr(self, reason)) for reason in REASONS)


REASONS: Final = tuple(field.name for field in dataclasses.fields(Refused))
"""Why a candidate is refused; when several hold, the first in this order counts."""

CODE: Final = {reason: code for code, reason in enumerate(REASONS)}
ACCEPTED: Final = len(REASONS)
_NONE: Final = ACCEPTED

LARGEST_ACCELERATION: Final = 9.81
"""m/s^2. A mean acceleration beyond it, either way, is more than tyres can do on a road: the speeds are wrong."""

GAP_FLOOR: Final = 0.25
GAP_STEPS: Final = 2.5
LANE_JUMP: Final = (0.7, 1.3)
"""A jump of the offset between these multiples of the lane width is a lane change."""

JUMP_WINDOW: Final = 0.6
"""Longest time [s] over which a movement is judged: a jump that was smoothed over half a second is seen in it."""

MOST_LAGS: Final = 600  # samples in that time, at most; it bounds the work for absurd clocks
JUMP_TIME: Final = 0.1  # [s] in which the offset may move by `max_jump`; over longer times it may move on at a speed
JUMP_SPEED: Final = 1.5  # [m/s]
WIDTH_JUMP: Final = (0.5, 1.0)
"""[m], [m/s]: the lane's width moves so far, and so fast, only where a line jumps to another marking."""

AROUND: Final = 10.0  # [s] before and after a departure with which its lane's width is compared
NARROWER: Final = 0.25  # [m] where the lane is narrower by more during a departure alone, a line was another marking


@dataclasses.dataclass(frozen=True)
class Runs:
    """Stretches of usable samples with the edge beyond one line, nothing joined across a break."""

    side: IntArray  # (n,): `LEFT` or `RIGHT`
    first: IntArray  # (n,): first and last sample beyond the line, as indices into the table
    last: IntArray  # (n,)
    reason: IntArray  # (n,): index into `REASONS` of what cut the run, or `ACCEPTED` for a run with both crossings
    candidate: IntArray  # (n,): candidate that the run belongs to


def median_steps(table: RecordingTable) -> FloatArray:
    """Median time step of each recording, (r,) [s]; NaN for a recording with fewer than two samples."""
    recording = table.recording_index
    within = recording[1:] == recording[:-1]
    step, owner = np.diff(table.t)[within], recording[1:][within]
    result = _median_steps(step, owner, table.names.size)
    count, time = (np.bincount(owner, x, table.names.size) for x in (None, step))
    bursts = time > 2.0 * result * count
    if bursts.any():  # the steps between them; a gap counts little
        mean = np.bincount(owner, np.minimum(step, 0.5), table.names.size) / np.maximum(count, 1)
        long = step > 0.5 * mean[owner]
        result = np.where(bursts, _median_steps(step[long], owner[long], table.names.size), result)
    return result


def _median_steps(step: FloatArray, owner: IntArray, recordings: int) -> FloatArray:
    """Median time step of each recording, (r,) [s]; NaN for none."""
    count = np.bincount(owner, minlength=recordings)
    below, above = middle_two(step, owner, count)
    result = np.full(recordings, np.nan)
    result[count > 0] = 0.5 * (below + above)
    return result


def breaks(
    table: RecordingTable, rows: IntArray, gap_limit: FloatArray, max_jump: float, edges: dict[int, FloatArray]
) -> tuple[BoolArray, IntArray, IntArray]:
    """Of each usable sample and the next: whether they are in one recording, the reason of a break between them, and
    the break's number, which the joints of one movement share.
    """
    recording = table.recording_index[rows]
    same = recording[1:] == recording[:-1]
    cause = np.full(same.shape, _NONE)
    # the weakest first: a stronger reason overwrites it
    cause[np.diff(table.t[rows]) > gap_limit[recording[1:]]] = CODE["gap"]
    cause[np.diff(rows) > 1] = CODE["invalid"]
    offset, width = table.lane_offset[rows], table.lane_width[rows]
    beyond = np.maximum(edges[LEFT][rows], edges[RIGHT][rows]) > 0.0
    jump = _jumps(table.t[rows], offset, width, beyond, ~same | (cause != _NONE), max_jump)
    cause[jump] = CODE["jump"]
    moved = jump.copy()
    if table.lane is not None:
        changed = same & (table.lane[rows][1:] != table.lane[rows][:-1])
        cause[changed] = CODE["lane_change"]
        moved |= changed
    # a movement that takes several steps is one break
    starts = np.flatnonzero(moved & ~np.append(False, moved[:-1]))
    ends = np.flatnonzero(moved & ~np.append(moved[1:], False)) + 1
    name = np.arange(same.size)
    name[moved] = np.repeat(starts, ends - starts)
    pairs = np.column_stack([starts, ends + 1]).ravel()
    way = np.maximum.reduceat(np.append(offset, -np.inf), pairs)[::2]
    way = way - np.minimum.reduceat(np.append(offset, np.inf), pairs)[::2]
    lane = 0.5 * (width[ends] + width[starts])
    whole = (way > max_jump) & (way > LANE_JUMP[0] * lane) & (way < LANE_JUMP[1] * lane)
    cause[moved & np.isin(name, starts[whole])] = CODE["lane_change"]
    return same, cause, name


def _samples_around(marked: BoolArray, t: FloatArray, barred: BoolArray, reach: float) -> BoolArray:
    """Samples, (k,), within the time `reach` of marked samples, and their neighbours; not across a barred joint."""
    first, last = (np.flatnonzero(marked & ~beside) for beside in (np.roll(marked, 1), np.roll(marked, -1)))
    if marked[:1].any() and marked[-1]:  # the ends are no neighbours
        first, last = np.append(0, first), np.append(last, marked.size - 1)
    low, high, walls = first, last, np.concatenate([[True], barred, [True]])
    for step in range(MOST_LAGS):
        before = ~walls[low] & ((t[first] - t[low - 1] <= reach + ROUNDING) | (step == 0))
        after = ~walls[high + 1] & ((t[np.minimum(high + 1, t.size - 1)] - t[last] <= reach + ROUNDING) | (step == 0))
        if not (before.any() or after.any()):
            break
        low, high = low - before, high + after
    count = np.bincount(low, minlength=t.size + 1) - np.bincount(high + 1, minlength=t.size + 1)
    return np.cumsum(count)[:-1] > 0


def _jumps(
    t: FloatArray, offset: FloatArray, width: FloatArray, beyond: BoolArray, barred: BoolArray, max_jump: float
) -> BoolArray:
    """Joints between neighbours, (k - 1,), across which offset or width moves too far, too fast; not across `barred`.

    They are looked for where it matters, within `JUMP_WINDOW` of samples with the edge beyond a line. Of two pairs of
    samples, one inside the other, the closer pair tells where the movement is; half a window to either side belongs to
    it, for one that was smoothed begins earlier and ends later than noise lets be seen.
    """
    rows = np.flatnonzero(_samples_around(beyond, t, barred, JUMP_WINDOW))
    time, offset, width = t[rows], offset[rows], width[rows]
    closed = np.append(barred, True)[rows[:-1]] | (np.diff(rows) > 1)
    jumps = np.zeros(closed.size, dtype=bool)
    for lag in range(1, min(MOST_LAGS, rows.size)):
        dt = time[lag:] - time[:-lag]
        before = np.append(0, np.cumsum(closed))
        free = before[lag:] == before[:-lag]
        if lag > 1:
            free &= dt <= JUMP_WINDOW + ROUNDING
        if not free.any():
            break
        lane = LANE_JUMP[0] * np.minimum(width[lag:], width[:-lag])
        limit = max_jump + JUMP_SPEED * np.maximum(dt - JUMP_TIME, 0.0)
        limit = np.maximum(np.minimum(limit, lane), max_jump)
        far = np.abs(offset[lag:] - offset[:-lag]) > limit + ROUNDING
        far |= np.abs(width[lag:] - width[:-lag]) > np.maximum(WIDTH_JUMP[0], WIDTH_JUMP[1] * dt) + ROUNDING
        first = np.flatnonzero(free & far)
        ends = np.bincount(first + lag, minlength=rows.size)
        jumps |= np.cumsum(np.bincount(first, minlength=rows.size) - ends)[:-1] > 0
        closed |= jumps
    moving = np.zeros(t.size, dtype=bool)
    moving[rows[:-1][jumps]] = moving[rows[1:][jumps]] = True
    moving = _samples_around(moving, t, barred, 0.5 * JUMP_WINDOW)
    return moving[:-1] & moving[1:] & ~barred


def find_runs(
    table: RecordingTable,
    rows: IntArray,
    edges: dict[int, FloatArray],
    same: BoolArray,
    cause: IntArray,
    name: IntArray,
) -> Runs:
    """All runs of a table, in the order of their first sample (left before right)."""
    k = rows.size
    joined = same & (cause == _NONE)
    # what stands before and after each usable sample; at a recording's ends, unusable samples outrank the end itself
    recording = table.recording_index[rows]
    before, after = np.full(k, CODE["cut_by_end"]), np.full(k, CODE["cut_by_end"])
    before[rows > table.offsets[recording]] = CODE["invalid"]
    after[rows < table.offsets[recording + 1] - 1] = CODE["invalid"]
    before[1:][same] = after[:-1][same] = cause[same]

    beyond = np.stack([edges[side][rows] > 0.0 for side in (LEFT, RIGHT)])
    linked = beyond[:, 1:] & beyond[:, :-1] & joined
    row, first = np.nonzero(beyond & ~np.pad(linked, ((0, 0), (1, 0))))
    _, last = np.nonzero(beyond & ~np.pad(linked, ((0, 0), (0, 1))))
    side = np.where(row == 0, LEFT, RIGHT)
    order = np.lexsort((-side, first))
    first, last, side = first[order], last[order], side[order]
    reason = np.minimum(before[first], after[last])
    inner = np.concatenate([[False], same & ~joined, [False]])  # inner[i]: a break between i - 1 and i
    name = np.concatenate([[-1], name, [-1]])
    candidate = _candidates(inner[first], inner[last + 1], name[first], name[last + 1])
    return Runs(side, rows[first], rows[last], reason, candidate)


def _candidates(from_break: BoolArray, to_break: BoolArray, before: IntArray, after: IntArray) -> IntArray:
    """Label of the candidate of each run: runs that touch the same break are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    run = np.arange(before.size)
    touched = np.concatenate([before[from_break], after[to_break]])
    runs = np.concatenate([run[from_break], run[to_break]])
    name, node = np.unique(touched, return_inverse=True)
    size = run.size + name.size
    graph = coo_array((np.ones(runs.size, dtype=np.int8), (runs, run.size + node)), shape=(size, size))
    labels = np.asarray(connected_components(graph, directed=False)[1])[: run.size]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def signals_of_runs(
    table: RecordingTable, runs: Runs, complete: IntArray, edges: dict[int, FloatArray], curvature: FloatArray
) -> tuple[DepartureSignals, FloatArray, IntArray]:
    """Signals of runs that have both crossings, in the outward frame."""
    first, last, side = runs.first[complete], runs.last[complete], runs.side[complete]
    length = last - first + 3
    offsets = np.concatenate([[0], np.cumsum(length)])
    event = np.repeat(np.arange(complete.size), length)
    source = (first - 1)[event] + np.arange(event.size) - offsets[:-1][event]
    y = np.where(side[event] == LEFT, edges[LEFT][source], edges[RIGHT][source])
    # times relative to the first sample beyond the line: no digits are lost on a large clock
    t = table.t[source] - table.t[first][event]
    v = table.speed[source].copy()
    c = curvature[source] * side[event]
    for row, neighbour in ((offsets[:-1], offsets[:-1] + 1), (offsets[1:] - 1, offsets[1:] - 2)):
        share = y[row] / (y[row] - y[neighbour])  # in [0, 1): 0 where the inner sample lies on the line
        for signal in (t, v, c):
            signal[row] += share * (signal[neighbour] - signal[row])
        y[row] = 0.0
    begin = t[offsets[:-1]]
    return DepartureSignals(offsets, t - begin[event], y, v, c), table.t[first] + begin, source


@dataclasses.dataclass(frozen=True)
class Criteria(CheckedArguments):
    """What counts as a departure."""

    # Width over the wheels' outer edges
    vehicle_width: float = declared(1.9, unit="m", lower=0.5, upper=4.0)
    # Both allowed values included
    min_duration: float = declared(0.5, unit="s", lower=0.0)
    max_duration: float = declared(10.0, unit="s")
    min_speed: float = declared(5.0, unit="m/s", lower=0.0)  # The mean speed lies above
    # Longest time step that is not a gap; None: 2.5 median steps of the recording, at least 0.25 s
    max_gap: float | None = declared(None, unit="s", above=0.0)
    max_jump: float = declared(MAX_JUMP, unit="m", above=0.0)  # Of the offset in 0.1 s; over longer times 1.5 m/s more
    # What the fitted path may ask of driver and vehicle
    plausibility: Plausibility = dataclasses.field(default_factory=Plausibility)
    # A sample with a narrower or wider lane is invalid
    min_lane_width: float = declared(MIN_LANE_WIDTH, unit="m", above=0.0)
    max_lane_width: float = declared(MAX_LANE_WIDTH, unit="m")
    keep_engaged: bool = declared(False)  # Whether departures and hours while a system steers count, too

    def __post_init__(self) -> None:
        if isinstance(self.plausibility, Mapping):  # as a file holds it
            object.__setattr__(self, "plausibility", Plausibility(**self.plausibility))
        check_declared(self)
        for least, most in (("min_duration", "max_duration"), ("min_lane_width", "max_lane_width")):
            if not getattr(self, least) < getattr(self, most):
                raise InputError(most, value=getattr(self, most), allowed=f"more than {least}")


@dataclasses.dataclass(frozen=True)
class SearchResult:
    """Departures and counts of a table of m samples of r recordings."""

    departures: Departures  # n departures
    owner: IntArray  # (n,): index of the recording of each
    signals: DepartureSignals  # of the n departures
    reason: IntArray  # (c,): of each candidate the index into `REASONS`, or `ACCEPTED`
    side: IntArray  # (c,): side of the first crossing of each candidate, `LEFT` or `RIGHT`
    recording: IntArray  # (c,): index of the recording of each candidate
    read: FloatArray  # (r,) [s]: time between neighbouring samples, without gaps
    driven: FloatArray  # (r,) [s]: time between usable neighbouring samples, without gaps
    distance: FloatArray  # (r,) [m]: speed times time over the steps in `driven`, whichever way it points
    usable: BoolArray  # (m,): samples that could be used
    median_step: FloatArray  # (r,) [s]: median time step; NaN for a recording with fewer than two times
    stays: FloatArray  # (k,) [s]: time of each stay beyond a line, lane changes apart
    stay_recording: IntArray  # (k,): index of the recording of each


def find_departures(table: RecordingTable, criteria: Criteria, gap_limit: float | None = None) -> SearchResult:
    """Find the departures of one table."""
    usable = usable_samples(table)
    if not usable.all():  # infinities and absurd numbers would only raise floating point warnings further on
        numbers = ("lane_offset", "lane_width", "speed", "curvature", "yaw_rate")
        table = changed_columns(table, numbers, lambda values: np.where(usable, values, np.nan))
    usable_rows = np.flatnonzero(usable)
    median_step = median_steps(table)
    limit = _gap_limit(median_step, criteria, gap_limit)
    read = _sums(table, np.arange(table.samples), limit, adjacent=False)
    margin = 0.5 * (criteria.vehicle_width - table.lane_width)
    edges = {LEFT: table.lane_offset + margin, RIGHT: -table.lane_offset + margin}
    same, cause, name = breaks(table, usable_rows, limit, criteria.max_jump, edges)
    runs = find_runs(table, usable_rows, edges, same, cause, name)
    reason = runs.reason.copy()

    complete = np.flatnonzero(reason == ACCEPTED)
    curvature = _curvature(table, usable, median_step, limit)
    signals, start_time, source = signals_of_runs(table, runs, complete, edges, curvature)
    verdict = _judge(table, runs.side[complete], signals, source, criteria)
    rows = np.nan_to_num(AROUND / np.fmax(median_step, ROUNDING)).astype(np.int64)
    deepest = np.maximum.reduceat(signals.y, signals.offsets[:-1])
    narrower = _narrower(table, usable, runs.first[complete], runs.last[complete], rows) > deepest
    verdict[narrower] = np.minimum(verdict[narrower], CODE["jump"])
    reason[complete] = verdict

    run, accepted, start_time = (
        complete[verdict == ACCEPTED],
        signals.take(verdict == ACCEPTED),
        start_time[verdict == ACCEPTED],
    )
    parameters = reduce_signals(accepted, runs.side[run])
    # acceleration that the curvature requires
    lateral = np.maximum.reduceat(accepted.v**2 * np.abs(accepted.c), accepted.offsets[:-1])
    plausible = (np.abs(parameters.a_mean) <= LARGEST_ACCELERATION) & (lateral <= LARGEST_ACCELERATION)
    plausible &= criteria.plausibility.holds(parameters)
    reason[run[~plausible]] = CODE["implausible"]
    owner = table.recording_index[runs.first[run]]
    departures = Departures(
        **{field.name: getattr(parameters, field.name) for field in dataclasses.fields(parameters)},
        recording=table.names[owner],
        start_time=start_time,
        samples=accepted.samples,
    ).take(plausible)
    # a candidate's reason is the strongest of its runs', its side and recording are those of the first
    count = int(runs.candidate.max(initial=-1)) + 1
    by_candidate: IntArray = np.full(count, ACCEPTED, dtype=np.int64)
    np.minimum.at(by_candidate, runs.candidate, reason)
    _, first = np.unique(runs.candidate, return_index=True)
    stayed = by_candidate[runs.candidate] != CODE["lane_change"]
    stay_recording = table.recording_index[runs.first[stayed]]
    stays = table.t[runs.last[stayed]] - table.t[runs.first[stayed]] + np.nan_to_num(median_step)[stay_recording]
    driver = usable_rows if criteria.keep_engaged or table.engaged is None else usable_rows[~table.engaged[usable_rows]]
    return SearchResult(
        departures=departures,
        owner=owner[plausible],
        signals=accepted.take(plausible),
        reason=by_candidate,
        side=runs.side[first],
        recording=table.recording_index[runs.first[first]],
        read=read,
        driven=_sums(table, driver, limit, adjacent=True),
        distance=_sums(table, driver, limit, adjacent=True, speed=np.abs(table.speed[driver])),
        usable=usable,
        median_step=median_step,
        stays=stays,
        stay_recording=stay_recording,
    )


def _gap_limit(median_step: FloatArray, criteria: Criteria, gap_limit: float | None) -> FloatArray:
    """Longest time [s] between neighbours of a recording that is no gap, (r,)."""
    if gap_limit is not None:  # resampled; a lane signal with a longer clock of its own is not
        return np.fmax(gap_limit, 1.5 * median_step)
    if criteria.max_gap is not None:
        return np.full(median_step.shape, criteria.max_gap)
    return np.fmax(GAP_STEPS * median_step, GAP_FLOOR)


def _sums(
    table: RecordingTable, rows: IntArray, limit: FloatArray, *, adjacent: bool, speed: FloatArray | None = None
) -> FloatArray:
    """Sums over each recording, (r,), of the time steps between rows, without gaps: [s], or [m] with speeds."""
    owner, step = table.recording_index[rows], np.diff(table.t[rows])
    counted = (owner[1:] == owner[:-1]) & (step <= limit[owner[1:]])
    if adjacent:
        counted &= np.diff(rows) == 1
    if speed is not None:
        with np.errstate(over="ignore"):  # of absurd times
            step = 0.5 * (speed[1:] + speed[:-1]) * step
    return np.bincount(owner[1:][counted], weights=step[counted], minlength=table.names.size).astype(float)


def _narrower(table: RecordingTable, usable: BoolArray, first: IntArray, last: IntArray, rows: IntArray) -> FloatArray:
    """How much narrower the lane is in runs than in some rows before and in some after, on average, (n,) [m]; 0 if less
    than `NARROWER`. An edge that is not as far beyond the line is there only because a line was another marking.
    """
    owner = table.recording_index[first]
    low = np.maximum(first - rows[owner], table.offsets[owner])
    high = np.minimum(last + 1 + rows[owner], table.offsets[owner + 1])
    count, width = np.append(0, np.cumsum(usable)), np.append(np.where(usable, table.lane_width, 0.0), 0.0)

    def mean(begin: IntArray, end: IntArray) -> FloatArray:
        number, pairs = count[end] - count[begin], np.column_stack([begin, end]).ravel()
        return np.where(number > 0, np.add.reduceat(width, pairs)[::2] / np.maximum(number, 1), np.inf)

    less: FloatArray = np.minimum(mean(low, first), mean(last + 1, high)) - mean(first, last + 1)
    return np.where(np.isfinite(less) & (less > NARROWER), less, 0.0)


def _judge(
    table: RecordingTable, side: IntArray, signals: DepartureSignals, source: IntArray, criteria: Criteria
) -> IntArray:
    """Index into `REASONS`, or `ACCEPTED`, of events that have both crossings; accelerations are judged later."""
    starts, last = signals.offsets[:-1], signals.offsets[1:] - 1
    verdict = np.full(signals.n, ACCEPTED)
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
    if table.engaged is not None and not criteria.keep_engaged:
        verdict[np.logical_or.reduceat(table.engaged[source], starts)] = CODE["engaged"]
    # a vehicle that stops or reverses covers no distance the parabola could be fitted over
    stands = np.minimum.reduceat(signals.v, starts) <= 0.0
    verdict[stands | ~(d_x > criteria.min_speed * T)] = CODE["slow"]
    verdict[signals.samples < 3] = CODE["too_few_samples"]
    verdict[criteria.max_duration < T] = CODE["too_long"]
    verdict[criteria.min_duration > T] = CODE["too_short"]
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
    return curvature_from_yaw_rate(table.yaw_rate, table.speed, usable, first, table.t, median_step[recording])


HALF_WINDOW: Final = 0.2
"""Half the smoothing window [s]. A longer one takes in the road before and after a departure, which flattens dc where
the curvature does not go on; c_0 and dc are fitted over all of a departure anyway, which averages the noise."""

SPEED_FLOOR: Final = 2.0  # below about this speed [m/s] the estimate fades to zero instead of dividing by a small speed


def curvature_from_yaw_rate(
    yaw_rate: FloatArray,
    speed: FloatArray,
    usable: BoolArray,
    first_of_stretch: BoolArray,
    t: FloatArray,
    step: FloatArray,
) -> FloatArray:
    """Curvature that explains the yaw rate best, by least squares over a moving window.

    The model is r = c v with c constant over the window, so c = sum(r v) / sum(v^2). Each sample weighs with its v^2,
    hence slow samples, whose r/v is noise, hardly count, and the sum of v^2 is not allowed below that of
    `SPEED_FLOOR`. The window shrinks at a stretch's ends and never reaches across them; it is `HALF_WINDOW` of time to
    either side, however the samples, of typical `step` [s], are spaced. The yaw rate is the vehicle's, not the lane's:
    during a departure it holds the vehicle's own turning too, which the window averages.
    """
    result = np.full(yaw_rate.shape, np.nan)
    rows = np.flatnonzero(usable)
    # a stretch also ends where an unusable sample was left out
    begin = np.flatnonzero(np.diff(np.cumsum(first_of_stretch | ~usable)[rows], prepend=-1))
    length = np.diff(np.append(begin, rows.size))
    first, last = np.repeat(begin, length), np.repeat(begin + length, length) - 1
    row, t = np.arange(rows.size), t[rows]
    half = HALF_WINDOW + ROUNDING
    count = np.nan_to_num(half / np.fmax(step[rows], ROUNDING)).astype(np.int64)
    low, high = np.maximum(row - count, first), np.minimum(row + count, last)
    # what even spacing gives is looked up in time where the spacing is not even
    uneven = (t - t[low] > half) | (t[high] - t > half)
    uneven |= (low > first) & (t - t[low - 1] <= half) | (high < last) & (t[np.minimum(high + 1, last)] - t <= half)
    if uneven.any():
        stretch = np.repeat(np.arange(begin.size), length)
        since = t - t[first]
        clock = since + np.append(0.0, np.cumsum(since[begin + length - 1] + 1.0))[stretch]  # never falls
        low[uneven] = np.searchsorted(clock, clock[uneven] - half, "left")
        high[uneven] = np.searchsorted(clock, clock[uneven] + half, "right") - 1
        low, high = np.maximum(low, first), np.minimum(high, last)
    high += 1
    v, r = speed[rows], yaw_rate[rows]
    # reduceat over (low, high) pairs: every second sum is a window; each is summed on its own, so no rounding is
    # carried from one recording into the next. The appended zero lets `high` point past the last sample.
    pairs = np.column_stack([low, high]).ravel()
    top = np.add.reduceat(np.append(r * v, 0.0), pairs)[::2]
    bottom = np.add.reduceat(np.append(v * v, 0.0), pairs)[::2]
    result[rows] = top / np.maximum(bottom, (high - low) * SPEED_FLOOR**2)
    return result
