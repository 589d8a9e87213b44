"""Where a study runs makes no difference: one process, two, a Dask cluster over TCP; the same rows and rankings."""

import concurrent.futures
import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from loky.process_executor import BrokenProcessPool

from ldctoolkit.errors import ClusterError, InputError, LdcError
from ldctoolkit.studies import Study, StudyResults, rank_study, run_study
from ldctoolkit.studies.running import campaign, executors
from ldctoolkit.studies.running.dispatch import Executor
from ldctoolkit.studies.running.executors import make_executor
from ldctoolkit.studies.running.tasks import Done
from ldctoolkit.studies.storage.store import Store

MakeStudy = Callable[..., Study]

LONG = 600  # seconds that a process which is sure to end may take, on a machine that does other things as well

DESIGNS = [
    {"law": "none"},
    {"law": "preview_proportional", "y_s": [0.05, 0.2], "gains": {"K_y": [-0.02, -0.005, -0.001]}},
    {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [50, 500]}},
    {"law": ["linear_mpc", "stanley"], "y_s": [0.05, 0.1]},
]


@pytest.fixture
def study(make_study: MakeStudy) -> Study:
    """Linear laws and others, noise and mismatch, finalists: all that could depend on the split."""
    return make_study(
        scenarios={"left": 40, "right": 30},
        ranking={"bootstrap": 300, "finalists": 3},
        simulation={"window": "control"},
        plant={
            "mismatch": {"m": [1.0, 1.3]},
            "sensors": {"e_y_noise": 0.03, "delay": 0.1, "kalman": {}},
            "residuals": {"y": True},
        },
        design=DESIGNS,
    )


