"""Tables of trips: their header, an index of where each trip lies in a file, the rows of trips, and their reader."""

import concurrent.futures
import dataclasses
import hashlib
import itertools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.checked_files import text_of
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.preparation import middle_two, rows_in_order
from ldctoolkit.recordings.recording import (
    FoundParts,
    Problem,
    Recording,
    SourceFile,
    check_columns,
    find_tables,
    shown_names,
)
from ldctoolkit.recordings.text_table import (
    BLANKS,
    ByteArray,
    Layout,
    LineFault,
    blocks,
    grouped_problems,
    read_numbers,
)

LONGEST_HEADER: Final = 1 << 16
_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
_PACKED: Final = {b"\x1f\x8b": "gzip", b"PK": "a ZIP archive", b"PAR1": "Parquet", b"BZh": "bzip2", b"\xfd7zXZ": "xz"}


@dataclasses.dataclass(frozen=True)
class TableLayout:
    """How the rows of a table are laid out."""

    columns: tuple[str, ...]  # name of each cell
    begin: int  # byte where the rows begin
    line: int = 2  # number of that line
    kind: str = ""  # which of the reader's tables it is; empty for another table
    cells: tuple[int, ...] = ()  # allowed numbers of cells in a row; empty for one for each column
    note: str = ""  # what is odd about it, or why it is none of the reader's tables


def read_header(path: Path) -> TableLayout:
    """The first line of a comma-separated table in UTF-8."""
    try:
        if path.exists() and not path.is_file():
            raise RecordingError("", "cannot be read: it is not a regular file")  # a pipe would be waited for
        with path.open("rb") as stream:
            first = stream.readline(LONGEST_HEADER)
        for magic, name in _PACKED.items():
            if first.startswith(magic):
                raise RecordingError("", f"cannot be read: the content is {name}", allowed="plain text, so unpack it")
        text = text_of(first)
    except RecordingError:
        raise
    except (OSError, ValueError) as error:  # also a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise RecordingError("", f"cannot be read: {reason}") from None
    if not first:
        raise RecordingError("", "the file is empty; a header is needed")
    if len(first) == LONGEST_HEADER and not first.endswith(b"\n"):
        raise RecordingError("", f"the first line is longer than {LONGEST_HEADER} bytes; this is not a table of text")
    if "\r" in text.rstrip("\r\n"):
        raise RecordingError("", "the first line holds a carriage return", allowed="lines that end in LF or CR LF")
    names = tuple(name.strip(BLANKS + "\n") for name in text.split(","))
    if len(names) == 1:
        for mark, what in _DELIMITERS.items():
            if text.strip().count(mark) > 1:
                raise RecordingError("", f"the columns are separated by {what}", allowed="commas")
    return TableLayout(names, len(first))


def check_trip_columns(
    columns: Sequence[str], key: Sequence[str], required: Sequence[str], optional: Sequence[str] = ()
) -> None:
    """Refuse a header that does not begin with the key, lacks a column or repeats one."""
    if [name.lower() for name in columns[: len(key)]] != [name.lower() for name in key]:
        first = ", ".join(columns[: len(key)])
        raise RecordingError("", f"the first columns are {first}", allowed=", ".join(key))
    check_columns(columns, required, optional, same=str.lower)


BLOCK_BYTES: Final = 4 << 20  # text that is looked through at once
MOST_FAULTS: Final = 20  # lines without a key that are reported one by one; the others are counted
MOST_STRETCHES: Final = 1_000_000  # more stretches than these mean that the rows are not sorted by trip at all

_KEY: Final = re.compile(rb'[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,')
_KEY_BYTES: Final = 128  # a key is looked for in this many first bytes of a line


@dataclasses.dataclass(frozen=True, slots=True)
class Stretch:
    """Neighbouring lines of one trip."""

    device: int
    trip: int
    begin: int  # bytes ``begin:end`` of the file are whole lines
    end: int
    line: int  # number of the first line, the file's first is 1
    lines: int  # how many, blank ones included
    unkeyed: int = 0  # lines without a key before it in the file

    @property
    def name(self) -> str:
        """The trip's name."""
        return f"{self.device}/{self.trip}"


@dataclasses.dataclass(frozen=True)
class TripIndex:
    """Stretches of a file in its order, and its digest."""

    stretches: tuple[Stretch, ...]
    faults: tuple[LineFault, ...]  # the first lines that have no key
    more_faults: int  # how many more there are
    bytes: int  # size of the file
    sha256: str  # digest of its content, hexadecimal


TripKey = tuple[int, ...]  # device and trip

_BLANK: Final[TripKey] = (-1, -1, -1)  # in place of a key: the lines are blank


