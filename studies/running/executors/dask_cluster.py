"""Tasks on a Dask cluster: one that is there already, or one that is started on this machine."""

from __future__ import annotations

import importlib
import importlib.metadata
import logging
import queue
import time
from concurrent.futures import CancelledError
from typing import Any, Final

from ldctoolkit.errors import InputError, LdcError
from studies.running.executors.protocol import Ended, Fault
from studies.running.tasks import Task
from studies.running.worker import run_task

LOCAL: Final = "local"
"""Address that stands for a cluster started on this machine."""

_LISTEN_EVERY = 0.2
_CONNECT = "15s"
_SAME_VERSIONS: Final = ("ldctoolkit", "numpy", "scipy", "numba")
"""Packages whose versions decide a number's last bits: they must be the same here and on every worker."""


class DaskExecutor:
    """Runs tasks on a Dask cluster.

    Parameters
    ----------
    address : str
        Of a scheduler, as ``tcp://host:8786``; ``"local"`` starts a cluster on this machine.
    workers : int, optional
        Processes of a local cluster; all cores by default.

    Raises
    ------
    LdcError
        If Dask is not installed, the scheduler does not answer or has no workers, or a worker has other versions.
    """

    name = "dask"
    isolated = True

    def __init__(self, address: str, workers: int | None = None) -> None:
        try:
            distributed = importlib.import_module("distributed")
        except ImportError:
            raise LdcError("a Dask cluster needs the extra cluster: install ldctoolkit[cluster]") from None
        self._killed: type[Exception] = distributed.KilledWorker
        # what becomes of a worker is told by this program, in its own words
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            if address == LOCAL:
                self._cluster: Any = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None
                )
                self._client: Any = distributed.Client(self._cluster, timeout=_CONNECT)
            else:
                self._cluster = None
                self._client = distributed.Client(address, timeout=_CONNECT, name="ldc")
        except (OSError, TimeoutError, ValueError) as error:
            raise LdcError(f"dask: no scheduler answers at {address} ({error or 'no reply'})") from None
        self._tasks: dict[Any, tuple[Task, float]] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        try:
            self._client.wait_for_workers(1, timeout=30)
        except TimeoutError:
            self._client.close()
            raise LdcError(f"dask: the scheduler at {address} has no workers") from None
        self._check_versions()

    def _check_versions(self) -> None:
        here = _versions()
        for worker, there in self._client.run(_versions).items():
            for name in _SAME_VERSIONS:
                if there.get(name) != here.get(name):
                    self._client.close()
                    raise InputError(
                        f"dask: worker {worker} has {name} {there.get(name)}, this process {here.get(name)}; "
                        "allowed: the same version everywhere, or numbers would depend on where they were computed"
                    )

    @property
    def workers(self) -> int:
        """Threads of all workers that are there now."""
        return max(1, int(sum(self._client.nthreads().values())))

    def start(self, task: Task) -> None:
        """Hand a task to the scheduler."""
        future = self._client.submit(run_task, task, pure=False, key=f"ldc-{task.job.token}-{task.number}")
        self._tasks[future] = (task, time.monotonic())
        future.add_done_callback(self._ended.put)

    def wait(self) -> list[Ended]:
        """A task that has ended; waits a moment for it. The scheduler itself repeats tasks of workers that died."""
        try:
            future = self._ended.get(timeout=_LISTEN_EVERY)
        except queue.Empty:
            if self._client.status not in ("running", "connecting"):
                raise _lost() from None
            return []
        if future not in self._tasks:
            return []
        task, since = self._tasks.pop(future)
        try:
            return [Ended(task, future.result())]
        except self._killed:
            limit = task.job.time_limit
            late = limit > 0 and time.monotonic() - since > limit
            fault: Fault = "late" if late else "died"
            return [Ended(task, None, fault, certain=True)]
        except CancelledError:
            raise _lost() from None

    def close(self, *, orderly: bool) -> None:
        """Leave the cluster as it was; one that was started here ends."""
        if not orderly:
            self._client.cancel(list(self._tasks))
        self._tasks.clear()
        self._client.close()
        if self._cluster is not None:
            self._cluster.close()


def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name) for name in _SAME_VERSIONS}


def _lost() -> LdcError:
    return LdcError(
        "dask: the connection to the scheduler is lost; what was finished is stored: run the study again to go on"
    )
