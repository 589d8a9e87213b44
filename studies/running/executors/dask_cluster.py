"""Work on a Dask cluster: one that is there already, or one that is started on this machine."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import pickle
import queue
import time
import uuid
from typing import Any

from ldctoolkit.errors import ClusterError
from studies.running.executors.dask_connection import Connection, lost, unable, unreadable
from studies.running.executors.protocol import Ended, Fault, Work
from studies.running.worker import run_checked

_LISTEN_EVERY = 0.2

_COUNT_EVERY = 3.0
"""Seconds after which workers are counted again; the scheduler has other things to do."""

_ANSWER = 10.0
"""Seconds that the scheduler has to answer a question, or to hand over a result."""

_GRACE = 60.0
"""Seconds that a run goes on without any worker: one that is restarted comes back within them."""

_log = logging.getLogger("studies")


@dataclasses.dataclass
class _UnderWay:
    task: Work
    since: float
    alone: bool


class DaskExecutor:
    """Runs work on a Dask cluster.

    Parameters
    ----------
    address : str
        Of a scheduler, as ``tcp://host:8786``; ``"local"`` starts a cluster on this machine.
    workers : int, optional
        Processes of a local cluster; all cores by default.
    packages : tuple of str
        Whose versions must be the same on all workers, besides those of every study.

    Raises
    ------
    InputError
        If a worker has other versions of the packages that decide numbers.
    LdcError
        If Dask is not installed, the scheduler does not answer or has no workers, or a worker has no ldctoolkit.
    """

    name = "dask"
    isolated = True

    def __init__(self, address: str, workers: int | None = None, packages: tuple[str, ...] = ()) -> None:
        self._connection = Connection(address, workers, packages)
        self._tasks: dict[Any, _UnderWay] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._count = 0
        self._counted_at = -float("inf")
        self._deserted_since: float | None = None

    @property
    def workers(self) -> int:
        """Threads of all workers that were there a moment ago, at least one; raises nothing."""
        self._count_workers()
        return max(1, self._count)

    def _count_workers(self) -> None:
        client = self._connection.client
        if time.monotonic() - self._counted_at < _COUNT_EVERY or client.status != "running":
            return
        # no answer: `wait` finds out whether the scheduler has gone
        with contextlib.suppress(Exception):
            self._count = int(sum(client.nthreads(callback_timeout=_ANSWER).values()))
        self._counted_at = time.monotonic()

    def start(self, task: Work) -> None:
        """Hand a piece of work to the scheduler."""
        sent = pickle.dumps(task, protocol=pickle.HIGHEST_PROTOCOL)
        # a key of its own each time: the scheduler answers a key that it knows with what that gave before
        key = f"ldc-{uuid.uuid4().hex}"
        with self._connection.asking():
            future = self._connection.client.submit(run_checked, self._connection.versions, sent, pure=False, key=key)
            future.add_done_callback(self._ended.put)
        for other in self._tasks.values():
            other.alone = False
        self._tasks[future] = _UnderWay(task, time.monotonic(), alone=not self._tasks)

    def wait(self) -> list[Ended]:
        """Work that has ended; waits a moment for it. The scheduler itself repeats work of workers that died."""
        try:
            future = self._ended.get(timeout=_LISTEN_EVERY)
        except queue.Empty:
            self._nothing_came()
            return []
        if future not in self._tasks:
            return []
        try:
            done = self._fetch(future)
        except self._connection.killed as error:
            under_way = self._tasks.pop(future)
            return [Ended(under_way.task, None, _fault(under_way, error), certain=True)]
        if done is None:
            self._ended.put(future)
            self._nothing_came()
            return []
        self._deserted_since = None
        return [Ended(self._tasks.pop(future).task, done)]

    def _fetch(self, future: Any) -> Any:
        """What the work gave; None if it does not arrive, because the worker that held it has gone since."""
        if future.status != "error":
            with self._connection.asking():
                try:
                    done = future.result(timeout=_ANSWER)
                except TimeoutError:
                    return None
                return done
        try:
            done = future.result(timeout=_ANSWER)
        except RuntimeError as error:
            if "deserializ" in str(error).lower():
                raise unable("the scheduler", error.__cause__ or "it cannot read a task") from None
            raise
        except Exception as error:
            if unreadable(error):
                raise unable("a worker", error) from None
            raise
        return done

    def _nothing_came(self) -> None:
        """See whether something can come at all."""
        if not self._connection.open:
            raise lost()
        self._count_workers()
        if self._count or not self._tasks:
            self._deserted_since = None
            return
        now = time.monotonic()
        if self._deserted_since is None:
            self._deserted_since = now
            _log.warning("dask: all workers have gone; the run waits %g s for others", _GRACE)
        elif now - self._deserted_since > _GRACE:
            raise ClusterError(
                f"dask: all workers have gone, and none has come for {_GRACE:g} s; what was stored is kept: run "
                "it again"
            )

    def close(self, *, orderly: bool) -> None:
        """Leave the cluster as it was; one that was started here ends."""
        futures = list(self._tasks)
        self._tasks.clear()
        self._connection.close(futures, orderly=orderly)


def _fault(under_way: _UnderWay, error: Any) -> Fault:
    """What ended the workers that tried a task: the scheduler, who tells of it, does not know.

    A task that is over its time takes at least the limit in each of its attempts. The time since it was sent tells
    this only if it had no other before or beside it. Otherwise it counts as "died", which is no verdict yet: the
    dispatcher sends it again, alone.
    """
    attempts = error.allowed_failures + 1
    late = 0 < under_way.task.time_limit * attempts < time.monotonic() - under_way.since
    return "late" if late and under_way.alone else "died"
