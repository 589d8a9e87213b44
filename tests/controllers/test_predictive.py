"""Predictive controllers that a designer writes: contract, studies, compiled code, faults, other routes to plans."""

import copy
import dataclasses
import importlib
import os
import pickle
import signal
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.integrate

import ldctoolkit as ldc
import ldctoolkit.casadi_code as casadi_code
from helpers.closed_loop import DT, assert_same_rows, known, make_scenarios, mpc_situations
from helpers.errors import refused
from helpers.kills import killing
from helpers.results import assert_same_results
from ldctoolkit import BicycleModel, Plant, PredictiveController, Preview, Soft, Stage, compiling, simulate
from ldctoolkit.control import EventStatus
from ldctoolkit.controllers import LinearMPC
from ldctoolkit.errors import UnknownNameError
from ldctoolkit.plant_options import Actuator, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.testing import CHECKS, ContractSettings, contract_faults

frozen = dataclasses.dataclass(frozen=True)
HORIZON = 8


@pytest.fixture(autouse=True)
def _nothing_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler takes longer than these tests; `test_nonlinear_mpc` has both ways give the same."""
    monkeypatch.setenv(casadi_code.CODE, "vm")


def horizon_gain() -> Any:
    return ldc.gain(HORIZON, unit="samples", lower=1, upper=100, description="horizon N")


def weight(default: float, unit: str = "1") -> Any:
    return ldc.gain(default, unit=unit, lower=0.0, upper=1e6, description="a weight or a limit")


@frozen
class Corridor(PredictiveController):
    """The formulation of the documentation."""

    name, title = "corridor", "Corridor MPC"
    horizon: int = horizon_gain()
    r: float = ldc.gain(2e4, unit="1/rad^2", lower=1.0, upper=1e6, scale="log", description="weight on steering")
    width: float = ldc.gain(0.3, unit="m", lower=0.0, upper=2.0, description="corridor at the end of the horizon")

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + x.e_psi**2 + self.r * (u.delta - lane.steady_delta) ** 2
        soft = [Soft(x.jerk, -5.0, 5.0, weight=1e3), Soft(x.e_y, upper=lane.offset + self.width, weight=1e2)]
        return Stage(cost, hard=[(u.delta, -0.1, 0.1), (u.change, -0.01, 0.01)], soft=soft)


@frozen
class Towed(PredictiveController):
    """States of its own: the wheels behind a motor, and a wind that is estimated to fade."""

    name, title = "towed", "MPC behind a motor"
    symmetric = True
    states = ("wheel", "wind")
    horizon: int = horizon_gain()
    tau: float = ldc.gain(0.1, unit="s", lower=0.01, upper=1.0, description="time constant of the motor")
    r: float = ldc.gain(500.0, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")
    smooth: float = weight(1e3, "1/rad^2")

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        rates = vehicle.nonlinear(x, x.wheel, lane)
        rates["e_y_rate"] += x.wind
        return rates | {"wheel": (u.delta - x.wheel) / self.tau, "wind": -2.0 * x.wind}

    def initial(self, x: Any, delta: Any) -> dict[str, Any]:
        return {"wind": 0.05 * x[:, 1]}

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + self.r * (u.delta - lane.steady_delta) ** 2
        cost += self.smooth * u.change**2 + 10.0 * (x.wheel - lane.steady_delta) ** 2
        hard = [(u.delta, -0.08, 0.08), (2.0 * u.change, -0.02, 0.02)]
        return Stage(cost, hard, [Soft(x.a_y, -3.0, 3.0)])


@frozen
class Quadratic(PredictiveController):
    """Linear dynamics, a quadratic cost, limits that 0 switches off: as `linear_mpc`."""

    name, title = "quadratic", "Linear-quadratic MPC"
    symmetric = True
    horizon: int = horizon_gain()
    r: float = ldc.gain(100.0, unit="1/rad^2", lower=1e-3, upper=1e6, description="weight on steering")
    angle_max: float = ldc.gain(0.1, unit="rad", lower=0.0, upper=1.0, description="limit of the steering angle")
    later: float = weight(0.0)
    change: float = weight(0.0)
    a_y_max: float = weight(0.0)
    jerk_max: float = weight(0.0)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        return vehicle.linear(x, u.delta, lane)  # type: ignore[no-any-return]

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = (1.0 + self.later * k) * x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2
        cost += self.r * (u.delta - lane.steady_delta) ** 2 + self.change * u.change**2
        limited = ((x.a_y, self.a_y_max, 1e3), (x.jerk, self.jerk_max, 1e2 * (1.0 + k)))
        return Stage(
            cost,
            hard=[(u.delta, -self.angle_max, self.angle_max * (1.0 + self.later * k)), (u.change, -0.01, 0.01)],
            soft=[Soft(value, -most, most, w) for value, most, w in limited if not self.is_zero(most)],
        )


LAWS = (Corridor, Towed, Quadratic)


def variant(base: type[PredictiveController], **members: Any) -> Any:
    """A class with other members."""
    return frozen(type(base.__name__, (base,), {"__module__": __name__, "__doc__": "Another.", **members}))


def walk(law: Any, n: int, steps: int = 8, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray, Any]]:
    """Commands, statuses and states of a law that sees a new situation at every sample."""
    rng, state, out = np.random.default_rng(seed), law.init(n), []
    delta, times = rng.uniform(-0.05, 0.05, n), law.preview_times
    for _ in range(steps):
        x = rng.normal(size=(n, 4)) * [0.6, 0.3, 0.02, 0.1]
        r = rng.normal(0, 0.05, (n, 1)) + rng.normal(0, 0.1, (n, 1)) * np.clip(times, 0.0, 0.5)
        delta, state, status = law.step(np.zeros(n), x, Preview(r, 0.0 * r), delta, state)
        out.append((delta, status, state))
    return out


def plant_of(n: int, seed: int = 0, **actuator: float) -> Plant:
    return Plant.build(BicycleModel(), np.random.default_rng(seed).uniform(7, 36, n), DT, **actuator)


# ------------------------------------------------------------------------------------------------ contract and studies


CASES = [
    pytest.param(
        law, check, marks=() if law is LAWS[0] and check not in ("extremes", "picklable") else pytest.mark.slow
    )
    for law in LAWS
    for check in CHECKS
]


@pytest.mark.parametrize(("law", "check"), CASES)
def test_a_formulation_keeps_the_contract_of_all_laws(law: Any, check: str) -> None:
    settings = ContractSettings(mirror_tolerance=1e-9)
    assert not [str(fault) for fault in contract_faults(law, checks=[check], settings=settings)]


def test_a_formulation_may_treat_the_crossed_line_in_another_way() -> None:
    """The class of the documentation in its own horizon; what says to be symmetric is checked."""
    assert not contract_faults(Corridor(horizon=20), checks=["mirror", "quiet"])
    (fault,) = contract_faults(variant(Corridor, symmetric=True)(horizon=20), checks="mirror")
    assert fault.check == "mirror"


REALISTIC = PlantOptions(
    speed="profile", actuator=Actuator(delta_max=0.2, rate_max=0.6, lag=0.08, delay=0.05),
    mismatch=Mismatch(m=(0.9, 1.1)), tyres=Tyres(model="magic_formula"), residuals=Residuals(y=True, v=True),
    sensors=Sensors(e_y_noise=0.01, curvature_noise=1e-5, delay=0.05),
)  # fmt: skip

SWEPT = {"corridor": "r", "towed": "tau", "quadratic": "angle_max"}
VALUES = {"r": [5e3, 1e4, 2e4], "tau": [0.08, 0.1, 0.15], "angle_max": [0.01, 0.015, 0.02]}


def study_of(*names: str, **counts: int) -> ldc.Study:
    designs = ({"law": name, "y_s": 0.1, "gains": {SWEPT[name]: VALUES[SWEPT[name]]}} for name in names)
    ranking = {"finalists": 0, "bootstrap": 100}
    return ldc.study("none", *designs, name="mine", plant=REALISTIC, seed=3, ranking=ranking, **counts)


@pytest.mark.slow
@pytest.mark.parametrize(("names", "each"), [(("corridor",), 4), (tuple(SWEPT), 10)])
def test_a_study_has_the_same_bits_with_workers(names: tuple[str, ...], each: int, tmp_path: Path) -> None:
    with known(*LAWS):
        study = study_of(*names, left=each, right=each)
        results = ldc.run_study(study, tmp_path / "one", workers=1)
        assert_same_results(ldc.run_study(study, tmp_path / "two", workers=2, block_size=7), results)
        ranking = ldc.rank_study(results, study)
    assert len(results.designs) == 1 + 3 * len(names)
    reduction = dict(zip(ranking.designs, ranking.metrics.reduction.tolist(), strict=True))
    assert all(0.0 < value < 1.0 for design, value in reduction.items() if design.law != "none")
    assert len({*reduction.values()}) == len(reduction)  # each gain has its own result


PROGRAM = """
import ldctoolkit as ldc
from my_laws import LAWS
from ldctoolkit.studies.running import campaign
campaign._STORE_EVERY = -1.0
designs = [{"law": law.name, "y_s": 0.1, "gains": {"r": [200.0, 1000.0, 5000.0]}} for law in LAWS]
for law in LAWS:
    ldc.register(law)
