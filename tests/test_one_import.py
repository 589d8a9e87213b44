"""What a Python session needs, from one import, in a few lines; each as a user would write it."""

import copy
import dataclasses
import inspect
import pickle
import re
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl
import pytest

import ldctoolkit as ldc
from helpers.cli import python
from helpers.errors import refused
from ldctoolkit.controllers import LQR
from ldctoolkit.declared import UnitWarning
from ldctoolkit.errors import LdcError
from ldctoolkit.metrics import DRIVER_METRICS, METRIC_COLUMNS
from ldctoolkit.plant_options import Actuator, PlantOptions
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.studies import Study, risk
from ldctoolkit.studies.ranking.ranking import write_csv

OWN_LAW = """
import dataclasses, numpy as np, ldctoolkit as ldc
@dataclasses.dataclass(frozen=True)
class Offset(ldc.Controller):
    name, title = "offset", "Offset feedback"
    K: float = ldc.gain(-0.02, unit="rad/m", description="feedback of e_y", lower=-1.0, upper=0.0)
    def prepare(self, plant):
        return ldc.LinearLaw(F=np.tile([self.K, 0.0, -0.3, 0.0], (plant.n, 1)))
results = ldc.run_study(ldc.study(ldc.NoControl, Offset, Offset(K=-0.05), y_s=0.1, left=9, right=9), workers=2)
"""


@pytest.mark.slow
def test_a_law_of_a_script_or_notebook(tmp_path: Path) -> None:
    """A class in __main__ runs in worker processes and passes the contract."""
    assert len(OWN_LAW.strip().splitlines()) <= 8
    check = "from ldctoolkit.testing import contract_faults\nprint(results, contract_faults(Offset()))"
    printed = python("-c", OWN_LAW + check, cwd=tmp_path)
    assert printed.startswith("<StudyResults: designs 3: none (1), offset (2); scenarios 18 (9 left, 9 right); ")
    assert printed.rstrip().endswith(" ()")


def arrays() -> ldc.Scenarios:
    side = np.where(np.arange(20) % 2, 1, -1)
    return ldc.Scenarios.from_arrays(T=np.linspace(2.0, 5.0, 20), d_y=0.4, v_mean=25.0, side=side)


def test_own_arrays_vehicle_requirement_and_a_data_frame() -> None:
    study = ldc.study(
        ldc.NoControl(), ldc.LQR(r_delta=np.float32(300.0)), "pid", y_s=[0.1, 0.2], require="a_y_peak_p95 <= 9",
        vehicle=ldc.VehicleParameters(m=np.int64(1500)), plant=PlantOptions(actuator=Actuator(lag=0.1)),
    )  # fmt: skip
    results = ldc.run_study(study, scenarios=arrays(), workers=1)
    ranking = ldc.rank_study(results, study)
    table = ranking.to_polars()
    assert table["design"].to_list() == [design.id for design in ranking.designs]
    np.testing.assert_array_equal(table["S_m_s"], ranking.metrics.S)
    assert table["set_of_best"].to_list() == ranking.inference.set_of_best.tolist()
    rows = results.to_polars()
    assert rows.shape[0] == 5 * 20
    np.testing.assert_array_equal(rows["S_departure_m_s"], results.S.ravel())
    one = ldc.simulate(ldc.LQR(r_delta=300.0), results.scenarios, 0.1, vehicle=study.vehicle, options=study.plant)
    np.testing.assert_array_equal(rows.filter(law="lqr", y_s_m=0.1)["S_departure_m_s"], one.S)
    assert study.ranking.require == ("a_y_peak_p95 <= 9",)
    assert repr(results) == (
        "<StudyResults: designs 5: none (1), lqr (2), pid (2); scenarios 20 (10 left, 10 right); "
        "S departure window, signs consistent>"
    )
    assert repr(ranking).startswith("<Ranking of 5 designs, departure window, signs consistent: best 'LQR, y_s=0.1 m")


