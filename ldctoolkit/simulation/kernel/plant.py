"""One smooth piece of a scenario's path: Taylor series for constant coefficients, Runge-Kutta of order 8 otherwise.

On a smooth piece the steering angle is offset + slope s + decay exp(-s/lag), s the time since its start. The linear
plant at a frozen speed has a Taylor series whose terms follow from one another; summed until they vanish it is exact to
rounding. A speed that changes, or saturating tyres, take fixed substeps of the method of Dormand and Prince (E. Hairer,
S. Norsett, G. Wanner, *Solving Ordinary Differential Equations I*, section II.5), a fifth of the fastest time
constant long.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np
from scipy.integrate import DOP853

from ldctoolkit.simulation.kernel.data import (
    A_11,
    A_12,
    A_13,
    A_31,
    A_32,
    A_33,
    A_MEAN,
    B_1,
    B_3,
    C_0,
    C_AF,
    C_AR,
    DC,
    E_1,
    E_3,
    FASTEST,
    I_Z,
    L_F,
    L_R,
    LAG,
    MASS,
    MODES,
    MU,
    PRINTED,
    PROFILE,
    SATURATING,
    SCENE,
    SHAPE,
    SPEED,
    T_END,
    V_MEAN,
    W_K,
    X,
)
from ldctoolkit.vehicle._nonlinear_compiled import nonlinear_rhs

# strict arithmetic: no number depends on its neighbours in a vector, nor on what was compiled before, which decides
# where a compiler that may fuses a product and a sum; division by zero gives infinity as in NumPy
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}

_STAGES: Final = 12
_A: Final = np.ascontiguousarray(DOP853.A[:_STAGES, :_STAGES])
_B: Final = np.ascontiguousarray(DOP853.B)
_C: Final = np.ascontiguousarray(DOP853.C[:_STAGES])

_SERIES_REACH: Final = 2.0
"""Longest step of a series, in units of the fastest time constant: more terms would cancel."""

_SUBSTEP: Final = 0.2
"""Longest substep of the Runge-Kutta method, in the same units."""

MOST_TERMS: Final = 80
INVERSE: Final = 1.0 / np.maximum(np.arange(MOST_TERMS + 2.0), 1.0)
NOTHING: Final = 2.0**-57
"""Share of a sum that is lost in its rounding."""
TINY: Final = 1e-22
"""The same where the sum is zero."""


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
def accelerations(scene, setting, i, t, r, p, psi, w, delta, inside=True):
    """Accelerations e_y'' and e_psi'', and a_y, at time t and lane yaw rate r; `inside` where that is before T."""
    if setting[PROFILE] + setting[SATURATING] == 0.0:
        lateral = (
            scene[i, A_11] * p + scene[i, A_12] * psi + scene[i, A_13] * w + scene[i, B_1] * delta + scene[i, E_1] * r
        )
        yaw = scene[i, A_31] * p + scene[i, A_32] * psi + scene[i, A_33] * w + scene[i, B_3] * delta + scene[i, E_3] * r
        return lateral, yaw, lateral + scene[i, SPEED] * r
    v, dv = speed(scene, setting, i, t)
    dv = dv if inside else 0.0
    if setting[SATURATING] > 0.0:
        return nonlinear_rhs(
            p, psi, w, delta, r, v, dv,
            scene[i, C_AF], scene[i, C_AR], scene[i, L_F], scene[i, L_R], scene[i, MASS], scene[i, I_Z],
            scene[i, MU], setting[SHAPE],
        )  # fmt: skip
    v_y = p - v * psi
    omega = w + r
    front = 2.0 * scene[i, C_AF] * (delta - (v_y + scene[i, L_F] * omega) / v)
    rear = -2.0 * scene[i, C_AR] * (v_y - scene[i, L_R] * omega) / v
    a_y = (front + rear) / scene[i, MASS] - scene[i, PRINTED] * w / v
    return a_y - v * r + dv * psi, (scene[i, L_F] * front - scene[i, L_R] * rear) / scene[i, I_Z], a_y


@numba.njit(**OPTIONS)
def _series(scene, i, state, h, offset, slope, decay, lag, r, r_slope, work, out):
    """Linear plant at h: state into work[out:out + 4], integral of e_y behind it; h within the reach of a series."""
    a_11, a_12, a_13 = scene[i, A_11], scene[i, A_12], scene[i, A_13]
    a_31, a_32, a_33 = scene[i, A_31], scene[i, A_32], scene[i, A_33]
    b_1, b_3, e_1, e_3 = scene[i, B_1], scene[i, B_3], scene[i, E_1], scene[i, E_3]
    y, p, psi, w = state[i, X], state[i, X + 1], state[i, X + 2], state[i, X + 3]
    sum_y, sum_p, sum_psi, sum_w, area = y, p, psi, w, h * y
    steer, lane, fading = offset + decay, r, decay
    # the lateral terms lose their meaning below the rounding of what they are added to
    small = NOTHING * (abs(p) + abs(w) + h * (abs(b_1 * steer) + abs(e_1 * lane))) + TINY
    fades = -1.0 / lag if decay != 0.0 else 0.0
    for k in range(1, MOST_TERMS):
        f = h * INVERSE[k]
        # written as a tree: what follows from the term before enters last
        p_next = f * ((a_13 * w + (b_1 * steer + e_1 * lane)) + (a_11 * p + a_12 * psi))
        w_next = f * ((a_32 * psi + (b_3 * steer + e_3 * lane)) + (a_31 * p + a_33 * w))
        y, psi = f * p, f * w
        p, w = p_next, w_next
        sum_y += y
        sum_p += p
        sum_psi += psi
        sum_w += w
        area += y * (h * INVERSE[k + 1])
        fading *= f * fades
        steer, lane = fading, 0.0
        if k == 1:
            steer += h * slope
            lane = h * r_slope
        # nothing is left in the state, nor in the inputs, that could bring more; the size of the terms tells
        elif abs(p) + abs(w) + abs(psi) + abs(y) + abs(b_1 * fading) <= small:
            break
    work[out], work[out + 1], work[out + 2], work[out + 3], work[out + 4] = sum_y, sum_p, sum_psi, sum_w, area


@numba.njit(**OPTIONS)
def _runge_kutta(scene, setting, i, state, t, h, offset, slope, decay, s_0, work, out):
    """One substep from t to t + h; s_0 is its start since the piece's start."""
    # no piece reaches over T, where the rate of the speed jumps; a stage may stand on T itself
    inside = t + 0.5 * h < scene[i, T_END]
    for stage in range(_STAGES):
        y, p, psi, w = state[i, X], state[i, X + 1], state[i, X + 2], state[i, X + 3]
        for j in range(stage):
            a = h * _A[stage, j]
            K = W_K + 5 * j
            y += a * work[K]
            p += a * work[K + 1]
            psi += a * work[K + 2]
            w += a * work[K + 3]
        s = s_0 + _C[stage] * h
        delta = offset + slope * s
        if decay != 0.0:
            delta += decay * math.exp(-s / setting[LAG])
        at = t + _C[stage] * h
        v, _ = speed(scene, setting, i, at)
        lateral, yaw, _ = accelerations(scene, setting, i, at, v * curvature(scene, i, at), p, psi, w, delta, inside)
        K = W_K + 5 * stage
        work[K], work[K + 1], work[K + 2], work[K + 3], work[K + 4] = p, lateral, w, yaw, y
    for n in range(5):
        total = 0.0
        for stage in range(_STAGES):
            total += _B[stage] * work[W_K + 5 * stage + n]
        work[out + n] = (state[i, X + n] if n < 4 else 0.0) + h * total


