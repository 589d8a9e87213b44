"""Rows of trips out of big text tables: which stretches make up a trip, and their cells in the order of time."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final, TypeVar

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.rising_times import rising_rows
from ldctoolkit.recordings.trips.table_text import Cells, read_cells
from ldctoolkit.recordings.trips.trip_index import Stretch, TripIndex

Key = tuple[int, int]
T = TypeVar("T")

MOST_PROBLEMS: Final = 20
"""Problems of one kind that are told one by one; the others are counted."""

LARGEST_TIME: Final = 1e11
"""A time of this size or more, in the table's own unit, is none."""


@dataclasses.dataclass(frozen=True)
class TripTable:
    """A text table that holds trips.

    Attributes
    ----------
    name : str
        What it is called in problems.
    path : str
        Where it is.
    columns : tuple of str
        Names of its columns.
    bytes : int
        Size when it was indexed.
    """

    name: str
    path: str
    columns: tuple[str, ...]
    bytes: int

    def spelled(self, wanted: Iterable[str]) -> dict[str, str]:
        """Those of the wanted columns that the table has, and their names as it spells them."""
        known = {name.lower(): name for name in self.columns}
        return {name: known[name.lower()] for name in wanted if name.lower() in known}


@dataclasses.dataclass(frozen=True)
class TripRows:
    """Cells of several trips, one trip after the other, times of a trip never falling.

    Attributes
    ----------
    cells : Cells
        m rows.
    trip : (m,) int
        Which of the trips asked for a row belongs to; never falls.
    problems : tuple of Problem
        What was left out.
    """

    cells: Cells
    trip: IntArray
    problems: tuple[Problem, ...]


def collect_trips(
    indexed: Sequence[tuple[TripTable, TripIndex]],
) -> tuple[dict[Key, tuple[int, tuple[Stretch, ...]]], list[Problem]]:
    """Put the stretches of each trip together.

    Parameters
    ----------
    indexed : sequence of (TripTable, TripIndex)
        Tables of one kind.

    Returns
    -------
    dict of (device, trip) to (int, tuple of Stretch)
        Which table a trip lies in, and where; in the order of the tables. Of a trip that two tables hold, the first
        one's rows are taken: a table of one day is often part of a larger one.
    list of Problem
        What was left out, or looks odd.
    """
    trips: dict[Key, tuple[int, tuple[Stretch, ...]]] = {}
    problems: list[Problem] = []
    seen: dict[Key, str] = {}
    for number, (table, index) in enumerate(indexed):
        own: dict[Key, list[Stretch]] = {}
        apart: dict[Key, int] = {}
        last: Key | None = None
        for one in index.stretches:
            key = (one.device, one.trip)
            own.setdefault(key, []).append(one)
            if key != last and len(own[key]) > 1 and key not in apart:
                apart[key] = one.line
            last = key
        faults = [(fault.line, "key", fault.what) for fault in index.faults]
        problems += told(table.name, faults)
        if index.more_faults:
            problems.append(
                Problem(table.name, "", f"{index.more_faults} more lines do not begin with a trip's numbers")
            )
        problems += told(
            table.name,
            (
                (line, "apart", f"trip {_shown(key)} goes on here, its rows begin in line {own[key][0].line}; "
                 "they are put together in the order of time")
                for key, line in apart.items()
            ),
        )  # fmt: skip
        twice: list[tuple[int, str, str]] = []
        for key, stretches in own.items():
            line = stretches[0].line
            if key in seen:
                words = f"trip {_shown(key)} is also in {seen[key]}; these rows are left out"
                twice.append((line, "twice", words))
                continue
            seen[key] = f"{table.name}, line {line}"
            trips[key] = number, tuple(stretches)
        problems += told(table.name, twice)
    return trips, problems


def _shown(key: Key) -> str:
    return f"{key[0]}/{key[1]}"


def batches(
    trips: Sequence[T], size_of: Callable[[T], int], most: int, apart: Callable[[T, T], bool] | None = None
) -> Iterator[tuple[T, ...]]:
    """Neighbouring trips that are read in one go.

    Parameters
    ----------
    trips : sequence
        In their order.
    size_of : callable
        Bytes of text of a trip.
    most : int
        A batch ends with the trip that reaches so many bytes.
    apart : callable, optional
        Whether a trip and the next one may not be in one batch.

    Examples
    --------
    >>> list(batches([3, 4, 5, 1], lambda trip: trip, 6))
    [(3, 4), (5, 1)]
    """
    batch: list[T] = []
    size = 0
    for i, trip in enumerate(trips):
        batch.append(trip)
        size += size_of(trip)
        if i + 1 == len(trips) or size >= most or (apart is not None and apart(trip, trips[i + 1])):
            yield tuple(batch)
            batch, size = [], 0


