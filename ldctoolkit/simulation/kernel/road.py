"""The road that a block of scenarios drives along: speed and lane along the substeps of a sample."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.numba_internals import OPTIONS, copy, fma
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.actuator import lay_lag
from ldctoolkit.simulation.kernel.block_table import L, length_of, rings
from ldctoolkit.vector_math import cosine, sine

# a segment of the road: its length, whether it is before T and after the delay, the length of a substep, what a lag
# leaves of a distance over both lengths, and the parabola of that over a substep; then two points a substep and one
HEADER: Final = 9 * L
POINT_SIZE: Final = 4 * L


@numba.njit(**OPTIONS)
def along(setting, w, turns):
    """Speed and its rate at the time t in `TIME`, held beyond T; on request the way since t = 0 and the lane's turn.

    v = v_0 + a t + sum b_j cos(j pi t/T), the way is its integral, and the turn that of v c, c = c_0 + (dc/T) t.
    """
    width = int(setting[data.WIDTH])
    for l in range(width):
        s, v_0, a = min(w[data.TIME + l], w[data.T + l]), w[data.V_0 + l], w[data.A_0 + l]
        way = s * fma(0.5 * a, s, v_0)
        turn = w[data.CURVATURE_RATE + l] * s * s * fma(a * (1.0 / 3.0), s, 0.5 * v_0)
        w[data.MOTION_V + l], w[data.MOTION_DV + l] = fma(a, s, v_0), a
        w[data.MOTION_WAY + l], w[data.MOTION_TURN + l] = way, fma(w[data.CURVATURE_0 + l], way, turn)
    if w[data.MODES_USED] > 0.0:
        _, _, modes, _ = rings(setting)
        for l in range(width):
            angle = w[data.PI_PER_T + l] * min(w[data.TIME + l], w[data.T + l])
            w[data.COS_1 + l], w[data.SIN_1 + l] = cosine(angle), sine(angle)
            w[data.COS_J + l], w[data.SIN_J + l] = 1.0, 0.0
        for j in range(int(w[data.MODES_USED])):
            copy(w, data.AMPLITUDE, w, modes + j * L, 1)
            _add_mode(w, j + 1.0, width)
            if turns:
                _add_turn(w, 1.0 / (math.pi * (j + 1.0)), width)
    if turns:
        for l in range(width):
            after = max(w[data.TIME + l] - w[data.T + l], 0.0) * w[data.MOTION_V + l]
            w[data.MOTION_WAY + l] += after
            curve = fma(w[data.CURVATURE_RATE + l], w[data.T + l], w[data.CURVATURE_0 + l])
            w[data.MOTION_TURN + l] = fma(after, curve, w[data.MOTION_TURN + l])


@numba.njit(**OPTIONS)
def _add_mode(w, number, width):
    """Add the mode b cos(j pi t/T) to the speed, and its derivative to the rate."""
    for l in range(width):
        cos_1, sin_1, c, d = w[data.COS_1 + l], w[data.SIN_1 + l], w[data.COS_J + l], w[data.SIN_J + l]
        c, d, b = fma(c, cos_1, -d * sin_1), fma(d, cos_1, c * sin_1), w[data.AMPLITUDE + l]
        w[data.COS_J + l], w[data.SIN_J + l] = c, d
        w[data.MOTION_V + l] = fma(b, c, w[data.MOTION_V + l])
        w[data.MOTION_DV + l] = fma(-b * number * w[data.PI_PER_T + l], d, w[data.MOTION_DV + l])


@numba.njit(**OPTIONS)
def _add_turn(w, per_angle, width):
    """Add its integral to the way, and the integral of c times it to the turn."""
    for l in range(width):
        T, slope, per_rate = w[data.T + l], w[data.CURVATURE_RATE + l], per_angle * w[data.T + l]
        curve = fma(slope, min(w[data.TIME + l], T), w[data.CURVATURE_0 + l])
        part = w[data.AMPLITUDE + l] * per_rate
        way = part * w[data.SIN_J + l]
        w[data.MOTION_WAY + l] += way
        turn = fma(way, curve, part * per_rate * slope * (w[data.COS_J + l] - 1.0))
        w[data.MOTION_TURN + l] += turn


@numba.njit(**OPTIONS)
def lay_point(setting, w, substep):
    """The road after so many substeps of a segment, into the rows from `V_START` on."""
    width = int(setting[data.WIDTH])
    for l in range(width):
        w[data.TIME + l] = w[data.SEGMENT_START + l] + min(
            substep * w[data.SUBSTEP_LENGTH + l], w[data.SEGMENT_LENGTH + l]
        )
    lay_time(setting, w)
    for l in range(width):
        w[data.DV_START + l] = w[data.MOTION_DV + l] * w[data.SEGMENT_IN_T + l]  # beyond T the speed stays


@numba.njit(**OPTIONS)
def lay_time(setting, w):
    """The road at the times in `TIME`, but for the rate of the speed."""
    along(setting, w, False)
    for l in range(int(setting[data.WIDTH])):
        v, s = w[data.MOTION_V + l], min(w[data.TIME + l], w[data.T + l])
        w[data.V_START + l], w[data.PER_V_START + l] = v, 1.0 / v
        w[data.LANE_START + l] = v * fma(w[data.CURVATURE_RATE + l], s, w[data.CURVATURE_0 + l])


@numba.njit(**OPTIONS)
def substeps_of(w):
    """Most substeps that a scenario of a block needs for a segment."""
    most = 1
    for l in range(L):
        most = max(most, int(w[data.N_SUBSTEPS + l]))
    return most


@numba.njit(**OPTIONS)
def segment_size(parts):
    """Numbers of a segment with so many substeps."""
    return HEADER + (2 * parts + 1) * POINT_SIZE


@numba.njit(**OPTIONS)
def lay_road(setting, k, w, parts, road, to):
    """Segments of sample k and the road along their substeps, from `to` on; where they end."""
    dt, switch, lag, cut = setting[data.DT], setting[data.DELAY_PART], setting[data.LAG], False
    for l in range(L):
        h, until = length_of(setting, w, l, k)
        cut |= 0.0 < until < h
    segments = 1 + int(cut) + int(switch > 0.0)
    for n in range(segments):
        for l in range(L):
            h, until = length_of(setting, w, l, k)
            inside = until if 0.0 < until < h else h
            low, high = (min(inside, switch), max(inside, switch)) if segments == 3 else (inside, h)
            if segments == 2 and not cut:
                low = switch
            first = 0.0 if n == 0 else min(low if n == 1 else high, h)
            last = h if n + 1 == segments else min(low if n == 0 else high, h)
            w[data.SEGMENT_LENGTH + l], w[data.SUBSTEP_LENGTH + l] = (
                last - first,
                (last - first) / w[data.N_SUBSTEPS + l],
            )
            w[data.SEGMENT_IN_T + l] = 1.0 if last <= until and until > 0.0 else 0.0
            w[data.SEGMENT_AFTER_DELAY + l] = 1.0 if first >= switch else 0.0
            w[data.SEGMENT_START + l] = w[data.T_0 + l] + k * dt + first
        if lag > 0.0:
            lay_lag(w, 1.0 / lag)
        copy(road, to, w, data.SEGMENT_LENGTH, 9)
        for j in range(2 * parts + 1):
            lay_point(setting, w, 0.5 * j)
            copy(road, to + HEADER + j * POINT_SIZE, w, data.V_START, 4)
        to += segment_size(parts)
    return to
