"""Reader of UAH-DriveSet v1: folders of trips, filmed and measured by a phone behind the windscreen."""

from __future__ import annotations

import codecs
import dataclasses
import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.preparation import (
    LIMITS,
    cut_at,
    joins_of,
    local_slope,
    merge_repeated,
    rows_in_order,
    spikes,
    values_at,
)
from ldctoolkit.recordings.recording import LARGEST, FoundParts, Label, Problem, Recording, SourceFile, source_file
from ldctoolkit.recordings.text_table import Layout, LineFault, grouped_problems, read_numbers

DETECTED: Final = 2.0  # state of the lane estimator in which offset and width can be used
STATES: Final = (DETECTED, 1.0, 0.0, -1.0, -9.0)  # detected, undetected, initialising, calibrating, missing
MOSTLY: Final = 0.9  # share of lines that must look as the file's name promises


Table = tuple[FloatArray, FloatArray]  # values (n, k), the time first; times before and after lines left out (j, 2)


@dataclasses.dataclass(frozen=True)
class TableKind:
    """A kind of table."""

    title: str  # for messages, with its article
    file: str  # name of the file
    columns: dict[str, int]  # names and indices of the cells that are read, the time first
    plausible: Callable[[FloatArray], bool]  # whether values, (n, k), can be those of this table
    needed: str  # signal that a trip lacks without it; empty for a table that may be missing


def is_course(course: FloatArray) -> BoolArray:
    """Where a course is valid, (n,); -1 stands for a missing one."""
    return (course >= 0.0) & (course <= 360.0)


def _mostly(good: BoolArray) -> bool:
    return bool(np.mean(good) >= MOSTLY)


def _lane_like(values: FloatArray) -> bool:
    _, offset, width, state = values.T
    usable = (width > 0.0) & (width < 20.0) & (np.abs(offset) < 20.0)
    return _mostly(np.isin(state, STATES)) and _mostly(usable | (state != DETECTED))


def _gps_like(values: FloatArray) -> bool:
    _, speed, latitude, longitude, course = values.T
    inside = (np.abs(latitude) <= 90.0) & (np.abs(longitude) <= 180.0) & (speed < 400.0)
    # in an accelerometer table a flag and accelerations stand in these columns
    flag = np.isin(speed, (0.0, 1.0)) & (np.abs(latitude) < 20.0) & (np.abs(longitude) < 20.0)
    return _mostly(inside & (is_course(course) | (course < 0.0))) and not _mostly(flag)


def _accelerometers_like(values: FloatArray) -> bool:
    _, flag, yaw = values.T
    return _mostly(np.isin(flag, (0.0, 1.0)) & (np.abs(yaw) <= 360.0))


LANE: Final = TableKind(
    "a lane table", "PROC_LANE_DETECTION.txt", {"time": 0, "offset": 1, "lane width": 3, "state": 4}, _lane_like,
    "the offset from the lane's centre",
)  # fmt: skip
GPS: Final = TableKind(
    "a GPS table", "RAW_GPS.txt", {"time": 0, "speed": 1, "latitude": 2, "longitude": 3, "course": 7}, _gps_like,
    "the speed",
)  # fmt: skip
ACCELEROMETERS: Final = TableKind(
    "an accelerometer table", "RAW_ACCELEROMETERS.txt", {"time": 0, "flag": 1, "yaw angle": 10}, _accelerometers_like,
    "",
)  # fmt: skip
KINDS: Final = (LANE, GPS, ACCELEROMETERS)


LARGEST_FILE: Final = 64 << 20
"""A file of one trip is not larger [bytes]: it would be hours of driving, some megabytes are usual."""

MOST_FAULTS: Final = 5  # so many faulty lines of one file are named one by one, the others are counted


