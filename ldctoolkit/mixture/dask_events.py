"""Events in Parquet files that the workers of a Dask cluster read: only sums come back."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from ldctoolkit.mixture._parquet_rows import (
    ParquetRows,
    Piece,
    Rows,
    Value,
    blocks_of,
    check_request,
    chosen,
    joined,
)
from ldctoolkit.mixture.cluster import Cluster
from ldctoolkit.mixture.sources import BLOCK, FloatArray, IntArray, Part, Work

if TYPE_CHECKING:
    from distributed import Client

_LEAST: Final = 16
_MOST: Final = 128
"""Blocks of a task: enough that its reading and its journey pay, few enough that all workers have some."""

_TASKS: Final = 4
"""Tasks a worker thread, at least, where there are blocks enough."""


@dataclasses.dataclass(frozen=True)
class Span:
    """Consecutive taken rows: `rows` of them, after the first `skip` that the pieces hold."""

    pieces: tuple[Piece, ...]
    skip: int
    rows: int


class DaskEvents:
    """Events in Parquet files, worked on by a Dask cluster.

    Each worker reads its share of the files for itself. What the work gives for each block comes back and is added in
    the order of the blocks: a fit gives the same numbers as on `ArrayEvents`, whatever the number of workers. (On
    processors of different kinds the last digits of a block's sums may differ.)

    Parameters
    ----------
    cluster : Client or str
        A client, or the address of a scheduler, such as ``"tcp://10.0.0.1:8786"``.
    paths : path or sequence of paths
        Parquet files that every worker sees under the same path; this computer need not see them.
    columns : sequence of str
        Columns of an event, of any type of number.
    where : mapping of str to value, optional
        Only rows are taken whose columns have these values: ``{"side": "left"}``.
    weight : str, optional
        Column of the events that each row stands for, not negative.

    Raises
    ------
    InputError
        If Dask is not installed or no scheduler answers; for a file, a column, a filter or a value that does not fit,
        as for `ParquetEvents`.
    ClusterError
        If the cluster has no workers, if they have another version of the toolkit, or if a task ends one worker after
        another. A worker that dies is made up for by the others.

    Notes
    -----
    Needs the extra ``cluster``. It is a context manager, which leaves the cluster at its end.

    Examples
    --------
    >>> DaskEvents("nowhere", "d.parquet", ["T_s"])  # doctest: +SKIP
    Traceback (most recent call last):
    ldctoolkit.errors.InputError: 'nowhere': not an address: ...
    """

    def __init__(
        self,
        cluster: Client | str,
        paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        columns: Sequence[str],
        *,
        where: Mapping[str, Value] | None = None,
        weight: str | None = None,
    ) -> None:
        files, names, conditions = check_request(paths, columns, where, weight)
        self._cluster = Cluster(cluster)
        try:
            self._cluster.check_workers(files)
            opened = self._cluster.client.submit(ParquetRows.open, files, names, conditions, weight, pure=False)
            self._rows: ParquetRows = self._cluster.result(opened)
            self._pieces: list[Piece] = self._rows.pieces()
            self._ends = np.cumsum(self._counts(), dtype=np.int64)
            if self._ends.size == 0 or self._ends[-1] == 0:
                raise self._cluster.result(self._cluster.client.submit(_no_rows, self._rows, pure=False))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the cluster, unless its client was given."""
        self._cluster.close()

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return len(self._rows.columns)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of an event, in order."""
        return self._rows.columns

    def count_rows(self) -> int:
        """Number of rows that are taken."""
        return int(self._ends[-1])

    def _counts(self) -> list[int]:
        """Taken rows of each piece."""
        if not self._rows.where:
            return [piece.rows for piece in self._pieces]
        groups = [self._pieces[first : first + _LEAST] for first in range(0, len(self._pieces), _LEAST)]
        counts = self._cluster.in_order(_count, groups, len(groups), self._rows)
        return [count for group in counts for count in group]

    def _span(self, first: int, end: int) -> Span:
        """Taken rows `first` to `end`."""
        low = int(np.searchsorted(self._ends, first, side="right"))
        high = int(np.searchsorted(self._ends, end, side="left"))
        before = int(self._ends[low - 1]) if low else 0
        return Span(tuple(self._pieces[low : high + 1]), first - before, end - first)

    def _spans(self) -> list[Span]:
        """All taken rows, in whole blocks."""
        rows = int(self._ends[-1])
        blocks = -(-rows // BLOCK)
        each = BLOCK * min(max(blocks // (_TASKS * max(self._cluster.threads(), 1)), _LEAST), _MOST)
        return [self._span(first, min(first + each, rows)) for first in range(0, rows, each)]

    def map_blocks(self, work: Work[Part]) -> Iterator[Part]:
        """What `work` gives for each block of `BLOCK` rows, in order."""
        spans = self._spans()
        for parts in self._cluster.in_order(_map, spans, len(spans), self._rows, work):
            yield from parts

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Rows (m, d) by their ascending numbers, and their weights."""
        spans = self._spans()
        ends = np.cumsum([span.rows for span in spans])
        cuts = np.searchsorted(rows, ends)
        asked = [
            (span, rows[low:high] - (end - span.rows))
            for span, end, low, high in zip(spans, ends, [0, *cuts[:-1]], cuts, strict=True)
            if high > low
        ]
        found = list(self._cluster.in_order(_take, asked, len(asked), self._rows))
        if not found:
            return np.empty((0, self.dimension)), None if self._rows.weight is None else np.empty(0)
        return joined(found)

    def blocks(self) -> Iterator[FloatArray]:
        """The rows of each block, in order; they travel from the workers to here."""
        for parts in self._cluster.in_order(_map, self._spans(), 2, self._rows, _only_rows):
            yield from parts


def _count(pieces: list[Piece], rows: ParquetRows) -> list[int]:
    return [rows.count(piece) for piece in pieces]


def _no_rows(rows: ParquetRows) -> Exception:
    return rows.no_rows()


def _only_rows(x: FloatArray, weight: FloatArray | None) -> FloatArray:
    del weight
    return x


def _map(span: Span, rows: ParquetRows, work: Work[Part]) -> list[Part]:
    return [work(x, weight) for x, weight in blocks_of(_read(span, rows))]


def _take(asked: tuple[Span, IntArray], rows: ParquetRows) -> Rows:
    span, numbers = asked
    return joined(list(chosen(_read(span, rows), numbers)))


def _read(span: Span, rows: ParquetRows) -> Iterable[Rows]:
    """The span's rows, a piece at a time."""
    skip, left = span.skip, span.rows  # the rows that are passed over lie in the first piece
    for piece in span.pieces:
        x, weight = rows.read(piece)
        end = min(skip + left, x.shape[0])
        yield x[skip:end], None if weight is None else weight[skip:end]
        skip, left = 0, left - (end - skip)
