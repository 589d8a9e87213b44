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
import numpy as np

from ldctoolkit.simulation.kernel.data import (
    A_11,
    A_12,
    A_13,
    A_Y,
    AREA,
    B_1,
    BACK,
    DEEP,
    DELTA,
    E_1,
    EFFORT,
    FRONT,
    JERK,
    OVER,
    RATE,
    SCORES,
    TRAVEL,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS
from ldctoolkit.simulation.kernel.sample import drive, earlier, length

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
_PAST_RIGHT = _R1 + 1
_PAST_LEFT = _PAST_RIGHT + 1
# ... and the scenario
_T = _PAST_LEFT + 1
_START = _T + 1
_V = _START + 1
_C0 = _V + 1  # v c_0
_DC = _C0 + 1  # v dc
_BEFORE = _DC + 1
_P = _BEFORE + 1  # A[:, 1:4], row by row
_B = _P + 12
_E0 = _B + 4
_E1 = _E0 + 4
_AX = _E1 + 4
_AD = _AX + 4
_AR0 = _AD + 1
_AR1 = _AR0 + 1
_Q = _AR1 + 1  # row of a_y: 3 states, delta, yaw rate
_F = _Q + 5
_FU = _F + 4
ROWS: Final = _FU + 1


@numba.njit(**OPTIONS)
def _load(scene, exact, block, w):
    """Scenario data of a block; lanes beyond the last scenario repeat it and are never alive."""
    m = scene.start.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        v = scene.v[i]
        w[_T * L + l] = scene.T[i]
        w[_START * L + l] = scene.start[i]
        w[_V * L + l] = v
        w[_C0 * L + l] = v * scene.c_0[i]
        w[_DC * L + l] = v * scene.dc[i]
        w[_BEFORE * L + l] = scene.a_before[i]
        for a in range(4):
            for b in range(3):
                w[(_P + 3 * a + b) * L + l] = exact.A[i, a, b + 1]
            w[(_B + a) * L + l] = exact.B[i, a]
            w[(_E0 + a) * L + l] = exact.E_0[i, a]
            w[(_E1 + a) * L + l] = exact.E_1[i, a]
            w[(_AX + a) * L + l] = exact.area_x[i, a]
        w[_AD * L + l] = exact.area_delta[i]
        w[_AR0 * L + l] = exact.area_r_0[i]
        w[_AR1 * L + l] = exact.area_r_1[i]
        q = scene.linear[i]
        w[(_Q + 0) * L + l] = q[A_11]
        w[(_Q + 1) * L + l] = q[A_12]
        w[(_Q + 2) * L + l] = q[A_13]
        w[(_Q + 3) * L + l] = q[B_1]
        w[(_Q + 4) * L + l] = q[E_1] + v


@numba.njit(**OPTIONS)
def _begin(scene, setting, law, design, block, w, g):
    """Start state and law of a block."""
    m = scene.start.shape[0]
    p = law.times.shape[1]
    for l in range(L):
        i = min(block * L + l, m - 1)
        alive = block * L + l < m and scene.steps[i] > 0
        for n in range(4):
            w[(_X + n) * L + l] = scene.x_0[i, n] if alive else 0.0
            w[(_F + n) * L + l] = law.F[design, i, n] if alive else 0.0
        w[_U * L + l] = scene.delta_0[i] if alive else 0.0
        w[_FU * L + l] = law.f_u[design, i] if alive else 0.0
        for j in range(p):
            g[(2 * j) * L + l] = law.G_yaw_rate[design, i, j] if alive else 0.0
            g[(2 * j + 1) * L + l] = law.G_heading[design, i, j] if alive else 0.0
        for n in range(SCORES):
            w[(_S + n) * L + l] = 0.0
        w[(_S + DEEP) * L + l] = scene.x_0[i, 0]
        w[(_S + FRONT) * L + l] = scene.x_0[i, 0] + setting.l_f * scene.x_0[i, 2]
        w[(_S + BACK) * L + l] = math.inf if alive else 0.0
        w[(_S + OVER) * L + l] = -scene.x_0[i, 0]
        w[_COUNTED * L + l] = 1.0 if alive and (scene.full[i] > 0 or scene.rest[i] > 0.0) else 0.0
        w[_ALIVE * L + l] = 1.0 if alive else 0.0


@numba.njit(**OPTIONS)
def _command(setting, law, design, k, w, g):
    """Command of every lane at sample k; True if one is not finite."""
    t_k = k * setting.dt
    for l in range(L):
        d = w[_FU * L + l] * w[_U * L + l]
        for n in range(4):
            d += w[(_F + n) * L + l] * w[(_X + n) * L + l]
        w[_D * L + l] = d
    for j in range(law.times.shape[1]):
        ahead = law.times[design, j]
        for l in range(L):
            T = w[_T * L + l]
            t_0 = w[_START * L + l] + t_k
            t_1 = t_0 + ahead
            in_0, in_1 = min(t_0, T), min(t_1, T)
            inside = 0.5 * (in_1 * in_1 - in_0 * in_0) / T
            turn = w[_C0 * L + l] * (t_1 - t_0) + w[_DC * L + l] * (inside + (t_1 - in_1) - (t_0 - in_0))
            rate = w[_C0 * L + l] + w[_DC * L + l] * (in_1 / T)
            w[_D * L + l] += g[(2 * j) * L + l] * rate + g[(2 * j + 1) * L + l] * turn
    wrong = False
    for l in range(L):
        wrong |= not abs(w[_D * L + l]) < math.inf
    return wrong


@numba.njit(**OPTIONS)
def _step(setting, k, w):
    """One whole step of every lane; True if something rare happens in one."""
    t_k, t_next, offset, bound, l_f = k * setting.dt, (k + 1) * setting.dt, setting.offset, setting.bound, setting.l_f
    rare = False
    for l in range(L):
        T = w[_T * L + l]
        r_0 = w[_C0 * L + l] + w[_DC * L + l] * min((w[_START * L + l] + t_k) / T, 1.0)
        r_1 = w[_C0 * L + l] + w[_DC * L + l] * min((w[_START * L + l] + t_next) / T, 1.0)
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
        f_0, f_1 = x_1 + l_f * x_3, n_1 + l_f * n_3
        rare |= not abs(n_0) <= bound
        rare |= (x_0 * n_0 < 0.0) | (x_1 * n_1 < 0.0) | (f_0 * f_1 < 0.0)
        rare |= (w[(_S + BACK) * L + l] == math.inf) & (n_0 < offset)
    return rare


@numba.njit(**OPTIONS)
def _is_rare(setting, w, l):
    """What `_step` asks of all lanes together, of one."""
    l_f = setting.l_f
    x_0, x_1, x_3 = w[_X * L + l], w[(_X + 1) * L + l], w[(_X + 3) * L + l]
    n_0, n_1, n_3 = w[_N * L + l], w[(_N + 1) * L + l], w[(_N + 3) * L + l]
    turns = x_0 * n_0 < 0.0 or x_1 * n_1 < 0.0 or (x_1 + l_f * x_3) * (n_1 + l_f * n_3) < 0.0
    back = w[(_S + BACK) * L + l] == math.inf and n_0 < setting.offset
    return turns or back or not abs(n_0) <= setting.bound


@numba.njit(**OPTIONS)
def _alone(scene, setting, state, paths, i, l, k, w, work):
    """Step k of one lane through `sample.drive`; False if it diverged."""
    for n in range(4):
        state.x[i, n] = w[(_X + n) * L + l]
    for n in range(SCORES):
        state.score[i, n] = w[(_S + n) * L + l]
    state.wheel[i] = w[_U * L + l]
    d = w[_D * L + l]
    whole = drive(scene, setting, state, paths, i, k, d, d, work)
    for n in range(4):
        w[(_N + n) * L + l] = state.x[i, n]
    for n in range(SCORES):
        w[(_S + n) * L + l] = state.score[i, n]
    w[_RIGHT * L + l], w[_LEFT * L + l] = work.limits[0], work.limits[1]
    return whole


@numba.njit(**OPTIONS)
def _past(left, right, position, from_left, w, row):
    """Lateral acceleration of all lanes at an earlier position, as `sample.earlier`."""
    size = left.shape[0]
    j = int(math.floor(position + 1e-9))
    part = position - j
    if position < -1e-9 or (part <= 1e-9 and from_left and j == 0):
        for l in range(L):
            w[row * L + l] = w[_BEFORE * L + l]
    elif part <= 1e-9:
        source = left[j % size] if from_left else right[j % size]
        for l in range(L):
            w[row * L + l] = source[l]
    else:
        start, end = right[j % size], left[(j + 1) % size]
        for l in range(L):
            w[row * L + l] = start[l] + part * (end[l] - start[l])


@numba.njit(**OPTIONS)
def _score(setting, w, single):
    """Scores of a step in every lane; `single` lanes have theirs but for acceleration, jerk and rate."""
    dt, l_f, per_window, per_step = setting.dt, setting.l_f, 1.0 / (setting.window * setting.dt), 1.0 / setting.dt
    for l in range(L):
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
        for n in range(4):
            w[(_X + n) * L + l] = w[(_N + n) * L + l]


@numba.njit(**OPTIONS)
def _stop(w, g, l, p):
    """Empty a lane that has ended: everything in it stays 0."""
    for n in range(4):
        w[(_X + n) * L + l] = w[(_F + n) * L + l] = w[(_N + n) * L + l] = 0.0
    for j in range(2 * p):
        g[j * L + l] = 0.0
    w[_U * L + l] = w[_D * L + l] = w[_FU * L + l] = w[_COUNTED * L + l] = w[_ALIVE * L + l] = 0.0
    w[(_S + BACK) * L + l] = 0.0


@numba.njit(**OPTIONS)
def drive_block(scene, exact, setting, law, state, paths, block, w, g, left, right, single, work, score, diverged, failed):
    """Every design of a law on one block of scenarios; scores into (d, m, SCORES)."""
    m, first, p = scene.start.shape[0], block * L, law.times.shape[1]
    _load(scene, exact, block, w)
    c_0 = np.empty(L)
    dc = np.empty(L)
    for l in range(L):
        c_0[l], dc[l] = w[_C0 * L + l], w[_DC * L + l]
    last = min(first + L, m)
    # the rest of a step that T cuts, and each scenario's last step, are not whole
    most = 0
    for i in range(first, last):
        most = max(most, scene.steps[i])
    for design in range(law.F.shape[0]):
        _begin(scene, setting, law, design, block, w, g)
        for l in range(L):
            w[_C0 * L + l], w[_DC * L + l] = c_0[l], dc[l]
        for k in range(most):
            if _command(setting, law, design, k, w, g):
                for l in range(L):
                    if not abs(w[_D * L + l]) < math.inf:
                        w[_D * L + l] = w[_U * L + l]
                        if first + l < m and w[_ALIVE * L + l] > 0.0:
                            failed[design, first + l] += 1
            rare = _step(setting, k, w)
            for l in range(L):
                single[l] = 0.0
            for l in range(last - first):
                i = first + l
                if w[_ALIVE * L + l] == 0.0:
                    continue
                h, counted = length(scene, setting, i, k)
                w[_COUNTED * L + l] = 1.0 if counted > 0.0 else 0.0
                if h < setting.dt or 0.0 < counted < h or (rare and _is_rare(setting, w, l)):
                    single[l] = 1.0
                    if not _alone(scene, setting, state, paths, i, l, k, w, work):
                        diverged[design, i] = True
                        for n in range(SCORES):
                            score[design, i, n] = w[(_S + n) * L + l]
                        _stop(w, g, l, p)
                        w[_C0 * L + l] = w[_DC * L + l] = 0.0
                        w[_RIGHT * L + l] = w[_LEFT * L + l] = 0.0
            size = left.shape[0]
            for l in range(L):
                right[k % size, l] = w[_RIGHT * L + l]
                left[(k + 1) % size, l] = w[_LEFT * L + l]
            _past(left, right, k - setting.window, False, w, _PAST_RIGHT)
            _past(left, right, k + 1 - setting.window, True, w, _PAST_LEFT)
            for l in range(last - first):
                if single[l] > 0.0 and w[_ALIVE * L + l] > 0.0 and k + 1 == scene.steps[first + l]:
                    _past_of_one(scene, setting, first + l, l, k, left, right, w)
            _score(setting, w, single)
            for l in range(last - first):
                i = first + l
                if w[_ALIVE * L + l] > 0.0 and k + 1 == scene.steps[i]:
                    for n in range(SCORES):
                        score[design, i, n] = w[(_S + n) * L + l]
                    _stop(w, g, l, p)
                    w[_C0 * L + l] = w[_DC * L + l] = 0.0


@numba.njit(**OPTIONS)
def _past_of_one(scene, setting, i, l, k, left, right, w):
    """The same for a last step that is not whole."""
    h, _ = length(scene, setting, i, k)
    arrival = k + (h / setting.dt if h < setting.dt else 1.0)
    past = earlier(left[:, l], right[:, l], w[_BEFORE * L + l], arrival - setting.window, True)
    w[_PAST_LEFT * L + l] = past
