"""The work of one worker: designs on some scenarios, from plain data, as a task that an executor can run."""

from __future__ import annotations

import dataclasses
import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, LdcError, Scenarios, controller_class, register, registry
from ldctoolkit.arrays import IntArray
from ldctoolkit.law_checks import raised
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import Outcome, Run, Takeover, drive, drive_many
from ldctoolkit.simulation.loop import recorded_run
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import FailedRun, TaskResult
from studies.running.tasks import Done, Job, Task

_DEPARTURES = 6

_SAME = 1e-9
"""Of S: sums in another order, in a batch of another size, are no state."""

_SAME_COMPANION = 1e-6
"""Of the companions: peaks and rates magnify what S averages."""


def first_departures(takeover: Takeover) -> tuple[IntArray, Takeover]:
    """The first few departures that trigger: their row numbers (k,), and a takeover of them alone."""
    rows = np.sort(takeover.rows)[:_DEPARTURES]
    return rows, Takeover.build(takeover.scenarios.take(rows), takeover.setup, y_s=takeover.y_s)


def kept_state(
    columns: Sequence[str],
    values: npt.NDArray[np.float64],
    status: npt.NDArray[np.int8],
    failed_solves: npt.NDArray[np.int32],
    again: Sequence[Outcome],
) -> str:
    """A sentence if departures have other numbers when they are driven once more; empty if they do not."""
    scores = [numbers for outcome in again for numbers in (outcome.S, outcome.S_uncorrected)]
    second = [*scores, *(getattr(again[0].companions, name) for name in COMPANION_UNITS)]
    same = (status == again[0].status) & (failed_solves == again[0].failed_solves)
    for column, (name, numbers) in enumerate(zip(columns, second, strict=True)):
        most = _SAME_COMPANION if name in COMPANION_UNITS else _SAME
        same &= np.isclose(values[column], numbers, rtol=most, atol=most, equal_nan=True)
    if same.all():
        return ""
    i = int(np.argmin(same))
    return (
        "keeps state between runs: the same departure, driven twice, gave "
        f"S = {values[0, i]:.9g} m s and then {second[0][i]:.9g} m s; "
        "allowed: state that init makes and step returns"
    )


_TAKEOVERS_KEPT = 8

_JOBS_KEPT = 2

_WARM_LAWS = ("preview_proportional", "pid")
"""A law of each kind of loop: linear, and step by step."""

_lock = threading.Lock()
_warm: set[str] = set()

_NOT_OF_A_LAW = (KeyboardInterrupt, GeneratorExit)
"""What ends a study even where it comes out of a law."""

Key = tuple[float, Convention, bytes]


