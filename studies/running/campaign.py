"""A campaign: tasks sent to an executor in order, what comes back stored, and progress shown."""

import contextlib
import dataclasses
import hashlib
import json
import sys
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, TextIO

import cloudpickle
import numpy as np

import ldctoolkit.compiling as compiling
import ldctoolkit.registry as registry
from ldctoolkit.code_content import content_of, modules_of
from ldctoolkit.control import Controller, EventStatus
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.scenarios import Scenarios

from ..design import NO_CONTROL, Design
from ..results import FailedRun, TaskResult
from ..storage.run_table import RunTable
from ..storage.store import Store
from ..study_file import Study
from .executors.processes import Ended, Executor, Fault
from .tasks import Done, Faults, Job, ScenarioBatch, SimulationTask, Simulator, Task, batches, load_loops

_LINE_EVERY = 1.0  # seconds between lines


class Progress:
    """What a run reports to; this one shows nothing."""

    def stage(self, name: str, total: int) -> None:
        """A new stage of so many scenario runs begins; the one before is over."""

    def advance(self, runs: int) -> None:
        """So many more scenario runs are done."""

    def phase(self, name: str) -> None:
        """What takes its time between two stages."""

    @contextlib.contextmanager
    def compiling(self, text: str) -> Iterator[None]:
        """Loops are compiled while the block runs."""
        self.phase(text)
        yield

    def close(self) -> None:
        """Nothing comes any more."""


class Lines(Progress):
    """One JSON object a line: stage, scenario runs done and in all, rate and seconds left; or the name of a phase."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._name, self._total, self._done = "", 0, 0
        self._phases: set[str] = set()
        self._started = self._reported = time.monotonic()

    def phase(self, name: str) -> None:
        """Write its name, the first time."""
        if name not in self._phases:
            self._phases.add(name)
            self._write({"event": "phase", "phase": name})

    def stage(self, name: str, total: int) -> None:
        """Write the first line of a stage."""
        self._name, self._total, self._done = name, total, 0
        self._started = time.monotonic()
        self._report()

    def advance(self, runs: int) -> None:
        """Write a line if the last one is old, or this is the stage's last."""
        self._done += runs
        if self._done >= self._total or time.monotonic() - self._reported > _LINE_EVERY:
            self._report()

    def _report(self) -> None:
        now = time.monotonic()
        seconds = now - self._started
        rate = self._done / seconds if self._done and seconds > 0 else None
        self._reported = now
        self._write({
            "event": "progress",
            "stage": self._name,
            "done": self._done,
            "total": self._total,
            "runs_per_s": None if rate is None else round(rate, 1),
            "seconds_left": None if rate is None else round((self._total - self._done) / rate, 1),
        })  # fmt: skip

    def _write(self, line: dict[str, Any]) -> None:
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()


