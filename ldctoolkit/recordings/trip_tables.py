"""Tables of trips: their header, an index of where each trip lies in a file, and the rows of single trips."""

import concurrent.futures
import dataclasses
import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.preparation import MOST_DROPPED, middle_two, rising_rows
from ldctoolkit.recordings.recording import Problem, SourceFile, check_columns, find_tables, shown_names
from ldctoolkit.recordings.text_table import BLANKS, ByteArray, Cells, Layout, LineFault, blocks, read_numbers
from ldctoolkit.whole_file import text_of

LONGEST_HEADER: Final = 1 << 16
_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
_PACKED: Final = {b"\x1f\x8b": "gzip", b"PK": "a ZIP archive", b"PAR1": "Parquet", b"BZh": "bzip2", b"\xfd7zXZ": "xz"}


@dataclasses.dataclass(frozen=True)
class TableLayout:
    """How the rows of a table are laid out."""

    columns: tuple[str, ...]  # name of each cell
    begin: int  # byte where the rows begin
    line: int = 2  # number of that line
    kind: str = ""  # which table it is, where a reader knows several
    cells: tuple[int, ...] = ()  # allowed numbers of cells in a row; empty for one for each column


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


def index_trips(path: Path, begin: int, line: int, *, block_bytes: int = BLOCK_BYTES) -> TripIndex:
    """Find the stretches of lines that belong to one trip each, from byte `begin` on, which is in that `line`."""
    scan = _Scan(begin)
    try:
        with path.open("rb") as stream, concurrent.futures.ThreadPoolExecutor(1) as beside:
            digest = hashlib.sha256(stream.read(begin))
            for block, first in blocks(stream, block_bytes, line):
                hashed = beside.submit(digest.update, block)  # both leave the interpreter free
                scan.add(block, first)
                hashed.result()
    except OSError as error:
        raise RecordingError("", f"cannot be read: {error.strerror or error}") from None
    scan.close()
    return TripIndex(tuple(scan.stretches), tuple(scan.faults), scan.more_faults, scan.at, digest.hexdigest())


class _Scan:
    """State of the search: the stretch that is open, and where the next block begins."""

    def __init__(self, begin: int) -> None:
        self.stretches: list[Stretch] = []
        self.faults: list[LineFault] = []
        self.more_faults = 0
        self.at = begin
        self._key: tuple[int, int] | None = None
        self._first = (0, 0, 0)  # byte and line of the open stretch, lines without a key before it
        self._last = (0, 0)  # behind it

    def add(self, block: bytes, line: int) -> None:
        """Take a block of whole lines, the first of that number."""
        text = np.frombuffer(block, dtype=np.uint8)
        ends = np.flatnonzero(text == ord("\n")) + 1
        if text[-1] != ord("\n"):
            ends = np.append(ends, text.size)
        starts = np.append(0, ends[:-1])
        i = 0
        while i < starts.size:
            start, end = int(starts[i]), int(ends[i])
            match = _KEY.match(block, start, min(start + _KEY_BYTES, end))
            after = i + 1
            if match is not None:
                key = int(match[1]), int(match[2])
                after = _first_other(text, starts, after, np.frombuffer(match[0], dtype=np.uint8))
                if self._key != key:
                    self.close()
                    unkeyed = len(self.faults) + self.more_faults
                    self._key, self._first = key, (self.at + start, line + i, unkeyed)
            elif block[start:end].strip():
                self.close()
                if len(self.faults) < MOST_FAULTS:
                    self.faults.append(LineFault(line + i, "key", _no_key(block[start : min(start + _KEY_BYTES, end)])))
                else:
                    self.more_faults += 1
            if self._key is not None:  # a blank line stays in its stretch
                self._last = (self.at + int(ends[after - 1]), line + after)
            i = after
        self.at += text.size

    def close(self) -> None:
        """End the open stretch."""
        if self._key is not None:
            (begin, line, unkeyed), (end, after) = self._first, self._last
            self.stretches.append(Stretch(*self._key, begin, end, line, after - line, unkeyed))
            if len(self.stretches) > MOST_STRETCHES:
                many = f"more than {MOST_STRETCHES} stretches of rows of one trip each"
                raise RecordingError(f"line {line}", many, allowed="rows sorted by device, trip and time")
        self._key = None


