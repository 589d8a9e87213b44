"""The closed loop over all scenarios at once: linear laws in compiled loops, other laws through `SteeringLaw.step`.

A scenario is driven by itself, whichever loop drives it, so that its numbers cannot depend on which others run beside
it, on their order or on the number of threads.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller, EventStatus, Law, LinearLaw, Preview, RecordedPath, SteeringLaw
from ldctoolkit.errors import InputError
from ldctoolkit.law_checks import check_controller, check_law, check_step
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from ldctoolkit.mixture.sources import usable_cores
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.outcome import Run, Trajectories
from ldctoolkit.simulation.tables import BOUND, Tables, law_table, times_of
from ldctoolkit.simulation.takeover import Takeover

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Chosen = bool | npt.ArrayLike

_TOGETHER = 2**21
"""Scores of linear laws that go through the compiled loop in one call, in numbers of scenarios times designs."""

_DROP_BELOW = 0.9
"""Share of a batch still running below which the others are dropped from it."""

_SCENARIOS_A_TASK = 512
"""Scenarios that a thread takes at a time."""


def drive(
    controller: Controller, takeover: Takeover, *, trajectories: Chosen = False, threads: int | None = None
) -> Run:
    """Drive one design from the trigger to the end of every departure and of the settling horizon.

    Parameters
    ----------
    controller : Controller
        The design.
    takeover : Takeover
        Scenarios at their triggers.
    trajectories : bool or (c,) int
        Keep the paths: of all scenarios, or of those with these row numbers.
    threads : int, optional
        Of the compiled loops; all cores this process may use by default. It changes no number.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If the design, its law or the result of a step is not what the interface promises.
    """
    rows = _chosen_rows(trajectories, takeover.scenarios.n)
    law = _prepared(controller, takeover)
    if isinstance(law, SteeringLaw):
        return _drive_general(law, takeover, controller.name, rows, threads)
    if isinstance(law, RecordedPath):
        return _recorded(takeover)
    return _drive_linear([law], takeover, rows, threads)[0]


def drive_many(
    controllers: Iterable[Controller], takeover: Takeover, *, threads: int | None = None
) -> Iterator[Run]:
    """Drive several designs; linear laws go through the compiled loop together, so that scenarios are read once.

    Parameters
    ----------
    controllers : iterable of Controller
        The designs.
    takeover : Takeover
        Scenarios at their triggers.
    threads : int, optional
        As in `drive`.

    Yields
    ------
    Run
        In the order of the designs; the same bits as from `drive`.

    Raises
    ------
    InputError
        As in `drive`.
    """
    most = max(1, _TOGETHER // max(1, takeover.m * data.SCORES))
    waiting: list[LinearLaw] = []
    for controller in controllers:
        law = _prepared(controller, takeover)
        if waiting and not (
            isinstance(law, LinearLaw)
            and len(waiting) < most
            and law.preview_times.size == waiting[0].preview_times.size
        ):
            yield from _drive_linear(waiting, takeover, None, threads)
            waiting = []
        if isinstance(law, LinearLaw):
            waiting.append(law)
        elif isinstance(law, SteeringLaw):
            yield _drive_general(law, takeover, controller.name, None, threads)
        else:
            yield _recorded(takeover)
    if waiting:
        yield from _drive_linear(waiting, takeover, None, threads)


def _prepared(controller: Controller, takeover: Takeover) -> Law:
    check_controller(controller)
    return check_law(controller.prepare(takeover.plant), takeover.m, controller.name)


def _chosen_rows(trajectories: Chosen, n: int) -> IntArray | None:
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


def _places(takeover: Takeover, rows: IntArray | None) -> tuple[IntArray, IntArray]:
    """Places among the m triggered of the chosen rows that triggered, and which of the rows these are."""
    if rows is None:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    place = np.full(takeover.scenarios.n, -1, dtype=np.int64)
    place[takeover.rows] = np.arange(takeover.m)
    found = np.flatnonzero(place[rows] >= 0)
    return place[rows[found]], found


def _in_threads(work: Callable[[int, int], None], count: int, threads: int | None, least: int) -> None:
    """Call ``work(first, last)`` on stretches of `count` things; the stretches do not depend on the threads."""
    firsts = range(0, count, least)
    number = min(usable_cores() if threads is None else threads, len(firsts))
    if number <= 1:
        work(0, count)
        return
    with ThreadPoolExecutor(number) as pool:
        list(pool.map(lambda first: work(first, min(first + least, count)), firsts))


def _recorded(takeover: Takeover) -> Run:
    """Nobody intervenes."""
    rows, recorded = takeover.rows, takeover.recorded
    companions = Companions(**{name: getattr(recorded, name)[rows] for name in COMPANION_UNITS})
    zeros = np.zeros(takeover.m, dtype=np.int64)
    return Run(takeover, None, zeros.astype(np.int8), zeros, companions, 0.0, None)


def _run(
    takeover: Takeover,
    score: FloatArray,
    diverged: npt.NDArray[np.bool_],
    failed: IntArray,
    law_seconds: float,
    trajectories: Trajectories | None,
) -> Run:
    edge = takeover.model.parameters.edge_offset
    status = np.where(failed > 0, EventStatus.SOLVER_FAILED, EventStatus.OK)
    status = np.where(diverged, EventStatus.DIVERGED, status).astype(np.int8)
    # before the trigger the vehicle was on the recorded path
    front = np.maximum(score[:, data.FRONT] - edge, takeover.front_before)
    companions = Companions(
        deepest=np.maximum(score[:, data.DEEP] - edge, takeover.deepest_before),
        dtle=-front,
        t_back=score[:, data.BACK].copy(),
        overshoot=np.maximum(score[:, data.OVER] - edge, 0.0),
        a_y_peak=score[:, data.A_Y].copy(),
        jerk_peak=score[:, data.JERK].copy(),
        delta_peak=score[:, data.DELTA].copy(),
        delta_rate_peak=score[:, data.RATE].copy(),
        effort=score[:, data.EFFORT].copy(),
        travel=score[:, data.TRAVEL].copy(),
    )
    return Run(takeover, score[:, data.AREA].copy(), status, failed, companions, law_seconds, trajectories)


def _drive_linear(
    laws: list[LinearLaw], takeover: Takeover, rows: IntArray | None, threads: int | None
) -> list[Run]:
    from ldctoolkit.simulation.kernel import entry
    from ldctoolkit.simulation.kernel.lanes import LANES

    tables = takeover.tables
    options = takeover.options
    if not (options.drives_exactly and options.sensors.ideal):
        return [_drive_each(law, tables, rows, threads) for law in laws]
    d, m = len(laws), takeover.m
    score = np.zeros((d, m, data.SCORES))
    diverged, failed = np.zeros((d, m), dtype=np.bool_), np.zeros((d, m), dtype=np.int64)
    if m:
        table, times = np.stack([law_table(law) for law in laws]), np.stack([times_of(law) for law in laws])
        state = tables.state()
        none = tables.paths(np.zeros(0, dtype=np.int64), state)
        scene, exact, setting = tables.scene, tables.exact, tables.setting

        def work(first: int, last: int) -> None:
            own = entry.scratch(setting, times.shape[1])
            entry.drive_lanes(
                scene, exact, setting, table, times, state, none, first, last, score, diverged, failed, own
            )

        _in_threads(work, -(-m // LANES), threads, _SCENARIOS_A_TASK // LANES)
    paths = [None if rows is None else _drive_each(law, tables, rows, threads).trajectories for law in laws]
    return [_run(takeover, score[i], diverged[i], failed[i], 0.0, paths[i]) for i in range(d)]


def _drive_each(law: LinearLaw, tables: Tables, rows: IntArray | None, threads: int | None) -> Run:
    """A linear law on any plant, scenario by scenario; on the ideal plant only those whose paths are wanted."""
    from ldctoolkit.simulation.kernel import entry

    over, state, table, times = tables.over, tables.state(), law_table(law), times_of(law)
    places, found = _places(over, rows)
    paths = tables.paths(places, state)
    ideal = over.options.drives_exactly and over.options.sensors.ideal
    driven = np.sort(places) if ideal else np.arange(over.m)

    def work(first: int, last: int) -> None:
        part = driven[first:last]
        entry.begin(tables.scene, tables.setting, state, paths, part)
        entry.drive_each(tables.scene, tables.setting, table, times, state, paths, part, entry.scratch())

    _in_threads(work, driven.size, threads, _SCENARIOS_A_TASK // 8)
    return _of_state(over, state, 0.0, _trajectories(paths, rows, found))


def _of_state(over: Takeover, state: FloatArray, law_seconds: float, trajectories: Trajectories | None) -> Run:
    score = state[:, data.SCORE : data.SCORE + data.SCORES]
    failed = state[:, data.FAILED].astype(np.int64)
    return _run(over, score, state[:, data.DIVERGED] > 0, failed, law_seconds, trajectories)


def _drive_general(
    law: SteeringLaw, takeover: Takeover, name: str, rows: IntArray | None, threads: int | None
) -> Run:
    """Any law, all scenarios of a sample at once."""
    from ldctoolkit.simulation.kernel import entry

    tables = takeover.tables
    scene, setting, state = tables.scene, tables.setting, tables.state()
    places, found = _places(takeover, rows)
    paths = tables.paths(places, state)
    batch = np.arange(takeover.m)
    entry.begin(scene, setting, state, paths, batch)
    times = np.ascontiguousarray(law.preview_times, dtype=np.float64)
    own = law.init(takeover.m)
    law_seconds, sample = 0.0, 0
    while True:
        going = np.flatnonzero(state[batch, data.ALIVE])
        if not going.size:
            break
        if going.size < _DROP_BELOW * batch.size:
            taken = law.take(going, own)
            if taken is not None:
                law, own = taken
                batch, going = batch[going], np.arange(going.size)
        running = batch[going]
        seen = np.zeros((running.size, 4))
        ahead = np.zeros((2, running.size, times.size))

        def look(first: int, last: int) -> None:
            part = slice(first, last)
            entry.look(
                scene, setting, state, sample, running[part], times,
                seen[part], ahead[0, part], ahead[1, part], entry.scratch(),
            )  # fmt: skip

        _in_threads(look, running.size, threads, _SCENARIOS_A_TASK)
        t, x, preview, previous = _shown(takeover, state, batch, going, sample, seen, ahead)
        started = time.perf_counter()
        result = law.step(t, x, preview, previous.copy(), own)
        law_seconds += time.perf_counter() - started
        delta, own, status = check_step(result, batch.size, name)
        wrong = ~np.isfinite(delta)
        delta[wrong] = previous[wrong]
        state[running, data.FAILED] += (wrong | (status == EventStatus.SOLVER_FAILED))[going]
        command = np.ascontiguousarray(delta[going])

        def go_on(first: int, last: int) -> None:
            entry.go_on(scene, setting, state, paths, sample, running[first:last], command[first:last], entry.scratch())

        _in_threads(go_on, running.size, threads, _SCENARIOS_A_TASK)
        sample += 1
    trajectories = _trajectories(paths, rows, found)
    return _of_state(takeover, state, law_seconds, trajectories)


def _shown(
    takeover: Takeover, state: FloatArray, batch: IntArray, going: IntArray, sample: int, seen: FloatArray, ahead: FloatArray
) -> tuple[FloatArray, FloatArray, Preview, FloatArray]:
    """What `SteeringLaw.step` is given: scenarios of the batch that have ended are zeros."""
    if going.size == batch.size:
        t = takeover.start[batch] + sample * takeover.dt
        return t, seen, Preview(ahead[0], ahead[1]), state[batch, data.COMMAND]
    x = np.zeros((batch.size, 4))
    lane = np.zeros((2, batch.size, ahead.shape[2]))
    t, previous = np.zeros(batch.size), np.zeros(batch.size)
    x[going], lane[:, going] = seen, ahead
    t[:] = takeover.start[batch] + sample * takeover.dt
    previous[going] = state[batch[going], data.COMMAND]
    return t, x, Preview(lane[0], lane[1]), previous


def _trajectories(paths: FloatArray, rows: IntArray | None, found: IntArray) -> Trajectories | None:
    """Paths of the chosen rows; NaN where a scenario never triggered."""
    if rows is None:
        return None
    used = np.isfinite(paths[:, :, data.P_TIME]).sum(axis=1).max(initial=1)
    out = np.full((rows.size, int(used), data.PATH), np.nan)
    out[found] = paths[:, : int(used)]
    return Trajectories(rows, out[:, :, data.P_TIME], out[:, :, data.P_X : data.P_DELTA], out[:, :, data.P_DELTA])


__all__ = ["BOUND", "drive", "drive_many"]
