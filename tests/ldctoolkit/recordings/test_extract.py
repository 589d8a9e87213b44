"""Hand-made recordings: each rule of the extraction, and each reason for refusing."""

from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.recordings import Extraction, Recording, extract_departures, open_recordings


def extract(*recordings: Recording, **criteria: Any) -> Extraction:
    found = extract_departures(recordings, **({"vehicle_width": 1.8} | criteria))
    assert found.candidates == len(found.departures) + sum(count for _, count in found.refused.items())
    return found


def reasons(found: Extraction) -> dict[str, int]:
    return {reason: count for reason, count in found.refused.items() if count}


def test_a_departure_by_hand():
    found = extract(drive(curvature=1e-3 + 1e-4 * T, speed=25.0 + 0.2 * (T - 5.0)))
    d = found.departures
    assert len(d) == 1
    assert (reasons(found), d.recording.tolist(), d.side.tolist()) == ({}, ["a"], [LEFT])
    assert d.samples.tolist() == [19]
    # the chord between two samples of a parabola differs from it by at most y'' h^2/8 = 0.00083 m, which the slope
    # at the crossing, 0.63 m/s, turns into 1.3 ms
    np.testing.assert_allclose(d.start_time, 4.05, atol=1.4e-3)
    np.testing.assert_allclose(d.T, 1.9, atol=2.8e-3)
    np.testing.assert_allclose(d.d_y, 0.3, atol=1e-3)
    np.testing.assert_allclose(d.v_mean, 25.0, atol=1e-3)
    np.testing.assert_allclose(d.a_mean, 0.2, atol=1e-9)
    # a straight line survives interpolation and regression exactly
    np.testing.assert_allclose(d.c_0, 1e-3 + 1e-4 * d.start_time, atol=1e-15)
    np.testing.assert_allclose(d.dc, 1e-4 * d.T, atol=1e-15)
    assert (found.hours, found.warnings) == (pytest.approx(9.9 / 3600.0), ())


def test_regressions_equal_numpy_on_the_recorded_samples():
    rng = np.random.default_rng(3)
    noise = 1e-4 * rng.standard_normal(100)
    speed = 25.0 + 0.3 * rng.standard_normal(100)
    d = extract(drive(lane_offset=-OFFSET, curvature=noise, speed=speed)).departures
    tau = T - d.start_time[0]
    inside = (tau > 0.0) & (tau < d.T[0])
    tau = tau[inside]
    assert (d.side.tolist(), d.samples[0]) == ([RIGHT], inside.sum())
    slope, c_0 = np.polyfit(tau, -noise[inside], 1)  # outward: a right departure sees its curvature mirrored
    np.testing.assert_allclose([d.c_0[0], d.dc[0]], [c_0, slope * d.T[0]], rtol=1e-9, atol=1e-18)
    a_mean = np.polyfit(tau, speed[inside], 1)[0]
    np.testing.assert_allclose(d.a_mean[0], a_mean, rtol=1e-9)


def with_value(values: Any, rows: Any, value: Any) -> np.ndarray:
    changed = np.array(np.broadcast_to(values, 100), dtype=float)
    changed[rows] = value
    return changed


