"""Linear laws on the ideal plant: eight scenarios side by side, in the lanes of the processor's vector registers.

Neighbours in the takeover's order last about equally long. Each whole step is a product with the exactly discretised
plant, the same arithmetic in every lane, so that a scenario's numbers do not depend on its neighbours. What happens
rarely is looked at one lane at a time: events within a step, steps that T cuts, and last ones that are not whole, which
are driven with exact matrices of their length.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lanes import any_lane, fma, select
from ldctoolkit.numba_internals import LARGEST_FLOAT, OPTIONS
from ldctoolkit.simulation.kernel import block_table, data
from ldctoolkit.simulation.kernel.block_table import L, length_of
from ldctoolkit.vector_math import touches

_CHANGED: Final = data.A_Y_START  # Rows that a run changes, but for those of the law
_NOT_FINITE: Final = 2.0  # Event of a command that is not finite


@numba.njit(**OPTIONS)
def start(scene, exact, setting, block, w, paths, path_rows):
    """Plant of a block, and everything before its first sample."""
    block_table.begin(scene, setting, block, w, paths, path_rows)
    w[data.NEXT_CUT] = 0.0
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        w[data.V, l], w[data.PER_T, l] = scene[i, data.SPEED], 1.0 / scene[i, data.T_END]
        for n in range(data.EXACT):
            w[data.STEP + n, l] = exact[0, i, n]
        for n in range(5):
            w[data.DDE_E_Y_RATE + n, l] = scene[i, data.A_11 + n]
        v = w[data.V, l] * w[data.ALIVE, l]
        w[data.V_C_0, l], w[data.V_DC, l] = v * scene[i, data.C_0], v * scene[i, data.DC]
        w[data.LANE_RATE, l] = _lane_rate(w, l, w[data.T_0, l])
        w[data.SINGLE, l] = 0.0
        a_y = (w[data.DDE_LANE, l] + v) * w[data.LANE_RATE, l] + w[data.DDE_DELTA, l] * w[data.LAST_COMMAND, l]
        for n in range(3):
            a_y += w[data.DDE_E_Y_RATE + n, l] * w[data.E_Y + n + 1, l]
        w[data.A_Y_BEFORE, l] = a_y


@numba.njit(**OPTIONS)
def _leave(setting, w, l):
    """Empty a lane that has ended: everything but its scores stays as it is from here on."""
    for n in range(4):
        w[data.E_Y + n, l] = w[data.NEXT_E_Y + n, l] = setting[data.OFFSET] if n == 0 else 0.0
    for n in range(data.LAW):
        w[data.F_E_Y + n, l] = 0.0
    w[data.G_YAW_RATE, l] = w[data.G_HEADING, l] = 0.0
    w[data.LAST_COMMAND, l] = w[data.COMMAND, l] = w[data.E_Y_INTEGRAL, l] = 0.0
    w[data.V_C_0, l] = w[data.V_DC, l] = w[data.LANE_RATE, l] = w[data.BEFORE_T, l] = w[data.ALIVE, l] = 0.0


# ------------------------------------------------------------------------------------------------ a step of every lane


@numba.njit(forceinline=True, **OPTIONS)
def _lane_rate(w, l, t):
    return fma(w[data.V_DC, l], min(t * w[data.PER_T, l], 1.0), w[data.V_C_0, l])


@numba.njit(forceinline=True, **OPTIONS)
def _lane_factors(T, per_T, t, lookahead):
    """Factors of v dc in the lane's yaw rate at t + lookahead, min(t + lookahead, T)/T, and in its turn until then."""
    t_1 = t + lookahead
    in_0, in_1 = min(t, T), min(t_1, T)
    within = 0.5 * (in_1 - in_0) * (in_1 + in_0)
    return in_1 * per_T, fma(within, per_T, (t_1 - in_1) - (t - in_0))


@numba.njit(**OPTIONS)
def _add_preview(setting, times, design, k, w, lane_weights):
    """Add the feedforward of a law with several lookahead times to `COMMAND`."""
    for j in range(times.shape[1]):
        lookahead = times[design, j]
        rate, turn = _lane_factors(w[data.T], w[data.PER_T], w[data.T_0] + k * setting[data.DT], lookahead)
        c_0, dc = w[data.V_C_0], w[data.V_DC]
        d = fma(lane_weights[2 * j], fma(dc, rate, c_0), w[data.COMMAND])
        w[data.COMMAND] = fma(lane_weights[2 * j + 1], fma(dc, turn, c_0 * lookahead), d)


