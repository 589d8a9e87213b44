"""The SPMD table HV_Primary."""

import dataclasses
import math
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from helpers import spmd
from helpers.bits import examples
from helpers.planted import assert_planted
from helpers.recordings import read_source
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.extract import extract_departures
from ldctoolkit.recordings.recording import Problem, Recording, open_recordings
from ldctoolkit.recordings.spmd_das2 import READER

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
    recordings, problems = read_source(READER.open(paths))
    assert len({r.name for r in recordings}) == len(recordings)
    return {r.name: r for r in recordings}, problems


def lines_of(trip: int, rows: int = 30, cells: int = 53, **columns: Any) -> list[str]:
    lines: list[str] = spmd.lines_of(spmd.rows_of(spmd.planted_drive(10, trip, rows=rows), **columns), cells)
    return lines


def test_the_sample_loads_in_both_shapes(sample: Path) -> None:
    one_day, two_month = sample / "one-day" / "HV_Primary_04_11_13.csv", sample / "two-month" / "HV_Primary.csv"
    recordings, problems = read(one_day, two_month)
    assert problems == []
    assert {name: r.samples for name, r in recordings.items()} == {"10/1417759": 19, "10/1417715": 1, "10/412198": 19}
    with_header, without = recordings["10/1417759"], recordings["10/412198"]
    # by hand from the first rows
    np.testing.assert_allclose(with_header.t, np.arange(19) * 0.1)
    np.testing.assert_allclose([with_header.lane_offset[0], with_header.lane_width[0]], [0.8585, 4.277])
    np.testing.assert_allclose([without.lane_offset[0], without.lane_width[0]], [0.297, 3.56])
    np.testing.assert_allclose([with_header.speed[0], without.speed[0]], [8.194445, 16.655556])
    np.testing.assert_allclose(without.yaw_rate[0], np.radians(0.031525), rtol=1e-9)
    np.testing.assert_allclose(without.heading[0], -np.radians(140.720001))
    # the tracker sees one marker at most there
    assert not any(r.valid.any() for r in recordings.values())
    assert np.isnan(recordings["10/1417715"].speed).all()


def test_other_tables_are_not_recognised(sample: Path, tmp_path: Path) -> None:
    other_tables = [path for path in sorted(sample.rglob("*.csv")) if "HV_Primary" not in path.name]
    assert other_tables
    assert [READER.recognise([path]) for path in other_tables] == [""] * len(other_tables)
    assert READER.recognise([tmp_path / "none.csv", tmp_path]) == ""


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
    drives = [dataclasses.replace(r, time=np.asarray(r.time) + 7) for r in drives]  # no multiples of the step
    rows = [line for r in drives for line in spmd.lines_of(spmd.rows_of(r), cells)]
    if mixed:
        rows[::3] = [row + ",NULL" * 8 for row in rows[::3]]
    if how.pop("header45", False):
        rows, how["header"] = [",".join(spmd.COLUMNS[:45]), *rows], False
    path = write([spmd.ODD_FIRST] * odd + rows, **how)
    opened = open_recordings([path])
    assert opened.reader.name == "spmd-das2"
    extraction = extract_departures(opened)
    assert extraction.problems == ()
    departures = extraction.departures
    for i, drive in enumerate(drives):
        of_drive = departures.take(slice(8 * i, 8 * i + 8))
        assert set(of_drive.recording) == {f"{drive.device}/{drive.trip}"}
        assert_planted(of_drive, spmd.PLANTED, spmd.curvature_at, clock=drive.time[0] / 100.0)
    assert departures.n == 24
    assert [words for words in extraction.warnings if "yaw" in words] == []


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
    recording = read(write(lines_of(1, **cells)))[0]["10/1"]
    np.testing.assert_array_equal(recording.speed, [10.5] * 28 + [np.nan, 11.5])
    assert (recording.turn_signal[:4].tolist(), np.isnan(recording.heading).sum()) == ([0, 1, -1, 0], 9)


def test_without_a_header_most_of_the_first_lines_must_look_right(write: Write) -> None:
    good, other_rows = lines_of(1, cells=45), ["1,1,0,-1.8,1.8,0,3,3"] * 30
    with pytest.raises(RecordingError, match="rows of 45 or 53 cells"):
        read(write([*good[:9], *other_rows], header=False))
    recordings, problems = read(write([*other_rows[:9], *good], header=False))
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


NUMBER = st.sampled_from(
    ["0", "1", "-1483.0", "2077.0", "3.1524999999999997E-2", " 3600 ", "499", "500", "900", "NULL", "", "  ", "15   ",
     "nan", "-1800", "1800", "3600", "1e308", "-inf", "-2e9"]
)  # fmt: skip
CELL = NUMBER | st.sampled_from(["x", "1;2", "1_0", "0x1", "--1", "é"])
PLACES = {
    "time": 2, "heading": 6, "gps_speed": 11, "gps_valid": 13, "speed": 20, "signal_left": 26, "signal_right": 27,
    "yaw_rate": 29, "left": 32, "right": 33, "width": 34, "p_left": 35, "p_right": 36,
}  # fmt: skip


