"""What both loops do with the table of a block: its start, events within a piece of the path, acceleration and jerk.

A piece leads from the state in rows `X` to that in rows `N`: a sample on the ideal plant, a few substeps on any other.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lane_functions import OPTIONS, absolute_area, fma, hermite_peak, larger, quartic_root, touches
from ldctoolkit.simulation.kernel import data as at

L: Final = at.LANES

# ------------------------------------------------------------------------------------------------ the table of a block

SAME: Final = 1e-9  # parts of a sample that are rounding

LARGEST: Final = 1.7e308
"""Command [rad] that still counts as a finite number: a comparison with infinity itself is not compiled for lanes."""

POSITIVE: Final = (1 << 48) - 1
"""Mask of a place in an array: the compiler then sees that it is not counted from the end, and moves lanes together."""


@numba.njit(inline="always", **OPTIONS)
def length_of(setting, w, l, k):
    """Length of sample k, and how much of it lies before T."""
    full, rest, steps = w[at.ENDS + l], w[at.ENDS + L + l], w[at.ENDS + 2 * L + l]
    h = rest if (k + 1 == steps) & (rest > 0.0) else setting[at.DT]
    return h, (h if k < full else (rest if k == full else 0.0))


@numba.njit(**OPTIONS)
def begin(scene, setting, block, w, paths, chosen):
    """Scenarios of a block at their triggers; lanes beyond the last repeat it and are never alive."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        alive = block * L + l < scene.shape[0] and scene[i, at.STEPS] > 0.0
        w[at.T_0 + l], w[at.T + l] = scene[i, at.START], scene[i, at.T_END]
        w[at.ENDS + l], w[at.ENDS + L + l] = scene[i, at.FULL], scene[i, at.REST]
        w[at.ENDS + 2 * L + l], last = scene[i, at.STEPS], scene[i, at.STEPS] - 1.0
        h, _ = length_of(setting, w, l, last)
        w[at.STOP + l] = scene[i, at.START] + last * setting[at.DT] + h
        for n in range(3):
            w[at.POLYNOMIAL + n * L + l] = scene[i, at.BEND + n]
        for n in range(at.SCORES):
            w[at.S + n * L + l] = 0.0
        for n in range(4):
            w[at.X + n * L + l] = w[at.N + n * L + l] = scene[i, at.X_0 + n] if alive else 0.0
        w[at.LAST + l] = scene[i, at.DELTA_0] if alive else 0.0
        w[at.TARGET + l] = w[at.Z + l] = w[at.COUNTED + l] = 0.0
        w[at.S + at.DEEP * L + l] = scene[i, at.X_0]
        w[at.S + at.FRONT * L + l] = scene[i, at.X_0] + setting[at.AXLE] * scene[i, at.X_0 + 2]
        w[at.S + at.BACK * L + l] = math.inf if alive else 0.0
        w[at.S + at.OPPOSITE * L + l] = -scene[i, at.X_0]
        w[at.ALIVE + l] = 1.0 if alive else 0.0
        w[at.WHEEL + l], w[at.KEPT + l] = w[at.LAST + l], chosen[i]
        w[at.DIVERGED + l] = w[at.FAILED + l] = w[at.ENTRIES + l] = 0.0
        if paths.shape[0] and alive and chosen[i] >= 0:
            record(paths, w, l, w[at.T_0 + l])


# ------------------------------------------------------------------------------------------------ within a piece


