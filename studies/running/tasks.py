"""Tasks of a run: which designs on which scenarios, how large, and what a worker does with one."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import Any, Final, Self

import numpy as np

import ldctoolkit.registry as registry
from ldctoolkit.arrays import IntArray
from ldctoolkit.control import EventStatus, LinearLaw, SteeringLaw
from ldctoolkit.errors import LdcError
from ldctoolkit.law_checks import declared_law, raised
from ldctoolkit.metrics import METRIC_UNITS
from ldctoolkit.registry import controller_class
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Run, Takeover, Window, drive, drive_many
from ldctoolkit.simulation.loop import recorded_run

from ..design import Design
from ..results import FailedRun, TaskResult
from .executors.processes import Ended, Executor, Fault, Work

_STRIKES: Final = 2
"""A task that has ended its worker so often is cut to find the scenario at fault: once may be bad luck."""

_MOST_SCENARIOS: Final = 3  # scenarios of a design that may end or stop a worker; with one more the design has failed

_MOST_LOST: Final = 25
"""Times in a row that tasks are lost which are not to blame, before it is plain that workers cannot live here."""

_WORDS: Final[dict[Fault, str]] = {"died": "ends its worker process", "late": "takes longer than the time limit"}


class Faults:
    """What is known of tasks that ended their workers."""

    def __init__(self) -> None:
        self._strikes: dict[int, int] = {}
        self._scenarios: dict[str, dict[int, Fault]] = {}
        self._lost = 0
        self.workers_live = False

    def guilty(self, task: Work, fault: Fault, *, certain: bool) -> bool:
        """Whether a task has to be cut, after one more end of its worker."""
        strikes = self._strikes[task.number] = self._strikes.get(task.number, 0) + 1
        return certain and (fault == "late" or strikes >= _STRIKES)

    def inherit(self, half: Task) -> None:
        """Half of a guilty task is under suspicion from the start."""
        self._strikes[half.number] = _STRIKES - 1

    def same_strikes(self, task: Task, other: Task) -> None:
        """Another task, with some of the designs, is as suspect as this one."""
        self._strikes[other.number] = self._strikes.get(task.number, 0)

    def record(self, id: str, row: int, fault: Fault) -> str:
        """Note a scenario at fault; a sentence if the design has failed with that."""
        rows = self._scenarios.setdefault(id, {})
        rows[row] = fault
        if len(rows) <= _MOST_SCENARIOS:
            return ""
        named = ", ".join(f"{row} ({_WORDS[kind]})" for row, kind in sorted(rows.items()))
        return f"ends or stops its worker process in scenarios {named}"

    def came_back(self, came: Iterable[Ended]) -> None:
        """Count whether tasks were lost that are not to blame: once, however many a broken pool held."""
        if not any(ended.done is None and ended.fault is None for ended in came):
            return
        self._lost += 1
        if self._lost >= _MOST_LOST:
            raise LdcError(
                "worker processes end before they have done anything (out of memory, or killed from outside); what was "
                "stored is kept: run it again, with fewer workers if memory was short"
            )

    def check_workers(self, executor: Executor, harmless: Work) -> None:
        """Where nothing has ended well yet, see whether a worker lives at all; nothing else may be under way."""
        if self.workers_live:
            return
        executor.start(harmless)
        while not (came := executor.wait()):
            pass
        if came[0].done is None:
            raise LdcError("worker processes end whatever they run; what was stored is kept")
        self.ended_well()

    def ended_well(self) -> None:
        """A task gave its result."""
        self._lost = 0
        self.workers_live = True


@dataclasses.dataclass(frozen=True, eq=False)
class ScenarioBatch:
    """Scenarios that are driven as one batch."""

    number: int  # its place among the batches of its size
    rows: IntArray  # (m,): row numbers of the scenarios, rising


def batches(n: int, size: int) -> tuple[ScenarioBatch, ...]:
    """All n scenarios in stretches of at most `size`."""
    stretches = np.array_split(np.arange(n), -(-n // size))
    return tuple(ScenarioBatch(number, rows) for number, rows in enumerate(stretches))


_SCORES = 2  # first columns of a result: S and S_uncorrected
_numbers = itertools.count()


@dataclasses.dataclass(frozen=True)
class Job:
    """What all designs of a study share."""

    token: str  # tells one job from another
    setup: Setup
    window: Window
    laws: bytes = b""  # controller classes that no installed package offers; empty where there are none
    time_limit: float = 0.0  # [s]: of one task; 0 for none


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Some designs on some scenarios."""

    job: Job
    designs: tuple[Design, ...]  # k designs of one law, by rising y_s
    rows: IntArray  # (m,): row numbers of the scenarios in the study
    scenarios: Scenarios  # these m scenarios
    batch: int  # number of the batch that they are, or a part of
    batch_size: int  # number of scenarios of the whole batch
    number: int = dataclasses.field(default_factory=lambda: next(_numbers))  # of this task in this process

    @property
    def whole(self) -> bool:
        """Whether the scenarios are the whole batch."""
        return self.rows.size == self.batch_size

    @property
    def runs(self) -> int:
        """Scenario runs: designs times scenarios."""
        return len(self.designs) * self.rows.size

    def halves(self) -> tuple[Self, ...]:
        """Two tasks that together are this one, first by designs, then by scenarios; none for one run."""
        if len(self.designs) > 1:
            middle = len(self.designs) // 2
            return tuple(self.only(part) for part in (self.designs[:middle], self.designs[middle:]))
        if self.rows.size > 1:
            middle = self.rows.size // 2
            places = np.split(np.arange(self.rows.size), [middle])
            return tuple(self._with(rows=self.rows[at], scenarios=self.scenarios.take(at)) for at in places)
        return ()

    def only(self, designs: tuple[Design, ...]) -> Self:
        """The same with some of the designs."""
        return self._with(designs=designs)

    def _with(self, **changes: object) -> Self:
        return dataclasses.replace(self, number=next(_numbers), **changes)  # type: ignore[arg-type]


