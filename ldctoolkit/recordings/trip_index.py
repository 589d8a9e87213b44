"""Tables of trips: their text as columns of numbers, and an index of where each trip lies in a file."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import MISSING

if TYPE_CHECKING:
    import polars as pl


TEXT_COMPILED_FROM: Final = 1 << 20  # loading a compiler's library is not worth it for less

_LINE_END: Final = 10
_BLANKS: Final = " \t\r\"'"


class LineFault(NamedTuple):
    """A line that was left out."""

    line: int  # its number in a file, or its place in a text, from 0
    kind: str  # faults of one kind are counted together
    what: str  # what is wrong


@dataclasses.dataclass(frozen=True)
class Cells:
    """Columns of numbers."""

    names: tuple[str, ...]  # the k columns
    values: tuple[FloatArray, ...]  # (m,): one array a column; NaN for a missing value
    row: IntArray  # (m,): place of each line in the text, from 0
    lines: int  # lines of the text, whatever they hold
    faults: tuple[LineFault, ...] = ()  # lines left out, by place

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[self.names.index(name)]


def read_cells(
    text: bytes | bytearray | memoryview,
    columns: Sequence[str],
    wanted: Sequence[str],
    *,
    cells: Sequence[int] = (),
    compiled_from: int = TEXT_COMPILED_FROM,
) -> Cells:
    r"""Parse whole lines of numbers.

    Plain numbers, as recorders write them, are parsed by a compiled loop over the bytes, three times as fast as a CSV
    library. If that is not possible, lines are looked through, all together, and the library parses the good ones; if
    that does not help either, the cells are read as words.
    """
    import polars as pl

    allowed = tuple(cells) or (len(columns),)
    place = [f"c{i}" for i in range(max(len(columns), *allowed))]
    chosen = [place[list(columns).index(name)] for name in wanted]
    bytes_ = np.frombuffer(text, dtype=np.uint8)
    if bytes_.size == 0:
        return Cells(tuple(wanted), tuple(np.empty(0) for _ in wanted), np.empty(0, dtype=np.int64), 0)

    lines = int(np.count_nonzero(bytes_ == _LINE_END)) + int(bytes_[-1] != _LINE_END)
    if bytes_.size >= compiled_from:
        from ldctoolkit.recordings._text_kernels import plain_numbers

        for number in allowed:
            numbers = plain_numbers(bytes_, [place.index(name) for name in chosen], number, lines)
            if numbers is not None:
                return Cells(tuple(wanted), tuple(numbers), np.arange(lines), lines)
    row, good, faults = _survey(bytes(text), bytes_, allowed)
    for kind in (pl.Float64, pl.String):
        kinds: dict[str, type[pl.DataType]] = dict.fromkeys(place, pl.String)
        kinds |= dict.fromkeys(chosen, kind)
        try:
            frame = pl.read_csv(
                ",".join(place).encode() + b"\n" + good,
                schema=kinds,
                columns=list(dict.fromkeys(chosen)),
                quote_char=None,
                truncate_ragged_lines=True,
                raise_if_empty=False,
            )
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            continue
        if frame.height == row.size:
            break
    else:  # a text that the library itself cannot split
        raise RecordingError("some lines cannot be split into cells")
    frame = frame.select(chosen)
    if kind is pl.String:
        frame, row, unreadable = _numbers(frame, row, wanted)
        faults += unreadable
    values = tuple(frame[name].fill_null(float("nan")).to_numpy() for name in chosen)
    return Cells(tuple(wanted), values, row, lines, tuple(sorted(faults)))


def _survey(
    text: bytes, bytes_: npt.NDArray[np.uint8], allowed: tuple[int, ...]
) -> tuple[IntArray, bytes, list[LineFault]]:
    """Lines that have the right number of cells, their text, and what is wrong with the others."""
    ends = np.flatnonzero(bytes_ == 10)
    if bytes_[-1] != 10:
        ends = np.append(ends, bytes_.size)
    starts = np.concatenate([[0], ends[:-1] + 1])
    found = np.diff(np.searchsorted(np.flatnonzero(bytes_ == 44), ends), prepend=0) + 1
    good = np.isin(found, allowed)
    faults: list[LineFault] = []
    for i in np.flatnonzero(~good).tolist():
        line = text[starts[i] : ends[i]]
        cells = f"{found[i]} cell{'' if found[i] == 1 else 's'}; allowed: {' or '.join(map(str, allowed))}"
        if line.strip():
            faults.append(LineFault(i, "cells", f"{line.count(0)} NUL bytes" if b"\0\0" in line else cells))
    strange = np.unique(np.searchsorted(ends, np.flatnonzero(bytes_ >= 128)))
    for i in strange[good[strange]]:
        try:
            text[starts[i] : ends[i]].decode("utf-8")
        except UnicodeDecodeError as error:
            good[i] = False
            faults.append(LineFault(int(i), "encoding", f"the text is not UTF-8 ({error.reason})"))
    if not good.all():
        # runs of good lines are copied as they are
        change = np.flatnonzero(np.diff(good.astype(np.int8), prepend=0, append=0))
        text = b"".join(text[starts[a] : ends[b - 1] + 1] for a, b in change.reshape(-1, 2))
    return np.flatnonzero(good), text, faults


def _numbers(
    frame: pl.DataFrame, row: IntArray, wanted: Sequence[str]
) -> tuple[pl.DataFrame, IntArray, list[LineFault]]:
    """Words as numbers; rows with a word that is neither a number nor stands for none are left out."""
    import polars as pl

    strings = frame.with_columns(pl.all().str.strip_chars(_BLANKS))
    values = strings.with_columns(pl.all().cast(pl.Float64, strict=False))
    bad = np.zeros(row.size, dtype=bool)
    faults: list[LineFault] = []
    for column, name in zip(frame.columns, wanted, strict=True):
        wrong = values[column].is_null() & ~strings[column].str.to_lowercase().is_in(MISSING).fill_null(True)
        new = np.flatnonzero(wrong.to_numpy() & ~bad)
        texts = strings[column].gather(new).to_list()
        faults += [
            LineFault(int(row[i]), "number", f"column {name!r} holds {text[:40]!r}; allowed: numbers")
            for i, text in zip(new, texts, strict=True)
        ]
        bad[new] = True
    return values.filter(pl.Series(~bad)), row[~bad], faults


BLOCK_BYTES: Final = 1 << 20
LONGEST_LINE: Final = 1 << 20  # a longer line [bytes] is not a row of a table
COMPILED_FROM: Final = 32 << 20  # loading a compiler's library is not worth it for a smaller file [bytes]
MOST_FAULTS: Final = 20  # lines without a key that are kept; the others are counted
MOST_STRETCHES: Final = 1_000_000  # more stretches than these mean that the rows are not sorted by trip at all

_KEY: Final = re.compile(rb'[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,')
_KEY_BYTES: Final = 128  # a key is looked for in this many first bytes of a line


@dataclasses.dataclass(frozen=True, slots=True)
class Stretch:
    """Neighbouring lines of one trip."""

    device: int  # the key
    trip: int  # the key
    begin: int  # bytes ``begin:end`` of the file; whole lines
    end: int  # bytes ``begin:end`` of the file; whole lines
    line: int  # number of the first line, the file's first is 1
    lines: int  # how many, blank ones included
    unkeyed: int = 0  # lines without a key before it in the file


@dataclasses.dataclass(frozen=True)
class TripIndex:
    """Stretches of a file in its order, and its digest."""

    stretches: tuple[Stretch, ...]
    faults: tuple[LineFault, ...]  # the first lines that have no key
    more_faults: int  # how many more there are
    bytes: int  # size of the file
    sha256: str  # digest of its content, hexadecimal


def index_trips(
    path: Path, begin: int, line: int, *, block_bytes: int = BLOCK_BYTES, compiled_from: int = COMPILED_FROM
) -> TripIndex:
    r"""Find the stretches of lines that belong to one trip each."""
    digest, size, kept = hashlib.sha256(), 0, 0
    # one buffer for the whole file; the begin of a line that a block cuts stays at its front
    buffer = bytearray(LONGEST_LINE + block_bytes + 1)
    view = memoryview(buffer)
    try:
        # the digest is made beside the search: both leave the interpreter free
        compiled = path.stat().st_size >= compiled_from
        scan = _Scan(begin, line, compiled)
        with path.open("rb", buffering=0) as stream, concurrent.futures.ThreadPoolExecutor(1) as beside:
            while count := stream.readinto(view[kept : kept + block_bytes]):
                hashed = beside.submit(digest.update, view[kept : kept + count])
                first, last = 0 if kept else max(0, min(begin - size, count)), kept + count
                size += count
                cut = max(buffer.rfind(b"\n", first, last) + 1, first)
                scan.add(buffer, first, cut)
                kept = last - cut
                hashed.result()
                if kept > LONGEST_LINE:
                    raise RecordingError(f"line {scan.line} is longer than {LONGEST_LINE} bytes")
                view[:kept] = view[cut:last]
    except OSError as error:
        raise RecordingError("cannot be read", f"{error.strerror or error}") from None
    if kept:
        buffer[kept] = 10
        scan.add(buffer, 0, kept + 1, unended=1)
    scan.close()
    return TripIndex(tuple(scan.stretches), tuple(scan.faults), scan.more_faults, size, digest.hexdigest())


class _Scan:
    """State of the search: the stretch that is open, and where the next block begins."""

    def __init__(self, begin: int, line: int, compiled: bool) -> None:
        self.stretches: list[Stretch] = []
        self.faults: list[LineFault] = []
        self.more_faults = 0
        self.line = line
        self._at = begin
        self._compiled: Callable[..., int] | None = None
        if compiled:
            from ldctoolkit.recordings._text_kernels import first_other_line

            self._compiled = first_other_line
        self._key: tuple[int, int] | None = None
        self._first = (0, 0, 0)  # byte and line of the open stretch, lines without a key before it
        self._last = (0, 0)  # behind it

    def add(self, block: bytearray, first: int, last: int, unended: int = 0) -> None:
        """Take bytes ``first:last`` of a block, whole lines; the last one's end may not be in the file."""
        if first == last:
            return
        text = np.frombuffer(block, dtype=np.uint8)[first:last]
        ends = np.flatnonzero(text == 10) + 1
        starts = np.empty_like(ends)
        starts[0], starts[1:] = 0, ends[:-1]
        begins = starts.tolist() if self._compiled is None else []
        i = 0
        while i < starts.size:
            start, end = first + int(starts[i]), first + int(ends[i])
            found = _KEY.match(block, start, min(start + _KEY_BYTES, end))
            after = i + 1
            if found is not None:
                key, same = (int(found[1]), int(found[2])), bytes(found[0])
                if self._compiled is not None:
                    after = self._compiled(text, starts, i, same)
                else:
                    while after < len(begins) and block.startswith(same, first + begins[after]):
                        after += 1
                if self._key != key:
                    self.close()
                    unkeyed = len(self.faults) + self.more_faults
                    self._key, self._first = key, (self._at + start - first, self.line + i, unkeyed)
            elif block[start:end].strip():
                self.close()
                cells = bytes(block[start : min(start + _KEY_BYTES, end)]).strip(b"\r\n").split(b",")[:2]
                shown = ",".join(cell.decode("utf-8", "replace").strip() for cell in cells)
                begin = "NUL bytes" if "\0" in shown else repr(shown[:40])
                what = f"it begins with {begin}; allowed: numbers of device and trip; the line is left out"
                if len(self.faults) < MOST_FAULTS:
                    self.faults.append(LineFault(self.line + i, "key", what))
                else:
                    self.more_faults += 1
            if self._key is not None:  # a blank line stays in its stretch
                self._last = (self._at + int(ends[after - 1]), self.line + after)
            i = after
        self._at += last - first - unended
        self.line += starts.size
        if unended and self._key is not None:
            self._last = (min(self._last[0], self._at), self._last[1])

    def close(self) -> None:
        """End the open stretch."""
        if self._key is not None:
            (begin, line, unkeyed), (end, after) = self._first, self._last
            self.stretches.append(Stretch(*self._key, begin, end, line, after - line, unkeyed))
            if len(self.stretches) > MOST_STRETCHES:
                what = f"line {line}: more than {MOST_STRETCHES} stretches of rows of one trip each"
                raise RecordingError(f"{what}; allowed: rows sorted by device, trip and time")
        self._key = None
