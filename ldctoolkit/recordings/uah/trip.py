"""One trip of UAH-DriveSet: its files, checked for what they hold, as a recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.recordings.recording import Label, Problem, Recording
from ldctoolkit.recordings.signals_in_time import local_slope, merge_repeated, values_at
from ldctoolkit.recordings.table import LARGEST
from ldctoolkit.recordings.uah.tables import ACCELEROMETERS, DETECTED, GPS, LANE, TableKind, is_course, read_table

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
