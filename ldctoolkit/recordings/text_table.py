"""Delimited text, read tolerantly: blocks of whole lines, and their cells as columns.

A fault costs the line that it is in, not the text. Sound lines are parsed by polars; where it refuses a text, lines are
looked through, all together, and it gets the sound ones.
"""

import csv
import dataclasses
import gzip
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.checked_files import text_of
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem

MISSING: Final = ("", "null", "nan", "na", "n/a", "none", "-nan", "#n/a")
"""Words for a missing number, in lower case, without blanks around them."""

BLANKS: Final = " \t\r\"'"  # around numbers and names; they do not count

LONGEST_LINE: Final = 1 << 20  # a longer line [bytes] is not a row of a table; a binary file would be read as one line
PACKED_PIECE: Final = 1 << 16  # packed files are unpacked in such pieces [bytes]: what lies before a cut is not lost
_COMMA, _LINE_END, _QUOTE, _RETURN = b',\n"\r'

Stream = IO[bytes] | gzip.GzipFile
ByteArray = npt.NDArray[np.uint8]


class LineFault(NamedTuple):
    """A line that was left out."""

    line: int  # its number in a file, or its index in a text, from 0
    kind: str  # faults of one kind are counted together
    what: str  # what is wrong
    text: bytes = b""  # the line itself


MOST_PROBLEMS: Final = 20  # problems of one kind that are reported one by one; the others are counted


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


def open_text(path: Path) -> Stream:
    """A text file, or one that gzip has packed."""
    return gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb")


def blocks(stream: Stream, size: int, line: int, *, count_nuls: bool = False) -> Iterator[tuple[bytes, int]]:
    r"""Whole lines, about `size` bytes at a time, and the number of the first; only the file's last may have no end.

    NUL bytes in a row may become their number between two of them (``b"\0512\0"``), so that many take no memory.
    """
    rest, ended = b"", False
    while not ended:
        block = _next_bytes(stream, size)
        ended = not block
        if count_nuls and b"\0" in block:
            block = re.sub(rb"\0+", lambda nuls: b"\0%d\0" % len(nuls[0]), block)
        block = rest + block
        end = len(block) if ended else block.rfind(b"\n") + 1
        block, rest = block[:end], block[end:]
        if block:
            yield block, line
            line += block.count(b"\n")
        if len(rest) >= LONGEST_LINE:
            raise RecordingError(f"line {line}", f"longer than {LONGEST_LINE} bytes; this is not CSV")


def _next_bytes(stream: Stream, size: int) -> bytes:
    """About `size` more bytes of a file; empty at its end.

    Of a packed file that was cut short, the bytes before the cut are returned, and the next call raises `EOFError`. Of
    one with damaged bytes none are returned, since it is not known where the damage begins.
    """
    if not isinstance(stream, gzip.GzipFile):
        return stream.read(size)
    pieces: list[bytes] = []
    try:
        while sum(map(len, pieces)) < size and (piece := stream.read1(PACKED_PIECE)):
            pieces.append(piece)
    except EOFError:
        if not pieces:
            raise
    return b"".join(pieces)


def cells_of(raw: bytes) -> list[str]:
    """The cells of one line, which may be quoted; raises `ValueError` with the reason for one that cannot be split."""
    text = text_of(raw).strip("\r\n")
    if text.count('"') % 2:
        raise ValueError("a quotation mark is not closed on its line")
    try:
        return next(csv.reader([text]), [])
    except csv.Error as error:
        reason = "a carriage return stands inside the line" if "\r" in text else str(error)
        raise ValueError(f"{reason}; allowed: lines that end in LF or CR LF") from None


@dataclasses.dataclass(frozen=True)
class Layout:
    """How lines are laid out in cells."""

    columns: Mapping[str, int]  # the columns that are read, and the index of the cell of each
    cells: tuple[int, ...]  # allowed numbers of cells in a line
    quoted: bool = False  # cells may stand in quotation marks, and a line may lack its last ones


