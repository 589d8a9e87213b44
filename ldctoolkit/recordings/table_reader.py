"""Plain tables of recordings, CSV or Parquet: the text table, its columns and units, and what is wrong with it."""

import codecs
import dataclasses
import gzip
import itertools
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import polars as pl

from ldctoolkit.arrays import BoolArray
from ldctoolkit.errors import RecordingError, first_line
from ldctoolkit.recordings.preparation import clock_stretches
from ldctoolkit.recordings.recording import (
    FoundParts,
    Problem,
    Recording,
    SourceFile,
    check_columns,
    real_path,
    shown_names,
    source_file,
)
from ldctoolkit.recordings.text_table import (
    LONGEST_LINE,
    MISSING,
    MOST_PROBLEMS,
    Layout,
    LineFault,
    Stream,
    as_numbers,
    blocks,
    cells_of,
    grouped_problems,
    open_text,
    parse,
)

REQUIRED: Final = ("recording", "t", "lane_offset", "lane_width", "speed")
NO_ROWS: Final = "a header but no rows; at least one sample is needed"

UNITS: Final = {
    "t": "s", "lane_offset": "m", "lane_width": "m", "speed": "m/s", "curvature": "1/m", "yaw_rate": "rad/s",
    "heading": "rad", "steering": "rad", "steering_command": "rad",
}  # fmt: skip
"""Columns of numbers, and what they are in."""

# further columns of a frame: the line of a CSV file or row of a Parquet file; whether a sample is at fault or next to a
# line that could not be used; whether a line was lost between it and the sample before
ROW: Final = "(row)"
FAULT: Final = "(fault)"
CUT: Final = "(cut)"

# numbers that words stand for, words for none, and what is allowed
_SWITCH: Final = ({"1": 1, "1.0": 1, "true": 1, "0": 0, "0.0": 0, "false": 0}, MISSING, "0, 1, false, true")
_SIGNAL: Final = (
    {"1": 1, "1.0": 1, "+1": 1, "left": 1, "-1": -1, "-1.0": -1, "right": -1},
    ("0", "0.0", "-0.0", "none", "off", "null", "nan", ""),
    "left, right, none, or 1 (left), -1 (right), 0 (none)",
)


def _typed(frame: pl.DataFrame, word: str, faults: list[RecordingError]) -> pl.DataFrame:
    """Columns in their types; the first value of a column that does not fit is a fault, all of them are marked."""
    marked = frame[FAULT].to_numpy() if FAULT in frame.columns else np.zeros(frame.height, dtype=bool)
    columns: list[pl.Series] = [frame[ROW], frame[CUT]]
    for name in frame.columns:
        if name in (ROW, FAULT, CUT):
            continue
        column, bad, allowed = _typed_column(name, frame[name])
        columns.append(column.alias(name))
        if bad.any():
            i, count = int(np.argmax(bad)), np.count_nonzero(bad)
            total = f" ({count} {word}s in all)" if count > 1 else ""
            what = f"column '{name}' holds {frame[name][i]!r}"
            faults.append(RecordingError(f"{word} {frame[ROW][i]}", what, allowed=f"{allowed}{total}"))
            marked = marked | bad
    return pl.DataFrame([*columns, pl.Series(FAULT, marked)])


def _typed_column(name: str, values: pl.Series) -> tuple[pl.Series, BoolArray, str]:
    """A column in its type, where a value does not fit, and what is allowed."""
    kind = values.dtype
    if name in UNITS:
        if kind != pl.String and not kind.is_numeric() and kind != pl.Null:
            raise RecordingError("", f"column '{name}' is of type {kind}", allowed="numbers")
        numbers, bad = as_numbers(values)
        return pl.Series(numbers), bad, "numbers"
    if kind.is_nested() or kind in (pl.Binary, pl.Duration):
        raise RecordingError("", f"column '{name}' is of type {kind}", allowed="text or numbers")
    texts = values.cast(pl.String).str.strip_chars()
    lower = texts.str.to_lowercase()
    missing = lower.is_in(MISSING).fill_null(True)
    if name in ("recording", "lane"):
        # lanes "3" and "3.0" are the same, whatever the rest of the column holds
        texts = texts.str.replace(r"^(-?\d+)\.0+$", "$1") if name == "lane" else texts
        bad = missing.to_numpy() & (name == "recording")
        return pl.select(pl.when(~missing).then(texts)).to_series(), bad, "an identifier of the recording"
    words, none, allowed = _SIGNAL if name == "turn_signal" else _SWITCH
    states = lower.replace_strict(words, default=None, return_dtype=pl.Int64)
    bad = (states.is_null() & ~lower.is_in(none).fill_null(True)).to_numpy()
    return states.fill_null(0).cast(pl.Int64 if words is _SIGNAL[0] else pl.Boolean), bad, allowed