study = ldc.study("none", *designs, name="mine", left=10, right=10, ranking={"finalists": 0, "bootstrap": 100})
"""

FILE = """
import dataclasses
import ldctoolkit as ldc

WEIGHT = 1.0

@dataclasses.dataclass(frozen=True)
class Mine(ldc.PredictiveController):
    name, title, horizon = "mine", "Mine", 6
    r: float = ldc.gain(1e3, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")

    def stage(self, x, u, lane, k):
        return ldc.Stage(WEIGHT * x.e_y**2 + self.r * (u.delta - lane.steady_delta) ** 2, hard=[(u.delta, -0.1, 0.1)])

LAWS = [Mine]
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed in another way on Windows")
def test_a_killed_study_goes_on_where_it_was(tmp_path: Path) -> None:
    (tmp_path / "my_laws.py").write_text(FILE, encoding="utf-8")
    run = "ldc.run_study(study, '{}', workers=2, block_size=5)"
    compared = "\nfrom helpers.results import assert_same_results\nassert_same_results("
    compared += f"{run.format('killed')}, {run.format('whole')})"
    path = os.pathsep.join([".", *sys.path])
    codes = []
    for step, program in ((24, run.format("killed")), (21, run.format("killed")), (0, compared)):
        code = (killing(tmp_path / "killed", step) if step else "") + PROGRAM + program
        words = [sys.executable, "-c", code]
        codes.append(subprocess.run(words, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, check=False).returncode)
        if step:
            assert list((tmp_path / "killed" / "results").glob("part-*"))
    assert codes == [-signal.SIGKILL, -signal.SIGKILL, 0]


@pytest.mark.slow
def test_no_bit_depends_on_the_company() -> None:
    scenarios = make_scenarios(9)
    order = np.random.default_rng(4).permutation(9)
    for law in LAWS:
        whole = simulate(law(), scenarios, y_s=0.1, settle=0.0)
        assert_same_rows(simulate(law(), scenarios.take(order), y_s=0.1, settle=0.0), whole, rows=order)
        one = np.array([5])
        assert_same_rows(simulate(law(), scenarios.take(one), y_s=0.1, settle=0.0), whole, rows=one)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda law: pickle.loads(pickle.dumps(law))], ids=["copy", "pickle"])
def test_a_prepared_law_can_be_copied_and_sent(law: Any, copied: Callable[[Any], Any]) -> None:
    prepared = law().prepare(plant_of(5))
    for (delta, status, _), (again, status_again, _) in zip(walk(prepared, 5), walk(copied(prepared), 5), strict=True):
        np.testing.assert_array_equal(again, delta)
        np.testing.assert_array_equal(status_again, status)