@numba.njit(**OPTIONS)
def look_closer(setting, w, l, t, h, counted):
    """What a piece of one lane holds from t to t + h: change of sign, extremes, edge back inside."""
    l_f, offset = setting[at.AXLE], setting[at.OFFSET]
    x_0, x_1, n_0, n_1 = w[at.X + l], w[at.X + L + l], w[at.N + l], w[at.N + L + l]
    if w[at.S + at.BACK * L + l] == math.inf and x_0 >= offset > n_0:
        u = quartic_root(x_0 - offset, h * x_1, n_0 - offset, h * n_1, w[at.SIGNED + l] / h - offset)
        w[at.S + at.BACK * L + l] = t + h * u
    if counted:
        f_0, f_1 = x_0 + l_f * w[at.X + 2 * L + l], n_0 + l_f * w[at.N + 2 * L + l]
        front = hermite_peak(f_0, x_1 + l_f * w[at.X + 3 * L + l], f_1, n_1 + l_f * w[at.N + 3 * L + l], h)
        w[at.S + at.DEEP * L + l] = max(w[at.S + at.DEEP * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        w[at.S + at.FRONT * L + l] = max(w[at.S + at.FRONT * L + l], front)
        if x_0 * n_0 < 0.0 or touches(x_0, x_1, n_0, n_1, h):
            w[at.SIGNED + l] = absolute_area(x_0, x_1, n_0, n_1, w[at.SIGNED + l], h)
    w[at.S + at.OPPOSITE * L + l] = max(w[at.S + at.OPPOSITE * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))


@numba.njit(**OPTIONS)
def diverge(setting, w, l, t, counted):
    """Score the bound from the start t of what left it."""
    inwards = w[at.N + l] < 0.0
    if counted:
        w[at.S + at.AREA * L + l] += setting[at.BOUND] * (w[at.T + l] - t)
        if not inwards:
            w[at.S + at.DEEP * L + l] = w[at.S + at.FRONT * L + l] = setting[at.BOUND]
    if inwards:
        w[at.S + at.OPPOSITE * L + l] = setting[at.BOUND]


# ------------------------------------------------------------------------------------------------ acceleration and jerk


@numba.njit(**OPTIONS)
def rings(setting):
    """First rows behind the rings of commands and wheel angles: of frames, of a_y, of the residual's modes; the end."""
    frames = at.RINGS + 2 * L * int(setting[at.COMMANDS])
    limits = frames + 2 * L * int(setting[at.FRAMES])
    modes = limits + 4 * L * int(setting[at.RING])
    return frames, limits, modes, modes + L * int(setting[at.MODES])


@numba.njit(forceinline=True, **OPTIONS)
def copy(w, row, other, place, count):
    """Copy whole rows of lanes from another array: what is worked on together lies in one.

    Eight numbers are read before any is written: only then are they moved together.
    """
    for n in range(count * (L // 8)):
        p, q = (place + 8 * n) & POSITIVE, (row + 8 * n) & POSITIVE
        a_0, a_1, a_2, a_3 = other[p], other[p + 1], other[p + 2], other[p + 3]
        a_4, a_5, a_6, a_7 = other[p + 4], other[p + 5], other[p + 6], other[p + 7]
        w[q], w[q + 1], w[q + 2], w[q + 3] = a_0, a_1, a_2, a_3
        w[q + 4], w[q + 5], w[q + 6], w[q + 7] = a_4, a_5, a_6, a_7


@numba.njit(inline="always", **OPTIONS)
def _past(setting, position, left):
    """Rows of a past position in samples, in the ring, and the share of the second; -1 for before the trigger.

    The ring holds four rows a sample: a_y just after and just before it, then the same without the lane's part.
    """
    _, limits, _, _ = rings(setting)
    mask, j = int(setting[at.RING]) - 1, math.floor(position + SAME)
    share = position - j
    if j < 0 or (left and j == 0 and share <= SAME):
        return -1, -1, 0.0
    if share <= SAME:
        row = limits + (4 * (j & mask) + left) * L
        return row, row, 0.0
    return limits + 4 * (j & mask) * L, limits + (4 * ((j + 1) & mask) + 1) * L, share


@numba.njit(**OPTIONS)
def _before(setting, w, l, position, left, n):
    """What a_y, or its own part, was in a lane at a past position; before the trigger that of the recorded path."""
    start, end, share = _past(setting, position, left)
    if start < 0:
        return w[at.RECORDED + 3 * L + l] if n else w[at.BEFORE + l]
    return w[start + 2 * n * L + l] + share * (w[end + 2 * n * L + l] - w[start + 2 * n * L + l])


@numba.njit(inline="always", **OPTIONS)
def look_back(setting, w, k):
    """Put the limits of sample k into the ring, and what they were a window earlier into `PAST`."""
    _, limits, _, _ = rings(setting)
    mask = int(setting[at.RING]) - 1
    for n in range(2):
        copy(w, limits + (4 * (k & mask) + 2 * n) * L, w, at.LIMITS + 2 * n * L, 1)
        copy(w, limits + (4 * ((k + 1) & mask) + 2 * n + 1) * L, w, at.LIMITS + (2 * n + 1) * L, 1)
    for left in range(2):
        start, end, share = _past(setting, k + left - setting[at.WINDOW], left)
        if start < 0:
            copy(w, at.PAST + left * L, w, at.BEFORE, 1)
            copy(w, at.PAST + (2 + left) * L, w, at.RECORDED + (2 + left) * L, 1)
        else:
            for n in range(2):
                copy(w, at.WORK, w, start + 2 * n * L, 1)
                if share > 0.0:
                    copy(w, at.WORK + L, w, end + 2 * n * L, 1)
                    for l in range(int(setting[at.WIDTH])):
                        w[at.WORK + l] = fma(share, w[at.WORK + L + l] - w[at.WORK + l], w[at.WORK + l])
                copy(w, at.PAST + (2 * n + left) * L, w, at.WORK, 1)


@numba.njit(**OPTIONS)
def look_back_from_end(setting, w, l, k):
    """The same at the end of a last sample that may be shorter, in one lane."""
    h, _ = length_of(setting, w, l, k)
    part = h / setting[at.DT] if h < setting[at.DT] else 1.0
    past = k + part - setting[at.WINDOW]
    for n in range(2):
        if past > k:
            low, high = w[at.LIMITS + 2 * n * L + l], w[at.LIMITS + (2 * n + 1) * L + l]
            w[at.PAST + (2 * n + 1) * L + l] = low + (past - k) / part * (high - low)
        else:
            w[at.PAST + (2 * n + 1) * L + l] = _before(setting, w, l, past, 1, n)


@numba.njit(**OPTIONS)
def score_limits(setting, w):
    """Peaks of a_y and of its moving average at both ends of a sample, and of what the intervention adds to them."""
    per_window = 1.0 / (setting[at.WINDOW] * setting[at.DT])
    for l in range(L):
        a, b, p, q = w[at.LIMITS + l], w[at.LIMITS + L + l], w[at.PAST + l], w[at.PAST + L + l]
        own_a, own_b = w[at.LIMITS + 2 * L + l], w[at.LIMITS + 3 * L + l]
        own_p, own_q = w[at.PAST + 2 * L + l], w[at.PAST + 3 * L + l]
        y_a, y_b = w[at.RECORDED + l], w[at.RECORDED + L + l]
        y_p, y_q = w[at.RECORDED + 2 * L + l], w[at.RECORDED + 3 * L + l]
        driven = w[at.ALIVE + l]
        added = larger(abs(own_a) - abs(y_a), abs(own_b) - abs(y_b))
        jerk = larger(abs(a - p), abs(b - q)) * per_window
        jerk_added = larger(abs(own_a - own_p) - abs(y_a - y_p), abs(own_b - own_q) - abs(y_b - y_q)) * per_window
        w[at.S + at.A_Y * L + l] = larger(w[at.S + at.A_Y * L + l], driven * larger(abs(a), abs(b)))
        w[at.S + at.JERK * L + l] = larger(w[at.S + at.JERK * L + l], driven * jerk)
        w[at.S + at.A_Y_ADDED * L + l] = larger(w[at.S + at.A_Y_ADDED * L + l], driven * added)
        w[at.S + at.JERK_ADDED * L + l] = larger(w[at.S + at.JERK_ADDED * L + l], driven * jerk_added)


@numba.njit(**OPTIONS)
def record(paths, w, l, t):
    """Put the present state into the path of a chosen scenario."""
    c, n = int(w[at.KEPT + l]), int(w[at.ENTRIES + l])
    paths[c, n, at.P_TIME], paths[c, n, at.P_DELTA] = t, w[at.WHEEL + l]
    for j in range(4):
        paths[c, n, at.P_X + j] = w[at.N + j * L + l]
    w[at.ENTRIES + l] = n + 1


@numba.njit(**OPTIONS)
def end_sample(setting, w, k, paths):
    """Paths at the end of sample k; the number of lanes that go on after it."""
    going = 0
    for l in range(L):
        if w[at.ALIVE + l] > 0.0:
            if paths.shape[0] and w[at.KEPT + l] >= 0.0:
                h, _ = length_of(setting, w, l, k)
                full, rest = w[at.ENDS + l], w[at.ENDS + L + l]
                at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
                record(paths, w, l, w[at.T + l] if at_T else w[at.T_0 + l] + k * setting[at.DT] + h)
            if k + 1 == w[at.ENDS + 2 * L + l]:
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
            score[design, n, i] = w[at.S + n * L + l]
        diverged[design, i], failed[design, i] = w[at.DIVERGED + l] > 0.0, int(w[at.FAILED + l])


@numba.njit(**OPTIONS)
def lay_bend(setting, recorded, block, k, w, bend, place):
    """Recorded y'' at both ends of sample k and a window before them, from `place` on; 0 beyond T.

    With residuals it comes from `recorded` (m, samples, 2), at the samples and a window before them.
    """
    t, window = k * setting[at.DT], setting[at.WINDOW] * setting[at.DT]
    for l in range(int(setting[at.WIDTH])):
        a = w[at.T_0 + l] + t
        b = min(a + setting[at.DT], w[at.STOP + l])
        c_0, c_1, c_2 = w[at.POLYNOMIAL + l], w[at.POLYNOMIAL + L + l], w[at.POLYNOMIAL + 2 * L + l]
        early, late = w[at.T + l] - SAME, w[at.T + l] + SAME
        p, q = a - window, b - window
        bend[place + l] = fma(a, fma(a, c_2, c_1), c_0) if a < early else 0.0
        bend[place + L + l] = fma(b, fma(b, c_2, c_1), c_0) if b < late else 0.0
        bend[place + 2 * L + l] = fma(p, fma(p, c_2, c_1), c_0) if p < early else 0.0
        bend[place + 3 * L + l] = fma(q, fma(q, c_2, c_1), c_0) if q < late else 0.0
    if recorded.shape[0]:
        for l in range(L):
            i, a = min(block * L + l, recorded.shape[0] - 1), w[at.T_0 + l] + t
            b = min(a + setting[at.DT], w[at.STOP + l])
            share = (b - a) / setting[at.DT]
            j, after = min(k, recorded.shape[1] - 1), min(k + 1, recorded.shape[1] - 1)
            for n in range(2):
                low, high, back = recorded[i, j, n], recorded[i, after, n], n * window
                bend[place + 2 * n * L + l] = low if a - back < w[at.T + l] - SAME else 0.0
                ends = b - back < w[at.T + l] + SAME
                bend[place + (2 * n + 1) * L + l] = low + share * (high - low) if ends else 0.0