@numba.njit(**OPTIONS)
def substeps(scene, setting, i, t, h, decay):
    """Into how many equal parts a smooth piece is cut."""
    v, _ = speed(scene, setting, i, t)
    fastest = scene[i, FASTEST] / v
    if decay != 0.0:
        fastest = max(fastest, 1.0 / setting[LAG])
    reach = _SUBSTEP if setting[PROFILE] + setting[SATURATING] > 0.0 else _SERIES_REACH
    parts = math.ceil(h * fastest / reach)
    return max(1, min(int(parts), 100_000) if parts == parts else 1)


@numba.njit(**OPTIONS)
def move(scene, setting, i, state, t, h, offset, slope, decay, s_0, work, out):
    """One substep: state at t + h into work[out:out + 4], integral of e_y behind it."""
    if setting[PROFILE] + setting[SATURATING] > 0.0:
        _runge_kutta(scene, setting, i, state, t, h, offset, slope, decay, s_0, work, out)
        return
    fading = decay * math.exp(-s_0 / setting[LAG]) if decay != 0.0 else 0.0
    v, T = scene[i, SPEED], scene[i, T_END]
    # the piece does not reach over T, where the curvature's slope ends
    r_slope = v * scene[i, DC] / T if t + 0.5 * h < T else 0.0
    r = v * curvature(scene, i, t)
    _series(scene, i, state, h, offset + slope * s_0, slope, fading, setting[LAG], r, r_slope, work, out)
