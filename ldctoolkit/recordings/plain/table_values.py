"""Values of recording tables in their final types, the faulty ones named. Imports polars, so it is imported late."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
import polars as pl

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.missing_words import MISSING

NUMBERS: Final = ("t", "lane_offset", "lane_width", "speed", "curvature", "yaw_rate")

ROW: Final = "(row)"
"""Column that carries each sample's place in its file: the line of a CSV file, the row of a Parquet file."""

FAULT: Final = "(fault)"
"""Column that is true for a sample that is at fault, or next to a line that could not be used; only where faults are
collected instead of raised."""

Faults = list[RecordingError]

_VALID: Final = {"1": True, "1.0": True, "true": True, "0": False, "0.0": False, "false": False}
_SIGNAL: Final = {"1": 1, "1.0": 1, "+1": 1, "left": 1, "-1": -1, "-1.0": -1, "right": -1}
_SIGNAL_OFF: Final = ("0", "0.0", "-0.0", "none", "off", "null", "nan", "")


def typed(path: Path, frame: pl.DataFrame, word: str, faults: Faults | None = None) -> pl.DataFrame:
    """Columns in their final types; the first value that does not fit is named, and raised unless faults are wanted."""
    marked = np.zeros(frame.height, dtype=bool)

    def refuse(name: str, bad: pl.Series, allowed: str) -> None:
        if bad.any():
            i = bad.arg_max() or 0
            more = f" ({bad.sum()} {word}s in all)" if (bad.sum() or 0) > 1 else ""
            value = frame[name][i]
            fault = RecordingError(
                f"{path.name}, {word} {frame[ROW][i]}: column '{name}' holds {value!r}; allowed: {allowed}{more}"
            )
            if faults is None:
                raise fault
            faults.append(fault)
            marked[:] |= bad.fill_null(False).to_numpy()

    columns: list[pl.Series] = [frame[ROW]]
    for name in frame.columns:
        values = frame[name]
        if name in (ROW, FAULT):
            continue
        if name in NUMBERS:
            if values.dtype == pl.String:
                words = values.str.strip_chars()
                values = words.cast(pl.Float64, strict=False)
                refuse(name, values.is_null() & ~words.str.to_lowercase().is_in(MISSING).fill_null(True), "numbers")
            elif not values.dtype.is_numeric() and values.dtype != pl.Null:
                raise RecordingError(f"{path.name}: column '{name}' is of type {values.dtype}; allowed: numbers")
            columns.append(values.cast(pl.Float64).fill_null(float("nan")).alias(name))
            continue
        if values.dtype.is_nested() or values.dtype == pl.Binary:
            raise RecordingError(f"{path.name}: column '{name}' is of type {values.dtype}; allowed: text or numbers")
        words = values.cast(pl.String).str.strip_chars()
        lower = words.str.to_lowercase()
        if name == "recording":
            refuse(name, words.is_null() | (words == ""), "an identifier of the recording")
            columns.append(words)
        elif name == "lane":
            # "3" and "3.0" are one lane whatever the rest of the column holds
            label = words.str.replace(r"^(-?\d+)\.0+$", "$1")
            columns.append(pl.select(pl.when(~lower.is_in(MISSING)).then(label)).to_series().alias(name))
        elif name == "valid":
            known = lower.replace_strict(_VALID, default=None, return_dtype=pl.Boolean)
            refuse(name, known.is_null() & ~lower.is_in(MISSING).fill_null(True), "0, 1, false, true")
            columns.append(known.fill_null(False))
        else:
            known = lower.replace_strict(_SIGNAL, default=None, return_dtype=pl.Int64)
            off = lower.is_in(_SIGNAL_OFF).fill_null(True)
            refuse(name, known.is_null() & ~off, "left, right, none, or 1 (left), -1 (right), 0 (none)")
            columns.append(known.fill_null(0).alias(name))
    if faults is not None:
        columns.append(pl.Series(FAULT, marked | frame[FAULT].to_numpy()))
    return pl.DataFrame(columns)
