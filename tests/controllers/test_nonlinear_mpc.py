"""Nonlinear MPC against IPOPT on the same problem written plainly, the linear MPC, and an integrator of its model."""

import dataclasses
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casadi as ca
import control
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import ldctoolkit.casadi_code as casadi_code
import ldctoolkit.controllers._nmpc_solver as solver_module
from helpers.closed_loop import DT, grid
from helpers.closed_loop import mpc_situations as situations
from helpers.errors import refused
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, Scenarios, VehicleParameters, simulate
from ldctoolkit.controllers import LinearMPC
from ldctoolkit.controllers._prediction_model import SHAPE, steady_cornering
from ldctoolkit.controllers.nonlinear_mpc import NonlinearMPC
from ldctoolkit.controllers.predictive import PredictiveState
from ldctoolkit.controllers.riccati import regulator
from ldctoolkit.plant_options import PlantOptions, Tyres

VEHICLE = VehicleParameters()
HORIZON = 8  # of nearly all plans here: each horizon is compiled, with soft limits once more


@pytest.fixture(autouse=True, scope="module")
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(casadi_code.CACHE, str(tmp_path_factory.mktemp("cache")))
        yield


def first(
    design: NonlinearMPC, plant: Plant, x: np.ndarray, preview: Preview, prev: np.ndarray
) -> tuple[np.ndarray, PredictiveState, np.ndarray]:
    law = design.prepare(plant)
    return law.step(np.zeros(plant.n), x, preview, prev, law.init(plant.n))


def right_hand_side(x: Any, delta: Any, r: Any, v: float, mu: float) -> Any:
    """Rates of the state and a_y of the nonlinear bicycle: Rajamani, section 2.3, with Pacejka's Magic Formula."""
    p = VEHICLE

    def axle_force(alpha: Any, C_alpha: float, arm: float) -> Any:
        D = mu * p.m * 9.81 * arm / (p.l_f + p.l_r)
        return D * ca.sin(SHAPE * ca.atan(2.0 * C_alpha * alpha / (SHAPE * D)))

    omega, v_y = x[3] + r, (x[1] - v * ca.sin(x[2])) / ca.cos(x[2])
    front = axle_force(delta - ca.atan((v_y + p.l_f * omega) / v), p.C_af, p.l_r) * ca.cos(delta)
    rear = axle_force(-ca.atan((v_y - p.l_r * omega) / v), p.C_ar, p.l_f)
    a_y = (front + rear) / p.m
    v_y_rate = a_y - v * omega
    # the time derivative of e_y' = v sin e_psi + v_y cos e_psi
    e_y_acceleration = (v * ca.cos(x[2]) - v_y * ca.sin(x[2])) * x[3] + v_y_rate * ca.cos(x[2])
    return ca.vertcat(x[1], e_y_acceleration, x[3], (p.l_f * front - p.l_r * rear) / p.I_z), a_y


