"""Recording files as blocks of typed columns; CSV, CSV.gz and Parquet. Imports polars, so it is imported late."""

from __future__ import annotations

import codecs
import csv
import gzip
import hashlib
import io
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Final

import numpy as np
import polars as pl

from ldctoolkit.errors import RecordingError, nearest
from ldctoolkit.recordings.plain.table_values import FAULT, NUMBERS, ROW, Faults, typed

REQUIRED: Final = ("recording", "t", "lane_offset", "lane_width", "speed")
COLUMNS: Final = (*REQUIRED, "curvature", "yaw_rate", "lane", "valid", "turn_signal")

LONGEST_LINE: Final = 1 << 20
"""A longer line [bytes] is not CSV; without a limit a binary file would be read into memory as one line."""

PACKED_PIECE: Final = 1 << 16
"""Packed files are unpacked in pieces of so many bytes: what lies before a cut is not lost with it."""

_BROKEN: Final = (EOFError, zlib.error, gzip.BadGzipFile)


class Meter:
    """Counts the bytes read from a file and hashes them."""

    def __init__(self, tick: Callable[[int], None]) -> None:
        self.bytes = 0
        self._sha256 = hashlib.sha256()
        self._tick = tick

    def update(self, data: bytes | memoryview) -> None:
        """Take more bytes into account."""
        self.bytes += len(data)
        self._sha256.update(data)
        self._tick(len(data))

    @property
    def sha256(self) -> str:
        """Digest of the bytes so far, hexadecimal."""
        return self._sha256.hexdigest()


class Unmetered(Meter):
    """Neither counts nor hashes."""

    def __init__(self) -> None:
        super().__init__(lambda _: None)

    def update(self, data: bytes | memoryview) -> None:
        """Pass over the bytes."""


class _Metered(io.RawIOBase):
    """A raw stream whose bytes pass a meter."""

    def __init__(self, stream: IO[bytes], meter: Meter) -> None:
        self._stream = stream
        self._meter = meter

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        data = self._stream.read(len(buffer))
        buffer[: len(data)] = data
        self._meter.update(data)
        return len(data)


def frames(path: Path, block_bytes: int, meter: Meter, faults: Faults | None = None) -> Iterator[pl.DataFrame]:
    """Blocks of a recording file: the known columns, typed, and `ROW`.

    Parameters
    ----------
    path : Path
        A file that ends in .csv, .csv.gz or .parquet.
    block_bytes : int
        About how many bytes of text are taken at once.
    meter : Meter
        Sees every byte of the file.
    faults : list of RecordingError, optional
        Where given, faults of single lines and values are added to it, and the blocks have the column `FAULT`.

    Yields
    ------
    polars.DataFrame
        Blocks in the order of the file. Missing numbers are NaN.

    Raises
    ------
    RecordingError
        Naming file, column and place.
    """
    read = parquet_frames if is_parquet(path) else csv_frames
    blocks = read(path, block_bytes, meter, faults)
    seen: set[str] = set()
    present: list[str] = []
    rows = 0
    for block in blocks:
        rows += block.height
        present = block.columns
        # a column that holds nothing at all is a mistake, not a series of invalid samples
        for name in set(present) - seen:
            values = block[name]
            if name in NUMBERS:
                seen |= {name} if values.is_finite().any() else set()
            elif name != "lane" or values.null_count() < values.len():
                seen.add(name)
        yield block
    empty = [name for name in COLUMNS if name in present and name not in seen]
    if rows == 0:
        fault = RecordingError(f"{path.name}: a header but no rows; at least one sample is needed")
    elif empty:
        advice = "" if empty[0] in REQUIRED else "; leave the column out if it was not recorded"
        fault = RecordingError(f"{path.name}: column '{empty[0]}' holds no number in any of {rows} rows{advice}")
    else:
        return
    if faults is None:
        raise fault
    faults.append(fault)


