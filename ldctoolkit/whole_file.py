"""Files that are written whole or not at all, and a checksum of their content that is checked when they are read.

In JSON the checksum is the last entry, of the values: another layout is the same content. In Parquet it is in the
metadata, of all bytes of the file: it is checked before anything is parsed.
"""

import contextlib
import hashlib
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ldctoolkit.errors import LdcError

if TYPE_CHECKING:
    import polars as pl

CHECKSUM: Final = "checksum"  # entry of a JSON file

PARQUET_CHECKSUM: Final = "ldctoolkit.checksum"  # entry of the metadata of a Parquet file
_MARK: Final = b"ldctoolkit:sha256:"  # how its value begins: with one of both damaged, the other still tells
_EMPTY: Final = _MARK + 64 * b"0"

NOT_AS_WRITTEN: Final = "its content is not what was written (its checksum differs)"


def write_whole(path: Path, content: bytes, error: type[LdcError]) -> None:
    """Make `content` the file `path`, or raise `error` and leave no trace."""
    try:
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            part.write_bytes(content)
            part.replace(path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    except (OSError, ValueError) as problem:  # ValueError: a path without a name, or with a NUL
        reason = problem.strerror if isinstance(problem, OSError) else problem
        raise error(f"{path}: cannot be written: {reason or problem}") from None


def digest(content: Mapping[str, Any]) -> str:
    """Checksum of JSON values."""
    return hashlib.sha256(json.dumps(content, separators=(",", ":"), allow_nan=False).encode()).hexdigest()


def json_text(content: Mapping[str, Any], indent: int | None = 1) -> str:
    """A JSON file with its checksum; raises `ValueError` or `TypeError` for what JSON does not know."""
    return json.dumps({**content, CHECKSUM: digest(content)}, indent=indent) + "\n"


def without_checksum(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a JSON file, checked; raises `ValueError` where it is not what was written."""
    if content.pop(CHECKSUM, None) != digest(content):
        raise ValueError(NOT_AS_WRITTEN)
    return content


def parquet_bytes(table: "pl.DataFrame", metadata: Mapping[str, str] | None = None) -> bytes:
    """A Parquet file with its checksum."""
    stream = io.BytesIO()
    table.write_parquet(stream, metadata={**(metadata or {}), PARQUET_CHECKSUM: _EMPTY.decode()})
    return stream.getvalue().replace(_EMPTY, _sealed(stream.getvalue()))


def check_parquet(data: bytes, *, needed: bool = True) -> None:
    """Raise `ValueError` where a Parquet file is not what was written."""
    at = data.rfind(_MARK)
    if at < 0 and not needed and PARQUET_CHECKSUM.encode() not in data:
        return
    end = at + len(_EMPTY)
    if at < 0 or data[at:end] != _sealed(data[:at] + _EMPTY + data[end:]):
        raise ValueError(NOT_AS_WRITTEN)


def _sealed(data: bytes) -> bytes:
    return _MARK + hashlib.sha256(data).hexdigest().encode()
