"""A vehicle of the designer's in the Runge-Kutta loop: the sample in pieces, between which its equations are called.

A row of `e` is what they get for a lane, as in `ldctoolkit.vehicle.vehicle_model`: the four states, the length of the
step, then speed, its rate, yaw rate of the lane and wheel angle at the start, the middle and the end of it.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import numba

from ldctoolkit.lanes import largest, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import block_table, data
from ldctoolkit.simulation.kernel.block_table import L
from ldctoolkit.simulation.kernel.rk4_loop import (
    at_T,
    begin_sample,
    begin_segment,
    begin_substep,
    correct_paths,
    end_piece,
    end_sample,
    end_segment,
    settle,
)
from ldctoolkit.simulation.kernel.road import IN_T, lay_road, motion_at


@numba.njit(**OPTIONS)
def _moment(setting, w, t, in_T, e, first, column, delta):
    """The road at times t, up to T, and the wheel angle of a row, into four columns of `e`."""
    v, dv, lane = motion_at(setting, w, t)
    w[data.ROAD_V], w[data.ROAD_DV], w[data.ROAD_LANE] = v, dv * in_T, lane
    for l in range(L):
        e[first + l, column], e[first + l, column + 1] = w[data.ROAD_V, l], w[data.ROAD_DV, l]
        e[first + l, column + 2], e[first + l, column + 3] = w[data.ROAD_LANE, l], w[delta, l]


@numba.njit(**OPTIONS)
def ask(phase, setting, w, road, k, j, segment, ramps, e, first):
    """A question about the lanes of a block; whether the wheels ramp in this segment."""
    if phase == data.ASK_AT_TRIGGER:
        _moment(setting, w, w[data.T_0], select(w[data.T] > w[data.T_0], 1.0, 0.0), e, first, 5, data.WHEEL)
    elif phase == data.ASK_COMMANDED:
        begin_sample(setting, w, k)
        _moment(setting, w, w[data.PIECE_START], road[IN_T], e, first, 5, data.DELTA_START)
    elif phase == data.ASK_STEP:
        if j == 0:
            ramps = begin_segment(setting, w, road, segment)
        begin_substep(setting, w, j, ramps)
        for n in range(3):
            within = min((j + 0.5 * n) * w[data.SUBSTEP_LENGTH], w[data.SEGMENT_LENGTH])
            t = w[data.SEGMENT_START] + within
            _moment(setting, w, t, w[data.SEGMENT_IN_T], e, first, 5 + 4 * n, data.DELTA_START + n)
    elif phase == data.ASK_CUT:
        _moment(setting, w, w[data.PIECE_START], road[segment + IN_T], e, first, 5, data.WHEEL)
    elif phase == data.ASK_END:
        settle(setting, w)
        _moment(setting, w, w[data.PIECE_START], w[data.SEGMENT_IN_T], e, first, 5, data.WHEEL)
    for l in range(L):
        for n in range(4):
            e[first + l, n] = w[data.NEXT_E_Y + n, l]
        e[first + l, 4] = w[data.H, l]
    return ramps


@numba.njit(**OPTIONS)
def _take_a_y(w, e, result, first, to):
    """a_y from the answer, and relative to the road two rows further."""
    for l in range(L):
        a_y = result[first + l, 0] if w[data.ALIVE, l] > 0.0 else 0.0  # a lane that has ended stays finite
        w[to, l], w[to + 2, l] = a_y, a_y - e[first + l, 5] * e[first + l, 7]


@numba.njit(**OPTIONS)
def take(phase, setting, w, road, k, j, segment, paths, e, result, first):
    """What follows from the answer: scores, paths, lanes that end."""
    if phase == data.AT_TRIGGER:
        for l in range(L):
            w[data.A_Y_BEFORE, l] = result[first + l, 0]
    elif phase == data.COMMANDED:
        _take_a_y(w, e, result, first, data.A_Y_START)
        correct_paths(w, paths)
    elif phase == data.STEPPED:
        for l in range(L):
            if w[data.H, l] > 0.0:
                psi, psi_rate, h = w[data.NEXT_E_PSI, l], w[data.NEXT_E_PSI_RATE, l], w[data.H, l]
                change = psi_rate - result[first + l, 3]
                w[data.PIECE_TURN, l] += h * (0.5 * (psi + result[first + l, 2]) + h * change / 12.0)
                for n in range(4):
                    w[data.NEXT_E_Y + n, l] = result[first + l, n]
                w[data.PIECE_AREA, l] += result[first + l, 4]
                w[data.PIECE_TIME, l] += w[data.H, l]
        end_piece(setting, w, k)
        if j + 1 == largest(w[data.N_SUBSTEPS]):
            end_segment(setting, w)
    elif phase == data.AT_CUT:
        _take_a_y(w, e, result, first, data.A_Y_START_PAST)
        at_T(w, road, segment, paths)
    elif phase == data.AT_END:
        _take_a_y(w, e, result, first, data.A_Y_END)
        end_sample(setting, w, k, paths)


@numba.njit(**OPTIONS)
def begin(setting, recorded, block, w, k, command, road):
    """Commands and road of sample k; where the road ends."""
    for l in range(min(L, command.shape[0] - block * L)):
        w[data.COMMAND, l] = command[block * L + l] if w[data.ALIVE, l] > 0.0 else 0.0
    block_table.lay_bend(setting, recorded, block, k, w, w, data.BEND_START)
    return lay_road(setting, k, w, False, road, 0)
