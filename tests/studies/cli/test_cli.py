"""The command line: behaviour that all commands share, widths and units."""

import contextlib
import dataclasses
import errno
import json
import logging
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.cli import bad, good, ldc, ldc_process
from helpers.recordings import TABLE_HEADER, table_of
from ldctoolkit import Departures, VehicleParameters, load_model, write_departures
from ldctoolkit.controllers import LQR
from ldctoolkit.declared import UnitWarning, unit_slip
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.plant_options import Actuator, Sensors
from ldctoolkit.recordings import Provenance
from ldctoolkit.scenario_model.model import conditions, outside_fit
from ldctoolkit.studies import read_manifest
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.study_file import catalog_names, load_study

STUDY = """
name = "tiny"
[scenarios]
left = 6
right = 6
[ranking]
bootstrap = 100
[[design]]
law = "none"
[[design]]
law = "preview_proportional"
y_s = [0.1, 0.2]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "s.toml").write_text(STUDY)
    return tmp_path


@contextlib.contextmanager
def no_room() -> Iterator[None]:
    """No file can hold a byte, whoever writes it: as on a full disk, but for the reason."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("words", "file"),
    [
        ("extract r.csv -o new.parquet --force", "new.parquet"),
        ("fit d.parquet -o new.json --components 1 --n-init 1 --workers 1", "new.json"),
        ("sample reference -n 100 -o new.parquet", "new.parquet"),
        ("sample reference -n 100 -o new.csv", "new.csv"),
        ("init zoo -o new.toml", "new.toml"),
        ("run s.toml -o new --workers 1", "new/scenarios.parquet"),
        ("rank plain -o new.csv", "new.csv"),
        ("report again --no-robustness", "again/ranking.csv"),
        ("compare plain again -o new.csv", "new.csv"),
        ("compare plain again -o new.html", "new.html"),
        ("risk s.toml -n 100 --workers 1 -o new", "new/risk.parts/manifest.json"),
        ("review lqr --json new.json", "new.json"),
        ("assess lqr --standard un-r79-b1 --no-tolerances -o new", "new/predictions.csv"),
        ("export again --format json -o new", "new/ldc_controller.json"),
    ],
)
def test_a_full_disk_is_one_sentence(words: str, file: str, folder: Path, finished: Path) -> None:
    (folder / "r.csv").write_text(table_of(0, 4))
    drawn = load_model("reference").sample(60, 60, seed=1)
    columns = dict(zip(PARAMETER_NAMES, drawn.matrix().T, strict=True))
    signals = {"recording": np.full(120, "r"), "start_time": np.arange(120.0), "samples": [9] * 120}
    write_departures(folder / "d.parquet", Departures(drawn.side, **columns, **signals), Provenance())
    for name in ("plain", "again"):
        shutil.copytree(finished, folder / name)

    def content() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}

    before = content()
    with no_room():
        done = ldc(*words.split(), cwd=folder)
    errors = [line for line in done.stderr.splitlines() if not line.startswith("ldc: warning: ")]
    assert (done.returncode, errors) == (2, [f"ldc: error: {file}: cannot be written: File too large"])
    assert content() == before


def test_an_output_that_cannot_be_written_is_one_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("builtins.print", lambda *text, file=None: full() if file is None else file.write(*text))
    done = ldc("sample", "reference", "-n", "10", "-o", "s.csv", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "ldc: error: the output: No space left on device")


