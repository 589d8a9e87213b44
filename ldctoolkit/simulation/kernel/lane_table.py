"""The table of a block of lanes: what eight scenarios need side by side, a row a number, a column a scenario.

All of it is one array with fixed distances, so that the compiler sees that rows do not overlap and works on the lanes
of a row together.
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
    A_31,
    A_32,
    A_33,
    A_BEFORE,
    AXLE,
    B_1,
    B_3,
    BACK,
    C_0,
    DC,
    DEEP,
    DELTA_0,
    DT,
    E_1,
    E_3,
    EX_B,
    EX_DELTA,
    EX_E_0,
    EX_E_1,
    EX_R_0,
    EX_R_1,
    EX_X,
    EXACT,
    FASTEST,
    FRONT,
    LAW,
    LAW_F,
    LAW_I,
    LAW_U,
    OVER,
    SCORES,
    SPEED,
    START,
    STEPS,
    T_END,
    X_0,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, substeps

LANES: Final = 8
L: Final = LANES
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
R_COUNTED = R_S + SCORES  # 1 before T
R_ALIVE = R_COUNTED + 1
R_R1 = R_ALIVE + 1  # lane yaw rate at the last sample that was looked at
R_SINGLE = R_R1 + 1  # 1 where a step was driven by itself, -1 where that is left to `drive_alone`
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
R_B = R_P + EX_B
R_E0 = R_P + EX_E_0
R_E1 = R_P + EX_E_1
R_AX = R_P + EX_X
R_AD = R_P + EX_DELTA
R_AR0 = R_P + EX_R_0
R_AR1 = R_P + EX_R_1
R_Q = R_P + EXACT  # row of a_y: 3 states, delta, yaw rate
R_STIFF = R_Q + 5  # 1 where the fastest mode dies within a step
R_REACH = R_STIFF + 1  # a step in units of the fastest mode's time constant
R_W = R_REACH + 1  # row of e_psi'': 3 states, delta, yaw rate
R_E = R_W + 5  # weight of the yaw rate in e_y''
R_F = R_E + 1
R_FU = R_F + 4
R_FI = R_FU + 1  # weight of the integral of e_y
R_GR = R_FI + 1  # weights of yaw rate and turn at a single lookahead time
R_GH = R_GR + 1
# ... and a step that is cut: lengths, then the state before and after a part of it, and the terms of its series
R_H = R_GH + 1  # [s] length; 0 where the step is whole
R_UNTIL = R_H + 1  # [s] of it before T
R_PART = R_UNTIL + 1
R_AT = R_PART + 1  # time at its start
R_O = R_AT + 1  # 4 rows
R_M = R_O + 4  # 4 rows, then the integral of e_y
R_SUM = R_M + 5  # integral of |e_y|
R_K = R_SUM + 1  # terms of e_y', e_psi, e_psi'
R_IN = R_K + 3  # what the lane's yaw rate brings to the second term of e_y' and e_psi'
R_SMALL = R_IN + 2
R_Z = R_SMALL + 1  # integral of e_y at the samples
ROWS: Final = R_Z + 1


@numba.njit(**OPTIONS)
def load(scene, setting, exact, block, w):
    """Scenario data of a block; lanes beyond the last scenario repeat it and are never alive."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        v = scene[i, SPEED]
        w[R_T * L + l] = scene[i, T_END]
        w[R_PER_T * L + l] = 1.0 / scene[i, T_END]
        w[R_START * L + l] = scene[i, START]
        w[R_BEFORE * L + l] = scene[i, A_BEFORE]
        for n in range(EXACT):
            w[(R_P + n) * L + l] = exact[i, n]
        w[(R_Q + 0) * L + l] = scene[i, A_11]
        w[(R_Q + 1) * L + l] = scene[i, A_12]
        w[(R_Q + 2) * L + l] = scene[i, A_13]
        w[(R_Q + 3) * L + l] = scene[i, B_1]
        w[(R_Q + 4) * L + l] = scene[i, E_1] + v
        w[R_W * L + l], w[(R_W + 1) * L + l], w[(R_W + 2) * L + l] = scene[i, A_31], scene[i, A_32], scene[i, A_33]
        w[(R_W + 3) * L + l], w[(R_W + 4) * L + l] = scene[i, B_3], scene[i, E_3]
        w[R_E * L + l] = scene[i, E_1]
        w[R_REACH * L + l] = setting[DT] * scene[i, FASTEST] / v
        w[R_STIFF * L + l] = 1.0 if substeps(scene, setting, i, scene[i, START], setting[DT], 0.0) > 1 else 0.0


@numba.njit(**OPTIONS)
def begin(scene, setting, law, times, design, block, w, g):
    """Start state and law of a block."""
    m = scene.shape[0]
    for l in range(L):
        i = min(block * L + l, m - 1)
        alive = block * L + l < m and scene[i, STEPS] > 0.0
        v = scene[i, SPEED] if alive else 0.0
        w[R_C0 * L + l], w[R_DC * L + l] = v * scene[i, C_0], v * scene[i, DC]
        start = scene[i, START] * w[R_PER_T * L + l]
        w[R_R1 * L + l] = w[R_C0 * L + l] + w[R_DC * L + l] * min(start, 1.0)
        for n in range(4):
            w[(R_X + n) * L + l] = scene[i, X_0 + n] if alive else 0.0
            w[(R_F + n) * L + l] = law[design, i, LAW_F + n] if alive else 0.0
        w[R_U * L + l] = scene[i, DELTA_0] if alive else 0.0
        w[R_FU * L + l] = law[design, i, LAW_U] if alive else 0.0
        w[R_FI * L + l] = law[design, i, LAW_I] if alive else 0.0
        w[R_Z * L + l] = 0.0
        single = times.shape[1] == 1
        w[R_GR * L + l] = law[design, i, LAW] if alive and single else 0.0
        w[R_GH * L + l] = law[design, i, LAW + 1] if alive and single else 0.0
        for j in range(2 * times.shape[1]):
            g[j * L + l] = law[design, i, LAW + j] if alive else 0.0
        w[R_D * L + l] = 0.0
        for n in range(SCORES):
            w[(R_S + n) * L + l] = 0.0
        w[(R_S + DEEP) * L + l] = scene[i, X_0]
        w[(R_S + FRONT) * L + l] = scene[i, X_0] + setting[AXLE] * scene[i, X_0 + 2]
        w[(R_S + BACK) * L + l] = math.inf if alive else 0.0
        w[(R_S + OVER) * L + l] = -scene[i, X_0]
        w[R_ALIVE * L + l] = 1.0 if alive else 0.0
        w[R_COUNTED * L + l] = 0.0


@numba.njit(**OPTIONS)
def leave(w, g, l, rows, out, design, i, score_only):
    """Take the scores of a lane that has ended and empty it: everything in it stays 0."""
    for n in range(1 if score_only else SCORES):
        out[design, n, i] = w[(R_S + n) * L + l]
    for n in range(4):
        w[(R_X + n) * L + l] = w[(R_F + n) * L + l] = w[(R_N + n) * L + l] = 0.0
    for j in range(rows):
        g[j * L + l] = 0.0
    w[R_FI * L + l] = w[R_Z * L + l] = 0.0
    w[R_U * L + l] = w[R_D * L + l] = w[R_FU * L + l] = w[R_COUNTED * L + l] = w[R_ALIVE * L + l] = 0.0
    w[R_C0 * L + l] = w[R_DC * L + l] = w[R_R1 * L + l] = w[R_RIGHT * L + l] = w[R_LEFT * L + l] = 0.0
    w[(R_S + BACK) * L + l] = 0.0
