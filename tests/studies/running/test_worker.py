"""What a worker process does around a task: the time limit, and the folder that only one run may hold."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.closed_loop import known
from ldctoolkit import Controller, Scenarios, Setup
from ldctoolkit.errors import StoreError
from ldctoolkit.studies import risk
from ldctoolkit.studies.running import campaign, tasks
from ldctoolkit.studies.running import executors as worker
from ldctoolkit.studies.storage.checked_parts import locked


def test_a_huge_limit_is_taken_by_this_platform() -> None:
    with worker._limited(1e300):
        assert worker._deadlines
    assert not worker._deadlines


@pytest.mark.slow
def test_a_process_over_its_time_ends() -> None:
    """Also where the interpreter has no turn, as in C code that does not come back."""
    code = "import ctypes; from ldctoolkit.studies.running.executors import _limited\n"
    code += "with _limited(0.1): ctypes.PyDLL(None).sleep(600)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr[:17]) == (1, "Timeout (0:00:00.")


def test_an_error_of_the_run_is_not_one_of_the_lock(tmp_path: Path) -> None:
    with pytest.raises(PermissionError, match="of the run"), locked(tmp_path):
        raise PermissionError("of the run")
    with locked(tmp_path):  # and it is let go
        pass


def test_a_folder_that_cannot_be_held_is_named(tmp_path: Path) -> None:
    (tmp_path / ".lock").mkdir()
    with pytest.raises(StoreError, match=f"{tmp_path}: cannot be written: Is a directory"), locked(tmp_path):
        pass


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a process keeps its parent there")
def test_a_worker_whose_parent_was_killed_before_it_began_leaves(tmp_path: Path) -> None:
    """It would run on for ever, with nobody to read what it computes."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    code = "import time; from ldctoolkit.studies.running.executors import start_worker; "
    code += f"start_worker({str(tmp_path)!r}, {gone.pid})"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; time.sleep(600)"], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (1, "")


@dataclasses.dataclass(frozen=True)
class Undeclared(Controller):
    name = "undeclared"
    title = "Says nothing of its law, and cannot make one"

    def prepare(self, plant):  # type: ignore[no-untyped-def]
        raise AssertionError("a law of a user runs in a worker only")


@pytest.mark.parametrize(
    ("laws", "driven"),
    [
        ({"none"}, []),
        ({"none", "lqr", "preview_lqr"}, ["preview_proportional"]),
        ({"stanley", "lqi"}, ["pid", "preview_proportional"]),
        ({"linear_mpc"}, ["linear_mpc"]),
        ({"undeclared"}, ["pid", "preview_proportional"]),
    ],
)
def test_only_the_loops_that_laws_need_are_loaded(
    laws: set[str], driven: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    monkeypatch.setattr(tasks, "drive", lambda law, over, threads: made.append(law.name) or 1 // over.m)
    scenarios = Scenarios.from_arrays(T=[3.0] * 30, d_y=[0.8] * 30, v_mean=np.linspace(10.0, 39.0, 30), side=[1] * 30)
    with known(Undeclared):
        tasks.load_loops(laws, scenarios, Setup(), 0.2)
    assert made == driven


def test_the_slowest_and_the_fastest_choose_the_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    speeds: list[float] = []
    monkeypatch.setattr(tasks, "drive", lambda law, over, threads: speeds.extend(over.plant.v))
    scenarios = Scenarios.from_arrays(T=[3.0] * 30, d_y=[0.8] * 30, v_mean=np.roll(np.arange(10.0, 40.0), 7), side=1)
    tasks.load_loops({"lqr"}, scenarios, Setup(), 0.2)
    assert sorted(speeds) == [*np.arange(10.0, 18.0), *np.arange(32.0, 40.0)]


def test_loops_are_loaded_here_before_any_task_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they are not on disk, that compiles them in one process."""
    order: list[object] = []
    start = worker.SerialExecutor.start
    for module in (campaign, risk):
        monkeypatch.setattr(module, "load_loops", lambda laws, *_: order.append(laws))
    monkeypatch.setattr(worker.SerialExecutor, "start", lambda self, task: order.append("task") or start(self, task))
    study = ldc.study(ldc.NoControl, ldc.LQR(r_delta=5000.0), ldc.LQR(), ldc.PID(), left=20, right=20)
    ldc.run_study(study, workers=1)
    assert order[:2] == [{"none", "lqr", "pid"}, "task"]
    order.clear()
    risk.estimate_risk(study.designs, study, n=20, workers=1)
    assert order == [{"none", "lqr", "pid"}, "task"]


@pytest.mark.slow
def test_a_first_run_compiles_in_one_process_and_says_so(tmp_path: Path) -> None:
    """With nothing on disk: one line, first of all; what is on disk afterwards is what a linear law needs."""
    study = '[[design]]\nlaw = "lqr"\n[[design]]\nlaw = "lqi"\n[scenarios]\nmodel = "reference"\nleft = 9\nright = 9\n'
    study += "[scenarios.given]\nv_mean = [20.0, 30.0]\n"  # slower ones would be driven by the loop of any plant
    (tmp_path / "s.toml").write_text(f'name = "s"\n{study}', encoding="utf-8")
    command = [sys.executable, "-m", "ldctoolkit", "run", "s.toml", "--json", "--workers", "2", "--no-robustness"]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, capture_output=True,
        text=True, timeout=900, check=True,
    )  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[0] == {"event": "phase", "phase": "compiling the closed loops, once, about a minute"}
    assert [line["event"] for line in lines].count(
        "phase"
    ) == 3  # the others: choosing the finalists, and what they measure
    assert done.stderr == ""
    loops = {path.name.split(".")[3].split("-")[0] for path in (tmp_path / "cache").rglob("entry.*.nbi")}
    assert loops == {"drive_lanes"}


@pytest.mark.slow
def test_what_a_linear_mpc_needs_is_loaded_before_its_tasks() -> None:
    """With what prepares quadratic programs, which many departures never need: workers would compile it each."""
    code = (
        "import ldctoolkit as ldc, ldctoolkit.controllers._mpc_kernel as kernel\n"
        "from ldctoolkit.studies.running.tasks import load_loops\n"
        "load_loops(['linear_mpc'], ldc.load_model('reference').sample(9, 9, seed=1), ldc.Setup(), 0.1)\n"
        "print(*(len(getattr(kernel, name).signatures) for name in ('sweep', 'assemble', 'finish')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout == "1 1 1\n"
