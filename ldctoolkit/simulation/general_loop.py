"""The loop for laws of any kind: one call of the law a sample, for all scenarios that still go on."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import EventStatus, Preview, SolverCalls, SteeringLaw
from ldctoolkit.law_checks import check_calls, check_step, check_taken
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.outcome import Run
from ldctoolkit.simulation.runs import SCENARIOS_A_TASK, in_threads, places, run_of_state, trajectories_of
from ldctoolkit.simulation.solver_log import SolverLog
from ldctoolkit.simulation.takeover import Tables, Takeover

_DROP_BELOW = 0.9
"""Share of a batch still running below which the others are dropped from it."""


def drive_general(law: SteeringLaw, takeover: Takeover, name: str, rows: IntArray | None, threads: int | None) -> Run:
    """Drive a law, all scenarios of a sample at once.

    Parameters
    ----------
    law : SteeringLaw
        Made for the takeover's m scenarios.
    takeover : Takeover
    name : str
        The controller, for messages.
    rows : (c,) int, optional
        Scenarios whose paths are kept.
    threads : int, optional
        Of the plant's side; the law is called in this thread.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If a step of the law is not what the interface promises.
    """
    tables = takeover.tables
    state = tables.state()
    chosen, found = places(takeover, rows)
    plant = _PlantSide(tables, state, tables.paths(chosen, state), threads)
    batch = np.arange(takeover.m)
    plant.begin(batch)
    times = np.ascontiguousarray(law.preview_times, dtype=np.float64)
    own = law.init(takeover.m)
    law_seconds, sample = 0.0, 0
    calls: list[tuple[IntArray, int, SolverCalls]] = []
    while True:
        going = np.flatnonzero(state[batch, data.ALIVE])
        if not going.size:
            break
        if going.size < _DROP_BELOW * batch.size:
            taken = check_taken(law.take(going, own), going.size, name, times)
            if taken is not None:
                law, own = taken
                batch, going = batch[going], np.arange(going.size)
        running = batch[going]
        seen, ahead = plant.look(sample, running, times)
        t = takeover.start[batch] + sample * takeover.setup.dt
        previous = _spread(state[running, data.COMMAND], going, batch.size)
        x = _spread(seen, going, batch.size)
        preview = Preview(_spread(ahead[0], going, batch.size), _spread(ahead[1], going, batch.size))
        started = time.perf_counter()
        result = law.step(t, x, preview, previous.copy(), own)
        law_seconds += time.perf_counter() - started
        delta, own, status = check_step(result, batch.size, name)
        made = law.solver_calls(own)
        if made is not None:
            calls.append(_of_running(made, batch, going, sample, name))
        wrong = ~np.isfinite(delta)
        delta[wrong] = previous[wrong]
        state[running, data.FAILED] += (wrong | (status == EventStatus.SOLVER_FAILED))[going]
        plant.go_on(sample, running, np.ascontiguousarray(delta[going]))
        sample += 1
    run = run_of_state(takeover, state, law_seconds, trajectories_of(plant.paths, rows, found))
    return dataclasses.replace(run, solver_log=SolverLog.of(calls))


def _of_running(
    made: SolverCalls, batch: IntArray, going: IntArray, sample: int, name: str
) -> tuple[IntArray, int, SolverCalls]:
    """Calls of scenarios that still go on, with their numbers among the triggered ones."""
    check_calls(made, batch.size, name)
    kept = np.isin(made.place, going)
    columns = {field.name: getattr(made, field.name)[kept] for field in dataclasses.fields(made)}
    return batch[made.place[kept]], sample, SolverCalls(**columns)


def _spread(values: FloatArray, going: IntArray, size: int) -> FloatArray:
    """Rows of a batch; those that have ended are zeros."""
    if going.size == size:
        return values
    out = np.zeros((size, *values.shape[1:]))
    out[going] = values
    return out


@dataclasses.dataclass(frozen=True)
class _PlantSide:
    """The compiled part of a sample, in threads."""

    tables: Tables
    state: FloatArray
    paths: FloatArray
    threads: int | None

    def begin(self, rows: IntArray) -> None:
        """Start every scenario."""
        from ldctoolkit.simulation.kernel import entry

        entry.begin(self.tables.scene, self.tables.setting, self.state, self.paths, rows)

    def look(self, sample: int, rows: IntArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the law is shown of the scenarios `rows`: state (r, 4); yaw rate and heading of the lane (2, r, p)."""
        from ldctoolkit.simulation.kernel import entry

        seen, ahead = np.zeros((rows.size, 4)), np.zeros((2, rows.size, times.size))
        scene, setting = self.tables.scene, self.tables.setting

        def work(first: int, last: int) -> None:
            part = slice(first, last)
            lane = ahead[0, part], ahead[1, part]
            entry.look(scene, setting, self.state, sample, rows[part], times, seen[part], *lane, entry.scratch())

        in_threads(work, rows.size, self.threads, SCENARIOS_A_TASK)
        return seen, ahead

    def go_on(self, sample: int, rows: IntArray, command: FloatArray) -> None:
        """Drive the scenarios `rows` to the next sample with their commands (r,)."""
        from ldctoolkit.simulation.kernel import entry

        scene, setting = self.tables.scene, self.tables.setting

        def work(first: int, last: int) -> None:
            part = slice(first, last)
            entry.go_on(scene, setting, self.state, self.paths, sample, rows[part], command[part], entry.scratch())

        in_threads(work, rows.size, self.threads, SCENARIOS_A_TASK)
