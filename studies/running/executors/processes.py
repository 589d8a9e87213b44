"""Executors: what one is, what runs in its workers, and the processes of this machine."""

import contextlib
import dataclasses
import faulthandler
import functools
import os
import pickle
import queue
import re
import signal
import tempfile
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import IO, Any, Literal, Protocol

from loky import get_reusable_executor
from loky.process_executor import BrokenProcessPool

import ldctoolkit.compiling as compiling
from ldctoolkit.declared import UnitWarning
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.surroundings import WORKERS, leave_with, safe_path, temporary_folder
from ldctoolkit.version import Versions, versions

Fault = Literal["died", "late"]


class Work(Protocol):
    """Something to be done in one go, anywhere: plain data that can be sent, and how it is done."""

    @property
    def number(self) -> int:
        """Of this piece of work in the process that sends it."""

    @property
    def time_limit(self) -> float:
        """How long [s] `run` may take where the worker can be ended; 0 for as long as it likes."""

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Load in a worker process what it lacks; no time limit holds."""

    def run(self, kept: dict[str, Any]) -> Any:
        """Do it; what may serve the next work in the same place is left in `kept`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ended:
    """Work that is no longer under way."""

    task: Any  # as it was given to `Executor.start`
    done: Any = None  # what its `run` gave; None if the worker is gone, or the work never began
    fault: Fault | None = None  # the worker ended during the work; None where the work is not to blame
    certain: bool = False  # no other work can have been the reason


class Executor(Protocol):
    """Runs work, in any order."""

    name: str  # "serial", "processes" or "dask"
    isolated: bool  # whether work that ends its process leaves this one alive

    @property
    def workers(self) -> int:
        """How many pieces of work run at the same time."""

    def start(self, task: Work) -> None:
        """Begin a piece of work, or queue it."""

    def wait(self) -> list[Ended]:
        """Some work that has ended; none if nothing did for a moment."""

    def close(self, *, orderly: bool) -> None:
        """Give back what was taken; if not `orderly`, work under way is given up."""


class SerialExecutor:
    """Runs work in the calling process; what ends its process ends this one, and no time limit holds."""

    name = "serial"
    isolated = False

    def __init__(self) -> None:
        self._waiting: deque[Work] = deque()
        self._kept: dict[str, Any] = {}

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def start(self, task: Work) -> None:
        """Queue a piece of work."""
        self._waiting.append(task)

    def wait(self) -> list[Ended]:
        """Run the next piece."""
        if not self._waiting:
            return []
        task = self._waiting.popleft()
        return [Ended(task, task.run(self._kept))]

    def close(self, *, orderly: bool) -> None:  # noqa: ARG002
        """Forget what was queued."""
        self._waiting.clear()


def attempt(action: Callable[[], object], seconds: float) -> None:
    """Do something that may fail or hang, and wait for it only so long."""

    def quietly() -> None:
        with contextlib.suppress(Exception):
            action()

    thread = threading.Thread(target=quietly, daemon=True)
    thread.start()
    thread.join(seconds)


def worker_versions(packages: tuple[str, ...]) -> Versions:
    """What a worker has; one without this module has not answered."""
    return versions(packages)


def check(sender: Versions, worker: Versions, named: str) -> None:
    """Compare two processes."""
    there = dict(worker)
    for name, version in sender:
        if there.get(name) != version:
            raise InputError(
                "dask",
                f"{named} has {name} {there.get(name)}, the process that sends the work {version}",
                allowed="the same version everywhere, or numbers would depend on where they were computed",
            )


def run_checked(sender: Versions, task: bytes) -> Any:
    """Run a pickled piece of work in this process."""
    check(sender, versions(tuple(name for name, _ in sender)), "a worker")
    return run_task(pickle.loads(task))


_LONGEST = 4e6  # seconds, 46 days, that every platform can watch for; a longer limit counts as this one

_local = threading.local()
_notes: IO[str] | None = None
_deadlines: dict[int, float] = {}
_lock = threading.Lock()


def run_task(task: Work) -> Any:
    """Run one piece of work in this process; what it keeps stays with this thread."""
    kept: dict[str, Any] = _local.__dict__.setdefault("kept", {})
    task.make_ready(kept)
    note(f"task {task.number}")
    with _limited(task.time_limit):
        done = task.run(kept)
    note("done")
    return done


def start_worker(folder: str, parent: int) -> None:
    """Make a fresh process of a pool ready."""
    global _notes
    # the parent decides what an interrupt means; a group of its own, because solvers (OSQP) catch the signal themselves
    # and would report an interrupted solve as a failed one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore", UnitWarning)  # the parent has shown it
    compiling.silence()
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    threading.Thread(target=leave_with, args=(parent,), daemon=True).start()
    _notes = (Path(folder) / str(os.getpid())).open("w", encoding="utf-8")


def note(text: str) -> None:
    """Write down what this process does, for whoever finds it dead."""
    if _notes is not None:
        try:
            _notes.write(f"{text}\n")
            _notes.flush()
        except OSError as error:
            raise LdcError(_notes.name, f"cannot be written: {error.strerror}") from None


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """End this process if the block takes longer, whatever runs in it: the watch needs no turn of the interpreter."""
    if not seconds:
        yield
        return
    me = threading.get_ident()
    try:
        _watch(me, time.monotonic() + seconds)
        yield
    finally:
        _watch(me, None)


def _watch(thread: int, deadline: float | None) -> None:
    with _lock:
        if deadline is None:
            _deadlines.pop(thread, None)
        else:
            _deadlines[thread] = deadline
        faulthandler.cancel_dump_traceback_later()
        if _deadlines:
            left = min(_LONGEST, max(0.001, min(_deadlines.values()) - time.monotonic()))
            if _notes is not None:
                faulthandler.dump_traceback_later(left, exit=True, file=_notes)
            else:
                faulthandler.dump_traceback_later(left, exit=True)


_LISTEN_EVERY = 0.2  # seconds after which an interrupt is noticed at the latest
_IDLE = 30.0  # seconds after which workers without work end; until then the next run of this process finds them ready

_CLOSE = 30.0  # seconds that ending the workers may take

_NOTE = re.compile(r"^(?:task (\d+)|(done|Timeout)\b.*)$", re.MULTILINE)
"""A line of a worker's notes: what it began, that it was done, or the first line of the dump that ends it."""


class ProcessExecutor:
    """Runs work in worker processes; when one dies the pool is made anew and says which work was under way."""

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
        """Hand a piece of work to the pool; raises `LdcError` if worker processes cannot start."""
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

    @safe_path()
    def _submit(self, task: Work) -> None:
        if self._pool is None:
            self._pool = get_reusable_executor(
                self._workers,
                timeout=_IDLE,
                initializer=start_worker,
                initargs=(_notes_folder().name, os.getpid()),
                env=WORKERS,
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
        under_way, late = _last_output(Path(_notes_folder().name))
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


@functools.cache
def _notes_folder() -> tempfile.TemporaryDirectory[str]:
    """Folder in which the workers of this process note what they do."""
    return temporary_folder()


def _last_output(folder: Path) -> tuple[set[int], set[int]]:
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
