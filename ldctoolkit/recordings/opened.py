"""Opening recordings of any known format."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.sources import AUTO, RecordingReader, RecordingSource, recognised_by, recording_reader, shown
from ldctoolkit.recordings.together import ReadersTogether


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
