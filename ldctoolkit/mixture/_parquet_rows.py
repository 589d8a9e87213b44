"""Rows of Parquet files, a bounded piece at a time: chosen columns as floats, chosen rows, checked.

Imports polars where it is used. Everything here can be pickled, so that a worker elsewhere reads for itself.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture.sources import BLOCK, FloatArray

if TYPE_CHECKING:
    import polars as pl

Value = str | float | int | bool
Rows = tuple[FloatArray, FloatArray | None]
"""Events (m, d) and their weights (m,), if any."""

PIECE: Final = 16 * BLOCK
"""Rows of a file that are read at once. A piece of a row group costs a look at all of its compressed bytes, so much
smaller pieces would be slow and much larger ones would need more memory."""

_LISTED: Final = 20
"""Values of a column that a message lists at most."""


@dataclasses.dataclass(frozen=True)
class Piece:
    """Consecutive rows of one file: `rows` of them, the first one has number `first` (from 0)."""

    file: int
    first: int
    rows: int


@dataclasses.dataclass(frozen=True)
class ParquetRows:
    """Chosen columns and rows of Parquet files, in the order of the files.

    Attributes
    ----------
    paths : tuple of Path
        Files, absolute.
    rows, size : tuple of int
        Rows and bytes of each file when it was opened.
    columns : tuple of str
        Columns of an event.
    weight : str, optional
        Column of the weights.
    where : tuple of (str, value)
        A row is taken if every one of these columns has its value.
    """

    paths: tuple[Path, ...]
    rows: tuple[int, ...]
    size: tuple[int, ...]
    columns: tuple[str, ...]
    weight: str | None
    where: tuple[tuple[str, Value], ...]

    @classmethod
    def open(
        cls, paths: Sequence[Path], columns: Sequence[str], where: tuple[tuple[str, Value], ...], weight: str | None
    ) -> ParquetRows:
        """Look at the files' heads.

        Raises
        ------
        InputError
            For a file that is missing or no Parquet, or a column that is missing or of the wrong type.
        """
        needed = (*columns, weight) if weight is not None else tuple(columns)
        heads = [_check_head(path, needed, where) for path in paths]
        rows, size = (tuple(head[i] for head in heads) for i in (0, 1))
        return cls(tuple(paths), rows, size, tuple(columns), weight, where)

    def pieces(self) -> list[Piece]:
        """All rows of all files, in order."""
        return [
            Piece(file, first, min(PIECE, rows - first))
            for file, rows in enumerate(self.rows)
            for first in range(0, rows, PIECE)
        ]

    def count(self, piece: Piece) -> int:
        """Rows of a piece that are taken."""
        if not self.where:
            return piece.rows
        import polars as pl

        return int(self._collect(self._scan(piece).select(pl.len()), piece).item())

    def read(self, piece: Piece) -> Rows:
        """The taken rows of a piece.

        Raises
        ------
        InputError
            For a file that has gone, has changed or cannot be read, a value that is missing or not finite, or a
            negative weight; the message names file, row (the first is 1), column and how many there are.
        """
        frame = self._collect(self._scan(piece).select(self._numbers()), piece)
        all_there = sum(frame.null_count().row(0)) == 0
        x = frame.to_numpy()
        if x.dtype != np.float64:  # without rows there is nothing to tell the type from
            x = x.astype(float)
        # a finite sum has finite terms; only an infinite one needs a closer look
        with np.errstate(over="ignore", invalid="ignore"):
            finite = all_there and (np.isfinite(x.sum()) or np.isfinite(x).all())
        d = len(self.columns)
        weight = None if self.weight is None else x[:, d]
        if not finite or (weight is not None and weight.size and weight.min() < 0.0):
            self._complain()
        return x[:, :d], weight

    def _numbers(self) -> list[pl.Expr]:
        import polars as pl

        names = [*self.columns, *([] if self.weight is None else [self.weight])]
        return [pl.col(name).cast(pl.Float64).alias(f"{i}") for i, name in enumerate(names)]

    def _scan(self, piece: Piece, number: str | None = None) -> pl.LazyFrame:
        """The taken rows of a piece, not read yet; `number` names a column for their numbers in the file, from 1."""
        import polars as pl

        lazy = scan(self.paths[piece.file]).slice(piece.first, piece.rows)
        if number is not None:
            lazy = lazy.with_row_index(number, piece.first + 1)
        for name, value in self.where:
            text = isinstance(value, str)
            lazy = lazy.filter((pl.col(name).cast(pl.String) if text else pl.col(name)) == value)
        return lazy

    def _collect(self, lazy: pl.LazyFrame, piece: Piece) -> pl.DataFrame:
        path = self.paths[piece.file]
        with readable(path):
            if path.stat().st_size != self.size[piece.file]:
                raise InputError(f"{path.name}: has changed since it was opened; allowed: files at rest")
            return lazy.collect()

    def _complain(self) -> None:
        """Raise for the first column with a bad value: its first place and how many there are."""
        import polars as pl

        names = [*self.columns, *([] if self.weight is None else [self.weight])]
        counts, rows = np.zeros(len(names), dtype=np.int64), 0
        first: dict[int, tuple[str, int, object]] = {}
        for piece in self.pieces():
            lazy = self._scan(piece, "number").select(pl.col("number"), *self._numbers())
            frame = self._collect(lazy, piece)
            rows += frame.height
            for j, name in enumerate(names):
                bad = ~frame[f"{j}"].is_finite().fill_null(False)
                if name == self.weight and j == len(self.columns):
                    bad |= (frame[f"{j}"] < 0.0).fill_null(True)
                if bad.any():
                    counts[j] += int(bad.sum() or 0)
                    at = bad.arg_max() or 0
                    first.setdefault(j, (self.paths[piece.file].name, frame["number"][at], frame[f"{j}"][at]))
        j = min(first)
        file, row, value = first[j]
        allowed = "finite numbers >= 0" if j == len(self.columns) else "finite numbers"
        shown = "nothing" if value is None else repr(value)
        raise InputError(
            f"{file}, row {row}: column {names[j]!r} holds {shown}; allowed: {allowed} ({counts[j]} of {rows} rows)"
        )

    def no_rows(self) -> InputError:
        """What to say where no row is taken."""
        import polars as pl

        files = ", ".join(path.name for path in self.paths[:3]) + (", ..." if len(self.paths) > 3 else "")
        if not self.where or sum(self.rows) == 0:
            return InputError(f"{files}: no rows; allowed: at least one event")
        wanted = " and ".join(f"{name} = {value!r}" for name, value in self.where)
        hints = []
        for name, value in self.where:
            if isinstance(value, str):
                at = next(i for i, rows in enumerate(self.rows) if rows)
                column = scan(self.paths[at]).head(PIECE).select(pl.col(name).cast(pl.String))
                found = self._collect(column, Piece(at, 0, 0))[name].drop_nulls().unique(maintain_order=True)
                if value not in found:
                    hints.append(f"; {name}: {nearest(value, found[:_LISTED].to_list())}")
        return InputError(f"{files}: none of {sum(self.rows)} rows has {wanted}{''.join(hints)}")


def scan(path: Path) -> pl.LazyFrame:
    """A file as it is: its name and folder mean nothing."""
    import polars as pl

    return pl.scan_parquet(path, glob=False, hive_partitioning=False, cache=False)


@contextlib.contextmanager
def readable(path: Path) -> Iterator[None]:
    """Tell of a file that cannot be read as such."""
    import polars as pl

    try:
        yield
    except FileNotFoundError:
        raise InputError(f"{path}: does not exist; allowed: Parquet files") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise InputError(f"{path.name}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None


def _check_head(path: Path, needed: Sequence[str], where: tuple[tuple[str, Value], ...]) -> tuple[int, int]:
    """Rows and bytes of a file that has what is needed."""
    import polars as pl

    with readable(path):
        size = path.stat().st_size
        if path.is_dir():
            raise InputError(f"{path}: is a folder; allowed: Parquet files")
        schema = scan(path).collect_schema()
        rows = int(scan(path).select(pl.len()).collect().item())
    for name in (*needed, *(name for name, _ in where)):
        if name not in schema:
            raise InputError(f"{path.name}: column {name!r} is missing; {nearest(name, schema)}")
    for name in needed:
        if not schema[name].is_numeric():
            raise InputError(f"{path.name}: column {name!r} is of type {schema[name]}; allowed: numbers")
    for name, value in where:
        kind = schema[name]
        text = kind in (pl.String, pl.Categorical, pl.Enum)
        fits = text if isinstance(value, str) else kind == pl.Boolean if isinstance(value, bool) else kind.is_numeric()
        if not fits:
            raise InputError(f"where: {name!r} = {value!r}; allowed: a value of type {kind}, as in {path.name}")
    return rows, size


def check_request(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    columns: Sequence[str],
    where: Mapping[str, Value] | None,
    weight: str | None,
) -> tuple[tuple[Path, ...], tuple[str, ...], tuple[tuple[str, Value], ...]]:
    """Paths, columns and row filter as they are kept; no file is looked at."""
    several = [paths] if isinstance(paths, str | os.PathLike) else paths
    files = tuple(Path(path).absolute() for path in several)
    if not files:
        raise InputError("paths: none; allowed: one or more Parquet files")
    if isinstance(columns, str) or not columns:
        raise InputError(f"columns: {columns!r}; allowed: one or more names of columns")
    for what, names in (("paths", [str(file) for file in files]), ("columns", list(columns))):
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"{what}: {twice[0]!r} is given more than once")
    if weight is not None and weight in columns:
        raise InputError(f"weight: {weight!r} is among the columns of an event; allowed: another column")
    conditions = []
    for name, value in (where or {}).items():
        plain = value.item() if isinstance(value, np.generic) else value
        if not isinstance(plain, str | bool | int | float):
            raise InputError(f"where: {name!r} = {plain!r}; allowed: a text, a number or a truth value")
        conditions.append((name, plain))
    return files, tuple(columns), tuple(conditions)


def blocks_of(parts: Iterable[Rows]) -> Iterator[Rows]:
    """Rows cut anew into blocks of `BLOCK`, whatever the parts' sizes; only the last one may be shorter."""
    kept: list[Rows] = []
    have = 0
    for x, weight in parts:
        at = 0
        while x.shape[0] - at >= BLOCK - have:
            end = at + BLOCK - have
            kept.append(_cut(x, weight, at, end))
            yield joined(kept)
            kept, have, at = [], 0, end
        if at < x.shape[0]:
            kept.append(_cut(x, weight, at, x.shape[0]))
            have += x.shape[0] - at
    if kept:
        yield joined(kept)


def _cut(x: FloatArray, weight: FloatArray | None, first: int, end: int) -> Rows:
    # a copy row by row: a block does not keep its piece in memory, and its sums do not depend on the memory's order
    rows = np.array(x[first:end], order="C")
    return rows, None if weight is None else np.array(weight[first:end])


def joined(parts: Sequence[Rows]) -> Rows:
    """Parts, at least one, under each other."""
    if len(parts) == 1:
        return parts[0]
    weights = [weight for _, weight in parts if weight is not None]
    return np.concatenate([x for x, _ in parts]), np.concatenate(weights) if weights else None


def chosen(parts: Iterable[Rows], rows: npt.NDArray[np.int64], first: int = 0) -> Iterator[Rows]:
    """Rows by their ascending numbers, a part at a time; `first` is the number of the parts' first row."""
    for x, weight in parts:
        low, high = np.searchsorted(rows, (first, first + x.shape[0]))
        if high > low:
            at = rows[low:high] - first
            yield np.array(x[at], order="C"), None if weight is None else weight[at]
        first += x.shape[0]
        if rows.size and rows[-1] < first:
            return  # no need to read on