def _columns_of(frame: pl.DataFrame) -> dict[str, Any]:
    """The columns of a frame as those of a `Recording`, by name."""
    columns: dict[str, Any] = {name: frame[name].to_numpy() for name in COLUMNS[1:] if name in frame.columns}
    valid = columns.get("valid", np.ones(frame.height, dtype=bool))
    if "lane" in columns:
        valid = valid & frame["lane"].is_not_null().to_numpy()
        columns["lane"] = frame["lane"].rank("dense").fill_null(0).to_numpy().astype(np.int64)
    return columns | {"valid": valid}


COLUMNS: Final = ("recording", *UNITS, "lane", "valid", "turn_signal", "engaged")

LINE_END: Final = b"\n"
_BROKEN: Final = (EOFError, zlib.error, gzip.BadGzipFile)
_POLARS: Final = (pl.exceptions.PolarsError, pl.exceptions.PanicException)


def _named_rows(path: Path, block_bytes: int, faults: list[RecordingError]) -> Iterator[pl.DataFrame]:
    """Blocks of rows that have a recording's name: the known columns, typed, with `ROW`, `FAULT` and `CUT`."""
    filled: set[str] = set()  # columns that hold something
    present: list[str] = []
    rows = 0
    for block in _blocks_of(path, block_bytes, faults, COLUMNS):
        rows += block.height
        present = block.columns
        # a column that holds nothing at all is a mistake, not a series of invalid samples
        for name in set(present) - filled:
            values = block[name]
            if name in UNITS:
                filled |= {name} if values.is_finite().any() else set()
            elif name not in ("lane", "recording") or values.null_count() < values.len():
                filled.add(name)
        nameless = block["recording"].fill_null("") == ""  # such rows mark their neighbours
        if nameless.any():
            near = nameless.shift(1).fill_null(False) | nameless.shift(-1).fill_null(False)
            block = block.with_columns((block[FAULT] | near).alias(FAULT)).filter(~nameless)
        yield block
    empty = [name for name in COLUMNS if name in present and name not in filled]
    if rows == 0:
        faults.append(RecordingError("", NO_ROWS))
    elif "recording" in empty:
        faults[:] = [RecordingError("", f"column 'recording' holds no name in any of {rows} rows")]
    elif empty:
        advice = "" if empty[0] in REQUIRED else "; leave the column out if it was not recorded"
        faults.append(RecordingError("", f"column '{empty[0]}' holds no number in any of {rows} rows{advice}"))


def _blocks_of(
    path: Path, block_bytes: int, faults: list[RecordingError], names: Sequence[str]
) -> Iterator[pl.DataFrame]:
    """Blocks of rows of a recording file: the columns of these names, typed, with `ROW`, `FAULT` and `CUT`."""
    return (_parquet_blocks if is_parquet(path) else _csv_blocks)(path, block_bytes, faults, names)


LONGEST_PIECE: Final = 500_000  # a recording of more samples than about this many is handed on in pieces
WELL_INSIDE: Final = 0.15  # offset, as a share of the lane's width, below which no edge is near a line
CALM: Final = 2.0  # time [s] before and after the border of two pieces in which the vehicle is well inside its lane


def _whole_recordings(blocks: Iterator[pl.DataFrame]) -> Iterator[tuple[pl.DataFrame, bool]]:
    """Regroup blocks of rows so that each holds whole recordings, or a piece of a long one: true if it goes on.

    The last recording of a block waits for the next block.
    """
    rest: pl.DataFrame | None = None
    for block in blocks:
        if block.height == 0:
            continue
        joined = block if rest is None else pl.concat([rest, block])
        labels = joined["recording"]
        earlier = (labels != labels[-1]).arg_true()
        begin = int(earlier[-1]) + 1 if earlier.len() else 0  # where the last recording begins
        if begin == 0 and joined.height > LONGEST_PIECE:
            begin = _border_of_pieces(joined)
        if begin:
            yield joined[:begin], labels[begin - 1] == labels[begin]
        rest = joined[begin:]
    if rest is not None:
        yield rest, False