def told(file: str, faults: Iterable[tuple[int, str, str]], most: int = MOST_PROBLEMS) -> list[Problem]:
    """Problems of a file from (line, kind, words): the first of each kind one by one, the others counted.

    Examples
    --------
    >>> [str(one) for one in told("a.csv", [(3, "x", "bad"), (4, "x", "worse"), (9, "x", "worst")], most=1)]
    ['a.csv, line 3: bad', 'a.csv, line 4: 2 more lines like line 3, to line 9']
    """
    problems: list[Problem] = []
    seen: dict[str, list[int]] = {}
    for line, kind, words in faults:
        seen.setdefault(kind, []).append(line)
        if len(seen[kind]) <= most:
            problems.append(Problem(file, f"line {line}", words))
    for lines in seen.values():
        if len(lines) > most:
            count = len(lines) - most
            more = f"{count} more line{'s' * (count > 1)} like line {lines[0]}, to line {lines[-1]}"
            problems.append(Problem(file, f"line {lines[most]}", more))
    return problems


def read_trips(
    table: TripTable,
    trips: Sequence[tuple[Stretch, ...]],
    wanted: Mapping[str, str],
    *,
    time: str,
    cells: Sequence[int] = (),
) -> TripRows:
    """Read the rows of trips, and leave out those that cannot be used.

    Parameters
    ----------
    table : TripTable
        The table.
    trips : sequence of tuple of Stretch
        Where each trip lies.
    wanted : mapping of str to str
        Names to give to columns, and the names they have in the table.
    time : str
        Which of the given names is the time.
    cells : sequence of int, optional
        Allowed numbers of cells in a line; by default one for each column.

    Raises
    ------
    RecordingError
        If the file cannot be read or is not the one that was indexed.
    """
    pieces = [one for stretches in trips for one in stretches]
    text = _read(table, pieces)
    found = read_cells(text, table.columns, list(wanted.values()), cells=cells)
    if found.lines != sum(one.lines for one in pieces):
        raise _changed(table)
    first = np.array([one.line for one in pieces], dtype=np.int64)
    lines = np.array([one.lines for one in pieces], dtype=np.int64)
    before = np.cumsum(lines) - lines
    owner = np.repeat(np.arange(len(trips)), [sum(one.lines for one in stretches) for stretches in trips])

    def line_of(row: IntArray) -> IntArray:
        piece = np.searchsorted(before, row, side="right") - 1
        # an empty piece would share its place with the next; there is none
        line: IntArray = row - before[piece] + first[piece]
        return line

    at = line_of(np.array([fault.row for fault in found.faults], dtype=np.int64)).tolist()
    faults = [
        (line, fault.kind, f"{fault.what}; the line is left out") for line, fault in zip(at, found.faults, strict=True)
    ]
    values = dict(zip(wanted, found.values, strict=True))
    trip, t = owner[found.row], values[time]
    timed = np.abs(t) < LARGEST_TIME  # False for NaN
    column = wanted[time]
    faults += [
        (line, "time", f"column {column!r} holds no usable time; the line is left out")
        for line in line_of(found.row[~timed]).tolist()
    ]
    keep = np.flatnonzero(timed)
    apart = len(pieces) > len(trips)
    if apart:
        keep = keep[pieces_in_time(trip[keep], np.searchsorted(before, found.row[keep], side="right"), t[keep])]
    forward, back = forward_rows(trip[keep], t[keep])
    for row, count in back:
        line, i = int(line_of(found.row[keep[row : row + 1]])[0]), int(keep[row])
        one = trips[int(trip[i])][0]
        rows = "this line is" if count == 1 else f"{count} lines of the trip are"
        faults.append((line, "back", f"trip {one.device}/{one.trip}: the time runs backwards; {rows} left out"))
    if apart or not forward.all() or keep.size < t.size:
        keep = keep[forward]
        trip = trip[keep]
        values = {name: column_[keep] for name, column_ in values.items()}
    faults.sort(key=lambda fault: fault[0])
    named = Cells(tuple(values), tuple(values.values()), found.row[keep], found.lines)
    return TripRows(named, trip, tuple(told(table.name, faults)))


