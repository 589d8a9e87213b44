"""Wherever rows of a trip are left out, or its time does not rise, its recording is cut there."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from helpers import spmd, uah
from helpers.recordings import read_source
from ldctoolkit.recordings import Criteria, Preparation, Recording, extract_part, open_recordings
from ldctoolkit.recordings.departures_table import combined_results

# departures to the left from 8.03 to 10.34 s and to the right from 17.45 to 19.35 s, at 10 Hz
ROWS, LEFT, RIGHT = 300, 92, 184
Lines = list[str]
Change = Callable[[Lines], None]


@dataclasses.dataclass
class FolderExtraction:
    recordings: dict[str, Recording]
    problems: list[str]
    sides: list[int]  # of the departures

    def cut(self, name: str) -> list[int] | None:
        cut = self.recordings[name].cut
        return None if cut is None else np.flatnonzero(cut).tolist()


def extract_folder(folder: Path) -> FolderExtraction:
    opened = open_recordings([folder])
    recordings, problems = read_source(opened.source)
    criteria = Criteria(vehicle_width=opened.reader.vehicle_width)
    result = combined_results(
        extract_part(part, criteria, Preparation(step=opened.reader.step)) for part in opened.source.parts
    )
    return FolderExtraction(
        {r.name: r for r in recordings}, [str(problem) for problem in problems], result.departures.side.tolist()
    )


def edit(path: Path, change: Change) -> None:
    lines = path.read_bytes().decode("latin-1").split("\n")
    change(lines)
    path.write_bytes("\n".join(lines).encode("latin-1"))


def put(rows: Sequence[int], how: str, header: int = 1) -> Change:
    """Lines of some rows of the first trip with a fault in them."""

    def change(lines: Lines) -> None:
        for row in rows:
            line_number = header + row
            device, trip, time, rest = lines[line_number].split(",", 3)
            lines[line_number] = {
                "cells": f"{device},{trip},{time}", "number": f"{device},{trip},{time}x,{rest}",
                "no time": f"{device},{trip},NULL,{rest}", "bytes": f"{device},{trip},{time}\xff,{rest}",
                "key": f"x{device},{trip},{time},{rest}", "behind": f"{device},{trip},{row},{rest}",
                "ahead": f"{device},{trip},{10**8 + row},{rest}",
            }[how]  # fmt: skip

    return change


def das1(folder: Path, drives: Sequence[spmd.Drive]) -> None:
    spmd.write_tables(folder, drives)


def das2(folder: Path, drives: Sequence[spmd.Drive]) -> None:
    lines = [line for r in drives for line in spmd.lines_of(spmd.rows_of(r))]
    (folder / "HV_Primary.csv").write_text("\n".join([spmd.HEADER, *lines, ""]))


FORMATS = {"das1": das1, "das2": das2}
FILES = (("das1", "DataLane.csv"), ("das1", "DataWsu.csv"), ("das2", "HV_Primary.csv"))


def two_trips(folder: Path, kind: str, rows: int = ROWS) -> None:
    FORMATS[kind](folder, [spmd.planted_drive(7, trip, spmd.PLANTED[:2], rows=rows) for trip in (1, 2)])


LOST = [
    ((LEFT,), "cells"), ((RIGHT,), "number"), ((LEFT, LEFT + 1, LEFT + 2), "no time"), ((LEFT, RIGHT), "bytes"),
    ((RIGHT,), "key"), ((LEFT, LEFT + 1), "key"), ((LEFT,), "behind"), ((LEFT, LEFT + 1), "ahead"),
    ((RIGHT, RIGHT + 1), "behind"), ((LEFT, RIGHT), "key"),
]  # fmt: skip


@pytest.mark.parametrize(("rows", "how"), LOST)
@pytest.mark.parametrize(("kind", "file"), [FILES[0], FILES[2]])
def test_rows_of_the_lane_that_are_left_out(
    tmp_path: Path, kind: str, file: str, rows: tuple[int, ...], how: str
) -> None:
    two_trips(tmp_path, kind)
    clean = extract_folder(tmp_path).recordings["7/1"]
    edit(tmp_path / file, put(rows, how))
    extraction = extract_folder(tmp_path)
    expected = {
        (LEFT,): [92], (RIGHT,): [184], (LEFT, LEFT + 1): [92], (RIGHT, RIGHT + 1): [184],
        (LEFT, LEFT + 1, LEFT + 2): [92], (LEFT, RIGHT): [92, 183],
    }[rows]  # fmt: skip
    assert (extraction.cut("7/1"), extraction.cut("7/2")) == (expected, None)
    recording = extraction.recordings["7/1"]
    for column in ("t", "lane_offset", "speed", "valid"):
        np.testing.assert_array_equal(getattr(recording, column), np.delete(getattr(clean, column), rows))
    assert extraction.sides == [*([] if LEFT in rows else [1]), *([] if RIGHT in rows else [-1]), 1, -1]
    assert extraction.problems


@pytest.mark.parametrize(("rows", "how"), LOST)
def test_rows_of_the_other_table_that_are_left_out(tmp_path: Path, rows: tuple[int, ...], how: str) -> None:
    """Samples of the lane between the rows around them are not used."""
    two_trips(tmp_path, "das1")
    edit(tmp_path / "DataWsu.csv", put(rows, how))
    extraction = extract_folder(tmp_path)
    expected = {
        (LEFT,): [92, 93], (RIGHT,): [184, 185], (LEFT, LEFT + 1): [92, 94], (RIGHT, RIGHT + 1): [184, 186],
        (LEFT, LEFT + 1, LEFT + 2): [92, 95], (LEFT, RIGHT): [92, 93, 184, 185],
    }[rows]  # fmt: skip
    assert (extraction.cut("7/1"), extraction.cut("7/2")) == (expected, None)
    recording = extraction.recordings["7/1"]
    assert (recording.samples, np.flatnonzero(~recording.valid).tolist()) == (ROWS, list(rows))
    assert extraction.sides == [*([] if LEFT in rows else [1]), *([] if RIGHT in rows else [-1]), 1, -1]


def test_a_sample_between_rows_of_the_other_table_is_not_used_though_one_is_near(tmp_path: Path) -> None:
    """The other table's clock is half a step ahead, so that two of its rows are as near to a sample of the lane."""
    spmd.write_tables(tmp_path, [spmd.planted_drive(7, 1, spmd.PLANTED[:2], rows=ROWS)], lag=5)
    edit(tmp_path / "DataWsu.csv", put([LEFT], "cells"))
    extraction = extract_folder(tmp_path)
    recording = extraction.recordings["7/1"]
    assert np.isfinite(recording.speed[1:]).all()
    assert (extraction.cut("7/1"), np.flatnonzero(~recording.valid).tolist(), extraction.sides) == (
        [92, 94],
        [92, 93],
        [-1],
    )


