"""Limits and move blocking of the linear MPC against a QP built from rolled-out paths, in Clarabel."""

from __future__ import annotations

import dataclasses
import functools

import control
import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

from controllers import LinearMPC
from controllers._mpc_condensing import block_starts
from controllers._mpc_law import MPCLaw, MPCState, Rung
from helpers.grids import grid, some
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, Scenarios, simulate

DT = 0.05


def situations(n: int, horizon: int, seed: int, size: float = 1.0) -> tuple[Plant, np.ndarray, Preview, np.ndarray]:
    """From quiet to violent, scenario by scenario."""
    rng = np.random.default_rng(seed)
    size = size * np.linspace(0.02, 1.0, n)[:, None]
    plant = Plant.build(BicycleModel(), rng.uniform(12, 36, n), DT)
    x = size * rng.normal(size=(n, 4)) * [0.8, 0.4, 0.03, 0.1]
    yaw_rate = size * (rng.normal(0, 0.04, (n, 1)) + rng.normal(0, 0.1, (n, 1)) * np.arange(horizon + 1) * DT)
    return plant, x, Preview(yaw_rate, np.zeros_like(yaw_rate)), size[:, 0] * rng.uniform(-0.02, 0.02, n)


@dataclasses.dataclass
class Case:
    """One MPC problem, everything by rolling the plant out."""

    design: LinearMPC
    plant: Plant
    i: int
    x_0: np.ndarray
    r: np.ndarray
    prev: float

    def outputs(self, u: np.ndarray, affine: bool = True) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Residuals whose squared norm is the cost, and every limited quantity, for the commands u (N,)."""
        d, step, i, N = self.design, self.plant.step, self.i, self.design.horizon
        x, r, prev = (self.x_0, self.r, self.prev) if affine else (0 * self.x_0, 0 * self.r, 0.0)
        A_c, B_c, E_c = (each[i] for each in self.plant.model.matrices(self.plant.v))
        Q, P = self._weights
        steady = self.plant.steady_state()
        target = np.array([0, 0, steady.e_psi[i], 0])

        def a_y(x: np.ndarray, u: float, r: float) -> float:
            return float(A_c[1] @ x + B_c[1] * u + E_c[1] * r + self.plant.v[i] * r)

        cost, after, end, jerk, offset = [], [], [], [], []
        was = a_y(x, prev, r[0])
        for j in range(N):
            after.append(a_y(x, u[j], r[j]))
            x = step.A[i] @ x + step.B[i] * u[j] + step.E_0[i] * r[j] + step.E_1[i] * r[j + 1]
            end.append(a_y(x, u[j], r[j + 1]))
            jerk.append((end[-1] - was) / DT)
            was = end[-1]
            offset.append(x[0])
            W = P if j == N - 1 else Q
            values, vectors = np.linalg.eigh(W)
            cost.append(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T @ (x - target * r[j + 1]))
            cost.append([np.sqrt(d.r_delta) * (u[j] - steady.delta[i] * 0.5 * (r[j] + r[j + 1]))])
        change = np.diff(u, prepend=prev)
        return np.concatenate(cost), {
            "u": np.array(u),
            "change": change,
            "a_y": np.array(after + end),
            "jerk": np.array(jerk),
            "e_y": np.array(offset),
        }

    def solve(self, held: np.ndarray, hard_soft: bool = False) -> tuple[float, np.ndarray]:
        """First command and slacks (3,); `held` (N, M) turns moves into commands."""
        d, N, M = self.design, self.design.horizon, held.shape[1]
        free, at = self.outputs(np.zeros(N))
        columns = [self.outputs(held[:, k], affine=False) for k in range(M)]
        J = np.column_stack([c[0] for c in columns])
        s = d.r_delta + self._curvature()  # the penalty is against half the squared corrections
        kinds = [(n, m) for n, m in (("a_y", d.a_y_max), ("jerk", d.jerk_max), ("e_y", d.e_y_max)) if m > 0]
        size = M + len(kinds)
        H, g = np.zeros((size, size)), np.zeros(size)
        H[:M, :M], g[:M] = J.T @ J / s, J.T @ free / s
        G, h = [], []

        def limit(name: str, most: float, slack: int | None) -> None:
            rows = np.zeros((at[name].size, size))
            rows[:, :M] = np.column_stack([c[1][name] for c in columns]) / most
            for sign in (1.0, -1.0):
                row = sign * rows
                if slack is not None and not hard_soft:
                    row[:, slack] = -1.0
                G.append(row)
                h.append(1.0 - sign * at[name] / most)

        limit("u", d.delta_max, None)
        limit("change", d.rate_max * DT, None)
        for k, (name, most) in enumerate(kinds):
            limit(name, most, M + k)
            H[M + k, M + k] = g[M + k] = d.soft_weight
            G.append(-np.eye(size)[M + k : M + k + 1])
            h.append(np.zeros(1))
        p = qpsolvers.Problem(sp.csc_matrix(H), g, sp.csc_matrix(np.vstack(G)), np.concatenate(h))
        tight = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12}
        answer = qpsolvers.solve_problem(p, solver="clarabel", **tight)
        assert answer.x is not None
        slacks = np.zeros(3)
        slacks[[("a_y", "jerk", "e_y").index(n) for n, _ in kinds]] = answer.x[M:]
        return float(held[0] @ answer.x[:M]) if answer.found else np.nan, slacks

    @functools.cached_property
    def _weights(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the states on the way, and of the last one."""
        d, step, i = self.design, self.plant.step, self.i
        Q = np.diag([d.q_y, d.q_y_rate, d.q_psi, d.q_psi_rate])
        return Q, control.dlqr(step.A[i], step.B[i][:, None], Q, np.array([[d.r_delta]]))[1]

    def _curvature(self) -> float:
        B = self.plant.step.B[self.i]
        return float(B @ self._weights[1] @ B)


