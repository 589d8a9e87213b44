"""Plans of predictive laws beside what came of them."""

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.errors import refused
from ldctoolkit import PredictiveController, Scenarios, Setup, Stage, gain
from ldctoolkit.controllers import LQR, LinearMPC, NoControl, NonlinearMPC
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Actuator, KalmanFilter, PlantOptions, Sensors


@dataclasses.dataclass(frozen=True)
class Quadratic(PredictiveController):
    """On the linear bicycle, with the Riccati equation's terminal cost: what it plans is what it will do."""

    name: ClassVar[str] = "quadratic_plans"
    title: ClassVar[str] = "Quadratic"
    horizon: int = gain(12, unit="samples", lower=1, upper=100, description="prediction horizon")

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return vehicle.linear(x, u.delta, lane)

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        return Stage(x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + 2e4 * (u.delta - lane.steady_delta) ** 2)


# to the right, too shallow to trigger, to the left in a bend that gets tighter
SCENARIOS = Scenarios.from_arrays(
    T=[3.0, 2.0, 4.0], d_y=[0.6, 0.02, 0.8], v_mean=[25.0, 20.0, 30.0], side=[-1, 1, 1], dc=[0.0, 0.0, 0.003]
)


@pytest.mark.parametrize(
    ("options", "delay", "tolerance"),
    [
        (PlantOptions(), 0.0, 1e-11),
        (PlantOptions(actuator=Actuator(delay=0.1)), 0.1, 1e-5),  # integrated, and steered before the trigger
        (PlantOptions(sensors=Sensors(delay=0.1, kalman=KalmanFilter())), 0.0, 1e-4),  # of a filter that has settled
    ],
    ids=["ideal", "actuator", "camera"],
)
def test_on_a_linear_plant_a_plan_comes_true(options: PlantOptions, delay: float, tolerance: float) -> None:
    """Every planned state, command and time against the trajectory's, from when commands before the trigger are gone;
    what is planned with a delay begins when its first command acts."""
    found = ldc.plans(Quadratic(), SCENARIOS, 0.1, setup=Setup(options=options))
    came = found.outcome.trajectories
    assert np.unique(found.row).tolist() == [0, 2]
    assert found.x.shape == (found.row.size, 13, 4)
    assert found.delta.shape == (found.row.size, 12)
    for row, far in ((0, 12), (2, 1)):  # the horizon's end takes a bend for one that goes on
        of_row = np.flatnonzero(found.row == row)
        assert found.sample[of_row].tolist() == list(range(of_row.size))
        for k in of_row[6:60:12]:
            np.testing.assert_allclose(found.t[k, 0], came.t[row, 0] + found.sample[k] * 0.05 + delay, atol=1e-12)
            np.testing.assert_allclose(np.diff(found.t[k]), 0.05, atol=1e-12)
            at = [int(np.nanargmin(np.abs(came.t[row] - t))) for t in found.t[k]]
            np.testing.assert_allclose(came.t[row, at], found.t[k], atol=1e-12)
            np.testing.assert_allclose(found.x[k, : far + 1], came.x[row, at[: far + 1]], atol=tolerance)
            np.testing.assert_allclose(found.delta[k, :far], came.delta[row, at[:far]], atol=tolerance)


def test_the_zoo_plans_on_its_tyres_and_is_corrected() -> None:
    """Later plans come closer to what is driven a second on than the first one did."""
    found = ldc.plans(NonlinearMPC(jerk_max=3.0), SCENARIOS, 0.1)
    came = found.outcome.trajectories
    error = [abs(found.x[k, 15, 0] - came.x[0, k + 15, 0]) for k in (0, 30)]
    assert 1e-9 < error[1] < 0.5 * error[0] < 0.01
    # the first command of a plan is the one that is steered
    np.testing.assert_allclose(found.delta[:20, 0], came.delta[0, :20], atol=1e-12)


def test_without_plans() -> None:
    assert ldc.plans(Quadratic(), SCENARIOS, 3.0).row.size == 0
    for design in (LQR(), NoControl(), LinearMPC()):
        with pytest.raises(InputError) as caught:
            ldc.plans(design, SCENARIOS)
        assert (caught.value.path, caught.value.value) == ("controller", design.name)
    with refused("scenarios"):
        ldc.plans(Quadratic(), LQR())  # type: ignore[arg-type]
