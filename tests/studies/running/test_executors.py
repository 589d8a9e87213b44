"""Where a study runs makes no difference: one process, two, a Dask cluster over TCP; the same rows and rankings."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ldctoolkit.errors import InputError, LdcError
from studies import Study, StudyResults, rank_study, run_study
from studies.running.executors import make_executor

MakeStudy = Callable[..., Study]

DESIGNS = [
    {"law": "none"},
    {"law": "preview_proportional", "y_s": [0.05, 0.2], "gains": {"K_y": [-0.02, -0.005, -0.001]}},
    {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [50, 500]}},
    {"law": ["linear_mpc", "stanley"], "y_s": [0.05, 0.1]},
]


@pytest.fixture
def study(make_study: MakeStudy) -> Study:
    """Linear laws and others, noise and mismatch, two cases, finalists: all that could depend on the split."""
    return make_study(
        scenarios={"left": 40, "right": 30},
        ranking={"bootstrap": 300, "finalists": 3},
        simulation={"window": ["departure", "control"]},
        plant={
            "mismatch": {"m": [1.0, 1.3]},
            "sensors": {"e_y_noise": 0.03, "delay": 0.1, "kalman": {}},
            "residuals": {"y": True},
        },
        design=DESIGNS,
    )


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as processes of their own, over loopback TCP."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler_words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker_words = ["worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
    processes = []
    try:
        for words in (scheduler_words, *[worker_words] * workers):
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
        yield address, processes[1:]
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(30)


def assert_same(one: StudyResults, other: StudyResults, study: Study) -> None:
    for a, b in zip(rank_study(one, study), rank_study(other, study), strict=True):
        for field in dataclasses.fields(a):
            left, right = getattr(a, field.name), getattr(b, field.name)
            if isinstance(left, np.ndarray):
                np.testing.assert_array_equal(left, right, err_msg=field.name)
            elif field.name != "release":  # holds the laws' times, which no second run gives again
                assert left == right, field.name


@pytest.mark.slow
def test_serial_processes_and_a_dask_cluster_give_the_same_bits(
    study: Study, tmp_path: Path, stored_rows: Callable[..., Any]
) -> None:
    """With any block size; the rows of both stores, the study's and its finalists', and the rankings."""
    reference = run_study(study, directory=tmp_path / "serial", executor="serial")
    ways: dict[str, dict[str, Any]] = {
        "serial-1": {"executor": "serial", "block_size": 1},
        "serial-7": {"executor": "serial", "block_size": 7},
        "processes": {"workers": 2},
        "processes-1": {"workers": 2, "block_size": 1},
        "processes-5": {"workers": 2, "block_size": 5},
    }
    with cluster(tmp_path) as (address, _):
        ways |= {"dask": {"dask": address}, "dask-1": {"dask": address, "block_size": 1}}
        for name, how in ways.items():
            assert_same(run_study(study, directory=tmp_path / name, **how), reference, study)
            for parts in ((), ("finalists",)):
                expected = stored_rows(tmp_path / "serial", *parts)
                assert stored_rows(tmp_path / name, *parts).equals(expected), (name, parts)
    assert len(expected) == 70 * len(reference.fresh.designs)  # type: ignore[union-attr]


@pytest.mark.slow
def test_a_dask_worker_that_is_killed_loses_nothing(
    make_study: MakeStudy, tmp_path: Path, stored_rows: Callable[..., Any]
) -> None:
    designs = [{"law": "linear_mpc", "y_s": {"from": 0.05, "to": 0.2, "count": 60}}]
    study = make_study(design=designs, scenarios={"left": 100, "right": 100})
    run_study(study, directory=tmp_path / "serial", executor="serial")
    with cluster(tmp_path) as (address, workers):
        ended: list[Any] = []
        runner = threading.Thread(
            target=lambda: ended.append(run_study(study, directory=tmp_path / "dask", dask=address, block_size=1))
        )
        runner.start()
        # in the midst of it: the first results are there, the last are not
        while runner.is_alive() and not list((tmp_path / "dask" / "results").glob("part-*")):
            time.sleep(0.05)
        killed = workers[0]
        os.killpg(killed.pid, signal.SIGKILL)  # the worker and the nanny that would start another
        in_the_midst = runner.is_alive()
        runner.join(300)
    assert in_the_midst
    assert ended
    assert stored_rows(tmp_path / "dask").equals(stored_rows(tmp_path / "serial"))


def test_what_cannot_be_used_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="executor: 'serial' with the address tcp://h:1; allowed with an address: 'dask'"
    ):
        make_executor("serial", None, "tcp://h:1")
    with pytest.raises(InputError, match=r"workers: 3 with the cluster at tcp://127\.0\.0\.1:1; allowed"):
        make_executor(None, 3, "tcp://127.0.0.1:1")
    with pytest.raises(LdcError, match=r"dask: no scheduler answers at tcp://127\.0\.0\.1:1 "):
        make_executor(None, None, "tcp://127.0.0.1:1")
    with pytest.raises(LdcError, match="dask: no scheduler answers at nowhere"):
        make_executor(None, None, "nowhere")


def test_missing_dask_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(LdcError, match=r"install ldctoolkit\[cluster\]"):
        make_executor(None, None, "local")
