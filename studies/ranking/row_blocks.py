"""Rows of large tables in blocks: what is worked out row by row needs no second table of the same size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray

T = TypeVar("T", bound=np.generic)

_BLOCK_ENTRIES = 250_000
"""Numbers in a block (2 MB)."""


def row_blocks(
    values: npt.NDArray[T], rows: IntArray | None = None, *, entries: int | None = None
) -> Iterator[tuple[slice, npt.NDArray[T]]]:
    """Some rows of a table, in blocks of about so many entries."""
    size = max(1, (entries or _BLOCK_ENTRIES) // max(1, values.shape[1]))
    count = values.shape[0] if rows is None else rows.size
    for first in range(0, count, size):
        places = slice(first, min(first + size, count))
        yield places, values[places] if rows is None else values[rows[places]]


def row_means(values: FloatArray, rows: IntArray | None = None) -> FloatArray:
    """Mean of every row, or of some, (d,): a sum that does not depend on the rows beside it."""
    result = np.empty(values.shape[0] if rows is None else rows.size)
    for places, block in row_blocks(values, rows):
        result[places] = np.ascontiguousarray(block).mean(axis=1)
    return result
