"""``ldc identify`` and ``ldc init --data-sheet``: vehicles from logs and from data sheets."""

import json
import tomllib
from pathlib import Path
from typing import Any

import control
import numpy as np
import polars as pl
import pytest

from helpers.cli import bad, good, ldc
from helpers.mdf import write_log
from ldctoolkit import BicycleModel, VehicleParameters
from ldctoolkit.studies.study_file import load_study

CAR = VehicleParameters(m=1650.0, I_z=2800.0, l_f=1.25, l_r=1.55, C_af=65000.0, C_ar=75000.0)
V = 25.0
T = np.arange(0.0, 40.0, 0.02)
STUDY = "name = 'x'\n[vehicle]\nm = 1650.0\nl_f = 1.25\nl_r = 1.55\n[[design]]\nlaw = 'none'\n"


def log() -> dict[str, np.ndarray]:
    """A log of a car at one speed: a lag of 0.1 s, 0.04 s late, no limit of the rate."""
    rng = np.random.default_rng(2)
    command = np.repeat(0.01 * rng.standard_normal(80), 25)
    fine = np.linspace(0.0, T[-1], 20 * (T.size - 1) + 1)  # between samples the command is held
    late = command[np.maximum((fine - 0.04 + 1e-9) // 0.02, 0.0).astype(int)]
    wheel = control.forced_response(control.ss(-10.0, 10.0, 1.0, 0.0), fine, late, late[0]).outputs
    A, B, _ = BicycleModel(CAR).matrices([V])
    rate = control.forced_response(control.ss(A[0], B[0][:, None], [[0, 0, 0, 1]], 0), fine, wheel).outputs
    noise = rng.standard_normal((2, T.size))
    return {
        "t": T, "steering_command": command, "steering": wheel[::20] + 5e-5 * noise[0],
        "yaw_rate": rate[::20] + 5e-4 * noise[1], "speed": np.full(T.size, V),
    }  # fmt: skip


def write_table(path: Path, **columns: Any) -> None:
    lane = {"recording": "a", "lane_offset": 0.0, "lane_width": 3.5}
    pl.DataFrame(log() | {name: np.full(T.size, value) for name, value in (lane | columns).items()}).write_csv(path)


def values(text: str) -> dict[str, Any]:
    return {one["name"]: one["value"] for one in json.loads(text)["estimates"]}


def check(found: dict[str, Any]) -> None:
    assert found["lag"] == pytest.approx(0.1, rel=0.02)
    assert found["delay"] == pytest.approx(0.04, abs=0.002)
    assert found["rate_max"] is None
    for name in ("C_af", "C_ar", "I_z"):
        assert found[name] == pytest.approx(getattr(CAR, name), rel=0.1)


def test_a_table_is_identified(tmp_path: Path) -> None:
    write_table(tmp_path / "drive.csv")
    (tmp_path / "car.toml").write_text(STUDY)
    out = good("identify", "drive.csv", "--vehicle", "car.toml", "--toml", "new.toml", cwd=tmp_path)
    rows = {row.split()[1]: row for row in out.splitlines() if row.startswith("│")}
    assert list(rows) == ["lag", "delay", "rate_max", "understeer_gradient", "C_af", "C_ar", "I_z"]
    assert "never reached" in rows["rate_max"]
    assert " s " in rows["lag"]
    text = (tmp_path / "new.toml").read_text()
    tables = tomllib.loads(text)
    assert tables["plant"]["actuator"].keys() == {"lag", "delay"}
    assert "# rate_max: never reached" in text
    assert tables["vehicle"].keys() == {"m", "l_f", "l_r", "C_af", "C_ar", "I_z"}
    check(tables["vehicle"] | tables["plant"]["actuator"] | {"rate_max": None})
    # the tables are those of a study
    (tmp_path / "study.toml").write_text("name = 'x'\n[[design]]\nlaw = 'none'\n" + text)
    assert load_study(tmp_path / "study.toml").plant.actuator.lag == tables["plant"]["actuator"]["lag"]
    # without a vehicle the understeer gradient needs speeds
    found = values(good("identify", "drive.csv", "--json", cwd=tmp_path))
    assert found.keys() == {"lag", "delay", "rate_max", "understeer_gradient", "wheelbase"}
    assert found["understeer_gradient"] is None
    assert bad("identify", "drive.csv", "--toml", "new.toml", cwd=tmp_path).startswith("ldc: error: --toml new.toml")
    assert (tmp_path / "new.toml").read_text() == text


def test_a_log_in_mdf_is_read_at_the_times_of_its_command(tmp_path: Path) -> None:
    """Without any signal of the lane; angles of the steering wheel in degrees, positive to the right."""
    signals = log()
    bus, wheel = np.arange(0.0, 39.9, 0.01), -15.0 * np.degrees(signals["steering"])
    write_log(tmp_path / "trip.mf4", [
        ("Command", T, {"Request": (-15.0 * np.degrees(signals["steering_command"]), "deg")}),
        ("Bus", bus, {
            "Wheel": (np.interp(bus, T, wheel), "deg"), "Speed": (np.full(bus.size, 90.0), "km/h"),
            "Yaw": (np.degrees(np.interp(bus, T, signals["yaw_rate"])), "deg/s"),
        }),
    ])  # fmt: skip
    (tmp_path / "car.toml").write_text(STUDY)
    channels = 'speed = {channel = "Speed"}\nyaw_rate = {channel = "Yaw"}\nsteering = {channel = "Wheel", scale = -1}\n'
    (tmp_path / "map.toml").write_text(channels + 'steering_command = {channel = "Request", scale = -1}\n')
    call = ("trip.mf4", "--channels", "map.toml")
    check(values(good("identify", *call, "--vehicle", "car.toml", "--steering-ratio", 15, "--json", cwd=tmp_path)))
    error = bad("extract", *call, "-o", "d.parquet", cwd=tmp_path)
    assert error.startswith("ldc: error: map.toml: lane_offset: missing")


def test_what_of_the_logs_cannot_be_used_is_named(tmp_path: Path) -> None:
    write_table(tmp_path / "drive.csv")
    (tmp_path / "other.csv").write_text((tmp_path / "drive.csv").read_text().replace("a,0.0,3.5", "b,x,3.5", 9))
    done = ldc("identify", "drive.csv", "other.csv", "--json", cwd=tmp_path)
    assert done.returncode == 3
    assert "other.csv, line 2" in done.stderr
    content = json.loads(done.stdout)
    assert len(content["problems"]) == 3
    assert content["estimates"][0]["value"] == pytest.approx(0.1, rel=0.02)
    for call in (("nowhere.csv",), ("drive.csv", "--vehicle", "nowhere"), ("drive.csv", "--steering-ratio", 0)):
        assert bad("identify", *call, cwd=tmp_path).startswith("ldc: error: ")


def test_an_extraction_takes_no_notice_of_the_command(tmp_path: Path) -> None:
    write_table(tmp_path / "drive.csv", lane_offset=0.2 * np.sin(T))
    pl.read_csv(tmp_path / "drive.csv").drop("steering_command").write_csv(tmp_path / "without.csv")
    call = ("--step", 0.1, "-o", "d.parquet", "--force")
    assert good("extract", "drive.csv", *call, cwd=tmp_path) == good("extract", "without.csv", *call, cwd=tmp_path)


SHEET = "mass = 1650.0\nfront_load = 910.0\nwheelbase = 2.8\nundersteer_gradient = 0.003\n"


def test_a_data_sheet_becomes_a_study_file(tmp_path: Path) -> None:
    (tmp_path / "car.toml").write_text(SHEET + "width = 1.85\n")
    good("init", "--data-sheet", "car.toml", "-o", "mine.toml", cwd=tmp_path)
    text = (tmp_path / "mine.toml").read_text()
    before, _, after = text.partition("\n[vehicle]")
    notes = before.rpartition("\n\n")[2].splitlines()
    assert notes[0] == "# the vehicle of the data sheet car.toml"
    assert [line.startswith("# assumed: ") for line in notes[1:]] == [True, True, True]
    vehicle = load_study(tmp_path / "mine.toml").vehicle
    assert (vehicle.m, vehicle.l_f, vehicle.w_v, vehicle.w_l) == (1650.0, 1.25576, 1.85, 3.6)
    assert vehicle.C_af == pytest.approx(56194.76, rel=1e-5)
    assert "\nm = 1650.0 " in after
    # a study of the catalog, or laws, with it
    good("init", "zoo", "--data-sheet", "car.toml", "-o", "zoo.toml", cwd=tmp_path)
    assert load_study(tmp_path / "zoo.toml").vehicle == vehicle
    assert load_study(tmp_path / "zoo.toml").design == load_study("zoo").design
    good("init", "my-vehicle", "--data-sheet", "car.toml", "-o", "model.toml", cwd=tmp_path)
    assert "vehicle that is driven has the values in my_car.py" in (tmp_path / "model.toml").read_text()


@pytest.mark.parametrize(
    ("text", "path"),
    [
        (SHEET + "rear_load = 800.0\n", "car.toml: data_sheet.rear_load: 800.0"),
        (SHEET + "whelbase = 2.8\n", "car.toml: whelbase: no such key; did you mean 'wheelbase'?"),
        ("mass = 1650.0\n", "car.toml: data_sheet.wheelbase: None"),
        (SHEET + "width = '2'\n", "car.toml: data_sheet.width"),
        ("mass = ", "car.toml: not a TOML file"), (SHEET + "width = 5.0\n", "car.toml: vehicle.w_v: 5.0"),
    ],
)  # fmt: skip
def test_a_wrong_data_sheet_is_one_sentence(text: str, path: str, tmp_path: Path) -> None:
    (tmp_path / "car.toml").write_text(text)
    error = bad("init", "--data-sheet", "car.toml", "-o", "mine.toml", cwd=tmp_path)
    assert error.startswith(f"ldc: error: {path}")
    assert not (tmp_path / "mine.toml").exists()
