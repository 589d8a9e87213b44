"""``ldc report``, ``ldc compare`` and ``ldc sensitivity`` on stored results."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from helpers.cli import bad, good, ldc, printed_rows
from studies import Study, read_results, run_study


@pytest.mark.slow
def test_departures_and_designs_are_put_into_the_page(folder: Path) -> None:
    results = read_results(folder / "plain")
    worst = results.designs[int(results.cases[0].S.mean(axis=1).argsort()[-2])].id
    asked = ("--departure", 249, "--departure", 7, "--design", worst[:8])
    good("report", "plain", *asked, "--no-robustness", "--no-figures", cwd=folder)
    page = (folder / "plain" / "report.html").read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    data = json.loads(found[1])["departures"]
    assert [one["number"] for one in data["departures"][:2]] == ["249", "7"]
    assert all("requested" in one["name"] for one in data["departures"][:2])
    assert "requested" in [design["why"] for design in data["designs"]]


@pytest.mark.slow
def test_what_lies_in_a_folder_and_how_it_is_written_again(folder: Path) -> None:
    """Numbers on other plants: left out, worked out, and shown where they are stored."""
    out = folder / "plain"
    page, plants, ranking = (out / name for name in ("report.html", "robustness.json", "ranking.csv"))
    good("report", "plain", "--no-robustness", "--no-figures", cwd=folder)
    assert not plants.exists()
    assert b"Designs were not driven on other plants for this report" in page.read_bytes()
    good("report", "plain", cwd=folder)
    assert sorted(path.name for path in out.iterdir()) == [
        ".lock", "designs.parquet", "figures", "finalists", "manifest.json", "model.json", "ranking.csv",
        "ranking.md", "report.html", "results", "robustness.json", "scenarios.parquet", "timing.json",
    ]  # fmt: skip
    written = {path: path.read_bytes() for path in (page, plants, ranking)}
    ranking.unlink()
    good("rank", "plain", cwd=folder)
    good("report", "plain", "--no-robustness", "--no-figures", cwd=folder)
    assert {path: path.read_bytes() for path in written} == written
    assert "plain: holds another study (before): " in bad("run", "paper", "-o", "plain", cwd=folder)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--departure", "250"], "departure: 250; allowed: 0 to 249, the nearest is 249"),
        (["--design", "not an id"], "design: 'not an id'; no design begins like this, the nearest is"),
    ],
)
def test_what_is_not_there_is_refused(folder: Path, given: list[str], message: str) -> None:
    assert message in bad("report", "plain", *given, cwd=folder)


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
    assert "holds no study" in bad("compare", "old", "nowhere", cwd=folders)
    assert "must end in .csv or .html" in bad("compare", "old", "new", "-o", "c.txt", cwd=folders)
    assert "the folder nowhere does not exist" in bad("compare", "old", "new", "-o", "nowhere/c.csv", cwd=folders)
    shutil.copytree(folders / "new", folders / "broken")
    part = next((folders / "broken" / "results").glob("*.parquet"))
    part.write_bytes(part.read_bytes()[:-100])
    assert part.name in bad("compare", "old", "broken", cwd=folders)
    part.unlink()
    assert "run the study again" in bad("compare", "old", "broken", cwd=folders)


STUDY = {
    "name": "tiny",
    "seed": 4,
    "scenarios": {"left": 6, "right": 6},
    "simulation": {"window": ["departure", "control"], "settle": 1.0},
    "ranking": {"bootstrap": 100, "finalists": 0},
    "design": [
        {"law": "none"},
        {"law": "preview_proportional", "y_s": [0.05, 0.2], "gains": {"K_y": [-0.02, -0.005], "K_psi": -0.3}},
        {"law": "lqr", "gains": {"r_delta": {"from": 300, "to": 3000}}, "sample": {"method": "sobol", "count": 64}},
    ],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "out"
    run_study(Study.from_dict(STUDY), directory=folder, workers=1, progress=False)
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "out"))


@pytest.mark.slow
def test_indices_and_profiles_are_printed_and_written(folder: Path) -> None:
    out = good("sensitivity", folder, "--points", "3", cwd=folder)
    for words in ("design[1], Preview P: Sobol indices", "design[2], LQR: Sobol indices", "first order only",
                  "intervals over scenarios", "one at a time, departure window"):  # fmt: skip
        assert words in out
    assert out.endswith(f"sensitivity: {folder / 'sensitivity.csv'}\n")
    table = pl.read_csv(folder / "sensitivity.csv", infer_schema_length=None)
    counts = table.group_by("kind").len()
    assert dict(zip(counts["kind"], counts["len"], strict=True)) == {
        "first": 3,  # y_s and K_y of the grid, r_delta of the sample, which has no total one
        "total": 2,
        "profile": table.filter(pl.col("kind") == "profile").height,
    }
    # the printed indices are those of the file
    for name in ("y_s", "K_y"):
        (cells,) = [row for row in printed_rows(out) if row[0] == name and " .. " in row[2] and len(row) == 5]
        first, total = (table.filter(kind=kind, dimension=name).row(0, named=True) for kind in ("first", "total"))
        for shown, interval, stored in ((cells[1], cells[2], first), (cells[3], cells[4], total)):
            ends = [float(end) for end in interval.split(" .. ")]
            wanted = [float(stored[key]) for key in ("index", "index_low", "index_high")]
            assert [float(shown), *ends] == pytest.approx(wanted, abs=6e-4)
    # the design with the smallest mean S is the middle
    results = read_results(folder)
    best = results.designs[int(results.cases[0].counted.mean(axis=1).argmin())]
    assert f"Around {best.label} ({best.id}), the winner, one at a time" in out
    assert best.id in table["design"]


def test_the_middle_the_case_and_the_points_can_be_chosen(folder: Path) -> None:
    middle = next(d for d in Study.from_dict(STUDY).designs if d.law == "preview_proportional")
    first = ldc("sensitivity", folder, "--design", middle.id[:8], "--points", "0", "--case", "2", cwd=folder)
    assert "control window" in first.stdout
    assert "different y_s are not comparable" in first.stderr
    assert middle.label in first.stdout
    profile = pl.read_csv(folder / "sensitivity.csv", infer_schema_length=None).filter(pl.col("kind") == "profile")
    assert profile["stored"].to_list() == [True] * 4
    assert profile["dimension"].to_list() == ["y_s", "y_s", "K_y", "K_y"]
    again = good("sensitivity", folder, "--design", middle.label, "--points", "0", "--case", "2", cwd=folder)
    assert again == first.stdout


def test_the_middle_is_no_winner_where_nothing_is_ranked(tmp_path: Path) -> None:
    settings = STUDY["ranking"] | {"require": ["S <= 0"]}  # type: ignore[operator]
    study = Study.from_dict(STUDY | {"ranking": settings, "design": STUDY["design"][:2]})  # type: ignore[index]
    run_study(study, directory=tmp_path / "out", workers=1, progress=False)
    out = good("sensitivity", "out", "--points", "0", cwd=tmp_path)
    assert ", smallest mean S, not ranked, one at a time, departure window" in out
    assert "the winner" not in out


def test_a_design_without_neighbours_has_no_profile(folder: Path) -> None:
    nothing = Study.from_dict(STUDY).designs[0]
    out = good("sensitivity", folder, "--design", nothing.id, cwd=folder)
    assert "nothing varies in the designs of this law" in out


def test_without_salib_the_rest_goes_on(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "SALib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "SALib", None)
    out = good("sensitivity", folder, "--points", "0", cwd=folder)
    assert "design[2], LQR: no Sobol indices: Sobol indices of a sample need SALib" in out
    assert 'pip install "ldctoolkit[sensitivity]"' in out
    assert "design[1], Preview P: Sobol indices" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--case", "3"], "--case 3; allowed: 1 to 2"),
        (["--case", "0"], "allowed: a whole number >= 1"),
        (["--points", "-1"], "allowed: a whole number >= 0"),
        (["--design", "zz"], "--design 'zz': no such design; allowed: a label, or the id in ranking.csv"),
        (["--design", ""], "--design '': no such design"),
        (["--design", "No control, y_s=0.3 m"], "did you mean 'No control, y_s=0.2 m'? (allowed: a label, or the"),
    ],
)
def test_wrong_input_is_one_line(arguments: list[str], words: str, folder: Path) -> None:
    assert words in bad("sensitivity", "out", *arguments, cwd=folder.parent)


def test_a_folder_without_a_study_is_refused(tmp_path: Path) -> None:
    assert "holds no study" in bad("sensitivity", ".", cwd=tmp_path)
