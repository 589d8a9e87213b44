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
from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import InputError, RecordingError
from ldctoolkit.recordings import Preparation, Recording, extract_departures, read_departures, write_departures
from ldctoolkit.recordings.find_departures import SPEED_FLOOR, curvature_from_yaw_rate
from ldctoolkit.recordings.preparation import FILLED, NONE, prepare, resample, rising_rows, with_yaw_rate


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
    ones = np.ones(N)
    one = Recording(
        "a", T_YAW_FROM_HEADING, 0.9 + beyond, 3.6 * ones, 25.0 * ones, ones > 0, yaw_rate=0.025 * ones,
        heading=3.0 + 0.025 * T_YAW_FROM_HEADING - 2.0 * np.pi * (T_YAW_FROM_HEADING > 5.0),
    )  # fmt: skip
    return dataclasses.replace(one, **changes)  # type: ignore[arg-type]


def test_a_whole_yaw_rate_stays() -> None:
    one = bend()
    assert with_yaw_rate(one) is one
    none = bend(yaw_rate=None)
    assert with_yaw_rate(none) is none


def test_a_hole_is_filled_through_a_turn_of_the_heading() -> None:
    rate = np.full(N, 0.03)
    rate[40:160] = np.nan
    filled = with_yaw_rate(bend(yaw_rate=rate))
    assert (filled.yaw_rate[:40] == 0.03).all()
    assert (filled.yaw_rate[160:] == 0.03).all()
    np.testing.assert_allclose(filled.yaw_rate[40:160], 0.025, atol=1e-9)  # rounding of the slope
    assert np.flatnonzero(~filled.yaw_rate_measured).tolist() == list(range(40, 160))
    # what a reader has marked stays marked
    own = with_yaw_rate(bend(yaw_rate=rate, yaw_rate_measured=T_YAW_FROM_HEADING > 1.0))
    assert np.flatnonzero(~own.yaw_rate_measured).tolist() == [*range(11), *range(40, 160)]
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
    one = with_yaw_rate(bend(yaw_rate=nothing, heading=nothing))
    assert one.yaw_rate is None
    assert one.yaw_rate_measured is None
    assert one.notes == (NONE,)
    # nor is the speed known: the yaw rate is the least of its troubles
    lost = with_yaw_rate(bend(yaw_rate=nothing, heading=None, speed=nothing))
    assert lost.notes == ()
    assert lost.yaw_rate is not None


def test_a_departure_is_not_lost_for_its_yaw_rate() -> None:
    rate = np.full(N, 0.025)
    rate[100:200] = np.nan
    found = extract_departures([bend(yaw_rate=rate)], vehicle_width=1.8, preparation=Preparation(0.1))
    assert found.departures.n == 1
    np.testing.assert_allclose(found.departures.c_0, 1e-3, rtol=1e-6)


def estimate(yaw_rate, speed, usable=None, first=None, half_width=5):
    n = len(speed)
    usable = np.ones(n, bool) if usable is None else usable
    starts = np.zeros(n, bool)
    starts[0] = True
    if first is not None:
        starts[first] = True
    return curvature_from_yaw_rate(yaw_rate, speed, usable, starts, np.full(n, half_width))


def test_equals_least_squares_in_every_window():
    rng = np.random.default_rng(1)
    v, r = rng.uniform(5, 30, 80), rng.normal(0, 0.05, 80)
    usable = rng.random(80) > 0.1
    c = estimate(r, v, usable, first=40)
    stretch = np.cumsum((np.arange(80) == 40) | ~usable)
    for i in range(80):
        if not usable[i]:
            assert np.isnan(c[i])
            continue
        same = np.flatnonzero(usable & (stretch == stretch[i]))
        here = int(np.flatnonzero(same == i)[0])
        window = same[max(here - 5, 0) : here + 6]
        expected = np.linalg.lstsq(v[window, None], r[window], rcond=None)[0][0]
        np.testing.assert_allclose(c[i], expected, rtol=1e-10)


def test_nothing_crosses_a_gap_or_an_invalid_sample():
    v = np.full(40, 20.0)
    r = np.where(np.arange(40) < 20, 0.02, -0.04)
    np.testing.assert_allclose(estimate(r, v, first=20), r / v, rtol=1e-12)
    usable = np.arange(40) != 20
    r[20] = np.nan
    np.testing.assert_allclose(estimate(r, v, usable), r / v, rtol=1e-12)