def index_trips(path: Path, begin: int, line: int, *, block_bytes: int = BLOCK_BYTES) -> TripIndex:
    """Find the stretches of lines that belong to one trip each, from byte `begin` on, which is in that `line`."""
    stretches: list[list[int]] = []  # fields of `Stretch`
    faults: list[LineFault] = []
    size, unkeyed = begin, 0
    open_key: TripKey = _BLANK
    try:
        with path.open("rb") as stream, concurrent.futures.ThreadPoolExecutor(1) as beside:
            digest = hashlib.sha256(stream.read(begin))
            for block, first_line in blocks(stream, block_bytes, line):
                hashed = beside.submit(digest.update, block)  # both leave the interpreter free
                for key, row, end_row, start, end in _runs_of_keys(block):
                    if key in (_BLANK, open_key):
                        if open_key != _BLANK:  # a blank line stays in its stretch
                            stretches[-1][3] = size + end
                            stretches[-1][5] = first_line + end_row - stretches[-1][4]
                    elif not key:
                        open_key = _BLANK
                        if unkeyed < MOST_FAULTS:
                            faults.append(LineFault(first_line + row, "key", _no_key(block[start:end])))
                        unkeyed += 1
                    elif len(stretches) == MOST_STRETCHES:
                        what = f"more than {MOST_STRETCHES} stretches of rows of one trip each"
                        allowed = "rows sorted by device, trip and time"
                        raise RecordingError(f"line {first_line + row}", what, allowed=allowed)
                    else:
                        open_key = key
                        stretches.append([*key, size + start, size + end, first_line + row, end_row - row, unkeyed])
                size += len(block)
                hashed.result()
    except OSError as error:
        raise RecordingError("", f"cannot be read: {error.strerror or error}") from None
    indexed = tuple(itertools.starmap(Stretch, stretches))
    return TripIndex(indexed, tuple(faults), unkeyed - len(faults), size, digest.hexdigest())


def _runs_of_keys(block: bytes) -> Iterator[tuple[TripKey, int, int, int, int]]:
    """Runs of lines that begin with the same key: the key, lines ``row:end_row`` and bytes ``start:end`` of the block.

    A line without a key is a run by itself: its key is `_BLANK` where nothing is in it, or else empty.
    """
    text = np.frombuffer(block, dtype=np.uint8)
    ends = np.flatnonzero(text == ord("\n")) + 1
    if text[-1] != ord("\n"):
        ends = np.append(ends, text.size)
    starts = np.append(0, ends[:-1])
    row = 0
    while row < starts.size:
        start, end_row = int(starts[row]), row + 1
        match = _KEY.match(block, start, min(start + _KEY_BYTES, int(ends[row])))
        key: TripKey = ()
        if match is not None:
            key = int(match[1]), int(match[2])
            end_row = _first_other(text, starts, end_row, np.frombuffer(match[0], dtype=np.uint8))
        elif not block[start : ends[row]].strip():
            key = _BLANK
        yield key, row, end_row, start, int(ends[end_row - 1])
        row = end_row


def _first_other(text: ByteArray, starts: IntArray, row: int, key: ByteArray) -> int:
    """The first line from `row` on that does not begin with the key's bytes; looked for in growing steps."""
    step = 16
    while row < starts.size:
        columns = np.minimum(starts[row : row + step, None] + np.arange(key.size), text.size - 1)
        differs = (text[columns] != key).any(axis=1)
        if differs.any():
            return row + int(np.argmax(differs))
        row, step = row + step, 2 * step
    return int(starts.size)


def _no_key(line: bytes) -> str:
    """What is wrong with a line that names no trip."""
    cells = line[:_KEY_BYTES].strip(b"\r\n").split(b",")[:2]
    shown = ",".join(cell.decode("utf-8", "replace").strip() for cell in cells)
    what = "NUL bytes" if "\0" in shown else repr(shown[:40])
    return f"it begins with {what}; allowed: numbers of device and trip; the line is left out"


CHANGED: Final = "the file has changed since it was looked through"
LARGEST_TIME: Final = 1e11  # a time of this size or more, in the table's own unit, is none


@dataclasses.dataclass(frozen=True)
class TripTable:
    """A text table that holds trips."""

    name: str  # what it is called in problems
    path: str  # where it is
    columns: tuple[str, ...]  # names of its columns
    cells: tuple[int, ...]  # allowed numbers of cells in a row
    bytes: int  # size when it was indexed


