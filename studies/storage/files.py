"""Files of a study: written whole or not at all; scenarios as a table."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ldctoolkit import LdcError, Scenarios
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import StoreError
from ldctoolkit.whole_file import whole_file

if TYPE_CHECKING:
    import polars as pl


@contextlib.contextmanager
def stored_file(path: Path) -> Iterator[IO[bytes]]:
    """A `whole_file` of a study.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
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
    """The content of a file.

    Raises
    ------
    StoreError
        If it cannot be read.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_parquet(path: Path, schema: dict[str, Any], *, finite: bool = True) -> pl.DataFrame:
    """Read a Parquet file and check it as `parse_parquet` does.

    Raises
    ------
    StoreError
        Naming the file and what is wrong with it.
    """
    return parse_parquet(path, read_bytes(path), schema, finite=finite)


def parse_parquet(path: Path, data: bytes, schema: dict[str, Any], *, finite: bool = True) -> pl.DataFrame:
    """A table from a Parquet file's content, checked: columns, types, nothing missing, nor, with `finite`, not finite.

    Raises
    ------
    StoreError
        Naming the file and what is wrong with it.
    """
    import polars as pl

    try:
        table = pl.read_parquet(data)
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
    """Read a table written from `scenario_table`.

    Raises
    ------
    StoreError
        Naming the file and what is wrong with it.
    """
    import polars as pl

    schema = {"scenario": pl.UInt32(), "side": pl.String(), **dict.fromkeys(PARAMETER_COLUMNS.values(), pl.Float64())}
    table = read_parquet(path, schema)
    columns = {name: table[column].to_numpy() for name, column in PARAMETER_COLUMNS.items()}
    try:
        return Scenarios.from_arrays(side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT), **columns)
    except LdcError as error:
        raise StoreError(f"{path}: broken: {error}") from None
