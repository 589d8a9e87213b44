"""Controllers from `casadi.Opti` problems: the same numbers as the class, whoever solves them, and named faults."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.bits import assert_same_bits
from helpers.closed_loop import mpc_situations
from helpers.errors import refused
from ldctoolkit import EventStatus, Preview, Scenarios, registry, simulate
from ldctoolkit.code_content import content_of
from ldctoolkit.controllers.riccati import regulator
from ldctoolkit.errors import UnknownNameError
from ldctoolkit.testing import CHECKS, ContractSettings, contract_faults

SCENARIOS = Scenarios.from_arrays(
    side=[1, -1, 1, 1, -1], T=[2.5, 1.6, 4.0, 3.0, 2.0], d_y=[0.4, 0.7, 0.6, 0.9, 0.3],
    v_mean=[11.0, 18.0, 27.0, 36.0, 24.0], c_0=[1e-3, -2e-3, 0.0, 5e-4, 0.0],
)  # fmt: skip


@ldc.from_opti
def plain_mpc(opti, x, lane, delta_prev, vehicle, horizon=12, r=2e3, delta_max=0.1, rate_max=0.2):  # type: ignore[no-untyped-def]
    X, U = opti.variable(4, horizon + 1), opti.variable(horizon)
    opti.subject_to(X[:, 0] == x)
    cost = 0
    for k in range(horizon):
        change = U[k] - (U[k - 1] if k else delta_prev)
        opti.subject_to(X[:, k + 1] == vehicle.sample(X[:, k], U[k], k))
        opti.subject_to(opti.bounded(-delta_max, U[k], delta_max))
        opti.subject_to(opti.bounded(-rate_max * lane.dt, change, rate_max * lane.dt))
        cost += X[0, k] ** 2 + (X[2, k] - lane.steady_e_psi[k]) ** 2 + r * (U[k] - lane.steady_delta[k]) ** 2
    off = X[:, horizon] - ca.vertcat(0, 0, lane.steady_e_psi[horizon], 0)
    opti.minimize(cost + off.T @ vehicle.riccati((1, 0, 1, 0), r) @ off)
    return U


@dataclasses.dataclass(frozen=True)
class Same(ldc.PredictiveController):
    name, title = "same", "The same formulation"
    horizon: int = ldc.gain(12, unit="samples", lower=1, upper=100, description="horizon")
    r: float = ldc.gain(2e3, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> ldc.Stage:
        cost = x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + self.r * (u.delta - lane.steady_delta) ** 2
        return ldc.Stage(cost, hard=[(u.delta, -0.1, 0.1), (u.change, -0.2 * lane.dt, 0.2 * lane.dt)])


BEHIND = ldc.PlantOptions(actuator=ldc.Actuator(lag=0.05, delay=0.08), sensors=ldc.Sensors(delay=0.1, e_y_noise=0.01))


@pytest.mark.parametrize(
    ("solver", "options", "weights"),
    [
        ("ipopt", ldc.PlantOptions(), (2e3, 50.0)),
        ("sqpmethod", BEHIND, (2e4,)),
        pytest.param("ipopt", BEHIND, (2e3, 200.0), marks=pytest.mark.slow),
        pytest.param("fatrop", BEHIND, (2e3, 200.0), marks=pytest.mark.slow),
    ],
)
def test_the_class_of_the_same_formulation_has_the_same_scores(
    solver: str, options: ldc.PlantOptions, weights: tuple[float, ...]
) -> None:
    """S within 1e-6; with the smallest weight the limit of the rate is reached."""
    kind: Any = plain_mpc
    for r in weights:
        given = {"y_s": 0.1, "options": options, "settle": 0.0, "trajectories": True}
        ours, same = simulate(kind(solver=solver, r=r), SCENARIOS, **given), simulate(Same(r=r), SCENARIOS, **given)
        np.testing.assert_allclose(ours.S, same.S, rtol=1e-6)
        assert not ours.failed_solves.any()
        assert r > 50.0 or np.nanmax(np.abs(np.diff(ours.trajectories.delta, axis=1))) > 0.01 - 1e-8
        assert (ours.solver_log.iterations > 0).all()


def test_neighbours_change_no_bit() -> None:
    for solver in ("ipopt", "fatrop", "sqpmethod"):
        kind: Any = plain_mpc
        design = kind(solver=solver, horizon=5)
        plant, x, preview, prev = mpc_situations(3, 5, seed=3, size=0.5)
        together = design.prepare(plant)
        alone = design.prepare(dataclasses.replace(plant, v=plant.v[1:2]))
        states = [together.init(3), alone.init(1)]
        for _ in range(3):
            both, states[0], _ = together.step(np.zeros(3), x, preview, prev, states[0])
            one = Preview(preview.yaw_rate[1:2], preview.heading[1:2])
            single, states[1], _ = alone.step(np.zeros(1), x[1:2], one, prev[1:2], states[1])
            assert_same_bits(single, both[1:2])
            x, prev = x * 0.9, both


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "checks"),
    [
        ({"solver": "sqpmethod", "horizon": 6, "r": 2e4}, {*CHECKS} - {"extremes"}),
        ({"solver": "ipopt", "horizon": 4}, {"mirror", "batch", "take", "state"}),
    ],
    ids=["sqpmethod", "ipopt"],
)
def test_the_contract(given: dict[str, Any], checks: set[str], monkeypatch: pytest.MonkeyPatch) -> None:
    kind: Any = plain_mpc
    monkeypatch.setattr(kind, "symmetric", True)  # this one is
    settings = ContractSettings(mirror_tolerance=1e-9)
    assert not [str(fault) for fault in contract_faults(kind(**given), checks=sorted(checks), settings=settings)]


@pytest.mark.slow
def test_a_sweep_of_gains_and_solvers_in_a_study(tmp_path: Path) -> None:
    """Two workers, started afresh; as good as the class, which comes with the same gains."""
    swept = {"law": "plain_mpc", "gains": {"r": [500.0, 5e4], "solver": ["fatrop", "ipopt"]}}
    same = {"law": "same", "gains": {"r": [500.0, 5e4]}}
    ldc.register(plain_mpc)
    ldc.register(Same)
    try:
        study = ldc.study(ldc.NoControl, swept, same, name="opti", left=4, right=4, y_s=[0.15])
        results = ldc.run_study(study, directory=tmp_path / "out", workers=2)
        ranking = ldc.rank_study(results, study)
    finally:
        for name in ("plain_mpc", "same"):
            registry.forget(name)
    assert len(ranking.designs) == 7
    for r in (500.0, 5e4):
        designs = zip(ranking.designs, ranking.metrics.S, strict=True)
        scores = [score for design, score in designs if dict(design.gains).get("r") == r]
        assert len(scores) == 3
        np.testing.assert_allclose(scores, scores[0], rtol=1e-6)


def first(design: Any, n: int, **changed: Any) -> tuple[np.ndarray, Any, np.ndarray, Any, tuple[Any, ...]]:
    plant, x, preview, prev = mpc_situations(n, design.horizon, seed=3, size=0.5)
    prev = changed.get("prev", np.clip(prev, -0.04, 0.04))
    law = design.prepare(plant)
    delta, state, status = law.step(np.zeros(n), x, preview, prev, law.init(n))
    return delta, state, status, law, (plant, x, preview, prev)


def test_where_the_solver_fails_the_lqr_steers_inside_the_limits() -> None:
    """Of the weights that the problem's LQR has; every failure is counted, and the step after starts afresh."""
    build: Any = plain_mpc
    lame = ldc.from_opti(build.build, options={"ipopt.max_iter": 0})
    design: Any = lame(r=100.0, delta_max=0.04)  # type: ignore[call-arg]
    delta, state, status, law, (plant, x, preview, prev) = first(design, 8)
    assert (status == EventStatus.SOLVER_FAILED).all()
    K = regulator(plant, (1.0, 0.0, 1.0, 0.0), 100.0).K
    samples = law.samples(preview.yaw_rate)[:, 0]
    wanted = samples[:, 3] - (K * (x - samples[:, 4:8])).sum(axis=1)
    np.testing.assert_allclose(delta, prev + np.clip(np.clip(wanted, -0.04, 0.04) - prev, -0.01, 0.01), atol=1e-12)
    assert not state.has_plan.any()
    out = simulate(design, SCENARIOS, y_s=0.1, settle=0.0)
    assert (out.failed_solves > 0).all()
    assert (out.status == EventStatus.SOLVER_FAILED).all()


