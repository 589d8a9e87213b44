"""Sends what is missing to an executor in tasks of half a second, and finds the scenario that kills its worker."""

from __future__ import annotations

import dataclasses
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.vehicle import Convention
from studies.design import NO_CONTROL, Design
from studies.results import FailedRun, RunKey, TaskResult
from studies.running.executors.protocol import Ended, Executor, Fault
from studies.running.simulate_designs import SimulationTask, Simulator
from studies.running.tasks import Done, Faults, Job, Piece, Task


class InOrder:
    """Holds results back until those of all earlier pieces of the same design are there.

    Of a design that fails on a piece, exactly the pieces before it are handed on, whatever ran at the same time.
    """

    def __init__(self) -> None:
        self._wanted: dict[RunKey, deque[int]] = defaultdict(deque)
        self._early: dict[RunKey, dict[int, TaskResult]] = {}

    def expect(self, keys: Iterable[RunKey], piece: int) -> None:
        """A piece of some designs will come, after those that were announced before."""
        for key in keys:
            self._wanted[key].append(piece)

    def take(self, piece: int, result: TaskResult) -> Iterator[TaskResult]:
        """Results that can be handed on, now that these are there."""
        now = [i for i, key in enumerate(result.keys) if self._wanted[key] and self._wanted[key][0] == piece]
        ready = set(now)
        for i, key in enumerate(result.keys):
            if i not in ready:
                self._early.setdefault(key, {})[piece] = result.take([i])
        if not now:
            return
        yield result if len(now) == len(result.keys) else result.take(now)
        for i in now:
            key = result.keys[i]
            wanted, early = self._wanted[key], self._early.get(key, {})
            wanted.popleft()
            while wanted and wanted[0] in early:
                yield early.pop(wanted.popleft())


class Merge:
    """Keeps results of parts of pieces until the rest is there."""

    def __init__(self) -> None:
        self._parts: dict[tuple[RunKey, int], list[TaskResult]] = {}

    def add(self, task: Task, result: TaskResult) -> TaskResult | None:
        """Take in results of one design on a part of a piece; the whole piece, once it is complete."""
        key = (result.keys[0], task.piece)
        parts = self._parts.setdefault(key, [])
        parts.append(result)
        if sum(part.rows.size for part in parts) < task.piece_size:
            return None
        del self._parts[key]
        return dataclasses.replace(
            parts[0],
            rows=np.concatenate([part.rows for part in parts]),
            values=np.concatenate([part.values for part in parts], axis=2),
            status=np.concatenate([part.status for part in parts], axis=1),
            failed_solves=np.concatenate([part.failed_solves for part in parts], axis=1),
            law_seconds=np.sum([part.law_seconds for part in parts], axis=0),
            commands=np.sum([part.commands for part in parts], axis=0),
        ).sorted_by_row()


SECONDS_A_TASK: Final = 0.5
"""Enough to hide the cost of sending a task, little enough to spread slow designs and to lose little with a worker."""

_FIRST_RUNS: Final = 2000
"""Scenario runs in the first task of a law, before its pace is known."""

_MOST_RUNS: Final = 400_000
"""Scenario runs in a task at most: results are in memory on both sides."""

_AHEAD: Final = 2
"""Tasks a worker that are under way or wait in the executor."""

STATUS_OF: Final[dict[Fault, EventStatus]] = {"died": EventStatus.CRASHED, "late": EventStatus.TIMED_OUT}
"""What becomes of the scenario at fault."""


class Lane:
    """Designs of one law that still have to run on one piece of scenarios."""

    def __init__(self, convention: Convention, piece: Piece, designs: Iterable[Design]) -> None:
        self.convention = convention
        self.piece = piece
        # designs of one threshold share a takeover
        self.designs = deque(sorted(designs, key=lambda design: design.y_s))

    @property
    def law(self) -> str:
        """The law of all of them."""
        return self.designs[0].law


