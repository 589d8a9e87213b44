"""Files that recordings came from, with their digests."""

from __future__ import annotations

import dataclasses
import hashlib
import stat
from pathlib import Path

from ldctoolkit.errors import RecordingError


@dataclasses.dataclass(frozen=True)
class SourceFile:
    """A file that was read.

    Attributes
    ----------
    name : str
        File name without its folder; for files that share names, with the folders inside the source.
    bytes : int
        Size.
    sha256 : str
        Digest of the content, hexadecimal.
    """

    name: str
    bytes: int
    sha256: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", printable(self.name))


def printable(text: str) -> str:
    r"""A text on one line, to show and store; names of files may hold line ends and bytes that are no text."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def source_file(path: Path, name: str = "") -> SourceFile:
    r"""Read a file for its digest.

    Parameters
    ----------
    path : Path
        The file.
    name : str, optional
        What to call it; its own name by default.

    Raises
    ------
    RecordingError
        If it is no regular file or cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.csv")
    ...     _ = path.write_bytes(b"t\n0\n")
    ...     source_file(path).bytes
    4
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would wait for ever
            raise RecordingError(f"{path.name}: is not a regular file")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256")
            size = stream.tell()
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    return SourceFile(name or path.name, size, digest.hexdigest())
