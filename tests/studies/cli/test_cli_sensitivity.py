"""``ldc sensitivity`` as people meet it: tables, the file, exit codes, one message for wrong input."""

import shutil
import sys
from pathlib import Path

import polars as pl
import pytest

from helpers.cli import bad, good, ldc, printed_rows
from ldctoolkit.studies import Study, read_results, run_study

STUDY = {
    "name": "tiny",
    "seed": 4,
    "scenarios": {"left": 6, "right": 6},
    "simulation": {"window": "control", "settle": 1.0},
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
                  "intervals over scenarios", "one at a time, control window"):  # fmt: skip
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
        (cells,) = [row for row in printed_rows(out) if len(row) == 6 and row[1] == name]
        first, total = (table.filter(kind=kind, dimension=name).row(0, named=True) for kind in ("first", "total"))
        for shown, interval, stored in ((cells[2], cells[3], first), (cells[4], cells[5], total)):
            ends = [float(end) for end in interval.split("..")]
            wanted = [float(stored[key]) for key in ("index", "index_low", "index_high")]
            assert [float(shown), *ends] == pytest.approx(wanted, abs=6e-4)
    # the design with the smallest mean S is the middle
    results = read_results(folder)
    best = results.designs[int(results.counted.mean(axis=1).argmin())]
    assert f"Around {best.label} ({best.id}), the winner, one at a time" in out
    assert best.id in table["design"]


def test_the_middle_and_the_points_can_be_chosen(folder: Path) -> None:
    middle = next(d for d in Study.from_dict(STUDY).designs if d.law == "preview_proportional")
    first = ldc("sensitivity", folder, "--design", middle.id[:8], "--points", "0", cwd=folder)
    assert "control window" in first.stdout
    assert "different y_s are not comparable" in first.stderr
    assert middle.label in first.stdout
    profile = pl.read_csv(folder / "sensitivity.csv", infer_schema_length=None).filter(pl.col("kind") == "profile")
    assert profile["stored"].to_list() == [True] * 4
    assert profile["dimension"].to_list() == ["y_s", "y_s", "K_y", "K_y"]
    again = good("sensitivity", folder, "--design", middle.label, "--points", "0", cwd=folder)
    assert again == first.stdout


def test_the_middle_is_no_winner_where_nothing_is_ranked(tmp_path: Path) -> None:
    settings = STUDY["ranking"] | {"require": ["S <= 0"]}  # type: ignore[operator]
    study = Study.from_dict(STUDY | {"ranking": settings, "design": STUDY["design"][:2]})  # type: ignore[index]
    run_study(study, directory=tmp_path / "out", workers=1, progress=False)
    out = good("sensitivity", "out", "--points", "0", cwd=tmp_path)
    assert ", smallest mean S, not ranked, one at a time, control window" in out
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
    assert "design[2], LQR: no Sobol indices: SALib is not installed, and" in out
    assert 'pip install "ldctoolkit[sensitivity]"' in out
    assert "design[1], Preview P: Sobol indices" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--points", "-1"], "allowed: a whole number >= 0"),
        (["--design", "zz"], "--design 'zz': no such design; allowed: a label, or the id in ranking.csv"),
        (["--design", ""], "--design '': no such design"),
        (["--design", "No control, y_s=0.3 m"], "did you mean 'No control, y_s=0.2 m'? (allowed: a label, or the"),
    ],
)
def test_wrong_input_is_one_line(arguments: list[str], words: str, folder: Path) -> None:
    assert words in bad("sensitivity", "out", *arguments, cwd=folder.parent)
