"""What a worker process does around a task: the time limit, and the folder that only one run may hold."""

from __future__ import annotations

import faulthandler
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ldctoolkit.errors import StoreError
from studies import Study
from studies.runner import study_model
from studies.running import worker
from studies.running.simulate_designs import SimulationTask
from studies.running.tasks import Job
from studies.storage.folder_lock import locked


def a_task(study: Study, time_limit: float) -> SimulationTask:
    simulation = study.simulation
    job = Job(
        token=f"test of {time_limit}",
        vehicle=study.vehicle,
        dt=simulation.dt,
        windows=simulation.window,
        initial_yaw_rate=simulation.initial_yaw_rate,
        options=study.plant,
        settle=simulation.settle,
        seed=study.seed,
        time_limit=time_limit,
    )
    scenarios = study_model(study).sample(study.scenarios.left, study.scenarios.right, seed=study.seed)
    rows = np.arange(len(scenarios))
    return SimulationTask(job, "consistent", tuple(study.designs[:1]), rows, scenarios, 0, rows.size)


@pytest.mark.parametrize("limit", [1e-9, 4e6, 1e7, 1e12, 1e300])
def test_the_watch_is_set_within_what_every_platform_takes(
    make_study: Callable[..., Study], monkeypatch: pytest.MonkeyPatch, limit: float
) -> None:
    """And changes no number; the watch is only looked at here, for it would end this process."""
    waits: list[float] = []

    def watch(seconds: float, **_: Any) -> None:
        waits.append(seconds)

    expected = worker.run_task(a_task(make_study(), 0.0))
    monkeypatch.setattr(faulthandler, "dump_traceback_later", watch)
    done = worker.run_task(a_task(make_study(), limit))
    (seconds,) = waits
    assert 0.001 <= seconds <= 0xFFFFFFFE / 1000  # milliseconds in 32 bits, the least that a platform takes
    assert seconds == pytest.approx(min(max(limit, 0.001), 4e6), rel=1e-3)
    np.testing.assert_array_equal(done.result.values, expected.result.values)


def test_a_huge_limit_is_taken_by_this_platform() -> None:
    with worker._limited(1e300):
        assert worker._deadlines
    assert not worker._deadlines


def test_an_error_of_the_run_is_not_one_of_the_lock(tmp_path: Path) -> None:
    with pytest.raises(PermissionError, match="of the run"), locked(tmp_path):
        raise PermissionError("of the run")
    with locked(tmp_path):  # and it is let go
        pass


def test_a_folder_that_cannot_be_held_is_named(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    with pytest.raises(StoreError, match=f"{tmp_path}: cannot be written: Is a directory"), locked(tmp_path):
        pass


@pytest.mark.skipif(sys.platform == "win32", reason="a process keeps its parent there")
def test_a_worker_whose_parent_was_killed_before_it_began_leaves(tmp_path: Path) -> None:
    """It would run on for ever, with nobody to read what it computes."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    code = f"import time; from studies.running.worker import start_worker; start_worker({str(tmp_path)!r}, {gone.pid})"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; time.sleep(600)"], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (1, "")
