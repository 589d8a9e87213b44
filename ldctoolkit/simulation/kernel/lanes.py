"""Linear laws on the ideal plant: eight scenarios side by side, in the lanes of the processor's vector registers.

Neighbours in the takeover's order last about equally long. Each whole step is a product with the exactly discretised
plant, the same arithmetic in every lane, so that a scenario's numbers do not depend on its neighbours. What happens
rarely (e_y or its slope changes sign, the edge comes back inside, a last or a shared step, a command that is not
finite) is left to `sample.drive`, one scenario at a time.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba

from ldctoolkit.simulation.kernel.data import (
    A_11,
    A_12,
    A_13,
    A_BEFORE,
    A_Y,
    AREA,
    AXLE,
    B_1,
    BACK,
    BOUND,
    C_0,
    DC,
    DEEP,
    DELTA,
    DELTA_0,
    DT,
    E_1,
    EFFORT,
    EX_B,
    EX_DELTA,
    EX_E_0,
    EX_E_1,
    EX_R_0,
    EX_R_1,
    EX_X,
    EXACT,
    FRONT,
    FULL,
    JERK,
    LAW,
    LAW_F,
    LAW_U,
    OFFSET,
    OVER,
    RATE,
    SCORE,
    SCORES,
    SPEED,
    START,
    STEPS,
    T_END,
    TRAVEL,
    W_AFTER,
    W_LIMITS,
    WHEEL,
    WINDOW,
    X,
    X_0,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, move, substeps
from ldctoolkit.simulation.kernel.sample import before_end, drive, hermite_peak, length, rings, time_at

LANES: Final = 8
L: Final = LANES

# rows of the lane table, each L wide: state, command, next state, scores ...
_X = 0
_U = 4  # last command
_D = 5  # command
_N = 6  # next state
_RIGHT = 10
_LEFT = 11
_SIGNED = 12
_S = 13  # scores
_COUNTED = _S + SCORES  # 1 before T
_ALIVE = _COUNTED + 1
_R0 = _ALIVE + 1
_R1 = _R0 + 1
_FLAG = _R1 + 1  # 1 where a step needs a closer look
_PAST_RIGHT = _FLAG + 1
_PAST_LEFT = _PAST_RIGHT + 1
# ... and the scenario
_T = _PAST_LEFT + 1
_PER_T = _T + 1  # 1/T
_START = _PER_T + 1
_C0 = _START + 1  # v c_0
_DC = _C0 + 1  # v dc
_BEFORE = _DC + 1
_P = _BEFORE + 1  # the exact step: A[:, 1:4] row by row, and the rest
_B = _P + EX_B
_E0 = _P + EX_E_0
_E1 = _P + EX_E_1
_AX = _P + EX_X
_AD = _P + EX_DELTA
_AR0 = _P + EX_R_0
_AR1 = _P + EX_R_1
_Q = _P + EXACT  # row of a_y: 3 states, delta, yaw rate
_STIFF = _Q + 5  # 1 where the fastest mode dies within a step
_F = _STIFF + 1
_FU = _F + 4
ROWS: Final = _FU + 1


@numba.njit(**OPTIONS)
def _load(scene, setting, exact, block, w):
    """Scenario data of a block; lanes beyond the last scenario repeat it and are never alive."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        v = scene[i, SPEED]
        w[_T * L + l] = scene[i, T_END]
        w[_PER_T * L + l] = 1.0 / scene[i, T_END]
        w[_START * L + l] = scene[i, START]
        w[_BEFORE * L + l] = scene[i, A_BEFORE]
        for n in range(EXACT):
            w[(_P + n) * L + l] = exact[i, n]
        w[(_Q + 0) * L + l] = scene[i, A_11]
        w[(_Q + 1) * L + l] = scene[i, A_12]
        w[(_Q + 2) * L + l] = scene[i, A_13]
        w[(_Q + 3) * L + l] = scene[i, B_1]
        w[(_Q + 4) * L + l] = scene[i, E_1] + v
        w[_STIFF * L + l] = 1.0 if substeps(scene, setting, i, scene[i, START], setting[DT], 0.0) > 1 else 0.0


