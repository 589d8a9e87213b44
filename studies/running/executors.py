"""Where work runs: in this process, in processes of this machine, or on a Dask cluster."""

import asyncio
import contextlib
import dataclasses
import faulthandler
import functools
import importlib
import logging
import os
import pickle
import queue
import re
import signal
import tempfile
import threading
import time
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import IO, Any, Final

from loky import get_reusable_executor
from loky.process_executor import BrokenProcessPool

import ldctoolkit.compiling as compiling
from ldctoolkit.declared import UnitWarning, checked_whole
from ldctoolkit.errors import ClusterError, InputError, LdcError, first_line
from ldctoolkit.surroundings import WORKERS, leave_with, safe_path, temporary_folder
from ldctoolkit.version import DECISIVE, Versions, versions

from .dispatch import Ended, Executor, Fault, Work

EXECUTORS: Final = ("serial", "processes", "dask")
LOCAL: Final = "local"  # address that stands for a cluster started on this machine

_LISTEN_EVERY = 0.2  # seconds after which an interrupt is noticed at the latest
_CLOSE = 30.0  # seconds that ending the workers, or leaving a cluster, may take


def make_executor(
    name: str | None, workers: int | None, address: str | None = None, packages: tuple[str, ...] = ()
) -> Executor:
    """The executor of that name: by default processes, one a core; serial where one worker is requested, dask where an
    address is given, of a scheduler or ``"local"``. The versions of `packages` must be the same on a cluster.
    """
    workers = None if workers is None else checked_whole("workers", workers, lower=1)
    if address is not None and not address.strip():
        raise InputError("dask", value=address, allowed="an address such as tcp://host:8786, or 'local'")
    name = name or ("dask" if address else "serial" if workers == 1 else "processes")
    if name not in EXECUTORS:
        raise InputError("executor", value=name, allowed=EXECUTORS)
    if address and name != "dask":
        raise InputError("executor", f"with the address {address}", value=name, allowed="'dask'")
    if name == "serial":
        return SerialExecutor()
    if name == "processes":
        return ProcessExecutor(workers or os.cpu_count() or 1)
    if address and address != LOCAL and workers is not None:
        raise InputError("workers", f"with the cluster at {address}", value=workers, allowed="the cluster's number")
    return DaskExecutor(address or LOCAL, workers, packages)


class SerialExecutor:
    """Runs work in the calling process; what ends its process ends this one, and no time limit holds."""

    name = "serial"
    isolated = False

    def __init__(self) -> None:
        self._waiting: deque[Work] = deque()
        self._cache: dict[str, Any] = {}

    @property
    def workers(self) -> int:
        """Always 1."""
        return 1

    def start(self, work: Work) -> None:
        """Queue a work."""
        self._waiting.append(work)

    def wait(self) -> list[Ended]:
        """Run the next one."""
        if not self._waiting:
            return []
        work = self._waiting.popleft()
        return [Ended(work, work.run(self._cache))]

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
    versions_of_worker = dict(worker)
    for name, version in sender:
        if versions_of_worker.get(name) != version:
            raise InputError(
                "dask",
                f"{named} has {name} {versions_of_worker.get(name)}, the process that sends the work {version}",
                allowed="the same version everywhere, or numbers would depend on where they were computed",
            )


def run_checked(sender: Versions, work: bytes) -> Any:
    """Run a pickled work in this process."""
    check(sender, versions(tuple(name for name, _ in sender)), "a worker")
    return run_work(pickle.loads(work))


_LONGEST = 4e6  # seconds, 46 days, that every platform can watch for; a longer limit counts as this one

_local = threading.local()
_notes: IO[str] | None = None
_deadlines: dict[int, float] = {}
_lock = threading.Lock()


def run_work(work: Work) -> Any:
    """Run a work in this process; what it keeps stays with this thread."""
    cache: dict[str, Any] = _local.__dict__.setdefault("cache", {})
    work.make_ready(cache)
    note(f"task {work.number}")
    with _limited(work.time_limit):
        result = work.run(cache)
    note("done")
    return result


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
    """Set or lift a thread's deadline; at the nearest of all the process ends, with a note."""
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


_IDLE = 30.0  # seconds after which workers without work end; until then the next run of this process finds them ready

_NOTE = re.compile(r"^(?:task (\d+)|(done|Timeout)\b.*)$", re.MULTILINE)
"""A line of a worker's notes: what it began, that it was done, or the first line of the dump that ends it."""