@dataclasses.dataclass(frozen=True)
class IndexedTable:
    """A table that can be used."""

    table: TripTable
    kind: str  # which of the reader's tables it is
    index: TripIndex  # where its trips lie

    @property
    def file(self) -> SourceFile:
        """The table as one of the files that were read."""
        return SourceFile(self.table.name, self.index.bytes, self.index.sha256)


@dataclasses.dataclass(frozen=True)
class TripRows:
    """Cells of several trips, one trip after the other, times of a trip never falling."""

    columns: dict[str, FloatArray]  # (m,) each; NaN for a missing value
    trip: IntArray  # (m,): to which of the requested trips a row belongs; never falls
    problems: tuple[Problem, ...]  # what was left out
    cuts: IntArray  # (k,): rows before which others of their trip were left out, or stand elsewhere in the file

    def joins(self, trip: int) -> FloatArray:
        """Times before and after each of a trip's cuts, (k, 2)."""
        cuts, t = self.cuts[self.trip[self.cuts] == trip], self.columns["Time"]
        return np.column_stack([t[cuts - 1], t[cuts]])


Stretches = tuple[Stretch, ...]  # of one trip in one table


def read_trips(table: TripTable, trips: Sequence[Stretches], names: Iterable[str]) -> TripRows:
    """Read those of the named columns that a table has, in rows of trips, and leave out rows that cannot be used."""
    pieces = [stretch for stretches in trips for stretch in stretches]
    lower = [name.lower() for name in table.columns]
    column_index = {name: lower.index(name.lower()) for name in names if name.lower() in lower}
    spelled = {table.columns[i]: i for i in column_index.values()}  # faults name a column as the table does
    numbers = read_numbers(_text_of_stretches(table, pieces), Layout(spelled, table.cells))
    if numbers.lines != sum(stretch.lines for stretch in pieces):
        raise RecordingError(table.name, CHANGED)
    first_line = np.array([stretch.line for stretch in pieces], dtype=np.int64)
    lines = np.array([stretch.lines for stretch in pieces], dtype=np.int64)
    lines_before = np.cumsum(lines) - lines
    trip_of_line = np.repeat(np.arange(len(trips)), [sum(stretch.lines for stretch in trip) for trip in trips])

    def line_of(row: IntArray) -> IntArray:
        """Line numbers in the file; a piece is never empty, so `lines_before` rises."""
        piece = np.searchsorted(lines_before, row, side="right") - 1
        return row - lines_before[piece] + first_line[piece]

    lost_rows = np.array([fault.line for fault in numbers.faults], dtype=np.int64)
    values = dict(zip(column_index, numbers.columns.values(), strict=True))
    trip, t = trip_of_line[numbers.row], values["Time"]
    timed = np.abs(t) < LARGEST_TIME  # False for NaN
    no_time = f"column {table.columns[column_index['Time']]!r} holds no usable time"
    faults = [
        fault._replace(line=line, what=f"{fault.what}; the line is left out")
        for fault, line in zip(numbers.faults, line_of(lost_rows).tolist(), strict=True)
    ]
    faults += [
        LineFault(line, "time", f"{no_time}; the line is left out") for line in line_of(numbers.row[~timed]).tolist()
    ]
    keep = np.flatnonzero(timed)
    split = len(pieces) > len(trips)
    if split:
        # pieces of a trip in the order of their median times: one time far ahead at the begin of one does not move it
        piece = np.searchsorted(lines_before, numbers.row[keep], side="right")
        begins = np.flatnonzero(np.diff(piece, prepend=-1))
        counts = np.diff(begins, append=keep.size)
        middle, _ = middle_two(t[keep], piece, counts)
        keep = keep[np.lexsort((np.repeat(middle, counts), trip[keep]))]  # stable: equal ones stay in the file's order
    trip_of, clock = trip[keep], t[keep]
    forward = np.ones(keep.size, dtype=bool)
    for i in np.unique(trip_of[1:][(clock[1:] < clock[:-1]) & (trip_of[1:] == trip_of[:-1])]).tolist():
        low, high = np.searchsorted(trip_of, [i, i + 1])
        forward[low:high], row, what = rows_in_order(clock[low:high])
        line = int(line_of(numbers.row[keep[[low + row]]])[0])
        faults.append(LineFault(line, "back", f"trip {trips[i][0].name}: {what}"))
    cuts = np.empty(0, dtype=np.int64)
    if split or numbers.faults or not forward.all() or keep.size < t.size:
        keep = keep[forward]
        trip, text_row = trip[keep], numbers.row[keep]
        values = {name: column[keep] for name, column in values.items()}
        unkeyed = lines_before[1:][np.diff([stretch.unkeyed for stretch in pieces]) != 0] - 0.5
        lost = np.sort(np.concatenate([lost_rows, np.setdiff1d(numbers.row, text_row), unkeyed]))
        parted = np.diff(np.searchsorted(lost, text_row)) != 0
        # also where pieces changed their order
        parted |= ~np.isin(np.diff(np.searchsorted(lines_before, text_row, side="right")), (0, 1))
        cuts = np.flatnonzero(parted & (np.diff(trip) == 0)) + 1
    return TripRows(values, trip, tuple(grouped_problems(table.name, sorted(faults))), cuts)


