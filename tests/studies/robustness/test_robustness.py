"""Numbers on other plants against plain simulations, textbook intervals, and python-control."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any, ClassVar

import control
import numpy as np
import pytest
from scipy import stats

from helpers.bits import assert_same_bits
from helpers.closed_loop import known
from helpers.results import results_of_outcomes
from ldctoolkit import BicycleModel, Controller, EventStatus, Scenarios, Setup, VehicleParameters, simulate
from ldctoolkit.controllers import LQR, LinearMPC, NoControl, PreviewProportional
from ldctoolkit.plant_options import (
    INTENTS,
    Actuator,
    Driver,
    KalmanFilter,
    Mismatch,
    PlantOptions,
    Residuals,
    Sensors,
    Tyres,
)
from ldctoolkit.review import design_margins
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.measures import drive_on_plants
from ldctoolkit.studies.ranking.ranking import Ranking
from ldctoolkit.studies.ranking.verdict import Light
from ldctoolkit.studies.results import StudyResults
from ldctoolkit.studies.robustness import (
    MOST,
    OtherPlant,
    Robustness,
    RobustnessTask,
    chosen_designs,
    impossible,
    lower_ends,
    other_plants,
    robustness_of,
    stored_of,
    work_out,
)
from ldctoolkit.studies.study_file import load_study
from ldctoolkit.vehicle import Plant

SETUP = Setup(settle=1.0, seed=5)


def departures(n: int, seed: int = 2) -> Scenarios:
    rng = np.random.default_rng(seed)
    T = np.clip(rng.lognormal(np.log(2.2), 0.4, n), 0.8, 6.0)
    v = rng.normal(25.0, 3.0, n)
    return Scenarios.from_arrays(
        T=T,
        d_y=np.clip(rng.lognormal(np.log(0.35), 0.4, n), 0.1, 1.0),
        v_mean=v,
        a_mean=rng.normal(0.0, 0.3, n),
        c_0=rng.normal(0.0, 0.3, n) / v**2,
        sigma_y=0.02,
        sigma_v=0.05,
        side=np.repeat([1, -1], [n // 2, n - n // 2]),
    )


DESIGNS = (
    Design.of(LQR(r_delta=30.0), 0.05),
    Design.of(PreviewProportional(), 0.2),
    Design.of(PreviewProportional(K_y=-0.08, K_psi=-0.5), 0.05),
    Design.of(NoControl(), 0.2),
)


def results_of(designs: tuple[Design, ...], scenarios: Scenarios) -> StudyResults:
    model = BicycleModel(VehicleParameters())
    outcomes = [simulate(d.controller(), scenarios, vehicle=model, y_s=d.y_s, settle=1.0, seed=5) for d in designs]
    return results_of_outcomes(designs, scenarios, outcomes)


@pytest.fixture(scope="module")
def results() -> StudyResults:
    return results_of(DESIGNS, departures(40))


@pytest.fixture(scope="module")
def task(results: StudyResults) -> RobustnessTask:
    return RobustnessTask.of(results, Ranking.of(results, bootstrap=100), SETUP, per_side=12)


@pytest.fixture(scope="module")
def robustness(task: RobustnessTask) -> Robustness:
    return work_out(task)


def test_numbers_are_those_of_plain_simulations(task: RobustnessTask, robustness: Robustness) -> None:
    rows = np.r_[0:12, 20:32]  # the first of each side
    assert (robustness.left, robustness.right) == (12, 12)
    scenarios = departures(40).take(rows)
    assert len(robustness.plants) == len(set(robustness.plants)) == 18
    for k, plant in enumerate(task.plants):
        scores = []
        for i, design in enumerate(task.chosen.designs):
            # the study's plant is ideal: that is what designs know
            setup = dataclasses.replace(SETUP, options=plant.options, plant_knowledge="ideal")
            out = simulate(design.controller(), scenarios, y_s=design.y_s, setup=setup)
            bad = (out.status == EventStatus.DIVERGED) | (out.status == EventStatus.SOLVER_FAILED)
            counted = np.where(bad, np.maximum(out.S, out.S_uncorrected), out.S)
            assert robustness.S[k, i] == pytest.approx(counted.mean(), rel=1e-12)
            assert robustness.excess[k, i] == pytest.approx((counted - out.S_uncorrected).mean(), abs=1e-12)
            scores.append(counted)
        lead = scores[0] - min(scores[1:], key=np.mean)
        error = np.sqrt(sum(12 * lead[part].var(ddof=1) for part in (slice(0, 12), slice(12, 24)))) / 24
        assert robustness.behind[k] == pytest.approx(lead.mean() - stats.t.ppf(0.975, 22) * error, rel=1e-9, abs=1e-12)
    assert not robustness.raised


def test_a_design_that_other_plants_destroy_is_found(task: RobustnessTask, robustness: Robustness) -> None:
    hard = next(i for i, design in enumerate(task.chosen.designs) if design.law == "lqr")
    together = robustness.plants.index("together")
    assert robustness.diverged[0].sum() == 0
    assert robustness.diverged[together, hard] > 0
    assert robustness.S[together, hard] > robustness.S[0, hard]


# ------------------------------------------------------------------------------------------------ drivers


MIX = Driver(straight=0.5, recorded=0.2, against=0.3, grip=(0.3, 0.3), torque_max=40.0)  # never at the limit


def test_each_driver_of_a_study_is_a_plant_and_nobody_is_one() -> None:
    def named(options: PlantOptions) -> dict[str, OtherPlant]:
        return {plant.name: plant for plant in other_plants(options) if plant.name.startswith("driver-")}

    assert not named(PlantOptions())
    options = PlantOptions(driver=MIX, actuator=Actuator(lag=0.1))
    plants = named(options)
    assert list(plants) == [f"driver-{name}" for name in ("nobody", *INTENTS)]
    assert not any(plant.adds for plant in plants.values())
    straight = Driver(straight=1.0, grip=(0.3, 0.3), torque_max=40.0)
    assert plants["driver-straight"].options == dataclasses.replace(options, driver=straight)
    assert plants["driver-nobody"].options == PlantOptions(actuator=Actuator(lag=0.1))
    # the study's own plant is not there twice
    assert "driver-straight" not in named(PlantOptions(driver=straight))


@pytest.fixture(scope="module")
def driven() -> tuple[RobustnessTask, Robustness, Ranking]:
    """On departures of which some trigger no design, with a driver who can be felt."""
    setup = dataclasses.replace(SETUP, options=PlantOptions(driver=MIX))
    scenarios = departures(40)
    outcomes = [simulate(d.controller(), scenarios, y_s=d.y_s, setup=setup) for d in DESIGNS]
    results = results_of_outcomes(DESIGNS, scenarios, outcomes)
    ranking = Ranking.of(results, bootstrap=100, setup=setup)
    task = RobustnessTask.of(results, ranking, setup, per_side=12)
    return task, work_out(task), ranking


def test_numbers_with_a_driver_are_those_of_plain_simulations(
    driven: tuple[RobustnessTask, Robustness, Ranking],
) -> None:
    task, robustness, _ = driven
    scenarios = departures(40).take(np.r_[0:12, 20:32])
    for name, p in (robustness.drivers | {"": 0}).items():
        plant, scores, idle = task.plants[p], [], 0
        for i, design in enumerate(task.chosen.designs):
            setup = dataclasses.replace(SETUP, options=plant.options)
            out = simulate(design.controller(), scenarios, y_s=design.y_s, setup=setup)
            acted = out.status != EventStatus.NEVER_TRIGGERED
            idle += int((~acted).sum())
            peak = out.metrics.driver_torque_peak[acted]
            felt = [peak.mean(), np.quantile(peak, 0.95), out.metrics.against_time[acted].mean(),
                    out.metrics.overridden[acted].mean()]  # fmt: skip
            np.testing.assert_allclose(robustness.felt[:, p, i], felt, rtol=1e-12, atol=1e-15)
            assert np.isnan(felt).all() == (name == "nobody")
            scores.append(out.S)
            for values, ends in ((out.S, robustness.S_ends), (out.S - scores[0], robustness.difference_ends)):
                error = np.sqrt(sum(12 * values[part].var(ddof=1) for part in (slice(0, 12), slice(12, 24)))) / 24
                half = stats.t.ppf(0.975, 22) * error
                assert ends[:, p, i] == pytest.approx([values.mean() - half, values.mean() + half], rel=1e-9, abs=1e-12)
        assert idle > 0
    assert robustness.felt[1, robustness.drivers["against"]].max() > 0.5


def with_scores(
    driven: tuple[RobustnessTask, Robustness, Ranking], S: dict[str, tuple[float, float]], half: float = 0.01
) -> Light | None:
    """The light of the reference where it and one other design have these S with the drivers, "" being all together."""
    _, robustness, ranking = driven
    scores, contends = robustness.S.copy(), np.array([True, True, *[False] * (len(robustness.designs) - 2)])
    for name, values in S.items():
        scores[robustness.drivers[name] if name else 0, :2] = values
    difference = scores - scores[:, :1]
    felt = robustness.felt.copy()
    felt[:, robustness.drivers["against"], 0] = 1.0, 4.2, 0.5, 0.75
    changed = dataclasses.replace(
        robustness,
        S=scores,
        contends=contends,
        felt=felt,
        difference_ends=np.stack([difference - half, difference + half]),
    )
    position = [design.id for design in ranking.designs].index(robustness.designs[0])
    return changed.driver_light(ranking, position, MIX)


AGAINST = "With against torque counts: 95 % of the peaks to 4.2 N m, 75\u00a0% overridden."


def test_the_light_of_the_driver_names_who_changes_the_order(
    driven: tuple[RobustnessTask, Robustness, Ranking],
) -> None:
    """A driver who is not in the mix does not count, nor does one whose departure is wanted."""
    same = {"": (1.0, 1.1), "straight": (1.0, 1.2), "recorded": (1.0, 1.05)}
    other = {"returns": (2.0, 1.0), "against": (2.0, 1.0), "nobody": (2.0, 1.0)}
    light = with_scores(driven, same | other)
    assert light is not None
    assert (light.name, light.state) == ("Driver", "good")
    assert light.text == f"First with each driver of the mix: recorded, straight. {AGAINST}"
    light = with_scores(driven, same | {"straight": (1.05, 1.0)})
    assert light is not None
    assert light.state == "warning"
    assert re.fullmatch(
        r"Another design is first with straight .+, S 0\.050 m s less \(0\.040 to 0\.060\)\. " + re.escape(AGAINST),
        light.text,
    )
    # by the mean alone: a change of the order only where the reference leads with all of them together
    light = with_scores(driven, same | {"straight": (1.005, 1.0)})
    assert light is not None
    assert light.state == "warning"
    assert "S 0.005 m s less (not separated)" in light.text
    light = with_scores(driven, same | {"": (1.005, 1.0), "straight": (1.005, 1.0)})
    assert light is not None
    assert light.state == "good"
    assert light.text.startswith("First or not separated from it with each driver of the mix: recorded, straight.")
    light = with_scores(driven, same | {"": (1.005, 1.0), "straight": (1.05, 1.0)})
    assert light is not None
    assert light.state == "warning"
    light = with_scores(driven, {name: (1.0, float("nan")) for name in same})
    assert light is not None
    assert light.state == "unknown"


def test_no_light_of_the_driver_for_another_design(driven: tuple[RobustnessTask, Robustness, Ranking]) -> None:
    _, robustness, ranking = driven
    position = [design.id for design in ranking.designs].index(robustness.designs[1])
    assert robustness.driver_light(ranking, position, MIX) is None


def test_few_changes_have_no_interval() -> None:
    old = np.ones((3, 40))
    new = old.copy()
    new[1, :5] += 1.0
    new[2, :6] += 1.0
    low = lower_ends(old, new, np.repeat([1, -1], 20), 0.95)
    assert low[0] == 0.0
    assert np.isnan(low[1])
    assert low[2] < (new - old)[2].mean()
    assert np.isnan(lower_ends(old[:1], old[:1] + 0.3, np.array([1] * 39 + [-1]), 0.95)[0])


def test_margins_are_those_of_python_control() -> None:
    """Preview P with a delayed actuator, its loop put together here from the vehicle's matrices."""
    K_y, K_psi, T_lp, dt = -0.02, -0.3, 0.6, 0.05
    law = PreviewProportional(K_y=K_y, K_psi=K_psi, T_lp=T_lp)
    v = np.array([15.0, 30.0])
    setup = dataclasses.replace(SETUP, options=PlantOptions(actuator=Actuator(delay=dt)))
    (found_gain,), (found_phase,) = design_margins([law], setup, v)
    model = BicycleModel(VehicleParameters())
    A, B, _ = model.matrices(v)
    gains = law.prepare(Plant.build(model, v, dt)).F
    for i in range(2):
        vehicle = control.ss(A[i], np.reshape(B[i], (4, 1)), -np.atleast_2d(gains[i]), 0.0).sample(dt)
        loop = control.series(control.ss(0.0, 1.0, 1.0, 0.0, dt), vehicle)  # one sample late
        gain, phase, *_ = control.stability_margins(loop, method="frd")
        assert found_phase[i] == pytest.approx(np.radians(phase), rel=5e-3)
        assert found_gain[i] == pytest.approx(gain, rel=5e-3)


