"""Linear laws on the ideal plant: eight scenarios side by side, in the lanes of the processor's vector registers.

Neighbours in the takeover's order last about equally long. Each whole step is a product with the exactly discretised
plant, the same arithmetic in every lane, so that a scenario's numbers do not depend on its neighbours. What happens
rarely is left to `lane_events`.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.between import touches
from ldctoolkit.simulation.kernel.fused import fma
from ldctoolkit.simulation.kernel.lane_events import cut, look_closer, past_of_last, past_sample
from ldctoolkit.simulation.kernel.lane_table import (
    R_AD,
    R_ALIVE,
    R_AR0,
    R_AR1,
    R_AX,
    R_B,
    R_BEFORE,
    R_C0,
    R_COUNTED,
    R_D,
    R_DC,
    R_E0,
    R_E1,
    R_F,
    R_FI,
    R_FLAG,
    R_FU,
    R_GH,
    R_GR,
    R_LEFT,
    R_N,
    R_P,
    R_PAST_LEFT,
    R_PAST_RIGHT,
    R_PER_T,
    R_Q,
    R_R1,
    R_RIGHT,
    R_S,
    R_SIGNED,
    R_SINGLE,
    R_START,
    R_T,
    R_U,
    R_X,
    R_Z,
    WRONG,
    L,
    begin,
    leave,
    load,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, length_of


@numba.njit(**OPTIONS)
def _look_ahead(setting, times, design, k, w, g, width):
    """What a law with several lookahead times, or none, makes of the lane ahead."""
    t_k = k * setting[data.DT]
    for l in range(width):
        w[R_D * L + l] = 0.0
    for j in range(times.shape[1]):
        ahead = times[design, j]
        for l in range(width):
            rate, turn = _lane(w[R_T * L + l], w[R_PER_T * L + l], w[R_START * L + l] + t_k, ahead)
            weight_rate, weight_turn = g[(2 * j) * L + l], g[(2 * j + 1) * L + l]
            c_0, dc = w[R_C0 * L + l], w[R_DC * L + l]
            d = fma(weight_rate, fma(dc, rate, c_0), w[R_D * L + l])
            w[R_D * L + l] = fma(weight_turn, fma(dc, turn, c_0 * ahead), d)


@numba.njit(inline="always", **OPTIONS)
def _lane(T, per_T, t, ahead):
    """Shares of v dc in the lane's yaw rate at t + ahead, and in its turn until then."""
    t_1 = t + ahead
    in_0, in_1 = min(t, T), min(t_1, T)
    within = 0.5 * (in_1 - in_0) * (in_1 + in_0)
    return in_1 * per_T, fma(within, per_T, (t_1 - in_1) - (t - in_0))


@numba.njit(inline="always", **OPTIONS)
def _three(a, x, b, y, c, z):
    """Sum of three products."""
    return fma(a, x, fma(b, y, c * z))