def _first_other(text: ByteArray, starts: IntArray, line: int, key: ByteArray) -> int:
    """The first line from `line` on that does not begin with the key's bytes; looked for in growing steps."""
    step = 16
    while line < starts.size:
        places = np.minimum(starts[line : line + step, None] + np.arange(key.size), text.size - 1)
        other = (text[places] != key).any(axis=1)
        if other.any():
            return line + int(np.argmax(other))
        line, step = line + step, 2 * step
    return int(starts.size)


def _no_key(begin: bytes) -> str:
    cells = begin.strip(b"\r\n").split(b",")[:2]
    shown = ",".join(cell.decode("utf-8", "replace").strip() for cell in cells)
    what = "NUL bytes" if "\0" in shown else repr(shown[:40])
    return f"it begins with {what}; allowed: numbers of device and trip; the line is left out"


Key = tuple[int, int]
T = TypeVar("T")

CHANGED: Final = "the file has changed since it was looked through"
MOST_PROBLEMS: Final = 20  # problems of one kind that are reported one by one; the others are counted
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
class TripRows:
    """Cells of several trips, one trip after the other, times of a trip never falling."""

    cells: Cells  # m rows
    trip: IntArray  # (m,): to which of the requested trips a row belongs; never falls
    problems: tuple[Problem, ...]  # what was left out
    cuts: IntArray  # (k,): rows before which others of their trip were left out, or stand elsewhere in the file

    def joins(self, trip: int) -> FloatArray:
        """Times before and after each of a trip's cuts, (k, 2)."""
        cuts, t = self.cuts[self.trip[self.cuts] == trip], self.cells["Time"]
        return np.column_stack([t[cuts - 1], t[cuts]])


@dataclasses.dataclass(frozen=True)
class FoundTable:
    """A table that can be used."""

    table: TripTable
    kind: str  # which table it is, where a reader knows several
    index: TripIndex  # where its trips lie

    @property
    def file(self) -> SourceFile:
        """The table as one of the files that were read."""
        return SourceFile(self.table.name, self.index.bytes, self.index.sha256)


def collect_trips(tables: Sequence[FoundTable]) -> tuple[dict[Key, tuple[int, tuple[Stretch, ...]]], list[Problem]]:
    """Put the stretches of each trip together."""
    trips: dict[Key, tuple[int, tuple[Stretch, ...]]] = {}
    problems: list[Problem] = []
    seen: dict[Key, str] = {}
    for number, (table, index) in enumerate((entry.table, entry.index) for entry in tables):
        by_trip: dict[Key, list[Stretch]] = {}
        split: dict[Key, int] = {}
        last: Key | None = None
        for stretch in index.stretches:
            key = (stretch.device, stretch.trip)
            by_trip.setdefault(key, []).append(stretch)
            if key != last and len(by_trip[key]) > 1 and key not in split:
                split[key] = stretch.line
            last = key
        faults = [*index.faults]
        for key, line in split.items():
            first = by_trip[key][0]
            what = f"trip {first.name} goes on here, its rows begin in line {first.line}"
            faults.append(LineFault(line, "apart", f"{what}; they are put together in the order of time"))
        for key, stretches in by_trip.items():
            line = stretches[0].line
            if key in seen:
                what = f"trip {stretches[0].name} is also in {seen[key]}; these rows are left out"
                faults.append(LineFault(line, "twice", what))
                continue
            seen[key] = f"{table.name}, line {line}"
            trips[key] = number, tuple(stretches)
        problems += grouped_problems(table.name, faults)
        if index.more_faults:
            what = f"{index.more_faults} more lines do not begin with a trip's numbers"
            problems.append(Problem(table.name, "", what))
    return trips, problems


def text_bytes(stretches: Iterable[Stretch]) -> int:
    """How much text they are."""
    return sum(stretch.end - stretch.begin for stretch in stretches)


