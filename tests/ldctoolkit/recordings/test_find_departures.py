"""Departures in recordings: crossings, lane changes, criteria."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.departures import LEFT, RIGHT, Plausibility
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Criteria, Extraction, Preparation, Recording, extract_departures, open_recordings

NO_LIMITS = Plausibility(y_rate=np.inf, y_acceleration=np.inf, a_y=np.inf)


def extract(*recordings: Recording, **criteria: Any) -> Extraction:
    extraction = extract_departures(recordings, **({"vehicle_width": 1.8, "force": True} | criteria))
    assert extraction.candidates == len(extraction.departures) + sum(count for _, count in extraction.refused.items())
    return extraction


def reasons(extraction: Extraction) -> dict[str, int]:
    return {reason: count for reason, count in extraction.refused.items() if count}


def test_a_departure_by_hand():
    extraction = extract(drive(curvature=1e-3 + 1e-4 * T, speed=25.0 + 0.2 * (T - 5.0)))
    d = extraction.departures
    assert len(d) == 1
    assert (reasons(extraction), d.recording.tolist(), d.side.tolist()) == ({}, ["a"], [LEFT])
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
    assert (extraction.hours, extraction.warnings) == (pytest.approx(9.9 / 3600.0), ())


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


REFUSALS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("slow", {"speed": 4.9}, {}),
    ("slow", {"speed": with_value(25.0, slice(49, 52), 0.0)}, {}),  # stops in between
    ("too_few_samples", {}, {"min_duration": 0.0, "vehicle_width": 1.202}),
    ("intended", {"turn_signal": with_value(0, slice(48, 52), 1)}, {}),
    ("intended", {"turn_signal": with_value(0, slice(30, 41), 1)}, {}),  # set when crossing out
    ("implausible", {"speed": 60.0 - 9.82 * (T - 3.0)}, {}),
    ("implausible", {"speed": 5.0 + 9.82 * T}, {}),
    ("implausible", {"curvature": 9.82 / 25.0**2}, {"plausibility": NO_LIMITS}),
    ("implausible", {"curvature": -9.82 / 25.0**2}, {"plausibility": NO_LIMITS}),
    ("implausible", {"curvature": 7.0 / 25.0**2}, {}),
    # every other reason is stronger
    ("intended", {"speed": 5.0 + 9.82 * T, "turn_signal": with_value(0, slice(48, 52), 1)}, {}),
    ("engaged", {"engaged": with_value(0, 50, 1), "turn_signal": with_value(0, slice(48, 52), 1)}, {}),
    ("slow", {"engaged": 1, "speed": 4.9}, {}),
    ("intended", {"engaged": 1, "turn_signal": with_value(0, slice(48, 52), 1)}, {"keep_engaged": True}),
    ("lane_change", {"lane": with_value(1, slice(50, None), 2)}, {}),
    ("invalid", {"valid": with_value(1, 50, 0)}, {}),
    ("invalid", {"valid": with_value(1, 40, 0)}, {}),  # the sample before the crossing
    ("invalid", {"lane_width": with_value(3.6, 50, np.nan)}, {}),
    ("invalid", {"lane_width": with_value(3.6, 50, -3.6)}, {}),
    ("invalid", {"speed": with_value(25.0, 50, np.inf)}, {}),
    ("invalid", {"lane_width": with_value(3.6, 50, 3.4)}, {"min_lane_width": 3.5}),
    ("invalid", {"lane_width": with_value(3.6, 50, 3.8)}, {"max_lane_width": 3.7}),
    ("invalid", {"curvature": with_value(0.0, 50, np.nan)}, {}),
    ("invalid", {"valid": with_value(1, slice(None, 45), 0)}, {}),  # nothing usable before: not the record's start
    ("invalid", {"valid": with_value(1, slice(55, None), 0)}, {}),
    ("gap", {"t": np.where(np.arange(100) > 50, T + 0.2, T)}, {}),
    ("gap", {"t": np.where(np.arange(100) > 50, T + 0.02, T)}, {"max_gap": 0.11}),
    ("jump", {"lane_offset": np.where(np.arange(100) > 50, OFFSET - 0.7, OFFSET)}, {}),
    ("jump", {"lane_offset": np.where(np.arange(100) > 50, OFFSET - 0.3, OFFSET)}, {"max_jump": 0.05}),
    # strongest reason first: an invalid sample, a gap and a lane change in one candidate
    ("lane_change", {"lane": 1 + (T > 5.15), "valid": with_value(1, 50, 0), "t": T + (T > 4.75)}, {}),
]


@pytest.mark.parametrize(("reason", "columns", "criteria"), REFUSALS)
@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_refused_with_one_reason(reason, columns, criteria, side):
    changed = {"lane_offset": OFFSET} | columns
    changed["lane_offset"] = side * changed["lane_offset"]
    if "turn_signal" in changed:
        changed["turn_signal"] = side * changed["turn_signal"]
    extraction = extract(drive(**changed), **criteria)
    assert len(extraction.departures) == 0
    assert reasons(extraction) == {reason: 1}


@pytest.mark.parametrize(
    ("limit", "asked"), [("y_rate", 4 * 0.3 / 1.9), ("y_acceleration", 8 * 0.3 / 1.9**2), ("a_y", 1 + 8 * 0.3 / 1.9**2)]
)
@pytest.mark.parametrize(("share", "expected"), [(1.01, {}), (0.99, {"implausible": 1})])
def test_a_path_that_asks_more_than_a_limit(limit, asked, share, expected):
    """0.3 m in 1.9 s at 25 m/s, in a bend of 1 m/s^2 away from the line."""
    limits = dataclasses.replace(NO_LIMITS, **{limit: share * asked})
    extraction = extract(drive(curvature=-1.0 / 25.0**2), plausibility=limits)
    assert (reasons(extraction), len(extraction.departures)) == (expected, 1 - len(expected))


@pytest.mark.parametrize("a", [-9.8, 9.8])
def test_hard_braking_is_a_departure_all_the_same(a):
    extraction = extract(drive(lane_offset=OFFSET, speed=60.0 + a * (T - 5.0)))
    np.testing.assert_allclose(extraction.departures.a_mean, [a], rtol=1e-9)


def test_a_signal_the_other_way_or_after_is_no_reason():
    assert len(extract(drive(turn_signal=-1)).departures) == 1
    assert len(extract(drive(turn_signal=with_value(0, slice(60, None), 1))).departures) == 1


@pytest.mark.parametrize(
    ("rows", "expected"),
    [(40, "engaged"), (60, "engaged"), (slice(39, 62), "engaged"), ([39, 61], ""), (slice(0, 40), "")],
)
def test_a_system_that_steers(rows, expected):
    """On the samples before and after the crossings, 4.0 and 6.0 s, too."""
    engaged = with_value(0, rows, 1)
    extraction, retained = extract(drive(engaged=engaged)), extract(drive(engaged=engaged), keep_engaged=True)
    assert reasons(extraction) == ({expected: 1} if expected else {})
    assert (len(extraction.departures), len(retained.departures)) == (not expected, 1)
    # hours and metres of the driver alone, in the steps between such samples; read is all
    driver = np.flatnonzero(engaged == 0)
    steps = 0.1 * np.count_nonzero(np.diff(driver) == 1)
    assert extraction.hours * 3600.0 == pytest.approx(steps)
    assert extraction.distance == pytest.approx(25.0 * steps)
    assert (retained.hours * 3600.0, retained.distance) == (pytest.approx(9.9), pytest.approx(247.5))
    assert [account.read_ns for account in extraction.accounts] == [9_900_000_000]
    assert extraction.provenance.invalid_samples == 0


def test_nothing_is_joined_across_a_cut():
    """Not even where the samples on both sides are next to each other in time: each side ends there."""
    recording = drive(cut=np.isin(np.arange(100), [0, 50]))
    extraction = extract(recording)
    assert (reasons(extraction), extraction.recordings, extraction.provenance.samples) == ({"cut_by_end": 2}, 1, 100)
    assert extraction.hours * 3600.0 == pytest.approx(9.8)
    # before the departure begins it does not matter, but for the step; a cut before the first sample is none
    assert len(extract(drive(cut=np.arange(100) == 40)).departures) == 1
    assert reasons(extract(drive(cut=np.arange(100) == 41))) == {"cut_by_end": 1}
    assert extract(drive(cut=np.arange(100) == 0)).hours * 3600.0 == pytest.approx(9.9)
    # with a step of time, too: nothing is made up in between
    sparse = recording.take(np.arange(100) != 49)
    for step in (0.1, 0.2):
        for cut, refused in ((sparse.cut, {"cut_by_end": 2}), (None, {})):
            extraction = extract(dataclasses.replace(sparse, cut=cut), preparation=Preparation(step=step))
            assert (reasons(extraction), extraction.problems, extraction.recordings) == (refused, (), 1)


def test_without_curvature_it_is_zero_and_says_so():
    extraction = extract(drive(curvature=None, lane=None))
    assert (extraction.departures.c_0.tolist(), extraction.provenance.curvature) == ([0.0], "none")
    assert [warning.split(":")[0] for warning in extraction.warnings] == [
        "no column 'curvature' or 'yaw_rate'",
        "no column 'lane'",
    ]


def test_a_table_without_usable_samples():
    for count in (1, 2, 3):
        extraction = extract(*(drive(f"r{i}", valid=0) for i in range(count)))
        assert (extraction.candidates, extraction.hours, extraction.provenance.invalid_samples) == (0, 0.0, 100 * count)
    assert len(extract(drive("a", valid=0), drive("b"), drive("c", valid=0)).departures) == 1


def test_real_recordings(ngsim_recordings):
    """Order of magnitude that the data's own description tells: about 250, median 1.4 s, median peak 0.16 m."""
    recordings = open_recordings(ngsim_recordings)
    extraction = extract_departures(recordings, vehicle_width=1.8)
    assert len(extraction.departures) == 247
    assert 1.3 <= np.median(extraction.departures.T) <= 1.6
    assert 0.14 <= np.median(extraction.departures.d_y) <= 0.18
    assert (extraction.recordings, extraction.provenance.samples) == (370, 214_267)
    assert extraction.hours == pytest.approx(5.95, abs=0.02)
    # 412 lane changes; some of them within one manoeuvre, or with the edge inside on both of their samples. Two events
    # of half a second with -24 and -19 m/s^2, the noise of five or six speeds, and four whose path asks too much: one
    # for 2.4 m/s at the line, all of them for more than 4 m/s^2
    refused_for_other_reasons = {
        "lane_change": 375,
        "jump": 2,
        "cut_by_end": 152,
        "too_short": 94,
        "too_long": 8,
        "slow": 19,
    }
    assert reasons(extraction) == refused_for_other_reasons | {"implausible": 6}
    assert extraction.candidates == len(extraction.departures) + extraction.refused.total
    assert np.abs(extraction.departures.a_mean).max() <= 9.81
    unlimited = extract_departures(recordings, vehicle_width=1.8, plausibility=NO_LIMITS)
    assert (len(unlimited.departures), reasons(unlimited)) == (251, refused_for_other_reasons | {"implausible": 2})
    assert extraction.warnings == ("the lane is straight in nearly all samples: c_0 and dc tell nothing",)
    assert extraction.provenance.sources == recordings.source.files


