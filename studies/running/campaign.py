"""Fills a study's store: what is missing goes to an executor, what comes back is kept in memory and stored."""

from __future__ import annotations

import hashlib
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import cloudpickle

from ldctoolkit import Scenarios, controller_class, registry
from ldctoolkit.errors import LdcError, StoreError
from studies.design import Design
from studies.results import FailedRun, RunKey, TaskResult
from studies.running.dispatch import STATUS_OF, Dispatcher, Lane
from studies.running.executors import Executor
from studies.running.progress import Progress
from studies.running.tasks import Done, Faults, Job, Prefixes
from studies.storage.run_table import RunTable
from studies.storage.store import Store
from studies.study_file import Study


def laws_of_this_process() -> bytes:
    """The classes that `register` made known here, to be sent along with tasks; empty for none."""
    classes = registry.registered()
    if not classes:
        return b""
    modules = [sys.modules[module] for module in dict.fromkeys(kind.__module__ for kind in classes)]
    by_value = [module for module in modules if module.__name__ not in cloudpickle.list_registry_pickle_by_value()]
    for module in by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        return bytes(cloudpickle.dumps(classes))
    except Exception as error:  # a class may hold anything
        names = ", ".join(kind.__name__ for kind in classes)
        raise LdcError(
            f"registered controllers ({names}) cannot be sent to worker processes ({error}); use one worker"
        ) from None
    finally:
        for module in by_value:
            cloudpickle.unregister_pickle_by_value(module)


_STORE_EVERY = 5.0
"""Seconds between parts: what a kill can cost at most."""

_ROWS_A_PART = 250_000
"""Rows after which a part is stored before its time: results that wait are in memory twice, and the last is written
while nothing else is left to do."""


class Campaign:
    """One study, its store and its executor."""

    def __init__(
        self,
        study: Study,
        scenarios: Scenarios,
        prefixes: Prefixes,
        store: Store,
        table: RunTable,
        executor: Executor,
        progress: Progress,
        *,
        time_limit: float,
        block_size: int | None,
    ) -> None:
        self.study, self.scenarios, self.prefixes = study, scenarios, prefixes
        self.store, self.table = store, table
        self._executor, self._progress = executor, progress
        self._block_size = block_size
        self._job = _job(study, store, executor, time_limit)
        self._faults = Faults()
        self._waiting: list[TaskResult] = []
        self._failed: list[FailedRun] = []
        self._stored = time.monotonic()
        self._writer: ThreadPoolExecutor | None = None
        self._writing: Future[None] | None = None

    def complete(self, designs: Sequence[Design], size: int, stage: str) -> None:
        """Run what is missing of some designs on the first `size` scenarios.

        Whatever happens, what was finished is stored before this returns.
        """
        lanes = self._lanes(designs, size)
        if not lanes:
            self._forget_failures(designs)
            return
        for key in {(design.id, lane.convention): None for lane in lanes for design in lane.designs}:
            self._remember_faults(key)
        self._progress.stage(stage, sum(len(lane.designs) * lane.piece.rows.size for lane in lanes))
        dispatcher = Dispatcher(
            self._job, self.scenarios, self._executor, self._collect, faults=self._faults, block_size=self._block_size
        )
        with ThreadPoolExecutor(1) as self._writer:
            try:
                dispatcher.run(lanes)
            finally:
                self._flush()
                self._written()
        self._forget_failures(designs)

    def _remember_faults(self, key: RunKey) -> None:
        """Scenarios that ended a worker in an earlier run count as well, or a resume could save a design."""
        if self.table.missing(key) == self.table.n:
            return
        for fault, status in STATUS_OF.items():
            for row in self.table.rows_with(key, status):
                self._faults.record(key, int(row), fault)

    def _lanes(self, designs: Sequence[Design], size: int) -> list[Lane]:
        """What is missing: convention by convention, law by law, piece by piece."""
        laws: dict[str, list[Design]] = {}
        for design in designs:
            laws.setdefault(design.law, []).append(design)
        lanes = []
        for convention in self.study.simulation.convention:
            for law, same in laws.items():
                covered = 0
                for piece in self.prefixes.pieces(controller_class(law).batch):
                    covered += piece.rows.size
                    if covered > size:
                        break
                    todo = [d for d in same if not self.table.has((d.id, convention), piece.rows)]
                    if todo:
                        lanes.append(Lane(convention, piece, todo))
        return lanes

    def _collect(self, done: Done) -> None:
        if done.result.keys:
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
        keys = {(design.id, convention) for design in designs for convention in self.study.simulation.convention}
        still = {
            key: reason for key, reason in self.store.failures.items() if key not in keys or self.table.missing(key)
        }
        self.store.write_failures(still)


def _job(study: Study, store: Store, executor: Executor, time_limit: float) -> Job:
    token = hashlib.sha256(f"{store.manifest.study_hash}{store.manifest.model_hash}{time.time_ns()}".encode())
    return Job(
        token=token.hexdigest()[:16],
        setup=study.setup(),
        windows=study.simulation.window,
        laws=laws_of_this_process() if executor.isolated else b"",
        time_limit=time_limit if executor.isolated else 0.0,
    )