@pytest.mark.parametrize("how", ["cells", "key", "no time"])
@pytest.mark.parametrize("rows", [(0,), (0, 1, 2), (ROWS - 1,)])
@pytest.mark.parametrize(("kind", "file"), FILES)
def test_rows_at_the_start_or_end_of_a_trip(
    tmp_path: Path, kind: str, file: str, rows: tuple[int, ...], how: str
) -> None:
    two_trips(tmp_path, kind)
    edit(tmp_path / file, put(rows, how))
    extraction = extract_folder(tmp_path)
    assert (extraction.cut("7/1"), extraction.cut("7/2"), extraction.sides) == (None, None, [1, -1, 1, -1])
    assert len(extraction.problems) == len(rows)


@pytest.mark.parametrize(("kind", "file"), FILES)
def test_nul_bytes_at_the_end(tmp_path: Path, kind: str, file: str) -> None:
    """A blank line is no row."""
    two_trips(tmp_path, kind)
    edit(tmp_path / file, lambda lines: lines.insert(1 + LEFT, ""))
    path = tmp_path / file
    extraction = extract_folder(tmp_path)
    assert extraction.problems == []
    path.write_bytes(path.read_bytes() + bytes(512))
    extraction = extract_folder(tmp_path)
    assert [problem.split(":")[0] for problem in extraction.problems] == [f"{file}, line 603"]
    assert (extraction.cut("7/1"), extraction.cut("7/2"), extraction.sides) == (None, None, [1, -1, 1, -1])


@pytest.mark.parametrize(("kind", "file"), FILES)
def test_a_clock_of_a_trip_that_starts_again(tmp_path: Path, kind: str, file: str) -> None:
    two_trips(tmp_path, kind)
    edit(tmp_path / file, lambda lines: lines.__setitem__(slice(301, 301), lines[101:301]))
    extraction = extract_folder(tmp_path)
    (problem,) = extraction.problems
    assert problem.startswith(f"{file}, line 302: trip 7/1: the time runs backwards from ")
    assert "199 of 500 lines" in problem
    assert (list(extraction.recordings), extraction.cut("7/2"), extraction.sides) == (["7/2"], None, [1, -1])


