"""UAH-DriveSet: folders of trips, and files at fault."""

import hashlib
import pickle
import re
import shutil

import numpy as np
import pytest

from helpers.uah import make_trip
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Label, Recording
from ldctoolkit.recordings.uah_driveset import READER

LANE, GPS, YAW = "PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt"
NAMES = {
    "20151110175712-16km-D1-NORMAL1-SECONDARY": ("D1", "NORMAL", "SECONDARY"),
    "20151111123124-25km-D1-NORMAL-MOTORWAY": ("D1", "NORMAL", "MOTORWAY"),
    "20151111135612-13km-D1-DROWSY-SECONDARY": ("D1", "DROWSY", "SECONDARY"),
    "20151120133502-26km-D2-AGGRESSIVE2-MOTORWAY": ("D2", "AGGRESSIVE", "MOTORWAY"),
}


def small(folder, seed=0):
    """The fewest lines that make a trip."""
    folder.mkdir(parents=True)
    (folder / LANE).write_text(f"1.0 0.{seed}1 0 3.5 2\n1.1 0.2 0 3.5 2\n")
    (folder / GPS).write_text("0.9 80 40.5 -3.4 600 6 10 12.5\n1.9 81 40.5 -3.4 600 6 10 12.5\n")
    (folder / YAW).write_text("1.0 1 0 0 0 0 0 0 0 0 0.5\n1.1 1 0 0 0 0 0 0 0 0 0.5\n")
    return folder


@pytest.fixture
def root(tmp_path):
    root = tmp_path / "UAH-DRIVESET-v1"
    for seed, (name, (driver, _, _)) in enumerate(NAMES.items()):
        small(root / driver / name, seed)
    (root / "README.txt").write_text("about")
    (root / "D1" / "notes").mkdir()
    return root


def test_root_driver_trip_or_file(root):
    source = READER.open([root])
    assert ([part.key for part in source.parts], source.problems) == (sorted(NAMES), ())
    assert READER.recognise([root]) == "4 trips of 2 drivers"
    assert READER.recognise([root.parent]) == "4 trips of 2 drivers"
    d1 = READER.open([root / "D1"])
    assert [part.key for part in d1.parts] == sorted(name for name in NAMES if "-D1-" in name)
    trip = root / "D1" / sorted(NAMES)[0]
    for path in (trip, trip / LANE, trip / GPS):
        assert READER.open([path]).parts == source.parts[:1]
        assert READER.recognise([path]) == "1 trip of 1 driver"
    # given twice, one way or another, is read once
    again = READER.open([trip, root / "D2", root])
    assert (sorted(part.key for part in again.parts), again.problems) == (sorted(NAMES), ())


def test_labels_and_sources(root):
    for part in READER.open([root]).parts:
        (recording,) = part.read()
        driver, behaviour, road = NAMES[part.key]
        assert recording.name == part.key
        assert recording.labels == (Label("driver", driver), Label("behaviour", behaviour), Label("road", road))
        assert (recording.source, pickle.loads(pickle.dumps(part))) == (driver, part)


def test_files_with_digests(root):
    files = READER.open([root]).files
    assert len(files) == 12
    assert str(root.parent) not in repr(files)
    for file in files:
        data = (root / file.name).read_bytes()
        assert (file.bytes, file.sha256) == (len(data), hashlib.sha256(data).hexdigest())
    assert sum(part.bytes for part in READER.open([root]).parts) == sum(file.bytes for file in files)


def test_missing_files(root):
    first, second, third, fourth = sorted(NAMES)
    (root / "D1" / first / LANE).unlink()
    (root / "D1" / second / GPS).unlink()
    (root / "D1" / third / YAW).unlink()
    source = READER.open([root])
    assert [part.key for part in source.parts] == [third, fourth]
    assert [str(problem) for problem in source.problems] == [
        f"D1/{first}: no file {LANE}, which holds the offset from the lane's centre; the trip is left out",
        f"D1/{second}: no file {GPS}, which holds the speed; the trip is left out",
    ]
    assert [file.name for file in source.files] == [
        f"D1/{third}/{LANE}", f"D1/{third}/{GPS}", *(f"D2/{fourth}/{name}" for name in (LANE, GPS, YAW))
    ]  # fmt: skip
    (recording,) = source.parts[0].read()
    assert isinstance(recording, Recording)
    assert recording.notes[0].startswith("RAW_ACCELEROMETERS.txt is missing or cannot be used; ")


def test_a_name_that_says_nothing(root):
    small(root / "D3" / "monday", 7)
    source = READER.open([root])
    assert [str(problem) for problem in source.problems] == [
        "D3/monday: the folder's name is not <date>-<km>-D<number>-<NORMAL|DROWSY|AGGRESSIVE>-<MOTORWAY|SECONDARY>; "
        "it is read without driver, behaviour and road"
    ]
    (recording,) = source.parts[-1].read()
    assert (recording.name, recording.labels, recording.source) == ("monday", (), "D3")


