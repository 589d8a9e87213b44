"""Plant options: every wrong value is named with what is allowed; NumPy numbers are numbers; nothing is ignored."""

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from controllers import LQR
from ldctoolkit import Scenarios, Setup, simulate
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        (Actuator, {"lag": -1}, "actuator.lag: -1; allowed: a finite number >= 0 and <= 10"),
        (Actuator, {"lag": 1e-9}, "actuator.lag: 1e-09; allowed: 0, or at least 0.0001 s"),
        (Actuator, {"rate_max": 0}, "actuator.rate_max: 0; allowed: a finite number > 0"),
        (Actuator, {"delta_max": float("inf")}, "actuator.delta_max: inf; allowed: a finite number > 0"),
        (Actuator, {"delay": True}, "actuator.delay: True; allowed"),
        (Actuator, {"delay": np.float64(-0.5)}, "actuator.delay: -0.5; allowed"),
        (Mismatch, {"m": (1.2, 0.8)}, "mismatch.m: (1.2, 0.8); allowed: (low, high), 0 < low <= high"),
        (Mismatch, {"I_z": 1.0}, "mismatch.I_z: 1.0; allowed"),
        (Mismatch, {"C_af": (np.float64(2), 1)}, "mismatch.C_af: (2.0, 1); allowed"),
        (Tyres, {"model": "magic"}, "tyres.model: 'magic'; did you mean 'magic_formula'"),
        (Tyres, {"mu": 0.3}, "tyres.mu: 0.3; linear tyres have none; allowed with tyres.model = 'magic_formula'"),
        (Tyres, {"model": "magic_formula", "shape": 3}, "tyres.shape: 3; allowed: a finite number >= 1 and <= 2"),
        (KalmanFilter, {"q_y": 0}, "sensors.kalman.q_y: 0; allowed: a finite number > 0"),
        (Sensors, {"e_y_noise": -0.1}, "sensors.e_y_noise: -0.1; allowed: a finite number >= 0"),
        (Sensors, {"e_y_bias": "left"}, "sensors.e_y_bias: 'left'; allowed: a finite number"),
        (Sensors, {"fps": 0}, "sensors.fps: 0; allowed: a finite number >= 0.1 and <= 1000"),
        (Sensors, {"fps": 30, "period": 0.1}, "sensors.fps: 30 beside period = 0.1 s; allowed: one of the two"),
        (Sensors, {"period": 1e-4}, "sensors.period: 0.0001; allowed: 0, or at least 0.001 s"),
        (Sensors, {"kalman": True}, "sensors.kalman: True; allowed: an instance of KalmanFilter, or None"),
        (Residuals, {"y": 1}, "residuals.y: 1; allowed: true or false"),
        (Residuals, {"bandwidth": 2.0}, "residuals.bandwidth: 2.0; allowed with residuals.y or residuals.v"),
        (PlantOptions, {"speed": "profil"}, "speed: 'profil'; did you mean 'profile'"),
        (PlantOptions, {"actuator": {}}, "actuator: {}; allowed: an instance of Actuator"),
        (PlantOptions, {"mismatch": Mismatch(mu=(0.3, 1))}, "mismatch.mu: (0.3, 1.0); linear tyres have no friction"),
    ],
)
def test_a_wrong_value_is_named(kind: Any, given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        kind(**given)


def test_numpy_numbers_are_numbers() -> None:
    assert Actuator(lag=np.float32(0.5), delay=np.int64(1)) == Actuator(lag=0.5, delay=1.0)
    assert type(Actuator(lag=np.float64(0.5)).lag) is float
    assert Sensors(fps=np.int64(30)) == Sensors(period=1 / 30) == dataclasses.replace(Sensors(), fps=30)
    assert Mismatch(m=(np.float64(0.5), np.int64(2))) == Mismatch(m=(0.5, 2.0))


@pytest.mark.parametrize(
    ("period", "delay", "first", "held"),
    [
        (0.0, 0.1, 0.1, 0.1),
        (0.1, 0.1, 0.1, 0.125),
        (0.0, 0.07, 0.1, 0.1),
        (1 / 30, 0.0, 1 / 120, 1 / 120),  # 0 and 1/60 s
        (1 / 30, 0.07, 11 / 120, 11 / 120),  # 5/60 and 6/60 s
        (0.125, 0.12, 0.1375, 0.175),  # 0.125 and 0.15 s; then, up to 0.225 s too
        (0.001, 0.0604, 0.061, 0.061),
    ],
)
def test_the_age_of_a_frame_is_its_mean_at_samples(period: float, delay: float, first: float, held: float) -> None:
    """By hand, samples 0.05 s apart; a design knows the age of a frame that is new."""
    sensors = Sensors(period=period, delay=delay)
    assert (sensors.age(0.05), sensors.age(0.05, held=True)) == (pytest.approx(first), pytest.approx(held))
    assert Setup(options=PlantOptions(sensors=sensors)).plant([20.0]).age == sensors.age(0.05)


def test_every_option_takes_the_ideal_away() -> None:
    assert PlantOptions().ideal
    assert PlantOptions().drives_exactly
    changed = {
        "actuator": Actuator(lag=0.1), "mismatch": Mismatch(m=(0.9, 1.1)), "tyres": Tyres(model="magic_formula"),
        "sensors": Sensors(delay=0.1), "residuals": Residuals(v=True), "speed": "profile",
    }  # fmt: skip
    assert set(changed) == {field.name for field in dataclasses.fields(PlantOptions)}
    exact = {"mismatch", "sensors", "residuals"}
    for name, value in changed.items():
        options = PlantOptions(**{name: value})
        assert not options.ideal
        assert options.drives_exactly == (name in exact)
        with pytest.raises(dataclasses.FrozenInstanceError):
            options.speed = "frozen"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"options": {}}, "options: {}; allowed: PlantOptions(...)"),
        ({"vehicle": 3}, "vehicle: 3; allowed: VehicleParameters(...)"),
        ({"y_s": "deep"}, "y_s: 'deep'; allowed: a finite number"),
        ({"y_s": np.float64(-1)}, "y_s: -1.0; allowed: a finite number >= 0"),
        ({"settle": True}, "settle: True; allowed: a finite number"),
        ({"settle": 61}, "settle: 61; allowed: a finite number >= 0 and <= 60"),
        ({"threads": 2.5}, "threads: 2.5; allowed: a whole number >= 1"),
        ({"seed": -1}, "seed: -1; allowed"),
    ],
)
def test_wrong_arguments_of_simulate_are_named(given: dict[str, Any], message: str) -> None:
    scenarios = Scenarios.from_arrays(T=2.0, d_y=0.4, v_mean=20.0)
    with pytest.raises(InputError, match=re.escape(message)):
        simulate(LQR(r_delta=100.0), scenarios, **given)


def test_numpy_arguments_of_simulate_are_numbers() -> None:
    scenarios = Scenarios.from_arrays(T=2.0, d_y=0.4, v_mean=20.0)
    plain = simulate(LQR(r_delta=100.0), scenarios, y_s=0.0, dt=0.1, settle=1.0)
    assert (
        simulate(LQR(r_delta=100.0), scenarios, y_s=np.int64(0), dt=np.float64(0.1), settle=np.int64(1)).S[0]
        == plain.S[0]
    )
