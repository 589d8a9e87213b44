"""The closed loop against an independent one, and its invariances."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from helpers import reference_loop as reference
from helpers.closed_loop import (
    Constant,
    InTheRoadFrame,
    Prepared,
    Stepped,
    assert_same_rows,
    make_scenarios,
    with_residuals,
)
from helpers.errors import refused
from ldctoolkit import Controller, EventStatus, LinearLaw, Plant, Scenarios, Setup, simulate
from ldctoolkit.controllers import LQI, LQR, LinearMPC, NoControl, PreviewLQR, PreviewProportional
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import BOUND


def preview_proportional(K_y: float, K_psi: float, T_lp: float = 0.0, sign: float = -1.0) -> reference.Law:
    return lambda x, yaw_rate, heading, *_: K_y * x[0] + K_psi * (x[2] + sign * (heading(T_lp) if T_lp else 0.0))


@pytest.mark.parametrize(
    ("convention", "settle"),
    [("consistent", 1.3), pytest.param("consistent", 0.0, marks=pytest.mark.slow), ("as_printed", 0.0)],
)
def test_preview_proportional_equals_the_reference(convention: str, settle: float) -> None:
    """Left and right, driven in ISO road coordinates by scipy: S to 1e-12 (1e-8 with a sign change). The path comes
    from the Runge-Kutta loop: to 1e-4 of its range."""
    given = {"K_y": -0.03, "K_psi": -0.25, "T_lp": 1.3}
    scenarios = make_scenarios(20, seed=4).take([0, 2, 4, 7, 9, 11, 13])
    out = simulate(
        PreviewProportional(**given, convention=convention), scenarios, y_s=0.1, settle=settle, trajectories=True
    )
    law = preview_proportional(**given, sign=-1.0 if convention == "consistent" else 1.0)
    crossed = 0
    for i in range(scenarios.n):
        expected = reference.drive(reference.Path.of(scenarios, i), law, y_s=0.1)
        assert out.S_uncorrected[i] == pytest.approx(expected.S_recorded, abs=1e-11)
        if np.isinf(expected.t_s):
            assert not out.triggered[i]
            assert out.S[i] == out.S_uncorrected[i]
            continue
        assert out.t_s[i] == pytest.approx(expected.t_s, abs=1e-12)
        (end,) = np.flatnonzero(out.trajectories.t[i] == scenarios.T[i])
        if settle == 0.0:
            assert np.isnan(out.trajectories.t[i, end + 1 :]).all()
        size = np.abs(expected.x).max(axis=0)
        assert (np.abs(out.trajectories.x[i, end] - expected.x_T) < 1e-4 * size).all()
        path = out.trajectories.x[i, : end + 1, 0]
        crossing = bool((path[:-1] * path[1:] < 0).any())
        crossed += crossing
        # one crossing found on a cubic instead of the true curve costs its error squared
        assert out.S[i] == pytest.approx(expected.S, abs=1e-8 if crossing else 1e-12)
    assert 0 < crossed < out.triggered.sum()


@pytest.mark.slow
@pytest.mark.parametrize(  # the first swings through the lane's centre several times
    ("v", "dt", "K_y", "K_psi"),
    [(18.0, 0.05, -0.06, -0.1), (1.5, 0.05, -0.6, -0.5), (3.0, 0.2, -0.3, -0.5), (12.0, 0.5, -0.075, -0.5)],
)
def test_S_is_exact_with_swings_at_low_speed_and_with_long_steps(v: float, dt: float, K_y: float, K_psi: float) -> None:
    """At low speed the lateral mode dies within one step: nothing that interpolates over the step would do. Such
    scenarios take substeps on the ideal plant too; their bound is 1e-5, what is seen here far less."""
    scenarios = Scenarios.from_arrays(T=[6.0, 9.0], d_y=[0.5, 0.9], v_mean=v, c_0=[1e-3, -5e-3 if v < 15 else -1e-3])
    law = PreviewProportional(K_y=K_y, K_psi=K_psi, T_lp=0.0)
    out = simulate(law, scenarios, y_s=0.1, dt=dt, settle=0.0, trajectories=True)
    crossings = 0
    for i in range(2):
        expected = reference.drive(reference.Path.of(scenarios, i), preview_proportional(K_y, K_psi), y_s=0.1, dt=dt)
        path = out.trajectories.x[i, :, 0]
        crossings += int((path[:-1] * path[1:] < 0).sum())
        assert out.S[i] == pytest.approx(expected.S, rel=1e-6)
    assert crossings > 0


def test_a_departure_shorter_than_the_step() -> None:
    scenarios = Scenarios.from_arrays(T=0.5, d_y=0.3, v_mean=20.0)
    out = simulate(PreviewProportional(), scenarios, y_s=0.2, dt=2.0)
    expected = reference.drive(
        reference.Path.of(scenarios, 0), preview_proportional(-0.005, -0.2, 2.0), y_s=0.2, dt=2.0
    )
    # steps follow the length of what is driven, not that of the sample
    assert out.S[0] == pytest.approx(expected.S, abs=5e-7)


@pytest.mark.parametrize("window", ["departure", "control"])
@pytest.mark.parametrize("y_s", [0.13, 9.0])
def test_no_control_reduces_by_exactly_nothing(window: str, y_s: float) -> None:
    out = simulate(NoControl(), make_scenarios(200), y_s=y_s, window=window)  # type: ignore[arg-type]
    assert (out.reduction == 0.0).all()
    assert (out.S_uncorrected == out.S).all()
    assert out.mean_reduction == 0.0


def test_windows_differ_by_what_was_before_the_trigger() -> None:
    scenarios = make_scenarios(50)
    departure, control = (simulate(LQR(r_delta=100.0), scenarios, window=w) for w in ("departure", "control"))
    assert departure.mean_reduction == pytest.approx(
        1.0 - departure.S.mean() / departure.S_uncorrected.mean(), rel=1e-12
    )
    np.testing.assert_allclose(departure.S_uncorrected - departure.S, control.S_uncorrected - control.S, atol=1e-12)
    untriggered = ~control.triggered
    assert untriggered.any()
    assert (control.S[untriggered] == 0).all()
    assert (control.reduction[untriggered] == 0).all()
    assert (control.status[untriggered] == EventStatus.NEVER_TRIGGERED).all()
    assert control.count(EventStatus.NEVER_TRIGGERED) == untriggered.sum()


@pytest.mark.parametrize(
    "law", [PreviewProportional(), LQR(r_delta=100.0), LinearMPC(horizon=4, r_delta=100.0)], ids=lambda law: law.name
)
def test_a_mirrored_departure_scores_the_same(law: Controller) -> None:
    """A right departure seen by the law in the road's own frame, and its mirrored left one."""
    left = dataclasses.replace(make_scenarios(40, seed=1), side=np.ones(40, dtype=np.int64))
    right = dataclasses.replace(left, side=-left.side)
    S_left, S_right = (simulate(InTheRoadFrame(law), side, y_s=0.1) for side in (left, right))
    assert S_left.triggered.sum() > 20
    np.testing.assert_allclose(S_right.S, S_left.S, rtol=0, atol=1e-12)


