"""Linear MPC: what is infeasible, solvers that give up, extreme gains, the road ahead, the record of solver calls."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import osqp
import pytest
import qpsolvers

import ldctoolkit.controllers.linear_mpc as module
from helpers.closed_loop import DT, mpc_situations, some
from helpers.errors import refused
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, Scenarios, simulate
from ldctoolkit.controllers import LinearMPC
from ldctoolkit.controllers.linear_mpc import QP, Answer, Rung, Workspace, make


def first_state(design: LinearMPC, plant: Plant, x: np.ndarray, preview: Preview, prev: np.ndarray) -> Any:
    law = design.prepare(plant)
    return law.step(np.zeros(plant.n), x, preview, prev, law.init(plant.n))


def test_a_wheel_beyond_delta_max_comes_back_with_a_status_of_its_own() -> None:
    design = LinearMPC(horizon=10, delta_max=0.05, rate_max=0.2, r_delta=100.0)
    plant, x, preview, prev = mpc_situations(6, 10, seed=3)
    prev = np.array([0.3, -0.3, 0.061, 0.0, -0.0601, 0.02])
    delta, _, status = first_state(design, plant, x, preview, prev)
    expected = np.abs(prev) > 0.05 + 0.2 * DT
    np.testing.assert_array_equal(status, np.where(expected, EventStatus.BEYOND_DELTA_MAX, EventStatus.OK))
    # it moves towards the limits as fast as the rate allows
    np.testing.assert_allclose(delta[expected], prev[expected] - np.sign(prev[expected]) * 0.2 * DT, atol=1e-15)
    assert (np.abs(delta - prev) <= 0.2 * DT + 1e-6).all()
    # 0.14 rad at the trigger; the limits can be met before the end, and no command counts as a failed solve
    tight = Scenarios.from_arrays(T=[1.2, 3.0], d_y=[0.3, 0.5], v_mean=[6.0, 25.0])
    out = simulate(LinearMPC(r_delta=100.0), tight, y_s=0.1, trajectories=True)
    assert out.status.tolist() == [EventStatus.BEYOND_DELTA_MAX, EventStatus.OK]
    assert not out.failed_solves.any()
    assert np.nanmin(np.abs(out.trajectories.delta[0])) <= 0.1


class GivesUp(Workspace):
    """A solver that reaches its maximum of iterations, with a placeholder in its answer."""

    def __init__(self, qp: QP) -> None:
        self.qp = qp

    def solve(self, low: np.ndarray, high: np.ndarray, y: np.ndarray) -> Answer:
        return Answer(False, np.full(self.qp.A.shape[1], 2.1e9), np.full(y.size, np.nan), 4000)


TIGHT = LinearMPC(horizon=8, delta_max=0.02, rate_max=0.1, r_delta=10.0, always_solve=True)
TWO = Scenarios.from_arrays(T=[3.0, 4.0], d_y=[0.6, 0.8], v_mean=[25.0, 15.0])


def test_where_the_solver_gives_up_another_solves_the_same_qp(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = simulate(TIGHT, TWO, y_s=0.1, settle=0.0)
    monkeypatch.setattr(module, "make", lambda solver, qp: make(solver, qp) if solver == "daqp" else GivesUp(qp))
    rescued = simulate(TIGHT, TWO, y_s=0.1, settle=0.0)
    assert (rescued.status == EventStatus.OK).all()
    np.testing.assert_allclose(rescued.S, usual.S, rtol=5e-5)  # eps = 1e-6 in each command, summed over the path


def test_where_nothing_solves_the_fallback_clips_the_unconstrained_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a solver leaves behind when it gives up never reaches the plant."""
    monkeypatch.setattr(module, "make", lambda solver, qp: GivesUp(qp))
    out = simulate(TIGHT, TWO, y_s=0.1, trajectories=True)
    assert (out.status == EventStatus.SOLVER_FAILED).all()
    assert (out.failed_solves > 0).all()
    delta = out.trajectories.delta
    assert np.nanmax(np.abs(delta)) <= 0.02 + 1e-12
    assert np.nanmax(np.abs(np.diff(delta, axis=1))) <= 0.1 * DT + 1e-12
    assert np.isfinite(out.S).all()


def test_an_interrupt_during_a_solve_is_an_interrupt() -> None:
    """OSQP catches Ctrl-C and reports a status; that must not become a counted failure."""

    class Interrupted:
        class info:
            status_val = int(osqp.SolverStatus.OSQP_SIGINT)

        def solve(self, raise_error: bool) -> Interrupted:
            return self

        def update(self, **_: object) -> None: ...

        def warm_start(self, **_: object) -> None: ...

    workspace = make("osqp", QP(np.zeros(1), np.eye(1)))
    workspace.solver = Interrupted()  # type: ignore[attr-defined]
    with pytest.raises(KeyboardInterrupt):
        workspace.solve(-np.ones(1), np.ones(1), np.zeros(1))


