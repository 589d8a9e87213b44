"""The table of a block of lanes: what eight scenarios need side by side, a row a number, a column a scenario.

All of it is one array with fixed distances, so that the compiler sees that rows do not overlap and works on the lanes
of a row together.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba

from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.plant import OPTIONS, curvature

L: Final = data.LANES
WRONG: Final = 2.0

# rows of the lane table, each L wide: state, command, next state, scores ...
R_X = 0
R_U = 4  # last command
R_D = 5  # command; before a step, its part from several lookahead times
R_N = 6  # next state
R_RIGHT = 10
R_LEFT = 11
R_SIGNED = 12
R_S = 13  # scores
R_COUNTED = R_S + data.SCORES  # 1 before T
R_ALIVE = R_COUNTED + 1
R_R1 = R_ALIVE + 1  # lane yaw rate at the last sample that was looked at
R_SINGLE = R_R1 + 1  # 1 where a step was driven by itself
R_FLAG = R_SINGLE + 1  # 1 where a step needs a closer look, WRONG where the command was not finite
R_PAST_RIGHT = R_FLAG + 1
R_PAST_LEFT = R_PAST_RIGHT + 1
# ... and the scenario
R_T = R_PAST_LEFT + 1
R_PER_T = R_T + 1  # 1/T
R_START = R_PER_T + 1
R_C0 = R_START + 1  # v c_0
R_DC = R_C0 + 1  # v dc
R_BEFORE = R_DC + 1
R_P = R_BEFORE + 1  # the exact step: A[:, 1:4] row by row, and the rest
R_B = R_P + data.EX_B
R_E0 = R_P + data.EX_E_0
R_E1 = R_P + data.EX_E_1
R_AX = R_P + data.EX_X
R_AD = R_P + data.EX_DELTA
R_AR0 = R_P + data.EX_R_0
R_AR1 = R_P + data.EX_R_1
R_Q = R_P + data.EXACT  # row of a_y: 3 states, delta, yaw rate
R_F = R_Q + 5
R_FU = R_F + 4
R_FI = R_FU + 1  # weight of the integral of e_y
R_GR = R_FI + 1  # weights of yaw rate and turn at a single lookahead time
R_GH = R_GR + 1
R_Z = R_GH + 1  # integral of e_y at the samples
ROWS: Final = R_Z + 1


@numba.njit(**OPTIONS)
def load(scene, exact, block, w):
    """Scenario data of a block; lanes beyond the last scenario repeat it and are never alive."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        v = scene[i, data.SPEED]
        w[R_T * L + l] = scene[i, data.T_END]
        w[R_PER_T * L + l] = 1.0 / scene[i, data.T_END]
        w[R_START * L + l] = scene[i, data.START]
        for n in range(data.EXACT):
            w[(R_P + n) * L + l] = exact[0, i, n]
        w[(R_Q + 0) * L + l] = scene[i, data.A_11]
        w[(R_Q + 1) * L + l] = scene[i, data.A_12]
        w[(R_Q + 2) * L + l] = scene[i, data.A_13]
        w[(R_Q + 3) * L + l] = scene[i, data.B_1]
        w[(R_Q + 4) * L + l] = scene[i, data.E_1] + v
        before = scene[i, data.A_11] * scene[i, data.X_0 + 1] + scene[i, data.A_12] * scene[i, data.X_0 + 2]
        before += scene[i, data.A_13] * scene[i, data.X_0 + 3] + scene[i, data.B_1] * scene[i, data.DELTA_0]
        w[R_BEFORE * L + l] = before + (scene[i, data.E_1] + v) * (v * curvature(scene, i, scene[i, data.START]))


@numba.njit(**OPTIONS)
def begin(scene, setting, law, times, design, block, w, g):
    """Start state and law of a block."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        alive = block * L + l < m and scene[i, data.STEPS] > 0.0
        v = scene[i, data.SPEED] if alive else 0.0
        w[R_C0 * L + l], w[R_DC * L + l] = v * scene[i, data.C_0], v * scene[i, data.DC]
        start = scene[i, data.START] * w[R_PER_T * L + l]
        w[R_R1 * L + l] = w[R_C0 * L + l] + w[R_DC * L + l] * min(start, 1.0)
        for n in range(4):
            w[(R_X + n) * L + l] = scene[i, data.X_0 + n] if alive else 0.0
            w[(R_F + n) * L + l] = law[design, i, data.LAW_F + n] if alive else 0.0
        w[R_U * L + l] = scene[i, data.DELTA_0] if alive else 0.0
        w[R_FU * L + l] = law[design, i, data.LAW_U] if alive else 0.0
        w[R_FI * L + l] = law[design, i, data.LAW_I] if alive else 0.0
        w[R_Z * L + l] = 0.0
        single = times.shape[1] == 1
        w[R_GR * L + l] = law[design, i, data.LAW] if alive and single else 0.0
        w[R_GH * L + l] = law[design, i, data.LAW + 1] if alive and single else 0.0
        for j in range(2 * times.shape[1]):
            g[j * L + l] = law[design, i, data.LAW + j] if alive else 0.0
        w[R_D * L + l] = 0.0
        for n in range(data.SCORES):
            w[(R_S + n) * L + l] = 0.0
        w[(R_S + data.DEEP) * L + l] = scene[i, data.X_0]
        w[(R_S + data.FRONT) * L + l] = scene[i, data.X_0] + setting[data.AXLE] * scene[i, data.X_0 + 2]
        w[(R_S + data.BACK) * L + l] = math.inf if alive else 0.0
        w[(R_S + data.OVER) * L + l] = -scene[i, data.X_0]
        w[R_ALIVE * L + l] = 1.0 if alive else 0.0
        w[R_COUNTED * L + l] = 0.0


@numba.njit(**OPTIONS)
def leave(w, g, l, rows, out, design, i, score_only):
    """Take the scores of a lane that has ended and empty it: everything in it stays 0."""
    for n in range(1 if score_only else data.SCORES):
        out[design, n, i] = w[(R_S + n) * L + l]
    for n in range(4):
        w[(R_X + n) * L + l] = w[(R_F + n) * L + l] = w[(R_N + n) * L + l] = 0.0
    for j in range(rows):
        g[j * L + l] = 0.0
    w[R_FI * L + l] = w[R_Z * L + l] = 0.0
    w[R_U * L + l] = w[R_D * L + l] = w[R_FU * L + l] = w[R_COUNTED * L + l] = w[R_ALIVE * L + l] = 0.0
    w[R_C0 * L + l] = w[R_DC * L + l] = w[R_R1 * L + l] = w[R_RIGHT * L + l] = w[R_LEFT * L + l] = 0.0
    w[(R_S + data.BACK) * L + l] = 0.0
