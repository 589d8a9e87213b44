"""What a release asks of a design beside its mean S: aggregates and shares of the metrics of its scenarios.

They are taken from a few metrics of the scenarios and a block of designs at a time: all of them together would be the
largest thing in memory by far.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus
from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.metrics import METRICS, RELEASE_METRICS, SCENARIO_METRICS, Interventions, Metric
from studies.design import Design
from studies.results import CaseResults, status_among
from studies.storage.stored_columns import StoredColumn

_FEW = 8
"""Places up to which what stands there is found without a full sort."""


def masked_mean(values: FloatArray, among: BoolArray) -> FloatArray:
    """Mean of what is marked in each row."""
    count = among.sum(axis=1)
    total = np.where(among, values, 0.0).sum(axis=1)
    result: FloatArray = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    return result


def masked_max(values: FloatArray, among: BoolArray) -> FloatArray:
    """Largest of what is marked in each row; parameters and result as `masked_mean`."""
    largest = np.where(among, values, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(among.any(axis=1), largest, np.nan)


def masked_quantile(values: FloatArray, among: BoolArray, share: float) -> FloatArray:
    """Quantile of what is marked in each row, linear between neighbours; parameters and result as `masked_mean`.
    Infinite values are allowed: between a finite and an infinite neighbour it is infinite.
    """
    count = among.sum(axis=1)
    ordered = np.where(among, values, np.inf)
    place = share * np.maximum(count - 1, 0)
    low = np.floor(place).astype(np.int64)
    high = np.minimum(low + 1, np.maximum(count - 1, 0))
    wanted = np.unique([low, high])
    if 0 < wanted.size <= _FEW:
        ordered.partition(wanted, axis=1)  # three times faster than all of them in order
    else:
        ordered.sort(axis=1)
    rows = np.arange(len(count))
    below, above, part = ordered[rows, low], ordered[rows, high], place - low
    with np.errstate(invalid="ignore"):  # inf - inf: the branch is not taken
        between = below + (above - below) * part
    result = np.where((part == 0) | (below == above), below, between)
    # NaN is sorted behind the infinities that stand for what is not marked
    return np.where((count > 0) & ~np.isnan(ordered).any(axis=1), result, np.nan)


Values = dict[str, FloatArray]

_BLOCK_ENTRIES: Final = 500_000
"""Runs that are looked at at once (4 MB for each metric); no number depends on it."""

_STORED_ENTRIES: Final = 50_000_000
"""Numbers that are read from a study's folder at once (400 MB): all at once where possible, as every file holds many
designs and no design has a file of its own."""

_MOST_THREADS: Final = 4


@dataclasses.dataclass(frozen=True)
class ReleaseFigures:
    """Metrics of d designs, arrays of d, one attribute for each of `ldctoolkit.metrics.RELEASE_METRICS`.

    What is taken over interventions is NaN where a design never intervened.
    """

    __annotations__ = dict.fromkeys(RELEASE_METRICS, "FloatArray")

    if TYPE_CHECKING:

        def __init__(self, **values: FloatArray) -> None: ...

        def __getattr__(self, name: str) -> FloatArray: ...

    def take(self, order: Sequence[int] | npt.NDArray[np.int64]) -> ReleaseFigures:
        """The same for some of the designs, in the order given."""
        return ReleaseFigures(**{name: getattr(self, name)[order] for name in RELEASE_METRICS})


def release_metrics(case: CaseResults, designs: Sequence[Design], d_y: FloatArray, *, D_y: float) -> Values:
    """Every metric of a design that is taken from metrics of its scenarios."""
    acted = ~status_among(case.status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
    acted[[design.is_baseline for design in designs]] = False
    blocks = _Blocks(case, acted)

    def of(group: Sequence[Metric], names: Sequence[str]) -> Callable[..., Values]:
        def values(acted: BoolArray, *columns: FloatArray) -> Values:
            by, there = Interventions(acted, d_y, D_y), dict(zip(names, columns, strict=True))
            return {one.name: _taken(one, by, *(there[name] for name in one.of)) for one in group}

        return values

    found: Values = {}
    for group in _groups():
        names = tuple(dict.fromkeys(name for one in group for name in one.of))
        found |= blocks.values(of(group, names), *names)
    return found


def _groups() -> list[list[Metric]]:
    """Metrics that are taken from the same metrics of the scenarios stand together: each of these is read once."""
    groups: list[list[Metric]] = []
    for one in METRICS.values():
        if one.aggregate or one.share is not None:
            joined = [group for group in groups if any(set(one.of) & set(other.of) for other in group)]
            groups = [group for group in groups if group not in joined]
            groups.append([*(other for group in joined for other in group), one])
    return groups


def _taken(one: Metric, by: Interventions, *values: FloatArray) -> FloatArray:
    """A metric of some designs, over all departures or the interventions."""
    if one.share is not None:
        return np.asarray(one.share(by, *values))
    (only,) = values
    of_all = SCENARIO_METRICS[one.of[0]].over == "all"
    if one.aggregate == "mean":
        return np.asarray(only.mean(axis=1)) if of_all else masked_mean(only, by.acted)
    if one.aggregate == "max":
        return np.asarray(only.max(axis=1)) if of_all else masked_max(only, by.acted)
    if one.aggregate == "min":
        return np.asarray(only.min(axis=1)) if of_all else -masked_max(-only, by.acted)
    share = 0.5 if one.aggregate == "median" else float(one.aggregate[1:]) / 100.0
    return np.asarray(np.quantile(only, share, axis=1)) if of_all else masked_quantile(only, by.acted, share)


class _Blocks:
    """Metrics of scenarios that are in memory, or read when they are needed, by blocks of designs in threads."""

    def __init__(self, case: CaseResults, acted: BoolArray) -> None:
        self._case, self._acted = case, acted
        self._size = max(1, _BLOCK_ENTRIES // acted.shape[1])
        stored = not isinstance(case.companions.deepest, np.ndarray)
        self._room = np.empty(max(min(_STORED_ENTRIES, acted.size), 2 * acted.shape[1]) if stored else 0)

    def values(self, function: Callable[..., Values], *names: str) -> Values:
        """Metrics of designs: `function` takes where a block of designs took over, and each metric of the scenarios."""
        columns: list[Any] = [getattr(self._case.companions, name) for name in names]
        (d, n), count = self._acted.shape, max(1, len(names))
        at_once = max(1, self._room.size // (count * n)) if self._room.size else d
        found: list[Values] = []
        for first in range(0, d, at_once):
            rows = slice(first, min(first + at_once, d))
            rooms = np.array_split(self._room, count)
            values = [_values(column, rows, room) for column, room in zip(columns, rooms, strict=False)]
            found += self._of_blocks(function, rows, values)
        return {name: np.concatenate([some[name] for some in found]) for name in found[0]}

    def _of_blocks(self, function: Callable[..., Values], rows: slice, values: Sequence[FloatArray]) -> list[Values]:
        def one(start: int) -> Values:
            block = slice(start, min(start + self._size, rows.stop - rows.start))
            acted = self._acted[rows][block]
            # one row after the other in memory: the sum of a row depends on it in the last bit
            return function(acted, *(np.ascontiguousarray(column[block], dtype=np.float64) for column in values))

        starts = range(0, rows.stop - rows.start, self._size)
        with ThreadPoolExecutor(max(1, min(_MOST_THREADS, os.cpu_count() or 1, len(starts)))) as pool:
            return list(pool.map(one, starts))


def _values(column: FloatArray | StoredColumn, rows: slice, room: FloatArray) -> FloatArray:
    return column[rows] if isinstance(column, np.ndarray) else column.read(rows, room)
