"""Files that are written whole or not at all, read up to some size and depth, with a checksum that is checked then.

In JSON the checksum is the last entry, of the values: another layout is the same content. In Parquet it is in the
metadata, of all bytes of the file: it is checked before anything is parsed.
"""

import codecs
import contextlib
import hashlib
import io
import json
import os
import re
import stat
import tomllib
from collections.abc import Callable, Mapping
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


def write_whole(path: Path, content: bytes, kind: type[LdcError]) -> None:
    """Make `content` the file `path`, or raise an error of that kind and leave no trace."""
    try:
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            part.write_bytes(content)
            part.replace(path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a path without a name, or with a NUL
        raise kind(path, f"cannot be written: {getattr(error, 'strerror', None) or error}") from None


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
    start = data.rfind(_MARK)
    if start < 0 and not needed and PARQUET_CHECKSUM.encode() not in data:
        return
    end = start + len(_EMPTY)
    if start < 0 or data[start:end] != _sealed(data[:start] + _EMPTY + data[end:]):
        raise ValueError(NOT_AS_WRITTEN)


def _sealed(data: bytes) -> bytes:
    """The end of a file of these bytes: mark and checksum."""
    return _MARK + hashlib.sha256(data).hexdigest().encode()


LARGEST: Final = 64 << 20  # bytes of a text that is parsed as a whole
_TOO_DEEP: Final = "nested too deeply; allowed: 64 levels"
_LONG_KEY: Final = re.compile(r"""(?<![\w.-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}""")


def read_regular(path: Path, kind: Callable[[Path, str], LdcError], largest: int | None = LARGEST) -> bytes:
    """The content of a regular file; an error of that `kind` for one that is larger, or none: a pipe would wait."""
    at_once = getattr(os, "O_NONBLOCK", 0)
    try:
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | at_once)) as stream:
            if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                raise ValueError("is not a regular file")
            data = stream.read(-1 if largest is None else largest + 1)
        if largest is not None and len(data) > largest:
            raise ValueError(f"larger than {largest >> 20} MiB")
    except (OSError, ValueError) as error:  # also a NUL in the name
        raise kind(path, f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    return data


def read_toml(path: Path, kind: type[LdcError]) -> dict[str, Any]:
    """What a file in TOML holds; raises an error of that kind, also for what is nested too deeply."""
    data = read_regular(path, kind, 16 << 20)  # its parser is far slower than that of JSON
    try:
        text = text_of(data)
        if _LONG_KEY.search(text):  # the parser's memory grows with the square of the parts of a dotted key
            raise ValueError(_TOO_DEEP)
        content: dict[str, Any] = _parsed(lambda: tomllib.loads(text))
    except ValueError as error:
        raise kind(path, f"not a TOML file: {error}") from None
    return content


def parse_json(text: str | bytes, **hooks: Any) -> Any:
    """What JSON holds, with `hooks` of `json.loads`; raises `ValueError`, also for what is nested too deeply."""
    return _parsed(lambda: json.loads(text, **hooks))


def _parsed(parse: Callable[[], Any]) -> Any:
    """Parsed content, which must be neither nested too deeply nor hold whole numbers beyond 64 bits."""
    try:
        content = parse()
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level = [content]
    for _ in range(64):
        if any(isinstance(item, int) and item.bit_length() > 63 for item in level):
            raise ValueError("a whole number of more than 64 bits")
        tables = [list(item.values()) if isinstance(item, dict) else item for item in level]
        level = [inner for item in tables if isinstance(item, list) for inner in item]
        if not level:
            return content
    raise ValueError(_TOO_DEEP)


def text_of(data: bytes) -> str:
    """Text in UTF-8, with a byte order mark or without; raises `ValueError` that says what is wrong with any other."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or data[:4].count(0) == 2:
        raise ValueError("the text is UTF-16; save it as UTF-8")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"the text is not UTF-8 ({error.reason})") from None