def test_duplicates(root):
    first, second = sorted(NAMES)[:2]
    small(root / "D4" / first, 9)  # the name again, another content
    shutil.copytree(root / "D1" / second, root / "D5" / second.replace("D1", "D5"))  # the content again
    source = READER.open([root])
    assert [part.key for part in source.parts] == sorted(NAMES)
    assert [str(problem) for problem in source.problems] == [
        f"D4/{first}: has the same name as D1/{first}; it is left out",
        f"D5/{second.replace('D1', 'D5')}: has the same {LANE} as D1/{second}; it is left out",
    ]


def test_only_trips_that_cannot_be_used(root):
    for name, (driver, _, _) in NAMES.items():
        (root / driver / name / LANE).unlink()
    assert READER.recognise([root]) == "4 trips of 2 drivers"
    with pytest.raises(RecordingError, match=r"no file PROC_LANE_DETECTION\.txt, which .* \(3 more\)$"):
        READER.open([root])


SHOWN = "D1/20151110175712-16km-D1-NORMAL1-SECONDARY"


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
def folder(tmp_path):
    return make_trip().write(tmp_path)


@pytest.fixture
def sound(tmp_path):
    return read(make_trip().write(tmp_path / "sound"))[1]


def change(path, number, line):
    """Put another line in the place of one, counted from 1; None takes it away."""
    lines = path.read_text().splitlines(keepends=True)
    lines[number - 1 : number] = [] if line is None else [line]
    path.write_bytes(b"".join(part if isinstance(part, bytes) else part.encode() for part in lines))


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("30.00 abc 0.01 3.5 2\n", "column 'offset' holds 'abc'; allowed: numbers"),
        ("NULL 0.1 0.01 3.5 2\n", "no usable time"),
        ("30.00 0.1 0.01 3.5\n", "4 cells; allowed: 5"),
        ("30.00\n", "1 cell; allowed: 5"), ("nan 0.1 0.01 3.5 2\n", "no usable time"),
        ("1e300 0.1 0.01 3.5 2\n", "no usable time"),
        (b"30.00 0.1\xff 0.01 3.5 2\n", "the text is not UTF-8 (invalid start byte)"),
        ("30.00 0.1 0.01 3.5 2\0\n", "column 'state' holds '2\\x00'; allowed: numbers"),
    ],
)  # fmt: skip
def test_a_faulty_line(folder, sound, line, what):
    change(folder / LANE, 500, line)
    problems, recording = read(folder)
    assert problems == [f"/{LANE}, line 500: {what}; the line is left out"]
    for column in ("t", "lane_offset", "valid", "speed", "yaw_rate"):
        np.testing.assert_array_equal(getattr(recording, column), np.delete(getattr(sound, column), 499))


def test_a_yaw_rate_from_the_course_is_marked(folder, sound):
    """It is the heading's own slope, and says nothing about the yaw angle."""
    assert sound.yaw_rate_measured[sound.valid].all()
    lines = (folder / YAW).read_text().splitlines(keepends=True)
    (folder / YAW).write_text("".join(lines[: len(lines) // 2]))
    _, recording = read(folder)
    late = recording.t > float(lines[len(lines) // 2].split()[0]) + 1.0
    assert not recording.yaw_rate_measured[late].any()
    assert np.isfinite(recording.yaw_rate[late & recording.valid]).mean() > 0.9
    np.testing.assert_array_equal(
        recording.yaw_rate_measured[recording.t < 50.0], sound.yaw_rate_measured[sound.t < 50.0]
    )
    (folder / YAW).unlink()
    _, recording = read(folder)
    assert not recording.yaw_rate_measured.any()


@pytest.mark.parametrize(
    ("file", "copied"), [(LANE, GPS), (LANE, YAW), (GPS, YAW), (GPS, LANE), (YAW, LANE), (YAW, GPS)]
)
def test_swapped_files(folder, file, copied):
    """A table in another's place is not read as what it is not."""
    (folder / file).write_bytes((folder / copied).read_bytes())
    problems, recording = read(folder)
    assert re.search("are files swapped|no line can be used", problems[0])
    assert problems[0].startswith(f"/{file}")
    assert (recording is None) == (file != YAW)


def test_no_detected_lane(tmp_path):
    trip = make_trip()
    trip.lane[:, 1:] = -9.0
    problems, recording = read(trip.write(tmp_path))
    assert problems == [f"/{LANE}: no line with a detected lane (state 2) can be used"]
    assert not recording.valid.any()


def test_positions_of_another_trip(tmp_path):
    trip = make_trip()
    trip.gps[:, 0] += 1000.0
    problems, recording = read(trip.write(tmp_path))
    assert recording is None
    assert problems[0].startswith(f"/{GPS}: it holds no speed in time, the trip runs from ")