@pytest.mark.parametrize(
    ("t", "lost", "expected"),
    [
        # bursts of three frames every 0.25 s: of these steps 2.5 are no gap, that is two lost bursts are
        (np.repeat(0.25 * np.arange(40), 3) + np.tile([0.0, 1e-3, 2e-3], 40), 0.25, {}),
        (np.repeat(0.25 * np.arange(40), 3) + np.tile([0.0, 1e-3, 2e-3], 40), 0.5, {"gap": 1}),
        # 250 Hz: these are no bursts, for the time is made of them
        (0.004 * np.arange(2500), 0.2, {}),
        (0.004 * np.arange(2500), 0.3, {"gap": 1}),
    ],
)
def test_a_gap_where_frames_come_in_bursts(t, lost, expected):
    retained = t[(t < 4.999) | (t > 4.999 + lost - 1e-6)]
    extraction = extract(drive(t=retained, lane_offset=np.interp(retained, T, OFFSET)))
    assert (reasons(extraction), len(extraction.departures)) == (expected, 1 - len(expected))


STEP = 0.125


def fate(beyond: int, *, criteria: dict[str, Any] | None = None, **columns: Any) -> str:
    """Extract a recording with one stretch of some samples 1/16 m beyond the left line; "departure", or why it is
    refused. It starts and ends on a sample that lies on the line itself, so it lasts (beyond + 1) steps. The lane is
    3 m wide, the vehicle 2 m, the speed 16 m/s."""
    y = np.full(beyond + 12, -0.25)
    y[5:-5] = 0.0
    y[6:-6] = 0.0625
    ones = np.ones(y.size)
    base: dict[str, Any] = {"t": STEP * np.arange(y.size), "lane_offset": 0.5 + y, "lane_width": 3.0 * ones}
    base |= {"speed": 16.0 * ones, "valid": ones > 0, "lane": ones.astype(np.int64), "curvature": 0.0 * ones}
    options = {"vehicle_width": 2.0, "force": True} | (criteria or {})
    extraction = extract_departures([Recording("a", **(base | columns))], **options)
    assert extraction.candidates == 1
    return next((reason for reason, count in extraction.refused.items() if count), "departure")