class Simulator:
    """Runs tasks of one job; keeps the last few takeovers, which designs of one threshold share.

    Every design of a `SteeringLaw` drives a few departures of its first piece once more, and fails if they do not give
    the numbers that are stored. So its fate does not depend on the order, the tasks or the workers, with one exception
    that no check can rule out: a law with hidden state of the whole process, which settles before this design runs or
    changes only after it, behaves here as what ran before in the same process made it.
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self._takeovers: OrderedDict[Key, Takeover] = OrderedDict()
        self._few: dict[Key, tuple[npt.NDArray[np.int64], Takeover]] = {}

    def takeover(self, y_s: float, convention: Convention, scenarios: Scenarios) -> Takeover:
        """The scenarios at their triggers."""
        key = _key(y_s, convention, scenarios)
        if key not in self._takeovers:
            while len(self._takeovers) >= _TAKEOVERS_KEPT:
                oldest, _ = self._takeovers.popitem(last=False)
                self._few.pop(oldest, None)
            self._takeovers[key] = Takeover.build(scenarios, self.job.setup.under(convention), y_s=y_s)
        self._takeovers.move_to_end(key)
        return self._takeovers[key]

    def run(self, task: Task) -> Done:
        """Every design of a task; one whose law raises, gives what no law may give, or keeps state, has failed."""
        started = time.perf_counter()
        room = _Room(task)
        reasons: dict[int, str] = {}
        for first, last in _same_threshold(task.designs):
            # what this raises is no fault of a law
            takeover = self.takeover(task.designs[first].y_s, task.convention, task.scenarios)
            try:
                self._together(room, takeover, first, last)
            except _NOT_OF_A_LAW:
                raise
            except BaseException:  # a controller may be anybody's code
                # which design it was is not known: one after the other, the one that raises is named
                for i in range(first, last):
                    self._alone(room, takeover, i, reasons)
            if task.piece == 0:
                for i in range(first, last):
                    if i not in reasons and room.law_seconds[i]:
                        self._steady(room, takeover, i, reasons)
        ran = [i for i in range(len(task.designs)) if i not in reasons]
        result = room.result(time.perf_counter() - started)
        failed = tuple(FailedRun((task.designs[i].id, task.convention), task.piece, why) for i, why in reasons.items())
        return Done(result if len(ran) == len(task.designs) else result.take(ran), failed)

    def uncontrolled(self, task: Task, status: EventStatus) -> TaskResult:
        """The recorded paths with a status, as what counts where a law could not be run; no law's code is called."""
        room = _Room(task)
        for i, design in enumerate(task.designs):
            takeover = self.takeover(design.y_s, task.convention, task.scenarios)
            room.put(i, recorded_run(takeover))
            room.status[i, takeover.rows] = status
        return room.result(0.0)

    def _together(self, room: _Room, takeover: Takeover, first: int, last: int) -> None:
        """Designs of one threshold in one go over the scenarios, as far as their laws allow."""
        convention = room.task.convention
        controllers = [design.controller(convention) for design in room.task.designs[first:last]]
        # all of them before any is taken in: what one raises leaves the others as they were
        for i, run in zip(range(first, last), list(drive_many(controllers, takeover, threads=1)), strict=True):
            room.put(i, run)

    def _alone(self, room: _Room, takeover: Takeover, i: int, reasons: dict[int, str]) -> None:
        try:
            self._together(room, takeover, i, i + 1)
        except _NOT_OF_A_LAW:
            raise
        except BaseException as error:
            reasons[i] = raised(error)

    def _steady(self, room: _Room, takeover: Takeover, i: int, reasons: dict[int, str]) -> None:
        """Drive a few departures once more: they have to give the same numbers."""
        task, design = room.task, room.task.designs[i]
        key = _key(design.y_s, task.convention, task.scenarios)
        if key not in self._few:
            self._few[key] = first_departures(takeover)
        rows, few = self._few[key]
        if not rows.size:
            return
        try:
            again = drive(design.controller(task.convention), few, threads=1)
            reason = kept_state(*room.some(i, rows), self._outcomes(again))
            if reason:  # state, or a law that minds its neighbours? all of them once more tell
                again = drive(design.controller(task.convention), takeover, threads=1)
                reason = kept_state(*room.some(i, np.arange(room.rows)), self._outcomes(again))
        except _NOT_OF_A_LAW:
            raise
        except BaseException as error:  # it did not raise the first time
            reason = f"driven a second time: {raised(error)}"
        if reason:
            reasons[i] = reason

    def _outcomes(self, run: Run) -> list[Outcome]:
        return [run.outcome(window) for window in self.job.windows]


