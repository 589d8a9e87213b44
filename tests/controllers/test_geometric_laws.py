"""Pure pursuit and Stanley."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from helpers.closed_loop import closed_loop_matrices, continuous_poles, moved, plant_at
from helpers.errors import refused
from ldctoolkit import BicycleModel, EventStatus, Preview, Scenarios, VehicleParameters, simulate
from ldctoolkit.controllers.pure_pursuit import PurePursuit, PurePursuitLaw
from ldctoolkit.controllers.stanley import Stanley, StanleyLaw

L_R, WHEEL_BASE = 1.47, 2.9


def clothoid(law: PurePursuitLaw, r: np.ndarray, slope: np.ndarray) -> Preview:
    """A lane whose yaw rate is r + slope t."""
    t = law.preview_times
    return Preview(r[:, None] + slope[:, None] * t, r[:, None] * t + 0.5 * slope[:, None] * t**2)


def command(law: PurePursuitLaw, x: np.ndarray, preview: Preview) -> np.ndarray:
    n = x.shape[0]
    delta, state, status = law.step(np.zeros(n), x, preview, np.zeros(n), law.init(n))
    assert state is None
    np.testing.assert_array_equal(status, EventStatus.OK)
    return delta


@pytest.mark.parametrize("radius", [400.0, -300.0])
def test_the_goal_on_a_circular_lane(radius: float) -> None:
    """From the circle itself; the law draws it as a parabola, off by s^4/(8 R^3) across, s^3/(6 R^2) along."""
    v, e_y, e_psi, l_d = 20.0, 0.5, -0.03, 24.0
    law = PurePursuit(T_lp=1.2, delta_max=1.0).prepare(plant_at(v))
    s = l_d - L_R
    goal = np.array([radius * math.sin(s / radius), radius * (1 - math.cos(s / radius))])
    rear = np.array([-L_R * math.cos(e_psi), e_y - L_R * math.sin(e_psi)])
    to_goal = goal - rear
    alpha = math.atan2(to_goal[1], to_goal[0]) - e_psi
    expected = math.atan(2 * WHEEL_BASE * math.sin(alpha) / np.hypot(*to_goal))
    delta = command(law, np.array([[e_y, 0.1, e_psi, 0.2]]), clothoid(law, np.array([v / radius]), np.zeros(1)))
    assert delta[0] == pytest.approx(expected, abs=2e-5)


@given(
    e_y=st.floats(-2, 2), e_psi=st.floats(-0.3, 0.3), r=st.floats(-0.3, 0.3), v=st.floats(5, 45), T_lp=st.floats(0.3, 3)
)
def test_the_arc_goes_through_the_goal(e_y: float, e_psi: float, r: float, v: float, T_lp: float) -> None:
    """The circle of curvature tan(delta)/L that leaves the rear axle along the heading, in the lane's frame."""
    law = PurePursuit(T_lp=T_lp, delta_max=1.0).prepare(plant_at(v))
    preview = clothoid(law, np.array([r]), np.zeros(1))
    delta = command(law, np.array([[e_y, 0.0, e_psi, 0.0]]), preview)[0]
    if abs(delta) > 0.99:
        return  # at the limit it goes elsewhere
    s = max(8.0, T_lp * v) - L_R
    goal = np.array([s, v * 0.5 * r * (s / v) ** 2])
    rear = np.array([-L_R * math.cos(e_psi), e_y - L_R * math.sin(e_psi)])
    normal = np.array([-math.sin(e_psi), math.cos(e_psi)])
    curvature = math.tan(delta) / WHEEL_BASE
    # |goal - centre| = |radius|, multiplied by the curvature so that a straight line is no exception
    to_goal = goal - rear
    assert curvature * to_goal @ to_goal - 2.0 * to_goal @ normal == pytest.approx(0.0, abs=1e-9)


def test_the_lane_ahead_is_exact_while_curvature_is_linear_in_time() -> None:
    rng = np.random.default_rng(3)
    v = np.concatenate([[1.0, 4.0, 90.0], rng.uniform(6, 40, 20)])
    law = PurePursuit(T_lp=1.234, l_min=7.0).prepare(plant_at(*v))
    r, slope = rng.normal(0, 0.05, v.size), rng.normal(0, 0.05, v.size)
    T = (np.maximum(7.0, 1.234 * v) - L_R) / v
    assert law.preview_times[-1] >= T.max() > law.preview_times[-2]
    expected = v * (r * T**2 / 2 + slope * T**3 / 6)
    np.testing.assert_allclose(law.lane_offset(clothoid(law, r, slope)), expected, rtol=1e-12, atol=1e-14)