@numba.njit(forceinline=True, **OPTIONS)
def _three(w, row, x, y, z):
    """Product of three rows with a state's rates."""
    return fma(w[row], x, fma(w[row + 1], y, w[row + 2] * z))


@numba.njit(forceinline=True, **OPTIONS)
def _driven(w, n, value, d, r_0, r_1):
    """The n-th state after a step: what comes from the state before, and from the inputs."""
    return fma(w[data.STEP_B + n], d, fma(w[data.STEP_E_0 + n], r_0, fma(w[data.STEP_E_1 + n], r_1, value)))


@numba.njit(forceinline=True, **OPTIONS)
def _step(setting, k, lookahead, w):
    """Command and one whole step of every lane; True if an event happens in one.

    With the lane's yaw rate r = v (c_0 + dc min(t, T)/T), and the command u of the sample before,

        z     <- z + dt e_y,
        delta  = F x + f_u u + f_i z + G_yaw_rate r(t + t_lookahead) + G_heading (turn of the lane until then),
        x(k+1) = A x + B delta + E_0 r(k) + E_1 r(k+1),
        area   = a_x x + a_delta delta + a_0 r(k) + a_1 r(k+1), the integral of e_y over the step,
        a_y    = e_y'' + v r = (row of A) x + B_1 delta + E_1 r + v r, at both ends.
    """
    dt, offset, bound, l_f = setting[data.DT], setting[data.OFFSET], setting[data.BOUND], setting[data.L_FRONT]
    t = w[data.T_0] + k * dt
    x_0, x_1, x_2, x_3 = w[data.E_Y], w[data.E_Y_RATE], w[data.E_PSI], w[data.E_PSI_RATE]
    u, z, c_0, dc = w[data.LAST_COMMAND], w[data.E_Y_INTEGRAL], w[data.V_C_0], w[data.V_DC]
    share = (w[data.T_0] + (k + 1) * dt) * w[data.PER_T]
    r_0, r_1 = w[data.LANE_RATE], fma(dc, min(share, 1.0), c_0)
    w[data.LANE_RATE] = r_1
    rate, turn = _lane_factors(w[data.T], w[data.PER_T], t, lookahead)
    d = fma(w[data.G_YAW_RATE], fma(dc, rate, c_0), w[data.COMMAND])
    d = fma(w[data.G_HEADING], fma(dc, turn, c_0 * lookahead), d)
    d = fma(w[data.F_I], z, fma(w[data.F_U], u, d))
    d += fma(w[data.F_E_Y], x_0, _three(w, data.F_E_Y_RATE, x_1, x_2, x_3))
    w[data.E_Y_INTEGRAL] = fma(dt, x_0, z)
    wrong = ~(abs(d) < LARGEST_FLOAT)
    d = select(wrong, u, d)
    w[data.COMMAND] = d
    # e_y feeds back into nothing: the first column of A is (1, 0, 0, 0)
    n_0 = _driven(w, 0, x_0 + _three(w, data.STEP_E_Y, x_1, x_2, x_3), d, r_0, r_1)
    n_1 = _driven(w, 1, _three(w, data.STEP_E_Y_RATE, x_1, x_2, x_3), d, r_0, r_1)
    n_2 = _driven(w, 2, _three(w, data.STEP_E_PSI, x_1, x_2, x_3), d, r_0, r_1)
    n_3 = _driven(w, 3, _three(w, data.STEP_E_PSI_RATE, x_1, x_2, x_3), d, r_0, r_1)
    area = fma(w[data.STEP_AREA_X], x_0, _three(w, data.STEP_AREA_X + 1, x_1, x_2, x_3))
    area = fma(w[data.STEP_AREA_DELTA], d, area)
    area = fma(w[data.STEP_AREA_R_0], r_0, fma(w[data.STEP_AREA_R_1], r_1, area))
    w[data.NEXT_E_Y], w[data.NEXT_E_Y_RATE] = n_0, n_1
    w[data.NEXT_E_PSI], w[data.NEXT_E_PSI_RATE] = n_2, n_3
    w[data.PIECE_AREA] = area
    counted = w[data.BEFORE_T] > 0.0
    event = ~(abs(n_0) <= bound)  # also true for NaN
    event |= counted & ((x_0 * n_0 < 0.0) | touches(x_0, x_1, n_0, n_1, dt))
    v, q_d, q_r = w[data.V], w[data.DDE_DELTA] * d, w[data.DDE_LANE]
    relative_start = fma(q_r, r_0, _three(w, data.DDE_E_Y_RATE, x_1, x_2, x_3) + q_d)
    relative_end = fma(q_r, r_1, _three(w, data.DDE_E_Y_RATE, n_1, n_2, n_3) + q_d)
    w[data.A_Y_START], w[data.A_Y_END] = fma(v, r_0, relative_start), fma(v, r_1, relative_end)
    w[data.A_Y_RELATIVE_START], w[data.A_Y_RELATIVE_END] = relative_start, relative_end
    event |= (w[data.T_BACK] == math.inf) & (n_0 < offset)
    # an extreme between the samples that may be a new one
    f_0, f_1 = fma(l_f, x_3, x_1), fma(l_f, n_3, n_1)
    front = fma(dt, f_0 - f_1, max(fma(l_f, x_2, x_0), fma(l_f, n_2, n_0)))
    deep, over = fma(dt, x_1 - n_1, max(x_0, n_0)), fma(dt, n_1 - x_1, -min(x_0, n_0))
    event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (deep > w[data.DEEPEST])
    event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (front > w[data.FRONT_DEEPEST])
    event |= (x_1 < 0.0) & (n_1 > 0.0) & (over > max(w[data.OPPOSITE], offset))
    w[data.EVENT] = select(wrong, _NOT_FINITE, select(event, 1.0, 0.0))
    return any_lane(event | wrong)


