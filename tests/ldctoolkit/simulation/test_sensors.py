"""What a law is shown: noise, bias, steps, delay and rate of the camera, the curvature ahead, the filter's estimate."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.stats

from helpers.closed_loop import Prepared, Stepped, Unsighted, assert_same_rows, grid, make_scenarios, with_residuals
from ldctoolkit import Outcome, Scenarios, simulate
from ldctoolkit.controllers import PreviewProportional
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres

DT, SETTLE, Y_S = 0.05, 0.5, 0.1
AHEAD = np.array([0.0, 0.4, 1.1])


class Seen(NamedTuple):
    """What a law was shown."""

    t: np.ndarray  # (k, n)
    x: np.ndarray  # (k, n, 4)
    yaw_rate: np.ndarray  # (k, n, 3)
    heading: np.ndarray  # (k, n, 3)


@dataclasses.dataclass(frozen=True)
class Witness(Unsighted):
    """Steers straight on, and writes down what it sees."""

    samples: list[list[np.ndarray]]

    @property
    def preview_times(self) -> np.ndarray:
        return AHEAD

    def step(self, t, x, preview, delta_prev, state):  # type: ignore[no-untyped-def]
        self.samples.append([np.array(value) for value in (t, x, preview.yaw_rate, preview.heading)])
        return np.zeros(t.size), state, np.zeros(t.size, dtype=np.int8)


def watch(scenarios: Scenarios, sensors: Sensors, *, seed: int = 0, **options: Any) -> tuple[Seen, np.ndarray]:
    """What was seen, and the true states at the same samples (k, n, 4); all scenarios as long as the first."""
    witness = Witness([])
    out = simulate(
        Prepared(lambda _: witness), scenarios, y_s=Y_S, dt=DT, seed=seed, settle=SETTLE, trajectories=True,
        options=PlantOptions(sensors=sensors, **options),
    )  # fmt: skip
    assert out.triggered.all()
    seen, paths = Seen(*map(np.array, zip(*witness.samples, strict=True))), out.trajectories
    at_samples = [np.flatnonzero(np.abs(paths.t[0] - t) < 1e-9)[0] for t in seen.t[:, 0]]
    return seen, paths.x[:, at_samples].transpose(1, 0, 2)


def alike(n: int, **changes: Any) -> Scenarios:
    given = {"T": 1.02, "d_y": 0.4, "v_mean": 22.0, "a_mean": 0.3, "c_0": 1e-3, "dc": -2e-3, "side": 1} | changes
    return Scenarios.from_arrays(**{name: np.broadcast_to(value, n) for name, value in given.items()})


def test_an_ideal_camera_shows_the_truth_and_one_noise_leaves_the_other_quantity_true() -> None:
    seen, true = watch(alike(3), Sensors())
    np.testing.assert_array_equal(seen.x, true)
    noisy, true = watch(alike(3), Sensors(e_psi_noise=0.01))
    np.testing.assert_array_equal(noisy.x[..., 0], true[..., 0])
    assert (noisy.x[..., 2] != true[..., 2]).all()


def test_noise_is_normal_white_and_independent() -> None:
    """12,000 numbers of a fixed seed; a false alarm would have had a chance of one in a thousand."""
    seen, true = watch(alike(400), Sensors(e_y_noise=0.05, e_psi_noise=0.004))
    noise = (seen.x - true)[:, :, [0, 2]] / [0.05, 0.004]
    assert noise.size > 20_000
    np.testing.assert_array_equal(seen.x[:, :, [1, 3]], true[:, :, [1, 3]])
    for quantity in range(2):
        assert scipy.stats.kstest(noise[:, :, quantity].ravel(), "norm").pvalue > 1e-3
    pairs = {
        "e_y and e_psi": (noise[..., 0], noise[..., 1]),
        "one frame and the next": (noise[1:, :, 0], noise[:-1, :, 0]),
        "one scenario and the next": (noise[:, 1:, 1], noise[:, :-1, 1]),
        "e_psi and the next e_y": (noise[1:, :, 0], noise[:-1, :, 1]),
    }
    for what, (a, b) in pairs.items():
        assert scipy.stats.pearsonr(a.ravel(), b.ravel()).pvalue > 1e-3, what


def test_values_are_rounded_to_the_step_last_of_all() -> None:
    seen, true = watch(alike(2), Sensors(e_y_step=0.02, e_psi_step=0.003, e_y_bias=0.004))
    np.testing.assert_array_equal(seen.x[..., 0], 0.02 * np.rint((true[..., 0] + 0.004) / 0.02))
    np.testing.assert_array_equal(seen.x[..., 2], 0.003 * np.rint(true[..., 2] / 0.003))
    noisy, _ = watch(alike(2), Sensors(e_y_step=0.02, e_y_noise=0.1))
    steps = noisy.x[..., 0] / 0.02
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-12)


def recorded(scenarios: Scenarios, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """e_y and e_psi of the first scenario's recorded path, from the paper's parabola and Table I's steady side slip."""
    T, d_y, v_mean, a_mean, c_0, dc = (getattr(scenarios, n)[0] for n in ("T", "d_y", "v_mean", "a_mean", "c_0", "dc"))
    x, v = v_mean * t + a_mean * (t**2 - T * t) / 2, v_mean + a_mean * (t - T / 2)
    bend = -4 * d_y / (v_mean * T) ** 2
    slope = 2 * bend * (x - v_mean * T / 2)
    yaw_rate = v * (c_0 + dc * t / T) + (2 * bend * v**2 + slope * a_mean) / v
    beta = yaw_rate * (1.47 / v - 1.43 * 1000.0 * v / (2 * 80000.0 * 2.9))
    return bend * (x - v_mean * T / 2) ** 2 + d_y + 0.85, slope - beta