@numba.njit(**OPTIONS)
def _begin(scene, setting, law, times, design, block, w, g):
    """Start state and law of a block."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        alive = block * L + l < m and scene[i, STEPS] > 0.0
        v = scene[i, SPEED] if alive else 0.0
        w[_C0 * L + l], w[_DC * L + l] = v * scene[i, C_0], v * scene[i, DC]
        start = scene[i, START] * w[_PER_T * L + l]
        w[_R1 * L + l] = w[_C0 * L + l] + w[_DC * L + l] * min(start, 1.0)
        for n in range(4):
            w[(_X + n) * L + l] = scene[i, X_0 + n] if alive else 0.0
            w[(_F + n) * L + l] = law[design, i, LAW_F + n] if alive else 0.0
        w[_U * L + l] = scene[i, DELTA_0] if alive else 0.0
        w[_FU * L + l] = law[design, i, LAW_U] if alive else 0.0
        for j in range(2 * times.shape[1]):
            g[j * L + l] = law[design, i, LAW + j] if alive else 0.0
        for n in range(SCORES):
            w[(_S + n) * L + l] = 0.0
        w[(_S + DEEP) * L + l] = scene[i, X_0]
        w[(_S + FRONT) * L + l] = scene[i, X_0] + setting[AXLE] * scene[i, X_0 + 2]
        w[(_S + BACK) * L + l] = math.inf if alive else 0.0
        w[(_S + OVER) * L + l] = -scene[i, X_0]
        w[_ALIVE * L + l] = 1.0 if alive else 0.0
        w[_COUNTED * L + l] = 0.0


@numba.njit(**OPTIONS)
def _command(setting, times, design, k, w, g, width):
    """Command of every lane at sample k; True if one is not finite."""
    t_k = k * setting[DT]
    for l in range(width):
        d = w[_FU * L + l] * w[_U * L + l]
        d += w[_F * L + l] * w[_X * L + l] + w[(_F + 1) * L + l] * w[(_X + 1) * L + l]
        d += w[(_F + 2) * L + l] * w[(_X + 2) * L + l] + w[(_F + 3) * L + l] * w[(_X + 3) * L + l]
        w[_D * L + l] = d
    for j in range(times.shape[1]):
        ahead = times[design, j]
        for l in range(width):
            T = w[_T * L + l]
            t_0 = w[_START * L + l] + t_k
            t_1 = t_0 + ahead
            in_0, in_1 = min(t_0, T), min(t_1, T)
            per_T = w[_PER_T * L + l]
            inside = 0.5 * (in_1 * in_1 - in_0 * in_0) * per_T
            turn = w[_C0 * L + l] * (t_1 - t_0) + w[_DC * L + l] * (inside + (t_1 - in_1) - (t_0 - in_0))
            rate = w[_C0 * L + l] + w[_DC * L + l] * (in_1 * per_T)
            w[_D * L + l] += g[(2 * j) * L + l] * rate + g[(2 * j + 1) * L + l] * turn
    wrong = False
    for l in range(width):
        wrong |= not abs(w[_D * L + l]) < math.inf
    return wrong


@numba.njit(**OPTIONS)
def _step(setting, k, w):
    """One whole step of every lane; True if something rare happens in one."""
    dt, offset, bound, l_f = setting[DT], setting[OFFSET], setting[BOUND], setting[AXLE]
    t_next, per_dt = (k + 1) * dt, 1.0 / dt
    rare = False
    for l in range(L):
        r_0 = w[_R1 * L + l]
        r_1 = w[_C0 * L + l] + w[_DC * L + l] * min((w[_START * L + l] + t_next) * w[_PER_T * L + l], 1.0)
        w[_R0 * L + l], w[_R1 * L + l] = r_0, r_1
        x_0, x_1, x_2, x_3 = w[_X * L + l], w[(_X + 1) * L + l], w[(_X + 2) * L + l], w[(_X + 3) * L + l]
        d = w[_D * L + l]
        # e_y feeds back into nothing: the first column of A is (1, 0, 0, 0)
        n_0 = x_0 + w[_P * L + l] * x_1 + w[(_P + 1) * L + l] * x_2 + w[(_P + 2) * L + l] * x_3
        n_1 = w[(_P + 3) * L + l] * x_1 + w[(_P + 4) * L + l] * x_2 + w[(_P + 5) * L + l] * x_3
        n_2 = w[(_P + 6) * L + l] * x_1 + w[(_P + 7) * L + l] * x_2 + w[(_P + 8) * L + l] * x_3
        n_3 = w[(_P + 9) * L + l] * x_1 + w[(_P + 10) * L + l] * x_2 + w[(_P + 11) * L + l] * x_3
        n_0 += w[_B * L + l] * d + w[_E0 * L + l] * r_0 + w[_E1 * L + l] * r_1
        n_1 += w[(_B + 1) * L + l] * d + w[(_E0 + 1) * L + l] * r_0 + w[(_E1 + 1) * L + l] * r_1
        n_2 += w[(_B + 2) * L + l] * d + w[(_E0 + 2) * L + l] * r_0 + w[(_E1 + 2) * L + l] * r_1
        n_3 += w[(_B + 3) * L + l] * d + w[(_E0 + 3) * L + l] * r_0 + w[(_E1 + 3) * L + l] * r_1
        area = w[_AX * L + l] * x_0 + w[(_AX + 1) * L + l] * x_1 + w[(_AX + 2) * L + l] * x_2
        area += w[(_AX + 3) * L + l] * x_3 + w[_AD * L + l] * d + w[_AR0 * L + l] * r_0 + w[_AR1 * L + l] * r_1
        q_1, q_2, q_3 = w[_Q * L + l], w[(_Q + 1) * L + l], w[(_Q + 2) * L + l]
        q_d, q_r = w[(_Q + 3) * L + l] * d, w[(_Q + 4) * L + l]
        w[_RIGHT * L + l] = q_1 * x_1 + q_2 * x_2 + q_3 * x_3 + q_d + q_r * r_0
        w[_LEFT * L + l] = q_1 * n_1 + q_2 * n_2 + q_3 * n_3 + q_d + q_r * r_1
        w[_N * L + l], w[(_N + 1) * L + l], w[(_N + 2) * L + l], w[(_N + 3) * L + l] = n_0, n_1, n_2, n_3
        w[_SIGNED * L + l] = area
        event = _event(
            x_0, x_1, x_1 + l_f * x_3, n_0, n_1, n_1 + l_f * n_3, l_f * x_2, l_f * n_2, dt, per_dt, offset, bound,
            w[_COUNTED * L + l] > 0.0, w[_STIFF * L + l] > 0.0,
            w[(_S + BACK) * L + l], w[(_S + DEEP) * L + l], w[(_S + FRONT) * L + l], w[(_S + OVER) * L + l],
        )  # fmt: skip
        w[_FLAG * L + l] = 1.0 if event else 0.0
        rare |= event
    return rare


@numba.njit(inline="always", **OPTIONS)
def _event(
    x_0, x_1, f_0, n_0, n_1, f_1, ahead_0, ahead_1, dt, per_dt, offset, bound, counted, stiff, back, deep, front, over
):  # fmt: skip
    """Whether a step holds anything but a smooth piece on one side of the lane's centre."""
    rise = (n_0 - x_0) * per_dt
    reach = dt * (abs(x_1 - rise) + abs(n_1 - rise))  # how far the path may be from the chord
    high, low = max(x_0, n_0), min(x_0, n_0)
    event = not abs(n_0) <= bound  # also true for NaN
    event |= (back == math.inf) & ((n_0 < offset) | (stiff & (low - reach < offset)))
    # an extreme between the samples that may be a new one
    event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (high + dt * (x_1 - n_1) > deep)
    event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (max(x_0 + ahead_0, n_0 + ahead_1) + dt * (f_0 - f_1) > front)
    event |= (x_1 < 0.0) & (n_1 > 0.0) & (dt * (n_1 - x_1) - low > max(over, offset))
    # a change of sign; or both ends on one side, but so close that the path between them may reach over
    close = min(abs(x_0), abs(n_0)) < reach
    return event | (counted & ((x_0 * n_0 < 0.0) | (close & (stiff | (x_1 * n_1 < 0.0)))))