def _border_of_pieces(frame: pl.DataFrame) -> int:
    """First row of the next piece: the last one that the vehicle is well inside its lane around, of the second half."""
    t, offset, width = (frame[name].to_numpy() for name in ("t", "lane_offset", "lane_width"))
    half = t.size // 2
    with np.errstate(all="ignore"):
        share = np.where(width > 0.0, np.abs(offset) / width, np.inf)
        inside, rises = share < WELL_INSIDE, t[1:] >= t[:-1]
        inside[1:] &= rises
        inside[:-1] &= rises
        inside[0] = inside[-1] = False  # what comes after the end is not known yet
        outside = np.flatnonzero(~inside)
        after = np.searchsorted(outside, np.arange(half, t.size))
        calm = (t[half:] - t[outside[after - 1]] > CALM) & (t[outside[after]] - t[half:] > CALM)
    return half + int(np.flatnonzero(calm)[-1] if calm.any() else np.argmin(np.nan_to_num(share[half:], nan=np.inf)))


def is_parquet(path: Path) -> bool:
    """Whether the name is that of a Parquet file."""
    return path.name.lower().endswith(".parquet")


def csv_lines(path: Path, block_bytes: int, faults: list[RecordingError]) -> Iterator[tuple[list[str], bytes, int]]:
    """Blocks of whole lines of a CSV or CSV.gz file: the header's names, the lines, the number of the first.

    Comments and units become blank lines. Of a packed file that is cut short the lines before the cut come first, then
    the error.
    """
    line = 0  # the next one, once the header has been read
    try:
        with open_text(path) as stream:
            header, number = _header(stream, faults)
            line, begun = number + 1, False
            for block, first in blocks(stream, block_bytes, line, count_nuls=True):
                line = first + block.count(LINE_END)
                if b"#" in block:
                    block = re.sub(rb"(?m)^#[^\n\0]*$", b"", block)
                if not begun and (row := re.search(rb"(?m)^.*[^\s,].*", block)):
                    begun = True
                    shown_line = f"line {first + block.count(LINE_END, 0, row.start())}"
                    if b"\0" not in row[0] and _are_units(header, row[0], shown_line):
                        faults.append(RecordingError(shown_line, "a row of units; it is passed over"))
                        block = block[: row.start()] + block[row.end() :]
                if block and not block.isspace():
                    yield header, block, first
    except _BROKEN as error:
        where = f" after line {line - 1}" if line else ""
        raise RecordingError("", f"broken gzip{where} ({error}); is the file cut short or not gzip?") from None


def _header(stream: Stream, faults: list[RecordingError]) -> tuple[list[str], int]:
    """The header's names, and the number of its line."""
    first, line, nuls = _header_line(stream, LONGEST_LINE)
    shown_line = f"line {line}"
    if first[:2] == b"\x1f\x8b":
        raise RecordingError("", "the content is gzip; give it a name that ends in .csv.gz")
    if len(first) == LONGEST_LINE:
        raise RecordingError(shown_line, f"longer than {LONGEST_LINE} bytes; this is not CSV")
    try:
        header = [name.strip() for name in cells_of(first)]
    except ValueError as error:
        raise RecordingError(shown_line, str(error)) from None
    if not any(header):
        state = "the file is empty" if line == 1 else "only comments and blank lines"
        raise RecordingError("", f"{state}; a header is needed: {', '.join(REQUIRED)}, ...")
    if len(header) == 1 and any(mark in header[0] for mark in ";\t|"):
        raise RecordingError(shown_line, f"columns are not separated by commas: {header[0][:60]!r}")
    check_columns(header, REQUIRED, COLUMNS)
    if nuls and header[0] not in COLUMNS:
        raise RecordingError(shown_line, f"{nuls} NUL bytes stand where the header begins")
    if nuls:
        faults.append(RecordingError(shown_line, f"{nuls} NUL bytes before the header; they are passed over"))
    return header, line