def is_parquet(path: Path) -> bool:
    """Whether the name is that of a Parquet file."""
    return path.name.lower().endswith(".parquet")


def csv_frames(path: Path, block_bytes: int, meter: Meter, faults: Faults | None = None) -> Iterator[pl.DataFrame]:
    """Blocks of whole lines of a CSV or CSV.gz file, parsed."""
    for header, block, line in csv_blocks(path, block_bytes, meter):
        if faults is None:
            yield _parse(path, header, block, line)
            continue
        if _ends_inside(header, block):
            yield _parse_faulty(path, header, block, line, faults)
            continue
        try:
            yield _parse(path, header, block, line).with_columns(pl.lit(False).alias(FAULT))
        except RecordingError:
            yield _parse_faulty(path, header, block, line, faults)


def csv_blocks(path: Path, block_bytes: int, meter: Meter) -> Iterator[tuple[list[str], bytes, int]]:
    """Blocks of whole lines of a CSV or CSV.gz file: the header's names, the lines, the number of the first.

    Of a packed file that is cut short the lines before the cut come first, then the error.
    """
    zipped = path.name.lower().endswith(".gz")
    with path.open("rb") as raw:
        metered = io.BufferedReader(_Metered(raw, meter), 1 << 18)
        stream = gzip.GzipFile(fileobj=metered) if zipped else metered
        line = 0
        try:
            first = stream.readline(LONGEST_LINE)
            if first[:2] == b"\x1f\x8b":
                raise RecordingError(f"{path.name}: the content is gzip; give it a name that ends in .csv.gz")
            if len(first) == LONGEST_LINE:
                raise RecordingError(f"{path.name}, line 1: longer than {LONGEST_LINE} bytes; this is not CSV")
            header = _csv_header(path, first)
            line = 2
            rest = b""
            broken: Exception | None = None
            while broken is None:
                block, broken = _next_bytes(stream, block_bytes)
                if not block:
                    break
                block = rest + block
                cut = block.rfind(b"\n") + 1
                block, rest = block[:cut], block[cut:]
                if len(rest) >= LONGEST_LINE and not block:
                    raise RecordingError(f"{path.name}, line {line}: longer than {LONGEST_LINE} bytes; this is not CSV")
                if block:
                    yield header, block, line
                    line += block.count(b"\n")
            if broken is not None:
                raise broken  # the line that it cuts is lost
            if rest:
                yield header, rest, line
        except _BROKEN as error:
            where = f" after line {line - 1}" if line else ""
            fault = f"broken gzip{where} ({error}); is the file cut short or not gzip?"
            raise RecordingError(f"{path.name}: {fault}") from None


def _next_bytes(stream: IO[bytes] | gzip.GzipFile, size: int) -> tuple[bytes, Exception | None]:
    """The next bytes of a file, about so many, and what ended those of a packed one before their time.

    What a cut leaves is sound. Of bytes that cannot be unpacked nobody knows where they went wrong: none is given.
    """
    if not isinstance(stream, gzip.GzipFile):
        return stream.read(size), None
    pieces: list[bytes] = []
    count = 0
    try:
        while count < size and (piece := stream.read1(PACKED_PIECE)):
            pieces.append(piece)
            count += len(piece)
    except EOFError as error:
        return b"".join(pieces), error
    return b"".join(pieces), None


def _csv_header(path: Path, first: bytes) -> list[str]:
    if first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise RecordingError(f"{path.name}: the text is UTF-16; save it as UTF-8")
    try:
        text = first.decode("utf-8-sig").strip("\r\n")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path.name}, line 1: the text is not UTF-8 ({error.reason})") from None
    if not text.strip():
        state = "the file is empty" if not first else "line 1 is blank"
        raise RecordingError(f"{path.name}: {state}; a header is needed: {', '.join(REQUIRED)}, ...")
    names = [name.strip() for name in _fields(path, text, 1)]
    if len(names) == 1 and any(mark in text for mark in ";\t|"):
        raise RecordingError(f"{path.name}, line 1: columns are not separated by commas: {text[:60]!r}")
    check_columns(path, names)
    return names


