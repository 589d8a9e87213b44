"""The sampled loop behind a review: against integration, the closed loop that studies run, and loops worked by hand."""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.closed_loop import Prepared
from ldctoolkit import BicycleModel, Controller, LinearLaw, Plant, Scenarios, simulate
from ldctoolkit.controllers import LQR, PreviewProportional
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Sensors
from ldctoolkit.review import review, review_plant
from ldctoolkit.review.law_model import (
    Camera,
    LawModel,
    Loop,
    System,
    controller_side,
    held_wheels,
    linear_view,
    sampled_vehicle,
)
from ldctoolkit.review.loop_numbers import _cameras, bandwidth, margins, poles

V = 27.0


@pytest.mark.parametrize("lag", [0.0, 0.13])
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.12])
def test_the_sampled_vehicle_is_the_continuous_one(lag: float, delay: float) -> None:
    """Random held commands through delay and lag, integrated numerically; tolerance: ten times the integrator's."""
    dt, K = 0.05, 8
    A, B, E = (matrix[0] for matrix in BicycleModel().matrices([V]))
    commands = np.random.default_rng(1).normal(0, 0.02, K)
    r = 0.07

    def command(t: float) -> float:
        k = math.floor((t - delay) / dt)
        return float(commands[k]) if 0 <= k < K else 0.0

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        delta = s[4] if lag else command(t)
        return np.append(A @ s[:4] + B * delta + E * r, (command(t) - s[4]) / lag if lag else 0.0)

    # one piece between two jumps, a little inside so that each piece sees one command
    ends = np.unique(np.round(np.concatenate([np.arange(K + 1) * dt, np.arange(K + 1) * dt + delay]), 12))
    ends = ends[ends <= K * dt + 1e-9]
    s, path = np.zeros(5), [np.zeros(4)]
    for a, b in itertools.pairwise(ends):
        middle = 0.5 * (a + b)
        s = solve_ivp(lambda t, y, m=middle: rate(m, y), (a, b), s, rtol=1e-11, atol=1e-13).y[:, -1]
        if abs(b / dt - round(b / dt)) < 1e-9:
            path.append(s[:4].copy())
    vehicle = sampled_vehicle(A, B, E, dt, Actuator(lag=lag, delay=delay))
    state = np.zeros(vehicle.A.shape[0])
    for k in range(K):
        state = vehicle.A @ state + vehicle.B @ [commands[k], r]
        np.testing.assert_allclose(vehicle.C[:4] @ state, path[k + 1], rtol=1e-9, atol=1e-11)


PLANTS = {
    "ideal": PlantOptions(),
    "actuator": PlantOptions(actuator=Actuator(lag=0.08, delay=0.07)),
    "camera": PlantOptions(actuator=Actuator(lag=0.08), sensors=Sensors(delay=0.1)),
    "filter": PlantOptions(actuator=Actuator(delay=0.03), sensors=Sensors(delay=0.05, kalman=KalmanFilter())),
    "frames between samples": PlantOptions(sensors=Sensors(fps=40, delay=0.08, kalman=KalmanFilter())),
}


def remembering(r_delta: float) -> Controller:
    """An LQR with a weight on its previous command and one on the integral of e_y."""

    def prepare(plant: Plant) -> LinearLaw:
        law = LQR(r_delta=r_delta).prepare(plant)
        return dataclasses.replace(law, f_u=np.full(plant.n, 0.3), f_i=np.full(plant.n, -0.02))

    return Prepared(prepare)


def loop_of(
    design: Controller, options: PlantOptions, v: float, dt: float = 0.05, driver: Driver | None = None
) -> Loop:
    plant = review_plant(BicycleModel(), dt, options, [v])
    A, B, E = plant.model.matrices(plant.v)
    view = linear_view(design, plant)
    side = controller_side(view.models[0], _cameras(plant, options)[0])
    arms = None if driver is None else held_wheels(driver)[0][1]
    return Loop.of(sampled_vehicle(A[0], B[0], E[0], dt, options.actuator, arms), side)