@dataclasses.dataclass(frozen=True, eq=False)
class Done:
    """What came out of a task."""

    result: TaskResult | None  # of the designs that ran; None where none did
    failed: tuple[FailedRun, ...] = ()  # the others
    seconds: float = 0.0  # [s] wall time of the whole task


_TAKEOVERS_KEPT = 8

_JOBS_KEPT = 2

_lock = threading.Lock()
_warm: set[tuple[str, str]] = set()  # jobs and laws

_NOT_OF_A_LAW = (KeyboardInterrupt, GeneratorExit)  # what ends a study even where it comes out of a law

Key = tuple[float, bytes]


class Simulator:
    """Runs tasks of one job; keeps the last few takeovers, which designs of one threshold share."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._takeovers: OrderedDict[Key, Takeover] = OrderedDict()

    def takeover(self, y_s: float, scenarios: Scenarios) -> Takeover:
        """The scenarios at their triggers."""
        key = _key(y_s, scenarios)
        if key not in self._takeovers:
            while len(self._takeovers) >= _TAKEOVERS_KEPT:
                self._takeovers.popitem(last=False)
            self._takeovers[key] = Takeover.build(scenarios, self.job.setup, y_s=y_s)
        self._takeovers.move_to_end(key)
        return self._takeovers[key]

    def run(self, task: Task) -> Done:
        """Every design of a task; one whose law raises, or gives what no law may give, has failed."""
        started = time.perf_counter()
        room = _Room(task)
        reasons: dict[int, str] = {}
        for first, last in _same_threshold(task.designs):
            # what this raises is no fault of a law
            takeover = self.takeover(task.designs[first].y_s, task.scenarios)
            try:
                self._together(room, takeover, first, last)
            except _NOT_OF_A_LAW:
                raise
            except BaseException:  # a controller may be third-party code
                # which design it was is not known: one after the other, the one that raises is named
                for i in range(first, last):
                    self._alone(room, takeover, i, reasons)
        ran = [i for i in range(len(task.designs)) if i not in reasons]
        failed = tuple(FailedRun(task.designs[i].id, task.batch, why) for i, why in reasons.items())
        result = room.result() if not reasons else room.result().take(ran) if ran else None
        return Done(result, failed, time.perf_counter() - started)

    def uncontrolled(self, task: Task, status: EventStatus) -> TaskResult:
        """The recorded paths with a status, as what counts where a law could not be run; no law's code is called."""
        room = _Room(task)
        for i, design in enumerate(task.designs):
            takeover = self.takeover(design.y_s, task.scenarios)
            room.put(i, recorded_run(takeover))
            room.status[i, takeover.rows] = status
        return room.result()

    def _together(self, room: _Room, takeover: Takeover, first: int, last: int) -> None:
        """Designs of one threshold in one go over the scenarios, as far as their laws allow."""
        convention = self.job.setup.convention
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


