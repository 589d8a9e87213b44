"""What a worker process does around a task: the time limit, and the folder that only one run may hold."""

import subprocess
import sys
from pathlib import Path

import pytest

from ldctoolkit.errors import StoreError
from studies.running.executors import processes as worker
from studies.storage.files import locked


def test_a_huge_limit_is_taken_by_this_platform() -> None:
    with worker._limited(1e300):
        assert worker._deadlines
    assert not worker._deadlines


@pytest.mark.slow
def test_a_process_over_its_time_ends() -> None:
    """Also where the interpreter has no turn, as in C code that does not come back."""
    code = "import ctypes; from studies.running.executors.processes import _limited\n"
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
    code = "import time; from studies.running.executors.processes import start_worker; "
    code += f"start_worker({str(tmp_path)!r}, {gone.pid})"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; time.sleep(600)"], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (1, "")
