"""Independent jobs on the same events in worker processes: fits hold the interpreter's lock too often for threads."""

from __future__ import annotations

import concurrent.futures
import contextlib
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import LdcError
from ldctoolkit.mixture.events import Events

Job = TypeVar("Job")
Result = TypeVar("Result")
StartMethod = Literal["fork", "spawn", "forkserver"]

_LISTEN_EVERY: Final = 0.2
"""Seconds after which an interrupt is noticed at the latest."""

_LOOK_FOR_PARENT_EVERY: Final = 2.0
"""Seconds after which a worker notices that nobody waits for it."""


def in_processes(
    work: Callable[[Events, Job], Result],
    jobs: Sequence[Job],
    events: Events,
    workers: int,
    start_method: StartMethod | None = None,
) -> Generator[tuple[int, Result], None, None]:
    """What `work` gives for each job, as they end; jobs begin in their order.

    Parameters
    ----------
    work : callable
        ``work(events, job)``; it can be pickled.
    jobs : sequence
        They can be pickled.
    events : Events
        Not copied: a forked process sees them, another one maps them from a temporary file.
    workers : int
        Processes; each works on one thread.
    start_method : {"fork", "spawn", "forkserver"}, optional
        Python's default for the platform.

    Yields
    ------
    number : int
        The job's.
    result

    Raises
    ------
    LdcError
        If a process ends abruptly. What a job raises arrives as it is.
    """
    context = multiprocessing.get_context(start_method)
    children = set(multiprocessing.active_children())
    with contextlib.ExitStack() as stack:
        x: FloatArray | Path = events.x
        weight: FloatArray | Path | None = events.weight
        if context.get_start_method() != "fork":
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ldc-")))
            x = _stored(events.x, folder / "x.npy")
            weight = None if events.weight is None else _stored(events.weight, folder / "weight.npy")
            stack.enter_context(_one_blas_thread())
        pool = concurrent.futures.ProcessPoolExecutor(
            workers, mp_context=context, initializer=_start_worker, initargs=(work, x, weight)
        )
        try:
            number = {pool.submit(_run, job): i for i, job in enumerate(jobs)}
            pending = set(number)
            while pending:
                # never an endless wait: an interrupt is seen only once Python code runs again
                done, pending = concurrent.futures.wait(pending, _LISTEN_EVERY, concurrent.futures.FIRST_COMPLETED)
                for future in sorted(done, key=number.__getitem__):
                    yield number[future], future.result()
            pool.shutdown()
        except BrokenProcessPool:
            raise LdcError(
                "a worker process ended abruptly: out of memory, killed, or a script without "
                "`if __name__ == '__main__':` around what it does; n_jobs=1 needs no other process"
            ) from None
        finally:
            # after an error or an interrupt nothing waits for fits that nobody will read
            for process in set(multiprocessing.active_children()) - children:
                process.terminate()
            # the pool's own thread waits for them: two that wait for one process can both miss its end
            pool.shutdown(wait=True, cancel_futures=True)


def may_start_processes() -> bool:
    """Whether this process is allowed to have children."""
    return not multiprocessing.current_process().daemon


def _stored(array: FloatArray, path: Path) -> Path:
    np.save(path, array, allow_pickle=False)
    return path


def _loaded(array: FloatArray | Path) -> FloatArray:
    if not isinstance(array, Path):
        return array
    out: FloatArray = np.load(array, mmap_mode="r", allow_pickle=False)
    return out


@contextlib.contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Processes that start meanwhile use one BLAS thread each: the fits are what runs in parallel."""
    names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


# ---- in the worker

_task: tuple[Callable[[Events, Any], Any], Events] | None = None


def _start_worker(work: Callable[[Events, Any], Any], x: FloatArray | Path, weight: FloatArray | Path | None) -> None:
    global _task
    # the parent decides what an interrupt means
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    _task = work, Events(_loaded(x), None if weight is None else _loaded(weight), 1)


def _leave_with(parent: int) -> None:
    """End this process soon after its parent was killed."""
    while os.getppid() == parent:
        time.sleep(_LOOK_FOR_PARENT_EVERY)
    os._exit(1)


def _run(job: Any) -> Any:
    if _task is None:
        raise RuntimeError("the worker was not started")
    work, events = _task
    return work(events, job)
