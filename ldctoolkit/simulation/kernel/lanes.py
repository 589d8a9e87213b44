"""The table of a block in both loops: its start, events within a piece of the path, acceleration and jerk, scores.

A piece leads from the state in the rows from `E_Y` on to that in the rows from `NEXT_E_Y` on: a sample on the ideal
plant, a few substeps on any other.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lane_functions import absolute_area, hermite_peak, quartic_root, touches
from ldctoolkit.numba_internals import OPTIONS, copy, fma, larger
from ldctoolkit.simulation.kernel import data as at

L: Final = at.LANES

# ------------------------------------------------------------------------------------------------ the table of a block

SAME: Final = 1e-9  # Parts of a sample that are rounding


@numba.njit(inline="always", **OPTIONS)
def length_of(setting, w, l, k):
    """Length of sample k, and how much of it lies before T."""
    full, rest, steps = w[at.WHOLE_STEPS + l], w[at.REST_OF_T + l], w[at.ALL_STEPS + l]
    h = rest if (k + 1 == steps) & (rest > 0.0) else setting[at.DT]
    return h, (h if k < full else (rest if k == full else 0.0))


@numba.njit(**OPTIONS)
def begin(scene, setting, block, w, paths, chosen):
    """Scenarios of a block at their triggers; lanes beyond the last repeat it and are never alive."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        alive = block * L + l < scene.shape[0] and scene[i, at.STEPS] > 0.0
        w[at.T_0 + l], w[at.T + l] = scene[i, at.START], scene[i, at.T_END]
        w[at.WHOLE_STEPS + l], w[at.REST_OF_T + l] = scene[i, at.FULL], scene[i, at.REST]
        w[at.ALL_STEPS + l], last = scene[i, at.STEPS], scene[i, at.STEPS] - 1.0
        h, _ = length_of(setting, w, l, last)
        w[at.STOP + l] = scene[i, at.START] + last * setting[at.DT] + h
        for n in range(3):
            w[at.BEND_0 + n * L + l] = scene[i, at.BEND + n]
        for n in range(at.SCORES):
            w[at.SCORE + n * L + l] = 0.0
        for n in range(4):
            w[at.E_Y + n * L + l] = w[at.NEXT_E_Y + n * L + l] = scene[i, at.X_0 + n] if alive else 0.0
        w[at.LAST_COMMAND + l] = scene[i, at.DELTA_0] if alive else 0.0
        w[at.COMMAND + l] = w[at.E_Y_INTEGRAL + l] = w[at.BEFORE_T + l] = 0.0
        w[at.DEEPEST + l] = scene[i, at.X_0]
        w[at.FRONT_DEEPEST + l] = scene[i, at.X_0] + setting[at.L_FRONT] * scene[i, at.X_0 + 2]
        w[at.T_BACK + l] = math.inf if alive else 0.0
        w[at.OPPOSITE + l] = -scene[i, at.X_0]
        w[at.ALIVE + l] = 1.0 if alive else 0.0
        w[at.WHEEL + l], w[at.PATH_ROW + l] = w[at.LAST_COMMAND + l], chosen[i]
        w[at.DIVERGED + l] = w[at.FAILED + l] = w[at.PATH_ENTRIES + l] = 0.0
        if paths.shape[0] and alive and chosen[i] >= 0:
            record(paths, w, l, w[at.T_0 + l])


# ------------------------------------------------------------------------------------------------ within a piece


