"""What runs in a worker process: one piece of work after the other, under a time limit, with a note of which."""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import importlib.metadata
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Final

from ldctoolkit.errors import InputError
from ldctoolkit.option_checks import UnitWarning
from studies.running.executors.protocol import Work

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
    """End this process soon after its parent was killed: nobody would read what it computes."""
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
