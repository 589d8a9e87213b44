"""Tasks of a run: which designs on which scenarios, how large, and what a worker does with one."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

import ldctoolkit.registry as registry
from ldctoolkit.arrays import IntArray
from ldctoolkit.control import EventStatus, LinearLaw, SteeringLaw
from ldctoolkit.errors import LdcError
from ldctoolkit.law_checks import declared_law, raised
from ldctoolkit.metrics import METRIC_UNITS, UserMetric
from ldctoolkit.registry import controller_class
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Run, Takeover, Window, drive, drive_many
from ldctoolkit.simulation.loop import recorded_run
from ldctoolkit.simulation.sampled_paths import PathSampler
from ldctoolkit.vehicle import Convention

from ..design import NO_CONTROL, Design
from ..results import FailedRun, TaskResult
from .dispatch import Work, new_number


@dataclasses.dataclass(frozen=True)
class Job:
    """What all designs of a study share."""

    token: str  # tells one job from another
    setup: Setup
    window: Window
    laws: bytes = b""  # controller classes that no installed package offers; empty where there are none
    time_limit: float = 0.0  # [s]: of one task; 0 for none
    metrics: bytes | tuple[UserMetric, ...] = ()  # of a designer; pickled for another process


@dataclasses.dataclass(frozen=True, eq=False)
class Done:
    """What came out of a task."""

    result: TaskResult | None  # of the designs that ran; None where none did
    failed: tuple[FailedRun, ...] = ()  # the others
    seconds: float = 0.0  # [s] wall time of the whole task


_SCORES = 2  # first columns of a result: S and S_uncorrected
_TOOLKIT = _SCORES + len(METRIC_UNITS)  # columns before those of designers' metrics
_TAKEOVERS = 8  # of a simulator
_JOBS = 2  # of a process

_lock = threading.Lock()
_warm: set[tuple[str, str]] = set()  # jobs and laws


class Simulator:
    """Runs tasks of one job; keeps the last few takeovers and their paths, which designs of one threshold share."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._metrics: tuple[UserMetric, ...] = (
            unpickled(job.metrics) if isinstance(job.metrics, bytes) else job.metrics
        )
        self._samplers: OrderedDict[tuple[float, bytes], PathSampler] = OrderedDict()

    def sampler(self, y_s: float, scenarios: Scenarios) -> PathSampler:
        """The scenarios at their triggers, and what measures designers' metrics on them."""
        key = y_s, scenarios.index.tobytes()
        if key not in self._samplers:
            while len(self._samplers) >= _TAKEOVERS:
                self._samplers.popitem(last=False)
            over = Takeover.build(scenarios, self.job.setup, y_s=y_s)
            self._samplers[key] = PathSampler(over, self._metrics)
        self._samplers.move_to_end(key)
        return self._samplers[key]

    def run(self, task: Task) -> Done:
        """Every design of a task; one whose law raises, or gives what no law may give, has failed."""
        started = time.perf_counter()
        room = _Room(task, len(self._metrics))
        reasons: dict[int, str] = {}
        # stretches of designs with the same threshold; each alone where its paths are kept
        alone, designs = bool(self._metrics), task.designs
        ends = [i for i in range(1, len(designs)) if alone or designs[i].y_s != designs[i - 1].y_s]
        for first, last in itertools.pairwise([0, *ends, len(task.designs)]):
            # what this raises is no fault of a law
            sampler = self.sampler(task.designs[first].y_s, task.scenarios)
            group = task.designs[first:last]
            runs = drive_each(group, sampler.over, self.job.setup.convention, paths=alone)
            for i, run in zip(range(first, last), runs, strict=True):
                if isinstance(run, str):
                    reasons[i] = run
                    continue
                try:
                    room.put(i, run, sampler)
                except LdcError as error:
                    reasons[i] = raised(error)
        ran = [i for i in range(len(task.designs)) if i not in reasons]
        failed = tuple(FailedRun(task.designs[i].id, task.batch, why) for i, why in reasons.items())
        result = room.result() if not reasons else room.result().take(ran) if ran else None
        return Done(result, failed, time.perf_counter() - started)

    def uncontrolled(self, task: Task, status: EventStatus) -> TaskResult:
        """The recorded paths with a status, as what counts where a law could not be run; no law's code is called."""
        room = _Room(task, len(self._metrics))
        for i, design in enumerate(task.designs):
            sampler = self.sampler(design.y_s, task.scenarios)
            room.put(i, recorded_run(sampler.over), sampler)
            room.status[i, sampler.over.rows] = status
        return room.result()


def drive_each(
    designs: Sequence[Design], takeover: Takeover, convention: Convention, *, paths: bool = False
) -> list[Run | str]:
    """Drive designs of one threshold in one go over the scenarios; in place of a run the error that its law raised."""
    try:
        return list(drive_many([design.controller(convention) for design in designs], takeover, paths=paths, threads=1))
    except (KeyboardInterrupt, GeneratorExit):  # end a study even where a law raises them
        raise
    except BaseException as error:  # a controller may be third-party code
        if len(designs) == 1:
            return [raised(error)]
        # one after the other, which tells the design that raises
        return [run for design in designs for run in drive_each([design], takeover, convention, paths=paths)]


