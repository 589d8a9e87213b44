"""What the tables of a UAH-DriveSet trip hold, and how a table in another's place is found out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.uah.text import Column, read_number_text

DETECTED: Final = 2.0
"""State of the lane estimator in which offset and width can be used."""

STATES: Final = (DETECTED, 1.0, 0.0, -1.0, -9.0)
"""Detected, undetected, initialising, calibrating, missing."""

MOSTLY: Final = 0.9
"""Share of lines that must look as the file's name promises."""


@dataclasses.dataclass(frozen=True)
class TableKind:
    """A kind of table.

    Attributes
    ----------
    title : str
        For messages, with its article.
    file : str
        Name of the file.
    columns : (k,) Column
        Columns that are read, the time first; others are passed over.
    plausible : callable
        Says of values, (n, k), whether they can be this table's.
    """

    title: str
    file: str
    columns: tuple[Column, ...]
    plausible: Callable[[FloatArray], bool]


def read_table(path: Path, shown: str, kind: TableKind) -> tuple[FloatArray | None, list[Problem]]:
    """Columns of a table.

    Parameters
    ----------
    path : Path
        The file.
    shown : str
        Its name in messages.
    kind : TableKind
        What it should be.

    Returns
    -------
    values : (n, k) or None
        The kind's columns, times that do not fall; None if the file cannot be used.
    problems : list of Problem
        Lines left out, or why the file cannot be used.
    """
    values, problems = read_number_text(path, shown, kind.columns)
    if values is not None and not kind.plausible(values):
        problems.append(Problem(shown, "", f"its numbers are not those of {kind.title}; are files swapped?"))
        return None, problems
    return values, problems


def is_course(course: FloatArray) -> BoolArray:
    """Where a course is known, (n,); -1 says that it is not."""
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


def _columns(*named: tuple[int, str]) -> tuple[Column, ...]:
    return tuple(Column(index, name) for index, name in named)


LANE: Final = TableKind(
    "a lane table",
    "PROC_LANE_DETECTION.txt",
    _columns((0, "time"), (1, "offset"), (3, "lane width"), (4, "state")),
    _lane_like,
)

GPS: Final = TableKind(
    "a GPS table",
    "RAW_GPS.txt",
    _columns((0, "time"), (1, "speed"), (2, "latitude"), (3, "longitude"), (7, "course")),
    _gps_like,
)

ACCELEROMETERS: Final = TableKind(
    "an accelerometer table",
    "RAW_ACCELEROMETERS.txt",
    _columns((0, "time"), (1, "flag"), (10, "yaw angle")),
    _accelerometers_like,
)