def test_in_the_closed_loop_the_goal_is_where_the_lane_is() -> None:
    """Commands of a run against the lane's curvature integrated twice by quadrature."""
    scenarios = Scenarios.from_arrays(
        T=[2.5, 6.0], d_y=[0.4, 0.6], v_mean=[22.0, 5.5], c_0=[1e-3, -2e-3], dc=[3e-3, 1e-3]
    )
    out = simulate(PurePursuit(delta_max=1.0, T_lp=1.0), scenarios, y_s=0.1, trajectories=True)
    paths = out.trajectories
    for i in range(2):
        v, T = scenarios.v_mean[i], scenarios.T[i]
        s = max(8.0, v) - L_R
        for k in (0, 9, 30):
            now, (e_y, _, e_psi, _) = paths.t[i, k], paths.x[i, k]

            def r(t: float, i: int = i, v: float = v, T: float = T) -> float:
                return float(v * (scenarios.c_0[i] + scenarios.dc[i] * min(t / T, 1.0)))

            end = now + s / v
            lane = v * quad(lambda u: (end - u) * r(u), now, end, points=[min(max(T, now), end)])[0]  # noqa: B023
            dx, dy = s + L_R * math.cos(e_psi), lane - e_y + L_R * math.sin(e_psi)
            alpha = math.atan2(dy, dx) - e_psi
            expected = math.atan(2 * WHEEL_BASE * math.sin(alpha) / math.hypot(dx, dy))
            assert paths.delta[i, k] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("dt", [0.05, 0.1])
def test_default_gains_damp_every_pole_from_10_to_40_m_per_s(dt: float) -> None:
    v = np.linspace(10, 40, 31)
    plant = plant_at(*v, dt=dt)
    law = PurePursuit(T_lp=1.0).prepare(plant)
    straight = clothoid(law, np.zeros(v.size), np.zeros(v.size))
    loop = closed_loop_matrices(plant, lambda x: command(law, x, straight))
    s = continuous_poles(loop, dt)
    assert (s.real < -0.7).all()
    assert (-s.real / np.abs(s)).min() > 0.45


def test_a_goal_behind_the_centre_of_gravity_is_named() -> None:
    long = BicycleModel(VehicleParameters(l_r=3.0))
    with refused("pure_pursuit.l_min", value=2.0):
        PurePursuit(l_min=2.0, T_lp=1.0).prepare(plant_at(20.0, model=long))


OTHER = VehicleParameters(C_af=95000.0, C_ar=70000.0, l_f=1.2, l_r=1.5, m=1900.0, I_z=3600.0)


def command_stanley(
    law: StanleyLaw, x: np.ndarray, r: np.ndarray, prev: np.ndarray | None = None, state: np.ndarray | None = None
) -> np.ndarray:
    preview = Preview(r[:, None], np.zeros((r.size, 1)))
    delta, _, status = law.step(np.zeros(r.size), x, preview, np.zeros(r.size) if prev is None else prev, state)
    np.testing.assert_array_equal(status, EventStatus.OK)
    return delta


@pytest.mark.parametrize("radius", [300.0, -250.0])
@pytest.mark.parametrize("vehicle", [VehicleParameters(), OTHER])
def test_the_published_formula_on_a_circular_lane(radius: float, vehicle: VehicleParameters) -> None:
    """Offset and heading from the geometry of the circle, signs as published: from the vehicle to the path. The law
    takes the lane beside the front axle to second order in l_f/R and e_psi: at most 2e-5 rad here."""
    gains = {"k": 2.0, "k_soft": 1.5, "k_d_yaw": 0.12, "k_d_steer": 0.3}
    v, e_y, e_psi, e_psi_rate = 15.0, 0.4, -0.02, 0.03
    delta_1, delta_2 = 0.02, 0.012  # measured now and one period earlier
    r = v / radius
    p = vehicle
    # lane: circle about (0, R), the vehicle's foot point at the origin, x along the lane
    front_x, front_y = p.l_f * math.cos(e_psi), e_y + p.l_f * math.sin(e_psi)
    e_left = radius - math.copysign(math.hypot(front_x, front_y - radius), radius)
    tangent = math.atan(front_x / (radius - front_y))
    psi, e = -(e_psi - tangent), -e_left
    yaw_rate, yaw_rate_path = -(e_psi_rate + r), -r
    k_ag = p.m / (2 * p.C_af * (1 + p.l_f / p.l_r))
    expected = (
        (psi - k_ag * v * yaw_rate_path)
        + math.atan(gains["k"] * e / (gains["k_soft"] + v))
        + gains["k_d_yaw"] * (yaw_rate - yaw_rate_path)
        + gains["k_d_steer"] * (delta_2 - delta_1)
    )
    law = Stanley(**gains, delta_max=1.0).prepare(plant_at(v, model=BicycleModel(vehicle)))
    x = np.array([[e_y, 0.2, e_psi, e_psi_rate]])
    delta = command_stanley(law, x, np.array([r]), np.array([delta_1]), np.array([delta_2]))
    assert delta[0] == pytest.approx(expected, abs=2e-5)


