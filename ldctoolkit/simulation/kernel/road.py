"""The road that a block of scenarios drives along: speed and lane along the substeps of a sample."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lanes import any_lane, ceil, fma, largest, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.actuator import lay_lag
from ldctoolkit.simulation.kernel.block_table import SAME, lengths, rings
from ldctoolkit.vector_math import cosine, sine

# a segment of the road, in this order: its length, whether it is before T and after the delay, substeps, the length of
# one, what a lag leaves of a distance over both lengths, and the parabola of that over a substep; then two points a
# substep and one: speed, 1/speed, yaw rate of the lane
HEADER: Final = data.HEADER
IN_T: Final = 1
POINT: Final = 3


@numba.njit(**OPTIONS)
def along(setting, w, t, turns):
    """Speed and its rate at times t, held beyond T; on request the way since t = 0 and the lane's turn.

    v = v_0 + a t + sum b_j cos(j pi t/T), the way is its integral, and the turn that of v c, c = c_0 + (dc/T) t.
    """
    T, c_0, slope = w[data.T], w[data.CURVATURE_0], w[data.CURVATURE_RATE]
    s, v_0, a = min(t, T), w[data.V_0], w[data.A_0]
    v, dv, way = fma(a, s, v_0), a, s * fma(0.5 * a, s, v_0)
    turn = fma(c_0, way, slope * s * s * fma(a * (1.0 / 3.0), s, 0.5 * v_0))
    used = int(w[data.MODES_USED, 0])
    if used > 0:
        _, _, modes, _ = rings(setting)
        cos_1, sin_1 = cosine(w[data.PI_PER_T] * s), sine(w[data.PI_PER_T] * s)
        cos_j, sin_j, curve = fma(cos_1, 0.0, 1.0), sin_1 * 0.0, fma(slope, s, c_0)
        for j in range(used):
            cos_j, sin_j, b = fma(cos_j, cos_1, -sin_j * sin_1), fma(sin_j, cos_1, cos_j * sin_1), w[modes + j]
            v, dv = fma(b, cos_j, v), fma(-b * (j + 1.0) * w[data.PI_PER_T], sin_j, dv)
            if turns:
                per_rate = 1.0 / (math.pi * (j + 1.0)) * T
                way += b * per_rate * sin_j
                turn += fma(b * per_rate * sin_j, curve, b * per_rate * per_rate * slope * (cos_j - 1.0))
    if turns:
        after = max(t - T, 0.0) * v
        way, turn = way + after, fma(after, fma(slope, T, c_0), turn)
    return v, dv, way, turn


@numba.njit(**OPTIONS)
def motion_at(setting, w, t):
    """Speed, its rate before T, and yaw rate of the lane at times t."""
    v, dv, _, _ = along(setting, w, t, False)
    return v, dv, v * fma(w[data.CURVATURE_RATE], min(t, w[data.T]), w[data.CURVATURE_0])


@numba.njit(**OPTIONS)
def lay_road(setting, k, w, points, road, to):
    """Segments of sample k, on request with the points along their substeps, from `to` on; where they end.

    A segment has as many substeps as its part of the sample asks for; without points, those of a whole sample.
    """
    dt, switch, lag = setting[data.DT], setting[data.DELAY_PART], setting[data.LAG]
    h, until = lengths(setting, w, k)
    cuts = (until > 0.0) & (until < h)
    inside, cut = select(cuts, until, h), any_lane(cuts)
    segments = 1 + int(cut) + int(switch > 0.0)
    first, low, high = h * 0.0, inside, h
    if segments == 3:
        low, high = min(inside, switch), max(inside, switch)
    elif not cut:
        low = min(switch, h)
    for n in range(segments):
        last = h
        if n + 1 < segments:
            last = min(low, h) if n == 0 else min(high, h)
        length = last - first
        share = length / dt if points else select(length > 0.0, 1.0, 0.0)
        parts = max(ceil(w[data.SUBSTEPS_A_SAMPLE] * share - SAME), 1.0)
        w[data.SEGMENT_LENGTH], w[data.N_SUBSTEPS], w[data.SUBSTEP_LENGTH] = length, parts, length / parts
        w[data.SEGMENT_IN_T] = select((last <= until) & (until > 0.0), 1.0, 0.0)
        w[data.SEGMENT_AFTER_DELAY] = select(first >= switch, 1.0, 0.0)
        if lag > 0.0:
            lay_lag(w, 1.0 / lag)
        for row in range(HEADER):
            road[to + row] = w[data.SEGMENT_LENGTH + row]
        to += HEADER
        for j in range(2 * int(largest(parts)) + 1 if points else 0):
            # the end is one number, however the segments of the block are cut
            within = select(2.0 * parts > j, fma(0.5 * j, w[data.SUBSTEP_LENGTH], first), last)
            t = w[data.T_0] + k * dt + within
            v, _, lane = motion_at(setting, w, t)
            road[to], road[to + 1], road[to + 2] = v, 1.0 / v, lane
            to += POINT
        first = last
    return to
