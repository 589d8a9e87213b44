"""Reader of plain recording tables as a source: a part is a file; a recording at fault is left out, the others stay."""

from __future__ import annotations

import dataclasses
import gzip
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import NO_ROWS, REQUIRED, Problem, Recording, TableFault
from ldctoolkit.recordings.source_file import SourceFile, source_file
from ldctoolkit.recordings.sources import FoundParts, place_of, shown_names

if TYPE_CHECKING:
    import polars as pl


SUFFIXES: Final = (".csv", ".csv.gz", ".parquet")

BLOCK_BYTES: Final = 16 << 20
"""About how much text is parsed at once."""

HEADER_BYTES: Final = 1 << 16
"""A header is looked for in so many first bytes."""

MOST_REPEATED: Final = 20
"""So many recordings that two files hold are told one by one."""


def header_names(path: Path) -> tuple[str, ...]:
    r"""Names in a file's header, whatever parts them; empty if there is none. Raises nothing."""
    name = path.name.lower()
    try:
        if not name.endswith(SUFFIXES) or not path.is_file():
            return ()
        if name.endswith(".parquet"):
            from ldctoolkit.recordings.csv_text import parquet_names

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
    """Refuse a file whose header lacks a column, or that has no rows at all."""
    from ldctoolkit.recordings.csv_text import check_columns, csv_blocks, is_parquet, parquet_names

    if is_parquet(path):
        check_columns(parquet_names(path))
    elif next(csv_blocks(path, HEADER_BYTES), None) is None:
        raise TableFault("", NO_ROWS)


def repeated_names(
    paths: Sequence[Path], shown: Sequence[str]
) -> tuple[tuple[tuple[str, ...], ...], tuple[Problem, ...]]:
    """Recordings that more than one file holds: the first file's rows are taken."""
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
            if len(problems) == MOST_REPEATED:
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

    from ldctoolkit.recordings.csv_text import ROW, blocks_of

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


KNOWN_BY: Final = 3
"""A file with so many of the five columns that are needed is meant as a recording table."""

MOST_TOLD: Final = 20
"""So many problems of one file are told one by one; the others are counted."""

LARGEST_TIME: Final = 1e20
"""A time of this size or more [s] is none, whatever the clock and its unit; sums of such would overflow."""


