"""Identification of actuator and vehicle: known vehicles are driven by other solvers, and found again."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import control
import numpy as np
import polars as pl
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st

from helpers.errors import refused
from ldctoolkit import Actuator, BicycleModel, Identification, VehicleParameters, identify
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import Recording

CAR = VehicleParameters(m=1650.0, I_z=2800.0, l_f=1.25, l_r=1.55, C_af=65000.0, C_ar=75000.0)
LAG, DELAY, RATE = 0.1, 0.06, 0.33
# K = m (l_r/C_f - l_f/C_r)/L with axle stiffnesses
TRUTH = {
    "lag": LAG, "delay": DELAY, "rate_max": RATE, "understeer_gradient": 1650.0 * (1.55 / 13e4 - 1.25 / 15e4) / 2.8,
    "C_af": 65000.0, "C_ar": 75000.0, "I_z": 2800.0, "wheelbase": 2.8,
}  # fmt: skip
WITH, WITHOUT = [*TRUTH][:7], ["lag", "delay", "rate_max", "understeer_gradient", "wheelbase"]
T = np.arange(0.0, 60.0, 0.02)
Log = dict[str, Any]


def solved(f: Callable[[float, np.ndarray], Any], start: list[float]) -> np.ndarray:
    return np.asarray(solve_ivp(f, (T[0], T[-1]), start, t_eval=T, max_step=0.01, rtol=1e-6, atol=1e-9).y)


def steps(size: float, hold: float = 0.5, seed: int = 3) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(size=200)[(T / hold).astype(int)]


def wheel(command: np.ndarray, lag: float = LAG, delay: float = DELAY, rate: float = RATE) -> np.ndarray:
    def f(t: float, x: np.ndarray) -> np.ndarray:
        u = command[max(np.searchsorted(T, t - delay + 1e-9, "right") - 1, 0)]
        return np.clip((u - x) / lag, -rate, rate)

    return solved(f, [command[0]])[0]


def yaw_rate(v: np.ndarray, delta: np.ndarray, p: VehicleParameters = CAR) -> np.ndarray:
    def f(t: float, x: np.ndarray) -> list[float]:
        speed, angle = np.interp(t, T, v), np.interp(t, T, delta)
        front = 2.0 * p.C_af * (angle - (x[0] + p.l_f * x[1]) / speed)
        rear = -2.0 * p.C_ar * (x[0] - p.l_r * x[1]) / speed
        return [(front + rear) / p.m - speed * x[1], (p.l_f * front - p.l_r * rear) / p.I_z]

    return solved(f, [0.0, 0.0])[1]


@functools.cache
def perfect() -> Log:
    """Signals without noise, one log for all tests."""
    command, v = steps(0.02), 20.0 + 6.0 * np.sin(2.0 * np.pi * T / 40.0)
    delta = wheel(command)
    return {"t": T, "steering_command": command, "steering": delta, "speed": v, "yaw_rate": yaw_rate(v, delta)}


def noisy(seed: int = 0, rho: float = 0.0) -> Log:
    """The log of a vehicle: noise with the autocorrelation `rho` of neighbours, offsets of two sensors."""
    rng = np.random.default_rng(seed)

    def noise(size: float, rho: float = rho) -> np.ndarray:
        white = rng.normal(size=T.size + 200)
        return size * np.asarray(lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white))[200:]

    log = perfect()
    return log | {
        "steering": log["steering"] + noise(2e-4) + 0.003,
        "speed": log["speed"] + noise(0.02, 0.0),
        "yaw_rate": log["yaw_rate"] + noise(2e-3) - 0.01,
    }


def known(found: Identification) -> set[str]:
    return {one.name for one in found.estimates if one.value is not None}


def check_inside(found: Identification, names: list[str], times: float = 1.7) -> None:
    """Truths lie in intervals that are so many times as wide, and each of them is narrow."""
    assert [one.name for one in found.estimates] == names
    for name in names:
        estimate = found[name]
        assert not estimate.reason
        assert estimate.value is not None
        assert estimate.interval is not None
        half = 0.5 * (estimate.interval[1] - estimate.interval[0])
        assert abs(estimate.value - TRUTH[name]) < times * half, estimate
        assert half < 0.1 * TRUTH[name], estimate


def coverage(seeds: range, rho: float) -> dict[str, int]:
    hits = dict.fromkeys(TRUTH, 0)
    for seed in seeds:
        for found in (identify(noisy(seed, rho), CAR), identify(noisy(seed, rho))):
            for name, _, value, interval, _ in found.estimates:
                if found.given is not None or name == "wheelbase":
                    assert value is not None
                    assert interval is not None
                    hits[name] += interval[0] <= TRUTH[name] <= interval[1]
    return hits


@pytest.mark.parametrize("vehicle", [CAR, None])
def test_a_known_vehicle_is_identified(vehicle: VehicleParameters | None) -> None:
    found = identify(noisy(), vehicle)
    check_inside(found, WITHOUT if vehicle is None else WITH)
    assert found.actuator == Actuator(**{name: found[name].value for name in ("lag", "delay", "rate_max")})
    if vehicle is not None:
        assert found.vehicle.C_af == found["C_af"].value != CAR.C_af
        assert dataclasses.replace(found.vehicle, C_af=CAR.C_af, C_ar=CAR.C_ar, I_z=CAR.I_z) == CAR
    # the yaw response is the model's, whether the vehicle was given or not
    A, B, _ = BicycleModel(CAR).matrices([22.0])
    theirs = control.ss(A[0], B[0][:, None], [[0, 0, 0, 1]], 0)
    omega = np.array([0.1, 1.0, 3.0, 10.0])
    np.testing.assert_allclose(found.yaw_response(22.0)(1j * omega), theirs(1j * omega), rtol=0.03)


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    hits = coverage(range(8), 0.0)
    assert min(hits.values()) >= 5
    assert sum(hits.values()) >= 55  # of 8 and 64; 95 % are 61


@pytest.mark.slow
@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_intervals_hold_the_truth_in_19_of_20(rho: float) -> None:
    hits = coverage(range(100, 150), rho)
    assert min(hits.values()) >= 42, hits
    assert sum(hits.values()) >= 4 * 91, hits


def test_another_codes_neutral_vehicle_is_told_up_to_a_factor() -> None:
    """CommonRoad's single track is neutral: its yaw rate depends on C_f/I_z and C_r/I_z alone."""
    p = parameters_vehicle2()
    delta, v = perfect()["steering"], 20.0
    rate = np.gradient(delta, T)

    def f(t: float, x: np.ndarray) -> Any:
        return vehicle_dynamics_st(x, [np.interp(t, T, rate), 0.0], p)

    x = solved(f, [0.0, 0.0, float(delta[0]), v, 0.0, 0.0, 0.0])
    log = {"t": T, "steering": x[2], "speed": np.full(T.size, v), "yaw_rate": x[5]}
    found = identify(log, VehicleParameters(m=p.m, l_f=p.a, l_r=p.b))
    assert known(found) == {"understeer_gradient"}
    assert found["understeer_gradient"].value == pytest.approx(0.0, abs=1e-5)
    stiffness = -p.tire.p_ky1 * 9.81 / (p.a + p.b)  # of an axle, over the mass and the other axle's distance
    pole = stiffness * p.a * p.b * (p.a + p.b) * p.m / p.I_z / v
    theirs = control.tf([stiffness * p.a * p.b * p.m / p.I_z], [1.0, pole])
    omega = np.array([0.1, 1.0, 3.0, 10.0])
    np.testing.assert_allclose(found.yaw_response(v)(1j * omega), theirs(1j * omega), rtol=0.01)
    assert found["lag"].reason == "the log has no steering_command"