def parse(text: bytes, layout: Layout, numbers: Collection[str]) -> tuple[pl.DataFrame, IntArray, list[LineFault]]:
    """Columns of whole lines, the line index of each row in the text, and the lines that were left out.

    The columns of `numbers` hold text where any of their cells is no plain number. A blank line is no row.
    """
    rows, text, faults = _survey(text, layout)
    frame = _split(text, rows.size, layout, numbers)
    if frame is None:  # quotation marks in places where polars cannot tell them from text
        split = map(cells_of if layout.quoted else _plain_cells, text.split(b"\n")[: rows.size])
        table = [[row[i] if i < len(row) else None for i in layout.columns.values()] for row in split]
        frame = pl.DataFrame(table, schema=dict.fromkeys(layout.columns, pl.String), orient="row")
    if layout.quoted and (blank := frame.select(pl.all_horizontal(pl.all().is_null())).to_series()).any():
        frame, rows = frame.filter(~blank), rows[~blank.to_numpy()]
    return frame, rows, faults


def line_count(text: bytes) -> int:
    """Number of lines, the last one with an end or without."""
    return text.count(b"\n") + (text[-1:] not in (b"", b"\n"))


def _ends_inside(text: bytes, cells: int) -> bool:
    """Whether the last line has no end and lacks cells: the file was cut. Short lines elsewhere lack values only."""
    last = text[text.rfind(b"\n") + 1 :]
    return bool(last.strip()) and last.count(b",") + 1 < cells


def _split(text: bytes, lines: int, layout: Layout, numbers: Collection[str]) -> pl.DataFrame | None:
    """Lines as columns of numbers and texts; None if polars cannot split them."""
    # positional names: a file may repeat or leave blank the names of columns that are not needed
    names = [f"c{i}" for i in range(max(layout.cells))]
    text = b"".join((",".join(names).encode(), b"\n", text.replace(b"\r\n", b"\n") if layout.quoted else text))
    for kind in (pl.Float64, pl.String):  # text is slower, but tolerates blanks and words for "missing"
        kinds: dict[str, Any] = dict.fromkeys(names, pl.String)
        kinds |= {names[layout.columns[name]]: kind for name in numbers}
        try:
            frame = pl.read_csv(
                text,
                schema=kinds,
                columns=list(dict.fromkeys(names[i] for i in layout.columns.values())),
                quote_char='"' if layout.quoted else None,
                raise_if_empty=False,
            )
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            continue
        # else a line has too many cells, or a quoted cell holds a line break
        if frame.height == lines:
            return frame.select(pl.col(names[i]).alias(name) for name, i in layout.columns.items())
    return None


def _plain_cells(line: bytes) -> list[str]:
    return line.decode("utf-8").split(",")


def _survey(text: bytes, layout: Layout) -> tuple[IntArray, bytes, list[LineFault]]:
    """Lines that can be split, their text, and what is wrong with the others."""
    bytes_ = np.frombuffer(text, dtype=np.uint8)
    marks = np.flatnonzero((bytes_ == _COMMA) | (bytes_ == _LINE_END))
    last = np.flatnonzero(bytes_[marks] == _LINE_END)
    if bytes_.size and bytes_[-1] != _LINE_END:
        marks, last = np.append(marks, bytes_.size), np.append(last, marks.size)
    ends, cells = marks[last], np.diff(last, prepend=-1)

    def lines_with(*values: int) -> IntArray:
        return np.searchsorted(ends, np.flatnonzero(np.isin(bytes_, values)))

    doubtful = cells > max(layout.cells) if layout.quoted else ~np.isin(cells, layout.cells)
    if bytes_.size and bytes_.max() >= 128:
        doubtful[np.searchsorted(ends, np.flatnonzero(bytes_ >= 128))] = True
    if layout.quoted:
        if b'"' in text:
            doubtful |= np.bincount(lines_with(_QUOTE), minlength=ends.size) % 2 > 0
        if b"\0" in text or text.count(b"\r") != text.count(b"\r\n"):
            doubtful[lines_with(0, _RETURN)] = True
        doubtful[-1:] |= _ends_inside(text, max(layout.cells))
    if not doubtful.any():
        return np.arange(ends.size), text, []
    starts, good = np.append(0, ends[:-1] + 1), ~doubtful
    faults: list[LineFault] = []
    for i in np.flatnonzero(doubtful).tolist():
        line = text[starts[i] : ends[i]]
        if not line.strip():
            continue
        fault = _fault_of(line, int(cells[i]), bool(ends[i] == bytes_.size), layout)
        if fault is None:
            good[i] = True
        else:
            faults.append(LineFault(i, *fault, line))
    # runs of good lines are copied as they are
    change = np.flatnonzero(np.diff(good.astype(np.int8), prepend=0, append=0))
    text = b"".join(text[starts[a] : ends[b - 1] + 1] for a, b in change.reshape(-1, 2))
    return np.flatnonzero(good), text, faults


