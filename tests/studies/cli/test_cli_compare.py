"""``ldc compare`` as people meet it: real processes, exit codes, tables, files, one message for wrong input."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from studies import Study, run_study

STUDY: dict[str, Any] = {
    "name": "before",
    "seed": 2,
    "scenarios": {"left": 150, "right": 100},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.2]}],
}


def ldc(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ldctoolkit", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``old``; ``new`` on more scenarios with a slow actuator and one more design; ``seed`` with other scenarios."""
    root = tmp_path_factory.mktemp("compare")
    slow: dict[str, Any] = {
        "name": "after",
        "scenarios": {"left": 200, "right": 120},
        "plant": {"actuator": {"lag": 0.3}},
        "design": [*STUDY["design"], {"law": "preview_proportional"}],
    }
    studies: dict[str, dict[str, Any]] = {"old": {}, "new": slow, "seed": {"seed": 3}}
    for folder, parts in studies.items():
        run_study(Study.from_dict(STUDY | parts), directory=root / folder, workers=1)
    return root


@pytest.fixture
def bad(folders: Path) -> Callable[..., str]:
    """Run what must be refused: exit code 2, one message, nothing on stdout, no file added."""

    def run(*arguments: object) -> str:
        before = sorted(folders.rglob("*"))
        done = ldc("compare", *arguments, cwd=folders)
        assert (done.returncode, done.stdout) == (2, ""), (done.stdout, done.stderr)
        assert re.fullmatch(r"ldc: error: [^\n]+\n", done.stderr), done.stderr
        assert sorted(folders.rglob("*")) == before
        return done.stderr

    return run


def test_tables_and_csv(folders: Path, tmp_path: Path) -> None:
    target = tmp_path / "c.csv"
    done = ldc("compare", "old", "new", "-o", target, cwd=folders)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[:2] == ["old: old (before)", "new: new (after)"]
    # what differs comes before any number
    inputs = lines.index("Inputs that differ, old -> new:")
    assert lines[inputs + 1] == "  plant.actuator.lag: 0.0 -> 0.3"
    assert inputs < next(i for i, line in enumerate(lines) if "3 designs in both studies, 250 shared scenarios" in line)
    assert re.search(r"│ worse +│ LQR, y_s=0.05 m", done.stdout)
    assert "the same within 1e-6 m s: 1 of 3 designs" in done.stdout
    assert "Only in the new study: 1 design\n" in done.stdout
    assert "250 shared scenarios (150 left, 100 right)" in lines[-2]
    assert lines[-1] == f"comparison: {target}"
    with target.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["compared"] for row in rows] == ["design"] * 3 + ["winners"]
    assert {row["verdict"] for row in rows if row["label_new"].startswith("LQR")} == {"worse"}
    assert rows[2]["difference_m_s"] == "0.0"


def test_the_page_and_the_csv_file_at_once(folders: Path, tmp_path: Path) -> None:
    targets = [tmp_path / "c.csv", tmp_path / "c.html"]
    done = ldc("compare", "old", "new", "-o", targets[0], "-o", targets[1], cwd=folders)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-2:] == [f"comparison: {target}" for target in targets]
    assert targets[1].read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert "plant.actuator.lag" in targets[1].read_text(encoding="utf-8")


def test_fewer_rows_on_request(folders: Path) -> None:
    done = ldc("compare", "old", "new", "--top", 1, cwd=folders)
    assert done.returncode == 0
    assert done.stdout.count("│ worse") == 1


def test_json_and_exit_code_for_scripts(folders: Path) -> None:
    done = ldc("compare", "old", "new", "--json", "--fail-if-worse", cwd=folders)
    assert done.returncode == 3, done.stderr
    content = json.loads(done.stdout)
    assert content["worse"] is True
    assert content["differences"][0] == "plant.actuator.lag: 0.0 -> 0.3"
    assert len(content["rows"]) == 4
    back = ldc("compare", "new", "old", "--json", "--fail-if-worse", cwd=folders)
    assert back.returncode == 0
    assert json.loads(back.stdout)["worse"] is False


def test_a_copy_is_the_same(folders: Path, tmp_path: Path) -> None:
    shutil.copytree(folders / "old", tmp_path / "copy")
    done = ldc("compare", folders / "old", tmp_path / "copy", "--fail-if-worse", cwd=folders)
    assert done.returncode == 0
    assert "The inputs are the same" in done.stdout
    assert "0 better, 0 worse, 0 cannot be told, 3 the same" in done.stdout


def test_refusals(bad: Callable[..., str], folders: Path, tmp_path: Path) -> None:
    assert "the same folder twice" in bad("old", "./old")
    assert "no scenario in both (seed: 2 -> 3)" in bad("old", "seed")
    assert "holds no study" in bad("old", "nowhere")
    assert "must end in .csv or .html" in bad("old", "new", "-o", "c.txt")
    assert "the folder nowhere does not exist" in bad("old", "new", "-o", "nowhere/c.csv")
    broken = tmp_path / "broken"
    shutil.copytree(folders / "new", broken)
    part = next((broken / "results").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-100])
    assert part.name in bad("old", broken)
    part.unlink()
    assert "run the study again" in bad("old", broken)