def _header_line(stream: Stream, longest: int) -> tuple[bytes, int, int]:
    """The first line behind comments, blank lines and NUL bytes, its number, and how many such bytes there are."""
    number, nuls = 1, 0
    while line := stream.readline(longest):
        text = line.lstrip(b"\0")
        nuls += len(line) - len(text)
        words = text.removeprefix(codecs.BOM_UTF8).strip()
        if words and not words.lower().startswith((b"#", b"sep=")):
            return text if text.endswith(b"\n") or not nuls else text + stream.readline(longest), number, nuls
        number += text.endswith(b"\n")
    return b"", number, nuls


def _are_units(header: list[str], raw: bytes, line: str) -> bool:
    """Whether the first line under the header names units; raises `RecordingError` for another unit than is needed."""
    cells = (cell.strip(' \r"()[]') for cell in raw.decode("utf-8", "replace").split(","))
    words = {name: word for name, word in zip(header, cells, strict=False) if name in UNITS}
    words = {name: word for name, word in words.items() if word.lower() not in (*MISSING, "-")}
    if pl.Series(words.values(), dtype=pl.String).cast(pl.Float64, strict=False).is_not_null().any():
        return False
    for name, word in words.items():
        unit = word.lower().replace(" ", "").replace("sec", "s")
        if ("1/m" if unit in ("m^-1", "m\u207b\xb9", "rad/m") else unit) != UNITS[name]:
            raise RecordingError(line, f"column '{name}' is in {word!r}", hint=f"needed: {UNITS[name]}")
    return bool(words)


def _csv_blocks(
    path: Path, block_bytes: int, faults: list[RecordingError], names: Sequence[str]
) -> Iterator[pl.DataFrame]:
    """Blocks of whole lines of a CSV or CSV.gz file, parsed; lines that cannot be split are left out, and reported."""
    nul_lines: list[int] = []
    last_row = 0
    for header, block, line in csv_lines(path, block_bytes, faults):
        columns = {name: header.index(name) for name in names if name in header}
        frame, rows, line_faults = parse(block, Layout(columns, (len(header),), quoted=True), UNITS.keys() & columns)
        near = np.zeros(rows.size, dtype=bool)
        for fault in line_faults:
            outcome = "; the line is left out" if fault.kind == "nul" else ""
            faults.append(RecordingError(f"line {line + fault.line}", f"{fault.what}{outcome}"))
            if fault.kind == "nul":
                nul_lines.append(line + fault.line)
                continue
            # it marks the row before or behind it that has its recording's name, or else both
            name = fault.text.split(b",")[: columns["recording"] + 1][-1].strip(b' "\r')
            after = int(np.searchsorted(rows, fault.line))
            around = [i for i in (after - 1, after) if 0 <= i < rows.size]
            near[[i for i in around if (frame["recording"][i] or "").strip().encode() == name] or around] = True
        rows += line
        cut = np.diff(np.searchsorted(nul_lines, np.append(last_row, rows))) > 0
        last_row = int(rows[-1]) if rows.size else last_row
        marks = (pl.Series(ROW, rows), pl.Series(FAULT, near), pl.Series(CUT, cut))
        yield _typed(frame.with_columns(marks), "line", faults)


