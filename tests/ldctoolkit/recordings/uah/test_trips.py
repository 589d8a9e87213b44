"""UAH-DriveSet: signals, departures, properties."""

import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import examples
from helpers.planted import assert_planted
from helpers.uah import PLANTED, TRUTH, make_trip
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.extract import extract_part
from ldctoolkit.recordings.find_departures import REASONS, Criteria
from ldctoolkit.recordings.preparation import Preparation, local_slope, merge_repeated, rising_rows, values_at
from ldctoolkit.recordings.uah_driveset import READER, TableKind, read_table

# times on a fine binary raster: sums and differences are exact, so no comparison hangs on rounding
TIMES = st.lists(st.integers(0, 400), min_size=0, max_size=30, unique=True).map(lambda ks: np.sort(ks) / 32.0)
SETTINGS = examples(150)


def value_by_hand(time, t, values, longest, beyond):
    for i in range(len(t) - 1):
        if t[i] <= time <= t[i + 1] and t[i + 1] - t[i] <= longest:
            share = (time - t[i]) / (t[i + 1] - t[i])
            return values[i] + share * (values[i + 1] - values[i])
    near = [(abs(time - t[i]), i) for i in range(len(t)) if abs(time - t[i]) <= beyond]
    return values[min(near)[1]] if near else math.nan


@SETTINGS
@given(TIMES, st.lists(st.integers(-40, 480).map(lambda k: k / 32.0), max_size=20), st.integers(0, 2**32 - 1))
def test_values_at(t, times, seed):
    values = np.random.default_rng(seed).normal(size=t.size)
    values_found = values_at(np.array(times), t, values, longest=1.5, beyond=0.25)
    expected = [value_by_hand(time, t, values, 1.5, 0.25) for time in times]
    np.testing.assert_allclose(values_found, expected, rtol=1e-12, atol=1e-12)


@SETTINGS
@given(TIMES, st.integers(0, 2**32 - 1))
def test_local_slope(t, seed):
    values = np.random.default_rng(seed).normal(size=t.size)
    slope = local_slope(t, values, half=0.25, longest=0.5)
    for i in range(t.size):
        window = [i]
        for step in (1, -1):
            j = i + step
            while 0 <= j < t.size and abs(t[j] - t[j - step]) <= 0.5 and abs(t[j] - t[i]) <= 0.25:
                window.append(j)
                j += step
        if len(window) == 1:
            assert math.isnan(slope[i])
        else:
            assert slope[i] == pytest.approx(np.polyfit(t[window] - t[i], values[window], 1)[0], rel=1e-9, abs=1e-9)


def test_absurd_clocks():
    # 200,000 samples in one window: only some of them are taken, so that the work is bounded
    t = np.arange(200_000) * 2.0**-21
    np.testing.assert_allclose(local_slope(t, t, half=0.25, longest=0.5), 1.0)
    assert np.isnan(local_slope(np.arange(4) * 1e8, np.ones(4), half=0.25, longest=0.5)).all()
    assert local_slope(np.empty(0), np.empty(0), half=0.25, longest=0.5).shape == (0,)


@SETTINGS
@given(st.lists(st.tuples(st.integers(0, 5), st.integers(-9, 9)), max_size=20))
def test_merge_repeated(pairs):
    pairs.sort(key=lambda pair: pair[0])
    t, values = (np.array([pair[i] for pair in pairs], dtype=float) for i in (0, 1))
    merged = merge_repeated(t, values)
    times = sorted(set(t.tolist()))
    assert merged[0].tolist() == times
    assert merged[1].tolist() == pytest.approx([np.mean(values[t == time]) for time in times])


def read(folder):
    (part,) = READER.open([folder]).parts
    (recording,) = part.read()
    return recording


def test_the_recording(tmp_path):
    """Units and signs of a whole trip."""
    trip = make_trip()
    recording = read(trip.write(tmp_path))
    np.testing.assert_array_equal(recording.t, trip.lane[:, 0])
    np.testing.assert_array_equal(recording.valid, trip.lane[:, 4] == 2.0)
    good = recording.valid
    assert recording.lane_offset[good].tolist() == (0.0 - trip.lane[good, 1]).tolist()
    assert recording.lane_width[good].tolist() == trip.lane[good, 3].tolist()
    assert np.isnan(recording.lane_offset[~good]).all()
    np.testing.assert_allclose(recording.speed, TRUTH["speed"](recording.t), atol=0.01)
    np.testing.assert_allclose(
        recording.yaw_rate, TRUTH["curvature"](recording.t) * TRUTH["speed"](recording.t), atol=1e-3
    )
    # no course before 14 s; then it turns as the vehicle does, without jumps
    finite = np.isfinite(recording.heading)
    assert not finite[recording.t < 13.3].any()
    assert finite[recording.t > 15.0].all()
    turned = recording.heading[finite] - TRUTH["yaw"](recording.t[finite])
    assert np.ptp(turned) < 0.03  # a course holds for half a second before the first one
    assert (recording.curvature, recording.lane, recording.turn_signal) == (None, None, None)
    assert recording.notes == ()