def test_scenarios_of_ones_own_keep_their_numbers() -> None:
    """Left ones are driven first; the column ``scenario`` is the row of the arrays, whose draws do not depend on it."""
    study = ldc.study(ldc.LQR, y_s=0.1, plant=ldc.PlantOptions(sensors=ldc.Sensors(e_y_noise=0.05)))
    results = ldc.run_study(study, scenarios=arrays(), workers=1)
    assert results.scenarios.index.tolist() == [*range(1, 20, 2), *range(0, 20, 2)]
    rows = results.to_polars().sort("scenario")
    one = ldc.simulate(ldc.LQR(), arrays(), 0.1, setup=study.setup())
    np.testing.assert_array_equal(rows["S_departure_m_s"], one.S)
    assert rows["side"][:2].to_list() == ["right", "left"]


def test_frames_of_departures_and_outcomes() -> None:
    scenarios = arrays()
    outcome = ldc.simulate(ldc.NoControl(), scenarios)
    frame = outcome.to_polars()
    scores = ["S_departure_m_s", "S_uncorrected_departure_m_s"]
    assert frame.columns[:6] == ["side", *scores, "t_s_s", "status", "failed_solves"]
    assert frame["status"].unique().sort().to_list() == ["ok"]
    np.testing.assert_array_equal(frame["deepest_m"], outcome.deepest)
    table = scenarios.to_polars()
    assert table.columns == [
        "scenario", "side", "T_s", "d_y_m", "sigma_y_m", "v_mean_m_s", "a_mean_m_s2", "sigma_v_m_s", "c_0_1_m", "dc_1_m"
    ]  # fmt: skip
    assert table["side"][:2].to_list() == ["right", "left"]
    assert repr(scenarios) == "<Scenarios: 10 left, 10 right>"
    assert repr(outcome).startswith("<Outcome of 20 scenarios, departure window: mean S ")
    two = ldc.Scenarios.from_arrays(T=3.0, d_y=[0.1, 0.6], v_mean=25.0)
    frame = ldc.simulate(ldc.LQR(), two, 0.2).to_polars()
    assert frame["status"].to_list() == ["never_triggered", "ok"]
    assert frame["t_s_s"][0] == np.inf
    assert 0.0 < frame["t_s_s"][1] < 1.5


def test_a_column_has_one_name_in_files_and_frames(tmp_path: Path) -> None:
    """Of a run: in stored parts, CSV files and data frames; its type does not depend on what it holds."""
    study = ldc.study(
        ldc.NoControl, ldc.LQR, y_s=[0.1, 0.3], left=9, right=9,
        simulation={"window": "control", "convention": "as_printed"}, require="a_y_peak_p95 <= 1e-3",
    )  # fmt: skip
    results = ldc.run_study(study, tmp_path, workers=1)
    frame, parts = results.to_polars(), pl.read_parquet(tmp_path / "results" / "*.parquet")
    of_a_driver = {METRIC_COLUMNS[name] for name in DRIVER_METRICS}
    assert set(frame.columns) == {*parts.columns, "label", "law", "y_s_m", "side"} - of_a_driver
    names = pl.read_parquet(tmp_path / "designs.parquet")
    key = ["design", "scenario"]
    assert frame.height == parts.height == 3 * 18
    assert frame["scenario"].max() == 17
    both = frame.join(parts.join(names, on="design"), on=key, suffix=" stored")
    assert both.height == frame.height
    for name in ("label", "y_s_m", "S_control_m_s", "S_uncorrected_control_m_s", "a_y_peak_m_s2"):
        assert both[name].to_list() == both[f"{name} stored"].to_list()
    outcome = ldc.simulate(ldc.LQR(), results.scenarios, 0.1, window="control", setup=study.setup()).to_polars()
    assert set(outcome.columns) - {"t_s_s"} < set(frame.columns)
    assert outcome["S_control_m_s"].to_list() == frame.filter(law="lqr", y_s_m=0.1)["S_control_m_s"].to_list()
    stored = pl.read_parquet(tmp_path / "scenarios.parquet")
    assert results.scenarios.to_polars().columns == stored.columns
    ranking = ldc.rank_study(results, study)
    write_csv(ranking, tmp_path / "ranking.csv")
    table = ranking.to_polars()
    assert set(table.columns) == set(pl.read_csv(tmp_path / "ranking.csv").columns)
    assert table.columns[:6] == ["rank", "law", "y_s_m", "S_m_s", "set_of_best", "unmet"]
    assert (table["rank"].dtype, table["rank"].null_count()) == (pl.Int64, 3)  # no design meets what is required
    assert table["fresh_S_m_s"].dtype == pl.Float64
    text = {name for name, kind in table.schema.items() if kind == pl.String}
    assert {"law", "unmet", "failure", "design"} <= text
    assert not any(name.endswith(("_m_s", "_m", "_share")) for name in text)
    assert table["label"].to_list() == [design.label for design in ranking.designs]
    assert {"design", "label", "law", "y_s_m"} <= set(table.columns) & set(frame.columns) & set(names.columns)
    found = risk.estimate_risk(study.designs[-1:], study, n=60, workers=1)
    for row in (*found.rows(), *found.worst_rows()):
        assert (row["design"], row["label"]) in [(one.id, one.label) for one in found.designs]
    assert set(results.scenarios.to_polars().columns) | {"deepest_m"} < set(row)


