"""Triggered scenarios sample by sample: what the law sees, the way to the next sample, scores.

The toolkit's plant is driven in the compiled loops from sample to sample. A vehicle model's equations are called
between pieces of the same loop, for all scenarios of some blocks at once: actuator, camera and scores are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import LANES, BoolArray, FloatArray, IntArray
from ldctoolkit.declared import checked_whole
from ldctoolkit.errors import LdcError
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.surroundings import usable_cores
from ldctoolkit.vehicle.vehicle_model import TOGETHER, equations

SCENARIOS_A_TASK: Final = 1024  # Scenarios that a thread takes at a time


class Stretch:
    """A range of the triggered scenarios in the compiled loops, sample by sample, in threads."""

    drives = True  # The compiled loop drives a sample, and does not only look at its end

    def __init__(
        self,
        takeover: Takeover,
        rows: slice,
        exact: FloatArray,
        paths: FloatArray,
        path_row: IntArray,
        threads: int | None,
    ) -> None:
        from ldctoolkit.lanes import zeros
        from ldctoolkit.simulation.kernel import entry

        self.entry, self.setting, self.exact, self.paths = entry, takeover.setting, exact, paths
        self.rows, self.recorded, self.steering = rows, takeover.recorded_bend[rows], takeover.recorded_steering[rows]
        self.threads = 1 if exact.size else threads  # an exact step takes less time than to start a thread
        self.blocks = np.arange(-(-(rows.stop - rows.start) // LANES))
        self.state = zeros(self.blocks.size, entry.table_rows(self.setting), LANES)
        self.substeps = float(takeover.scene[rows, data.SUBSTEPS].max(initial=1.0))
        self.going = np.ones((self.blocks.size, LANES), dtype=np.bool_)  # lanes that go on
        entry.begin(takeover.scene[rows], exact, self.setting, self.state, paths, path_row[rows])

    def go_on(
        self, k: int, command: FloatArray, alive: BoolArray, times: FloatArray, shown: Sequence[FloatArray]
    ) -> None:  # fmt: skip
        """Drive sample k with the commands (m,), unless k is -1; whether each scenario goes on into `alive` (m,).

        What the law then sees, into `shown`: state (m, 4); yaw rate and heading of the lane (m, p); wheel angle,
        driver's torque, and 1 where the assist yields (m,).
        """
        commands, seen = command[self.rows], [values[self.rows] for values in shown]

        def work(first: int, last: int) -> None:
            self.sample(k, self.blocks[first:last], commands, times, seen)

        in_threads(work, self.blocks.size, self.threads, SCENARIOS_A_TASK // LANES)
        self.blocks = self.blocks[self.going[self.blocks].any(axis=1)]
        alive[self.rows] = self.going.ravel()[: commands.size]

    def new_frame(self, k: int) -> FloatArray:
        """e_y and e_psi of the frame that the filter took in when it looked at sample k, (rows, 2); NaN without one."""
        from ldctoolkit.simulation.kernel.sight import frame_of

        latest = [frame_of.py_func(self.setting, sample) for sample in (k, k - 1)]
        if not self.setting[data.FILTERED] or (k and latest[0] == latest[1]):
            return np.full((self.rows.stop - self.rows.start, 2), np.nan)

        def lanes(row: int) -> FloatArray:
            return self.state[:, row]

        # x = x_predicted + K innovation, and the innovation is frame - x_predicted
        innovation, gain = [lanes(data.INNOVATION_Y), lanes(data.INNOVATION_PSI)], data.FILTER_ROWS + data.GAIN
        frame = []
        for i, seen in enumerate((data.SEEN_E_Y, data.SEEN_E_PSI)):
            K = [lanes(gain + 4 * i + j) for j in range(2)]
            frame.append(lanes(seen) - K[0] * innovation[0] - K[1] * innovation[1] + innovation[i])
        return np.stack(frame, axis=-1).reshape(-1, 2)[: self.rows.stop - self.rows.start]

    def scores(self) -> tuple[FloatArray, BoolArray]:
        """Scores (columns, rows), and which scenarios diverged (rows,)."""
        count = self.rows.stop - self.rows.start
        score = self.state[:, data.SCORE : data.SCORE + data.SCORES].swapaxes(0, 1).reshape(data.SCORES, -1)
        diverged = self.state[:, data.DIVERGED].ravel() > 0.0
        return score[:, :count], diverged[:count]

    def sample(
        self, k: int, blocks: IntArray, command: FloatArray, times: FloatArray, seen: Sequence[FloatArray],
    ) -> None:  # fmt: skip
        """Sample k of some blocks, and what the law sees then."""
        work = self.entry.sample_scratch(self.setting, times.size, self.substeps)
        tables = self.recorded, self.steering, self.paths
        drives = self.drives and k >= 0
        self.entry.go_on(
            self.exact, self.setting, self.state, work, *tables, k, blocks, drives, command, self.going, times, *seen
        )


def in_threads(work: Callable[[int, int], None], count: int, threads: int | None, least: int) -> None:
    """Call ``work(first, last)`` on stretches of `count` things; the stretches do not depend on the threads."""
    firsts = range(0, count, least)
    number = min(usable_cores() if threads is None else checked_whole("threads", threads, lower=1), len(firsts))
    if number <= 1:
        work(0, count)
        return
    with ThreadPoolExecutor(number) as pool:
        list(pool.map(lambda first: work(first, min(first + least, count)), firsts))


def stretches(takeover: Takeover, paths: FloatArray, path_row: IntArray, threads: int | None) -> list[Stretch]:
    """The scenarios of a takeover, by the method that drives them."""
    m, stiff, no_matrices = takeover.m, takeover.stiff, np.zeros((3, 0, data.EXACT))
    if takeover.setup.vehicle_model is not None:
        return [ModelStretch(takeover, slice(0, m), no_matrices, paths, path_row, threads)]
    plants = []
    if stiff or not m:
        plants.append(Stretch(takeover, slice(0, stiff), no_matrices, paths, path_row, threads))
    if stiff < m:
        exact = np.ascontiguousarray(takeover.exact[:, stiff:])
        plants.append(Stretch(takeover, slice(stiff, m), exact, paths, path_row, threads))
    return plants


_UPRIGHT: Final = 0.5  # |e_psi| [rad] up to which a vehicle has not spun: there, no state may become infinite
_LARGEST: Final = 1e6  # of a state that has not diverged


class ModelStretch(Stretch):
    """The same on a vehicle model of the designer's."""

    drives = False

    def __init__(self, takeover: Takeover, *arguments: Any) -> None:
        super().__init__(takeover, *arguments)
        assert takeover.setup.vehicle_model is not None
        self.equations = equations(takeover.setup.vehicle_model)
        self.model = self.equations.model
        lanes = self.state[:, data.SUBSTEPS_A_SAMPLE]
        self.parts = np.ceil(lanes.max(axis=1, initial=1.0) - 1e-9).astype(np.int64)
        self.own = np.zeros((self.blocks.size * LANES, takeover.states.shape[1]))
        self.own[: takeover.m], self.own[takeover.m :] = takeover.states, takeover.states[-1:]
        self.free: list[_Workspace] = []  # Each is used by one thread at a time
        if not self.equations.symbolic:
            self.threads = 1
        if self.model.advances and takeover.m:
            self.memory = self.model.begin(takeover.turn)
        for blocks in self._pieces(self.blocks):
            self._ask_a_y(_Workspace(self), data.ASK_AT_TRIGGER, 0, 0, blocks, np.arange(blocks.size), np.zeros(0))

    @staticmethod
    def _pieces(blocks: IntArray) -> list[IntArray]:
        count = SCENARIOS_A_TASK // LANES
        return [blocks[first : first + count] for first in range(0, blocks.size, count)]

    def sample(
        self, k: int, blocks: IntArray, command: FloatArray, times: FloatArray, seen: Sequence[FloatArray],
    ) -> None:  # fmt: skip
        """Sample k of some blocks: segments, and in each as many substeps as a block needs."""
        work = self.free.pop() if self.free else _Workspace(self)
        for some in self._pieces(blocks) if k >= 0 else []:
            every, parts, segment = np.arange(some.size), self.parts[some], 0
            self._ask_a_y(work, data.ASK_COMMANDED, k, 0, some, every, command)
            rows = every
            while rows.size:
                for j in range(parts[rows].max()):
                    using = rows[parts[rows] > j]
                    call = k, j, segment, some, using, command
                    self._exchange(work, data.ASK_STEP, *call, work.result)
                    self._step(work, some[using])
                    self._exchange(work, data.STEPPED, *call, work.result)
                segment += data.HEADER
                rows = every[work.ends[: some.size] > segment]
                if rows.size:
                    self._ask_a_y(work, data.ASK_CUT, k, segment, some, rows, command)
            self._ask_a_y(work, data.ASK_END, k, 0, some, every, command)
        self.free.append(work)
        super().sample(k, blocks, command, times, seen)

    def _exchange(
        self, work: _Workspace, phase: int, k: int, j: int, segment: int, blocks: IntArray, rows: IntArray,
        command: FloatArray, result: FloatArray,
    ) -> None:  # fmt: skip
        self.entry.exchange(
            phase, self.setting, self.state, self.recorded, self.paths, k, j, segment, blocks, rows, command,
            work.road, work.ends, work.ramps, work.e, result,
        )  # fmt: skip

    def _ask_a_y(
        self, work: _Workspace, phase: int, k: int, segment: int, blocks: IntArray, rows: IntArray, command: FloatArray
    ) -> None:
        """Lateral acceleration at a moment, and what follows from it."""
        call = k, 0, segment, blocks, rows, command, work.a_y
        self._exchange(work, phase, *call)
        n, _ = self._own(work, blocks[rows])
        if self.equations.symbolic:
            work.run(work.a_y_calls, n)
        else:
            work.a_y[:n, 0] = self.equations.a_y(
                np.concatenate([work.e[:n, :4], work.own[:n]], axis=1), work.e[:n, 5:9]
            )
        if not np.isfinite(work.a_y[:n]).all():
            alive = self.state[blocks[rows], data.ALIVE].ravel() > 0.0
            self._fail("a_y", work, alive & ~np.isfinite(work.a_y[:n, 0]))
        self._exchange(work, phase + 1, *call)

    def _own(self, work: _Workspace, blocks: IntArray) -> tuple[int, IntArray]:
        """Own states of the lanes of some blocks into the workspace; how many lanes, and which."""
        lanes = (blocks[:, None] * LANES + np.arange(LANES)).ravel()
        if self.own.size:
            work.own[: lanes.size] = self.own[lanes]
        return lanes.size, lanes

    def _step(self, work: _Workspace, blocks: IntArray) -> None:
        """A step of the lanes of some blocks."""
        n, lanes = self._own(work, blocks)
        moved = work.e[:n, 4] > 0.0
        if self.equations.symbolic:
            work.run(work.step_calls, n)
        elif self.model.advances:
            work.result[:n][moved], work.own_after[:n][moved] = self.equations.advance(
                self.memory, lanes[moved], work.e[:n][moved], work.own[:n][moved]
            )
        else:
            work.result[:n], work.own_after[:n] = self.equations.step(work.e[:n], work.own[:n])
        if not (np.isfinite(work.result[:n]).all() and np.isfinite(work.own_after[:n]).all()):
            finite = np.isfinite(work.result[:n]).all(axis=1) & np.isfinite(work.own_after[:n]).all(axis=1)
            upright = (np.abs(work.e[:n, 2]) <= _UPRIGHT) & (np.abs(work.own[:n]) <= _LARGEST).all(axis=1)
            self._fail("advance" if self.model.advances else "derivatives", work, moved & ~finite & upright)
        if self.own.size:
            self.own[lanes[moved]] = work.own_after[:n][moved]

    def _fail(self, method: str, work: _Workspace, bad: BoolArray) -> None:
        """Raise where a model gave no number although its vehicle has not spun."""
        if bad.any():
            i = int(np.flatnonzero(bad)[0])
            e_y, _, e_psi, _, _, v = work.e[i, :6]
            where = f"at e_y = {e_y:.3g} m, e_psi = {e_psi:.3g} rad, {v:.3g} m/s"
            hint = "ldctoolkit.testing.check_vehicle_model looks for the reason"
            raise LdcError(f"{self.equations.name}.{method}", f"not finite {where}", hint=hint)


