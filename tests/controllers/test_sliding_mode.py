"""Super-twisting: the implicit step by itself and against the differential equation, the sampled plant, the limit."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from controllers.sliding_mode import SlidingMode, SlidingModeLaw, conditioned, super_twisting
from helpers.sampled_plant import DT, closed_loop_matrices, moved, plant_at
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, VehicleParameters

OTHER = BicycleModel(VehicleParameters(m=1300.0, C_af=64000.0, C_ar=90000.0))


def command(
    law: SlidingModeLaw, x: np.ndarray, r: np.ndarray, r_next: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    preview = Preview(np.column_stack([r, r_next]), np.zeros((r.size, 2)))
    delta, w, status = law.step(np.zeros(r.size), x, preview, np.zeros(r.size), w)
    np.testing.assert_array_equal(status, EventStatus.OK)
    return delta, w


def sliding_variable(design: SlidingMode, plant: Plant, x: np.ndarray, r: np.ndarray) -> np.ndarray:
    """s as it is written: rate of the offset ahead plus lambda times that offset, about steady cornering."""
    e_psi = x[:, 2] - plant.steady_state().e_psi * r
    ahead = design.T_lp * plant.v
    return x[:, 1] + ahead * x[:, 3] + design.lambda_ * (x[:, 0] + ahead * e_psi)


@given(s=st.floats(-5, 5), w=st.floats(-5, 5), dt=st.floats(0.001, 0.5), k_1=st.floats(0.01, 5), k_2=st.floats(0.01, 5))
def test_the_implicit_step_solves_its_inclusion(s: float, w: float, dt: float, k_1: float, k_2: float) -> None:
    """y by bracketing where it is not zero, then w+ and u as they are written."""
    y = 0.0
    if abs(s) > dt**2 * k_2:
        size = brentq(lambda a: a + dt * k_1 * math.sqrt(a) + dt**2 * k_2 - abs(s), 0.0, 10.0, xtol=1e-15)
        y = math.copysign(size, s)
    g = math.copysign(1.0, s) if y else s / (dt**2 * k_2)
    w_next = w - dt * k_2 * g
    u = super_twisting(np.array([s]), np.array([w]), dt, k_1, k_2)
    assert dt * u[0] == pytest.approx(dt * w_next + y - s, abs=1e-11)
    assert conditioned(np.array([w]), u, dt, k_2)[0] == pytest.approx(w_next, abs=1e-11)


def test_small_samples_follow_the_differential_equation() -> None:
    """Levant's equations under a disturbance, integrated by solve_ivp until the surface is near; first order in dt."""
    k_1, k_2, dt = 1.5, 1.1, 1e-4
    path = solve_ivp(
        lambda t, y: [-k_1 * np.sqrt(abs(y[0])) * np.sign(y[0]) + y[1] + 0.4 * np.sin(t), -k_2 * np.sign(y[0])],
        (0.0, 0.8), [1.2, 0.3], rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    s, w = np.array([1.2]), np.array([0.3])
    for i in range(8000):
        u = super_twisting(s, w, dt, k_1, k_2)
        w = conditioned(w, u, dt, k_2)
        s = s + dt * (u + 0.4 * math.sin((i + 0.5) * dt))
    assert (s[0], w[0]) == (pytest.approx(path.y[0, -1], abs=3e-4), pytest.approx(path.y[1, -1], abs=3e-4))


def test_it_reaches_the_surface_and_does_not_chatter() -> None:
    """A disturbance of slope below k_2: |s| stays at slope dt^2 and u follows it; the explicit step chatters."""
    k_1, k_2, slope = 1.5, 1.1, 0.9
    paths = {}
    for kind in ("implicit", "explicit"):
        s, w, path = np.array([0.5]), np.zeros(1), []
        for i in range(400):
            if kind == "implicit":
                u = super_twisting(s, w, DT, k_1, k_2)
                w = conditioned(w, u, DT, k_2)
            else:
                u = -k_1 * np.sqrt(np.abs(s)) * np.sign(s) + w
                w = w - DT * k_2 * np.sign(s)
            disturbance = slope * math.sin((i + 0.5) * DT)
            s = s + DT * (u + disturbance)
            path.append([s[0], u[0]])
        paths[kind] = np.array(path)[200:]
    s, u = paths["implicit"].T
    assert np.abs(s).max() <= slope * DT**2 * (1 + 1e-9)
    assert np.abs(np.diff(u)).max() <= 2.0 * slope * DT
    assert np.abs(paths["explicit"][:, 0]).max() > 2 * np.abs(s).max()
    turns = {kind: (np.diff(np.sign(np.diff(path[:, 1]))) != 0).sum() for kind, path in paths.items()}
    assert turns["implicit"] <= 4  # 10 s of a sine
    assert turns["explicit"] > 50


def test_on_the_nominal_vehicle_the_next_s_is_s_plus_dt_u() -> None:
    """In a bend whose curvature changes; rounding only."""
    rng = np.random.default_rng(1)
    n = 20
    plant = plant_at(*rng.uniform(3, 45, n))
    design = SlidingMode(delta_max=1.0, k_1=1.0, k_2=0.4)
    x = rng.normal(size=(n, 4)) * [0.5, 0.2, 0.02, 0.05]
    r, r_next, w = rng.normal(0, 0.05, n), rng.normal(0, 0.05, n), rng.normal(0, 0.2, n)
    delta, w_next = command(design.prepare(plant), x, r, r_next, w)
    assert (np.abs(delta) < 1.0).all()
    s = sliding_variable(design, plant, x, r)
    u = super_twisting(s, w, DT, 1.0, 0.4)
    after = sliding_variable(design, plant, moved(plant, x, delta, r, r_next), r_next)
    np.testing.assert_allclose(after, s + DT * u, rtol=0, atol=1e-12)
    assert (np.abs(s) > DT**2 * 0.4).all()
    np.testing.assert_allclose(w_next, w - DT * 0.4 * np.sign(s), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("T_lp", "least"), [(0.3, 0.7), (0.0, 0.15)])
def test_zero_dynamics_are_damped_by_the_preview(T_lp: float, least: float) -> None:
    """Poles of the sampled loop under the equivalent control: 1 for s, exp(-lambda dt), two of the zero dynamics."""
    design = SlidingMode(T_lp=T_lp, k_1=0.0, k_2=0.0, delta_max=1.0)
    v = np.linspace(10, 40, 31)
    plant = plant_at(*v)
    law, zero = design.prepare(plant), np.zeros(v.size)
    loop = closed_loop_matrices(plant, lambda x: command(law, x, zero, zero, zero)[0])
    z = np.linalg.eigvals(loop)
    order = np.argsort(-np.abs(z), axis=1)
    z = np.take_along_axis(z, order, axis=1)
    np.testing.assert_allclose(z[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose(z[:, 1], np.exp(-1.5 * DT), atol=2e-3)
    s = np.log(z[:, 2:].astype(complex)) / DT
    damping = (-s.real / np.abs(s)).min()
    assert least < damping
    assert damping < 0.3 or T_lp > 0


def closed_loop(
    law: SlidingModeLaw, driven: Plant, x: np.ndarray, r: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Paths of e_y, delta, w."""
    w, path = law.init(r.size), []
    for _ in range(steps):
        delta, w = command(law, x, r, r, w)
        x = moved(driven, x, delta, r, r)
        path.append(np.array([x[:, 0], delta, w]))
    e_y, angle, integral = np.array(path).transpose(1, 0, 2)
    return e_y, angle, integral


def test_on_another_vehicle_w_takes_up_what_the_model_gets_wrong() -> None:
    known, other = plant_at(12.0, 20.0, 33.0), plant_at(12.0, 20.0, 33.0, model=OTHER)
    r = 2.0 / known.v
    design = SlidingMode()
    e_y, delta, w = closed_loop(design.prepare(known), other, np.tile([0.8, 0.0, 0.0, 0.0], (3, 1)), r, 1200)
    # what is left at the point ahead is the error of the nominal e_psi_ss
    left = -design.T_lp * known.v * (other.steady_state().e_psi - known.steady_state().e_psi) * r
    np.testing.assert_allclose(e_y[-1], left, atol=1e-6)
    assert (np.abs(w[-1]) > 0.05).all()
    np.testing.assert_allclose(delta[-1], other.steady_state().delta * r, atol=1e-7)
    assert np.abs(np.diff(delta[-200:], axis=0)).max() < 1e-6  # no chatter


def test_w_does_not_wind_up_at_the_limit() -> None:
    """Held off for 10 s at the limit, then let go. The plain algorithm goes by u before the limit and winds up."""
    plant, zero = plant_at(15.0), np.zeros(1)
    design = SlidingMode(delta_max=0.01, k_1=2.0, k_2=1.0, lambda_=0.4)
    law = design.prepare(plant)
    lowest = {}
    for guarded in (True, False):
        x, w, path = np.array([[2.0, 0.0, 0.0, 0.0]]), np.zeros(1), []
        for i in range(800):
            delta, w_next = command(law, x, zero, zero, w)
            if not guarded:
                s = sliding_variable(design, plant, x, zero)
                w_next = conditioned(w, super_twisting(s, w, DT, 2.0, 1.0), DT, 1.0)
            w = w_next
            if i < 200:
                assert i < 100 or delta[0] == -0.01
            else:
                x = moved(plant, x, delta, zero, zero)
            path.append(x[0, 0])
            # the largest u that the limit stands for
            assert not guarded or abs(w[0]) < 0.01 * law.cB[0] / DT + 0.5
        lowest[guarded] = min(path)
    assert lowest[True] > -0.2
    assert lowest[False] < -0.5