def still(name: str) -> Callable[[Log], Log]:
    return lambda log: log | {name: np.full(T.size, 0.01)}


def gentle(log: Log) -> Log:
    command = 0.2 * log["steering_command"]
    return log | {"steering_command": command, "steering": wheel(command)}


def constant_speed(log: Log) -> Log:
    v = np.full(T.size, 20.0)
    return log | {
        "speed": v,
        "yaw_rate": yaw_rate(v, log["steering"]) + np.random.default_rng(0).normal(size=T.size) * 2e-3,
    }


def held_wheel(log: Log) -> Log:
    """The wheel is held at one angle while the speed varies; it only shows noise."""
    rng, delta = np.random.default_rng(0), np.full(T.size, 0.02)
    r = yaw_rate(log["speed"], delta)
    return log | {"steering": delta + rng.normal(size=T.size) * 2e-4, "yaw_rate": r + rng.normal(size=T.size) * 2e-3}


STEERING, DYNAMICS = {"lag", "delay", "rate_max"}, {"understeer_gradient", "C_af", "C_ar", "I_z"}
UNTOLD: dict[str, tuple[Callable[[Log], Log], set[str], str]] = {
    "no command": (lambda log: {k: x for k, x in log.items() if k != "steering_command"}, STEERING, "steering_command"),
    "the command rests": (still("steering_command"), STEERING, "is constant"),
    "sign of the command": (lambda log: log | {"steering_command": -log["steering_command"]}, STEERING, "-1"),
    "command in degrees": (
        lambda log: log | {"steering_command": np.degrees(log["steering_command"])}, STEERING, "times the command",
    ),
    "the limit is not reached": (gentle, {"rate_max"} | DYNAMICS, "never reached"),
    "no yaw rate": (lambda log: {k: x for k, x in log.items() if k != "yaw_rate"}, DYNAMICS, "yaw_rate"),
    "no speed": (lambda log: {k: x for k, x in log.items() if k != "speed"}, DYNAMICS, "speed"),
    "sign of the yaw rate": (lambda log: log | {"yaw_rate": -log["yaw_rate"]}, DYNAMICS, "sign"),
    "yaw rate in degrees": (lambda log: log | {"yaw_rate": np.degrees(log["yaw_rate"])}, DYNAMICS, "unit"),
    "steering wheel": (
        lambda log: log | {name: 15.0 * log[name] for name in ("steering", "steering_command")},
        DYNAMICS, "steering_ratio",
    ),
    "another channel": (
        lambda log: log | {"yaw_rate": np.random.default_rng(1).normal(0.0, 0.05, T.size)}, DYNAMICS, "another channel",
    ),
    "speed in km/h": (lambda log: log | {"speed": 3.6 * log["speed"]}, DYNAMICS, "speed or the yaw rate in another"),
    "too slow": (lambda log: log | {"speed": np.full(T.size, 2.0)}, DYNAMICS, "0 samples"),
    "beyond linear tyres": (lambda log: log | {"speed": np.full(T.size, 5000.0)}, DYNAMICS, "4 m/s^2"),
    "the wheel rests": (held_wheel, STEERING | {"C_af", "C_ar", "I_z"}, "noise"),
}  # fmt: skip


