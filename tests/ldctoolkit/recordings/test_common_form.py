"""The common form of a recording: times, yaw rate, curvature, scale."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Preparation, Recording, extract_departures, read_departures, write_departures
from ldctoolkit.recordings.find_departures import SPEED_FLOOR, curvature_from_yaw_rate
from ldctoolkit.recordings.preparation import FILLED, NONE, prepare, rising_rows, with_yaw_rate


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


def test_absurd_numbers_do_no_harm():
    """Not even a floating point warning, which the tests turn into errors."""
    offset, width = OFFSET.copy(), np.full(100, 3.6)
    offset[3], width[4], width[5] = 1e308, 1e308, math.inf
    yaw_rate = np.full(100, 1e308)
    one = drive(lane_offset=offset, lane_width=width, curvature=None, yaw_rate=yaw_rate, heading=yaw_rate)
    with np.errstate(all="raise", under="ignore"):
        for preparation in (Preparation(0.1), Preparation(0.05, 0.25, 6.0, 1e300), Preparation(None, 0.25, 2.0, -5.0)):
            # without a yaw rate that anybody can believe, the lane counts as straight
            found = extract_departures([one], preparation=preparation)
            assert np.isfinite(found.departures.matrix()).all()
            assert found.warnings[-1] == f"{NONE}: 1 of 1 recordings"


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
