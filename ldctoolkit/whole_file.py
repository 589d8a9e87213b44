"""Files that are written whole or not at all, and read up to some size and depth."""

import codecs
import contextlib
import json
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Final

from ldctoolkit.errors import LdcError


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A binary stream that becomes the file `path` when the block ends well, and leaves no trace when it does not."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            yield stream
        part.replace(path)
    finally:
        with contextlib.suppress(OSError, ValueError):
            part.unlink(missing_ok=True)


LARGEST: Final = 64 << 20  # bytes of a text that is parsed as a whole
_TOO_DEEP: Final = "nested too deeply; allowed: 64 levels"
_LONG_KEY: Final = re.compile(r"""(?<![\w.-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}""")


def read_regular(path: Path, kind: Callable[[str], LdcError], largest: int | None = LARGEST) -> bytes:
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
        raise kind(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    return data


def read_toml(path: Path, kind: Callable[[str], LdcError]) -> dict[str, Any]:
    """What a file in TOML holds; raises an error of that kind, also for what is nested too deeply."""
    data = read_regular(path, kind, 16 << 20)  # its parser is far slower than that of JSON
    try:
        text = text_of(data)
        if _LONG_KEY.search(text):  # the parser's memory grows with the square of the parts of a dotted key
            raise ValueError(_TOO_DEEP)
        content: dict[str, Any] = _parsed(lambda: tomllib.loads(text))
    except ValueError as error:
        raise kind(f"{path}: not a TOML file: {error}") from None
    return content


def parse_json(text: str | bytes, **hooks: Any) -> Any:
    """What JSON holds, with `hooks` of `json.loads`; raises `ValueError`, also for what is nested too deeply."""
    return _parsed(lambda: json.loads(text, **hooks))


def _parsed(parse: Callable[[], Any]) -> Any:
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
