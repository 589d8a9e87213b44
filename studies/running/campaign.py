"""A campaign: what is missing of a study is run in tasks, and what comes back is stored."""

import dataclasses
import hashlib
import time
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np

import ldctoolkit.registry as registry
from ldctoolkit.arrays import IntArray
from ldctoolkit.code_content import content_of, modules_of, pickled_by_value
from ldctoolkit.control import Controller, EventStatus
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.metrics import UserMetric
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import Takeover
from ldctoolkit.simulation.loop import recorded_run
from ldctoolkit.simulation.sampled_paths import PathSampler

from ..design import Design
from ..results import FailedRun, TaskResult
from ..storage.run_table import RunTable
from ..storage.store import Store
from ..study_file import Study
from .dispatch import Executor, Fault, Lost, Progress, run_works
from .tasks import Done, Job, Simulator, Task, load_loops


class Assembly:
    """Results of whole batches, in order: of pieces of a batch, and of batches that come early, none is handed on.

    Of a design that fails on a batch, exactly the batches before it are handed on, whatever ran at the same time.
    """

    def __init__(self) -> None:
        self._expected: dict[str, deque[int]] = defaultdict(deque)
        self._early: dict[str, dict[int, TaskResult]] = defaultdict(dict)
        self._pieces: dict[tuple[str, int], list[TaskResult]] = defaultdict(list)

    def expect(self, designs: Iterable[Design], batch: int) -> None:
        """A batch of some designs will come, after those that were announced before."""
        for design in designs:
            self._expected[design.id].append(batch)

    def take(self, task: Task, result: TaskResult) -> Iterator[TaskResult]:
        """Results that can be handed on, now that these are there."""
        if result.rows.size < task.batch_size:
            pieces = self._pieces[result.ids[0], task.batch]
            pieces.append(result)
            if sum(piece.rows.size for piece in pieces) < task.batch_size:
                return
            result = _joined(self._pieces.pop((result.ids[0], task.batch)))
        now = [i for i, id in enumerate(result.ids) if self._expected[id] and self._expected[id][0] == task.batch]
        for i in set(range(len(result.ids))) - set(now):
            self._early[result.ids[i]][task.batch] = result.take([i])
        if now:
            yield result if len(now) == len(result.ids) else result.take(now)
        for i in now:
            expected, early = self._expected[result.ids[i]], self._early[result.ids[i]]
            expected.popleft()
            while expected and expected[0] in early:
                yield early.pop(expected.popleft())


def _joined(pieces: Sequence[TaskResult]) -> TaskResult:
    """Results of one design on the pieces of a batch as one."""
    return dataclasses.replace(
        pieces[0],
        rows=np.concatenate([piece.rows for piece in pieces]),
        values=np.concatenate([piece.values for piece in pieces], axis=2),
        status=np.concatenate([piece.status for piece in pieces], axis=1),
        failed_solves=np.concatenate([piece.failed_solves for piece in pieces], axis=1),
        law_seconds=np.sum([piece.law_seconds for piece in pieces], axis=0),
        commands=np.sum([piece.commands for piece in pieces], axis=0),
    ).sorted_by_row()


SECONDS_A_TASK: Final = 0.5
"""Enough to hide the cost of sending a task, little enough to spread slow designs and to lose little with a worker."""

_FIRST_RUNS: Final = 2000  # scenario runs in the first task of a law, before its pace is known
_MOST_RUNS: Final = 400_000  # scenario runs in a task at most: results are in memory on both sides

_STORE_EVERY = 5.0  # seconds between parts: what a kill can cost at most

_ROWS_A_PART = 250_000
"""Rows after which a part is stored before its time: results that wait are in memory twice, and the last is written
while nothing else is left to do."""

_SAMPLES: Final = 2**19  # of paths that are in memory at a time, where metrics of a designer need them
_FEWEST_PATHS: Final = 64

_MOST_FAULTS: Final = 3  # scenarios of a design that may end or stop a worker; with one more the design has failed
_FAULTS: Final[dict[Fault, tuple[EventStatus, str]]] = {
    "died": (EventStatus.CRASHED, "ends its worker process"),
    "late": (EventStatus.TIMED_OUT, "takes longer than the time limit"),
}
"""Status of a scenario whose worker ended or exceeded the time limit, and the warning for it."""