@numba.njit(**OPTIONS)
def look_closer(setting, w, l, t, h, counted):
    """Score a piece of one lane from t to t + h closely: change of sign, extremes, edge back inside.

    e_y is the cubic through both ends, e_y + l_f e_psi as well; |e_y| is integrated on the quartic that also has the
    integral of the piece.
    """
    l_f, offset = setting[at.L_FRONT], setting[at.OFFSET]
    x_0, x_1, n_0, n_1 = w[at.E_Y + l], w[at.E_Y_RATE + l], w[at.NEXT_E_Y + l], w[at.NEXT_E_Y_RATE + l]
    if w[at.T_BACK + l] == math.inf and x_0 >= offset > n_0:
        u = quartic_root(x_0 - offset, h * x_1, n_0 - offset, h * n_1, w[at.PIECE_AREA + l] / h - offset)
        w[at.T_BACK + l] = t + h * u
    if counted:
        f_0, f_1 = x_0 + l_f * w[at.E_PSI + l], n_0 + l_f * w[at.NEXT_E_PSI + l]
        front = hermite_peak(f_0, x_1 + l_f * w[at.E_PSI_RATE + l], f_1, n_1 + l_f * w[at.NEXT_E_PSI_RATE + l], h)
        w[at.DEEPEST + l] = max(w[at.DEEPEST + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        w[at.FRONT_DEEPEST + l] = max(w[at.FRONT_DEEPEST + l], front)
        if x_0 * n_0 < 0.0 or touches(x_0, x_1, n_0, n_1, h):
            w[at.PIECE_AREA + l] = absolute_area(x_0, x_1, n_0, n_1, w[at.PIECE_AREA + l], h)
    w[at.OPPOSITE + l] = max(w[at.OPPOSITE + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))


@numba.njit(**OPTIONS)
def diverge(setting, w, l, t, counted):
    """Score the bound for the rest of a departure that left it in the piece from t on: |e_y| = bound up to T."""
    inwards = w[at.NEXT_E_Y + l] < 0.0
    if counted:
        w[at.AREA + l] += setting[at.BOUND] * (w[at.T + l] - t)
        if not inwards:
            w[at.DEEPEST + l] = w[at.FRONT_DEEPEST + l] = setting[at.BOUND]
    if inwards:
        w[at.OPPOSITE + l] = setting[at.BOUND]


# ------------------------------------------------------------------------------------------------ acceleration and jerk


@numba.njit(**OPTIONS)
def rings(setting):
    """First rows behind the rings of commands and wheel angles: of frames, of a_y, of the residual's modes; the end."""
    frames = at.RINGS + 2 * L * int(setting[at.COMMAND_RING])
    limits = frames + 2 * L * int(setting[at.FRAME_RING])
    modes = limits + 4 * L * int(setting[at.A_Y_RING])
    return frames, limits, modes, modes + L * int(setting[at.MODES])


@numba.njit(inline="always", **OPTIONS)
def _past(setting, position, left):
    """Rows of a past position in samples, in the ring, and the share of the second; -1 for before the trigger.

    The ring holds four rows a sample: a_y just after and just before it, then the same without the lane's part.
    """
    _, limits, _, _ = rings(setting)
    mask, j = int(setting[at.A_Y_RING]) - 1, math.floor(position + SAME)
    share = position - j
    if j < 0 or (left and j == 0 and share <= SAME):
        return -1, -1, 0.0
    if share <= SAME:
        row = limits + (4 * (j & mask) + left) * L
        return row, row, 0.0
    return limits + 4 * (j & mask) * L, limits + (4 * ((j + 1) & mask) + 1) * L, share


@numba.njit(**OPTIONS)
def _before(setting, w, l, position, left, n):
    """a_y, or its own part, of a lane at a past position; before the trigger that of the recorded path."""
    start, end, share = _past(setting, position, left)
    if start < 0:
        return w[at.BEND_END_PAST + l] if n else w[at.A_Y_BEFORE + l]
    return w[start + 2 * n * L + l] + share * (w[end + 2 * n * L + l] - w[start + 2 * n * L + l])


@numba.njit(inline="always", **OPTIONS)
def look_back(setting, w, k):
    """Put a_y of sample k into the ring, and a_y a jerk window earlier into the rows from `A_Y_START_PAST` on."""
    _, limits, _, _ = rings(setting)
    mask = int(setting[at.A_Y_RING]) - 1
    for n in range(2):
        copy(w, limits + (4 * (k & mask) + 2 * n) * L, w, at.A_Y_START + 2 * n * L, 1)
        copy(w, limits + (4 * ((k + 1) & mask) + 2 * n + 1) * L, w, at.A_Y_START + (2 * n + 1) * L, 1)
    for left in range(2):
        start, end, share = _past(setting, k + left - setting[at.WINDOW], left)
        if start < 0:
            copy(w, at.A_Y_START_PAST + left * L, w, at.A_Y_BEFORE, 1)
            copy(w, at.A_Y_START_PAST + (2 + left) * L, w, at.BEND_START + (2 + left) * L, 1)
        else:
            for n in range(2):
                copy(w, at.WORK_0, w, start + 2 * n * L, 1)
                if share > 0.0:
                    copy(w, at.WORK_1, w, end + 2 * n * L, 1)
                    for l in range(int(setting[at.WIDTH])):
                        w[at.WORK_0 + l] = fma(share, w[at.WORK_1 + l] - w[at.WORK_0 + l], w[at.WORK_0 + l])
                copy(w, at.A_Y_START_PAST + (2 * n + left) * L, w, at.WORK_0, 1)


@numba.njit(**OPTIONS)
def look_back_from_end(setting, w, l, k):
    """The same at the end of a last sample that may be shorter, in one lane."""
    h, _ = length_of(setting, w, l, k)
    part = h / setting[at.DT] if h < setting[at.DT] else 1.0
    past = k + part - setting[at.WINDOW]
    for n in range(2):
        if past > k:
            low, high = w[at.A_Y_START + 2 * n * L + l], w[at.A_Y_START + (2 * n + 1) * L + l]
            w[at.A_Y_START_PAST + (2 * n + 1) * L + l] = low + (past - k) / part * (high - low)
        else:
            w[at.A_Y_START_PAST + (2 * n + 1) * L + l] = _before(setting, w, l, past, 1, n)


@numba.njit(**OPTIONS)
def score_limits(setting, w):
    """Peaks of a_y and jerk at both ends of a sample, and of what the intervention adds to them.

    jerk = |a_y(t) - a_y(t - W)| / W with the window W; added: |a_y - v^2 c| - |y''| of the recorded path, and the same
    of the differences over W.
    """
    per_window = 1.0 / (setting[at.WINDOW] * setting[at.DT])
    for l in range(L):
        a, b, p, q = w[at.A_Y_START + l], w[at.A_Y_END + l], w[at.A_Y_START_PAST + l], w[at.A_Y_END_PAST + l]
        own_a, own_b = w[at.A_Y_OWN_START + l], w[at.A_Y_OWN_END + l]
        own_p, own_q = w[at.A_Y_OWN_START_PAST + l], w[at.A_Y_OWN_END_PAST + l]
        y_a, y_b = w[at.BEND_START + l], w[at.BEND_END + l]
        y_p, y_q = w[at.BEND_START_PAST + l], w[at.BEND_END_PAST + l]
        driven = w[at.ALIVE + l]
        added = larger(abs(own_a) - abs(y_a), abs(own_b) - abs(y_b))
        jerk = larger(abs(a - p), abs(b - q)) * per_window
        jerk_added = larger(abs(own_a - own_p) - abs(y_a - y_p), abs(own_b - own_q) - abs(y_b - y_q)) * per_window
        w[at.A_Y_PEAK + l] = larger(w[at.A_Y_PEAK + l], driven * larger(abs(a), abs(b)))
        w[at.JERK_PEAK + l] = larger(w[at.JERK_PEAK + l], driven * jerk)
        w[at.A_Y_ADDED_PEAK + l] = larger(w[at.A_Y_ADDED_PEAK + l], driven * added)
        w[at.JERK_ADDED_PEAK + l] = larger(w[at.JERK_ADDED_PEAK + l], driven * jerk_added)


@numba.njit(**OPTIONS)
def record(paths, w, l, t):
    """Put the present state into the path of a chosen scenario."""
    c, n = int(w[at.PATH_ROW + l]), int(w[at.PATH_ENTRIES + l])
    paths[c, n, at.P_TIME], paths[c, n, at.P_DELTA] = t, w[at.WHEEL + l]
    for j in range(4):
        paths[c, n, at.P_X + j] = w[at.NEXT_E_Y + j * L + l]
    w[at.PATH_ENTRIES + l] = n + 1


@numba.njit(**OPTIONS)
def end_sample(setting, w, k, paths):
    """Paths at the end of sample k; the number of lanes that go on after it."""
    going = 0
    for l in range(L):
        if w[at.ALIVE + l] > 0.0:
            if paths.shape[0] and w[at.PATH_ROW + l] >= 0.0:
                h, _ = length_of(setting, w, l, k)
                full, rest = w[at.WHOLE_STEPS + l], w[at.REST_OF_T + l]
                at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
                record(paths, w, l, w[at.T + l] if at_T else w[at.T_0 + l] + k * setting[at.DT] + h)
            if k + 1 == w[at.ALL_STEPS + l]:
                w[at.ALIVE + l] = 0.0
            else:
                going += 1
    return going


@numba.njit(**OPTIONS)
def hand_over(w, design, block, score, diverged, failed):
    """Results of a design on a block."""
    for l in range(min(L, score.shape[2] - block * L)):
        i = block * L + l
        for n in range(score.shape[1]):
            score[design, n, i] = w[at.SCORE + n * L + l]
        diverged[design, i], failed[design, i] = w[at.DIVERGED + l] > 0.0, int(w[at.FAILED + l])


@numba.njit(**OPTIONS)
def lay_bend(setting, recorded, block, k, w, bend, to):
    """Recorded y'' at both ends of sample k and a window before them, from `to` on; 0 beyond T.

    With residuals it comes from `recorded` (m, samples, 2), at the samples and a window before them.
    """
    t, window = k * setting[at.DT], setting[at.WINDOW] * setting[at.DT]
    for l in range(int(setting[at.WIDTH])):
        a = w[at.T_0 + l] + t
        b = min(a + setting[at.DT], w[at.STOP + l])
        c_0, c_1, c_2 = w[at.BEND_0 + l], w[at.BEND_1 + l], w[at.BEND_2 + l]
        early, late = w[at.T + l] - SAME, w[at.T + l] + SAME
        p, q = a - window, b - window
        bend[to + l] = fma(a, fma(a, c_2, c_1), c_0) if a < early else 0.0
        bend[to + L + l] = fma(b, fma(b, c_2, c_1), c_0) if b < late else 0.0
        bend[to + 2 * L + l] = fma(p, fma(p, c_2, c_1), c_0) if p < early else 0.0
        bend[to + 3 * L + l] = fma(q, fma(q, c_2, c_1), c_0) if q < late else 0.0
    if recorded.shape[0]:
        for l in range(L):
            i, a = min(block * L + l, recorded.shape[0] - 1), w[at.T_0 + l] + t
            b = min(a + setting[at.DT], w[at.STOP + l])
            share = (b - a) / setting[at.DT]
            j, after = min(k, recorded.shape[1] - 1), min(k + 1, recorded.shape[1] - 1)
            for n in range(2):
                low, high, back = recorded[i, j, n], recorded[i, after, n], n * window
                bend[to + 2 * n * L + l] = low if a - back < w[at.T + l] - SAME else 0.0
                ends = b - back < w[at.T + l] + SAME
                bend[to + (2 * n + 1) * L + l] = low + share * (high - low) if ends else 0.0