def read_table(path: Path, shown: str, kind: TableKind) -> tuple[Table, list[Problem]]:
    """Read a table's columns, whose values are parted by blanks; without rows where its clock starts again.

    Raises `RecordingError` for a file that is no such table.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise RecordingError("", f"{size} bytes; a file of one trip has at most {LARGEST_FILE}")
        data = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise RecordingError("", f"cannot be read: {error.strerror}") from None
    # in UTF-16, digits alternate with NUL
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or data[:4].count(0) == 2:
        raise RecordingError("", "it is UTF-16 text, or no text at all", allowed="UTF-8")
    filled = [(number, line) for number, line in enumerate(data.splitlines(), 1) if line.strip()]
    if not filled:
        raise RecordingError("", "it is empty")
    cells = 1 + max(kind.columns.values())
    text = b"\n".join(line if b"," in line else b",".join(line.split()[:cells]) for _, line in filled)
    numbers = read_numbers(text, Layout(kind.columns, (cells,)))
    timed = np.abs(numbers["time"]) < LARGEST  # False for NaN
    untimed = [LineFault(row, "time", "no usable time") for row in numbers.row[~timed].tolist()]
    faults = [fault._replace(line=filled[fault.line][0]) for fault in sorted([*numbers.faults, *untimed])]
    if not timed.any():
        count = f" and {len(faults) - 1} more" if len(faults) > 1 else ""
        raise RecordingError(f"line {faults[0].line}{count}", f"{faults[0].what}; no line can be used")
    values, rows = np.column_stack([*numbers.columns.values()])[timed], numbers.row[timed]
    t = np.full(len(filled), np.nan)
    t[rows] = values[:, 0]
    forward, row, what = rows_in_order(values[:, 0])
    order = [] if forward.all() else [Problem(shown, f"line {filled[rows[row]][0]}", what)]
    if not forward.any():
        return (values[:0], np.empty((0, 2))), order
    if not kind.plausible(values[forward]):
        raise RecordingError("", f"its numbers are not those of {kind.title}; are files swapped?")
    lost = (fault._replace(kind="", what=f"{fault.what}; the line is left out") for fault in faults)
    return (values[forward], joins_of(t, rows[forward])), [*grouped_problems(shown, lost, MOST_FAULTS), *order]


DEPTH: Final = 3  # trips are looked for so many folders below a given one; the dataset's root has them at 2

_TRIP: Final = re.compile(
    r"\d+-[^-]+-(?P<driver>D\d+)-(?P<behaviour>NORMAL|DROWSY|AGGRESSIVE)[^-]*-(?P<road>MOTORWAY|SECONDARY)[^-]*",
    re.IGNORECASE,
)
_DRIVER: Final = re.compile(r"D\d+", re.IGNORECASE)
_PATTERN: Final = "<date>-<km>-D<number>-<NORMAL|DROWSY|AGGRESSIVE>-<MOTORWAY|SECONDARY>"
_FILES: Final = tuple(kind.file for kind in KINDS)


@dataclasses.dataclass(frozen=True)
class UahDriveset:
    r"""The reader; see `ldctoolkit.recordings.recording.RecordingReader`."""

    name: str = "uah-driveset"
    title: str = "UAH-DriveSet v1: trips in folders, a phone's lane detection, positions and yaw angles"
    vehicle_width: float = 1.8
    step: float | None = 0.1

    def recognise(self, paths: Sequence[Path]) -> str:
        """How many trips and drivers there are."""
        trips = {folder for folder, _ in _folders(paths, [])}
        if not trips:
            return ""
        drivers = {match["driver"].upper() for trip in trips if (match := _TRIP.fullmatch(trip.name))}
        by = f" of {_plural(len(drivers), 'driver')}" if drivers else ""
        return f"{_plural(len(trips), 'trip')}{by}"

    def open(self, paths: Sequence[Path]) -> FoundParts[TripFolder]:
        """Look through folders for trips."""
        problems: list[Problem] = []
        parts: list[TripFolder] = []
        files: list[SourceFile] = []
        seen: set[Path] = set()
        first_trip: dict[str, str] = {}  # the first trip of a name, and of a lane table's digest
        for folder, names in _folders(paths, problems):
            if folder in seen:  # given twice, or inside another one that was given
                continue
            seen.add(folder)
            shown = _shown(folder)
            try:
                part, digests = _trip(folder, names, problems)
            except RecordingError as error:
                problems.append(Problem(shown, "", f"{error}; the trip is left out"))
                continue
            lane = digests[0]
            if first := first_trip.get(part.key) or first_trip.get(lane.sha256):
                same = "has the same name as" if part.key in first_trip else f"has the same {part.files[0]} as"
                problems.append(Problem(shown, "", f"{same} {first}; it is left out"))
                continue
            first_trip[part.key] = shown
            if lane.bytes:
                first_trip[lane.sha256] = shown
            parts.append(part)
            files.extend(digests)
        if not parts:
            shown = ", ".join(path.name or str(path) for path in paths)
            reason = f"; {problems[0]}" if problems else ""
            count = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
            raise RecordingError(shown, f"no trip of UAH-DriveSet that can be used{reason}{count}")
        return FoundParts(tuple(parts), tuple(files), tuple(problems))


READER: Final = UahDriveset()


def _driver_folder(folder: Path) -> str:
    """Name of the driver's folder that a trip lies in; empty where it lies in another one."""
    return folder.parent.name if _DRIVER.fullmatch(folder.parent.name) else ""