def test_missing_numbers_in_recordings_end_or_are_counted(tmp_path: Path) -> None:
    """A NaN invalidates its sample and is told; it never reaches the departures table."""
    text = table_of(0, 40).splitlines(keepends=True)
    text[41] = re.sub(r"^(r0,[^,]*),[^,]*", r"\1,NaN", text[41])
    (tmp_path / "r.csv").write_text("".join(text))
    out = good("extract", "r.csv", "-o", "d.parquet", cwd=tmp_path)
    assert re.search(r"refused: invalid +│ +1 ", out)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "papr"], "study: 'papr' is neither a file nor in the catalog; did you mean 'paper'?"),
        (["run", "none.toml"], "none.toml: cannot be read: No such file or directory"),
        (["run", "s.toml", "--model", "referenc"], "did you mean 'reference'"),
        (["run", "s.toml", "--model", "none.json"], "none.json"),
        (["run", "s.toml", "--workers", "0"], "--workers"),
        (["run", "s.toml", "-o", "s.toml"], "s.toml: exists, but is not the folder of a study"),
        (["rnu"], "invalid choice: 'rnu'"),
        ([], "required: COMMAND"),
        (["run", "s.toml", "--wokers=3"], "'--wokers=3': did you mean --workers? (see ldc run --help)"),
        (["doctor", "--jsn"], "'--jsn': did you mean --json? (see ldc doctor --help)"),
        (["rank", "nowhere", "else"], "unrecognized argument 'else' (see ldc rank --help)"),
        (["rank", "nowhere"], "nowhere: is not the folder of a study"),
        (["report", "."], "is not the folder of a study"),
        (["controllers", "lqq"], "did you mean 'lqr'"),
        (["models", "none.json"], "none.json"),
        (["sample", "reference", "-o", "x.csv"], "-n: the number of departures is missing"),
        (["sample", "reference", "-n", "3", "--left", "2", "-o", "x.csv"], "-n: cannot be combined"),
        (["sample", "reference", "-n", "-3", "-o", "x.csv"], "-n"),
        (["sample", "reference", "-n", "3", "-o", "x.txt"], "must end in .parquet or .csv"),
        (["sample", "reference", "-n", "3", "-o", "nowhere/x.csv"], "the folder nowhere does not exist"),
        (["fit", "none.parquet", "-o", "m.json"], "none.parquet"),
        (["fit", "s.toml", "-o", "m.json"], "s.toml"),
        (["fit", "s.toml", "-o", "m.json", "--components", "3:1"], "allowed: K or FIRST:LAST"),
        (["extract", "s.toml", "-o", "d.parquet"], "s.toml"),
        (["extract", "s.toml", "-o", "d.csv"], "must end in .parquet"),
        (["extract", "s.toml", "-o", "d.parquet", "--vehicle-width", "wide"], "allowed: a finite number"),
        (["sample", "reference", "-n", "999999999999", "-o", "s.csv"], "allowed: up to 10000000"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_arguments_get_one_message(arguments: list[str], message: str, folder: Path) -> None:
    assert message in bad(*arguments, cwd=folder)


def test_what_is_there_stays_when_a_command_fails(folder: Path) -> None:
    (folder / "d.parquet").write_text("old")
    (folder / "r.csv").write_text(TABLE_HEADER)
    bad("extract", "none.csv", "-o", "d.parquet", cwd=folder)
    assert (folder / "d.parquet").read_text() == "old"


def test_lists_and_version(tmp_path: Path) -> None:
    out = good("controllers", cwd=tmp_path)
    for word in ("preview_proportional", "K_psi", "rad/rad", "-5 .. 0", "lqr", "r_delta", "linear_mpc", "horizon"):
        assert word in out
    models = good("models", cwd=tmp_path)
    for word in ("SYNTHETIC", "NGSIM US-101", "247 (86 left, 161 right)", "UAH-DriveSet", "not tried", "OpenLKA"):
        assert word in models
    assert "NGSIM" not in good("models", "reference", cwd=tmp_path)  # of a model that was asked for, the model alone
    assert re.fullmatch(r"ldc \d+\.\d+\.\d+\S*\n", good("--version", cwd=tmp_path))
    for command in ("extract", "fit", "sample", "run", "rank", "report", "controllers", "models"):
        assert command in good("--help", cwd=tmp_path)
        assert "usage: ldc " + command in good(command, "--help", cwd=tmp_path)


def test_a_process_starts_without_anything_heavy_and_ends_with_one_line(tmp_path: Path) -> None:
    done = ldc_process("rnu", cwd=tmp_path, python=("-X", "importtime"))
    assert (done.returncode, done.stdout) == (2, "")
    imports, others = [], []
    for line in done.stderr.splitlines():
        (imports if line.startswith("import time:") else others).append(line)
    loaded = {line.rpartition("|")[2].strip() for line in imports}
    heavy = {"polars", "pydantic", "scipy", "matplotlib", "casadi", "control", "osqp", "jinja2", "rich", "qpsolvers"}
    assert "ldctoolkit.studies.cli.run" in loaded
    assert not loaded & heavy
    (message,) = others
    assert message.startswith("ldc: error: argument COMMAND: invalid choice: 'rnu' (choose from ")


def test_a_reader_that_leaves_is_no_error(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ldctoolkit", "models"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    message = process.stderr.read().decode()
    process.stderr.close()
    assert (process.wait(600), message) == (1, "")


def test_an_interrupt_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ldctoolkit.scenario_model.load_model", interrupted)
    done = ldc("models", cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "ldc: interrupted\n")


def test_a_command_leaves_the_log_of_its_process_as_it_was(folder: Path) -> None:
    """Whoever calls `main` from their own program keeps their handlers."""
    log, mine = logging.getLogger("studies"), logging.NullHandler()
    log.addHandler(mine)
    try:
        good("--version", cwd=folder)
        bad("rank", "nowhere", cwd=folder)
        assert log.handlers == [mine]
        assert log.propagate
    finally:
        log.removeHandler(mine)


INTERRUPTED = """
import os, signal, sys
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.running import campaign
from ldctoolkit.studies.storage.store import Store

# a test runner in the background passes ignored interrupts on to its children: ask for the usual handler
signal.signal(signal.SIGINT, signal.default_int_handler)
add = Store.add

def interrupted(*content):
    Store.add = add
    add(*content)
    os.killpg(0, signal.SIGINT)

campaign._STORE_EVERY, Store.add = -1.0, interrupted
sys.exit(main())
"""
"""The command with an interrupt as a terminal sends it, to the whole group, when the first result is stored."""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="interrupts are sent in another way on Windows")
@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_ends_with_one_line_and_the_study_resumes(workers: int, folder: Path) -> None:
    study = STUDY.replace("left = 6", "left = 20000").replace("right = 6", "right = 20000")
    study += '[[design]]\nlaw = "lqr"\ny_s = 0.05\n[design.gains]\nr_delta = { from = 10, to = 5000, count = 300 }\n'
    (folder / "s.toml").write_text(study)
    words = ["run", "s.toml", "-o", "o", "--workers", str(workers)]
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, *words], cwd=folder, capture_output=True, text=True, timeout=600,
        start_new_session=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr, done.stdout) == (130, "ldc: interrupted\n", "")
    assert list(folder.glob("o/results/part-*.parquet"))
    # what was finished is there, and what was being computed is not half there
    assert re.search(r"\d+ of 303 designs are not complete \(\d+ % of", bad("rank", "o", cwd=folder))


