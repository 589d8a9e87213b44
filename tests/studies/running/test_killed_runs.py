"""A run that is killed at any moment: the next run into its folder ends with what an uninterrupted one would have."""

import csv
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.kills import killing
from ldctoolkit.studies import read_manifest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed in another way on Windows")

KILLS = 4

LONG = 600  # seconds that a whole run may take, on a machine that does other things as well and has to compile first

PROGRAM = """
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.running import campaign

campaign._STORE_EVERY = -1.0
campaign.Campaign._fitting = lambda *_: 8
sys.exit(main())
"""
"""The command with eight designs a task, each task stored as a part: so many steps on a machine of any speed."""

STUDY = """
name = "killed"
seed = 5
[scenarios]
left = 100
right = 100
[simulation]
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
[[design]]
law = "linear_mpc"
y_s = [0.05, 0.1, 0.15, 0.2]
[design.gains]
q_y = { from = 1.0, to = 3.0, count = 5 }
"""


def run(folder: Path, name: str, *, killed_at: int = 0) -> int:
    """The command's exit code; it is killed before it takes that step, and its workers notice. 0: it is not killed."""
    code = killing(folder / name, killed_at) + PROGRAM
    words = ["run", "s.toml", "-o", name, "--quiet", "--no-robustness", "--no-figures", "--workers", "2"]
    return subprocess.run([sys.executable, "-c", code, *words], cwd=folder, timeout=LONG, check=False).returncode


def ranking(folder: Path) -> list[dict[str, str]]:
    """All of ``ranking.csv``."""
    with (folder / "ranking.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_kills_lose_nothing_and_leave_nothing_twice(tmp_path: Path, stored_rows: Callable[..., Any]) -> None:
    (tmp_path / "s.toml").write_text(STUDY, encoding="utf-8")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert run(tmp_path, "whole") == 0
    chance, stages = random.Random(10), []
    for _ in range(KILLS):
        assert run(tmp_path, "killed", killed_at=chance.randint(20, 40)) == -signal.SIGKILL
        stages.append((any(killed.glob("results/part-*")), bool(read_manifest(killed).finished)))
    assert run(tmp_path, "killed") == 0
    for rooms in ((), ("finalists",)):
        assert stored_rows(killed, *rooms).equals(stored_rows(whole, *rooms))
    assert ranking(killed) == ranking(whole)
    # some were killed while results were stored, others when all were
    assert {(True, False), (True, True)} <= set(stages), stages
    assert not list(killed.rglob(".*.part"))
