"""What a Python session needs, from one import, in a few lines; each as a user would write it."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import ldctoolkit as ldc
from controllers import LQR
from ldctoolkit.plant_options import Actuator, PlantOptions
from studies import Study

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


def test_a_law_of_a_script_or_notebook(tmp_path: Path) -> None:
    """A class in __main__ runs in worker processes and passes the contract."""
    assert len(OWN_LAW.strip().splitlines()) <= 8
    check = "from ldctoolkit.testing import contract_faults\nprint(results, contract_faults(Offset()))"
    done = subprocess.run(
        [sys.executable, "-c", OWN_LAW + check], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("<StudyResults: designs 3: none (1), offset (2); scenarios 18 (9 left, 9 right); ")
    assert done.stdout.rstrip().endswith(" ()")


def arrays() -> ldc.Scenarios:
    side = np.where(np.arange(20) % 2, 1, -1)
    return ldc.Scenarios.from_arrays(T=np.linspace(2.0, 5.0, 20), d_y=0.4, v_mean=25.0, side=side)


def test_own_arrays_vehicle_requirement_and_a_data_frame() -> None:
    study = ldc.study(
        ldc.NoControl(), ldc.LQR(r_delta=np.float32(300.0)), "pid", y_s=[0.1, 0.2], require="a_y_peak_p95 <= 9",
        vehicle=ldc.VehicleParameters(m=np.int64(1500)), plant=PlantOptions(actuator=Actuator(lag=0.1)),
    )  # fmt: skip
    results = ldc.run_study(study, scenarios=arrays(), workers=1)
    ranking = ldc.rank_study(results, study)[0]
    table = ranking.to_polars()
    assert table["design"].to_list() == [design.id for design in ranking.designs]
    np.testing.assert_array_equal(table["S_m_s"], ranking.S)
    assert table["set_of_best"].to_list() == ranking.set_of_best.tolist()
    rows = results.to_polars()
    assert rows.shape[0] == 5 * 20
    np.testing.assert_array_equal(rows["S_m_s"], results.cases[0].S.ravel())
    one = ldc.simulate(ldc.LQR(r_delta=300.0), results.scenarios, 0.1, vehicle=study.vehicle, options=study.plant)
    np.testing.assert_array_equal(rows.filter(law="lqr", y_s_m=0.1)["S_m_s"], one.S)
    assert study.ranking.require == ("a_y_peak_p95 <= 9",)
    assert repr(results) == (
        "<StudyResults: designs 5: none (1), lqr (2), pid (2); scenarios 20 (10 left, 10 right); "
        "cases departure window, consistent>"
    )
    assert repr(ranking).startswith("<Ranking of 5 designs, departure window, consistent: best 'LQR, y_s=0.1 m")


def test_frames_of_departures_and_outcomes() -> None:
    scenarios = arrays()
    outcome = ldc.simulate(ldc.NoControl(), scenarios)
    frame = outcome.to_polars()
    assert frame.columns[:6] == ["side", "S_m_s", "S_uncorrected_m_s", "t_s_s", "status", "failed_solves"]
    assert frame["status"].unique().sort().to_list() == ["ok"]
    np.testing.assert_array_equal(frame["deepest_m"], outcome.deepest)
    table = scenarios.to_polars()
    assert table.columns == [
        "side", "T_s", "d_y_m", "sigma_y_m", "v_mean_m_s", "a_mean_m_s2", "sigma_v_m_s", "c_0_1_m", "dc_1_m"
    ]  # fmt: skip
    assert table["side"][:2].to_list() == ["right", "left"]
    assert repr(scenarios) == "<Scenarios: 10 left, 10 right>"
    assert repr(outcome).startswith("<Outcome of 20 scenarios, departure window: mean S ")


def test_pandas_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in: the toolkit does not bring pandas."""

    class Pandas:
        DataFrame = dict

    monkeypatch.setitem(sys.modules, "pandas", Pandas)  # type: ignore[arg-type]
    made = arrays().to_pandas()
    assert list(made) == arrays().to_polars().columns
    assert isinstance(made["T_s"], np.ndarray)


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
    with pytest.raises(ldc.LdcError, match=r"vehicle\.m: True; allowed: a number > 0"):
        ldc.VehicleParameters(m=np.bool_(True))


def test_seeds_have_defaults_and_the_folder_is_optional(tmp_path: Path) -> None:
    model = ldc.load_model("reference")
    assert model.sample(3, 2).T.tolist() == model.sample(3, 2, seed=0).T.tolist()
    study = ldc.study(ldc.NoControl, "lqr", left=5, right=5)
    there, gone = ldc.run_study(study, tmp_path / "out", workers=1), ldc.run_study(study, workers=1)
    np.testing.assert_array_equal(there.cases[0].S, gone.cases[0].S)
    assert isinstance(gone.to_polars(), pl.DataFrame)
    assert (tmp_path / "out" / "study.toml").is_file() or list((tmp_path / "out").iterdir())


def test_dir_shows_public_names_only() -> None:
    assert dir(ldc) == sorted(ldc.__all__)
    assert {"LQR", "study", "run_study", "simulate", "Scenarios"} <= set(dir(ldc))
    assert not {"package_names", "errors", "kernel", "np", "importlib"} & set(dir(ldc))
    assert all(hasattr(ldc, name) for name in dir(ldc))
    with pytest.raises(AttributeError, match="module 'ldctoolkit' has no attribute 'LQRR'"):
        ldc.LQRR  # noqa: B018


@pytest.mark.parametrize(
    ("design", "message"),
    [
        (3, r"design: 3; allowed: a controller, its class, the name of a law, or a design table"),
        (int, r"design: <class 'int'>; allowed: a controller, its class"),
        ("lqq", r"did you mean 'lqr'"),
        ({"law": "lqr", "gain": {}}, r"study: design\[0\]\.gain: no such key; did you mean 'gains'"),
    ],
)
def test_what_is_no_design_is_named(design: object, message: str) -> None:
    with pytest.raises(ldc.LdcError, match=message):
        ldc.study(design)  # type: ignore[arg-type]


def test_a_frozen_law_is_still_a_dataclass() -> None:
    assert dataclasses.replace(ldc.LQR(), r_delta=5.0).r_delta == 5.0
