"""Columns that travel along with departures: driver, behaviour, road, whatever a source of recordings can tell."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt


@dataclasses.dataclass(frozen=True)
class ExtraColumn:
    """One more column of n departures.

    Attributes
    ----------
    name : str
        Of the column in a departures table; a number's unit at its end.
    values : (n,) str or float
        Text, empty where it is not known, or numbers, NaN where they are not.
    """

    name: str
    values: npt.NDArray[np.str_] | npt.NDArray[np.float64]

    def take(self, rows: npt.NDArray[np.int64] | npt.NDArray[np.bool_] | slice) -> ExtraColumn:
        """The same column of chosen departures."""
        return ExtraColumn(self.name, self.values[rows])


def joined_columns(parts: Sequence[tuple[tuple[ExtraColumn, ...], int]]) -> tuple[ExtraColumn, ...]:
    """Extra columns of several tables, one after the other; what a table lacks is empty there.

    Parameters
    ----------
    parts : sequence of (tuple of ExtraColumn, int)
        Columns of each table and its number of departures.

    Returns
    -------
    tuple of ExtraColumn
        In the order in which the names first come. A column that is text anywhere is text.

    Examples
    --------
    >>> a = ExtraColumn("road", np.array(["motorway"]))
    >>> joined_columns([((a,), 1), ((), 1)])[0].values.tolist()
    ['motorway', '']
    """
    names = dict.fromkeys(column.name for columns, _ in parts for column in columns)
    joined = []
    for name in names:
        found = [(next((c.values for c in columns if c.name == name), None), n) for columns, n in parts]
        text = any(values is not None and values.dtype.kind == "U" for values, _ in found)
        filler: Any = "" if text else np.nan
        kind: Any = np.str_ if text else np.float64
        pieces = [np.full(n, filler, dtype=kind) if v is None else _as(kind, v) for v, n in found]
        joined.append(ExtraColumn(name, np.concatenate(pieces)))
    return tuple(joined)


def _as(kind: Any, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Values as text or numbers; a number that is not known is empty text."""
    if kind is np.str_ and values.dtype.kind == "f":
        return np.where(np.isnan(values), "", values.astype(np.str_))
    return values.astype(kind)
