"""``designs.parquet``: what each identifier in the results stands for."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ldctoolkit.errors import StoreError
from studies.design import Design
from studies.storage.files import read_parquet, write_parquet

DESIGNS = "designs.parquet"


def _schema() -> dict[str, Any]:
    import polars as pl

    return {
        "design": pl.String(),
        "law": pl.String(),
        "y_s_m": pl.Float64(),
        "gains": pl.String(),
        "label": pl.String(),
    }


def write_designs(folder: Path, designs: Sequence[Design]) -> None:
    """Write or replace the table: identifier, law, y_s, all gains as JSON, and a label for people."""
    import polars as pl

    rows = [(d.id, d.law, d.y_s, json.dumps(dict(d.gains)), d.label) for d in designs]
    write_parquet(folder / DESIGNS, pl.DataFrame(rows, schema=_schema(), orient="row"))


def read_designs(path: Path) -> tuple[Design, ...]:
    """The designs of a table, in its order.

    Raises
    ------
    StoreError
        If the file is missing or broken.
    """
    table = read_parquet(path, _schema())
    try:
        designs = tuple(
            Design(law, y_s, tuple(json.loads(gains).items())) for _, law, y_s, gains, _ in table.iter_rows()
        )
        wrong = [d.id for d, told in zip(designs, table["design"], strict=True) if d.id != told]
    except (ValueError, AttributeError) as error:
        raise StoreError(f"{path}: broken: {error}") from None
    if wrong:
        raise StoreError(f"{path}: broken: design {wrong[0]} is not what its row says")
    return designs