def test_low_speed_fades_out():
    # half a degree a second of sensor noise, at a speed of nearly nothing
    c = estimate(np.full(20, 0.01), np.full(20, 1e-3))
    assert np.abs(c).max() <= 0.01 * 1e-3 / SPEED_FLOOR**2 * (1.0 + 1e-12)
    assert estimate(np.full(20, 0.01), np.zeros(20)).tolist() == [0.0] * 20


def test_a_recording_with_yaw_rate():
    t = np.arange(100) * 0.1
    true = 1e-3 + 2e-4 * (t - 5.0)
    speed = 25.0 + 0.1 * (t - 5.0)
    straight = extract_departures([drive(curvature=true, speed=speed)], vehicle_width=1.8)
    found = extract_departures([drive(curvature=None, yaw_rate=true * speed, speed=speed)], vehicle_width=1.8)
    assert (found.provenance.curvature, found.warnings) == ("yaw_rate", ())
    # the window averages a straight line without bias but for its weights v^2: 1 % of speed over half a window
    np.testing.assert_allclose(found.departures.c_0, straight.departures.c_0, atol=1e-6)
    np.testing.assert_allclose(found.departures.dc, straight.departures.dc, atol=1e-6)


def scale_of(found: Any) -> list[float]:
    return next((column.values.tolist() for column in found.departures.extra if column.name == "lane_scale"), [])