@st.composite
def rows(draw: st.DrawFn) -> list[str]:
    """Some lines of one to three trips, with odd cells here and there, some cells too many or too few."""
    lines = []
    for i in range(draw(st.integers(1, 8))):
        cells = ["0"] * draw(st.sampled_from([45, 45, 53, 53, 44, 46, 52]))
        cells[:3] = [str(draw(st.integers(1, 2))), "7", str(100 * i)]
        for column in PLACES.values():
            if draw(st.integers(0, 3)):
                cells[column] = draw(NUMBER if draw(st.integers(0, 9)) else CELL) if column != 2 else cells[2]
        if not draw(st.integers(0, 9)):
            cells[2] = draw(CELL)
        lines.append(",".join(cells))
    return lines


def number(text: str) -> float | None:
    """What a cell holds, by plain Python; None for a word."""
    text = text.strip()
    if text.lower() in ("", "null", "nan"):
        return math.nan
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def by_hand(lines: list[str]) -> tuple[dict[str, list[tuple[float, ...]]], set[int]]:
    """Samples of each trip, and numbers of the lines that are left out (times that run backwards aside)."""
    trips: dict[str, list[tuple[float, ...]]] = {}
    faulty = set()
    lost: set[str] = set()  # trips that the line before was left out of
    for i, line in enumerate(lines, start=2):
        cells = line.split(",")
        name = f"{cells[0]}/{cells[1]}"
        values = {name: number(cells[column]) for name, column in PLACES.items() if column < len(cells)}
        if len(cells) not in (45, 53) or None in values.values() or not abs(values["time"]) < 1e11:  # type: ignore[arg-type]
            faulty.add(i)
            lost.add(name)
            continue
        v: Any = {
            name: x if name == "time" or abs(x) < 1e9 else math.nan  # type: ignore[arg-type]
            for name, x in values.items()
        }
        width = (v["right"] - v["left"]) / 1000
        valid = v["p_left"] >= 500 and v["p_right"] >= 500 and width > 0
        if v["width"] > 0 and not abs(width - v["width"] / 1000) <= 0.5:
            valid = False
        gps = v["gps_valid"] == 1
        speed = v["speed"] if not math.isnan(v["speed"]) else v["gps_speed"] if gps else math.nan
        cut = name in lost and name in trips
        lost.discard(name)
        trips.setdefault(name, []).append(
            (
                v["time"] / 1000, (v["left"] + v["right"]) / 2000, width, speed, valid, math.radians(v["yaw_rate"]),
                -math.radians(v["heading"]) if gps else math.nan, (v["signal_left"] > 0) - (v["signal_right"] > 0),
                cut,
            )
        )  # fmt: skip
    return trips, faulty


@examples(150, suppress_health_check=[HealthCheck.too_slow])
@given(rows(), st.sampled_from(["\n", "\r\n"]), st.booleans(), st.integers(1, 3000))
def test_against_plain_python(lines: list[str], end: str, ended: bool, part_bytes: int) -> None:
    expected, faulty = by_hand(lines)
    text = spmd.HEADER + end + end.join(lines) + end * ended
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "HV_Primary.csv")
        path.write_bytes(text.encode())
        source = dataclasses.replace(READER, part_bytes=part_bytes).open([path])
        items = [item for part in source.parts for item in part.read()]
    recordings = {item.name: item for item in items if isinstance(item, Recording)}
    reported = [*source.problems, *(item for item in items if isinstance(item, Problem))]
    assert {
        problem.place for problem in reported if "backwards" not in problem.what and "goes on here" not in problem.what
    } == {f"line {line}" for line in faulty}
    assert set(recordings) <= set(expected)
    for name, samples in expected.items():
        t = [sample[0] for sample in samples]
        if t != sorted(t):
            # whole pieces of a trip are put in order; otherwise a trip of so few rows goes as a whole
            assert name not in recordings or np.allclose(recordings[name].t, sorted(t), rtol=1e-12, atol=1e-12)
            continue
        recording = recordings[name]
        cut = np.zeros(len(t), dtype=bool) if recording.cut is None else recording.cut
        if len(set(t)) < len(t):
            cut = np.array([sample[-1] for sample in samples])  # of samples at one time it is not known which
        columns = (
            recording.t,
            recording.lane_offset,
            recording.lane_width,
            recording.speed,
            recording.valid,
            recording.yaw_rate,
            recording.heading,
        )
        for column, values in zip((*columns, recording.turn_signal, cut), zip(*samples, strict=True), strict=True):
            np.testing.assert_allclose(np.asarray(column, float), np.array(values, float), rtol=1e-12, atol=1e-12)
