"""Reader of UAH-DriveSet v1: folders of trips, filmed and measured by a phone behind the windscreen."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Label, Problem, Recording
from ldctoolkit.recordings.signals_in_time import local_slope, merge_repeated, values_at
from ldctoolkit.recordings.source_file import SourceFile, source_file
from ldctoolkit.recordings.sources import FoundParts
from ldctoolkit.recordings.table import LARGEST
from ldctoolkit.recordings.uah.tables import ACCELEROMETERS, DETECTED, GPS, LANE, TableKind, is_course, read_table

DEPTH: Final = 3
"""Trips are looked for so many folders below a given one; the dataset's root has them at 2."""

_TRIP: Final = re.compile(
    r"\d+-[^-]+-(?P<driver>D\d+)-(?P<behaviour>NORMAL|DROWSY|AGGRESSIVE)[^-]*-(?P<road>MOTORWAY|SECONDARY)[^-]*",
    re.IGNORECASE,
)
_DRIVER: Final = re.compile(r"D\d+", re.IGNORECASE)
_PATTERN: Final = "<date>-<km>-D<number>-<NORMAL|DROWSY|AGGRESSIVE>-<MOTORWAY|SECONDARY>"
_WANTED: Final = (LANE.file, GPS.file, ACCELEROMETERS.file)


@dataclasses.dataclass(frozen=True)
class UahDriveset:
    r"""The reader; see `ldctoolkit.recordings.sources.RecordingReader`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     trip = Path(folder, "D2", "20151120133502-26km-D2-DROWSY-MOTORWAY")
    ...     trip.mkdir(parents=True)
    ...     _ = Path(trip, "PROC_LANE_DETECTION.txt").write_text("1.0 0.25 0 3.5 2\n1.03 0.5 0 3.5 2\n")
    ...     _ = Path(trip, "RAW_GPS.txt").write_text("0.6 90 40.5 -3.4 600 6 10 12\n1.6 90 40.5 -3.4 600 6 10 12\n")
    ...     source = READER.open([Path(folder)])
    ...     recording = next(source.parts[0].read())
    >>> recording.lane_offset.tolist(), recording.speed.tolist(), [label.value for label in recording.labels]
    ([-0.25, -0.5], [25.0, 25.0], ['D2', 'DROWSY', 'MOTORWAY'])
    """

    name: str = "uah-driveset"
    title: str = "UAH-DriveSet v1: trips in folders, a phone's lane detection, positions and yaw angles"
    vehicle_width: float = 1.8
    step: float | None = 0.1

    def recognise(self, paths: Sequence[Path]) -> str:
        """How many trips and drivers there are.

        Parameters
        ----------
        paths : sequence of Path
            Files or folders.

        Returns
        -------
        str
            Empty if there are none.
        """
        trips = {folder.path for folder in _folders(paths, [])}
        if not trips:
            return ""
        drivers = {match["driver"].upper() for trip in trips if (match := _TRIP.fullmatch(trip.name))}
        of = f" of {_count(len(drivers), 'driver')}" if drivers else ""
        return f"{_count(len(trips), 'trip')}{of}"

    def open(self, paths: Sequence[Path]) -> FoundParts[TripFolder]:
        """Look through folders for trips.

        Parameters
        ----------
        paths : sequence of Path
            The dataset's folder, folders of drivers or trips, or files of trips.

        Returns
        -------
        FoundParts
            Trips in the order of `paths` and, inside each, of their names.

        Raises
        ------
        RecordingError
            If there is no trip that can be used.
        """
        problems: list[Problem] = []
        parts: list[TripFolder] = []
        files: list[SourceFile] = []
        seen: set[Path] = set()
        names: dict[str, str] = {}
        contents: dict[str, str] = {}
        for folder in _folders(paths, problems):
            if folder.path in seen:  # given twice, or inside another one that was given
                continue
            seen.add(folder.path)
            try:
                part, digests = _trip(folder, problems)
            except RecordingError as error:
                problems.append(Problem(folder.shown, "", f"{error}; the trip is left out"))
                continue
            if part is None:
                continue
            lane = digests[0]
            other = names.get(part.key) or contents.get(lane.sha256)
            if other:
                same = "has the same name as" if part.key in names else f"has the same {part.lane} as"
                problems.append(Problem(folder.shown, "", f"{same} {other}; it is left out"))
                continue
            names[part.key] = folder.shown
            if lane.bytes:
                contents[lane.sha256] = folder.shown
            parts.append(part)
            files.extend(digests)
        if not parts:
            shown = ", ".join(path.name or str(path) for path in paths)
            first = f"; {problems[0]}" if problems else ""
            more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
            raise RecordingError(f"{shown}: no trip of UAH-DriveSet that can be used{first}{more}")
        return FoundParts(tuple(parts), tuple(files), tuple(problems))


READER: Final = UahDriveset()