@numba.njit(inline="always", **OPTIONS)
def _step(setting, k, ahead, w, full):
    """Command and one whole step of every lane; True if something rare happens in one."""
    dt, offset, bound, l_f = setting[data.DT], setting[data.OFFSET], setting[data.BOUND], setting[data.AXLE]
    t_k, t_next = k * dt, (k + 1) * dt
    rare = False
    for l in range(L):
        r_0 = w[R_R1 * L + l]
        c_0, dc = w[R_C0 * L + l], w[R_DC * L + l]
        r_1 = fma(dc, min((w[R_START * L + l] + t_next) * w[R_PER_T * L + l], 1.0), c_0)
        w[R_R1 * L + l] = r_1
        x_0, x_1, x_2, x_3 = w[R_X * L + l], w[(R_X + 1) * L + l], w[(R_X + 2) * L + l], w[(R_X + 3) * L + l]
        u = w[R_U * L + l]
        rate, turn = _lane(w[R_T * L + l], w[R_PER_T * L + l], w[R_START * L + l] + t_k, ahead)
        d = fma(w[R_GR * L + l], fma(dc, rate, c_0), w[R_D * L + l])
        d = fma(w[R_GH * L + l], fma(dc, turn, c_0 * ahead), d)
        d = fma(w[R_FI * L + l], w[R_Z * L + l], fma(w[R_FU * L + l], u, d))
        d += fma(
            w[R_F * L + l], x_0, _three(w[(R_F + 1) * L + l], x_1, w[(R_F + 2) * L + l], x_2, w[(R_F + 3) * L + l], x_3)
        )
        w[R_Z * L + l] = fma(dt, x_0, w[R_Z * L + l])
        wrong = not abs(d) < math.inf
        d = u if wrong else d
        w[R_D * L + l] = d
        # e_y feeds back into nothing: the first column of A is (1, 0, 0, 0)
        n_0 = fma(w[R_P * L + l], x_1, fma(w[(R_P + 1) * L + l], x_2, fma(w[(R_P + 2) * L + l], x_3, x_0)))
        n_1 = _three(w[(R_P + 3) * L + l], x_1, w[(R_P + 4) * L + l], x_2, w[(R_P + 5) * L + l], x_3)
        n_2 = _three(w[(R_P + 6) * L + l], x_1, w[(R_P + 7) * L + l], x_2, w[(R_P + 8) * L + l], x_3)
        n_3 = _three(w[(R_P + 9) * L + l], x_1, w[(R_P + 10) * L + l], x_2, w[(R_P + 11) * L + l], x_3)
        n_0 = fma(w[R_B * L + l], d, fma(w[R_E0 * L + l], r_0, fma(w[R_E1 * L + l], r_1, n_0)))
        n_1 = fma(w[(R_B + 1) * L + l], d, fma(w[(R_E0 + 1) * L + l], r_0, fma(w[(R_E1 + 1) * L + l], r_1, n_1)))
        n_2 = fma(w[(R_B + 2) * L + l], d, fma(w[(R_E0 + 2) * L + l], r_0, fma(w[(R_E1 + 2) * L + l], r_1, n_2)))
        n_3 = fma(w[(R_B + 3) * L + l], d, fma(w[(R_E0 + 3) * L + l], r_0, fma(w[(R_E1 + 3) * L + l], r_1, n_3)))
        area = _three(w[R_AX * L + l], x_0, w[(R_AX + 1) * L + l], x_1, w[(R_AX + 2) * L + l], x_2)
        area = fma(w[(R_AX + 3) * L + l], x_3, fma(w[R_AR0 * L + l], r_0, fma(w[R_AR1 * L + l], r_1, area)))
        area = fma(w[R_AD * L + l], d, area)
        back, deep, front, over = 0.0, math.inf, math.inf, math.inf
        if full:
            q_1, q_2, q_3 = w[R_Q * L + l], w[(R_Q + 1) * L + l], w[(R_Q + 2) * L + l]
            q_d, q_r = w[(R_Q + 3) * L + l] * d, w[(R_Q + 4) * L + l]
            w[R_RIGHT * L + l] = fma(q_r, r_0, _three(q_1, x_1, q_2, x_2, q_3, x_3) + q_d)
            w[R_LEFT * L + l] = fma(q_r, r_1, _three(q_1, n_1, q_2, n_2, q_3, n_3) + q_d)
            back, deep = w[(R_S + data.BACK) * L + l], w[(R_S + data.DEEP) * L + l]
            front, over = w[(R_S + data.FRONT) * L + l], w[(R_S + data.OVER) * L + l]
        w[R_N * L + l], w[(R_N + 1) * L + l], w[(R_N + 2) * L + l], w[(R_N + 3) * L + l] = n_0, n_1, n_2, n_3
        w[R_SIGNED * L + l] = area
        event = _event(
            x_0, x_1, fma(l_f, x_3, x_1), n_0, n_1, fma(l_f, n_3, n_1), l_f * x_2, l_f * n_2, dt, offset, bound,
            w[R_COUNTED * L + l] > 0.0, back, deep, front, over,
        )  # fmt: skip
        w[R_FLAG * L + l] = WRONG if wrong else (1.0 if event else 0.0)
        rare |= event | wrong
    return rare


@numba.njit(**OPTIONS)
def _light_step(setting, k, ahead, w):
    """The same for S alone."""
    return _step(setting, k, ahead, w, False)


@numba.njit(**OPTIONS)
def _light_score(w):
    """S of a step in every lane."""
    for l in range(L):
        counted = w[R_COUNTED * L + l] * (1.0 - w[R_SINGLE * L + l])
        w[(R_S + data.AREA) * L + l] = fma(abs(w[R_SIGNED * L + l]), counted, w[(R_S + data.AREA) * L + l])
        w[R_U * L + l], w[R_D * L + l] = w[R_D * L + l], 0.0
        w[R_X * L + l], w[(R_X + 1) * L + l] = w[R_N * L + l], w[(R_N + 1) * L + l]
        w[(R_X + 2) * L + l], w[(R_X + 3) * L + l] = w[(R_N + 2) * L + l], w[(R_N + 3) * L + l]


