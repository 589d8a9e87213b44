"""What happens in a lane of the ideal plant now and then, one scenario at a time.

A change of sign of e_y, an extreme between two samples, the edge back inside; steps that T cuts, and last ones that are
not whole, which are driven with their own exact matrices.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.between import absolute_area, hermite_peak, quartic_root, touches
from ldctoolkit.simulation.kernel.data import (
    AREA,
    AXLE,
    BACK,
    BOUND,
    DEEP,
    DELTA,
    DT,
    EFFORT,
    FRONT,
    OFFSET,
    OVER,
    TRAVEL,
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
    R_START,
    R_T,
    R_U,
    R_X,
    L,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, length_of

_SAME = 1e-9
"""Parts of a sample that are rounding."""


@numba.njit(inline="always", **OPTIONS)
def past_sample(position, from_left):
    """Sample at or before a past position, and the share of the step from it; -1 for before the first."""
    j = math.floor(position + _SAME)
    share = position - j
    if share <= _SAME:
        share = 0.0
        if from_left and j == 0:
            j = -1
    return max(j, -1), share


@numba.njit(**OPTIONS)
def _piece(setting, w, l, t, h, x_0, f_0, x_1, f_1, area, counted, full):
    """Integral of |e_y| over a smooth piece with depth and front (value, slope) at its ends; what it adds to scores."""
    if full and w[(R_S + BACK) * L + l] == math.inf and x_0[0] >= setting[OFFSET] > x_1[0]:
        level = setting[OFFSET]
        u = quartic_root(x_0[0] - level, h * x_0[1], x_1[0] - level, h * x_1[1], area / h - level)
        w[(R_S + BACK) * L + l] = t + h * u
    if full and counted:
        deep, front = hermite_peak(x_0[0], x_0[1], x_1[0], x_1[1], h), hermite_peak(f_0[0], f_0[1], f_1[0], f_1[1], h)
        w[(R_S + DEEP) * L + l] = max(w[(R_S + DEEP) * L + l], deep)
        w[(R_S + FRONT) * L + l] = max(w[(R_S + FRONT) * L + l], front)
    if full:
        over = hermite_peak(-x_0[0], -x_0[1], -x_1[0], -x_1[1], h)
        w[(R_S + OVER) * L + l] = max(w[(R_S + OVER) * L + l], over)
    if x_0[0] * x_1[0] < 0.0 or touches(x_0[0], x_0[1], x_1[0], x_1[1], h):
        return absolute_area(x_0[0], x_0[1], x_1[0], x_1[1], area, h)
    return abs(area)


@numba.njit(**OPTIONS)
def _edges(setting, w, l, row):
    """Depth and front of a state in the table, (value, slope) each."""
    y, p, psi, turn = w[row * L + l], w[(row + 1) * L + l], w[(row + 2) * L + l], w[(row + 3) * L + l]
    l_f = setting[AXLE]
    return (y, p), (y + l_f * psi, p + l_f * turn)


@numba.njit(**OPTIONS)
def diverge(setting, w, l, t, counted):
    """Score the bound from the start t of the piece that left it; `R_N` is where it led."""
    inwards = w[R_N * L + l] < 0.0
    if counted:
        w[(R_S + AREA) * L + l] += setting[BOUND] * (w[R_T * L + l] - t)
        if not inwards:
            w[(R_S + DEEP) * L + l] = w[(R_S + FRONT) * L + l] = setting[BOUND]
    if inwards:
        w[(R_S + OVER) * L + l] = setting[BOUND]


@numba.njit(**OPTIONS)
def look_closer(setting, w, l, k, full):
    """What happens between the ends of a whole step; False if it diverged."""
    t, counted = w[R_START * L + l] + k * setting[DT], w[R_COUNTED * L + l] > 0.0
    if not abs(w[R_N * L + l]) <= setting[BOUND]:  # also true for NaN
        diverge(setting, w, l, t, counted)
        return False
    x_0, f_0 = _edges(setting, w, l, R_X)
    x_1, f_1 = _edges(setting, w, l, R_N)
    w[R_SIGNED * L + l] = _piece(setting, w, l, t, setting[DT], x_0, f_0, x_1, f_1, w[R_SIGNED * L + l], counted, full)
    return True


@numba.njit(**OPTIONS)
def _lane_rate(w, l, t):
    return w[R_C0 * L + l] + w[R_DC * L + l] * min(t * w[R_PER_T * L + l], 1.0)


@numba.njit(**OPTIONS)
def cut(scene, exact, setting, w, i, l, k, full):
    """Step k of a lane in which it is cut by T or shorter than dt, with its scores; False if it diverged."""
    h, until = length_of(scene, setting, i, k)
    rest, d, t = scene[i, data.REST], w[R_D * L + l], w[R_START * L + l] + k * setting[DT]
    for part in range(1, 2 if h == rest else 3):
        span, counted = (rest, until > 0.0) if part == 1 else (h - rest, False)
        row = R_X if part == 1 else R_N
        x_0, f_0 = _edges(setting, w, l, row)
        psi, turn = w[(row + 2) * L + l], w[(row + 3) * L + l]
        r_0, r_1 = _lane_rate(w, l, t), _lane_rate(w, l, t + span)
        for n in range(4):
            value = exact[part, i, 3 * n] * x_0[1] + exact[part, i, 3 * n + 1] * psi + exact[part, i, 3 * n + 2] * turn
            value += exact[part, i, data.EX_B + n] * d + exact[part, i, data.EX_E_0 + n] * r_0
            value += exact[part, i, data.EX_E_1 + n] * r_1
            w[(R_N + n) * L + l] = value + (x_0[0] if n == 0 else 0.0)
        area = exact[part, i, data.EX_X] * x_0[0] + exact[part, i, data.EX_X + 1] * x_0[1]
        area += exact[part, i, data.EX_X + 2] * psi + exact[part, i, data.EX_X + 3] * turn
        area += (
            exact[part, i, data.EX_DELTA] * d + exact[part, i, data.EX_R_0] * r_0 + exact[part, i, data.EX_R_1] * r_1
        )
        if not abs(w[R_N * L + l]) <= setting[BOUND]:
            diverge(setting, w, l, t, counted)
            return False
        x_1, f_1 = _edges(setting, w, l, R_N)
        total = _piece(setting, w, l, t, span, x_0, f_0, x_1, f_1, area, counted, full)
        if counted:
            w[(R_S + AREA) * L + l] += total
        if full:
            w[(R_S + EFFORT) * L + l] += span * (d * d)
            w[(R_S + DELTA) * L + l] = max(w[(R_S + DELTA) * L + l], abs(d))
            w[(R_S + TRAVEL) * L + l] += abs(d - w[R_U * L + l]) if part == 1 else 0.0
        t += span
    if full:
        a_y = w[R_Q * L + l] * w[(R_N + 1) * L + l] + w[(R_Q + 1) * L + l] * w[(R_N + 2) * L + l]
        a_y += w[(R_Q + 2) * L + l] * w[(R_N + 3) * L + l] + w[(R_Q + 3) * L + l] * d
        w[R_LEFT * L + l] = a_y + w[(R_Q + 4) * L + l] * _lane_rate(w, l, t)
    return True


@numba.njit(inline="always", **OPTIONS)
def past_of_last(scene, setting, i, l, k, ring, w):
    """What a_y was a window before the end of a last step that is not whole."""
    h, _ = length_of(scene, setting, i, k)
    size, share_of_step = int(setting[data.RING]), h / setting[DT] if h < setting[DT] else 1.0
    past = k + share_of_step - setting[data.WINDOW]
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