def _fault_of(line: bytes, cells: int, unended: bool, layout: Layout) -> tuple[str, str] | None:
    """What kind of fault a line has, and its description."""
    try:
        if layout.quoted:
            if b"\0" in line:
                count = sum(map(int, re.findall(rb"\0(\d+)\0", line)))
                return "nul", f"{count} NUL bytes{' at the end of the file' if unended else ''}"
            cells = len(cells_of(line))
            if cells > max(layout.cells):
                return "cells", f"{cells} fields; the header has {max(layout.cells)} columns"
            if unended and _ends_inside(line, max(layout.cells)):
                few = f"{line.count(b',') + 1} of {max(layout.cells)} fields"
                return "cells", f"the file ends inside this line, behind {few}"
        elif cells not in layout.cells:
            allowed = " or ".join(map(str, layout.cells))
            nuls = line.count(0) if b"\0\0" in line else 0
            return "cells", f"{nuls} NUL bytes" if nuls else f"{cells} cell{'s' * (cells != 1)}; allowed: {allowed}"
        text_of(line)
    except ValueError as error:
        return "encoding", str(error)
    return None


@dataclasses.dataclass(frozen=True)
class Cells:
    """Columns of numbers."""

    columns: dict[str, FloatArray]  # (m,) each; NaN for a missing value
    row: IntArray  # (m,): line index of each row in the text, from 0
    lines: int  # lines of the text, whatever they hold
    faults: tuple[LineFault, ...] = ()  # lines left out, in order

    def __getitem__(self, name: str) -> FloatArray:
        return self.columns[name]


def read_numbers(text: bytes, layout: Layout) -> Cells:
    """Columns of numbers; a line with a cell that is neither a number nor a word for a missing one is left out."""
    frame, row, faults = parse(text, layout, layout.columns)
    bad = np.zeros(row.size, dtype=bool)
    columns: dict[str, FloatArray] = {}
    for name in layout.columns:
        values, wrong = as_numbers(frame[name], BLANKS)
        for i in np.flatnonzero(wrong & ~bad).tolist():
            what = f"column {name!r} holds {frame[name][i].strip(BLANKS)[:40]!r}; allowed: numbers"
            faults.append(LineFault(int(row[i]), "number", what))
        bad |= wrong
        columns[name] = values
    if bad.any():
        row, columns = row[~bad], {name: values[~bad] for name, values in columns.items()}
    return Cells(columns, row, line_count(text), tuple(sorted(faults)))


def as_numbers(values: pl.Series, blanks: str | None = None) -> tuple[FloatArray, BoolArray]:
    """A column as numbers, NaN for a missing one, and where a word stands neither for a number nor for none; (m,)."""
    bad = np.zeros(values.len(), dtype=bool)
    if values.dtype == pl.String:
        words = values.str.strip_chars(blanks)
        values = words.cast(pl.Float64, strict=False)
        bad = (values.is_null() & ~words.str.to_lowercase().is_in(MISSING).fill_null(True)).to_numpy()
    return values.cast(pl.Float64).fill_null(float("nan")).to_numpy(), bad
