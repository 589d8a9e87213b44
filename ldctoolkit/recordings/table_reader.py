"""Reader of plain recording tables as a source: a part is a file; a recording at fault is left out, the others stay."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.plain.table_names import check_header, header_names, repeated_names
from ldctoolkit.recordings.read import BLOCK_BYTES, SUFFIXES, check_file, columns_of, whole_recordings
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.source_file import SourceFile, source_file
from ldctoolkit.recordings.sources import FoundParts
from ldctoolkit.recordings.trips.table_files import shown_names

if TYPE_CHECKING:
    import polars as pl

KNOWN_BY: Final = 3
"""A file with so many of the five columns that are needed is meant as a recording table."""

MOST_TOLD: Final = 20
"""So many problems of one file are told one by one; the others are counted."""

LARGEST_TIME: Final = 1e20
"""A time of this size or more [s] is none, whatever the clock and its unit; sums of such would overflow."""

_PLACE: Final = re.compile(r"(?:, ((?:after )?(?:line|row) \d+))?: (.*)", re.DOTALL)


@dataclasses.dataclass(frozen=True)
class TablePart:
    """One file of recordings.

    Attributes
    ----------
    path : str
        The file.
    key : str
        Its place among the source's files, and its name.
    bytes : int
        Its size.
    left_out : tuple of str
        Recordings that another file holds, too.
    shown : str
        Its name in messages: with as few folders as tell it apart from the others; by default its own name.
    """

    path: str
    key: str
    bytes: int
    left_out: tuple[str, ...] = ()
    shown: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "shown", self.shown or Path(self.path).name)

    def read(self) -> Iterator[Recording | Problem]:
        """Recordings in the file's order; one with a fault in any of its rows is left out, and told."""
        told = 0
        more: Problem | None = None
        for one in _recordings(Path(self.path), self.shown, set(self.left_out)):
            if isinstance(one, Recording):
                yield one
                continue
            told += 1
            if told <= MOST_TOLD:
                yield one
            else:
                more = one
        if more is not None:
            count = told - MOST_TOLD
            yield Problem(
                self.shown, "", f"{count} more problem{'s' * (count > 1)}; the last: {more.place}: {more.what}"
            )


class TableReader:
    """Reads plain recording tables; see `RecordingReader`."""

    name: str = "table"
    title: str = "plain recording tables (CSV, CSV.gz, Parquet)"
    vehicle_width: float = 1.9
    step: float | None = None

    def recognise(self, paths: Sequence[Path]) -> str:
        """What was found, if one of the files has a recording table's header; otherwise an empty text."""
        from ldctoolkit.recordings.plain.frames import REQUIRED

        found = sum(len(set(header_names(path)) & set(REQUIRED)) >= KNOWN_BY for path in _files(paths))
        return f"{found} recording table{'s' * (found > 1)}" if found else ""

    def open(self, paths: Sequence[Path]) -> FoundParts[TablePart]:
        """Look through files, or folders that hold them.

        Raises
        ------
        RecordingError
            If nothing can be used.
        """
        problems: list[Problem] = []
        found: dict[Path, SourceFile] = {}
        twins: dict[str, str] = {}
        files = list(_files(paths))
        for path, shown in zip(files, _shown(files), strict=True):
            try:
                if not path.name.lower().endswith(SUFFIXES) and not path.is_dir():
                    raise RecordingError(f"{path.name}: the suffix is not known; allowed: {', '.join(SUFFIXES)}")
                check_file(path, "a recording file, or a folder that holds some,")
                if path.resolve() in found:
                    raise RecordingError(f"{path.name}: given twice")
                check_header(path)
                file = source_file(path, shown)
                if file.sha256 in twins:
                    twin = twins[file.sha256]
                    raise RecordingError(f"{path.name}: holds the same as {twin}, byte by byte; it is left out")
                found[path.resolve()] = file
                twins[file.sha256] = shown
            except RecordingError as error:
                problems.append(problem_of(error, path, shown))
            except OSError as error:
                problems.append(Problem(shown, "", f"cannot be read: {error.strerror or error}"))
        if not found:
            others = f" (and {len(problems) - 1} more problems)" if len(problems) > 1 else ""
            raise RecordingError(f"{problems[0]}{others}" if problems else "no recording file is given")
        names = [file.name for file in found.values()]
        left_out, repeated = repeated_names(list(found), names) if len(found) > 1 else ((), ())
        parts = tuple(
            TablePart(str(path), f"{i:05d}-{path.name}", file.bytes, left_out[i] if left_out else (), file.name)
            for i, (path, file) in enumerate(found.items())
        )
        return FoundParts(parts, tuple(found.values()), (*problems, *repeated))


READER: Final = TableReader()