@numba.njit(forceinline=True, **OPTIONS)
def _score(setting, w):
    """Scores of a step in every lane but acceleration and jerk; `single` lanes have theirs but for the rate."""
    dt, l_f = setting[data.DT], setting[data.L_FRONT]
    per_step = 1.0 / dt
    in_step = 1.0 - w[data.SINGLE]
    n_0, n_2, d, u = w[data.NEXT_E_Y], w[data.NEXT_E_PSI], w[data.COMMAND], w[data.LAST_COMMAND]
    counted, alive = w[data.BEFORE_T] * in_step, w[data.ALIVE] * in_step
    w[data.AREA] = fma(abs(w[data.PIECE_AREA]), counted, w[data.AREA])
    front = fma(l_f, n_2, n_0)
    w[data.DEEPEST] = max(w[data.DEEPEST], select(counted > 0.0, n_0, -math.inf))
    w[data.FRONT_DEEPEST] = max(w[data.FRONT_DEEPEST], select(counted > 0.0, front, -math.inf))
    w[data.OPPOSITE] = max(w[data.OPPOSITE], select(alive > 0.0, -n_0, -math.inf))
    change = abs(d - u)
    w[data.EFFORT] = fma(alive, dt * (d * d), w[data.EFFORT])
    w[data.TRAVEL] = fma(alive, change, w[data.TRAVEL])
    w[data.DELTA_PEAK] = max(w[data.DELTA_PEAK], abs(d))
    w[data.DELTA_RATE_PEAK] = max(w[data.DELTA_RATE_PEAK], change * per_step)
    w[data.LAST_COMMAND], w[data.COMMAND] = d, 0.0
    w[data.E_Y], w[data.E_Y_RATE] = n_0, w[data.NEXT_E_Y_RATE]
    w[data.E_PSI], w[data.E_PSI_RATE] = n_2, w[data.NEXT_E_PSI_RATE]


# ------------------------------------------------------------------------------------------------ a step that is cut


