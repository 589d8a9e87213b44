"""One run at a time into a study's folder."""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

from ldctoolkit.errors import StoreError

_NAME = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, as long as the block or the process lives; a killed process holds nothing.

    Raises
    ------
    StoreError
        If another process holds it, or the lock cannot be made.
    """
    try:
        fcntl = importlib.import_module("fcntl")
    except ImportError:  # Windows: nobody guards the folder there
        yield
        return
    try:
        stream = (folder / _NAME).open("ab")
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{folder}: another run is writing into this folder; wait for it, or end it") from None
        except OSError:
            pass  # a file system without locks, as some network ones: nobody guards the folder there
        yield


def remove_leftovers(folder: Path) -> None:
    """Remove what a killed process had not finished writing; call it only while the folder is held."""
    for path in (*folder.glob(".*.part"), *(folder / "results").glob(".*.part")):
        with contextlib.suppress(OSError):
            path.unlink()


def remove_unfinished(path: Path) -> None:
    """Remove what killed processes had not finished writing of one file; call it only while nobody else writes it."""
    # as `whole_file` names it, after the process
    name = re.compile(rf"\.{re.escape(path.name)}\.\d+\.part")
    with contextlib.suppress(OSError):
        for other in list(path.parent.iterdir()):
            if name.fullmatch(other.name):
                other.unlink()