@pytest.mark.parametrize(("behind", "samples"), [(15, 285), (16, 0)])
@pytest.mark.parametrize(("kind", "file"), [FILES[0], FILES[2]])
def test_the_share_of_rows_in_disorder(tmp_path: Path, kind: str, file: str, behind: int, samples: int) -> None:
    """5 % of 300 are 15."""
    two_trips(tmp_path, kind)
    edit(tmp_path / file, put(range(200, 200 + behind), "behind"))
    extraction = extract_folder(tmp_path)
    assert (extraction.recordings["7/1"].samples if "7/1" in extraction.recordings else 0) == samples
    assert len(extraction.problems) == 1
    if samples:
        assert (extraction.cut("7/1"), extraction.sides) == ([200], [1, -1, 1, -1])


def in_turns(lines: Lines) -> None:
    """Both trips' rows in the order of time, as if they had been sorted by it alone."""
    lines[1:601] = [line for pair in zip(lines[1:301], lines[301:601], strict=True) for line in pair]


@pytest.mark.parametrize(("kind", "file"), FILES)
def test_trips_in_turns_are_not_cut(tmp_path: Path, kind: str, file: str) -> None:
    two_trips(tmp_path, kind)
    edit(tmp_path / file, in_turns)
    extraction = extract_folder(tmp_path)
    assert (extraction.cut("7/1"), extraction.cut("7/2"), extraction.sides) == (None, None, [1, -1, 1, -1])


def test_a_row_lost_where_trips_stand_in_turns(tmp_path: Path) -> None:
    two_trips(tmp_path, "das2")

    def change(lines: Lines) -> None:
        put([LEFT], "cells")(lines)
        put([300 + RIGHT], "number")(lines)
        in_turns(lines)

    edit(tmp_path / "HV_Primary.csv", change)
    extraction = extract_folder(tmp_path)
    assert (extraction.cut("7/1"), extraction.cut("7/2"), extraction.sides) == ([92], [184], [-1, 1])


def test_a_piece_that_changes_its_place_in_time(tmp_path: Path) -> None:
    """The time falls between the pieces, so nothing is joined where they meet."""
    two_trips(tmp_path, "das2")
    edit(
        tmp_path / "HV_Primary.csv",
        lambda lines: lines.__setitem__(slice(1, 601), [*lines[93:301], *lines[301:601], *lines[1:93]]),
    )
    extraction = extract_folder(tmp_path)
    assert (extraction.cut("7/1"), extraction.recordings["7/1"].samples, extraction.sides) == ([92], ROWS, [-1, 1, -1])


# departures to the left from 22.7 to 25.0 s and to the right from 31.05 to 32.95 s
LANE, GPS, YAW = "PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt"
SHOWN = f"D1/{uah.NAME}"


def steady_trip(root: Path) -> Path:
    """Lane and yaw angles at 10 Hz, positions at 1 Hz, each from 0 s: line n + 1 is at n steps."""
    t, second = np.arange(400) / 10.0, np.arange(41.0)
    zeros, ones = np.zeros(t.size), np.ones(t.size)
    yaw = np.mod(uah.yaw_at(t) + np.pi, 2.0 * np.pi) - np.pi
    course = np.mod(np.degrees(-uah.yaw_at(second)) + 180.0, 360.0)
    gps = [second, 3.6 * uah.speed_at(second), 40.5 + 0 * second, -3.4 + 0 * second, *[second] * 3, course]
    return uah.Trip(
        np.column_stack([t, -uah.offset_at(t), zeros, uah.LANE_WIDTH * ones, 2.0 * ones]),
        np.column_stack(gps),
        np.column_stack([t, ones, *[zeros] * 8, yaw]),
    ).write(root)


def spoil(rows: Sequence[int], how: str) -> Change:
    def change(lines: Lines) -> None:
        for row in rows:
            time, rest = lines[row].split(" ", 1)
            lines[row] = {
                "short": time, "word": f"{time} x{rest}", "no time": f"NULL {rest}", "bytes": f"{time} \xff{rest}",
                "behind": f"0.{row} {rest}", "ahead": f"9{row} {rest}", "nul": f"{time} \0\0\0",
            }[how]  # fmt: skip

    return change


def test_uah_without_a_fault(tmp_path: Path) -> None:
    folder = steady_trip(tmp_path)
    extraction = extract_folder(tmp_path)
    assert (extraction.problems, extraction.cut(uah.NAME), extraction.sides) == ([], None, [1, -1])
    for file in (LANE, GPS, YAW):
        (folder / file).write_bytes(b"\xef\xbb\xbf" + (folder / file).read_bytes().replace(b"\n", b"\r\n\r\n"))
    again = extract_folder(tmp_path)
    assert (again.problems, again.cut(uah.NAME)) == ([], None)
    np.testing.assert_array_equal(again.recordings[uah.NAME].yaw_rate, extraction.recordings[uah.NAME].yaw_rate)


