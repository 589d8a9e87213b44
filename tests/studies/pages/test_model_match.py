"""The scenario model against its departures, accelerations of paths, the notebook of the documentation."""

import dataclasses
import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import stats

import ldctoolkit
from helpers.results import invented_scenarios
from ldctoolkit import Controller, Outcome, Scenarios, Setup, studies
from ldctoolkit.controllers import LQR, LinearMPC, PreviewProportional
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, Departures
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.plant_options import Actuator, Mismatch, PlantOptions, Residuals, Tyres
from ldctoolkit.scenario_model import ScenarioModel, SideModel, load_model
from ldctoolkit.simulation import Takeover, drive
from ldctoolkit.studies import Ranking, StudyResults
from ldctoolkit.studies.pages.model_section import match
from ldctoolkit.studies.pages.replay import path_acceleration


def recorded(scenarios: Scenarios) -> Departures:
    """The same departures as if they were recorded."""
    n = len(scenarios)
    columns = {name: getattr(scenarios, name) for name in PARAMETER_NAMES}
    return Departures(
        scenarios.side, **columns, recording=np.full(n, "r"), start_time=np.zeros(n), samples=np.full(n, 9)
    )


@pytest.fixture(scope="module")
def model() -> ScenarioModel:
    return load_model("reference")


@pytest.fixture(scope="module")
def generated(model: ScenarioModel) -> Scenarios:
    return model.sample(300, 200, seed=5)


def test_a_departures_table_is_compared_exactly(model: ScenarioModel, generated: Scenarios) -> None:
    source = recorded(model.sample(900, 700, seed=6))
    left, right = match(generated, model, source=source)
    assert (left.key, left.generated, left.source, right.generated, right.source) == ("left", 300, 900, 200, 700)
    rows, mine = source.side == LEFT, generated.side == LEFT
    for one in left.parameters:
        own, other = getattr(generated, one.name)[mine], getattr(source, one.name)[rows]
        assert one.to_source is not None
        exact = stats.ks_2samp(own, other).statistic
        assert exact - 1 / 300 - 1 / 900 <= one.to_source.value <= exact + 1e-12
        # 5 % in eight parameters together, as one sample of as many effective events
        assert one.to_source.limit == pytest.approx(stats.kstwo.ppf(1 - 0.05 / 8, 225), rel=0.05)
        assert one.median == pytest.approx(np.median(own))


def test_the_same_driving_is_within_chance(model: ScenarioModel, generated: Scenarios) -> None:
    for side in match(generated, model):
        assert (side.source, side.reason) == (30_000, "")
        assert not any(
            one.to_model.beyond or one.to_source.beyond for one in side.parameters if one.to_model and one.to_source
        )


def test_other_driving_is_beyond_chance(model: ScenarioModel, generated: Scenarios) -> None:
    faster = recorded(model.sample(800, 800, seed=6))
    faster = dataclasses.replace(faster, v_mean=faster.v_mean + 4.0)
    for side in match(generated, model, source=faster):
        assert [one.name for one in side.parameters if one.to_source and one.to_source.beyond] == ["v_mean"]


def test_margins_of_the_model_are_exact() -> None:
    """One normal, cut at zero: the truncated normal's own distribution."""
    mixture = BoundedGaussianMixture.from_parameters(
        [1.0], [[2.0, 0.1, 25.0]], np.diag([0.25, 0.01, 9.0])[None], lower=[0.5, 0.0, 5.0], upper=[10.0, np.inf, np.inf]
    )
    rest = tuple((name, 0.0) for name in PARAMETER_NAMES if name not in ("T", "d_y", "v_mean"))
    side = SideModel(mixture, ("T", "d_y", "v_mean"), rest)
    model = dataclasses.replace(load_model("reference"), left_side=side)
    scenarios = model.sample(200, 0, seed=1)
    (left,) = match(scenarios, model)
    assert [one.name for one in left.parameters] == ["T", "d_y", "v_mean"]
    cut = stats.truncnorm(-1.0, np.inf, loc=0.1, scale=0.1)
    assert left.parameters[1].to_model is not None
    assert left.parameters[1].to_model.value == pytest.approx(stats.kstest(scenarios.d_y, cut.cdf).statistic, abs=3e-3)


def test_what_cannot_be_compared_is_said(model: ScenarioModel, generated: Scenarios) -> None:
    few = recorded(model.sample(20, 20, seed=6))
    assert "holds 20 departures of this side; 30 are needed" in match(generated, model, source=few)[0].reason
    given = model.sample(50, 50, seed=1, given={"v_mean": (20.0, 30.0)})
    assert "not those under the conditions" in match(given, model, given={"v_mean": (20.0, 30.0)})[0].reason


