"""``ldc fit``, ``ldc sample --given``, ``ldc models`` by real processes; one message for what is wrong."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ldctoolkit import Departures, load_model
from ldctoolkit.departures import LEFT, PARAMETER_NAMES
from ldctoolkit.recordings import Criteria, Provenance, Refused, read_departures, write_departures


def ldc(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ldctoolkit", *map(str, arguments)],
        cwd=cwd, capture_output=True, text=True, timeout=600, check=False, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip


def good(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    done = ldc(*arguments, cwd=cwd)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    return done


def bad(*arguments: object, cwd: Path) -> str:
    """What must fail: exit code 2, one line, nothing on stdout, no file added or changed."""
    before = {path: path.stat().st_mtime_ns for path in cwd.rglob("*")}
    done = ldc(*arguments, cwd=cwd)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert done.stdout == ""
    assert re.fullmatch(r"ldc: error: [^\n]+\n", done.stderr), done.stderr
    assert {path: path.stat().st_mtime_ns for path in cwd.rglob("*")} == before
    return done.stderr


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
    origin = Provenance(criteria=Criteria(min_speed=4.0), refused=Refused(gap=3), recordings=7, hours=1.5)
    write_departures(folder / "d.parquet", made, origin)
    return folder


def side_of(path: Path) -> dict[str, tuple[float | None, float | None, str]]:
    """Bounds and transform of each parameter of the left side."""
    side = json.loads(path.read_text())["sides"]["left"]
    rows = zip(side["lower"], side["upper"], side["transform"], strict=True)
    return dict(zip(side["parameters"], rows, strict=True))


def test_the_fit_tells_its_choice_and_writes_its_card(folder: Path) -> None:
    done = good(
        "fit", "d.parquet", "-o", "m.json", "--components", "1:2", "--criterion", "held_out", "--workers", "1",
        "--prior-strength", "20", "--tol", "1e-5", "--n-init", "2", "--no-page", cwd=folder,
    )  # fmt: skip
    assert re.search(
        r"left: K = \d, the smallest whose held-out log-likelihood lies within one standard error", done.stdout
    )
    for heading in ("BIC", "AIC", "ICL", "held-out an event"):
        assert heading in done.stdout
    assert re.search(r"│ +\d \* │", done.stdout)
    assert re.search(r"scenario model written to m\.json \(content [0-9a-f]{12}\)\n$", done.stdout)
    assert "ldc: warning: left: c_0 is 0 in every event" in done.stderr
    assert not (folder / "m.html").exists()
    card = json.loads((folder / "m.json").read_text())["provenance"]
    assert card["source"]["refused"]["gap"] == 3
    assert card["source"]["criteria"]["min_speed"] == 4.0
    assert card["settings"] == {
        "criterion": "held_out", "slack": None, "indifference": 0.0, "prior_strength": 20.0, "tol": 1e-5, "n_init": 2,
        "max_iter": 500,
    }  # fmt: skip
    assert ["v_mean", "extraction criteria", "physical"] in card["left"]["bounds_from"]
    told = good("models", "m.json", cwd=folder).stdout
    assert "chosen by held-out likelihood among K = 1 to 2" in told
    assert "v_mean 4 to open (extraction criteria, physical)" in told
    assert "numba " in told
    assert "refused: lane_change 0, invalid 0, gap 3" in told


def test_bounds_and_transforms(folder: Path) -> None:
    good(
        "fit", "d.parquet", "-o", "b.json", "--components", "1", "--no-page", "--bounds", "auto", "--bound", "d_y=0:3",
        "--bound", "sigma_y=:", "--bound", "v_mean=physical", "--transform", "T=logit", cwd=folder,
    )  # fmt: skip
    sides = side_of(folder / "b.json")
    departures, _ = read_departures(folder / "d.parquet")
    smallest = departures.T[departures.side == LEFT].min()
    assert sides["d_y"] == (0.0, 3.0, "none")
    assert sides["sigma_y"] == (0.0, None, "none")
    assert sides["v_mean"] == (4.0, None, "none")
    low = sides["T"][0]  # read off the data, not beyond the criteria of the extraction
    assert low is not None
    assert 0.5 <= low < smallest
    assert sides["T"][2] == "logit"
    low, high, _ = sides["a_mean"]
    assert low is not None
    assert high is not None
    # uniform between -0.2 and 0.2: the ends within 4 mean gaps of 150 values
    assert abs(low + 0.2) < 4 * 0.4 / 150
    assert abs(high - 0.2) < 4 * 0.4 / 150

    good("fit", "d.parquet", "-o", "t.json", "--components", "1", "--no-page", "--transform", "auto", "--transform",
         "d_y=none", cwd=folder)  # fmt: skip
    assert {name: row[2] for name, row in side_of(folder / "t.json").items()} == {
        "T": "logit", "d_y": "none", "sigma_y": "log", "v_mean": "log", "a_mean": "logit", "sigma_v": "log"
    }  # fmt: skip
    assert "fitted after a map of T by logit, sigma_y by log" in good("models", "t.json", cwd=folder).stdout


def test_verbose_tells_of_starts_and_passes(folder: Path) -> None:
    done = good("fit", "d.parquet", "-o", "v.json", "--components", "1", "--no-page", "--verbose", cwd=folder)
    assert re.search(r"^K = 1: ", done.stderr, flags=re.M)


def content(done: subprocess.CompletedProcess[str]) -> str:
    """Content hash of the model that was written."""
    (found,) = re.findall(r"\(content ([0-9a-f]{12})\)", done.stdout)
    return str(found)


def two_tables(folder: Path) -> None:
    """The departures table once more, in two files."""
    made, origin = read_departures(folder / "d.parquet")
    write_departures(folder / "one.parquet", made.take(slice(0, 100)), origin)
    write_departures(folder / "two.parquet", made.take(slice(100, None)), origin)


def test_tables_in_files_give_the_same_model(folder: Path) -> None:
    two_tables(folder)
    options = ("--components", "2", "--n-init", "1", "--no-page")
    inside = good("fit", "d.parquet", "-o", "i.json", *options, cwd=folder)
    for tables, more in (
        (["d.parquet"], ["--stream", "--workers", "1"]),
        (["one.parquet", "two.parquet"], ["--stream"]),
        (["one.parquet", "two.parquet"], ["--no-stream"]),
    ):
        done = good("fit", *tables, "-o", "s.json", *options, *more, cwd=folder)
        assert content(done) == content(inside)
        assert done.stderr == inside.stderr
    card = json.loads((folder / "s.json").read_text())["provenance"]
    assert card["source"]["refused"]["gap"] == 6  # three in each table
    assert card["source"]["criteria"]["min_speed"] == 4.0


def test_tables_that_do_not_go_together_get_one_message(folder: Path) -> None:
    made, origin = read_departures(folder / "d.parquet")
    write_departures(folder / "slow.parquet", made, dataclasses.replace(origin, criteria=Criteria(min_speed=1.0)))
    for how in ("--stream", "--no-stream"):
        twice = bad("fit", "d.parquet", "d.parquet", "-o", "x.json", how, cwd=folder)
        assert re.search(r"d\.parquet'?:? (is )?given more than once", twice)
        assert "slow.parquet: extracted with min_speed = 1.0, d.parquet with 4.0; allowed: tables of the same" in bad(
            "fit", "d.parquet", "slow.parquet", "-o", "x.json", how, cwd=folder
        )


def test_large_tables_stay_in_files_by_default(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The size from which on is 300 departures for this test; the option decides otherwise."""
    from studies.cli import fit, parser

    def streams(*options: str) -> bool:
        return fit._streams(parser().parse_args(["fit", str(folder / "d.parquet"), "-o", "x.json", *options]))

    assert not streams()
    assert streams("--stream")
    monkeypatch.setattr(fit, "_STREAM_FROM", 300)
    assert streams()
    assert not streams("--no-stream")
    monkeypatch.setattr(fit, "_STREAM_FROM", 301)
    assert not streams()