@numba.njit(**OPTIONS)
def _turn(w, l, h, r_0, r_1):
    """Integral of e_psi over a step: the row of e_y'' integrated, and solved for it."""
    rest = w[data.DDE_DELTA, l] * w[data.COMMAND, l] * h + w[data.DDE_LANE, l] * 0.5 * h * (r_0 + r_1)
    rest += w[data.DDE_E_Y_RATE, l] * (w[data.NEXT_E_Y, l] - w[data.E_Y, l])
    rest += w[data.DDE_E_PSI_RATE, l] * (w[data.NEXT_E_PSI, l] - w[data.E_PSI, l])
    return (w[data.NEXT_E_Y_RATE, l] - w[data.E_Y_RATE, l] - rest) / w[data.DDE_E_PSI, l]


@numba.njit(**OPTIONS)
def _cut(exact, setting, w, i, l, k, paths):
    """Step k of a lane in which it is cut by T or shorter than dt, with its scores; False if it diverged."""
    h, until = length_of(setting, w, l, k)
    rest, d, t = w[data.REST_OF_T, l], w[data.COMMAND, l], w[data.T_0, l] + k * setting[data.DT]
    for part in range(1, 2 if h == rest else 3):
        span, counted = (rest, until > 0.0) if part == 1 else (h - rest, False)
        r_0, r_1 = _lane_rate(w, l, t), _lane_rate(w, l, t + span)
        if part == 2:
            for n in range(4):
                w[data.E_Y + n, l] = w[data.NEXT_E_Y + n, l]
        area = exact[part, i, data.EX_X] * w[data.E_Y, l]
        area += (
            exact[part, i, data.EX_DELTA] * d + exact[part, i, data.EX_R_0] * r_0 + exact[part, i, data.EX_R_1] * r_1
        )
        for n in range(4):
            value = exact[part, i, data.EX_B + n] * d + exact[part, i, data.EX_E_0 + n] * r_0
            value += exact[part, i, data.EX_E_1 + n] * r_1 + (w[data.E_Y, l] if n == 0 else 0.0)
            for j in range(3):
                value += exact[part, i, 3 * n + j] * w[data.E_Y + j + 1, l]
            w[data.NEXT_E_Y + n, l] = value
            area += exact[part, i, data.EX_X + n] * w[data.E_Y + n, l] if n else 0.0
        w[data.PIECE_AREA, l], w[data.PIECE_TURN, l] = area, _turn(w, l, span, r_0, r_1)
        if not abs(w[data.NEXT_E_Y, l]) <= setting[data.BOUND]:
            block_table.diverge(setting, w, l, t, counted)
            return False
        block_table.look_closer(setting, w, l, t, span, counted)
        if counted:
            w[data.AREA, l] += abs(w[data.PIECE_AREA, l])
        t += span
        relative = w[data.DDE_DELTA, l] * d + w[data.DDE_LANE, l] * r_1
        for n in range(3):
            relative += w[data.DDE_E_Y_RATE + n, l] * w[data.NEXT_E_Y + n + 1, l]
        w[data.A_Y_END, l], w[data.A_Y_RELATIVE_END, l] = relative + w[data.V, l] * r_1, relative
        if part == 1 and h != rest and paths.shape[0] and w[data.PATH_ROW, l] >= 0.0:
            block_table.record(paths, w, l, w[data.T, l], w[data.A_Y_END, l])
        if counted and h != rest:  # just after T nothing is recorded any more
            w[data.A_Y_ADDED_PEAK, l] = max(w[data.A_Y_ADDED_PEAK, l], abs(relative))
        w[data.EFFORT, l] += span * (d * d)
        w[data.DELTA_PEAK, l] = max(w[data.DELTA_PEAK, l], abs(d))
        w[data.TRAVEL, l] += abs(d - w[data.LAST_COMMAND, l]) if part == 1 else 0.0
    return True


# ------------------------------------------------------------------------------------------------ a sample, a whole run


