"""Events in Parquet files, read anew at every pass: memory does not grow with the files."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final, TypeVar

import numpy as np

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._parquet_rows import ParquetRows, Rows, Value, blocks_of, check_request, chosen, joined
from ldctoolkit.mixture.sources import FloatArray, IntArray, Part, Work, usable_cores

Item = TypeVar("Item")
Result = TypeVar("Result")

_AHEAD: Final = 2
"""Pieces that are read before they are needed."""

_QUEUED: Final = 4
"""Blocks a thread that wait for it or for their turn."""


class ParquetEvents:
    """Events in one or several Parquet files, for a fit of more than memory holds.

    A fit reads the files again at every pass, while threads work on what has been read. The rows of all files, after
    the row filter, are cut into the same blocks as an array's: a fit gives the same numbers as on `ArrayEvents`.

    Parameters
    ----------
    paths : path or sequence of paths
        Parquet files; the events are taken in this order.
    columns : sequence of str
        Columns of an event, of any type of number.
    where : mapping of str to value, optional
        Only rows are taken whose columns have these values: ``{"side": "left"}``.
    weight : str, optional
        Column of the events that each row stands for, not negative.
    threads : int, optional
        Blocks worked on at a time; all cores this process may use by default. It changes no number.

    Raises
    ------
    InputError
        For a file, a column or a filter that does not fit. While reading: for a value that is missing or not finite,
        a negative weight, a file that has changed, or no rows at all. The message names file, row and column.

    Notes
    -----
    Some hundred megabytes are enough for files of any size if their row groups are of usual size (up to about a
    million rows): the compressed bytes of one row group are in memory at a time, and two pieces of 131,072 rows.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import polars as pl
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "d.parquet")
    ...     pl.DataFrame({"T_s": [1.0, 2.0, 4.0], "side": ["left", "right", "left"]}).write_parquet(path)
    ...     events = ParquetEvents(path, ["T_s"], where={"side": "left"})
    ...     list(events.blocks())[0].ravel().tolist()
    [1.0, 4.0]
    """

    def __init__(
        self,
        paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        columns: Sequence[str],
        *,
        where: Mapping[str, Value] | None = None,
        weight: str | None = None,
        threads: int | None = None,
    ) -> None:
        if threads is not None and threads < 1:
            raise InputError(f"threads: {threads!r}; allowed: an integer >= 1")
        files, names, conditions = check_request(paths, columns, where, weight)
        self._rows = ParquetRows.open(files, names, conditions, weight)
        self._threads = usable_cores() if threads is None else threads

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return len(self._rows.columns)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of an event, in order."""
        return self._rows.columns

    def count_rows(self) -> int:
        """Number of rows that are taken; only the columns of the row filter are read."""
        return sum(self._rows.count(piece) for piece in self._rows.pieces())

    def _parts(self) -> Iterator[Rows]:
        """What is taken of each piece, in order; later pieces are being read meanwhile."""
        with ThreadPoolExecutor(1) as reader:
            empty = True
            for part in in_order(reader, self._rows.read, self._rows.pieces(), _AHEAD):
                empty &= part[0].shape[0] == 0
                yield part
        if empty:
            raise self._rows.no_rows()

    def map_blocks(self, work: Work[Part]) -> Iterator[Part]:
        """What `work` gives for each block of `BLOCK` rows, in order."""
        with ThreadPoolExecutor(self._threads) as pool:
            yield from in_order(pool, lambda rows: work(*rows), blocks_of(self._parts()), _QUEUED * self._threads)

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Rows (m, d) by their ascending numbers, and their weights; the files are read once."""
        found = list(chosen(self._parts(), rows))
        if not found:
            found = [(np.empty((0, self.dimension)), None if self._rows.weight is None else np.empty(0))]
        return joined(found)

    def blocks(self) -> Iterator[FloatArray]:
        """The rows of each block, in order."""
        for x, _ in blocks_of(self._parts()):
            yield x


def in_order(
    pool: ThreadPoolExecutor, work: Callable[[Item], Result], items: Iterable[Item], ahead: int
) -> Iterator[Result]:
    """Results in the order of the items; at most `ahead` items are worked on or waiting."""
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:  # the caller has stopped, or something has failed
            future.cancel()