def _fields(path: Path, text: str, line: int) -> list[str]:
    try:
        return next(csv.reader([text]), [])
    except csv.Error as error:
        fault = "a carriage return stands inside the line" if "\r" in text else str(error)
        raise RecordingError(f"{path.name}, line {line}: {fault}; allowed: lines that end in LF or CR LF") from None


def check_columns(path: Path, names: Sequence[str]) -> None:
    """Refuse a header that lacks a column or repeats one."""
    for name in COLUMNS:
        if names.count(name) > 1:
            raise RecordingError(f"{path.name}: column '{name}' appears {names.count(name)} times")
    for name in REQUIRED:
        if name not in names:
            # the nearest name is looked for among the file's own, which is what its author has to rename
            unknown = [given for given in names if given and given not in COLUMNS]
            hint = nearest(name, unknown) if unknown else "no other column of the file could be it"
            hint = hint.replace("allowed:", "columns not known here:")
            raise RecordingError(f"{path.name}: column '{name}' is missing; {hint}. Needed: {', '.join(REQUIRED)}")


def _parse(path: Path, header: list[str], block: bytes, line: int) -> pl.DataFrame:
    """Lines as typed columns; `line` is the number of the first."""
    # positional names: a file may repeat or leave blank the names of columns that nobody needs
    position = [f"c{i}" for i in range(len(header))]
    wanted = {name: position[header.index(name)] for name in COLUMNS if name in header}
    text = (",".join(position) + "\n").encode() + block.replace(b"\r\n", b"\n")

    if b'"' in text and _open_quote(text):
        raise _line_fault(path, len(header), block, line, "a quotation mark is not closed")

    def read(numbers: type[pl.DataType]) -> pl.DataFrame:
        kinds: dict[str, type[pl.DataType]] = dict.fromkeys(position, pl.String)
        kinds |= {place: numbers for name, place in wanted.items() if name in NUMBERS}
        frame = pl.read_csv(io.BytesIO(text), schema=kinds, columns=list(wanted.values()), raise_if_empty=False)
        return frame.select(pl.col(place).alias(name) for name, place in wanted.items())

    try:
        frame = read(pl.Float64)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
        # slower, but tolerates blanks and words for "missing", and can say where the fault lies
        try:
            frame = read(pl.String)
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            raise _line_fault(path, len(header), block, line, str(error)) from None
    if frame.height != block.count(b"\n") + (not block.endswith(b"\n")):
        raise _line_fault(path, len(header), block, line, "a quoted field holds a line break")
    frame = frame.with_columns(pl.int_range(line, line + frame.height, dtype=pl.Int64).alias(ROW))
    return typed(path, frame.filter(~pl.all_horizontal(pl.col(list(wanted)).is_null())), "line")


def _parse_faulty(path: Path, header: list[str], block: bytes, line: int, faults: Faults) -> pl.DataFrame:
    """Lines of which some are at fault: these are left out where they cannot be split, and told.

    A line left out marks the sample before or behind it that has its recording's name, or else both.
    """
    index = {name: header.index(name) for name in COLUMNS if name in header}
    good, places, broken = [], [], []
    lines = block.replace(b"\r\n", b"\n").split(b"\n")
    for number, raw in enumerate(lines, line):
        fault = _fault_of_line(path, len(header), raw, number)
        if fault is None and number == line + len(lines) - 1 and _ends_inside(header, block):
            few = f"{raw.count(b',') + 1} of {len(header)} fields"
            fault = RecordingError(f"{path.name}, line {number}: the file ends inside this line, behind {few}")
        if fault is not None:
            faults.append(fault)
            broken.append((number, raw.split(b",")[: index["recording"] + 1][-1].strip(b' "')))
        elif raw.strip():
            good.append(raw)
            places.append(number)
    cells: dict[str, list[str | None]] = {name: [] for name in index}
    for raw in good:
        row = next(csv.reader([raw.decode()]))
        for name, i in index.items():
            cells[name].append(row[i] if i < len(row) else None)
    rows = np.array(places, dtype=np.int64)
    near = np.zeros(rows.size, dtype=bool)
    for number, name_there in broken:
        after = int(np.searchsorted(rows, number))
        around = [i for i in (after - 1, after) if 0 <= i < rows.size]
        same = [i for i in around if (cells["recording"][i] or "").strip().encode() == name_there]
        near[same or around] = True
    frame = pl.DataFrame(cells, schema=dict.fromkeys(index, pl.String))
    return typed(path, frame.with_columns(pl.Series(ROW, rows), pl.Series(FAULT, near)), "line", faults)