def parquet_names(path: Path) -> list[str]:
    """Names of a Parquet file's columns."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise RecordingError("", "its path is not UTF-8", allowed="for Parquet names in UTF-8") from None
    try:
        return list(pl.read_parquet_schema(path))
    except _POLARS as error:
        raise _not_parquet(error) from None


def _parquet_blocks(
    path: Path, block_bytes: int, faults: list[RecordingError], names: Sequence[str]
) -> Iterator[pl.DataFrame]:
    """Blocks of rows of a Parquet file."""
    present = parquet_names(path)
    check_columns(present, REQUIRED, COLUMNS)
    height, first = max(block_bytes // 64, 1), 0
    lazy = pl.scan_parquet(path, glob=False).select(name for name in names if name in present)
    while True:
        try:
            frame = lazy.slice(first, height).collect()
        except _POLARS as error:
            raise _not_parquet(error) from None
        if frame.height == 0:
            return
        rows = pl.int_range(first + 1, first + frame.height + 1, dtype=pl.Int64).alias(ROW)
        yield _typed(frame.with_columns(rows, pl.lit(False).alias(CUT)), "row", faults)
        first += frame.height


def _not_parquet(error: BaseException) -> RecordingError:
    return RecordingError("", f"cannot be read as Parquet: {first_line(error)}")


SUFFIXES: Final = (".csv", ".csv.gz", ".parquet")

BLOCK_BYTES: Final = 8 << 20  # about how much text is parsed at once
HEADER_BYTES: Final = 1 << 16  # a header is looked for in so many first bytes


def _repeated_names(
    paths: Sequence[Path], shown: Sequence[str]
) -> tuple[list[tuple[str, ...]], list[Problem], tuple[str, ...]]:
    """Of each file, recordings that an earlier one holds, too; problems that say so; names that end as "a (2)" does."""
    first: dict[str, tuple[int, int]] = {}  # file and row that a recording begins in
    left_out: list[tuple[str, ...]] = []
    problems: list[Problem] = []
    for i, path in enumerate(paths):
        faults: dict[str, LineFault] = {}
        for name, row in _first_rows(path).items():
            file, first_row = first.setdefault(name, (i, row))
            if file != i:
                what = f"recording {name!r} is also in {shown[file]}, {row_word(paths[file])} {first_row}"
                faults[name] = LineFault(row, "", f"{what}; these rows are left out")
        left_out.append(tuple(sorted(faults)))
        problems += grouped_problems(shown[i], faults.values(), word=row_word(path))
    return left_out, problems, tuple(name for name in first if name.endswith(")"))


def row_word(path: Path) -> str:
    """What a row of a file is called in messages."""
    return "row" if is_parquet(path) else "line"


def _first_rows(path: Path) -> dict[str, int]:
    """First row of each recording of a file, as far as it can be read; faults are reported when it is read in full."""
    first_rows: dict[str, int] = {}
    name = pl.col("recording").fill_null("")
    try:
        for block in _blocks_of(path, BLOCK_BYTES, [], ("recording",)):
            first = block.filter((name != name.shift(1)).fill_null(True) & (name != ""))
            for label, row in first.select("recording", ROW).iter_rows():
                first_rows.setdefault(label, row)
    except (RecordingError, OSError):
        pass
    return first_rows


KNOWN_BY: Final = 3  # a file with so many of the five columns that are needed is meant as a recording table
LARGEST_TIME: Final = 1e20  # a time of this size or more [s] is none; sums of such would overflow


@dataclasses.dataclass
class _Progress:
    """How far a file has been read."""

    first_rows: dict[str, int] = dataclasses.field(default_factory=dict)  # of each recording
    label: str = ""  # the recording that the rows before belong to
    name: str = ""  # the name that it is given, another one where its clock started again; empty if it is left out
    last_time: float = -np.inf  # of its last sample that was given
    rows_lost: bool = False  # whether rows after that one were left out
    used_names: frozenset[str] = frozenset()  # names in any file; read where the first clock starts again


@dataclasses.dataclass(frozen=True)
class TablePart:
    """One file of recordings."""

    path: str  # the file
    key: str  # its index among the source's files, and its name
    bytes: int  # its size
    shown: str  # its name in messages: with as few folders as tell it apart from the others
    left_out: tuple[str, ...] = ()  # recordings that another file holds, too
    block_bytes: int = BLOCK_BYTES  # about how much text is parsed at once
    numbered: tuple[str, ...] = ()  # names in any of the files that end as "a (2)" does

    def read(self) -> Iterator[Recording | Problem]:
        """Recordings in the file's order; one with a fault in any of its rows is left out, and reported.

        Of a long one only the piece with the fault is.
        """
        count = 0
        for item in self._items():
            if isinstance(item, Recording):
                yield item
                continue
            count, last = count + 1, item
            if count <= MOST_PROBLEMS:
                yield Problem.of(self.shown, item)
        if (unnamed := count - MOST_PROBLEMS) > 0:
            yield Problem(self.shown, "", f"{unnamed} more problem{'s' * (unnamed > 1)}; the last: {last}")

    def _items(self) -> Iterator[Recording | RecordingError]:
        """Recordings and faults, in the order in which they are met."""
        faults: list[RecordingError] = []
        progress = _Progress()
        try:
            for frame, goes_on in _whole_recordings(_named_rows(Path(self.path), self.block_bytes, faults)):
                yield from faults
                faults.clear()
                yield from self._recordings(frame, goes_on, progress)
        except RecordingError as fault:
            faults.append(fault)
        except OSError as error:
            faults.append(RecordingError("", f"cannot be read: {error.strerror or error}"))
        yield from faults

    def _recordings(
        self, frame: pl.DataFrame, goes_on: bool, progress: _Progress
    ) -> Iterator[Recording | RecordingError]:
        """The recordings in a block of rows, or the pieces of them that it holds; the last one may go on behind it."""
        word = row_word(Path(self.path))
        labels, rows, fault = frame["recording"], frame[ROW].to_numpy(), frame[FAULT].to_numpy()
        starts = np.concatenate([[0], np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())])
        columns = _columns_of(frame)
        timed = np.abs(columns["t"]) < LARGEST_TIME  # False for NaN
        count = np.append(0, np.cumsum(1 + frame[CUT].to_numpy()))  # of rows down to each one, with the lost ones

        def fault_at(i: int, what: str) -> RecordingError:
            return RecordingError(f"{word} {rows[i]}", f"recording {label!r}{what}")

        for label, start, end in zip(
            labels.gather(starts).to_list(), starts.tolist(), [*starts[1:].tolist(), frame.height], strict=True
        ):
            outcome = "it is left out"
            if label == progress.label or (goes_on and end == frame.height):
                outcome = f"this piece of it, {word}s {rows[start]} to {rows[end - 1]}, is left out"
            if label != progress.label:
                progress.label, progress.last_time, progress.rows_lost = label, -np.inf, False
                first_row = progress.first_rows.get(label)
                progress.name = "" if label in self.left_out or first_row is not None else label
                if first_row is not None:
                    what = f"comes in separate pieces, the first from {word} {first_row}; this one is left out"
                    yield fault_at(start, f" {what}")
                elif progress.name:
                    progress.first_rows[label] = int(rows[start])
            if not progress.name:
                continue
            timed_rows = start + np.flatnonzero(timed[start:end])  # a sample without a time is passed over
            t = columns["t"][timed_rows]
            first = start + int(np.argmax(fault[start:end]))
            what = " has a fault here" if fault[first] else ""
            try:
                stretches = clock_stretches(t)
            except RecordingError as error:
                first, what = timed_rows[int(np.argmax(t[1:] < t[:-1])) + 1], f": {error}"
            if what:
                yield fault_at(first, f"{what}; {outcome}")
                progress.rows_lost = True
                continue
            if sum(map(len, stretches)) < timed_rows.size:
                disordered = np.delete(timed_rows, np.concatenate(stretches))
                total = f" ({disordered.size} {word}s in all)" if disordered.size > 1 else ""
                time = float(columns["t"][disordered[0]])
                what = f"t = {time!r} s is not in the order of time; the {word} is left out{total}"
                yield fault_at(disordered[0], f": {what}")
            for stretch in (timed_rows[piece] for piece in stretches if piece.size):
                if columns["t"][stretch[0]] < progress.last_time:
                    progress.name, progress.last_time = self._another_name(label, progress), -np.inf
                    progress.first_rows[progress.name] = int(rows[stretch[0]])
                    what = f"the clock starts again here; it is read as another recording {progress.name!r}"
                    yield fault_at(stretch[0], f": {what}")
                continues, count_after = progress.last_time > -np.inf, count[stretch + 1]
                lost_before = continues and count_after[0] - count[start] + progress.rows_lost > 1
                cut = np.append(lost_before, count_after[1:] - count_after[:-1] > 1)
                whole = stretch[-1] - stretch[0] == stretch.size - 1
                samples = slice(stretch[0], stretch[-1] + 1) if whole else stretch
                piece: dict[str, Any] = {name: values[samples] for name, values in columns.items()}
                piece |= {"cut": cut if cut.any() else None, "continues": continues}
                yield Recording(progress.name, source=self.shown, **piece)
                progress.last_time = float(columns["t"][stretch[-1]])
            progress.rows_lost = timed_rows.size == 0 or stretch[-1] < end - 1

    def _another_name(self, label: str, progress: _Progress) -> str:
        """A name for the rows behind a clock that starts again: "a (2)", or the next one that is free."""
        progress.used_names = progress.used_names or frozenset({*self.numbered, *_first_rows(Path(self.path))})
        names = (f"{label} ({number})" for number in itertools.count(2))
        return next(name for name in names if name not in progress.first_rows and name not in progress.used_names)


@dataclasses.dataclass(frozen=True)
class TableReader:
    """Reads plain recording tables; see `RecordingReader`."""

    name: str = "table"
    title: str = "plain recording tables (CSV, CSV.gz, Parquet)"
    vehicle_width: float = 1.9
    step: float | None = None
    block_bytes: int = BLOCK_BYTES

    def recognise(self, paths: Sequence[Path]) -> str:
        """What was found, if one of the files has a recording table's header; otherwise an empty text."""
        count = sum(map(_is_table, _files(paths)))
        return f"{count} recording table{'s' * (count > 1)}" if count else ""

    def open(self, paths: Sequence[Path]) -> FoundParts[TablePart]:
        """Look through files, or folders that hold them."""
        problems: list[Problem] = []
        accepted: dict[Path, SourceFile] = {}
        by_digest: dict[str, str] = {}
        files = _files(paths)
        for path, shown in zip(files, shown_names(files), strict=True):
            try:
                if path.is_dir():
                    raise RecordingError("", "the folder holds no recording table")
                if not path.name.lower().endswith(SUFFIXES):
                    raise RecordingError("", "the suffix is not known", allowed=", ".join(SUFFIXES))
                file = source_file(path, shown)
                # refuse a file whose header lacks a column, or that has no rows at all
                if is_parquet(path):
                    check_columns(parquet_names(path), REQUIRED, COLUMNS)
                elif next(csv_lines(path, HEADER_BYTES, []), None) is None:
                    raise RecordingError("", NO_ROWS)
                if (first := by_digest.setdefault(file.sha256, shown)) != shown:
                    raise RecordingError("", f"holds the same as {first}, byte by byte; it is left out")
                accepted[path] = file
            except RecordingError as error:
                problems.append(Problem.of(shown, error.at("") if error.path == shown else error))
            except OSError as error:
                problems.append(Problem(shown, "", f"cannot be read: {error.strerror}"))
        if not accepted:
            count = len(problems) - 1
            raise problems[0].error.hinted(f"{count} more problem{'s' * (count > 1)}" if count else "")
        names = [file.name for file in accepted.values()]
        left_out, repeated, numbered = _repeated_names(list(accepted), names) if names[1:] else ([()], [], ())
        parts = tuple(
            TablePart(str(path), f"{i:05d}-{path.name}", file.bytes, file.name, left_out[i], self.block_bytes, numbered)
            for i, (path, file) in enumerate(accepted.items())
        )
        return FoundParts(parts, tuple(accepted.values()), (*problems, *repeated))