@pytest.mark.parametrize(
    ("beyond", "criteria", "expected"),
    [
        (3, {}, "departure"),  # 0.5 s, and three samples
        (3, {"min_duration": np.nextafter(0.5, 1.0)}, "too_short"),
        (2, {}, "too_short"),
        (2, {"min_duration": 0.375}, "too_few_samples"),
        (79, {}, "departure"),  # 10 s
        (79, {"max_duration": np.nextafter(10.0, 0.0)}, "too_long"),
        (80, {}, "too_long"),
    ],
)
def test_the_allowed_durations_include_both_ends(beyond, criteria, expected):
    assert fate(beyond, criteria=criteria) == expected


@pytest.mark.parametrize(("speed", "expected"), [(5.0, "slow"), (5.0001, "departure")])
def test_the_mean_speed_lies_above_the_limit(speed, expected):
    assert fate(15, speed=np.full(27, speed)) == expected
    assert fate(15, speed=np.full(27, speed), criteria={"min_speed": 4.0}) == "departure"


def later(rows: int, seconds: float, beyond: int = 15, step: float = STEP) -> np.ndarray:
    """Times with one step longer by some seconds."""
    t = step * np.arange(beyond + 12)
    return t + seconds * (np.arange(t.size) > rows)


@pytest.mark.parametrize(
    ("t", "criteria", "expected"),
    [
        (later(12, 0.375), {"max_gap": 0.5}, "departure"),
        (later(12, 0.375), {"max_gap": np.nextafter(0.5, 0.0)}, "gap"),
        # 2.5 median steps
        (later(12, 0.1875), {}, "departure"),
        (later(12, 0.1876), {}, "gap"),
        # at least 0.25 s
        (later(12, 0.1875, step=0.0625), {}, "departure"),
        (later(12, 0.1876, step=0.0625), {}, "gap"),
    ],
)
def test_a_step_as_long_as_the_limit_is_no_gap(t, criteria, expected):
    assert fate(15, t=t, criteria=criteria) == expected