@contextlib.contextmanager
def cluster(
    folder: Path, workers: int = 2, scheduler: tuple[str, ...] = (), later: tuple[str, ...] = ()
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as processes of their own, over loopback TCP; the scheduler is the last of them. With
    `later` there is one more worker, before it; `scheduler` and `later` are more words of the command line. All have
    met when the block begins."""
    import distributed

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler_words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", *scheduler]
    worker_words = ["worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
    processes = []
    try:
        for words in (scheduler_words, *[worker_words] * workers, *([[*worker_words, *later]] if later else [])):
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
        with distributed.Client(address, timeout=LONG, set_as_default=False) as client:
            client.wait_for_workers(len(processes) - 1, timeout=LONG)
        yield address, [*processes[1:], processes[0]]
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(LONG)


def assert_same(result: StudyResults, reference: StudyResults, study: Study) -> None:
    """The same rankings, but for what holds the laws' times, which no second run gives again."""
    left, right = (
        rank_study(results, study).to_polars().drop("law_time_us", strict=False) for results in (result, reference)
    )
    assert left.equals(right)


@pytest.mark.slow
def test_serial_processes_and_dask_are_equal(study: Study, tmp_path: Path, stored_rows: Callable[..., Any]) -> None:
    """With any block size; the rows of both stores, the study's and its finalists', and the rankings."""
    reference = run_study(study, directory=tmp_path / "serial", executor="serial")
    ways: dict[str, dict[str, Any]] = {
        "serial-1": {"executor": "serial", "block_size": 1}, "serial-7": {"executor": "serial", "block_size": 7},
        "processes": {"workers": 2}, "processes-1": {"workers": 2, "block_size": 1},
        "processes-5": {"workers": 2, "block_size": 5},
    }  # fmt: skip
    with cluster(tmp_path) as (address, _):
        ways |= {"dask": {"dask": address}, "dask-1": {"dask": address, "block_size": 1}}
        for name, how in ways.items():
            assert_same(run_study(study, directory=tmp_path / name, **how), reference, study)
            for parts in ((), ("finalists",)):
                expected = stored_rows(tmp_path / "serial", *parts)
                assert stored_rows(tmp_path / name, *parts).equals(expected), (name, parts)
    assert len(expected) == 70 * len(reference.fresh.designs)  # type: ignore[union-attr]


def at_the_first_part(patch: pytest.MonkeyPatch, event: Callable[[], None]) -> None:
    """Each result is a part, and as soon as the first is stored something happens; the run waits for it."""
    add, left = Store.add, [event]

    def added(*content: Any) -> None:
        add(*content)
        if left:
            left.pop()()

    patch.setattr(campaign, "_STORE_EVERY", -1.0)
    patch.setattr(Store, "add", added)


@pytest.mark.slow
def test_a_dask_worker_that_is_killed_loses_nothing(
    make_study: MakeStudy, tmp_path: Path, stored_rows: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    designs = [{"law": "linear_mpc", "y_s": {"from": 0.05, "to": 0.2, "count": 20}}]
    study = make_study(design=designs, scenarios={"left": 20, "right": 20})
    run_study(study, directory=tmp_path / "serial", executor="serial")
    with cluster(tmp_path) as (address, workers):
        # the worker and the nanny that would start another
        at_the_first_part(monkeypatch, lambda: os.killpg(workers[0].pid, signal.SIGKILL))
        run_study(study, directory=tmp_path / "dask", dask=address, block_size=1)
        assert workers[0].wait(LONG) == -signal.SIGKILL
    assert stored_rows(tmp_path / "dask").equals(stored_rows(tmp_path / "serial"))


@pytest.mark.parametrize(
    ("arguments", "path", "value"),
    [
        (("serial", None, "tcp://h:1"), "executor", "serial"),
        ((None, 3, "tcp://127.0.0.1:1"), "workers", 3),
        ((None, None, ""), "dask", ""),
        ((None, None, " "), "dask", " "),
        ((None, None, "tcp://127.0.0.1:1"), "dask", None),
        ((None, None, "nowhere"), "dask", None),
    ],
)
def test_what_cannot_be_used_is_named(
    arguments: Any, path: str, value: str | int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "_CONNECT", "1s")
    with pytest.raises(LdcError) as refused:
        make_executor(*arguments)
    assert refused.value.path == path
    assert value is None or refused.value.value == value


def test_missing_dask_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(LdcError, match=r"install ldctoolkit\[cluster\]"):
        make_executor(None, None, "local")


class FakeFuture:
    """As one of Dask: pending until it gives something, or raises it."""

    def __init__(self) -> None:
        self.status = "pending"
        self.outcome: Any = None
        self.callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self.callbacks.append(callback)

    def end(self, status: str, outcome: Any) -> None:
        self.status, self.outcome = status, outcome
        for callback in self.callbacks:
            callback(self)

    def result(self, timeout: float) -> Any:
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome


class KilledWorker(Exception):
    allowed_failures = 3


class FakeClient:
    """As one of Dask, of a scheduler that may have gone."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self.status = "running"
        self.threads: Any = {"tcp://w:1": 2}
        self.there: dict[str, Any] = {}
        self.asked = 0
        self.futures: list[FakeFuture] = []
        self.sent: list[tuple[Any, ...]] = []
        self.keys: list[str] = []
        self.fails: Exception | None = None

    def wait_for_workers(self, n: int, timeout: float) -> None:
        pass

    def run(self, function: Callable[[], Any], on_error: str) -> dict[str, Any]:
        return self.there or {"tcp://w:1": function()}

    def nthreads(self, callback_timeout: float) -> dict[str, int]:
        self.asked += 1
        if self.fails:
            raise self.fails
        return dict(self.threads)

    def submit(self, *sent: Any, pure: bool, key: str) -> FakeFuture:
        if self.fails:
            raise self.fails
        self.sent.append(sent)
        self.keys.append(key)
        self.futures.append(FakeFuture())
        return self.futures[-1]

    def cancel(self, futures: Any) -> None:
        if self.fails:
            raise self.fails

    def close(self) -> None:
        if self.fails:
            raise self.fails
        self.status = "closed"


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    """What a `DaskExecutor` finds behind any address; the executor looks often and does not wait."""
    found = FakeClient()
    fake = types.SimpleNamespace(KilledWorker=KilledWorker, Client=lambda *_, **__: found)
    monkeypatch.setitem(sys.modules, "distributed", fake)
    monkeypatch.setattr(executors, "_LISTEN_EVERY", 0.001)
    return found


def a_task(time_limit: float = 0.0) -> Any:
    """All that an executor looks at."""
    return types.SimpleNamespace(number=1, time_limit=time_limit)


def connected() -> executors.DaskExecutor:
    return executors.DaskExecutor("tcp://h:1")


def listen(executor: Executor, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        executor.wait()


LOST = "the connection to the scheduler is lost; what was stored is kept: run it again"


def test_a_result_whose_worker_has_gone_is_waited_for(client: FakeClient) -> None:
    executor = connected()
    executor.start(a_task())
    client.futures[0].end("finished", TimeoutError())
    assert executor.wait() == []
    client.futures[0].outcome = done = Done(None)  # type: ignore[arg-type]
    assert [ended.result for ended in executor.wait()] == [done]


def test_no_workers(client: FakeClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(executors, "_COUNT_EVERY", 0.0)
    executor = connected()
    executor.start(a_task())
    assert executor.wait() == []
    assert not caplog.records
    client.threads = {}
    for _ in range(5):
        assert executor.wait() == []
    assert caplog.messages == ["dask: all workers have gone; the run waits 60 s for others"]
    # one comes back, and the time begins anew
    client.threads = {"tcp://w:2": 1}
    executor.wait()
    monkeypatch.setattr(executors, "_GRACE", 0.0)
    client.threads = {}
    executor.wait()
    time.sleep(0.002)
    with pytest.raises(ClusterError, match="all workers have gone, and none has come for 0 s; what was stored is kept"):
        executor.wait()


def test_a_task_is_late_where_nothing_else_took_the_time(client: FakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of 10 s and four attempts: 41 s alone are too long; 39 s, or 41 s beside another task, tell nothing."""
    now = 0.0
    monkeypatch.setattr(executors.time, "monotonic", lambda: now)
    faults = []
    for seconds, others, limit in ((41.0, 0, 10.0), (39.0, 0, 10.0), (41.0, 1, 10.0), (1e9, 0, 0.0)):
        now = 0.0
        executor = connected()
        client.futures.clear()
        for _ in range(others + 1):
            executor.start(a_task(limit))
        now = seconds
        for future in client.futures:
            future.end("error", KilledWorker())
        while ended := executor.wait():
            assert ended[0].certain
            assert ended[0].result is None
            faults.append(ended[0].fault)
    assert faults == ["late", "died", "died", "died", "died"]


def test_a_task_that_is_sent_again_has_another_key(client: FakeClient) -> None:
    """The scheduler would answer the old one with the old fault, or with what another run of the study asked."""
    executor, task = connected(), a_task()
    executor.start(task)
    executor.start(task)
    assert len(set(client.keys)) == 2


@pytest.mark.slow
def test_a_dask_scheduler_that_is_killed_ends_the_run(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    designs = [{"law": "linear_mpc", "y_s": {"from": 0.05, "to": 0.2, "count": 20}}]
    study = make_study(design=designs, scenarios={"left": 20, "right": 20})
    with cluster(tmp_path) as (address, processes):
        at_the_first_part(monkeypatch, lambda: os.killpg(processes[-1].pid, signal.SIGKILL))
        with pytest.raises(ClusterError, match=LOST):
            run_study(study, directory=tmp_path / "dask", dask=address, block_size=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preload", "message"),
    [
        ("import sys; sys.modules['ldctoolkit.studies'] = None", r"worker tcp://\S+ cannot run tasks"),
        (
            "import importlib.metadata as m; m.version = lambda n, v=m.version: '0.1' if n == 'scipy' else v(n)",
            r"worker tcp://\S+ has scipy 0\.1",
        ),
    ],
)
def test_a_dask_worker_of_another_kind_is_refused(tmp_path: Path, preload: str, message: str) -> None:
    with (
        cluster(tmp_path, workers=0, later=("--preload", preload)) as (address, _),
        pytest.raises(LdcError, match=message),
    ):
        make_executor(None, None, address)


@pytest.mark.slow
def test_a_dask_worker_that_joins_later_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one that was there goes, and one with another SciPy comes: the study ends, and says why."""
    monkeypatch.setattr(executors, "_GRACE", float(LONG))
    preload = tmp_path / "other.py"
    preload.write_text(
        "import importlib.metadata as m\nm.version = lambda n, v=m.version: '0.1' if n == 'scipy' else v(n)"
    )
    with cluster(tmp_path, workers=1) as (address, processes_there):
        executor = make_executor(None, None, address)
        os.killpg(processes_there[0].pid, signal.SIGKILL)
        words = [address, "--nthreads", "1", "--no-dashboard", "--preload", str(preload)]
        other = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", *words, "--local-directory", str(tmp_path)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            executor.start(a_task())
            with pytest.raises(InputError, match=r"dask: a worker has scipy 0\.1, the process that sends the work"):
                listen(executor, LONG)
        finally:
            executor.close(orderly=False)
            os.killpg(other.pid, signal.SIGKILL)
            other.wait(LONG)


@pytest.mark.slow
def test_a_dask_scheduler_without_the_toolkit_is_told(make_study: MakeStudy, tmp_path: Path) -> None:
    preload = ("--preload", "import sys; sys.modules['ldctoolkit.studies'] = None")
    told = pytest.raises(ClusterError, match="the scheduler cannot run tasks")
    with cluster(tmp_path, workers=1, scheduler=preload) as (address, _), told:
        run_study(make_study(), directory=tmp_path / "results", dask=address)


def test_processes_that_cannot_start_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pool that is broken as soon as it is made, and a machine that gives no processes."""
    for error in (BrokenProcessPool("a worker ended"), OSError(11, "Resource temporarily unavailable")):

        def submit(*_: Any, error: Exception = error) -> None:
            raise error

        monkeypatch.setattr(executors, "get_reusable_executor", lambda *_, **__: types.SimpleNamespace(submit=submit))
        executor = executors.ProcessExecutor(2)
        with pytest.raises(
            LdcError, match=r"worker processes cannot start \(.*(ended|unavailable)\); what was stored is kept"
        ):
            executor.start(a_task())


def test_last_output_are_read_by_the_line(tmp_path: Path) -> None:
    """A late task's dump names files, whose paths may hold words of a note."""
    dump = (
        'Timeout (0:00:04)!\nThread 0x1 (most recent call first):\n  File "/home/task 7/done\'s task 9", line 3 in f\n'
    )
    (tmp_path / "1").write_text(f"task 3\ndone\ntask 12\n{dump}")
    (tmp_path / "2").write_text("task 4\ndone\n")
    (tmp_path / "3").write_text("task 4\ndone\ntask 5\n")
    (tmp_path / "4").write_text("")
    assert executors._last_output(tmp_path) == ({12, 5}, {12})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("hurdle", ["raises", "hangs", "is interrupted"])
def test_giving_up_neither_raises_nor_hangs(client: FakeClient, monkeypatch: pytest.MonkeyPatch, hurdle: str) -> None:
    release, waited = threading.Event(), []

    def end(*_: Any, **__: Any) -> None:
        if hurdle == "raises":
            raise OSError("gone")
        release.wait(LONG)
        waited.append(True)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(executors, "_CLOSE", 0.01)
    on_dask = connected()
    on_dask.start(a_task())
    monkeypatch.setattr(client, "cancel", end)
    pool = types.SimpleNamespace(submit=lambda *_: concurrent.futures.Future(), shutdown=end)
    monkeypatch.setattr(executors, "get_reusable_executor", lambda *_, **__: pool)
    here = executors.ProcessExecutor(2)
    here.start(a_task())
    try:
        with monkeypatch.context() as patch:
            if hurdle == "is interrupted":
                patch.setattr(threading.Thread, "join", interrupted)
            on_dask.close(orderly=False)
            here.close(orderly=False)
        assert not waited
    finally:
        release.set()