# ------------------------------------------------------------------------------------------------ what is compiled


def test_a_sweep_of_numbers_compiles_nothing_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What decides the form does: whole numbers, switches, words, and whether a gain is 0."""

    @frozen
    class Swept(Quadratic):
        name = "swept"
        deep: bool = ldc.gain(False, unit="1", description="a switch")
        kind: str = ldc.option("flat", choices=("flat", "steep"), description="a word")

        def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
            stage, factor = super().stage(x, u, lane, k), 1.0 + self.deep + 2.0 * (self.kind == "steep")
            return dataclasses.replace(stage, cost=factor * stage.cost)

    monkeypatch.setenv(casadi_code.CODE, "auto")
    monkeypatch.setenv(casadi_code.CACHE, str(tmp_path))
    compiled: list[str] = []

    def compile_nothing(compiler: str, text: str, target: Path) -> None:
        compiled.append(text)
        raise OSError

    monkeypatch.setattr(casadi_code.shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(casadi_code, "_compile", compile_nothing)
    plant = plant_of(3)

    def compilations(**gains: Any) -> int:
        before = len(compiled)
        walk(Swept(horizon=2, **gains).prepare(plant), 3, steps=1)
        return len(compiled) - before

    assert compilations() == 1
    for r in (1.0, 50.0, 1e6):
        for angle_max in (0.02, 0.3):
            assert compilations(r=r, angle_max=angle_max) == 0
    assert compilations(a_y_max=2.0) == 1
    assert compilations(a_y_max=3.0, r=7.0) == 0
    assert compilations(angle_max=0.0) == 1
    assert compilations(deep=True) == 1
    assert compilations(kind="steep") == 1
    assert compilations(kind="steep", deep=True, r=3.0) == 1
    assert len({*compiled}) == len(compiled)


def test_an_edited_class_is_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Also a constant of its module, and back again."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    plant, found = plant_of(3), []
    for text in (FILE, FILE.replace("WEIGHT = 1.0", "WEIGHT = 4.0"), FILE.replace("1.0 *", "2.0 *"), FILE):
        (tmp_path / "edited_laws.py").write_text(text, encoding="utf-8")
        sys.modules.pop("edited_laws", None)
        importlib.invalidate_caches()
        law = importlib.import_module("edited_laws").Mine()
        found.append(walk(law.prepare(plant), 3, steps=1)[0][0])
    del sys.modules["edited_laws"]
    np.testing.assert_array_equal(found[3], found[0])
    assert (found[1] != found[0]).all()


def test_where_nothing_compiles_it_is_said_once(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv(casadi_code.CODE, "auto")
    monkeypatch.setattr(casadi_code.shutil, "which", lambda _: None)
    compiling.line.cache_clear()
    plant = plant_of(3)
    for horizon in (3, 4):
        assert (walk(Quadratic(horizon=horizon, r=3.0).prepare(plant), 3, steps=1)[0][1] == EventStatus.OK).all()
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "slower" in lines[0]


# ------------------------------------------------------------------------------------------------ other routes to plans


class Motor(Quadratic):
    """The linear vehicle behind a lag."""

    name, states = "motor", ("wheel",)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        return vehicle.linear(x, x.wheel, lane) | {"wheel": (u.delta - x.wheel) / 0.12}


@pytest.mark.parametrize(
    ("kind", "blocks", "actuator"),
    [
        (Quadratic, 0, {}),
        (variant(Quadratic, name="blocked", move_blocks=3), 3, {}),
        (variant(Quadratic, name="gauss_newton", hessian="gauss_newton", iterations=1), 0, {}),
        (Quadratic, 0, {"delay": 0.1, "age": 0.07}),
        (frozen(Motor), 0, {"lag": 0.12}),
    ],
    ids=["plain", "blocks", "gauss_newton", "delay_and_age", "lag"],
)
def test_a_linear_quadratic_formulation_is_linear_mpc(kind: Any, blocks: int, actuator: dict[str, float]) -> None:
    """Within 1e-9 rad, over eight samples of 40 scenarios, limits active in most."""
    plant = plant_of(40, **actuator)
    law = kind(angle_max=0.05).prepare(plant)
    other = LinearMPC(horizon=HORIZON, r_delta=100.0, delta_max=0.05, rate_max=0.2, blocks=blocks).prepare(plant)
    np.testing.assert_allclose(law.preview_times, other.preview_times)
    pairs = list(zip(walk(law, 40), walk(other, 40), strict=True))
    for (delta, status, _), (expected, expected_status, _) in pairs:
        np.testing.assert_allclose(delta, expected, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(status, expected_status)
    free = np.mean([(state.rung == 0).mean() for _, (_, _, state) in pairs])
    assert 0.02 < free < 0.5


class Wandering(Quadratic):
    """The limits of the angle move with the lane."""

    name = "wandering"

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        stage = super().stage(x, u, lane, k)
        return dataclasses.replace(stage, hard=[(u.delta - lane.steady_delta, -0.03, 0.03), stage.hard[1]])


class Winding(Quadratic):
    """The cost grows with the lane's yaw rate."""

    name = "winding"

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        stage = super().stage(x, u, lane, k)
        return dataclasses.replace(stage, cost=stage.cost * (1.0 + 100.0 * lane.yaw_rate**2))


class Torn(Quadratic):
    """A cost that is not convex: e_psi is rewarded."""

    name = "torn"

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        stage = super().stage(x, u, lane, k)
        return dataclasses.replace(stage, cost=stage.cost - 3e3 * x.e_psi**2 - 90.0 * (u.delta - x.e_psi) ** 2)

    def terminal(self, x: Any, lane: Any) -> Any:
        return x.e_y**2


