"""The loop for laws of any kind: one call of the law a sample, for all scenarios that still go on."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus, Preview, SolverCalls, SteeringLaw
from ldctoolkit.law_checks import check_calls, check_step, check_taken
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.outcome import Run
from ldctoolkit.simulation.runs import SCENARIOS_A_TASK, in_threads, run_of_scores, trajectories_of
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
    tables, m = takeover.tables, takeover.m
    plant = _PlantSide(tables, tables.blocks(), *tables.paths(rows), threads)
    times = np.ascontiguousarray(law.preview_times, dtype=np.float64)
    seen, lane = np.zeros((m, 4)), np.zeros((2, m, times.size))
    last, failed = takeover.delta_0.copy(), np.zeros(m, dtype=np.int64)
    batch, alive = np.arange(m), plant.begin()
    own = law.init(m)
    law_seconds, sample = 0.0, 0
    calls: list[tuple[IntArray, int, SolverCalls]] = []
    while True:
        going = np.flatnonzero(alive[batch])
        if not going.size:
            break
        if going.size < _DROP_BELOW * batch.size:
            taken = check_taken(law.take(going, own), going.size, name, times)
            if taken is not None:
                law, own = taken
                batch, going = batch[going], np.arange(going.size)
        running = batch[going]
        blocks = np.unique(running // data.LANES)
        plant.look(sample, blocks, times, seen, lane)
        t = takeover.start[batch] + sample * takeover.setup.dt
        ended = np.delete(np.arange(batch.size), going)
        x, previous, yaw_rate, heading = seen[batch], last[batch], lane[0, batch], lane[1, batch]
        for values in (x, previous, yaw_rate, heading):
            values[ended] = 0.0
        started = time.perf_counter()
        result = law.step(t, x, Preview(yaw_rate, heading), previous.copy(), own)
        law_seconds += time.perf_counter() - started
        delta, own, status = check_step(result, batch.size, name)
        made = law.solver_calls(own)
        if made is not None:
            calls.append(_of_running(made, batch, going, sample, name))
        wrong = ~np.isfinite(delta)
        delta[wrong] = previous[wrong]
        failed[running] += (wrong | (status == EventStatus.SOLVER_FAILED))[going]
        last[running] = delta[going]
        plant.go_on(sample, blocks, last, alive)
        sample += 1
    score, diverged = plant.scores()
    kept = trajectories_of(plant.paths, rows, plant.found)
    run = run_of_scores(takeover, score, diverged, failed, law_seconds, kept)
    return dataclasses.replace(run, solver_log=SolverLog.of(calls))


def _of_running(
    made: SolverCalls, batch: IntArray, going: IntArray, sample: int, name: str
) -> tuple[IntArray, int, SolverCalls]:
    """Calls of scenarios that still go on, with their numbers among the triggered ones."""
    check_calls(made, batch.size, name)
    kept = np.isin(made.place, going)
    columns = {field.name: getattr(made, field.name)[kept] for field in dataclasses.fields(made)}
    return batch[made.place[kept]], sample, SolverCalls(**columns)


@dataclasses.dataclass(frozen=True)
class _PlantSide:
    """The compiled part of a sample, in threads: tables of blocks (b, numbers), of scenarios that come in lanes."""

    tables: Tables
    state: FloatArray
    paths: FloatArray
    place: IntArray
    found: IntArray
    threads: int | None

    def begin(self) -> BoolArray:
        """Start every scenario; which ones go on, (m,)."""
        from ldctoolkit.simulation.kernel import entry

        scene, setting, blocks = self.tables.scene, self.tables.setting, np.arange(self.state.shape[0])
        entry.begin(scene, setting, self.state, self.paths, self.place, blocks)
        return self._alive()

    def look(self, k: int, blocks: IntArray, times: FloatArray, seen: FloatArray, lane: FloatArray) -> None:
        """What the law is shown: state (m, 4); yaw rate and heading of the lane (2, m, p)."""
        from ldctoolkit.simulation.kernel import entry

        def work(first: int, last: int) -> None:
            scene, setting = self.tables.scene, self.tables.setting
            entry.look(scene, setting, self.state, k, blocks[first:last], times, seen, lane)

        in_threads(work, blocks.size, self.threads, SCENARIOS_A_TASK // data.LANES)

    def go_on(self, k: int, blocks: IntArray, command: FloatArray, alive: BoolArray) -> None:
        """Drive to the next sample with the commands (m,); which ones go on into `alive` (m,)."""
        from ldctoolkit.simulation.kernel import entry

        def work(first: int, last: int) -> None:
            scene, setting = self.tables.scene, self.tables.setting
            entry.go_on(scene, setting, self.state, self.paths, self.place, k, blocks[first:last], command)

        in_threads(work, blocks.size, self.threads, SCENARIOS_A_TASK // data.LANES)
        alive[:] = self._alive()

    def _alive(self) -> BoolArray:
        from ldctoolkit.simulation.kernel import lane_rows

        return self._row(lane_rows.ALIVE) > 0.0

    def _row(self, row: int) -> FloatArray:
        return self.state[:, row : row + data.LANES].ravel()[: self.tables.over.m]

    def scores(self) -> tuple[FloatArray, BoolArray]:
        """Scores (columns, m), and who diverged (m,)."""
        from ldctoolkit.simulation.kernel import lane_rows

        rows = [self._row(lane_rows.S + n * data.LANES) for n in range(data.SCORES)]
        return np.array(rows), self._row(lane_rows.DIVERGED) > 0.0
