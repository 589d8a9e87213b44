"""The companions of S on signals whose answers are known, and against brute force."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicHermiteSpline

from ldctoolkit import BicycleModel, metrics
from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]
NAN = math.nan

ROUNDING = 1e-12
"""Values of the order of one, a few operations each."""


def sine(t: FloatArray, amplitude: float = 0.4, omega: float = 1.7) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A path, its slope and its second derivative."""
    return (
        amplitude * np.sin(omega * t),
        amplitude * omega * np.cos(omega * t),
        -amplitude * omega**2 * np.sin(omega * t),
    )


# ---------------------------------------------------------------- lateral acceleration


def test_acceleration_of_a_sine_on_a_bend() -> None:
    t = np.linspace(0.0, 4.0, 81)
    v, c = np.array([20.0, 30.0]), np.array([0.002, -0.001])
    _, _, second = sine(t)
    a_y = metrics.lateral_acceleration(np.tile(second, (2, 1)), v, np.tile((v * c)[:, None], (1, 81)))
    expected = -0.4 * 1.7**2 * np.sin(1.7 * t) + (v**2 * c)[:, None]
    np.testing.assert_allclose(a_y, expected, atol=ROUNDING)
    # a speed for each sample gives the same
    speeds = np.tile(v[:, None], (1, 81))
    np.testing.assert_array_equal(
        metrics.lateral_acceleration(np.tile(second, (2, 1)), speeds, speeds * c[:, None]), a_y
    )


@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_acceleration_of_the_linear_vehicle_is_what_its_path_says(convention: str) -> None:
    """Against central differences of a path integrated by solve_ivp, on both sides of a jump of the angle."""
    model = BicycleModel(convention=convention)  # type: ignore[arg-type]
    v, r = 22.0, 0.03
    A, B, E = (m[0] for m in model.matrices([v]))
    angles = [0.004, -0.006, 0.001]
    h = 0.2
    x, rows, smooth = np.array([0.9, 0.3, 0.01, 0.005]), [], []
    for angle in angles:
        path = solve_ivp(
            lambda _, z, d=angle: A @ z + B * d + E * r, (0.0, h), x, rtol=1e-12, atol=1e-14, dense_output=True
        ).sol
        # one-sided differences of de_y/dt of second order, eps 1e-4: error below 1e-6
        eps = 1e-4
        at = [path(s)[1] for s in (0.0, eps, 2 * eps, h - 2 * eps, h - eps, h)]
        start = (-3 * at[0] + 4 * at[1] - at[2]) / (2 * eps)
        end = (3 * at[5] - 4 * at[4] + at[3]) / (2 * eps)
        smooth.append((start + v * r, end + v * r))
        rows.append(x)
        x = path(h)
    states = np.array([[*rows, x]])
    left, right = metrics.linear_lateral_acceleration(
        model, [v], states, np.array([[*angles, NAN]]), np.full((1, 4), r), [0.002]
    )
    np.testing.assert_allclose(right[0, :3], [s for s, _ in smooth], atol=1e-5)
    np.testing.assert_allclose(left[0, 1:], [e for _, e in smooth], atol=1e-5)
    assert right[0, 3] == left[0, 3]
    # before the first sample: the same state with the angle before
    jump = B[1] * (angles[0] - 0.002)
    assert right[0, 0] - left[0, 0] == pytest.approx(jump, abs=ROUNDING)


# ---------------------------------------------------------------- jerk


def test_moving_average_of_a_sine() -> None:
    """(2/W) sin(omega W/2) cos(omega (t - W/2)) where the window is a whole number of samples."""
    t = 1.3 + np.arange(61) * 0.05
    a, omega, window = 2.0, 2.5, 0.5
    a_y = a * np.sin(omega * t)
    left, right = metrics.moving_average_jerk(t, a_y, a_y, before=a_y[0], window=window)
    expected = a * (2.0 / window) * math.sin(omega * window / 2) * np.cos(omega * (t - window / 2))
    later = t > t[0] + window - 1e-9
    np.testing.assert_allclose(right[later], expected[later], atol=ROUNDING)
    np.testing.assert_allclose(left[later], expected[later], atol=ROUNDING)


@given(st.floats(-8.0, 8.0), st.floats(-3.0, 3.0), st.floats(0.011, 1.3), st.floats(0.05, 2.0), st.floats(0.0, 9.0))
def test_moving_average_of_a_ramp_is_its_slope(
    slope: float, start: float, dt: float, window: float, trigger: float
) -> None:
    """Any window, any dt, shorter and longer than the window: exact, as a straight line is interpolated exactly."""
    since = np.arange(int(3.0 / dt) + 2) * dt
    a_y = start + slope * since
    for jerk in metrics.moving_average_jerk(trigger + since, a_y, a_y, before=start, window=window):
        expected = slope * np.minimum(since / window, 1.0)  # constant history: the mean over what has ramped so far
        # rounding of t (1e-15) over the window
        np.testing.assert_allclose(jerk, expected, atol=1e-10)


