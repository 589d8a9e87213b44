"""The values that one entry of a study file stands for: a scalar, a list, or an evenly spaced range."""

from __future__ import annotations

import math
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.errors import InputError, nearest

RANGE_KEYS: Final = ("count", "from", "scale", "to")
MOST_VALUES: Final = 10_000
"""Largest number of values of one entry; more is a slip of the pen."""


class EntryError(InputError):
    """An entry of a study file is wrong; `path` says where inside the entry."""

    def __init__(self, path: str, message: str) -> None:
        super().__init__(message)
        self.path = path


def expand(entry: Any, scale: Literal["linear", "log"] = "linear", *, whole: bool = False) -> tuple[Any, ...]:
    """The values of one entry, in the order written, each once.

    Parameters
    ----------
    entry : scalar, list or table
        A table is ``{from, to, count, scale}``, both ends included.
    scale : {"linear", "log"}
        Spacing of a table that does not say.
    whole : bool
        Round the values of a table to whole numbers.

    Returns
    -------
    tuple

    Raises
    ------
    EntryError
        For an empty list, or a table with a wrong key or value.

    Examples
    --------
    >>> expand({"from": 0.1, "to": 0.3, "count": 3})
    (0.1, 0.2, 0.3)
    >>> expand([1, 2, 2])
    (1, 2)
    """
    if isinstance(entry, dict):
        values = _range(entry, scale, whole)
    elif isinstance(entry, list | tuple):
        if not entry:
            raise EntryError("", "an empty list; allowed: one value or more")
        if len(entry) > MOST_VALUES:
            raise EntryError("", f"{len(entry)} values; allowed: at most {MOST_VALUES}")
        values = list(entry)
    else:
        values = [entry]
    seen: list[Any] = []
    for value in values:
        # True == 1 in Python, not in a study file
        if not any(value == other and type(value) is type(other) for other in seen):
            seen.append(value)
    return tuple(seen)


def _range(entry: dict[str, Any], scale: Literal["linear", "log"], whole: bool) -> list[Any]:
    for key in entry:
        if key not in RANGE_KEYS:
            raise EntryError(f".{key}", f"no such key; {nearest(key, RANGE_KEYS)}")
    for key in ("from", "to", "count"):
        if key not in entry:
            raise EntryError(f".{key}", "missing; a range is written {from = ..., to = ..., count = ...}")
    first, last, count = entry["from"], entry["to"], entry["count"]
    for key, value in (("from", first), ("to", last)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise EntryError(f".{key}", f"{value!r}; allowed: a finite number")
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MOST_VALUES:
        raise EntryError(".count", f"{count!r}; allowed: a whole number from 2 to {MOST_VALUES}")
    scale = entry.get("scale", scale if first * last > 0 else "linear")
    if scale not in ("linear", "log"):
        raise EntryError(".scale", f"{scale!r}; {nearest(str(scale), ('linear', 'log'))}")
    if scale == "log" and not first * last > 0:
        raise EntryError(".scale", f"'log' from {first!r} to {last!r}; allowed: both ends of one sign, neither zero")
    points = np.geomspace(first, last, count) if scale == "log" else np.linspace(first, last, count)
    # twelve digits: 0.3 and not 0.30000000000000004 in names and identities; the ends stay as written
    values = [float(f"{value:.12g}") + 0.0 for value in points.tolist()]
    values[0], values[-1] = float(first), float(last)
    return [round(value) for value in values] if whole else values
