"""The recorded path of a departure, driven in place of its parabola."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from helpers.errors import refused
from ldctoolkit import Scenarios, Setup, VehicleParameters, extract_departures, simulate
from ldctoolkit.controllers import LQR, NoControl
from ldctoolkit.departures import Departures, combined_departures
from ldctoolkit.errors import RecordingError
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import PlantOptions, Residuals
from ldctoolkit.recordings import Provenance, Recording, read_departures, write_departures

WIDTH, LANE = 1.8, 3.5
SETUP = Setup(vehicle=VehicleParameters(w_v=WIDTH, w_l=LANE))
T = np.arange(0.0, 12.0, 0.1)


def depth(t: np.ndarray) -> np.ndarray:
    """Beyond the line from 3.03 s to 7.03 s, deepest late, and no parabola."""
    u = (t - 3.03) / 4.0
    wave = np.sin(np.pi * np.clip(u, 0.0, 1.0))
    return np.where((u > 0) & (u < 1), 0.45 * wave**1.5 * (0.8 + 0.4 * u), -0.1)


def speed(t: np.ndarray) -> np.ndarray:
    return 24.0 + np.sin(0.7 * t)


def curvature(t: np.ndarray) -> np.ndarray:
    return 8e-4 * np.cos(0.4 * t)


def recording(side: int) -> Recording:
    """Of a vehicle that leaves its lane to a side, in a bend to that side at first."""
    offset = depth(T) + 0.5 * (LANE - WIDTH)
    ones = np.ones(T.size)
    return Recording("ab"[side < 0], T, side * offset, LANE * ones, speed(T), ones > 0, curvature=side * curvature(T))


@pytest.fixture(scope="module")
def departures() -> Departures:
    """One to the left, one to the right, with their signals."""
    extraction = extract_departures([recording(1), recording(-1)], vehicle_width=WIDTH, keep_signals=True)
    assert extraction.departures.side.tolist() == [1, -1]
    return extraction.departures


def samples() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times since the crossing, depth, speed and curvature of the planted samples, both crossings interpolated."""
    y = depth(T)
    inside = np.flatnonzero(y > 0.0)
    a, b = inside[0], inside[-1]
    out = T[a - 1] + 0.1 * y[a - 1] / (y[a - 1] - y[a])
    back = T[b] + 0.1 * y[b] / (y[b] - y[b + 1])
    t = np.concatenate([[out], T[inside], [back]])
    zero = np.zeros(1)
    return t - out, np.concatenate([zero, y[inside], zero]), *(np.interp(t, T, f(T)) for f in (speed, curvature))


def test_the_planted_signals_are_followed_on_both_sides(departures: Departures) -> None:
    """At every sample and between them, to 1e-6 m, 1e-6 m/s and 1e-9 1/m."""
    path = UncorrectedPath.of(Scenarios.from_departures(departures, path="recorded"), Residuals(), seed=0)
    t, y, v, c = samples()
    times = np.tile(np.sort(np.concatenate([t, np.linspace(0.0, t[-1], 301)])), (2, 1))
    for found, planted, tolerance in (
        (path.lateral(times), y, 1e-6), (path.speed(times), v, 1e-6), (path.curvature(times), c, 1e-9),
    ):  # fmt: skip
        np.testing.assert_allclose(found, np.tile(np.interp(times[0], t, planted), (2, 1)), atol=tolerance, rtol=0)


def test_the_score_without_control_is_the_integral_over_the_samples(departures: Departures) -> None:
    scenarios = Scenarios.from_departures(departures, path="recorded")
    t, y, *_ = samples()
    expected = np.trapezoid(y + 0.5 * (LANE - WIDTH), t)
    outcome = simulate(NoControl(), scenarios, setup=SETUP, y_s=0.2)
    np.testing.assert_allclose(outcome.S_uncorrected, expected, rtol=1e-12)
    np.testing.assert_allclose(outcome.S, expected, rtol=1e-12)
    assert abs(simulate(NoControl(), Scenarios.from_departures(departures), setup=SETUP).S[0] - expected) > 1e-3


@pytest.mark.parametrize("y_s", [0.0, 0.05, 0.3, 0.55])
def test_control_starts_where_the_recorded_path_crosses_the_threshold(departures: Departures, y_s: float) -> None:
    scenarios = Scenarios.from_departures(departures, path="recorded")
    outcome = simulate(LQR(), scenarios, setup=SETUP, y_s=y_s, trajectories=True)
    t, y, v, _ = samples()
    beyond = np.flatnonzero(y > y_s)
    if y_s > y.max():
        assert not outcome.triggered.any()
        return
    b = beyond[0]
    t_s = t[b - 1] + (y_s - y[b - 1]) / (y[b] - y[b - 1]) * (t[b] - t[b - 1])
    paths = outcome.trajectories
    assert paths is not None
    np.testing.assert_allclose(paths.t[:, 0], t_s, atol=1e-9)
    np.testing.assert_allclose(paths.x[:, 0, 0], y_s + 0.5 * (LANE - WIDTH), atol=1e-9)
    np.testing.assert_allclose(outcome.S[0], outcome.S[1], rtol=1e-9)  # the mirror image
    before = np.trapezoid(np.append(y[:b], y_s) + 0.5 * (LANE - WIDTH), np.append(t[:b], t_s))
    control = simulate(LQR(), scenarios, setup=SETUP, y_s=y_s, window="control")
    np.testing.assert_allclose(outcome.S - control.S, before, rtol=1e-9)
    plain = simulate(LQR(), scenarios, setup=dataclasses.replace(SETUP, dt=0.01), y_s=y_s)
    np.testing.assert_allclose(outcome.S, plain.S, rtol=0.02)
    assert abs(np.interp(t_s, t, v) - scenarios.v_mean[0]) > 0.05  # the speed of the trigger is not the mean


