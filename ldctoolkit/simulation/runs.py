"""From what the compiled loops leave behind to a `Run`; the rows whose paths are kept; the threads of a loop."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import EventStatus
from ldctoolkit.errors import InputError, plain
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from ldctoolkit.mixture.events import usable_cores
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.outcome import Run, Trajectories
from ldctoolkit.simulation.takeover import Takeover

Chosen = bool | npt.ArrayLike

SCENARIOS_A_TASK = 1024
"""Scenarios that a thread takes at a time."""


def chosen_rows(trajectories: Chosen, n: int) -> IntArray | None:
    """Row numbers of the scenarios whose paths are kept; None for no paths at all."""
    if isinstance(trajectories, bool | np.bool_):
        return np.arange(n) if trajectories else None
    rows = np.atleast_1d(np.asarray(trajectories))
    if rows.size == 0:
        rows = rows.astype(np.int64)
    if rows.ndim != 1 or rows.dtype.kind not in "iu":
        raise InputError("trajectories: allowed: true, false, or a list of row numbers of scenarios")
    outside = (rows < 0) | (rows >= n)
    if outside.any():
        raise InputError(f"trajectories: no scenario {rows[outside][0]}; allowed: 0 to {n - 1}")
    if np.unique(rows).size != rows.size:
        raise InputError("trajectories: a row number is given twice; allowed: each once")
    return rows.astype(np.int64)


def in_threads(work: Callable[[int, int], None], count: int, threads: int | None, least: int) -> None:
    """Call ``work(first, last)`` on stretches of `count` things; the stretches do not depend on the threads."""
    chosen = plain(threads)
    if chosen is not None and (isinstance(chosen, bool) or not isinstance(chosen, int) or chosen < 1):
        raise InputError(f"threads: {chosen!r}; allowed: a whole number >= 1")
    firsts = range(0, count, least)
    number = min(usable_cores() if threads is None else threads, len(firsts))
    if number <= 1:
        work(0, count)
        return
    with ThreadPoolExecutor(number) as pool:
        list(pool.map(lambda first: work(first, min(first + least, count)), firsts))


def recorded_run(takeover: Takeover) -> Run:
    """Nobody intervenes."""
    rows, recorded = takeover.rows, takeover.recorded
    companions = Companions(**{name: getattr(recorded, name)[rows] for name in COMPANION_UNITS})
    zeros = np.zeros(takeover.m, dtype=np.int64)
    return Run(takeover, None, zeros.astype(np.int8), zeros, companions, 0.0, None)


def _status(diverged: npt.NDArray[np.bool_], failed: IntArray) -> npt.NDArray[np.int8]:
    status = np.where(failed > 0, EventStatus.SOLVER_FAILED, EventStatus.OK)
    return np.where(diverged, EventStatus.DIVERGED, status).astype(np.int8)


def run_of_area(takeover: Takeover, area: FloatArray, diverged: npt.NDArray[np.bool_], failed: IntArray) -> Run:
    """A run of which S alone was worked out, from the integral (m,), who diverged (m,), and failed commands (m,)."""
    unknown = np.full(area.size, np.nan)
    companions = Companions(**dict.fromkeys(COMPANION_UNITS, unknown))
    return Run(takeover, area.copy(), _status(diverged, failed), failed, companions, 0.0, None)


def run_of_scores(
    takeover: Takeover,
    score: FloatArray,
    diverged: npt.NDArray[np.bool_],
    failed: IntArray,
    law_seconds: float,
    trajectories: Trajectories | None,
) -> Run:
    """A run from scores (columns, m), who diverged (m,), and failed commands (m,)."""
    edge = takeover.setup.vehicle.edge_offset
    status = _status(diverged, failed)
    # before the trigger the vehicle was on the recorded path
    front = np.maximum(score[data.FRONT] - edge, takeover.front_before)
    values = dict(zip(COMPANION_UNITS, score[data.AREA + 1 :], strict=True)) | {
        "deepest": np.maximum(score[data.DEEP] - edge, takeover.deepest_before),
        "dtle": -front,
        "overshoot": np.maximum(score[data.OVER] - edge, 0.0),
    }
    companions = Companions(**values)
    return Run(takeover, score[data.AREA], status, failed, companions, law_seconds, trajectories)


def trajectories_of(paths: FloatArray, rows: IntArray | None, found: IntArray) -> Trajectories | None:
    """Paths of the chosen rows; NaN where a scenario never triggered."""
    if rows is None:
        return None
    used = np.isfinite(paths[:, :, data.P_TIME]).sum(axis=1).max(initial=1)
    out = np.full((rows.size, int(used), data.PATH), np.nan)
    out[found] = paths[:, : int(used)]
    return Trajectories(rows, out[:, :, data.P_TIME], out[:, :, data.P_X : data.P_DELTA], out[:, :, data.P_DELTA])
