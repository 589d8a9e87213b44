"""A Dask cluster seen from the fit: reach it, hand out work, get the results in order, say what went wrong."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from ldctoolkit.errors import ClusterError, InputError, LdcError
from ldctoolkit.version import __version__

if TYPE_CHECKING:
    from distributed import Client, Future

Result = TypeVar("Result")

ANSWER: Final = 5.0
"""How long a scheduler may take to answer [s]."""

PATIENCE: Final = 15.0
"""How long a cluster may be without any worker [s]: one that died is back sooner."""


class Cluster:
    """A client of a cluster.

    Parameters
    ----------
    client : Client or str
        A client, which stays open, or the address of a scheduler.
    patience : float
        How long to wait for a first or a new worker [s].
    """

    def __init__(self, client: Client | str, patience: float = PATIENCE) -> None:
        self._owned = isinstance(client, str)
        self.client: Client = connect(client) if isinstance(client, str) else client
        self.patience = patience

    def close(self) -> None:
        """Leave the cluster, if the client is this object's own."""
        if self._owned:
            self.client.close()

    def threads(self) -> int:
        """Tasks that the cluster's workers can do at a time."""
        with self._told_if_gone():
            return sum(self.client.nthreads().values())

    @contextlib.contextmanager
    def _told_if_gone(self) -> Iterator[None]:
        """A client without its scheduler may raise anything; this tells of it as such."""
        try:
            yield
        except (Exception, asyncio.CancelledError):
            if self.client.status == "running":
                raise
            raise ClusterError("the scheduler has gone, or has dropped the work") from None

    def check_workers(self, paths: tuple[Path, ...]) -> None:
        """Refuse workers of another version of the toolkit, and workers that do not see the files."""
        try:
            self.result(self.client.submit(_look, paths, pure=False))  # waits for a first worker
            looks: dict[str, tuple[str, str | None]] = self.client.run(_look, paths)
        except LdcError:
            raise
        except Exception as error:  # a worker may run anything: whatever it raises must be told in one line
            raise ClusterError(
                f"a worker cannot run the toolkit ({type(error).__name__}: {error}); allowed: workers that have "
                f"ldctoolkit {__version__}"
            ) from None
        for worker, (version, _) in looks.items():
            if version != __version__:
                raise ClusterError(f"worker {worker}: has ldctoolkit {version}; allowed: {__version__}, as here")
        blind = {worker: missing for worker, (_, missing) in looks.items() if missing is not None}
        for worker, missing in blind.items():
            raise InputError(
                f"{missing}: not seen by {len(blind)} of {len(looks)} workers, first {worker}; "
                "allowed: files that every worker sees under the same path"
            )

    def in_order(self, work: Callable[..., Result], items: Iterable[Any], ahead: int, *more: Any) -> Iterator[Result]:
        """What ``work(item, *more)`` gives, in order; at most `ahead` items are on the cluster at a time."""
        waiting: deque[Future[Result]] = deque()
        try:
            for item in items:
                with self._told_if_gone():
                    waiting.append(self.client.submit(work, item, *more, pure=False))
                if len(waiting) > ahead:
                    yield self.result(waiting.popleft())
            while waiting:
                yield self.result(waiting.popleft())
        finally:
            if waiting:  # the caller has stopped, or something has failed
                with contextlib.suppress(Exception):
                    self.client.cancel(list(waiting))

    def result(self, future: Future[Any]) -> Any:
        """A task's result; its own errors are raised as they are.

        Raises
        ------
        ClusterError
            If the cluster has gone, has had no worker for `patience`, or the task has ended one worker after another.
        """
        from distributed import KilledWorker

        empty_since: float | None = None
        while True:
            try:
                return future.result(timeout=min(2.0, self.patience))
            except KilledWorker:
                raise ClusterError(
                    "a task has ended one worker after another, perhaps for want of memory; see the workers' logs"
                ) from None
            except TimeoutError:
                now = time.monotonic()
                if self._empty():
                    empty_since = now if empty_since is None else empty_since
                    if now - empty_since >= self.patience:
                        raise ClusterError(
                            f"the cluster has had no worker for {self.patience:g} s; start some: dask worker ADDRESS"
                        ) from None
                else:
                    empty_since = None
            except (Exception, asyncio.CancelledError):
                # a future that is cancelled while it is waited for may raise anything; the task's own errors pass
                if future.status in ("cancelled", "lost") or self.client.status != "running":
                    raise ClusterError("the scheduler has gone, or has dropped the work") from None
                raise

    def _empty(self) -> bool:
        try:
            return not self.client.nthreads()
        except (Exception, asyncio.CancelledError):  # as above: a client that loses its scheduler may raise anything
            raise ClusterError("the scheduler has gone, or has dropped the work") from None


def connect(address: str) -> Client:
    """A client of the scheduler at an address.

    Raises
    ------
    InputError
        If Dask is not installed, or no scheduler answers there within `ANSWER`.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError('Dask is not installed; install the extra: pip install "ldctoolkit[cluster]"') from None
    # asked first: a client that never reached its scheduler complains once more when it is cleared away
    try:
        with ThreadPoolExecutor(1) as aside:  # this thread may have a loop of its own, as in a notebook
            kind = aside.submit(asyncio.run, _identity(address)).result()
        if kind != "Scheduler":
            raise InputError(f"{address}: a Dask {kind} answers there; allowed: the address of a scheduler")
        return Client(address, timeout=ANSWER, set_as_default=False)
    except OSError:
        raise InputError(
            f"{address}: no Dask scheduler answers within {ANSWER:g} s; "
            "allowed: the address that `dask scheduler` shows"
        ) from None
    except (ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{address!r}: not an address: {error}; allowed: such as tcp://10.0.0.1:8786") from None


async def _identity(address: str) -> str:
    """What answers at an address: a Scheduler, it is hoped."""
    from distributed.core import rpc
    from distributed.security import Security

    peer = rpc(address, timeout=ANSWER, connection_args=Security().get_connection_args("client"))
    try:
        return str((await asyncio.wait_for(peer.identity(), ANSWER))["type"])
    finally:
        await peer.close_rpc()


def _look(paths: tuple[Path, ...]) -> tuple[str, str | None]:
    """On a worker: the toolkit's version, and the first file that is not there."""
    return __version__, next((str(path) for path in paths if not path.is_file()), None)
