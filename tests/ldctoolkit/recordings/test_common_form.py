"""The common form of a recording: times, yaw rate, curvature, scale, step."""

import dataclasses
import itertools
import math
import statistics
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import examples
from helpers.errors import refused
from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import InputError, RecordingError
from ldctoolkit.recordings import Preparation, Recording, extract_departures
from ldctoolkit.recordings.find_departures import SPEED_FLOOR, curvature_from_yaw_rate
from ldctoolkit.recordings.preparation import (
    FILLED,
    NONE,
    coarse_step,
    corrected,
    local_slope,
    on_own_clocks,
    prepare,
    resample,
    rising_rows,
    stretches,
    with_yaw_rate,
)


def by_trial(times: list[int]) -> list[bool]:
    """Of all choices that do not fall a longest one; among these the one whose row numbers come first."""
    for length in range(len(times), 0, -1):
        for rows in itertools.combinations(range(len(times)), length):  # in the order of row numbers
            if all(times[a] <= times[b] for a, b in itertools.pairwise(rows)):
                return [row in rows for row in range(len(times))]
    return []


@examples(400)
@given(st.lists(st.integers(-3, 6), max_size=11))
def test_every_choice(times: list[int]) -> None:
    assert rising_rows(np.array(times, dtype=float)).tolist() == by_trial(times)


N = 300
T_YAW_FROM_HEADING = np.arange(N) * 0.1


def bend(**changes: object) -> Recording:
    """A left bend of 1/1000 m at 25 m/s, the vehicle 0.3 m over the left line for 2 s around t = 15 s."""
    beyond = np.clip(0.3 * (1.0 - (T_YAW_FROM_HEADING - 15.0) ** 2), -0.4, None)
    unit = np.ones(N)
    recording = Recording(
        "a", T_YAW_FROM_HEADING, 0.9 + beyond, 3.6 * unit, 25.0 * unit, unit > 0, yaw_rate=0.025 * unit,
        heading=3.0 + 0.025 * T_YAW_FROM_HEADING - 2.0 * np.pi * (T_YAW_FROM_HEADING > 5.0),
    )  # fmt: skip
    return dataclasses.replace(recording, **changes)  # type: ignore[arg-type]


def test_a_hole_is_filled_through_a_turn_of_the_heading() -> None:
    rate = np.full(N, 0.03)
    rate[40:160] = np.nan
    filled = with_yaw_rate(bend(yaw_rate=rate))
    assert (filled.yaw_rate[:40] == 0.03).all()
    assert (filled.yaw_rate[160:] == 0.03).all()
    np.testing.assert_allclose(filled.yaw_rate[40:160], 0.025, atol=1e-9)  # rounding of the slope
    assert np.flatnonzero(~filled.yaw_rate_measured).tolist() == list(range(40, 160))
    # what a reader has marked stays marked
    marked = with_yaw_rate(bend(yaw_rate=rate, yaw_rate_measured=T_YAW_FROM_HEADING > 1.0))
    assert np.flatnonzero(~marked.yaw_rate_measured).tolist() == [*range(11), *range(40, 160)]
    assert filled.notes == (FILLED,)


def test_holes_in_the_heading_stay_holes() -> None:
    heading = bend().heading.copy()
    heading[100:200] = np.nan
    filled = with_yaw_rate(bend(yaw_rate=np.full(N, np.nan), heading=heading))
    lost = np.isnan(filled.yaw_rate)
    assert lost[110:190].all()  # a heading holds for a second beyond the last
    assert not lost[:100].any()
    assert not lost[200:].any()


def test_without_both_the_lane_counts_as_straight() -> None:
    nothing = np.full(N, np.nan)
    recording = with_yaw_rate(bend(yaw_rate=nothing, heading=nothing))
    assert recording.yaw_rate is None
    assert recording.yaw_rate_measured is None
    assert recording.notes == (NONE,)
    # nor is the speed known: the yaw rate is the least of its troubles
    lost = with_yaw_rate(bend(yaw_rate=nothing, heading=None, speed=nothing))
    assert lost.notes == ()
    assert lost.yaw_rate is not None


def estimate(yaw_rate, speed, usable=None, first=None, t=None):
    """At 25 Hz, five samples to either side."""
    n = len(speed)
    t = 0.04 * np.arange(n) if t is None else t
    usable = np.ones(n, bool) if usable is None else usable
    starts = np.zeros(n, bool)
    starts[0] = True
    if first is not None:
        starts[first] = True
    steps = np.diff(t)[np.diff(t) > 0.005]
    return curvature_from_yaw_rate(yaw_rate, speed, usable, starts, t, np.full(n, np.median(steps)))