REFUSALS: list[tuple[str, dict[str, Any], dict[str, Any], int]] = [
    ("too_short", {}, {"min_duration": 2.0}, 1),
    ("too_long", {}, {"max_duration": 1.8}, 1),
    ("slow", {"speed": 4.9}, {}, 1),
    ("slow", {"speed": with_value(25.0, 50, 0.0)}, {}, 1),  # stops in between
    ("too_few_samples", {}, {"min_duration": 0.0, "vehicle_width": 1.202}, 1),
    ("intended", {"turn_signal": with_value(0, slice(48, 52), 1)}, {}, 1),
    ("intended", {"turn_signal": with_value(0, slice(30, 41), 1)}, {}, 1),  # set when crossing out
    ("implausible", {"speed": 60.0 - 9.82 * (T - 3.0)}, {}, 1),
    ("implausible", {"speed": 5.0 + 9.82 * T}, {}, 1),
    ("implausible", {"curvature": 9.82 / 25.0**2}, {}, 1),
    ("implausible", {"curvature": -9.82 / 25.0**2}, {}, 1),
    ("implausible", {"lane_width": with_value(3.6, slice(41, 60), 1.75), "lane_offset": 0.3}, {}, 1),
    # every other reason is stronger
    ("intended", {"speed": 5.0 + 9.82 * T, "turn_signal": with_value(0, slice(48, 52), 1)}, {}, 1),
    ("lane_change", {"lane": with_value(1, slice(50, None), 2)}, {}, 1),
    ("invalid", {"valid": with_value(1, 50, 0)}, {}, 1),
    ("invalid", {"valid": with_value(1, 40, 0)}, {}, 1),  # the sample before the crossing
    ("invalid", {"lane_width": with_value(3.6, 50, np.nan)}, {}, 1),
    ("invalid", {"lane_width": with_value(3.6, 50, -3.6)}, {}, 1),
    ("invalid", {"speed": with_value(25.0, 50, np.inf)}, {}, 1),
    ("invalid", {"curvature": with_value(0.0, 50, np.nan)}, {}, 1),
    ("invalid", {"valid": with_value(1, slice(None, 45), 0)}, {}, 1),  # nothing usable before: not the record's start
    ("invalid", {"valid": with_value(1, slice(55, None), 0)}, {}, 1),
    ("gap", {"t": np.where(np.arange(100) > 50, T + 0.2, T)}, {}, 1),
    ("gap", {"t": np.where(np.arange(100) > 50, T + 0.02, T)}, {"max_gap": 0.11}, 1),
    ("jump", {"lane_offset": np.where(np.arange(100) > 50, OFFSET - 0.7, OFFSET)}, {}, 1),
    ("jump", {"lane_offset": np.where(np.arange(100) > 50, OFFSET - 0.1, OFFSET)}, {"max_jump": 0.05}, 1),
    # strongest reason first: an invalid sample, a gap and a lane change in one candidate
    (
        "lane_change",
        {"lane": with_value(1, slice(52, None), 2), "valid": with_value(1, 50, 0), "t": T + (T > 4.75) * 1.0},
        {},
        1,
    ),
]


@pytest.mark.parametrize(("reason", "columns", "criteria", "count"), REFUSALS)
@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_refused_with_one_reason(reason, columns, criteria, count, side):
    changed = {"lane_offset": OFFSET} | columns
    changed["lane_offset"] = side * changed["lane_offset"]
    if "turn_signal" in changed:
        changed["turn_signal"] = side * changed["turn_signal"]
    found = extract(drive(**changed), **criteria)
    assert len(found.departures) == 0
    assert reasons(found) == {reason: count}


@pytest.mark.parametrize("a", [-9.8, 9.8])
def test_hard_braking_is_a_departure_all_the_same(a):
    found = extract(drive(lane_offset=OFFSET, speed=60.0 + a * (T - 5.0)))
    np.testing.assert_allclose(found.departures.a_mean, [a], rtol=1e-9)


def test_a_signal_the_other_way_or_after_is_no_reason():
    assert len(extract(drive(turn_signal=-1)).departures) == 1
    assert len(extract(drive(turn_signal=with_value(0, slice(60, None), 1))).departures) == 1


def test_without_curvature_it_is_zero_and_says_so():
    found = extract(drive(curvature=None, lane=None))
    assert (found.departures.c_0.tolist(), found.provenance.curvature) == ([0.0], "none")
    assert [warning.split(":")[0] for warning in found.warnings] == [
        "no column 'curvature' or 'yaw_rate'",
        "no column 'lane'",
    ]


def test_a_table_without_usable_samples():
    found = extract(drive(valid=0))
    assert (found.candidates, found.hours, found.provenance.invalid_samples) == (0, 0.0, 100)


def test_real_recordings(ngsim_recordings):
    """Order of magnitude that the data's own description tells: about 250, median 1.4 s, median peak 0.16 m."""
    recordings = open_recordings(ngsim_recordings)
    found = extract_departures(recordings, vehicle_width=1.8)
    assert 230 <= len(found.departures) <= 270
    assert 1.3 <= np.median(found.departures.T) <= 1.6
    assert 0.14 <= np.median(found.departures.d_y) <= 0.18
    assert (found.recordings, found.provenance.samples) == (370, 214_267)
    assert found.hours == pytest.approx(5.95, abs=0.02)
    # 412 lane changes; some of them within one manoeuvre, or with the edge inside on both of their samples
    assert 330 <= found.refused.lane_change <= 412
    assert found.candidates == len(found.departures) + found.refused.total
    # two events of half a second with -24 and -19 m/s^2, the noise of five or six speeds
    assert found.refused.implausible == 2
    assert np.abs(found.departures.a_mean).max() <= 9.81
    assert found.warnings == ("the lane is straight in nearly all samples: c_0 and dc tell nothing",)
    assert found.provenance.sources == recordings.source.files