def changed(options: PlantOptions) -> dict[str, dict[str, Any]]:
    """What each plant changes of the study's own: part -> its new value, only the fields that differ."""
    changes_of: dict[str, dict[str, Any]] = {}
    for plant in other_plants(options):
        changes_of[plant.name] = {}
        for part in dataclasses.fields(PlantOptions):
            old, new = getattr(options, part.name), getattr(plant.options, part.name)
            names = [field.name for field in dataclasses.fields(old)] if dataclasses.is_dataclass(old) else [""]
            for name in names:
                was, now = (getattr(one, name) if name else one for one in (old, new))
                if was != now:
                    changes_of[plant.name][f"{part.name}.{name}".rstrip(".")] = now
    return changes_of


NOISE = {"sensors.e_y_noise": 0.03, "sensors.e_psi_noise": 0.003, "sensors.curvature_noise": 2e-4}
ACTUATOR = {"actuator.rate_max": 0.33, "actuator.lag": 0.1, "actuator.delay": 0.05}
OF_IDEAL: dict[str, dict[str, Any]] = {
    "delay": {"actuator.delay": 0.05},
    "lag": {"actuator.lag": 0.1},
    "limits": {"actuator.delta_max": 0.1, "actuator.rate_max": 0.33},
    "heavy": {"mismatch.m": (1.3, 1.3), "mismatch.I_z": (1.3, 1.3)},
    "light": {"mismatch.m": (0.85, 0.85), "mismatch.I_z": (0.85, 0.85)},
    "soft": {"mismatch.C_af": (0.8, 0.8), "mismatch.C_ar": (0.8, 0.8)},
    "stiff": {"mismatch.C_af": (1.2, 1.2), "mismatch.C_ar": (1.2, 1.2)},
    "tyres": {"tyres.model": "magic_formula"},
    "friction": {"tyres.model": "magic_formula", "tyres.mu": 0.5},
    "noise": NOISE,
    "camera-delay": {"sensors.delay": 0.1},
    "camera-rate": {"sensors.period": 1 / 15},
    "lost-frames": {"sensors.period": 2 / 15},
    "filter": NOISE | {"sensors.kalman": KalmanFilter()},
    "speed": {"speed": "profile"},
    "residuals": {"residuals.y": True, "residuals.v": True},
}
HARDER_THAN_REAL: dict[str, dict[str, Any]] = {
    "slow-actuator": {"actuator.lag": 0.2, "actuator.delay": 0.1},
    "heavy": {"mismatch.m": (1.43, 1.43), "mismatch.I_z": (1.43, 1.43)},
    "soft": {"mismatch.C_af": (0.72, 0.72), "mismatch.C_ar": (0.72, 0.72)},
    "friction": {"tyres.mu": 0.5},
    "camera-delay": {"sensors.delay": 0.2},
    "camera-rate": {"sensors.period": 1 / 15},
    "lost-frames": {"sensors.period": 2 / 15},
}
RANGES = dict.fromkeys(("mismatch.m", "mismatch.I_z", "mismatch.C_af", "mismatch.C_ar"), (1.0, 1.0))
EASIER_THAN_REAL: dict[str, dict[str, Any]] = {
    "no-actuator": {"actuator.rate_max": None, "actuator.lag": 0.0, "actuator.delay": 0.0},
    "nominal": RANGES | {"tyres.model": "linear"},
    "no-noise": dict.fromkeys(NOISE, 0.0),
    "no-camera-delay": {"sensors.delay": 0.0},
    "no-filter": {"sensors.kalman": None},
    "no-residuals": {"residuals.y": False},
}