def batches(
    trips: Sequence[T], size_of: Callable[[T], int], most: int, separate: Callable[[T, T], bool] | None = None
) -> Iterator[tuple[T, ...]]:
    """Neighbouring trips that are read in one go."""
    batch: list[T] = []
    size = 0
    for i, trip in enumerate(trips):
        batch.append(trip)
        size += size_of(trip)
        if i + 1 == len(trips) or size >= most or (separate is not None and separate(trip, trips[i + 1])):
            yield tuple(batch)
            batch, size = [], 0


def grouped_problems(
    file: str, faults: Iterable[LineFault], most: int = MOST_PROBLEMS, word: str = "line"
) -> list[Problem]:
    """Problems of a file: the first of each kind one by one, the others counted."""
    problems: list[Problem] = []
    seen: dict[str, list[int]] = {}
    for fault in faults:
        lines = seen.setdefault(fault.kind, [])
        lines.append(fault.line)
        if len(lines) <= most:
            problems.append(Problem(file, f"{word} {fault.line}", fault.what))
    for lines in seen.values():
        if len(lines) > most:
            count = len(lines) - most
            more = f"{count} more {word}{'s' * (count > 1)} like {word} {lines[0]}, to {word} {lines[-1]}"
            problems.append(Problem(file, f"{word} {lines[most]}", more))
    return problems


def read_trips(table: TripTable, trips: Sequence[tuple[Stretch, ...]], names: Iterable[str]) -> TripRows:
    """Read those of the named columns that a table has, in rows of trips, and leave out rows that cannot be used."""
    pieces = [stretch for stretches in trips for stretch in stretches]
    lower = [name.lower() for name in table.columns]
    place = {name: lower.index(name.lower()) for name in names if name.lower() in lower}
    spelled = {table.columns[i]: i for i in place.values()}  # faults name a column as the table does
    numbers = read_numbers(_read(table, pieces), Layout(spelled, table.cells))
    if numbers.lines != sum(stretch.lines for stretch in pieces):
        raise RecordingError(table.name, CHANGED)
    first = np.array([stretch.line for stretch in pieces], dtype=np.int64)
    lines = np.array([stretch.lines for stretch in pieces], dtype=np.int64)
    before = np.cumsum(lines) - lines
    owner = np.repeat(np.arange(len(trips)), [sum(stretch.lines for stretch in stretches) for stretches in trips])

    def line_of(row: IntArray) -> IntArray:
        piece = np.searchsorted(before, row, side="right") - 1
        # an empty piece would share its place with the next; there is none
        return row - before[piece] + first[piece]

    lost_rows = np.array([fault.line for fault in numbers.faults], dtype=np.int64)
    values = dict(zip(place, numbers.columns.values(), strict=True))
    trip, t = owner[numbers.row], values["Time"]
    timed = np.abs(t) < LARGEST_TIME  # False for NaN
    no_time = f"column {table.columns[place['Time']]!r} holds no usable time"
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
        piece = np.searchsorted(before, numbers.row[keep], side="right")
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
        values = {name: column_[keep] for name, column_ in values.items()}
        unkeyed = before[1:][np.diff([stretch.unkeyed for stretch in pieces]) != 0] - 0.5
        lost = [lost_rows, np.setdiff1d(numbers.row, text_row), unkeyed]
        over = np.diff(np.searchsorted(np.sort(np.concatenate(lost)), text_row)) != 0
        over |= ~np.isin(np.diff(np.searchsorted(before, text_row, side="right")), (0, 1))  # pieces that changed places
        cuts = np.flatnonzero(over & (np.diff(trip) == 0)) + 1
    return TripRows(
        Cells(values, numbers.row[keep], numbers.lines), trip, tuple(grouped_problems(table.name, sorted(faults))), cuts
    )


def _read(table: TripTable, pieces: Sequence[Stretch]) -> bytes:
    """Text of stretches, one after the other, each ends its last line."""
    text: list[bytes] = []
    try:
        with open(table.path, "rb") as stream:  # noqa: PTH123 - a path as plain text
            if os.fstat(stream.fileno()).st_size != table.bytes:
                raise RecordingError(table.name, CHANGED)
            for piece in pieces:
                stream.seek(piece.begin)
                text.append(stream.read(piece.end - piece.begin))
                if not text[-1].endswith(b"\n"):
                    text.append(b"\n")
    except OSError as error:
        raise RecordingError(table.name, f"cannot be read: {error.strerror or error}") from None
    return b"".join(text)


