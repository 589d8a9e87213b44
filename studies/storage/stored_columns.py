"""Columns of a study's parts that are read when they are asked for: a large study's companions do not fit in memory."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import StoreError
from studies.results import RunKey, TaskResult
from studies.storage.parts import ahead, read_column

_THREADS: Final = 2
"""That read parts; more would wait for the one that takes in what they read."""


@dataclasses.dataclass(frozen=True)
class _Stretch:
    """Where a part holds some scenarios of a run: rows first to first + size of the part."""

    part: int
    first: int
    size: int
    scenarios: Any


class PartIndex:
    """Where the runs of a study stand in its parts, which were checked when they were added."""

    def __init__(self) -> None:
        self._parts: list[tuple[Path, tuple[int, int]]] = []
        self._stretches: dict[RunKey, list[_Stretch]] = {}

    def add(self, path: Path, results: Sequence[TaskResult]) -> None:
        """Remember what a part holds, one run after the other, as `studies.storage.parts.parse_part` gives it."""
        first = 0
        for result in results:
            (key,) = result.keys
            rows, size = result.rows, result.rows.size
            whole = rows[-1] - rows[0] + 1 == size
            scenarios = slice(int(rows[0]), int(rows[-1]) + 1) if whole else rows
            self._stretches.setdefault(key, []).append(_Stretch(len(self._parts), first, size, scenarios))
            first += size
        self._parts.append((path, _signature(path)))

    def read(self, column: str, keys: Sequence[RunKey], n: int, out: FloatArray | None = None) -> FloatArray:
        """A column of some runs on all n scenarios, (k, n); in `out` where that is given."""
        table = np.empty((len(keys), n)) if out is None else out
        wanted: dict[int, list[tuple[int, _Stretch]]] = {}
        for i, key in enumerate(keys):
            for stretch in self._stretches.get(key, ()):
                wanted.setdefault(stretch.part, []).append((i, stretch))
        # in the order in which they were checked: where two hold the same run, the last one counts
        for part, future in ahead(lambda part: self._column(part, column), sorted(wanted), threads=_THREADS):
            values = future.result()
            for i, stretch in wanted[part]:
                table[i, stretch.scenarios] = values[stretch.first : stretch.first + stretch.size]
        return table

    def _column(self, part: int, column: str) -> FloatArray:
        path, signature = self._parts[part]
        values = read_column(path, column)
        if _signature(path) != signature:
            raise StoreError(f"{path}: changed since it was checked; read the study again")
        return values


def _signature(path: Path) -> tuple[int, int]:
    try:
        found = path.stat()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    return found.st_size, found.st_mtime_ns


class StoredColumn(np.lib.mixins.NDArrayOperatorsMixin):
    """A column of d runs on n scenarios, (d, n), that is read from the parts each time it is used.

    Some designs are an array, ``column[3]``, ``column[[3, 5], :10]``, and only what is asked for is read. Some
    scenarios of all designs, ``column[:, mask]``, are a column again. Everything else that an array can do reads the
    whole column first: NumPy's functions, operators, methods.
    """

    ndim = 2
    dtype = np.dtype(np.float64)

    def __init__(
        self, index: PartIndex, name: str, keys: Sequence[RunKey], n: int, columns: IntArray | None = None
    ) -> None:
        self._index, self._name, self._keys, self._n, self._columns = index, name, tuple(keys), n, columns
        self.shape = (len(self._keys), n if columns is None else columns.size)

    @property
    def size(self) -> int:
        """Number of values."""
        return self.shape[0] * self.shape[1]

    def __len__(self) -> int:
        return self.shape[0]

    def __repr__(self) -> str:
        return f"<{self._name} of {self.shape[0]:,} designs on {self.shape[1]:,} scenarios, read when used>"

    def read(self, rows: slice, room: FloatArray) -> FloatArray:
        """Some designs, (k, m), in `room`, (k n or more,), where possible: memory is cleared when it is used first."""
        if self._columns is not None:
            result: FloatArray = self[rows]
            return result
        keys = self._keys[rows]
        return self._index.read(self._name, keys, self._n, room[: len(keys) * self._n].reshape(len(keys), self._n))

    def _read(self, rows: Sequence[int]) -> FloatArray:
        table = self._index.read(self._name, [self._keys[i] for i in rows], self._n)
        return table if self._columns is None else table[:, self._columns]

    def __getitem__(self, at: Any) -> Any:
        rows, *others = at if isinstance(at, tuple) else (at,)
        of_all = isinstance(rows, slice) and rows == slice(None)
        if of_all and len(others) == 1 and np.ndim(others[0]) == 1:
            columns = np.arange(self._n) if self._columns is None else self._columns
            return StoredColumn(self._index, self._name, self._keys, self._n, columns[np.asarray(others[0])])
        if not _is_simple(rows, others):
            return np.asarray(self)[at]
        places = np.arange(len(self))[rows]
        distinct, back = np.unique(places, return_inverse=True)
        table = self._read(distinct.tolist())
        if distinct.size < places.size or not np.array_equal(distinct, places):
            table = table[back.reshape(places.shape)]
        return table[(..., *others)] if others else table

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> npt.NDArray[Any]:
        if copy is False:
            raise ValueError("a stored column is in memory after it was read only: it is always a copy")
        return self._read(range(len(self))).astype(dtype or np.float64, copy=False)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **named: Any) -> Any:
        arrays = (np.asarray(one) if isinstance(one, StoredColumn) else one for one in inputs)
        return getattr(ufunc, method)(*arrays, **named)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return getattr(np.asarray(self), name)


def _is_simple(rows: Any, others: Sequence[Any]) -> bool:
    """Whether an index is one of the rows, and perhaps one of the columns that has nothing to do with it."""
    if rows is None or rows is Ellipsis or np.ndim(rows) > 1 or len(others) > 1:
        return False
    alone = isinstance(rows, slice) or np.ndim(rows) == 0
    return not others or (others[0] is not Ellipsis and others[0] is not None and (alone or np.ndim(others[0]) == 0))