@dataclasses.dataclass(frozen=True)
class _Folder:
    """A folder that is a trip by its name or its files.

    Attributes
    ----------
    path : Path
        Resolved.
    files : dict of str to str
        Those of `_WANTED` that are there: their names on disk.
    """

    path: Path
    files: dict[str, str]

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def driver_folder(self) -> str:
        parent = self.path.parent.name
        return parent if _DRIVER.fullmatch(parent) else ""

    @property
    def shown(self) -> str:
        return f"{self.driver_folder}/{self.name}" if self.driver_folder else self.name


def _trip(folder: _Folder, problems: list[Problem]) -> tuple[TripFolder | None, list[SourceFile]]:
    """The trip in a folder and the digests of its files, the lane's first; None, and a problem, if it has none."""
    for name, what in ((LANE.file, "the offset from the lane's centre"), (GPS.file, "the speed")):
        if name not in folder.files:
            problems.append(Problem(f"{folder.shown}/{name}", "", f"is missing; without {what} the trip is left out"))
            return None, []
    match = _TRIP.fullmatch(folder.name)
    labels: tuple[Label, ...] = ()
    source = folder.driver_folder or folder.name
    if match:
        driver = match["driver"].upper()
        behaviour, road = match["behaviour"].upper(), match["road"].upper()
        labels = (Label("driver", driver), Label("behaviour", behaviour), Label("road", road))
        source = folder.driver_folder or driver
    else:
        what = f"the folder's name is not {_PATTERN}; it is read without driver, behaviour and road"
        problems.append(Problem(folder.shown, "", what))
    names = [folder.files.get(name, "") for name in _WANTED]
    digests = [source_file(folder.path / name, f"{folder.shown}/{name}") for name in names if name]
    size = sum(file.bytes for file in digests)
    lane, gps, accelerometers = names
    path = str(folder.path)
    return TripFolder(folder.name, path, folder.shown, lane, gps, accelerometers, size, labels, source), digests


def _folders(paths: Sequence[Path], problems: list[Problem]) -> Iterator[_Folder]:
    """Trips below the given paths, sorted inside each; a file stands for the folder that it lies in."""
    for path in paths:
        shown = path.name or "."
        try:
            resolved = path.resolve()
            there = resolved.exists()
        except (OSError, ValueError, RuntimeError):  # a NUL in the name, a loop of links
            there = False
        if not there:
            problems.append(Problem(shown, "", "does not exist"))
            continue
        if resolved.name.upper() in map(str.upper, _WANTED) and not _is_folder(resolved):
            resolved = resolved.parent
        found = list(_walk(resolved, DEPTH, problems)) if _is_folder(resolved) else []
        if not found:
            problems.append(Problem(shown, "", f"holds no trip: no folder {_PATTERN} and no file {LANE.file}"))
        yield from found


def _walk(folder: Path, depth: int, problems: list[Problem]) -> Iterator[_Folder]:
    try:
        inside = sorted(folder.iterdir())
    except OSError as error:
        problems.append(Problem(folder.name, "", f"cannot be read: {error.strerror or error}"))
        return
    wanted = {name.upper(): name for name in _WANTED}
    files = {wanted[entry.name.upper()]: entry.name for entry in inside if entry.name.upper() in wanted}
    if LANE.file in files:
        yield _Folder(folder.resolve(), files)
        return
    found = False
    if depth > 0:
        for entry in inside:
            # archives from a Mac hold a shadow of every folder
            if not entry.name.startswith((".", "__")) and _is_folder(entry):
                for trip in _walk(entry, depth - 1, problems):
                    found = True
                    yield trip
    if not found and _TRIP.fullmatch(folder.name):
        yield _Folder(folder.resolve(), files)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # a link into a folder that may not be looked at
        return False


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'s' * (number != 1)}"


SPEED_STEP: Final = 2.5
"""Longest step [s] between two positions that speed and course are interpolated over; 1 s is usual."""

SPEED_HELD: Final = 0.5
"""So long [s] a speed or a course holds where there is no next one."""

YAW_STEP: Final = 0.5
"""Longest step [s] of the yaw angle that is no gap; 0.1 s is usual."""

YAW_HALF: Final = 0.25
"""Half the window [s] of a yaw rate from yaw angles."""

COURSE_HALF: Final = 1.5
"""Half the window [s] of a yaw rate from courses."""

ENOUGH: Final = 0.95
"""A signal that covers less than this share of the samples with a lane is told."""


