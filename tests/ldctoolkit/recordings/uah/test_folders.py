"""Trips found in folders: names, labels, duplicates, missing files."""

import hashlib
import os
import pickle
import re
import shutil

import pytest

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Label, Recording
from ldctoolkit.recordings.sources import RecordingPart, RecordingReader, RecordingSource
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


def test_the_protocols(root):
    source = READER.open([root])
    assert isinstance(READER, RecordingReader)
    assert isinstance(source, RecordingSource)
    assert all(isinstance(part, RecordingPart) for part in source.parts)
    assert (READER.name, READER.vehicle_width, READER.step) == ("uah-driveset", 1.8, 0.1)


def test_root_driver_trip_or_file(root):
    source = READER.open([root])
    assert ([part.key for part in source.parts], source.problems) == (sorted(NAMES), ())
    assert READER.recognise([root]) == "4 trips of 2 drivers"
    assert READER.recognise([root.parent]) == "4 trips of 2 drivers"
    d1 = READER.open([root / "D1"])
    assert [part.key for part in d1.parts] == sorted(name for name in NAMES if "-D1-" in name)
    one = sorted(NAMES)[0]
    for path in (root / "D1" / one, root / "D1" / one / LANE, root / "D1" / one / GPS):
        assert READER.open([path]).parts == source.parts[:1]
        assert READER.recognise([path]) == "1 trip of 1 driver"
    # given twice, one way or another, is read once
    again = READER.open([root / "D1" / one, root / "D2", root])
    assert (sorted(part.key for part in again.parts), again.problems) == (sorted(NAMES), ())


def test_a_folder_of_here(root, monkeypatch):
    from pathlib import Path

    monkeypatch.chdir(root / "D1" / sorted(NAMES)[0])
    (part,) = READER.open([Path()]).parts
    assert part == READER.open([root]).parts[0]


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
        f"D1/{first}/{LANE}: is missing; without the offset from the lane's centre the trip is left out",
        f"D1/{second}/{GPS}: is missing; without the speed the trip is left out",
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


def test_traces_of_archives(root):
    """A folder of the same name inside, a Mac's shadow folders, other cases of letters."""
    first, second = sorted(NAMES)[:2]
    (root / "D1" / first).rename(root / "inner")
    (root / "D1" / first).mkdir()
    (root / "inner").rename(root / "D1" / first / first)
    shadow = root / "__MACOSX" / "D1" / second
    shadow.mkdir(parents=True)
    (shadow / f"._{LANE}").write_bytes(b"\0\5\x16\7")
    (root / "D1" / second / LANE).rename(root / "D1" / second / LANE.lower())
    source = READER.open([root])
    assert ([part.key for part in source.parts], source.problems) == (sorted(NAMES), ())
    assert all(isinstance(item, Recording) for part in source.parts for item in part.read())


def test_what_is_no_trip(root, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "drive.csv").write_text("recording,t\n")
    gone = tmp_path / "gone"
    others = [tmp_path / "other", tmp_path / "drive.csv", gone, tmp_path / "a\0b"]
    for path in others:
        assert READER.recognise([path]) == ""
        with pytest.raises(RecordingError, match="no trip of UAH-DriveSet that can be used"):
            READER.open([path])
    source = READER.open([*others, root])
    assert len(source.parts) == 4
    assert [problem.file for problem in source.problems] == ["other", "drive.csv", "gone", "a\\x00b"]
    assert source.problems[2].what == "does not exist"
    with pytest.raises(RecordingError, match=r"^other, gone: no trip .*; other: holds no trip: .* \(1 more\)$"):
        READER.open([others[0], gone])


def test_only_trips_that_cannot_be_used(root):
    for name, (driver, _, _) in NAMES.items():
        (root / driver / name / LANE).unlink()
    assert READER.recognise([root]) == "4 trips of 2 drivers"
    with pytest.raises(RecordingError, match=r"PROC_LANE_DETECTION\.txt: is missing; .* \(3 more\)$"):
        READER.open([root])


@pytest.mark.skipif(os.name != "posix", reason="links and bytes in names are those of POSIX")
def test_links_and_odd_names(root):
    (root / "D1" / "loop").symlink_to(root)
    (root / "again").symlink_to(root / "D2")
    odd = os.fsencode(root / "D1") + b"/20151110175713-16km-D1-NORMAL\xff-SECONDARY"
    small(root / "D1" / "odd", 8)
    (root / "D1" / "odd").rename(os.fsdecode(odd))
    source = READER.open([root])
    found = [item for part in source.parts for item in part.read()]
    assert all(isinstance(item, Recording) for item in found)
    names = {one.name for one in found} - set(NAMES)
    assert len(found) == len(NAMES) + 1
    assert re.fullmatch(r"20151110175713-16km-D1-NORMAL\\udcff-SECONDARY \([0-9a-f]{8}\)", names.pop())