def _text_of_stretches(table: TripTable, stretches: Sequence[Stretch]) -> bytes:
    """Text of stretches, one after the other, each ends its last line."""
    text: list[bytes] = []
    try:
        with open(table.path, "rb") as stream:  # noqa: PTH123 - a path as plain text
            if os.fstat(stream.fileno()).st_size != table.bytes:
                raise RecordingError(table.name, CHANGED)
            for stretch in stretches:
                stream.seek(stretch.begin)
                text.append(stream.read(stretch.end - stretch.begin))
                if not text[-1].endswith(b"\n"):
                    text.append(b"\n")
    except OSError as error:
        raise RecordingError(table.name, f"cannot be read: {error.strerror or error}") from None
    return b"".join(text)


AT_ONCE: Final = 4  # tables that are read side by side; two keep two cores busy, more than these only make a disk jump


@dataclasses.dataclass(frozen=True)
class TripPart:
    """Some trips, in one table of each kind."""

    key: str  # names the first kind's table and the first trip
    tables: tuple[TripTable, ...]
    trips: tuple[tuple[Stretches, ...], ...]  # where each trip lies in each of the tables
    recordings_of: Callable[["TripPart"], Iterator[Recording | Problem]]

    @property
    def bytes(self) -> int:
        """Text that is read."""
        return sum(map(_text_bytes, self.trips))

    def stretches(self, table: int) -> list[Stretches]:
        """Where each trip lies in one of the tables."""
        return [trip[table] for trip in self.trips]

    def read(self) -> Iterator[Recording | Problem]:
        """What could not be used, then recordings in the order of the first kind's table."""
        return self.recordings_of(self)


def _text_bytes(trip: Iterable[Stretches]) -> int:
    return sum(stretch.end - stretch.begin for stretches in trip for stretch in stretches)


