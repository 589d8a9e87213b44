"""Departures of several tables as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ldctoolkit.departure_columns import joined_columns
from ldctoolkit.departures import PARAMETER_NAMES, Departures


def no_departures() -> Departures:
    """A table without rows."""
    numbers: dict[str, Any] = dict.fromkeys((*PARAMETER_NAMES, "start_time"), np.empty(0))
    return Departures(
        side=np.empty(0, dtype=np.int64),
        recording=np.empty(0, dtype=np.str_),
        samples=np.empty(0, dtype=np.int64),
        **numbers,
    )


def joined_departures(parts: Sequence[Departures]) -> Departures:
    """Departures one after the other; an extra column that a part lacks is empty there.

    Examples
    --------
    >>> joined_departures([no_departures(), no_departures()]).n
    0
    """
    if not parts:
        return no_departures()
    names = [field.name for field in dataclasses.fields(Departures) if field.name != "extra"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Departures(**columns, extra=joined_columns([(part.extra, part.n) for part in parts]))
