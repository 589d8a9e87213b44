"""Reading JSON with a check of every value; every complaint names the file and the key path."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import ModelError, nearest

_WHOLE_DIGITS: Final = 18
"""Longest whole number of a file: it must fit a float and 64 bits."""


class Reader:
    """Values of one file."""

    def __init__(self, file: str) -> None:
        self.file = file

    def wrong(self, path: str, message: str) -> ModelError:
        """What to raise for a value."""
        return ModelError(f"{self.file}: {path}: {message}")

    def member(self, owner: Mapping[str, Any], key: str, path: str, kind: type | tuple[type, ...], what: str) -> Any:
        """A value that must be there, of a kind."""
        here = f"{path}.{key}" if path else key
        if key not in owner:
            near = nearest(key, owner) if owner else "the object is empty"
            raise self.wrong(here, f"missing; {near}")
        value = owner[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.wrong(here, f"{short(value)}; allowed: {what}")
        return value

    def only(self, owner: Mapping[str, Any], path: str, keys: Iterable[str]) -> None:
        """Refuse unknown keys: a mistyped one would be passed over."""
        known = tuple(keys)
        for key in owner:
            if key not in known:
                raise self.wrong(f"{path}.{key}" if path else clipped(key), f"not known; {nearest(key, known)}")

    def array(self, owner: Mapping[str, Any], key: str, path: str, shape: tuple[int, ...]) -> FloatArray:
        """Finite numbers of a shape."""
        value = self.member(owner, key, path, list, f"numbers of shape {shape}")
        here = f"{path}.{key}"
        try:
            cells = np.array(value, dtype=object)
        except ValueError:
            raise self.wrong(here, f"not numbers of shape {shape}") from None
        for at, cell in zip(np.ndindex(cells.shape), cells.flat, strict=True):
            if cell is None:
                raise self.wrong(here + "".join(f"[{i}]" for i in at), "null is not a finite number")
            if not is_number(cell):
                raise self.wrong(here, f"not numbers of shape {shape}: {short(cell)}")
        if cells.shape != shape:
            raise self.wrong(here, f"shape {cells.shape}; allowed: {shape}")
        return cells.astype(float)

    def rows(self, owner: Mapping[str, Any], key: str, path: str, kinds: tuple[type, ...], what: str) -> Any:
        """A list of short lists, each with values of these kinds, as a tuple of tuples."""
        out = self.member(owner, key, path, list, what)
        for row in out:
            good = isinstance(row, list) and len(row) == len(kinds)
            if not good or not all(
                is_whole(cell) if kind is int else isinstance(cell, kind) for cell, kind in zip(row, kinds, strict=True)
            ):
                raise self.wrong(f"{path}.{key}", f"{short(row)}; allowed: {what}")
        return tuple(tuple(row) for row in out)


def is_number(value: object) -> bool:
    """A JSON number; `parse` has seen to it that all of them are finite."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """A count."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def short(value: object) -> str:
    """A value for a message."""
    return clipped(repr(value))


def clipped(text: str) -> str:
    """A text for a message."""
    return text if len(text) <= 60 else text[:57] + "..."


def parse(text: str, file: str) -> object:
    """JSON with finite numbers only."""

    def refuse(token: str) -> float:
        raise ModelError(
            f"{file}: {clipped(token)} is not a finite number; allowed: finite numbers, null for an open bound"
        )

    def whole(token: str) -> int:
        if len(token.lstrip("-")) > _WHOLE_DIGITS:
            raise ModelError(f"{file}: {clipped(token)}; allowed: whole numbers of at most {_WHOLE_DIGITS} digits")
        return int(token)

    def number(token: str) -> float:
        value = float(token)
        return value if math.isfinite(value) else refuse(token)

    try:
        return json.loads(text, parse_constant=refuse, parse_int=whole, parse_float=number)
    except json.JSONDecodeError as error:
        message = f"{file}, line {error.lineno}, column {error.colno}: broken JSON ({error.msg})"
        raise ModelError(message) from None
    except RecursionError:
        raise ModelError(f"{file}: broken JSON (nested too deeply)") from None


def read_text(path: Path) -> str:
    """The file's text; a file that cannot be read is a ModelError."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ModelError(f"{path}: cannot read the scenario model (not UTF-8 text)") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise ModelError(f"{clipped(str(path))}: cannot read the scenario model ({reason})") from None
