"""What is wrong with a table is named by file and line; the rest is read."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers import spmd
from helpers.recordings import read_source
from ldctoolkit.errors import LdcError, RecordingError
from ldctoolkit.recordings import Criteria, Preparation, Recording, extract_part
from ldctoolkit.recordings.spmd_das1 import ALONE, READER

ROWS = 120  # rows of each of the three trips 7/1, 7/2, 7/3; trip k begins in line 2 + 120 (k - 1)


@pytest.fixture
def tables(tmp_path: Path) -> tuple[Path, Path]:
    return spmd.write_tables(tmp_path, [spmd.planted_drive(7, trip, rows=ROWS) for trip in (1, 2, 3)])


def read(*paths: Path) -> tuple[dict[str, Recording], list[str]]:
    recordings, problems = read_source(READER.open(paths))
    return {r.name: r for r in recordings}, [str(problem) for problem in problems]


def edit(path: Path, change: Callable[[list[bytes]], None]) -> None:
    lines = path.read_bytes().split(b"\r\n")
    change(lines)
    path.write_bytes(b"\r\n".join(lines))


def samples(recordings: dict[str, Recording]) -> list[int]:
    return [recordings[name].samples if name in recordings else 0 for name in ("7/1", "7/2", "7/3")]


def put(line: int, text: bytes) -> Callable[[list[bytes]], None]:
    def change(lines: list[bytes]) -> None:
        lines[line - 1] = text

    return change


LINE_FAULTS = [
    (b"7,2,500,-1.5,1.5,0,3", "7 cells; allowed: 8"),
    (b"7,2,500,-1.5,1.5,0,3,3,9", "9 cells; allowed: 8"),
    (b"7,2,500,-1.5,far,0,3,3", "column 'LaneDistanceRight' holds 'far'; allowed: numbers"),
    (b"7,2,500,-1.5,1;5,0,3,3", "column 'LaneDistanceRight' holds '1;5'; allowed: numbers"),
    (b"7,2,500,-1.5,1.5,\xff\xfe,3,3", "the text is not UTF-8"),
    (b"7,2,,-1.5,1.5,0,3,3", "column 'Time' holds no usable time"),
    (b"7,2,NULL,-1.5,1.5,0,3,3", "column 'Time' holds no usable time"),
    (b"7,2,1e300,-1.5,1.5,0,3,3", "column 'Time' holds no usable time"),
    (b"seven,2,500,-1.5,1.5,0,3,3", "it begins with 'seven,2'; allowed: numbers of device and trip"),
    (b",,,,,,,", "it begins with ','; allowed: numbers of device and trip"),
    (b"7;2;500;-1.5;1.5;0;3;3", "it begins with '7;2;500;-1.5;1.5;0;3;3'"),
    (b"Device,Trip,Time,LaneDistanceLeft,LaneDistanceRight,LaneHeading", "it begins with 'Device,Trip'"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), LINE_FAULTS)
def test_a_line_that_cannot_be_used(tables: tuple[Path, Path], text: bytes, words: str) -> None:
    clean, _ = read(*tables)
    edit(tables[0], put(171, text))  # row 49 of trip 7/2
    recordings, problems = read(*tables)
    assert samples(recordings) == [ROWS, ROWS - 1, ROWS]
    (problem,) = problems
    assert problem.startswith("DataLane.csv, line 171: ")
    assert words in problem
    assert problem.endswith("the line is left out")
    for name, recording in recordings.items():
        keep = np.delete(np.arange(ROWS), 49) if name == "7/2" else np.arange(ROWS)
        np.testing.assert_array_equal(recording.t, clean[name].t[keep])
        np.testing.assert_array_equal(recording.lane_offset, clean[name].lane_offset[keep])
        np.testing.assert_array_equal(recording.speed, clean[name].speed[keep])


def test_lines_are_right_behind_blank_and_faulty_lines(tables: tuple[Path, Path]) -> None:
    def change(lines: list[bytes]) -> None:
        lines[200] = b"7,2,1990,far,1.5,0,3,3"
        lines[150] = b"x"
        lines[100:100] = [b"", b"  ", b""]

    edit(tables[0], change)
    _, problems = read(*tables)
    assert [problem.split(":")[0] for problem in problems] == ["DataLane.csv, line 154", "DataLane.csv, line 204"]


def test_a_file_that_ends_inside_a_line(tables: tuple[Path, Path]) -> None:
    for path, cells in ((tables[0], 8), (tables[1], 27)):
        path.write_bytes(path.read_bytes().rsplit(b",", 3)[0])
        _, problems = read(*tables)
        words = f"{path.name}, line 361: {cells - 3} cells; allowed: {cells}; the line is left out"
        assert problems[-1] == words
    recordings, _ = read(*tables)
    assert samples(recordings) == [ROWS, ROWS, ROWS - 1]


@pytest.mark.parametrize(
    ("times", "line", "words"),
    [
        ({50: 99999}, 172, "99999 to 510"),  # one row that jumps ahead
        ({50: 510, 51: 500}, 173, "510 to 500"),  # two rows changed places
        (dict.fromkeys(range(50, 53), 300), 172, "490 to 300"),
        ({50: 90000, 80: 100}, 172, "90000 to 510"),  # one ahead, one behind
    ],
)
def test_time_that_runs_backwards(tables: tuple[Path, Path], times: dict[int, int], line: int, words: str) -> None:
    def change(lines: list[bytes]) -> None:
        for row, time in times.items():
            lines[1 + ROWS + row] = b"7,2,%d,%b" % (time, lines[1 + ROWS + row].split(b",", 3)[3])

    edit(tables[0], change)
    recordings, (problem,) = read(*tables)
    assert problem.startswith(f"DataLane.csv, line {line}: trip 7/2: the time runs backwards from {words}; ")
    assert samples(recordings) == [ROWS, ROWS - (1 if 510 in times.values() else len(times)), ROWS]


def test_of_a_trip_in_two_files_the_first_ones_rows_are_taken(tables: tuple[Path, Path], tmp_path: Path) -> None:
    """A table of one day is part of a larger one, and both are given."""
    clean, _ = read(*tables)
    again = tmp_path / "DataLane_again.csv"
    again.write_bytes(spmd.text_of(spmd.lane_frame([spmd.planted_drive(7, trip, rows=50) for trip in (2, 4)])))
    wsu_again = tmp_path / "DataWsu_again.csv"
    wsu_again.write_bytes(spmd.text_of(spmd.wsu_frame([spmd.planted_drive(7, 3, rows=50)])))
    recordings, problems = read(*tables, again, wsu_again)
    assert [r.samples for r in recordings.values()] == [ROWS] * 3 + [50]
    assert problems == [
        "DataLane_again.csv, line 2: trip 7/2 is also in DataLane.csv, line 122; these rows are left out",
        "DataWsu_again.csv, line 2: trip 7/3 is also in DataWsu.csv, line 242; these rows are left out",
    ]
    for name, recording in clean.items():
        np.testing.assert_array_equal(recordings[name].lane_offset, recording.lane_offset)
        np.testing.assert_array_equal(recordings[name].speed, recording.speed)
    assert recordings["7/4"].notes == (ALONE,)
    recordings, problems = read(again, *tables)  # the order in which they are given says which is the first
    assert {name: r.samples for name, r in recordings.items()} == {"7/1": ROWS, "7/2": 50, "7/3": ROWS, "7/4": 50}
    assert problems == [
        "DataLane.csv, line 122: trip 7/2 is also in DataLane_again.csv, line 2; these rows are left out"
    ]


@pytest.mark.parametrize("which", [0, 1])
def test_pieces_in_any_order_are_put_together_by_time(tables: tuple[Path, Path], which: int) -> None:
    clean, _ = read(*tables)

    def change(lines: list[bytes]) -> None:
        a, b, c = (lines[1 + i * ROWS : 1 + (i + 1) * ROWS] for i in range(3))
        lines[1:] = [*a[80:], *b[50:], *a[:30], *c, *b[:50], *a[30:80], *lines[1 + 3 * ROWS :]]

    edit(tables[which], change)
    recordings, problems = read(*tables)
    file = tables[which].name
    assert [problem.partition(";")[0] for problem in problems] == [
        f"{file}, line 112: trip 7/1 goes on here, its rows begin in line 2",
        f"{file}, line 262: trip 7/2 goes on here, its rows begin in line 42",
    ]
    assert samples(recordings) == [ROWS] * 3
    for name, clean_recording in clean.items():
        for column in ("t", "lane_offset", "speed", "yaw_rate"):
            np.testing.assert_array_equal(getattr(recordings[name], column), getattr(clean_recording, column))


def test_trips_without_a_partner(tables: tuple[Path, Path]) -> None:
    drives = [spmd.planted_drive(7, trip, rows=3) for trip in range(1, 41)]
    tables[0].write_bytes(spmd.text_of(spmd.lane_frame(drives)))
    recordings, problems = read(*tables)
    assert (problems, list(recordings)) == ([], [f"7/{trip}" for trip in range(1, 41)])
    for trip, recording in enumerate(recordings.values(), 1):
        finite = trip <= 3  # of the others nothing can be used, but they are counted
        assert recording.samples == 3
        assert np.isfinite(recording.speed).all() == np.isfinite(recording.yaw_rate).all() == finite
        assert recording.notes == (() if finite else (ALONE,))
    # rows of the other table alone are nothing unusual
    spmd.write_tables(tables[0].parent, [spmd.planted_drive(7, 1, rows=30)])
    tables[1].write_bytes(spmd.text_of(spmd.wsu_frame(drives)))
    assert read(*tables)[1] == []


def test_tables_whose_clocks_never_meet(tables: tuple[Path, Path]) -> None:
    drives = [spmd.planted_drive(7, trip, first=9000 * (trip == 2), rows=ROWS) for trip in (1, 2, 3)]
    tables[1].write_bytes(spmd.text_of(spmd.wsu_frame(drives)))
    recordings, problems = read(*tables)
    assert samples(recordings) == [ROWS, 0, ROWS]
    assert problems == [
        "DataLane.csv, line 122: trip 7/2: no row of DataWsu.csv lies within 5 centiseconds of any of its rows; "
        "it is left out"
    ]


def test_swapped_files(tables: tuple[Path, Path]) -> None:
    lane, wsu = (path.read_bytes() for path in tables)
    tables[0].write_bytes(wsu)
    tables[1].write_bytes(lane)
    recordings, problems = read(*tables)
    assert samples(recordings) == [ROWS] * 3
    assert problems == [
        "DataLane.csv: the columns are those of DataWsu, the name is not; read as DataWsu. Are two files swapped?",
        "DataWsu.csv: the columns are those of DataLane, the name is not; read as DataLane. Are two files swapped?",
    ]


FILE_FAULTS = [
    (lambda text: b"", "the file is empty"),
    (lambda text: text.replace(b",", b";"), "the columns are separated by semicolons; allowed: commas"),
    (lambda text: text.replace(b",", b"\t"), "the columns are separated by tabs; allowed: commas"),
    (lambda text: text.decode("utf-8-sig").encode("utf-16"), "UTF-16"),
    (lambda text: text.decode("utf-8-sig").encode("utf-16-le"), "UTF-16"),
    (lambda text: text.replace(b"Device", b"D\xffvice", 1), "the text is not UTF-8"),
    (gzip.compress, "the content is gzip"),
    (lambda text: b"PK\x03\x04" + text, "the content is a ZIP archive"),
    (lambda text: text.replace(b"LaneQualityLeft", b"LaneQualtyLeft"), "did you mean 'LaneQualtyLeft'?"),
    (lambda text: text.replace(b"LaneHeading", b"Time"), "column 'Time' appears 2 times"),
    (lambda text: text.replace(b"Device,Trip,Time", b"Time,Trip,Device"), "the first columns are Time, Trip"),
    (lambda text: text.split(b"\n", 1)[1], "neither the columns of DataLane nor those of DataWsu: 7, 1, 0"),
    (lambda text: b"x" * 100_000, "the first line is longer than"),
]


@pytest.mark.parametrize(("spoil", "words"), FILE_FAULTS)
def test_a_file_that_cannot_be_used(tables: tuple[Path, Path], spoil: Callable[[bytes], bytes], words: str) -> None:
    """It is left out, and said; another lane table is still read. In a folder its name tells that it was meant."""
    lane = tables[0]
    good = lane.with_name("good.csv")
    good.write_bytes(lane.read_bytes())
    lane.write_bytes(spoil(lane.read_bytes()))
    for paths in ([lane, good, tables[1]], [lane.parent]):
        recordings, problems = read(*paths)
        assert samples(recordings) == [ROWS] * 3
        (problem,) = problems
        assert problem.startswith("DataLane.csv")
        assert words in problem
        assert problem.endswith("left out")
    with pytest.raises(RecordingError, match="no table DataLane") as error:
        READER.open([lane, tables[1]])
    assert words in str(error.value)


def test_a_file_that_changes_between_looking_and_reading(tables: tuple[Path, Path]) -> None:
    source = READER.open(tables)
    tables[0].write_bytes(tables[0].read_bytes() + b"7,9,0,-1.5,1.5,0,3,3\r\n")
    with pytest.raises(LdcError, match=r"DataLane.csv: the file has changed since it was looked through"):
        list(source.parts[0].read())
    result = extract_part(source.parts[0], Criteria(), Preparation())
    assert "the file has changed" in result.problems[0].what