@pytest.mark.parametrize(("step", "expected"), [(0.5, "departure"), (0.53125, "jump")])
def test_a_step_of_the_offset_as_large_as_the_limit_is_no_jump(step, expected):
    offset = np.full(27, 0.25)
    offset[6:-6] = 0.25 + step
    assert fate(15, t=0.0625 * np.arange(27), lane_offset=offset, criteria={"max_jump": 0.5}) == expected


@pytest.mark.parametrize(("reach", "expected"), [(2.8, "lane_change"), (np.nextafter(2.8, 0.0), "departure")])
def test_an_offset_that_reaches_the_next_lane(reach, expected):
    """0.7 lane widths; the steps are too small for a jump, and the way out and back is a calm one."""
    out = np.linspace(0.0, 2.5, 24)
    offset = np.concatenate([np.zeros(4), out, [reach] * 3, out[::-1], np.zeros(4)])
    assert fate(47, lane=None, lane_offset=offset, lane_width=np.full(59, 4.0)) == expected


@pytest.mark.parametrize(
    ("step", "expected"), [(2.75, "jump"), (2.85, "lane_change"), (5.15, "lane_change"), (5.25, "jump")]
)
@pytest.mark.parametrize("lane", [None, np.ones(27, dtype=np.int64)], ids=["without lane", "with lane"])
def test_a_step_of_the_offset_by_about_a_lane_width(step, expected, lane):
    """0.7 to 1.3 of 4 m, whether the lane has a name or not."""
    offset = np.interp(np.arange(27), [2, 8, 17, 26], [0.5, 1.5, 1.5, 2.5])
    offset[13:] -= step
    assert fate(15, lane=lane, lane_offset=offset, lane_width=np.full(27, 4.0)) == expected


