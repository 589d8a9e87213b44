"""One line on what a law raised: what its author needs to find the mistake, and a study can store."""

from __future__ import annotations

import itertools
import traceback
from pathlib import Path

from ldctoolkit.errors import LdcError

_OURS = tuple(Path(__file__).resolve().parent.parent / package for package in ("ldctoolkit", "studies"))
_LONGEST = 500


def raised(error: BaseException) -> str:
    """What was raised, with the law's own file and line; messages of the toolkit as they are."""
    words = _clean(_said(error))
    if not isinstance(error, LdcError):
        called = _clean(type(error).__name__)
        words = f"{called}: {words}" if words else called
    if len(words) > _LONGEST:
        words = f"{words[: _LONGEST - 4]} ..."
    return words if isinstance(error, LdcError) else f"{words} {_clean(_place(error))}".rstrip()


def _said(error: BaseException) -> str:
    """The message; an exception may be anybody's code too, and have none."""
    try:
        return str(error)
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as second:
        return f"its message cannot be read, __str__ raises {type(second).__name__}"


def _clean(words: str) -> str:
    """One line without control characters, which steer a terminal, and lone surrogates, which no file takes."""
    known = words.encode("utf-8", "backslashreplace").decode("utf-8")
    return "".join(c for c in " ".join(known.split()) if c.isprintable())


def _place(error: BaseException) -> str:
    """File name and line, the innermost in the file that the toolkit called."""
    frames = list(itertools.dropwhile(_is_ours, traceback.extract_tb(error.__traceback__)))
    inside = [frame for frame in frames if frame.filename == frames[0].filename]
    return f"({Path(inside[-1].filename).name}, line {inside[-1].lineno})" if inside else ""


def _is_ours(frame: traceback.FrameSummary) -> bool:
    path = Path(frame.filename).resolve()
    return any(path.is_relative_to(folder) for folder in _OURS)