READER: Final = TableReader()


def _is_table(path: Path) -> bool:
    """Whether a file is meant as a recording table, whatever parts the names of its header."""
    name = path.name.lower()
    try:
        if not name.endswith(SUFFIXES) or not path.is_file():
            return False
        if is_parquet(path):
            names = parquet_names(path)
        else:
            with open_text(path) as stream:
                # no more: the rest may be broken, which is reported when it is read
                first, _, _ = _header_line(stream, HEADER_BYTES)
            line = first.decode("utf-8-sig", "replace").replace("\0", "").split("\n", 1)[0]  # of UTF-16 the letters
            names = [part.strip(' \t\r"') for part in re.split(r"[,;\t|]", line)]
    except (OSError, EOFError, ValueError, zlib.error):
        return False
    return len(set(REQUIRED).intersection(names)) >= KNOWN_BY


def _files(paths: Sequence[Path]) -> list[Path]:
    """The files, each once; of a folder those with a recording table's suffix and columns, or else the folder."""
    files: dict[str, Path] = {}
    for path in paths:
        try:
            inside = sorted(path.iterdir()) if path.is_dir() else []
        except (OSError, ValueError):
            inside = []  # opening it tells why
        for file in list(filter(_is_table, inside)) or [path]:
            files.setdefault(real_path(file), file)
    return list(files.values())
