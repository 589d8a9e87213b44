"""The SPMD table HV_Primary."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import spmd
from helpers.planted import assert_planted
from helpers.recordings import read_source
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.extract import extract_departures
from ldctoolkit.recordings.recording import Problem, Recording, open_recordings
from ldctoolkit.recordings.spmd_das2 import SpmdDas2

Write = Callable[..., Path]
BOM = b"\xef\xbb\xbf"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def to_file(
        lines: Sequence[str], name: str = "HV_Primary.csv", *, header: bool = True, start: bytes = b"",
        end: str = "\r\n",
    ) -> Path:  # fmt: skip
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        head = [",".join(spmd.COLUMNS)] if header else []
        path.write_bytes(start + "".join(line + end for line in [*head, *lines]).encode())
        return path

    return to_file


def read(*paths: Path) -> tuple[dict[str, Recording], list[Problem]]:
    """All recordings by name, and all problems."""
    recordings, problems = read_source(SpmdDas2().open(paths))
    assert len({one.name for one in recordings}) == len(recordings)
    return {one.name: one for one in recordings}, problems


def lines_of(trip: int, rows: int = 30, cells: int = 53, **more: Any) -> list[str]:
    found: list[str] = spmd.lines_of(spmd.rows_of(spmd.planted_drive(10, trip, rows=rows), **more), cells)
    return found


def test_the_sample_loads_in_both_shapes(sample: Path) -> None:
    one_day, two_month = sample / "one-day" / "HV_Primary_04_11_13.csv", sample / "two-month" / "HV_Primary.csv"
    recordings, problems = read(one_day, two_month)
    assert problems == []
    assert {name: one.samples for name, one in recordings.items()} == {
        "10/1417759": 19,
        "10/1417715": 1,
        "10/412198": 19,
    }
    with_header, without = recordings["10/1417759"], recordings["10/412198"]
    # by hand from the first rows
    np.testing.assert_allclose(with_header.t, np.arange(19) * 0.1)
    np.testing.assert_allclose([with_header.lane_offset[0], with_header.lane_width[0]], [0.8585, 4.277])
    np.testing.assert_allclose([without.lane_offset[0], without.lane_width[0]], [0.297, 3.56])
    np.testing.assert_allclose([with_header.speed[0], without.speed[0]], [8.194445, 16.655556])
    np.testing.assert_allclose(without.yaw_rate[0], np.radians(0.031525), rtol=1e-9)
    np.testing.assert_allclose(without.heading[0], -np.radians(140.720001))
    # the tracker sees one marker at most there
    assert not any(one.valid.any() for one in recordings.values())
    assert np.isnan(recordings["10/1417715"].speed).all()


def test_other_tables_are_not_recognised(sample: Path, tmp_path: Path) -> None:
    others = [one for one in sorted(sample.rglob("*.csv")) if "HV_Primary" not in one.name]
    assert others
    assert [SpmdDas2().recognise([one]) for one in others] == [""] * len(others)
    assert SpmdDas2().recognise([tmp_path / "none.csv", tmp_path]) == ""


SHAPES = {
    "header, 53 cells": {},
    "header, 45 cells": {"header45": True, "cells": 45},
    "no header": {"header": False, "cells": 45, "odd": True},
    "no header, mixed, byte order mark, LF": {"header": False, "cells": 45, "mixed": True, "start": BOM, "end": "\n"},
    "header, byte order mark": {"start": BOM},
}


@pytest.mark.parametrize("shape", SHAPES)
def test_planted_departures_come_back(shape: str, write: Write) -> None:
    how: dict[str, Any] = dict(SHAPES[shape])
    cells, odd, mixed = how.pop("cells", 53), how.pop("odd", False), how.pop("mixed", False)
    drives = [spmd.planted_drive(10, 1), spmd.planted_drive(10, 2, first=-7), spmd.planted_drive(11, 1)]
    drives = [dataclasses.replace(one, time=np.asarray(one.time) + 7) for one in drives]  # no multiples of the step
    rows = [line for one in drives for line in spmd.lines_of(spmd.rows_of(one), cells)]
    if mixed:
        rows[::3] = [row + ",NULL" * 8 for row in rows[::3]]
    if how.pop("header45", False):
        rows, how["header"] = [",".join(spmd.COLUMNS[:45]), *rows], False
    path = write([spmd.ODD_FIRST] * odd + rows, **how)
    opened = open_recordings([path])
    assert opened.reader.name == "spmd-das2"
    found = extract_departures(opened)
    assert found.problems == ()
    departures = found.departures
    for i, drive in enumerate(drives):
        of_drive = departures.take(slice(8 * i, 8 * i + 8))
        assert set(of_drive.recording) == {f"{drive.device}/{drive.trip}"}
        assert_planted(of_drive, spmd.PLANTED, spmd.curvature_at, clock=drive.time[0] / 100.0)
    assert departures.n == 24
    assert [words for words in found.warnings if "yaw" in words] == []


def test_what_is_usable(write: Write) -> None:
    left = [900] * 30
    right, width = list(left), [f"{3600.0}"] * 30
    left[3], left[4], right[5], right[6] = 499, 500, 0, "NULL"  # type: ignore[call-overload]
    width[7], width[8], width[9], width[10] = "3050.0", "3150", "NULL", "4150.0"
    lines = lines_of(
        1, LaneTrack_Probability_Left_Exist=left, LaneTrack_Probability_Right_Exists=right,
        LaneTrack_Lane_Width=width,
    )  # fmt: skip
    recordings, problems = read(write(lines))
    assert (problems, np.flatnonzero(~recordings["10/1"].valid).tolist()) == ([], [3, 5, 6, 7, 10])


def test_speed_signals_and_heading(write: Write) -> None:
    cells: dict[str, list[Any]] = {
        "InVehicle_Longitudinal_Speed": [10.5] * 28 + ["NULL", ""], "GPS_Speed": [11.5] * 30,
        "GPS_Valid": [1] * 20 + [0] * 9 + [1], "InVehicle_Turn_Signal_Left": [1, 1, 0] + [0] * 27,
        "InVehicle_Turn_Signal_Right": [1, 0, 1] + [0] * 27,
    }  # fmt: skip
    one = read(write(lines_of(1, **cells)))[0]["10/1"]
    np.testing.assert_array_equal(one.speed, [10.5] * 28 + [np.nan, 11.5])
    assert (one.turn_signal[:4].tolist(), np.isnan(one.heading).sum()) == ([0, 1, -1, 0], 9)


def check(problems: list[Problem], place: str, words: str) -> None:
    assert any(one.place == place and words in one.what for one in problems), [str(one) for one in problems]


def changed(lines: list[str], row: int, column: int, value: str) -> None:
    cells = lines[row].split(",")
    cells[column] = value
    lines[row] = ",".join(cells)


FAULTS: dict[str, tuple[Callable[[list[str]], None], str, str]] = {
    "text for a number": (lambda rows: changed(rows, 4, 32, "far"), "line 6", "'far'"),
    "a surplus cell": (lambda rows: changed(rows, 4, 3, "1,2"), "line 6", "54 cells"),
    "cut short": (lambda rows: rows.__setitem__(29, rows[29][:60]), "line 31", "cells"),
    "no time": (lambda rows: changed(rows, 4, 2, "NULL"), "line 6", "time"),
    "time backwards": (lambda rows: changed(rows, 20, 2, "55"), "line 22", "backwards"),
    "no trip": (lambda rows: changed(rows, 4, 1, "x"), "line 6", "device and trip"),
    "a header again": (lambda rows: rows.__setitem__(4, "DeviceID,Trip,Time"), "line 6", "device and trip"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faulty_lines_are_named_and_the_rest_is_read(fault: str, write: Write) -> None:
    damage, place, words = FAULTS[fault]
    rows = lines_of(1)
    damage(rows)
    recordings, problems = read(write([*rows, *lines_of(2)]))
    check(problems, place, words)
    assert all(one.file == "HV_Primary.csv" for one in problems)
    assert (recordings["10/1"].samples, recordings["10/2"].samples) == (29, 30)


def test_without_a_header_most_of_the_first_lines_must_look_right(write: Write) -> None:
    good, other = lines_of(1, cells=45), ["1,1,0,-1.8,1.8,0,3,3"] * 30
    with pytest.raises(RecordingError, match="rows of 45 or 53 cells"):
        read(write([*good[:9], *other], header=False))
    recordings, problems = read(write([*other[:9], *good], header=False))
    assert recordings["10/1"].samples == 30
    assert {problem.what.split(";")[0] for problem in problems} == {"8 cells"}


def test_columns_that_are_not_needed_may_be_missing(write: Write) -> None:
    rows = [
        {name: cell for name, cell in row.items() if name not in ("InVehicle_Yaw_Rate", "GPS_Valid")}
        for row in spmd.rows_of(spmd.planted_drive(10, 1, rows=30))
    ]
    path = write([",".join(rows[0]), *(",".join(row.values()) for row in rows)], header=False)
    recordings, problems = read(path)
    assert problems == []
    assert recordings["10/1"].yaw_rate is None
    assert recordings["10/1"].notes == ("no column InVehicle_Yaw_Rate, GPS_Valid",)
