"""LQR gains and feedforward against python-control and a bend."""

import control
import numpy as np
import pytest

from controllers import LQI, LQR, PreviewLQR
from controllers.riccati import SPEED_RANGE, regulator
from helpers.grids import grid, some
from helpers.sampled_plant import moved, weights_of
from ldctoolkit import BicycleModel, Controller, EventStatus, LinearLaw, Plant, VehicleParameters, load_model, simulate
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Actuator, KalmanFilter, PlantOptions, Sensors

WEIGHTS = [
    {},
    {"q_y": 0.1, "q_y_rate": 0.5, "q_psi": 40.0, "q_psi_rate": 3.0, "r_delta": 3000.0},
    {"q_y": 30.0, "q_psi": 0.0, "r_delta": 5.0},
]
VEHICLES = [VehicleParameters(), VehicleParameters(C_af=95000.0, C_ar=70000.0, l_f=1.2, l_r=1.5, m=1900.0, I_z=3600.0)]


@pytest.mark.parametrize(("number", "vehicle"), grid(range(3), VEHICLES, (0, VEHICLES[0]), (1, VEHICLES[1])))
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


def test_a_bend_leaves_no_bias() -> None:
    plant = Plant.build(BicycleModel(), np.array([8.0, 20.0, 33.0]), 0.05)
    law = LQR(r_delta=100.0).prepare(plant)
    assert isinstance(law, LinearLaw)
    r = 2.0 / plant.v  # 2 m/s^2
    x = np.tile([0.9, 0.1, 0.02, 0.0], (3, 1))
    for _ in range(2000):
        delta = (law.F * x).sum(axis=1) + law.G_yaw_rate[:, 0] * r
        x = moved(plant, x, delta, r)
    np.testing.assert_allclose(x[:, 0], 0.0, atol=1e-9)


def test_speeds_outside_the_schedule_are_named() -> None:
    with pytest.raises(InputError, match=rf"95 m/s; allowed .* {SPEED_RANGE[0]:g} to {SPEED_RANGE[1]:g}"):
        LQR(r_delta=100.0).prepare(Plant.build(BicycleModel(), [20.0, 95.0], 0.05))
