"""``measures.parquet``: numbers of designs beside those of their runs, one row a measure and design."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from ldctoolkit.arrays import FloatArray

from ..design import Design
from .files import read_parquet, write_parquet

MEASURES: Final = "measures.parquet"


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
        """Those of some designs that a measure is not there of."""
        known = self.values.get(name, {})
        return [design for design in designs if design.id not in known]

    def of(self, designs: Sequence[Design]) -> dict[str, FloatArray]:
        """Every measure that all of some designs have, (d,)."""
        return {
            name: np.array([values[design.id] for design in designs])
            for name, values in self.values.items()
            if not self.without(name, designs)
        }