def highest(t: np.ndarray, value: np.ndarray, rate: np.ndarray) -> float:
    """Largest value of scipy's Hermite cubics through samples."""
    curve = CubicHermiteSpline(t, value, rate)
    return float(max(value.max(), curve(curve.derivative().roots(extrapolate=False)).max(initial=-np.inf)))


UNSTABLE = Constant((0.5, 0.0, 2.0, 0.0))


@pytest.mark.parametrize("settle", [0.0, 3.0])
def test_an_unstable_law_is_scored_at_the_bound_and_counted(settle: float) -> None:
    scenarios = make_scenarios(60, seed=9)
    out = simulate(UNSTABLE, scenarios, y_s=0.05, settle=settle, trajectories=True)
    diverged = out.status == EventStatus.DIVERGED
    assert diverged.sum() > 5
    assert np.isfinite(out.S).all()
    for i in np.flatnonzero(diverged):
        # the same run cut off at the last sample inside the bound, then the bound to the end
        path = out.trajectories.x[i, :, 0]
        last = np.flatnonzero(~np.isnan(path))[-1]
        assert np.abs(path[: last + 1]).max() <= BOUND
        t = out.trajectories.t[i, : last + 1]
        if t[-1] >= scenarios.T[i]:
            continue  # after the departure: nothing of it is scored
        inside = np.trapezoid(np.abs(path[: last + 1]), t)
        before = out.S_uncorrected[i] - simulate(NoControl(), scenarios.take([i]), y_s=0.05, window="control").S[0]
        expected = before + inside + BOUND * (scenarios.T[i] - t[-1])
        # the trapezoid rule on an exponential that grows tenfold in half a second
        assert out.S[i] == pytest.approx(expected, rel=0.02)
        assert np.isfinite(out.trajectories.delta[i, : last + 1]).all()
        assert np.isnan(out.trajectories.delta[i, last + 1 :]).all()
    # a neighbour that diverges changes nothing for the others
    others = np.flatnonzero(~diverged)
    assert_same_rows(simulate(UNSTABLE, scenarios.take(others), y_s=0.05, settle=settle), out, others)