def _ends_inside(header: list[str], block: bytes) -> bool:
    """Whether the last line has no end and lacks cells: the file was cut. Short lines elsewhere lack values only."""
    last = block[block.rfind(b"\n") + 1 :]
    return bool(last.strip()) and last.count(b",") + 1 < len(header)


def _open_quote(text: bytes) -> bool:
    """Whether any line has an odd number of quotation marks; the CSV parser must not see such a line."""
    marks = np.frombuffer(text, dtype=np.uint8)
    ends = np.append(np.flatnonzero(marks == ord("\n")), marks.size)
    quotes = np.searchsorted(np.flatnonzero(marks == ord('"')), ends)
    return bool((quotes % 2).any())


def _line_fault(path: Path, fields: int, block: bytes, line: int, reason: str) -> RecordingError:
    """What is wrong with a block that cannot be split into columns; looked for line by line, only after a failure."""
    for number, raw in enumerate(block.split(b"\n"), line):
        fault = _fault_of_line(path, fields, raw, number)
        if fault is not None:
            return fault
    return RecordingError(f"{path.name}, after line {line - 1}: cannot be read as CSV: {reason.splitlines()[0]}")


def _fault_of_line(path: Path, fields: int, raw: bytes, number: int) -> RecordingError | None:
    """Why a line cannot be split into columns, if it cannot."""
    try:
        text = raw.decode("utf-8").rstrip("\r")
        if text.count('"') % 2:
            return RecordingError(f"{path.name}, line {number}: a quotation mark is not closed on its line")
        found = len(_fields(path, text, number))
    except UnicodeDecodeError as error:
        return RecordingError(f"{path.name}, line {number}: the text is not UTF-8 ({error.reason})")
    except RecordingError as error:
        return error
    if found > fields:
        return RecordingError(f"{path.name}, line {number}: {found} fields; the header has {fields} columns")
    return None


def check_parquet_path(path: Path) -> None:
    """Refuse a path that cannot be given to the Parquet library."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise RecordingError(f"{path.name}: its path is not UTF-8; allowed for Parquet: names in UTF-8") from None


def parquet_frames(path: Path, block_bytes: int, meter: Meter, faults: Faults | None = None) -> Iterator[pl.DataFrame]:
    """Blocks of rows of a Parquet file."""
    check_parquet_path(path)
    with path.open("rb") as raw:
        while data := raw.read(1 << 20):
            meter.update(data)
    rows = max(block_bytes // 64, 1)
    try:
        # missing files, directories and patterns were refused before, so a fault here lies in the content
        schema = pl.read_parquet_schema(path)
        check_columns(path, list(schema))
        lazy = pl.scan_parquet(path, glob=False).select(name for name in COLUMNS if name in schema)
        first = 0
        while True:
            frame = lazy.slice(first, rows).collect()
            if frame.height == 0:
                return
            numbered = frame.with_columns(pl.int_range(first + 1, first + frame.height + 1, dtype=pl.Int64).alias(ROW))
            if faults is not None:
                numbered = numbered.with_columns(pl.lit(False).alias(FAULT))
            yield typed(path, numbered, "row", faults)
            first += frame.height
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise RecordingError(f"{path.name}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None
