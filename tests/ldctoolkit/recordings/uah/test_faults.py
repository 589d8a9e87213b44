"""Faults inside files: named by file and line, the rest is read."""

from __future__ import annotations

import re

import numpy as np
import pytest

from ldctoolkit.recordings.recording import Recording
from ldctoolkit.recordings.uah_driveset import READER

LANE, GPS, YAW = "PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt"
SHOWN = "D1/20151110175712-16km-D1-NORMAL1-SECONDARY"
LEFT_OUT = "without the offset from the lane's centre the trip is left out"


def read(folder):
    """Problems as text, and the recording or None."""
    source = READER.open([folder])
    assert source.problems == ()
    items = [item for part in source.parts for item in part.read()]
    recordings = [item for item in items if isinstance(item, Recording)]
    problems = [str(item) for item in items if not isinstance(item, Recording)]
    assert all(text.startswith(SHOWN) for text in problems)
    return [text.removeprefix(f"{SHOWN}") for text in problems], recordings[0] if recordings else None


@pytest.fixture
def folder(made, tmp_path):
    return made().write(tmp_path)


@pytest.fixture
def sound(made, tmp_path):
    return read(made().write(tmp_path / "sound"))[1]


def change(path, number, line):
    """Put another line in the place of one, counted from 1; None takes it away."""
    lines = path.read_text().splitlines(keepends=True)
    lines[number - 1 : number] = [] if line is None else [line]
    path.write_bytes(b"".join(part if isinstance(part, bytes) else part.encode() for part in lines))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("30.00 abc 0.01 3.5 2\n", "'abc' where the offset is needed"),
        ("30.00 0.1 0.01 NULL 2\n", "'NULL' where the lane width is needed"),
        ("30.00 0.1 0.01 3.5\n", "4 values where at least 5 are needed"),
        ("30.00\n", "1 value where at least 5 are needed"), ("nan 0.1 0.01 3.5 2\n", "the time is 'nan'"),
        ("1e300 0.1 0.01 3.5 2\n", "the time is '1e300'"), (b"30.00 0.1\xff 0.01 3.5 2\n", "bytes that are not UTF-8"),
        ("30.00 0.1 0.01 3.5 2\0\n", "'2\\x00' where the state is needed"),
    ],
)  # fmt: skip
def test_a_faulty_line(folder, sound, line, what):
    change(folder / LANE, 500, line)
    problems, found = read(folder)
    assert problems == [f"/{LANE}, line 500: {what}; the line is left out"]
    for column in ("t", "lane_offset", "valid", "speed", "yaw_rate"):
        np.testing.assert_array_equal(getattr(found, column), np.delete(getattr(sound, column), 499))


def test_text_in_a_column_that_is_not_read(folder, sound):
    t = f"{sound.t[499]:.2f}"
    change(folder / LANE, 500, f"{t} 0.1 bad 3.5 2 \xe4\n")
    problems, found = read(folder)
    assert (problems, found.samples) == ([], sound.samples)
    assert (found.lane_offset[499], found.lane_width[499]) == (-0.1, 3.5)


def test_a_truncated_file(folder, sound):
    data = (folder / LANE).read_bytes()
    (folder / LANE).write_bytes(data[:60_001])
    whole, rest = data[:60_001].count(b"\n"), data[:60_001].rpartition(b"\n")[2]
    assert 0 < len(rest.split()) < 5
    problems, found = read(folder)
    assert len(problems) == 1
    assert problems[0].startswith(f"/{LANE}, line {whole + 1}: ")
    assert found.samples == whole
    np.testing.assert_array_equal(found.t, sound.t[:whole])