@pytest.mark.parametrize(
    ("horizon", "r_delta", "q_y", "size"),
    [
        (20, 0.01, 1.0, 1.0), pytest.param(20, 1.0, 1.0, 1.0, marks=pytest.mark.slow),
        pytest.param(60, 1.0, 1.0, 3.0, marks=pytest.mark.slow),
        pytest.param(40, 1e-3, 1.0, 1.0, marks=pytest.mark.slow), (20, 100.0, 1e4, 1.0),
    ],
)  # fmt: skip
def test_feasible_qps_are_solved_with_extreme_gains(horizon: int, r_delta: float, q_y: float, size: float) -> None:
    """Weights far beyond what the limits allow; Clarabel on the same QP is the reference."""
    design = LinearMPC(horizon=horizon, r_delta=r_delta, q_y=q_y, delta_max=0.04, rate_max=0.05)
    plant, x, preview, prev = mpc_situations(12, horizon, seed=7, size=size)
    prev = np.clip(prev, -0.0424, 0.0424)  # up to just inside what the rate limit can bring back
    delta, _, status = first_state(design, plant, x, preview, prev)
    assert (status == EventStatus.OK).all()
    reference = dataclasses.replace(design, solver="clarabel", always_solve=True)
    theirs, _, _ = first_state(reference, plant, x, preview, prev)
    np.testing.assert_allclose(delta, theirs, rtol=0, atol=1e-5)


def test_the_previewed_road_reaches_the_law() -> None:
    """In the closed loop the command is the plan for the lane's true yaw rate at each sample ahead."""
    scenarios = Scenarios.from_arrays(
        T=[2.5, 6.0], d_y=[0.4, 0.6], v_mean=[22.0, 15.0], c_0=[1e-3, -2e-3], dc=[3e-3, 1e-3]
    )
    design = LinearMPC(horizon=12, delta_max=1.0, rate_max=10.0, r_delta=100.0)
    out = simulate(design, scenarios, y_s=0.1, trajectories=True)
    paths = out.trajectories
    for i in range(2):
        t_s = out.t_s[i]
        v = scenarios.v_mean[i]
        law = design.prepare(Plant.build(BicycleModel(), [v], DT))
        for k in (0, 7, 20):
            ahead = paths.t[i, k] + DT * np.arange(13)
            r = v * (scenarios.c_0[i] + scenarios.dc[i] * np.minimum(ahead / scenarios.T[i], 1.0))
            ahead = Preview(r[None], np.zeros((1, 13)))
            expected = law.step(np.zeros(1), paths.x[i, k][None], ahead, np.zeros(1), law.init(1))[0][0]
            assert paths.t[i, k] == pytest.approx(t_s + k * DT)
            assert paths.delta[i, k] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("solver", some(["osqp", "daqp", "clarabel"], "osqp", "clarabel"))
def test_the_record_of_solver_calls(solver: str) -> None:
    """Every call counts; residuals are within what each solver promises."""
    plant, x, preview, prev = mpc_situations(12, 10, seed=4)
    design = LinearMPC(horizon=10, delta_max=0.03, rate_max=0.1, r_delta=5.0, solver=solver, always_solve=True)
    law, prev = design.prepare(plant), np.clip(prev, -0.03, 0.03)
    delta, state, _ = law.step(np.zeros(12), x, preview, prev, law.init(12))
    proved, guessed, _ = first_state(dataclasses.replace(design, always_solve=False), plant, x, preview, prev)
    tolerance = {"osqp": 2e-6, "daqp": 1e-9, "clarabel": 1e-6}[solver]
    np.testing.assert_allclose(delta, proved, rtol=0, atol=10 * tolerance)
    calls = law.solver_calls(state)
    assert calls.position.tolist() == list(range(12))
    assert (calls.status == 1).all()
    np.testing.assert_array_equal(state.rung, Rung.SOLVED)
    assert calls.primal_residual.max() <= tolerance
    assert calls.dual_residual.max() <= tolerance
    assert solver == "clarabel" or (calls.iterations > 0).all()
    assert set(guessed.rung.tolist()) <= {Rung.FREE, Rung.HELD}
    assert guessed.calls.position.size == 0


@pytest.mark.parametrize("solver", ["dapq", "mosek"])
def test_a_solver_that_is_not_installed_is_named(solver: str) -> None:
    with refused("linear_mpc.solver", value=solver, allowed={"osqp", "daqp", *qpsolvers.available_solvers}):
        LinearMPC(solver=solver)


def test_skipping_the_solver_changes_nothing_that_matters() -> None:
    rng = np.random.default_rng(6)
    scenarios = Scenarios.from_arrays(
        T=rng.uniform(1, 3, 4), d_y=rng.uniform(0.3, 0.8, 4), v_mean=rng.uniform(12, 30, 4)
    )
    skipped = simulate(LinearMPC(horizon=8, r_delta=100.0), scenarios).S
    solved = simulate(LinearMPC(horizon=8, always_solve=True, r_delta=100.0), scenarios).S
    np.testing.assert_allclose(solved, skipped, rtol=2e-5)