def problem_of(error: RecordingError, path: Path, shown: str = "") -> Problem:
    """An error that names file, place and fault, as a `Problem` of the file under the name that is shown.

    Examples
    --------
    >>> problem_of(RecordingError("a.csv, line 3: 7 fields; the header has 5 columns"), Path("a.csv")).place
    'line 3'
    """
    text = str(error)
    rest = text.removeprefix(str(path)) if text.startswith(str(path)) else text.removeprefix(path.name)
    split = _PLACE.fullmatch(rest) if rest != text else None
    shown = shown or path.name
    return Problem(shown, "", text) if split is None else Problem(shown, split[1] or "", split[2])


def _shown(files: Sequence[Path]) -> list[str]:
    """Names to tell files apart by; the same for a file that is given twice."""
    places = [_place(path) for path in files]
    first = dict(zip(reversed(places), reversed(files), strict=True))
    names = dict(zip(first, shown_names(list(first.values())), strict=True))
    return [names[place] or str(path) for place, path in zip(places, files, strict=True)]


def _place(path: Path) -> str:
    try:
        return os.path.realpath(path)
    except ValueError:  # a NUL in the name; opening it tells
        return str(path)


def _files(paths: Sequence[Path]) -> Iterator[Path]:
    """The files themselves; of a folder those with a recording table's suffix and columns, or else the folder."""
    from ldctoolkit.recordings.plain.frames import REQUIRED

    for path in map(Path, paths):
        inside: list[Path] = []
        try:
            if path.is_dir():
                inside = [one for one in sorted(path.iterdir()) if one.name.lower().endswith(SUFFIXES)]
        except (OSError, ValueError):
            pass  # opening it tells why
        tables = [one for one in inside if len(set(header_names(one)) & set(REQUIRED)) >= KNOWN_BY]
        yield from tables or [path]


def _recordings(path: Path, shown: str, left_out: set[str]) -> Iterator[Recording | Problem]:
    """Recordings of a file and problems, as they come."""
    from ldctoolkit.recordings.plain.frames import Unmetered, frames

    faults: list[RecordingError] = []
    seen: dict[str, int] = {}
    try:
        for frame in whole_recordings(_labelled(frames(path, BLOCK_BYTES, Unmetered(), faults))):
            yield from (problem_of(fault, path, shown) for fault in faults)
            faults.clear()
            yield from _of_frame(path, shown, frame, seen, left_out)
    except RecordingError as error:
        faults.append(error)
    except OSError as error:
        faults.append(RecordingError(f"{path.name}: cannot be read: {error.strerror or error}"))
    yield from (problem_of(fault, path, shown) for fault in faults)


def _labelled(blocks: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Rows without a recording's name are left out, and their neighbours marked as rows at fault."""
    import polars as pl

    from ldctoolkit.recordings.plain.table_values import FAULT

    for block in blocks:
        nameless = block["recording"].fill_null("") == ""
        if nameless.any():
            near = nameless.shift(1).fill_null(False) | nameless.shift(-1).fill_null(False)
            block = block.with_columns((block[FAULT] | near).alias(FAULT)).filter(~nameless)
        yield block.with_columns(pl.col("recording").cast(pl.String))


def _of_frame(
    path: Path, shown: str, frame: pl.DataFrame, seen: dict[str, int], left_out: set[str]
) -> Iterator[Recording | Problem]:
    from ldctoolkit.recordings.plain.table_values import FAULT, ROW

    word = "row" if path.name.lower().endswith(".parquet") else "line"
    labels, rows, fault = frame["recording"], frame[ROW].to_numpy(), frame[FAULT].to_numpy()
    starts = np.concatenate([[0], np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())])
    columns = columns_of(frame)
    timed = np.abs(columns["t"]) < LARGEST_TIME  # False for NaN
    for name, start, end in zip(
        labels.gather(starts).to_list(), starts.tolist(), [*starts[1:].tolist(), frame.height], strict=True
    ):
        if name in seen:
            what = f"comes in separate pieces, the first from {word} {seen[name]}; this one is left out"
            yield Problem(shown, f"{word} {rows[start]}", f"recording {name!r} {what}")
            continue
        seen[name] = int(rows[start])
        if name in left_out:
            continue
        if fault[start:end].any():
            i = start + int(np.argmax(fault[start:end]))
            yield Problem(shown, f"{word} {rows[i]}", f"recording {name!r} has a fault here; it is left out")
            continue
        place = start + np.flatnonzero(timed[start:end])  # a sample without a time is passed over
        if place.size == 0:
            continue
        t = columns["t"][place]
        falls = np.flatnonzero(~(t[1:] > t[:-1])) + 1
        if falls.size:
            i = int(falls[0])
            what = "is repeated" if t[i] == t[i - 1] else f"comes after t = {float(t[i - 1])!r} s: times are not sorted"
            more = f" ({falls.size} places in all)" if falls.size > 1 else ""
            yield Problem(
                shown,
                f"{word} {rows[place[i]]}",
                f"column 't', recording {name!r}: t = {float(t[i])!r} s {what}; "
                f"allowed: times that increase inside a recording{more}; it is left out",
            )
            continue
        here = slice(start, end) if place.size == end - start else place
        values: dict[str, Any] = {column: None if found is None else found[here] for column, found in columns.items()}
        yield Recording(name=name, source=shown, **values)