def test_pandas_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in: the toolkit does not bring pandas; without it the error says what to do."""
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=dict))  # type: ignore[arg-type]
    made = arrays().to_pandas()
    assert list(made) == arrays().to_polars().columns
    assert isinstance(made["T_s"], np.ndarray)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with refused("to_pandas", LdcError, hint="or use to_polars()"):
        arrays().to_pandas()


def test_numbers_of_numpy_are_numbers() -> None:
    assert ldc.LQR(r_delta=np.float32(30.0)) == LQR(r_delta=30.0)
    assert ldc.LinearMPC(horizon=np.int64(12), always_solve=np.bool_(True)) == ldc.LinearMPC(12, always_solve=True)
    assert ldc.VehicleParameters(m=np.array(1500)) == ldc.VehicleParameters(m=1500)
    assert type(ldc.VehicleParameters(m=np.float32(1500)).m) is float
    study = ldc.study({"law": "lqr", "gains": {"r_delta": np.array([30.0, 300.0])}}, y_s=np.linspace(0.1, 0.3, 3),
                      left=np.int64(5), right=np.int32(5), seed=np.int64(2))  # fmt: skip
    assert len(study.designs) == 6
    assert study == ldc.study({"law": "lqr", "gains": {"r_delta": [30.0, 300.0]}}, y_s=[0.1, 0.2, 0.3],
                              left=5, right=5, seed=2)  # fmt: skip
    assert Study.from_dict(study.content()).hash == study.hash
    with refused("vehicle.m", value=True, allowed="a finite number > 0 kg"):
        ldc.VehicleParameters(m=np.bool_(True))


def test_a_design_table_takes_classes() -> None:
    @dataclasses.dataclass(frozen=True)
    class Own(ldc.LQR):
        name, title = "own_lqr", "Own"

    gains = {"r_delta": [30.0, 300.0]}
    study = ldc.study({"law": Own, "gains": gains}, {"law": [ldc.LQR, "pid"]}, y_s=0.1)
    ldc.registry.forget("own_lqr")
    assert [design.law for design in study.designs] == ["own_lqr", "own_lqr", "lqr", "pid"]
    assert {design.y_s for design in study.designs} == {0.1}
    assert study.designs[0].kind is Own
    assert study.designs[2:] == ldc.study(ldc.LQR, ldc.PID, y_s=0.1).designs


def test_seeds_have_defaults_and_the_folder_is_optional(tmp_path: Path) -> None:
    model = ldc.load_model("reference")
    assert model.sample(3, 2).T.tolist() == model.sample(3, 2, seed=0).T.tolist()
    study = ldc.study(ldc.NoControl, "lqr", left=5, right=5)
    there, gone = ldc.run_study(study, tmp_path / "out", workers=1), ldc.run_study(study, workers=1)
    np.testing.assert_array_equal(there.S, gone.S)
    assert isinstance(gone.to_polars(), pl.DataFrame)
    assert (tmp_path / "out" / "manifest.json").is_file()


def test_representations_are_short() -> None:
    plant = ldc.PlantOptions(speed="profile", actuator=ldc.Actuator(lag=0.1))
    study = ldc.study(ldc.NoControl, ldc.LQR, y_s=[0.1, 0.2], name="two", plant=plant)
    assert repr(study) == str(study) == "<Study 'two': 3 designs>"
    assert repr(plant) == "PlantOptions(speed='profile', actuator=Actuator(lag=0.1))"
    assert repr(ldc.Setup(dt=0.1)) == "Setup(dt=0.1)"
    late = ldc.PlantOptions(actuator=ldc.Actuator(delay=2.0))
    lost = ldc.simulate(ldc.LQR(r_delta=10.0), arrays(), 0.1, setup=ldc.Setup(options=late, plant_knowledge="ideal"))
    assert re.fullmatch(r"<Outcome of 20 scenarios, departure window: mean S .*, \d+ diverged>", repr(lost))


def test_dir_shows_public_names_only() -> None:
    assert dir(ldc) == sorted(ldc.__all__)
    assert {"LQR", "study", "run_study", "simulate", "Scenarios"} <= set(dir(ldc))
    assert not {"arrays", "errors", "kernel", "np", "importlib"} & set(dir(ldc))
    assert all(hasattr(ldc, name) for name in dir(ldc))
    with pytest.raises(AttributeError, match="module 'ldctoolkit' has no attribute 'LQRR'"):
        ldc.LQRR  # noqa: B018


STUDY = ldc.study(ldc.NoControl, left=2, right=2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ldc.study(3), r"design: 3; allowed: a controller, its class or name, or \{\"law\""),  # type: ignore[arg-type]
        (lambda: ldc.study(int), r"design: <class 'int'>; allowed: a controller, its class"),  # type: ignore[arg-type]
        (lambda: ldc.study({"law": "lqr", "gain": {}}), r"study: design\[0\]\.gain: no such key; did you mean 'gains'"),
        (lambda: ldc.study(ldc.LQR, y_s="0.1"), r"^study: design\[0\]\.y_s: '0.1'; allowed: a finite number"),
        (lambda: ldc.study(ldc.LQR, y_s=True), r"^study: design\[0\]\.y_s: True; allowed: a finite number"),
        (lambda: ldc.study(ldc.LQR, require=3), r"ranking\.require: 3; allowed: "),
        (lambda: ldc.study([ldc.LQR, ldc.PID]), r"^design: \[.*; allowed: .*, each an argument of its own$"),
        (
            lambda: ldc.study("LQR"),
            r"is not a known control law; did you mean 'lqr'\?.*; a class of your own needs an entry point",
        ),
        (lambda: ldc.study({"gains": {"r_delta": 1.0}}), r"^study: design\[0\]\.law: is missing and has no default$"),
        (lambda: ldc.study({"law": [ldc.LQR, int]}), r"^study: design\[0\]\.law: .*; allowed: text, or a list"),
        (
            lambda: ldc.study(ldc.LQR, scenarios=arrays()),
            r"^scenarios: an object of type Scenarios; allowed: a table of keys; .*run_study\(study, scenarios=",
        ),
        (lambda: ldc.run_study("my.toml"), r"^study: an object of type str; allowed: Study$"),
        (lambda: ldc.run_study(ldc.LQR), r"^study: the class LQR; allowed: Study$"),
        (
            lambda: ldc.run_study(STUDY, scenarios={}),
            r"^scenarios: an object of type dict; allowed: Scenarios or None$",
        ),
        (
            lambda: ldc.run_study(STUDY, model="reference", scenarios=arrays()),
            r"^model, scenarios: both are given; allowed: one of them$",
        ),
        (lambda: ldc.rank_study(STUDY, STUDY), r"^results: an object of type Study; allowed: StudyResults$"),
        (
            lambda: ldc.rank_study(ldc.run_study(STUDY, workers=1), ldc.study(ldc.PID, name="other")),
            r"^study: 'other' has none of the designs of the results; allowed: the one that was run$",
        ),
        (lambda: ldc.plot_ranking(3), r"^ranking: an object of type int; allowed: Ranking$"),
        (lambda: ldc.plot_distribution(3), r"^results: an object of type int; allowed: StudyResults$"),
        (lambda: ldc.assess(ldc.LQR(), 0.1), r"^standard: an object of type float; allowed: str or Path or Standard$"),
    ],
)
def test_arguments_of_a_wrong_type_are_named(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ldc.LdcError, match=message):
        call()


def test_speeds_that_are_likely_kilometres_an_hour() -> None:
    with pytest.warns(UnitWarning, match="v_mean: 85 m/s; likely km/h were meant: 23.61 m/s"):
        ldc.Scenarios.from_arrays(T=3.0, d_y=0.4, v_mean=[80.0, 85.0])


@dataclasses.dataclass(frozen=True)
class Own(ldc.Controller):
    name: ClassVar[str] = "own"
    title: ClassVar[str] = "Own"
    K_heading: float = ldc.gain(-0.2, unit="1", description="a gain")

    def prepare(self, plant: ldc.Plant) -> ldc.RecordedPath:
        return ldc.RecordedPath()


@pytest.mark.parametrize(
    ("kind", "name", "near"),
    [
        (ldc.LQR, "q_yy", "q_y"), (ldc.LinearMPC, "horizn", "horizon"), (Own, "K_heding", "K_heading"),
        (ldc.VehicleParameters, "C_aff", "C_af"), (ldc.BicycleModel, "parameter", "parameters"),
        (ldc.Setup, "trigge", "trigger"), (ldc.PlantOptions, "actuatr", "actuator"), (ldc.Actuator, "lagg", "lag"),
        (ldc.Sensors, "kalmann", "kalman"), (ldc.KalmanFilter, "r_yy", "r_y"), (ldc.Tyres, "muu", "mu"),
        (ldc.Mismatch, "Iz", "I_z"), (ldc.Residuals, "bandwith", "bandwidth"), (ldc.Plausibility, "y_rat", "y_rate"),
        (ldc.LinearLaw, "f_pst", "f_past"), (ldc.BoundedGaussianMixture, "n_component", "n_components"),
        (Criteria, "min_durations", "min_duration"), (Preparation, "steps", "step"), (ldc.LQR, "title", None),
    ],
)  # fmt: skip
def test_a_wrong_name_of_an_argument_names_the_nearest(kind: Any, name: str, near: str | None) -> None:
    """A `TypeError` as Python's own, and an error of the toolkit; wherever the name is given."""
    for make in (lambda: kind(**{name: 1.0}), lambda: dataclasses.replace(kind(), **{name: 1.0})):
        with pytest.raises(TypeError) as error:
            make()
        if kind in (Criteria, ldc.LinearLaw) and "missing" in str(error.value):
            continue  # there is no kind()
        assert isinstance(error.value, LdcError)
        assert (f"did you mean '{near}'?" in str(error.value)) == (near is not None)
        assert (error.value.path, error.value.value) == (kind.__name__, name)


def test_other_calls_stay_as_they_are() -> None:
    @dataclasses.dataclass(frozen=True, init=False)
    class Free(ldc.Controller):
        name: ClassVar[str] = "free"
        title: ClassVar[str] = "Takes what it is given"

        def __init__(self, **given: float) -> None:
            self.__dict__.update(given)

        prepare = Own.prepare

    assert Free(anything=2.0).__dict__ == {"anything": 2.0}
    law = ldc.LQR(5.0, r_delta=3.0)
    assert copy.deepcopy(law) == pickle.loads(pickle.dumps(law)) == law
    assert list(inspect.signature(ldc.LQR).parameters) == ["q_y", "q_y_rate", "q_psi", "q_psi_rate", "r_delta"]
    with pytest.raises(TypeError, match="positional"):
        ldc.LQR(*range(9))