def moved(steps: dict[int, float], step: float, *, width: float = 6.0, **criteria: Any) -> str:
    """A vehicle of 2 m strays; at some samples the offset changes by that much at once, later on it comes back."""
    offset = np.zeros(60)
    offset[6:] = 0.3125
    for sample, way in steps.items():
        offset[sample:] += way
    offset *= np.interp(np.arange(60), [20, 50], [1.0, 0.0])
    offset += 1e-9 * (-1.0) ** np.arange(60)  # one that stands still is none
    columns = {"t": step * np.arange(60), "lane_offset": offset + 0.5 * width - 1.25, "lane_width": np.full(60, width)}
    criteria = {"plausibility": NO_LIMITS, "max_duration": 60.0} | criteria
    return fate(48, **columns, criteria=criteria)


def evenly(way: float, steps: int) -> dict[int, float]:
    return {14 + i: way / steps for i in range(steps)}


@pytest.mark.parametrize(
    ("steps", "step", "max_jump", "expected"),
    [
        # in 0.1 s
        ({14: 0.6}, 0.1, 0.6, "departure"), ({14: 0.6001}, 0.1, 0.6, "jump"), ({14: 0.6001}, 0.05, 0.6, "jump"),
        (evenly(0.6, 2), 0.05, 0.6, "departure"), (evenly(0.6001, 2), 0.05, 0.6, "jump"),
        # over longer times 1.5 m/s more
        ({14: 0.6375}, 0.125, 0.6, "departure"), ({14: 0.6376}, 0.125, 0.6, "jump"),
        ({14: -0.6375}, 0.125, 0.6, "departure"), ({14: -0.6376}, 0.125, 0.6, "jump"),
        (evenly(0.525, 2), 0.125, 0.3, "departure"), (evenly(0.5251, 2), 0.125, 0.3, "jump"),
        (evenly(1.2, 4), 0.125, 0.6, "departure"), (evenly(1.2001, 4), 0.125, 0.6, "jump"),
        (evenly(1.2001, 4), 0.125, 0.61, "departure"),
        # a single step is judged however long it takes, what is further apart than 0.6 s is not one movement
        ({14: 1.5}, 0.7, 0.6, "departure"), ({14: 1.5001}, 0.7, 0.6, "jump"),
        ({14: 1.0, 17: 1.0}, 0.15, 1.0, "jump"), ({14: 1.0, 17: 1.0}, 0.1501, 1.0, "departure"),
        # there and back again: not far in all, but on the way
        ({14: 0.7, 15: -0.7}, 0.125, 0.6, "jump"), ({14: 0.5, 15: -0.5}, 0.125, 0.6, "departure"),
    ],
)  # fmt: skip
def test_a_movement_that_is_too_fast(steps, step, max_jump, expected):
    assert moved(steps, step, max_jump=max_jump) == expected