def ipopt(
    design: NonlinearMPC, plant: Plant, i: int, x_0: np.ndarray, r: np.ndarray, prev: float, guess: np.ndarray
) -> tuple[np.ndarray, float]:
    """Commands and cost of the same problem, written with states as variables, from the toolkit's own plant."""
    N, step, v, mu = design.horizon, plant.step, float(plant.v[i]), design.mu
    A, B, E = plant.model.matrices(plant.v[i : i + 1])
    half = plant.model.discretize(plant.v[i : i + 1], 0.5 * DT)

    def response(power: int, dt: float) -> np.ndarray:
        """To accelerations (s/dt)^power / power!, by quadrature."""
        shape = lambda s: scipy.linalg.expm(A[0] * (dt - s))[:, [1, 3]] * (s / dt) ** power / max(power, 1)  # noqa: E731
        return np.asarray(scipy.integrate.quad_vec(shape, 0, dt, epsabs=1e-14, epsrel=1e-13)[0])

    H_1, G_1, G_2, G_3 = response(0, 0.5 * DT), response(0, DT), response(1, DT), response(2, DT)

    def rest(x: Any, u: Any, r: float) -> Any:
        f, _ = right_hand_side(x, u, r, v, mu)
        return (f - (A[0] @ x + B[0] * u + E[0] * r))[[1, 3]]

    # what is limited is the acceleration less that of the lane
    opti = ca.Opti()
    X, U = opti.variable(4, N), opti.variable(N)
    q = np.diag([design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate])
    _, P, _ = control.dlqr(step.A[i], step.B[i][:, None], q, np.array([[design.r_delta]]))
    single = dataclasses.replace(plant, v=plant.v[i : i + 1])
    nodes, between = (
        steady_cornering(single, mu, r[None]),
        steady_cornering(single, mu, 0.5 * (r[None, 1:] + r[None, :-1])),
    )
    cost: Any = 0
    y, w = [], 1e3 * (design.q_y + 1e-2 * design.q_psi + 1e-2 * design.r_delta)
    rate = design.rate_max * DT
    for j in range(N):
        x = ca.DM(x_0) if j == 0 else X[:, j - 1]
        mid = 0.5 * (r[j] + r[j + 1])
        g_0 = rest(x, U[j], r[j])
        a = half.A[0] @ x + half.B[0] * U[j] + half.E_0[0] * r[j] + half.E_1[0] * mid + H_1 @ g_0
        g_a = rest(a, U[j], mid)
        linear = step.A[i] @ x + step.B[i] * U[j] + step.E_0[i] * r[j] + step.E_1[i] * r[j + 1]
        g_b = rest(linear + G_1 @ (2 * g_a - g_0), U[j], r[j + 1])
        after = G_1 @ g_0 + G_2 @ (-3 * g_0 + 4 * g_a - g_b) + G_3 @ (4 * g_0 - 8 * g_a + 4 * g_b)
        opti.subject_to(X[:, j] == linear + after)
        off = X[:, j] - np.array([0, 0, nodes.e_psi[0, j + 1], 0])
        cost += off.T @ (P if j == N - 1 else q) @ off + design.r_delta * (U[j] - between.delta[0, j]) ** 2
        opti.subject_to(opti.bounded(-design.delta_max, U[j], design.delta_max))
        opti.subject_to(opti.bounded(-rate, U[j] - (U[j - 1] if j else prev), rate))
        y += [right_hand_side(at, U[j], bend, v, mu)[1] - v * bend for at, bend in ((x, r[j]), (X[:, j], r[j + 1]))]
    total = cost
    if design.a_y_max:
        slack = opti.variable(2 * N)
        opti.subject_to(slack >= 0)
        opti.subject_to(ca.vertcat(*y) - slack <= design.a_y_max)
        opti.subject_to(ca.vertcat(*y) + slack >= -design.a_y_max)
        total = cost + 2.0 * w * (ca.sum1(slack) + 0.5 * ca.sumsqr(slack))
    opti.minimize(total)
    opti.set_initial(U, guess)
    follow, x, start = sampled(design, plant, i), x_0, []
    for j in range(N):
        x = follow(x, guess[j], r[j], r[j + 1])
        start.append(x)
    opti.set_initial(X, np.array(start).T)
    # a small first barrier keeps IPOPT in the valley where it starts: slippery problems have several
    quiet = {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-11}
    opti.solver("ipopt", quiet | {"ipopt.bound_relax_factor": 0.0, "ipopt.max_iter": 500, "ipopt.mu_init": 1e-5})
    solution = opti.solve()
    # the law's cost begins at the state that is given, which no command changes
    off = x_0 - np.array([0, 0, nodes.e_psi[0, 0], 0])
    return np.asarray(solution.value(U)).reshape(N), float(solution.value(cost) + off @ q @ off)


