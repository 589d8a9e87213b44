"""Actuator, mismatch, Kalman filter, and functions of the lanes."""

import warnings
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from helpers.closed_loop import Constant, Stepped, grid, some
from helpers.errors import refused
from helpers.reference_loop import Vehicle
from ldctoolkit import BicycleModel, Controller, Plant, Scenarios, VehicleParameters, simulate
from ldctoolkit import vector_math as lanes
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Tyres
from ldctoolkit.simulation.takeover import true_vehicles
from ldctoolkit.vehicle import Convention
from ldctoolkit.vehicle.kalman_filter import filter_gain

DT, SETTLE = 0.05, 0.4
STEP = 0.02  # [rad], of the command
JUMP = Stepped(Constant(), lambda delta, k: np.full_like(delta, STEP))
"""Commands one angle for ever, in the loop for any law."""

# T is no whole number of samples, and the second departure is to the right
SCENARIOS = Scenarios.from_arrays(side=[1, -1], T=[0.93, 0.777], d_y=0.4, v_mean=[25.0, 14.0], c_0=[1e-3, -2e-3])


def delta_0(i: int) -> float:
    """Steady steering of the recorded path, from the understeer gradient."""
    v, T, d_y = SCENARIOS.v_mean[i], SCENARIOS.T[i], SCENARIOS.d_y[i]
    gradient = (1.47 - 1.43) * 1000.0 / (2 * 80000.0 * 2.9)
    return float((2.9 / v + gradient * v) * (v * SCENARIOS.c_0[i] - 8 * d_y / T**2 / v))


def wheel(law: Controller, actuator: Actuator) -> list[tuple[np.ndarray, np.ndarray]]:
    """(t, delta) of each scenario, at samples, at T and at the end."""
    options = PlantOptions(actuator=actuator)
    out = simulate(law, SCENARIOS, y_s=0.0, dt=DT, options=options, settle=SETTLE, trajectories=True)
    rows = []
    for i in range(SCENARIOS.n):
        driven = ~np.isnan(out.trajectories.t[i])
        rows.append((out.trajectories.t[i, driven], out.trajectories.delta[i, driven]))
        assert rows[-1][0][-1] == pytest.approx(SCENARIOS.T[i] + SETTLE, abs=1e-9)
    return rows


def moved(s: np.ndarray, start: float, target: float, lag: float, rate: float) -> np.ndarray:
    """Angle s seconds after the target jumped, s < 0 before it: a ramp, then an exponential from where it ends."""
    way = target - start
    ramp = max(abs(way) / rate - lag, 0.0)
    reached = start + np.copysign(min(rate * ramp, abs(way)), way) if np.isfinite(rate) else start
    after = np.zeros_like(s) if lag == 0.0 else (reached - target) * np.exp(-np.maximum(s - ramp, 0.0) / max(lag, 1e-9))
    on_the_way = start + np.sign(way) * (rate if np.isfinite(rate) else 0.0) * s
    return np.where(s < 0.0, start, np.where(s < ramp, on_the_way, target + after))


ACTUATORS: dict[str, dict[str, Any]] = {
    "nothing": {}, "lag": {"lag": 0.13}, "short lag": {"lag": 1e-4}, "rate": {"rate_max": 0.11},
    "lag and rate": {"lag": 0.04, "rate_max": 0.15}, "rate that does not bind": {"lag": 0.5, "rate_max": 1.0},
}  # fmt: skip
DELAYS = (0.0, 0.15, 3 * DT, 0.013, 0.117, 5.0)  # 0.15/DT is a little less than 3, 3 DT a little more than 0.15


@pytest.mark.parametrize("limit", [None, 0.007])
@pytest.mark.parametrize(
    ("kind", "delay"),
    grid(ACTUATORS, DELAYS, *((kind, 0.117) for kind in ACTUATORS), *(("lag and rate", delay) for delay in DELAYS)),
)
def test_step_response_is_analytic(kind: str, delay: float, limit: float | None) -> None:
    """From the angle at the trigger, which is not limited, to the command or its limit."""
    given = ACTUATORS[kind]
    actuator = Actuator(**given, delay=delay, delta_max=limit)
    target = STEP if limit is None else limit
    for i, (t, delta) in enumerate(wheel(JUMP, actuator)):
        expected = moved(t - delay, delta_0(i), target, given.get("lag", 0.0), given.get("rate_max", np.inf))
        # where a delay is a whole number of samples the wheel starts to turn at a sample, up to rounding
        sure = np.abs(t - delay) > 1e-12 if not given else np.full(t.size, True)
        np.testing.assert_allclose(delta[sure], expected[sure], rtol=0, atol=1e-12)


