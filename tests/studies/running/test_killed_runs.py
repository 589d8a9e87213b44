"""A run that is killed at any moment: the next run into its folder ends with what an uninterrupted one would have."""

from __future__ import annotations

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

KILLS = 20

STUDY = """
name = "killed"
seed = 5
[scenarios]
left = 400
right = 400
[simulation]
convention = ["consistent", "as_printed"]
[ranking]
bootstrap = 200
finalists = 5
[[design]]
law = "preview_proportional"
y_s = [0.05, 0.1]
[design.gains]
K_y = { from = -0.04, to = -0.002, count = 40 }
K_psi = [-0.3, -0.2]
[[design]]
law = "stanley"
y_s = [0.05, 0.2]
[design.gains]
k = [1.0, 2.0]
"""


def start(folder: Path, name: str, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "ldctoolkit", "run", "s.toml", "-o", name, "--quiet",
         "--no-robustness", "--no-figures", *words],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )  # fmt: skip


def kill(process: subprocess.Popen[bytes]) -> None:
    """The run itself; its workers notice."""
    os.kill(process.pid, signal.SIGKILL)
    process.wait(60)


def seconds_to_finish(folder: Path, name: str) -> float:
    """Until all results are stored; what a run does after that, writing its report, takes longer than the rest."""
    started, process, took = time.monotonic(), start(folder, name, "--workers", "2"), 0.0
    manifest = folder / name / "manifest.json"
    while process.poll() is None:
        if not took and manifest.exists() and json.loads(manifest.read_text(encoding="utf-8"))["finished"]:
            took = time.monotonic() - started
        time.sleep(0.01)
    assert process.returncode == 0
    assert took
    return took


def ranking(folder: Path) -> list[dict[str, str]]:
    """All of ``ranking.csv`` but how long the laws took, which no second run gives again."""
    with (folder / "ranking.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        del row["law_time_us"]
    return rows


@pytest.mark.slow
def test_twenty_kills_lose_nothing_and_leave_nothing_twice(tmp_path: Path, stored_rows: Callable[..., Any]) -> None:
    (tmp_path / "s.toml").write_text(STUDY, encoding="utf-8")
    for name in ("first", "whole"):  # the first one may have to compile
        took = seconds_to_finish(tmp_path, name)
    chance = random.Random(7)
    kept = []
    for _ in range(KILLS):
        process = start(tmp_path, "killed", "--workers", "2")
        # anywhere in a run, from its first moments on; what the runs before stored makes later ones shorter
        time.sleep(chance.uniform(0.15, 0.85) * took)
        kill(process)
        kept.append(len(list((tmp_path / "killed" / "results").glob("part-*"))))
    last = start(tmp_path, "killed", "--workers", "2")
    _, error = last.communicate(timeout=300)
    assert last.returncode == 0, error
    for parts in ((), ("finalists",)):
        assert stored_rows(tmp_path / "killed", *parts).equals(stored_rows(tmp_path / "whole", *parts))
    killed, uninterrupted = (ranking(tmp_path / name) for name in ("killed", "whole"))
    assert killed == uninterrupted
    # they were killed at different stages, not all of them before or after the work
    assert len(set(kept)) > 1
    assert not list((tmp_path / "killed").rglob(".*.part"))
