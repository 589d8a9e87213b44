"""The table of a block in both loops: its start, events within a piece of the path, acceleration and jerk, scores.

A piece leads from the state in the rows from `E_Y` on to that in the rows from `NEXT_E_Y` on: a sample on the ideal
plant, a few substeps on any other.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.arrays import LANES
from ldctoolkit.control import AssistState
from ldctoolkit.lanes import fma, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import data
from ldctoolkit.vector_math import absolute_area, quartic_peak, quartic_root, touches

L: Final = LANES

# ------------------------------------------------------------------------------------------------ the table of a block

SAME: Final = 1e-9  # Parts of a sample that are rounding
ACTIVE: Final = float(AssistState.ACTIVE)


@numba.njit(forceinline=True, **OPTIONS)
def length_of(setting, w, l, k):
    """Length of sample k, and how much of it lies before T."""
    full, rest, steps = w[data.WHOLE_STEPS, l], w[data.REST_OF_T, l], w[data.ALL_STEPS, l]
    h = rest if (k + 1 == steps) & (rest > 0.0) else setting[data.DT]
    return h, (h if k < full else (rest if k == full else 0.0))


@numba.njit(forceinline=True, **OPTIONS)
def lengths(setting, w, k):
    """The same of all lanes."""
    full, rest, steps = w[data.WHOLE_STEPS], w[data.REST_OF_T], w[data.ALL_STEPS]
    h = select((steps == k + 1.0) & (rest > 0.0), rest, setting[data.DT])
    return h, select(full > k, h, select(full == k, rest, 0.0))


@numba.njit(**OPTIONS)
def begin(scene, setting, block, w, paths, path_rows):
    """Scenarios of a block at their triggers; lanes beyond the last repeat it and are never alive."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        alive = block * L + l < scene.shape[0] and scene[i, data.STEPS] > 0.0
        w[data.T_0, l], w[data.T, l] = scene[i, data.START], scene[i, data.T_END]
        w[data.WHOLE_STEPS, l], w[data.REST_OF_T, l] = scene[i, data.FULL], scene[i, data.REST]
        w[data.ALL_STEPS, l], last = scene[i, data.STEPS], scene[i, data.STEPS] - 1.0
        h, _ = length_of(setting, w, l, last)
        w[data.STOP, l] = scene[i, data.START] + last * setting[data.DT] + h
        for n in range(3):
            w[data.BEND_0 + n, l] = scene[i, data.BEND + n]
        for n in range(data.SCORES):
            w[data.SCORE + n, l] = 0.0
        for n in range(4):
            w[data.E_Y + n, l] = w[data.NEXT_E_Y + n, l] = scene[i, data.X_0 + n] if alive else 0.0
        w[data.LAST_COMMAND, l] = scene[i, data.DELTA_0] if alive else 0.0
        w[data.COMMAND, l] = w[data.E_Y_INTEGRAL, l] = w[data.BEFORE_T, l] = 0.0
        w[data.DEEPEST, l] = scene[i, data.X_0]
        w[data.FRONT_DEEPEST, l] = scene[i, data.X_0] + setting[data.L_FRONT] * scene[i, data.X_0 + 2]
        w[data.T_BACK, l] = math.inf if alive else 0.0
        w[data.OPPOSITE, l] = -scene[i, data.X_0]
        w[data.ALIVE, l] = 1.0 if alive else 0.0
        w[data.WHEEL, l], w[data.PATH_ROW, l] = w[data.LAST_COMMAND, l], path_rows[i]
        w[data.DIVERGED, l] = w[data.FAILED, l] = w[data.PATH_ENTRIES, l] = 0.0
        w[data.ASSIST_STATE, l], w[data.AUTHORITY, l] = ACTIVE, 1.0
        if paths.shape[0] and alive and path_rows[i] >= 0:
            record(paths, w, l, w[data.T_0, l], 0.0)


# ------------------------------------------------------------------------------------------------ within a piece