@dataclasses.dataclass(frozen=True)
class TablePart:
    """One file of recordings."""

    path: str  # the file
    key: str  # its place among the source's files, and its name
    bytes: int  # its size
    left_out: tuple[str, ...] = ()  # recordings that another file holds, too
    shown: str = ""  # its name in messages: with as few folders as tell it apart from the others
    block_bytes: int = BLOCK_BYTES  # about how much text is parsed at once

    def __post_init__(self) -> None:
        object.__setattr__(self, "shown", self.shown or Path(self.path).name)

    def read(self) -> Iterator[Recording | Problem]:
        """Recordings in the file's order; one with a fault in any of its rows is left out, and told."""
        told = 0
        more: Problem | None = None
        for one in self._items():
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

    def _items(self) -> Iterator[Recording | Problem]:
        """Recordings and problems, as they come."""
        from ldctoolkit.recordings.csv_text import frames, whole_recordings

        faults: list[TableFault] = []
        seen: dict[str, int] = {}
        try:
            for frame in whole_recordings(_labelled(frames(Path(self.path), self.block_bytes, faults))):
                yield from self._told(faults)
                faults.clear()
                yield from self._recordings(frame, seen)
        except TableFault as fault:
            faults.append(fault)
        except OSError as error:
            faults.append(TableFault("", f"cannot be read: {error.strerror or error}"))
        yield from self._told(faults)

    def _told(self, faults: list[TableFault]) -> Iterator[Problem]:
        return (Problem(self.shown, fault.place, fault.what) for fault in faults)

    def _recordings(self, frame: pl.DataFrame, seen: dict[str, int]) -> Iterator[Recording | Problem]:
        """Those of a frame; `seen` has the first row of each that came before."""
        from ldctoolkit.recordings.csv_text import FAULT, ROW, columns_of

        word = place_word(Path(self.path))
        labels, rows, fault = frame["recording"], frame[ROW].to_numpy(), frame[FAULT].to_numpy()
        starts = np.concatenate([[0], np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())])
        columns = columns_of(frame)
        timed = np.abs(columns["t"]) < LARGEST_TIME  # False for NaN
        for name, start, end in zip(
            labels.gather(starts).to_list(), starts.tolist(), [*starts[1:].tolist(), frame.height], strict=True
        ):
            place = start + np.flatnonzero(timed[start:end])  # a sample without a time is passed over
            t = columns["t"][place]
            falls = np.flatnonzero(~(t[1:] > t[:-1])) + 1
            if name in seen:
                i = start
                what = (
                    f"recording {name!r} comes in separate pieces, the first from {word} {seen[name]}; this one is "
                    "left out"
                )
            elif name in self.left_out:
                continue
            elif fault[start:end].any():
                i = start + int(np.argmax(fault[start:end]))
                what = f"recording {name!r} has a fault here; it is left out"
            elif falls.size:
                i, first = int(place[falls[0]]), int(falls[0])
                how = f"comes after t = {float(t[first - 1])!r} s: times are not sorted"
                what = (
                    f"column 't', recording {name!r}: t = {float(t[first])!r} s "
                    f"{'is repeated' if t[first] == t[first - 1] else how}; allowed: times that increase inside a "
                    f"recording{f' ({falls.size} places in all)' if falls.size > 1 else ''}; it is left out"
                )
            else:
                seen[name] = int(rows[start])
                if place.size:
                    here = slice(start, end) if place.size == end - start else place
                    own: dict[str, Any] = {key: None if one is None else one[here] for key, one in columns.items()}
                    yield Recording(name=name, source=self.shown, **own)
                continue
            seen.setdefault(name, int(rows[start]))
            yield Problem(self.shown, f"{word} {rows[i]}", what)


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
        found = sum(map(_is_table, _files(paths)))
        return f"{found} recording table{'s' * (found > 1)}" if found else ""

    def open(self, paths: Sequence[Path]) -> FoundParts[TablePart]:
        """Look through files, or folders that hold them."""
        problems: list[Problem] = []
        found: dict[Path, SourceFile] = {}
        twins: dict[str, str] = {}
        files = _files(paths)
        for path, shown in zip(files, shown_names(files), strict=True):
            place, what = "", ""
            try:
                if path.is_dir():
                    what = "the folder holds no recording table"
                elif not path.name.lower().endswith(SUFFIXES):
                    what = f"the suffix is not known; allowed: {', '.join(SUFFIXES)}"
                else:
                    file = source_file(path, shown)
                    check_header(path)
                    twin = twins.setdefault(file.sha256, shown)
                    if twin == shown:
                        found[path] = file
                    else:
                        what = f"holds the same as {twin}, byte by byte; it is left out"
            except TableFault as fault:
                place, what = fault.place, fault.what
            except RecordingError as error:
                what = str(error)
            except (OSError, ValueError) as error:  # a NUL in the name
                what = f"cannot be read: {(isinstance(error, OSError) and error.strerror) or error}"
            if what:
                problems.append(Problem(shown, place, what.removeprefix(f"{path.name}: ")))
        if not found:
            others = f" (and {len(problems) - 1} more problems)" if len(problems) > 1 else ""
            raise RecordingError(f"{problems[0]}{others}" if problems else "no recording file is given")
        names = [file.name for file in found.values()]
        left_out, repeated = repeated_names(list(found), names) if len(found) > 1 else (((),), ())
        parts = tuple(
            TablePart(str(path), f"{i:05d}-{path.name}", file.bytes, left_out[i], file.name, self.block_bytes)
            for i, (path, file) in enumerate(found.items())
        )
        return FoundParts(parts, tuple(found.values()), (*problems, *repeated))


READER: Final = TableReader()


def _is_table(path: Path) -> bool:
    return len(set(REQUIRED) & set(header_names(path))) >= KNOWN_BY


def _files(paths: Sequence[Path]) -> list[Path]:
    """The files, each once; of a folder those with a recording table's suffix and columns, or else the folder."""
    found: dict[str, Path] = {}
    for path in paths:
        try:
            inside = sorted(path.iterdir()) if path.is_dir() else []
        except (OSError, ValueError):
            inside = []  # opening it tells why
        for one in list(filter(_is_table, inside)) or [path]:
            found.setdefault(place_of(one), one)
    return list(found.values())


def _labelled(blocks: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Rows without a recording's name are left out, and their neighbours marked as rows at fault."""
    from ldctoolkit.recordings.csv_text import FAULT

    for block in blocks:
        nameless = block["recording"].fill_null("") == ""
        if nameless.any():
            near = nameless.shift(1).fill_null(False) | nameless.shift(-1).fill_null(False)
            block = block.with_columns((block[FAULT] | near).alias(FAULT)).filter(~nameless)
        yield block
