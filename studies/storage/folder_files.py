"""Files of a result folder: written whole or not at all, read with what is wrong named."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar, get_type_hints

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.checked_files import (
    check_parquet,
    json_text,
    parquet_bytes,
    parse_json,
    read_regular,
    without_checksum,
    write_whole,
)
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import LdcError, StoreError, first_line
from ldctoolkit.recordings.departures_table import read_signals, signals_path, signals_table
from ldctoolkit.scenarios import Drifts, Scenarios

if TYPE_CHECKING:
    import polars as pl


T = TypeVar("T")

SCENARIOS = "scenarios.parquet"

_DRIFT: Final = {"lateral_velocity": "drift_rate_m_s", "radius": "drift_radius_m", "distance": "drift_distance_m"}
"""Of paths that do not return: attribute -> column."""

_CLUSTER: Final = "cluster"  # trip or driver of a recorded departure


def output_folder(folder: Path) -> Path:
    """Make a folder, if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(folder, f"cannot be made: {error.strerror or error}") from None
    return folder


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all; what a path has that is no text is written as in messages."""
    write_whole(path, text.encode(errors="backslashreplace"), StoreError)


def write_json(path: Path, content: Mapping[str, Any], indent: int | None = 1) -> None:
    """Write a JSON file with its checksum, whole or not at all."""
    write_text(path, json_text(content, indent))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that `write_json` wrote; raises `StoreError`."""
    try:
        return without_checksum(parse_json(read_regular(path, StoreError)))
    except (ValueError, TypeError, AttributeError) as error:
        raise StoreError(path, f"broken: {error}") from None


_KINDS: Final[dict[Any, Callable[[Any], Any]]] = {
    kind: functools.partial(np.array, dtype=dtype)
    for kind, dtype in ((FloatArray, np.float64), (IntArray, np.int64), (BoolArray, np.bool_))
} | {float: float}


def write_fields(path: Path, value: Any) -> None:
    """Write the fields of a dataclass as JSON: arrays, numbers, texts, and tuples of these."""
    write_json(path, {name: _plain(field) for name, field in vars(value).items()}, indent=None)


def read_fields(path: Path, kind: type[T]) -> T | None:
    """What `write_fields` wrote; None if it is missing, damaged or of other fields: it is a cache."""
    try:
        kinds, content = get_type_hints(kind), read_json(path)
        return kind(**{name: _KINDS.get(kinds[name], _tuples)(value) for name, value in content.items()})
    except (StoreError, ValueError, TypeError, KeyError, AttributeError):
        return None


def _plain(field: Any) -> Any:
    """Nested lists of an array; NaN and infinity, which JSON lacks, as text."""
    if not isinstance(field, float | np.ndarray):
        return field
    plain = np.array(field, dtype=object)
    unknown = ~np.isfinite(field)
    plain[unknown] = np.asarray(field)[unknown].astype(str)
    return plain.tolist()


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def write_parquet(path: Path, table: pl.DataFrame) -> None:
    """Write a Parquet file with its checksum, whole or not at all."""
    write_whole(path, parquet_bytes(table), StoreError)


def read_bytes(path: Path) -> bytes:
    """The content of a regular file."""
    return read_regular(path, StoreError, None)


def read_parquet(
    path: Path, schema: dict[str, Any], *, finite: bool = True, optional: Sequence[dict[str, Any]] = ()
) -> pl.DataFrame:
    """Read a Parquet file that `write_parquet` wrote, and check it as `parse_parquet` does; it may have the columns of
    one of the optional sets.
    """
    data = read_bytes(path)
    try:
        check_parquet(data)
    except ValueError as error:
        raise StoreError(
            path, f"broken: {error}", hint="run the study into this folder again to write it anew"
        ) from None
    return parse_parquet(path, data, schema, finite=finite, optional=optional)


def parse_parquet(
    path: Path, data: bytes, schema: dict[str, Any], *, finite: bool = True, optional: Sequence[dict[str, Any]] = (),
    beside: str = "",
) -> pl.DataFrame:  # fmt: skip
    """A table from the bytes of a Parquet file, checked: columns, types, nothing missing, with `finite` all finite.

    It may have columns of numbers whose names begin with `beside`.
    """
    import polars as pl

    try:
        table = pl.read_parquet(data)
    except pl.exceptions.PolarsError as error:
        raise StoreError(path, f"broken: {first_line(error)}") from None
    free = {name for name, kind in table.schema.items() if beside and name.startswith(beside) and kind == pl.Float64()}
    there = {name: kind for name, kind in table.schema.items() if name not in free}
    if there not in (schema, *(schema | columns for columns in optional)):
        raise StoreError(
            path, f"broken: its columns are {', '.join(table.columns)}", hint=f"needed: {', '.join(schema)}"
        )
    for column in table.iter_columns():
        if column.null_count() or (finite and column.dtype.is_float() and not column.is_finite().all()):
            raise StoreError(path, f"broken: column {column.name} holds a value that is missing or not finite")
    return table


def scenario_table(scenarios: Scenarios) -> pl.DataFrame:
    """Scenarios as a table: number, side, eight parameters with their units in the names, and drifts."""
    import polars as pl

    drift, cluster = scenarios.drift, scenarios.cluster
    return pl.DataFrame(
        {
            "scenario": scenarios.index.astype(np.uint32),
            "side": np.where(scenarios.side == LEFT, "left", "right").tolist(),
            **{column: getattr(scenarios, name) for name, column in PARAMETER_COLUMNS.items()},
            **({column: getattr(drift, name) for name, column in _DRIFT.items()} if drift is not None else {}),
            **({} if cluster is None else {_CLUSTER: cluster.astype(np.int32)}),
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
    table = read_parquet(path, schema, optional=(dict.fromkeys(_DRIFT.values(), pl.Float64()), {_CLUSTER: pl.Int32()}))
    columns = {name: table[column].to_numpy() for name, column in PARAMETER_COLUMNS.items()}
    try:
        scenarios = Scenarios.drawn(side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT), **columns)
        scenarios = dataclasses.replace(scenarios, index=table["scenario"].to_numpy().astype(np.int64))
        if "drift_radius_m" in table.columns:
            drift = Drifts(**{name: table[column].to_numpy() for name, column in _DRIFT.items()})
            scenarios = dataclasses.replace(scenarios, drift=drift)
        if _CLUSTER in table.columns:
            scenarios = dataclasses.replace(scenarios, cluster=table[_CLUSTER].to_numpy().astype(np.int64))
        if signals_path(path).exists():
            scenarios = dataclasses.replace(
                scenarios, signals=read_signals(signals_path(path), scenarios.T, checksum=True)
            )
    except LdcError as error:
        raise StoreError(path, f"broken: {error}") from None
    return scenarios
