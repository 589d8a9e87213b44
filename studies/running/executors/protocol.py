"""What an executor is, and what runs in its workers."""

from __future__ import annotations

import contextlib
import dataclasses
import faulthandler
import functools
import importlib.metadata
import os
import pickle
import signal
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, Final, Literal, Protocol

from ldctoolkit.errors import InputError
from ldctoolkit.option_checks import UnitWarning

Fault = Literal["died", "late"]


class Work(Protocol):
    """Something to be done in one go, anywhere: plain data that can be sent, and how it is done.

    Attributes
    ----------
    number : int
        Of this piece of work in the process that sends it.
    time_limit : float [s]
        How long `run` may take where the worker can be ended; 0 for as long as it likes.
    """

    @property
    def number(self) -> int:
        """Of this piece of work in the process that sends it."""

    @property
    def time_limit(self) -> float:
        """How long `run` may take; 0 for as long as it likes."""

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Load in a worker process what it lacks; no time limit holds."""

    def run(self, kept: dict[str, Any]) -> Any:
        """Do it; what may serve the next work in the same place is left in `kept`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ended:
    """Work that is no longer under way.

    Attributes
    ----------
    task : Work
        As it was given to `Executor.start`.
    done : object or None
        What its `run` gave; None if the worker is gone, or the work never began.
    fault : {"died", "late"} or None
        The worker ended during the work, by itself or by the time limit; None where the work is not to blame.
    certain : bool
        No other work can have been the reason.
    """

    task: Any
    done: Any = None
    fault: Fault | None = None
    certain: bool = False


class Executor(Protocol):
    """Runs work, in any order.

    Attributes
    ----------
    name : str
        ``"serial"``, ``"processes"`` or ``"dask"``.
    workers : int
        How many pieces of work run at the same time.
    isolated : bool
        Whether work that ends its process leaves this one alive.
    """

    name: str
    isolated: bool

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


SAME_VERSIONS: Final = ("ldctoolkit", "numpy", "scipy", "numba")
"""Packages whose versions decide a number's last bits: they must be the same here and on every worker."""

Versions = tuple[tuple[str, str], ...]
"""Names of packages and their versions; ``"not installed"`` where there is none."""


@functools.cache
def versions(packages: tuple[str, ...] = SAME_VERSIONS) -> Versions:
    """What this process has of some packages."""
    return tuple((name, _version(name)) for name in packages)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def check(sender: Versions, worker: Versions, named: str) -> None:
    """Compare two processes."""
    there = dict(worker)
    for name, version in sender:
        if there.get(name) != version:
            raise InputError(
                f"dask: {named} has {name} {there.get(name)}, the process that sends the work {version}; allowed: the "
                "same version everywhere, or numbers would depend on where they were computed"
            )


def run_checked(sender: Versions, task: bytes) -> Any:
    """Run a pickled piece of work in this process."""
    check(sender, versions(tuple(name for name, _ in sender)), "a worker")
    return run_task(pickle.loads(task))


_LONGEST = 4e6
"""Seconds, 46 days, that every platform can watch for; a longer limit counts as this one."""

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
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    if hasattr(os, "getppid"):
        threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    _notes = (Path(folder) / str(os.getpid())).open("w", encoding="utf-8")


def note(text: str) -> None:
    """Write down what this process does, for whoever finds it dead."""
    if _notes is not None:
        _notes.write(f"{text}\n")
        _notes.flush()


def _leave_with(parent: int) -> None:
    """End this process soon after its parent was killed: no one would read what it computes."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


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
