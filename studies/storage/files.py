"""Files of a result folder: written whole or not at all, read with what is wrong named, locked while in use."""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import importlib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit import LdcError, Scenarios
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings.departures_table import read_signals, signals_path, signals_table
from ldctoolkit.whole_file import parse_json, read_regular, whole_file

if TYPE_CHECKING:
    import polars as pl


SCENARIOS = "scenarios.parquet"


@contextlib.contextmanager
def stored_file(path: Path) -> Iterator[IO[bytes]]:
    """A `whole_file` of a study."""
    try:
        with whole_file(path) as stream:
            yield stream
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None


def output_folder(folder: Path) -> Path:
    """Make a folder, if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be made: {error.strerror or error}") from None
    return folder


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all; what a path has that is no text is written as in messages."""
    with stored_file(path) as stream:
        stream.write(text.encode(errors="backslashreplace"))


def csv_text(columns: Iterable[str], rows: Iterable[Mapping[str, Any]], *, plain: bool = False) -> str:
    """Rows as CSV, empty where there is no value; an apostrophe before what a spreadsheet would run, unless `plain`."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(columns), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows if plain else ({name: _cell(value) for name, value in row.items()} for row in rows))
    return text.getvalue()


_FORMULA: Final = re.compile(r"[=@\t]|[+-](?!([\d.]+(e[+-]?\d+)?|inf|nan)$)")


def _cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    value = value.replace("\r", " ")  # a line would end there
    return f"'{value}" if _FORMULA.match(value) else value


def write_parquet(path: Path, table: pl.DataFrame) -> None:
    """Write a Parquet file, whole or not at all."""
    with stored_file(path) as stream:
        table.write_parquet(stream)


def read_bytes(path: Path) -> bytes:
    """The content of a regular file."""
    return read_regular(path, StoreError, None)


def read_json(path: Path) -> Any:
    """What a file in JSON holds; raises `StoreError`, or `ValueError` for what is no JSON."""
    return parse_json(read_regular(path, StoreError))


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


def write_scenarios(folder: Path, scenarios: Scenarios) -> None:
    """Write the scenarios of a study, and what is replayed of recorded paths."""
    write_parquet(folder / SCENARIOS, scenario_table(scenarios))
    if scenarios.signals is not None:
        write_parquet(signals_path(folder / SCENARIOS), signals_table(scenarios.signals))


def read_scenarios(path: Path) -> Scenarios:
    """Read a table written from `scenario_table`, and the signals beside it, if any."""
    import polars as pl

    schema = {"scenario": pl.UInt32(), "side": pl.String(), **dict.fromkeys(PARAMETER_COLUMNS.values(), pl.Float64())}
    table = read_parquet(path, schema)
    columns = {name: table[column].to_numpy() for name, column in PARAMETER_COLUMNS.items()}
    try:
        made = Scenarios.drawn(side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT), **columns)
        if signals_path(path).exists():
            made = dataclasses.replace(made, signals=read_signals(signals_path(path), made.T))
    except LdcError as error:
        raise StoreError(f"{path}: broken: {error}") from None
    return made


_NAME = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, as long as the block or the process lives; a killed process holds nothing."""
    try:
        fcntl = importlib.import_module("fcntl")
    except ImportError:  # Windows: the folder is not guarded there
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
            pass  # a file system without locks, as some network ones: the folder is not guarded there
        yield


def remove_leftovers(folder: Path) -> None:
    """Remove what a killed process had not finished writing; call it only while the folder is held."""
    for path in (*folder.glob(".*.part"), *(folder / "results").glob(".*.part")):
        with contextlib.suppress(OSError):
            path.unlink()


def remove_unfinished(path: Path) -> None:
    """Remove what killed processes had not finished writing of one file; call it while no other writes it."""
    # as `whole_file` names it, after the process
    name = re.compile(rf"\.{re.escape(path.name)}\.\d+\.part")
    with contextlib.suppress(OSError):
        for other in list(path.parent.iterdir()):
            if name.fullmatch(other.name):
                other.unlink()
