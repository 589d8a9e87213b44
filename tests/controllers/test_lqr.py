"""LQR, LQI and preview LQR."""

import dataclasses

import control
import numpy as np
import pytest

from helpers.closed_loop import DT, Stepped, grid, moved, some, weights_of
from helpers.errors import refused
from ldctoolkit import BicycleModel, Plant, Scenarios, Setup, VehicleParameters, load_model, simulate
from ldctoolkit.control import Controller, EventStatus, LinearLaw, Preview
from ldctoolkit.controllers import LQI, LQR, LinearMPC, PreviewLQR
from ldctoolkit.controllers.riccati import regulator
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Sensors
from ldctoolkit.simulation import Takeover, drive, drive_many

WEIGHTS = [
    {},
    {"q_y": 0.1, "q_y_rate": 0.5, "q_psi": 40.0, "q_psi_rate": 3.0, "r_delta": 3000.0},
    {"q_y": 30.0, "q_psi": 0.0, "r_delta": 5.0},
]
HEAVY = VehicleParameters(C_af=95000.0, C_ar=70000.0, l_f=1.2, l_r=1.5, m=1900.0, I_z=3600.0)
VEHICLES = [VehicleParameters(), HEAVY]


@pytest.mark.parametrize(("number", "vehicle"), grid(range(3), VEHICLES, (0, VEHICLES[0]), (1, HEAVY)))
@pytest.mark.parametrize("dt", some([0.05, 0.02], 0.05))
@pytest.mark.parametrize(("lag", "delay"), [(0.0, 0.0), (0.1, 0.1), (0.0, 0.12), (0.03, 0.01)])
def test_gains_equal_dlqr(number: int, vehicle: VehicleParameters, dt: float, lag: float, delay: float) -> None:
    """At speeds between the nodes, commands on their way among the states; the tolerance is dlqr's at these weights."""
    rng = np.random.default_rng(0)
    v = np.concatenate([[1.0, 90.0], np.exp(rng.uniform(np.log(1.0), np.log(90.0), 25))])
    plant = Plant.build(BicycleModel(vehicle), v, dt, lag=lag, delay=delay)
    A, B, _, _ = plant.augmented.with_commands()
    design = LQR(**WEIGHTS[number])
    law = design.prepare(plant)
    assert isinstance(law, LinearLaw)
    q = np.diag([design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate, *[0.0] * (A.shape[1] - 4)])
    P = regulator(plant, (design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate), design.r_delta).P
    steady = plant.steady_state()
    for i in range(v.size):
        K, P_i, _ = control.dlqr(A[i], B[i][:, None], q, np.array([[design.r_delta]]))
        np.testing.assert_allclose(-weights_of(law, i), K[0], rtol=1e-8, atol=1e-9)
        if lag + delay == 0.0:
            np.testing.assert_allclose(P[i], P_i, rtol=1e-8, atol=1e-8 * np.abs(P_i).max())
        held = np.array([0.0, 0.0, steady.e_psi[i], 0.0, *[steady.delta[i]] * (A.shape[1] - 4)])
        assert weights_of(law, i) @ held + law.G_yaw_rate[i, 0] == pytest.approx(steady.delta[i], abs=1e-12)


LATE = {
    "actuator": PlantOptions(actuator=Actuator(lag=0.1, delay=0.1)),
    "camera": PlantOptions(actuator=Actuator(lag=0.1), sensors=Sensors(delay=0.1)),
    "both": PlantOptions(actuator=Actuator(lag=0.1, delay=0.1), sensors=Sensors(delay=0.1)),
    "filter": PlantOptions(actuator=Actuator(lag=0.1, delay=0.1), sensors=Sensors(delay=0.1, kalman=KalmanFilter())),
}


@pytest.mark.parametrize(
    "design", [LQR(r_delta=100.0), LQI(r_delta=100.0), PreviewLQR(r_delta=100.0)], ids=lambda design: design.name
)
@pytest.mark.parametrize("case", some(LATE, "both"))
@pytest.mark.parametrize("n", some([100, 1000], 100))
def test_departures_do_not_diverge_behind_lag_and_delay(n: int, case: str, design: Controller) -> None:
    """Departures of the bundled model, n to each side; those that do not know diverge."""
    scenarios = load_model("reference").sample(n, n, seed=1)
    knows = simulate(design, scenarios, options=LATE[case])
    assert not (knows.status == EventStatus.DIVERGED).any()
    ideal = simulate(design, scenarios, options=LATE[case], plant_knowledge="ideal")
    assert (ideal.status == EventStatus.DIVERGED).any() or n < 1000
    assert knows.S.mean() < ideal.S.mean()


