"""What happens in a lane now and then, one scenario at a time.

A change of sign of e_y, an extreme between two samples, the edge back inside; the steps that T cuts, and last ones that
are not whole.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

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
    RING,
    SCORE,
    SCORES,
    START,
    TRAVEL,
    W_AFTER,
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
    R_LEFT,
    R_N,
    R_PAST_LEFT,
    R_PER_T,
    R_Q,
    R_RIGHT,
    R_S,
    R_SIGNED,
    R_STIFF,
    R_U,
    R_X,
    L,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, move
from ldctoolkit.simulation.kernel.sample import drive, hermite_peak, length, past_sample, time_at, touches


@numba.njit(inline="always", **OPTIONS)
def _extremes(setting, state, i, l, h, counted, w, work):
    """Depth and overshoot between the state and what it was moved to."""
    x_0, x_1, n_0, n_1 = state[i, X], state[i, X + 1], work[W_AFTER], work[W_AFTER + 1]
    if counted:
        l_f = setting[AXLE]
        g_0, f_0 = x_0 + l_f * state[i, X + 2], x_1 + l_f * state[i, X + 3]
        g_1, f_1 = n_0 + l_f * work[W_AFTER + 2], n_1 + l_f * work[W_AFTER + 3]
        w[(R_S + DEEP) * L + l] = max(w[(R_S + DEEP) * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        w[(R_S + FRONT) * L + l] = max(w[(R_S + FRONT) * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
    w[(R_S + OVER) * L + l] = max(w[(R_S + OVER) * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))


@numba.njit(inline="always", **OPTIONS)
def _area(scene, setting, state, i, l, t, h, counted, w, work):
    """Integral of |e_y| between the state and what it was moved to; the time back inside on the way."""
    x_0, n_0, area, d = state[i, X], work[W_AFTER], work[W_AFTER + 4], w[R_D * L + l]
    if w[(R_S + BACK) * L + l] == math.inf and x_0 >= setting[OFFSET] > n_0:
        s, _ = time_at(scene, setting, i, state, t, h, setting[OFFSET], d, 0.0, 0.0, 0.0, work)
        w[(R_S + BACK) * L + l] = t + s
    if counted and x_0 * n_0 < 0.0:
        _, before = time_at(scene, setting, i, state, t, h, 0.0, d, 0.0, 0.0, 0.0, work)
        return abs(before) + abs(area - before)
    return abs(area)


@numba.njit(inline="always", **OPTIONS)
def look_closer(scene, setting, state, i, l, k, w, work):
    """What happens between the ends of a whole step; False if that takes `sample.drive`."""
    x_0, n_0, h, counted = w[R_X * L + l], w[R_N * L + l], setting[DT], w[R_COUNTED * L + l] > 0.0
    if w[R_STIFF * L + l] > 0.0 or not abs(n_0) <= setting[BOUND]:
        return False
    x_1, n_1 = w[(R_X + 1) * L + l], w[(R_N + 1) * L + l]
    if counted and touches(x_0, x_1, n_0, n_1, h):
        return False
    back = w[(R_S + BACK) * L + l] == math.inf and x_0 >= setting[OFFSET] > n_0
    if back or (counted and x_0 * n_0 < 0.0):
        for n in range(4):
            state[i, X + n] = w[(R_X + n) * L + l]
            work[W_AFTER + n] = w[(R_N + n) * L + l]
        work[W_AFTER + 4] = w[R_SIGNED * L + l]
        w[R_SIGNED * L + l] = _area(scene, setting, state, i, l, scene[i, START] + k * h, h, counted, w, work)
    f_0, f_1 = x_1 + setting[AXLE] * w[(R_X + 3) * L + l], n_1 + setting[AXLE] * w[(R_N + 3) * L + l]
    if counted and x_1 > 0.0 > n_1:
        w[(R_S + DEEP) * L + l] = max(w[(R_S + DEEP) * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
    if counted and f_0 > 0.0 > f_1:
        g_0, g_1 = x_0 + setting[AXLE] * w[(R_X + 2) * L + l], n_0 + setting[AXLE] * w[(R_N + 2) * L + l]
        w[(R_S + FRONT) * L + l] = max(w[(R_S + FRONT) * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
    if x_1 < 0.0 < n_1:
        w[(R_S + OVER) * L + l] = max(w[(R_S + OVER) * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))
    return True


@numba.njit(**OPTIONS)
def drive_cut(scene, setting, state, i, l, k, h, before_T, w, work):
    """A step that T cuts, or a last one that is not whole; False if that takes `sample.drive`."""
    if w[R_STIFF * L + l] > 0.0:
        return False
    t, d = scene[i, START] + k * setting[DT], w[R_D * L + l]
    area = 0.0
    for n in range(4):
        state[i, X + n] = w[(R_X + n) * L + l]
    for piece in range(2):
        counted = piece == 0
        s, part = (0.0, before_T) if counted else (before_T, h - before_T)
        if part <= 0.0:
            continue
        move(scene, setting, i, state, t + s, part, d, 0.0, 0.0, 0.0, work, W_AFTER)
        n_0, n_1 = work[W_AFTER], work[W_AFTER + 1]
        x_0, x_1 = state[i, X], state[i, X + 1]
        if not abs(n_0) <= setting[BOUND] or (counted and touches(x_0, x_1, n_0, n_1, part)):
            return False
        value = _area(scene, setting, state, i, l, t + s, part, counted, w, work)
        area += value if counted else 0.0
        _extremes(setting, state, i, l, part, counted, w, work)
        for n in range(4):
            state[i, X + n] = work[W_AFTER + n]
    change = abs(d - w[R_U * L + l])
    w[(R_S + AREA) * L + l] += area
    w[(R_S + EFFORT) * L + l] += h * (d * d)
    w[(R_S + TRAVEL) * L + l] += change
    for n in range(4):
        w[(R_N + n) * L + l] = state[i, X + n]
    r = w[R_C0 * L + l] + w[R_DC * L + l] * min((t + h) * w[R_PER_T * L + l], 1.0)
    q = w[R_Q * L + l] * state[i, X + 1] + w[(R_Q + 1) * L + l] * state[i, X + 2]
    q += w[(R_Q + 2) * L + l] * state[i, X + 3]
    w[R_LEFT * L + l] = q + w[(R_Q + 3) * L + l] * d + w[(R_Q + 4) * L + l] * r
    return True


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