class _Room:
    """Room for the results of a task."""

    def __init__(self, task: Task, metrics: int) -> None:
        self.task = task
        self.rows = task.rows.size
        k = len(task.designs)
        self.values = np.empty((_TOOLKIT + metrics, k, self.rows))
        self.status = np.empty((k, self.rows), dtype=np.int8)
        self.failed_solves = np.empty((k, self.rows), dtype=np.int32)
        self.law_seconds = np.zeros(k)
        self.commands = np.zeros(k, dtype=np.int64)
        self._takeover: Takeover | None = None
        self._recorded = np.zeros((0, 0))
        self._not_driven = np.zeros(0, dtype=np.int8)
        self._commands = 0

    def put(self, i: int, run: Run, sampler: PathSampler) -> None:
        """Results of one design."""
        over, windows = run.takeover, (self.task.job.window,)
        if over is not self._takeover:  # designs of one threshold share what they do not change
            self._takeover, self._recorded = over, run.columns(windows)
            self._not_driven = np.where(over.valid, EventStatus.NEVER_TRIGGERED, EventStatus.INVALID).astype(np.int8)
            # scenarios times samples that there is a command for; one that diverges counts as if driven to the end
            self._commands = int(np.sum(over.steps))
        values, rows = self.values[:, i], over.rows
        values[:_TOOLKIT] = self._recorded
        run.fill(values, windows)
        values[_TOOLKIT:] = sampler.values(run)
        self.status[i] = self._not_driven
        self.status[i, rows] = run.status
        if not np.isfinite(values[:_SCORES]).all():
            driven = self.status[i] != EventStatus.INVALID
            if not np.isfinite(values[:_SCORES, driven]).all():
                raise LdcError("S", "not finite in some scenario")
        self.failed_solves[i] = 0
        self.failed_solves[i, rows] = run.failed_solves
        self.law_seconds[i] = run.law_seconds
        self.commands[i] = self._commands

    def result(self) -> TaskResult:
        """The results of all designs."""
        ids, rows = tuple(design.id for design in self.task.designs), self.task.rows
        return TaskResult(ids, rows, self.values, self.status, self.failed_solves, self.law_seconds, self.commands)


@dataclasses.dataclass(frozen=True, eq=False)
class Task(Work):
    """Some designs on some scenarios. Tasks of one job in one process share their simulator, hence takeovers."""

    job: Job
    designs: tuple[Design, ...]  # k designs of one law, by rising y_s
    rows: IntArray  # (m,): row numbers of the scenarios in the study
    scenarios: Scenarios  # these m scenarios
    batch: int  # number of the batch that they are, or a part of
    batch_size: int  # number of scenarios of the whole batch

    @property
    def runs(self) -> int:
        """Scenario runs: designs times scenarios."""
        return len(self.designs) * self.rows.size

    @property
    def time_limit(self) -> float:
        """The limit of the job [s]."""
        return self.job.time_limit

    def make_ready(self, cache: dict[str, Any]) -> None:
        """Make the job's own controllers known, and load the compiled loops: the time limit counts a law's own time."""
        simulators = _simulators(cache)
        if self.job.token not in simulators:
            while len(simulators) >= _JOBS:
                del simulators[next(iter(simulators))]
            learn(self.job.laws)
        law = self.designs[0].law
        if self.time_limit and (self.job.token, law) not in _warm:
            load_loops({law}, self.scenarios, self.job.setup, self.designs[0].y_s)
            _warm.add((self.job.token, law))

    def run(self, cache: dict[str, Any]) -> Done:
        """Drive the designs."""
        simulators = _simulators(cache)
        if self.job.token not in simulators:
            simulators[self.job.token] = Simulator(self.job)
        return simulators[self.job.token].run(self)

    def halves(self) -> tuple[Task, ...]:
        """First by designs, then by scenarios; none for one run."""
        if len(self.designs) > 1:
            middle = len(self.designs) // 2
            return self._piece(designs=self.designs[:middle]), self._piece(designs=self.designs[middle:])
        if self.rows.size > 1:
            halves = np.array_split(np.arange(self.rows.size), 2)
            return tuple(self._piece(rows=self.rows[half], scenarios=self.scenarios.take(half)) for half in halves)
        return ()

    def harmless(self) -> Task:
        """One scenario without control."""
        passive = Design.from_gains(NO_CONTROL, self.designs[0].y_s, {})
        return self._piece(designs=(passive,), rows=self.rows[:1], scenarios=self.scenarios.take([0]), batch_size=1)

    def _piece(self, **changes: Any) -> Task:
        return dataclasses.replace(self, number=new_number(), **changes)


def _simulators(cache: dict[str, Any]) -> dict[str, Simulator]:
    simulators: dict[str, Simulator] = cache.setdefault("simulators", {})
    return simulators


def learn(laws: bytes) -> None:
    """Make controllers known that another process has."""
    if laws:
        with _lock:
            registry.learn(unpickled(laws))


def unpickled(content: bytes) -> Any:
    """What another process pickled by value."""
    import cloudpickle

    return cloudpickle.loads(content)


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
            gains = {"horizon": 3, "always_solve": True} if name == "linear_mpc" else {}  # also what prepares its QPs
            drive(controller_class(name)(**gains), takeover, threads=1)