def blocked(N: int, starts: list[int]) -> np.ndarray:
    held = np.zeros((N, len(starts)))
    for k, (first, last) in enumerate(zip(starts, [*starts[1:], N], strict=True)):
        held[first:last, k] = 1.0
    return held


def commands(
    design: LinearMPC, plant: Plant, x: np.ndarray, preview: Preview, prev: np.ndarray
) -> tuple[np.ndarray, MPCState, np.ndarray]:
    law = design.prepare(plant)
    assert isinstance(law, MPCLaw)
    return law.step(np.zeros(plant.n), x, preview, prev, law.init(plant.n))


@pytest.mark.parametrize(
    ("horizon", "always_solve"), grid([1, 8, 20], [False, True], (1, False), (8, True), (20, False))
)
def test_without_active_limits_it_is_the_finite_horizon_lqr(horizon: int, always_solve: bool) -> None:
    """The least squares of the rolled-out cost."""
    wide = LinearMPC(horizon=horizon, delta_max=1.0, rate_max=10.0, q_psi=5.0, r_delta=60.0, always_solve=always_solve)
    plant, x, preview, prev = situations(10, horizon, seed=horizon, size=0.3)
    delta, _, status = commands(wide, plant, x, preview, prev)
    assert (status == EventStatus.OK).all()
    for i in range(plant.n):
        case = Case(wide, plant, i, x[i], preview.yaw_rate[i], prev[i])
        J = np.column_stack([case.outputs(unit, affine=False)[0] for unit in np.eye(horizon)])
        plan = np.linalg.lstsq(J, -case.outputs(np.zeros(horizon))[0])[0]
        # the plan without limits is exact; through OSQP it carries eps = 1e-6
        assert delta[i] == pytest.approx(plan[0], abs=1e-5 if always_solve else 1e-9)


@pytest.mark.parametrize("r_delta", some([5.0, 100.0, 2000.0], 100.0))
def test_with_active_limits_it_equals_another_solver(r_delta: float) -> None:
    """OSQP's eps 1e-6 leaves at most 1e-4 rad."""
    design = LinearMPC(horizon=15, delta_max=0.04, rate_max=0.15, r_delta=r_delta)
    plant, x, preview, prev = situations(30, 15, seed=2)
    delta, _, status = commands(design, plant, x, preview, prev)
    free, _, _ = commands(dataclasses.replace(design, delta_max=1.0, rate_max=10.0), plant, x, preview, prev)
    assert (status == EventStatus.OK).all()
    assert (np.abs(delta - free) > 1e-3).sum() > 5, "the limits must bind for this to test anything"
    for i in range(plant.n):
        first, _ = Case(design, plant, i, x[i], preview.yaw_rate[i], prev[i]).solve(np.eye(15))
        assert delta[i] == pytest.approx(first, abs=1e-4)


SOFT = [
    {"a_y_max": 1.0},
    {"jerk_max": 4.0},
    {"e_y_max": 0.7},
    {"a_y_max": 1.0, "soft_weight": 0.003},  # so light that it pays to go beyond a limit that could be met
    {"a_y_max": 1.5, "jerk_max": 6.0, "e_y_max": 0.9},
]


