"""What runs in a worker process: one task after the other, under a time limit, with a note of what is under way."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from ldctoolkit import controller_class, register, registry
from ldctoolkit.simulation import drive
from studies.running.simulate_designs import Simulator
from studies.running.tasks import Done, Job, Task

_JOBS_KEPT = 2

_WARM_LAWS = ("preview_proportional", "pid")
"""A law of each kind of loop: linear, and step by step."""

_LONGEST = 4e6
"""Seconds, 46 days, that every platform can watch for; a longer limit counts as this one."""

_local = threading.local()
_notes: IO[str] | None = None
_deadlines: dict[int, float] = {}
_lock = threading.Lock()
_warm: set[str] = set()


def run_task(task: Task) -> Done:
    """Run one task in this process."""
    chosen = simulator(task.job)
    _warm_up(chosen, task)
    note(f"task {task.number}")
    with _limited(task.job.time_limit):
        done = chosen.run(task)
    note("done")
    return done


def _warm_up(chosen: Simulator, task: Task) -> None:
    """Load the compiled loops in a fresh process, so that the time limit counts a law's own time."""
    if task.job.token in _warm or not task.job.time_limit:
        return
    takeover = chosen.takeover(task.designs[0].y_s, task.convention, task.scenarios.take([0]))
    for name in _WARM_LAWS:
        drive(controller_class(name)(), takeover, threads=1)
    _warm.add(task.job.token)


def simulator(job: Job) -> Simulator:
    """The simulator of a job in this thread, so that tasks of one job share takeovers."""
    kept: dict[str, Simulator] = _local.__dict__.setdefault("simulators", {})
    if job.token not in kept:
        while len(kept) >= _JOBS_KEPT:
            del kept[next(iter(kept))]
        _learn(job.laws)
        kept[job.token] = Simulator(job)
    return kept[job.token]


def _learn(laws: bytes) -> None:
    """Make controllers known that no installed package offers."""
    if not laws:
        return
    import cloudpickle

    for law in cloudpickle.loads(laws):
        with _lock:
            registry.forget(law.name)  # of an earlier job
            register(law)


def start_worker(folder: str) -> None:
    """Make a fresh process of a pool ready.

    Parameters
    ----------
    folder : str
        Where it notes what it does, in a file named after its process.
    """
    global _notes
    # the parent decides what an interrupt means; a group of its own, because solvers (OSQP) catch the signal themselves
    # and would report an interrupted solve as a failed one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    if hasattr(os, "getppid"):
        threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
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
