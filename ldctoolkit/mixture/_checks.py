"""Checks of data and settings; every message names the column, the row and what is allowed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError

RandomState = int | np.random.Generator | None
FloatArray = npt.NDArray[np.float64]

LARGEST: Final = 1e100
"""Squares and their sums must not overflow; nor may the squares of spreads below its inverse vanish."""


def column_name(j: int, names: Sequence[str] | None) -> str:
    """The column's name, or its number."""
    return f"column {j}" if names is None else f"column {names[j]!r}"


def check_matrix(X: npt.ArrayLike, dimension: int | None, names: Sequence[str] | None) -> FloatArray:
    """A finite float matrix (n, d)."""
    try:
        x = np.asarray(X, dtype=float)
    except (TypeError, ValueError):
        raise InputError("X: not a table of numbers; allowed: an array of shape (n, d)") from None
    if x.ndim != 2:
        raise InputError(f"X: shape {x.shape}; allowed: (n, d), one row an event")
    if dimension is not None and x.shape[1] != dimension:
        raise InputError(f"X: {x.shape[1]} columns; allowed: {dimension}, as many as there are bounds")
    refuse(~np.isfinite(x), x, "finite numbers", names)
    refuse(np.abs(x) > LARGEST, x, f"at most {LARGEST:g} in size", names)
    return x


def refuse(bad: npt.NDArray[np.bool_], x: FloatArray, allowed: str, names: Sequence[str] | None) -> None:
    """Raise for the first column with a bad entry."""
    if not bad.any():
        return
    j = int(np.argmax(bad.any(axis=0)))
    row = int(np.argmax(bad[:, j]))
    count = int(bad[:, j].sum())
    others = [column_name(int(k), names) for k in np.flatnonzero(bad.any(axis=0)) if k != j]
    also = f"; also in {', '.join(others)}" if others else ""
    raise InputError(
        f"X: {column_name(j, names)}, row {row}: {float(x[row, j])!r}; allowed: {allowed} "
        f"({count} of {x.shape[0]} rows{also})"
    )


def check_inside(x: FloatArray, lower: FloatArray, upper: FloatArray, names: Sequence[str] | None) -> None:
    """Refuse data on or outside a bound."""
    for j in range(x.shape[1]):
        bad = np.zeros(x.shape, dtype=bool)
        bad[:, j] = ~((x[:, j] > lower[j]) & (x[:, j] < upper[j]))
        refuse(bad, x, f"strictly between the bounds {lower[j]:g} and {upper[j]:g}", names)


def check_constant(x: FloatArray, names: Sequence[str] | None) -> None:
    """Refuse a column without spread: its density would be infinite."""
    spread = np.ptp(x, axis=0)
    size = np.max(np.abs(x), axis=0)
    flat = ~(spread > 1e-12 * size)
    if flat.any():
        j = int(np.argmax(flat))
        raise InputError(
            f"X: {column_name(j, names)} is constant ({float(x[0, j])!r} in all {x.shape[0]} rows); "
            "leave it out of the fit"
        )
    tiny = spread < 1.0 / LARGEST
    if tiny.any():
        j = int(np.argmax(tiny))
        raise InputError(f"X: {column_name(j, names)} spreads over {spread[j]:g}; allowed: {1.0 / LARGEST:g} or more")


def check_bound_array(value: npt.ArrayLike | None, name: str, fill: float, dimension: int) -> FloatArray:
    """Bounds as (d,) floats; a scalar is repeated, None is open."""
    try:
        out = np.asarray(fill if value is None else value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: {value!r}; allowed: a number or {dimension} numbers, inf included") from None
    if out.ndim == 0:
        out = np.full(dimension, float(out))
    if out.shape != (dimension,):
        raise InputError(f"{name}: shape {out.shape}; allowed: a number or ({dimension},), one per column")
    return out


def check_number(name: str, value: object, low: float, *, integer: bool = False, above: bool = False) -> None:
    """A number of at least `low` (more than it with `above`)."""
    kinds = (int, np.integer) if integer else (int, float, np.integer, np.floating)
    good = isinstance(value, kinds) and not isinstance(value, bool)
    if good:
        number = float(value)  # type: ignore[arg-type]
        good = np.isfinite(number) and (number > low if above else number >= low)
    if not good:
        kind = "an integer" if integer else "a number"
        raise InputError(f"{name}: {value!r}; allowed: {kind} {'>' if above else '>='} {low:g}")


def seed_of(random_state: RandomState) -> int:
    """An integer seed; None gives a fresh one, a Generator is advanced once."""
    if random_state is None:
        return int(np.random.SeedSequence().generate_state(1, np.uint64)[0])
    if isinstance(random_state, np.random.Generator):
        return int(random_state.integers(2**63))
    check_number("random_state", random_state, 0, integer=True)
    return int(random_state)
