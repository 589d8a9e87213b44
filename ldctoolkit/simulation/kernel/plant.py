"""One smooth piece of a scenario's path: Taylor series for constant coefficients, Runge-Kutta of order 8 otherwise.

On a smooth piece the steering angle is offset + slope s + decay exp(-s/lag), s the time since its start. The linear
plant at a frozen speed has a Taylor series whose terms follow from one another; summed until they vanish it is exact to
rounding. A speed that changes, or saturating tyres, take fixed substeps of the method of Dormand and Prince (E. Hairer,
S. Norsett, G. Wanner, *Solving Ordinary Differential Equations I*, section II.5), a quarter of the fastest time
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
    B_1,
    B_3,
    C_AF,
    C_AR,
    E_1,
    E_3,
    I_Z,
    L_F,
    L_R,
    MASS,
    MU,
    PRINTED,
)
from ldctoolkit.vehicle._nonlinear_compiled import nonlinear_rhs

# strict arithmetic: no number depends on how a loop was vectorised; division by zero gives infinity as in NumPy
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}

_STAGES: Final = 12
_A: Final = np.ascontiguousarray(DOP853.A[:_STAGES, :_STAGES])
_B: Final = np.ascontiguousarray(DOP853.B)
_C: Final = np.ascontiguousarray(DOP853.C[:_STAGES])

_SERIES_REACH: Final = 2.0
"""Longest step of a series, in units of the fastest time constant: more terms would cancel."""

_SUBSTEP: Final = 0.25
"""Longest substep of the Runge-Kutta method, in the same units."""

_MOST_TERMS: Final = 80


@numba.njit(**OPTIONS)
def speed(scene, setting, i, t):
    """Speed and its rate."""
    if not setting.profile:
        return scene.v[i], 0.0
    T = scene.T[i]
    s = min(t, T)
    v = scene.v_mean[i] + scene.a_mean[i] * (s - 0.5 * T)
    rate = scene.a_mean[i]
    modes = scene.modes_v.shape[1]
    if modes:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * s), math.sin(w * s)
        c, d = 1.0, 0.0
        for j in range(modes):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            v += scene.modes_v[i, j] * c
            rate -= scene.modes_v[i, j] * (j + 1) * w * d
    return v, (rate if t < T else 0.0)


@numba.njit(**OPTIONS)
def curvature(scene, i, t):
    """Lane curvature, held beyond T."""
    return scene.c_0[i] + scene.dc[i] * min(t / scene.T[i], 1.0)


@numba.njit(**OPTIONS)
def _turned(scene, setting, i, t):
    """Integral of v(t) (c(t), 1) from 0 to t, t at most T, in closed form."""
    T, c_0, slope = scene.T[i], scene.c_0[i], scene.dc[i] / scene.T[i]
    v_0 = scene.v_mean[i] - 0.5 * scene.a_mean[i] * T
    a = scene.a_mean[i]
    way = t * (v_0 + 0.5 * a * t)
    turn = c_0 * way + slope * t * t * (0.5 * v_0 + a * t / 3.0)
    modes = scene.modes_v.shape[1]
    if modes:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * t), math.sin(w * t)
        c, d = 1.0, 0.0
        for j in range(modes):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            f = (j + 1) * w
            part = scene.modes_v[i, j] * d / f
            way += part
            turn += part * (c_0 + slope * t) + scene.modes_v[i, j] * slope * (c - 1.0) / (f * f)
    return turn, way


@numba.njit(**OPTIONS)
def heading(scene, setting, i, t_0, t_1):
    """Turn of the lane between two times, and the way driven."""
    T, c_0, dc = scene.T[i], scene.c_0[i], scene.dc[i]
    if not setting.profile:
        v = scene.v[i]
        in_0, in_1 = min(t_0, T), min(t_1, T)
        turn = c_0 * (t_1 - t_0) + dc * (0.5 * (in_1 * in_1 - in_0 * in_0) / T + (max(t_1 - T, 0.0) - max(t_0 - T, 0.0)))
        return v * turn, v * (t_1 - t_0)
    turn_0, way_0 = _turned(scene, setting, i, min(t_0, T))
    turn_1, way_1 = _turned(scene, setting, i, min(t_1, T))
    after = max(t_1 - T, 0.0) - max(t_0 - T, 0.0)
    v, _ = speed(scene, setting, i, T)
    return turn_1 - turn_0 + v * (c_0 + dc) * after, way_1 - way_0 + v * after


@numba.njit(**OPTIONS)
def accelerations(scene, setting, i, t, r, p, psi, w, delta):
    """Accelerations e_y'' and e_psi'', and a_y, at time t with the lane yaw rate r."""
    if not (setting.profile or setting.saturating):
        q = scene.linear[i]
        lateral = q[A_11] * p + q[A_12] * psi + q[A_13] * w + q[B_1] * delta + q[E_1] * r
        yaw = q[A_31] * p + q[A_32] * psi + q[A_33] * w + q[B_3] * delta + q[E_3] * r
        return lateral, yaw, lateral + scene.v[i] * r
    v, dv = speed(scene, setting, i, t)
    car = scene.vehicle[i]
    if setting.saturating:
        return nonlinear_rhs(
            p, psi, w, delta, r, v, dv,
            car[C_AF], car[C_AR], car[L_F], car[L_R], car[MASS], car[I_Z], car[MU], setting.shape,
        )  # fmt: skip
    v_y = p - v * psi
    omega = w + r
    front = 2.0 * car[C_AF] * (delta - (v_y + car[L_F] * omega) / v)
    rear = -2.0 * car[C_AR] * (v_y - car[L_R] * omega) / v
    a_y = (front + rear) / car[MASS] - car[PRINTED] * w / v
    return a_y - v * r + dv * psi, (car[L_F] * front - car[L_R] * rear) / car[I_Z], a_y


@numba.njit(**OPTIONS)
def _series(q, x, h, offset, slope, decay, lag, r, r_slope, out):
    """Linear plant at h: state into out[:4], integral of e_y into out[4]; h within the reach of a series."""
    y, p, psi, w = x[0], x[1], x[2], x[3]
    sum_y, sum_p, sum_psi, sum_w, area = y, p, psi, w, h * y
    steer, lane, fading = offset + decay, r, decay
    for k in range(1, _MOST_TERMS):
        f = h / k
        p_next = f * (q[A_11] * p + q[A_12] * psi + q[A_13] * w + q[B_1] * steer + q[E_1] * lane)
        w_next = f * (q[A_31] * p + q[A_32] * psi + q[A_33] * w + q[B_3] * steer + q[E_3] * lane)
        y, psi = f * p, f * w
        p, w = p_next, w_next
        sum_y += y
        sum_p += p
        sum_psi += psi
        sum_w += w
        area += y * h / (k + 1)
        if decay != 0.0:
            fading *= -f / lag
        steer, lane = fading, 0.0
        if k == 1:
            steer += h * slope
            lane = h * r_slope
        # two terms in a row without weight, and nothing left in the inputs that could bring more
        small = abs(p) <= 1e-17 * abs(sum_p) + 1e-22 and abs(w) <= 1e-17 * abs(sum_w) + 1e-22
        if k > 3 and small and abs(fading) <= 1e-19 * abs(decay) and abs(psi) <= 1e-17 * abs(sum_psi) + 1e-22:
            break
    out[0], out[1], out[2], out[3], out[4] = sum_y, sum_p, sum_psi, sum_w, area


@numba.njit(**OPTIONS)
def _runge_kutta(scene, setting, i, x, t, h, offset, slope, decay, lag, s_0, out, K):
    """One substep from t to t + h; s_0 is its start since the piece's start."""
    for stage in range(_STAGES):
        y, p, psi, w = x[0], x[1], x[2], x[3]
        for j in range(stage):
            a = h * _A[stage, j]
            y += a * K[j, 0]
            p += a * K[j, 1]
            psi += a * K[j, 2]
            w += a * K[j, 3]
        s = s_0 + _C[stage] * h
        delta = offset + slope * s
        if decay != 0.0:
            delta += decay * math.exp(-s / lag)
        at = t + _C[stage] * h
        v, _ = speed(scene, setting, i, at)
        lateral, yaw, _ = accelerations(scene, setting, i, at, v * curvature(scene, i, at), p, psi, w, delta)
        K[stage, 0], K[stage, 1], K[stage, 2], K[stage, 3], K[stage, 4] = p, lateral, w, yaw, y
    for n in range(4):
        total = 0.0
        for stage in range(_STAGES):
            total += _B[stage] * K[stage, n]
        out[n] = x[n] + h * total
    area = 0.0
    for stage in range(_STAGES):
        area += _B[stage] * K[stage, 4]
    out[4] = h * area


