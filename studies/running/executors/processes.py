"""Work in processes of this machine, started afresh by loky, with a note of what each was doing when it died."""

from __future__ import annotations

import contextlib
import os
import queue
import re
import tempfile
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

from loky import get_reusable_executor
from loky.process_executor import BrokenProcessPool

from ldctoolkit.errors import LdcError
from studies.running.executors.protocol import Ended, Fault, Work, attempt, run_task, start_worker

_LISTEN_EVERY = 0.2
"""Seconds after which an interrupt is noticed at the latest."""

_IDLE = 30.0
"""Seconds after which workers without work end; until then the next run of this process finds them ready."""

_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "POLARS_MAX_THREADS"), "1")
"""The workers are what runs in parallel."""

_CLOSE = 30.0
"""Seconds that ending the workers may take."""

_NOTE = re.compile(r"^(?:task (\d+)|(done|Timeout)\b.*)$", re.MULTILINE)
"""A line of a worker's notes: what it began, that it was done, or the first line of the dump that ends it."""

_folder: tempfile.TemporaryDirectory[str] | None = None


class ProcessExecutor:
    """Runs work in worker processes; when one dies the pool is made anew and says which work was under way.

    Parameters
    ----------
    workers : int
    """

    name = "processes"
    isolated = True

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._pool: Any = None
        self._tasks: dict[Future[Any], Work] = {}
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()

    @property
    def workers(self) -> int:
        """Number of processes."""
        return self._workers

    def start(self, task: Work) -> None:
        """Hand a piece of work to the pool.

        Raises
        ------
        LdcError
            If worker processes cannot start.
        """
        try:
            try:
                self._submit(task)
            except BrokenProcessPool:
                # a worker died while it had nothing to do
                self._pool = None
                self._submit(task)
        except (BrokenProcessPool, OSError) as error:
            self._pool = None
            reason = str(error).strip() or type(error).__name__
            raise LdcError(
                f"worker processes cannot start ({reason}); what was stored is kept: run it again "
                "with fewer workers, or with one, which runs in this process"
            ) from None

    def _submit(self, task: Work) -> None:
        if self._pool is None:
            self._pool = get_reusable_executor(
                self._workers,
                timeout=_IDLE,
                initializer=start_worker,
                initargs=(_notes(), os.getpid()),
                env=_ONE_THREAD,
                kill_workers=True,
            )
        future = self._pool.submit(run_task, task)
        self._tasks[future] = task
        future.add_done_callback(self._ended.put)

    def wait(self) -> list[Ended]:
        """Work that has ended by now; waits a moment for the first."""
        try:
            futures = [self._ended.get(timeout=_LISTEN_EVERY)]
        except queue.Empty:
            return []
        with contextlib.suppress(queue.Empty):
            while True:
                futures.append(self._ended.get_nowait())
        ended: list[Ended] = []
        for future in futures:
            if future not in self._tasks:
                continue  # reported already, with all that a broken pool held
            try:
                done = future.result()
            except (BrokenProcessPool, CancelledError):
                return ended + self._broken()
            ended.append(Ended(self._tasks.pop(future), done))
        return ended

    def _broken(self) -> list[Ended]:
        """Everything that the pool held; tasks that a dead worker may have stumbled over are reported as such."""
        ended: list[Ended] = []
        lost: list[Work] = []
        for future, task in self._tasks.items():
            # the pool gives up all tasks that it holds; those that ended before have their results
            error = future.exception()
            if error is None:
                ended.append(Ended(task, future.result()))
            elif isinstance(error, BrokenProcessPool | CancelledError):
                lost.append(task)
            else:
                raise error
        self._tasks.clear()
        self._pool = None
        under_way, late = _last_words(Path(_notes()))
        suspects = [task for task in lost if task.number in under_way]
        for task in lost:
            fault: Fault | None = None
            if task.number in late:
                fault = "late"
            elif task in suspects and not any(other.number in late for other in suspects):
                fault = "died"  # where one was late the others were only in the same pool
            ended.append(Ended(task, None, fault, fault == "late" or len(suspects) == 1))
        return ended

    def close(self, *, orderly: bool) -> None:
        """Leave the workers to the next run of this process; if not `orderly`, end them now."""
        if self._pool is not None and not orderly:
            pool, self._pool = self._pool, None
            # the reason is reported already: a second interrupt only ends the waiting
            with contextlib.suppress(KeyboardInterrupt):
                attempt(lambda: pool.shutdown(wait=True, kill_workers=True), _CLOSE)
        self._tasks.clear()


def _notes() -> str:
    """Folder in which the workers of this process note what they do."""
    global _folder
    if _folder is None:
        _folder = tempfile.TemporaryDirectory(prefix=f"ldc-{os.getpid()}-")
    return _folder.name


def _last_words(folder: Path) -> tuple[set[int], set[int]]:
    """Numbers of the tasks that were under way in workers, and those of them that were over their time."""
    under_way, late = set(), set()
    for path in folder.iterdir():
        text = path.read_text(encoding="utf-8", errors="replace")
        path.unlink()
        number: int | None = None
        # where the dump of a late task names files, a path may hold any of these words
        for begun, word in _NOTE.findall(text):
            if begun:
                number = int(begun)
            elif number is not None and word == "Timeout":
                late.add(number)
            elif word == "done":
                number = None
        if number is not None:
            under_way.add(number)
    return under_way, late