@pytest.mark.parametrize(("period", "delay"), [(3, 0), (1, 2), (4, 3), (2, 5), (2, 1.4), (1, 2.5)])
def test_delay_and_rate_are_exact(period: int, delay: float) -> None:
    """The latest frame that has arrived; frames from before the trigger show the recorded path."""
    scenarios = alike(1)
    seen, true = watch(scenarios, Sensors(period=(period * DT) if period > 1 else 0.0, delay=delay * DT))
    t_s = seen.t[0, 0]
    for k in range(seen.t.shape[0]):
        sample = math.floor((k - delay) / period) * period
        if sample >= 0:
            assert (seen.x[k, 0, 0], seen.x[k, 0, 2]) == (true[sample, 0, 0], true[sample, 0, 2])
        else:
            e_y, e_psi = recorded(scenarios, t_s + sample * DT)
            assert seen.x[k, 0, 0] == pytest.approx(e_y, abs=1e-14)
            assert seen.x[k, 0, 2] == pytest.approx(e_psi, abs=1e-14)
    # rates come from elsewhere
    np.testing.assert_array_equal(seen.x[:, 0, [1, 3]], true[:, 0, [1, 3]])


def test_a_frame_keeps_its_noise_while_it_is_the_latest() -> None:
    seen, _ = watch(alike(5), Sensors(e_y_noise=0.1, period=3 * DT, delay=DT))
    frames = (np.arange(seen.t.shape[0]) - 1) // 3
    for j in range(1, frames.max() + 1):
        rows = np.flatnonzero(frames == j)
        assert (seen.x[rows, :, 0] == seen.x[rows[0], :, 0]).all()
    first = np.array([seen.x[frames == j, :, 0][0] for j in range(frames.max() + 1)])
    assert np.unique(first).size == first.size
    # ... which is that of the same frame when it arrives at once
    prompt, _ = watch(alike(5), Sensors(e_y_noise=0.1, period=3 * DT))
    np.testing.assert_array_equal(first, prompt.x[::3, :, 0][: first.shape[0]])


def test_curvature_noise_is_one_normal_draw_a_scenario() -> None:
    """2,000 draws of a fixed seed."""
    seen, _ = watch(alike(2000), Sensors(curvature_noise=4e-4))
    ideal, _ = watch(alike(1), Sensors())
    v = 22.0 + 0.3 * (seen.t[0, 0] - 0.51)
    draws = (seen.yaw_rate - ideal.yaw_rate) / v / 4e-4
    np.testing.assert_allclose(draws, np.broadcast_to(draws[:1, :, :1], draws.shape), rtol=0, atol=1e-10)
    assert scipy.stats.kstest(draws[0, :, 0], "norm").pvalue > 1e-3
    assert np.unique(draws[0, :, 0]).size == 2000
    headings = (seen.heading - ideal.heading)[:, :, 2] / (v * AHEAD[2]) / 4e-4
    np.testing.assert_allclose(headings, draws[:, :, 0], rtol=0, atol=1e-10)


