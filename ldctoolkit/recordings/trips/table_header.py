"""First line of a table of text: is it one, and which columns has it?"""

from __future__ import annotations

import codecs
import dataclasses
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.errors import RecordingError, nearest

LONGEST_HEADER: Final = 1 << 16
_DELIMITERS: Final = {";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "blanks"}
_PACKED: Final = {b"\x1f\x8b": "gzip", b"PK": "a ZIP archive", b"PAR1": "Parquet", b"BZh": "bzip2", b"\xfd7zXZ": "xz"}
_BLANKS: Final = " \t\r\"'"


@dataclasses.dataclass(frozen=True)
class Header:
    """First line of a table.

    Attributes
    ----------
    columns : tuple of str
        Names, without blanks around them.
    begin : int
        Byte where the second line begins.
    """

    columns: tuple[str, ...]
    begin: int


@dataclasses.dataclass(frozen=True)
class TableLayout:
    """How the rows of a table are laid out.

    Attributes
    ----------
    columns : tuple of str
        Name of each cell.
    begin, line : int
        Byte and number of the line where the rows begin.
    kind : str
        Which table it is, where a reader knows several.
    cells : tuple of int
        Allowed numbers of cells in a row; empty for one for each column.
    """

    columns: tuple[str, ...]
    begin: int
    line: int = 2
    kind: str = ""
    cells: tuple[int, ...] = ()


def read_header(path: Path) -> Header:
    """The first line of a comma-separated table in UTF-8.

    Raises
    ------
    RecordingError
        If the file cannot be read, is empty, is packed, is not UTF-8, or is separated by something else.
    """
    try:
        if path.exists() and not path.is_file():
            raise RecordingError("it is not a regular file")  # a pipe would be waited for
        with path.open("rb") as stream:
            first = stream.readline(LONGEST_HEADER)
    except (OSError, ValueError) as error:  # a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else None
        raise RecordingError(f"cannot be read: {reason or error}") from None
    for magic, name in _PACKED.items():
        if first.startswith(magic):
            raise RecordingError(f"the content is {name}; allowed: plain text, so unpack it")
    if first.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in first[:64]:
        raise RecordingError("the text is UTF-16 or not a text; allowed: UTF-8, so save it as that")
    if not first:
        raise RecordingError("the file is empty; a header is needed")
    if len(first) == LONGEST_HEADER and not first.endswith(b"\n"):
        raise RecordingError(f"the first line is longer than {LONGEST_HEADER} bytes; this is not a table of text")
    try:
        text = first.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"the first line is not UTF-8 ({error.reason})") from None
    if "\r" in text.rstrip("\r\n"):
        raise RecordingError("the first line holds a carriage return; allowed: lines that end in LF or CR LF")
    names = tuple(name.strip(_BLANKS + "\n") for name in text.split(","))
    if len(names) == 1:
        for mark, words in _DELIMITERS.items():
            if text.strip().count(mark) > 1:
                raise RecordingError(f"the columns are separated by {words}; allowed: commas")
    return Header(names, len(first))


def check_columns(
    columns: Sequence[str], key: Sequence[str], required: Sequence[str], optional: Sequence[str] = ()
) -> None:
    """Refuse a table of trips whose header lacks a column or repeats one; letters may be of either case.

    Parameters
    ----------
    columns : sequence of str
        The header.
    key : sequence of str
        Columns that tell the trip; they come first.
    required, optional : sequence of str
        Columns that must, and may, be there, once.

    Raises
    ------
    RecordingError
        Naming the column.
    """
    lower = [name.lower() for name in columns]
    if lower[: len(key)] != [name.lower() for name in key]:
        raise RecordingError(f"the first columns are {', '.join(columns[: len(key)])}; allowed: {', '.join(key)}")
    for name in required:
        if name.lower() not in lower:
            raise RecordingError(f"column {name!r} is missing; {textwrap.shorten(nearest(name, columns[:64]), 400)}")
    for name in (*required, *optional):
        if lower.count(name.lower()) > 1:
            raise RecordingError(f"column {name!r} appears {lower.count(name.lower())} times; allowed: once")


def is_plain(columns: Sequence[str]) -> bool:
    """Whether columns are those of a plain recording table, whatever the file's name.

    Examples
    --------
    >>> is_plain(("recording", "t", "lane_offset")), is_plain(("Device", "Trip"))
    (True, False)
    """
    return {"recording", "lane_offset"}.issubset(columns)