def test_speeds_outside_the_schedule_are_named() -> None:
    with refused("speed at the trigger", value=95.0):
        LQR(r_delta=100.0).prepare(Plant.build(BicycleModel(), [20.0, 95.0], DT))


def prepared(
    design: LQI | LQR, v: np.ndarray | list[float], dt: float = DT, **actuator: float
) -> tuple[Plant, LinearLaw]:
    plant = Plant.build(BicycleModel(), v, dt, **actuator)
    return plant, design.prepare(plant)


@pytest.mark.parametrize(("number", "dt"), grid(range(3), [0.05, 0.02], (0, 0.02), (1, 0.05)))
@pytest.mark.parametrize("actuator", [{}, {"lag": 0.1, "delay": 0.07}])
def test_scheduled_gains_equal_dlqr_on_the_augmented_plant(number: int, dt: float, actuator: dict[str, float]) -> None:
    """Written out as a last state, and by python-control's own integral action; the tolerance is dlqr's accuracy."""
    rng = np.random.default_rng(0)
    design = LQI(**WEIGHTS[number], **({}, {"q_i": 1e-3}, {"q_i": 20.0})[number])
    plant, law = prepared(design, np.r_[1.0, 90.0, np.exp(rng.uniform(0.0, np.log(90.0), 15))], dt, **actuator)
    assert law.f_i is not None
    states, inputs, _, _ = plant.augmented.with_commands()
    k = states.shape[1]
    Q = np.diag([design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate, *[0.0] * (k - 4), design.q_i])
    R = np.array([[design.r_delta]])
    offset = np.eye(1, k)
    for i in range(plant.n):
        A, B = states[i], inputs[i][:, None]
        augmented = np.block([[A, np.zeros((k, 1))], [dt * offset, np.ones((1, 1))]])
        K, _, E = control.dlqr(augmented, np.vstack([B, [[0.0]]]), Q, R)
        ours = np.append(weights_of(law, i), law.f_i[i])
        np.testing.assert_allclose(-ours, K[0], rtol=1e-8, atol=1e-9)
        assert np.abs(E).max() < 1.0
        plant_i = control.ss(A, B, np.eye(k), 0, dt)
        theirs, _, _ = control.dlqr(plant_i, Q, R, integral_action=dt * offset)
        np.testing.assert_allclose(-ours, theirs[0], rtol=1e-8, atol=1e-9)


def doubled(A: np.ndarray, B: np.ndarray, Q: np.ndarray, r: float) -> np.ndarray:
    """Gain by structure-preserving doubling (E. Chu, H. Fan, W. Lin, C. Wang, Int. J. Control 77, 2004)."""
    A_k, G, H = A, B @ B.T / r, Q
    for _ in range(60):
        W = np.linalg.inv(np.eye(A.shape[0]) + G @ H)
        A_k, G, H = A_k @ W @ A_k, G + A_k @ W @ G @ A_k.T, H + A_k.T @ H @ W @ A_k
    return ((B.T @ H @ A) / (r + B.T @ H @ B))[0]