@numba.njit(inline="always", **OPTIONS)
def _event(
    x_0, x_1, f_0, n_0, n_1, f_1, ahead_0, ahead_1, dt, offset, bound, counted, back, deep, front, over
):  # fmt: skip
    """Whether a step holds anything but a smooth piece on one side of the lane's centre."""
    high, low = max(x_0, n_0), min(x_0, n_0)
    event = not abs(n_0) <= bound  # also true for NaN
    event |= (back == math.inf) & (n_0 < offset)
    # an extreme between the samples that may be a new one
    event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (fma(dt, x_1 - n_1, high) > deep)
    event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (fma(dt, f_0 - f_1, max(x_0 + ahead_0, n_0 + ahead_1)) > front)
    event |= (x_1 < 0.0) & (n_1 > 0.0) & (fma(dt, n_1 - x_1, -low) > max(over, offset))
    return event | (counted & ((x_0 * n_0 < 0.0) | touches(x_0, x_1, n_0, n_1, dt)))


@numba.njit(inline="always", **OPTIONS)
def _past(j, share, size, from_left):
    """Ring rows of the start and the end of the step from sample j on; the last row is the time before the trigger.

    Rows are those of the right limits, then those of the left ones.
    """
    mask = size - 1
    if j < 0 or (from_left and share == 0.0 and j == 0):
        return 2 * size, 2 * size
    if share == 0.0:
        row = size + (j & mask) if from_left else j & mask
        return row, row
    return j & mask, size + ((j + 1) & mask)


@numba.njit(inline="always", **OPTIONS)
def _row(table, row):
    """A row of lanes, read before anything is written: only then are the lanes moved together."""
    at = row * L
    return (
        table[at], table[at + 1], table[at + 2], table[at + 3],
        table[at + 4], table[at + 5], table[at + 6], table[at + 7],
    )  # fmt: skip


@numba.njit(inline="always", **OPTIONS)
def _put(table, row, values):
    """Write a row of lanes."""
    at = row * L
    table[at], table[at + 1], table[at + 2], table[at + 3] = values[0], values[1], values[2], values[3]
    table[at + 4], table[at + 5], table[at + 6], table[at + 7] = values[4], values[5], values[6], values[7]


@numba.njit(inline="always", **OPTIONS)
def _keep(ring, right, left, w):
    """Put both limits of a_y into their rows of the ring."""
    _put(ring, right, _row(w, R_RIGHT))
    _put(ring, left, _row(w, R_LEFT))


@numba.njit(inline="always", **OPTIONS)
def _compare(ring, start, end, share, w, row):
    """What a limit of a_y was a window earlier."""
    a = _row(ring, start)
    if share > 0.0:
        b = _row(ring, end)
        a = (
            a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2]),
            a[3] + share * (b[3] - a[3]), a[4] + share * (b[4] - a[4]), a[5] + share * (b[5] - a[5]),
            a[6] + share * (b[6] - a[6]), a[7] + share * (b[7] - a[7]),
        )  # fmt: skip
    _put(w, row, a)


@numba.njit(inline="always", **OPTIONS)
def _score(setting, w):
    """Scores of a step in every lane; `single` lanes have theirs but for acceleration, jerk and rate."""
    dt, l_f = setting[data.DT], setting[data.AXLE]
    per_window, per_step = 1.0 / (setting[data.WINDOW] * dt), 1.0 / dt
    for l in range(L):
        together = 1.0 - w[R_SINGLE * L + l]
        n_0, n_2, d, u = w[R_N * L + l], w[(R_N + 2) * L + l], w[R_D * L + l], w[R_U * L + l]
        counted = w[R_COUNTED * L + l] * together
        alive = w[R_ALIVE * L + l] * together
        w[(R_S + data.AREA) * L + l] = fma(abs(w[R_SIGNED * L + l]), counted, w[(R_S + data.AREA) * L + l])
        front = fma(l_f, n_2, n_0)
        w[(R_S + data.DEEP) * L + l] = max(w[(R_S + data.DEEP) * L + l], n_0 if counted > 0.0 else -math.inf)
        w[(R_S + data.FRONT) * L + l] = max(w[(R_S + data.FRONT) * L + l], front if counted > 0.0 else -math.inf)
        w[(R_S + data.OVER) * L + l] = max(w[(R_S + data.OVER) * L + l], -n_0 if alive > 0.0 else -math.inf)
        change = abs(d - u)
        w[(R_S + data.EFFORT) * L + l] = fma(alive, dt * (d * d), w[(R_S + data.EFFORT) * L + l])
        w[(R_S + data.TRAVEL) * L + l] = fma(alive, change, w[(R_S + data.TRAVEL) * L + l])
        right, left = w[R_RIGHT * L + l], w[R_LEFT * L + l]
        jerk = max(abs(right - w[R_PAST_RIGHT * L + l]), abs(left - w[R_PAST_LEFT * L + l]))
        w[(R_S + data.JERK) * L + l] = max(w[(R_S + data.JERK) * L + l], jerk * per_window)
        w[(R_S + data.A_Y) * L + l] = max(w[(R_S + data.A_Y) * L + l], max(abs(right), abs(left)))
        w[(R_S + data.DELTA) * L + l] = max(w[(R_S + data.DELTA) * L + l], abs(d))
        w[(R_S + data.RATE) * L + l] = max(w[(R_S + data.RATE) * L + l], change * per_step)
        w[R_U * L + l], w[R_D * L + l] = d, 0.0
        w[R_X * L + l], w[(R_X + 1) * L + l] = n_0, w[(R_N + 1) * L + l]
        w[(R_X + 2) * L + l], w[(R_X + 3) * L + l] = n_2, w[(R_N + 3) * L + l]