def _shown(folder: Path) -> str:
    """Name of a trip's folder in messages."""
    return "/".join(filter(None, (_driver_folder(folder), folder.name)))


def _trip(folder: Path, names_on_disk: dict[str, str], problems: list[Problem]) -> tuple[TripFolder, list[SourceFile]]:
    """The trip in a folder and the digests of its files, the lane's first."""
    for kind in KINDS:
        if kind.needed and kind.file not in names_on_disk:
            raise RecordingError("", f"no file {kind.file}, which holds {kind.needed}")
    shown, match = _shown(folder), _TRIP.fullmatch(folder.name)
    labels: tuple[Label, ...] = ()
    if match:
        labels = tuple(Label(name, value.upper()) for name, value in match.groupdict().items())
    else:
        what = f"the folder's name is not {_PATTERN}; it is read without driver, behaviour and road"
        problems.append(Problem(shown, "", what))
    names = tuple(names_on_disk.get(name, "") for name in _FILES)
    digests = [source_file(folder / name, f"{shown}/{name}") for name in names if name]
    size = sum(file.bytes for file in digests)
    source = _driver_folder(folder) or (labels[0].value if labels else folder.name)
    return TripFolder(folder.name, str(folder), shown, names, size, labels, source), digests


def _folders(paths: Sequence[Path], problems: list[Problem]) -> Iterator[tuple[Path, dict[str, str]]]:
    """Trips below the given paths, sorted inside each; a file stands for the folder that it lies in.

    Of each trip the resolved folder, and the names on disk of those of its `_FILES` that are there.
    """
    for path in paths:
        shown = path.name or "."
        try:
            resolved = path.resolve()
            exists = resolved.exists()
        except (OSError, ValueError, RuntimeError):  # a NUL in the name, a loop of links
            exists = False
        if not exists:
            problems.append(Problem(shown, "", "does not exist"))
            continue
        if resolved.name.upper() in map(str.upper, _FILES) and not _is_folder(resolved):
            resolved = resolved.parent
        trips = list(_walk(resolved, DEPTH, problems)) if _is_folder(resolved) else []
        if not trips:
            problems.append(Problem(shown, "", f"holds no trip: no folder {_PATTERN} and no file {LANE.file}"))
        yield from trips