def _read(table: TripTable, pieces: Sequence[Stretch]) -> memoryview:
    """Text of stretches, one after the other; each ends its last line."""
    text = np.empty(sum(one.end - one.begin for one in pieces) + len(pieces), dtype=np.uint8).data
    at, changed = 0, False
    try:
        with open(table.path, "rb", buffering=0) as stream:  # noqa: PTH123 - a path as plain text
            changed = os.fstat(stream.fileno()).st_size != table.bytes
            i = 0
            while i < len(pieces) and not changed:
                begin, end = pieces[i].begin, pieces[i].end
                i += 1
                while i < len(pieces) and pieces[i].begin == end:
                    end = pieces[i].end
                    i += 1
                stream.seek(begin)
                while begin < end and (count := stream.readinto(text[at : at + end - begin])):
                    begin += count
                    at += count
                changed = begin < end
                if at and text[at - 1] != 10:
                    text[at] = 10
                    at += 1
    except OSError as error:
        raise RecordingError(f"{table.name}: cannot be read: {error.strerror or error}") from None
    if changed:
        raise _changed(table)
    return text[:at]


def _changed(table: TripTable) -> RecordingError:
    return RecordingError(f"{table.name}: the file has changed since it was looked through")


def pieces_in_time(trip: IntArray, piece: IntArray, t: FloatArray) -> IntArray:
    """Order of the rows that puts the pieces of each trip in the order of their median times.

    One time far ahead at the begin of a piece does not move it. Trips whose times never fall from one piece to the next
    stay as they are.

    Parameters
    ----------
    trip, piece : (m,) int
        Numbers of each row's trip and piece; neither ever falls.
    t : (m,)
        Times, finite.

    Examples
    --------
    >>> pieces_in_time(np.zeros(4, dtype=int), np.array([1, 1, 2, 2]), np.array([20.0, 30.0, 0.0, 10.0])).tolist()
    [2, 3, 0, 1]
    """
    order = np.arange(t.size)
    falls = (t[1:] < t[:-1]) & (trip[1:] == trip[:-1])
    moved = np.isin(trip, trip[1:][falls & (piece[1:] != piece[:-1])])
    if not moved.any():
        return order
    rows = np.flatnonzero(moved)
    begins = np.flatnonzero(np.diff(piece[rows], prepend=-1))
    counts = np.diff(begins, append=rows.size)
    middle = np.lexsort((t[rows], piece[rows]))[begins + (counts - 1) // 2]
    pieces = np.lexsort((t[rows][middle], trip[rows[begins]]))  # stable: equal ones stay in the order of the file
    place = np.empty_like(pieces)
    place[pieces] = np.arange(pieces.size)
    order[rows] = rows[np.argsort(np.repeat(place, counts), kind="stable")]
    return order


def forward_rows(trip: IntArray, t: FloatArray) -> tuple[BoolArray, list[tuple[int, int]]]:
    """Which rows to keep so that the times of no trip fall.

    Parameters
    ----------
    trip : (m,) int
        Number of each row's trip; never falls.
    t : (m,)
        Times, finite.

    Returns
    -------
    keep : (m,) bool
        False for rows that must go so that as many as possible of the trip stay: a time that jumps ahead does not cost
        the rest of the trip.
    back : list of (int, int)
        First row left out of each trip, and how many.

    Examples
    --------
    >>> keep, back = forward_rows(np.zeros(5, dtype=int), np.array([0.0, 10.0, 900.0, 30.0, 40.0]))
    >>> keep.tolist(), back
    ([True, True, False, True, True], [(2, 1)])
    """
    keep = np.ones(t.size, dtype=bool)
    falls = np.flatnonzero((t[1:] < t[:-1]) & (trip[1:] == trip[:-1]))
    back: list[tuple[int, int]] = []
    for one in np.unique(trip[falls + 1]):
        low, high = np.searchsorted(trip, one), np.searchsorted(trip, one, side="right")
        good = rising_rows(t[low:high])
        keep[low:high] = good
        back.append((int(low + np.argmin(good)), int(np.sum(~good))))
    return keep, back