def test_yaw_in_degrees(tmp_path):
    trip = make_trip()
    recording = read(trip.write(tmp_path / "radians"))
    trip.accelerometers[:, 10] = np.degrees(trip.accelerometers[:, 10])
    in_degrees = read(trip.write(tmp_path / "degrees"))
    np.testing.assert_allclose(in_degrees.yaw_rate, recording.yaw_rate, atol=1e-6)
    assert in_degrees.notes == ("the yaw angle in RAW_ACCELEROMETERS.txt goes beyond pi and is taken as degrees",)


def test_speed_and_yaw_rate_end_at_gaps(tmp_path):
    trip = make_trip()
    trip.gps = trip.gps[(trip.gps[:, 0] < 60.0) | (trip.gps[:, 0] > 68.0)]
    trip.gps[(trip.gps[:, 0] > 30.0) & (trip.gps[:, 0] < 34.0), 1] = -3.6  # the phone's word for no speed
    trip.accelerometers = trip.accelerometers[np.abs(trip.accelerometers[:, 0] - 64.0) > 2.0]
    (part,) = READER.open([trip.write(tmp_path)]).parts
    problem, recording = part.read()
    assert "a speed" in str(problem)
    t = recording.t
    for missing, around in (
        ((t > 60.5) & (t < 67.0), (t < 59.0) | (t > 69.0)),
        ((t > 30.6) & (t < 33.4), (t < 29.0) | (t > 35.0)),
    ):
        assert np.isnan(recording.speed[missing]).all()
        near = around & (np.abs(t - np.mean(t[missing])) < 9.0)
        assert np.isfinite(recording.speed[near]).all()
    missing = (t > 62.3) & (t < 65.7)  # and the course is missing as well
    assert np.isnan(recording.yaw_rate[missing]).all()
    assert np.isfinite(recording.yaw_rate[(t < 61.5) | (t > 66.5)]).all()


def test_repeated_and_missing_times_in_side_files(tmp_path):
    trip = make_trip()
    trip.gps = np.repeat(trip.gps, 2, axis=0)
    trip.accelerometers = np.repeat(trip.accelerometers, 3, axis=0)
    trip.accelerometers = trip.accelerometers[np.arange(len(trip.accelerometers)) % 7 != 3]
    recording = read(trip.write(tmp_path))
    np.testing.assert_allclose(recording.speed, TRUTH["speed"](recording.t), atol=0.01)
    np.testing.assert_allclose(
        recording.yaw_rate, TRUTH["curvature"](recording.t) * TRUTH["speed"](recording.t), atol=2e-3
    )


CRITERIA = Criteria(vehicle_width=1.8)
STEP = Preparation(step=READER.step)


def extract(*paths, preparation=STEP):
    results = [extract_part(part, CRITERIA, preparation) for part in READER.open(list(paths)).parts]
    (result,) = results
    return result


def check(departures, planted, curvature=1e-4):
    """Also the mean speed of each."""
    assert_planted(departures, planted, TRUTH["curvature"], bend=curvature)
    v_mean = [TRUTH["speed"](departure.start + np.array([0.0, departure.T])).mean() for departure in planted]
    np.testing.assert_allclose(departures.v_mean, v_mean, atol=0.05)


def test_departures_come_back(tmp_path):
    make_trip().write(tmp_path)
    result = extract(tmp_path)
    assert result.problems == ()
    check(result.departures, PLANTED)


@pytest.mark.parametrize("width", [2.5, 3.6])
def test_scale_of_a_single_camera(tmp_path, width):
    make_trip(scale=width / 3.5).write(tmp_path)
    result = extract(tmp_path, preparation=Preparation(step=0.1, nominal_lane_width=3.5))
    check(result.departures, PLANTED)
    extra = {column.name: column.values for column in result.departures.extra}
    np.testing.assert_allclose(extra["lane_scale"], 3.5 / width, rtol=1e-3)
    # without it the vehicle's edge lies elsewhere: offset and width keep the factor, the vehicle's width does not
    plain = extract(tmp_path).departures
    factor, moved = width / 3.5, 0.5 * CRITERIA.vehicle_width * (1.0 - width / 3.5)
    expected = [factor * departure.d_y + moved for departure in PLANTED]
    pairs = [
        (float(plain.d_y[k]), depth)
        for departure, depth in zip(PLANTED, expected, strict=True)
        for k in np.flatnonzero(plain.side == departure.side)
        if plain.start_time[k] < departure.start + 0.5 * departure.T < plain.start_time[k] + plain.T[k]
    ]
    assert len(pairs) == sum(depth > 0.02 for depth in expected) == len(PLANTED)
    for depth_found, depth in pairs:
        assert depth_found == pytest.approx(depth, abs=0.01)