class _Room:
    """Room for the results of a task."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.rows = task.rows.size
        self.columns = task.job.columns
        k = len(task.designs)
        self.values = np.empty((len(self.columns), k, self.rows))
        self.status = np.empty((k, self.rows), dtype=np.int8)
        self.failed_solves = np.empty((k, self.rows), dtype=np.int32)
        self.law_seconds = np.zeros(k)
        self.commands = np.zeros(k, dtype=np.int64)
        self._takeover: Takeover | None = None
        self._recorded = np.zeros((0, 0))
        self._not_driven = np.zeros(0, dtype=np.int8)
        self._commands = 0

    def put(self, i: int, run: Run) -> None:
        """Results of one design; two windows are two ways to score the same run."""
        over, windows = run.takeover, self.task.job.windows
        if over is not self._takeover:  # designs of one threshold share what they do not change
            self._takeover, self._recorded = over, run.columns(windows)
            self._not_driven = np.where(over.valid, EventStatus.NEVER_TRIGGERED, EventStatus.INVALID).astype(np.int8)
            # scenarios times samples that there is a command for; one that diverges counts as if driven to the end
            self._commands = int(np.sum(over.steps))
        values, rows = self.values[:, i], over.rows
        values[:] = self._recorded
        run.fill(values, windows)
        self.status[i] = self._not_driven
        self.status[i, rows] = run.status
        if not np.isfinite(values[: 2 * len(windows)]).all():
            driven = self.status[i] != EventStatus.INVALID
            if not np.isfinite(values[: 2 * len(windows), driven]).all():
                raise LdcError("S is not finite in some scenario")
        self.failed_solves[i] = 0
        self.failed_solves[i, rows] = run.failed_solves
        self.law_seconds[i] = run.law_seconds
        self.commands[i] = self._commands

    def some(
        self, i: int, rows: npt.NDArray[np.int64]
    ) -> tuple[tuple[str, ...], npt.NDArray[np.float64], npt.NDArray[np.int8], npt.NDArray[np.int32]]:
        """Columns, values, status and failed solves of one design in some scenarios."""
        return self.columns, self.values[:, i, rows], self.status[i, rows], self.failed_solves[i, rows]

    def result(self, seconds: float) -> TaskResult:
        """All of it."""
        keys = tuple((design.id, self.task.convention) for design in self.task.designs)
        return TaskResult(
            keys,
            self.task.rows,
            self.values,
            self.status,
            self.failed_solves,
            self.law_seconds,
            self.commands,
            seconds,
        )


def _key(y_s: float, convention: Convention, scenarios: Scenarios) -> Key:
    return y_s, convention, scenarios.index.tobytes()


def _same_threshold(designs: tuple[Design, ...]) -> list[tuple[int, int]]:
    """Stretches of designs with the same y_s."""
    y_s = np.array([design.y_s for design in designs])
    ends = [0, *(np.flatnonzero(np.diff(y_s)) + 1).tolist(), len(designs)]
    return list(itertools.pairwise(ends))


@dataclasses.dataclass(frozen=True, eq=False)
class SimulationTask(Task):
    """A `Task` that an executor can run. Tasks of one job in one place share their simulator, hence takeovers."""

    @property
    def time_limit(self) -> float:
        """Of the job [s]."""
        return self.job.time_limit

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Make the job's own controllers known, and load the compiled loops: the time limit counts a law's own time."""
        simulators = _simulators(kept)
        if self.job.token not in simulators:
            while len(simulators) >= _JOBS_KEPT:
                del simulators[next(iter(simulators))]
            _learn(self.job.laws)
        _warm_up(_simulator(simulators, self.job), self)

    def run(self, kept: dict[str, Any]) -> Done:
        """Drive the designs."""
        return _simulator(_simulators(kept), self.job).run(self)


def _simulators(kept: dict[str, Any]) -> dict[str, Simulator]:
    simulators: dict[str, Simulator] = kept.setdefault("simulators", {})
    return simulators


def _simulator(simulators: dict[str, Simulator], job: Job) -> Simulator:
    if job.token not in simulators:
        simulators[job.token] = Simulator(job)
    return simulators[job.token]


def _learn(laws: bytes) -> None:
    """Make controllers known that no installed package offers."""
    if not laws:
        return
    import cloudpickle

    for law in cloudpickle.loads(laws):
        with _lock:
            registry.forget(law.name)  # of an earlier job
            register(law)


def _warm_up(chosen: Simulator, task: Task) -> None:
    if task.job.token in _warm or not task.job.time_limit:
        return
    takeover = chosen.takeover(task.designs[0].y_s, task.convention, task.scenarios.take([0]))
    for name in _WARM_LAWS:
        drive(controller_class(name)(), takeover, threads=1)
    _warm.add(task.job.token)