def test_limits_that_are_no_gains_hold_for_the_fallback_alone() -> None:
    def wide(opti: Any, x: Any, delta_prev: Any, vehicle: Any, horizon: int = 6, wanted: float = 0.3) -> Any:
        U = opti.variable(horizon)
        opti.minimize(ca.sumsqr(U - wanted) + ca.sumsqr(0 * x) + 0 * delta_prev + 0 * vehicle.v)
        return [U[k] for k in range(horizon)]

    for solver, options, expected in (("ipopt", {}, 0.3), ("sqpmethod", {"max_iter": 0}, None)):
        kind: Any = ldc.from_opti(wide, solver=solver, options=options)
        delta, _, status, _, (*_, prev) = first(kind(), 4)
        if expected:
            np.testing.assert_allclose(delta, expected, atol=1e-7)
            assert (status == EventStatus.OK).all()
        else:
            assert (np.abs(delta - prev) <= 0.2 * 0.05 + 1e-12).all()
            assert (status == EventStatus.SOLVER_FAILED).all()


def test_a_limit_that_is_a_gain_holds_without_the_other() -> None:
    """The problem wants 0.3 rad at once, from 0.02 rad."""

    def angle(opti: Any, horizon: int = 4, delta_max: float = 0.05) -> Any:
        U = opti.variable(horizon)
        opti.minimize(ca.sumsqr(U - 0.3))
        return U

    def rate(opti: Any, horizon: int = 4, rate_max: float = 0.6) -> Any:
        return angle(opti, horizon)

    for build, expected in ((angle, 0.05), (rate, 0.02 + 0.6 * 0.05)):
        kind: Any = ldc.from_opti(build)
        delta, _, status, *_ = first(kind(), 2, prev=np.full(2, 0.02))
        np.testing.assert_allclose(delta, expected, rtol=1e-12)
        assert (status == EventStatus.OK).all()