@pytest.mark.slow
def test_the_report_names_a_width_that_contradicts_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A departure depends on the vehicle's width: a model found with another one is a warning, not a footnote. The
    stored command holds no absolute path, in whatever form one was given."""
    model = load_model("reference")
    provenance = dataclasses.replace(model.provenance, source={"criteria": {"vehicle_width": 1.8}})
    dataclasses.replace(model, provenance=provenance).save(tmp_path / "m.json")
    study = STUDY.replace("[scenarios]", '[vehicle]\nm = 1234.0\n[scenarios]\nmodel = "m.json"')
    (tmp_path / "s.toml").write_text(study, encoding="utf-8")
    out = tmp_path / "with space"
    words = ["run", f"{tmp_path}/s.toml", "-o", f"{tmp_path}/a", f"-o{tmp_path}/b", f"--output={out}"]
    words += ["--vehicle-width", "2.1", "--workers", "1", "--quiet", "--no-robustness", "--no-figures"]
    monkeypatch.setattr(sys, "argv", [f"{tmp_path}/bin/ldc", *words])
    good(*words, cwd=tmp_path)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "1234 kg" in page
    assert "departures were found with a vehicle 1.8 m wide, the study drives one of w<sub>v</sub> = 2.1 m" in page
    manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["command"] == (
        "ldc run s.toml -o a -ob '--output=with space' --vehicle-width 2.1 --workers 1 --quiet --no-robustness "
        "--no-figures"
    )


LQR_STUDY = """
name = "s"
[scenarios]
left = 6
right = 6
[ranking]
finalists = 0
[[design]]
law = "lqr"
"""


@pytest.fixture
def widths_folder(tmp_path: Path) -> Path:
    """A model whose departures were found with a vehicle 1.75 m wide in lanes of 3.5 m, and studies."""
    model = load_model("reference")
    source = dict(model.provenance.source) | {"criteria": {"vehicle_width": 1.75}, "nominal_lane_width": 3.5}
    provenance = dataclasses.replace(model.provenance, source=source)
    dataclasses.replace(model, provenance=provenance).save(tmp_path / "m.json")
    (tmp_path / "s.toml").write_text(LQR_STUDY, encoding="utf-8")
    (tmp_path / "wide.toml").write_text(f"{LQR_STUDY}[vehicle]\nw_v = 2.1\n", encoding="utf-8")
    return tmp_path


RUN = ("--no-robustness", "--no-figures", "--quiet", "--workers", "1")


@pytest.mark.parametrize(
    ("words", "widths"),
    [
        ("s.toml --model m.json", (1.75, 3.5)),
        ("wide.toml --model m.json --vehicle-width 2.1", (2.1, 3.5)),
        ("wide.toml", (2.1, 3.6)),
    ],
)
def test_a_model_brings_its_widths(words: str, widths: tuple[float, float], widths_folder: Path) -> None:
    good("run", *words.split(), *RUN, cwd=widths_folder)
    vehicle = read_manifest(widths_folder / "out" / "s").read_study().vehicle
    assert (vehicle.w_v, vehicle.w_l) == widths


def test_a_study_that_sets_another_width_is_refused_until_it_is_decided(widths_folder: Path) -> None:
    message = bad("run", "wide.toml", "--model", "m.json", *RUN, cwd=widths_folder)
    assert "vehicle.w_v: 2.1 m in the study, 1.75 m in the recordings behind its departures" in message
    assert "--vehicle-width" in message


def test_conditions_beyond_the_data_warn_with_the_range(widths_folder: Path) -> None:
    done = ldc("sample", "reference", "-n", "4", "--given", "v_mean=50:60", "-o", "d.csv", cwd=widths_folder)
    assert done.returncode == 0
    assert "ldc: warning: given v_mean from 50 to 60 m/s: outside the fitted departures (left), " in done.stderr
    (warning,) = outside_fit(load_model("reference"), {"v_mean": (50.0, 60.0)})
    assert " to " in warning.split("(left), ")[1]
    assert outside_fit(load_model("reference"), {"v_mean": (20.0, 30.0)}) == []


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: VehicleParameters(m=1.65), "vehicle.m: 1.65 kg; likely tonnes were meant: 1650 kg"),
        (lambda: VehicleParameters(w_l=360.0), "vehicle.w_l: 360 m; likely centimetres were meant: 3.6 m"),
        (lambda: Actuator(rate_max=20.0), "actuator.rate_max: 20 rad/s; likely degrees per second were meant: "
            "0.3491 rad/s"),
        (lambda: Design.of(LQR(r_delta=100.0), 10.0), "y_s: 10 m; likely centimetres were meant: 0.1 m"),
        (lambda: conditions({"v_mean": 120.0}), "given v_mean: 120 m/s; likely km/h were meant: 33.33 m/s"),
    ],
)  # fmt: skip
def test_likely_slips_name_the_unit(make: object, message: str) -> None:
    with pytest.warns(UnitWarning) as caught:
        make()  # type: ignore[operator]
    assert str(caught[0].message).startswith(message)


def test_usual_values_are_silent() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnitWarning)
        VehicleParameters()
        Actuator(rate_max=0.33, lag=0.1, delay=0.1, delta_max=0.6)
        Sensors(delay=0.1)
        for name in catalog_names():
            load_study(name).designs  # noqa: B018 - made for their warnings
    assert unit_slip("vehicle.m", True) == unit_slip("y_s", "0.2") == unit_slip("nothing", 1e9) == ""


def test_the_command_line_warns_once(widths_folder: Path) -> None:
    (widths_folder / "far.toml").write_text(f"{LQR_STUDY}y_s = [10.0, 20.0]\n", encoding="utf-8")
    done = ldc("run", "far.toml", *RUN, cwd=widths_folder)
    assert done.stderr.splitlines() == [
        "ldc: warning: y_s: 10 m; likely centimetres were meant: 0.1 m",
        "ldc: warning: y_s: 20 m; likely centimetres were meant: 0.2 m",
    ]
