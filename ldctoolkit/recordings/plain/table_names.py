"""Headers of recording tables, and recordings that several files hold: looked at before anything is read in full."""

from __future__ import annotations

import csv
import gzip
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.read import BLOCK_BYTES, SUFFIXES
from ldctoolkit.recordings.recording import Problem

if TYPE_CHECKING:
    import polars as pl

HEADER_BYTES: Final = 1 << 16
"""A header is looked for in so many first bytes."""

MOST_TOLD: Final = 20
"""So many recordings that two files hold are told one by one."""


def header_names(path: Path) -> tuple[str, ...]:
    r"""Names in a file's header, whatever parts them; empty if there is none. Raises nothing.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.csv")
    ...     _ = path.write_text("recording;t\na;0\n")
    ...     header_names(path)
    ('recording', 't')
    """
    name = path.name.lower()
    try:
        if not name.endswith(SUFFIXES) or not path.is_file():
            return ()
        if name.endswith(".parquet"):
            return tuple(_parquet_names(path))
        with gzip.open(path) if name.endswith(".gz") else path.open("rb") as stream:
            first = stream.readline(HEADER_BYTES)  # no more: the rest may be broken, which is told when it is read
    except (OSError, EOFError, ValueError, zlib.error, RecordingError):
        return ()
    utf_16 = first[:2] in (b"\xff\xfe", b"\xfe\xff")
    line = first.decode("utf-16" if utf_16 else "utf-8-sig", "replace").split("\n", 1)[0]
    for mark in ";\t|":
        line = line.replace(mark, ",")
    return tuple(part.strip().strip('"').strip() for part in line.split(","))


def check_header(path: Path) -> None:
    """Refuse a file whose header lacks a column, or that has no rows at all.

    Raises
    ------
    RecordingError
        Naming file and column.
    OSError
        If it cannot be read.
    """
    from ldctoolkit.recordings.plain.frames import Unmetered, check_columns, csv_blocks, is_parquet

    if is_parquet(path):
        check_columns(path, _parquet_names(path))
    elif next(csv_blocks(path, HEADER_BYTES, Unmetered()), None) is None:
        raise RecordingError(f"{path.name}: a header but no rows; at least one sample is needed")


def repeated_names(
    paths: Sequence[Path], shown: Sequence[str]
) -> tuple[tuple[tuple[str, ...], ...], tuple[Problem, ...]]:
    """Recordings that more than one file holds: the first file's rows are taken.

    Parameters
    ----------
    paths : (n,) Path
        Recording tables.
    shown : (n,) str
        Their names in messages.

    Returns
    -------
    left_out : (n,) tuple of str
        For each file, names of recordings that an earlier one holds, too.
    problems : tuple of Problem
        Naming both files and places.
    """
    first: dict[str, tuple[int, int]] = {}
    left_out: list[set[str]] = [set() for _ in paths]
    problems: list[Problem] = []
    more = 0
    for i, path in enumerate(paths):
        word = _word(path)
        for name, row in _names(path).items():
            j, other = first.setdefault(name, (i, row))
            if i == j:
                continue
            left_out[i].add(name)
            if len(problems) == MOST_TOLD:
                more += 1
                continue
            what = f"recording {name!r} is also in {shown[j]}, {_word(paths[j])} {other}; these rows are left out"
            problems.append(Problem(shown[i], f"{word} {row}", what))
    if more:
        problems.append(
            Problem(shown[-1], "", f"{more} more recordings are in an earlier file, too; they are left out")
        )
    return tuple(tuple(sorted(names)) for names in left_out), tuple(problems)


def _word(path: Path) -> str:
    return "row" if path.name.lower().endswith(".parquet") else "line"


def _parquet_names(path: Path) -> list[str]:
    import polars as pl

    from ldctoolkit.recordings.plain.frames import check_parquet_path

    check_parquet_path(path)
    try:
        return list(pl.read_parquet_schema(path))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise RecordingError(f"{path.name}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None


def _names(path: Path) -> dict[str, int]:
    """First row of each recording of a file, as far as it can be read; its faults are told when it is read in full."""
    import polars as pl

    found: dict[str, int] = {}
    try:
        for rows, labels in _parquet_labels(path) if _word(path) == "row" else _csv_labels(path):
            frame = pl.DataFrame({"row": rows, "name": labels.str.strip_chars()})
            frame = frame.filter((pl.col("name") != pl.col("name").shift(1)).fill_null(True)).drop_nulls()
            for row, name in frame.iter_rows():
                found.setdefault(name, row)
    except (RecordingError, OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException):
        pass
    return found


def _parquet_labels(path: Path) -> Iterator[tuple[pl.Series, pl.Series]]:
    import polars as pl

    labels = pl.scan_parquet(path, glob=False).select(pl.col("recording").cast(pl.String)).collect()["recording"]
    yield pl.int_range(1, len(labels) + 1, dtype=pl.Int64, eager=True), labels


def _csv_labels(path: Path) -> Iterator[tuple[pl.Series, pl.Series]]:
    """Lines and names, block by block. Only the one column is parsed, unless a line is at fault."""
    import polars as pl

    from ldctoolkit.recordings.plain.frames import Unmetered, csv_blocks

    for header, block, line in csv_blocks(path, BLOCK_BYTES, Unmetered()):
        index = header.index("recording")
        names = [f"c{i}" for i in range(len(header))]
        lines = block.count(b"\n") + (not block.endswith(b"\n"))
        labels = None
        if b'"' not in block:
            try:
                labels = pl.read_csv(
                    block, has_header=False, schema=dict.fromkeys(names, pl.String), columns=[index], quote_char=None
                ).to_series()
            except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
                labels = None
        if labels is None or len(labels) != lines:
            labels = pl.Series([_cell(raw, index) for raw in block.split(b"\n")[:lines]], dtype=pl.String)
        yield pl.int_range(line, line + lines, dtype=pl.Int64, eager=True), labels


def _cell(raw: bytes, index: int) -> str | None:
    try:
        row = next(csv.reader([raw.decode("utf-8").rstrip("\r")]), [])
    except (UnicodeDecodeError, csv.Error):
        return None
    return row[index] if index < len(row) and row[index].strip() else None
