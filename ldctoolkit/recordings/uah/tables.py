"""What the tables of a UAH-DriveSet trip hold, and how a table in another's place is found out."""

from __future__ import annotations

import dataclasses
import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.rising_times import rising_rows
from ldctoolkit.recordings.table import LARGEST

DETECTED: Final = 2.0
"""State of the lane estimator in which offset and width can be used."""

STATES: Final = (DETECTED, 1.0, 0.0, -1.0, -9.0)
"""Detected, undetected, initialising, calibrating, missing."""

MOSTLY: Final = 0.9
"""Share of lines that must look as the file's name promises."""


@dataclasses.dataclass(frozen=True)
class Column:
    """A column that is needed.

    Attributes
    ----------
    index : int
        Counted from 0.
    name : str
        For messages.
    """

    index: int
    name: str


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


LARGEST_FILE: Final = 64 << 20
"""A file of one trip is not larger [bytes]: it would be hours of driving, some megabytes are usual."""

TOLD: Final = 5
"""So many faulty lines of one file are named one by one, the others are counted."""

_LINE_END: Final = re.compile(r"\r\n|\r|\n")


def read_number_text(path: Path, shown: str, columns: Sequence[Column]) -> tuple[FloatArray | None, list[Problem]]:
    r"""Read some columns of a file whose values are parted by blanks.

    Parameters
    ----------
    path : Path
        The file.
    shown : str
        Its name in messages.
    columns : (k,) Column
        Columns needed, the time first; a line may hold more.

    Returns
    -------
    values : (n, k) or None
        The columns asked for, in that order; NaN where the file says so, but never in the time, which does not fall.
        None if nothing can be used.
    problems : list of Problem
        Lines that were left out, or why the file cannot be used.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "RAW_GPS.txt")
    ...     _ = path.write_text("0.1 80.0\n1.1 eighty\n2.1 81.0\n")
    ...     values, problems = read_number_text(path, "RAW_GPS.txt", [Column(0, "time"), Column(1, "speed")])
    >>> values.tolist()
    [[0.1, 80.0], [2.1, 81.0]]
    >>> print(problems[0])
    RAW_GPS.txt, line 2: 'eighty' where the speed is needed; the line is left out
    """
    text, fault = _read_text(path)
    if fault:
        return None, [Problem(shown, "", fault)]
    values = _fast(text, columns)
    if values is not None and rising_rows(values[:, 0]).all():
        return values, []
    values, lines, faults = _tolerant(text, columns)
    if values.shape[0] == 0:
        (line, what), count = faults[0], len(faults)
        where = f"line {line}" if count == 1 else f"line {line} and {count - 1} more"
        return None, [Problem(shown, where, f"{what}; no line can be used")]
    problems = [Problem(shown, f"line {line}", f"{what}; the line is left out") for line, what in faults[:TOLD]]
    if len(faults) > TOLD:
        line, what = faults[TOLD]
        where = f"line {line} and {len(faults) - TOLD - 1} more"
        problems.append(Problem(shown, where, f"{what}, or alike; the lines are left out"))
    kept = rising_rows(values[:, 0])
    if not kept.all():
        problems.append(Problem(shown, f"line {lines[int(np.argmin(kept))]}", _backwards(values[:, 0], kept)))
    return values[kept], problems


def _number(token: str) -> float | None:
    """The number that a token is, as NumPy's reader sees it; None if it is none."""
    if not token.isascii() or "_" in token:
        return None
    try:
        return float(token)
    except ValueError:
        return None


def _read_text(path: Path) -> tuple[str, str]:
    """The text, or why there is none."""
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            return "", f"{size} bytes; a file of one trip has at most {LARGEST_FILE}"
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        return "", f"cannot be read: {error.strerror if isinstance(error, OSError) else error}"
    start = data[:4096]
    # in UTF-16, digits alternate with NUL; UTF-32 holds even more of them
    if start[:2] in (b"\xff\xfe", b"\xfe\xff") or start.count(0) * 3 > len(start):
        return "", "it is UTF-16 text, or no text at all; allowed: UTF-8"
    text = data.decode("utf-8-sig", errors="replace")
    if not text.strip():
        return "", "it is empty"
    return text, ""


def _fast(text: str, columns: Sequence[Column]) -> FloatArray | None:
    """All lines at once, (n, k); None if there is any fault."""
    try:
        values: FloatArray = np.loadtxt(
            io.StringIO(text), comments=None, usecols=[column.index for column in columns], ndmin=2
        )
    except (ValueError, OverflowError):
        return None
    return values if (np.abs(values[:, 0]) < LARGEST).all() else None


def _tolerant(text: str, columns: Sequence[Column]) -> tuple[FloatArray, list[int], list[tuple[int, str]]]:
    """Good lines, (n, k), their line numbers, and line and fault of the others."""
    needed = max(column.index for column in columns) + 1
    rows, lines, faults = [], [], []
    for line, content in enumerate(_LINE_END.split(text), start=1):
        tokens = content.split()
        if not tokens:
            continue
        row: list[float] = []
        fault = ""
        for column in columns:
            value = _number(tokens[column.index]) if column.index < len(tokens) else None
            if value is None:
                fault = _fault(tokens, column, needed)
                break
            row.append(value)
        if not fault and not abs(row[0]) < LARGEST:
            fault = f"the time is {tokens[columns[0].index][:30]!r}"
        if fault:
            faults.append((line, fault))
        else:
            rows.append(row)
            lines.append(line)
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns)), lines, faults


def _fault(tokens: Sequence[str], column: Column, needed: int) -> str:
    if any("\ufffd" in token for token in tokens):
        return "bytes that are not UTF-8"
    if column.index >= len(tokens):
        return f"{len(tokens)} value{'s' * (len(tokens) > 1)} where at least {needed} are needed"
    return f"{tokens[column.index][:30]!r} where the {column.name} is needed"


def _backwards(t: FloatArray, kept: BoolArray) -> str:
    first, count = int(np.argmin(kept)), int(np.sum(~kept))
    latest, here = t[:first].max(initial=-np.inf), t[first]
    # what is not behind an earlier row is ahead of the next one that is kept
    after = latest > here
    told = f"after {float(latest)!r} s" if after else f"before {float(t[first:][kept[first:]][0])!r} s"
    left = "the line is" if count == 1 else f"{count} lines are"
    return f"the time runs backwards: {float(here)!r} s {told}; {left} left out"