def rows_in_order(t: FloatArray) -> tuple[BoolArray, int, str]:
    """Which rows of a trip to keep so that its times do not fall, none if its clock starts again; one of the others and
    words for them.
    """
    keep = rising_rows(t)
    if keep.all():
        return keep, 0, ""
    count, fall = np.count_nonzero(~keep), int(np.argmax(t[1:] < t[:-1]))
    words = f"the time runs backwards from {t[fall]:.12g} to {t[fall + 1]:.12g}"
    if count > MOST_DROPPED * t.size:
        words += f", and {count} of {t.size} lines are out of order (allowed: {100 * MOST_DROPPED:g} %)"
        return np.zeros_like(keep), fall + 1, f"{words}; the trip is left out"
    return keep, int(np.argmin(keep)), f"{words}; {'the line is' if count == 1 else f'{count} lines are'} left out"


AT_ONCE: Final = 4  # tables that are read side by side; two keep two cores busy, more than these only make a disk jump


def recognised(paths: Sequence[Path], named: Callable[[Path], str], kind_of: Callable[[Path], str]) -> str:
    """How many tables there are of each kind, as text; empty if there are none."""
    kinds: list[str] = []
    for path, _ in find_tables(paths):
        kind, plain = "", False
        try:
            kind = kind_of(path)
            plain = {"recording", "lane_offset"}.issubset(read_header(path).columns)
        except RecordingError:
            pass  # opening it tells what is wrong
        if kind:
            kinds.append(kind)
        elif named(path) and not plain:
            kinds.append(f"{named(path)} by name alone")
    return ", ".join(f"{kinds.count(kind)} of {kind}" for kind in sorted(set(kinds)))


def look_through(
    paths: Sequence[Path], named: Callable[[Path], str], layout_of: Callable[[Path], tuple[TableLayout | None, str]]
) -> tuple[list[FoundTable], list[Problem]]:
    """Look through the tables that a reader is for; several are read at the same time."""
    files = find_tables(paths)
    shown = shown_names([path for path, _ in files])
    problems_of: list[list[Problem]] = [[] for _ in files]
    layouts: list[tuple[int, TableLayout]] = []

    def report(number: int, error: RecordingError, outcome: str = "") -> None:
        path, by_user = files[number]
        if by_user or named(path):
            problems_of[number].append(Problem.of(shown[number], error, outcome))

    for number, (path, _) in enumerate(files):
        try:
            layout, what = layout_of(path)
        except RecordingError as error:
            report(number, error, "it is left out")
            continue
        if layout is None:
            report(number, RecordingError("line 1", what))
            continue
        if what:
            report(number, RecordingError("", what))
        layouts.append((number, layout))

    def index(entry: tuple[int, TableLayout]) -> TripIndex | RecordingError:
        number, layout = entry
        try:
            return index_trips(files[number][0], layout.begin, layout.line)
        except RecordingError as error:
            return error

    with concurrent.futures.ThreadPoolExecutor(AT_ONCE) as beside:
        indexes = list(beside.map(index, layouts))
    tables: dict[str, FoundTable] = {}
    for (number, layout), trips in zip(layouts, indexes, strict=True):
        if isinstance(trips, RecordingError):
            report(number, trips, "it is left out")
        elif trips.sha256 in tables:
            what = f"holds the same as {tables[trips.sha256].table.name}, byte by byte; it is left out"
            problems_of[number].append(Problem(shown[number], "", what))
        else:
            if not trips.stretches:
                problems_of[number].append(Problem(shown[number], "", "no usable row"))
            cells = layout.cells or (len(layout.columns),)
            table = TripTable(shown[number], str(files[number][0].resolve()), layout.columns, cells, trips.bytes)
            tables[trips.sha256] = FoundTable(table, layout.kind, trips)
    return list(tables.values()), [problem for listed in problems_of for problem in listed]


def no_trips(what: str, problems: Sequence[Problem]) -> str:
    """What was not found, and the first problems."""
    return "; ".join([f"no {what} was found", *map(str, problems[:5])])
