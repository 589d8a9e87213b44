"""Widths that travel with a model, conditions beyond its data, and values that are likely in another unit."""

import dataclasses
import warnings
from pathlib import Path

import pytest

from controllers import LQR
from helpers.cli import bad, good, ldc
from ldctoolkit import VehicleParameters, load_model
from ldctoolkit.option_checks import UnitWarning, unit_slip
from ldctoolkit.plant_options import Actuator, Sensors
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.scenario_model.model import conditions, outside_fit
from studies import read_manifest
from studies.design import Design
from studies.study_file import catalog_names, load_study

STUDY = """
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
def folder(tmp_path: Path) -> Path:
    """A model whose departures were found with a vehicle 1.75 m wide in lanes of 3.5 m, and studies."""
    model = load_model("reference")
    source = dict(model.provenance.source) | {"criteria": {"vehicle_width": 1.75}, "nominal_lane_width": 3.5}
    ScenarioModel.save(
        dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source=source)), tmp_path / "m.json"
    )
    (tmp_path / "s.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "wide.toml").write_text(f"{STUDY}[vehicle]\nw_v = 2.1\n", encoding="utf-8")
    return tmp_path


def vehicle_of(folder: Path) -> VehicleParameters:
    return read_manifest(folder / "out" / "s").read_study().vehicle


RUN = ("--no-robustness", "--no-figures", "--quiet", "--workers", "1")


def test_a_model_brings_its_widths(folder: Path) -> None:
    good("run", "s.toml", "--model", "m.json", *RUN, cwd=folder)
    assert (vehicle_of(folder).w_v, vehicle_of(folder).w_l) == (1.75, 3.5)


def test_a_study_that_sets_another_width_is_refused_until_it_is_decided(folder: Path) -> None:
    message = bad("run", "wide.toml", "--model", "m.json", *RUN, cwd=folder)
    assert "vehicle.w_v: 2.1 m in the study, 1.75 m in the recordings that the model was fitted to" in message
    assert "--vehicle-width" in message
    good("run", "wide.toml", "--model", "m.json", "--vehicle-width", "2.1", *RUN, cwd=folder)
    assert vehicle_of(folder).w_v == 2.1


def test_a_model_that_says_nothing_changes_nothing(folder: Path) -> None:
    good("run", "wide.toml", *RUN, cwd=folder)
    assert (vehicle_of(folder).w_v, vehicle_of(folder).w_l) == (2.1, 3.6)


def test_conditions_beyond_the_data_warn_with_the_range(folder: Path) -> None:
    done = ldc("sample", "reference", "-n", "4", "--given", "v_mean=50:60", "-o", "d.csv", cwd=folder)
    assert done.returncode == 0
    assert "ldc: warning: given v_mean from 50 to 60 m/s: outside the fitted departures (left), " in done.stderr
    (one,) = outside_fit(load_model("reference"), {"v_mean": (50.0, 60.0)})
    assert " to " in one.split("(left), ")[1]
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


def test_the_command_line_warns_once(folder: Path) -> None:
    (folder / "far.toml").write_text(f"{STUDY}y_s = [10.0, 20.0]\n", encoding="utf-8")
    done = ldc("run", "far.toml", *RUN, cwd=folder)
    lines = done.stderr.splitlines()
    assert lines == [
        "ldc: warning: y_s: 10 m; likely centimetres were meant: 0.1 m",
        "ldc: warning: y_s: 20 m; likely centimetres were meant: 0.2 m",
    ]