@pytest.mark.parametrize("delay", [0.0, 2 * DT, 0.15])
def test_whole_delays_without_lag_are_exact_at_samples(delay: float) -> None:
    """The command of sample k is at the wheel from sample k + delay/dt on, that sample included."""
    for i, (t, delta) in enumerate(wheel(JUMP, Actuator(delay=delay))):
        late = round(delay / DT)
        assert (delta[:late] == pytest.approx(delta_0(i), rel=1e-12)) or late == 0
        np.testing.assert_array_equal(delta[late:], STEP)
        assert t[late] == pytest.approx(delay, abs=1e-12)


def test_the_rate_is_kept_between_samples_too() -> None:
    """A limit that no sample sees broken, with commands that arrive between samples and turn round at once."""
    for _, delta in wheel(Constant(f_u=-0.95), Actuator(rate_max=0.3, delay=0.021)):
        # two directions within one step
        assert (np.abs(np.diff(delta)) <= 0.3 * DT + 1e-12).all()
        assert (np.abs(np.diff(delta)) < 0.2 * 0.3 * DT).any()


def test_delta_prev_is_the_command_and_not_the_wheel() -> None:
    """The law multiplies what it commanded, whatever the wheel did with it."""
    limited = wheel(Constant(f_u=-1.0), Actuator(delta_max=0.001))
    for i, (_, delta) in enumerate(limited):
        # with the wheel's angle as delta_prev the limit would never be left, nor the sign of delta_0 come back
        np.testing.assert_allclose(delta[:4], -np.sign(delta_0(i)) * 0.001 * np.array([1, -1, 1, -1]), rtol=0, atol=0)


NOMINAL = VehicleParameters(C_af=61000.0, C_ar=93000.0, l_f=1.1, l_r=1.7, m=1573.3, I_z=2873.7)
RANGES = Mismatch(m=(0.9, 1.4), I_z=(0.8, 1.3), C_af=(0.6, 1.1), C_ar=(0.7, 1.2), mu=(0.3, 1.0))
TYRES = Tyres(model="magic_formula", mu=0.87)
NAMES = ("m", "I_z", "C_af", "C_ar", "mu")
MANY = Scenarios.from_arrays(T=np.full(20_000, 2.0), d_y=0.3, v_mean=20.0)


def nominal(name: str) -> float:
    return TYRES.mu if name == "mu" else float(getattr(NOMINAL, name))


def test_factors_are_uniform_on_their_ranges_and_independent() -> None:
    true = true_vehicles(NOMINAL, RANGES, TYRES, MANY, seed=3)
    factors = []
    for name in NAMES:
        low, high = getattr(RANGES, name)
        share = (getattr(true, name) / nominal(name) - low) / (high - low)
        # a fixed seed: the test decides once
        assert scipy.stats.kstest(share, "uniform").pvalue > 1e-3, name
        factors.append(share)
    correlation = np.corrcoef(factors) - np.eye(5)
    assert np.abs(correlation).max() < 4 / np.sqrt(MANY.n)


@given(st.floats(0.05, 5.0), st.floats(0.0, 5.0), st.integers(0, 2**63 - 1))
def test_factors_stay_in_their_ranges(low: float, width: float, seed: int) -> None:
    few = MANY.take(slice(50))
    true = true_vehicles(NOMINAL, Mismatch(C_ar=(low, low + width)), Tyres(), few, seed)
    assert np.all(true.C_ar >= low * NOMINAL.C_ar)
    assert np.all(true.C_ar <= (low + width) * NOMINAL.C_ar)