class Bar(Progress):
    """A bar on stderr with the rate and the time left."""

    def __init__(self) -> None:
        from rich import progress
        from rich.console import Console

        self._bar: Any = progress.Progress(
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.TaskProgressColumn(),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._bar.start()
        self._task: Any = None
        self._done, self._started = 0, time.monotonic()

    def stage(self, name: str, total: int) -> None:
        """Begin a bar; without a total it pulses."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._done, self._started = 0, time.monotonic()
        self._task = self._bar.add_task(name, total=total or None, rate="")

    def phase(self, name: str) -> None:
        """Show the name."""
        self.stage(name, 0)

    @contextlib.contextmanager
    def compiling(self, text: str) -> Iterator[None]:
        """A second line that moves."""
        task = self._bar.add_task(text, total=None, rate="")
        yield
        self._bar.remove_task(task)

    def advance(self, runs: int) -> None:
        """Move the bar."""
        self._done += runs
        rate = self._done / max(time.monotonic() - self._started, 1e-3)
        self._bar.update(self._task, completed=self._done, rate=f"{rate:,.0f} scenario runs/s")

    def close(self) -> None:
        """Take the bar away."""
        self._bar.stop()


@contextlib.contextmanager
def displayed(progress: bool | Progress | None) -> Iterator[Progress]:
    """What a run reports to: a bar if requested, or, with None, where stderr is a terminal; it shows compiling too."""
    show = sys.stderr.isatty() if progress is None else progress
    shown = (Bar() if show else Progress()) if isinstance(show, bool) else show
    # where there is no terminal, compiling takes a line, which was not refused
    elsewhere = contextlib.nullcontext() if progress is None and not show else compiling.shown_by(shown.compiling)
    with contextlib.closing(shown), elsewhere:
        yield shown


class InOrder:
    """Holds results back until those of all earlier batches of the same design are there.

    Of a design that fails on a batch, exactly the batches before it are handed on, whatever ran at the same time.
    """

    def __init__(self) -> None:
        self._wanted: dict[str, deque[int]] = defaultdict(deque)
        self._early: dict[str, dict[int, TaskResult]] = {}

    def expect(self, ids: Iterable[str], batch: int) -> None:
        """A batch of some designs will come, after those that were announced before."""
        for id in ids:
            self._wanted[id].append(batch)

    def take(self, batch: int, result: TaskResult) -> Iterator[TaskResult]:
        """Results that can be handed on, now that these are there."""
        now = [i for i, id in enumerate(result.ids) if self._wanted[id] and self._wanted[id][0] == batch]
        arrived = set(now)
        for i, id in enumerate(result.ids):
            if i not in arrived:
                self._early.setdefault(id, {})[batch] = result.take([i])
        if not now:
            return
        yield result if len(now) == len(result.ids) else result.take(now)
        for i in now:
            id = result.ids[i]
            wanted, early = self._wanted[id], self._early.get(id, {})
            wanted.popleft()
            while wanted and wanted[0] in early:
                yield early.pop(wanted.popleft())


class Merge:
    """Keeps results of parts of batches until the rest is there."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, int], list[TaskResult]] = {}

    def add(self, task: Task, result: TaskResult) -> TaskResult | None:
        """Take in results of one design on a part of a batch; the whole batch, once it is complete."""
        key = (result.ids[0], task.batch)
        parts = self._parts.setdefault(key, [])
        parts.append(result)
        if sum(part.rows.size for part in parts) < task.batch_size:
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

_FIRST_RUNS: Final = 2000  # scenario runs in the first task of a law, before its pace is known
_MOST_RUNS: Final = 400_000  # scenario runs in a task at most: results are in memory on both sides
_PREFETCH: Final = 2  # tasks a worker that are under way or wait in the executor

STATUS_OF: Final[dict[Fault, EventStatus]] = {"died": EventStatus.CRASHED, "late": EventStatus.TIMED_OUT}
"""What becomes of the scenario at fault."""


class WorkQueue:
    """Designs of one law that still have to run on one batch of scenarios."""

    def __init__(self, batch: ScenarioBatch, designs: Iterable[Design]) -> None:
        self.batch = batch
        # designs of one threshold share a takeover
        self.designs = deque(sorted(designs, key=lambda design: design.y_s))

    @property
    def law(self) -> str:
        """The law of all of them."""
        return self.designs[0].law


class Dispatcher:
    """Runs work queues of designs through an executor."""

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
        self._failed: dict[str, int] = {}

    def run(self, queues: Sequence[WorkQueue]) -> None:
        """Run everything; returns when nothing is left."""
        for queue in queues:
            self._in_order.expect((design.id for design in queue.designs), queue.batch.number)
        tasks = self._tasks(deque(queues))
        following = next(tasks, None)
        while following or self._again or self._alone or self._under_way:
            if self._alone:
                # a task that may have killed its worker runs with no other beside it, so that there is no doubt
                if not self._under_way:
                    self._start(self._alone.popleft())
            else:
                most = 1 if self._executor.workers == 1 else _PREFETCH * self._executor.workers
                while self._under_way < most and (self._again or following):
                    if self._again:
                        self._start(self._again.popleft())
                    elif following:
                        self._start(following)
                        following = next(tasks, None)
            came = self._executor.wait()
            self._faults.came_back(came)
            for ended in came:
                self._under_way -= 1
                self._take(ended)

    def _tasks(self, queues: deque[WorkQueue]) -> Iterator[SimulationTask]:
        while queues:
            queue = queues[0]
            if not queue.designs:
                queues.popleft()
                continue
            count = self._block_size or self._fitting(queue)
            designs: list[Design] = []
            while queue.designs and len(designs) < count:
                design = queue.designs.popleft()
                # a design that has failed on an earlier batch is out
                if self._failed.get(design.id, queue.batch.number) >= queue.batch.number:
                    designs.append(design)
            if designs:
                rows = queue.batch.rows
                scenarios = self._scenarios.take(rows)
                yield SimulationTask(self._job, tuple(designs), rows, scenarios, queue.batch.number, rows.size)

    def _fitting(self, queue: WorkQueue) -> int:
        """Designs that take about half a second."""
        pace = self._seconds_a_run.get(queue.law)
        runs = _FIRST_RUNS if pace is None else min(_MOST_RUNS, SECONDS_A_TASK / max(pace, 1e-9))
        return max(1, int(runs / queue.batch.rows.size))

    def _start(self, task: SimulationTask) -> None:
        self._under_way += 1
        self._executor.start(task)

    def _take(self, ended: Ended) -> None:
        task: SimulationTask = ended.task
        if ended.done is not None:
            self._faults.ended_well()
            # the last pace counts: the first task of a process also loads and compiles
            self._seconds_a_run[task.designs[0].law] = ended.done.seconds / task.runs
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
        id = task.designs[0].id
        reason = self._faults.record(id, int(task.rows[0]), fault)
        if reason:
            self._faults.check_workers(self._executor, self._harmless(task))
            self._fail(FailedRun(id, task.batch, reason))
            self._alone = deque(self._without(id, self._alone))
            self._again = deque(self._without(id, self._again))
        else:
            self._give(task, Done(Simulator(self._job).uncontrolled(task, STATUS_OF[fault])))

    def _without(self, id: str, tasks: Iterable[SimulationTask]) -> Iterator[SimulationTask]:
        """The same tasks without a design that has failed; those of its fellows are as suspect as before."""
        for task in tasks:
            rest = tuple(design for design in task.designs if design.id != id)
            if len(rest) == len(task.designs):
                yield task
            elif rest:
                fewer = task.only(rest)
                self._faults.same_strikes(task, fewer)
                yield fewer

    def _harmless(self, task: SimulationTask) -> SimulationTask:
        """A task without control, on one scenario."""
        passive = Design.from_gains(NO_CONTROL, task.designs[0].y_s, {})
        return dataclasses.replace(
            task.only((passive,)), rows=task.rows[:1], scenarios=task.scenarios.take([0]), batch_size=1
        )

    def _give(self, task: Task, done: Done) -> None:
        """Hand on whole batches; parts of one wait for the rest."""
        for run in done.failed:
            self._fail(run)
        if done.result is None:
            return
        whole = done.result if task.whole else self._merge.add(task, done.result)
        if whole is not None:
            for result in self._in_order.take(task.batch, whole):
                self._collect(Done(result))

    def _fail(self, run: FailedRun) -> None:
        before = self._failed.get(run.id)
        if before is None or run.batch < before:
            self._failed[run.id] = run.batch
            self._collect(Done(None, (run,)))


def laws_to_send(kinds: Iterable[type[Controller]]) -> bytes:
    """Classes that are not the toolkit's, of these and those that `register` made known; empty for none.

    They go by value with their modules: a worker has what is loaded here, whatever its files say. Installed ones that
    cannot be sent are loaded by the worker itself, which checks their content.
    """
    registered = registry.registered()
    every = [kind for kind in dict.fromkeys((*registered, *kinds)) if content_of(kind)]
    if not every:
        return b""
    try:
        return _pickled(registry.keyed(every), {name for kind in every for name in modules_of(kind)})
    except Exception:  # a class may hold anything
        kept = [kind for kind in every if kind in registered]
    try:
        return _pickled(registry.keyed(kept), {kind.__module__ for kind in kept}) if kept else b""
    except Exception as error:
        names = ", ".join(kind.__name__ for kind in kept)
        raise LdcError(
            f"registered controllers ({names}) cannot be sent to worker processes ({error}); use one worker"
        ) from None


def _pickled(content: object, modules: Iterable[str]) -> bytes:
    """An object with its classes of some modules by value."""
    known = {*cloudpickle.list_registry_pickle_by_value()}
    by_value = [sys.modules[name] for name in sorted(modules) if name in sys.modules and name not in known]
    for module in by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(content))
    finally:
        for module in by_value:
            cloudpickle.unregister_pickle_by_value(module)