def test_terms_by_hand() -> None:
    """Straight lane: rounding only. Offset 1 m, k = 3 1/s, k_soft = 2 m/s, v = 10 m/s: atan(1/4)."""
    law = Stanley(k=3.0, k_soft=2.0, k_d_yaw=0.1, delta_max=1.0).prepare(plant_at(10.0))
    quiet = np.zeros(1)
    assert command_stanley(law, np.array([[1.0, 0.0, 0.0, 0.0]]), quiet)[0] == -math.atan(0.25)
    assert command_stanley(law, np.array([[0.0, 5.0, 0.0, 0.2]]), quiet)[0] == pytest.approx(-0.02, abs=1e-17)
    turned = command_stanley(law, np.array([[-1.43 * math.sin(0.1), 0.0, 0.1, 0.0]]), quiet)
    assert turned[0] == pytest.approx(-0.1, abs=1e-15)


def test_the_last_change_of_the_command_is_known_from_the_second_step_on() -> None:
    law = Stanley(k_d_steer=0.4).prepare(plant_at(20.0))
    nothing = np.zeros((1, 4)), Preview(np.zeros((1, 1)), np.zeros((1, 1)))
    first, state, _ = law.step(np.zeros(1), *nothing, np.array([0.05]), law.init(1))
    second, state, _ = law.step(np.zeros(1), *nothing, np.array([0.03]), state)
    third, _, _ = law.step(np.zeros(1), *nothing, np.array([0.03]), state)
    assert (first[0], second[0], third[0]) == (0.0, pytest.approx(0.008, abs=1e-16), 0.0)


@pytest.mark.parametrize("vehicle", [VehicleParameters(), OTHER])
def test_a_bend_leaves_no_offset_of_the_front_axle(vehicle: VehicleParameters) -> None:
    plant = plant_at(8.0, 20.0, 33.0, model=BicycleModel(vehicle))
    r = 2.0 / plant.v
    ends = {}
    for k_ag in (1.0, 0.0):
        law, x = Stanley(k_ag=k_ag).prepare(plant), np.zeros((3, 4))
        for _ in range(600):
            delta = command_stanley(law, x, r)
            x = moved(plant, x, delta, r)
        ends[k_ag] = x
    e_psi = plant.steady_state().e_psi * r
    front = ends[1.0][:, 0] + vehicle.l_f * np.sin(e_psi) - 0.5 * vehicle.l_f**2 * r / plant.v
    np.testing.assert_allclose(front, 0.0, atol=1e-9)
    np.testing.assert_allclose(ends[1.0][:, 2], e_psi, atol=1e-9)
    assert (np.abs(ends[0.0][:, 0] - ends[1.0][:, 0]) > 0.01).all()  # what k_ag takes out


def poles(design: Stanley, v: np.ndarray) -> np.ndarray:
    """Of the sampled loop about the lane's centre, in continuous time."""
    plant = plant_at(*v)
    law = design.prepare(plant)
    return continuous_poles(closed_loop_matrices(plant, lambda x: command_stanley(law, x, np.zeros(v.size))))


def test_default_gains_damp_every_pole_from_10_to_40_m_per_s_stanley() -> None:
    s = poles(Stanley(), np.linspace(10, 40, 31))
    assert (s.real < -1.0).all()
    slow = np.abs(s) < 30.0  # faster ones are gone within a sample
    assert (-s.real / np.abs(s))[slow].min() > 0.8
    undamped = poles(Stanley(k_d_yaw=0.0), np.array([40.0]))
    assert (-undamped.real / np.abs(undamped)).min() < 0.3