@pytest.mark.parametrize(
    ("sample", "step", "expected"),
    [
        (13, 0.125, "jump"), (5, 0.125, "jump"), (4, 0.125, "jump"), (3, 0.125, "departure"),
        (23, 0.125, "jump"), (24, 0.125, "departure"), (5, 0.3, "jump"), (4, 0.15, "jump"), (4, 0.1501, "departure"),
    ],
)  # fmt: skip
def test_a_jump_shortly_before_or_after(sample, step, expected):
    """Up to 0.3 s: a smoothed jump begins earlier and ends later than can be told."""
    offset = np.full(27, 0.75)
    offset[6:-6] = 1.0625
    offset[:sample] -= 1.0 * (sample < 6)
    offset[sample:] -= 1.0 * (sample > 6)
    assert fate(15, t=step * np.arange(27), lane_offset=offset, lane_width=np.full(27, 4.0)) == expected


@pytest.mark.parametrize(("way", "expected"), [(1.4, "departure"), (1.4001, "lane_change")])
def test_a_movement_by_most_of_a_narrow_lane(way, expected):
    """0.7 of 2 m in 0.6 s, which would otherwise be slow enough: 0.7 m and 1.5 m/s for half a second."""
    offset = np.interp(np.arange(36), [8, 12, 20, 28], [-0.4, way - 0.4, way - 0.4, -0.4])
    columns = {"t": 0.15 * np.arange(36), "lane_offset": offset, "lane_width": np.full(36, 2.0)}
    criteria = {"vehicle_width": 1.0, "max_jump": 0.7, "plausibility": NO_LIMITS}
    assert fate(24, **columns, criteria=criteria) == expected


@pytest.mark.parametrize(("max_jump", "expected"), [(2.25, {}), (2.15, {"lane_change": 1})])
def test_whoever_allows_for_more_than_most_of_a_lane_gets_it(max_jump, expected):
    """2.2 m at once in a lane of 3 m, out on the left before and on the right after."""
    offset = np.interp(np.arange(60), [10, 20, 30, 31, 40, 50], [0.0, 1.1, 1.1, -1.1, -1.1, 0.0])
    recording = drive("a", 0.1 * np.arange(60), lane_width=3.0, lane_offset=offset)
    extraction = extract(recording, vehicle_width=2.0, max_jump=max_jump, plausibility=NO_LIMITS)
    assert (reasons(extraction), extraction.departures.side.tolist()) == (expected, [] if expected else [LEFT, RIGHT])


@pytest.mark.parametrize(
    ("wider", "steps", "expected"),
    [(0.5, 1, "departure"), (0.501, 1, "jump"), (-0.501, 1, "jump"), (0.6, 4, "departure"), (0.601, 4, "jump")],
)
def test_a_width_that_changes_too_fast(wider, steps, expected):
    """By half a metre, or faster than 1 m/s within 0.6 s."""
    width = np.interp(np.arange(27), [12, 12 + steps], [4.0, 4.0 + wider])
    y = np.where((np.arange(27) < 6) | (np.arange(27) > 20), -0.25, 0.0625)
    assert fate(15, t=0.15 * np.arange(27), lane_width=width, lane_offset=y + 0.5 * width - 1.0) == expected


def beside(narrower: float, deepest: float, *, before: float = 10.0, after: float = 10.0, **columns: Any) -> Recording:
    """Beyond the left line from 100 to 102 s, in a lane that is narrower then, and further away in time; 10 Hz."""
    t = 0.1 * np.arange(2001)
    beyond = (t > 99.95) & (t < 102.05)
    width = np.where((t > 99.95 - before) & (t < 102.05 + after) & ~beyond, 3.5 + narrower, 3.5)
    y = np.where(beyond, deepest, np.where(np.abs(t - 101.0) < 2.5, -0.1, -0.8)) + 1e-6 * np.sin(t)
    return drive("a", t, lane_width=width, lane_offset=y + 0.5 * (width - 1.8), **columns)