@pytest.mark.parametrize("kind", [LQR, remembering])
@pytest.mark.parametrize("name", PLANTS)
def test_the_closed_loop_of_studies_has_these_poles(name: str, kind: Callable[..., Controller]) -> None:
    """Once start effects have left the registers, e_y obeys the recursion of the characteristic polynomial. Tolerance:
    what the Runge-Kutta loop misses, of a sum whose largest term is a binomial of the polynomial's degree (6 to 17)
    times e_y."""
    design, options = kind(r_delta=300.0), PLANTS[name]
    straight = Scenarios.from_arrays(T=[4.0], d_y=[0.5], v_mean=[V])
    run = simulate(design, straight, y_s=0.2, options=options, trajectories=True, settle=2.0)
    path = run.trajectories
    e_y = path.x[0, :, 0]
    samples = np.abs((path.t[0] - path.t[0, 0]) / 0.05 % 1.0 - 0.5) > 0.5 - 1e-6  # T and the end are no samples
    e_y = e_y[samples & np.isfinite(e_y)]
    polynomial = np.poly(loop_of(design, options, V).closed_A)
    tail = e_y[8:]
    residual = np.convolve(tail, polynomial, mode="valid")
    assert residual.size > 20
    scale = np.convolve(np.abs(tail), np.abs(polynomial), mode="valid").max()
    assert np.abs(residual).max() < 2e-10 * scale
    other = np.poly(loop_of(kind(r_delta=390.0), options, V).closed_A)
    assert np.abs(np.convolve(tail, other, mode="valid")).max() > 1e-9 * scale


GRIP = Driver(straight=1.0, grip=(0.3, 0.6), arm_lag=0.12, torque_max=100.0, override_torque=100.0)
ARMS = Driver(
    model="arms", straight=1.0, stiffness=(15.0, 45.0), damping=1.1, inertia=0.08, assist_stiffness=50.0,
    assist_damping=3.0, wheel_inertia=0.07, wheel_damping=0.5, torque_max=100.0, override_torque=100.0,
)  # fmt: skip


@pytest.mark.parametrize("driver", [GRIP, ARMS], ids=lambda driver: driver.model)
@pytest.mark.parametrize("actuator", [Actuator(), Actuator(lag=0.08, delay=0.07)], ids=["ideal", "late"])
def test_the_loop_with_arms_is_that_of_studies(driver: Driver, actuator: Actuator) -> None:
    """As above, with a driver who holds the wheel still: what he means is constant, and a factor z - 1 takes it out.
    Tolerance: that of the steps of the column and its aligning torque."""
    field = "grip" if driver.model == "grip" else "stiffness"
    straight = Scenarios.from_arrays(T=[4.0], d_y=[0.5], v_mean=[V])
    design = LQR(r_delta=3000.0)
    lower, upper = (dataclasses.replace(driver, **{field: (end, end)}) for end in getattr(driver, field))
    options = PlantOptions(actuator=actuator, driver=upper)
    run = simulate(design, straight, y_s=0.2, options=options, trajectories=True, settle=2.0)
    assert run.metrics.overridden[0] == 0
    path = run.trajectories
    samples = np.abs((path.t[0] - path.t[0, 0]) / 0.05 % 1.0 - 0.5) > 0.5 - 1e-6
    e_y = path.x[0, :, 0]
    tail = e_y[samples & np.isfinite(e_y)][8:]
    residuals = []
    for held in (upper, lower):
        polynomial = np.poly(np.append(np.linalg.eigvals(loop_of(design, options, V, driver=held).closed_A), 1.0)).real
        residual = np.convolve(tail, polynomial, mode="valid")
        assert residual.size > 20
        scale = np.convolve(np.abs(tail), np.abs(polynomial), mode="valid").max()
        residuals.append(float(np.abs(residual).max() / scale))
    assert residuals[0] < 1e-10, residuals
    assert residuals[1] > 100 * residuals[0], residuals


