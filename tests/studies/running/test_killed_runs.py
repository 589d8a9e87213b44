"""A run that is killed at any moment: the next run into its folder ends with what an uninterrupted one would have."""

import csv
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed in another way on Windows")

KILLS = 4

LONG = 600  # seconds that a whole run may take, on a machine that does other things as well and has to compile first

OFTEN = """
import sys
from ldctoolkit.studies.cli import main
from studies.running import campaign

campaign._STORE_EVERY = 0.3
sys.exit(main())
"""
"""The command, with parts stored so often that some are long before the last result."""

STUDY = """
name = "killed"
seed = 5
[scenarios]
left = 100
right = 100
[simulation]
convention = ["consistent", "as_printed"]
[ranking]
bootstrap = 200
finalists = 5
[[design]]
law = "preview_proportional"
y_s = [0.05, 0.1]
[design.gains]
K_y = { from = -0.04, to = -0.002, count = 10 }
K_psi = [-0.3, -0.2]
[[design]]
law = "stanley"
y_s = [0.05, 0.2]
[design.gains]
k = [1.0, 2.0]
# takes long enough for several parts
[[design]]
law = "linear_mpc"
y_s = [0.05, 0.1, 0.15, 0.2]
[design.gains]
q_y = { from = 1.0, to = 3.0, count = 5 }
"""


def start(folder: Path, name: str, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", OFTEN, "run", "s.toml", "-o", name, "--quiet",
         "--no-robustness", "--no-figures", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )  # fmt: skip


def kill(process: subprocess.Popen[bytes]) -> None:
    """The run itself; its workers notice."""
    os.kill(process.pid, signal.SIGKILL)
    process.wait(LONG)


def finished(folder: Path) -> bool:
    """Whether all results are stored; what a run does after that takes about as long."""
    manifest = folder / "manifest.json"
    return manifest.exists() and bool(json.loads(manifest.read_text(encoding="utf-8"))["finished"])


def parts(folder: Path) -> int:
    return len(list((folder / "results").glob("part-*")))


def wait_for_part(folder: Path, process: subprocess.Popen[bytes]) -> None:
    """Until the run has stored one more part, or has stored everything."""
    before, given_up = parts(folder), time.monotonic() + LONG
    while parts(folder) == before and not finished(folder):
        assert process.poll() is None
        assert time.monotonic() < given_up
        time.sleep(0.01)


def ranking(folder: Path) -> list[dict[str, str]]:
    """All of ``ranking.csv``."""
    with (folder / "ranking.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_kills_lose_nothing_and_leave_nothing_twice(tmp_path: Path, stored_rows: Callable[..., Any]) -> None:
    (tmp_path / "s.toml").write_text(STUDY, encoding="utf-8")
    whole = tmp_path / "whole"
    process, started = start(tmp_path, "whole", "--workers", "2"), time.monotonic()
    while not finished(whole):
        assert process.poll() is None
        time.sleep(0.01)
    took = time.monotonic() - started
    while not (whole / "ranking.csv").exists():
        assert process.poll() is None
        time.sleep(0.01)
    kill(process)  # its page is not looked at
    chance, killed = random.Random(7), tmp_path / "killed"
    unfinished = []
    for i in range(KILLS):
        process = start(tmp_path, "killed", "--workers", "2")
        # by turns as soon as one more part is stored, or all are, and at any moment, also while it ends
        if i % 2:
            time.sleep(chance.uniform(0.0, 0.4) * took)
        else:
            wait_for_part(killed, process)
        kill(process)
        if not finished(killed):
            unfinished.append(parts(killed))
    last = start(tmp_path, "killed", "--workers", "2")
    _, error = last.communicate(timeout=LONG)
    assert last.returncode == 0, error
    for rooms in ((), ("finalists",)):
        assert stored_rows(killed, *rooms).equals(stored_rows(whole, *rooms))
    assert ranking(killed) == ranking(whole)
    # not all of them were killed before or after the work
    assert any(unfinished), unfinished
    assert not list(killed.rglob(".*.part"))
