"""Faulty files given to ``ldc extract``, run as a process: what is wrong is named by file and line, the rest is there.

Every source holds the same three trips, 7/1 to 7/3, with the same eight departures each; faults are done to the second
or third. Rows of a trip are 0.1 s apart and begin with its start, so the row of a time is known.
"""

from __future__ import annotations

import dataclasses
import gzip
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from helpers import das1, das2
from helpers.cli import ldc
from ldctoolkit.recordings import read_departures

ROWS = 1200
TRIPS = ("7/1", "7/2", "7/3")
BETWEEN = 600
"""Row of a trip, at 60 s, with four departures before it and four behind, all of them far away."""

WHOLE, HALF, NONE = 8, 4, 0


DRIVES = [
    # a speed of its own each, else they would be told as one trip repeated
    dataclasses.replace(drive, speed=drive.speed + drive.trip)
    for drive in (das1.planted_drive(7, trip, rows=ROWS) for trip in (1, 2, 3))
]


def table_lines(drives: list) -> list[str]:
    lines = ["recording,t,lane_offset,lane_width,speed,yaw_rate"]
    for one in drives:
        for i in range(len(one.time)):
            numbers = (one.time[i] / 100, one.lane_offset[i], one.lane_width, one.speed[i], one.yaw_rate[i])
            lines.append(f"{one.device}/{one.trip}," + ",".join(f"{x:.5f}" for x in numbers))
    return lines


def das2_lines(drives: list) -> list[str]:
    return [das2.HEADER, *das2.lines_of([row for one in drives for row in das2.rows_of(one)])]


