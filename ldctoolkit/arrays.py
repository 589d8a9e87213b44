"""Types of arrays, whose shapes are given where they are used, frozen dataclasses of arrays, and tables of facts."""

from __future__ import annotations

import abc
import dataclasses
import html
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import LdcError

if TYPE_CHECKING:
    import polars as pl

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

LANES: Final = 8  # Scenarios side by side in compiled code, see `ldctoolkit.lanes`


def unmasked(values: Any) -> Any:
    """A masked array as a plain one whose masked entries are missing: NaN, or False; anything else as it is."""
    if not np.ma.isMaskedArray(values):
        return values
    if not np.ma.is_masked(values) or values.dtype.kind == "b":
        return np.ma.filled(values, False)
    return np.ma.filled(values.astype(np.float64 if values.dtype.kind in "iuf" else np.object_), np.nan)


class ReadOnly:
    """A frozen dataclass whose arrays cannot be written to: views, so that the caller's own arrays stay writable."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            array = getattr(self, field.name)
            if isinstance(array, np.ndarray):
                array = unmasked(array).view()
                array.flags.writeable = False
                object.__setattr__(self, field.name, array)


class Rows(ReadOnly):
    """A frozen dataclass of columns with one row for each departure: arrays, or what has such rows itself."""

    def take(self, rows: npt.ArrayLike | slice) -> Self:
        """The chosen rows of every column: an index array, a mask or a slice."""
        index = row_index(rows)
        names = [field.name for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        columns = {name: _rows_of(getattr(self, name), index) for name in names}
        return dataclasses.replace(self, **columns)  # type: ignore[type-var]


def row_index(rows: npt.ArrayLike | slice) -> IntArray | BoolArray | slice:
    """Rows to take: an index array, a mask or a slice; an empty list takes none."""
    index = rows if isinstance(rows, slice) else np.asarray(rows)
    if not isinstance(index, slice) and index.size == 0:
        return index.astype(np.int64)  # an empty list would be an array of floats
    return index


def _rows_of(column: Any, index: IntArray | BoolArray | slice) -> Any:
    """Some rows of a column of any kind; what has no rows stays."""
    if isinstance(column, tuple):
        return tuple(part.take(index) for part in column)
    if isinstance(column, Rows):
        return column.take(index)
    return column[index] if isinstance(column, np.ndarray) else column


class Frame(ReadOnly, abc.ABC):
    """What can be a data frame: a row a departure or design, columns with their unit at the end, ``deepest_m``."""

    @abc.abstractmethod
    def to_polars(self) -> pl.DataFrame:
        """A polars data frame."""

    def to_pandas(self) -> Any:
        """The same as a pandas data frame; pandas is not among the toolkit's own packages."""
        try:
            import pandas  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise LdcError("to_pandas", "needs pandas, which is not installed", hint="or use to_polars()") from None

        return pandas.DataFrame({name: column.to_numpy() for name, column in self.to_polars().to_dict().items()})


# no ground and no text colour of its own: the notebook's theme, light or dark, sets them
CELL: Final = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"


def facts_html(title: str, lines: Iterable[tuple[str, str]], value_style: str) -> str:
    """A title and a table of names and values, these in a CSS style."""
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left;font-weight:normal;{CELL}">{html.escape(name)}</th>'
        f'<td style="{value_style};{CELL}">{html.escape(value)}</td></tr>'
        for name, value in lines
    )
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b></div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><tbody>{rows}</tbody></table></div>'
    )
