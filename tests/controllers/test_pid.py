"""PID on the preview point: by hand, against a linear law, in a bend, at its limit."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np
import pytest

from controllers.pid import PID, PIDLaw
from helpers.closed_loop import Stepped
from helpers.sampled_plant import DT, moved, plant_at
from ldctoolkit import (
    BicycleModel,
    Controller,
    EventStatus,
    LinearLaw,
    Plant,
    Preview,
    Scenarios,
    VehicleParameters,
    simulate,
)

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
    poles = np.log(np.linalg.eigvals(loop).astype(complex)) / DT
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
    known = plant_at(20.0, 33.0)
    other = plant_at(20.0, 33.0, model=BicycleModel(VehicleParameters(m=1300.0, C_af=64000.0, C_ar=90000.0)))
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


def test_without_back_calculation_the_path_overshoots() -> None:
    plant = plant_at(15.0)
    x = np.array([[3.0, 0.0, 0.0, 0.0]])
    design = PID(K_i=-0.008, delta_max=0.01, K_p=-0.015)
    guarded, _ = closed_loop(design, plant, x, np.zeros(1), 600)
    wound_up, _ = closed_loop(dataclasses.replace(design, T_t=1e3), plant, x, np.zeros(1), 600)
    assert guarded.min() > -0.05
    assert wound_up.min() < -0.5
