"""Recordings of files of any known kind, one after the other."""

from __future__ import annotations

import itertools
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.opened import OpenedRecordings, open_recordings
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.sources import AUTO


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