UAH_LOST = [
    # file, lines from 0, fault; where the recording is cut, samples between, sides of the departures that stay
    (LANE, (238,), "short", [238], [], [-1]),
    (LANE, (320,), "word", [320], [], [1]),
    (LANE, (238, 239, 240), "bytes", [238], [], [-1]),
    (LANE, (238, 320), "no time", [238, 319], [], []),
    (LANE, (320,), "behind", [320], [], [1]),
    (LANE, (238, 239), "ahead", [238], [], [-1]),
    (GPS, (24,), "short", [231, 250], range(231, 250), [-1]),
    (GPS, (32,), "word", [311, 330], range(311, 330), [1]),
    (GPS, (24, 25), "bytes", [231, 260], range(231, 260), [-1]),
    (GPS, (24, 32), "behind", [231, 250, 311, 330], [*range(231, 250), *range(311, 330)], []),
    (GPS, (24,), "ahead", [231, 250], range(231, 250), [-1]),
    (YAW, (238,), "short", [238, 239], [238], [-1]),
    (YAW, (320, 321), "no time", [320, 322], [320, 321], [1]),
    (YAW, (238,), "behind", [238, 239], [238], [-1]),
    (YAW, (320,), "nul", [320, 321], [320], [1]),
]


@pytest.mark.parametrize(("file", "rows", "how", "cut", "inside", "sides"), UAH_LOST)
def test_lines_of_uah_that_are_left_out(
    tmp_path: Path, file: str, rows: tuple[int, ...], how: str, cut: list[int], inside: Sequence[int], sides: list[int]
) -> None:
    folder = steady_trip(tmp_path)
    edit(folder / file, spoil(rows, how))
    extraction = extract_folder(tmp_path)
    recording = extraction.recordings[uah.NAME]
    assert (extraction.cut(uah.NAME), np.flatnonzero(~recording.valid).tolist()) == (cut, list(inside))
    assert (recording.samples, extraction.sides) == (400 - len(rows) * (file == LANE), sides)
    assert all(problem.startswith(f"{SHOWN}/{file}, line ") for problem in extraction.problems)


@pytest.mark.parametrize(("file", "rows"), [(LANE, (0, 399)), (GPS, (0, 40)), (YAW, (0, 1, 399))])
def test_lines_of_uah_at_the_start_or_end(tmp_path: Path, file: str, rows: tuple[int, ...]) -> None:
    folder = steady_trip(tmp_path)
    edit(folder / file, spoil(rows, "short"))
    extraction = extract_folder(tmp_path)
    assert (len(extraction.problems), extraction.cut(uah.NAME), extraction.sides) == (len(rows), None, [1, -1])


@pytest.mark.parametrize(("file", "lines"), [(LANE, 400), (GPS, 41), (YAW, 400)])
def test_nul_bytes_at_the_end_of_uah(tmp_path: Path, file: str, lines: int) -> None:
    folder = steady_trip(tmp_path)
    (folder / file).write_bytes((folder / file).read_bytes() + bytes(100_000))
    extraction = extract_folder(tmp_path)
    assert extraction.problems == [f"{SHOWN}/{file}, line {lines + 1}: 100000 NUL bytes; the line is left out"]
    assert (extraction.cut(uah.NAME), extraction.sides) == (None, [1, -1])


def test_uah_in_utf_16(tmp_path: Path) -> None:
    folder = steady_trip(tmp_path)
    (folder / LANE).write_bytes((folder / LANE).read_bytes().decode().encode("utf-16-le"))
    assert extract_folder(tmp_path).problems == [
        f"{SHOWN}/{LANE}: it is UTF-16 text, or no text at all; allowed: UTF-8",
        f"{SHOWN}: without the offset from the lane's centre the trip is left out",
    ]


@pytest.mark.parametrize(
    ("file", "again", "words"),
    [
        (LANE, 300, "line 401: the time runs backwards from 39.9 to 0, and 300 of 700"),
        (GPS, 41, "line 42: the time runs backwards from 40 to 0, and 40 of 82"),
        (YAW, 22, "line 401: the time runs backwards from 39.9 to 0, and 22 of 422"),
    ],
)
def test_a_clock_of_uah_that_starts_again(tmp_path: Path, file: str, again: int, words: str) -> None:
    folder = steady_trip(tmp_path)
    text = (folder / file).read_text()
    (folder / file).write_text(text + "".join(text.splitlines(keepends=True)[:again]))
    extraction = extract_folder(tmp_path)
    assert extraction.problems == [
        f"{SHOWN}/{file}, {words} lines are out of order (allowed: 5 %); the trip is left out"
    ]
    assert (extraction.recordings, extraction.sides) == ({}, [])
