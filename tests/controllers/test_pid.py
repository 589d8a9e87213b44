"""PID and sliding mode."""

import dataclasses
import math
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from helpers.closed_loop import DT, Stepped, closed_loop_matrices, continuous_poles, moved, plant_at
from ldctoolkit import BicycleModel, EventStatus, Plant, Preview, Scenarios, VehicleParameters, simulate
from ldctoolkit.control import Controller, LinearLaw
from ldctoolkit.controllers.barrier_filter import BarrierFilter, inner_design, steering_law
from ldctoolkit.controllers.pid import PID, PIDLaw
from ldctoolkit.controllers.sliding_mode import SlidingMode, SlidingModeLaw, conditioned, super_twisting

OTHER = BicycleModel(VehicleParameters(m=1300.0, C_af=64000.0, C_ar=90000.0))

SOME = Scenarios.from_arrays(
    T=[2.5, 6.0, 4.0, 5.0], d_y=[0.4, 0.7, 0.6, 0.9], v_mean=[11.0, 18.0, 27.0, 38.0], c_0=[1e-3, -2e-3, 0.0, 5e-4]
)


def lane(r: np.ndarray) -> Preview:
    return Preview(r[:, None], np.zeros((r.size, 1)))


def command(law: PIDLaw, x: np.ndarray, r: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    delta, state, status = law.step(np.zeros(r.size), x, lane(r), np.zeros(r.size), state)
    np.testing.assert_array_equal(status, EventStatus.OK)
    return delta, state


def closed_loop(
    design: PID, driven: Plant, x: np.ndarray, r: np.ndarray, steps: int, known: Plant | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Paths of e_y and of the integral on the sampled plant; `known` is the plant that the law is prepared for."""
    law = design.prepare(known or driven)
    state, e_y, integral = law.init(r.size), [], []
    for _ in range(steps):
        delta, state = command(law, x, r, state)
        x = moved(driven, x, delta, r)
        e_y.append(x[:, 0])
        integral.append(state)
    return np.array(e_y), np.array(integral)


def test_two_steps_by_hand() -> None:
    """The formula in plain arithmetic; rounding only."""
    design = PID(K_p=-0.01, K_i=-0.002, K_d=-0.003, T_lp=1.5, T_t=2.0, delta_max=0.03)
    v, r = 20.0, 0.02
    plant = plant_at(v)
    law = design.prepare(plant)
    # steady cornering from the formulas of Rajamani's section 3.2, per unit of yaw rate
    p = VehicleParameters()
    L = p.l_f + p.l_r
    delta_ss = L / v + p.m * v / L * (p.l_r / (2 * p.C_af) - p.l_f / (2 * p.C_ar))
    e_psi_ss = -p.l_r / v + p.l_f * p.m * v / (2 * p.C_ar * L)
    e_y, e_y_rate, e_psi, e_psi_rate = 0.8, -0.1, 0.01, 0.04

    e_p = e_y + 1.5 * 20.0 * (e_psi - e_psi_ss * r)
    e_p_rate = e_y_rate + 1.5 * 20.0 * e_psi_rate
    u = -0.01 * e_p - 0.003 * e_p_rate + delta_ss * r
    x = np.array([[e_y, e_y_rate, e_psi, e_psi_rate]])
    delta, state = command(law, x, np.array([r]), law.init(1))
    assert delta[0] == pytest.approx(u, abs=1e-15)
    assert abs(u) < 0.03
    assert state[0] == pytest.approx(-0.002 * e_p * DT, abs=1e-15)

    x[0, 0] = 6.0  # far beyond the limit
    e_p += 5.2
    u = -0.01 * e_p + state[0] - 0.003 * e_p_rate + delta_ss * r
    delta, after = command(law, x, np.array([r]), state)
    assert u < -0.03
    assert delta[0] == -0.03
    expected = state[0] - 0.002 * e_p * DT + (1 - math.exp(-DT / 2.0)) * (-0.03 - u)
    assert after[0] == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("filtered", [False, True])
def test_the_integral_waits_where_the_assist_yields(filtered: bool) -> None:
    """PID, LQI and a filter around them: no wind-up of the offset; back-calculation goes on; only on request."""
    plant, x = plant_at(20.0, 20.0, 30.0), np.tile([0.4, 0.0, 0.001, 0.0], (3, 1))
    yielding = np.array([True, False, True])
    for name, gains in (("pid", "K_i=-0.002, T_t=2, delta_max=0.001"), ("lqi", "q_i=0.3")):
        for conditions in (True, False):
            text = f"{gains}, conditioned=true" if conditions else gains
            filter_ = BarrierFilter(inner=name, inner_gains=text, e_y_max=9.0)
            inner = inner_design(name, text, BarrierFilter)
            law = steering_law(filter_ if filtered else inner, plant, "test")
            nothing = np.zeros((3, law.preview_times.size))
            state = law.init(3)
            for _ in range(4):
                _, state, _ = law.step(np.zeros(3), x, Preview(nothing, nothing, yielding=yielding), x[:, 1], state)
            integral = state if name == "pid" else state[0]
            expected = np.where(yielding & conditions, 0.0, 4 * DT * 0.4)
            if name == "pid":
                assert isinstance(inner, PID)
                e_p, share = 0.4 + 1.5 * plant.v * 0.001, -math.expm1(-DT / 2.0)
                expected = np.zeros(3)
                for _ in range(4):
                    excess = -0.006 * e_p + expected + 0.001  # of the command beyond the limit
                    expected = expected + np.where(yielding & conditions, 0.0, DT * -0.002 * e_p) - share * excess
            np.testing.assert_allclose(integral, expected, rtol=1e-12, atol=1e-15)


def test_default_gains_damp_every_pole_from_10_to_40_m_per_s() -> None:
    """Eigenvalues of the sampled loop with the integral; the law's own derivatives are taken from its commands."""
    v = np.linspace(10, 40, 31)
    plant = plant_at(*v)
    law = PID(K_p=-0.015).prepare(plant)
    loop = np.zeros((v.size, 5, 5))
    small = 1e-4
    for i in range(5):
        x, state = np.zeros((v.size, 4)), np.zeros(v.size)
        if i < 4:
            x[:, i] = small
        else:
            state += small
        delta, after = command(law, x, np.zeros(v.size), state)
        loop[:, :4, i] = moved(plant, x, delta) / small
        loop[:, 4, i] = after / small
    poles = continuous_poles(loop)
    assert (poles.real < -0.05).all()
    assert (-poles.real / np.abs(poles)).min() > 0.5


def test_a_steady_bend_needs_no_integral() -> None:
    plant = plant_at(8.0, 20.0, 33.0)
    r = 2.0 / plant.v  # 2 m/s^2
    x = np.zeros((3, 4))
    x[:, 2] = plant.steady_state().e_psi * r
    e_y, integral = closed_loop(PID(K_p=-0.015), plant, x, r, 200)
    np.testing.assert_allclose(e_y, 0.0, atol=1e-12)
    np.testing.assert_allclose(integral, 0.0, atol=1e-12)


def test_on_another_vehicle_the_integral_takes_the_offset_out() -> None:
    """Down to what the error of e_psi_ss leaves at the preview point."""
    known, other = plant_at(20.0, 33.0), plant_at(20.0, 33.0, model=OTHER)
    r, x = 2.0 / known.v, np.zeros((2, 4))
    with_i, _ = closed_loop(PID(K_p=-0.015), other, x, r, 4000, known)
    without, _ = closed_loop(PID(K_i=0.0, K_p=-0.015), other, x, r, 4000, known)
    left = -1.5 * known.v * (other.steady_state().e_psi - known.steady_state().e_psi) * r
    np.testing.assert_allclose(with_i[-1], left, atol=1e-6)
    assert (np.abs(with_i[-1]) < 0.5 * np.abs(without[-1])).all()


def test_back_calculation_bounds_the_integral() -> None:
    """A minute at the limit: I rests where both rates cancel; with next to no back-calculation it winds up."""
    x = np.array([[4.0, 0.0, 0.0, 0.0]])
    ends = {}
    for T_t in (1.0, 1e3):
        law = PID(K_i=-0.01, T_t=T_t, delta_max=0.02, K_p=-0.015).prepare(plant_at(20.0))
        state = law.init(1)
        for _ in range(1200):
            delta, state = command(law, x, np.zeros(1), state)
            assert delta[0] == -0.02
        ends[T_t] = state[0]
    # K_i e_p dt = share (u - delta) with u = K_p e_p + I
    rest = -0.02 + 0.015 * 4.0 - 0.01 * 4.0 * DT / (1 - math.exp(-DT))
    assert ends[1.0] == pytest.approx(rest, abs=1e-12)
    assert ends[1e3] < -1.0


def command_sliding_mode(
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
    delta, w_next = command_sliding_mode(design.prepare(plant), x, r, r_next, w)
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
    loop = closed_loop_matrices(plant, lambda x: command_sliding_mode(law, x, zero, zero, zero)[0])
    z = np.linalg.eigvals(loop)
    order = np.argsort(-np.abs(z), axis=1)
    z = np.take_along_axis(z, order, axis=1)
    np.testing.assert_allclose(z[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose(z[:, 1], np.exp(-1.5 * DT), atol=2e-3)
    s = np.log(z[:, 2:].astype(complex)) / DT
    damping = (-s.real / np.abs(s)).min()
    assert least < damping
    assert damping < 0.3 or T_lp > 0


def closed_loop_sliding_mode(
    law: SlidingModeLaw, driven: Plant, x: np.ndarray, r: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Paths of e_y, delta, w."""
    w, path = law.init(r.size), []
    for _ in range(steps):
        delta, w = command_sliding_mode(law, x, r, r, w)
        x = moved(driven, x, delta, r, r)
        path.append(np.array([x[:, 0], delta, w]))
    e_y, angle, integral = np.array(path).transpose(1, 0, 2)
    return e_y, angle, integral


def test_on_another_vehicle_w_takes_up_what_the_model_gets_wrong() -> None:
    known, other = plant_at(12.0, 20.0, 33.0), plant_at(12.0, 20.0, 33.0, model=OTHER)
    r = 2.0 / known.v
    design = SlidingMode()
    e_y, delta, w = closed_loop_sliding_mode(
        design.prepare(known), other, np.tile([0.8, 0.0, 0.0, 0.0], (3, 1)), r, 1200
    )
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
            delta, w_next = command_sliding_mode(law, x, zero, zero, w)
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


@dataclasses.dataclass(frozen=True)
class _Linear(Controller):
    """The PID without integral and limit, written as a linear law."""

    pid: PID
    name: ClassVar[str] = "linear"
    title: ClassVar[str] = "Linear"

    def prepare(self, plant: Plant) -> LinearLaw:
        d, n = self.pid, plant.n
        reach, steady = d.T_lp * plant.v, plant.steady_state()
        return LinearLaw(
            F=np.column_stack([np.full(n, d.K_p), np.full(n, d.K_d), d.K_p * reach, d.K_d * reach]),
            preview_times=np.zeros(1),
            G_yaw_rate=(steady.delta - d.K_p * reach * steady.e_psi)[:, None],
            G_heading=np.zeros((n, 1)),
            f_u=np.zeros(n),
        )


def test_without_integral_and_limit_it_is_a_linear_law() -> None:
    """The same sums in another order."""
    design = PID(K_i=0.0, delta_max=1.0, K_p=-0.015)
    np.testing.assert_allclose(simulate(design, SOME).S, simulate(Stepped(_Linear(design)), SOME).S, rtol=0, atol=1e-11)


def test_without_back_calculation_the_path_overshoots() -> None:
    plant = plant_at(15.0)
    x = np.array([[3.0, 0.0, 0.0, 0.0]])
    design = PID(K_i=-0.008, delta_max=0.01, K_p=-0.015)
    guarded, _ = closed_loop(design, plant, x, np.zeros(1), 600)
    wound_up, _ = closed_loop(dataclasses.replace(design, T_t=1e3), plant, x, np.zeros(1), 600)
    assert guarded.min() > -0.05
    assert wound_up.min() < -0.5