@numba.njit(forceinline=True, **OPTIONS)
def advance(exact, setting, w, k, lookahead, first, bend, bend_offset, paths):
    """Sample k with the law in the rows of a block, or with the command in `COMMAND` where its weights are 0."""
    quiet = k < w[data.NEXT_CUT, 0]
    if not quiet:  # a lane passes its T or comes to its last step
        next_cut = math.inf
        for l in range(L):
            _, counted = length_of(setting, w, l, k)
            w[data.BEFORE_T, l] = w[data.ALIVE, l] if counted > 0.0 else 0.0
            full, end = w[data.WHOLE_STEPS, l], w[data.ALL_STEPS, l] - 1.0
            if k < end and w[data.ALIVE, l] > 0.0:
                next_cut = min(next_cut, min(full, end) if k < full else (k + 1.0 if k == full else end))
        w[data.NEXT_CUT] = next_cut
    rare = _step(setting, k, lookahead, w)
    if paths.shape[0]:
        for l in range(L):
            w[data.WHEEL, l] = w[data.COMMAND, l]
            if w[data.ALIVE, l] > 0.0 and w[data.PATH_ROW, l] >= 0.0:
                block_table.correct_record(paths, w, l, w[data.COMMAND, l], w[data.A_Y_START, l])
    if rare or not quiet:
        for l in range(L):
            if w[data.ALIVE, l] > 0.0:
                t, counted, inside = w[data.T_0, l] + k * setting[data.DT], w[data.BEFORE_T, l] > 0.0, True
                h, until = length_of(setting, w, l, k)
                # the command before it was driven
                w[data.FAILED, l] += 1.0 if w[data.EVENT, l] == _NOT_FINITE else 0.0
                if h < setting[data.DT] or 0.0 < until < h:
                    w[data.SINGLE, l] = 1.0
                    inside = _cut(exact, setting, w, first + l, l, k, paths)
                elif not abs(w[data.NEXT_E_Y, l]) <= setting[data.BOUND]:
                    block_table.diverge(setting, w, l, t, counted)
                    inside = False
                elif w[data.EVENT, l] > 0.0:
                    w[data.PIECE_TURN, l] = _turn(w, l, h, _lane_rate(w, l, t), w[data.LANE_RATE, l])
                    block_table.look_closer(setting, w, l, t, h, counted)
                if not inside:
                    w[data.DIVERGED, l] = 1.0
                    _leave(setting, w, l)
    for n in range(4):
        w[data.BEND_START + n] = bend[bend_offset + n]
    block_table.look_back(setting, w, k)
    if not quiet:
        for l in range(L):
            if w[data.SINGLE, l] * w[data.ALIVE, l] > 0.0 and k + 1 == w[data.ALL_STEPS, l]:
                block_table.look_back_from_end(setting, w, l, k)
    block_table.score_limits(setting, w)
    _score(setting, w)
    if rare or not quiet or paths.shape[0]:
        block_table.end_sample(setting, w, k, paths)
        for l in range(L):
            w[data.SINGLE, l] = 0.0
            if w[data.ALIVE, l] == 0.0:
                _leave(setting, w, l)


@numba.njit(**OPTIONS)
def drive_block(scene, exact, setting, law, times, recorded, paths, path_rows, block, score, diverged, failed, tables):
    """Every design of a law on one block of scenarios; scores into (d, SCORES, m)."""
    w, lane_weights, initial, bend = tables
    several, most = times.shape[1] != 1, 0
    start(scene, exact, setting, block, w, paths, path_rows)
    for n in range(_CHANGED):
        initial[n] = w[n]
    for l in range(L):
        most = max(most, int(w[data.ALL_STEPS, l]))
    for k in range(most):
        block_table.lay_bend(setting, recorded, block, k, w, bend, 4 * k)
    for design in range(law.shape[0]):
        for n in range(_CHANGED):
            w[n] = initial[n]
        for l in range(L):
            i, alive = min(block * L + l, scene.shape[0] - 1), w[data.ALIVE, l]
            for n in range(data.LAW):
                w[data.F_E_Y + n, l] = law[design, i, n] * alive
            for j in range(2 * times.shape[1]):
                lane_weights[j, l] = law[design, i, data.LAW + j] * alive
        w[data.G_YAW_RATE] = w[data.G_HEADING] = 0.0
        if not several:
            w[data.G_YAW_RATE], w[data.G_HEADING] = lane_weights[0], lane_weights[1]
        lookahead = 0.0 if several else times[design, 0]
        for k in range(most):
            if several:
                _add_preview(setting, times, design, k, w, lane_weights)
            advance(exact, setting, w, k, lookahead, block * L, bend, 4 * k, paths)
        block_table.store_scores(w, design, block, score, diverged, failed)
