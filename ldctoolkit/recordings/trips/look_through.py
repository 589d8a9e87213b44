"""Big tables among files and folders: which a reader can use, and where the rows of each trip lie in them."""

from __future__ import annotations

import concurrent.futures
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.trips.table_files import find_tables, shown_names
from ldctoolkit.recordings.trips.table_header import TableLayout, is_plain, read_header
from ldctoolkit.recordings.trips.trip_index import TripIndex, index_trips
from ldctoolkit.recordings.trips.trip_rows import TripTable

AT_ONCE: Final = 4
"""Tables that are read side by side; two keep two cores busy, more than these only make a disk jump."""


@dataclasses.dataclass(frozen=True)
class FoundTable:
    """A table that can be used.

    Attributes
    ----------
    table : TripTable
        What it is called, and where it is.
    layout : TableLayout
        What the reader said of it.
    index : TripIndex
        Where its trips lie.
    """

    table: TripTable
    layout: TableLayout
    index: TripIndex


def recognised(paths: Sequence[Path], named: Callable[[Path], str], kind_of: Callable[[Path], str]) -> str:
    """How many tables there are of each kind, in words; empty if there are none.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders.
    named : callable
        Which kind a file's name speaks of; empty for none.
    kind_of : callable
        Which kind a file is by its content; empty for none; raises `RecordingError` if it cannot be read as a table.
    """
    kinds: list[str] = []
    for path, _ in find_tables(paths):
        kind, plain = "", False
        try:
            kind = kind_of(path)
            plain = is_plain(read_header(path).columns)
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
    """Look through the tables that a reader is for; several are read at the same time.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders.
    named : callable
        Which of the reader's tables a file's name speaks of; empty for none. Faults of other files are told only if
        the user named them.
    layout_of : callable
        How a file's rows are laid out, and what is odd about it or an empty text. None, and why, for another table;
        raises `RecordingError` if it cannot be read as one.

    Returns
    -------
    list of FoundTable
        In the order of the files. Of files with the same content the first.
    list of Problem
        Files that are left out, and what is odd; in the same order.
    """
    files = find_tables(paths)
    shown = shown_names([path for path, _ in files])
    said: list[list[Problem]] = [[] for _ in files]
    layouts: list[tuple[int, TableLayout]] = []

    def tell(number: int, place: str, words: str) -> None:
        path, by_user = files[number]
        if by_user or named(path):
            said[number].append(Problem(shown[number], place, words.removeprefix(f"{path.name}: ")))

    for number, (path, _) in enumerate(files):
        try:
            layout, words = layout_of(path)
        except RecordingError as error:
            tell(number, "", f"{error}; it is left out")
            continue
        if layout is None:
            tell(number, "line 1", words)
            continue
        if words:
            tell(number, "", words)
        layouts.append((number, layout))
    indexes = _index_all([(files[number][0], layout) for number, layout in layouts])
    found: dict[str, FoundTable] = {}
    for (number, layout), index in zip(layouts, indexes, strict=True):
        if isinstance(index, RecordingError):
            tell(number, "", f"{index}; it is left out")
        elif index.sha256 in found:
            twin = found[index.sha256].table.name
            said[number].append(Problem(shown[number], "", f"holds the same as {twin}, byte by byte; it is left out"))
        else:
            if not index.stretches:
                said[number].append(Problem(shown[number], "", "no usable row"))
            table = TripTable(shown[number], str(files[number][0].resolve()), layout.columns, index.bytes)
            found[index.sha256] = FoundTable(table, layout, index)
    return list(found.values()), [problem for some in said for problem in some]


def _index_all(tables: Sequence[tuple[Path, TableLayout]]) -> list[TripIndex | RecordingError]:
    def index(table: tuple[Path, TableLayout]) -> TripIndex | RecordingError:
        path, layout = table
        try:
            return index_trips(path, layout.begin, layout.line)
        except RecordingError as error:
            return error

    with concurrent.futures.ThreadPoolExecutor(AT_ONCE) as beside:
        return list(beside.map(index, tables))