def _walk(folder: Path, depth: int, problems: list[Problem]) -> Iterator[tuple[Path, dict[str, str]]]:
    """Folders of trips below a folder, and how their files are spelled there."""
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        problems.append(Problem(folder.name, "", f"cannot be read: {error.strerror or error}"))
        return
    spelled = {name.upper(): name for name in _FILES}
    files = {spelled[entry.name.upper()]: entry.name for entry in inside if entry.name.upper() in spelled}
    if LANE.file in files:
        yield folder.resolve(), files
        return
    any_trip = False
    if depth > 0:
        for entry in inside:
            # archives from a Mac hold a shadow of every folder
            if not entry.name.startswith((".", "__")) and _is_folder(entry):
                for trip in _walk(entry, depth - 1, problems):
                    any_trip = True
                    yield trip
    if not any_trip and _TRIP.fullmatch(folder.name):
        yield folder.resolve(), files


_is_folder: Final = os.path.isdir  # this one raises nothing, whatever the path


def _plural(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


SPEED_STEP: Final = 2.5
"""Longest step [s] between two positions that speed and course are interpolated over; 1 s is usual."""

SPEED_HELD: Final = 0.5  # so long [s] a speed or a course holds where there is no next one
YAW_STEP: Final = 0.5  # longest step [s] of the yaw angle that is no gap; 0.1 s is usual
YAW_HALF: Final = 0.25  # half the window [s] of a yaw rate from yaw angles
COURSE_HALF: Final = 1.5  # half the window [s] of a yaw rate from courses
ENOUGH: Final = 0.95  # a signal that covers less than this share of the samples with a lane is reported


@dataclasses.dataclass(frozen=True)
class TripFolder:
    """A part of the source: one trip."""

    key: str  # the folder's name
    folder: str  # where it lies
    shown: str  # its name in messages: with the driver's folder, without any other
    files: tuple[str, ...]  # names of the files in the order of `KINDS`; the last is empty if there is none
    bytes: int  # size of the files together
    labels: tuple[Label, ...]  # driver, behaviour, road; empty if the folder's name does not tell
    source: str  # what the trip is accounted under

    def read(self) -> Iterator[Recording | Problem]:
        """What is wrong with the files, then the recording, if there can be one."""
        tables: dict[str, Table] = {}
        for name, kind in zip(self.files, KINDS, strict=True):
            shown = f"{self.shown}/{name}"
            try:
                table, problems = read_table(Path(self.folder, name), shown, kind) if name else (None, [])
            except RecordingError as error:
                table, problems = None, [Problem.of(shown, error)]
            yield from problems
            if table is not None:
                tables[kind.file] = table
                if not table[0].size:
                    return
            elif kind.needed:
                yield Problem(self.shown, "", f"without {kind.needed} the trip is left out")
                return
        joins = np.concatenate([table[1] for table in tables.values()])
        angles = tables[ACCELEROMETERS.file][0] if ACCELEROMETERS.file in tables else None
        recording = self._recording(tables[LANE.file][0], tables[GPS.file][0], angles, joins)
        yield from self._lost(recording)
        if np.isfinite(recording.speed).any():
            yield recording

    def _recording(self, lane: FloatArray, gps: FloatArray, angles: FloatArray | None, joins: FloatArray) -> Recording:
        t, x, width, state = lane.T.copy()  # one piece of memory a column
        cut, inside = cut_at(t, joins)
        valid = (state == DETECTED) & (width > 0.0) & (width < LARGEST) & (np.abs(x) < LARGEST) & ~inside
        # a phone without a speed says less than 0; what no vehicle drives is not interpolated either
        driven = (gps[:, 1] >= 0.0) & (gps[:, 1] < 360.0) & ~spikes(gps[:, 1], 3.6 * LIMITS["speed"].spike)
        speed_t, speed = merge_repeated(gps[driven, 0], gps[driven, 1] / 3.6)
        headed = is_course(gps[:, 4])
        course_t, course = merge_repeated(gps[headed, 0], np.unwrap(-np.radians(gps[headed, 4])))
        yaw_rate, measured, notes = _yaw_rate(t, valid, angles, course_t, course)
        return Recording(
            name=self.key,
            t=t,
            lane_offset=np.where(valid, 0.0 - x, np.nan),
            lane_width=np.where(valid, width, np.nan),
            speed=values_at(t, speed_t, speed, longest=SPEED_STEP, beyond=SPEED_HELD),
            valid=valid,
            yaw_rate=yaw_rate,
            yaw_rate_measured=measured,
            cut=cut,
            heading=values_at(t, course_t, course, longest=SPEED_STEP, beyond=SPEED_HELD),
            labels=self.labels,
            source=self.source,
            notes=notes,
        )

    def _lost(self, recording: Recording) -> Iterator[Problem]:
        """Problems of samples with a lane that cannot be used, since another file lacks their speed or yaw rate."""
        t, lanes = recording.t, int(np.count_nonzero(recording.valid))
        lane, gps, accelerometers = (f"{self.shown}/{name}" if name else "" for name in self.files)
        if lanes == 0:
            yield Problem(lane, "", "no line with a detected lane (state 2) can be used")
            return
        span = f"the trip runs from {float(t[0])!r} s to {float(t[-1])!r} s"
        if not np.isfinite(recording.speed).any():
            yield Problem(gps, "", f"it holds no speed in time, {span}; the trip is left out")
            return
        yaw = recording.yaw_rate
        for file, values, what in ((gps, recording.speed, "speed"), (accelerometers or gps, yaw, "yaw rate")):
            share = 1.0 if values is None else np.count_nonzero(np.isfinite(values) & recording.valid) / lanes
            if share < ENOUGH:
                few = f"it is short or has gaps: {share:.0%} of the samples with a lane have a {what} ({span})"
                yield Problem(file, "", f"{few}; the others are left out")


def _yaw_rate(
    t: FloatArray, valid: BoolArray, angles: FloatArray | None, course_t: FloatArray, course: FloatArray
) -> tuple[FloatArray | None, BoolArray | None, tuple[str, ...]]:
    """Yaw rate at the times `t` [rad/s], where it is not from the course, and what to note; or None.

    It comes from yaw angles, and from the course where these are missing.
    """
    notes = []
    by_angle = np.full(t.size, np.nan)
    if angles is not None:
        by_angle, degrees = _rate_of_angles(t, angles)
        if degrees:
            notes.append(f"the yaw angle in {ACCELEROMETERS.file} goes beyond pi and is taken as degrees")
    rate = local_slope(course_t, course, half=COURSE_HALF, longest=SPEED_STEP)
    finite = np.isfinite(rate)
    by_course = values_at(t, course_t[finite], rate[finite], longest=SPEED_STEP, beyond=SPEED_HELD)
    measured = np.isfinite(by_angle)
    yaw_rate = np.where(measured, by_angle, by_course)
    if np.count_nonzero(measured & valid) < ENOUGH * np.count_nonzero(valid):
        state = "missing or cannot be used" if angles is None else "short or has gaps"
        instead = f"the yaw rate there is that of the course in {GPS.file}"
        if not np.isfinite(yaw_rate[valid]).any():
            instead = f"{GPS.file} holds no course instead; without a yaw rate the lane counts as straight"
        notes.append(f"{ACCELEROMETERS.file} is {state}; {instead}")
    if not np.isfinite(yaw_rate[valid]).any():
        return None, None, tuple(notes)
    return yaw_rate, measured, tuple(notes)


def _rate_of_angles(t: FloatArray, angles: FloatArray) -> tuple[FloatArray, bool]:
    """Yaw rate at the times `t` [rad/s], and whether the angles are degrees: documented so, but they are radians."""
    yaw = angles[:, 2]
    degrees = bool(np.mean(np.abs(yaw) > 1.01 * np.pi) > 0.01)
    yaw = np.radians(yaw) if degrees else yaw
    within = np.abs(yaw) <= (2.02 if degrees else 1.01) * np.pi
    yaw_t, angle = merge_repeated(angles[within, 0], np.unwrap(yaw[within]))
    rate = local_slope(yaw_t, angle, half=YAW_HALF, longest=YAW_STEP)
    finite = np.isfinite(rate)
    return values_at(t, yaw_t[finite], rate[finite], longest=YAW_STEP, beyond=YAW_HALF), degrees