@pytest.mark.slow
def test_a_page_about_some_of_many_departures_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from studies.cli import fit, main

    monkeypatch.chdir(folder)
    monkeypatch.setattr(fit, "_SHOWN", 200)
    assert main(["fit", "d.parquet", "-o", "n.json", "--components", "1", "--stream"]) == 0
    page = (folder / "n.html").read_text(encoding="utf-8")
    sentence = "{}: the model was fitted to 150 departures and is checked here against 100 of them, drawn at random"
    assert sentence.format("left") in page
    assert sentence.format("right") in page
    monkeypatch.setattr(fit, "_SHOWN", 300)
    assert main(["fit", "d.parquet", "-o", "n.json", "--components", "1", "--stream"]) == 0
    assert "drawn at random" not in (folder / "n.html").read_text(encoding="utf-8")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler and two workers started from the shell: the scheduler's address and its process."""
    pytest.importorskip("distributed")
    at = tmp_path / "scheduler.json"

    def start(program: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file", str(at), *options]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", ":0")
    workers = [start("worker", "--no-nanny", "--nthreads", "1", "--dashboard-address", ":0") for _ in range(2)]
    try:
        for _ in range(300):
            if at.exists() and at.read_text().endswith("}"):
                break
            time.sleep(0.1)
        yield json.loads(at.read_text())["address"], scheduler
    finally:
        for process in (scheduler, *workers):
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_gives_the_same_model(folder: Path, cluster: tuple[str, subprocess.Popen[bytes]]) -> None:
    address, scheduler = cluster
    two_tables(folder)
    options = ("--components", "1:2", "--n-init", "2", "--no-page")
    inside = good("fit", "d.parquet", "-o", "i.json", *options, cwd=folder)
    done = good("fit", "one.parquet", "two.parquet", "-o", "c.json", *options, "--dask", address, cwd=folder)
    assert content(done) == content(inside)
    assert done.stderr == inside.stderr
    assert "nix.parquet: not seen by 2 of 2 workers" in bad(
        "fit", "nix.parquet", "-o", "x.json", "--dask", address, cwd=folder
    )
    message = "departures (left): d_y = "
    assert message in bad("fit", "d.parquet", "-o", "x.json", "--bound", "d_y=0:0.01", "--dask", address, cwd=folder)
    threading.Timer(5.0, scheduler.kill).start()  # in the middle of a fit that would take a minute
    assert bad(
        "fit", "d.parquet", "-o", "x.json", "--components", "2:4", "--n-init", "200", "--tol", "0", "--dask", address,
        cwd=folder,
    ) == "ldc: error: the scheduler has gone, or has dropped the work\n"  # fmt: skip