@pytest.mark.parametrize(
    "design",
    [
        pytest.param(NonlinearMPC(horizon=HORIZON, mu=0.3, r_delta=20.0), marks=pytest.mark.slow),
        pytest.param(
            NonlinearMPC(
                horizon=HORIZON, q_y_rate=0.3, q_psi_rate=0.7, q_psi=4.0, rate_max=0.1, delta_max=0.04, r_delta=100.0
            ),
            marks=pytest.mark.slow,
        ),
        NonlinearMPC(horizon=HORIZON, a_y_max=2.0, r_delta=100.0),
        pytest.param(NonlinearMPC(horizon=12, r_delta=100.0), marks=pytest.mark.slow),
        pytest.param(NonlinearMPC(horizon=12, mu=0.3, r_delta=20.0), marks=pytest.mark.slow),
        pytest.param(NonlinearMPC(horizon=1, delta_max=0.04, rate_max=0.5, r_delta=100.0), marks=pytest.mark.slow),
    ],
    ids=["slippery", "all_weights", "soft_a_y", "default", "slippery_longer", "one_step"],
)
def test_ipopt_finds_the_same_plan(design: NonlinearMPC) -> None:
    """First command within 1e-6 rad and cost within 1e-6; both are local optima near the same start."""
    n = 3 if design.horizon == HORIZON else 8
    plant, x, preview, prev = situations(n, design.horizon, seed=3, size=0.6)
    prev = np.clip(prev, -design.delta_max, design.delta_max)
    delta, state, status = first(design, plant, x, preview, prev)
    assert (status == EventStatus.OK).all()
    bound = 0
    for i in range(n):
        U, cost = ipopt(design, plant, i, x[i], preview.yaw_rate[i], prev[i], state.U[i])
        assert (delta[i], state.cost[i]) == (pytest.approx(U[0], abs=1e-6), pytest.approx(cost, rel=1e-6))
        change = np.diff(U, prepend=prev[i])
        bound += np.abs(change).max() > design.rate_max * DT - 1e-7 or np.abs(U).max() > design.delta_max - 1e-7
    assert bound >= 1, "limits must bind for this to test anything"


def sampled(design: NonlinearMPC, plant: Plant, i: int = 0) -> Any:
    """One sample of the law's model."""
    law = design.prepare(plant)
    predict = law.form.program(design.horizon).predict

    def follow(x: np.ndarray, u: float, r_0: float, r_1: float) -> np.ndarray:
        return np.asarray(predict(x, u, [r_0, r_1, *[0.0] * (law.form.samples - 2)], law.columns[i])[0]).ravel()

    return follow