_STORE_EVERY = 5.0  # seconds between parts: what a kill can cost at most

_ROWS_A_PART = 250_000
"""Rows after which a part is stored before its time: results that wait are in memory twice, and the last is written
while nothing else is left to do."""


class Campaign:
    """One study, its store and its executor."""

    def __init__(
        self,
        study: Study,
        scenarios: Scenarios,
        store: Store,
        table: RunTable,
        executor: Executor,
        progress: Progress,
        *,
        time_limit: float,
        block_size: int | None,
    ) -> None:
        self.study, self.scenarios = study, scenarios
        self.store, self.table = store, table
        self._executor, self._progress = executor, progress
        self._block_size = block_size
        self._job = _job(study, store, executor, time_limit)
        self._faults = Faults()
        self._waiting: list[TaskResult] = []
        self._failed: list[FailedRun] = []
        self._loaded: set[str] = set()
        self._stored = time.monotonic()
        self._writer: ThreadPoolExecutor | None = None
        self._writing: Future[None] | None = None

    def complete(self, designs: Sequence[Design], stage: str) -> None:
        """Run what is missing of some designs.

        Whatever happens, what was finished is stored before this returns.
        """
        queues = self._queues(designs)
        if not queues:
            self._forget_failures(designs)
            return
        for id in {design.id: None for queue in queues for design in queue.designs}:
            # scenarios that ended a worker in an earlier run count as well, or a resume could save a design
            for fault, status in STATUS_OF.items() if self.table.missing(id) < self.table.n else ():
                for row in self.table.rows_with(id, status):
                    self._faults.record(id, int(row), fault)
        # in this process, each law once: workers would all compile the same
        laws = {queue.law for queue in queues} - self._loaded
        self._loaded |= laws
        load_loops(laws, self.scenarios, self._job.setup, min(one.y_s for queue in queues for one in queue.designs))
        self._progress.stage(stage, sum(len(queue.designs) * queue.batch.rows.size for queue in queues))
        dispatcher = Dispatcher(
            self._job, self.scenarios, self._executor, self._collect, faults=self._faults, block_size=self._block_size
        )
        with ThreadPoolExecutor(1) as self._writer:
            try:
                dispatcher.run(queues)
            finally:
                self._flush()
                self._written()
        self._forget_failures(designs)

    def _queues(self, designs: Sequence[Design]) -> list[WorkQueue]:
        """What is missing: law by law, batch by batch."""
        laws: dict[str, list[Design]] = {}
        for design in designs:
            laws.setdefault(design.law, []).append(design)
        queues = []
        for same in laws.values():
            for batch in batches(len(self.scenarios), same[0].batch):
                todo = [design for design in same if not self.table.has(design.id, batch.rows)]
                if todo:
                    queues.append(WorkQueue(batch, todo))
        return queues

    def _collect(self, done: Done) -> None:
        if done.result is not None:
            self._waiting.append(done.result)
            self._progress.advance(done.result.status.size)
        self._failed += done.failed
        rows = sum(result.status.size for result in self._waiting)
        if rows > _ROWS_A_PART or time.monotonic() - self._stored > _STORE_EVERY:
            self._flush()

    def _flush(self) -> None:
        """Store what has come, while the next tasks run."""
        self._written()
        if self._waiting or self._failed:
            results, failed = self._waiting, self._failed
            self._waiting, self._failed = [], []
            if self._writer is not None:
                self._writing = self._writer.submit(self._keep, results, failed)
        self._stored = time.monotonic()

    def _keep(self, results: list[TaskResult], failed: list[FailedRun]) -> None:
        """Take results into memory and into the store; in a thread, since neither needs the interpreter for long."""
        for result in results:
            self.table.put(result)
        self.store.add(results, failed)

    def _written(self) -> None:
        """Wait for the part that is being written."""
        writing, self._writing = self._writing, None
        if writing is None:
            return
        try:
            writing.result()
        except StoreError as error:
            raise StoreError(f"{error}; what was finished before is stored: run the study again to go on") from None

    def _forget_failures(self, designs: Sequence[Design]) -> None:
        """Failures of earlier runs that did not come again."""
        ids = {design.id for design in designs}
        still = {
            id: reason
            for id, reason in self.store.failures.items()
            if id in self.table and (id not in ids or self.table.missing(id))
        }
        self.store.write_failures(still)


def _job(study: Study, store: Store, executor: Executor, time_limit: float) -> Job:
    token = hashlib.sha256(f"{store.manifest.study_hash}{store.manifest.model_hash}{time.time_ns()}".encode())
    return Job(
        token=token.hexdigest()[:16],
        setup=study.setup(),
        window=study.simulation.window,
        laws=laws_to_send(study.classes.values()) if executor.isolated else b"",
        time_limit=time_limit if executor.isolated else 0.0,
    )
