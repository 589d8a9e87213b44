"""The road along a departure, as a plant drives it and as a law sees it."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Any, Final

import numba

from ldctoolkit.simulation.kernel.data import (
    A_MEAN,
    C_0,
    CAMERA,
    CURVATURE_BIAS,
    CURVATURE_GAIN,
    DC,
    DT,
    FULL,
    MODES,
    PROFILE,
    REST,
    SCENE,
    SPEED,
    STEPS,
    T_END,
    V_MEAN,
)

# strict arithmetic: no number depends on its neighbours in a vector, nor on what was compiled before, which decides
# where a compiler that may fuses a product and a sum; division by zero gives infinity as in NumPy
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}


@numba.njit(**OPTIONS)
def speed(scene, setting, i, t):
    """Speed and its rate."""
    if setting[PROFILE] == 0.0:
        return scene[i, SPEED], 0.0
    T = scene[i, T_END]
    s = min(t, T)
    v = scene[i, V_MEAN] + scene[i, A_MEAN] * (s - 0.5 * T)
    rate = scene[i, A_MEAN]
    if setting[MODES] > 0.0:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * s), math.sin(w * s)
        c, d = 1.0, 0.0
        for j in range(int(setting[MODES])):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            v += scene[i, SCENE + j] * c
            rate -= scene[i, SCENE + j] * (j + 1) * w * d
    return v, rate


@numba.njit(**OPTIONS)
def curvature(scene, i, t):
    """Lane curvature, held beyond T."""
    return scene[i, C_0] + scene[i, DC] * min(t / scene[i, T_END], 1.0)


@numba.njit(**OPTIONS)
def _turned(scene, setting, i, t):
    """Integral of v(t) (c(t), 1) from 0 to t, t at most T, in closed form."""
    T, c_0, slope = scene[i, T_END], scene[i, C_0], scene[i, DC] / scene[i, T_END]
    v_0 = scene[i, V_MEAN] - 0.5 * scene[i, A_MEAN] * T
    a = scene[i, A_MEAN]
    way = t * (v_0 + 0.5 * a * t)
    turn = c_0 * way + slope * t * t * (0.5 * v_0 + a * t / 3.0)
    if setting[MODES] > 0.0:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * t), math.sin(w * t)
        c, d = 1.0, 0.0
        for j in range(int(setting[MODES])):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            f = (j + 1) * w
            part = scene[i, SCENE + j] * d / f
            way += part
            turn += part * (c_0 + slope * t) + scene[i, SCENE + j] * slope * (c - 1.0) / (f * f)
    return turn, way


@numba.njit(**OPTIONS)
def heading(scene, setting, i, t_0, t_1):
    """Turn of the lane between two times, and the way driven."""
    T, c_0, dc = scene[i, T_END], scene[i, C_0], scene[i, DC]
    if setting[PROFILE] == 0.0:
        v = scene[i, SPEED]
        in_0, in_1 = min(t_0, T), min(t_1, T)
        turn = c_0 * (t_1 - t_0) + dc * (
            0.5 * (in_1 * in_1 - in_0 * in_0) / T + (max(t_1 - T, 0.0) - max(t_0 - T, 0.0))
        )
        return v * turn, v * (t_1 - t_0)
    turn_0, way_0 = _turned(scene, setting, i, min(t_0, T))
    turn_1, way_1 = _turned(scene, setting, i, min(t_1, T))
    after = max(t_1 - T, 0.0) - max(t_0 - T, 0.0)
    v, _ = speed(scene, setting, i, T)
    return turn_1 - turn_0 + v * (c_0 + dc) * after, way_1 - way_0 + v * after


@numba.njit(**OPTIONS)
def lane_ahead(scene, setting, i, t, ahead):
    """Yaw rate and turn of the lane at a lookahead time, as the law sees them."""
    v, _ = speed(scene, setting, i, t + ahead)
    c = curvature(scene, i, t + ahead)
    turn, way = heading(scene, setting, i, t, t + ahead)
    if setting[CAMERA] == 0.0:
        return v * c, turn
    gain, bias = 1.0 + setting[CURVATURE_GAIN], scene[i, CURVATURE_BIAS]
    return v * (gain * c + bias), gain * turn + bias * way


@numba.njit(inline="always", **OPTIONS)
def length_of(scene, setting, i, k):
    """Length of sample k, and how much of it lies before T."""
    full, rest = scene[i, FULL], scene[i, REST]
    h = rest if k + 1 == scene[i, STEPS] and rest > 0.0 else setting[DT]
    return h, (h if k < full else (rest if k == full else 0.0))