def test_states_that_no_vehicle_has_give_finite_commands() -> None:
    kind: Any = plain_mpc
    design = kind(horizon=6, solver="sqpmethod")
    plant, x, preview, prev = mpc_situations(3, 6, seed=1)
    law = design.prepare(plant)
    wild = np.array([[np.nan, 0, 0, 0], [1e6, 0, 3.0, 0], [0, 1e200, 0, 0]])
    delta, state, status = law.step(np.zeros(3), wild, preview, prev, law.init(3))
    assert (np.isfinite(delta) & (np.abs(delta - prev) <= 0.01 + 1e-12)).all()
    assert status[0] == EventStatus.SOLVER_FAILED
    again, _, status = law.step(np.zeros(3), x, preview, prev, state)
    assert (status == EventStatus.OK).all()
    np.testing.assert_allclose(again, law.step(np.zeros(3), x, preview, prev, law.init(3))[0], atol=1e-7)


def test_gains_are_parameters_of_one_problem_and_declared_as_any() -> None:
    weight: Any = ldc.gain(10.0, unit="1", lower=0.0, upper=50.0, description="weight")

    @ldc.from_opti
    def swept(opti, x, vehicle, horizon=5, r=weight, ends: bool = True):  # type: ignore[no-untyped-def]
        U = opti.variable(horizon)
        built.append((horizon, ends))
        target = opti.parameter()
        opti.set_value(target, 0.02)
        opti.minimize(ca.sumsqr(U - target) + r * U[0] ** 2 * (1 if ends else 0) + 0 * x[0] + 0 * vehicle.v)
        return U

    built: list[Any] = []
    kind: Any = swept
    assert [(gain.name, gain.unit, gain.upper) for gain in kind.gains()][2] == ("r", "1", 50.0)
    with refused("swept.r", value=60.0):
        kind(r=60.0)
    for r in (0.0, 1.0, 3.0):
        np.testing.assert_allclose(first(kind(r=r), 2)[0], 0.02 / (1 + r), atol=1e-7)
    np.testing.assert_allclose(first(kind(r=3.0, ends=False), 2)[0], 0.02, atol=1e-7)
    assert built == [(5, True), (5, False)]


