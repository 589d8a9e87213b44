"""Steps that T cuts, and last ones that are not whole, in all lanes at once.

Neighbours last about equally long and so come to their T at the same sample. Each part of a step is the plant's Taylor
series, as in `plant`, with the lanes side by side; a lane whose terms have vanished adds nothing more, so that its
numbers do not depend on its neighbours.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

from ldctoolkit.simulation.kernel.between import hermite_peak, touches
from ldctoolkit.simulation.kernel.data import (
    AREA,
    AXLE,
    BACK,
    BOUND,
    DEEP,
    DT,
    EFFORT,
    FRONT,
    OFFSET,
    OVER,
    TRAVEL,
    W_AFTER,
    X,
)
from ldctoolkit.simulation.kernel.fused import fma
from ldctoolkit.simulation.kernel.lane_table import (
    R_ALIVE,
    R_AT,
    R_C0,
    R_D,
    R_DC,
    R_E,
    R_FLAG,
    R_H,
    R_IN,
    R_K,
    R_LEFT,
    R_M,
    R_N,
    R_O,
    R_PART,
    R_PER_T,
    R_Q,
    R_S,
    R_SINGLE,
    R_SMALL,
    R_START,
    R_STIFF,
    R_SUM,
    R_T,
    R_U,
    R_UNTIL,
    R_W,
    R_X,
    L,
)
from ldctoolkit.simulation.kernel.plant import INVERSE, MOST_TERMS, NOTHING, OPTIONS, TINY
from ldctoolkit.simulation.kernel.sample import length, time_at


@numba.njit(**OPTIONS)
def _first_terms(w):
    """State and first term of the series over a part of a step, from the state in R_M."""
    for l in range(L):
        h, t = w[R_PART * L + l], w[R_AT * L + l]
        y, p, psi, turn, d = (
            w[R_M * L + l],
            w[(R_M + 1) * L + l],
            w[(R_M + 2) * L + l],
            w[(R_M + 3) * L + l],
            w[R_D * L + l],
        )
        r = w[R_C0 * L + l] + w[R_DC * L + l] * min(t * w[R_PER_T * L + l], 1.0)
        # no part reaches over T, where the slope of the curvature ends
        slope = w[R_DC * L + l] * w[R_PER_T * L + l] if t + 0.5 * h < w[R_T * L + l] else 0.0
        e_1, e_3 = w[R_E * L + l], w[(R_W + 4) * L + l]
        p_in = w[(R_Q + 3) * L + l] * d + e_1 * r
        p_k = h * (w[R_Q * L + l] * p + w[(R_Q + 1) * L + l] * psi + w[(R_Q + 2) * L + l] * turn + p_in)
        turn_k = h * (w[R_W * L + l] * p + w[(R_W + 1) * L + l] * psi + w[(R_W + 2) * L + l] * turn)
        turn_k += h * (w[(R_W + 3) * L + l] * d + e_3 * r)
        y_k, psi_k = h * p, h * turn
        w[R_O * L + l], w[(R_O + 1) * L + l], w[(R_O + 2) * L + l], w[(R_O + 3) * L + l] = y, p, psi, turn
        w[R_M * L + l], w[(R_M + 1) * L + l] = y + y_k, p + p_k
        w[(R_M + 2) * L + l], w[(R_M + 3) * L + l] = psi + psi_k, turn + turn_k
        w[(R_M + 4) * L + l] = h * y + 0.5 * h * y_k
        w[R_K * L + l], w[(R_K + 1) * L + l], w[(R_K + 2) * L + l] = p_k, psi_k, turn_k
        w[R_IN * L + l], w[(R_IN + 1) * L + l] = e_1 * h * slope, e_3 * h * slope
        # the lateral terms lose their meaning below the rounding of what they are added to
        w[R_SMALL * L + l] = NOTHING * (abs(p) + abs(turn) + h * abs(p_in)) + TINY


@numba.njit(**OPTIONS)
def _next_terms(k, w):
    """Term k >= 2 of every lane; whether one of them has more to come."""
    f, g, lane = INVERSE[k], INVERSE[k + 1], 1.0 if k == 2 else 0.0
    more = False
    for l in range(L):
        h, p, psi, turn = w[R_PART * L + l], w[R_K * L + l], w[(R_K + 1) * L + l], w[(R_K + 2) * L + l]
        f_h = f * h
        y_k, psi_k = f_h * p, f_h * turn
        p_k = fma(w[R_Q * L + l], p, fma(w[(R_Q + 1) * L + l], psi, w[(R_Q + 2) * L + l] * turn))
        p_k = f_h * fma(lane, w[R_IN * L + l], p_k)
        turn_k = fma(w[R_W * L + l], p, fma(w[(R_W + 1) * L + l], psi, w[(R_W + 2) * L + l] * turn))
        turn_k = f_h * fma(lane, w[(R_IN + 1) * L + l], turn_k)
        w[R_M * L + l] += y_k
        w[(R_M + 1) * L + l] += p_k
        w[(R_M + 2) * L + l] += psi_k
        w[(R_M + 3) * L + l] += turn_k
        w[(R_M + 4) * L + l] = fma(y_k, h * g, w[(R_M + 4) * L + l])
        going = abs(p_k) + abs(turn_k) + abs(psi_k) + abs(y_k) > w[R_SMALL * L + l]
        more |= going
        w[R_K * L + l] = p_k if going else 0.0
        w[(R_K + 1) * L + l] = psi_k if going else 0.0
        w[(R_K + 2) * L + l] = turn_k if going else 0.0
    return more


@numba.njit(inline="always", **OPTIONS)
def _part(scene, setting, state, i, l, counted, w, work, full):
    """What happened over a part of a step; False if that takes `sample.drive`."""
    h, t = w[R_PART * L + l], w[R_AT * L + l]
    x_0, x_1, n_0, n_1 = w[R_O * L + l], w[(R_O + 1) * L + l], w[R_M * L + l], w[(R_M + 1) * L + l]
    if not abs(n_0) <= setting[BOUND] or (counted and touches(x_0, x_1, n_0, n_1, h)):
        return False
    area, before = w[(R_M + 4) * L + l], 0.0
    back = full and w[(R_S + BACK) * L + l] == math.inf and x_0 >= setting[OFFSET] > n_0
    across = counted and x_0 * n_0 < 0.0
    if back or across:
        d = w[R_D * L + l]
        for n in range(4):
            state[i, X + n] = w[(R_O + n) * L + l]
            work[W_AFTER + n] = w[(R_M + n) * L + l]
        work[W_AFTER + 4] = area
        if back:
            s, _ = time_at(scene, setting, i, state, t, h, setting[OFFSET], d, 0.0, 0.0, 0.0, work)
            w[(R_S + BACK) * L + l] = t + s
        if across:
            _, before = time_at(scene, setting, i, state, t, h, 0.0, d, 0.0, 0.0, 0.0, work)
    if counted:
        w[R_SUM * L + l] = abs(before) + abs(area - before)
    if full:
        if counted:
            l_f = setting[AXLE]
            g_0, f_0 = x_0 + l_f * w[(R_O + 2) * L + l], x_1 + l_f * w[(R_O + 3) * L + l]
            g_1, f_1 = n_0 + l_f * w[(R_M + 2) * L + l], n_1 + l_f * w[(R_M + 3) * L + l]
            w[(R_S + DEEP) * L + l] = max(w[(R_S + DEEP) * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
            w[(R_S + FRONT) * L + l] = max(w[(R_S + FRONT) * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
        w[(R_S + OVER) * L + l] = max(w[(R_S + OVER) * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))
    return True


@numba.njit(**OPTIONS)
def drive_cuts(scene, setting, state, first, count, k, w, work, full):
    """Step k of the lanes in which it is cut; the others stay as they are."""
    for l in range(L):
        w[R_H * L + l] = w[R_UNTIL * L + l] = w[R_SUM * L + l] = 0.0
        for n in range(4):
            w[(R_M + n) * L + l] = w[(R_X + n) * L + l]
    some = False
    for l in range(count):
        if w[R_ALIVE * L + l] > 0.0:
            h, until = length(scene, setting, first + l, k)
            if h < setting[DT] or 0.0 < until < h:
                w[R_FLAG * L + l] = max(w[R_FLAG * L + l], 1.0)
                w[R_SINGLE * L + l] = -1.0
                if w[R_STIFF * L + l] == 0.0:
                    w[R_SINGLE * L + l], w[R_H * L + l], w[R_UNTIL * L + l], some = 1.0, h, until, True
    if not some:
        return
    for piece in range(2):
        counted = piece == 0
        any_part = False
        for l in range(L):
            until, t = w[R_UNTIL * L + l], w[R_START * L + l] + k * setting[DT]
            part = until if counted else w[R_H * L + l] - until
            w[R_PART * L + l], w[R_AT * L + l] = part, (t if counted else t + until)
            any_part |= part > 0.0
        if not any_part:
            continue
        _first_terms(w)
        for term in range(2, MOST_TERMS):
            if not _next_terms(term, w):
                break
        for l in range(count):
            driven = w[R_PART * L + l] > 0.0 and w[R_SINGLE * L + l] > 0.0
            if driven and not _part(scene, setting, state, first + l, l, counted, w, work, full):
                w[R_SINGLE * L + l] = -1.0
    for l in range(count):
        h, d = w[R_H * L + l], w[R_D * L + l]
        if h > 0.0 and w[R_SINGLE * L + l] > 0.0:
            w[(R_S + AREA) * L + l] += w[R_SUM * L + l]
            for n in range(4):
                w[(R_N + n) * L + l] = w[(R_M + n) * L + l]
            if full:
                w[(R_S + EFFORT) * L + l] += h * (d * d)
                w[(R_S + TRAVEL) * L + l] += abs(d - w[R_U * L + l])
                t = w[R_START * L + l] + k * setting[DT] + h
                r = w[R_C0 * L + l] + w[R_DC * L + l] * min(t * w[R_PER_T * L + l], 1.0)
                q = w[R_Q * L + l] * w[(R_M + 1) * L + l] + w[(R_Q + 1) * L + l] * w[(R_M + 2) * L + l]
                q += w[(R_Q + 2) * L + l] * w[(R_M + 3) * L + l]
                w[R_LEFT * L + l] = q + w[(R_Q + 3) * L + l] * d + w[(R_Q + 4) * L + l] * r
