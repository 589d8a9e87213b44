"""The road that a block of scenarios drives along: speed and lane along the substeps of a sample."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lanes import any_lane, fma, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.actuator import lay_lag
from ldctoolkit.simulation.kernel.block_table import L, lengths, rings
from ldctoolkit.vector_math import cosine, sine

# a segment of the road: its length, whether it is before T and after the delay, the length of a substep, what a lag
# leaves of a distance over both lengths, and the parabola of that over a substep; then two points a substep and one
HEADER: Final = 9
POINT_SIZE: Final = 4


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
def lay_point(setting, w, substep):
    """The road after so many substeps of a segment, into the rows from `V_START` on."""
    t = w[data.SEGMENT_START] + min(substep * w[data.SUBSTEP_LENGTH], w[data.SEGMENT_LENGTH])
    dv = lay_time(setting, w, t)
    w[data.DV_START] = dv * w[data.SEGMENT_IN_T]  # beyond T the speed stays


@numba.njit(**OPTIONS)
def lay_time(setting, w, t):
    """The road at times t; the rate of the speed there."""
    v, dv, _, _ = along(setting, w, t, False)
    w[data.V_START], w[data.PER_V_START] = v, 1.0 / v
    w[data.LANE_START] = v * fma(w[data.CURVATURE_RATE], min(t, w[data.T]), w[data.CURVATURE_0])
    return dv


@numba.njit(**OPTIONS)
def substeps_of(w):
    """Most substeps that a scenario of a block needs for a segment."""
    most = 1
    for l in range(L):
        most = max(most, int(w[data.N_SUBSTEPS, l]))
    return most


@numba.njit(**OPTIONS)
def segment_size(parts):
    """Rows of a segment with so many substeps."""
    return HEADER + (2 * parts + 1) * POINT_SIZE


@numba.njit(**OPTIONS)
def lay_road(setting, k, w, parts, road, to):
    """Segments of sample k and the road along their substeps, from `to` on; where they end."""
    dt, switch, lag = setting[data.DT], setting[data.DELAY_PART], setting[data.LAG]
    h, until = lengths(setting, w, k)
    cut = any_lane((until > 0.0) & (until < h))
    inside = select((until > 0.0) & (until < h), until, h)
    segments = 1 + int(cut) + int(switch > 0.0)
    low, high = inside, h
    if segments == 3:
        low, high = min(inside, switch), max(inside, switch)
    elif not cut:
        low = min(fma(h, 0.0, switch), h)
    last = h * 0.0
    for n in range(segments):
        first = last
        last = h
        if n + 1 < segments:
            last = min(low, h)
            if n == 1:
                last = min(high, h)
        w[data.SEGMENT_LENGTH], w[data.SUBSTEP_LENGTH] = last - first, (last - first) / w[data.N_SUBSTEPS]
        w[data.SEGMENT_IN_T] = select((last <= until) & (until > 0.0), 1.0, 0.0)
        w[data.SEGMENT_AFTER_DELAY] = select(first >= switch, 1.0, 0.0)
        w[data.SEGMENT_START] = w[data.T_0] + k * dt + first
        if lag > 0.0:
            lay_lag(w, 1.0 / lag)
        for j in range(HEADER):
            road[to + j] = w[data.SEGMENT_LENGTH + j]
        for j in range(2 * parts + 1):
            lay_point(setting, w, 0.5 * j)
            for n in range(POINT_SIZE):
                road[to + HEADER + POINT_SIZE * j + n] = w[data.V_START + n]
        to += HEADER + (2 * parts + 1) * POINT_SIZE
    return to
