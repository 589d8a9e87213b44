"""What happens in a lane now and then, one scenario at a time.

A change of sign of e_y, an extreme between two samples, the edge back inside.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba

from ldctoolkit.simulation.kernel.between import crossing, hermite_peak, touches
from ldctoolkit.simulation.kernel.data import (
    AXLE,
    BACK,
    BOUND,
    DEEP,
    DT,
    FRONT,
    OFFSET,
    OVER,
    RING,
    SCORE,
    SCORES,
    START,
    W_LIMITS,
    WHEEL,
    WINDOW,
    X,
)
from ldctoolkit.simulation.kernel.lane_table import (
    R_BEFORE,
    R_C0,
    R_COUNTED,
    R_D,
    R_DC,
    R_E,
    R_LEFT,
    R_N,
    R_PAST_LEFT,
    R_PER_T,
    R_Q,
    R_R1,
    R_REACH,
    R_RIGHT,
    R_S,
    R_SIGNED,
    R_STIFF,
    R_U,
    R_W,
    R_X,
    L,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS
from ldctoolkit.simulation.kernel.sample import drive, length, past_sample, time_near

_CLOSE: Final = 1e-12
"""Error [m s] of an integral of e_y, and [s] of a time, above which the path's Taylor series is asked."""


@numba.njit(inline="always", **OPTIONS)
def look_closer(scene, setting, state, i, l, k, w, work, full):
    """What happens between the ends of a whole step; False if that takes `sample.drive`."""
    x_0, n_0, h, counted = w[R_X * L + l], w[R_N * L + l], setting[DT], w[R_COUNTED * L + l] > 0.0
    if w[R_STIFF * L + l] > 0.0 or not abs(n_0) <= setting[BOUND]:
        return False
    x_1, n_1 = w[(R_X + 1) * L + l], w[(R_N + 1) * L + l]
    if counted and touches(x_0, x_1, n_0, n_1, h):
        return False
    back = full and w[(R_S + BACK) * L + l] == math.inf and x_0 >= setting[OFFSET] > n_0
    across = counted and x_0 * n_0 < 0.0
    if back or across:
        _cross(scene, setting, state, i, l, k, back, across, counted, w, work)
    if full:
        f_0, f_1 = x_1 + setting[AXLE] * w[(R_X + 3) * L + l], n_1 + setting[AXLE] * w[(R_N + 3) * L + l]
        if counted and x_1 > 0.0 > n_1:
            w[(R_S + DEEP) * L + l] = max(w[(R_S + DEEP) * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        if counted and f_0 > 0.0 > f_1:
            g_0, g_1 = x_0 + setting[AXLE] * w[(R_X + 2) * L + l], n_0 + setting[AXLE] * w[(R_N + 2) * L + l]
            w[(R_S + FRONT) * L + l] = max(w[(R_S + FRONT) * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
        if x_1 < 0.0 < n_1:
            w[(R_S + OVER) * L + l] = max(w[(R_S + OVER) * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))
    return True


@numba.njit(inline="always", **OPTIONS)
def _cross(scene, setting, state, i, l, k, back, across, counted, w, work):
    """The edge back inside, and a change of sign of e_y, within a whole step."""
    h, offset, reach, t = setting[DT], setting[OFFSET], w[R_REACH * L + l], scene[i, START] + k * setting[DT]
    x_0, x_1, x_2, x_3 = w[R_X * L + l], w[(R_X + 1) * L + l], w[(R_X + 2) * L + l], w[(R_X + 3) * L + l]
    n_0, n_1, n_2, n_3 = w[R_N * L + l], w[(R_N + 1) * L + l], w[(R_N + 2) * L + l], w[(R_N + 3) * L + l]
    d, area, lane = w[R_D * L + l], w[R_SIGNED * L + l], w[R_DC * L + l] * w[R_PER_T * L + l] if counted else 0.0
    r_0 = w[R_C0 * L + l] + w[R_DC * L + l] * min(t * w[R_PER_T * L + l], 1.0)
    a_0, j_0 = _rates(l, x_1, x_2, x_3, d, r_0, lane, w)
    a_1, j_1 = _rates(l, n_1, n_2, n_3, d, w[R_R1 * L + l], lane, w)
    for n in range(4):
        state[i, X + n] = w[(R_X + n) * L + l]
    if back:
        s, _, off = crossing(offset, h, x_0, x_1, a_0, j_0, n_0, n_1, a_1, j_1, area, 1e-7)
        if not reach * off <= _CLOSE * -max(x_1, n_1):
            s, _ = time_near(scene, setting, i, state, t, h, s, offset, d, 0.0, 0.0, 0.0, work)
        w[(R_S + BACK) * L + l] = t + s
    if across:
        s, before, off = crossing(0.0, h, x_0, x_1, a_0, j_0, n_0, n_1, a_1, j_1, area, 1e-5)
        if not h * reach * off <= _CLOSE:
            _, before = time_near(scene, setting, i, state, t, h, s, 0.0, d, 0.0, 0.0, 0.0, work)
        w[R_SIGNED * L + l] = abs(before) + abs(area - before)


@numba.njit(inline="always", **OPTIONS)
def _rates(l, p, psi, turn, d, r, lane, w):
    """Second and third derivative of e_y in a state, with the lane's yaw rate r and its slope."""
    steer = w[(R_Q + 3) * L + l] * d
    a = w[R_Q * L + l] * p + w[(R_Q + 1) * L + l] * psi + w[(R_Q + 2) * L + l] * turn + steer + w[R_E * L + l] * r
    yaw = w[R_W * L + l] * p + w[(R_W + 1) * L + l] * psi + w[(R_W + 2) * L + l] * turn
    yaw += w[(R_W + 3) * L + l] * d + w[(R_W + 4) * L + l] * r
    return a, w[R_Q * L + l] * a + w[(R_Q + 1) * L + l] * turn + w[(R_Q + 2) * L + l] * yaw + w[R_E * L + l] * lane


@numba.njit(**OPTIONS)
def drive_alone(scene, setting, state, paths, i, l, k, w, work):
    """Step k of one lane through `sample.drive`; False if it diverged."""
    for n in range(4):
        state[i, X + n] = w[(R_X + n) * L + l]
    for n in range(SCORES):
        state[i, SCORE + n] = w[(R_S + n) * L + l]
    state[i, WHEEL] = w[R_U * L + l]
    d = w[R_D * L + l]
    whole = drive(scene, setting, state, paths, i, k, d, d, work)
    for n in range(4):
        w[(R_N + n) * L + l] = state[i, X + n]
    for n in range(SCORES):
        w[(R_S + n) * L + l] = state[i, SCORE + n]
    w[R_RIGHT * L + l], w[R_LEFT * L + l] = work[W_LIMITS], work[W_LIMITS + 1]
    return whole


@numba.njit(inline="always", **OPTIONS)
def past_of_last(scene, setting, i, l, k, ring, w):
    """What a_y was a window before the end of a last step that is not whole; as `sample.before_end`."""
    h, _ = length(scene, setting, i, k)
    size, share_of_step = int(setting[RING]), h / setting[DT] if h < setting[DT] else 1.0
    past = k + share_of_step - setting[WINDOW]
    start, end, share = w[R_RIGHT * L + l], w[R_LEFT * L + l], (past - k) / share_of_step
    if past <= k:
        j, share = past_sample(past, True)
        if j < 0:
            w[R_PAST_LEFT * L + l] = w[R_BEFORE * L + l]
            return
        start, end = ring[(j & (size - 1)) * L + l], ring[(size + ((j + 1) & (size - 1))) * L + l]
        if share == 0.0:
            start = ring[(size + (j & (size - 1))) * L + l]
    w[R_PAST_LEFT * L + l] = start + share * (end - start)