def by_least_squares(yaw_rate, speed, usable, stretch, t):
    """Each sample by itself, over all of its stretch that lie within 0.2 s."""
    expected = np.full(len(t), np.nan)
    for i in np.flatnonzero(usable):
        window = usable & (stretch == stretch[i]) & (np.abs(t - t[i]) <= 0.2 + 1e-6)
        expected[i] = np.linalg.lstsq(speed[window, None], yaw_rate[window], rcond=None)[0][0]
    return expected


def frames(rng: np.random.Generator, kind: str, n: int = 240) -> np.ndarray:
    """Times of samples."""
    if kind.endswith("Hz"):
        return np.arange(n) / float(kind.split()[0])
    if kind.startswith("burst"):  # so many frames a millisecond apart, ten times a second
        count = int(kind.split()[1])
        return np.repeat(0.1 * np.arange(n // count), count) + 1e-3 * np.tile(np.arange(count), n // count)
    if kind == "equal":  # two frames of one time
        return np.repeat(0.05 * np.arange(n // 2), 2)
    if kind == "jitter":
        return np.cumsum(rng.uniform(0.01, 0.09, n))
    if kind == "slow":  # further apart than the window
        return np.cumsum(rng.uniform(0.15, 0.45, n))
    return np.cumsum(rng.choice([0.0, 1e-4, 0.02, 0.1, 0.2], n))


@pytest.mark.parametrize("origin", [0.0, 1.7e9])
@pytest.mark.parametrize(
    "kind", ["10 Hz", "20 Hz", "50 Hz", "100 Hz", "burst 2", "burst 3", "burst 5", "equal", "jitter", "slow", "mixed"]
)
def test_equals_least_squares_over_a_fifth_of_a_second(kind, origin):
    """However samples are spaced."""
    rng = np.random.default_rng(1)
    t = origin + frames(rng, kind)
    v, r = rng.uniform(5, 30, t.size), rng.normal(0, 0.05, t.size)
    usable = rng.random(t.size) > 0.1
    c = estimate(r, v, usable, first=t.size // 2, t=t)
    stretch = np.cumsum((np.arange(t.size) == t.size // 2) | ~usable)
    np.testing.assert_allclose(c, by_least_squares(r, v, usable, stretch, t), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_a_slope_of_many_samples_takes_all_of_its_window(rate):
    """A step of the values shows in the slope as far as half a window away, and no further."""
    t = np.arange(round(4.0 * rate)) / rate
    slope = local_slope(t, (t >= 2.0).astype(float), half=0.5, longest=1.0)
    (seen,) = np.nonzero(np.abs(slope) > 1e-9)
    tolerance = 0.5 / 50 + 1e-9  # of so many samples every second, third, ...
    assert 0.0 <= t[seen[0]] - 1.5 <= tolerance
    assert 0.0 <= 2.5 - t[seen[-1]] <= tolerance
    # in the middle that of the straight line through as many zeros as ones: 1.5 steps / width
    assert slope[round(2.0 * rate)] == pytest.approx(1.5, rel=0.03)


def test_low_speed_fades_out():
    # half a degree a second of sensor noise, at a speed of nearly nothing
    c = estimate(np.full(20, 0.01), np.full(20, 1e-3))
    assert np.abs(c).max() <= 0.01 * 1e-3 / SPEED_FLOOR**2 * (1.0 + 1e-12)
    assert estimate(np.full(20, 0.01), np.zeros(20)).tolist() == [0.0] * 20


def scale_of(extraction: Any) -> list[float]:
    return next((column.values.tolist() for column in extraction.departures.extra if column.name == "lane_scale"), [])


@pytest.mark.parametrize(("jump", "max_jump", "bridged"), [
    (0.5, 0.6, True), (0.7, 0.6, False), (0.7, 0.8, True), (0.5, 0.4, False), (0.3, 0.4, True),
])  # fmt: skip
def test_the_criterions_jump_is_the_preparations(jump, max_jump, bridged):
    """A sample is missing where the offset steps up, beyond the line."""
    offset = np.interp(T, [3.0, 4.9, 5.1, 8.0], [0.2, 1.2, 1.2 + jump, 0.2])
    recording = drive(lane_offset=offset).take(np.arange(100) != 50)
    prepared = prepare(recording, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.samples == 99 + bridged
    if bridged:
        assert prepared.lane_offset[50] == pytest.approx(1.2 + 0.5 * jump)
    preparation = Preparation(step=0.1)
    extraction = extract_departures([recording], vehicle_width=1.8, max_jump=max_jump, preparation=preparation)
    assert extraction.departures.n == bridged
    assert extraction.refused.gap + extraction.refused.jump == extraction.refused.total == (not bridged)


@pytest.mark.parametrize("max_jump", [0.6, 2.0])
def test_two_middle_offsets_a_jump_apart(max_jump):
    """Their mean lies where the vehicle never was; it is taken only if the criterion sees no jump between them."""
    t = np.array([0.0, 0.06, 0.1, 0.14, 0.2])
    full = np.full(5, 25.0)
    recording = Recording("a", t, np.array([0.0, 0, 0, 1, 1]), full - 21.4, full, full > 0.0)
    recording = recording.take(np.array([0, 1, 3, 4]))
    prepared = prepare(recording, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.lane_offset.tolist() == [0.0, 0.5 if max_jump == 2.0 else 0.0, 1.0]


@pytest.mark.parametrize("seen", [2.5, 3.5, 4.2])
def test_the_nominal_width(seen):
    """A camera that sees everything `seen`/3.5 times as large as it is."""
    true = drive(lane_offset=OFFSET - 0.05, lane_width=np.full(100, 3.5))
    factor = 3.5 / seen
    wrong = dataclasses.replace(true, lane_offset=true.lane_offset / factor, lane_width=true.lane_width / factor)
    preparation = Preparation(nominal_lane_width=3.5)
    prepared = prepare(corrected(wrong, preparation), preparation)
    assert (prepared.lane_scale, np.median(prepared.lane_width)) == (pytest.approx(factor), pytest.approx(3.5))
    np.testing.assert_allclose(prepared.lane_offset, true.lane_offset)

    right = extract_departures([true], vehicle_width=1.8)
    extraction = extract_departures([wrong], vehicle_width=1.8, preparation=preparation)
    assert len(right.departures) == len(extraction.departures) == 1
    np.testing.assert_allclose(extraction.departures.matrix(), right.departures.matrix(), rtol=1e-9, atol=1e-12)
    # told even where the factor is 1: it was asked for; never told where it was not
    assert scale_of(extraction) == pytest.approx([factor])
    assert scale_of(right) == []


def test_the_median_is_that_of_usable_samples():
    width = np.full(100, 2.8)
    width[:80] = 3.7
    valid = np.arange(100) >= 30
    speed = np.full(100, 25.0)
    speed[30:80] = np.nan
    recording = drive(lane_width=width, valid=valid, speed=speed)
    assert corrected(recording, Preparation(nominal_lane_width=3.5)).lane_scale == pytest.approx(1.25)
    assert corrected(recording, Preparation()).lane_scale == 1.0
    nothing = drive(valid=np.zeros(100, bool))
    assert corrected(nothing, Preparation(nominal_lane_width=3.5)) is nothing
    # a reader that has scaled already
    assert corrected(drive(lane_scale=2.0), Preparation(nominal_lane_width=3.6)).lane_scale == pytest.approx(2.0)


def test_the_yaw_rate_factor():
    yaw_rate = np.full(100, 0.02)
    recording = drive(curvature=None, yaw_rate=-yaw_rate)
    extraction = extract_departures([recording], vehicle_width=1.8, preparation=Preparation(yaw_rate_factor=-1.0))
    np.testing.assert_allclose(extraction.departures.c_0, 0.02 / 25.0)
    measured = drive(curvature=np.full(100, 1e-3))
    assert corrected(measured, Preparation(yaw_rate_factor=-1.0)) is measured


def lost(recording: Recording, name: str, **limits: Any) -> list[int]:
    """Rows in which a signal is not there any more once a recording is prepared; the others are what they were."""
    values = getattr(recording, name)
    prepared = getattr(prepare(on_own_clocks(corrected(recording, Preparation())), Preparation(), **limits), name)
    gone = ~np.isfinite(prepared)
    np.testing.assert_array_equal(prepared[~gone], values[~gone])
    return np.flatnonzero(gone).tolist()


LIVELY = np.random.default_rng(0).uniform(-0.1, 0.1, 100)
"""Noise: signals that stand still are not driving."""


@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [
        ("lane_width", 2.0, 1.999), ("lane_width", 7.0, 7.001), ("lane_offset", 3.6, 3.601),
        ("lane_offset", -3.6, -3.601), ("speed", 100.0, 100.001), ("speed", -100.0, -100.001),
        ("curvature", 0.2, 0.2001), ("curvature", -0.2, -0.2001), ("yaw_rate", 1.5, 1.5001),
        ("yaw_rate", -1.5, -1.5001),
    ],
)  # fmt: skip
def test_numbers_that_no_lane_and_no_vehicle_has(name, inside, outside):
    """Two rows, so that they are no code, one beside the other, so that they are no spike."""
    base = {"lane_width": 3.6, "speed": 25.0}.get(name, 0.0)
    for value, rows in ((inside, []), (outside, [30, 31])):
        signal = base + LIVELY
        signal[[30, 31]] = value
        columns = {"lane_offset": LIVELY} | ({"curvature": None} if name == "yaw_rate" else {}) | {name: signal}
        recording = drive(**columns)
        assert lost(recording, name) == rows
        if name == "lane_width":
            assert lost(recording, name, widths=(1.0, 9.0)) == []
    # a width that is not known does not tell how far the offset may be
    assert lost(drive(lane_offset=LIVELY + 3.0, lane_width=np.nan), "lane_offset") == []


@pytest.mark.parametrize(
    ("name", "base", "gap"),
    [("lane_width", 3.6, 1.0), ("lane_offset", 0.0, 0.6), ("speed", 25.0, 10.0), ("curvature", 0.0, 0.01),
     ("yaw_rate", 0.0, 0.3)],
)  # fmt: skip
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_number_that_stands_for_not_available(name, base, gap, side):
    """The end of a column's range, three times, far from all others."""
    rows = np.array([10, 40, 41])
    for times, share, expected in ((3, 1.01, [10, 40, 41]), (3, 0.99, []), (2, 1.01, [])):
        signal = base + LIVELY * gap
        last = signal.max() if side > 0.0 else signal.min()
        signal[rows[:times]] = last + side * share * gap
        columns = {"lane_offset": LIVELY} | ({"curvature": None} if name == "yaw_rate" else {}) | {name: signal}
        assert lost(drive(**columns), name) == expected
    # an absurd number hides none, nor does one of a row that is not valid
    for odd, valid in ((side * 1e12, True), (side * 1e3, np.arange(100) != 80), (np.nan, True)):
        signal[rows], signal[80] = last + side * 1.01 * gap, odd
        values = getattr(
            on_own_clocks(corrected(drive(**(columns | {name: signal, "valid": valid})), Preparation())), name
        )
        assert np.flatnonzero(np.isnan(values[:80])).tolist() == [10, 40, 41]
    signal[80] = base
    # of several codes all, from the outside in
    signal[[10, 40, 41, 60, 61, 62]] = last + side * gap * np.array([1.1, 1.1, 1.1, 3.0, 3.0, 3.0])
    assert lost(drive(**(columns | {name: signal})), name) == [10, 40, 41, 60, 61, 62]


@pytest.mark.parametrize(
    ("name", "base", "most"),
    [("lane_width", 3.6, 10.0), ("lane_offset", 0.0, 5.0), ("speed", 25.0, 60.0), ("curvature", 0.0, 0.2),
     ("yaw_rate", 0.0, 1.5)],
)  # fmt: skip
def test_a_number_that_most_samples_have_is_a_code_only_if_it_is_large(name, base, most):
    """Of another unit it may be the signal itself."""
    for value, rows, lost_rows in ((most, 51, 0), (most, 50, 50), (1.001 * most, 51, 51), (1.001 * most, 97, 97)):
        signal = base + 0.001 * LIVELY
        signal[:rows] = value
        columns = {"lane_offset": LIVELY} | ({"curvature": None} if name == "yaw_rate" else {}) | {name: signal}
        values = getattr(on_own_clocks(corrected(drive(**columns), Preparation())), name)
        assert np.flatnonzero(np.isnan(values)).tolist() == list(range(lost_rows))


def test_what_is_no_code():
    """A made signal that stands still, and steps; the one row in which a constant width differs; what is invalid."""
    step = np.where(T < 6.0, 0.3, -1.2)
    assert lost(drive(lane_offset=step), "lane_offset") == []
    width = np.where(np.arange(100) == 50, 5.0, 3.6)
    assert lost(drive(lane_offset=LIVELY, lane_width=width), "lane_width") == []
    for code in (0.0, -3.6, 1e6):
        width[50] = code
        assert lost(drive(lane_offset=LIVELY, lane_width=width), "lane_width") == [50]
    speed = np.where(np.isin(np.arange(100), [10, 11, 40, 41]), 60.0, 25.0 + LIVELY)
    assert lost(drive(lane_offset=LIVELY, speed=speed, valid=~np.isin(np.arange(100), [40, 41])), "speed") == []


@pytest.mark.parametrize(("name", "base", "height"), [("speed", 25.0, 20.0), ("yaw_rate", 0.0, 0.5)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_single_sample_far_from_both_of_its_neighbours(name, base, height, side):
    for share, rows, expected in ((1.001, [50], [50]), (0.999, [50], []), (1.001, [50, 51], []), (1.001, [0, 99], [])):
        signal = np.full(100, base)
        signal[rows] += side * share * height
        columns = {"curvature": None} if name == "yaw_rate" else {}
        assert lost(drive(lane_offset=LIVELY, **(columns | {name: signal})), name) == expected
    stairs = base + side * height * np.where(np.arange(100) < 50, 0.0, np.where(np.arange(100) < 51, 1.001, 2.002))
    assert lost(drive(lane_offset=LIVELY, **({"curvature": None, name: stairs})), name) == []


def held(values: np.ndarray, rows: int) -> np.ndarray:
    """Each so many-th value, repeated until the next."""
    return np.repeat(values[::rows], rows)[: values.size]


def road(n: int = 300, seed: int = 0) -> Recording:
    """At 10 Hz; the offset moves smoothly, the other signals are noise."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(n)
    columns = {"lane_offset": 0.5 * np.sin(0.9 * t) + 0.01 * rng.normal(size=n), "speed": 25.0 + rng.normal(size=n)}
    return drive(t=t, **columns, curvature=None, yaw_rate=0.01 * rng.normal(size=n))


@pytest.mark.parametrize(("rows", "note"), [(2, ""), (3, ": departures of less than about 0.9 s cannot be found"),
                                            (5, ": departures of less than about 1.5 s cannot be found")])  # fmt: skip
def test_the_lane_has_a_clock_of_its_own(rows, note):
    recording = road()
    slow = dataclasses.replace(recording, lane_offset=held(recording.lane_offset, rows))
    result = on_own_clocks(slow)
    assert result.t.tolist() == recording.t[::rows].tolist()
    for name in ("lane_offset", "speed", "yaw_rate"):  # only the row of the lane counts, as it is
        assert getattr(result, name).tolist() == getattr(recording, name)[::rows].tolist()
    assert result.notes == (f"the lane is new every {rows / 10:.2g} s only{note}",)
    assert on_own_clocks(recording) is recording


@pytest.mark.parametrize("name", ["speed", "yaw_rate", "steering"])
def test_a_signal_with_a_slower_clock_is_interpolated(name):
    recording = road()
    values = np.random.default_rng(1).normal(25.0, 1.0, 300)
    recording = dataclasses.replace(recording, **{name: held(values, 5)})
    result = on_own_clocks(recording)
    expected = np.interp(recording.t, recording.t[::5], values[::5])
    np.testing.assert_allclose(getattr(result, name), expected, rtol=1e-12)
    assert result.notes == (f"{name} is new every 0.5 s only, and interpolated between",)
    assert result.t.tolist() == recording.t.tolist()
    # not where it was lost for longer
    holed = held(values, 5)
    holed[100:130] = np.nan
    result = getattr(on_own_clocks(dataclasses.replace(recording, **{name: holed})), name)
    np.testing.assert_allclose(result[:95], expected[:95], rtol=1e-12)
    assert (result[95:101] == values[95]).all()
    assert np.flatnonzero(np.isnan(result)).tolist() == list(range(101, 125))


def test_signals_without_a_clock_of_their_own():
    """Coarse ones, of which the value stays the same for a while; few values; times that are not even."""
    recording = road()
    coarse = np.round(recording.lane_offset / 0.02) * 0.02
    assert on_own_clocks(dataclasses.replace(recording, lane_offset=coarse)).samples == 300
    few = np.where(recording.t < 15.0, 0.1, 0.2)
    assert on_own_clocks(dataclasses.replace(recording, lane_offset=few)).samples == 300
    rng = np.random.default_rng(3)
    uneven = recording.lane_offset[np.maximum.accumulate(np.where(rng.random(300) < 0.4, np.arange(300), 0))]
    assert on_own_clocks(dataclasses.replace(recording, lane_offset=uneven)).samples == 300


@pytest.mark.parametrize(("step", "noted"), [(0.04, False), (0.05, True), (0.1, True)])
def test_steps_of_the_offset(step, noted):
    recording = road()
    stepped = dataclasses.replace(recording, lane_offset=np.round(recording.lane_offset / step) * step)
    assert coarse_step(stepped.lane_offset) == pytest.approx(step * noted)
    assert on_own_clocks(stepped).notes == ((f"lane_offset comes in steps of {step:.2g} m",) if noted else ())
    # a few samples are on some steps by chance
    assert coarse_step(stepped.lane_offset[:10]) == 0.0


def frozen(**columns: Any) -> list[int]:
    """Rows that are not valid any more, and so no driving."""
    recording = road()
    replaced = {
        name: np.where(np.isfinite(values), values, getattr(recording, name)) for name, values in columns.items()
    }
    return np.flatnonzero(~prepare(dataclasses.replace(recording, **replaced), Preparation()).valid).tolist()


def stands(value: float, rows: slice) -> np.ndarray:
    stuck = np.full(300, np.nan)
    stuck[rows] = value
    return stuck


def test_rows_that_repeat_the_one_before():
    """The lane alone for more than two seconds, or all signals for more than one; the first row is good."""
    ten, eleven, twenty, twenty_one = slice(100, 111), slice(100, 112), slice(100, 121), slice(100, 122)
    assert frozen(lane_offset=stands(0.2, twenty)) == []
    assert frozen(lane_offset=stands(0.2, twenty_one)) == list(range(101, 122))
    # as the vehicle does
    assert frozen(lane_offset=stands(0.2, twenty_one), speed=stands(1.0, twenty_one)) == []
    assert frozen(lane_offset=stands(0.2, twenty_one), speed=stands(1.1, twenty_one)) == list(range(101, 122))
    every = {"lane_offset": 0.2, "speed": 25.0, "yaw_rate": 0.0}
    assert frozen(**{name: stands(value, ten) for name, value in every.items()}) == []
    assert frozen(**{name: stands(value, eleven) for name, value in every.items()}) == list(range(101, 112))
    assert frozen(**{name: stands(value, eleven) for name, value in list(every.items())[:2]}) == []
    # a signal that stands still in most rows, for less long, says nothing when it does so for longer
    for rows, expected in ((3, []), (1, list(range(101, 131)))):
        offset = held(road().lane_offset, rows)
        offset[100:131] = 0.2
        assert frozen(lane_offset=offset) == expected


def test_stretches_lie_between_the_cuts():
    recording = drive(cut=np.isin(np.arange(100), [0, 30, 31]), notes=("odd",))
    pieces = stretches(recording)
    assert [piece.t.tolist() for piece in pieces] == [T[:30].tolist(), T[30:31].tolist(), T[31:].tolist()]
    assert [(piece.continues, piece.notes) for piece in pieces] == [(False, ("odd",)), (True, ()), (True, ())]
    (whole,) = stretches(drive(cut=np.arange(100) == 0))
    assert (whole.samples, whole.continues) == (100, False)
    assert [piece.cut for piece in (whole, *pieces)] == [None] * 4
    assert extract_departures([recording], vehicle_width=1.8).warnings == ("odd: 1 of 1 recordings",)


@pytest.mark.parametrize(("apart", "resampled"), [(0.25, True), (0.26, False)])
def test_a_clock_too_slow_for_any_bridge_is_kept(apart, resampled):
    recording = drive(t=apart * np.arange(100), lane_offset=LIVELY)
    result = prepare(recording, Preparation(step=0.125, max_gap=0.25))
    assert result.t.tolist() == (0.125 * np.arange(199) if resampled else recording.t).tolist()
    assert prepare(recording, Preparation(step=0.5, max_gap=0.1)).samples < 55


def test_the_gap_of_the_criteria_rules_resampled_recordings():
    """A stricter one bridges less; a wider one lets a hole pass, but makes nothing up in it."""
    t = np.arange(200) * 0.05
    offset = 0.9 + np.clip(0.3 * (1.0 - ((t - 5.0) / 0.95) ** 2), -0.4, None)
    columns = {"lane_offset": offset, "lane_width": np.full(200, 3.6), "speed": np.full(200, 25.0)}
    recording = Recording("a", t, valid=np.ones(200, bool), curvature=np.zeros(200), **columns)

    def search(hole: float, **criteria: Any) -> tuple[int, dict[str, int]]:
        holed = recording.take(np.abs(t - 5.0) >= 0.5 * hole - 1e-9)
        result = extract_departures([holed], vehicle_width=1.8, preparation=Preparation(0.1), **criteria)
        samples = int(result.departures.samples[0]) if len(result.departures) else 0
        return samples, {reason: count for reason, count in result.refused.items() if count}

    assert search(0.2) == (19, {})
    assert search(0.2, max_gap=0.15) == (0, {"gap": 1})
    assert search(0.6) == (0, {"gap": 1})
    assert search(0.6, max_gap=0.7) == (14, {})


def test_a_recording_that_cannot_be_prepared_is_a_problem():
    endless = drive("endless", t=[*T[:-1], 1e300], source="x.csv")
    extraction = extract_departures([endless, drive("b")], vehicle_width=1.8, preparation=Preparation(0.1))
    assert extraction.departures.recording.tolist() == ["b"]
    (problem,) = extraction.problems
    assert str(problem).startswith("x.csv: recording 'endless': from t = 0.0 to 1e+300 s is too long")
    assert extraction.provenance.problems == (str(problem),)


def test_things_that_are_no_recordings():
    with pytest.raises(InputError, match="recordings: an item is a str; allowed: Recording"):
        extract_departures(["drive.csv"])  # type: ignore[list-item]


SETTINGS = examples(80)
EPS = 1e-6  # share of a step that the edge of a window is wider


def recording(t: Any, **changes: Any) -> Recording:
    n = len(t)
    columns: dict[str, Any] = {"lane_offset": 0.01 * np.arange(n), "lane_width": np.full(n, 3.6)}
    columns |= {"speed": np.full(n, 25.0), "valid": np.ones(n, bool)}
    return Recording("a", np.asarray(t, dtype=float), **(columns | changes))


def random_recording(seed: int, step: float) -> Recording:
    """Irregular, repeated and jittered times, gaps, invalid and missing samples, jumps, lanes. Times lie on a grid of
    2^-9 s that no edge of a window lies on but those of the multiples, so it is clear what is in."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 80))
    ticks = rng.choice([0, 3, 17, 17, 17, 51, 90, 128, 200, 3000], n)
    t = 7.0 + np.cumsum(ticks) / 512.0
    if rng.random() < 0.2:  # on the multiples of the step, and half-way between them
        t = 7.0 + np.cumsum(rng.choice([0.5, 1.0, 2.0, 3.0], n)) * step
    offset = np.cumsum(rng.normal(0.0, 0.05, n)) + 3.5 * np.cumsum(rng.choice([-1, 0, 1], n, p=[0.05, 0.9, 0.05]))
    speed = rng.uniform(10.0, 30.0, n)
    speed[rng.random(n) < 0.05] = rng.choice([np.nan, np.inf, 1e9])
    width = np.where(rng.random(n) < 0.05, rng.choice([0.0, -1.0, np.nan]), rng.uniform(3.0, 4.0, n))
    yaw_rate = rng.normal(0.0, 0.01, n)
    yaw_rate[rng.random(n) < 0.05] = np.nan
    return Recording(
        "a",
        t,
        offset,
        width,
        speed,
        rng.random(n) > 0.1,
        yaw_rate=yaw_rate if rng.random() < 0.7 else None,
        lane=np.cumsum(rng.random(n) < 0.05) if rng.random() < 0.5 else None,
        turn_signal=rng.integers(-1, 2, n) if rng.random() < 0.5 else None,
        heading=np.where(rng.random(n) < 0.3, np.nan, rng.uniform(-3.0, 3.0, n)) if rng.random() < 0.5 else None,
    )


def one_by_one(recording: Recording, step: float, max_gap: float) -> list[dict[str, Any]]:
    """The docstring of `resample`, in plain loops over every multiple of the step."""

    def known(value: float) -> bool:
        return math.isfinite(value) and abs(value) < 1e9

    t = [float(time) - float(recording.t[0]) for time in recording.t]
    numbers = [
        name for name in ("lane_offset", "lane_width", "speed", "yaw_rate") if getattr(recording, name) is not None
    ]
    good = [
        i
        for i in range(len(t))
        if recording.valid[i]
        and all(known(getattr(recording, name)[i]) for name in numbers)
        and recording.lane_width[i] > 0
    ]
    out = []
    for k in range(round(t[-1] / step) + 2):
        centre = k * step
        if centre > t[-1] + 0.5 * step:
            break
        reach = (0.5 + EPS) * step
        window = [i for i in good if centre - reach <= t[i] < centre + reach or t[i] == centre + reach]
        row: dict[str, Any] = {"t": float(recording.t[0]) + centre, "valid": True}
        nearest = min(good, key=lambda i: abs(t[i] - centre), default=None)
        if recording.lane is not None and window:
            # only the neighbours in the nearest sample's lane, without another one in between
            position = good.index(nearest)
            low = high = position
            while low > 0 and recording.lane[good[low - 1]] == recording.lane[nearest]:
                low -= 1
            while high < len(good) - 1 and recording.lane[good[high + 1]] == recording.lane[nearest]:
                high += 1
            window = [i for i in window if i in good[low : high + 1]]
        before = [i for i in good if t[i] < centre - reach]
        after = [i for i in good if t[i] > centre + reach]
        if window:
            for name in numbers:
                values = sorted(float(getattr(recording, name)[i]) for i in window)
                row[name] = statistics.median(values)
                a, b = values[(len(values) - 1) // 2], values[len(values) // 2]
                if name == "lane_offset" and b - a > 0.6:
                    near = float(recording.lane_offset[nearest])
                    row[name] = a if abs(a - near) <= abs(b - near) else b
        elif (
            before
            and after
            and t[after[0]] - t[before[-1]] <= max_gap * (1.0 + EPS)
            and abs(recording.lane_offset[after[0]] - recording.lane_offset[before[-1]]) <= 0.6
            and (recording.lane is None or recording.lane[after[0]] == recording.lane[before[-1]])
        ):
            i, j = before[-1], after[0]
            for name in numbers:
                row[name] = np.interp(centre, [t[i], t[j]], [getattr(recording, name)[i], getattr(recording, name)[j]])
        elif any(abs(time - centre) <= reach for time in t):
            row["valid"] = False
        else:
            continue
        if row["valid"]:
            for name in ("lane", "turn_signal", "heading"):
                if getattr(recording, name) is not None:
                    row[name] = getattr(recording, name)[nearest]
        out.append(row)
    return out


@SETTINGS
@given(
    seed=st.integers(0, 2**32 - 1),
    step=st.sampled_from([0.05, 0.1, 0.125, 0.3, 1.0]),
    max_gap=st.sampled_from([0.03, 0.25, 1.0]),
)
def test_equals_the_walk_through_every_window(seed, step, max_gap):
    raw = random_recording(seed, step)
    rows = one_by_one(raw, step, max_gap)
    result = resample(raw, step, max_gap)
    assert result.valid.tolist() == [row["valid"] for row in rows]
    np.testing.assert_allclose(result.t, [row["t"] for row in rows], rtol=1e-12)
    for name in ("lane_offset", "lane_width", "speed", "yaw_rate", "lane", "turn_signal", "heading"):
        values = getattr(result, name)
        assert (values is None) == (getattr(raw, name) is None)
        if values is None:
            continue
        expected = [row[name] for row in rows if row["valid"]]
        np.testing.assert_allclose(values[result.valid], expected, rtol=1e-9, atol=1e-12)
        if name in ("lane_offset", "lane_width", "speed", "yaw_rate"):
            assert np.isnan(values[~result.valid]).all()


@pytest.mark.parametrize("origin", [0.0, 3.3, 1e5 + 0.7, 1.7e9])
def test_samples_at_the_multiples_keep_their_bits(origin):
    rng = np.random.default_rng(0)
    t = origin + np.arange(200) / 10.0
    columns = {name: rng.normal(5.0, 1.0, 200) for name in ("lane_offset", "lane_width", "speed", "yaw_rate")}
    sparse = recording(t, **columns, turn_signal=rng.integers(-1, 2, 200))
    keep = rng.random(200) > 0.1
    keep[0] = True
    sparse = sparse.take(keep)
    result = resample(sparse, 0.1, max_gap=0.11)
    for name in Recording.COLUMNS:
        if getattr(sparse, name) is not None and (name != "t" or origin < 1e6):
            np.testing.assert_array_equal(getattr(result, name), getattr(sparse, name))
    # a clock of years resolves 2e-7 s
    np.testing.assert_allclose(result.t, sparse.t, rtol=0.0, atol=5e-7)
    again = resample(result, 0.1, max_gap=0.11)
    np.testing.assert_array_equal(again.lane_offset, result.lane_offset)
    np.testing.assert_array_equal(again.t, result.t)


def test_one_sample_and_none():
    single = recording([5.0], lane_offset=np.array([0.4]))
    result = resample(single, 0.1)
    assert (result.t.tolist(), result.lane_offset.tolist(), result.valid.tolist()) == ([5.0], [0.4], [True])
    assert resample(single.take(slice(0, 0)), 0.1).samples == 0
    nothing = recording(np.arange(20) / 20.0, valid=np.zeros(20, bool), lane=np.ones(20, dtype=np.int64))
    result = resample(nothing, 0.1)
    assert not result.valid.any()
    assert result.samples in (10, 11)
    assert np.isnan(result.speed).all()
    same = resample(recording(np.full(5, 3.0), lane_offset=np.array([0.5, 0.1, 0.2, 0.4, 0.3])), 0.1)
    assert same.lane_offset.tolist() == [0.3]


def test_a_huge_gap_costs_nothing():
    t = np.concatenate([np.arange(50) / 10.0, 1e6 + np.arange(50) / 10.0, 1e12 + np.arange(50) / 10.0])
    tracemalloc.start()
    result = resample(recording(t), 0.01)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6
    np.testing.assert_array_equal(np.unique(np.round(result.t[result.t > 10.0] / 1e6)), [1.0, 1e6])


@pytest.mark.parametrize("t", [[0.0, 1e300], [-1e308, 1e308]])
def test_absurd_times_are_told(t):
    problem = f"from t = {t[0]} to {t[1]} s is too long for steps of 0.1 s"
    with refused("recording 'a'", RecordingError, problem=problem, hint=""):
        resample(recording(t), 0.1)


def test_absurd_numbers_are_no_part_of_a_median():
    offset = np.array([0.1, 1e12, 1.5e308, 0.2, 1.5e308])
    result = resample(recording([0.0, 0.01, 0.02, 0.1, 0.11], lane_offset=offset), 0.1)
    assert result.lane_offset.tolist() == [0.1, 0.2]
