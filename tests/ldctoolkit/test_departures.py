"""The eight parameters, both ways, against brute force."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from helpers.errors import assert_fields, refused
from ldctoolkit import DepartureSignals, Scenarios, rebuild_signals, reduce_signals
from ldctoolkit import departures as dep
from ldctoolkit.errors import InputError


@st.composite
def events(draw: st.DrawFn) -> Scenarios:
    T = draw(st.floats(0.5, 10.0))
    v_mean = draw(st.floats(5.0, 40.0))
    a_most = 2.0 * (v_mean - 1.0) / T
    return Scenarios.from_arrays(
        T=T, d_y=draw(st.floats(0.01, 1.5)), v_mean=v_mean, a_mean=draw(st.floats(-1.0, 1.0)) * min(a_most, 3.0),
        c_0=draw(st.floats(-0.01, 0.01)), dc=draw(st.floats(-0.01, 0.01)),
    )  # fmt: skip


@given(events(), st.floats(0.0, 1.0))
def test_closed_forms_equal_brute_force(event: Scenarios, share: float) -> None:
    t = share * event.T

    def y(s: float) -> float:
        return float(dep.lateral(event, np.array([s]))[0])

    integral, _ = quad(y, 0.0, float(t[0]), epsabs=1e-13)
    # a quartic: Gauss-Kronrod is exact, what remains is rounding
    assert dep.lateral_integral(event, t)[0] == pytest.approx(integral, abs=1e-12)
    travelled, _ = quad(lambda s: float(dep.speed(event, np.array([s]))[0]), 0.0, float(t[0]), epsabs=1e-10)
    assert dep.position(event, t)[0] == pytest.approx(travelled, abs=1e-9)


@given(events(), st.floats(0.05, 0.95))
def test_derivatives_equal_central_differences(event: Scenarios, share: float) -> None:
    t = share * event.T
    h = 1e-4 * event.T
    slope = (dep.lateral(event, t + h) - dep.lateral(event, t - h)) / (2 * h)
    bend = (dep.lateral_rate(event, t + h) - dep.lateral_rate(event, t - h)) / (2 * h)
    # truncation of a quartic's central difference: h^2/6 times the third derivative
    scale = event.d_y / event.T
    assert dep.lateral_rate(event, t)[0] == pytest.approx(slope[0], abs=1e-5 * scale[0])
    assert dep.lateral_acceleration(event, t)[0] == pytest.approx(bend[0], abs=1e-4 * scale[0] / event.T[0])


@given(events(), st.floats(0.001, 0.999))
def test_crossing_time_equals_a_root_search(event: Scenarios, share: float) -> None:
    y_s = share * float(event.d_y[0])
    x_peak = 0.5 * float(event.v_mean[0] * event.T[0])
    t_peak = brentq(lambda t: float(dep.position(event, np.array([t]))[0]) - x_peak, 0.0, float(event.T[0]))
    expected = (
        brentq(lambda t: float(dep.lateral(event, np.array([t]))[0]) - y_s, 0.0, t_peak + 1e-9, xtol=1e-13)
        if float(dep.lateral(event, np.array([t_peak + 1e-9]))[0]) > y_s
        else t_peak
    )
    # near the peak the root is as flat as sqrt of rounding
    assert dep.crossing_time(event, y_s)[0] == pytest.approx(expected, abs=1e-6 * float(event.T[0]))


def test_no_crossing_at_or_above_the_peak() -> None:
    event = Scenarios.from_arrays(T=[2.0, 2.0], d_y=[0.2, 0.0], v_mean=20.0)
    assert np.isinf(dep.crossing_time(event, 0.2)).all()
    assert dep.crossing_time(event, 0.0)[0] == 0.0
    assert np.isinf(dep.crossing_time(event, 0.0)[1])


@given(events())
def test_rebuilding_and_reducing_give_the_parameters_back(event: Scenarios) -> None:
    signals = rebuild_signals(event, dt=float(event.T[0]) / 200)
    back = reduce_signals(signals, event.side)
    np.testing.assert_array_equal(back.T, event.T)
    # speed is linear, so the trapezoid rule and the regressions are exact up to rounding
    for name in ("d_y", "v_mean", "a_mean", "c_0", "dc"):
        np.testing.assert_allclose(getattr(back, name), getattr(event, name), rtol=1e-7, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(back.sigma_y, 0.0, atol=1e-9)
    np.testing.assert_allclose(back.sigma_v, 0.0, atol=1e-9)


def test_reduction_equals_lstsq_event_by_event() -> None:
    rng = np.random.default_rng(3)
    count = rng.integers(5, 60, 40)
    pieces: dict[str, list[np.ndarray]] = {name: [] for name in "tyvc"}
    for k in count:
        t = np.concatenate([[0.0], np.sort(rng.uniform(0.05, 1.95, k - 2)), [2.0]])
        y = np.abs(rng.normal(0.2, 0.1, k))
        y[[0, -1]] = 0.0
        for name, values in zip("tyvc", (t, y, rng.normal(20, 1, k), rng.normal(0, 1e-3, k)), strict=True):
            pieces[name].append(values)
    flat = {name: np.concatenate(values) for name, values in pieces.items()}
    signals = DepartureSignals(offsets=np.concatenate([[0], np.cumsum(count)]), **flat)
    back = reduce_signals(signals, np.ones(40, dtype=np.int64))
    for i in range(signals.n):
        rows = slice(signals.offsets[i], signals.offsets[i + 1])
        t, y, v, c = signals.t[rows], signals.y[rows], signals.v[rows], signals.c[rows]
        T = t[-1]
        x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
        d_x = x[-1]
        inner = slice(1, -1)
        parabola = (-4 / d_x**2 * (x - d_x / 2) ** 2 + 1)[inner]
        d_y = np.linalg.lstsq(parabola[:, None], y[inner], rcond=None)[0][0]
        slope_v = np.polyfit(t[inner] - T / 2, v[inner], 1)[0]
        slope_c, c_0 = np.polyfit(t[inner], c[inner], 1)
        expected = {
            "d_y": d_y,
            "sigma_y": np.std(y[inner] - d_y * parabola, ddof=1),
            "v_mean": d_x / T,
            "a_mean": slope_v,
            "sigma_v": np.std(v[inner] - slope_v * (t[inner] - T / 2) - d_x / T, ddof=1),
            "c_0": c_0,
            "dc": slope_c * T,
        }
        for name, value in expected.items():
            assert getattr(back, name)[i] == pytest.approx(value, rel=1e-9, abs=1e-12), name


@pytest.mark.parametrize(
    ("t", "path", "value"),
    [
        ([0.0, 0.2, 0.4, 0.6], "signals: event 0: samples between its crossings", 2),
        ([0.0] * 5, "signals: event 0: duration", 0.0),
    ],
)
def test_too_few_samples_and_bad_durations_are_named(t: list[float], path: str, value: float) -> None:
    n = len(t)
    signals = DepartureSignals(np.array([0, n]), np.array(t), np.zeros(n), np.ones(n), np.zeros(n))
    with refused(path, value=value):
        reduce_signals(signals, [1])


def test_three_samples_and_a_speed_of_1_m_s_are_enough() -> None:
    t = np.array([0.0, 0.2, 0.4, 0.6, 0.8])
    three = DepartureSignals(np.array([0, 5]), t, np.array([0.0, 0.1, 0.2, 0.1, 0.0]), np.ones(5), np.zeros(5))
    assert reduce_signals(three, [1]).d_y[0] == pytest.approx(0.35 / 2.125)  # least squares on 0.75, 1, 0.75
    assert Scenarios.from_arrays(T=2.0, d_y=0.0, v_mean=2.0, a_mean=1.0).n == 1  # 1 m/s at the start
    with refused("scenarios.v_mean[0]", value=2.0):
        Scenarios.from_arrays(T=2.0, d_y=0.0, v_mean=2.0, a_mean=-1.0 - 1e-15)


def test_rows_can_be_taken_by_list_mask_and_slice() -> None:
    two = Scenarios.from_arrays(T=[1.0, 2.0], d_y=0.1, v_mean=20.0)
    assert len(two.take([])) == 0
    for rows in ([1], [False, True], slice(1, 2)):
        assert two.take(rows).T.tolist() == [2.0]


def test_nothing_in_nothing_out_and_no_step_of_zero() -> None:
    with refused("dt", value=0.0):
        rebuild_signals(Scenarios.from_arrays(T=1.0, d_y=0.1, v_mean=20.0), 0.0)
    empty = np.empty(0)
    signals = DepartureSignals(np.array([0]), empty, empty, empty, empty)
    assert len(reduce_signals(signals, np.empty(0))) == 0


@pytest.mark.parametrize(
    ("columns", "column", "value", "allowed"),
    [
        ({"T": [1.0, np.nan]}, ".T[1]", np.nan, "finite numbers"),
        ({"T": [0.0, 1.0]}, ".T[0]", 0.0, "> 0 s"),
        ({"d_y": [0.1, -0.1]}, ".d_y[1]", -0.1, ">= 0"),
        ({"side": [1, 2]}, ".side[1]", 2.0, "1 (left) or -1 (right)"),
        ({"v_mean": [20.0, 0.5]}, ".v_mean[1]", 0.5, "stays at or above 1.0 m/s"),
        ({"a_mean": [0.0, 39.0]}, ".v_mean[1]", 20.0, "stays at or above 1.0 m/s"),
        ({"v_mean": 120.0}, ".v_mean[0]", 120.0, "stays at or below 90 m/s"),
        ({"v_mean": 88.0, "a_mean": [0.0, -5.0]}, ".v_mean[1]", 88.0, "stays at or below 90 m/s"),
        ({"d_y": [0.1, 30.0]}, ".d_y[1]", 30.0, "up to 10 m"),
        ({"c_0": 500.0}, ".c_0[0]", 500.0, "up to 0.2 1/m, with v_mean^2 times it up to 40 m/s^2"),
        ({"c_0": 0.04, "dc": [0.0, 0.08]}, ".dc[1]", 0.08, "a curvature"),
        ({"T": ["2"]}, ".T[0]", "2", "a number"),
        ({"T": [1.0, None]}, ".T[1]", None, "a number"),
        ({"side": ["left", "rihgt"]}, ".side[1]", "rihgt", "right"),
        ({"T": [[1.0], [1.0, 2.0]]}, ".T", ..., "one number per row"),
        ({"c_0": [0.0, 0.0, 0.0]}, "", ..., ""),
        ({"c_0": [[0.0]]}, "", ..., "one dimension"),
    ],
)
def test_bad_scenarios_are_named(columns: dict[str, Any], column: str, value: Any, allowed: str) -> None:
    good = {"T": [1.0, 1.0], "d_y": [0.1, 0.1], "v_mean": [20.0, 20.0]}
    with pytest.raises(InputError) as caught:
        Scenarios.from_arrays(**{**good, **columns})
    assert_fields(caught.value, f"scenarios{column}", value)
    assert allowed in str(caught.value.allowed)


def test_sides_may_be_words() -> None:
    for side in (["left", "right"], np.array(["left", "right"], dtype=object), [1, -1]):
        assert Scenarios.from_arrays(T=1.0, d_y=0.1, v_mean=20.0, side=side).side.tolist() == [1, -1]
    assert Scenarios.from_arrays(T=[1.0, 2.0], d_y=0.1, v_mean=20.0, side="right").side.tolist() == [-1, -1]
