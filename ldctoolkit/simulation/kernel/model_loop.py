"""A vehicle of the designer's in the Runge-Kutta loop: the sample in pieces, between which its equations are called.

A row of `e` is what they get for a lane, as in `ldctoolkit.vehicle.vehicle_model`: the four states, the length of the
step, then speed, its rate, yaw rate of the lane and wheel angle at the start, the middle and the end of it.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from typing import Final

import numba

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
from ldctoolkit.simulation.kernel.road import HEADER, lay_point, lay_road, substeps_of

_WHOLE: Final = 1e9  # Substeps after which any segment has ended


@numba.njit(**OPTIONS)
def _moment(w, e, first, column, delta):
    """The road in the rows from `V_START` on and the wheel angle of a row, into four columns of `e`."""
    for l in range(L):
        e[first + l, column], e[first + l, column + 1] = w[data.V_START, l], w[data.DV_START, l]
        e[first + l, column + 2], e[first + l, column + 3] = w[data.LANE_START, l], w[delta, l]


@numba.njit(**OPTIONS)
def _state(w, e, first):
    for l in range(L):
        for n in range(4):
            e[first + l, n] = w[data.NEXT_E_Y + n, l]
        e[first + l, 4] = w[data.H, l]


@numba.njit(**OPTIONS)
def ask(phase, setting, w, road, k, j, segment, ramps, e, first):
    """A question about the lanes of a block; whether the wheels ramp in this segment."""
    if phase == data.ASK_AT_TRIGGER:
        lay_point(setting, w, 0.0)
        _moment(w, e, first, 5, data.WHEEL)
    elif phase == data.ASK_COMMANDED:
        begin_sample(setting, w, k)
        for n in range(4):
            w[data.V_START + n] = road[HEADER + n]
        _moment(w, e, first, 5, data.DELTA_START)
    elif phase == data.ASK_STEP:
        if j == 0:
            ramps = begin_segment(setting, w, road, segment)
        begin_substep(setting, w, j, ramps)
        for n in range(3):
            lay_point(setting, w, j + 0.5 * n)
            _moment(w, e, first, 5 + 4 * n, data.DELTA_START + n)
    elif phase == data.ASK_CUT:
        for n in range(4):
            w[data.V_START + n] = road[segment + HEADER + n]
        _moment(w, e, first, 5, data.WHEEL)
    elif phase == data.ASK_END:
        settle(setting, w)
        lay_point(setting, w, _WHOLE)
        _moment(w, e, first, 5, data.WHEEL)
    _state(w, e, first)
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
                for n in range(4):
                    w[data.NEXT_E_Y + n, l] = result[first + l, n]
                w[data.PIECE_AREA, l] += result[first + l, 4]
                w[data.PIECE_TIME, l] += w[data.H, l]
        end_piece(setting, w, k)
        if j + 1 == substeps_of(w):
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
    return lay_road(setting, k, w, 0, road, 0)