@pytest.mark.parametrize("ranges", [Mismatch(), Mismatch(mu=(0.3, 1.0))])
def test_a_range_of_one_leaves_the_nominal_number(ranges: Mismatch) -> None:
    true = true_vehicles(NOMINAL, ranges, TYRES, MANY, seed=3)
    for name in NAMES[:4]:
        assert set(getattr(true, name)) == {nominal(name)}
    assert np.unique(true.mu).size == (1 if ranges.ideal else MANY.n)
    assert (true.l_f, true.l_r) == (NOMINAL.l_f, NOMINAL.l_r)
    v = np.linspace(1.0, 60.0, MANY.n)
    for ours, theirs in zip(true.matrices(v, "consistent"), BicycleModel(NOMINAL).matrices(v), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_factor_does_not_depend_on_other_ranges() -> None:
    alone = true_vehicles(NOMINAL, Mismatch(C_ar=RANGES.C_ar), Tyres(), MANY, seed=3)
    np.testing.assert_array_equal(alone.C_ar, true_vehicles(NOMINAL, RANGES, TYRES, MANY, seed=3).C_ar)


@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_matrices_and_steady_cornering_equal_one_model_each(convention: Convention) -> None:
    few = MANY.take(slice(40))
    true = true_vehicles(NOMINAL, RANGES, TYRES, few, seed=3)
    v = np.linspace(3.0, 45.0, 40)
    A, B, E = true.matrices(v, convention)
    steady = true.steady_state(v, convention)
    for i in range(40):
        values = {name: float(getattr(true, name)[i]) for name in NAMES[:4]}
        model = BicycleModel(VehicleParameters(**values, l_f=NOMINAL.l_f, l_r=NOMINAL.l_r), convention)
        for ours, theirs in zip((A[i], B[i], E[i]), model.matrices(v[i]), strict=True):
            np.testing.assert_array_equal(ours, theirs[0])
        assert steady.delta[i] == model.steady_state(v[i]).delta[0]
        assert steady.e_psi[i] == model.steady_state(v[i]).e_psi[0]


def test_bad_input_is_named() -> None:
    with refused("seed", value=-1):
        true_vehicles(NOMINAL, Mismatch(), Tyres(), MANY, seed=-1)
    true = true_vehicles(NOMINAL, RANGES, TYRES, MANY.take(slice(2)), seed=3)
    with refused("v[1]", value=0.0):
        true.matrices([20.0, 0.0], "consistent")
    with refused("speed at the trigger", value=95.0):
        filter_gain(Plant.build(BicycleModel(), [20.0, 95.0], 0.05), KalmanFilter(), 1)
    unsolvable = KalmanFilter(q_y=1e150)
    with refused("sensors.kalman", LdcError, value=unsolvable), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of scipy, which is not certain where it gives up
        filter_gain(Plant.build(BicycleModel(), [20.0], 0.05), unsolvable, 1)


FILTERS = [KalmanFilter(), KalmanFilter(q_y=2.0, q_psi=0.05, r_y=0.1, r_psi=0.001), KalmanFilter(q_y=0.05, r_psi=0.05)]
C = np.eye(4)[[0, 2]]


def noises(kalman: KalmanFilter, dt: float) -> tuple[np.ndarray, np.ndarray]:
    Q = dt * np.diag([0.0, kalman.q_y**2, 0.0, kalman.q_psi**2])
    return Q, np.diag([kalman.r_y**2, kalman.r_psi**2])


@pytest.mark.parametrize("kalman", some(FILTERS, FILTERS[1]))
@pytest.mark.parametrize(("frame_samples", "dt"), grid([1, 2, 7], [0.02, 0.05], (2, 0.05), (7, 0.02)))
def test_gain_equals_scipys_riccati(kalman: KalmanFilter, frame_samples: int, dt: float) -> None:
    """At speeds between the nodes. Gains are up to 50 1/s, and the interpolant is good to 1e-12 of that."""
    v = np.concatenate([[1.0, 90.0], np.exp(np.random.default_rng(0).uniform(0.0, np.log(90.0), 10))])
    M = filter_gain(Plant.build(BicycleModel(), v, dt), kalman, frame_samples)
    Q, R = noises(kalman, dt)
    for i in range(v.size):
        A = scipy.linalg.expm(dt * Vehicle().matrices(v[i])[0])
        powers = [np.linalg.matrix_power(A, j) for j in range(frame_samples + 1)]
        Q_p = sum(power @ Q @ power.T for power in powers[:-1])
        P = scipy.linalg.solve_discrete_are(powers[-1].T, C.T, Q_p, R)
        np.testing.assert_allclose(M[i], P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=0, atol=1e-10)


def test_arc_tangent_sine_cosine_and_decay() -> None:
    """Over all that a plant may ask for; the errors are those that the functions state."""
    wide = np.concatenate([np.linspace(-20, 20, 4001), [-1e300, -1e9, 1e9, 1e300]])
    assert max(abs(lanes.arctan(x) - np.arctan(x)) for x in wide) < 3e-10
    turn = np.linspace(-np.pi, np.pi, 4001)
    assert max(abs(lanes.sine(x) - np.sin(x)) for x in turn) < 3e-11
    assert max(abs(lanes.cosine(x) - np.cos(x)) for x in turn) < 3e-11
    falling = np.linspace(-60.0, 0.0, 4001)
    assert max(abs(lanes.decay(x) / np.exp(x) - 1.0) for x in falling) < 1e-12
    assert lanes.decay(-1e6) < 1e-25


@pytest.mark.parametrize(
    ("x_0", "x_1", "n_0", "n_1"),
    [
        (0.3, -0.5, -0.2, -0.4), (-0.1, 0.2, 0.4, -0.3), (0.02, -1.0, 0.03, 1.2), (0.4, -0.1, 0.3, -0.2),
        (0.1, -0.3, 0.2, 0.4),
    ],
)  # fmt: skip
def test_the_integral_of_the_absolute_value_is_the_quartics(x_0: float, x_1: float, n_0: float, n_1: float) -> None:
    """One crossing, over and back, none: against a fine sum on a cubic, which is a quartic without its last term."""
    h = 0.4
    curve = CubicHermiteSpline([0.0, h], [x_0, n_0], [x_1, n_1])
    t = np.linspace(0.0, h, 400_001)
    expected = float(np.trapezoid(np.abs(curve(t)), t))
    assert lanes.absolute_area(x_0, x_1, n_0, n_1, float(curve.integrate(0.0, h)), h) == pytest.approx(
        expected, abs=1e-10
    )
