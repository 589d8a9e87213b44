"""``ldc fit``, ``ldc sample --given``, ``ldc models``; one message for what is wrong."""

import csv
import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from helpers.cli import bad, good, ldc
from ldctoolkit import Departures, load_model
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.recordings import Criteria, Provenance, Refused, read_departures, write_departures


@pytest.fixture(autouse=True)
def _wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A departures table: 150 departures a side of the bundled model, accelerations between two abrupt ends."""
    folder = tmp_path_factory.mktemp("fit")
    drawn = load_model("reference").sample(150, 150, seed=1)
    columns = dict(zip(PARAMETER_NAMES, drawn.matrix().T, strict=True))
    columns["a_mean"] = np.random.default_rng(0).uniform(-0.2, 0.2, 300)
    columns["c_0"] = columns["dc"] = np.zeros(300)
    made = Departures(
        side=drawn.side, **columns, recording=np.full(300, "r"), start_time=np.arange(300.0), samples=np.full(300, 20)
    )
    origin = Provenance(
        criteria=Criteria(min_speed=4.0), refused=Refused(gap=3), recordings=7, hours=1.5, distance=72e3
    )
    write_departures(folder / "d.parquet", made, origin)
    return folder


def side_of(path: Path) -> dict[str, tuple[float | None, float | None, str]]:
    """Bounds and transform of each parameter of the left side."""
    side = json.loads(path.read_text())["sides"]["left"]
    rows = zip(side["lower"], side["upper"], side["transform"], strict=True)
    return dict(zip(side["parameters"], rows, strict=True))


def test_the_fit_tells_its_choice_and_writes_its_card(folder: Path) -> None:
    done = ldc(
        "fit", "d.parquet", "-o", "m.json", "--components", "1:2", "--workers", "1",
        "--prior-strength", "20", "--tol", "1e-4", "--n-init", "1", "--no-page", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"left: K = \d, .*the smallest whose BIC lies within 10 of the best", done.stdout)
    assert re.search(r"┃ +K ┃ +p ┃ +\[nats an event\] ┃ +BIC ┃ Above the least ┃", done.stdout)
    assert re.search(r"│ +\d \* │", done.stdout)
    assert re.search(r"scenario model written to m\.json \(content [0-9a-f]{12}\)\n$", done.stdout)
    assert "ldc: warning: left: c_0 is 0 in every event" in done.stderr
    assert not (folder / "m.html").exists()
    card = json.loads((folder / "m.json").read_text())["provenance"]
    assert (card["source"]["refused"]["gap"], card["source"]["criteria"]["min_speed"]) == (3, 4.0)
    assert (card["hours"], card["distance"], card["source"]["distance"]) == (1.5, 72e3, 72e3)
    assert card["settings"] == {"prior_strength": 20.0, "tol": 1e-4, "n_init": 1, "max_iter": 500}
    assert ["v_mean", "extraction criteria", "physical"] in card["left"]["bounds_from"]
    told = good("models", "m.json", cwd=folder)
    assert re.search(r"left: \d components? from 150 departures: K = \d, ", told)
    assert "v_mean 4 to open (extraction criteria, physical)" in told
    assert "numba " in told
    assert "refused: lane_change 0, invalid 0, gap 3" in told


@pytest.mark.slow
def test_bounds_and_transforms(folder: Path) -> None:
    good(
        "fit", "d.parquet", "-o", "b.json", "--components", "1", "--no-page", "--bound", "d_y=0:3",
        "--bound", "sigma_y=:", "--transform", "T=logit", cwd=folder,
    )  # fmt: skip
    sides = side_of(folder / "b.json")
    assert (sides["d_y"], sides["sigma_y"]) == ((0.0, 3.0, "none"), (0.0, None, "none"))
    assert sides["v_mean"] == (4.0, None, "none")
    assert sides["T"][2] == "logit"

    good("fit", "d.parquet", "-o", "t.json", "--components", "1", "--no-page", "--transform", "auto", "--transform",
         "d_y=none", cwd=folder)  # fmt: skip
    assert {name: row[2] for name, row in side_of(folder / "t.json").items()} == {
        "T": "logit", "d_y": "none", "sigma_y": "log", "v_mean": "log", "a_mean": "logit", "sigma_v": "log"
    }  # fmt: skip
    assert "fitted after a map of T by logit, sigma_y by log" in good("models", "t.json", cwd=folder)


@pytest.mark.slow
def test_verbose_tells_of_starts_and_passes(folder: Path) -> None:
    done = ldc("fit", "d.parquet", "-o", "v.json", "--components", "1", "--no-page", "--verbose", cwd=folder)
    assert re.search(r"^K = 1: ", done.stderr, flags=re.M)


@pytest.mark.slow
def test_several_tables_are_fitted_as_one(folder: Path) -> None:
    made, origin = read_departures(folder / "d.parquet")
    write_departures(folder / "one.parquet", made.take(slice(0, 100)), origin)
    write_departures(folder / "two.parquet", made.take(slice(100, None)), origin)
    options = ("--components", "2", "--n-init", "1", "--no-page")
    good("fit", "d.parquet", "-o", "i.json", *options, cwd=folder)
    good("fit", "one.parquet", "two.parquet", "-o", "s.json", *options, "--workers", "1", cwd=folder)
    together = load_model(folder / "s.json")
    assert together.content_hash == load_model(folder / "i.json").content_hash
    assert together.provenance.source["refused"]["gap"] == 6  # three in each table
    assert together.provenance.source["criteria"]["min_speed"] == 4.0


def test_tables_that_do_not_go_together_get_one_message(folder: Path) -> None:
    made, origin = read_departures(folder / "d.parquet")
    write_departures(folder / "slow.parquet", made, dataclasses.replace(origin, criteria=Criteria(min_speed=1.0)))
    assert "d.parquet: given more than once" in bad("fit", "d.parquet", "d.parquet", "-o", "x.json", cwd=folder)
    assert "slow.parquet: extracted with min_speed = 1.0, d.parquet with 4.0; allowed: tables of the same" in bad(
        "fit", "d.parquet", "slow.parquet", "-o", "x.json", cwd=folder
    )


@pytest.mark.slow
def test_a_page_lies_beside_the_model(folder: Path) -> None:
    told = good("fit", "d.parquet", "-o", "p.json", "--components", "1", cwd=folder)
    assert told.endswith("page about the fit written to p.html\n")
    assert (folder / "p.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--kind", "smooth"], "argument --kind: invalid choice: 'smooth'"),
        (["--workers", "0"], "argument --workers: '0'; allowed: a whole number >= 1"),
        (["--tol", "small"], "argument --tol: 'small'; allowed: a finite number"),
        (["--tol", "-1"], "tol: -1.0; allowed: a finite number >= 0"),
        (["--prior-strength", "-1"], "prior_strength: -1.0; allowed: a finite number >= 0"),
        (["--bound", "d_y"], "argument --bound: 'd_y'; allowed: NAME=..."),
        (["--bound", "d_y=1"], "argument --bound: 'd_y=1'; allowed: NAME=LOW:HIGH, an empty end is open"),
        (["--bound", "d_y=0:x"], "argument --bound: 'x'; allowed: a number"),
        (["--bound", "d_y=0:nan"], "argument --bound: 'nan'; allowed: a number"),
        (["--bound", "dy=0:1"], "bounds: 'dy' is not a parameter of departures; did you mean 'd_y'?"),
        (["--bound", "d_y=2:1"], "bounds['d_y']: (2.0, 1.0); allowed: 0 <= lower < upper"),
        (["--bound", "d_y=0:0.01"], "departures (left): d_y: "),
        (["--bound", "d_y=0:1", "--bound", "d_y=0:2"], "--bound d_y: given 2 times; allowed: each name once"),
        (["--transform", "log"], "argument --transform: 'log'; allowed: auto, none or NAME=KIND"),
        (["--transform", "d_y=lgo"], "transform['d_y']: 'lgo'; did you mean 'log'?"),
        (["--transform", "T=log"], "transform['T']: 'log' with 2 finite bounds; allowed: for columns with 1"),
        (["--transform", "dy=log"], "transform: 'dy' is not a parameter of departures; did you mean 'd_y'?"),
        (["--components", "0"], "argument --components: '0'; allowed: K or FIRST:LAST, from 1 to 100"),
        (["--components", "3:2"], "argument --components: '3:2'; allowed: K or FIRST:LAST, from 1 to 100"),
        (["--components", "1:101"], "argument --components: '1:101'; allowed: K or FIRST:LAST, from 1 to 100"),
        (["--components", "40:50"], "components: 40 and more; allowed: a range that begins at"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_options_get_one_message(options: list[str], message: str, folder: Path) -> None:
    assert message in bad("fit", "d.parquet", "-o", "x.json", *options, cwd=folder)


def test_a_page_that_cannot_be_written_is_told_before_the_fit(folder: Path) -> None:
    (folder / "q.html").mkdir(exist_ok=True)
    assert "q.html: is a folder" in bad("fit", "d.parquet", "-o", "q.json", cwd=folder)


def rows(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as stream:
        table = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in table]) for name in ("v_mean_m_s", "c_0_1_m", "T_s")}


def test_conditional_samples(folder: Path) -> None:
    good("sample", "reference", "-n", "400", "--given", "v_mean=25:35", "--given", "c_0=0.001", "--given", "T=3:",
         "-o", "s.csv", cwd=folder)  # fmt: skip
    drawn = rows(folder / "s.csv")
    assert drawn["v_mean_m_s"].size == 400
    assert drawn["v_mean_m_s"].min() > 25.0
    assert drawn["v_mean_m_s"].max() < 35.0
    assert np.all(drawn["c_0_1_m"] == 0.001)
    assert drawn["T_s"].min() > 3.0
    good("sample", "reference", "--left", "10", "--given", "v_mean=25:35", "-o", "few.csv", cwd=folder)
    good("sample", "reference", "--left", "50", "--right", "9", "--given", "v_mean=25:35", "-o", "more.csv", cwd=folder)
    assert np.array_equal(rows(folder / "few.csv")["T_s"], rows(folder / "more.csv")["T_s"][:10])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--given", "v_mean"], "argument --given: 'v_mean'; allowed: NAME=..."),
        (["--given", "v_mean=fast"], "argument --given: 'fast'; allowed: a number"),
        (["--given", "v=3"], "given: 'v' is not a parameter of departures; "),
        (["--given", "v_mean=35:25"], "given['v_mean']: (35.0, 25.0); allowed: a number, or (lower, upper)"),
        (["--given", "T=20"], "given['T']: T = 20 s; allowed: between 0.5 and 10, the bounds of the left departures"),
        (["--given", "T=10:30"], "given['T']: T from 10 to 30 s; allowed: between 0.5 and 10"),
        (["--given", "T=1", "--given", "T=2"], "--given T: given 2 times; allowed: each name once"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_conditions_get_one_message(options: list[str], message: str, folder: Path) -> None:
    assert message in bad("sample", "reference", "-n", "5", *options, "-o", "x.csv", cwd=folder)


STUDY = """
name = "motorway"
[scenarios]
left = 6
right = 6
[scenarios.given]
v_mean = [25, inf]
[ranking]
bootstrap = 100
[[design]]
law = "none"
"""


@pytest.mark.slow
def test_a_study_of_some_departures_only(tmp_path: Path) -> None:
    """The condition reaches the scenarios, the report and what decides whether a folder is resumed."""
    (tmp_path / "s.toml").write_text(STUDY)
    good("run", "s.toml", "-o", "o", "--workers", "1", "--quiet", "--no-figures", "--no-robustness", cwd=tmp_path)
    assert pl.read_parquet(tmp_path / "o" / "scenarios.parquet")["v_mean_m_s"].min() > 25.0
    note = "Only departures with v_mean above 25 m/s are taken."
    assert note in json.loads((tmp_path / "o" / "manifest.json").read_text())["model_notes"]
    page = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")  # it sets symbols its own way
    assert re.search(r"<li>Only departures with [^\n]* above 25 m/s are taken\.</li>", page)
    (tmp_path / "s.toml").write_text(STUDY.replace("[25, inf]", "[26, inf]"))
    assert "holds another study (motorway): scenarios.given.v_mean: [25.0, None] there, [26.0, None] now" in bad(
        "run", "s.toml", "-o", "o", cwd=tmp_path
    )
    (tmp_path / "s.toml").write_text(STUDY.replace("v_mean = [25, inf]", "v_mean = [35, 25]"))
    assert "s.toml: scenarios.given.v_mean: (35, 25); allowed: a number, or (lower, upper)" in bad(
        "run", "s.toml", "-o", "p", cwd=tmp_path
    )