class _Workspace:
    """Arrays of a piece, where compiled functions read and write."""

    def __init__(self, plant: ModelStretch) -> None:
        blocks, q = min(SCENARIOS_A_TASK // LANES, plant.parts.size), plant.own.shape[1]
        size = -(-blocks * LANES // TOGETHER) * TOGETHER
        self.road, self.ends = np.zeros((blocks, 4 * data.HEADER, LANES)), np.zeros(blocks, dtype=np.int64)
        self.ramps = np.zeros(blocks, dtype=np.bool_)
        self.e, self.result, self.a_y = np.ones((size, data.QUESTION)), np.zeros((size, 5)), np.zeros((size, 1))
        self.own, self.own_after = np.zeros((size, q)), np.zeros((size, q))
        self.step_calls: list[Any] = []
        self.a_y_calls: list[Any] = []
        if not plant.equations.symbolic:
            return
        step, a_y = plant.equations.compiled
        for first in range(0, size, TOGETHER):
            for function, calls, results in (
                (step, self.step_calls, [self.result, self.own_after]), (a_y, self.a_y_calls, [self.a_y]),
            ):  # fmt: skip
                buffer, run = function.buffer()
                for put, arrays in ((buffer.set_arg, [self.e, self.own]), (buffer.set_res, results)):
                    for k, array in enumerate(arrays):
                        if array.size:
                            put(k, array[first : first + TOGETHER].data)
                calls.append((run, function, buffer))

    @staticmethod
    def run(calls: list[Any], n: int) -> None:
        """As many calls as n lanes need."""
        for run, _, _ in calls[: -(-n // TOGETHER)]:
            run()