@pytest.mark.parametrize("size", [1e6, 1e17, 1e300])
def test_the_score_before_a_divergence_is_kept(size: float) -> None:
    """One absurd command at sample 20: S up to there is that of the sane law."""
    scenarios = Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=20.0)
    sane = simulate(LQR(r_delta=100.0), scenarios, y_s=0.1, trajectories=True)
    control = simulate(LQR(r_delta=100.0), scenarios, y_s=0.1, window="control")
    for sign in (1.0, -1.0):
        kick = sign * size
        out = simulate(
            Stepped(LQR(r_delta=100.0), lambda delta, k, kick=kick: np.where(k == 20, kick, delta)), scenarios, y_s=0.1
        )
        assert out.count(EventStatus.DIVERGED) == 1
        path, t = sane.trajectories.x[0, :21, 0], sane.trajectories.t[0, :21]
        rate = sane.trajectories.x[0, :21, 1]
        area = np.trapezoid(path, t) + np.sum(np.diff(t) ** 2 * (rate[:-1] - rate[1:]) / 12)  # Hermite, path > 0
        assert (path > 0).all()
        before = sane.S_uncorrected[0] - control.S_uncorrected[0]
        assert out.S[0] == pytest.approx(before + area + BOUND * (4.0 - t[-1]), rel=1e-6)
        # the edge is deepest where it left, or where it was before leaving inwards
        deepest = BOUND - 0.85 if sign > 0 else highest(t, path, rate) - 0.85
        assert out.deepest[0] == pytest.approx(deepest, abs=1e-4)  # a cubic through samples, others through substeps


def test_deepest_is_that_of_the_cubic_through_the_samples_up_to_the_end() -> None:
    """No sample is deeper, and what comes after T is not looked at; scipy's Hermite cubics are the reference."""
    scenarios = make_scenarios(40, seed=12)
    # it steers late and hard: the edge goes on outwards, some of them beyond T
    out = simulate(PreviewProportional(K_y=-0.002, K_psi=-0.02), scenarios, y_s=0.1, trajectories=True)
    paths, between, later = out.trajectories, 0, 0
    for i in np.flatnonzero(out.triggered):
        counted = paths.t[i] <= scenarios.T[i]
        t, edge = paths.t[i, counted], paths.x[i, counted, 0] - 0.85
        assert out.deepest[i] == pytest.approx(highest(t, edge, paths.x[i, counted, 1]), abs=1e-6)
        between += out.deepest[i] > edge.max() + 1e-9
        later += np.nanmax(paths.x[i, :, 0]) - 0.85 > out.deepest[i]
    assert between > 5
    assert later > 5
    np.testing.assert_array_equal(out.deepest[~out.triggered], scenarios.d_y[~out.triggered])


def test_the_command_before_the_first_holds_the_recorded_path() -> None:
    """Steady steering angle for the yaw rate of the recorded path, from the bicycle model's textbook formula."""
    scenarios = Scenarios.from_arrays(T=[2.0, 5.0], d_y=[0.4, 0.5], v_mean=[20.0, 28.0], c_0=[2e-3, -1e-3])
    hold = Constant((0.0, 0.0, 0.0, 0.0), f_u=1.0)  # repeats the command before
    for given in ({"start": "steady"}, {"start": "printed"}, {"start": "printed", "initial_yaw_rate": "zero"}):
        out = simulate(hold, scenarios, y_s=0.0, trajectories=True, **given)
        for i in range(2):
            v, T, d_y = scenarios.v_mean[i], scenarios.T[i], scenarios.d_y[i]
            yaw_rate = v * scenarios.c_0[i] + (-8 * d_y / T**2) / v
            K_V = (1.47 - 1.43) * 1000.0 / (2 * 80000.0 * 2.9)
            assert out.trajectories.delta[i, 0] == pytest.approx((2.9 / v + K_V * v) * yaw_rate, rel=1e-10)
            turned = 0.0 if "initial_yaw_rate" in given else (-8 * d_y / T**2) / v
            assert out.trajectories.x[i, 0, 3] == pytest.approx(turned, rel=1e-12)