@pytest.mark.parametrize(("v", "mu"), grid([3.0, 20.0, 35.0], [0.3, 1.0], (3.0, 0.3), (35.0, 1.0)))
def test_a_sample_follows_the_differential_equation(v: float, mu: float) -> None:
    """solve_ivp at 1e-11; one step's error falls like dt^3, by 8 when dt is halved. More than 5 is asked for, and 3 at
    3 m/s, where the stiffness of the tyres beyond their peak costs an order."""
    rhs = ca.Function("f", [x := ca.SX.sym("x", 4), u := ca.SX.sym("u"), r := ca.SX.sym("r")],
                      [right_hand_side(x, u, r, v, mu)[0]])  # fmt: skip
    x_0, delta, r_0, r_1 = np.array([0.2, 0.3, 0.02, -0.05]), 0.03, 0.05, 0.07
    errors = []
    for dt in (0.02, 0.01):
        plant = Plant.build(BicycleModel(), [v], dt)
        end = sampled(NonlinearMPC(mu=mu, r_delta=100.0), plant)(x_0, delta, r_0, r_1)
        flow = scipy.integrate.solve_ivp(
            lambda t, x, dt=dt: np.asarray(rhs(x, delta, r_0 + (r_1 - r_0) * t / dt)).ravel(),
            (0, dt), x_0, method="Radau", rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        errors.append(np.abs(end - flow.y[:, -1]).max())
    assert errors[0] < 5e-2  # the stiffest of these: slip far beyond the peak at 3 m/s
    assert errors[1] < errors[0] / (5 if v > 3 else 3)


def test_steady_cornering_is_an_equilibrium() -> None:
    """All accelerations vanish to 1e-7 up to 90 % of the friction; beyond, the angles are finite and stay."""
    v = np.array([8.0, 20.0, 35.0])
    plant = Plant.build(BicycleModel(), v, DT)
    for share in (0.01, 0.5, -0.9):
        r = share * 0.4 * 9.81 / v[:, None]
        steady = steady_cornering(plant, 0.4, r)
        for i in range(3):
            state = np.array([0, 0, steady.e_psi[i, 0], 0])
            f, a_y = right_hand_side(ca.DM(state), steady.delta[i, 0], r[i, 0], v[i], 0.4)
            np.testing.assert_allclose(np.asarray(f).ravel(), 0.0, atol=1e-7)
            assert float(a_y) == pytest.approx(v[i] * r[i, 0], abs=1e-7)
    far = steady_cornering(plant, 0.4, np.full((3, 2), [0.6, 60.0]))
    assert np.isfinite(far.delta).all()
    small = steady_cornering(plant, 1.0, np.full((3, 1), 1e-5))
    np.testing.assert_allclose(small.delta[:, 0], plant.steady_state().delta * 1e-5, rtol=1e-5)
    np.testing.assert_allclose(small.e_psi[:, 0], plant.steady_state().e_psi * 1e-5, rtol=1e-3)


def test_small_angles_give_the_linear_mpc() -> None:
    """The model is odd and its linear part exact: the difference falls with the cube, 1000 times for a tenth."""
    n = 8
    plant, x, preview, prev = situations(n, HORIZON, seed=4)
    worst = []
    for size in (1e-2, 1e-3):
        given = x * size, Preview(preview.yaw_rate * size, preview.heading), prev * size
        ours, _, _ = first(NonlinearMPC(horizon=HORIZON, r_delta=100.0), plant, *given)
        law = LinearMPC(horizon=HORIZON, r_delta=100.0).prepare(plant)
        theirs, _, _ = law.step(np.zeros(n), *given, law.init(n))
        worst.append(np.abs(ours - theirs).max() / size)
    assert worst[1] < 3e-6
    assert worst[1] < worst[0] / 50  # 100 by theory for the difference over the size


def test_slippery_plans_stay_on_the_tyres() -> None:
    """At friction 0.3 no command goes far beyond the peak of the tyres' force. From rest in the lane the command is the
    front slip angle; the linear MPC's goes far beyond the peak."""
    n = 12
    design = NonlinearMPC(horizon=HORIZON, mu=0.3, r_delta=20.0, rate_max=10.0)
    plant, x, preview, prev = situations(n, HORIZON, seed=7)
    x[:, 2:] = 0.0
    x[:, 1] = 0.0
    still = Preview(0 * preview.yaw_rate, 0 * preview.heading)
    ours, _, _ = first(design, plant, x, still, 0 * prev)
    law = LinearMPC(horizon=HORIZON, r_delta=20.0, rate_max=10.0).prepare(plant)
    theirs, _, _ = law.step(np.zeros(n), x, still, 0 * prev, law.init(n))
    load = VEHICLE.m * 9.81 * VEHICLE.l_r / (VEHICLE.l_f + VEHICLE.l_r) / 2.0
    peak = np.tan(np.pi / 2 / SHAPE) * SHAPE * 0.3 * load / VEHICLE.C_af
    far = np.abs(x[:, 0]) > 0.5
    assert far.sum() > 3
    assert (np.abs(theirs[far]) > 1.5 * peak).all()
    assert (np.abs(ours[far]) <= 1.2 * peak).all()  # the force there is within 1 % of the peak's


def test_the_soft_limits_of_acceleration_and_jerk_bind() -> None:
    """On saturating tyres that the law knows, as the closed loop measures them: kept with the limits, not without."""
    options = PlantOptions(tyres=Tyres(model="magic_formula", mu=1.0, shape=SHAPE))
    scenarios = Scenarios.from_arrays(T=3.0, d_y=0.6, v_mean=25.0)
    given = {"y_s": 0.1, "options": options, "settle": 0.0, "start": "steady"}
    free, held = (
        simulate(NonlinearMPC(r_delta=100.0, **soft), scenarios, **given)  # it must see more than half a second
        for soft in ({"horizon": HORIZON}, {"a_y_max": 3.0, "jerk_max": 5.0})
    )
    assert (held.failed_solves == 0).all()
    assert (free.metrics.a_y_peak > 3.5).all()
    assert (free.metrics.jerk_peak > 8.0).all()
    assert (held.metrics.a_y_peak < 3.01).all()
    assert (held.metrics.jerk_peak < 5.01).all()


@pytest.mark.parametrize(
    ("soft", "size", "r_delta"),
    [({"e_y_max": 0.57}, 0.57, 1e4), pytest.param({"jerk_max": 4.0}, 4.0, 200.0, marks=pytest.mark.slow)],
)
def test_corridor_and_jerk_bind_in_the_plan(soft: dict[str, float], size: float, r_delta: float) -> None:
    """Where the free plan breaks a limit that can be met, the plan with the limit meets it, to the QP's tolerance."""
    plant = Plant.build(BicycleModel(), [20.0, 28.0], DT)
    x = np.array([[0.5, 0.5, 0.025, 0.0], [0.45, 0.65, 0.0232, 0.0]])
    still = Preview(np.zeros((2, HORIZON + 1)), np.zeros((2, HORIZON + 1)))

    def worst(design: NonlinearMPC) -> float:
        _, state, status = first(design, plant, x, still, np.zeros(2))
        assert (status == EventStatus.OK).all()
        largest = 0.0
        for i in range(2):
            follow, path = sampled(design, plant, i), x[i]
            before = float(right_hand_side(ca.DM(path), 0.0, 0.0, plant.v[i], 1.0)[1])
            for u in state.U[i]:
                after = path, follow(path, u, 0.0, 0.0)
                path = after[1]
                a_y = [float(right_hand_side(ca.DM(at), u, 0.0, plant.v[i], 1.0)[1]) for at in after]
                largest = max(
                    largest, abs(path[0]) if "e_y_max" in soft else np.abs(np.subtract(a_y, before)).max() / 0.5
                )
        return largest

    assert worst(NonlinearMPC(horizon=HORIZON, r_delta=r_delta)) > 1.01 * size
    assert worst(NonlinearMPC(horizon=HORIZON, r_delta=r_delta, **soft)) < size * (1 + 1e-6)


def test_a_command_beyond_the_limits_goes_back_as_fast_as_it_may() -> None:
    design = NonlinearMPC(horizon=HORIZON, delta_max=0.05, rate_max=0.2, r_delta=100.0)
    plant, x, preview, _ = situations(6, HORIZON, seed=3, size=0.3)
    prev = np.array([0.3, -0.3, 0.061, 0.0, -0.0601, 0.02])
    delta, state, status = first(design, plant, x, preview, prev)
    beyond = np.abs(prev) > 0.05 + 0.2 * DT
    np.testing.assert_array_equal(status, np.where(beyond, EventStatus.BEYOND_DELTA_MAX, EventStatus.OK))
    np.testing.assert_array_equal(state.rung, np.where(beyond, 2, 1))
    np.testing.assert_allclose(delta[beyond], prev[beyond] - np.sign(prev[beyond]) * 0.2 * DT, atol=1e-12)
    assert (np.abs(delta - prev) <= 0.2 * DT + 1e-15).all()


def test_where_nothing_converges_the_lqr_steers_inside_the_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solver_module, "MAX_ITERATIONS", 0)
    design = NonlinearMPC(horizon=HORIZON, delta_max=0.04, r_delta=100.0)
    plant, x, preview, prev = situations(20, HORIZON, seed=5)
    prev = np.clip(prev, -0.04, 0.04)
    delta, state, status = first(design, plant, x, preview, prev)
    assert (status == EventStatus.SOLVER_FAILED).all()
    assert (state.rung == 3).all()
    K = regulator(plant, (1.0, 0.0, 1.0, 0.0), 100.0).K
    r = preview.yaw_rate
    e_psi = steady_cornering(plant, 1.0, r[:, :1]).e_psi[:, 0]
    expected = steady_cornering(plant, 1.0, 0.5 * (r[:, :1] + r[:, 1:2])).delta[:, 0]
    expected = expected - (K * (x - np.outer(e_psi, [0, 0, 1, 0]))).sum(axis=1)
    expected = prev + np.clip(np.clip(expected, -0.04, 0.04) - prev, -0.01, 0.01)
    np.testing.assert_allclose(delta, expected, atol=1e-12)