@pytest.mark.parametrize("driver", [GRIP, ARMS], ids=lambda driver: driver.model)
@pytest.mark.parametrize("end", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_margins_with_arms_are_those_of_python_control(driver: Driver, end: int) -> None:
    """The chain as transfer functions, sampled and closed by python-control; tolerance: its grid of frequencies."""
    dt, design = 0.05, PreviewProportional(K_y=-0.004, K_psi=-0.15, T_lp=2.0)
    options = PlantOptions(actuator=Actuator(lag=0.1, delay=0.1), driver=driver)
    name, numbers = review(design, options=options, speeds=[V]).held[end]
    d, g, k = driver, driver.grip[end], driver.stiffness[end]
    if driver.model == "grip":
        arms = control.tf([1.0 - g], [g * d.arm_lag, 1.0])
        assert name == f"arms {('relaxed', 'tensed')[end]} (g = {g:g})"
    else:
        damping = d.wheel_damping + d.assist_damping + d.damping
        arms = control.tf([d.assist_stiffness], [d.wheel_inertia + d.inertia, damping, d.assist_stiffness + k])
        assert name == f"arms {('relaxed', 'tensed')[end]} (k = {k:g} N m/rad)"
    A, B, _ = (matrix[0] for matrix in BicycleModel().matrices([V]))
    F = np.array([[-0.004, 0.0, -0.15, 0.0]])
    chain = control.ss(control.tf([1.0], [0.1, 1.0]) * arms)
    continuous = control.ss(A, B[:, None], -F, 0.0) * chain
    L = control.sample_system(continuous, dt) * control.ss(control.tf([1.0], [1.0, 0.0, 0.0], dt))
    omega = np.geomspace(1e-2, math.pi / dt, 20001)
    gain, phase, *_ = control.stability_margins(control.FRD(L(np.exp(1j * omega * dt)), omega, smooth=True))
    assert numbers.gain_margin[0] == pytest.approx(20.0 * math.log10(gain), abs=1e-3)
    assert numbers.phase_margin[0] == pytest.approx(math.radians(phase), abs=1e-4)
    s = np.log(control.feedback(L, 1).poles().astype(complex)) / dt
    s = s[np.abs(np.exp(s * dt)) >= 0.5]
    assert numbers.damping[0] == pytest.approx((-s.real / np.abs(s)).min(), rel=1e-6)
    assert numbers.slowest[0] == pytest.approx((-1.0 / s.real).max(), rel=1e-6)
    size = np.abs(continuous(1j * omega))
    assert numbers.bandwidth[0] == pytest.approx(omega[np.flatnonzero(size >= 1.0)[-1]], rel=2e-3)


def test_arms_that_leave_nothing_or_all_to_the_assist_have_no_loop() -> None:
    def arms(**given: Any) -> list[str]:
        return [name for name, _ in held_wheels(Driver(**given))]

    assert arms() == arms(recorded=1.0, grip=(1.0, 1.0)) == arms(recorded=1.0, grip=(0.0, 0.0)) == []
    assert arms(recorded=1.0, grip=(0.0, 0.3)) == arms(recorded=1.0, grip=(0.3, 0.3)) == ["arms (g = 0.3)"]
    assert arms(recorded=1.0, model="arms", stiffness=(0.0, 40.0)) == [
        "arms relaxed (k = 0 N m/rad)", "arms tensed (k = 40 N m/rad)"
    ]  # fmt: skip


def integrator(k: float, h: float) -> System:
    """L(z) = k h/(z (z - 1)): an integrator behind one sample of delay."""
    return System(np.array([[1.0, h], [0.0, 0.0]]), np.array([[0.0], [k]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)))


@pytest.mark.parametrize("k", [1.0, 3.0, 9.9])
def test_margins_of_an_integrator_with_a_delay(k: float) -> None:
    """By hand: |L| = k h/(2 sin(w h/2)), arg L = -90 deg - 3 w h/2; so GM = 1/(k h), PM = 90 deg - 3 w_c h/2.
    With k = 9.9 it is stable by 1 % of gain: its smallest disk margin lies between two frequencies of a coarse grid."""
    h = 0.1
    result = margins(integrator(k, h), h)
    w_c = 2.0 / h * math.asin(k * h / 2.0)
    PM = math.pi / 2.0 - 1.5 * w_c * h
    assert result.gain == pytest.approx(20 * math.log10(1.0 / (k * h)), rel=1e-9)
    assert (result.gain_reduction, result.crossover) == (math.inf, pytest.approx(w_c, rel=1e-9))
    assert (result.phase, result.delay) == (pytest.approx(PM, rel=1e-9), pytest.approx(PM / w_c, rel=1e-9))
    # disk margin: 1/max |S - 1/2| = 2 min |1 + L|/|1 - L|, on a fine grid of its own
    z = np.exp(1j * np.linspace(1e-3, math.pi, 2_000_001))
    L = k * h / (z * (z - 1.0))
    assert result.disk == pytest.approx(float((2.0 * np.abs(1 + L) / np.abs(1 - L)).min()), rel=1e-6)


def test_a_crossing_at_the_nyquist_frequency_counts() -> None:
    """L = k h/(z - 1) gets real and negative only there: GM = 2/(k h)."""
    h, k = 0.1, 5.0
    result = margins(System(np.eye(1), np.array([[k * h]]), np.eye(1), np.zeros((1, 1))), h)
    assert result.gain == pytest.approx(20 * math.log10(2.0 / (k * h)), rel=1e-9)


def test_a_conditionally_stable_loop_has_a_reduction_margin() -> None:
    """PI on an unstable pole: L = g (z - b)/((z - 1)(z - a)), a > 1, is stable for gains between two bounds only.
    Characteristic polynomial z^2 + (g - 1 - a) z + a - g b: Jury asks a - g b < 1 and 2 + 2 a > g (1 + b)."""
    a, b, g = 1.2, 0.9, 1.0
    A = np.array([[1.0 + a, -a], [1.0, 0.0]])
    result = margins(System(A, np.array([[1.0], [0.0]]), g * np.array([[1.0, -b]]), np.zeros((1, 1))), 0.1)
    assert result.gain_reduction == pytest.approx(20 * math.log10(g / ((a - 1) / b)), abs=1e-3)
    assert result.gain == pytest.approx(20 * math.log10((2 + 2 * a) / (1 + b) / g), abs=1e-3)


@pytest.mark.parametrize(("radius", "angle", "g"), [(0.95, 0.8, -0.1), (0.98, 0.5, -0.05), (0.97, 0.6, -0.2)])
def test_a_delay_margin_is_the_delay_that_makes_the_loop_unstable(radius: float, angle: float, g: float) -> None:
    """L = g/(z^2 - 2 a z + b), positive feedback of a resonance: at the lower crossing its phase leads, and a delay has
    to turn it nearly once around. Delays of whole samples, by the roots of z^d (z^2 - 2 a z + b) + g."""
    h, denominator = 0.1, [1.0, -2.0 * radius * math.cos(angle), radius**2]
    A = np.array([[-denominator[1], -denominator[2]], [1.0, 0.0]])
    result = margins(System(A, np.array([[1.0], [0.0]]), np.array([[0.0, g]]), np.zeros((1, 1))), h)
    d = 0
    while np.abs(np.roots(np.polyadd(denominator + [0.0] * d, [g]))).max() < 1.0:
        d += 1
    assert (d - 1) * h < result.delay < d * h


@pytest.mark.filterwarnings("error")
def test_margins_of_random_loops_are_those_of_a_fine_grid() -> None:
    """Among them loops without a crossing, of which nothing but the disk margin is finite."""
    rng, dt, without, count = np.random.default_rng(0), 0.05, 0, 0
    z = np.exp(1j * np.linspace(1e-3 * dt, math.pi, 50_001))
    while count < 30:
        k, g = int(rng.integers(1, 9)), 10.0 ** rng.uniform(-1.0, 0.5)
        A, B, C = rng.normal(size=(k, k)), g * rng.normal(size=(k, 1)), rng.normal(size=(1, k))
        A *= rng.uniform(0.3, 1.02) / np.abs(np.linalg.eigvals(A)).max()
        if np.abs(np.linalg.eigvals(A - B @ C)).max() > 0.999:
            continue
        result = margins(System(A, B, C, np.zeros((1, 1))), dt)
        L = (C @ np.linalg.solve(z[:, None, None] * np.eye(k) - A, B[None].astype(complex)))[:, 0, 0]
        real, unit = np.flatnonzero(np.diff(np.sign(L.imag))), np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
        at = np.append(L.real[real], L.real[-1])
        factors = -20.0 * np.log10(-at[at < 0.0])
        assert result.gain == pytest.approx(factors[factors > 0.0].min(initial=math.inf), abs=0.02)
        assert result.gain_reduction == pytest.approx((-factors[factors <= 0.0]).min(initial=math.inf), abs=0.02)
        assert result.phase == pytest.approx(np.abs(np.angle(-L[unit])).min(initial=math.inf), abs=5e-3)
        assert result.disk == pytest.approx((2.0 * np.abs(1.0 + L) / np.abs(1.0 - L)).min(), rel=1e-3)
        without, count = without + (unit.size == 0), count + 1
    assert 5 < without < 25


def test_no_loop_has_no_bounds() -> None:
    result = margins(System(np.eye(1), np.zeros((1, 1)), np.eye(1), np.zeros((1, 1))), 0.1)
    assert (result.gain, result.phase, result.delay) == (math.inf,) * 3


def test_poles_are_those_that_the_continuous_ones_sample() -> None:
    dt, s = 0.05, complex(-0.8, 3.0)
    angle = s.imag * dt
    closed = math.exp(s.real * dt) * np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    result = poles(closed, dt)
    assert result.stable
    assert result.damping == pytest.approx(-s.real / abs(s), rel=1e-12)
    assert result.slowest == pytest.approx(1 / 0.8, rel=1e-9)
    assert not poles(np.diag([1.0, 0.5]), dt).stable
    assert not poles(np.diag([-1.01, 0.5]), dt).stable
    assert poles(np.zeros((2, 2)), dt).slowest == 0.0


def test_the_bandwidth_is_that_of_the_loop_before_sampling() -> None:
    """Feedback of the yaw rate alone on a plant with one integrator: K b/w = 1 at w = K b, here beyond Nyquist."""
    dt, b, K = 0.5, 20.0, 2.0
    A, B = np.zeros((4, 4)), np.array([0.0, 0.0, 0.0, b])
    D = np.array([0.0, 0.0, 0.0, -K, 0.0, 0.0, 0.0])
    law = LawModel(np.zeros((0, 0)), np.zeros((0, 7)), np.zeros(0), D)
    side = controller_side(law, Camera(0, 0, None, Plant.build(BicycleModel(), [V], dt).augmented))
    assert bandwidth(A, B, 0.0, side, dt) == pytest.approx(K * b, rel=1e-5)
    lagged = bandwidth(A, B, 0.1, side, dt)  # K b = w sqrt(1 + (w/10)^2)
    assert lagged * math.hypot(1.0, 0.1 * lagged) == pytest.approx(K * b, rel=1e-5)
    assert bandwidth(A, 0 * B, 0.0, side, dt) == 0.0


def test_what_is_seen_between_samples_is_linear() -> None:
    options = PlantOptions(sensors=Sensors(period=0.1, delay=0.07))  # frames are seen twice, 0.1 and 0.15 s old
    camera = _cameras(review_plant(BicycleModel(), 0.05, options, [V]), options)[0]
    assert (camera.delay, camera.age) == (pytest.approx(2.5), pytest.approx(2.0))
    D = np.array([-0.02, 0.0, -0.3, 0.0, 0.0, 0.0, -0.2])
    law = LawModel(np.zeros((0, 0)), np.zeros((0, 7)), np.zeros(0), D)
    step, z = Plant.build(BicycleModel(), [V], 0.05).augmented, np.exp(1j * np.array([0.1, 1.0, 3.0]))
    whole = [controller_side(law, Camera(k, k, None, step)).response(z) for k in range(3)]
    half = controller_side(law, Camera(0.5, 1.25, None, step)).response(z)
    np.testing.assert_allclose(half[..., [0, 2]], 0.5 * (whole[0] + whole[1])[..., [0, 2]], atol=1e-15)
    np.testing.assert_allclose(half[..., 4], (0.75 * whole[1] + 0.25 * whole[2])[..., 4], atol=1e-15)


def settled(design: Controller, options: PlantOptions) -> float:
    """e_y a long time after a bend of constant curvature began, from the closed loop that studies run."""
    bend = Scenarios.from_arrays(T=[4.0], d_y=[0.5], v_mean=[V], c_0=[2.0 / V**2])
    run = simulate(design, bend, y_s=0.2, options=options, trajectories=True, settle=40.0)
    return float(run.trajectories.x[0, -1, 0])


@pytest.mark.parametrize("design", [LQR(r_delta=1000.0), PreviewProportional()], ids=lambda d: d.name)
def test_bends_are_those_of_the_closed_loop(design: Controller) -> None:
    """Nominal, and the worst of four simulated vehicles; tolerance: the rest of the transient, e^-20 and less."""
    actuator = Actuator(lag=0.05, delay=0.03)
    reviewed = review(design, options=PlantOptions(actuator=actuator), speeds=[V]).loop
    assert reviewed.e_y_bend[0] == pytest.approx(settled(design, PlantOptions(actuator=actuator)), abs=1e-7)
    corners = [
        settled(design, PlantOptions(actuator=actuator, mismatch=Mismatch(C_af=(f, f), C_ar=(r, r))))
        for f in (0.8, 1.2)
        for r in (0.8, 1.2)
    ]
    assert reviewed.e_y_bend_mismatched[0] == pytest.approx(max(corners, key=abs), abs=1e-7)