class Dispatcher:
    """Runs lanes of designs through an executor."""

    def __init__(
        self,
        job: Job,
        scenarios: Scenarios,
        executor: Executor,
        collect: Callable[[Done], None],
        *,
        faults: Faults,
        block_size: int | None = None,
    ) -> None:
        self._job = job
        self._scenarios = scenarios
        self._executor = executor
        self._collect = collect
        self._block_size = block_size
        self._seconds_a_run: dict[str, float] = {}
        self._under_way = 0
        self._again: deque[SimulationTask] = deque()
        self._alone: deque[SimulationTask] = deque()
        self._faults = faults
        self._merge = Merge()
        self._in_order = InOrder()
        self._failed: dict[RunKey, int] = {}

    def run(self, lanes: Sequence[Lane]) -> None:
        """Run everything; returns when nothing is left."""
        for lane in lanes:
            self._in_order.expect(((design.id, lane.convention) for design in lane.designs), lane.piece.number)
        queue = self._tasks(deque(lanes))
        following = next(queue, None)
        while following or self._again or self._alone or self._under_way:
            if self._alone:
                # a task that may have killed its worker runs with no other beside it, so that there is no doubt
                if not self._under_way:
                    self._start(self._alone.popleft())
            else:
                most = 1 if self._executor.workers == 1 else _AHEAD * self._executor.workers
                while self._under_way < most and (self._again or following):
                    if self._again:
                        self._start(self._again.popleft())
                    elif following:
                        self._start(following)
                        following = next(queue, None)
            came = self._executor.wait()
            self._faults.came_back(came)
            for ended in came:
                self._under_way -= 1
                self._take(ended)

    def _tasks(self, lanes: deque[Lane]) -> Iterator[SimulationTask]:
        while lanes:
            lane = lanes[0]
            if not lane.designs:
                lanes.popleft()
                continue
            count = self._block_size or self._fitting(lane)
            designs: list[Design] = []
            while lane.designs and len(designs) < count:
                design = lane.designs.popleft()
                # a design that has failed on an earlier piece is out
                if self._failed.get((design.id, lane.convention), lane.piece.number) >= lane.piece.number:
                    designs.append(design)
            if designs:
                rows = lane.piece.rows
                scenarios = self._scenarios.take(rows)
                yield SimulationTask(
                    self._job, lane.convention, tuple(designs), rows, scenarios, lane.piece.number, rows.size
                )

    def _fitting(self, lane: Lane) -> int:
        """Designs that take about half a second."""
        pace = self._seconds_a_run.get(lane.law)
        runs = _FIRST_RUNS if pace is None else min(_MOST_RUNS, SECONDS_A_TASK / max(pace, 1e-9))
        return max(1, int(runs / lane.piece.rows.size))

    def _start(self, task: SimulationTask) -> None:
        self._under_way += 1
        self._executor.start(task)

    def _take(self, ended: Ended) -> None:
        task: SimulationTask = ended.task
        if ended.done is not None:
            self._faults.ended_well()
            # the last pace counts: the first task of a process also loads and compiles
            self._seconds_a_run[task.designs[0].law] = ended.done.result.seconds / task.runs
            self._give(task, ended.done)
        elif ended.fault is None:
            self._again.append(task)
        else:
            self._blame(task, ended.fault, certain=ended.certain)

    def _blame(self, task: SimulationTask, fault: Fault, *, certain: bool) -> None:
        """Run a task once more alone; halve it when it has ended its worker again, or was over its time."""
        if not self._faults.guilty(task, fault, certain=certain):
            self._alone.append(task)
            return
        halves = task.halves()
        if halves:
            for half in halves:
                self._faults.inherit(half)
            # the halves go first: what is left of the study waits for no other death
            self._alone.extendleft(reversed(halves))
            return
        key = (task.designs[0].id, task.convention)
        reason = self._faults.record(key, int(task.rows[0]), fault)
        if reason:
            self._faults.check_workers(self._executor, self._harmless(task))
            self._fail(FailedRun(key, task.piece, reason))
            self._alone = deque(self._without(key, self._alone))
            self._again = deque(self._without(key, self._again))
        else:
            self._give(task, Done(Simulator(self._job).uncontrolled(task, STATUS_OF[fault])))

    def _without(self, key: RunKey, tasks: Iterable[SimulationTask]) -> Iterator[SimulationTask]:
        """The same tasks without a design that has failed; those of its fellows are as suspect as before."""
        for task in tasks:
            rest = tuple(design for design in task.designs if (design.id, task.convention) != key)
            if len(rest) == len(task.designs):
                yield task
            elif rest:
                fewer = task.only(rest)
                self._faults.same_strikes(task, fewer)
                yield fewer

    def _harmless(self, task: SimulationTask) -> SimulationTask:
        """A task that drives nobody, on one scenario."""
        nobody = Design.from_gains(NO_CONTROL, task.designs[0].y_s, {})
        return dataclasses.replace(
            task.only((nobody,)), rows=task.rows[:1], scenarios=task.scenarios.take([0]), piece_size=1
        )

    def _give(self, task: Task, done: Done) -> None:
        """Hand on whole pieces; parts of one wait for the rest."""
        for run in done.failed:
            self._fail(run)
        if not done.result.keys:
            return
        whole = done.result if task.whole else self._merge.add(task, done.result)
        if whole is not None:
            for result in self._in_order.take(task.piece, whole):
                self._collect(Done(result))

    def _fail(self, run: FailedRun) -> None:
        before = self._failed.get(run.key)
        if before is None or run.piece < before:
            self._failed[run.key] = run.piece
            self._collect(Done(_nothing(self._job), (run,)))


def _nothing(job: Job) -> TaskResult:
    none = np.zeros(0, dtype=np.int64)
    return TaskResult(
        (),
        none,
        np.zeros((len(job.columns), 0, 0)),
        np.zeros((0, 0), dtype=np.int8),
        np.zeros((0, 0), dtype=np.int32),
        np.zeros(0),
        none,
    )