def test_the_filter_knows_rates_that_differencing_does_not() -> None:
    """Root mean square over 300 departures, after the first half second, against two frames subtracted."""
    noisy = Sensors(e_y_noise=0.03, e_psi_noise=0.003)
    frames, true = watch(alike(300), noisy)
    filtered, same = watch(alike(300), dataclasses.replace(noisy, kalman=KalmanFilter()))
    np.testing.assert_array_equal(true, same)
    later = slice(10, None)

    def rms(error: np.ndarray) -> float:
        return float(np.sqrt(np.mean(error[later] ** 2)))

    for measured, rate, noise in ((0, 1, 0.03), (2, 3, 0.003)):
        differences = np.diff(frames.x[..., measured], axis=0, prepend=np.nan) / DT
        assert rms(differences - true[..., rate]) > 0.8 * np.sqrt(2.0) * noise / DT
        assert rms(filtered.x[..., rate] - true[..., rate]) < 0.2 * rms(differences - true[..., rate])
        assert rms(filtered.x[..., measured] - true[..., measured]) < 0.7 * noise


@pytest.mark.parametrize(("delay", "late", "first"), [(0.0, 0, 0), (0.07, 2, 20)])
def test_the_filter_with_true_frames_on_the_true_model_is_the_truth(delay: float, late: int, first: int) -> None:
    """It knows the model, the command, a lane without a kink, and how late frames are: nothing to correct but a start
    on a recorded path, which is not driven by the model."""
    seen, true = watch(alike(2, dc=0.0, T=4.0), Sensors(delay=delay, kalman=KalmanFilter()))
    error = seen.x[first + late :] - true[first : true.shape[0] - late]
    assert (np.abs(error) < 1e-5 * np.abs(true).max(axis=(0, 1))).all()


# everything that is drawn, at once

DRAWN = PlantOptions(
    speed="profile",
    actuator=Actuator(lag=0.05, rate_max=0.4),
    mismatch=Mismatch(m=(0.8, 1.2), C_af=(0.8, 1.1), mu=(0.6, 1.0)),
    tyres=Tyres(model="magic_formula"),
    sensors=Sensors(e_y_noise=0.05, e_psi_noise=0.005, curvature_noise=3e-4, delay=DT, kalman=KalmanFilter()),
    residuals=Residuals(y=True, v=True),
)
ALONE = {
    "noise": PlantOptions(sensors=Sensors(e_y_noise=0.05, e_psi_noise=0.005)),
    "curvature": PlantOptions(sensors=Sensors(curvature_noise=3e-4)),
    "mismatch": PlantOptions(mismatch=Mismatch(m=(0.8, 1.2))),
    "residual of y": PlantOptions(residuals=Residuals(y=True)),
    "residual of v": PlantOptions(speed="profile", residuals=Residuals(v=True)),
    "everything": DRAWN,
}


def drawn(stepped: bool, n: int, options: PlantOptions, seed: int) -> Outcome:
    law = Stepped(PreviewProportional(), drops=True) if stepped else PreviewProportional()
    scenarios = with_residuals(make_scenarios(n, seed=4))
    return simulate(law, scenarios, y_s=Y_S, dt=DT, options=options, seed=seed, settle=SETTLE)


@pytest.mark.parametrize(("case", "stepped"), grid(ALONE, [False, True], *((case, False) for case in ALONE)))
def test_the_seed_decides_every_draw(case: str, stepped: bool) -> None:
    first, again, other = (drawn(stepped, 40, ALONE[case], seed) for seed in (7, 7, 8))
    assert_same_rows(first, again)
    assert (first.S != other.S)[first.triggered & other.triggered].all()


def test_one_options_draws_do_not_depend_on_another() -> None:
    """Camera noise is the same with and without a curvature error, and conversely."""
    noise = Sensors(e_y_noise=0.05, e_psi_noise=0.005)
    curvature = Sensors(curvature_noise=3e-4)
    both = dataclasses.replace(noise, curvature_noise=3e-4)
    (a, _), (b, _), (c, _) = (watch(alike(10), sensors) for sensors in (noise, curvature, both))
    np.testing.assert_array_equal(a.x, c.x)
    np.testing.assert_array_equal(b.yaw_rate, c.yaw_rate)
