"""Files of a study: written whole or not at all; scenarios as a table."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit import LdcError, Scenarios
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT
from ldctoolkit.errors import StoreError

if TYPE_CHECKING:
    import polars as pl

SCENARIO_COLUMNS: Final = dict(
    zip(
        PARAMETER_NAMES,
        ("T_s", "d_y_m", "sigma_y_m", "v_mean_m_s", "a_mean_m_s2", "sigma_v_m_s", "c_0_1_m", "dc_1_m"),
        strict=True,
    )
)
"""Parameter -> column of a scenario table, named as in a departures table."""


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[IO[bytes]]:
    """A binary stream that becomes the file `path` when the block ends well, and leaves no trace when it does not.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            yield stream
        part.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    with whole_file(path) as stream:
        stream.write(text.encode())


def write_parquet(path: Path, table: pl.DataFrame) -> None:
    """Write a Parquet file, whole or not at all."""
    with whole_file(path) as stream:
        table.write_parquet(stream)


def read_parquet(path: Path, schema: dict[str, Any]) -> pl.DataFrame:
    """Read a Parquet file and check its columns, types and that nothing is missing or not finite.

    Raises
    ------
    StoreError
        Naming the file and what is wrong with it.
    """
    import polars as pl

    try:
        content = path.read_bytes()
        table = pl.read_parquet(content)
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from None
    except pl.exceptions.PolarsError as error:
        raise StoreError(f"{path}: broken: {str(error).splitlines()[0]}") from None
    if dict(table.schema) != schema:
        raise StoreError(f"{path}: broken: its columns are {', '.join(table.columns)}; needed: {', '.join(schema)}")
    for column in table.iter_columns():
        if column.null_count() or (column.dtype.is_float() and not column.is_finite().all()):
            raise StoreError(f"{path}: broken: column {column.name} holds a value that is missing or not finite")
    return table


def scenario_table(scenarios: Scenarios) -> pl.DataFrame:
    """Scenarios as a table: index, side, eight parameters with their units in the names."""
    import polars as pl

    return pl.DataFrame(
        {
            "scenario": np.arange(len(scenarios), dtype=np.uint32),
            "side": np.where(scenarios.side == LEFT, "left", "right").tolist(),
            **{column: getattr(scenarios, name) for name, column in SCENARIO_COLUMNS.items()},
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

    schema = {"scenario": pl.UInt32(), "side": pl.String(), **dict.fromkeys(SCENARIO_COLUMNS.values(), pl.Float64())}
    table = read_parquet(path, schema)
    columns = {name: table[column].to_numpy() for name, column in SCENARIO_COLUMNS.items()}
    try:
        return Scenarios.from_arrays(side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT), **columns)
    except LdcError as error:
        raise StoreError(f"{path}: broken: {error}") from None
