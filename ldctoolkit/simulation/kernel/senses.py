"""What the law gets: the camera's latest frame, the filter's estimate, the lane ahead as the camera sees it."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import numba
import numpy as np

from ldctoolkit.simulation._philox import normal_pair
from ldctoolkit.simulation.kernel.data import (
    BIAS_PSI,
    BIAS_Y,
    CAMERA,
    COMMAND,
    CURVATURE_BIAS,
    CURVATURE_GAIN,
    DT,
    EARLIER,
    ESTIMATE,
    FILTERED,
    FRAMES,
    GAIN,
    INDEX,
    INTEGRAL,
    LATE,
    LAW,
    LAW_F,
    LAW_I,
    LAW_U,
    MODEL_A,
    MODEL_B,
    MODEL_E_0,
    MODEL_E_1,
    MODES,
    NOISE_PSI,
    NOISE_Y,
    PERIOD,
    SCENE,
    SEED_HIGH,
    SEED_LOW,
    SIDE,
    START,
    STEP_PSI,
    STEP_Y,
    W_FRAME,
    W_SEEN,
    X,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, curvature, heading, speed
from ldctoolkit.simulation.kernel.sample import rings

_CAMERA = 4
"""Stream of random numbers; see `ldctoolkit.simulation.random_streams`."""

_FRAME_ZERO = 1 << 20
"""Counter of the frame at the trigger: earlier ones have numbers too."""


@numba.njit(**OPTIONS)
def _measured(scene, i, true, noise, bias, step):
    """Bias in the road's frame, noise, quantisation."""
    value = true + scene[i, SIDE] * bias + noise
    return step * np.rint(value / step) if step > 0.0 else value


@numba.njit(**OPTIONS)
def _frame(scene, setting, state, i, j, work):
    """Frame j as it reaches the law, into `work`."""
    a, b = 0.0, 0.0
    if setting[NOISE_Y] + setting[NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[SEED_LOW])
        a, b = normal_pair(seed, np.uint64(scene[i, INDEX]), _CAMERA, np.uint64(_FRAME_ZERO + j))
    if j >= 0:
        _, frames, _, _ = rings(setting)
        at = frames + 2 * ((j * int(setting[PERIOD])) % int(setting[FRAMES]))
        y, psi = state[i, at], state[i, at + 1]
    else:
        at = SCENE + int(setting[MODES]) + 2 * (-j - 1)
        y, psi = scene[i, at], scene[i, at + 1]
    work[W_FRAME] = _measured(scene, i, y, setting[NOISE_Y] * a, setting[BIAS_Y], setting[STEP_Y])
    work[W_FRAME + 1] = _measured(scene, i, psi, setting[NOISE_PSI] * b, setting[BIAS_PSI], setting[STEP_PSI])


@numba.njit(**OPTIONS)
def lane_ahead(scene, setting, i, t, ahead):
    """Yaw rate and turn of the lane at a lookahead time, as the law is told."""
    v, _ = speed(scene, setting, i, t + ahead)
    c = curvature(scene, i, t + ahead)
    turn, way = heading(scene, setting, i, t, t + ahead)
    if setting[CAMERA] == 0.0:
        return v * c, turn
    gain, bias = 1.0 + setting[CURVATURE_GAIN], scene[i, CURVATURE_BIAS]
    return v * (gain * c + bias), gain * turn + bias * way


@numba.njit(**OPTIONS)
def see(scene, setting, state, i, k, work):
    """State as the law sees it at sample k, into `work`; each sample once and in order."""
    for n in range(4):
        work[W_SEEN + n] = state[i, X + n]
    if setting[CAMERA] == 0.0:
        return
    _, frames, _, _ = rings(setting)
    at = frames + 2 * (k % int(setting[FRAMES]))
    state[i, at], state[i, at + 1] = state[i, X], state[i, X + 2]
    period, late = int(setting[PERIOD]), int(setting[LATE])
    j = (k - late) // period
    if setting[FILTERED] == 0.0:
        _frame(scene, setting, state, i, j, work)
        work[W_SEEN], work[W_SEEN + 2] = work[W_FRAME], work[W_FRAME + 1]
        return
    model = SCENE + int(setting[MODES]) + 2 * int(setting[EARLIER])
    if k > 0:
        t = scene[i, START] + k * setting[DT]
        r_0, _ = lane_ahead(scene, setting, i, t - setting[DT], 0.0)
        r_1, _ = lane_ahead(scene, setting, i, t, 0.0)
        for n in range(4):
            value = scene[i, model + MODEL_B + n] * state[i, COMMAND]
            value += scene[i, model + MODEL_E_0 + n] * r_0 + scene[i, model + MODEL_E_1 + n] * r_1
            for m in range(4):
                value += scene[i, model + MODEL_A + 4 * n + m] * state[i, ESTIMATE + m]
            work[W_SEEN + n] = value
        for n in range(4):
            state[i, ESTIMATE + n] = work[W_SEEN + n]
    if k == 0 or j != (k - 1 - late) // period:
        _frame(scene, setting, state, i, j, work)
        a, b = work[W_FRAME] - state[i, ESTIMATE], work[W_FRAME + 1] - state[i, ESTIMATE + 2]
        for n in range(4):
            state[i, ESTIMATE + n] += scene[i, model + GAIN + 2 * n] * a + scene[i, model + GAIN + 2 * n + 1] * b
    for n in range(4):
        work[W_SEEN + n] = state[i, ESTIMATE + n]


@numba.njit(**OPTIONS)
def linear_command(scene, setting, law, times, state, i, t, work):
    """Command of a linear law on what it sees; once a sample, for the integral of e_y goes on with it."""
    command = law[i, LAW_U] * state[i, COMMAND] + law[i, LAW_I] * state[i, INTEGRAL]
    state[i, INTEGRAL] += setting[DT] * work[W_SEEN]
    for n in range(4):
        command += law[i, LAW_F + n] * work[W_SEEN + n]
    for j in range(times.shape[0]):
        of_rate, of_turn = law[i, LAW + 2 * j], law[i, LAW + 2 * j + 1]
        if of_rate != 0.0 or of_turn != 0.0:
            yaw_rate, turn = lane_ahead(scene, setting, i, t, times[j])
            command += of_rate * yaw_rate + of_turn * turn
    return command