@numba.njit(**OPTIONS)
def look_closer(setting, w, l, t, h, counted):
    """Score a piece of one lane from t to t + h closely: change of sign, extremes, edge back inside.

    e_y and e_psi are the quartics with their ends, slopes and integrals over the piece.
    """
    l_f, offset = setting[data.L_FRONT], setting[data.OFFSET]
    x_0, x_1, n_0, n_1 = w[data.E_Y, l], w[data.E_Y_RATE, l], w[data.NEXT_E_Y, l], w[data.NEXT_E_Y_RATE, l]
    if w[data.T_BACK, l] == math.inf and x_0 >= offset > n_0:
        u = quartic_root(x_0 - offset, h * x_1, n_0 - offset, h * n_1, w[data.PIECE_AREA, l] / h - offset)
        w[data.T_BACK, l] = t + h * u
    area, m_0, m_1 = w[data.PIECE_AREA, l], h * x_1, h * n_1
    if counted:
        f_0, f_1 = x_0 + l_f * w[data.E_PSI, l], n_0 + l_f * w[data.NEXT_E_PSI, l]
        g_0, g_1 = m_0 + h * l_f * w[data.E_PSI_RATE, l], m_1 + h * l_f * w[data.NEXT_E_PSI_RATE, l]
        front = quartic_peak(f_0, g_0, f_1, g_1, (area + l_f * w[data.PIECE_TURN, l]) / h)
        w[data.DEEPEST, l] = max(w[data.DEEPEST, l], quartic_peak(x_0, m_0, n_0, m_1, area / h))
        w[data.FRONT_DEEPEST, l] = max(w[data.FRONT_DEEPEST, l], front)
        if x_0 * n_0 < 0.0 or touches(x_0, x_1, n_0, n_1, h):
            w[data.PIECE_AREA, l] = absolute_area(x_0, x_1, n_0, n_1, area, h)
    w[data.OPPOSITE, l] = max(w[data.OPPOSITE, l], quartic_peak(-x_0, -m_0, -n_0, -m_1, -area / h))


@numba.njit(**OPTIONS)
def diverge(setting, w, l, t, counted):
    """Score the bound for the rest of a departure that left it in the piece from t on: |e_y| = bound up to T."""
    inwards = w[data.NEXT_E_Y, l] < 0.0
    if counted:
        w[data.AREA, l] += setting[data.BOUND] * (w[data.T, l] - t)
        if not inwards:
            w[data.DEEPEST, l] = w[data.FRONT_DEEPEST, l] = setting[data.BOUND]
    if inwards:
        w[data.OPPOSITE, l] = setting[data.BOUND]


# ------------------------------------------------------------------------------------------------ acceleration and jerk


@numba.njit(**OPTIONS)
def rings(setting):
    """First rows behind the rings of commands and wheel angles: of frames, of a_y, of the residual's modes; the end."""
    frames = data.RINGS + 2 * int(setting[data.COMMAND_RING])
    limits = frames + 2 * int(setting[data.FRAME_RING])
    modes = limits + 4 * int(setting[data.A_Y_RING])
    return frames, limits, modes, modes + int(setting[data.MODES])


@numba.njit(forceinline=True, **OPTIONS)
def _past(setting, position, left):
    """Rows of a past position in samples, in the ring, and the share of the second; -1 for before the trigger.

    The ring holds four rows a sample: a_y just after and just before it, then the same relative to the road.
    """
    _, limits, _, _ = rings(setting)
    mask, j = int(setting[data.A_Y_RING]) - 1, math.floor(position + SAME)
    share = position - j
    if j < 0 or (left and j == 0 and share <= SAME):
        return -1, -1, 0.0
    if share <= SAME:
        row = limits + 4 * (j & mask) + left
        return row, row, 0.0
    return limits + 4 * (j & mask), limits + 4 * ((j + 1) & mask) + 1, share


@numba.njit(**OPTIONS)
def _before(setting, w, l, position, left, n):
    """a_y, or with n = 1 that relative to the road, of a lane at a past position; the recorded path's before T_0."""
    start, end, share = _past(setting, position, left)
    if start < 0:
        return w[data.BEND_END_PAST, l] if n else w[data.A_Y_BEFORE, l]
    return w[start + 2 * n, l] + share * (w[end + 2 * n, l] - w[start + 2 * n, l])