@dataclasses.dataclass(frozen=True)
class TripReader:
    """Reads the tables of one data acquisition system; see `RecordingReader`."""

    name: str
    title: str
    kinds: Mapping[str, str]  # kinds of tables, that of the lane first, and what is missing where there is none
    named: Callable[[Path], str]  # the kind that a file's name speaks of; empty for none
    kind_of: Callable[[Path], str]  # the kind that a file's first lines look like; empty for none
    layout_of: Callable[[Path], TableLayout]  # raises `RecordingError` for columns that are not as they have to be
    recordings_of: Callable[[TripPart], Iterator[Recording | Problem]]
    part_bytes: int  # about how much text a part reads
    vehicle_width: float = 1.82  # [m]
    step: float | None = 0.1  # [s]: the tables' own

    def recognise(self, paths: Sequence[Path]) -> str:
        """How many tables there are of each kind among the files or in the folders; empty if there are none."""
        kinds: list[str] = []
        for path, _ in find_tables(paths):
            kind, plain = "", False
            try:
                kind = self.kind_of(path)
                plain = {"recording", "lane_offset"}.issubset(read_header(path).columns)
            except RecordingError:
                pass  # opening it tells what is wrong
            if kind:
                kinds.append(kind)
            elif self.named(path) and not plain:
                kinds.append(f"{self.named(path)} by name alone")
        return ", ".join(f"{kinds.count(kind)} of {kind}" for kind in sorted(set(kinds)))

    def open(self, paths: Sequence[Path]) -> FoundParts[TripPart]:
        """Look through the tables for where each trip lies."""
        indexed, problems = self._indexed(paths)
        tables = {kind: [table for table in indexed if table.kind == kind] for kind in self.kinds}
        trips_of_kinds = []
        for tables_of_kind in tables.values():
            trips_of_kind, trip_problems = _collect_trips(tables_of_kind)
            trips_of_kinds.append(trips_of_kind)
            problems += trip_problems
        if not trips_of_kinds[0] or not all(tables.values()):
            missing = [what for kind, what in self.kinds.items() if not tables[kind]]
            what = [*missing, f"trip of a table {next(iter(self.kinds))}"][0]
            raise RecordingError(self.name, "; ".join([f"no {what} was found", *map(str, problems[:5])]))
        # a trip that only the first kind's table holds is read as well: it counts, though nothing of it can be used
        entries_of_trips = ([trips.get(key, (0, ())) for trips in trips_of_kinds] for key in trips_of_kinds[0])
        trips = [tuple(zip(*entries, strict=True)) for entries in entries_of_trips]
        trips.sort(key=lambda trip: (trip[0], trip[1][0][0].begin))
        batches: list[tuple[tuple[int, ...], list[tuple[Stretches, ...]]]] = []
        size = self.part_bytes
        for numbers, stretches in trips:
            if size >= self.part_bytes or numbers != batches[-1][0]:
                batches.append((numbers, []))
                size = 0
            batches[-1][1].append(stretches)
            size += _text_bytes(stretches)
        parts: list[TripPart] = []
        for numbers, batch in batches:
            used = tuple(tables[kind][number].table for kind, number in zip(tables, numbers, strict=True))
            key = f"{used[0].name}:{batch[0][0][0].name}"
            parts.append(TripPart(key, used, tuple(batch), self.recordings_of))
        files = tuple(table.file for tables_of_kind in tables.values() for table in tables_of_kind)
        return FoundParts(tuple(parts), files, tuple(problems))

    def _indexed(self, paths: Sequence[Path]) -> tuple[list[IndexedTable], list[Problem]]:
        """The tables among files and in folders; several are read at the same time."""
        files = find_tables(paths)
        with concurrent.futures.ThreadPoolExecutor(AT_ONCE) as beside:
            looked = list(beside.map(self._look_through, [path for path, _ in files]))
        tables: dict[str, IndexedTable] = {}
        problems: list[Problem] = []
        shown = shown_names([path for path, _ in files])
        for (path, by_user), name, (layout, index) in zip(files, shown, looked, strict=True):
            meant = by_user or self.named(path)  # other files in a folder may hold anything
            if meant and layout is not None and layout.note:
                problems.append(Problem.of(name, RecordingError("" if layout.kind else "line 1", layout.note)))
            if isinstance(index, RecordingError):
                problems += [Problem.of(name, index, "it is left out")] if meant else []
            elif layout is not None and index is not None:
                if index.sha256 in tables:
                    what = f"holds the same as {tables[index.sha256].table.name}, byte by byte; it is left out"
                    problems.append(Problem(name, "", what))
                    continue
                if not index.stretches:
                    problems.append(Problem(name, "", "no usable row"))
                cells = layout.cells or (len(layout.columns),)
                table = TripTable(name, str(path.resolve()), layout.columns, cells, index.bytes)
                tables[index.sha256] = IndexedTable(table, layout.kind, index)
        return list(tables.values()), problems

    def _look_through(self, path: Path) -> tuple[TableLayout | None, TripIndex | RecordingError | None]:
        """The layout of a file, and the index of its trips if it is one of the reader's tables."""
        layout = None
        try:
            layout = self.layout_of(path)
            return layout, index_trips(path, layout.begin, layout.line) if layout.kind else None
        except RecordingError as error:
            return layout, error


def _collect_trips(
    tables: Sequence[IndexedTable],
) -> tuple[dict[tuple[int, int], tuple[int, Stretches]], list[Problem]]:
    """The number of the table that holds each trip, and the trip's stretches there."""
    trips: dict[tuple[int, int], tuple[int, Stretches]] = {}
    problems: list[Problem] = []
    first_row: dict[tuple[int, int], str] = {}
    for number, (table, index) in enumerate((entry.table, entry.index) for entry in tables):
        by_trip: dict[tuple[int, int], list[Stretch]] = {}
        split: dict[tuple[int, int], int] = {}  # line in which a trip goes on behind another one
        previous = None
        for stretch in index.stretches:
            key = (stretch.device, stretch.trip)
            by_trip.setdefault(key, []).append(stretch)
            if key != previous and len(by_trip[key]) > 1:
                split.setdefault(key, stretch.line)
            previous = key
        faults = [*index.faults]
        for key, line in split.items():
            first = by_trip[key][0]
            what = f"trip {first.name} goes on here, its rows begin in line {first.line}"
            faults.append(LineFault(line, "apart", f"{what}; they are put together in the order of time"))
        for key, stretches in by_trip.items():
            line = stretches[0].line
            if key in first_row:
                what = f"trip {stretches[0].name} is also in {first_row[key]}; these rows are left out"
                faults.append(LineFault(line, "twice", what))
                continue
            first_row[key] = f"{table.name}, line {line}"
            trips[key] = number, tuple(stretches)
        problems += grouped_problems(table.name, faults)
        if index.more_faults:
            what = f"{index.more_faults} more lines do not begin with a trip's numbers"
            problems.append(Problem(table.name, "", what))
    return trips, problems