@numba.njit(**OPTIONS)
def _extremes(setting, state, i, l, h, counted, w, work):
    """Depth and overshoot between the state and what it was moved to."""
    x_0, x_1, n_0, n_1 = state[i, X], state[i, X + 1], work[W_AFTER], work[W_AFTER + 1]
    if counted:
        l_f = setting[AXLE]
        g_0, f_0 = x_0 + l_f * state[i, X + 2], x_1 + l_f * state[i, X + 3]
        g_1, f_1 = n_0 + l_f * work[W_AFTER + 2], n_1 + l_f * work[W_AFTER + 3]
        w[(_S + DEEP) * L + l] = max(w[(_S + DEEP) * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        w[(_S + FRONT) * L + l] = max(w[(_S + FRONT) * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
    w[(_S + OVER) * L + l] = max(w[(_S + OVER) * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))


@numba.njit(**OPTIONS)
def _area(scene, setting, state, i, l, t, h, counted, w, work):
    """Integral of |e_y| between the state and what it was moved to; the time back inside on the way."""
    x_0, n_0, area, d = state[i, X], work[W_AFTER], work[W_AFTER + 4], w[_D * L + l]
    if w[(_S + BACK) * L + l] == math.inf and x_0 >= setting[OFFSET] > n_0:
        s, _ = time_at(scene, setting, i, state, t, h, setting[OFFSET], d, 0.0, 0.0, 0.0, work)
        w[(_S + BACK) * L + l] = t + s
    if counted and x_0 * n_0 < 0.0:
        _, before = time_at(scene, setting, i, state, t, h, 0.0, d, 0.0, 0.0, 0.0, work)
        return abs(before) + abs(area - before)
    return abs(area)


@numba.njit(**OPTIONS)
def _look_closer(scene, setting, state, i, l, k, w, work):
    """What happens between the ends of a whole step; False if that takes `sample.drive`."""
    x_0, n_0, h, counted = w[_X * L + l], w[_N * L + l], setting[DT], w[_COUNTED * L + l] > 0.0
    if w[_STIFF * L + l] > 0.0 or not abs(n_0) <= setting[BOUND]:
        return False
    x_1, n_1 = w[(_X + 1) * L + l], w[(_N + 1) * L + l]
    if counted and x_0 * n_0 >= 0.0 and x_1 * n_1 < 0.0 and min(abs(x_0), abs(n_0)) < h * (abs(x_1) + abs(n_1)):
        return False
    for n in range(4):
        state[i, X + n] = w[(_X + n) * L + l]
        work[W_AFTER + n] = w[(_N + n) * L + l]
    work[W_AFTER + 4] = w[_SIGNED * L + l]
    w[_SIGNED * L + l] = _area(scene, setting, state, i, l, scene[i, START] + k * h, h, counted, w, work)
    _extremes(setting, state, i, l, h, counted, w, work)
    return True


@numba.njit(**OPTIONS)
def _cut(scene, setting, state, i, l, k, h, before_T, w, work):
    """A step that T cuts, or a last one that is not whole; False if that takes `sample.drive`."""
    if w[_STIFF * L + l] > 0.0:
        return False
    t, d = scene[i, START] + k * setting[DT], w[_D * L + l]
    area = 0.0
    for n in range(4):
        state[i, X + n] = w[(_X + n) * L + l]
    for piece in range(2):
        counted = piece == 0
        s, part = (0.0, before_T) if counted else (before_T, h - before_T)
        if part <= 0.0:
            continue
        move(scene, setting, i, state, t + s, part, d, 0.0, 0.0, 0.0, work, W_AFTER)
        n_0, n_1 = work[W_AFTER], work[W_AFTER + 1]
        x_0, x_1 = state[i, X], state[i, X + 1]
        touches = x_1 * n_1 < 0.0 and min(abs(x_0), abs(n_0)) < part * (abs(x_1) + abs(n_1))
        if not abs(n_0) <= setting[BOUND] or (counted and x_0 * n_0 >= 0.0 and touches):
            return False
        value = _area(scene, setting, state, i, l, t + s, part, counted, w, work)
        area += value if counted else 0.0
        _extremes(setting, state, i, l, part, counted, w, work)
        for n in range(4):
            state[i, X + n] = work[W_AFTER + n]
    change = abs(d - w[_U * L + l])
    w[(_S + AREA) * L + l] += area
    w[(_S + EFFORT) * L + l] += h * (d * d)
    w[(_S + TRAVEL) * L + l] += change
    for n in range(4):
        w[(_N + n) * L + l] = state[i, X + n]
    r = w[_C0 * L + l] + w[_DC * L + l] * min((t + h) * w[_PER_T * L + l], 1.0)
    q = w[_Q * L + l] * state[i, X + 1] + w[(_Q + 1) * L + l] * state[i, X + 2]
    q += w[(_Q + 2) * L + l] * state[i, X + 3]
    w[_LEFT * L + l] = q + w[(_Q + 3) * L + l] * d + w[(_Q + 4) * L + l] * r
    return True


@numba.njit(**OPTIONS)
def _alone(scene, setting, state, paths, i, l, k, w, work):
    """Step k of one lane through `sample.drive`; False if it diverged."""
    for n in range(4):
        state[i, X + n] = w[(_X + n) * L + l]
    for n in range(SCORES):
        state[i, SCORE + n] = w[(_S + n) * L + l]
    state[i, WHEEL] = w[_U * L + l]
    d = w[_D * L + l]
    whole = drive(scene, setting, state, paths, i, k, d, d, work)
    for n in range(4):
        w[(_N + n) * L + l] = state[i, X + n]
    for n in range(SCORES):
        w[(_S + n) * L + l] = state[i, SCORE + n]
    w[_RIGHT * L + l], w[_LEFT * L + l] = work[W_LIMITS], work[W_LIMITS + 1]
    return whole


@numba.njit(**OPTIONS)
def _past(setting, left, right, k, w):
    """Put both limits of a_y into their rings; what they were a window earlier, as `sample.earlier`."""
    size, width = left.shape
    here, there = right[k % size], left[(k + 1) % size]
    for l in range(width):
        here[l], there[l] = w[_RIGHT * L + l], w[_LEFT * L + l]
    position = k - setting[WINDOW]
    j = math.floor(position + 1e-9)
    part = position - j
    if position < -1e-9:
        for l in range(width):
            w[_PAST_RIGHT * L + l] = w[_BEFORE * L + l]
    else:
        start, end = right[j % size], left[(j + 1) % size]
        share = part if part > 1e-9 else 0.0
        for l in range(width):
            w[_PAST_RIGHT * L + l] = start[l] + share * (end[l] - start[l])
    # one sample later, just before it
    if position + 1.0 < -1e-9 or (part <= 1e-9 and j == -1):
        for l in range(width):
            w[_PAST_LEFT * L + l] = w[_BEFORE * L + l]
    else:
        start, end = right[(j + 1) % size], left[(j + 2) % size]
        if part <= 1e-9:
            start, end = left[(j + 1) % size], left[(j + 1) % size]
        share = part if part > 1e-9 else 0.0
        for l in range(width):
            w[_PAST_LEFT * L + l] = start[l] + share * (end[l] - start[l])


@numba.njit(**OPTIONS)
def _score(setting, w, single):
    """Scores of a step in every lane; `single` lanes have theirs but for acceleration, jerk and rate."""
    dt, l_f, per_window, per_step = setting[DT], setting[AXLE], 1.0 / (setting[WINDOW] * setting[DT]), 1.0 / setting[DT]
    for l in range(single.shape[0]):
        alone = single[l]
        n_0, d, u = w[_N * L + l], w[_D * L + l], w[_U * L + l]
        counted = w[_COUNTED * L + l] * (1.0 - alone)
        alive = w[_ALIVE * L + l] * (1.0 - alone)
        w[(_S + AREA) * L + l] += abs(w[_SIGNED * L + l]) * counted
        front = n_0 + l_f * w[(_N + 2) * L + l]
        w[(_S + DEEP) * L + l] = max(w[(_S + DEEP) * L + l], n_0 if counted > 0.0 else -math.inf)
        w[(_S + FRONT) * L + l] = max(w[(_S + FRONT) * L + l], front if counted > 0.0 else -math.inf)
        w[(_S + OVER) * L + l] = max(w[(_S + OVER) * L + l], -n_0 if alive > 0.0 else -math.inf)
        change = abs(d - u)
        w[(_S + EFFORT) * L + l] += alive * (dt * (d * d))
        w[(_S + TRAVEL) * L + l] += alive * change
        right, left = w[_RIGHT * L + l], w[_LEFT * L + l]
        jerk = max(abs(right - w[_PAST_RIGHT * L + l]), abs(left - w[_PAST_LEFT * L + l]))
        w[(_S + JERK) * L + l] = max(w[(_S + JERK) * L + l], jerk * per_window)
        w[(_S + A_Y) * L + l] = max(w[(_S + A_Y) * L + l], max(abs(right), abs(left)))
        w[(_S + DELTA) * L + l] = max(w[(_S + DELTA) * L + l], abs(d))
        w[(_S + RATE) * L + l] = max(w[(_S + RATE) * L + l], change * per_step)
        w[_U * L + l] = d
        w[_X * L + l], w[(_X + 1) * L + l] = n_0, w[(_N + 1) * L + l]
        w[(_X + 2) * L + l], w[(_X + 3) * L + l] = w[(_N + 2) * L + l], w[(_N + 3) * L + l]


@numba.njit(**OPTIONS)
def _leave(w, g, l, rows, out):
    """Take the scores of a lane that has ended and empty it: everything in it stays 0."""
    for n in range(SCORES):
        out[n] = w[(_S + n) * L + l]
    for n in range(4):
        w[(_X + n) * L + l] = w[(_F + n) * L + l] = w[(_N + n) * L + l] = 0.0
    for j in range(rows):
        g[j * L + l] = 0.0
    w[_U * L + l] = w[_D * L + l] = w[_FU * L + l] = w[_COUNTED * L + l] = w[_ALIVE * L + l] = 0.0
    w[_C0 * L + l] = w[_DC * L + l] = w[_R1 * L + l] = w[_RIGHT * L + l] = w[_LEFT * L + l] = 0.0
    w[(_S + BACK) * L + l] = 0.0


@numba.njit(**OPTIONS)
def _replace_wrong(w, failed, count):
    """Commands that are not finite become the ones before, and are counted."""
    for l in range(L):
        if not abs(w[_D * L + l]) < math.inf:
            w[_D * L + l] = w[_U * L + l]
            if l < count and w[_ALIVE * L + l] > 0.0:
                failed[l] += 1


@numba.njit(**OPTIONS)
def _past_of_last(scene, setting, state, i, l, k, left, right, w):
    """The same for a last step that is not whole."""
    _, _, at_left, at_right = rings(setting)
    for n in range(left.shape[0]):
        state[i, at_left + n], state[i, at_right + n] = left[n, l], right[n, l]
    before, a_right, a_left = scene[i, A_BEFORE], w[_RIGHT * L + l], w[_LEFT * L + l]
    h, _ = length(scene, setting, i, k)
    w[_PAST_LEFT * L + l] = before_end(setting, state, i, before, k, h, a_right, a_left)


@numba.njit(**OPTIONS)
def drive_block(scene, exact, setting, law, times, state, paths, block, score, diverged, failed, tables):
    """Every design of a law on one block of scenarios; scores into (d, m, SCORES)."""
    w, g, left, right, single, work = tables
    first, rows, size = block * L, 2 * times.shape[1], left.shape[0]
    count = min(L, scene.shape[0] - first)
    most = 0
    for l in range(count):
        most = max(most, int(scene[first + l, STEPS]))
    _load(scene, setting, exact, block, w)
    for design in range(law.shape[0]):
        _begin(scene, setting, law, times, design, block, w, g)
        for l in range(L):
            single[l] = 0.0
        next_cut = 0  # the first sample at which a lane passes its T or comes to its last step
        for k in range(most):
            if _command(setting, times, design, k, w, g, left.shape[1]):
                _replace_wrong(w, failed[design, first:], count)
            quiet = k < next_cut
            if not quiet:
                next_cut = most
                for l in range(count):
                    i = first + l
                    _, counted = length(scene, setting, i, k)
                    w[_COUNTED * L + l] = w[_ALIVE * L + l] if counted > 0.0 else 0.0
                    full, end = int(scene[i, FULL]), int(scene[i, STEPS]) - 1
                    if k < end:
                        next_cut = min(next_cut, full if k < full else (k + 1 if k == full else end))
            rare = _step(setting, k, w)
            if rare or not quiet:
                for l in range(count):
                    i = first + l
                    if w[_ALIVE * L + l] == 0.0 or (quiet and w[_FLAG * L + l] == 0.0):
                        continue
                    h, before_T = length(scene, setting, i, k)
                    if h < setting[DT] or 0.0 < before_T < h:
                        single[l] = 1.0
                        if _cut(scene, setting, state, i, l, k, h, before_T, w, work):
                            continue
                    elif w[_FLAG * L + l] == 0.0 or _look_closer(scene, setting, state, i, l, k, w, work):
                        continue
                    single[l] = 1.0
                    if not _alone(scene, setting, state, paths, i, l, k, w, work):
                        diverged[design, i] = True
                        _leave(w, g, l, rows, score[design, i])
            _past(setting, left, right, k, w)
            if not quiet:
                for l in range(count):
                    if single[l] * w[_ALIVE * L + l] > 0.0 and k + 1 == scene[first + l, STEPS]:
                        _past_of_last(scene, setting, state, first + l, l, k, left, right, w)
            _score(setting, w, single)
            if rare or not quiet:
                for l in range(count):
                    single[l] = 0.0
                    if w[_ALIVE * L + l] > 0.0 and k + 1 == scene[first + l, STEPS]:
                        _leave(w, g, l, rows, score[design, first + l])
