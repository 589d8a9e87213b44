"""The Stanley law against the published formula in the publication's own signs, on a circular lane."""

import math

import numpy as np
import pytest

from controllers.stanley import Stanley, StanleyLaw
from helpers.sampled_plant import DT, closed_loop_matrices, moved, plant_at
from ldctoolkit import BicycleModel, EventStatus, Preview, VehicleParameters

OTHER = VehicleParameters(C_af=95000.0, C_ar=70000.0, l_f=1.2, l_r=1.5, m=1900.0, I_z=3600.0)


def command(
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
    delta = command(law, x, np.array([r]), np.array([delta_1]), np.array([delta_2]))
    assert delta[0] == pytest.approx(expected, abs=2e-5)


def test_terms_by_hand() -> None:
    """Straight lane: rounding only. Offset 1 m, k = 3 1/s, k_soft = 2 m/s, v = 10 m/s: atan(1/4)."""
    law = Stanley(k=3.0, k_soft=2.0, k_d_yaw=0.1, delta_max=1.0).prepare(plant_at(10.0))
    quiet = np.zeros(1)
    assert command(law, np.array([[1.0, 0.0, 0.0, 0.0]]), quiet)[0] == -math.atan(0.25)
    assert command(law, np.array([[0.0, 5.0, 0.0, 0.2]]), quiet)[0] == pytest.approx(-0.02, abs=1e-17)
    turned = command(law, np.array([[-1.43 * math.sin(0.1), 0.0, 0.1, 0.0]]), quiet)
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
            delta = command(law, x, r)
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
    loop = closed_loop_matrices(plant, lambda x: command(law, x, np.zeros(v.size)))
    return np.log(np.linalg.eigvals(loop).astype(complex)) / DT


def test_default_gains_damp_every_pole_from_10_to_40_m_per_s() -> None:
    s = poles(Stanley(), np.linspace(10, 40, 31))
    assert (s.real < -1.0).all()
    slow = np.abs(s) < 30.0  # faster ones are gone within a sample
    assert (-s.real / np.abs(s))[slow].min() > 0.8
    undamped = poles(Stanley(k_d_yaw=0.0), np.array([40.0]))
    assert (-undamped.real / np.abs(undamped)).min() < 0.3