@pytest.mark.parametrize("case", UNTOLD)
def test_what_a_log_does_not_tell_is_refused_alone(case: str) -> None:
    change, names, reason = UNTOLD[case]
    found = identify(change(noisy()), CAR)
    gone = {*WITH} - known(found)
    if case == "the limit is not reached":
        assert gone - DYNAMICS == {"rate_max"}  # the yaw rate is that of another wheel
        assert reason in found["rate_max"].reason
        assert found.actuator.rate_max is None
        assert found["lag"].value == pytest.approx(LAG, rel=0.01)
        return
    assert gone == names
    assert all(found[name].reason and found[name].interval is None for name in names)
    assert any(reason in found[name].reason for name in names), [found[name].reason for name in names]
    if names >= DYNAMICS:
        with refused("yaw_response"):
            found.yaw_response(20.0)


def test_one_speed_tells_no_understeer_gradient_unless_the_axle_distances_are_known() -> None:
    log = constant_speed(noisy())
    assert known(identify(log)) == STEERING
    assert "20" in identify(log)["understeer_gradient"].reason
    check_inside(identify(log, CAR), WITH)


def test_steering_wheel_angles_are_divided_by_the_ratio() -> None:
    log = noisy()
    wheel = log | {name: 15.2 * log[name] for name in ("steering", "steering_command")}
    ours, theirs = identify(log, CAR), identify(wheel, CAR, steering_ratio=15.2)
    for name in WITH:
        assert theirs[name].value == pytest.approx(ours[name].value, rel=1e-3)


