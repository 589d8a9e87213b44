"""What the law gets: the camera's latest frame, the filter's estimate, the lane ahead as the camera sees it."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba
import numpy as np

from ldctoolkit.simulation._philox import normal_pair
from ldctoolkit.simulation.kernel.plant import OPTIONS, curvature, heading, speed

_CAMERA = 4
"""Stream of random numbers; see `ldctoolkit.simulation.random_streams`."""

_FRAME_ZERO = 1 << 20
"""Counter of the frame at the trigger: earlier ones have numbers too."""


@numba.njit(**OPTIONS)
def _frame(scene, camera, state, i, j, out):
    """Frame j as it reaches the law."""
    ring = state.frames.shape[1]
    a, b = 0.0, 0.0
    if camera.noise[0] > 0.0 or camera.noise[1] > 0.0:
        a, b = normal_pair(camera.seed, scene.index[i], _CAMERA, _FRAME_ZERO + j)
    for n in range(2):
        true = state.frames[i, (j * camera.period) % ring, n] if j >= 0 else camera.earlier[i, -j - 1, n]
        value = true + scene.side[i] * camera.bias[n] + camera.noise[n] * (a if n == 0 else b)
        if camera.step[n] > 0.0:
            value = camera.step[n] * np.rint(value / camera.step[n])
        out[n] = value


@numba.njit(**OPTIONS)
def lane_ahead(scene, setting, camera, i, t, ahead):
    """Yaw rate and turn of the lane at a lookahead time, as the law is told."""
    v, _ = speed(scene, setting, i, t + ahead)
    c = curvature(scene, i, t + ahead)
    turn, way = heading(scene, setting, i, t, t + ahead)
    if camera.ideal:
        return v * c, turn
    gain, bias = 1.0 + camera.curvature_gain, camera.curvature_bias[i]
    return v * (gain * c + bias), gain * turn + bias * way


@numba.njit(**OPTIONS)
def see(scene, setting, camera, state, i, k, seen, frame):
    """State as the law sees it at sample k, into `seen`; each sample once and in order."""
    x = state.x[i]
    for n in range(4):
        seen[n] = x[n]
    if camera.ideal:
        return
    ring = state.frames.shape[1]
    state.frames[i, k % ring, 0] = x[0]
    state.frames[i, k % ring, 1] = x[2]
    j = (k - camera.delay) // camera.period
    fresh = k == 0 or j != (k - 1 - camera.delay) // camera.period
    if not camera.filtered:
        _frame(scene, camera, state, i, j, frame)
        seen[0], seen[2] = frame[0], frame[1]
        return
    z = state.estimate[i]
    if k > 0:
        t = scene.start[i] + k * setting.dt
        r_0, _ = lane_ahead(scene, setting, camera, i, t - setting.dt, 0.0)
        r_1, _ = lane_ahead(scene, setting, camera, i, t, 0.0)
        for n in range(4):
            value = camera.B[i, n] * state.command[i] + camera.E_0[i, n] * r_0 + camera.E_1[i, n] * r_1
            for m in range(4):
                value += camera.A[i, n, m] * z[m]
            seen[n] = value
        for n in range(4):
            z[n] = seen[n]
    if fresh:
        _frame(scene, camera, state, i, j, frame)
        a, b = frame[0] - z[0], frame[1] - z[2]
        for n in range(4):
            z[n] += camera.gain[i, n, 0] * a + camera.gain[i, n, 1] * b
    for n in range(4):
        seen[n] = z[n]


@numba.njit(**OPTIONS)
def linear_command(scene, setting, camera, law, state, i, t, seen):
    """Command of a linear law on what it sees."""
    command = law.f_u[i] * state.command[i]
    for n in range(4):
        command += law.F[i, n] * seen[n]
    for j in range(law.times.shape[0]):
        if law.G_yaw_rate[i, j] != 0.0 or law.G_heading[i, j] != 0.0:
            yaw_rate, turn = lane_ahead(scene, setting, camera, i, t, law.times[j])
            command += law.G_yaw_rate[i, j] * yaw_rate + law.G_heading[i, j] * turn
    return command
