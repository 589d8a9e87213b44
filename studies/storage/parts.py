"""Parts of a study's results: Parquet files whose names tell whether they are whole.

A part's name holds a checksum of its content: a file that was cut short or has a flipped bit is found out before a
number is read from it.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from ldctoolkit import EventStatus
from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import StoreError
from ldctoolkit.metrics import COMPANION_COLUMNS
from ldctoolkit.simulation import Window
from studies.results import TaskResult
from studies.storage.files import parse_parquet, read_bytes, stored_file

if TYPE_CHECKING:
    import polars as pl


Item = TypeVar("Item")
Result = TypeVar("Result")


def ahead(
    function: Callable[[Item], Result], items: Iterable[Item], *, threads: int = 1
) -> Iterator[tuple[Item, Future[Result]]]:
    """Call a function on each item in threads; at most one result more than there are threads waits."""
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        for item in items:
            waiting.append((item, pool.submit(function, item)))
            if len(waiting) > threads:
                yield waiting.popleft()
        yield from waiting


PATTERN = "part-*.parquet"

_ENDLESS = "t_back"
"""The companion that may be infinite: the edge is not back inside by the end."""

_FORMER = {COMPANION_COLUMNS["opposite_crossing"]: "overshoot_m"}
"""Column of a part -> what earlier versions called it."""

_ADDED = (COMPANION_COLUMNS["a_y_added_peak"], COMPANION_COLUMNS["jerk_added_peak"])
"""Columns that earlier versions did not record: NaN throughout."""

_DIGITS = 16


def float_columns(windows: Sequence[Window]) -> dict[str, str]:
    """Name of a result's column -> its column in a part, in the order of `TaskResult.values`."""
    scores = {f"{name}_{window}": f"{name}_{window}_m_s" for window in windows for name in ("S", "S_uncorrected")}
    return scores | COMPANION_COLUMNS


def schema(windows: Sequence[Window]) -> dict[str, Any]:
    """Columns of a part and their types."""
    import polars as pl

    return {
        "design": pl.String(),
        "convention": pl.String(),
        "scenario": pl.UInt32(),
        **dict.fromkeys(float_columns(windows).values(), pl.Float64()),
        "status": pl.Int8(),
        "failed_solves": pl.Int32(),
    }


def write_part(folder: Path, results: Sequence[TaskResult], windows: Sequence[Window]) -> Path:
    """Write results as one part, whole or not at all; the same results in the same order make the same file."""
    content = io.BytesIO()
    # nearly all columns are noise to a compressor: a fast one loses little
    _table(results, windows).write_parquet(content, compression="lz4", statistics=False)
    data = content.getbuffer()
    what = json.dumps([[result.keys, [int(result.rows[0]), int(result.rows[-1])]] for result in results])
    name = f"part-{hashlib.sha256(what.encode()).hexdigest()[:_DIGITS]}-{_checksum(data)}.parquet"
    with stored_file(folder / name) as stream:
        stream.write(data)
    return folder / name


def _checksum(data: bytes | memoryview) -> str:
    return hashlib.sha256(data).hexdigest()[:_DIGITS]


def _table(results: Sequence[TaskResult], windows: Sequence[Window]) -> pl.DataFrame:
    import polars as pl

    every = [key for result in results for key in result.keys]
    keys = pl.DataFrame(every, schema=["design", "convention"], orient="row")
    counts = np.concatenate([np.full(len(result.keys), result.rows.size) for result in results])
    # names are repeated by the library: a million strings of Python would take longer than the simulation
    repeated = keys[np.repeat(np.arange(counts.size, dtype=np.uint32), counts)]
    columns: dict[str, Any] = {
        "scenario": np.concatenate([np.tile(result.rows.astype(np.uint32), len(result.keys)) for result in results])
    }
    for i, column in enumerate(float_columns(windows).values()):
        columns[column] = np.concatenate([result.values[i].ravel() for result in results])
    columns["status"] = np.concatenate([result.status.ravel() for result in results])
    columns["failed_solves"] = np.concatenate([result.failed_solves.ravel() for result in results])
    types = schema(windows)
    numbers = pl.DataFrame(columns, schema={name: types[name] for name in columns})
    return pl.concat([repeated, numbers], how="horizontal")


def checked_content(path: Path) -> bytes:
    """The content of a part, as it was written."""
    data = read_bytes(path)
    if not path.stem.endswith(f"-{_checksum(data)}"):
        raise StoreError(f"{path}: broken: its content is not what was written (the checksum in its name differs)")
    return data


def parse_part(
    path: Path, data: bytes, windows: Sequence[Window], n: int, *, companions: bool = True
) -> Iterator[TaskResult]:
    """Results that a part holds, one design and stretch of scenarios at a time; without `companions` only checked."""
    table = parse_parquet(path, data, schema(windows), finite=False, change=_as_now)
    status, failed = table["status"].to_numpy(), table["failed_solves"].to_numpy()
    columns = list(float_columns(windows).values())
    _check_numbers(path, [table[column] for column in columns], status)
    floats = np.stack([table[column].to_numpy() for column in (columns if companions else columns[: 2 * len(windows)])])
    rows = table["scenario"].to_numpy().astype(np.int64)
    if rows.size and rows.max() >= n:
        raise StoreError(f"{path}: broken: scenario {rows.max()}; allowed: 0 to {n - 1}")
    keys = table.select("design", "convention")
    other = np.zeros(rows.size, dtype=np.bool_)
    for name in ("design", "convention"):
        other |= keys[name].ne_missing(keys[name].shift(1)).to_numpy()
    ends = np.flatnonzero(other[1:] | (np.diff(rows) <= 0)) + 1
    for a, b in zip([0, *ends.tolist()], [*ends.tolist(), rows.size], strict=True):
        if a == b:
            continue
        design, convention = keys.row(a)
        yield TaskResult(
            keys=((design, convention),),
            rows=rows[a:b],
            values=floats[:, None, a:b],
            status=status[None, a:b],
            failed_solves=failed[None, a:b],
            law_seconds=np.zeros(1),
            commands=np.zeros(1, dtype=np.int64),
        )


def read_column(path: Path, column: str) -> FloatArray:
    """One column of a part, (rows,), not checked again."""
    import polars as pl

    try:
        there = pl.read_parquet_schema(path)
        stored = next(name for name in (column, _FORMER.get(column), "scenario") if name in there)
        table = pl.read_parquet(path, columns=[stored], glob=False, hive_partitioning=False)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StoreError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    values: FloatArray = table[stored].to_numpy() if stored != "scenario" else np.full(table.height, np.nan)
    return values


def _as_now(table: pl.DataFrame) -> pl.DataFrame:
    """A part of an earlier version with the columns of this one."""
    import polars as pl

    table = table.rename({former: column for column, former in _FORMER.items()}, strict=False)
    return table.with_columns(pl.lit(np.nan).alias(column) for column in _ADDED if column not in table.columns)


def _check_numbers(path: Path, columns: Sequence[pl.Series], status: Any) -> None:
    """Refuse what is no number in a scenario that was driven."""
    driven = status != EventStatus.INVALID
    for column in columns:
        good = column.is_not_nan() if column.name == COMPANION_COLUMNS[_ENDLESS] else column.is_finite()
        if column.name in _ADDED and column.is_nan().all():
            continue
        if not good.all() and not good.to_numpy()[driven].all():
            raise StoreError(f"{path}: broken: column {column.name} holds a value that is not finite")