PLANTS = {
    "ideal": PlantOptions(),
    "profile": PlantOptions(speed="profile", residuals=Residuals(y=True, v=True)),
    "lag": PlantOptions(actuator=Actuator(lag=0.1, rate_max=0.5)),
    "whole delay": PlantOptions(actuator=Actuator(delay=0.1)),
    "part of a delay": PlantOptions(actuator=Actuator(delay=0.07)),
    "other vehicles": PlantOptions(mismatch=Mismatch(m=(0.8, 1.3), C_af=(0.7, 1.2))),
    "tyres": PlantOptions(
        tyres=Tyres(model="magic_formula", mu=0.5), speed="profile", mismatch=Mismatch(mu=(0.6, 1.0))
    ),
}


def driven(controller: Controller, options: PlantOptions, convention: str = "consistent"):  # type: ignore[no-untyped-def]
    scenarios = invented_scenarios(8, 7)
    scenarios = dataclasses.replace(scenarios, sigma_y=np.full(15, 0.02), sigma_v=np.full(15, 0.2))
    setup = Setup(convention=convention, options=options, seed=3)  # type: ignore[arg-type]
    over = Takeover.build(scenarios, setup, y_s=0.05)
    run = drive(controller, over, trajectories=True)
    kept = run.trajectories
    assert kept is not None
    paths = kept.t[over.rows], kept.x[over.rows], kept.delta[over.rows]
    return over, run, paths, path_acceleration(over, np.arange(over.m), *paths)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("controller", [LQR(r_delta=100.0), LinearMPC(r_delta=100.0)], ids=["linear", "steps"])
def test_the_largest_is_the_stored_peak(plant: str, controller: Controller) -> None:
    over, run, (t, _, _), a_y = driven(controller, PLANTS[plant])
    assert over.m > 8
    # T between two samples is no sample of the closed loop: its peak leaves it out, so ours may only be larger there
    since = (t - t[:, :1]) / over.setup.dt
    last = t == np.nanmax(t, axis=1, keepdims=True)
    sample = (np.abs(since - np.rint(since)) < 1e-7) | last
    peak = np.nanmax(np.where(sample, np.abs(a_y), np.nan), axis=1)
    stored = run.metrics.a_y_peak
    # up to the rounding of another order of operations; where the wheel jumps at a sample, the loop sees both sides
    assert (peak <= stored * (1 + 1e-9) + 1e-9).all()
    if plant in ("lag", "part of a delay"):
        assert peak == pytest.approx(stored, rel=1e-9, abs=1e-9)
    assert np.array_equal(np.isnan(a_y), np.isnan(t))


@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_it_is_that_of_the_linear_model(convention: str) -> None:
    over, _, (t, x, delta), a_y = driven(PreviewProportional(), PlantOptions(), convention)
    v = over.plant.v
    lane = v[:, None] * over.driven.curvature(np.where(np.isnan(t), 0.0, t))
    A, B, E = over.setup.model.matrices(v)
    # Rajamani, eq. 2.45, the row of d2e_y/dt2; a_y = d2e_y/dt2 + v dpsi_l/dt
    free = np.sum(A[:, None, 1] * np.nan_to_num(x), axis=-1) + (E[:, 1] + v)[:, None] * lane
    wheel = np.column_stack([delta[:, 0], delta])
    held = np.where(np.isnan(delta), wheel[:, :-1], delta)
    known = np.isfinite(t)
    assert a_y[known] == pytest.approx((free + B[:, 1:2] * held)[known], abs=1e-9)


matplotlib.use("agg")
PAGE = Path(__file__).resolve().parents[3] / "docs/gallery/index.md"


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S):
        exec(compile(code, "notebooks.md", "exec"), scope)
    assert len(plt.get_fignums()) == 6
    plt.close("all")
    for name, kind in (("ranking", Ranking), ("results", StudyResults), ("outcome", Outcome)):
        shown = scope[name]
        assert isinstance(shown, kind)
        assert shown._repr_html_().startswith("<div")


def test_the_page_names_every_plot_and_pages_that_exist() -> None:
    text = PAGE.read_text(encoding="utf-8")
    plots = {name for module in (studies, ldctoolkit) for name in module.__all__ if name.startswith("plot_")}
    assert plots == set(re.findall(r"\| `(plot_\w+)\(", text))
    for link in re.findall(r"\]\(([\w/.-]+)\)", text):
        assert (PAGE.parent / link).exists(), link
