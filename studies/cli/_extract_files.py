"""Files that `ldc extract` must not write over."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ldctoolkit.errors import InputError

if TYPE_CHECKING:
    from ldctoolkit.recordings.source_file import SourceFile


def refuse_input(option: str, target: Path, paths: Sequence[Path], files: Sequence[SourceFile]) -> None:
    """Refuse to write over what is read.

    Parameters
    ----------
    option : str
        By which the file to write was given.
    target : Path
        The file to write.
    paths : sequence of Path
        Files and folders to read, all of which exist.
    files : sequence of SourceFile
        What was found in them. In a folder a file counts that is one of these by its content: there the output of an
        earlier extraction may lie as well.

    Raises
    ------
    InputError
        If the file to write is one of those that are read.
    """
    from ldctoolkit.recordings.source_file import source_file

    if not target.exists():
        return
    for path in paths:
        if target.samefile(path):
            raise InputError(f"{option} {target}: is the input {path}; allowed: a file that is not read")
        if path.is_dir() and target.resolve().is_relative_to(path.resolve()):
            one = source_file(target)
            if any((one.bytes, one.sha256) == (file.bytes, file.sha256) for file in files):
                raise InputError(f"{option} {target}: is an input, in {path}; allowed: a file that is not read")