def text(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def make_table(folder: Path, drives: list) -> None:
    (folder / "drives.csv").write_bytes(text(table_lines(drives)))


def make_das1(folder: Path, drives: list) -> None:
    (folder / "DataLane.csv").write_bytes(das1.text_of(das1.lane_frame(drives), crlf=False))
    (folder / "DataWsu.csv").write_bytes(das1.text_of(das1.wsu_frame(drives), crlf=False))


def make_das2(folder: Path, drives: list) -> None:
    (folder / "HV_Primary.csv").write_bytes(text(das2_lines(drives)))


UAH = {name: f"D1/2015111017571{name[-1]}-16km-D1-NORMAL-MOTORWAY" for name in TRIPS}
LANE, GPS, YAW = "PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt"


def make_uah(folder: Path, drives: list) -> None:
    for one in drives:
        trip = folder / UAH[f"{one.device}/{one.trip}"]
        trip.mkdir(parents=True)
        t = one.time / 100.0
        # a little of its own in each trip: equal files would be duplicates
        lane = [f"{a:.2f} {-b:.4f} {one.trip} 3.6 2" for a, b in zip(t, one.lane_offset, strict=True)]
        course = np.degrees(-one.heading) % 360.0
        gps = [
            f"{t[i]:.2f} {3.6 * one.speed[i]:.4f} 40.5 -3.4 600 6 10 {course[i]:.3f} 0 0" for i in range(0, ROWS, 10)
        ]
        yaw = np.angle(np.exp(1j * one.heading))
        angles = [f"{a:.2f} 1 0 0 0 0 0 0 0 0 {b:.5f}" for a, b in zip(t, yaw, strict=True)]
        for name, lines in ((LANE, lane), (GPS, gps), (YAW, angles)):
            (trip / name).write_bytes(text(lines))


MAKE: dict[str, Callable[[Path, list], None]] = {
    "table": make_table,
    "spmd-das1": make_das1,
    "spmd-das2": make_das2,
    "uah-driveset": make_uah,
}


@dataclasses.dataclass(frozen=True)
class Found:
    """What a run of the command gave."""

    code: int
    out: str
    err: str
    counts: dict[str, int]


def extract(folder: Path, source: str, *words: str) -> Found:
    """Run the command on the folder; departures of each trip are compared with those planted."""
    table = folder.parent / "d.parquet"
    chosen = ["--format", source, folder, "-o", table, "--vehicle-width", das1.VEHICLE_WIDTH, "--workers", 1, *words]
    done = ldc("extract", *chosen, cwd=folder.parent)
    assert "Traceback" not in done.stderr
    assert str(folder) not in done.stderr.replace(f"no trip of UAH-DriveSet in {folder}", "")
    counts = dict.fromkeys(TRIPS, 0)
    if table.exists():
        departures, provenance = read_departures(table)
        told = [line for line in done.stderr.splitlines() if line.startswith("ldc: warning: ")]
        assert [f"ldc: warning: {problem}" for problem in provenance.problems] == told[: len(provenance.problems)]
        names = {Path(place).name: name for name, place in UAH.items()}
        recording = np.array([names.get(name, name) for name in departures.recording.tolist()])
        assert set(recording) <= set(TRIPS)
        for name in TRIPS:
            own = departures.take(recording == name)
            counts[name] = own.n
            planted = das1.PLANTED[: own.n]
            assert own.side.tolist() == [one.side for one in planted]
            np.testing.assert_allclose(own.T, [one.T for one in planted], atol=0.1)
            np.testing.assert_allclose(own.d_y, [one.d_y for one in planted], atol=0.01)
            np.testing.assert_allclose(own.start_time, [one.start for one in planted], atol=0.1)
    return Found(done.returncode, done.stdout, done.stderr, counts)


Change = Callable[[Path], None]


def lines_changed(name: str, change: Callable[[list[bytes]], None]) -> Change:
    def act(folder: Path) -> None:
        lines = (folder / name).read_bytes().split(b"\n")
        change(lines)
        (folder / name).write_bytes(b"\n".join(lines))

    return act


def cut(name: str, line: int, cells: int, mark: bytes = b",") -> Change:
    """The file ends inside a line (counted from 1), behind some cells."""

    def change(lines: list[bytes]) -> None:
        lines[line - 1 :] = [mark.join(lines[line - 1].split(mark)[:cells])]

    return lines_changed(name, change)


def swapped(a: str, b: str) -> Change:
    def act(folder: Path) -> None:
        one, other = (folder / a).read_bytes(), (folder / b).read_bytes()
        (folder / a).write_bytes(other)
        (folder / b).write_bytes(one)

    return act


def more_table(drives: list) -> bytes:
    return text(table_lines(drives))


def utf_16(data: bytes) -> bytes:
    return data.decode().encode("utf-16")


def second_folder(folder: Path) -> None:
    """The second trip once more, under another driver."""
    place = folder / UAH["7/2"].replace("D1/", "D2/")
    place.mkdir(parents=True)
    for path in (folder / UAH["7/2"]).iterdir():
        (place / path.name).write_bytes(path.read_bytes())


@dataclasses.dataclass(frozen=True)
class Case:
    """A fault, how it is told, and how many departures of the second and third trip stay."""

    source: str
    fault: str
    change: Change
    told: tuple[str, ...]
    second: int = WHOLE
    third: int = WHOLE


def row(trip: int, index: int) -> int:
    """Line of a row in a table with a header."""
    return 2 + ROWS * (trip - 1) + index


L3 = row(3, BETWEEN)
U2 = UAH["7/2"]

CASES = (
    Case(
        "table", "ends in a line", cut("drives.csv", L3, 3),
        (rf"drives\.csv, line {L3}: the file ends inside",), third=HALF,
    ),
    Case(
        "table", "ends in gzip",
        lambda folder: (folder / "more.csv.gz").write_bytes(gzip.compress(more_table(DRIVES[:1]))[:3000]) and None,
        (r"more\.csv\.gz: broken gzip",),
    ),
    Case(
        "spmd-das1", "ends in a line", cut("DataLane.csv", L3, 4),
        (rf"DataLane\.csv, line {L3}: 4 cells",), third=HALF,
    ),
    Case(
        "spmd-das1", "other table ends in a line", cut("DataWsu.csv", L3, 9),
        (rf"DataWsu\.csv, line {L3}: 9 cells",), third=HALF,
    ),
    Case(
        "spmd-das1", "swapped", swapped("DataLane.csv", "DataWsu.csv"),
        (r"DataLane\.csv: the columns are those of DataWsu", r"DataWsu\.csv: the columns are those of DataLane"),
    ),
    Case(
        "spmd-das2", "ends in a line", cut("HV_Primary.csv", L3, 30),
        (rf"HV_Primary\.csv, line {L3}: 30 cells",), third=HALF,
    ),
    Case(
        "uah-driveset", "ends in a line", cut(f"{U2}/{LANE}", 1 + BETWEEN, 2, b" "),
        (rf"{U2}/{LANE}, line {1 + BETWEEN}: 2 values",), HALF,
    ),
    Case("uah-driveset", "swapped", swapped(f"{U2}/{LANE}", f"{U2}/{GPS}"), (rf"{U2}/{LANE}: ",), NONE),
    Case("uah-driveset", "in two folders", second_folder, (r"D2/\S+: has the same name as D1/",)),
)  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.source}: {case.fault}")
def test_a_fault_is_told_and_the_rest_is_there(case: Case, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    MAKE[case.source](folder, DRIVES)
    case.change(folder)
    found = extract(folder, case.source)
    for words in case.told:
        assert re.search(rf"^ldc: warning: {words}", found.err, re.MULTILINE), found.err
    assert found.counts == {"7/1": WHOLE, "7/2": case.second, "7/3": case.third}
    assert found.code == (3 if case.told else 0)


@pytest.mark.slow
@pytest.mark.parametrize("source", MAKE)
def test_sound_files_give_no_problem(source: str, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    MAKE[source](folder, DRIVES)
    for format_ in (source, "auto"):
        found = extract(folder, format_)
        assert found.counts == dict.fromkeys(TRIPS, WHOLE)
        assert found.code == 0
        assert found.out.startswith(f"format: {source} ")


@pytest.mark.slow
@pytest.mark.parametrize("source", MAKE)
def test_where_nothing_can_be_used_one_message_says_why(source: str, tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    MAKE[source](folder, DRIVES)
    files = [path for path in folder.rglob("*.*") if path.is_file()]
    for path in files:
        path.write_bytes(utf_16(path.read_bytes()))
    found = extract(folder, source)
    assert found.code == 2
    assert found.out == ""
    assert re.search(r"^ldc: error: [^\n]*UTF-16[^\n]*\n\Z", found.err, re.MULTILINE), found.err
    assert list(tmp_path.iterdir()) == [folder]