@numba.njit(forceinline=True, **OPTIONS)
def look_back(setting, w, k):
    """Put a_y of sample k into the ring, and a_y a jerk window earlier into the rows from `A_Y_START_PAST` on."""
    _, limits, _, _ = rings(setting)
    mask = int(setting[data.A_Y_RING]) - 1
    for n in range(2):
        w[limits + 4 * (k & mask) + 2 * n] = w[data.A_Y_START + 2 * n]
        w[limits + 4 * ((k + 1) & mask) + 2 * n + 1] = w[data.A_Y_START + 2 * n + 1]
    for left in range(2):
        start, end, share = _past(setting, k + left - setting[data.WINDOW], left)
        if start < 0:
            w[data.A_Y_START_PAST + left] = w[data.A_Y_BEFORE]
            w[data.A_Y_START_PAST + 2 + left] = w[data.BEND_START + 2 + left]
        else:
            for n in range(2):
                past = w[start + 2 * n]
                if share > 0.0:
                    past = fma(share, w[end + 2 * n] - past, past)
                w[data.A_Y_START_PAST + 2 * n + left] = past


@numba.njit(**OPTIONS)
def look_back_from_end(setting, w, l, k):
    """The same at the end of a last sample that may be shorter, in one lane."""
    h, _ = length_of(setting, w, l, k)
    part = h / setting[data.DT] if h < setting[data.DT] else 1.0
    past = k + part - setting[data.WINDOW]
    for n in range(2):
        if past > k:
            low, high = w[data.A_Y_START + 2 * n, l], w[data.A_Y_START + 2 * n + 1, l]
            w[data.A_Y_START_PAST + 2 * n + 1, l] = low + (past - k) / part * (high - low)
        else:
            w[data.A_Y_START_PAST + 2 * n + 1, l] = _before(setting, w, l, past, 1, n)


@numba.njit(**OPTIONS)
def score_limits(setting, w):
    """Peaks of a_y and jerk at both ends of a sample, and of what the intervention adds to them.

    jerk = |a_y(t) - a_y(t - W)| / W with the window W; added: |a_y - v^2 c| - |y''| of the recorded path, and the same
    of the differences over W.
    """
    per_window = 1.0 / (setting[data.WINDOW] * setting[data.DT])
    start, end = w[data.A_Y_START], w[data.A_Y_END]
    change_start, change_end = start - w[data.A_Y_START_PAST], end - w[data.A_Y_END_PAST]
    relative_start, relative_end = w[data.A_Y_RELATIVE_START], w[data.A_Y_RELATIVE_END]
    relative_change_start = relative_start - w[data.A_Y_RELATIVE_START_PAST]
    relative_change_end = relative_end - w[data.A_Y_RELATIVE_END_PAST]
    bend_start, bend_end = w[data.BEND_START], w[data.BEND_END]
    bend_change_start = bend_start - w[data.BEND_START_PAST]
    bend_change_end = bend_end - w[data.BEND_END_PAST]
    driven = w[data.ALIVE]
    added = max(abs(relative_start) - abs(bend_start), abs(relative_end) - abs(bend_end))
    jerk = max(abs(change_start), abs(change_end)) * per_window
    jerk_added_start = abs(relative_change_start) - abs(bend_change_start)
    jerk_added = max(jerk_added_start, abs(relative_change_end) - abs(bend_change_end)) * per_window
    w[data.A_Y_PEAK] = max(w[data.A_Y_PEAK], driven * max(abs(start), abs(end)))
    w[data.JERK_PEAK] = max(w[data.JERK_PEAK], driven * jerk)
    w[data.A_Y_ADDED_PEAK] = max(w[data.A_Y_ADDED_PEAK], driven * added)
    w[data.JERK_ADDED_PEAK] = max(w[data.JERK_ADDED_PEAK], driven * jerk_added)