class ProcessExecutor:
    """Runs work in worker processes; when one dies the pool is replaced, and notes say which work was under way."""

    name = "processes"
    isolated = True

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: Any = None
        self._under_way: dict[Future[Any], Work] = {}
        self._ended: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()

    def start(self, work: Work) -> None:
        """Hand a work to the pool; raises `LdcError` if worker processes cannot start."""
        try:
            try:
                self._submit(work)
            except BrokenProcessPool:
                # a worker died while it had nothing to do
                self._pool = None
                self._submit(work)
        except (BrokenProcessPool, OSError) as error:
            self._pool = None
            reason = first_line(error)
            raise LdcError(
                problem=f"worker processes cannot start ({reason})",
                hint="what was stored is kept: run it again with fewer workers, or with one, which runs in this "
                "process",
            ) from None

    @safe_path()
    def _submit(self, work: Work) -> None:
        if self._pool is None:
            self._pool = get_reusable_executor(
                self.workers,
                timeout=_IDLE,
                initializer=start_worker,
                initargs=(_notes_folder().name, os.getpid()),
                env=WORKERS,
                kill_workers=True,
            )
        future = self._pool.submit(run_work, work)
        self._under_way[future] = work
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
            if future not in self._under_way:
                continue  # reported already, with all that a broken pool held
            try:
                result = future.result()
            except (BrokenProcessPool, CancelledError):
                return ended + self._broken()
            ended.append(Ended(self._under_way.pop(future), result))
        return ended

    def _broken(self) -> list[Ended]:
        """Everything that the pool held; work that was under way in a worker that died is reported as such."""
        ended: list[Ended] = []
        lost: list[Work] = []
        for future, work in self._under_way.items():
            # the pool gives up all that it holds; what ended before has its result
            error = future.exception()
            if error is None:
                ended.append(Ended(work, future.result()))
            elif isinstance(error, BrokenProcessPool | CancelledError):
                lost.append(work)
            else:
                raise error
        self._under_way.clear()
        self._pool = None
        noted, late = _last_output(Path(_notes_folder().name))
        suspects = {work.number for work in lost} & noted
        for work in lost:
            fault: Fault | None = None
            if work.number in late:
                fault = "late"
            elif work.number in suspects and not suspects & late:
                fault = "died"  # where one was late the others were only in the same pool
            ended.append(Ended(work, None, fault, fault == "late" or len(suspects) == 1))
        return ended

    def close(self, *, orderly: bool) -> None:
        """Leave the workers to the next run of this process; if not `orderly`, end them now."""
        if self._pool is not None and not orderly:
            pool, self._pool = self._pool, None
            # the reason is reported already: a second interrupt only ends the waiting
            with contextlib.suppress(KeyboardInterrupt):
                attempt(lambda: pool.shutdown(wait=True, kill_workers=True), _CLOSE)
        self._under_way.clear()


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


_CONNECT = "15s"
_COUNT_EVERY = 3.0  # seconds after which workers are counted again; the scheduler has other things to do
_ANSWER = 10.0  # seconds that the scheduler has to answer a question, or to hand over a result
_GRACE = 60.0  # seconds that a run goes on without any worker: one that is restarted comes back within them

_NOT_THERE: Final = (ModuleNotFoundError, ImportError, AttributeError)

_log = logging.getLogger("studies")


@dataclasses.dataclass
class _UnderWay:
    work: Work
    since: float
    alone: bool