def rounded(changes_of: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {
        name: {
            key: tuple(np.round(value, 9).tolist()) if isinstance(value, tuple) else value
            for key, value in changes.items()
        }
        for name, changes in changes_of.items()
    }


def test_plants_add_a_difficulty_or_take_one_away() -> None:
    """By literals. The ideal plant has none to take away; what a plant has already is made worse, and left out."""
    ideal, real = other_plants(PlantOptions()), load_study("reality").plant
    assert all(plant.adds for plant in ideal)
    assert rounded(changed(PlantOptions())) | {"together": {}} == rounded(OF_IDEAL) | {"together": {}}
    assert ideal[-1].name == "together"
    assert ideal[-1].options == real
    own = dataclasses.replace(real, residuals=Residuals(y=True))
    changes_of = rounded(changed(own))
    assert set(changes_of.pop("ideal")) >= {*EASIER_THAN_REAL["no-actuator"], *RANGES, *NOISE, "speed", "residuals.y"}
    assert changes_of == HARDER_THAN_REAL | EASIER_THAN_REAL
    assert {plant.name for plant in other_plants(own) if plant.adds} == set(HARDER_THAN_REAL)
    titles = {plant.name: plant.title for plant in other_plants(own)}
    assert titles["slow-actuator"] == "Lag and delay doubled"
    assert titles["no-noise"] == "Without camera noise"


@pytest.mark.parametrize(
    ("options", "name", "changes"),
    [
        (PlantOptions(actuator=Actuator(lag=0.2)), "delay", {"actuator.delay": 0.05}),
        (PlantOptions(actuator=Actuator(lag=0.2)), "slow-actuator", {"actuator.lag": 0.4}),
        (
            PlantOptions(mismatch=Mismatch(m=(0.5, 2.0))),
            "heavy",
            {"mismatch.m": (2.2, 2.2), "mismatch.I_z": (2.2, 2.2)},
        ),
        (PlantOptions(tyres=Tyres(model="magic_formula", mu=0.3)), "friction", {"tyres.mu": 0.15}),
        (PlantOptions(sensors=Sensors(fps=10)), "lost-frames", {"sensors.period": 0.2}),
        (PlantOptions(sensors=Sensors(fps=10)), "no-camera-delay", {"sensors.period": 0.0}),
        (PlantOptions(sensors=Sensors(e_y_bias=0.1)), "filter", {"sensors.kalman": KalmanFilter()}),
        (
            PlantOptions(tyres=Tyres(model="magic_formula"), mismatch=Mismatch(mu=(0.5, 1.0))),
            "nominal",
            {"tyres.model": "linear", "mismatch.mu": (1.0, 1.0)},
        ),
    ],
)
def test_what_is_added_is_worse_than_what_there_is(options: PlantOptions, name: str, changes: dict[str, Any]) -> None:
    assert rounded(changed(options))[name] == changes


def test_no_slower_camera_is_faster_than_the_studys() -> None:
    assert "camera-rate" not in changed(PlantOptions(sensors=Sensors(fps=10)))


def test_a_path_that_no_tyre_could_follow_is_not_counted_as_diverged() -> None:
    """One departure asks for 6.7 m/s^2: more than a friction of 0.5 gives, less than one of 0.9."""
    T, d_y = np.full(4, 2.5), np.full(4, 0.4)
    T[1], d_y[1] = 1.2, 1.2
    scenarios = Scenarios.from_arrays(T=T, d_y=d_y, v_mean=25.0, side=[1, 1, -1, -1])
    results = results_of((Design.of(LQR(r_delta=0.1), 0.05),), scenarios)
    task = RobustnessTask.of(results, Ranking.of(results, bootstrap=50), SETUP)
    drives = drive_on_plants(
        task.chosen.designs, [plant.options for plant in task.plants], scenarios, SETUP, "departure"
    )
    robustness, diverged = work_out(task), drives.status[:, 0] == EventStatus.DIVERGED
    for name, more in (("friction", 0), ("tyres", 1)):
        k = robustness.plants.index(name)
        assert diverged[k, 1]
        assert robustness.diverged[k, 0] == diverged[k, [0, 2, 3]].sum() + more


def test_what_a_plant_is_called_holds_its_values() -> None:
    what = {plant.name: plant.what for plant in other_plants(PlantOptions())}
    assert what["heavy"] == "mass and yaw inertia times 1.3; the laws are not told"
    assert what["soft"] == "cornering stiffness of both axles times 0.8; the laws are not told"
    assert what["lost-frames"] == "every second frame of a camera of 15 Hz is lost"
    assert what["tyres"] == "magic formula, friction coefficient 0.9"
    assert what["limits"] == "at most 0.1 rad and 0.33 rad/s at the front wheels"
    assert what["noise"] == "standard deviations of 0.03 m, 0.003 rad, and 0.0002 1/m in the curvature"


def test_plants_that_cannot_be_driven_on_are_named() -> None:
    plants = {plant.name: plant for plant in other_plants(PlantOptions())}
    assert impossible(plants["tyres"], "as_printed", True) == (
        "the matrix as printed is linear and has no saturating tyres"
    )
    assert impossible(plants["residuals"], "consistent", False) == "the departures have no residuals"
    for name, convention, residuals in (("tyres", "consistent", False), ("residuals", "as_printed", True)):
        assert impossible(plants[name], convention, residuals) == ""  # type: ignore[arg-type]


def test_numbers_do_not_depend_on_order_or_neighbours(task: RobustnessTask) -> None:
    designs, plants = task.chosen.designs, [plant.options for plant in task.plants[:6]]
    both = drive_on_plants(designs, plants, task.scenarios, SETUP, "departure")
    turned = drive_on_plants(designs[::-1], plants[::-1], task.scenarios, SETUP, "departure")
    assert np.array_equal(both.S, turned.S[::-1, ::-1])
    alone = drive_on_plants(designs[:1], plants[3:4], task.scenarios.take(np.array([7])), SETUP, "departure")
    assert alone.S[0, 0, 0] == both.S[3, 0, 7]


@dataclasses.dataclass(frozen=True)
class Fussy(Controller):
    """Raises where a speed is not the one that it knows."""

    name: ClassVar[str] = "fussy_robustness"
    title: ClassVar[str] = "Fussy"

    def prepare(self, plant: object) -> object:
        raise ZeroDivisionError("not today")


def test_a_law_that_raises_is_told_and_the_others_are_driven(task: RobustnessTask) -> None:
    chosen = dataclasses.replace(
        task.chosen, designs=(*task.chosen.designs[:1], Design.of(Fussy(), 0.1)), contends=(True, True)
    )
    plants = task.plants[:3]
    with known(Fussy):
        robustness = work_out(dataclasses.replace(task, chosen=chosen, plants=plants))
    assert [(k, i) for k, i, _ in robustness.raised] == [(0, 1), (1, 1), (2, 1)]
    assert "not today" in robustness.raised[0][2]
    assert np.isnan(robustness.S[:, 1]).all()
    assert np.isfinite(robustness.S[:, 0]).all()
    assert np.isnan(robustness.behind).all()
    assert robustness.n == 24
    assert np.isnan(robustness.gain[1]).all()


def test_designs_are_chosen_by_their_places() -> None:
    designs = [Design.of(LQR(r_delta=10.0 * k), 0.05) for k in (1, 2, 3)]
    designs += [Design.of(PreviewProportional(K_y=-0.08), 0.05), Design.of(PreviewProportional(), 0.2)]
    designs += [Design.of(NoControl(), 0.2)]
    results = results_of(tuple(designs), departures(10))
    ranking = Ranking.of(results, bootstrap=50)
    chosen = chosen_designs(ranking)
    assert chosen.designs[0] == ranking.designs[ranking.winner or 0]
    laws = [design.law for design in chosen.designs]
    assert laws.count("lqr") == 1
    assert Design.of(PreviewProportional(), 0.2) in chosen.designs  # Table I
    assert "none" in laws  # the baseline
    assert len(chosen.designs) == 4 <= MOST
    unranked = Ranking.of(results, bootstrap=50, require=["S <= 0"])
    assert all(chosen_designs(unranked).contends)
    strict = Ranking.of(results, bootstrap=50, require=[f"S <= {ranking.metrics.S[0] + 1e-9}"])
    assert [design.law for design, takes in zip(chosen_designs(strict).designs, chosen_designs(strict).contends,
                                                strict=True) if takes] == ["lqr"]  # fmt: skip


def test_slow_and_unsafe_laws_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    designs = (
        Design.of(LinearMPC(r_delta=100.0), 0.05),
        Design.of(LQR(r_delta=100.0), 0.05),
        Design.of(NoControl(), 0.2),
    )
    results = results_of(designs, departures(8))
    status = results.status.copy()
    status[1, 0] = EventStatus.CRASHED
    ranking = Ranking.of(dataclasses.replace(results, status=status), bootstrap=50)
    monkeypatch.setattr(LinearMPC, "batch", 20)
    chosen = chosen_designs(ranking)
    assert chosen.slow == ("linear_mpc",)
    assert chosen.unsafe == (designs[1].label,)
    assert [design.law for design in chosen.designs] == ["none"]


def test_numbers_are_stored_and_worked_out_again_for_anything_else(
    tmp_path: Path, task: RobustnessTask, robustness: Robustness, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def count(wanted: RobustnessTask) -> Robustness:
        calls.append(wanted.key)
        return dataclasses.replace(robustness, key=wanted.key)

    monkeypatch.setattr("ldctoolkit.studies.robustness.work_out", count)
    assert stored_of(tmp_path, task) is None
    assert robustness_of(tmp_path, task) is not None
    json.loads((tmp_path / "robustness.json").read_text(), parse_constant=pytest.fail)  # numbers that JSON knows only
    assert_same_bits(stored_of(tmp_path, task), robustness)
    assert_same_bits(robustness_of(tmp_path, task), robustness)
    assert len(calls) == 1
    others = [
        dataclasses.replace(task, plants=task.plants[:4]),
        dataclasses.replace(task, scenarios=task.scenarios.take(np.arange(5))),
        dataclasses.replace(task, setup=dataclasses.replace(SETUP, seed=6)),
        dataclasses.replace(task, chosen=dataclasses.replace(task.chosen, designs=task.chosen.designs[:2],
                                                             contends=(True, True))),
    ]  # fmt: skip
    for other in others:
        assert stored_of(tmp_path, other) is None
        robustness_of(tmp_path, other)
    assert len(calls) == len(set(calls)) == 5
    (tmp_path / "robustness.json").write_text("{broken")
    robustness_of(tmp_path, task)
    assert len(calls) == 6
