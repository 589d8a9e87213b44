"""Headers of recording tables, and recordings that several files hold: looked at before anything is read in full."""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.plain.table_fault import NO_ROWS, TableFault
from ldctoolkit.recordings.recording import Problem

SUFFIXES: Final = (".csv", ".csv.gz", ".parquet")

BLOCK_BYTES: Final = 16 << 20
"""About how much text is parsed at once."""

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
            from ldctoolkit.recordings.plain.frames import parquet_names

            return tuple(parquet_names(path))
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
    TableFault
        Naming the column.
    OSError
        If it cannot be read.
    """
    from ldctoolkit.recordings.plain.frames import check_columns, csv_blocks, is_parquet, parquet_names

    if is_parquet(path):
        check_columns(parquet_names(path))
    elif next(csv_blocks(path, HEADER_BYTES), None) is None:
        raise TableFault("", NO_ROWS)


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
        word = place_word(path)
        for name, row in _names(path).items():
            j, other = first.setdefault(name, (i, row))
            if i == j:
                continue
            left_out[i].add(name)
            if len(problems) == MOST_TOLD:
                more += 1
                continue
            what = f"recording {name!r} is also in {shown[j]}, {place_word(paths[j])} {other}; these rows are left out"
            problems.append(Problem(shown[i], f"{word} {row}", what))
    if more:
        problems.append(
            Problem(shown[-1], "", f"{more} more recordings are in an earlier file, too; they are left out")
        )
    return tuple(tuple(sorted(names)) for names in left_out), tuple(problems)


def place_word(path: Path) -> str:
    """What a place in a file is called."""
    return "row" if path.name.lower().endswith(".parquet") else "line"


def _names(path: Path) -> dict[str, int]:
    """First row of each recording of a file, as far as it can be read; its faults are told when it is read in full."""
    import polars as pl

    from ldctoolkit.recordings.plain.frames import blocks_of
    from ldctoolkit.recordings.plain.table_values import ROW

    found: dict[str, int] = {}
    name = pl.col("recording").fill_null("")
    try:
        for block in blocks_of(path, BLOCK_BYTES, [], ("recording",)):
            first = block.filter((name != name.shift(1)).fill_null(True) & (name != ""))
            for label, row in first.select("recording", ROW).iter_rows():
                found.setdefault(label, row)
    except (RecordingError, OSError):
        pass
    return found
