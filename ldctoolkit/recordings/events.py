"""Candidates for a departure: where the edge is beyond a line, and what breaks into it. All samples at once."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT, DepartureSignals
from ldctoolkit.recordings.recording import RecordingTable

REASONS: Final = (
    "lane_change",
    "invalid",
    "gap",
    "jump",
    "cut_by_end",
    "too_short",
    "too_long",
    "too_few_samples",
    "slow",
    "intended",
    "implausible",
)
"""Why a candidate is refused; when several hold, the first in this order counts."""

CODE: Final = {reason: code for code, reason in enumerate(REASONS)}
ACCEPTED: Final = len(REASONS)
_NONE: Final = ACCEPTED

LARGEST_ACCELERATION: Final = 9.81
"""m/s^2. A mean acceleration beyond it, either way, is more than tyres can do on a road: the speeds are wrong."""

GAP_FLOOR: Final = 0.25
GAP_STEPS: Final = 2.5
LANE_JUMP: Final = (0.7, 1.3)
"""Without a column `lane`: a step of the offset between these multiples of the lane width is a lane change."""


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
    order = np.lexsort((step, owner))
    count = np.bincount(owner, minlength=table.names.size)
    begin = np.cumsum(count) - count
    result = np.full(table.names.size, np.nan)
    some = count > 0
    low, high = (begin + (count - 1) // 2)[some], (begin + count // 2)[some]
    result[some] = 0.5 * (step[order[low]] + step[order[high]])
    return result


def breaks(
    table: RecordingTable, place: IntArray, gap_limit: FloatArray, max_jump: float
) -> tuple[BoolArray, IntArray]:
    """What lies between each usable sample and the next."""
    recording = table.recording_index[place]
    same = recording[1:] == recording[:-1]
    step = np.abs(np.diff(table.lane_offset[place]))
    cause = np.full(same.shape, _NONE)
    # the weakest first: a stronger reason overwrites it
    cause[step > max_jump] = CODE["jump"]
    cause[np.diff(table.t[place]) > gap_limit[recording[1:]]] = CODE["gap"]
    cause[np.diff(place) > 1] = CODE["invalid"]
    if table.lane is not None:
        changed = table.lane[place][1:] != table.lane[place][:-1]
    else:
        width = 0.5 * (table.lane_width[place][1:] + table.lane_width[place][:-1])
        changed = (step > max_jump) & (step > LANE_JUMP[0] * width) & (step < LANE_JUMP[1] * width)
    cause[changed] = CODE["lane_change"]
    return same, cause


def find_runs(
    table: RecordingTable, place: IntArray, edges: dict[int, FloatArray], same: BoolArray, cause: IntArray
) -> Runs:
    """All runs of a table, in the order of their first sample (left before right)."""
    k = place.size
    joined = same & (cause == _NONE)
    # what stands before and after each usable sample; at a recording's ends, unusable samples outrank the end itself
    recording = table.recording_index[place]
    before, after = np.full(k, CODE["cut_by_end"]), np.full(k, CODE["cut_by_end"])
    before[place > table.offsets[recording]] = CODE["invalid"]
    after[place < table.offsets[recording + 1] - 1] = CODE["invalid"]
    before[1:][same] = after[:-1][same] = cause[same]

    found = [_runs_of_side(edges[side][place] > 0.0, joined) for side in (LEFT, RIGHT)]
    first = np.concatenate([run[0] for run in found])
    last = np.concatenate([run[1] for run in found])
    side = np.repeat([LEFT, RIGHT], [run[0].size for run in found])
    order = np.lexsort((-side, first))
    first, last, side = first[order], last[order], side[order]
    reason = np.minimum(before[first], after[last])
    inner = np.concatenate([[False], same & ~joined, [False]])  # inner[i]: a break between i - 1 and i
    candidate = _candidates(first, last, inner[first], inner[last + 1])
    return Runs(side, place[first], place[last], reason, candidate)


def _runs_of_side(beyond: BoolArray, joined: BoolArray) -> tuple[IntArray, IntArray]:
    linked = beyond[1:] & beyond[:-1] & joined
    start, end = beyond.copy(), beyond.copy()
    start[1:] &= ~linked
    end[:-1] &= ~linked
    return np.flatnonzero(start), np.flatnonzero(end)


def _candidates(first: IntArray, last: IntArray, from_break: BoolArray, to_break: BoolArray) -> IntArray:
    """Label of the candidate of each run: runs that touch the same break are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    run = np.arange(first.size)
    # a break is named by the sample after it
    touched = np.concatenate([first[from_break], last[to_break] + 1])
    runs = np.concatenate([run[from_break], run[to_break]])
    name, node = np.unique(touched, return_inverse=True)
    size = first.size + name.size
    graph = coo_array((np.ones(runs.size, dtype=np.int8), (runs, first.size + node)), shape=(size, size))
    labels = np.asarray(connected_components(graph, directed=False)[1])[: first.size]
    return np.unique(labels, return_inverse=True)[1].astype(np.int64)


def signals_of_runs(
    table: RecordingTable, runs: Runs, chosen: IntArray, edges: dict[int, FloatArray], curvature: FloatArray
) -> tuple[DepartureSignals, FloatArray, IntArray]:
    """Signals of runs that have both crossings, in the outward frame."""
    first, last, side = runs.first[chosen], runs.last[chosen], runs.side[chosen]
    length = last - first + 3
    offsets = np.concatenate([[0], np.cumsum(length)])
    event = np.repeat(np.arange(chosen.size), length)
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
