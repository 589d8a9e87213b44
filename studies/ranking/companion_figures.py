"""One figure a design from the companions of its runs, a few companions and a block of designs at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, metrics
from studies.design import Design
from studies.ranking.masked import masked_max, masked_mean, masked_quantile
from studies.results import CaseResults, status_among
from studies.storage.stored_columns import StoredColumn

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Figures = dict[str, FloatArray]

_BLOCK_ENTRIES: Final = 500_000
"""Runs that are looked at at once (4 MB for each companion); no figure depends on it."""

_STORED_ENTRIES: Final = 50_000_000
"""Numbers that are read from a study's folder at once (400 MB): all at once where possible, as every file holds many
designs and no design has a file of its own."""

_MOST_THREADS: Final = 4


def companion_figures(case: CaseResults, designs: Sequence[Design], d_y: FloatArray, *, D_y: float) -> Figures:
    """What `studies.ranking.release.ReleaseFigures` tells of each design, and the share that gets deep.

    Parameters
    ----------
    case : CaseResults
        Scenarios that can be driven only.
    designs : sequence of Design
        In the order of `case`.
    d_y : (n,) [m]
        Depth of the departures without control.
    D_y : float [m]
        Depth from which on a departure is deep, and below which it needs no intervention.

    Returns
    -------
    dict of str to (d,)
        The fields of `ReleaseFigures`, and ``deeper``.
    """
    acted = ~status_among(case.status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
    acted[[design.is_baseline for design in designs]] = False

    def depth(_: BoolArray, deepest: FloatArray) -> Figures:
        return _depth(deepest) | {"deeper": (deepest > D_y).mean(axis=1)}

    def overshoot(acted: BoolArray, values: FloatArray) -> Figures:
        return _overshoot(acted, values) | {"needless": np.asarray(metrics.needless_share(acted, d_y, D_y))}

    blocks = _Blocks(case, acted)
    # few companions at once: all of them together would be the largest thing in memory by far
    return {
        "law_time": 1e6 * case.law_time,
        **blocks.figures(depth, "deepest"),
        **blocks.figures(_distance, "dtle"),
        **blocks.figures(overshoot, "overshoot"),
        **blocks.figures(_way_back, "t_back"),
        **blocks.figures(_motion, "a_y_peak", "jerk_peak"),
        **blocks.figures(lambda acted, values: {"delta_peak_max": masked_max(values, acted)}, "delta_peak"),
        **blocks.figures(lambda acted, values: {"delta_rate_peak_max": masked_max(values, acted)}, "delta_rate_peak"),
        **blocks.figures(lambda acted, values: {"effort_mean": masked_mean(values, acted)}, "effort"),
        **blocks.figures(lambda acted, values: {"travel_mean": masked_mean(values, acted)}, "travel"),
    }


class _Blocks:
    """Figures of companions that are in memory, or read when they are needed, by blocks of designs in threads.

    Parameters
    ----------
    case : CaseResults
    acted : (d, n) bool
        Where each design took over.
    """

    def __init__(self, case: CaseResults, acted: BoolArray) -> None:
        self._case, self._acted = case, acted
        self._size = max(1, _BLOCK_ENTRIES // acted.shape[1])
        stored = not isinstance(case.companions.deepest, np.ndarray)
        self._room = np.empty(max(min(_STORED_ENTRIES, acted.size), 2 * acted.shape[1]) if stored else 0)

    def figures(self, function: Callable[..., Figures], *names: str) -> Figures:
        """Figures of some companions: `function` takes what a block of designs did, and each companion of it."""
        columns: list[Any] = [getattr(self._case.companions, name) for name in names]
        d, n = self._acted.shape
        at_once = max(1, self._room.size // (len(names) * n)) if self._room.size else d
        found: list[Figures] = []
        for first in range(0, d, at_once):
            rows = slice(first, min(first + at_once, d))
            rooms = np.array_split(self._room, len(columns))
            values = [_values(column, rows, room) for column, room in zip(columns, rooms, strict=True)]
            found += self._of_blocks(function, rows, values)
        return {name: np.concatenate([some[name] for some in found]) for name in found[0]}

    def _of_blocks(self, function: Callable[..., Figures], rows: slice, values: Sequence[FloatArray]) -> list[Figures]:
        def one(start: int) -> Figures:
            block = slice(start, min(start + self._size, rows.stop - rows.start))
            acted = self._acted[rows][block]
            # one row after the other in memory: the sum of a row depends on it in the last bit
            return function(acted, *(np.ascontiguousarray(column[block], dtype=np.float64) for column in values))

        starts = range(0, rows.stop - rows.start, self._size)
        with ThreadPoolExecutor(max(1, min(_MOST_THREADS, os.cpu_count() or 1, len(starts)))) as pool:
            return list(pool.map(one, starts))


def _values(column: FloatArray | StoredColumn, rows: slice, room: FloatArray) -> FloatArray:
    return column[rows] if isinstance(column, np.ndarray) else column.read(rows, room)


def _depth(deepest: FloatArray) -> Figures:
    return {"deepest_mean": deepest.mean(axis=1), "deepest_p95": np.quantile(deepest, 0.95, axis=1)}


def _distance(_: BoolArray, dtle: FloatArray) -> Figures:
    return {
        "dtle_mean": dtle.mean(axis=1),
        "dtle_p5": np.quantile(dtle, 0.05, axis=1),
        "dtle_min": dtle.min(axis=1),
        "within_dtle": np.asarray(metrics.share_within_dtle(dtle)),
    }


def _overshoot(acted: BoolArray, overshoot: FloatArray) -> Figures:
    return {
        "overshoot_share": np.asarray(metrics.overshoot_share(overshoot, acted)),
        "overshoot_max": masked_max(overshoot, acted),
    }


def _way_back(acted: BoolArray, t_back: FloatArray) -> Figures:
    return {
        "back_inside": np.asarray(metrics.back_inside_share(t_back, acted)),
        "t_back_median": masked_quantile(t_back, acted, 0.5),
    }


def _motion(acted: BoolArray, a_y_peak: FloatArray, jerk_peak: FloatArray) -> Figures:
    return {
        "a_y_peak_mean": masked_mean(a_y_peak, acted),
        "a_y_peak_p95": masked_quantile(a_y_peak, acted, 0.95),
        "a_y_peak_max": masked_max(a_y_peak, acted),
        "jerk_peak_mean": masked_mean(jerk_peak, acted),
        "jerk_peak_p95": masked_quantile(jerk_peak, acted, 0.95),
        "jerk_peak_max": masked_max(jerk_peak, acted),
        "comfortable": np.asarray(metrics.comfortable_share(a_y_peak, jerk_peak, acted)),
    }