def test_many_faulty_lines_are_counted(folder, sound):
    for number in range(100, 120):
        change(folder / GPS, number - 60, f"{number} fast 40.5 -3.4 610 6 10 90\n")
    problems, found = read(folder)
    faulty = [text for text in problems if ", line" in text]
    assert len(faulty) == 6
    assert faulty[0] == f"/{GPS}, line 40: 'fast' where the speed is needed; the line is left out"
    assert (
        faulty[5] == f"/{GPS}, line 45 and 14 more: 'fast' where the speed is needed, or alike; the lines are left out"
    )
    # and what they cost is told
    assert problems[6].startswith(f"/{GPS}: it is short or has gaps")
    assert found.samples == sound.samples


@pytest.mark.parametrize(
    "change",
    [lambda text: text.replace(" \n", "\n").replace(" ", ";"), lambda text: text.replace(".", ",")],
    ids=["semicolons", "decimal commas"],
)
def test_a_file_that_is_parted_otherwise(folder, change):
    (folder / LANE).write_text(change((folder / LANE).read_text()))
    problems, found = read(folder)
    assert found is None
    assert re.fullmatch(rf"/{LANE}, line 1 and \d+ more: .* needed; no line can be used", problems[0])
    assert problems[1] == f": {LEFT_OUT}"


