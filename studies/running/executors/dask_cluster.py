"""Workers of a Dask cluster: the connection, and tasks on it."""

import asyncio
import contextlib
import dataclasses
import functools
import importlib
import logging
import pickle
import queue
import time
import uuid
from collections.abc import Iterator
from concurrent.futures import CancelledError
from typing import Any, Final

from ldctoolkit.errors import ClusterError, LdcError
from ldctoolkit.surroundings import WORKERS, safe_path
from ldctoolkit.version import DECISIVE, versions

from .processes import Ended, Fault, Work, attempt, check, run_checked, worker_versions

LOCAL: Final = "local"  # address that stands for a cluster started on this machine

_CONNECT = "15s"

_NOT_THERE: Final = (ModuleNotFoundError, ImportError, AttributeError)

_CLOSE = 30.0  # seconds that leaving a cluster may take


class Connection:
    """A client of a scheduler that has workers, all of them with the packages of this process."""

    def __init__(self, address: str, workers: int | None, packages: tuple[str, ...] = ()) -> None:
        self.versions = versions((*DECISIVE, *packages))
        try:
            distributed = importlib.import_module("distributed")
        except ImportError:
            raise LdcError("a Dask cluster needs the extra cluster: install ldctoolkit[cluster]") from None
        self.killed: type[Exception] = distributed.KilledWorker
        # what becomes of a worker is reported by this program itself
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self.client: Any = None
        self._cluster: Any = None
        self._safe_path = contextlib.ExitStack()
        try:
            self._open(distributed, address, workers)
            self._check_versions()
        except BaseException:
            self.close([], orderly=False)
            raise

    def _open(self, distributed: Any, address: str, workers: int | None) -> None:
        try:
            if address == LOCAL:
                self._safe_path.enter_context(safe_path())  # for workers that are started later, too
                self._cluster = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None, env=WORKERS
                )
            self.client = distributed.Client(self._cluster or address, timeout=_CONNECT, name="ldc")
        except (OSError, ValueError) as error:
            raise LdcError("dask", f"no scheduler answers at {address} ({error or 'no reply'})") from None
        with self.asking():
            try:
                self.client.wait_for_workers(1, timeout=30)
            except TimeoutError:
                raise ClusterError("dask", f"the scheduler at {address} has no workers") from None

    def _check_versions(self) -> None:
        """Before anything runs; a worker that comes later checks itself, with each task."""
        with self.asking():
            request = functools.partial(worker_versions, tuple(name for name, _ in self.versions))
            answers = self.client.run(request, on_error="return")
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
        with self._safe_path:
            if self._cluster is not None:
                self._cluster.close()


def lost() -> ClusterError:
    """The scheduler has gone, or has dropped the work."""
    return ClusterError("dask", "the connection to the scheduler is lost", hint="what was stored is kept: run it again")


def unreadable(error: Exception) -> bool:
    """Whether a process could not read what it was sent; Dask hands on some errors as their text alone."""
    return isinstance(error, _NOT_THERE) or str(error).startswith(tuple(kind.__name__ for kind in _NOT_THERE))


def unable(who: str, error: object) -> ClusterError:
    """A scheduler or worker cannot read a task."""
    return ClusterError(
        "dask",
        f"{who} cannot run tasks ({error})",
        allowed="ldctoolkit in the same version on the scheduler and on every worker",
    )


_LISTEN_EVERY = 0.2

_COUNT_EVERY = 3.0  # seconds after which workers are counted again; the scheduler has other things to do
_ANSWER = 10.0  # seconds that the scheduler has to answer a question, or to hand over a result
_GRACE = 60.0  # seconds that a run goes on without any worker: one that is restarted comes back within them

_log = logging.getLogger("studies")


@dataclasses.dataclass
class _UnderWay:
    task: Work
    since: float
    alone: bool


class DaskExecutor:
    """Runs work on a Dask cluster: at an address such as ``tcp://host:8786``, or with ``"local"`` on this machine, with
    so many workers. The versions of `packages` must be the same on all of them, besides those of every study.
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
                "dask",
                f"all workers have gone, and none has come for {_GRACE:g} s",
                hint="what was stored is kept: run it again",
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
