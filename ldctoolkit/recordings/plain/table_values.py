"""Values of recording tables in their final types, the faulty ones named. Imports polars, so it is imported late."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
import polars as pl

from ldctoolkit.recordings.plain.table_fault import TableFault
from ldctoolkit.recordings.table import MISSING

NUMBERS: Final = ("t", "lane_offset", "lane_width", "speed", "curvature", "yaw_rate")

ROW: Final = "(row)"
"""Column that carries each sample's place in its file: the line of a CSV file, the row of a Parquet file."""

FAULT: Final = "(fault)"
"""Column that is true for a sample that is at fault, or next to a line that could not be used."""

_VALID: Final = {"1": True, "1.0": True, "true": True, "0": False, "0.0": False, "false": False}
_SIGNAL: Final = {"1": 1, "1.0": 1, "+1": 1, "left": 1, "-1": -1, "-1.0": -1, "right": -1}
_SIGNAL_OFF: Final = ("0", "0.0", "-0.0", "none", "off", "null", "nan", "")


def typed(frame: pl.DataFrame, word: str, faults: list[TableFault]) -> pl.DataFrame:
    """Columns in their final types; the first value of a column that does not fit is a fault, all of them are marked.

    Parameters
    ----------
    frame : polars.DataFrame
        Known columns and `ROW`, perhaps `FAULT`.
    word : str
        What a place in the file is called: "line" or "row".
    faults : list of TableFault
        Faults are added.
    """
    marked = frame[FAULT].to_numpy() if FAULT in frame.columns else np.zeros(frame.height, dtype=bool)

    def refuse(name: str, bad: pl.Series, allowed: str) -> None:
        nonlocal marked
        if bad.any():
            i = bad.arg_max() or 0
            more = f" ({bad.sum()} {word}s in all)" if (bad.sum() or 0) > 1 else ""
            what = f"column '{name}' holds {frame[name][i]!r}; allowed: {allowed}{more}"
            faults.append(TableFault(f"{word} {frame[ROW][i]}", what))
            marked = marked | bad.fill_null(False).to_numpy()

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
                raise TableFault("", f"column '{name}' is of type {values.dtype}; allowed: numbers")
            columns.append(values.cast(pl.Float64).fill_null(float("nan")).alias(name))
            continue
        if values.dtype.is_nested() or values.dtype in (pl.Binary, pl.Duration):
            raise TableFault("", f"column '{name}' is of type {values.dtype}; allowed: text or numbers")
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
    return pl.DataFrame([*columns, pl.Series(FAULT, marked)])


def columns_of(frame: pl.DataFrame) -> dict[str, Any]:
    """The columns of a frame as those of a `Recording`, by name; None for one that it lacks."""

    def numbers(name: str) -> npt.NDArray[np.float64] | None:
        return frame[name].to_numpy() if name in frame.columns else None

    valid = frame["valid"].to_numpy() if "valid" in frame.columns else np.ones(frame.height, dtype=bool)
    lane = None
    if "lane" in frame.columns:
        valid = valid & frame["lane"].is_not_null().to_numpy()
        lane = frame["lane"].rank("dense").fill_null(0).to_numpy().astype(np.int64)
    signal = frame["turn_signal"].to_numpy() if "turn_signal" in frame.columns else None
    return {name: numbers(name) for name in NUMBERS} | {"valid": valid, "lane": lane, "turn_signal": signal}
