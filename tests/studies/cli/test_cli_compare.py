"""``ldc compare`` as people meet it: exit codes, tables, files, one message for wrong input."""

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from helpers.cli import bad, good, ldc
from helpers.stored import rewrite_json
from ldctoolkit.studies import Study, run_study


@pytest.fixture(scope="module")
def changed(content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``new`` on more scenarios with a slow actuator and one more design; ``seed`` with other scenarios."""
    root = tmp_path_factory.mktemp("compare")
    slow: dict[str, Any] = {
        "name": "after",
        "scenarios": {"left": 200, "right": 120},
        "plant": {"actuator": {"lag": 0.3}},
        "design": [*content["design"], {"law": "preview_proportional", "y_s": 0.3}],
    }
    seed = {"seed": 3, "scenarios": {"left": 3, "right": 3}}
    for folder, parts in {"new": slow, "seed": seed}.items():
        run_study(Study.from_dict(content | parts), directory=root / folder, workers=1, progress=False)
    return root


@pytest.fixture
def folders(changed: Path, finished: Path, tmp_path: Path) -> Path:
    """A folder with ``old``, ``new`` and ``seed``."""
    for name, source in {"old": finished, "new": changed / "new", "seed": changed / "seed"}.items():
        (tmp_path / name).symlink_to(source, target_is_directory=True)
    return tmp_path


def test_tables_csv_and_page(folders: Path) -> None:
    out = good("compare", "old", "new", "-o", "c.csv", "-o", "c.html", cwd=folders)
    lines = out.splitlines()
    assert lines[:2] == ["old: old (before)", "new: new (after)"]
    # what differs comes before any number
    inputs = lines.index("Inputs that differ, old -> new:")
    assert lines[inputs + 1] == "  plant.actuator.lag: 0.0 -> 0.3"
    assert inputs < next(i for i, line in enumerate(lines) if "4 designs in both studies, 250 shared scenarios" in line)
    assert re.search(r"│ worse +│ LQR, y_s=0.05 m", out)
    assert "the same within 1e-6 m s: 1 of 4 designs" in out
    assert "Only in the new study: 1 design\n" in out
    assert "250 shared scenarios (150 left, 100 right)" in lines[-3]
    assert lines[-2:] == ["comparison: c.csv", "comparison: c.html"]
    with (folders / "c.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["compared"] for row in rows] == ["design"] * 4 + ["winners"]
    assert {row["verdict"] for row in rows if row["label_new"].startswith("LQR")} == {"worse"}
    assert rows[3]["difference_m_s"] == "0.0"
    page = (folders / "c.html").read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert "plant.actuator.lag" in page

    # old, new and new - old of the table are those of the file, to its digits
    (row,) = [line for line in lines if "LQR, y_s=0.05 m" in line and "│ worse" in line]
    cells = [cell.strip() for cell in row.strip("│").split("│")]
    (stored,) = [one for one in rows if one["label_new"] == "LQR, y_s=0.05 m" and one["compared"] == "design"]
    assert float(cells[2]) == pytest.approx(float(stored["S_old_m_s"]), abs=6e-5)
    assert float(cells[3]) == pytest.approx(float(stored["S_new_m_s"]), abs=6e-5)
    assert cells[4].startswith("+")
    assert float(cells[4]) == pytest.approx(float(stored["difference_m_s"]), abs=6e-5)
    assert good("compare", "old", "new", "--top", 1, cwd=folders).count("│ worse") == 1


def test_that_there_is_no_winner_is_printed_once(folders: Path) -> None:
    shutil.copytree(folders / "old", folders / "strict")
    rewrite_json(
        folders / "strict" / "manifest.json", lambda content: content["study"]["ranking"].update(require=["S <= 1e-9"])
    )
    out = good("compare", "old", "strict", cwd=folders)
    assert " ".join(out.split()).count("there is no winner to compare") == 1


def test_json_and_exit_code_for_scripts(folders: Path) -> None:
    done = ldc("compare", "old", "new", "--json", "--fail-if-worse", cwd=folders)
    assert done.returncode == 3, done.stderr
    content = json.loads(done.stdout)
    assert content["worse"] is True
    assert (content["differences"][0], len(content["rows"])) == ("plant.actuator.lag: 0.0 -> 0.3", 5)
    back = json.loads(good("compare", "new", "old", "--json", "--fail-if-worse", cwd=folders))
    assert back["worse"] is False


def test_a_copy_is_the_same(folders: Path, tmp_path: Path) -> None:
    shutil.copytree(folders / "old", tmp_path / "copy")
    out = good("compare", "old", "copy", "--fail-if-worse", cwd=folders)
    assert "The inputs are the same" in out
    assert "0 better, 0 worse, 0 not separated, 4 the same" in out


def test_refusals(folders: Path) -> None:
    assert "the same folder twice" in bad("compare", "old", "./old", cwd=folders)
    assert "no scenario in both (seed: 2 -> 3; " in bad("compare", "old", "seed", cwd=folders)
    assert "is not the folder of a study" in bad("compare", "old", "nowhere", cwd=folders)
    assert "must end in .csv or .html" in bad("compare", "old", "new", "-o", "c.txt", cwd=folders)
    assert "the folder nowhere does not exist" in bad("compare", "old", "new", "-o", "nowhere/c.csv", cwd=folders)
    shutil.copytree(folders / "new", folders / "broken")
    part = next((folders / "broken" / "results").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-100])
    assert part.name in bad("compare", "old", "broken", cwd=folders)
    part.unlink()
    assert "run the study again" in bad("compare", "old", "broken", cwd=folders)
