"""Departures that do not return, and triggers before the line, by distance or by time to line crossing."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from helpers.bits import assert_same_bits
from helpers.closed_loop import Constant, values
from helpers.errors import refused
from helpers.reference_loop import Vehicle
from ldctoolkit import Scenarios, Setup, VehicleParameters, simulate
from ldctoolkit.controllers import LQR, NoControl
from ldctoolkit.departures import DepartureSignals
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import Actuator, PlantOptions, Residuals, Tyres

EDGE, T = 0.85, 9.0  # m, from the edge to the line in the middle of the lane; s
ALL = np.array([  # speed, lateral velocity, radius, distance: two start beyond the middle of the lane, one at the line
    (50 / 3.6, 0.2, 600.0, 0.762), (70 / 3.6, 0.5, 1200.0, 1.1), (100 / 3.6, 0.7, 2400.0, 1.3), (20.0, 0.6, 900.0, 0.0)
])  # fmt: skip


def drifts(rows: Any = slice(None), **given: Any) -> Scenarios:
    v, rate, radius, distance = ALL[rows].T
    columns = {"v": v, "lateral_velocity": rate, "radius": radius, "distance": distance, "T": T}
    return Scenarios.from_drifts(**columns | given)


def path_of(scenarios: Scenarios, residuals: Residuals | None = None) -> UncorrectedPath:
    return UncorrectedPath.of(scenarios, residuals or Residuals(), seed=3)


def motion(v: float, rate: float, radius: float, distance: float, t: np.ndarray) -> list[np.ndarray]:
    """Position, its rate and second derivative: the heading grows by v/radius a second until v sin(heading) = rate."""
    end = radius / v * np.arcsin(rate / v)
    given = {"rtol": 1e-12, "atol": 1e-13, "dense_output": True}
    arc = solve_ivp(lambda t, y: [v * np.sin(v * t / radius)], (0.0, end), [-distance], **given).sol
    y = np.where(t < end, arc(np.minimum(t, end))[0], arc(end)[0] + rate * (t - end))
    heading = np.minimum(v * t / radius, np.arcsin(rate / v))
    return [y, v * np.sin(heading), np.where(t < end, v**2 / radius * np.cos(heading), 0.0)]


@pytest.mark.parametrize("row", range(4))
def test_without_control_it_is_an_arc_and_a_straight_line(row: int) -> None:
    """By integration of the heading: position to 1e-6 m, rate to 1e-6 m/s, acceleration to 1e-6 m/s^2."""
    t, path = np.linspace(0.0, T, 2001), path_of(drifts([row]))
    values = [curve(t[None, :])[0] for curve in (path.lateral, path.lateral_rate, path.lateral_acceleration)]
    np.testing.assert_allclose(values, motion(*ALL[row], t), atol=1e-6, rtol=0)
    np.testing.assert_array_equal(path.lateral(np.array([[-1.0]])), [[-ALL[row, 3]]])  # straight along the lane before


def test_the_score_is_the_integral_of_the_distance_to_the_middle() -> None:
    """By a trapezoid rule of 300,001 points, to 1e-7; what is before the trigger to 1e-6 m s."""
    t, out = np.linspace(0.0, T, 300_001), simulate(NoControl(), drifts(), y_s=-0.3)
    e_y = np.array([motion(*drift, t)[0] for drift in ALL]) + EDGE
    np.testing.assert_allclose(out.S, np.trapezoid(np.abs(e_y), t), rtol=1e-7)
    np.testing.assert_allclose(out.S_uncorrected, out.S, rtol=1e-12)
    law = [simulate(LQR(), drifts(), y_s=-0.3, window=window) for window in ("departure", "control")]
    grids = np.linspace(0.0, law[0].t_s, 300_001).T
    before = [
        np.trapezoid(np.abs(motion(*drift, grid)[0] + EDGE), grid) for drift, grid in zip(ALL, grids, strict=True)
    ]
    np.testing.assert_allclose(law[0].S - law[1].S, before, atol=1e-6)


def test_without_control_it_is_deepest_at_the_end_and_never_back() -> None:
    """The front tyre is l_f times the heading further out: the small angle of a vehicle that goes straight on."""
    out = simulate(NoControl(), drifts(), y_s=9.0)
    deepest = np.array([motion(*drift, np.array([T]))[0][0] for drift in ALL])
    np.testing.assert_allclose(out.metrics.deepest, deepest, atol=1e-6)
    np.testing.assert_allclose(drifts().d_y, deepest, atol=1e-6)
    np.testing.assert_allclose(-out.metrics.dtle, deepest + 1.43 * ALL[:, 1] / ALL[:, 0], atol=1e-6)
    assert np.isinf(out.metrics.t_back).all()


def setup_of(ahead: float, **given: Any) -> Setup:
    return Setup(**given, trigger="ttlc", ttlc=ahead) if ahead else Setup(**given)


def first(value: Any, least: float, end: float) -> float:
    """First time at which a function exceeds a value: a fine grid, and a root to 1e-13."""
    grid = np.linspace(0.0, end, 6001)
    k = next((k for k, t in enumerate(grid) if value(t) > least), -1)
    if k <= 0:
        return 0.0 if k == 0 else np.inf
    return float(brentq(lambda t: value(t) - least, grid[k - 1], grid[k], xtol=1e-13))


@pytest.mark.parametrize(
    ("y_s", "ahead"), [(-0.8, 0.0), (-0.4, 0.0), (0.1, 0.0), (0.0, 0.5), (0.0, 1.0), (-0.3, 1.7), (0.2, 6.0)]
)
def test_drifts_trigger_where_the_closed_form_says(y_s: float, ahead: float) -> None:
    """To 1e-9 s; the state is that of the path there."""
    out = simulate(LQR(), drifts(), y_s=y_s, setup=setup_of(ahead), trajectories=True)
    for i, (v, rate, radius, distance) in enumerate(ALL):
        end, deep = radius / v * np.arcsin(rate / v), radius * (1 - np.sqrt(1 - (rate / v) ** 2))

        def at(t: float) -> tuple[float, float]:
            heading = min(v * t / radius, np.arcsin(rate / v))  # noqa: B023
            y = radius * (1 - np.cos(heading)) - distance + rate * max(t - end, 0.0)  # noqa: B023
            return y, v * np.sin(heading)  # noqa: B023

        expected = first(lambda t: at(t)[0] + ahead * at(t)[1], y_s, T)
        assert out.t_s[i] == pytest.approx(expected, abs=1e-9)
        if expected > end:
            assert expected == pytest.approx(end + (y_s + distance - deep) / rate - ahead, abs=1e-9)
        t, x = out.trajectories.t[i, 0], out.trajectories.x[i, 0]
        assert t == out.t_s[i]
        np.testing.assert_allclose(x[:2], [at(t)[0] + EDGE, at(t)[1]], atol=1e-9)
        if t > end:  # without an acceleration there is no side slip
            np.testing.assert_allclose(x[2:], [rate / v, 0.0], atol=1e-5)
        else:
            assert x[3] == pytest.approx(v / radius * np.cos(v * t / radius), abs=1e-9)


@pytest.mark.parametrize(("y_s", "ahead"), [(0.3, 0.5), (0.3, 1.0), (0.45, 0.4), (0.0, 1.0), (-0.2, 0.7), (-0.2, 0.0)])
def test_parabolas_trigger_by_the_time_to_line_crossing(y_s: float, ahead: float) -> None:
    """To 1e-9 s; a departure begins at the line, so a trigger before it is at once."""
    duration, d_y, v, a = np.array([3.0, 5.0, 2.0]), np.array([0.3, 0.5, 0.25]), 22.0, np.array([0.0, 0.8, -1.0])
    given = Scenarios.from_arrays(T=duration, d_y=d_y, v_mean=v, a_mean=a)
    t_s = simulate(LQR(), given, y_s=y_s, setup=setup_of(ahead)).t_s
    for i in range(3):

        def value(t: float) -> float:
            x = (v - a[i] * duration[i] / 2) * t + a[i] * t**2 / 2  # noqa: B023
            s, rate = x / (v * duration[i]), (v + a[i] * (t - duration[i] / 2)) / (v * duration[i])  # noqa: B023
            return 4 * d_y[i] * (s * (1 - s) + ahead * rate * (1 - 2 * s))  # noqa: B023

        expected = first(value, y_s, duration[i])
        assert t_s[i] == pytest.approx(expected, abs=1e-9)
        assert y_s > 0 or expected == 0.0


def test_parabolas_with_residuals_trigger_by_the_time_to_line_crossing() -> None:
    """The rate is a difference over 2e-6 s: to 1e-7 s."""
    given = Scenarios.from_arrays(T=[4.0, 6.0], d_y=[0.35, 0.5], v_mean=25.0, sigma_y=[0.04, 0.03], sigma_v=0.2)
    residuals = Residuals(y=True, v=True)
    setup = setup_of(0.6, options=PlantOptions(residuals=residuals), seed=3)
    t_s = simulate(LQR(), given, y_s=0.4, setup=setup).t_s
    for i in range(2):
        single = path_of(given, residuals).take([i])

        def value(t: float) -> float:
            y = single.lateral(t + np.array([[-1e-6, 0.0, 1e-6]]))[0]  # noqa: B023
            return y[1] + 0.6 * (y[2] - y[0]) / 2e-6

        assert t_s[i] == pytest.approx(first(value, 0.4, given.T[i]), abs=1e-7)
    assert (t_s > 0.05).all()


def test_recorded_signals_trigger_on_the_smooth_path_nearest_to_them() -> None:
    """y + ttlc dy/dt of the curve that the samples are of, to 5 ms; before the line at the first sample."""
    t = np.linspace(0.0, 4.0, 41)
    y = 0.5 * np.sin(np.pi * t / 4.0) ** 2
    signals = DepartureSignals(np.array([0, 41]), t, y, np.full(41, 21.0), np.zeros(41))
    given = dataclasses.replace(Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=21.0), signals=signals)

    def ahead(at: float) -> float:
        return 0.5 * np.sin(np.pi * at / 4.0) ** 2 + 0.4 * np.pi / 8 * np.sin(np.pi * at / 2.0) - 0.45

    expected = brentq(ahead, 0.5, 1.9)
    assert simulate(LQR(), given, y_s=0.45, setup=setup_of(0.4)).t_s[0] == pytest.approx(expected, abs=5e-3)
    assert 0.3 < expected < simulate(LQR(), given, y_s=0.45).t_s[0] - 0.2
    assert simulate(LQR(), given, y_s=-0.3).t_s[0] == 0.0
    assert not simulate(LQR(), given, y_s=0.9, setup=setup_of(0.1)).triggered[0]


# ------------------------------------------------------------------------------------------------ the closed loop

BUILT = PlantOptions(speed="profile", actuator=Actuator(rate_max=0.3, lag=0.1), tyres=Tyres(model="magic_formula"))


@pytest.mark.parametrize("options", [PlantOptions(), BUILT], ids=["ideal", "built"])
def test_left_and_right_are_mirror_images(options: PlantOptions) -> None:
    """To the bit; and a steering ratio changes nothing."""
    left = simulate(LQR(), drifts(side="left", c=2e-4), y_s=-0.3, options=options)
    right = simulate(LQR(), drifts(side="right", c=2e-4), y_s=-0.3, options=options)
    assert_same_bits(values(left), values(right))
    assert left.triggered.all()
    setup = Setup(vehicle=VehicleParameters(steering_ratio=20.0), options=options)
    assert_same_bits(values(simulate(LQR(), drifts(c=2e-4), y_s=-0.3, setup=setup)), values(left))


GAINS = (-0.02, -0.01, -0.45, -0.05)


@pytest.mark.parametrize(("lag", "tolerance"), [(0.0, 1e-6), (0.1, 1e-4)])
def test_a_linear_law_steers_back_as_an_independent_loop_says(lag: float, tolerance: float) -> None:
    """DTLE and depth by matrix exponentials of a fortieth of a sample, from the state at the trigger to T."""
    options = PlantOptions(actuator=Actuator(lag=lag))
    out = simulate(Constant(F=GAINS), drifts([0, 1, 2]), y_s=-0.2, dt=0.02, options=options, trajectories=True)
    for i in range(3):
        A, B, _ = Vehicle().matrices(ALL[i, 0])
        M = np.zeros((6, 6))  # state, wheel, command
        M[:4, :4], M[:4, 4 if lag else 5] = A, B
        if lag:
            M[4, 4:] = -1 / lag, 1 / lag
        state = np.array([*out.trajectories.x[i, 0], out.trajectories.delta[i, 0], 0.0])
        steps, rest = divmod(T - out.t_s[i], 0.02)
        front, edge = [state[0] + 1.43 * state[2] - EDGE], [state[0] - EDGE]
        for over in [expm(M * 0.02 / 40)] * int(steps) + [expm(M * rest / 40)]:
            state[5] = np.dot(GAINS, state[:4])
            for _ in range(40):
                state = over @ state
                front.append(state[0] + 1.43 * state[2] - EDGE)
                edge.append(state[0] - EDGE)
        assert out.metrics.dtle[i] == pytest.approx(-max(front), abs=tolerance)
        assert out.metrics.deepest[i] == pytest.approx(max(edge), abs=tolerance)


def test_a_vehicle_that_never_leaves_is_back_at_the_trigger() -> None:
    hard = simulate(LQR(r_delta=500.0), drifts([0, 1, 2]), y_s=-0.4)
    assert (hard.metrics.deepest < 0.0).all()
    np.testing.assert_array_equal(hard.metrics.t_back, hard.t_s)
    late = simulate(LQR(r_delta=500.0), drifts([0, 1, 2]), y_s=0.05)
    assert (late.metrics.t_back > late.t_s + 0.1).all()


@pytest.mark.parametrize(
    ("given", "path", "value", "allowed"),
    [
        ({"lateral_velocity": 30.0}, "scenarios.lateral_velocity[0]", 30.0, "below the speed"),
        ({"lateral_velocity": [1, 0, 1, 1]}, "scenarios.lateral_velocity[1]", 0.0, "> 0"),
        ({"radius": 0}, "scenarios.radius[0]", 0.0, "> 0"),
        ({"distance": [1, 1, np.nan, 1]}, "scenarios.distance[2]", np.nan, ">= 0"),
        *(({name: given}, "scenarios", ..., "") for name, given in (
            ("T", [1.0] * 3), ("radius", [600.0] * 3), ("side", ["left", "right"]))),
        ({"v": [20.0, np.nan, 20.0, 20.0]}, "scenarios.v_mean[1]", np.nan, "finite numbers"),
        ({"T": 601}, "scenarios.T[0]", 601.0, "up to 600 s"),
        ({"side": "up"}, "scenarios.side[0]", "up", {"left", "right"}),
    ],
)  # fmt: skip
def test_bad_drifts_are_named(given: dict[str, Any], path: str, value: Any, allowed: Any) -> None:
    with refused(path, value=value, allowed=allowed):
        drifts(**given)


@pytest.mark.parametrize(
    ("given", "path", "value", "allowed"),
    [
        ({"trigger": "distnace"}, "trigger", "distnace", {"distance", "ttlc"}),
        ({"ttlc": 2.0}, "ttlc", 2.0, ""),
        ({"trigger": "ttlc", "ttlc": 0.0}, "ttlc", 0.0, "a finite number > 0 and <= 10 s"),
        ({"y_s": -11}, "y_s", -11, "a finite number >= -10 m"),
    ],
)
def test_bad_triggers_are_named(given: dict[str, Any], path: str, value: Any, allowed: Any) -> None:
    with refused(path, value=value, allowed=allowed):
        simulate(NoControl(), drifts(), **given)