@numba.njit(**OPTIONS)
def substeps(scene, setting, i, t, h, decay):
    """Into how many equal parts a smooth piece is cut."""
    v, _ = speed(scene, setting, i, t)
    fastest = scene.fastest[i] / v
    if decay != 0.0:
        fastest = max(fastest, 1.0 / setting.lag)
    reach = _SUBSTEP if setting.profile or setting.saturating else _SERIES_REACH
    parts = math.ceil(h * fastest / reach)
    return max(1, min(int(parts), 100_000) if parts == parts else 1)


@numba.njit(**OPTIONS)
def move(scene, setting, i, x, t, h, offset, slope, decay, s_0, out, K):
    """One substep: state at t + h into out[:4], integral of e_y into out[4]."""
    if setting.profile or setting.saturating:
        _runge_kutta(scene, setting, i, x, t, h, offset, slope, decay, setting.lag, s_0, out, K)
        return
    fading = decay * math.exp(-s_0 / setting.lag) if decay != 0.0 else 0.0
    r = scene.v[i] * curvature(scene, i, t)
    # the piece does not reach over T, where the curvature's slope ends
    r_slope = scene.v[i] * scene.dc[i] / scene.T[i] if t + 0.5 * h < scene.T[i] else 0.0
    _series(scene.linear[i], x, h, offset + slope * s_0, slope, fading, setting.lag, r, r_slope, out)