@pytest.mark.parametrize(
    ("number", "solver"), grid(range(5), ["osqp", "daqp"], (2, "daqp"), (3, "osqp"), (4, "osqp"), (4, "daqp"))
)
def test_soft_limits_equal_another_solver(number: int, solver: str) -> None:
    """Clarabel to 1e-12 on the rolled-out QP; commands to 1e-6 rad, slacks to 1e-4 of the limit or of themselves."""
    design = LinearMPC(horizon=10, r_delta=20.0, solver=solver, always_solve=solver == "daqp", **SOFT[number])
    plant, x, preview, prev = situations(24, 10, seed=2)
    delta, state, status = commands(design, plant, x, preview, prev)
    assert (status == EventStatus.OK).all()
    slacks = np.zeros((24, 3))
    for i in range(24):
        case = Case(design, plant, i, x[i], preview.yaw_rate[i], prev[i])
        first, slacks[i] = case.solve(np.eye(10))
        assert delta[i] == pytest.approx(first, abs=1e-6), i
        np.testing.assert_allclose(state.slack[i], slacks[i], rtol=1e-4, atol=1e-5)
    assert (slacks.max(axis=1) > 1e-3).sum() > 2, "some cannot be met"
    assert (slacks.max(axis=1) < 1e-6).sum() > 3, "some can"


def test_the_penalty_is_exact() -> None:
    """Where the soft limits can be met, they are: the command of the QP in which they are hard."""
    design = LinearMPC(horizon=10, r_delta=20.0, a_y_max=2.0, jerk_max=12.0, e_y_max=1.5)
    plant, x, preview, prev = situations(24, 10, seed=5)
    delta, state, _ = commands(design, plant, x, preview, prev)
    binding = 0
    for i in range(plant.n):
        case = Case(design, plant, i, x[i], preview.yaw_rate[i], prev[i])
        first, _ = case.solve(np.eye(10), hard_soft=True)
        if np.isfinite(first):
            assert delta[i] == pytest.approx(first, abs=1e-6)
            np.testing.assert_allclose(state.slack[i], 0.0, atol=1e-9)
            binding += bool(np.any(state.multipliers[i, 19:] != 0))
    assert binding > 2


@pytest.mark.parametrize(
    ("horizon", "blocks", "starts", "soft"),
    [
        (12, 4, [0, 1, 3, 7], {"a_y_max": 1.5}),
        (20, 6, [0, 1, 2, 5, 9, 14], {}),
        pytest.param(12, 4, [0, 1, 3, 7], {}, marks=pytest.mark.slow),
        pytest.param(20, 6, [0, 1, 2, 5, 9, 14], {"a_y_max": 1.5}, marks=pytest.mark.slow),
    ],
)
def test_blocked_moves_equal_another_solver(
    horizon: int, blocks: int, starts: list[int], soft: dict[str, float]
) -> None:
    design = LinearMPC(horizon=horizon, blocks=blocks, r_delta=30.0, delta_max=0.05, **soft)
    assert block_starts(horizon, blocks).tolist() == starts
    plant, x, preview, prev = situations(16, horizon, seed=4)
    delta, state, _ = commands(design, plant, x, preview, prev)
    for i in range(16):
        case = Case(design, plant, i, x[i], preview.yaw_rate[i], prev[i])
        first, _ = case.solve(blocked(horizon, starts))
        assert delta[i] == pytest.approx(first, abs=1e-6)
    assert set(state.rung.tolist()) >= {Rung.FREE, Rung.HELD}


HARSH = Scenarios.from_arrays(T=[3.0, 3.0, 4.0], d_y=[0.9, 0.7, 0.8], v_mean=[30.0, 34.0, 26.0], c_0=[5e-4, 0.0, -8e-4])


@pytest.mark.parametrize("solver", some(["osqp", "daqp"], "daqp"))
def test_lateral_acceleration_stays_within_its_limit(solver: str) -> None:
    """A hasty design takes more than 3 m/s^2; the limit keeps it, but for what passes between two samples."""
    hasty = LinearMPC(q_y=100.0, r_delta=20.0, solver=solver)
    free = simulate(hasty, HARSH, y_s=0.2)
    assert (free.companions.a_y_peak > 3.3).all()
    limited = simulate(dataclasses.replace(hasty, a_y_max=3.0), HARSH, y_s=0.2)
    assert (limited.companions.a_y_peak < 3.05).all()
    assert (limited.companions.a_y_peak > 2.9).all()
    assert not limited.failed_solves.any()


def test_a_corridor_that_is_left_already_is_no_failure() -> None:
    design = LinearMPC(e_y_max=0.1, a_y_max=0.2, jerk_max=0.5, solver="daqp")
    out = simulate(design, HARSH, y_s=0.2)
    assert (out.status == EventStatus.OK).all()
    assert np.isfinite(out.S).all()
