"""Properties of the extraction, and an independent, sample-by-sample extraction to compare with."""

import dataclasses
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from helpers.bits import examples
from helpers.recordings import assert_same, drive, frame_of
from ldctoolkit.departures import LEFT, RIGHT, Plausibility, rebuild_signals
from ldctoolkit.recordings import Extraction, OpenedRecordings, Recording, extract_departures
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.table_reader import READER
from ldctoolkit.scenarios import Scenarios

WIDTH = 1.8
SETTINGS = examples(60)
NO_LIMITS = Plausibility(y_rate=np.inf, y_acceleration=np.inf, a_y=np.inf)


def random_drives(seed: int, with_lane: bool, yaw: bool = False) -> list[Recording]:
    """Recordings that wander over both lines, with holes, gaps, lane changes, jumps, some of them smoothed, turn
    signals, and systems that steer. Numbers are multiples of 1/64, so sums of times are exact and samples on the line
    do occur."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 60, rng.integers(1, 8))
    n = int(lengths.sum())
    lane_width = 3.5 + rng.choice([0.0, 0.25], n, p=[0.9, 0.1])
    walk = np.concatenate([np.cumsum(rng.normal(0.0, 0.2, length)) for length in lengths])
    offset = np.round((1.4 * np.sin(walk)) * 64) / 64
    lane = np.concatenate([np.cumsum(rng.random(length) < 0.03) for length in lengths])
    leap = np.array([-3.5, 3.5, -0.75, 0.75])
    jump = np.concatenate([np.cumsum((rng.random(length) < 0.04) * rng.choice(leap)) for length in lengths])
    if rng.random() < 0.5:  # over three steps
        jump = np.round(np.convolve(jump, [0.25, 0.5, 0.25])[1:-1] * 64) / 64
    step = rng.choice([0.125, 0.25, 0.5], n, p=[0.9, 0.08, 0.02])
    speed = np.round(rng.uniform(-1.0, 30.0) * 64) / 64 + rng.integers(-64, 64, n) / 64
    bend = rng.normal(0.0, 1e-3, n)
    speed[rng.random(n) < 0.01] = np.nan
    speed += 16.0 * (rng.random(n) < 0.02)
    columns: dict[str, Any] = {
        "t": np.concatenate([np.cumsum(part) for part in np.split(step, np.cumsum(lengths)[:-1])]),
        "lane_offset": offset if with_lane else offset - jump,
        "lane_width": lane_width,
        "speed": speed,
        "valid": rng.random(n) > 0.02,
        "curvature": None if yaw else bend,
        "yaw_rate": 20.0 * bend if yaw else None,
        "lane": lane if with_lane else None,
        "turn_signal": rng.choice([-1, 0, 1], n, p=[0.02, 0.96, 0.02]),
        "engaged": np.cumsum(rng.random(n) < 0.03) % 8 == 7 if rng.random() < 0.5 else None,
    }
    ends = np.cumsum(lengths)
    arguments_given = {
        name: None if values is None else np.split(values, ends[:-1]) for name, values in columns.items()
    }
    return [
        Recording(f"r{i}", **{name: None if values is None else values[i] for name, values in arguments_given.items()})
        for i in range(lengths.size)
    ]


def extract(recordings: Iterable[Recording], **criteria: Any) -> Extraction:
    return extract_departures(recordings, vehicle_width=2.0, force=True, **criteria)


def asked(T: float, d_y: float, v_mean: float, a_mean: float, c_0: float, dc: float) -> float:
    """What the path of a departure asks of driver and vehicle, at 2,001 times; above 1 it is implausible."""
    v = Polynomial([v_mean - 0.5 * a_mean * T, a_mean])
    share = v.integ() / (v_mean * T)
    y, c = 4.0 * d_y * share * (1.0 - share), Polynomial([c_0, dc / T])
    t = np.linspace(0.0, T, 2001)
    return max(4.0 * d_y / T / 2.0, np.abs(y.deriv(2)(t)).max() / 4.0, np.abs((v**2 * c + y.deriv(2))(t)).max() / 6.0)


def too_fast(recording: Recording, i: int, j: int) -> bool:
    """Whether offset or width move too far and too fast between two samples."""
    dt, most = recording.t[j] - recording.t[i], 0.7 * min(recording.lane_width[i], recording.lane_width[j])
    if abs(recording.lane_width[j] - recording.lane_width[i]) > max(0.5, dt):
        return True
    return abs(recording.lane_offset[j] - recording.lane_offset[i]) > max(
        0.6, min(0.6 + 1.5 * max(dt - 0.1, 0.0), most)
    )


def spread(recording: Recording, good: list[int], seeds: set[int], walls: set[int], reach: float) -> set[int]:
    """Places in `good` that are no further in time from some of them, or next to them, and no wall between."""
    reached = set(seeds)
    for position in seeds:
        for way in (-1, 1):
            neighbour = position + way
            while 0 <= neighbour < len(good) and max(neighbour, neighbour - way) not in walls:
                if (
                    abs(recording.t[good[neighbour]] - recording.t[good[position]]) > reach
                    and neighbour != position + way
                ):
                    break
                reached.add(neighbour)
                neighbour += way
    return reached


def movements(recording: Recording, good: list[int], beyond: set[int], walls: set[int]) -> list[set[int]]:
    """Jumps and changes of the lane's label, each as the steps that it takes, named by the later sample's place in
    `good`. `walls` are steps across a gap or an invalid sample."""
    near = spread(recording, good, beyond, walls, 0.6)
    steps: set[int] = set()
    for lag in range(1, len(good)):  # the closest pairs first
        pairs = []
        for position in range(len(good) - lag):
            inside = set(range(position + 1, position + lag + 1))
            far = lag > 1 and recording.t[good[position + lag]] - recording.t[good[position]] > 0.6
            if not far and inside | {position} <= near and not inside & (walls | steps):
                pairs += [inside] if too_fast(recording, good[position], good[position + lag]) else []
        steps = steps.union(*pairs)
    moving = spread(recording, good, {position for step in steps for position in (step - 1, step)}, walls, 0.3)
    moved = {position for position in moving if position - 1 in moving and position not in walls}
    if recording.lane is not None:
        moved |= {
            position
            for position in range(1, len(good))
            if recording.lane[good[position]] != recording.lane[good[position - 1]]
        }
    groups: list[set[int]] = []
    for position in sorted(moved):
        if groups and position - 1 in groups[-1]:
            groups[-1].add(position)
        else:
            groups.append({position})
    return groups


def within_limits(recording: Recording) -> list[int]:
    """Samples that can be used, for a recording with a curvature."""
    return [
        i
        for i in range(recording.samples)
        if recording.valid[i]
        and 2.0 <= recording.lane_width[i] <= 7.0
        and abs(recording.lane_offset[i]) <= recording.lane_width[i]
        and abs(recording.speed[i]) <= 100.0
        and abs(recording.curvature[i]) <= 0.2  # type: ignore[index]
    ]


def one_by_one(recordings: list[Recording]) -> tuple[list[tuple[float, ...]], Counter[str]]:
    """The rules of docs/how-to/my-recordings.md, walked through with plain loops, for a vehicle of 2 m."""
    events: list[tuple[float, ...]] = []
    refused: Counter[str] = Counter()
    for number, table in enumerate(recordings):
        end = table.samples
        good = within_limits(table)
        steps = np.diff(table.t)
        limit = max(0.25, 2.5 * float(np.median(steps))) if steps.size else 0.25
        edges = {
            side: {i: side * table.lane_offset[i] + 1.0 - 0.5 * table.lane_width[i] for i in good}
            for side in (LEFT, RIGHT)
        }
        why: dict[int, str] = {}  # what lies before a place in `good`, and the break that it is part of
        of: dict[int, Any] = {}
        for position in range(1, len(good)):
            i, j = good[position - 1], good[position]
            if j > i + 1 or table.t[j] - table.t[i] > limit:
                why[position], of[position] = "invalid" if j > i + 1 else "gap", position
        beyond = {position for position, i in enumerate(good) if max(edges[LEFT][i], edges[RIGHT][i]) > 0.0}
        for group in movements(table, good, beyond, set(why)):
            members = [good[position] for position in (min(group) - 1, *sorted(group))]
            way = max(table.lane_offset[members]) - min(table.lane_offset[members])
            lane = 0.5 * (table.lane_width[members[0]] + table.lane_width[members[-1]])
            for position in group:
                label = table.lane is not None and table.lane[good[position]] != table.lane[good[position - 1]]
                change = label or (way > 0.6 and 0.7 < way / lane < 1.3)
                why[position], of[position] = "lane_change" if change else "jump", min(group)

        runs: list[dict[str, Any]] = []
        for side in (LEFT, RIGHT):
            y = edges[side]
            open_run: dict[str, Any] | None = None
            for position, i in enumerate(good):
                broken, mark = why.get(position), of.get(position)
                if position == 0:
                    broken = "invalid" if i > 0 else "cut_by_end"
                if open_run is not None and (broken or y[i] <= 0):
                    open_run["end"] = (broken, mark)
                    open_run = None
                if y[i] > 0:
                    if open_run is None:
                        open_run = {"side": side, "y": y, "rows": [], "start": (broken, mark), "end": None}
                        runs.append(open_run)
                    open_run["rows"].append(i)
            if open_run is not None:
                open_run["end"] = ("invalid" if good[-1] < end - 1 else "cut_by_end", None)
        groups: list[tuple[set[Any], list[dict[str, Any]]]] = []
        for run in runs:
            marks = {mark for _, mark in (run["start"], run["end"]) if mark is not None}
            joined = [group for group in groups if group[0] & marks]
            groups = [group for group in groups if not group[0] & marks]
            groups.append((marks.union(*(g[0] for g in joined)), [run, *(r for g in joined for r in g[1])]))
        for _, members in groups:
            cut = {reason for run in members for reason, _ in (run["start"], run["end"]) if reason}
            if cut:
                refused[min(cut, key=REASONS.index)] += 1
                continue
            (run,) = members
            rows, y, side = run["rows"], run["y"], run["side"]
            first, last = rows[0], rows[-1]

            def cross(inner: int, outer: int, signal: Any, y: Any = y) -> float:
                return float(np.interp(0.0, [y[inner], y[outer]], [signal[inner], signal[outer]]))

            start, stop = cross(first - 1, first, table.t), cross(last + 1, last, table.t)
            bends = side * table.curvature  # type: ignore[operator]
            speeds = [cross(first - 1, first, table.speed), *table.speed[rows], cross(last + 1, last, table.speed)]
            times = [start, *table.t[rows], stop]
            v_mean = np.trapezoid(speeds, times) / (stop - start)
            every = [first - 1, *rows, last + 1]
            if any(abs(table.lane_offset[i]) >= 0.7 * table.lane_width[i] for i in every):
                refused["lane_change"] += 1
            elif stop - start < 0.5:
                refused["too_short"] += 1
            elif stop - start > 10.0:
                refused["too_long"] += 1
            elif len(rows) < 3:
                refused["too_few_samples"] += 1
            elif not v_mean > 5.0 or min(speeds) <= 0:
                refused["slow"] += 1
            elif table.engaged is not None and any(table.engaged[every]):
                refused["engaged"] += 1
            elif any(table.turn_signal[i] == side for i in every[:-1]):  # type: ignore[index]
                refused["intended"] += 1
            else:
                tau, T = table.t[rows] - start, stop - start
                a_mean, (slope, c_0) = np.polyfit(tau, table.speed[rows], 1)[0], np.polyfit(tau, bends[rows], 1)
                driven = [np.trapezoid(speeds[: i + 2], times[: i + 2]) / (v_mean * T) for i in range(len(rows))]
                parabola = [4.0 * share * (1.0 - share) for share in driven]
                d_y = np.dot(parabola, [y[i] for i in rows]) / np.dot(parabola, parabola)
                if abs(a_mean) > 9.81 or asked(T, d_y, v_mean, a_mean, c_0, slope * T) > 1.0:
                    refused["implausible"] += 1
                else:
                    events.append((number, first, side, start, T, len(rows)))
    return sorted(events, key=lambda event: (event[0], event[1], -event[2])), refused


@SETTINGS
@given(seed=st.integers(0, 2**32 - 1), with_lane=st.booleans())
def test_equals_the_walk_through_every_sample(seed, with_lane):
    drives = random_drives(seed, with_lane)
    events, refused = one_by_one(drives)
    extraction = extract(drives)
    d = extraction.departures
    assert {reason: count for reason, count in extraction.refused.items() if count} == dict(refused)
    assert d.side.tolist() == [event[2] for event in events]
    assert d.samples.tolist() == [event[5] for event in events]
    np.testing.assert_allclose(d.start_time, [event[3] for event in events], rtol=1e-12)
    np.testing.assert_allclose(d.T, [event[-2] for event in events], rtol=1e-12)
    assert extraction.candidates == len(events) + sum(refused.values())


def test_the_random_tables_reach_every_reason():
    total: Counter[str] = Counter()
    for seed in range(60):
        for with_lane in (True, False):
            extraction = extract(random_drives(seed, with_lane))
            total.update(dict(extraction.refused.items()) | {"departures": len(extraction.departures)})
    missing = [name for name in (*REASONS, "departures") if not total[name]]
    # ten seconds beyond the line do not happen in walks this short
    assert set(missing) <= {"too_long", "too_few_samples"}


@SETTINGS
@given(seed=st.integers(0, 2**32 - 1), yaw=st.booleans())
def test_mirror(seed, yaw):
    drives = random_drives(seed, True, yaw)
    names = ("lane_offset", "curvature", "yaw_rate", "turn_signal")
    flipped = [
        dataclasses.replace(r, **{name: -getattr(r, name) for name in names if getattr(r, name) is not None})
        for r in drives
    ]
    plain, two = extract(drives), extract(flipped)
    # a left and a right event may begin at the same sample only where they change places with each other
    a, b = (
        np.lexsort((d.side * s, d.start_time, d.recording)) for d, s in ((plain.departures, 1), (two.departures, -1))
    )
    np.testing.assert_array_equal(plain.departures.side[a], -two.departures.side[b])
    np.testing.assert_array_equal(plain.departures.matrix()[a], two.departures.matrix()[b])
    assert plain.refused == two.refused


@SETTINGS
@given(seed=st.integers(0, 2**32 - 1), shift=st.integers(-(10**6), 10**9))
def test_shifting_time_changes_nothing_else(seed, shift):
    drives = random_drives(seed, True)
    plain, two = extract(drives), extract(dataclasses.replace(r, t=r.t + shift) for r in drives)
    np.testing.assert_array_equal(plain.departures.matrix(), two.departures.matrix())
    # the clock itself resolves 1e-7 s at 1e9 s
    np.testing.assert_allclose(two.departures.start_time, plain.departures.start_time + shift, rtol=1e-15, atol=1e-12)
    assert (plain.refused, plain.hours) == (two.refused, two.hours)


@pytest.mark.slow
@examples(12)  # writes and parses three files each
@given(seed=st.integers(0, 2**32 - 1), yaw=st.booleans(), block=st.integers(300, 8000), cut=st.integers(1, 6))
def test_files_and_blocks_make_no_difference(tmp_path_factory, seed, yaw, block, cut):
    drives = [r for r in random_drives(seed, True, yaw) if np.isfinite(r.speed).any()]
    folder = tmp_path_factory.mktemp("split")
    cut = min(cut, len(drives) - 1)
    files = {"all": drives, "0": drives[:cut], "1": drives[cut:]}
    for name, subset in files.items():
        if subset:
            frame_of(subset).write_csv(folder / f"{name}.csv")
            frame_of(subset).write_parquet(folder / f"{name}.parquet")
    reader = dataclasses.replace(READER, block_bytes=block)
    for names in (["all.csv"], ["all.parquet"], ["0.csv", "1.parquet"] if cut else []):
        if names:
            opened = OpenedRecordings(reader, reader.open([folder / name for name in names]), "")
            assert_same(extract(drives), extract_departures(opened, vehicle_width=2.0, force=True))


@examples(40)
@given(data=st.data(), rate=st.integers(10, 50), side=st.sampled_from([LEFT, RIGHT]), n=st.integers(1, 4))
def test_planted_departures_come_back(data, rate, side, n):
    def draw(low: float, high: float) -> list[float]:
        return [data.draw(st.floats(low, high)) for _ in range(n)]

    T_drawn = draw(0.8, 9.0)
    # the path is nowhere as fast as a jump, which moves more than 1.35 m in 0.6 s
    depths = [data.draw(st.floats(0.05, min(0.9, 0.54 * T))) for T in T_drawn]
    planted = Scenarios.from_arrays(
        T=T_drawn, d_y=depths, v_mean=draw(12.0, 38.0), a_mean=draw(-0.5, 0.5), c_0=draw(-2e-3, 2e-3),
        dc=draw(-1e-3, 1e-3), side=side,
    )  # fmt: skip
    # on the recording's clock each departure starts somewhere between two samples; the approach is as steep as the
    # parabola's own ends, the rest of the recording is quiet
    fine = rebuild_signals(planted, 1e-3)
    columns: dict[str, list[np.ndarray]] = {"t": [], "y": [], "v": [], "c": []}
    starts = []
    for i in range(n):
        rows = slice(fine.offsets[i], fine.offsets[i + 1])
        T = float(planted.T[i])
        start = 5.0 + data.draw(st.floats(0.0, 1.0)) / rate
        starts.append(start)
        t = np.arange(round((T + 10.0) * rate)) / rate
        tau = t - start
        steep = 4.0 * planted.d_y[i] / T
        change = 0.5 * planted.a_mean[i] * T / planted.v_mean[i]
        outside = -steep * np.maximum(np.maximum(-tau * (1.0 - change), (tau - T) * (1.0 + change)), 0.0)
        y = np.where((tau >= 0) & (tau <= T), np.interp(tau, fine.t[rows], fine.y[rows]), np.maximum(outside, -1.0))
        columns["t"].append(t)
        columns["y"].append(y)
        # speed and curvature go on along their lines
        columns["v"].append(planted.v_mean[i] + planted.a_mean[i] * (np.clip(tau, -1.0, T + 1.0) - 0.5 * T))
        columns["c"].append(planted.c_0[i] + planted.dc[i] * np.clip(tau, -1.0, T + 1.0) / T)
    drives = [
        drive(
            f"r{i}", t, lane_offset=side * (columns["y"][i] + 0.5 * (3.6 - WIDTH)), speed=columns["v"][i],
            curvature=side * columns["c"][i],
        )
        for i, t in enumerate(columns["t"])
    ]  # fmt: skip
    # much of so short a drive lies beyond the line
    extraction = extract_departures(drives, vehicle_width=WIDTH, plausibility=NO_LIMITS, force=True)
    d = extraction.departures
    assert (len(d), extraction.refused.total, d.side.tolist()) == (n, 0, [side] * n)
    # A crossing lies between a straight line of slope s and a parabola s tau - k tau^2. The chord over a step h passes
    # the crossing at most 4/27 k h^2 too low, with a slope of s - k h or more. At constant speed s = 4 d_y/T and
    # k = s/T; the speeds here change s by up to 19 % and k by up to 60 %: the time is off by less than 0.4 h^2/T
    h = 1.0 / rate
    tolerance = 0.4 * h * (h / planted.T)
    np.testing.assert_array_less(np.abs(d.start_time - starts), tolerance + 1e-9)
    np.testing.assert_array_less(np.abs(d.T - planted.T), 2.0 * tolerance + 1e-9)
    np.testing.assert_allclose(d.d_y, planted.d_y, atol=0.01)
    np.testing.assert_allclose(d.v_mean, planted.v_mean, atol=0.01)
    np.testing.assert_allclose(d.a_mean, planted.a_mean, atol=1e-9)
    np.testing.assert_allclose(d.sigma_y, 0.0, atol=0.01)
    # c is a straight line in time, recovered exactly; only the ends it is told at move with the crossings
    reach = np.abs(planted.dc) / planted.T * 2.0 * tolerance + 1e-12
    np.testing.assert_array_less(np.abs(d.c_0 - planted.c_0), reach)
    np.testing.assert_array_less(np.abs(d.dc - planted.dc), reach)
    # by default those whose path asks too much are refused; the error of d_y alone changes that by up to 4 %
    retained = set(extract_departures(drives, vehicle_width=WIDTH, force=True).departures.recording)
    for i in range(n):
        most = asked(*(getattr(planted, name)[i] for name in ("T", "d_y", "v_mean", "a_mean", "c_0", "dc")))
        if abs(most - 1.0) > 0.1:
            assert (f"r{i}" in retained) == (most < 1.0)
