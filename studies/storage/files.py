"""Files of a result folder: written whole or not at all, read with what is wrong named, locked while in use; parts."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import io
import json
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

import numpy as np

from ldctoolkit import EventStatus, LdcError, Scenarios
from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import StoreError
from ldctoolkit.metrics import METRIC_COLUMNS
from ldctoolkit.simulation import Window
from ldctoolkit.whole_file import whole_file
from studies.results import TaskResult

if TYPE_CHECKING:
    import polars as pl


@contextlib.contextmanager
def stored_file(path: Path) -> Iterator[IO[bytes]]:
    """A `whole_file` of a study."""
    try:
        with whole_file(path) as stream:
            yield stream
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    with stored_file(path) as stream:
        stream.write(text.encode())


def write_parquet(path: Path, table: pl.DataFrame) -> None:
    """Write a Parquet file, whole or not at all."""
    with stored_file(path) as stream:
        table.write_parquet(stream)


def read_bytes(path: Path) -> bytes:
    """The content of a file."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_parquet(path: Path, schema: dict[str, Any], *, finite: bool = True) -> pl.DataFrame:
    """Read a Parquet file and check it as `parse_parquet` does."""
    return parse_parquet(path, read_bytes(path), schema, finite=finite)


def parse_parquet(
    path: Path,
    data: bytes,
    schema: dict[str, Any],
    *,
    finite: bool = True,
    change: Callable[[pl.DataFrame], pl.DataFrame] | None = None,
) -> pl.DataFrame:
    """A table from the bytes of a Parquet file, checked: columns, types, nothing missing, with `finite` all finite.

    `change` makes the columns of this version of those of an earlier one.
    """
    import polars as pl

    try:
        table = pl.read_parquet(data)
        table = table if change is None else change(table)
    except pl.exceptions.PolarsError as error:
        raise StoreError(f"{path}: broken: {str(error).splitlines()[0]}") from None
    if dict(table.schema) != schema:
        raise StoreError(f"{path}: broken: its columns are {', '.join(table.columns)}; needed: {', '.join(schema)}")
    for column in table.iter_columns():
        if column.null_count() or (finite and column.dtype.is_float() and not column.is_finite().all()):
            raise StoreError(f"{path}: broken: column {column.name} holds a value that is missing or not finite")
    return table


def scenario_table(scenarios: Scenarios) -> pl.DataFrame:
    """Scenarios as a table: index, side, eight parameters with their units in the names."""
    import polars as pl

    return pl.DataFrame(
        {
            "scenario": np.arange(len(scenarios), dtype=np.uint32),
            "side": np.where(scenarios.side == LEFT, "left", "right").tolist(),
            **{column: getattr(scenarios, name) for name, column in PARAMETER_COLUMNS.items()},
        }
    )


def read_scenarios(path: Path) -> Scenarios:
    """Read a table written from `scenario_table`."""
    import polars as pl

    schema = {"scenario": pl.UInt32(), "side": pl.String(), **dict.fromkeys(PARAMETER_COLUMNS.values(), pl.Float64())}
    table = read_parquet(path, schema)
    columns = {name: table[column].to_numpy() for name, column in PARAMETER_COLUMNS.items()}
    try:
        return Scenarios.drawn(side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT), **columns)
    except LdcError as error:
        raise StoreError(f"{path}: broken: {error}") from None


_NAME = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, as long as the block or the process lives; a killed process holds nothing."""
    try:
        fcntl = importlib.import_module("fcntl")
    except ImportError:  # Windows: no one guards the folder there
        yield
        return
    try:
        stream = (folder / _NAME).open("ab")
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written: {error.strerror or error}") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StoreError(f"{folder}: another run is writing into this folder; wait for it, or end it") from None
        except OSError:
            pass  # a file system without locks, as some network ones: no one guards the folder there
        yield


def remove_leftovers(folder: Path) -> None:
    """Remove what a killed process had not finished writing; call it only while the folder is held."""
    for path in (*folder.glob(".*.part"), *(folder / "results").glob(".*.part")):
        with contextlib.suppress(OSError):
            path.unlink()


def remove_unfinished(path: Path) -> None:
    """Remove what killed processes had not finished writing of one file; call it only while no one else writes it."""
    # as `whole_file` names it, after the process
    name = re.compile(rf"\.{re.escape(path.name)}\.\d+\.part")
    with contextlib.suppress(OSError):
        for other in list(path.parent.iterdir()):
            if name.fullmatch(other.name):
                other.unlink()


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

_ENDLESS = "t_back"  # the companion that may be infinite: the edge is not back inside by the end
_FORMER = {METRIC_COLUMNS["opposite_crossing"]: "overshoot_m"}  # column of a part -> what earlier versions called it

_ADDED = (METRIC_COLUMNS["a_y_added_peak"], METRIC_COLUMNS["jerk_added_peak"])
"""Columns that earlier versions did not record: NaN throughout."""

_DIGITS = 16


def float_columns(windows: Sequence[Window]) -> dict[str, str]:
    """Name of a result's column -> its column in a part, in the order of `TaskResult.values`."""
    scores = {f"{name}_{window}": f"{name}_{window}_m_s" for window in windows for name in ("S", "S_uncorrected")}
    return scores | METRIC_COLUMNS


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
        good = column.is_not_nan() if column.name == METRIC_COLUMNS[_ENDLESS] else column.is_finite()
        if column.name in _ADDED and column.is_nan().all():
            continue
        if not good.all() and not good.to_numpy()[driven].all():
            raise StoreError(f"{path}: broken: column {column.name} holds a value that is not finite")