def test_its_content_is_that_of_its_function() -> None:
    def problem(target: float) -> Any:
        def build(opti, horizon=3):  # type: ignore[no-untyped-def]
            U = opti.variable(horizon)
            opti.minimize(ca.sumsqr(U - target))
            return U

        return ldc.from_opti(build)

    first, other, again = (content_of(problem(target)) for target in (0.01, 0.02, 0.01))
    assert first == again not in ("", other)


def commands(opti: Any, horizon: int = 3) -> Any:
    U = opti.variable(horizon)
    opti.minimize(ca.sumsqr(U))
    return U


def test_faults_are_named() -> None:
    def prepared(build: Any, **given: Any) -> Any:
        return first(ldc.from_opti(build, **given)(), 1)

    with refused("commands.solver", value="ipop", allowed={"ipopt", "fatrop", "sqpmethod"}):
        prepared(commands, solver="ipop")

    def nothing(opti: Any, horizon: int = 3) -> None:
        commands(opti, horizon)

    def too_few(opti: Any, horizon: int = 3) -> Any:
        return commands(opti, horizon)[:2]

    def solves(opti: Any, horizon: int = 3) -> Any:
        opti.solver("ipopt")

    def free(opti: Any, horizon: int = 3) -> Any:
        U = commands(opti, horizon)
        opti.minimize(ca.sumsqr(U - opti.parameter()))
        return U

    def outside(opti: Any, horizon: int = 3) -> Any:
        opti.subject_to(opti.variable() > ca.MX.sym("weight"))

    def weights(opti: Any, x: Any, vehicle: Any, horizon: int = 3) -> Any:
        vehicle.riccati((1, 0, 1, 0), x[0])
        return commands(opti, horizon)

    def branches(opti: Any, x: Any, horizon: int = 3) -> Any:
        return commands(opti, horizon) if x[0] > 0 else None

    def misspelt(opti: Any, lane: Any, horizon: int = 3) -> Any:
        return lane.yaw_rat

    for build in (nothing, too_few, solves, free, outside, branches):
        with refused(f"{build.__name__}.build"):
            prepared(build)
    with refused("weights.build: vehicle.riccati"):
        prepared(weights)
    with refused("misspelt.lane.yaw_rat", UnknownNameError, allowed={"yaw_rate", "curvature", "v"}):
        prepared(misspelt)
    with refused("commands.build"):
        prepared(commands, options={"ipopt.no_such_option": 1})

    def fractional(opti: Any, horizon: float = 4.5) -> Any: ...
    def long(opti: Any, horizon: int = 101) -> Any: ...
    def slippery(opti: Any, horizon: int = 3, mu: float = 0.0) -> Any: ...

    for build, gain in ((fractional, "horizon"), (long, "horizon"), (slippery, "mu")):
        with refused(f"{build.__name__}.{gain}.default"):
            prepared(build)

    def solving(opti: Any, horizon: int = 3, solver: str = "ipopt") -> Any: ...
    def titled(opti: Any, horizon: int = 3, title: float = 1.0) -> Any: ...
    def building(opti: Any, horizon: int = 3, build: float = 1.0) -> Any: ...

    for build, taken in ((solving, "solver"), (titled, "title"), (building, "build")):
        with refused(f"{build.__name__}.{taken}"):
            ldc.from_opti(build)

    def unknown(opti: Any, lanes: Any, horizon: int = 3) -> Any: ...
    def endless(opti: Any) -> Any: ...

    with refused("unknown.lanes", UnknownNameError, allowed={"lane", "x"}):
        ldc.from_opti(unknown)
    with refused("endless.horizon"):
        ldc.from_opti(endless)