HELD = {
    "ideal": PlantOptions(),
    "mismatch": PlantOptions(mismatch=Mismatch(m=(0.8, 1.3), I_z=(0.8, 1.3), C_af=(0.7, 1.2), C_ar=(0.7, 1.2))),
    "profile": PlantOptions(speed="profile"),
    "actuator": PlantOptions(actuator=Actuator(lag=0.1, rate_max=0.5, delay=0.07)),
    "camera": PlantOptions(sensors=Sensors(delay=0.1, e_y_noise=0.03, kalman=KalmanFilter())),
    "tyres": PlantOptions(tyres=Tyres(model="magic_formula", mu=0.7)),
    "residuals": PlantOptions(residuals=Residuals(y=True, v=True, bandwidth=0.5)),
    "all": PlantOptions(
        speed="profile", actuator=Actuator(lag=0.1, rate_max=0.5, delay=0.07),
        mismatch=Mismatch(m=(0.8, 1.3), C_af=(0.8, 1.2), mu=(0.8, 1.1)), tyres=Tyres(model="magic_formula"),
        sensors=Sensors(delay=0.1, e_psi_noise=0.01), residuals=Residuals(y=True, v=True, bandwidth=0.5),
    ),
}  # fmt: skip


def start_of_a_held_wheel(scenarios: Scenarios, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lateral acceleration relative to the lane in the first two milliseconds, and that of the recorded path, (m,)."""
    setup = Setup(dt=1e-3, settle=0.0, **settings)
    out = simulate(Constant(f_u=1.0), scenarios, y_s=0.1, setup=setup, trajectories=True)
    rows = np.flatnonzero(out.triggered)
    path = UncorrectedPath.of(scenarios, setup.options.residuals, setup.seed).take(rows)
    rate = out.trajectories.x[rows, :3, 1]
    np.testing.assert_allclose(rate[:, 0], path.lateral_rate(out.t_s[rows]), rtol=1e-12)
    return (rate[:, 2] - rate[:, 0]) / 2e-3, path.lateral_acceleration(out.t_s[rows] + 1e-3)


@pytest.mark.parametrize(
    "option", [pytest.param(name, marks=() if name in ("ideal", "tyres") else pytest.mark.slow) for name in HELD]
)
def test_a_held_wheel_keeps_the_acceleration_of_the_path(option: str) -> None:
    """To 0.02 m/s^2, to the left and to the right, in bends, wherever the tyres can."""
    scenarios = with_residuals(make_scenarios(150, seed=4))
    at_peak = 8.0 * scenarios.d_y / scenarios.T**2 + scenarios.v_mean**2 * np.abs(scenarios.c_0) + 1.0
    scenarios = dataclasses.replace(scenarios, sigma_y=0.2 * scenarios.sigma_y).take(at_peak < 4.0)
    driven, path = start_of_a_held_wheel(scenarios, options=HELD[option], seed=3)
    assert path.size > 40
    assert np.abs(path).max() > 2.0
    assert np.abs(driven - path).max() < 0.02  # 0.013 with residuals, whose acceleration changes, 0.001 without
    printed, _ = start_of_a_held_wheel(scenarios, options=HELD[option], start="printed", seed=3)
    assert np.abs(printed - path).max() > 2.0


def test_the_printed_start_has_no_side_slip() -> None:
    """By hand: A[1, 2] = 320 m/s^2, beta = r (l_r/v - l_f m v/(2 C_ar L)) = -0.177778*0.116181; 10 m/s, y = 0. Printed:
    320*atan(0.133333) - 32*1.333333 - 0.64*0.177778 - 160*0.051709 = -8.637."""
    scenario = Scenarios.from_arrays(T=[1.5], d_y=[0.5], v_mean=[10.0])
    printed, steady = (
        simulate(Constant(f_u=1.0), scenario, y_s=0.0, dt=1e-4, start=start, trajectories=True).trajectories.x[0, :3]
        for start in ("printed", "steady")
    )
    assert steady[0, 2] == pytest.approx(0.133333 + 0.177778 * 0.116181, abs=1e-6)
    assert printed[0, 2] == pytest.approx(math.atan(0.133333), abs=1e-6)
    assert (steady[1, 1] - steady[0, 1]) / 1e-4 == pytest.approx(-16.0 / 9.0, abs=1e-3)
    assert (printed[1, 1] - printed[0, 1]) / 1e-4 == pytest.approx(-8.637, abs=0.02)


def test_a_path_has_one_distance_to_the_edge_whoever_drives_it() -> None:
    """By hand: e_psi = y'/v - beta, beta = (v c + y''/v) (l_r/v - l_f m v/(2 C_ar L)) of the steady turn."""
    values = {"T": [1.1708], "d_y": [0.3426], "v_mean": [8.274], "c_0": [-0.011476]}
    t = np.linspace(0.0, 1.1708, 100_001)
    y, rate, bend = 4 * 0.3426 / 1.1708**2 * np.stack([t * (1.1708 - t), 1.1708 - 2 * t, -2.0 + 0 * t])
    beta = (8.274 * -0.011476 + bend / 8.274) * (1.47 / 8.274 - 1.43 * 1000 * 8.274 / (160_000 * 2.9))
    front = y + 1.43 * (rate / 8.274 - beta)
    assert -front.max() == pytest.approx(-0.446, abs=5e-4)
    for side in ("left", "right"):
        scenario = Scenarios.from_arrays(**values, side=side)
        for start in ("steady", "printed"):
            dtle = simulate(NoControl(), scenario, start=start).metrics.dtle[0]
            assert dtle == pytest.approx(-front.max(), abs=1e-9)
        driven = simulate(LQR(), scenario, y_s=0.2, trajectories=True)
        e_y, _, e_psi, _ = driven.trajectories.x[0, 0]
        assert e_y + 1.43 * e_psi - 0.85 == pytest.approx(np.interp(driven.t_s[0], t, front), abs=1e-9)


@pytest.mark.parametrize("digits", [9, 10, 11, 15])
def test_a_delay_is_a_multiple_of_the_sample_time_but_for_rounding(digits: int) -> None:
    """Of a camera at 30 Hz and an actuator, 0.1 s each, at 1/30 s written with so many digits: S to 1e-6."""
    scenarios, dt = make_scenarios(12), float(f"{1 / 30:.{digits}f}")
    for sensors in (Sensors(), Sensors(delay=0.1, fps=30, kalman=KalmanFilter())):
        options = PlantOptions(actuator=Actuator(delay=0.1), sensors=sensors)
        for law in (LQR(), LQI(), PreviewLQR(), LinearMPC()):
            exact, rounded = (simulate(law, scenarios, 0.1, dt=step, options=options).S for step in (1 / 30, dt))
            np.testing.assert_allclose(rounded, exact, rtol=1e-6)
        assert sensors.age(dt) == pytest.approx(0.0 if sensors.ideal else 0.1, abs=1e-8)


@pytest.mark.parametrize("part", [1e-9, 1e-8, 3e-8, 1e-7, 1e-3])
def test_a_delay_of_any_small_part_of_a_sample_has_a_gain(part: float) -> None:
    scenarios = make_scenarios(12)
    late, exact = (simulate(LQR(), scenarios, 0.1, options=PlantOptions(actuator=Actuator(delay=delay))).S
                   for delay in (0.05 * (1.0 + part), 0.05))  # fmt: skip
    np.testing.assert_allclose(late, exact, rtol=part + 1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_either_matrix_starts_on_the_path(convention: str) -> None:
    scenarios = make_scenarios(40, seed=2)
    for yaw_rate in ("path", "zero"):
        driven, path = start_of_a_held_wheel(scenarios, convention=convention, initial_yaw_rate=yaw_rate)
        # without the path's yaw rate the turn is no steady one, and two milliseconds are enough to see it
        np.testing.assert_allclose(driven, path, rtol=0.05 if yaw_rate == "zero" else 0.02, atol=0.05)


def three_gains(plant: Plant) -> LinearLaw:
    return LinearLaw(np.zeros((plant.n, 3)), np.zeros(0), *[np.zeros((plant.n, 0))] * 2, np.zeros(plant.n))


@pytest.mark.parametrize(
    ("given", "path", "value"),
    [
        ({"controller": Stepped(fault=lambda delta, k: delta[:-1])}, "controller 'stepped': step: delta", ...),
        ({"controller": Prepared(three_gains)}, "controller 'prepared': F", ...),
        *(({name: value}, name, value) for name, values in (
            ("y_s", (-10.1, np.nan)), ("dt", (0.0, 50.0)), ("settle", (-0.1, 61.0, np.nan)),
            ("window", ("departures",)), ("initial_yaw_rate", ("none",))) for value in values),
        ({"controller": make_scenarios(5), "scenarios": LQR()}, "controller, scenarios", ...),
        ({"scenarios": {"T": 1.0}}, "scenarios", ...),
        ({"setup": {"dt": 0.1}}, "setup", ...),
    ],
)  # fmt: skip
def test_shapes_and_arguments_are_checked(given: dict[str, Any], path: str, value: Any) -> None:
    with refused(path, value=value):
        simulate(**{"controller": LQR(r_delta=100.0), "scenarios": make_scenarios(5), "y_s": 0.0} | given)


@pytest.mark.parametrize("speed", ["frozen", "profile"])
def test_paths_in_the_plane_follow_the_lane_on_their_true_side(speed: Any) -> None:
    """Against the lane's centre line, integrated from the parameters; the same departure to both sides, mirrored."""
    scenarios = Scenarios.from_arrays(
        T=4.0, d_y=[0.5, 0.5, 0.1], v_mean=22.0, a_mean=1.5, c_0=0.004, dc=-0.006, side=[1, -1, 1]
    )  # fmt: skip
    out = simulate(LQR(), scenarios, 0.2, options=PlantOptions(speed=speed), settle=2.0, trajectories=[1, 2, 0])
    paths = out.trajectories
    x, y, heading = paths.world()
    assert x.shape == y.shape == heading.shape == paths.t.shape
    assert np.isnan([x[1], y[1], heading[1]]).all()  # it never triggered
    assert np.isnan(paths.t[1]).all()
    for i, side in ((0, -1), (2, 1)):
        t = paths.t[i]
        start = t[0]

        def v(s: float, start: float = start) -> float:
            return 22.0 + 1.5 * (min(s if speed == "profile" else start, 4.0) - 2.0)

        def lane(s: float, pose: Any, side: int = side, v: Any = v) -> list[float]:
            curvature = side * (0.004 - 0.006 * min(s, 4.0) / 4.0)
            return [v(s) * np.cos(pose[2]), v(s) * np.sin(pose[2]), v(s) * curvature]

        centre = solve_ivp(lane, (start, t[-1]), [0.0, 0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=0.02).y
        e_y, e_psi = side * paths.x[i, :, 0], side * paths.x[i, :, 2]
        np.testing.assert_allclose(heading[i], centre[2] + e_psi, rtol=0, atol=1e-8)
        # from the centre line at right angles, to the left where positive
        np.testing.assert_allclose(x[i], centre[0] - e_y * np.sin(centre[2]), rtol=0, atol=1e-6)
        np.testing.assert_allclose(y[i], centre[1] + e_y * np.cos(centre[2]), rtol=0, atol=1e-6)
        assert (x[i, 0], y[i, 0]) == (0.0, side * paths.x[i, 0, 0])
        assert np.sign(y[i, 0]) == side  # left of the centre is positive
        assert np.sign(heading[i, 20] - e_psi[20]) == side  # a lane that bends outward
    np.testing.assert_array_equal([x[0], -y[0], -heading[0]], [x[2], y[2], heading[2]])


def test_no_path_in_the_plane_without_a_trigger() -> None:
    scenario = Scenarios.from_arrays(T=3.0, d_y=0.1, v_mean=25.0)
    x, y, heading = simulate(LQR(), scenario, 0.2, trajectories=True).trajectories.world()
    assert x.shape == (1, 1)
    assert np.isnan([x, y, heading]).all()