@dataclasses.dataclass(frozen=True)
class TripFolder:
    """A part of the source: one trip.

    Attributes
    ----------
    key : str
        The folder's name.
    folder : str
        Where it lies.
    shown : str
        Its name in messages: with the driver's folder, without any other.
    lane, gps, accelerometers : str
        Names of the files; the last is empty if there is none.
    bytes : int
        Size of the files together.
    labels : tuple of Label
        Driver, behaviour, road; empty if the folder's name does not tell.
    source : str
        What the trip is accounted under.
    """

    key: str
    folder: str
    shown: str
    lane: str
    gps: str
    accelerometers: str
    bytes: int
    labels: tuple[Label, ...]
    source: str

    def read(self) -> Iterator[Recording | Problem]:
        """What is wrong with the files, then the recording, if there can be one."""
        lane, problems = self._table(self.lane, LANE)
        yield from problems
        if lane is None:
            yield Problem(self.shown, "", "without the offset from the lane's centre the trip is left out")
            return
        gps, problems = self._table(self.gps, GPS)
        yield from problems
        if gps is None:
            yield Problem(self.shown, "", "without the speed the trip is left out")
            return
        angles, problems = self._table(self.accelerometers, ACCELEROMETERS)
        yield from problems
        recording = self._recording(lane, gps, angles)
        yield from self._lost(recording)
        if np.isfinite(recording.speed).any():
            yield recording

    def _table(self, name: str, kind: TableKind) -> tuple[FloatArray | None, list[Problem]]:
        return read_table(Path(self.folder, name), f"{self.shown}/{name}", kind) if name else (None, [])

    def _recording(self, lane: FloatArray, gps: FloatArray, angles: FloatArray | None) -> Recording:
        t, x, width, state = lane.T.copy()  # one piece of memory a column
        valid = (state == DETECTED) & (width > 0.0) & (width < LARGEST) & (np.abs(x) < LARGEST)
        speed = _speed(gps, t)
        course_t, course = _course(gps)
        yaw_rate, measured, notes = _yaw_rate(t, valid, angles, course_t, course)
        return Recording(
            name=self.key,
            t=t,
            lane_offset=np.where(valid, 0.0 - x, np.nan),
            lane_width=np.where(valid, width, np.nan),
            speed=speed,
            valid=valid,
            yaw_rate=yaw_rate,
            yaw_rate_measured=measured,
            heading=values_at(t, course_t, course, longest=SPEED_STEP, beyond=SPEED_HELD),
            labels=self.labels,
            source=self.source,
            notes=notes,
        )

    def _lost(self, recording: Recording) -> Iterator[Problem]:
        """Lanes that nothing can be done with, for another file does not go with them."""
        t, lanes = recording.t, int(np.count_nonzero(recording.valid))
        if lanes == 0:
            yield Problem(f"{self.shown}/{self.lane}", "", "no line has a detected lane (state 2)")
            return
        span = f"the trip runs from {float(t[0])!r} s to {float(t[-1])!r} s"
        known = np.isfinite(recording.speed) & recording.valid
        if not np.isfinite(recording.speed).any():
            yield Problem(f"{self.shown}/{self.gps}", "", f"it holds no speed in time, {span}; the trip is left out")
        elif np.count_nonzero(known) < ENOUGH * lanes:
            what = f"it is short or has gaps: {_percent(known, lanes)} of the samples with a lane have a speed ({span})"
            yield Problem(f"{self.shown}/{self.gps}", "", f"{what}; the others are left out")
        if recording.yaw_rate is not None:
            known = np.isfinite(recording.yaw_rate) & recording.valid
            if np.count_nonzero(known) < ENOUGH * lanes:
                what = f"{_percent(known, lanes)} of the samples with a lane have a yaw rate, from yaw angle or course"
                file = self.accelerometers or self.gps
                yield Problem(f"{self.shown}/{file}", "", f"{what} ({span}); the others are left out")


def _speed(gps: FloatArray, t: FloatArray) -> FloatArray:
    """Speed at the times `t` [m/s]."""
    known = (gps[:, 1] >= 0.0) & (gps[:, 1] < LARGEST)  # a phone without a speed says less than 0
    return values_at(t, *merge_repeated(gps[known, 0], gps[known, 1] / 3.6), longest=SPEED_STEP, beyond=SPEED_HELD)


def _course(gps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times [s], and the course at them, counter-clockwise and without jumps [rad]."""
    known = is_course(gps[:, 4])
    return merge_repeated(gps[known, 0], np.unwrap(-np.radians(gps[known, 4])))


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
    known = np.isfinite(rate)
    by_course = values_at(t, course_t[known], rate[known], longest=SPEED_STEP, beyond=SPEED_HELD)
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
    known = np.abs(yaw) <= (2.02 if degrees else 1.01) * np.pi
    at, angle = merge_repeated(angles[known, 0], np.unwrap(yaw[known]))
    rate = local_slope(at, angle, half=YAW_HALF, longest=YAW_STEP)
    known = np.isfinite(rate)
    return values_at(t, at[known], rate[known], longest=YAW_STEP, beyond=YAW_HALF), degrees


def _percent(part: BoolArray, of: int) -> str:
    return f"{100.0 * np.count_nonzero(part) / of:.0f} %"
