"""Metrics, and options of the plant."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from helpers.errors import refused
from ldctoolkit import Scenarios, Setup, metrics, simulate
from ldctoolkit.controllers import LQR
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres

FloatArray = npt.NDArray[np.float64]
NAN = math.nan


def test_reduction() -> None:
    S, S_uncorrected = np.array([0.25, 1.5, 0.0, 0.3, NAN]), np.array([1.0, 1.0, 0.0, 0.0, NAN])
    np.testing.assert_array_equal(metrics.reduction(S, S_uncorrected), [0.75, -0.5, 0.0, 0.0, NAN])


def test_shares_of_all_and_of_the_interventions() -> None:
    triggered = np.array([True, True, True, False])
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1]) == 0.75
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1], limit=-0.2) == 0.5
    assert metrics.share_deeper(np.array([0.5, 0.51, 0.1, 0.9]), 0.5) == 0.5
    peaks, jerks = [3.0, 3.1, 1.0, 9.0], [5.0, 1.0, 5.1, 9.0]
    np.testing.assert_array_equal(metrics.comfortable(peaks, jerks), [True, False, False, False])
    # the last one did not intervene: neither counted nor in the denominator
    assert metrics.comfortable_share(peaks, jerks, triggered) == pytest.approx(1 / 3)
    assert metrics.comfortable_share([1.0] * 4, [1.0] * 4, triggered) == 1.0
    np.testing.assert_array_equal(metrics.needless(triggered, [0.3, 0.31, 0.2, 0.1]), [True, False, True, False])
    assert metrics.needless_share(triggered, [0.3, 0.31, 0.2, 0.1]) == 0.5
    assert metrics.needless_share(triggered, [0.3, 0.31, 0.2, 0.1], limit=-0.2) == 0.25
    assert metrics.back_inside_share([2.0, np.inf, np.inf, 3.0], triggered) == pytest.approx(1 / 3)
    assert metrics.opposite_crossed_share([0.0, 0.1, 1e-9, 0.4], triggered) == pytest.approx(2 / 3)


def test_shares_of_many_designs_are_those_of_each() -> None:
    rng = np.random.default_rng(8)
    d, n = 5, 40
    triggered = rng.random((d, n)) < 0.4
    triggered[2] = False
    depth, peak, jerk = rng.random(n), 6 * rng.random((d, n)), 10 * rng.random((d, n))
    dtle, over = rng.normal(size=(d, n)), np.maximum(0, rng.normal(size=(d, n)))
    back = np.where(rng.random((d, n)) < 0.5, 2.0, np.inf)

    def shares(rows: int | slice) -> list[float | FloatArray]:
        return [
            metrics.share_within_dtle(dtle[rows]), metrics.comfortable_share(peak[rows], jerk[rows], triggered[rows]),
            metrics.needless_share(triggered[rows], depth), metrics.back_inside_share(back[rows], triggered[rows]),
            metrics.opposite_crossed_share(over[rows], triggered[rows]),
        ]  # fmt: skip

    together = shares(slice(None))
    for i in range(d):
        one = shares(i)
        assert all(type(share) is float for share in one)
        np.testing.assert_array_equal([np.asarray(share)[i] for share in together], one)
    assert np.isnan(np.asarray(together[1])).tolist() == [False, False, True, False, False]


def test_empty_sets() -> None:
    nobody = np.zeros(0, dtype=bool)
    assert metrics.share_within_dtle([]) == 0.0
    assert metrics.share_deeper(np.zeros(0), 0.5) == 0.0
    assert metrics.needless_share(nobody, []) == 0.0
    # no intervention: a share of nothing
    for triggered in (nobody, np.zeros(3, dtype=bool)):
        values = np.zeros(triggered.size)
        assert math.isnan(metrics.comfortable_share(values, values, triggered))
        assert math.isnan(metrics.back_inside_share(values, triggered))
        assert math.isnan(metrics.opposite_crossed_share(values, triggered))


def test_a_nan_counts_and_is_seen() -> None:
    values, yes = [0.1, NAN, 0.2], np.array([True, True, True])
    no = np.array([True, False, True])
    assert math.isnan(metrics.share_within_dtle(values))
    assert math.isnan(metrics.share_within_dtle(np.ma.masked_array([0.1, 0.0, 0.2], mask=[0, 1, 0])))
    assert math.isnan(metrics.share_deeper(np.array(values), 0.5))
    assert not metrics.comfortable(values, [0.0] * 3)[1]
    for share in (
        lambda flags: metrics.comfortable_share([0.0] * 3, values, flags),
        lambda flags: metrics.comfortable_share(values, [0.0] * 3, flags),
        lambda flags: metrics.back_inside_share(values, flags),
        lambda flags: metrics.opposite_crossed_share(values, flags),
        lambda flags: metrics.needless_share(flags, values),
    ):
        assert math.isnan(share(yes))
        assert not math.isnan(share(no))  # not an intervention, so not asked for


# ---------------------------------------------------------------- bad input

Z3 = np.zeros(3)


@pytest.mark.parametrize(
    ("call", "path", "value"),
    [
        (lambda: metrics.back_inside_share([0.1, 0.0], [1.0, 0.0]), "triggered", ...),
        (lambda: metrics.back_inside_share(Z3, np.ma.masked_array(Z3 == 0.0, mask=[0, 1, 0])), "triggered", ...),
        (lambda: metrics.back_inside_share(0.1, True), "shapes", ...),
        (lambda: metrics.needless_share([True, False], [0.1]), "shapes", ...),
        (lambda: metrics.needless([True], [0.1], NAN), "limit", NAN),
        (lambda: metrics.share_within_dtle([0.1], limit="deep"), "limit", "deep"),  # type: ignore[arg-type]
        (lambda: metrics.share_within_dtle(["a"]), "dtle", ...),
        (lambda: metrics.share_deeper(Z3, NAN), "D_y", NAN),
        (lambda: metrics.comfortable(Z3, Z3, a_y_limit=NAN), "a_y_limit", NAN),
    ],
)
def test_bad_input(call: Callable[[], object], path: str, value: Any) -> None:
    with refused(path, value=value):
        call()


@pytest.mark.parametrize(
    ("kind", "given", "path", "value", "allowed"),
    [
        (Actuator, {"lag": -1}, "actuator.lag", -1, "a number from 0 to 10 s"),
        (Actuator, {"lag": 1e-9}, "actuator.lag", 1e-9, "0, or at least 0.0001 s"),
        (Actuator, {"rate_max": 0}, "actuator.rate_max", 0, "a finite number > 0 rad/s"),
        (Actuator, {"delta_max": float("inf")}, "actuator.delta_max", float("inf"), "a finite number > 0 rad"),
        (Actuator, {"delay": True}, "actuator.delay", True, ""),
        (Actuator, {"delay": 10**400}, "actuator.delay", 10**400, ""),
        (Actuator, {"delay": np.float64(-0.5)}, "actuator.delay", -0.5, ""),
        (Mismatch, {"m": (1.2, 0.8)}, "mismatch.m", (1.2, 0.8), "two ascending numbers > 0"),
        (Mismatch, {"I_z": 1.0}, "mismatch.I_z", 1.0, ""),
        (Mismatch, {"mu": (0.0, 1.0)}, "mismatch.mu", (0.0, 1.0), ""),
        (Mismatch, {"mu": {0.5: "low", 0.6: "high"}}, "mismatch.mu", {0.5: "low", 0.6: "high"}, ""),
        (Mismatch, {"mu": (0.5, 0.6, 0.7)}, "mismatch.mu", (0.5, 0.6, 0.7), ""),
        (Mismatch, {"C_af": (np.float64(2), 1)}, "mismatch.C_af", (2.0, 1), ""),
        (Tyres, {"model": "magic"}, "tyres.model", "magic", {"magic_formula"}),
        (Tyres, {"mu": 0.3}, "tyres.mu", 0.3, ""),
        (Tyres, {"model": "magic_formula", "shape": 3}, "tyres.shape", 3, "a number from 1 to 2"),
        (KalmanFilter, {"q_y": 0}, "sensors.kalman.q_y", 0, "a finite number > 0 m/s^2/sqrt(Hz)"),
        (Sensors, {"e_y_noise": -0.1}, "sensors.e_y_noise", -0.1, "a finite number >= 0 m"),
        (Sensors, {"e_y_bias": "left"}, "sensors.e_y_bias", "left", "a finite number"),
        (Sensors, {"fps": 0}, "sensors.fps", 0, "a number from 0.1 to 1000 Hz"),
        (Sensors, {"fps": 30, "period": 0.1}, "sensors.fps", 30, "one of the two"),
        (Sensors, {"period": 1e-4}, "sensors.period", 1e-4, "0, or at least 0.001 s"),
        (Sensors, {"kalman": True}, "sensors.kalman", True, "an instance of KalmanFilter, or None"),
        (Residuals, {"y": 1}, "residuals.y", 1, "true or false"),
        (Residuals, {"bandwidth": 2.0}, "residuals.bandwidth", 2.0, ""),
        (PlantOptions, {"speed": "profil"}, "speed", "profil", {"profile"}),
        (PlantOptions, {"actuator": {}}, "actuator", {}, "an instance of Actuator"),
        (PlantOptions, {"mismatch": Mismatch(mu=(0.3, 1))}, "mismatch.mu", (0.3, 1.0), ""),
    ],
)
def test_a_wrong_value_is_named(kind: Any, given: dict[str, Any], path: str, value: Any, allowed: Any) -> None:
    with refused(path, value=value, allowed=allowed):
        kind(**given)


def test_an_error_seen_from_outside_holds_the_same_value() -> None:
    error = InputError("m", value=(given := [1.2, 0.8])).within("mismatch")
    assert error.path == "mismatch.m"
    assert error.value is given


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
        "driver": Driver(straight=1.0),
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
    ("name", "value", "allowed"),
    [
        ("options", {}, "an instance of PlantOptions"),
        ("vehicle", 3, ""),
        ("y_s", "deep", "a finite number >= -10 m"),
        ("y_s", -11.0, "a finite number >= -10 m"),
        ("settle", True, "a number from 0 to 60 s"),
        ("settle", 61, "a number from 0 to 60 s"),
        ("threads", 2.5, "a whole number >= 1"),
        ("seed", -1, "a whole number from 0 to 2^63 - 1"),
    ],
)
def test_wrong_arguments_of_simulate_are_named(name: str, value: Any, allowed: str) -> None:
    scenarios = Scenarios.from_arrays(T=2.0, d_y=0.4, v_mean=20.0)
    with refused(name, value=value, allowed=allowed):
        simulate(LQR(r_delta=100.0), scenarios, **{name: value})


def test_numpy_arguments_of_simulate_are_numbers() -> None:
    law, scenarios = LQR(r_delta=100.0), Scenarios.from_arrays(T=2.0, d_y=0.4, v_mean=20.0)
    usual = simulate(law, scenarios, y_s=0.0, dt=0.1, settle=1.0)
    assert simulate(law, scenarios, y_s=np.int64(0), dt=np.float64(0.1), settle=np.int64(1)).S[0] == usual.S[0]
