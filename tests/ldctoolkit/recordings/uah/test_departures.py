"""Departures planted in trips come back, whatever the defects of the files."""

import dataclasses

import numpy as np
import pytest

from ldctoolkit.recordings.extract import extract_part
from ldctoolkit.recordings.find_departures import REASONS, Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.uah_driveset import READER

CRITERIA = Criteria(vehicle_width=1.8)
STEP = Preparation(step=READER.step)


def extract(*paths, preparation=STEP):
    results = [extract_part(part, CRITERIA, preparation) for part in READER.open(list(paths)).parts]
    (result,) = results
    return result


def check(departures, planted, truth, d_y=0.01, curvature=1e-4):
    """Count exact; side, start, duration, depth and curvature of each."""
    assert departures.side.tolist() == [one.side for one in planted]
    for i, one in enumerate(planted):
        assert departures.start_time[i] == pytest.approx(one.start, abs=0.05)
        assert departures.T[i] == pytest.approx(one.T, abs=0.1)
        assert departures.d_y[i] == pytest.approx(one.d_y, abs=d_y)
        c = one.side * truth["curvature"](one.start + np.array([0.0, one.T]))
        assert departures.c_0[i] == pytest.approx(c[0], abs=curvature)
        assert departures.dc[i] == pytest.approx(c[1] - c[0], abs=2 * curvature)
        # the signs are told, not by chance: the bends are far from 0
        assert abs(c[0]) > 2 * curvature
        assert np.sign(departures.c_0[i]) == np.sign(c[0])
        if abs(c[1] - c[0]) > 2 * curvature:
            assert np.sign(departures.dc[i]) == np.sign(c[1] - c[0])
        v = truth["speed"](one.start + np.array([0.0, one.T]))
        assert departures.v_mean[i] == pytest.approx(v.mean(), abs=0.05)


def test_departures_come_back(made, planted, truth, tmp_path):
    made().write(tmp_path)
    result = extract(tmp_path)
    assert result.problems == ()
    check(result.departures, planted, truth)
    # each side departs in a left and in a right bend, entering and leaving it
    bends = np.sign(truth["curvature"](np.array([one.start for one in planted])))
    assert {(one.side, bend) for one, bend in zip(planted, bends, strict=True)} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}
    assert {np.sign(value) for value in result.departures.dc} == {1.0, -1.0}


@pytest.mark.parametrize("width", [2.5, 3.6])
def test_scale_of_a_single_camera(made, planted, truth, tmp_path, width):
    made(scale=width / 3.5).write(tmp_path)
    result = extract(tmp_path, preparation=Preparation(step=0.1, nominal_lane_width=3.5))
    check(result.departures, planted, truth)
    extra = {column.name: column.values for column in result.departures.extra}
    np.testing.assert_allclose(extra["lane_scale"], 3.5 / width, rtol=1e-3)
    # without it the vehicle's edge lies elsewhere: offset and width keep the factor, the vehicle's width does not
    plain = extract(tmp_path).departures
    factor, moved = width / 3.5, 0.5 * CRITERIA.vehicle_width * (1.0 - width / 3.5)
    expected = [factor * one.d_y + moved for one in planted]
    pairs = [
        (float(plain.d_y[k]), depth)
        for one, depth in zip(planted, expected, strict=True)
        for k in np.flatnonzero(plain.side == one.side)
        if plain.start_time[k] < one.start + 0.5 * one.T < plain.start_time[k] + plain.T[k]
    ]
    assert len(pairs) == sum(depth > 0.02 for depth in expected) == len(planted)
    for found, depth in pairs:
        assert found == pytest.approx(depth, abs=0.01)


def test_yaw_rate_from_the_course(made, planted, truth, tmp_path):
    folder = made().write(tmp_path)
    (folder / "RAW_ACCELEROMETERS.txt").unlink()
    result = extract(tmp_path)
    check(result.departures, planted, truth, curvature=2e-4)
    assert [note for note, _ in result.evidence.notes] == [
        "RAW_ACCELEROMETERS.txt is missing or cannot be used; the yaw rate there is that of the course in RAW_GPS.txt"
    ]


def test_short_side_files(made, planted, truth, tmp_path):
    """The accelerometers stop early, the positions begin late; each part is used as far as it goes."""
    trip = made()
    trip.accelerometers = trip.accelerometers[trip.accelerometers[:, 0] < 60.0]
    trip.gps = trip.gps[trip.gps[:, 0] > 28.0]
    trip.write(tmp_path)
    result = extract(tmp_path)
    check(result.departures, planted[1:], truth, curvature=2e-4)
    assert len(result.problems) == 1
    assert "RAW_GPS.txt: it is short or has gaps: " in str(result.problems[0])
    assert [note.split(";")[0] for note, _ in result.evidence.notes] == ["RAW_ACCELEROMETERS.txt is short or has gaps"]


def test_no_yaw_rate_at_all(made, planted, tmp_path):
    trip = made()
    trip.gps[:, 7] = -1.0
    folder = trip.write(tmp_path)
    (folder / "RAW_ACCELEROMETERS.txt").unlink()
    result = extract(tmp_path)
    assert result.departures.n == len(planted)
    assert not result.departures.c_0.any()
    assert "the lane counts as straight" in result.evidence.notes[0][0]


def test_a_gap_inside_a_departure(made, planted, truth, tmp_path):
    trip = made()
    middle = planted[2].start + 0.5 * planted[2].T
    trip.lane = trip.lane[np.abs(trip.lane[:, 0] - middle) > 0.2]
    trip.write(tmp_path)
    result = extract(tmp_path)
    check(result.departures, (*planted[:2], *planted[3:]), truth)
    (account,) = result.accounts
    assert account.refused.sum() == account.refused[0, REASONS.index("gap")] == 1


def test_nothing_else_counts(made, planted, truth, tmp_path):
    """Blanks, line ends, a byte order mark, columns at the end: the same bits."""
    folder = made().write(tmp_path / "plain")
    other = made().write(tmp_path / "other")
    for file in ("PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt"):
        lines = (folder / file).read_text().splitlines()
        text = "\ufeff\r\n" + "\r\n\r\n".join("\t" + line.replace(" ", " \t ") + " 7 x" for line in lines)
        (other / file).write_bytes(text.encode())
    one, same = extract(folder), extract(other)
    assert same.problems == ()
    check(one.departures, planted, truth)
    np.testing.assert_array_equal(one.departures.matrix(), same.departures.matrix())
    (a,), (b,) = (list(READER.open([path]).parts[0].read()) for path in (folder, other))
    for column in a.COLUMNS:
        np.testing.assert_array_equal(getattr(a, column), getattr(b, column))
    assert dataclasses.replace(b, **{column: getattr(a, column) for column in a.COLUMNS}) == a
