"""A connection to a Dask cluster, and what it means when it breaks."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import importlib
import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError
from typing import Any, Final

from ldctoolkit.errors import ClusterError, LdcError
from studies.running.executors.protocol import attempt
from studies.running.worker import SAME_VERSIONS, check, versions

LOCAL: Final = "local"
"""Address that stands for a cluster started on this machine."""

_CONNECT = "15s"

_NOT_THERE: Final = (ModuleNotFoundError, ImportError, AttributeError)

_ONE_THREAD: Final = {"POLARS_MAX_THREADS": "1"}
"""For workers that are started here; Dask itself keeps the other libraries to one thread."""

_CLOSE = 30.0
"""Seconds that leaving a cluster may take."""


class Connection:
    """A client of a scheduler that has workers, all of them with the packages of this process."""

    def __init__(self, address: str, workers: int | None, packages: tuple[str, ...] = ()) -> None:
        self.versions = versions((*SAME_VERSIONS, *packages))
        try:
            distributed = importlib.import_module("distributed")
        except ImportError:
            raise LdcError("a Dask cluster needs the extra cluster: install ldctoolkit[cluster]") from None
        self.killed: type[Exception] = distributed.KilledWorker
        # what becomes of a worker is told by this program, in its own words
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self.client: Any = None
        self._cluster: Any = None
        try:
            self._open(distributed, address, workers)
            self._check_versions()
        except BaseException:
            self.close([], orderly=False)
            raise

    def _open(self, distributed: Any, address: str, workers: int | None) -> None:
        try:
            if address == LOCAL:
                self._cluster = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None, env=_ONE_THREAD
                )
            self.client = distributed.Client(self._cluster or address, timeout=_CONNECT, name="ldc")
        except (OSError, ValueError) as error:
            raise LdcError(f"dask: no scheduler answers at {address} ({error or 'no reply'})") from None
        with self.asking():
            try:
                self.client.wait_for_workers(1, timeout=30)
            except TimeoutError:
                raise ClusterError(f"dask: the scheduler at {address} has no workers") from None

    def _check_versions(self) -> None:
        """Before anything runs; a worker that comes later checks itself, with each task."""
        with self.asking():
            asked = functools.partial(versions, tuple(name for name, _ in self.versions))
            answers = self.client.run(asked, on_error="return")
        for worker, there in answers.items():
            if isinstance(there, OSError):
                continue  # it has gone
            if isinstance(there, Exception):
                raise unable(f"worker {worker}", there)
            check(self.versions, there, f"worker {worker}")

    @property
    def open(self) -> bool:
        """Whether something can still come."""
        return self.client.status in ("running", "connecting")

    @contextlib.contextmanager
    def asking(self) -> Iterator[None]:
        """Say what it means when the scheduler goes while the block asks it for something."""
        try:
            yield
        except LdcError:
            raise
        except (OSError, CancelledError, asyncio.CancelledError):
            raise lost() from None
        except Exception:
            if self.open:
                raise
            # a client that has given up raises whatever its version raises
            raise lost() from None

    def close(self, futures: list[Any], *, orderly: bool) -> None:
        """Leave the cluster as it was; one that was started here ends."""
        with contextlib.suppress(*(() if orderly else (KeyboardInterrupt,))):
            attempt(lambda: self._leave(futures), _CLOSE)

    def _leave(self, futures: list[Any]) -> None:
        if self.client is not None:
            if futures:
                with contextlib.suppress(Exception):
                    self.client.cancel(futures)
            with contextlib.suppress(Exception):
                self.client.close()
        if self._cluster is not None:
            self._cluster.close()


def lost() -> ClusterError:
    """The scheduler has gone, or has dropped the work."""
    return ClusterError("dask: the connection to the scheduler is lost; what was stored is kept: run it again")


def unreadable(error: Exception) -> bool:
    """Whether a process could not read what it was sent; Dask hands on some errors as their text alone."""
    return isinstance(error, _NOT_THERE) or str(error).startswith(tuple(kind.__name__ for kind in _NOT_THERE))


def unable(who: str, error: object) -> ClusterError:
    """A scheduler or worker cannot read a task."""
    return ClusterError(
        f"dask: {who} cannot run tasks ({error}); allowed: ldctoolkit in the same version on the scheduler and on "
        "every worker"
    )