def test_a_jump_at_the_first_sample() -> None:
    """It stays in the window for half a second and leaves with it: both sides of both ends are seen."""
    t = 2.0 + np.arange(13) * 0.05
    a_y = np.full(13, 1.5)
    left, right = metrics.moving_average_jerk(t, a_y, a_y, before=0.5, window=0.5)
    step = 1.0 / 0.5
    np.testing.assert_allclose(right, [step] * 10 + [0.0] * 3, atol=ROUNDING)
    np.testing.assert_allclose(left, [0.0] + [step] * 10 + [0.0] * 2, atol=ROUNDING)
    # the first left limit is `before`, whatever it says
    a_y[0] = NAN
    again, _ = metrics.moving_average_jerk(t, a_y, np.full(13, 1.5), before=0.5)
    np.testing.assert_array_equal(again, left)


def brute_force_jerk(
    t: FloatArray, left: FloatArray, right: FloatArray, before: float, window: float, side: int
) -> list[float]:
    """From the definition, one sample at a time; `side` -1 or +1."""

    def a_y(at: float) -> float:
        for i in range(len(t)):
            if abs(at - t[i]) < 1e-9:
                return float((left[i] if i else before) if side < 0 else right[i])
        i = int(np.searchsorted(t, at))
        return before if i == 0 else float(np.interp(at, [t[i - 1], t[i]], [right[i - 1], left[i]]))

    return [(a_y(float(s)) - a_y(float(s) - window)) / window for s in t]


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.07, 0.1, 0.3, 0.8]), st.sampled_from([0.5, 0.33, 0.2]))
def test_jerk_equals_brute_force(seed: int, dt: float, window: float) -> None:
    """Windows that are no multiple of dt, dt longer than the window, a short last step, jumps everywhere."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 25))
    t = rng.uniform(0, 5) + np.arange(k) * dt
    if k > 1:
        t[-1] -= rng.uniform(0.01, 0.99) * dt
    left, right = np.asarray(rng.normal(size=(2, k)), dtype=np.float64)
    jerk = metrics.moving_average_jerk(t, left, right, before=0.3, window=window)
    for side, values in zip((-1, 1), jerk, strict=True):
        expected = brute_force_jerk(t, left, right, 0.3, window, side)
        np.testing.assert_allclose(values, expected, atol=1e-11)  # slopes up to 100, times rounded to 1e-15
    peak = metrics.jerk_peak(t, left, right, before=0.3, window=window)
    assert peak == np.max(np.abs(jerk))


def test_windows_of_whole_samples_do_not_hang_on_rounding() -> None:
    """t - 0.5 s falls on a sample up to rounding, left or right of it: the jump there is on one side all the same."""
    jumps = np.arange(200.0)  # a_y jumps by one at every sample
    for start in np.linspace(0.0, 9.0, 37):
        t = start + np.arange(200) * 0.05
        left, right = metrics.moving_average_jerk(t, jumps, jumps + 1.0, before=0.0)
        np.testing.assert_allclose(left[11:], 20.0, atol=ROUNDING)
        np.testing.assert_allclose(right[11:], 20.0, atol=ROUNDING)


def test_peak_acceleration_sees_both_limits_but_not_what_was_before() -> None:
    t = np.array([[0.0, 0.1, 0.2], [0.0, 0.1, NAN]])
    left = np.array([[9.0, -3.0, 1.0], [9.0, 1.0, NAN]])
    right = np.array([[1.0, 2.0, NAN], [-2.0, NAN, NAN]])
    np.testing.assert_array_equal(metrics.acceleration_peak(t, left, right), [3.0, 2.0])
    left[1, 1] = 4.0
    np.testing.assert_array_equal(metrics.acceleration_peak(t, left, right), [3.0, 4.0])


# ---------------------------------------------------------------- positions


@example([0.0, 0.0, 1.0, -1.0], [1.0], 1.0)
@example([0.0, 1.0, -1.0, 0.0], [1.0], 1.0)
@given(
    st.lists(st.integers(-2000, 2000).map(lambda c: c / 1000), min_size=4, max_size=4),
    st.lists(st.floats(0.05, 1.0), min_size=1, max_size=6),
    st.floats(0.0, 1.2),
)
def test_peaks_of_cubics_are_exact(coefficients: list[float], steps: list[float], share: float) -> None:
    """Hermite interpolation reproduces a polynomial of degree 3, and so its peak, wherever the samples are."""
    p = np.polynomial.Polynomial(coefficients)
    t = np.concatenate([[0.0], np.cumsum(steps)])
    until = share * t[-1]
    inside = min(until, t[-1])
    roots = p.deriv().roots() if np.any(np.abs(coefficients[1:]) > 1e-9) else np.zeros(0)
    places = [0.0, inside, *(float(z.real) for z in roots if abs(z.imag) < 1e-9 and 0 <= z.real <= inside)]
    found = float(metrics.largest_on_path(t, p(t), p.deriv()(t), until))
    # double roots of a derivative are known to the root of rounding only, which the value does not feel
    assert found == pytest.approx(max(float(p(s)) for s in places), abs=1e-11)


def test_peak_between_samples_equals_a_dense_spline() -> None:
    t = np.linspace(0.5, 6.5, 25)
    value, rate, _ = sine(t, omega=2.3)
    spline = CubicHermiteSpline(t, value, rate)
    for until in (0.9, 1.3, 3.0, 6.5, np.inf):
        dense = spline(np.linspace(0.5, min(until, 6.5), 200_001)).max()
        # the grid of 3e-5 s misses a peak by at most rate^2: curvature 2 times its square, below 1e-9
        assert float(metrics.largest_on_path(t, value, rate, until)) == pytest.approx(dense, abs=1e-9)


def test_depth_and_distance_stop_at_T_and_overshoot_does_not() -> None:
    """A parabola in time, deepest between the samples at t = 1.25, and on its way to the other side."""
    t = np.array([[1.0, 1.5, 2.0, 2.5, 3.0]])
    depth = 0.3 - 0.8 * (t - 1.25) ** 2
    e_y, rate = 0.85 + depth, -1.6 * (t - 1.25)
    e_psi, e_psi_rate = rate / 20.0, np.full_like(t, -1.6 / 20.0)
    assert metrics.deepest_position(t, e_y, rate, T=[2.0], edge_offset=0.85) == pytest.approx(0.3, abs=ROUNDING)
    assert metrics.deepest_position(t, e_y, rate, T=[1.1], edge_offset=0.85) == pytest.approx(
        0.3 - 0.8 * 0.15**2, abs=ROUNDING
    )
    # e_y + l_f e_psi peaks where rate = -l_f e_psi_rate
    l_f = 1.4
    at = 1.25 - l_f / 20.0
    worst = 0.3 - 0.8 * (at - 1.25) ** 2 + l_f * (-1.6 * (at - 1.25)) / 20.0
    dtle = metrics.distance_to_lane_edge(t, e_y, rate, e_psi, e_psi_rate, T=[2.0], edge_offset=0.85, l_f=l_f)
    assert dtle == pytest.approx(-worst, abs=ROUNDING)
    assert -dtle > 0.3  # the front axle is further out than the centre of gravity
    over = metrics.overshoot(t, e_y, rate, edge_offset=0.85)
    assert over == pytest.approx(-(0.3 - 0.8 * 1.75**2) - 2 * 0.85, abs=ROUNDING)
    assert metrics.overshoot(t[:, :3], e_y[:, :3], rate[:, :3], edge_offset=0.85) == 0.0


def test_time_back_on_a_parabola_and_a_cubic() -> None:
    t = np.array([1.0, 1.4, 1.9, 2.2, 3.0])
    depth = np.polynomial.Polynomial([0.3, 0.0, -0.8])(t - 1.25)
    rate = -1.6 * (t - 1.25)
    back = metrics.time_back_inside(t, 0.85 + depth, rate, edge_offset=0.85)
    assert float(back) == pytest.approx(1.25 + math.sqrt(0.3 / 0.8), abs=ROUNDING)
    p = np.polynomial.Polynomial([0.2, 0.5, -0.3, -0.1])  # one root beyond 0
    root = float(max(z.real for z in p.roots() if abs(z.imag) < 1e-12))
    samples = np.linspace(0.0, 4.0, 6)
    back = metrics.time_back_inside(samples + 0.7, p(samples), p.deriv()(samples), edge_offset=0.0)
    assert float(back) == pytest.approx(root + 0.7, abs=ROUNDING)


def test_time_back_takes_the_first_of_several_crossings() -> None:
    t = np.linspace(0.5, 12.5, 241)  # rises through 0 at 0.5, back at pi, out again, back again
    e_y, rate, _ = sine(t, omega=1.0)
    # cubic through a sine, step 0.05: (h^4/384) error, over the slope
    assert float(metrics.time_back_inside(t, e_y, rate, edge_offset=0.0)) == pytest.approx(math.pi, abs=2e-8)
    assert metrics.time_back_inside(t[:40], e_y[:40], rate[:40], edge_offset=0.0) == np.inf


def test_time_back_at_the_ends_of_a_step() -> None:
    t = [1.0, 2.0, 3.0]
    assert metrics.time_back_inside(t, [1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], edge_offset=0.0) == 2.0
    # triggered on the line itself: outwards first, or at once inwards
    assert metrics.time_back_inside(t, [0.0, -1.0, -2.0], [-1.0, -1.0, -1.0], edge_offset=0.0) == 1.0
    assert metrics.time_back_inside(t, [0.0, 0.5, -0.5], [1.0, 0.0, 0.0], edge_offset=0.0) == pytest.approx(2.5)
    assert metrics.time_back_inside(t, [0.0, 0.0, -0.5], [0.0, 0.0, -1.0], edge_offset=0.0) == 1.0
    assert metrics.time_back_inside([1.0], [0.5], [0.0], edge_offset=0.0) == np.inf


# ---------------------------------------------------------------- steering


def test_steering_on_a_simple_sequence() -> None:
    t = np.array([[0.0, 0.5, 1.0, 1.25], [3.0, 3.5, NAN, NAN]])
    delta = np.array([[0.25, -0.5, 0.125, NAN], [0.5, NAN, NAN, NAN]])
    before = [0.125, 0.0]
    np.testing.assert_array_equal(metrics.steering_peak(t, delta), [0.5, 0.5])
    np.testing.assert_array_equal(metrics.steering_travel(t, delta, delta_0=before), [0.125 + 0.75 + 0.625, 0.5])
    np.testing.assert_array_equal(metrics.steering_rate_peak(t, delta, delta_0=before, dt=0.5), [1.5, 1.0])
    effort = [0.5 * 0.0625 + 0.5 * 0.25 + 0.25 * 0.015625, 0.5 * 0.25]
    np.testing.assert_array_equal(metrics.steering_effort(t, delta), effort)
    # the first change alone can be the fastest
    assert metrics.steering_rate_peak(t[0], delta[0], delta_0=-1.0, dt=0.5) == 2.5
    # an angle that is known at the end counts as a change, not as effort
    known = np.array([0.25, -0.5, 0.125, 1.125])
    assert metrics.steering_travel(t[0], known, delta_0=0.125) == 2.5
    assert metrics.steering_effort(t[0], known) == effort[0]


def test_effort_of_held_samples_equals_quadrature() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.02, 0.3, 12))
    delta = rng.normal(scale=0.02, size=12)
    integral, _ = quad(
        lambda s: float(delta[np.searchsorted(t, s, side="right") - 1]) ** 2, t[0], t[-1], points=t, limit=200
    )
    assert float(metrics.steering_effort(t, delta)) == pytest.approx(integral, rel=1e-9)


# ---------------------------------------------------------------- everything together


@dataclasses.dataclass(frozen=True)
class Driven:
    """Arguments of `companions`: three scenarios, the last never triggered."""

    t: FloatArray
    x: FloatArray
    delta: FloatArray
    a_left: FloatArray
    a_right: FloatArray
    T: FloatArray
    t_s: FloatArray
    dt: float
    delta_0: FloatArray
    a_before: FloatArray
    edge_offset: float = 0.85
    l_f: float = 1.43
    deepest_before: FloatArray = dataclasses.field(default_factory=lambda: np.array([0.2, 0.2, 0.15]))
    dtle_before: FloatArray = dataclasses.field(default_factory=lambda: np.array([-0.22, -0.9, -0.17]))

    def companions(self) -> metrics.Companions:
        arguments = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return metrics.companions(**arguments)


def driven(seed: int = 0, dt: float = 0.1) -> Driven:
    """Sines as paths, random accelerations and angles; T between samples in the first, on a sample in the second."""
    rng = np.random.default_rng(seed)
    t_s, T = np.array([0.6, 0.9, np.inf]), np.array([1.45, 1.9, 1.2])
    times = [
        [0.6 + 0.1 * i for i in range(9)] + [1.45] + [1.5, 1.6, 1.7, 1.75],
        [0.9 + 0.1 * i for i in range(14)],
        [],
    ]
    k = 15
    t = np.full((3, k), NAN)
    for row, values in zip(t, times, strict=True):
        row[: len(values)] = values
    used = np.isfinite(t)
    e_y, e_y_rate, _ = sine(t, 1.4, 2.0)
    e_psi, e_psi_rate, _ = sine(t, 0.02, 3.0)
    a_left, a_right, delta = np.where(used, rng.normal(size=(3, 3, k)), NAN)
    # at T between two samples nothing jumps, and nothing is looked at
    a_left[0, 9] = a_right[0, 9] = 50.0
    delta[0, 9] = delta[0, 8]
    # what the law would do at the end is not asked
    delta[0, 13] = delta[1, 13] = a_right[0, 13] = a_right[1, 13] = NAN
    x = np.stack([e_y, e_y_rate, e_psi, e_psi_rate], axis=-1)
    delta_0, a_before = rng.normal(size=(2, 3))
    return Driven(t, x, delta, a_left, a_right, T, t_s, dt, delta_0, a_before)


def test_companions_put_the_parts_together() -> None:
    case = driven()
    result = case.companions()
    e_y, e_y_rate, e_psi, e_psi_rate = np.moveaxis(case.x, -1, 0)
    for i in (0, 1):
        n = int(np.isfinite(case.t[i]).sum())
        t, y, rate = case.t[i, :n], e_y[i, :n], e_y_rate[i, :n]
        up_to_T = np.linspace(t[0], case.T[i], 100_001)
        whole = np.linspace(t[0], t[-1], 100_001)
        path = CubicHermiteSpline(t, y, rate)
        yaw = CubicHermiteSpline(t, e_psi[i, :n], e_psi_rate[i, :n])
        # grids of 1e-5 s: below 1e-9
        assert result.deepest[i] == pytest.approx(path(up_to_T).max() - 0.85, abs=1e-9)
        front = 0.85 - (path(up_to_T) + 1.43 * yaw(up_to_T)).max()
        assert result.dtle[i] == pytest.approx(min(front, case.dtle_before[i]), abs=1e-9)
        assert result.overshoot[i] == pytest.approx(max(0.0, (-path(whole)).max() - 0.85), abs=1e-9)
        inside = whole[np.argmax(path(whole) <= 0.85)]
        assert result.t_back[i] == pytest.approx(inside, abs=2e-5)
        # samples only from here on: not the T between two of them
        keep = np.ones(n, dtype=bool)
        if i == 0:
            keep[9] = False
        left, right = case.a_left[i, :n][keep], case.a_right[i, :n][keep]
        left[0] = case.a_before[i]
        right[-1] = left[-1]
        assert result.a_y_peak[i] == max(np.abs(left[1:]).max(), np.abs(right).max())  # not before the trigger
        jerk = [brute_force_jerk(t[keep], left, right, float(case.a_before[i]), 0.5, side) for side in (-1, 1)]
        assert result.jerk_peak[i] == pytest.approx(np.abs(jerk).max(), abs=1e-11)
        angles = np.concatenate([[case.delta_0[i]], case.delta[i, :n][keep][:-1]])
        assert result.delta_peak[i] == np.abs(angles[1:]).max()
        assert result.delta_rate_peak[i] == pytest.approx(np.abs(np.diff(angles)).max() / case.dt, rel=1e-14)
        assert result.travel[i] == pytest.approx(np.abs(np.diff(angles)).sum(), rel=1e-14)
        assert result.effort[i] == pytest.approx(np.sum(angles[1:] ** 2 * np.diff(t[keep])), rel=1e-14)
    assert result.dtle[1] == -0.9  # the recorded path was worse


def test_never_triggered_is_the_recorded_path_and_nobody_steers() -> None:
    result = driven().companions()
    values = {field.name: getattr(result, field.name)[2] for field in dataclasses.fields(result)}
    assert values.pop("deepest") == 0.15
    assert values.pop("dtle") == -0.17
    assert values.pop("t_back") == 1.2
    assert set(values.values()) == {0.0}
    assert list(metrics.COMPANION_UNITS) == [field.name for field in dataclasses.fields(result)]


def test_companions_do_not_feel_padding_order_or_what_runs_beside() -> None:
    case = driven()
    whole = case.companions()
    for rows in ([2, 0, 1], [1], [0]):
        part = dataclasses.replace(
            case,
            **{
                field.name: getattr(case, field.name)[rows]
                for field in dataclasses.fields(case)
                if isinstance(getattr(case, field.name), np.ndarray)
            },
        )
        padded = dataclasses.replace(
            part,
            **{
                name: np.concatenate([getattr(part, name), np.full_like(getattr(part, name)[:, :4], NAN)], axis=1)
                for name in ("t", "x", "delta", "a_left", "a_right")
            },
        )
        for name in metrics.COMPANION_UNITS:
            np.testing.assert_array_equal(getattr(padded.companions(), name), getattr(whole, name)[rows])


def test_mirrored_accelerations_and_angles_give_the_same_peaks() -> None:
    case = driven()
    mirrored = dataclasses.replace(
        case,
        **{name: -getattr(case, name) for name in ("delta", "a_left", "a_right", "delta_0", "a_before")},
    ).companions()
    for name in metrics.COMPANION_UNITS:
        np.testing.assert_array_equal(getattr(mirrored, name), getattr(case.companions(), name))
    # a mirrored path turns depth into overshoot
    t, e_y, rate = case.t[0, :14], case.x[0, :14, 0], case.x[0, :14, 1]
    depth = metrics.deepest_position(t, e_y, rate, T=t[-1], edge_offset=0.85)
    assert metrics.overshoot(t, -e_y, -rate, edge_offset=0.85) == depth > 0


@given(st.integers(0, 2**32 - 1), st.integers(2, 13))
def test_later_samples_never_lower_a_peak(seed: int, k: int) -> None:
    case = driven(seed)
    t, x, delta = case.t[1, :14], case.x[1, :14], case.delta[1, :14]
    left, right = case.a_left[1, :14], case.a_right[1, :14]

    def values(n: int) -> list[FloatArray]:
        s, z, d = t[:n], x[:n], delta[:n]
        return [
            metrics.deepest_position(s, z[:, 0], z[:, 1], T=9.0, edge_offset=0.85),
            -metrics.distance_to_lane_edge(s, z[:, 0], z[:, 1], z[:, 2], z[:, 3], T=9.0, edge_offset=0.85, l_f=1.43),
            metrics.overshoot(s, z[:, 0], z[:, 1], edge_offset=0.85),
            -metrics.time_back_inside(s, z[:, 0], z[:, 1], edge_offset=0.85),
            metrics.acceleration_peak(s, left[:n], right[:n]),
            metrics.jerk_peak(s, left[:n], right[:n], before=0.0),
            metrics.steering_peak(s, d),
            metrics.steering_rate_peak(s, d, delta_0=0.0, dt=0.1),
            metrics.steering_effort(s, d),
            metrics.steering_travel(s, d, delta_0=0.0),
        ]

    for shorter, longer in zip(values(k), values(k + 1), strict=True):
        assert longer >= shorter


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0), st.floats(-0.5, 20.0))
def test_scaling_and_time_shift(seed: int, factor: float, shift: float) -> None:
    case = driven(seed)
    plain = case.companions()
    scaled = dataclasses.replace(
        case,
        **{name: factor * getattr(case, name) for name in ("delta", "a_left", "a_right", "delta_0", "a_before")},
        x=factor * case.x,
        edge_offset=factor * case.edge_offset,
        deepest_before=factor * case.deepest_before,
        dtle_before=factor * case.dtle_before,
    ).companions()
    shifted = dataclasses.replace(case, t=case.t + shift, T=case.T + shift, t_s=case.t_s + shift).companions()
    for name in metrics.COMPANION_UNITS:
        values = getattr(plain, name)
        power = {"t_back": 0, "effort": 2}.get(name, 1)
        # rounding only; values up to 60
        np.testing.assert_allclose(getattr(scaled, name), factor**power * values, rtol=1e-11, atol=1e-12)
        moved = values + (shift if name == "t_back" else 0.0)
        np.testing.assert_allclose(getattr(shifted, name), moved, rtol=1e-11, atol=1e-11)


def test_nan_among_the_samples_is_not_dropped() -> None:
    """NaN after the end is padding; a NaN before it makes that scenario's value NaN, and no other's."""
    case = driven()
    broken = {"x": (0, 3, 0), "delta": (0, 3), "a_left": (0, 3)}
    touched = {
        "x": ("deepest", "dtle", "t_back", "overshoot"),
        "delta": ("delta_peak", "delta_rate_peak", "effort", "travel"),
        "a_left": ("a_y_peak", "jerk_peak"),
    }
    for argument, place in broken.items():
        values = getattr(case, argument).copy()
        values[place] = NAN
        result = dataclasses.replace(case, **{argument: values}).companions()
        for name in metrics.COMPANION_UNITS:
            assert np.isnan(getattr(result, name)[0]) == (name in touched[argument]), (argument, name)
            assert not np.isnan(getattr(result, name)[1:]).any()


def test_an_end_that_is_nan_gives_nan() -> None:
    t = np.tile([0.0, 1.0], (2, 1))
    depth = metrics.deepest_position(t, t, t, T=[NAN, 1.0], edge_offset=0.0)
    assert np.isnan(depth).tolist() == [True, False]


def test_no_scenarios() -> None:
    none = np.zeros((0, 3))
    result = metrics.companions(
        none, np.zeros((0, 3, 4)), none, none, none,
        T=[], t_s=[], dt=0.1, delta_0=[], a_before=[], edge_offset=0.85, l_f=1.43,
    )  # fmt: skip
    assert all(getattr(result, name).shape == (0,) for name in metrics.COMPANION_UNITS)


# ---------------------------------------------------------------- shares


def test_shares_of_all_and_of_the_interventions() -> None:
    triggered = np.array([True, True, True, False])
    assert metrics.intervention_share(triggered) == 0.75
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1]) == 0.75
    assert metrics.share_within_dtle([-0.3, -0.31, 0.2, -0.1], limit=-0.2) == 0.5
    assert metrics.share_deeper(np.array([0.5, 0.51, 0.1, 0.9]), 0.5) == 0.5
    peaks, jerks = [3.0, 3.1, 1.0, 9.0], [5.0, 1.0, 5.1, 9.0]
    np.testing.assert_array_equal(metrics.comfortable(peaks, jerks), [True, False, False, False])
    # the last one did not intervene: neither counted nor in the denominator
    assert metrics.comfortable_share(peaks, jerks, triggered) == pytest.approx(1 / 3)
    assert metrics.comfortable_share([1.0] * 4, [1.0] * 4, triggered) == 1.0
    np.testing.assert_array_equal(metrics.needless(triggered, [0.49, 0.5, 0.2, 0.1], 0.5), [True, False, True, False])
    assert metrics.needless_share(triggered, [0.49, 0.5, 0.2, 0.1], 0.5) == 0.5
    assert metrics.back_inside_share([2.0, np.inf, np.inf, 3.0], triggered) == pytest.approx(1 / 3)
    assert metrics.overshoot_share([0.0, 0.1, 1e-9, 0.4], triggered) == pytest.approx(2 / 3)


def test_shares_of_many_designs_are_those_of_each() -> None:
    rng = np.random.default_rng(8)
    d, n = 5, 40
    triggered = rng.random((d, n)) < 0.4
    triggered[2] = False
    depth, peak, jerk = rng.random(n), 6 * rng.random((d, n)), 10 * rng.random((d, n))
    dtle, over = rng.normal(size=(d, n)), np.maximum(0, rng.normal(size=(d, n)))
    back = np.where(rng.random((d, n)) < 0.5, 2.0, np.inf)
    together = [
        metrics.intervention_share(triggered),
        metrics.share_within_dtle(dtle),
        metrics.comfortable_share(peak, jerk, triggered),
        metrics.needless_share(triggered, depth, 0.5),
        metrics.back_inside_share(back, triggered),
        metrics.overshoot_share(over, triggered),
    ]
    for i in range(d):
        one = [
            metrics.intervention_share(triggered[i]),
            metrics.share_within_dtle(dtle[i]),
            metrics.comfortable_share(peak[i], jerk[i], triggered[i]),
            metrics.needless_share(triggered[i], depth, 0.5),
            metrics.back_inside_share(back[i], triggered[i]),
            metrics.overshoot_share(over[i], triggered[i]),
        ]
        assert all(type(share) is float for share in one)
        np.testing.assert_array_equal([np.asarray(share)[i] for share in together], one)
    assert np.isnan(np.asarray(together[2])).tolist() == [False, False, True, False, False]


def test_empty_sets() -> None:
    nobody = np.zeros(0, dtype=bool)
    assert metrics.intervention_share(nobody) == 0.0
    assert metrics.intervention_share([]) == 0.0
    assert metrics.share_within_dtle([]) == 0.0
    assert metrics.share_deeper(np.zeros(0), 0.5) == 0.0
    assert metrics.needless_share(nobody, [], 0.5) == 0.0
    # no intervention: a share of nothing
    for triggered in (nobody, np.zeros(3, dtype=bool)):
        values = np.zeros(triggered.size)
        assert math.isnan(metrics.comfortable_share(values, values, triggered))
        assert math.isnan(metrics.back_inside_share(values, triggered))
        assert math.isnan(metrics.overshoot_share(values, triggered))


def test_a_nan_counts_and_is_seen() -> None:
    values, yes = [0.1, NAN, 0.2], np.array([True, True, True])
    no = np.array([True, False, True])
    assert math.isnan(metrics.share_within_dtle(values))
    assert math.isnan(metrics.share_deeper(np.array(values), 0.5))
    assert not metrics.comfortable(values, [0.0] * 3)[1]
    for share in (
        lambda flags: metrics.comfortable_share([0.0] * 3, values, flags),
        lambda flags: metrics.comfortable_share(values, [0.0] * 3, flags),
        lambda flags: metrics.back_inside_share(values, flags),
        lambda flags: metrics.overshoot_share(values, flags),
        lambda flags: metrics.needless_share(flags, values, 0.5),
    ):
        assert math.isnan(share(yes))
        assert not math.isnan(share(no))  # not an intervention, so not asked for


# ---------------------------------------------------------------- bad input

T3 = np.array([0.0, 0.1, 0.2])
Z3 = np.zeros(3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.steering_peak([0.0, 0.2, 0.1], Z3), r"t\[2\] = 0.1; allowed: rising times"),
        (lambda: metrics.steering_peak([[0.0, 0.1], [0.3, 0.3]], np.zeros((2, 2))), r"t\[1, 1\] = 0.3"),
        (lambda: metrics.steering_peak([0.0, NAN, 0.1], Z3), r"t\[2\] = 0.1; allowed: NaN only after the end"),
        (lambda: metrics.steering_peak([0.0, 0.1, np.inf], Z3), r"t\[2\] = inf; allowed: finite times"),
        (lambda: metrics.steering_peak(0.0, 0.0), "t: one number"),
        (lambda: metrics.steering_peak(T3, np.zeros(2)), r"delta: shape \(2,\); allowed: that of t, \(3,\)"),
        (lambda: metrics.steering_peak(T3, ["a", "b", "c"]), "delta: not an array of numbers"),
        (lambda: metrics.steering_rate_peak(T3, Z3, delta_0=0.0, dt=0.0), "dt: 0.0 s; allowed: a finite number > 0"),
        (lambda: metrics.steering_rate_peak(T3, Z3, delta_0=[0.0, 1.0], dt=0.1), r"delta_0: shape \(2,\)"),
        (lambda: metrics.moving_average_jerk(T3, Z3, Z3, before=0.0, window=0.0), "window: 0.0 s"),
        (lambda: metrics.moving_average_jerk(T3, Z3, Z3, before=0.0, window=1e-10), "window: 1e-10 s"),
        (lambda: metrics.moving_average_jerk(T3, Z3, Z3, before=0.0, window=NAN), "window: nan s"),
        (lambda: metrics.moving_average_jerk(T3, Z3[:2], Z3, before=0.0), r"a_left: shape \(2,\)"),
        (lambda: metrics.lateral_acceleration(Z3, 20.0, Z3[:2]), r"yaw_rate: shape \(2,\)"),
        (lambda: metrics.lateral_acceleration(np.zeros((2, 3)), Z3, np.zeros((2, 3))), r"v: shape \(3,\)"),
        (
            lambda: metrics.linear_lateral_acceleration(BicycleModel(), [20.0], np.zeros((1, 3)), [Z3], [Z3], [0.0]),
            r"allowed: \(n, k, 4\) and \(n, k\)",
        ),
        (lambda: metrics.deepest_position(T3, Z3, Z3, T=[1.0, 2.0], edge_offset=0.85), r"until: shape \(2,\)"),
        (lambda: metrics.intervention_share([1.0, 0.0]), "triggered: an array of float64; allowed: booleans"),
        (lambda: metrics.intervention_share(True), r"triggered \(\); allowed: \(n,\) or \(d, n\)"),
        (lambda: metrics.needless_share([True, False], [0.1], 0.5), r"d_y \(1,\), triggered \(2,\)"),
        (lambda: metrics.needless([True], [0.1], NAN), "D_y: nan; allowed: a number"),
        (lambda: metrics.share_within_dtle([0.1], limit="deep"), "limit: 'deep'"),  # type: ignore[arg-type]
        (lambda: metrics.share_within_dtle(["a"]), "dtle: not an array of numbers"),
        (lambda: metrics.share_deeper(np.zeros((2, 2)), 0.5), r"deepest: shape \(2, 2\)"),
        (lambda: metrics.comfortable(Z3, Z3, a_y_limit=NAN), "a_y_limit: nan"),
    ],
)
def test_bad_input(call: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()  # type: ignore[operator]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((3, 15))}, r"x: shape \(3, 15\); allowed: \(3, 15, 4\)"),
        ({"t_s": np.array([0.5, 0.9, np.inf])}, r"t\[0, 0\] = 0.6; allowed: t_s\[0\] = 0.5"),
        ({"t_s": np.array([0.6, 0.9, 1.0])}, r"t\[2, 0\]"),
        ({"t_s": np.array([0.6, np.inf, np.inf])}, r"t\[1, 0\] = 0.9"),
        (
            {"T": np.array([1.4, 1.9, 1.2])},
            r"t\[0, 9\] = 1.45; allowed: t_s \+ a multiple of dt = 0.1 s, T, or the last",
        ),
        ({"deepest_before": None}, "deepest_before: not given; needed for the scenarios that never triggered"),
        ({"dt": -0.1}, "dt: -0.1 s"),
        ({"dt": True}, "dt: True s"),
    ],
)
def test_bad_input_of_companions(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(driven(), **change).companions()  # type: ignore[arg-type]