def test_states_that_no_vehicle_has_give_finite_commands() -> None:
    plant = Plant.build(BicycleModel(), [1.0, 20.0, 90.0, 20.0, 20.0], DT)
    x = np.array([[50, 40, 1.5, 9], [-50, 90, 1.57, -9], [1e6, 0, 0, 0], [np.nan, 0, 0, 0], [0, 1e200, 3.0, 0]])
    r = np.full((5, HORIZON + 1), 3.0)
    delta, state, status = first(NonlinearMPC(horizon=HORIZON, r_delta=100.0), plant, x, Preview(r, 0 * r), np.zeros(5))
    assert np.isfinite(delta).all()
    assert (np.abs(delta) <= 0.01 + 1e-15).all()
    assert status[3] == EventStatus.SOLVER_FAILED
    assert np.isfinite(state.U).all()
    # and the step after is not spoilt
    law = NonlinearMPC(horizon=HORIZON, r_delta=100.0).prepare(plant)
    again, _, status = law.step(np.zeros(5), np.zeros((5, 4)), Preview(0 * r, 0 * r), np.zeros(5), state)
    np.testing.assert_allclose(again, 0.0, atol=1e-7)
    assert (status == EventStatus.OK).all()


@pytest.mark.slow
def test_a_switch_takes_the_virtual_machine_and_commands_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    plant, x, preview, prev = situations(6, HORIZON, seed=1)
    designs = (
        NonlinearMPC(horizon=HORIZON, r_delta=100.0),
        NonlinearMPC(horizon=HORIZON, a_y_max=2.0, jerk_max=20.0, r_delta=100.0),
    )
    usual = [first(design, plant, x, preview, prev)[0] for design in designs]
    functions = solver_module._functions
    monkeypatch.setenv(casadi_code.CODE, "vm")
    monkeypatch.setattr(casadi_code.subprocess, "run", lambda *_, **__: pytest.fail("compiled"))
    monkeypatch.setattr(solver_module, "_functions", functions.__wrapped__)
    monkeypatch.setattr(solver_module, "_LOCAL", threading.local())
    for design, expected in zip(designs, usual, strict=True):
        np.testing.assert_allclose(first(design, plant, x, preview, prev)[0], expected, atol=1e-10)
    monkeypatch.setenv(casadi_code.CODE, "fast")
    with refused(casadi_code.CODE, value="fast", allowed={"auto", "vm"}):
        casadi_code.compiled((), "x")