@pytest.mark.parametrize(
    "design",
    [
        pytest.param(LQI(q_i=1e-6, q_y=1e6, r_delta=100.0), marks=pytest.mark.slow),
        LQI(q_y_rate=1e6, r_delta=100.0), LQR(q_y_rate=1e6, r_delta=100.0),
        pytest.param(LQR(q_psi=1e6, q_y=1e-3, r_delta=100.0), marks=pytest.mark.slow),
    ],
    ids=["q_y", "q_y_rate", "LQR q_y_rate", "LQR q_psi"],
)  # fmt: skip
def test_weights_that_are_far_apart_are_solved_too(design: LQI | LQR) -> None:
    """Where dlqr's own answers scatter; another method, at 1e-6 of each gain for its own rounding."""
    plant, law = prepared(design, [1.0, 7.0, 20.0, 33.0, 90.0])
    weights = [design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate]
    for i in range(plant.n):
        A, B = plant.step.A[i], plant.step.B[i][:, None]
        ours, Q = law.F[i], np.diag(weights)
        if isinstance(design, LQI):
            A = np.block([[A, np.zeros((4, 1))], [np.array([[DT, 0.0, 0.0, 0.0]]), np.ones((1, 1))]])
            B, ours, Q = np.vstack([B, [[0.0]]]), np.append(ours, law.f_i[i]), np.diag([*weights, design.q_i])
        np.testing.assert_allclose(-ours, doubled(A, B, Q, design.r_delta), rtol=1e-6)


def test_with_little_weight_on_the_integral_it_is_the_lqr() -> None:
    """The gains then differ by the order of sqrt(q_i/q_y), 1e-3 per second of the loop's time constant."""
    plant, law = prepared(LQI(q_i=1e-6, r_delta=100.0), [10.0, 20.0, 33.0])
    plain = LQR(r_delta=100.0).prepare(plant)
    np.testing.assert_allclose(law.F, plain.F, rtol=5e-3)
    np.testing.assert_allclose(law.G_yaw_rate, plain.G_yaw_rate, rtol=5e-3)
    steady = plant.steady_state()
    expected = steady.delta - law.F[:, 2] * steady.e_psi  # what holds a bend with e_y = 0 and an empty integral
    np.testing.assert_allclose(law.G_yaw_rate[:, 0], expected, rtol=1e-12)
    assert law.f_i is not None
    # the corner of the Riccati equation: K_i^2 (r + B'PB) = q_i, P tending to the LQR's
    P = regulator(plant, (1.0, 0.0, 1.0, 0.0), 100.0).P
    s = 100.0 + np.einsum("ni,nij,nj->n", plant.step.B, P, plant.step.B)
    np.testing.assert_allclose(law.f_i, -np.sqrt(1e-6 / s), rtol=1e-4)


def closed_loop(plant: Plant, law: LinearLaw, r: np.ndarray, steps: int) -> np.ndarray:
    """The state after a bend of lane yaw rate r, written out."""
    x, z = np.tile([0.9, 0.1, 0.02, 0.0], (plant.n, 1)), np.zeros(plant.n)
    for _ in range(steps):
        delta = (law.F * x).sum(axis=1) + law.G_yaw_rate[:, 0] * r
        if law.f_i is not None:
            delta += law.f_i * z
        z = z + plant.dt * x[:, 0]
        x = moved(plant, x, delta, r)
    return x


def test_a_bend_leaves_no_bias_of_the_integral_even_without_feedforward() -> None:
    """2 m/s^2 for two minutes: the slowest mode decays with about K_i/K_y, 0.2 1/s."""
    plant, law = prepared(LQI(r_delta=100.0), [8.0, 20.0, 33.0])
    plain = LQR(r_delta=100.0).prepare(plant)
    blind, both_blind = (dataclasses.replace(given, G_yaw_rate=np.zeros((3, 1))) for given in (law, plain))
    for without_bias in (law, blind, plain):
        np.testing.assert_allclose(closed_loop(plant, without_bias, 2.0 / plant.v, 2400)[:, 0], 0.0, atol=1e-9)
    assert (np.abs(closed_loop(plant, both_blind, 2.0 / plant.v, 2400)[:, 0]) > 0.1).all()


@pytest.mark.parametrize(
    "options",
    [
        PlantOptions(mismatch=Mismatch(m=(1.3, 1.3), C_af=(0.8, 0.8))),
        PlantOptions(sensors=Sensors(curvature_bias=5e-4)),
    ],
    ids=["another vehicle", "biased curvature"],
)
def test_errors_that_the_law_does_not_know_leave_no_bias(options: PlantOptions) -> None:
    """In the toolkit's own loop, at the end of a long constant bend; the LQR keeps a centimetre or more."""
    scenarios = Scenarios.from_arrays(T=[4.0, 4.0], d_y=[0.6, 0.5], v_mean=[16.0, 28.0], c_0=[4e-3, 2e-3])
    left = {}
    for design in (LQI(q_i=1.0, r_delta=100.0), LQR(r_delta=100.0)):
        out = simulate(design, scenarios, options=options, settle=50.0, trajectories=True)
        paths = out.trajectories
        last = np.isfinite(paths.t).sum(axis=1) - 1
        left[design.name] = np.abs(paths.x[np.arange(2), last, 0])
    assert (left["lqi"] < 1e-6).all()
    assert (left["lqr"] > 0.01).all()