@pytest.mark.parametrize("shift", [0, 1, 10])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_delay_without_a_lag(shift: int, noise: float) -> None:
    command = perfect()["steering_command"]
    late = np.append(np.full(shift, command[0]), command[: T.size - shift])
    log = {"t": T, "steering_command": command, "steering": late + noise * np.random.default_rng(2).normal(size=T.size)}
    found = identify(log)
    assert (found["lag"].value, found["lag"].interval) == (0.0, (0.0, pytest.approx(0.02)))
    assert found["delay"].value == pytest.approx(0.02 * shift, abs=1e-6)
    assert found["rate_max"].value is None
    assert found.actuator == Actuator(delay=found["delay"].value)


def rows(log: Log, keep: np.ndarray) -> Log:
    return {name: values[keep] for name, values in log.items()}


def missing(log: Log) -> Log:
    """Single outputs, a part of an input, an infinite speed, a number of absurd size."""
    log = {name: values.copy() for name, values in log.items()}
    log["yaw_rate"][::7] = np.nan
    log["steering"][500:650] = np.nan
    log["speed"][3], log["yaw_rate"][100] = np.inf, 1e30
    return log


FORMS: dict[str, Callable[[Log], Any]] = {
    "data frame": pl.DataFrame,
    "seconds since 1970": lambda log: log | {"t": log["t"] + 1.7e9},
    "missing values": missing,
    "masked": lambda log: (
        log | {"yaw_rate": np.ma.masked_array(np.where(T % 1 < 0.1, 9.0, log["yaw_rate"]), T % 1 < 0.1)}
    ),
    "repeated times": lambda log: {name: np.repeat(values, 2) for name, values in log.items()},
    "a gap": lambda log: rows(log, (T < 20.0) | (T > 25.0)),
    "recordings": lambda log: [recording(rows(log, T < 30.0), "a"), recording(rows(log, T >= 30.0), "b")],
    "one without an angle": lambda log: [recording(log), recording({"t": T, "speed": T})],
    "a cut": lambda log: recording(log, cut=T == 30.0),
    "a system that steers at times": lambda log: recording(
        log | {"steering_command": np.where(T < 40.0, log["steering_command"], 0.3)}, engaged=T < 40.0
    ),
}


def recording(log: Log, name: str = "a", **columns: Any) -> Recording:
    none = np.full(log["t"].size, np.nan)
    return Recording(name, lane_offset=none, lane_width=none, valid=np.isfinite(none), **log, **columns)


@pytest.mark.parametrize("form", FORMS)
def test_a_log_has_many_forms(form: str) -> None:
    check_inside(identify(FORMS[form](noisy()), CAR), WITH)


def test_irregular_samples() -> None:
    """Of all signals but the command: one that is not in the log is not known."""
    log, keep = noisy(), np.random.default_rng(5).random(T.size) < 0.6
    found = identify(log | {"steering": np.where(keep, log["steering"], np.nan)})
    for name in STEERING:
        assert found[name].value == pytest.approx(TRUTH[name], rel=0.02)
    found = identify(rows(log, keep), CAR)
    for name in DYNAMICS:
        assert found[name].value == pytest.approx(TRUTH[name], rel=0.1)


@pytest.mark.parametrize("count", [0, 1, 2, 50])
def test_a_short_log_tells_nothing(count: int) -> None:
    found = identify(rows(noisy(), 0.02 * count - 0.01 > T), CAR)
    assert known(found) == set()
    assert found.notes == ()
    assert all(one.reason for one in found.estimates)


@pytest.mark.parametrize(
    ("arguments", "path"),
    [
        (({},), "log"), (({"t": T},), "log"), (({"speed": T},), "log"), ((3,), "log"), ((["a"],), "log"),
        (({"t": T, "speed": np.full(T.size, "x")},), "log"), (({"t": T, "speed": T[:5]},), "recording 'log'"),
        (({"t": -T, "speed": T},), "recording 'log'"), (("nowhere.csv",), "nowhere.csv"),
        (({"t": T, "speed": T}, 5), "vehicle"),
    ],
)  # fmt: skip
def test_what_is_no_log_is_refused(arguments: tuple[Any, ...], path: str) -> None:
    with refused(path, LdcError):
        identify(*arguments)
    with refused("steering_ratio", value=0.0):
        identify({"t": T, "speed": T}, steering_ratio=0.0)