@pytest.mark.slow
def test_no_scheduler_answers(folder: Path) -> None:
    pytest.importorskip("distributed")
    assert "tcp://127.0.0.1:1: no Dask scheduler answers within 5 s; allowed: the address that" in bad(
        "fit", "d.parquet", "-o", "x.json", "--dask", "tcp://127.0.0.1:1", cwd=folder
    )


def test_no_cluster(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    assert "'here': not an address: " in bad("fit", "d.parquet", "-o", "x.json", "--dask", "here", cwd=folder)
    (tmp_path / "distributed.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert 'Dask is not installed; install the extra: pip install "ldctoolkit[cluster]"' in bad(
        "fit", "d.parquet", "-o", "x.json", "--dask", "tcp://127.0.0.1:1", cwd=folder
    )


@pytest.mark.slow
def test_a_page_lies_beside_the_model(folder: Path) -> None:
    done = good("fit", "d.parquet", "-o", "p.json", "--components", "1", cwd=folder)
    assert done.stdout.endswith("page about the fit written to p.html\n")
    assert (folder / "p.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--criterion", "bix"], "argument --criterion: invalid choice: 'bix'"),
        (["--workers", "0"], "argument --workers: '0'; allowed: a whole number >= 1"),
        (["--tol", "small"], "argument --tol: 'small'; allowed: a number"),
        (["--tol", "-1"], "tol: -1.0; allowed: a number >= 0"),
        (["--prior-strength", "-1"], "prior_strength: -1.0; allowed: a number >= 0"),
        (["--slack", "-1"], "slack: -1.0; allowed: a number >= 0"),
        (["--bounds", "given"], "argument --bounds: invalid choice: 'given'"),
        (["--bound", "d_y"], "argument --bound: 'd_y'; allowed: NAME=..."),
        (["--bound", "d_y=1"], "argument --bound: 'd_y=1'; allowed: NAME=LOW:HIGH (an empty end is open)"),
        (["--bound", "d_y=0:x"], "argument --bound: 'd_y=0:x': 'x' is not a number"),
        (["--bound", "d_y=0:nan"], "argument --bound: 'd_y=0:nan': 'nan' is not a number"),
        (["--bound", "dy=0:1"], "bounds: no parameter 'dy'; did you mean 'd_y'?"),
        (["--bound", "d_y=2:1"], "bounds['d_y']: (2.0, 1.0); allowed: 0 <= lower < upper"),
        (["--bound", "d_y=0:0.01"], "departures (left): d_y = "),
        (["--bound", "d_y=0:1", "--bound", "d_y=0:2"], "--bound d_y: given 2 times; allowed: once a name"),
        (["--transform", "log"], "argument --transform: 'log'; allowed: auto, none or NAME=KIND"),
        (["--transform", "d_y=lgo"], "transform['d_y']: 'lgo'; did you mean 'log'?"),
        (["--transform", "T=log"], "transform['T']: 'log' with the bounds 0.5 to 10; allowed: with one finite bound"),
        (["--transform", "dy=log"], "transform: no parameter 'dy'; did you mean 'd_y'?"),
        (
            ["--stream", "--criterion", "held_out"],
            "--criterion held_out: for departures in files; allowed: bic, aic, icl",
        ),
        (["--stream", "--bounds", "auto"], "--bounds auto: for departures in files; allowed: physical or given bounds"),
        (["--stream", "--bound", "d_y=auto"], "--bound d_y=auto: for departures in files; allowed: physical or given"),
        (["--stream", "--bound", "d_y=0:0.01"], "departures (left): d_y = "),
        (["--dask", "tcp://a:1", "--no-stream"], "--no-stream: given beside --dask; allowed: one of them"),
        (["--dask", "tcp://a:1", "--workers", "2"], "--workers: has no meaning with --dask; the cluster has its own"),
        (["--dask", "tcp://a:1", "--criterion", "held_out"], "--criterion held_out: beside --dask; allowed: bic, aic"),
        (["--components", "40:50"], "components: 40 and more; allowed: a range that begins at"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_options_get_one_message(options: list[str], message: str, folder: Path) -> None:
    assert message in bad("fit", "d.parquet", "-o", "x.json", *options, cwd=folder)


def test_every_option_is_described() -> None:
    from studies.cli import parser

    (commands,) = (action for action in parser()._actions if isinstance(action, argparse._SubParsersAction))
    options = {option for action in commands.choices["fit"]._actions for option in action.option_strings}
    page = (Path(__file__).parents[3] / "docs" / "cli.md").read_text(encoding="utf-8")
    section = page[page.index("## Options of `ldc fit`") : page.index("## Behaviour")]
    described = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", section))
    assert options - {"-h", "--help", "--output"} <= described


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
        (["--given", "v_mean=fast"], "argument --given: 'v_mean=fast': 'fast' is not a number"),
        (["--given", "v=3"], "given: no parameter 'v'; "),
        (["--given", "v_mean=35:25"], "given['v_mean']: (35.0, 25.0); allowed: a number, or (lower, upper)"),
        (["--given", "T=20"], "given['T']: T = 20 s; allowed: between 0.5 and 10, the bounds of the left departures"),
        (["--given", "T=10:30"], "given['T']: T from 10 to 30 s; allowed: between 0.5 and 10"),
        (["--given", "T=1", "--given", "T=2"], "--given T: given 2 times; allowed: once a name"),
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


def test_a_study_of_some_departures_only(tmp_path: Path) -> None:
    """The condition reaches the scenarios, the report and what decides whether a folder is resumed."""
    import polars as pl

    (tmp_path / "s.toml").write_text(STUDY)
    good("run", "s.toml", "-o", "o", "--workers", "1", "--quiet", cwd=tmp_path)
    assert pl.read_parquet(tmp_path / "o" / "scenarios.parquet")["v_mean_m_s"].min() > 25.0
    note = "Only departures with v_mean above 25 m/s are drawn from it."
    assert note in json.loads((tmp_path / "o" / "manifest.json").read_text())["model_notes"]
    page = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")  # it sets symbols its own way
    assert re.search(r"<li>Only departures with [^\n]* above 25 m/s are drawn from it\.</li>", page)
    good("run", "s.toml", "-o", "o", "--workers", "1", "--quiet", cwd=tmp_path)
    (tmp_path / "s.toml").write_text(STUDY.replace("[25, inf]", "[26, inf]"))
    assert "holds another study (motorway): scenarios.given.v_mean: [25.0, None] there, [26.0, None] now" in bad(
        "run", "s.toml", "-o", "o", cwd=tmp_path
    )
    (tmp_path / "s.toml").write_text(STUDY.replace("v_mean = [25, inf]", "v_mean = [35, 25]"))
    assert "s.toml: scenarios.given.v_mean: (35, 25); allowed: a number, or (lower, upper)" in bad(
        "run", "s.toml", "-o", "p", cwd=tmp_path
    )