def test_a_library_is_written_whole_or_not_at_all(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A compiler that writes half a file and fails leaves nothing, and the virtual machine serves."""
    monkeypatch.setenv(casadi_code.CACHE, str(tmp_path / "cache"))
    broken = tmp_path / "cc"
    broken.write_text('#!/bin/sh\nwhile [ "$1" != "-o" ]; do shift; done\necho half > "$2"\nexit 1\n')
    broken.chmod(0o755)
    function = ca.Function("f", [x := ca.SX.sym("x")], [2 * x])
    monkeypatch.setattr(casadi_code.shutil, "which", lambda _: str(broken))
    (same,) = casadi_code.compiled((function,), "half")
    assert same is function
    assert list((tmp_path / "cache").iterdir()) == []
    monkeypatch.undo()
    monkeypatch.setenv(casadi_code.CACHE, str(tmp_path / "cache"))
    (compiled,) = casadi_code.compiled((function,), "whole")
    assert float(compiled(3)) == 6.0
    if casadi_code.shutil.which("cc") is None:
        return
    assert compiled is not function
    (library,) = (tmp_path / "cache").iterdir()
    stamp = library.stat().st_mtime_ns
    casadi_code.compiled((function,), "whole")
    assert library.stat().st_mtime_ns == stamp  # not compiled again
    damaged = casadi_code._library((function,), "damaged")
    damaged.write_bytes(b"half")
    assert casadi_code.compiled((function,), "damaged")[0] is function
    assert not damaged.exists()
    (again,) = casadi_code.compiled((function,), "damaged")
    assert again is not function
    assert float(again(3)) == 6.0