@pytest.mark.parametrize(
    ("narrower", "deepest", "around", "expected"),
    [
        (0.26, 0.2, {}, "jump"), (0.24, 0.2, {}, ""), (0.4, 0.39, {}, "jump"), (0.4, 0.41, {}, ""),
        # before and after, on average over 10 s
        (0.4, 0.2, {"before": 0.0}, ""), (0.4, 0.2, {"after": 0.0}, ""), (0.4, 0.2, {"before": 50.0}, "jump"),
        (0.4, 0.2, {"before": 6.5}, "jump"), (0.4, 0.2, {"before": 6.0}, ""),
        (0.4, 0.2, {"after": 6.5}, "jump"), (0.4, 0.2, {"after": 6.0}, ""),
    ],
)  # fmt: skip
@pytest.mark.parametrize("rates", [[], [100.0], [1.0]])
def test_a_lane_that_is_narrower_for_a_departure_alone(narrower, deepest, around, expected, rates):
    """Its line was another marking; whatever other recordings are searched with it."""
    slower = [drive("b", np.arange(3000) / rate, lane_offset=0.0, lane_width=3.5) for rate in rates]
    extraction = extract(*slower, beside(narrower, deepest, **around))
    assert (reasons(extraction), len(extraction.departures)) == ({expected: 1} if expected else {}, not expected)


@pytest.mark.parametrize("way", [2.0, 3.6, -2.0])
@pytest.mark.parametrize("steps", [1, 2, 4])
@pytest.mark.parametrize("lane", [None, np.ones(60, dtype=np.int64)], ids=["without lane", "with lane"])
def test_a_movement_in_several_steps_is_one_break(way, steps, lane):
    """Beyond one line before, beyond the other or the same after: one candidate."""
    position = np.arange(60)
    offset = np.interp(position, [5, 20, 30, 30 + steps, 40, 55], [0.0, 1.0, 1.0, 1.0 - way, 1.0 - way, 0.0])
    if way < 0.0:
        offset = np.interp(position, [5, 15, 30, 30 + steps, 40, 55], [0.0, 1.0, 1.0, 3.0, 3.0, 0.0])
    columns = {"t": 0.1 * position, "lane_offset": offset, "lane_width": np.full(60, 3.6), "lane": lane}
    assert fate(48, **columns, criteria={"max_duration": 20.0}) == ("jump" if abs(way) < 2.5 else "lane_change")


@pytest.mark.parametrize(("width", "expected"), [(2.0, "implausible"), (2.03125, "departure")])
def test_a_lane_as_wide_as_the_vehicle(width, expected):
    """On one sample of several."""
    offset, widths = np.zeros(27), np.full(27, 2.5)
    offset[6:-6] = 0.3125
    widths[12] = width
    assert fate(15, lane_width=widths, lane_offset=offset) == expected


@pytest.mark.parametrize(
    ("kind", "name", "good", "bad"),
    [
        (Criteria, "vehicle_width", (0.5, 4.0), (0.49, 4.01)), (Criteria, "min_duration", (0.0, 9.9), (-0.01, 10.0)),
        (Criteria, "max_duration", (0.51, 1e6), (0.5, np.inf)), (Criteria, "min_speed", (0.0,), (-0.01, np.inf)),
        (Criteria, "max_gap", (1e-3, None), (0.0, np.inf, np.nan)), (Criteria, "max_jump", (1e-3,), (0.0, np.nan)),
        (Criteria, "min_lane_width", (1e-3, 6.99), (0.0, np.nan)), (Criteria, "max_lane_width", (2.01,), (2.0, np.inf)),
        (Preparation, "step", (0.01, 1.0, None), (0.0099, 1.01, np.nan)),
        (Preparation, "max_gap", (1e-3, 10.0), (0.0, 10.01, np.inf)),
        (Preparation, "nominal_lane_width", (2.0, 6.0, None), (1.99, 6.01)),
        (Preparation, "yaw_rate_factor", (-1.0, 1e-3), (0.0, np.nan, np.inf)),
    ],
)  # fmt: skip
def test_the_ends_of_what_is_allowed(kind, name, good, bad):
    for value in good:
        kind(**{name: value})
    for value in bad:
        with pytest.raises(InputError, match=rf"^{name if name != 'min_duration' or value < 0 else 'max_duration'}: "):
            kind(**{name: value})
