"""Numbers that are driven beside a study's runs: measures of designs, and arrays of a report."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import StoreError
from ldctoolkit.version import versions

from ..design import Design
from .files import read_parquet, write_parquet

MEASURES: Final = "measures.parquet"
"""File with a row for each measure and design."""


def _schema() -> dict[str, Any]:
    import polars as pl

    return {"measure": pl.String(), "design": pl.String(), "value": pl.Float64()}


@dataclasses.dataclass
class MeasureTable:
    """Measures of designs, in memory and, where there is a folder, in its file."""

    folder: Path | None = None
    # Name of a measure -> identifier of a design -> value; NaN where the design has none
    values: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)

    @classmethod
    def read(cls, folder: Path) -> Self:
        """The measures of a folder; none where the file is missing."""
        table = cls(folder)
        if (folder / MEASURES).exists():
            for name, design, value in read_parquet(folder / MEASURES, _schema(), finite=False).iter_rows():
                table.values.setdefault(name, {})[design] = value
        return table

    def add(self, measures: Mapping[str, FloatArray], designs: Sequence[Design]) -> None:
        """Take in measures (d,) of d designs, and write the file anew, sorted by measure and design."""
        import polars as pl

        for name, column in measures.items():
            self.values.setdefault(name, {}).update(
                (design.id, x) for design, x in zip(designs, column.tolist(), strict=True)
            )
        if self.folder is not None:
            rows = [(name, *item) for name, values in sorted(self.values.items()) for item in sorted(values.items())]
            write_parquet(self.folder / MEASURES, pl.DataFrame(rows, schema=_schema(), orient="row"))

    def without(self, name: str, designs: Sequence[Design]) -> list[Design]:
        """The designs for which a measure is missing."""
        measured = self.values.get(name, {})
        return [design for design in designs if design.id not in measured]

    def of(self, designs: Sequence[Design]) -> dict[str, FloatArray]:
        """Every measure that all d designs have, (d,)."""
        return {
            name: np.array([values[design.id] for design in designs])
            for name, values in self.values.items()
            if not self.without(name, designs)
        }


Arrays = Mapping[str, npt.NDArray[Any]]


def remembered(folder: Path | None, name: str, key: object, make: Callable[[], Arrays]) -> Arrays:
    """Numbers that follow from a key in plain JSON types: those of ``DIR/NAME.parquet``, else made and stored there.

    Without a folder they are made. A file that cannot be read, or is of another key, is replaced. All are floats.
    """
    if folder is None:
        return make()
    import polars as pl

    text = json.dumps([list(versions()), key], sort_keys=True, separators=(",", ":"))
    digest, path = hashlib.sha256(text.encode()).hexdigest()[:16], folder / f"{name}.parquet"
    numbers = {"shape": pl.List(pl.Int64()), "values": pl.List(pl.Float64())}
    schema: dict[str, Any] = {"key": pl.String(), "name": pl.String(), **numbers}
    try:
        rows = read_parquet(path, schema, finite=False).rows() if path.exists() else []
        if rows and all(row[0] == digest for row in rows):
            return {row[1]: np.array(row[3], dtype=np.float64).reshape(row[2]) for row in rows}
    except (StoreError, ValueError):
        pass  # it only saves time
    arrays = {title: np.asarray(values, dtype=np.float64) for title, values in make().items()}
    table = [(digest, title, list(values.shape), values.ravel().tolist()) for title, values in arrays.items()]
    write_parquet(path, pl.DataFrame(table, schema=schema, orient="row"))
    return arrays