@dataclasses.dataclass(frozen=True)
class _Missing:
    """Designs of one law that still have to run on one batch of scenarios."""

    batch: int
    rows: IntArray
    designs: Sequence[Design]  # by rising y_s: designs of one threshold share a takeover


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
        identity = f"{store.manifest.study_hash}{store.manifest.model_hash}{time.time_ns()}"
        self._job = Job(
            token=hashlib.sha256(identity.encode()).hexdigest()[:16],
            setup=study.setup(),
            window=study.simulation.window,
            laws=laws_to_send(study.classes.values()) if executor.isolated else b"",
            time_limit=time_limit if executor.isolated else 0.0,
            metrics=metrics_to_send(study.metrics) if executor.isolated and study.metrics else study.metrics,
        )
        # scenarios whose paths are in memory at a time
        dt, longest = self._job.setup.dt, float(scenarios.T[np.isfinite(scenarios.T)].max(initial=0.0))
        samples = 1.0 + (longest + self._job.setup.settle) / dt
        self._most = max(_FEWEST_PATHS, int(_SAMPLES / samples)) if study.metrics else max(len(scenarios), 1)
        self._seconds_a_run: dict[str, float] = {}  # of each law
        self._faults: dict[str, dict[int, Fault]] = defaultdict(dict)  # by row number
        self._failed: dict[str, int] = {}  # the first batch that it failed on
        self._assembly = Assembly()
        self._results: list[TaskResult] = []  # to be stored
        self._failures: list[FailedRun] = []
        self._loaded: set[str] = set()
        self._stored = time.monotonic()
        self._writer: ThreadPoolExecutor | None = None
        self._writing: Future[None] | None = None

    def complete(self, designs: Sequence[Design], stage: str) -> None:
        """Run what is missing of some designs.

        Whatever happens, what was finished is stored before this returns.
        """
        missing = self._missing(designs)
        self._assembly, self._failed = Assembly(), {}
        for part in missing:
            self._assembly.expect(part.designs, part.batch)
        # scenarios that ended a worker in an earlier run count as well, or a resume could save a design
        for id in {design.id for part in missing for design in part.designs}:
            for fault, (status, _) in _FAULTS.items() if self.table.missing(id) < self.table.n else ():
                self._faults[id] |= dict.fromkeys(self.table.rows_with(id, status).tolist(), fault)
        if missing:
            # in this process, each law once: workers would all compile the same
            if self.study.metrics:  # a mistake in one of them is found before a design runs
                over = Takeover.build(
                    self.scenarios.take(np.arange(min(8, len(self.scenarios)))), self._job.setup, y_s=0.0
                )
                PathSampler(over, self.study.metrics).values(recorded_run(over))
            laws = {part.designs[0].law for part in missing} - self._loaded
            self._loaded |= laws
            load_loops(laws, self.scenarios, self._job.setup, min(part.designs[0].y_s for part in missing))
            self._progress.stage(stage, sum(len(part.designs) * part.rows.size for part in missing))
            self._stored = time.monotonic()  # compiling took none of it
            with ThreadPoolExecutor(1) as self._writer:
                try:
                    for task, done in run_works(self._executor, self._tasks(missing), still_needed=self._still_needed):
                        self._take(task, done)
                finally:
                    self._flush()
                    self._written()
        self._forget_failures(designs)

    def _missing(self, designs: Sequence[Design]) -> list[_Missing]:
        """What is missing: law by law, batch by batch."""
        laws: dict[str, list[Design]] = defaultdict(list)
        for design in sorted(designs, key=lambda design: design.y_s):
            laws[design.law].append(design)
        n, missing = len(self.scenarios), []
        for law in dict.fromkeys(design.law for design in designs):
            batches = -(-n // min(laws[law][0].batch, self._most))
            for batch, rows in enumerate(np.array_split(np.arange(n), batches)):
                left = [design for design in laws[law] if not self.table.has(design.id, rows)]
                if left:
                    missing.append(_Missing(batch, rows, left))
        return missing

    def _tasks(self, missing: Iterable[_Missing]) -> Iterator[Task]:
        for part in missing:
            scenarios, first = self.scenarios.take(part.rows), 0
            while first < len(part.designs):
                designs = tuple(part.designs[first : first + (self._block_size or self._fitting(part))])
                first += len(designs)
                yield Task(self._job, designs, part.rows, scenarios, part.batch, part.rows.size)

    def _fitting(self, part: _Missing) -> int:
        """Designs that take about half a second."""
        pace = self._seconds_a_run.get(part.designs[0].law)
        runs = _FIRST_RUNS if pace is None else min(_MOST_RUNS, SECONDS_A_TASK / max(pace, 1e-9))
        return max(1, int(runs / part.rows.size))

    def _still_needed(self, task: Task) -> Task | None:
        """The task without designs that have failed on this batch or an earlier one."""
        failed = [self._failed.get(design.id, task.batch + 1) <= task.batch for design in task.designs]
        if not any(failed):
            return task
        left = tuple(design for design, out in zip(task.designs, failed, strict=True) if not out)
        return dataclasses.replace(task, designs=left) if left else None

    def _take(self, task: Task, done: Done | Lost) -> None:
        """Store what came out of a task: results of whole batches, and designs that failed."""
        if isinstance(done, Lost):
            id = task.designs[0].id
            self._faults[id][int(task.rows[0])] = done.fault
            if len(self._faults[id]) > _MOST_FAULTS:
                named = ", ".join(f"{row} ({_FAULTS[fault][1]})" for row, fault in sorted(self._faults[id].items()))
                self._fail(FailedRun(id, task.batch, f"ends or stops its worker process in scenarios {named}"))
                self._failed[id] = -1  # what is left of earlier batches would end workers too
                return
            done = Done(Simulator(self._job).uncontrolled(task, _FAULTS[done.fault][0]))
        else:
            # the last pace counts: the first task of a process also loads and compiles
            self._seconds_a_run[task.designs[0].law] = done.seconds / task.runs
        for run in done.failed:
            self._fail(run)
        for result in self._assembly.take(task, done.result) if done.result is not None else ():
            self._results.append(result)
            self._progress.advance(result.status.size)
        rows = sum(result.status.size for result in self._results)
        if rows > _ROWS_A_PART or time.monotonic() - self._stored > _STORE_EVERY:
            self._flush()

    def _fail(self, run: FailedRun) -> None:
        if run.batch < self._failed.get(run.id, run.batch + 1):
            self._failed[run.id] = run.batch
            self._failures.append(run)

    def _flush(self) -> None:
        """Store what has come, while the next tasks run."""
        self._written()
        if (self._results or self._failures) and self._writer is not None:
            self._writing = self._writer.submit(self._keep, self._results, self._failures)
            self._results, self._failures = [], []
        self._stored = time.monotonic()

    def _keep(self, results: list[TaskResult], failures: list[FailedRun]) -> None:
        """Take results into memory and into the store; in a thread, since neither needs the interpreter for long."""
        for result in results:
            self.table.put(result)
        self.store.add(results, failures)

    def _written(self) -> None:
        """Wait for the part that is being written."""
        writing, self._writing = self._writing, None
        if writing is None:
            return
        try:
            writing.result()
        except StoreError as error:
            raise error.hinted("what was finished before is stored: run the study again to go on") from None

    def _forget_failures(self, designs: Sequence[Design]) -> None:
        """Failures of earlier runs that did not come again."""
        run = {design.id for design in designs}
        still = {
            id: reason
            for id, reason in self.store.failures.items()
            if id in self.table and (id not in run or self.table.missing(id))
        }
        self.store.write_failures(still)


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
        return pickled_by_value(registry.keyed(every), {name for kind in every for name in modules_of(kind)})
    except Exception:  # a class may hold anything
        every = [kind for kind in every if kind in registered]
    try:
        return pickled_by_value(registry.keyed(every), {kind.__module__ for kind in every}) if every else b""
    except Exception as error:
        names = ", ".join(kind.__name__ for kind in every)
        problem = f"registered controllers ({names}) cannot be sent to worker processes ({error})"
        raise LdcError(problem=problem, hint="use one worker") from None


def metrics_to_send(metrics: Sequence[UserMetric]) -> bytes:
    """Designers' metrics by value, as laws are sent."""
    try:
        return pickled_by_value(tuple(metrics), {name for metric in metrics for name in modules_of(metric.function)})
    except Exception as error:
        names = ", ".join(metric.name for metric in metrics)
        problem = f"metrics ({names}) cannot be sent to worker processes ({error})"
        raise LdcError(problem=problem, hint="use one worker") from None