def test_a_yaw_rate_from_the_course_is_marked(folder, sound):
    """It is the heading's own slope, and says nothing about the yaw angle."""
    assert sound.yaw_rate_measured[sound.valid].all()
    lines = (folder / YAW).read_text().splitlines(keepends=True)
    (folder / YAW).write_text("".join(lines[: len(lines) // 2]))
    _, found = read(folder)
    late = found.t > float(lines[len(lines) // 2].split()[0]) + 1.0
    assert not found.yaw_rate_measured[late].any()
    assert np.isfinite(found.yaw_rate[late & found.valid]).mean() > 0.9
    np.testing.assert_array_equal(found.yaw_rate_measured[found.t < 50.0], sound.yaw_rate_measured[sound.t < 50.0])
    (folder / YAW).unlink()
    _, found = read(folder)
    assert not found.yaw_rate_measured.any()


@pytest.mark.parametrize(("line", "number"), [("9.5,0.2,0.0,3.5,2\n", 1), ("9,5 0,2 0,0 3,5 2\n", 3)])
def test_a_single_line_that_is_parted_otherwise(folder, sound, line, number):
    change(folder / LANE, number, line)
    problems, found = read(folder)
    assert found.samples == sound.samples - 1
    (problem,) = problems
    assert problem.startswith(f"/{LANE}, line {number}: ")
    assert problem.endswith("is needed; the line is left out") or problem.endswith("are needed; the line is left out")
    np.testing.assert_array_equal(found.t, np.delete(sound.t, number - 1))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-32"])
def test_utf_16(folder, encoding):
    (folder / LANE).write_bytes((folder / LANE).read_text().encode(encoding))
    problems, found = read(folder)
    assert found is None
    assert problems == [f"/{LANE}: it is UTF-16 text, or no text at all; allowed: UTF-8", f": {LEFT_OUT}"]


def test_mixed_encodings(folder, sound):
    """Half of the file was appended by another program."""
    lines = (folder / GPS).read_text().splitlines(keepends=True)
    (folder / GPS).write_bytes("".join(lines[:80]).encode() + "".join(lines[80:]).encode("utf-16-le"))
    problems, found = read(folder)
    assert problems[0].startswith(f"/{GPS}, line 81: ")
    early = sound.t < 80.0
    np.testing.assert_array_equal(found.speed[early], sound.speed[early])


@pytest.mark.parametrize("content", [b"", b" \n\r\n", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("file", [LANE, GPS, YAW])
def test_empty_files(folder, sound, file, content):
    (folder / file).write_bytes(content)
    problems, found = read(folder)
    assert problems[0] == f"/{file}: it is empty"
    if file == YAW:
        np.testing.assert_array_equal(found.speed, sound.speed)
        assert "the yaw rate there is that of the course" in found.notes[0]
    else:
        assert found is None
        assert len(problems) == 2


@pytest.mark.parametrize(("one", "other"), [(LANE, GPS), (LANE, YAW), (GPS, YAW), (GPS, LANE), (YAW, LANE), (YAW, GPS)])
def test_swapped_files(folder, one, other):
    """A table in another's place is not read as what it is not."""
    (folder / one).write_bytes((folder / other).read_bytes())
    problems, found = read(folder)
    assert re.search("are files swapped|no line can be used", problems[0])
    assert problems[0].startswith(f"/{one}")
    assert (found is None) == (one != YAW)


def test_another_table_of_five_columns(folder):
    """The vehicle detection: time, distance, time to impact, vehicles, speed."""
    rows = "".join(f"{0.1 * i:.2f} -1 -1 {i % 3} {90 + i % 7}\n" for i in range(500))
    (folder / LANE).write_text(rows)
    problems, found = read(folder)
    assert found is None
    assert problems[0] == f"/{LANE}: its numbers are not those of a lane table; are files swapped?"


def test_time_runs_backwards(made, sound, tmp_path):
    trip = made()
    trip.lane[700:720, 0] -= 5.0
    trip.gps[50, 0] = 9999.0
    problems, found = read(trip.write(tmp_path))
    before, here = trip.lane[699, 0], trip.lane[700, 0]
    assert problems == [
        f"/{LANE}, line 701: the time runs backwards: {here} s after {before} s; 20 lines are left out",
        f"/{GPS}, line 51: the time runs backwards: 9999.0 s before {trip.gps[51, 0]} s; the line is left out",
    ]
    np.testing.assert_array_equal(found.t, np.delete(sound.t, slice(700, 720)))
    early = (found.t < trip.gps[49, 0]) | (found.t > trip.gps[51, 0])
    np.testing.assert_array_equal(found.speed[early], np.delete(sound.speed, slice(700, 720))[early])


@pytest.mark.parametrize("changed", [{700: 900.0, 701: 900.0}, {700: 900.0, 900: 0.5}])
def test_two_odd_times_cost_two_lines(changed, made, sound, tmp_path):
    """Two neighbours far ahead; one ahead and one behind."""
    trip = made()
    trip.lane[list(changed), 0] = list(changed.values())
    problems, found = read(trip.write(tmp_path))
    reported = f"the time runs backwards: 900.0 s before {sound.t[701 + (701 in changed)]} s; 2 lines are left out"
    assert problems == [f"/{LANE}, line 701: {reported}"]
    np.testing.assert_array_equal(found.t, np.delete(sound.t, list(changed)))


def test_a_clock_that_starts_again(made, sound, tmp_path):
    """Two drives in one file: the second one's times lie before the end of the first."""
    trip = made()
    trip.lane = np.vstack([trip.lane, trip.lane[:1000]])
    problems, found = read(trip.write(tmp_path))
    assert problems == [
        f"/{LANE}, line {sound.samples + 1}: the time runs backwards: {sound.t[0]} s after {sound.t[-1]} s; "
        "1000 lines are left out"
    ]
    np.testing.assert_array_equal(found.t, sound.t)


def test_no_detected_lane(made, tmp_path):
    trip = made()
    trip.lane[:, 1:] = -9.0
    problems, found = read(trip.write(tmp_path))
    assert problems == [f"/{LANE}: no line has a detected lane (state 2)"]
    assert not found.valid.any()


def test_positions_of_another_trip(made, tmp_path):
    trip = made()
    trip.gps[:, 0] += 1000.0
    problems, found = read(trip.write(tmp_path))
    assert found is None
    assert problems[0].startswith(f"/{GPS}: it holds no speed in time, the trip runs from ")


def test_a_file_too_large(folder, monkeypatch):
    monkeypatch.setattr("ldctoolkit.recordings.uah_driveset.LARGEST_FILE", 1000)
    problems, found = read(folder)
    assert found is None
    assert problems[0].endswith("bytes; a file of one trip has at most 1000")


def test_a_file_that_vanishes(folder):
    (part,) = READER.open([folder]).parts
    (folder / GPS).unlink()
    assert "cannot be read: No such file" in str(next(part.read()))