class _Room:
    """Room for the results of a task."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.rows = task.rows.size
        k = len(task.designs)
        self.values = np.empty((_SCORES + len(METRIC_UNITS), k, self.rows))
        self.status = np.empty((k, self.rows), dtype=np.int8)
        self.failed_solves = np.empty((k, self.rows), dtype=np.int32)
        self.law_seconds = np.zeros(k)
        self.commands = np.zeros(k, dtype=np.int64)
        self._takeover: Takeover | None = None
        self._recorded = np.zeros((0, 0))
        self._not_driven = np.zeros(0, dtype=np.int8)
        self._commands = 0

    def put(self, i: int, run: Run) -> None:
        """Results of one design."""
        over, windows = run.takeover, (self.task.job.window,)
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
        if not np.isfinite(values[:_SCORES]).all():
            driven = self.status[i] != EventStatus.INVALID
            if not np.isfinite(values[:_SCORES, driven]).all():
                raise LdcError("S is not finite in some scenario")
        self.failed_solves[i] = 0
        self.failed_solves[i, rows] = run.failed_solves
        self.law_seconds[i] = run.law_seconds
        self.commands[i] = self._commands

    def result(self) -> TaskResult:
        """All of it."""
        ids, rows = tuple(design.id for design in self.task.designs), self.task.rows
        return TaskResult(ids, rows, self.values, self.status, self.failed_solves, self.law_seconds, self.commands)


def _key(y_s: float, scenarios: Scenarios) -> Key:
    return y_s, scenarios.index.tobytes()


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
            learn(self.job.laws)
        _warm_up(self.job, self)

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


def learn(laws: bytes) -> None:
    """Make controllers known that another process has."""
    if not laws:
        return
    import cloudpickle

    with _lock:
        registry.learn(cloudpickle.loads(laws))


def _warm_up(job: Job, task: Task) -> None:
    key = job.token, task.designs[0].law
    if key not in _warm and job.time_limit:
        load_loops({key[1]}, task.scenarios, job.setup, task.designs[0].y_s)
        _warm.add(key)


def load_loops(laws: Iterable[str], scenarios: Scenarios, setup: Setup, y_s: float) -> None:
    """Load the compiled loops that some laws need, and compile those that are not on disk; no code of a user runs."""
    names: set[str] = set()
    for law in laws:
        kind = declared_law(controller_class(law))  # a law that declares nothing may be of either kind
        names |= {"preview_proportional"} if kind is None or issubclass(kind, LinearLaw) else set()
        # linear MPC has a loop of its own beside
        names |= {law if law == "linear_mpc" else "pid"} if kind is None or issubclass(kind, SteeringLaw) else set()
    order = np.argsort(scenarios.v_mean, kind="stable")
    ends = np.unique([*order[:8], *order[-8:]])  # the slowest may need another loop than the fastest
    with contextlib.suppress(LdcError):  # who needs these scenarios and this plant says what is wrong with them
        takeover = Takeover.build(scenarios.take(ends), setup, y_s=y_s)
        for name in sorted(names):
            drive(controller_class(name)(), takeover, threads=1)
