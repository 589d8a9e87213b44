"""Recordings opened and read: the reader that the given paths are for, or several together."""

from __future__ import annotations

import dataclasses
import itertools
import os
import stat
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.sources import (
    AUTO,
    FoundParts,
    RecordingPart,
    RecordingReader,
    RecordingSource,
    find_tables,
    recognised_by,
    recording_reader,
    shown,
    shown_names,
)


@dataclasses.dataclass(frozen=True)
class ReadersTogether:
    """Readers with the same vehicle width and step, for paths that hold files of each."""

    readers: tuple[RecordingReader, ...]  # two or more, by name

    @property
    def name(self) -> str:
        """Names of all of them."""
        return " + ".join(reader.name for reader in self.readers)

    @property
    def title(self) -> str:
        """Titles of all of them."""
        return "; ".join(reader.title for reader in self.readers)

    @property
    def vehicle_width(self) -> float:
        """The same for all [m]."""
        return self.readers[0].vehicle_width

    @property
    def step(self) -> float | None:
        """The same for all [s]."""
        return self.readers[0].step

    def recognise(self, paths: Sequence[Path]) -> str:
        """What each of them finds."""
        said = ((reader.name, reader.recognise(paths)) for reader in self.readers)
        return "; ".join(f"{name}: {words}" for name, words in said if words)

    def open(self, paths: Sequence[Path]) -> FoundParts[RecordingPart]:
        """Look through the paths with each; each passes over the others' files."""
        sources: list[RecordingSource] = []
        errors: list[RecordingError] = []
        unread: list[Problem] = []
        owner: dict[str, str] = {}
        for reader in self.readers:
            try:
                source = reader.open(paths)
            except RecordingError as error:
                errors.append(error)
                unread.append(Problem(_file_for(reader, paths), "", str(error)))
                continue
            sources.append(source)
            for file in source.files:
                if owner.setdefault(file.sha256, reader.name) != reader.name:
                    raise RecordingError(
                        f"{file.name}: several readers know such files ({self.recognise(paths)}); choose one with "
                        "--format"
                    )
        if not sources:
            raise errors[0]
        names = [{file.name for file in source.files} for source in sources]
        read = set().union(*names)
        problems = [
            problem
            for source, own in zip(sources, names, strict=True)
            for problem in source.problems
            if problem.file in own or problem.file not in read  # else a file that another one is for
        ]
        parts = tuple(part for source in sources for part in source.parts)
        files = tuple(file for source in sources for file in source.files)
        return FoundParts(parts, files, (*problems, *unread))


def _file_for(reader: RecordingReader, paths: Sequence[Path]) -> str:
    """Name of the first file that a reader knows, or else of the first path."""
    found = [path for path, _ in find_tables(paths)]
    for path, name in zip(found, shown_names(found), strict=True):
        if reader.recognise([path]):
            return name
    return paths[0].name


@dataclasses.dataclass(frozen=True)
class OpenedRecordings:
    """Recordings that a reader has looked through.

    Attributes
    ----------
    reader : RecordingReader
        What reads them.
    source : RecordingSource
        Parts, files, problems.
    found : str
        What was found, in a few words.
    """

    reader: RecordingReader
    source: RecordingSource
    found: str


def open_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], *, format: str = AUTO
) -> OpenedRecordings:
    """Look through files and folders of recordings.

    Parameters
    ----------
    paths : path or iterable of paths
        Files or folders of one kind.
    format : str
        Name of a reader; "auto" looks at columns and folders.

    Returns
    -------
    OpenedRecordings
        To be given to `extract_departures`.

    Raises
    ------
    RecordingError
        If a path does not exist or is given twice, or nothing of it can be used.
    UnknownNameError
        For a reader that is not known.
    InputError
        If no path is given.
    LdcError
        If the reader fails over the paths, or two of its parts have the same key.

    Examples
    --------
    >>> open_recordings("nowhere.csv")
    Traceback (most recent call last):
    ldctoolkit.errors.RecordingError: nowhere.csv: does not exist
    """
    given = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    if not given:
        raise InputError("paths: none given; at least one file or folder of recordings is needed")
    seen: set[Path] = set()
    for path in given:
        try:
            there = path.exists()
        except (OSError, ValueError) as error:  # no permission, name too long, a NUL in the name
            reason = error.strerror if isinstance(error, OSError) else error
            raise RecordingError(f"{path}: cannot be read: {reason}") from None
        if not there:
            raise RecordingError(f"{path}: does not exist")
        if path.resolve() in seen:
            raise RecordingError(f"{path.name}: given twice")
        seen.add(path.resolve())
    reader, found = _recognised(given) if format == AUTO else (recording_reader(format), "")
    return OpenedRecordings(reader, _opened(reader, given), found or reader.title)


def _opened(reader: RecordingReader, paths: list[Path]) -> RecordingSource:
    try:
        source = reader.open(paths)
        keys = Counter(part.key for part in source.parts)
    except LdcError:
        raise
    except Exception as error:  # the reader may be anybody's code
        raise LdcError(f"format {reader.name!r}: open fails with {type(error).__name__}: {error}") from error
    for key, count in keys.items():
        if count > 1:
            raise LdcError(f"format {reader.name!r}: {count} parts have the key {key!r}; allowed: a key for each part")
    return source


def _recognised(paths: list[Path]) -> tuple[RecordingReader, str]:
    """The reader for these paths, and what it found; several readers as one where one set of options serves them."""
    found = recognised_by(paths)
    if len(found) == 1:
        return found[0]
    said = "; ".join(f"{reader.name}: {words}" for reader, words in found)
    readers = tuple(reader for reader, _ in found)
    if len({(reader.vehicle_width, reader.step) for reader in readers}) > 1:
        raise RecordingError(f"{shown(paths)}: several readers know such files ({said}); choose one with --format")
    return ReadersTogether(readers), said


def read_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], *, format: str = AUTO
) -> Iterator[Recording]:
    r"""Read driving recordings, and stop at the first fault.

    `open_recordings` goes on with what is sound, and names what is not.

    Parameters
    ----------
    paths : path or iterable of paths
        Files or folders of one kind.
    format : str
        Name of a reader; "auto" looks at columns and folders.

    Returns
    -------
    iterator of Recording
        Whole recordings in the order of the files; the content is read, and checked, while iterating.

    Raises
    ------
    RecordingError
        As `open_recordings`; while iterating, for content that cannot be used, naming file and place.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "drive.csv")
    >>> _ = path.write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\na,0.1,0.2,3.6,25\n")
    >>> [(recording.name, recording.samples) for recording in read_recordings(path)]
    [('a', 2)]
    >>> folder.cleanup()
    """
    return _sound(open_recordings(paths, format=format))


def _sound(opened: OpenedRecordings) -> Iterator[Recording]:
    source = opened.source
    for item in itertools.chain(source.problems, *(part.read() for part in source.parts)):
        if isinstance(item, Problem):
            raise RecordingError(str(item))
        yield item


def check_file(path: Path, needed: str) -> None:
    """Refuse a path that is not a file; `needed` says in the message what it should be."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise RecordingError(f"{path}: does not exist; {needed} is needed") from None
    except (OSError, ValueError) as error:  # no permission, name too long, a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise RecordingError(f"{path}: cannot be read: {reason}") from None
    if not stat.S_ISREG(mode):
        state = "is a folder" if stat.S_ISDIR(mode) else "is not a regular file"
        raise RecordingError(f"{path}: {state}; {needed} is needed")