def test_slopes_come_from_a_smooth_fit(departures: Departures) -> None:
    """A noise of 1 cm on every sample makes lateral accelerations of 10 m/s^2 by differences, and far less here."""
    signals = departures.signals
    assert signals is not None
    noisy = dataclasses.replace(signals, y=signals.y + 0.01 * np.random.default_rng(1).standard_normal(signals.y.size))
    rates = []
    for recorded in (signals, noisy):
        scenarios = Scenarios.from_departures(dataclasses.replace(departures, signals=recorded), path="recorded")
        path = UncorrectedPath.of(scenarios, Residuals(), seed=0)
        t = np.tile(np.linspace(0.5, 3.5, 31), (2, 1))
        rates.append((path.lateral_rate(t), path.lateral_acceleration(t)))
    inner = np.linspace(0.5, 3.5, 31)
    slope = (depth(inner + 3.031) - depth(inner + 3.029)) / 0.002
    np.testing.assert_allclose(rates[0][0][0], slope, atol=0.05)
    assert np.abs(rates[1][0] - rates[0][0]).max() < 0.06
    assert np.abs(rates[1][1] - rates[0][1]).max() < 0.5


def test_peaks_and_depth_are_those_of_the_samples(departures: Departures) -> None:
    scenarios = Scenarios.from_departures(departures, path="recorded")
    path = UncorrectedPath.of(scenarios, Residuals(), seed=0)
    t, y, v, _ = samples()
    np.testing.assert_allclose(path.deepest(scenarios.T), y.max(), atol=1e-9)
    half = np.full(2, 1.234)
    np.testing.assert_allclose(path.deepest(half), max(np.interp(1.234, t, y), y[t < 1.234].max()), atol=1e-9)
    np.testing.assert_allclose(path.slowest_speed(half, scenarios.T), min(np.interp(1.234, t, v), v[t > 1.234].min()))
    lowest = simulate(NoControl(), scenarios, setup=SETUP).metrics.deepest
    np.testing.assert_allclose(lowest, y.max(), atol=1e-6)


def test_a_plant_of_every_option_drives_recorded_paths(departures: Departures) -> None:
    """Nothing is drawn for them, and rows taken alone give the same bits."""
    setup = dataclasses.replace(SETUP, options=PlantOptions(speed="profile", residuals=Residuals(y=True, v=True)))
    scenarios = Scenarios.from_departures(departures, path="recorded")
    both = simulate(LQR(), scenarios, setup=setup, y_s=0.1)
    other_seed = simulate(LQR(), scenarios, setup=dataclasses.replace(setup, seed=7), y_s=0.1)
    alone = simulate(LQR(), scenarios.take([1]), setup=setup, y_s=0.1)
    assert both.S.tobytes() == other_seed.S.tobytes()
    assert both.S[1].tobytes() == alone.S[0].tobytes()


def test_signals_survive_the_second_table(departures: Departures, tmp_path: Path) -> None:
    write_departures(tmp_path / "d.parquet", departures, Provenance())
    back, _ = read_departures(tmp_path / "d.parquet", signals=True)
    assert back.signals is not None
    assert departures.signals is not None
    for name in ("offsets", "t", "y", "v", "c"):
        np.testing.assert_array_equal(getattr(back.signals, name), getattr(departures.signals, name))
    assert read_departures(tmp_path / "d.parquet")[0].signals is None
    joined = combined_departures([departures, departures.take([1])])
    assert joined.signals is not None
    assert joined.signals.n == 3
    np.testing.assert_array_equal(joined.take([2]).signals.y, departures.take([1]).signals.y)  # type: ignore[union-attr]


def test_signals_of_other_departures_are_refused(departures: Departures, tmp_path: Path) -> None:
    write_departures(tmp_path / "d.parquet", departures, Provenance())
    write_departures(tmp_path / "d.parquet", dataclasses.replace(departures.take([0]), signals=None), Provenance())
    with pytest.raises(RecordingError, match=r"^d\.signals\.parquet: not the signals of these 1 departures"):
        read_departures(tmp_path / "d.parquet", signals=True)
    (tmp_path / "d.signals.parquet").unlink()
    with pytest.raises(RecordingError, match=r"d\.signals\.parquet: cannot be read: .*; needed: a table of signals"):
        read_departures(tmp_path / "d.parquet", signals=True)


def test_a_recorded_path_needs_signals(departures: Departures) -> None:
    with refused("path", value="recorded"):
        Scenarios.from_departures(dataclasses.replace(departures, signals=None), path="recorded")
    with refused("path", value="record", allowed={"recorded"}):
        Scenarios.from_departures(departures, path="record")  # type: ignore[arg-type]
