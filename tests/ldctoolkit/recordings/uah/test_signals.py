"""Interpolation and slopes against sample-by-sample code."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.preparation import local_slope, merge_repeated, values_at
from ldctoolkit.recordings.uah_driveset import READER

# times on a fine binary raster: sums and differences are exact, so no comparison hangs on rounding
TIMES = st.lists(st.integers(0, 400), min_size=0, max_size=30, unique=True).map(lambda ks: np.sort(ks) / 32.0)
SETTINGS = examples(150)


def value_by_hand(at, t, values, longest, beyond):
    for i in range(len(t) - 1):
        if t[i] <= at <= t[i + 1] and t[i + 1] - t[i] <= longest:
            share = (at - t[i]) / (t[i + 1] - t[i])
            return values[i] + share * (values[i + 1] - values[i])
    near = [(abs(at - t[i]), i) for i in range(len(t)) if abs(at - t[i]) <= beyond]
    return values[min(near)[1]] if near else math.nan


@SETTINGS
@given(TIMES, st.lists(st.integers(-40, 480).map(lambda k: k / 32.0), max_size=20), st.integers(0, 2**32 - 1))
def test_values_at(t, at, seed):
    values = np.random.default_rng(seed).normal(size=t.size)
    found = values_at(np.array(at), t, values, longest=1.5, beyond=0.25)
    expected = [value_by_hand(one, t, values, 1.5, 0.25) for one in at]
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@SETTINGS
@given(TIMES, st.integers(0, 2**32 - 1))
def test_local_slope(t, seed):
    values = np.random.default_rng(seed).normal(size=t.size)
    found = local_slope(t, values, half=0.25, longest=0.5)
    for i in range(t.size):
        window = [i]
        for step in (1, -1):
            j = i + step
            while 0 <= j < t.size and abs(t[j] - t[j - step]) <= 0.5 and abs(t[j] - t[i]) <= 0.25:
                window.append(j)
                j += step
        if len(window) == 1:
            assert math.isnan(found[i])
        else:
            assert found[i] == pytest.approx(np.polyfit(t[window] - t[i], values[window], 1)[0], rel=1e-9, abs=1e-9)


def test_absurd_clocks():
    # 200,000 samples in one window: too near each other for a slope, and the work is bounded
    t = np.arange(200_000) * 2.0**-21
    assert np.isnan(local_slope(t, t, half=0.25, longest=0.5)).all()
    assert np.isnan(local_slope(np.arange(4) * 1e8, np.ones(4), half=0.25, longest=0.5)).all()
    assert local_slope(np.empty(0), np.empty(0), half=0.25, longest=0.5).shape == (0,)


@SETTINGS
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(-9, 9)), max_size=20))
def test_merge_repeated(pairs):
    pairs.sort(key=lambda pair: pair[0])
    t, values = (np.array([pair[i] for pair in pairs], dtype=float) for i in (0, 1))
    found = merge_repeated(t, values)
    times = sorted(set(t.tolist()))
    assert found[0].tolist() == times
    assert found[1].tolist() == pytest.approx([np.mean(values[t == one]) for one in times])


def read(folder):
    (part,) = READER.open([folder]).parts
    (recording,) = part.read()
    return recording


def test_the_recording(made, truth, tmp_path):
    """Units and signs of a whole trip."""
    trip = made()
    one = read(trip.write(tmp_path))
    np.testing.assert_array_equal(one.t, trip.lane[:, 0])
    np.testing.assert_array_equal(one.valid, trip.lane[:, 4] == 2.0)
    good = one.valid
    assert one.lane_offset[good].tolist() == (0.0 - trip.lane[good, 1]).tolist()
    assert one.lane_width[good].tolist() == trip.lane[good, 3].tolist()
    assert np.isnan(one.lane_offset[~good]).all()
    np.testing.assert_allclose(one.speed, truth["speed"](one.t), atol=0.01)
    np.testing.assert_allclose(one.yaw_rate, truth["curvature"](one.t) * truth["speed"](one.t), atol=1e-3)
    # no course before 14 s; then it turns as the vehicle does, without jumps
    known = np.isfinite(one.heading)
    assert not known[one.t < 13.3].any()
    assert known[one.t > 15.0].all()
    turned = one.heading[known] - truth["yaw"](one.t[known])
    assert np.ptp(turned) < 0.03  # a course holds for half a second before the first one
    assert (one.curvature, one.lane, one.turn_signal) == (None, None, None)
    assert one.notes == ()


def test_yaw_in_degrees(made, tmp_path):
    trip = made()
    one = read(trip.write(tmp_path / "radians"))
    trip.accelerometers[:, 10] = np.degrees(trip.accelerometers[:, 10])
    other = read(trip.write(tmp_path / "degrees"))
    np.testing.assert_allclose(other.yaw_rate, one.yaw_rate, atol=1e-6)
    assert other.notes == ("the yaw angle in RAW_ACCELEROMETERS.txt goes beyond pi and is taken as degrees",)


def test_speed_and_yaw_rate_end_at_gaps(made, tmp_path):
    trip = made()
    trip.gps = trip.gps[(trip.gps[:, 0] < 60.0) | (trip.gps[:, 0] > 68.0)]
    trip.gps[(trip.gps[:, 0] > 30.0) & (trip.gps[:, 0] < 34.0), 1] = -3.6  # the phone's word for no speed
    trip.accelerometers = trip.accelerometers[np.abs(trip.accelerometers[:, 0] - 64.0) > 2.0]
    (part,) = READER.open([trip.write(tmp_path)]).parts
    problem, one = part.read()
    assert "a speed" in str(problem)
    t = one.t
    for missing, around in (
        ((t > 60.5) & (t < 67.0), (t < 59.0) | (t > 69.0)),
        ((t > 30.6) & (t < 33.4), (t < 29.0) | (t > 35.0)),
    ):
        assert np.isnan(one.speed[missing]).all()
        near = around & (np.abs(t - np.mean(t[missing])) < 9.0)
        assert np.isfinite(one.speed[near]).all()
    missing = (t > 62.3) & (t < 65.7)  # and the course is missing as well
    assert np.isnan(one.yaw_rate[missing]).all()
    assert np.isfinite(one.yaw_rate[(t < 61.5) | (t > 66.5)]).all()


def test_repeated_and_missing_times_in_side_files(made, truth, tmp_path):
    trip = made()
    trip.gps = np.repeat(trip.gps, 2, axis=0)
    trip.accelerometers = np.repeat(trip.accelerometers, 3, axis=0)
    trip.accelerometers = trip.accelerometers[np.arange(len(trip.accelerometers)) % 7 != 3]
    one = read(trip.write(tmp_path))
    np.testing.assert_allclose(one.speed, truth["speed"](one.t), atol=0.01)
    np.testing.assert_allclose(one.yaw_rate, truth["curvature"](one.t) * truth["speed"](one.t), atol=2e-3)