YIELDS = {
    "nothing": PlantOptions(actuator=Actuator(delay=0.07)),
    "limit": PlantOptions(actuator=Actuator(delay=0.07, delta_max=0.01)),
    "grip": PlantOptions(actuator=Actuator(delay=0.07), driver=Driver(straight=0.5, against=0.5, return_after=0.3)),
    "arms": PlantOptions(driver=Driver(model="arms", straight=0.5, against=0.5, return_after=0.3)),
}


@pytest.mark.parametrize("name", YIELDS)
def test_the_integral_waits_in_the_compiled_loop_as_step_by_step(name: str) -> None:
    """Also beside designs that do not wait; where nothing yields it makes no difference to the bit."""
    plain, waiting = (LQI(q_i=0.5, r_delta=3000.0, conditioned=conditioned) for conditioned in (False, True))
    over = Takeover.build(load_model("reference").sample(30, 30, seed=1), Setup(options=YIELDS[name], seed=1), y_s=0.1)
    areas = []
    for design, run in zip((plain, waiting, plain), drive_many([plain, waiting, plain], over), strict=True):
        np.testing.assert_allclose(run.area, drive(Stepped(design), over).area, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(run.area, drive(design, over).area)
        areas.append(run.area)
    np.testing.assert_array_equal(areas[0], areas[2])
    assert ((areas[0] == areas[1]).all()) == (name == "nothing")
    assert np.abs(areas[1] - areas[0]).max() > 0.1 or name == "nothing"


DESIGNS = [
    PreviewLQR(r_delta=100.0),
    PreviewLQR(horizon=1, r_delta=100.0),
    PreviewLQR(horizon=7, q_y=0.1, q_y_rate=0.5, q_psi=40.0, q_psi_rate=3.0, r_delta=3000.0),
    PreviewLQR(horizon=12, q_y=30.0, q_psi=0.0, r_delta=5.0),
]


def weights(design: PreviewLQR) -> np.ndarray:
    return np.diag([design.q_y, design.q_y_rate, design.q_psi, design.q_psi_rate])


@pytest.mark.parametrize(("design", "vehicle"), grid(DESIGNS, VEHICLES, (DESIGNS[1], VEHICLES[0]), (DESIGNS[3], HEAVY)))
def test_gains_equal_the_recursion_on_the_register_of_yaw_rates(design: PreviewLQR, vehicle: VehicleParameters) -> None:
    """The problem as it is stated: states (x, r_0 .. r_N), the register shifts and holds its last entry, the cost is
    that of the deviations, no change of variables. Holding is an uncontrollable eigenvalue 1, at which solvers of the
    algebraic equation refuse, but the deviations of a held bend cost nothing, so the recursion from P = 0 converges. It
    is iterated until the slowest closed-loop mode (0.99 a sample at worst here) has decayed to rounding; 1e-9 of the
    largest gain covers what rounding 10,000 steps may add up to."""
    N = design.horizon
    plant = Plant.build(BicycleModel(vehicle), [9.0, 21.0, 34.0], DT)
    law = design.prepare(plant)
    steady, step = plant.steady_state(), plant.step
    for i in range(plant.n):
        size = 4 + N + 1
        A, B = np.zeros((size, size)), np.zeros((size, 1))
        A[:4, :4], B[:4, 0] = step.A[i], step.B[i]
        A[:4, 4], A[:4, 5] = step.E_0[i], step.E_1[i]
        A[4:-1, 5:] = np.eye(N)
        A[-1, -1] = 1.0
        x_dev = np.zeros((4, size))
        x_dev[:, :4] = np.eye(4)
        x_dev[2, 4] = -steady.e_psi[i]
        u_dev = np.zeros((1, size))
        u_dev[0, 4:6] = -0.5 * steady.delta[i]
        Q = x_dev.T @ weights(design) @ x_dev + design.r_delta * u_dev.T @ u_dev
        S, R = design.r_delta * u_dev.T, design.r_delta
        P = np.zeros((size, size))
        for _ in range(10_000):
            coupling = A.T @ P @ B + S
            following = Q + A.T @ P @ A - coupling @ coupling.T / (R + B.T @ P @ B)
            done = np.abs(following - P).max() <= 1e-14 * np.abs(P).max()
            P = following
            if done:
                break
        K = ((A.T @ P @ B + S).T / (R + B.T @ P @ B))[0]
        ours = np.concatenate([law.F[i], law.G_yaw_rate[i]])
        np.testing.assert_allclose(ours, -K, rtol=0, atol=1e-9 * np.abs(K).max())


@pytest.mark.parametrize(("lag", "delay"), [(0.0, 0.0), (0.1, 0.1), (0.0, 0.13), (0.07, 0.02)])
@pytest.mark.parametrize("design", some(DESIGNS[1:], DESIGNS[2]))
def test_gains_equal_dlqr_on_the_register_of_changes(design: PreviewLQR, lag: float, delay: float) -> None:
    """States: deviations from the bend as it is now, every command on its way among them, and its changes w_j = r_(j+1)
    - r_j until N samples after the command acts. Zeros are shifted in, so holding needs no marginal mode and
    python-control solves it. The tolerance is dlqr's own accuracy, as for the LQR."""
    v = np.exp(np.random.default_rng(1).uniform(np.log(2.0), np.log(80.0), 8))
    plant = Plant.build(BicycleModel(), v, DT, lag=lag, delay=delay)
    law, steady, whole = design.prepare(plant), plant.steady_state(), int(delay / DT)
    A, B, _, E_1 = plant.augmented.with_commands()
    k, M = B.shape[1], whole + design.horizon
    for i in range(plant.n):
        held = np.array([0.0, 0.0, steady.e_psi[i], 0.0, *[steady.delta[i]] * (k - 4)])
        # the command that costs nothing is that of the bend when it acts
        c = steady.delta[i] * ((np.arange(M) < whole) + 0.5 * (np.arange(M) == whole))
        full, Q = np.zeros((k + M, k + M)), np.zeros((k + M, k + M))
        full[:k, :k], full[:k, k:], full[k:-1, k + 1 :] = A[i], np.outer(B[i], c), np.eye(M - 1)
        full[:k, k] += E_1[i] - held
        Q[:4, :4] = weights(design)
        K, _, _ = control.dlqr(full, np.append(B[i], np.zeros(M))[:, None], Q, np.array([[design.r_delta]]))
        r = np.random.default_rng(i).normal(size=M + 1)
        s = np.random.default_rng(i + 100).normal(size=k)
        expected = steady.delta[i] * r[0] + c @ np.diff(r) - K[0] @ np.concatenate([s - held * r[0], np.diff(r)])
        assert weights_of(law, i) @ s + law.G_yaw_rate[i] @ r == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_a_camera_that_is_late_leaves_out_the_lane_before_now() -> None:
    plant = Plant.build(BicycleModel(), [25.0], DT, lag=0.1, delay=0.2)
    seen_now, late = (PreviewLQR(r_delta=100.0).prepare(dataclasses.replace(plant, age=age)) for age in (0.0, 0.1))
    np.testing.assert_allclose(late.preview_times, seen_now.preview_times[2:] - 0.1, atol=1e-15)
    np.testing.assert_array_equal(late.G_yaw_rate[:, 1:], seen_now.G_yaw_rate[:, 3:])
    np.testing.assert_allclose(late.G_yaw_rate[:, 0], seen_now.G_yaw_rate[:, :3].sum(axis=1), rtol=1e-12)


@pytest.mark.parametrize("horizon", some([1, 20, 100], 1, 20))
def test_it_is_the_linear_mpc_far_from_its_limits(horizon: int) -> None:
    """Limits so wide that none is near: the same command to rounding of sums of N terms."""
    rng = np.random.default_rng(horizon)
    plant = Plant.build(BicycleModel(), rng.uniform(7, 36, 30), DT)
    x = rng.normal(size=(30, 4)) * [0.2, 0.1, 0.01, 0.03]
    r = rng.normal(0, 0.02, (30, 1)) + rng.normal(0, 0.01, (30, 1)) * np.arange(horizon + 1) / horizon
    mpc = LinearMPC(horizon=horizon, q_psi=5.0, r_delta=300.0, delta_max=1.0, rate_max=10.0).prepare(plant)
    theirs, _, status = mpc.step(np.zeros(30), x, Preview(r, np.zeros_like(r)), np.zeros(30), mpc.init(30))
    law = PreviewLQR(horizon=horizon, q_psi=5.0, r_delta=300.0).prepare(plant)
    np.testing.assert_allclose(law.preview_times, mpc.preview_times, rtol=0, atol=0)
    np.testing.assert_array_equal(status, 0)
    np.testing.assert_allclose((law.F * x).sum(axis=1) + (law.G_yaw_rate * r).sum(axis=1), theirs, rtol=0, atol=1e-13)


def test_feedback_and_constant_bends_are_those_of_the_lqr() -> None:
    plant = Plant.build(BicycleModel(), [8.0, 20.0, 33.0], DT)
    law, plain = PreviewLQR(horizon=50, r_delta=100.0).prepare(plant), LQR(r_delta=100.0).prepare(plant)
    # gain alone and gain with cost have the same bits
    np.testing.assert_array_equal(law.F, plain.F)
    np.testing.assert_allclose(law.G_yaw_rate.sum(axis=1), plain.G_yaw_rate[:, 0], rtol=1e-12)


def cost(plant: Plant, design: PreviewLQR, law: LinearLaw, r: np.ndarray) -> np.ndarray:
    """The sum of the design's cost over a lane yaw rate r (steps + 1) that ends in a constant, from rest."""
    steady = plant.steady_state()
    x, total = np.zeros((plant.n, 4)), np.zeros(plant.n)
    ahead = law.preview_times.size
    held = np.concatenate([r, np.full(ahead, r[-1])])
    for k in range(r.size - 1):
        delta = (law.F * x).sum(axis=1) + law.G_yaw_rate @ held[k : k + ahead]
        z = x.copy()
        z[:, 2] -= steady.e_psi * r[k]
        u = delta - 0.5 * steady.delta * (r[k] + r[k + 1])
        total += np.einsum("ni,ij,nj->n", z, weights(design), z) + design.r_delta * u**2
        x = moved(plant, x, delta, r[k], np.full(plant.n, r[k + 1]))
    return total


def test_the_further_it_sees_the_less_a_bend_costs() -> None:
    """A bend that begins between two samples, 3 s ahead: held before and after, so every plan is right once it sees it.
    (Where curvature goes on changing, a short preview may do worse than none: it takes what it sees last to be held.)
    """
    plant = Plant.build(BicycleModel(), [12.0, 30.0], DT)
    r = np.where(np.arange(401) < 60, 0.0, 0.08)
    costs = [
        cost(plant, d, d.prepare(plant), r) for d in (PreviewLQR(horizon=N, r_delta=100.0) for N in (1, 3, 10, 30, 60))
    ]
    plain = cost(plant, PreviewLQR(r_delta=100.0), LQR(r_delta=100.0).prepare(plant), r)
    for shorter, longer in zip([plain, *costs], costs, strict=False):
        assert (longer < shorter).all()
    assert (costs[-1] < 0.5 * plain).all()


def test_in_the_closed_loop_it_is_the_mpc_without_limits() -> None:
    """Sums in another order over some hundred samples."""
    scenarios = Scenarios.from_arrays(T=[2.0, 4.0, 3.0], d_y=[0.4, 0.6, 0.5], v_mean=[14.0, 30.0, 22.0], c_0=1e-3)
    wide = LinearMPC(horizon=8, delta_max=1.0, rate_max=10.0, r_delta=100.0)
    linear, general = simulate(Stepped(PreviewLQR(horizon=8, r_delta=100.0)), scenarios), simulate(wide, scenarios)
    assert general.failed_solves.sum() == 0
    np.testing.assert_allclose(linear.S, general.S, rtol=1e-10)