class Estimated(Motor):
    """Own states, a terminal cost, Runge-Kutta, blocks."""

    name, integrator, move_blocks = "estimated", "rk4", 4

    def terminal(self, x: Any, lane: Any) -> Any:
        return 10.0 * x.e_y**2 + x.e_y * x.e_psi + 5.0 * (x.e_psi - lane.steady_e_psi) ** 2 + x.wheel**2


@pytest.mark.parametrize(
    ("kind", "gains", "at_once"),
    [
        (Quadratic, {}, True),
        (Quadratic, {"later": 1.0, "change": 100.0, "angle_max": 0.03}, True),
        (Quadratic, {"a_y_max": 2.0, "jerk_max": 5.0, "later": 0.5}, True),
        (Quadratic, {"horizon": 1, "a_y_max": 2.0}, True),
        (frozen(Estimated), {"jerk_max": 6.0}, True),
        (frozen(Wandering), {}, False),
        (frozen(Winding), {}, False),
        (frozen(Torn), {}, True),
    ],
    ids=["plain", "of_k", "soft", "one", "own", "limits_of_lane", "cost_of_lane", "not_convex"],
)
@pytest.mark.parametrize("actuator", [{}, {"delay": 0.1, "lag": 0.06, "age": 0.08}], ids=["direct", "delayed"])
def test_plans_for_all_scenarios_are_those_of_the_iteration(
    kind: Any, gains: dict[str, Any], at_once: bool, actuator: dict[str, float]
) -> None:
    """Where the lane changes the problem, and where it is not convex, the iteration itself is what runs."""
    law = kind(**gains).prepare(plant_of(15, **actuator))
    assert (law.affine is not None) == at_once
    ours, theirs = walk(law, 15, seed=2), walk(dataclasses.replace(law, affine=None), 15, seed=2)
    for (delta, status, state), (expected, expected_status, other) in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(delta, expected, rtol=0.0, atol=1e-9)
        np.testing.assert_array_equal(status, expected_status)
        np.testing.assert_array_equal(state.rung, other.rung)
        np.testing.assert_allclose(state.U, other.U, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(state.own, other.own, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(state.past, other.past, rtol=0.0, atol=1e-6)
        np.testing.assert_array_equal(state.sent.shape, other.sent.shape)


def test_a_kink_in_gains_alone_changes_no_problem() -> None:
    """With them the formulation stays one quadratic program, planned for all scenarios at once; not with one of a state
    that a gain switches on."""

    def scaled(factor: Callable[[Any, Any], Any]) -> Any:
        def stage(self: Any, x: Any, u: Any, lane: Any, k: Any) -> Stage:
            given = Quadratic.stage(self, x, u, lane, k)
            return dataclasses.replace(given, cost=given.cost + factor(self, x))

        def dynamics(self: Any, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
            given = vehicle.linear(x, u.delta, lane)
            return given | {"e_psi": given["e_psi"] * ca.fmin(self.r, 1.0)}

        return variant(Quadratic, name="scaled", stage=stage, dynamics=dynamics)().prepare(plant_of(2))

    assert scaled(lambda design, x: ca.fmax(design.r, 1e3) * x.e_psi**2).affine is not None
    assert scaled(lambda design, x: ca.if_else(design.r > 1e3, ca.fabs(x.e_y), 0.0)).affine is None


def test_ends_of_a_soft_limit_may_depend_on_the_state_or_be_infinite() -> None:
    """An end that is infinite by an expression limits nothing, whatever the other end is."""
    plans = []
    for lower in (-np.inf, ca.SX(-np.inf), lambda k: ca.if_else(k < 99, -np.inf, 0.0)):
        members = soft(lambda x, u, lane, k, low=lower: [Soft(x.e_y, low(k) if callable(low) else low, 0.1 + x.e_psi)])
        law = variant(PredictiveController, name="ends", title="T", horizon=4, **members)()
        ((delta, status, _),) = walk(law.prepare(plant_of(3)), 3, steps=1)
        assert (status == EventStatus.OK).all()
        plans.append(delta)
    np.testing.assert_allclose(plans[1:], [plans[0]] * 2, rtol=0.0, atol=1e-9)


def test_a_situation_that_is_no_number_leaves_the_others_alone() -> None:
    law, n = Quadratic().prepare(plant_of(4)), 4
    x, r = np.tile([0.3, 0.1, 0.0, 0.0], (n, 1)), np.zeros((n, HORIZON + 1))
    good, _, _ = law.step(np.zeros(n), x, Preview(r, r), np.zeros(n), law.init(n))
    x[2] = [np.nan, 0.0, np.inf, 0.0]
    delta, state, status = law.step(np.zeros(n), x, Preview(r, r), np.zeros(n), law.init(n))
    np.testing.assert_array_equal(status == EventStatus.SOLVER_FAILED, [False, False, True, False])
    np.testing.assert_array_equal(delta[[0, 1, 3]], good[[0, 1, 3]])
    assert abs(delta[2]) <= 0.01
    x[2] = 0.0
    _, _, status = law.step(np.zeros(n), x, Preview(r, r), delta, state)
    assert (status == EventStatus.OK).all()


@frozen
class Model:
    """A formulation written again, for IPOPT: rates of (e_y, e_y_rate, e_psi, e_psi_rate, trend)."""

    plant: Plant
    i: int

    def rates(self, x: Any, u: Any, r: Any) -> Any:
        A, B, E = (part[self.i] for part in self.plant.model.matrices(self.plant.v))
        lateral = A @ x[:4] + B * u + E * r
        cubed = ca.vertcat(0.0, -30.0 * x[2] ** 3 * self.plant.v[self.i], 0.0, 0.0)
        return ca.vertcat(lateral + cubed, 0.5 * x[0] - 0.3 * ca.sin(x[4]))

    def after(self, x: Any, u: Any, r_0: Any, r_1: Any) -> Any:
        mid = 0.5 * (r_0 + r_1)
        k_1 = self.rates(x, u, r_0)
        k_2 = self.rates(x + 0.5 * DT * k_1, u, mid)
        k_3 = self.rates(x + 0.5 * DT * k_2, u, mid)
        return x + DT / 6.0 * (k_1 + 2 * k_2 + 2 * k_3 + self.rates(x + DT * k_3, u, r_1))


@frozen
class Trend(PredictiveController):
    """Nonlinear dynamics with a state, Runge-Kutta, a cost and limits that depend on the sample."""

    name, title, states, integrator = "trend", "MPC with a trend", ("trend",), "rk4"
    horizon: int = horizon_gain()
    r: float = ldc.gain(50.0, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")
    tight: float = weight(0.02)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        rates = vehicle.linear(x, u.delta, lane)
        rates["e_y_rate"] -= 30.0 * x.e_psi**3 * vehicle.v
        return rates | {"trend": 0.5 * x.e_y - 0.3 * ca.sin(x.trend)}

    def initial(self, x: Any, delta: Any) -> dict[str, Any]:
        return {"trend": 0.1 * x[:, 0] + delta}

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = (1.0 + 0.2 * k) * x.e_y**2 + x.e_psi**2 + 3.0 * x.trend**2 + self.r * u.delta**2 + 400.0 * u.change**2
        return Stage(
            cost + 20.0 * x.wheel**2, hard=[(u.delta, -self.tight - 0.002 * k, 0.05), (u.change, -0.01, 0.012)]
        )

    def terminal(self, x: Any, lane: Any) -> Any:
        return 12.0 * x.e_y**2 + 2.0 * x.trend**4 + (x.e_psi + 0.1 * lane.yaw_rate) ** 2


def test_ipopt_finds_the_same_plan_with_states_of_its_own() -> None:
    """Commands within 1e-6 rad, the cost within 1e-6; with either Hessian."""
    n = 6
    plant, x, preview, prev = mpc_situations(n, HORIZON, seed=8, size=0.5)
    prev = np.clip(prev, -0.02, 0.02)
    law = Trend().prepare(plant)
    _, state, status = law.step(np.zeros(n), x, preview, prev, law.init(n))
    assert (status == EventStatus.OK).all()
    fast = variant(Trend, name="trend_gauss", hessian="gauss_newton")().prepare(plant)
    _, by_gauss_newton, _ = fast.step(np.zeros(n), x, preview, prev, fast.init(n))
    np.testing.assert_allclose(by_gauss_newton.U, state.U, atol=1e-6)
    bound = 0
    for i in range(n):
        model, opti, r = Model(plant, i), ca.Opti(), preview.yaw_rate[i]
        U, cost = opti.variable(HORIZON), 0.0
        z: Any = ca.vertcat(*x[i], 0.1 * x[i, 0] + prev[i])
        before: Any = prev[i]
        for k in range(HORIZON):
            cost += (1.0 + 0.2 * k) * z[0] ** 2 + z[2] ** 2 + 3.0 * z[4] ** 2 + 50.0 * U[k] ** 2
            cost += 400.0 * (U[k] - before) ** 2 + 20.0 * before**2
            opti.subject_to(opti.bounded(-0.02 - 0.002 * k, U[k], 0.05))
            opti.subject_to(opti.bounded(-0.01, U[k] - before, 0.012))
            z, before = model.after(z, U[k], r[k], r[k + 1]), U[k]
        cost += 12.0 * z[0] ** 2 + 2.0 * z[4] ** 4 + (z[2] + 0.1 * r[HORIZON]) ** 2
        opti.minimize(cost)
        quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-11}
        opti.solver("ipopt", quiet | {"ipopt.bound_relax_factor": 0.0})
        solution = opti.solve()
        plan = np.asarray(solution.value(U))
        np.testing.assert_allclose(state.U[i], plan, atol=1e-6)
        assert state.cost[i] == pytest.approx(float(solution.value(cost)), rel=1e-6)
        change = np.diff(plan, prepend=prev[i])
        bound += min(change.min() + 0.01, 0.012 - change.max(), 0.05 - plan.max()) < 1e-6
    assert bound >= 2


@pytest.mark.parametrize("integrator", ["exponential", "rk4"])
def test_a_rate_that_is_a_step_moves_its_state(integrator: str) -> None:
    """0.25 m left of the lane's middle: its slopes are 0 everywhere, the rate is not."""

    def counting(self: Any, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        rates = vehicle.linear(x, u.delta, lane)
        return rates | {"outside": ca.if_else(x.e_y > 0.1, 3.0, 0.0), "side": ca.sign(x.e_y), "way": x.e_y}

    members = {"name": "counting", "states": ("outside", "side", "way"), "integrator": integrator}
    law = variant(Quadratic, dynamics=counting, **members)().prepare(plant_of(1))
    x, r = np.array([[0.25, 0.0, 0.0, 0.0]]), np.zeros((1, HORIZON + 1))
    _, state, _ = law.step(np.zeros(1), x, Preview(r, r), np.zeros(1), law.init(1))
    np.testing.assert_allclose(state.own[0, :2], [3.0 * DT, DT], rtol=1e-12)
    np.testing.assert_allclose(state.own[0, 2], 0.25 * DT, rtol=1e-2)


@pytest.mark.parametrize(("integrator", "order", "most"), [("exponential", 3, 2e-4), ("rk4", 4, 2e-3)])
def test_a_sample_follows_the_differential_equation(integrator: str, order: int, most: float) -> None:
    """`solve_ivp` at 1e-11; halving the sample divides its error by 2^(order + 1), three quarters of that is asked."""
    law, errors = variant(Trend, name=integrator, integrator=integrator), []
    z_0, u, r_0, r_1 = np.array([0.4, 0.3, 0.1, -0.05, 1.2]), 0.03, 0.05, 0.07
    for dt in (0.04, 0.02):
        plant = Plant.build(BicycleModel(), [25.0], dt)
        prepared, model = law().prepare(plant), Model(plant, 0)
        predict = prepared.form.program(HORIZON).predict
        p = [r_0, r_1, *[0.0] * (prepared.form.samples - 2)]
        end = np.asarray(predict([*z_0, 0.0], u, p, prepared.columns[0])[0]).ravel()[:5]
        flow = scipy.integrate.solve_ivp(
            lambda t, z, dt=dt, model=model: np.asarray(
                ca.DM(model.rates(ca.DM(z), u, r_0 + (r_1 - r_0) * t / dt))
            ).ravel(),
            (0, dt), z_0, method="Radau", rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        errors.append(np.abs(end - flow.y[:, -1]).max())
    assert errors[0] < most
    assert errors[0] / errors[1] > 0.75 * 2 ** (order + 1)


def test_a_few_iterations_a_sample_come_to_the_same_plan() -> None:
    """A situation that stays: the plan of each sample starts from the last; every one meets the limits."""
    n = 6
    plant, x, preview, prev = mpc_situations(n, HORIZON, seed=8, size=0.5)
    prev = np.clip(prev, -0.02, 0.02)
    exact = Trend().prepare(plant)
    wanted = exact.step(np.zeros(n), x, preview, prev, exact.init(n))[1].U
    until_converged = variant(Trend, name="until_converged", iterations=0)().prepare(plant)
    same = until_converged.step(np.zeros(n), x, preview, prev, until_converged.init(n))[1].U
    np.testing.assert_array_equal(same, wanted)  # the default is the word
    for iterations in (1, 2, 3):
        law = variant(Trend, name=f"few_{iterations}", iterations=iterations)().prepare(plant)
        state, errors = law.init(n), []
        for _ in range(5):
            _, state, status = law.step(
                np.zeros(n), x, preview, prev, dataclasses.replace(state, own=np.full((n, 1), np.nan))
            )
            assert (status == EventStatus.OK).all()
            assert (state.iterations <= iterations).all()
            assert (np.abs(np.diff(state.U, axis=1, prepend=prev[:, None])) <= 0.012 + 1e-9).all()
            errors.append(np.abs(state.U[:, 0] - wanted[:, 0]).max())
        assert errors[-1] < 1e-4


# ------------------------------------------------------------------------------------------------ edges and faults


@pytest.mark.parametrize("law", LAWS)
def test_speeds_at_the_ends_of_their_range_and_no_scenario(law: Any) -> None:
    plant = Plant.build(BicycleModel(), [1.0, 90.0], DT)
    for design in (law(), law(horizon=1)):
        for delta, status, _ in walk(design.prepare(plant), 2, steps=3):
            assert (np.abs(delta) <= 0.1).all()
            assert law is not Quadratic or (status != EventStatus.SOLVER_FAILED).all()
        ((delta, _, _),) = walk(design.prepare(Plant.build(BicycleModel(), [], DT)), 0, steps=1)
        assert delta.shape == (0,)


def test_limits_that_a_gain_of_0_closes_leave_one_command() -> None:
    for delta, _, _ in walk(Quadratic(angle_max=0.0).prepare(plant_of(3)), 3, steps=12)[8:]:
        np.testing.assert_array_equal(delta, 0.0)


def test_a_state_that_no_cost_sees_may_drift() -> None:
    """It changes no command; without it the law is the same."""

    def drifting(self: Any, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        return vehicle.linear(x, u.delta, lane) | {"way": x.e_y}

    law = variant(Quadratic, name="drifting", states=("way",), dynamics=drifting)
    for (delta, _, _), (expected, _, _) in zip(
        walk(law().prepare(plant_of(5)), 5), walk(Quadratic().prepare(plant_of(5)), 5), strict=True
    ):
        np.testing.assert_allclose(delta, expected, rtol=0.0, atol=1e-9)


def cost(x: Any, u: Any) -> Any:
    return x.e_y**2 + 1e3 * u.delta**2


def staged(function: Callable[..., Any]) -> dict[str, Any]:
    """Members of a class: a stage of the cost (self, x, u, lane, k) alone."""
    return {"stage": lambda self, x, u, lane, k: Stage(function(self, x, u, lane, k), hard=[(u.delta, -0.1, 0.1)])}


def hard(function: Callable[..., Any]) -> dict[str, Any]:
    return {"stage": lambda self, x, u, lane, k: Stage(cost(x, u), hard=function(x, u, k))}


def soft(function: Callable[..., Any]) -> dict[str, Any]:
    return {"stage": lambda self, x, u, lane, k: Stage(cost(x, u), soft=function(x, u, lane, k))}


def moved_by(**rates: Any) -> dict[str, Any]:
    """Dynamics with other rates, each a function (x, u, vehicle), or left out."""

    def dynamics(self: Any, x: Any, u: Any, lane: Any, vehicle: Any) -> dict[str, Any]:
        given = vehicle.nonlinear(x, u.delta, lane)
        given |= {name: rate(x, u, vehicle) for name, rate in rates.items() if rate}
        return {name: value for name, value in given.items() if rates.get(name, True)}

    return {"dynamics": dynamics}


def towing(**members: Any) -> dict[str, Any]:
    return {"states": ("hitch",), **moved_by(hitch=lambda x, u, vehicle: -x.hitch)} | members


SMOOTH = "write ca.sqrt(x**2 + 1e-6) for abs(x)"
NO_TERMINAL = "let the cost weigh x.e_y and u.delta or u.change near straight driving, or define terminal()"

FAULTS: dict[str, tuple[dict[str, Any], str, dict[str, Any]]] = {
    "nothing returned": ({"stage": lambda *_: None}, "stage", {"allowed": "a Stage"}),
    "no scalar": (staged(lambda s, x, u, lane, k: ca.vertcat(x.e_y, u.delta)), "stage.cost", {}),
    "no number": (staged(lambda *_: "e_y"), "stage.cost", {}),
    "another kind of symbol": (staged(lambda *_: ca.MX.sym("w")), "stage.cost", {}),
    "a free symbol": (staged(lambda s, x, u, lane, k: ca.SX.sym("w") * cost(x, u)), "stage.cost", {}),
    "float() of a symbol": (staged(lambda s, x, u, lane, k: float(x.e_y) + cost(x, u)), "stage.cost", {}),
    "jerk in the cost": (staged(lambda s, x, u, lane, k: x.jerk**2 + cost(x, u)), "stage.cost", {}),
    "an unknown state": (staged(lambda s, x, u, lane, k: x.ey**2), "x.ey", {"kind": UnknownNameError}),
    "an unknown command": (
        staged(lambda s, x, u, lane, k: u.angle), "u.angle", {"kind": UnknownNameError, "allowed": {"delta", "change"}},
    ),
    "an unknown number of the lane": (
        staged(lambda s, x, u, lane, k: lane.curve), "lane.curve", {"kind": UnknownNameError, "allowed": {"curvature"}},
    ),
    "an unknown gain": (staged(lambda s, *_: s.weight), "weight", {"kind": UnknownNameError}),
    "an unknown part of the vehicle": (
        moved_by(e_y=lambda x, u, vehicle: vehicle.mass), "vehicle.mass", {"kind": UnknownNameError, "allowed": {"m"}},
    ),
    "no derivative": (staged(lambda s, x, u, lane, k: ca.log(x.e_y) + cost(x, u)), "stage", {}),
    "no derivative of a rate": (moved_by(e_psi=lambda x, u, vehicle: ca.sqrt(x.e_psi)), "dynamics", {}),
    "if on a symbol": (staged(lambda s, x, u, lane, k: cost(x, u) if k > 3 else 0.0), "stage", {}),
    "an error of its own": (staged(lambda *_: {}["missing"]), "stage", {}),
    "no use of steering": (staged(lambda s, x, u, lane, k: x.e_y**2), "stage", {"hint": NO_TERMINAL}),
    "hard limits of a state": (hard(lambda x, u, k: [(x.e_y, -1.0, 1.0)]), "stage.hard[0]", {}),
    "hard limits of two things": (hard(lambda x, u, k: [(u.delta + u.change, -1.0, 1.0)]), "stage.hard[0]", {}),
    "a hard limit that is no tuple": (hard(lambda x, u, k: (u.delta, -1.0, 1.0)), "stage.hard[0]", {}),
    "no list of hard limits": (hard(lambda x, u, k: None), "stage.hard", {"allowed": "a list"}),
    "an end that is no number": (hard(lambda x, u, k: [(u.delta, -1.0, np.nan)]), "stage.hard[0][2]", {}),
    "infeasible limits": (
        hard(lambda x, u, k: [(u.delta, 0.1, 0.2), (u.delta, -0.2, 0.0)]), "stage.hard",
        {"value": "0.1 to 0 rad at k = 0", "allowed": "limits of u.delta, low <= 0 <= high"},
    ),
    "no straight driving": (
        hard(lambda x, u, k: [(u.delta, 0.01, 0.1)]), "stage.hard", {"value": "0.01 to 0.1 rad at k = 0"},
    ),
    "infeasible later": (
        hard(lambda x, u, k: [(u.change, -0.1, 0.1 - 0.05 * k)]), "stage.hard",
        {"value": "-0.1 to -0.05 rad at k = 3", "allowed": "limits of u.change, low <= 0 <= high"},
    ),
    "crossed soft limits": (
        soft(lambda x, u, lane, k: [Soft(x.a_y, upper=x.e_y), Soft(x.e_y, 1.0, -1.0)]), "stage.soft[1]",
        {"value": "1 to -1 at k = 1", "allowed": "lower <= upper"},
    ),
    "a weight of 0": (
        soft(lambda x, u, lane, k: [Soft(x.e_y, -1.0, 1.0), Soft(x.jerk, -1.0, 1.0, weight=0.0)]),
        "stage.soft[1].weight", {"value": "0 at k = 0", "allowed": "a number > 0"},
    ),
    "a weight of 0 in the middle": (
        soft(lambda x, u, lane, k: [Soft(x.e_y, -1.0, 1.0, weight=(k - 2) ** 2)]), "stage.soft[0].weight",
        {"value": "0 at k = 2"},
    ),
    "a soft limit without an end": (soft(lambda x, u, lane, k: [Soft(x.a_y)]), "stage.soft[0]", {}),
    "a soft limit with None at both ends": (
        soft(lambda x, u, lane, k: [Soft(x.a_y, None, 1.0), Soft(x.jerk, None, None)]), "stage.soft[1]", {},
    ),
    "an absolute value": (staged(lambda s, x, u, lane, k: abs(x.e_psi) + cost(x, u)), "stage.cost", {"hint": SMOOTH}),
    "a root of a square": (
        staged(lambda s, x, u, lane, k: 1e-3 * ca.sqrt(x.e_y**2) + cost(x, u)), "stage.cost", {"hint": SMOOTH},
    ),
    "a kink later": (
        staged(lambda s, x, u, lane, k: ca.if_else(k > 3, ca.fmax(u.change, 0.0), 0.0) + cost(x, u)), "stage.cost", {},
    ),
    "a kink at the end": (
        {"terminal": lambda self, x, lane: x.e_y**2 + ca.fabs(x.e_psi)}, "terminal", {"hint": SMOOTH},
    ),
    "another signature": (
        {"stage": lambda self, x, u, lane: Stage(cost(x, u))}, "stage",
        {"hint": "its arguments are self, x, u, lane, k"},
    ),
    "a rate of the command": (
        staged(lambda s, x, u, lane, k: u.rate**2), "u.rate",
        {"kind": UnknownNameError, "hint": "the rate of a command is u.change / lane.dt"},
    ),
    "a weight of the state": (
        soft(lambda x, u, lane, k: [Soft(x.e_y, -1.0, 1.0, weight=x.e_y)]), "stage.soft[0].weight", {},
    ),
    "one soft limit": (soft(lambda x, u, lane, k: Soft(x.e_y, -1.0, 1.0)), "stage.soft", {"allowed": "a list"}),
    "a square of jerk": (soft(lambda x, u, lane, k: [Soft(x.jerk**2, 0.0, 9.0)]), "stage.soft[0]", {}),
    "a state twice": ({"states": ("hitch", "hitch")}, "states", {"value": "hitch"}),
    "a state of the vehicle": ({"states": ("e_psi",)}, "states", {"value": "e_psi"}),
    "states in a text": ({"states": "hitch"}, "states", {"value": "hitch", "allowed": "a tuple of names"}),
    "no rate of a state": (
        {"states": ("hitch",)}, "dynamics['hitch']", {"allowed": "rates of e_y, e_y_rate, e_psi, e_psi_rate, hitch"},
    ),
    "no rate of the vehicle's": (moved_by(e_psi=None), "dynamics['e_psi']", {}),
    "a rate of no state": (
        moved_by(hitch=lambda x, u, vehicle: 0.0), "dynamics.hitch", {"kind": UnknownNameError},
    ),
    "no rates": ({"dynamics": lambda *_: None}, "dynamics", {"allowed": "a dictionary of rates by state"}),
    "a terminal cost of a command": (
        {"terminal": lambda self, x, lane: x.delta}, "x.delta", {"kind": UnknownNameError, "allowed": {"wheel"}},
    ),
    "a terminal cost that is no number": ({"terminal": lambda self, x, lane: "x"}, "terminal", {}),
    "a first value of no state": (towing(initial=lambda self, x, delta: {"trailer": 0.0}), "initial", {}),
    "first values in a list": (towing(initial=lambda self, x, delta: [0.0]), "initial", {"value": [0.0]}),
    "too many first values": (towing(initial=lambda self, x, delta: {"hitch": [0.0] * 9}), "initial['hitch']", {}),
    "a first value that is none": (
        towing(initial=lambda self, x, delta: {"hitch": np.nan}), "initial['hitch']", {"allowed": "finite numbers"},
    ),
    "a first value that fails": (towing(initial=lambda self, x, delta: x.front), "initial", {}),
    "no horizon": ({"horizon": 0}, "horizon", {"value": 0}),
    "a horizon that is a switch": ({"horizon": True}, "horizon", {"value": True}),
    "a horizon too long": ({"horizon": 9000}, "horizon", {"value": 9000}),
    "moves below 0": ({"move_blocks": -1}, "move_blocks", {"value": -1}),
    "iterations in words": ({"iterations": "many"}, "iterations", {"value": "many"}),
    "a word for the number of moves": ({"move_blocks": "converged"}, "move_blocks", {"value": "converged"}),
    "another integrator": ({"integrator": "euler"}, "integrator", {"value": "euler", "allowed": {"rk4"}}),
    "another Hessian": ({"hessian": "bfgs"}, "hessian", {"value": "bfgs", "allowed": {"exact", "gauss_newton"}}),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_formulation_is_one_sentence(fault: str) -> None:
    members, path, fields = FAULTS[fault]
    law = variant(
        PredictiveController,
        **({"name": "faulty", "title": "T", "horizon": 6} | staged(lambda s, x, u, *_: cost(x, u)) | members),
    )
    with refused(f"faulty.{path}", **fields):
        walk(law().prepare(plant_of(3)), 3, steps=1)


def test_smooth_costs_and_open_ends_are_taken() -> None:
    """Kinks of the slope alone, a rate of the command, the speed: the same commands as with the numbers written out."""
    v = 20.0

    def law(change: Any, low: Any, high: Any, speed: Any) -> Any:
        def stage(self: Any, x: Any, u: Any, lane: Any, k: Any) -> Stage:
            smooth = ca.sqrt(x.e_y**2 + 1e-6) + ca.fmax(x.e_y, 0.0) ** 2
            soft = [Soft(x.a_y, low, 2.0 - speed(lane) ** 2 * lane.curvature)]
            return Stage(smooth + cost(x, u), [(u.delta, low, 0.03), (change(u, lane), -0.1, high)], soft)

        return variant(PredictiveController, name="open", title="T", horizon=6, stage=stage)

    plant = Plant.build(BicycleModel(), np.full(5, v), DT)
    laws = (
        law(lambda u, lane: u.change / lane.dt, None, None, lambda lane: lane.v),
        law(lambda u, lane: -u.change / -DT, -np.inf, np.inf, lambda lane: v),
    )
    walks = (walk(law().prepare(plant), 5) for law in laws)
    for (delta, status, _), (expected, _, _) in zip(*walks, strict=True):
        np.testing.assert_allclose(delta, expected, atol=1e-9)
        assert (status != EventStatus.SOLVER_FAILED).all()


def test_a_class_that_is_no_design_is_refused() -> None:
    stage = staged(lambda s, x, u, *_: cost(x, u))
    for name, meant in (("itertions", "iterations"), ("dynamic", "dynamics"), ("move_block", "move_blocks")):
        with refused(f"PredictiveController.{name}", hint=f"did you mean {meant!r}?"):
            variant(PredictiveController, name="plain", title="T", horizon=6, **stage, **{name: 2})()
    plain = type("Plain", (PredictiveController,), {"name": "plain", "title": "T", "horizon": 6, **stage})
    with refused("Plain"):
        plain().prepare(plant_of(1))
    for name in ("terminal", "initial", "prepare"):
        taken = {
            "__annotations__": {name: float},
            name: weight(1.0),
            "name": "taken",
            "title": "T",
            "horizon": 6,
            **stage,
        }
        with refused(f"Taken.{name}"):
            frozen(type("Taken", (PredictiveController,), taken))()


def test_functions_of_numpy_take_symbols() -> None:
    law = variant(PredictiveController, name="numpy", title="T", horizon=6, **staged(
        lambda s, x, u, *_: np.sin(x.e_y) ** 2 + np.float64(1e3) * np.square(u.delta) + np.maximum(x.e_y, 1.0) ** 2
    ))  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # CasADi's, of its next version
        ((_, status, _),) = walk(law().prepare(plant_of(5)), 5, steps=1)
    assert (status == EventStatus.OK).all()