@numba.njit(**OPTIONS)
def record(paths, w, l, t, a_y):
    """Append the present state, steering angle, lateral acceleration and command to the path of a scenario."""
    c, n = int(w[data.PATH_ROW, l]), int(w[data.PATH_ENTRIES, l])
    paths[c, n, data.P_TIME], paths[c, n, data.P_DELTA], paths[c, n, data.P_A_Y] = t, w[data.WHEEL, l], a_y
    paths[c, n, data.P_COMMAND], paths[c, n, data.P_AUTHORITY] = w[data.COMMAND, l], w[data.AUTHORITY, l]
    paths[c, n, data.P_TORQUE], paths[c, n, data.P_ASSIST] = w[data.TORQUE, l], w[data.ASSIST, l]
    paths[c, n, data.P_STATE] = w[data.ASSIST_STATE, l]
    for j in range(4):
        paths[c, n, data.P_X + j] = w[data.NEXT_E_Y + j, l]
    w[data.PATH_ENTRIES, l] = n + 1


@numba.njit(**OPTIONS)
def correct_record(paths, w, l, delta, a_y):
    """Replace steering angle, lateral acceleration and command of the latest entry by those after the new command."""
    c, n = int(w[data.PATH_ROW, l]), int(w[data.PATH_ENTRIES, l]) - 1
    paths[c, n, data.P_DELTA], paths[c, n, data.P_A_Y], paths[c, n, data.P_COMMAND] = delta, a_y, w[data.COMMAND, l]


@numba.njit(**OPTIONS)
def end_sample(setting, w, k, paths):
    """Paths at the end of sample k; the number of lanes that go on after it."""
    going = 0
    for l in range(L):
        if w[data.ALIVE, l] > 0.0:
            if paths.shape[0] and w[data.PATH_ROW, l] >= 0.0:
                h, _ = length_of(setting, w, l, k)
                full, rest = w[data.WHOLE_STEPS, l], w[data.REST_OF_T, l]
                at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
                t = w[data.T, l] if at_T else w[data.T_0, l] + k * setting[data.DT] + h
                record(paths, w, l, t, w[data.A_Y_END, l])
            if k + 1 == w[data.ALL_STEPS, l]:
                w[data.ALIVE, l] = 0.0
            else:
                going += 1
    return going


@numba.njit(**OPTIONS)
def store_scores(w, design, block, score, diverged, failed):
    """Results of a design on a block."""
    for l in range(min(L, score.shape[2] - block * L)):
        i = block * L + l
        for n in range(score.shape[1]):
            score[design, n, i] = w[data.SCORE + n, l]
        diverged[design, i], failed[design, i] = w[data.DIVERGED, l] > 0.0, int(w[data.FAILED, l])


@numba.njit(**OPTIONS)
def lay_bend(setting, recorded, block, k, w, bend, to):
    """Recorded y'' at both ends of sample k and a window before them, from `to` on; 0 beyond T.

    With residuals it comes from `recorded` (m, samples, 2), at the samples and a window before them.
    """
    t, window = k * setting[data.DT], setting[data.WINDOW] * setting[data.DT]
    a = w[data.T_0] + t
    b = min(a + setting[data.DT], w[data.STOP])
    c_0, c_1, c_2 = w[data.BEND_0], w[data.BEND_1], w[data.BEND_2]
    early, late = w[data.T] - SAME, w[data.T] + SAME
    p, q = a - window, b - window
    bend[to] = select(a < early, fma(a, fma(a, c_2, c_1), c_0), 0.0)
    bend[to + 1] = select(b < late, fma(b, fma(b, c_2, c_1), c_0), 0.0)
    bend[to + 2] = select(p < early, fma(p, fma(p, c_2, c_1), c_0), 0.0)
    bend[to + 3] = select(q < late, fma(q, fma(q, c_2, c_1), c_0), 0.0)
    if recorded.shape[0]:
        for l in range(L):
            i, a = min(block * L + l, recorded.shape[0] - 1), w[data.T_0, l] + t
            b = min(a + setting[data.DT], w[data.STOP, l])
            share = (b - a) / setting[data.DT]
            j, after = min(k, recorded.shape[1] - 1), min(k + 1, recorded.shape[1] - 1)
            for n in range(2):
                low, high, back = recorded[i, j, n], recorded[i, after, n], n * window
                bend[to + 2 * n, l] = low if a - back < w[data.T, l] - SAME else 0.0
                ends = b - back < w[data.T, l] + SAME
                bend[to + 2 * n + 1, l] = low + share * (high - low) if ends else 0.0
