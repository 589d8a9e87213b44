"""Soft limits and move blocking of the linear MPC against a QP built from rolled-out paths, in Clarabel."""

from __future__ import annotations

import dataclasses
import functools

import control
import numpy as np
import pytest
import qpsolvers
import scipy.optimize
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from controllers import LinearMPC
from controllers._mpc_condensing import block_starts
from controllers._mpc_law import MPCLaw, MPCState, Rung
from helpers.closed_loop import takeover
from helpers.examples import examples
from helpers.grids import grid, some
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, Scenarios, load_model, simulate
from ldctoolkit.simulation import Takeover, drive

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


@examples(25)
@given(seed=st.integers(0, 2**31), size=st.sampled_from([0.1, 1.0, 3.0]), blocks=st.sampled_from([0, 4]))
def test_mirrored_input_gives_the_mirrored_command(seed: int, size: float, blocks: int) -> None:
    design = LinearMPC(horizon=10, r_delta=20.0, a_y_max=2.0, jerk_max=9.0, e_y_max=1.0, blocks=blocks)
    plant, x, preview, prev = situations(6, 10, seed, size)
    delta, state, status = commands(design, plant, x, preview, prev)
    mirrored, turned, same = commands(design, plant, -x, Preview(-preview.yaw_rate, -preview.heading), -prev)
    np.testing.assert_allclose(mirrored, -delta, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(same, status)
    np.testing.assert_array_equal(turned.rung, state.rung)


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


def reachable(over: Takeover, i: int, design: LinearMPC) -> bool:
    """Whether commands from the trigger on can keep angle, rate and a_y inside their limits, by linear programming."""
    N, dt, step, v = design.horizon, over.setup.dt, over.plant.step, over.plant.v[i]
    A_c, B_c, E_c = (each[i] for each in over.plant.model.matrices(over.plant.v))
    p = over.triggered
    t = over.start[i] + dt * np.arange(N + 1)
    r = v * (p.c_0[i] + p.dc[i] * np.minimum(t / p.T[i], 1.0))
    # state and a_y as (weights of the commands, constant)
    x = np.zeros((4, N + 1))
    x[:, N] = over.x_0[i]
    rows = []
    for j in range(N):
        command = np.zeros(N + 1)
        command[j] = 1.0
        rows.append(A_c[1] @ x + B_c[1] * command)
        rows[-1][N] += (E_c[1] + v) * r[j]
        x = step.A[i] @ x + np.outer(step.B[i], command)
        x[:, N] += step.E_0[i] * r[j] + step.E_1[i] * r[j + 1]
        rows.append(A_c[1] @ x + B_c[1] * command)
        rows[-1][N] += (E_c[1] + v) * r[j + 1]
    a_y = np.array(rows)
    change = np.eye(N) - np.eye(N, k=-1)
    first = np.zeros(N)
    first[0] = over.delta_0[i]
    G = np.vstack([a_y[:, :N], -a_y[:, :N], change, -change])
    allowed, reach = np.full(2 * N, design.a_y_max), np.full(N, design.rate_max * dt)
    h = np.concatenate([allowed - a_y[:, N], allowed + a_y[:, N], reach + first, reach - first])
    bounds = (-design.delta_max, design.delta_max)
    return bool(scipy.optimize.linprog(np.zeros(N), A_ub=G, b_ub=h, bounds=bounds).status == 0)


@pytest.mark.slow
@pytest.mark.parametrize("limits", [(10.0, 0.3, 1.0), (100.0, 0.1, 0.4)])
def test_lateral_acceleration_stays_within_its_limit_wherever_that_is_feasible(
    limits: tuple[float, float, float],
) -> None:
    """On departures of the bundled model; a linear program says where the limit cannot be met from the trigger on."""
    r_delta, delta_max, rate_max = limits
    scenarios = load_model("reference").sample(100, 100, seed=4)
    over = takeover(scenarios)
    without = LinearMPC(solver="daqp", r_delta=r_delta, delta_max=delta_max, rate_max=rate_max)
    limited = dataclasses.replace(without, a_y_max=3.0)
    # a scenario that starts beyond the angle's limit has its commands from elsewhere
    possible = np.array([abs(over.delta_0[i]) <= delta_max and reachable(over, i, limited) for i in range(over.m)])
    assert possible.mean() > 0.85
    assert drive(without, over).companions.a_y_peak[possible].min() > 3.05
    assert drive(limited, over).companions.a_y_peak[possible].max() < 3.05


def test_a_corridor_that_is_left_already_is_no_failure() -> None:
    design = LinearMPC(e_y_max=0.1, a_y_max=0.2, jerk_max=0.5, solver="daqp")
    out = simulate(design, HARSH, y_s=0.2)
    assert (out.status == EventStatus.OK).all()
    assert np.isfinite(out.S).all()
