"""A table whose rows are nearly always one and the same row, which is kept once as long as they are."""

from __future__ import annotations

from typing import Any

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray


class SharedRows:
    """Room for d rows of n numbers, as for scores without control, which differ between designs in some windows only.

    Parameters
    ----------
    size : int
        Number of rows d.
    n : int
        Number of columns.
    """

    def __init__(self, size: int, n: int) -> None:
        self._size = size
        self._row = np.empty(n)
        self._known = np.zeros(n, dtype=np.bool_)
        self._table: FloatArray | None = None

    def put(self, place: int, columns: Any, values: FloatArray) -> None:
        """Set some numbers of a row; `columns` is a slice or an array of int."""
        if self._table is None:
            known = self._known[columns]
            # bits: NaN stands for a scenario that cannot be driven
            same = self._row[columns].view(np.int64) == np.ascontiguousarray(values).view(np.int64)
            if (same | ~known).all():
                if not known.all():
                    self._row[columns] = values
                    self._known[columns] = True
                return
            self._table = np.empty((self._size, self._row.size))
            self._table[:] = self._row
        self._table[place, columns] = values

    def grow(self, size: int) -> None:
        """Make room for more rows."""
        if self._table is not None:
            table = np.empty((size, self._row.size))
            table[: self._size] = self._table
            self._table = table
        self._size = size

    def take(self, rows: IntArray | None, columns: IntArray | None = None) -> FloatArray:
        """Some rows and columns, all by default; a read-only view of one row where there is only one."""
        if self._table is not None:
            table = self._table if rows is None else self._table[rows]
            return table if columns is None else table[:, columns]
        row = self._row if columns is None else self._row[columns]
        return np.broadcast_to(row, (self._size if rows is None else rows.size, row.size))
