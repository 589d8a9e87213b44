"""The wheel's angle after a command that jumps once, against the analytic answer, in both loops."""

from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Constant, Stepped
from helpers.grids import grid
from ldctoolkit import Controller, Scenarios, simulate
from ldctoolkit.plant_options import Actuator, PlantOptions

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
