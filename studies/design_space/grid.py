"""What one entry of a study file stands for: a scalar, a list, an evenly spaced range, or all between two ends."""

from __future__ import annotations

import math
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.errors import InputError, nearest
from studies.design_space.dimensions import Choices, Dimension, Span, rounded

RANGE_KEYS: Final = ("count", "from", "scale", "to")
MOST_VALUES: Final = 10_000
"""Largest number of values of one entry; more is a slip of the pen."""


class EntryError(InputError):
    """An entry of a study file is wrong; `path` says where inside the entry."""

    def __init__(self, path: str, message: str) -> None:
        super().__init__(message)
        self.path = path


def read_entry(entry: Any, scale: Literal["linear", "log"] = "linear", *, whole: bool = False) -> Dimension:
    """The dimension of a design space that one entry stands for.

    Parameters
    ----------
    entry : scalar, list or table
        As in `expand`; a table without ``count`` holds all numbers between its ends.
    scale : {"linear", "log"}
        Spacing of a table that does not say.
    whole : bool
        Whole numbers only, of a table.

    Returns
    -------
    Choices or Span

    Raises
    ------
    EntryError
        As in `expand`.

    Examples
    --------
    >>> read_entry({"from": 0.1, "to": 0.3})
    Span(first=0.1, last=0.3, scale='linear', whole=False)
    """
    if not isinstance(entry, dict) or "count" in entry:
        return Choices(expand(entry, scale, whole=whole))
    first, last, spacing = _ends(entry, scale)
    if first == last:
        raise EntryError("", f"from and to are both {first!r}; allowed: two different numbers")
    return Span(first, last, spacing, whole)


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
    seen: dict[Any, Any] = {}
    for value in values:
        # True == 1 in Python, not in a study file; a list is refused later, as no value of any gain
        seen.setdefault((type(value), value if isinstance(value, int | float | str) else repr(value)), value)
    return tuple(seen.values())


def _range(entry: dict[str, Any], scale: Literal["linear", "log"], whole: bool) -> list[Any]:
    first, last, scale = _ends(entry, scale)
    if "count" not in entry:
        raise EntryError(".count", "missing; a range is written {from = ..., to = ..., count = ...}")
    count = entry["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= MOST_VALUES:
        raise EntryError(".count", f"{count!r}; allowed: a whole number from 2 to {MOST_VALUES}")
    points = np.geomspace(first, last, count) if scale == "log" else np.linspace(first, last, count)
    values = [rounded(value) for value in points.tolist()]
    values[0], values[-1] = float(first), float(last)  # the ends stay as written
    return [round(value) for value in values] if whole else values


def _ends(entry: dict[str, Any], scale: Literal["linear", "log"]) -> tuple[float, float, Literal["linear", "log"]]:
    """Ends and spacing of a table."""
    for key in entry:
        if key not in RANGE_KEYS:
            raise EntryError(f".{key}", f"no such key; {nearest(key, RANGE_KEYS)}")
    for key in ("from", "to"):
        if key not in entry:
            raise EntryError(f".{key}", "missing; a range is written {from = ..., to = ..., count = ...}")
        value = entry[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise EntryError(f".{key}", f"{value!r}; allowed: a finite number")
    first, last = entry["from"], entry["to"]
    one_sign = (first > 0) == (last > 0) and first != 0 and last != 0
    chosen = entry.get("scale", scale if one_sign else "linear")
    if chosen not in ("linear", "log"):
        raise EntryError(".scale", f"{chosen!r}; {nearest(str(chosen), ('linear', 'log'))}")
    if chosen == "log" and not one_sign:
        raise EntryError(".scale", f"'log' from {first!r} to {last!r}; allowed: both ends of one sign, neither zero")
    return first, last, "log" if chosen == "log" else "linear"