def test_yaw_rate_from_the_course(tmp_path):
    folder = make_trip().write(tmp_path)
    (folder / "RAW_ACCELEROMETERS.txt").unlink()
    result = extract(tmp_path)
    check(result.departures, PLANTED, curvature=2e-4)
    assert [note for note, _ in result.evidence.notes] == [
        "RAW_ACCELEROMETERS.txt is missing or cannot be used; the yaw rate there is that of the course in RAW_GPS.txt"
    ]


def test_short_side_files(tmp_path):
    """The accelerometers stop early, the positions begin late; each part is used as far as it goes."""
    trip = make_trip()
    trip.accelerometers = trip.accelerometers[trip.accelerometers[:, 0] < 60.0]
    trip.gps = trip.gps[trip.gps[:, 0] > 28.0]
    trip.write(tmp_path)
    result = extract(tmp_path)
    check(result.departures, PLANTED[1:], curvature=2e-4)
    assert len(result.problems) == 1
    assert "RAW_GPS.txt: it is short or has gaps: " in str(result.problems[0])
    assert [note.split(";")[0] for note, _ in result.evidence.notes] == ["RAW_ACCELEROMETERS.txt is short or has gaps"]


def test_no_yaw_rate_at_all(tmp_path):
    trip = make_trip()
    trip.gps[:, 7] = -1.0
    folder = trip.write(tmp_path)
    (folder / "RAW_ACCELEROMETERS.txt").unlink()
    result = extract(tmp_path)
    assert result.departures.n == len(PLANTED)
    assert not result.departures.c_0.any()
    assert "the lane counts as straight" in result.evidence.notes[0][0]


def test_a_gap_inside_a_departure(tmp_path):
    trip = make_trip()
    middle = PLANTED[2].start + 0.5 * PLANTED[2].T
    trip.lane = trip.lane[np.abs(trip.lane[:, 0] - middle) > 0.2]
    trip.write(tmp_path)
    result = extract(tmp_path)
    check(result.departures, (*PLANTED[:2], *PLANTED[3:]))
    (account,) = result.accounts
    assert account.refused.sum() == account.refused[0, REASONS.index("gap")] == 1


KIND = TableKind("a table", "a.txt", {"time": 0, "offset": 1, "lane width": 3}, lambda values: True, "")
TOKENS = st.sampled_from(
    ["1", "2.5", "-9", "+3", ".5", "1e3", "-1E-3", "nan", "inf", "x", "1_0", "٣", "0x1", "1;5", "#", '"1"', "NULL", "é"]
)
LINES = st.lists(TOKENS, max_size=6).flatmap(
    lambda tokens: st.sampled_from([" ", "  ", "\t"]).map(lambda s: s.join(tokens))
)


@examples(300)
@given(st.lists(LINES, max_size=8), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_against_plain_python(lines, end, last):
    """Line by line with nothing but `split` and `float`."""
    text = end.join(lines) + (end if last else "")
    expected, faulty = [], []
    for line, content in enumerate(lines, start=1):
        tokens = content.split()
        if not tokens:
            continue
        used = [tokens[i] for i in (0, 1, 3) if i < len(tokens)]
        try:
            if len(used) < 3 or not "".join(used).isascii() or "_" in "".join(used):
                raise ValueError
            row = [float(token.strip('"').replace("NULL", "nan")) for token in used]
            if not abs(row[0]) < 1e9:
                raise ValueError
            expected.append(row)
        except ValueError:
            faulty.append(line)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.txt")
        path.write_bytes(text.encode())
        try:
            table, problems = read_table(path, "a.txt", KIND)
        except RecordingError:
            assert expected == []
            return
    rows = np.array(expected)
    keep = rising_rows(rows[:, 0])
    assert (20 * np.sum(~keep) > keep.size) == (table[0].size == 0)
    if table[0].size == 0:
        return
    np.testing.assert_array_equal(table[0], rows[keep])
    reported = [problem for problem in problems if "time runs" not in problem.what]
    assert [problem.place for problem in reported][:5] == [f"line {line}" for line in faulty[:5]]
    assert len(problems) - len(reported) == (not keep.all())