@pytest.mark.parametrize(("jump", "max_jump", "bridged"), [
    (0.5, 0.6, True), (0.7, 0.6, False), (0.7, 0.8, True), (0.5, 0.4, False), (0.3, 0.4, True),
])  # fmt: skip
def test_the_criterions_jump_is_the_preparations(jump, max_jump, bridged):
    """A sample is missing where the offset steps up, beyond the line."""
    offset = np.interp(T, [3.0, 4.9, 5.1, 8.0], [0.2, 1.2, 1.2 + jump, 0.2])
    one = drive(lane_offset=offset).take(np.arange(100) != 50)
    prepared = prepare(one, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.samples == 99 + bridged
    if bridged:
        assert prepared.lane_offset[50] == pytest.approx(1.2 + 0.5 * jump)
    found = extract_departures([one], vehicle_width=1.8, max_jump=max_jump, preparation=Preparation(step=0.1))
    assert found.departures.n == bridged
    assert found.refused.gap + found.refused.jump == found.refused.total == (not bridged)


@pytest.mark.parametrize("max_jump", [0.6, 2.0])
def test_two_middle_offsets_a_jump_apart(max_jump):
    """Their mean lies where the vehicle never was; it is taken only if the criterion sees no jump between them."""
    t = np.array([0.0, 0.06, 0.1, 0.14, 0.2])
    full = np.full(5, 25.0)
    one = Recording("a", t, np.array([0.0, 0, 0, 1, 1]), full - 21.4, full, full > 0.0).take(np.array([0, 1, 3, 4]))
    prepared = prepare(one, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.lane_offset.tolist() == [0.0, 0.5 if max_jump == 2.0 else 0.0, 1.0]


@pytest.mark.parametrize("seen", [2.5, 3.5, 4.2])
def test_the_nominal_width(seen, tmp_path):
    """A camera that sees everything `seen`/3.5 times as large as it is."""
    true = drive(lane_offset=OFFSET - 0.05, lane_width=np.full(100, 3.5))
    factor = 3.5 / seen
    wrong = dataclasses.replace(true, lane_offset=true.lane_offset / factor, lane_width=true.lane_width / factor)
    preparation = Preparation(nominal_lane_width=3.5)
    prepared = prepare(wrong, preparation)
    assert (prepared.lane_scale, np.median(prepared.lane_width)) == (pytest.approx(factor), pytest.approx(3.5))
    np.testing.assert_allclose(prepared.lane_offset, true.lane_offset)

    right = extract_departures([true], vehicle_width=1.8)
    found = extract_departures([wrong], vehicle_width=1.8, preparation=preparation)
    assert len(right.departures) == len(found.departures) == 1
    np.testing.assert_allclose(found.departures.matrix(), right.departures.matrix(), rtol=1e-9, atol=1e-12)
    # told even where the factor is 1: it was asked for; never told where it was not
    assert scale_of(found) == pytest.approx([factor])
    assert scale_of(right) == []
    write_departures(tmp_path / "d.parquet", found.departures, found.provenance)
    departures, provenance = read_departures(tmp_path / "d.parquet")
    assert (provenance.preparation, departures.extra[-1].name) == (preparation, "lane_scale")
    assert departures.extra[-1].values.tolist() == scale_of(found)


def test_the_median_is_that_of_usable_samples():
    width = np.full(100, 2.8)
    width[:80] = 9.0
    valid = np.arange(100) >= 30
    speed = np.full(100, 25.0)
    speed[30:80] = np.nan
    assert prepare(
        drive(lane_width=width, valid=valid, speed=speed), Preparation(nominal_lane_width=3.5)
    ).lane_scale == (pytest.approx(1.25))
    nothing = drive(valid=np.zeros(100, bool))
    assert prepare(nothing, Preparation(nominal_lane_width=3.5)) is nothing
    # a reader that has scaled already
    assert prepare(drive(lane_scale=2.0), Preparation(nominal_lane_width=3.6)).lane_scale == pytest.approx(2.0)


def test_the_yaw_rate_factor():
    yaw_rate = np.full(100, 0.02)
    one = drive(curvature=None, yaw_rate=-yaw_rate)
    found = extract_departures([one], vehicle_width=1.8, preparation=Preparation(yaw_rate_factor=-1.0))
    np.testing.assert_allclose(found.departures.c_0, 0.02 / 25.0)
    measured = drive(curvature=np.full(100, 1e-3))
    assert prepare(measured, Preparation(yaw_rate_factor=-1.0)) == measured


def test_the_gap_of_the_criteria_rules_resampled_recordings():
    """A stricter one bridges less; a wider one lets a hole pass, but makes nothing up in it."""
    t = np.arange(200) * 0.05
    offset = 0.9 + np.clip(0.3 * (1.0 - ((t - 5.0) / 0.95) ** 2), -0.4, None)
    columns = {"lane_offset": offset, "lane_width": np.full(200, 3.6), "speed": np.full(200, 25.0)}
    one = Recording("a", t, valid=np.ones(200, bool), curvature=np.zeros(200), **columns)

    def found(hole: float, **criteria: Any) -> tuple[int, dict[str, int]]:
        holed = one.take(np.abs(t - 5.0) >= 0.5 * hole - 1e-9)
        result = extract_departures([holed], vehicle_width=1.8, preparation=Preparation(0.1), **criteria)
        samples = int(result.departures.samples[0]) if len(result.departures) else 0
        return samples, {reason: count for reason, count in result.refused.items() if count}

    assert found(0.2) == (19, {})
    assert found(0.2, max_gap=0.15) == (0, {"gap": 1})
    assert found(0.6) == (0, {"gap": 1})
    assert found(0.6, max_gap=0.7) == (14, {})


def test_a_recording_that_cannot_be_prepared_is_a_problem():
    endless = drive("endless", t=np.linspace(0.0, 1e300, 100), source="x.csv")
    found = extract_departures([endless, drive("b")], vehicle_width=1.8, preparation=Preparation(0.1))
    assert found.departures.recording.tolist() == ["b"]
    (problem,) = found.problems
    assert str(problem).startswith("x.csv: recording 'endless': from t = 0.0 to 1e+300 s; too long")
    assert found.provenance.problems == (str(problem),)


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


def one_by_one(given: Recording, step: float, max_gap: float) -> list[dict[str, Any]]:
    """The docstring of `resample`, in plain loops over every multiple of the step."""

    def known(value: float) -> bool:
        return math.isfinite(value) and abs(value) < 1e9

    t = [float(time) - float(given.t[0]) for time in given.t]
    numbers = [name for name in ("lane_offset", "lane_width", "speed", "yaw_rate") if getattr(given, name) is not None]
    good = [
        i
        for i in range(len(t))
        if given.valid[i] and all(known(getattr(given, name)[i]) for name in numbers) and given.lane_width[i] > 0
    ]
    out = []
    for k in range(round(t[-1] / step) + 2):
        centre = k * step
        if centre > t[-1] + 0.5 * step:
            break
        reach = (0.5 + EPS) * step
        window = [i for i in good if centre - reach <= t[i] < centre + reach or t[i] == centre + reach]
        row: dict[str, Any] = {"t": float(given.t[0]) + centre, "valid": True}
        nearest = min(good, key=lambda i: abs(t[i] - centre), default=None)
        if given.lane is not None and window:
            # only the neighbours in the nearest sample's lane, without another one in between
            place = good.index(nearest)
            low = high = place
            while low > 0 and given.lane[good[low - 1]] == given.lane[nearest]:
                low -= 1
            while high < len(good) - 1 and given.lane[good[high + 1]] == given.lane[nearest]:
                high += 1
            window = [i for i in window if i in good[low : high + 1]]
        before = [i for i in good if t[i] < centre - reach]
        after = [i for i in good if t[i] > centre + reach]
        if window:
            for name in numbers:
                values = sorted(float(getattr(given, name)[i]) for i in window)
                row[name] = statistics.median(values)
                a, b = values[(len(values) - 1) // 2], values[len(values) // 2]
                if name == "lane_offset" and b - a > 0.6:
                    near = float(given.lane_offset[nearest])
                    row[name] = a if abs(a - near) <= abs(b - near) else b
        elif (
            before
            and after
            and t[after[0]] - t[before[-1]] <= max_gap * (1.0 + EPS)
            and abs(given.lane_offset[after[0]] - given.lane_offset[before[-1]]) <= 0.6
            and (given.lane is None or given.lane[after[0]] == given.lane[before[-1]])
        ):
            i, j = before[-1], after[0]
            for name in numbers:
                row[name] = np.interp(centre, [t[i], t[j]], [getattr(given, name)[i], getattr(given, name)[j]])
        elif any(abs(time - centre) <= reach for time in t):
            row["valid"] = False
        else:
            continue
        if row["valid"]:
            for name in ("lane", "turn_signal", "heading"):
                if getattr(given, name) is not None:
                    row[name] = getattr(given, name)[nearest]
        out.append(row)
    return out


@SETTINGS
@given(
    seed=st.integers(0, 2**32 - 1),
    step=st.sampled_from([0.05, 0.1, 0.125, 0.3, 1.0]),
    max_gap=st.sampled_from([0.03, 0.25, 1.0]),
)
def test_equals_the_walk_through_every_window(seed, step, max_gap):
    made = random_recording(seed, step)
    rows = one_by_one(made, step, max_gap)
    result = resample(made, step, max_gap)
    assert result.valid.tolist() == [row["valid"] for row in rows]
    np.testing.assert_allclose(result.t, [row["t"] for row in rows], rtol=1e-12)
    for name in ("lane_offset", "lane_width", "speed", "yaw_rate", "lane", "turn_signal", "heading"):
        values = getattr(result, name)
        assert (values is None) == (getattr(made, name) is None)
        if values is None:
            continue
        wanted = [row[name] for row in rows if row["valid"]]
        np.testing.assert_allclose(values[result.valid], wanted, rtol=1e-9, atol=1e-12)
        if name in ("lane_offset", "lane_width", "speed", "yaw_rate"):
            assert np.isnan(values[~result.valid]).all()


@pytest.mark.parametrize("origin", [0.0, 3.3, 1e5 + 0.7, 1.7e9])
def test_samples_at_the_multiples_keep_their_bits(origin):
    rng = np.random.default_rng(0)
    t = origin + np.arange(200) / 10.0
    columns = {name: rng.normal(5.0, 1.0, 200) for name in ("lane_offset", "lane_width", "speed", "yaw_rate")}
    one = recording(t, **columns, turn_signal=rng.integers(-1, 2, 200))
    kept = rng.random(200) > 0.1
    kept[0] = True
    one = one.take(kept)
    result = resample(one, 0.1, max_gap=0.11)
    for name in Recording.COLUMNS:
        if getattr(one, name) is not None and (name != "t" or origin < 1e6):
            np.testing.assert_array_equal(getattr(result, name), getattr(one, name))
    # a clock of years resolves 2e-7 s
    np.testing.assert_allclose(result.t, one.t, rtol=0.0, atol=5e-7)
    again = resample(result, 0.1, max_gap=0.11)
    np.testing.assert_array_equal(again.lane_offset, result.lane_offset)
    np.testing.assert_array_equal(again.t, result.t)


def test_one_sample_and_none():
    one = recording([5.0], lane_offset=np.array([0.4]))
    result = resample(one, 0.1)
    assert (result.t.tolist(), result.lane_offset.tolist(), result.valid.tolist()) == ([5.0], [0.4], [True])
    assert resample(one.take(slice(0, 0)), 0.1).samples == 0
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
    with pytest.raises(RecordingError, match=r"recording 'a': from t = .* too long to be brought to steps of 0\.1 s"):
        resample(recording(t), 0.1)


def test_absurd_numbers_are_no_part_of_a_median():
    offset = np.array([0.1, 1e12, 1.5e308, 0.2, 1.5e308])
    result = resample(recording([0.0, 0.01, 0.02, 0.1, 0.11], lane_offset=offset), 0.1)
    assert result.lane_offset.tolist() == [0.1, 0.2]


@pytest.mark.parametrize(
    ("step", "max_gap"), [(0.0, 0.25), (-0.1, 0.25), (math.nan, 0.25), (0.1, 0.0), (0.1, math.inf)]
)
def test_steps_that_are_refused(step, max_gap):
    with pytest.raises(InputError, match="allowed: more than 0, finite"):
        resample(recording([0.0, 0.1]), step, max_gap)
