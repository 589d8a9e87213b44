"""Arrays that a report needs of drives beside the study's: driven once, and read where they follow from the same."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import StoreError
from ldctoolkit.version import versions

from .files import read_parquet, write_parquet

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
    made = {one: np.asarray(values, dtype=np.float64) for one, values in make().items()}
    table = [(digest, one, list(values.shape), values.ravel().tolist()) for one, values in made.items()]
    write_parquet(path, pl.DataFrame(table, schema=schema, orient="row"))
    return made