@numba.njit(**OPTIONS)
def drive_block(scene, exact, setting, law, times, block, score, diverged, failed, tables, score_only):
    """Every design of a law on one block of scenarios; scores into (d, SCORES, m). S alone on request."""
    w, g, ring = tables
    first, rows, size = block * L, 2 * times.shape[1], int(setting[data.RING])
    width = ring.shape[0] // (2 * size + 1)  # L, but unknown to the compiler, which would unroll a small loop instead
    count = min(L, scene.shape[0] - first)
    most = 0
    for l in range(count):
        most = max(most, int(scene[first + l, data.STEPS]))
    load(scene, exact, block, w)
    for l in range(L):
        ring[2 * size * L + l] = w[R_BEFORE * L + l]
    # a window is so many samples and the same share of another everywhere
    window_ago, share = past_sample(4 * size - setting[data.WINDOW], False)
    behind = 4 * size - window_ago
    for design in range(law.shape[0]):
        begin(scene, setting, law, times, design, block, w, g)
        for l in range(L):
            w[R_SINGLE * L + l] = 0.0
            if score_only:
                w[(R_S + data.BACK) * L + l] = 0.0  # no time is wanted beside S
        several, ahead = times.shape[1] != 1, 0.0
        if not several:
            ahead = times[design, 0]
        next_cut = 0  # the first sample at which a lane passes its T or comes to its last step
        for k in range(most):
            if several:
                _look_ahead(setting, times, design, k, w, g, width)
            quiet = k < next_cut
            if not quiet:
                next_cut = most
                for l in range(count):
                    i = first + l
                    _, counted = length_of(scene, setting, i, k)
                    w[R_COUNTED * L + l] = w[R_ALIVE * L + l] if counted > 0.0 else 0.0
                    full, end = int(scene[i, data.FULL]), int(scene[i, data.STEPS]) - 1
                    if k < end:
                        next_cut = min(next_cut, min(full, end) if k < full else (k + 1 if k == full else end))
            rare = _light_step(setting, k, ahead, w) if score_only else _step(setting, k, ahead, w, True)
            if rare or not quiet:
                for l in range(count):
                    i, fine = first + l, True
                    if w[R_ALIVE * L + l] == 0.0:
                        continue
                    if w[R_FLAG * L + l] == WRONG:  # the command before it was driven
                        failed[design, i] += 1
                    h, until = length_of(scene, setting, i, k)
                    if h < setting[data.DT] or 0.0 < until < h:
                        w[R_SINGLE * L + l] = 1.0
                        fine = cut(scene, exact, setting, w, i, l, k, not score_only)
                    elif w[R_FLAG * L + l] > 0.0:
                        fine = look_closer(setting, w, l, k, not score_only)
                    if not fine:
                        diverged[design, i] = True
                        leave(w, g, l, rows, score, design, i, score_only)
            if not score_only:
                _keep(ring, k & (size - 1), size + ((k + 1) & (size - 1)), w)
                start, end = _past(k - behind, share, size, False)
                _compare(ring, start, end, share, w, R_PAST_RIGHT)
                start, end = _past(k + 1 - behind, share, size, True)
                _compare(ring, start, end, share, w, R_PAST_LEFT)
                if not quiet:
                    for l in range(count):
                        if w[R_SINGLE * L + l] * w[R_ALIVE * L + l] > 0.0 and k + 1 == scene[first + l, data.STEPS]:
                            past_of_last(scene, setting, first + l, l, k, ring, w)
                _score(setting, w)
            else:
                _light_score(w)
            if rare or not quiet:
                for l in range(count):
                    w[R_SINGLE * L + l] = 0.0
                    if w[R_ALIVE * L + l] > 0.0 and k + 1 == scene[first + l, data.STEPS]:
                        leave(w, g, l, rows, score, design, first + l, score_only)