class DaskExecutor:
    """Runs work on a Dask cluster: at an address such as ``tcp://host:8786``, or with ``"local"`` on this machine, with
    so many workers. The versions of `packages` must be the same on all of them, besides those of every study.
    """

    name = "dask"
    isolated = True

    def __init__(self, address: str, workers: int | None = None, packages: tuple[str, ...] = ()) -> None:
        self._versions = versions((*DECISIVE, *packages))
        try:
            distributed = importlib.import_module("distributed")
        except ImportError:
            raise LdcError(
                problem="a Dask cluster needs the extra cluster", hint="install ldctoolkit[cluster]"
            ) from None
        self._killed: type[Exception] = distributed.KilledWorker
        # what becomes of a worker is reported by this program itself
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._client: Any = None
        self._cluster: Any = None
        self._safe_path = contextlib.ExitStack()
        self._under_way: dict[Any, _UnderWay] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._count = 0
        self._counted_at = -float("inf")
        self._deserted_since: float | None = None
        try:
            self._open(distributed, address, workers)
            self._check_versions()
        except BaseException:
            self.close(orderly=False)
            raise

    def _open(self, distributed: Any, address: str, workers: int | None) -> None:
        try:
            if address == LOCAL:
                self._safe_path.enter_context(safe_path())  # for workers that are started later, too
                self._cluster = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, dashboard_address=None, env=WORKERS
                )
            self._client = distributed.Client(self._cluster or address, timeout=_CONNECT, name="ldc")
        except (OSError, ValueError) as error:
            raise LdcError("dask", f"no scheduler answers at {address} ({error or 'no reply'})") from None
        with self._asking():
            try:
                self._client.wait_for_workers(1, timeout=30)
            except TimeoutError:
                raise ClusterError("dask", f"the scheduler at {address} has no workers") from None

    def _check_versions(self) -> None:
        """Before anything runs; a worker that comes later checks itself, with each work."""
        with self._asking():
            request = functools.partial(worker_versions, tuple(name for name, _ in self._versions))
            answers = self._client.run(request, on_error="return")
        for worker, answer in answers.items():
            if isinstance(answer, OSError):
                continue  # it has gone
            if isinstance(answer, Exception):
                raise _unable(f"worker {worker}", answer)
            check(self._versions, answer, f"worker {worker}")

    @contextlib.contextmanager
    def _asking(self) -> Iterator[None]:
        """Say what it means when the scheduler goes while the block asks it for something."""
        try:
            yield
        except LdcError:
            raise
        except (OSError, CancelledError, asyncio.CancelledError):
            raise _disconnected() from None
        except Exception:
            if self._connected:
                raise
            # a client that has given up raises whatever its version raises
            raise _disconnected() from None

    @property
    def _connected(self) -> bool:
        return self._client.status in ("running", "connecting")

    @property
    def workers(self) -> int:
        """Threads of all workers that were there a moment ago, at least one; raises nothing."""
        self._count_workers()
        return max(1, self._count)

    def _count_workers(self) -> None:
        if time.monotonic() - self._counted_at < _COUNT_EVERY or self._client.status != "running":
            return
        # no answer: `wait` finds out whether the scheduler has gone
        with contextlib.suppress(Exception):
            self._count = int(sum(self._client.nthreads(callback_timeout=_ANSWER).values()))
        self._counted_at = time.monotonic()

    def start(self, work: Work) -> None:
        """Hand a work to the scheduler."""
        sent = pickle.dumps(work, protocol=pickle.HIGHEST_PROTOCOL)
        # a key of its own each time: the scheduler answers a key that it knows with what that gave before
        key = f"ldc-{uuid.uuid4().hex}"
        with self._asking():
            future = self._client.submit(run_checked, self._versions, sent, pure=False, key=key)
            future.add_done_callback(self._ended.put)
        for other in self._under_way.values():
            other.alone = False
        self._under_way[future] = _UnderWay(work, time.monotonic(), alone=not self._under_way)

    def wait(self) -> list[Ended]:
        """Work that has ended; waits a moment for it. The scheduler itself repeats work of workers that died."""
        try:
            future = self._ended.get(timeout=_LISTEN_EVERY)
        except queue.Empty:
            self._nothing_came()
            return []
        if future not in self._under_way:
            return []
        try:
            result = self._fetch(future)
        except self._killed as error:
            under_way = self._under_way.pop(future)
            return [Ended(under_way.work, None, _fault(under_way, error), certain=True)]
        if result is None:
            self._ended.put(future)
            self._nothing_came()
            return []
        self._deserted_since = None
        return [Ended(self._under_way.pop(future).work, result)]

    def _fetch(self, future: Any) -> Any:
        """What the work gave; None if it does not arrive, because the worker that held it has gone since."""
        if future.status != "error":
            with self._asking():
                try:
                    return future.result(timeout=_ANSWER)
                except TimeoutError:
                    return None
        try:
            return future.result(timeout=_ANSWER)
        except Exception as error:
            text = str(error)  # Dask hands on some errors as their text alone
            if isinstance(error, RuntimeError) and "deserializ" in text.lower():
                raise _unable("the scheduler", error.__cause__ or "it cannot read a task") from None
            if isinstance(error, _NOT_THERE) or text.startswith(tuple(kind.__name__ for kind in _NOT_THERE)):
                raise _unable("a worker", error) from None
            raise

    def _nothing_came(self) -> None:
        """See whether something can come at all."""
        if not self._connected:
            raise _disconnected()
        self._count_workers()
        if self._count or not self._under_way:
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
        futures = list(self._under_way)
        self._under_way.clear()
        with contextlib.suppress(*(() if orderly else (KeyboardInterrupt,))):
            attempt(lambda: self._leave(futures), _CLOSE)

    def _leave(self, futures: list[Any]) -> None:
        if self._client is not None:
            if futures:
                with contextlib.suppress(Exception):
                    self._client.cancel(futures)
            with contextlib.suppress(Exception):
                self._client.close()
        with self._safe_path:
            if self._cluster is not None:
                self._cluster.close()


def _disconnected() -> ClusterError:
    return ClusterError("dask", "the connection to the scheduler is lost", hint="what was stored is kept: run it again")


def _unable(who: str, error: object) -> ClusterError:
    """A scheduler or worker cannot read a work."""
    return ClusterError(
        "dask",
        f"{who} cannot run tasks ({error})",
        allowed="ldctoolkit in the same version on the scheduler and on every worker",
    )


def _fault(under_way: _UnderWay, error: Any) -> Fault:
    """What ended the workers that tried a work: the scheduler, which reports it, does not know.

    A work over its time takes at least the limit in each of its attempts. The time since it was sent shows this only
    if it had no other before or beside it. Otherwise it counts as "died", which is no verdict yet: it is sent again,
    alone.
    """
    attempts = error.allowed_failures + 1
    late = 0 < under_way.work.time_limit * attempts < time.monotonic() - under_way.since
    return "late" if late and under_way.alone else "died"
