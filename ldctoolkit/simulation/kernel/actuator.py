"""The steering actuator: rate limit and lag, in closed form along a segment, and as a parabola over a substep.

d delta/dt = (u - delta)/lag, at most `RATE_MAX` in size: a ramp at the rate limit, then a decay with the lag.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math

import numba

from ldctoolkit.lanes import any_lane, fma, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import data
from ldctoolkit.vector_math import decay, moments


@numba.njit(**OPTIONS)
def lay_lag(w, per_lag):
    """Decay exp(-s/lag) over a segment and over a substep, and its parabola over a substep."""
    z = w[data.SUBSTEP_LENGTH] * per_lag
    m_0, m_1, m_2 = moments(z, 1.0)
    a, b, c = parabola(m_0, m_1, m_2)
    w[data.LAG_SEGMENT], w[data.LAG_SUBSTEP] = decay(-w[data.SEGMENT_LENGTH] * per_lag), decay(-z)
    w[data.LAG_START], w[data.LAG_MID], w[data.LAG_END] = a, b, c


@numba.njit(forceinline=True, **OPTIONS)
def parabola(m_0, m_1, m_2):
    """Start, middle and end of the parabola with these moments over [0, 1]."""
    tilt, bend = 3.0 * (2.0 * m_1 - m_0), 5.0 * (6.0 * (m_2 - m_1) + m_0)
    return m_0 - tilt + bend, m_0 - 0.5 * bend, m_0 + tilt + bend


@numba.njit(**OPTIONS)
def steer(setting, w):
    """Steering angle over a segment, and its scores; True if it ramps in a lane.

        d delta/dt = (u - delta)/lag, at most `RATE_MAX` in size:

    a ramp until u is within rate times lag, then delta = u - remaining exp(-s/lag). Without a lag the ramp ends at u.
    """
    lag, rate = setting[data.LAG], setting[data.RATE_MAX]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    immediate = lag == 0.0 and rate == math.inf
    limited = rate < math.inf
    u, start, length = w[data.COMMAND], w[data.WHEEL], w[data.SEGMENT_LENGTH]
    distance = u - start
    slope = select(limited, math.copysign(rate, distance), 0.0)
    # the rate is at its limit until u is within rate times lag
    ramp = select(limited, min(max((abs(distance) - rate * lag) / rate, 0.0), length), 0.0)
    corner = fma(slope, ramp, start)
    rest = length - ramp
    remaining = select(lag > 0.0, u - corner, 0.0)  # after the ramp the angle is u - remaining exp(-s/lag)
    fallen = select(ramp > 0.0, decay(-rest * per_lag), w[data.LAG_SEGMENT])
    end = select(lag > 0.0, fma(-remaining, fallen, u), select((ramp == length) & limited, corner, u))
    end = select(length > 0.0, end, start)
    w[data.RAMP_RATE], w[data.RAMP_TIME], w[data.RAMP_START] = slope, ramp, start
    w[data.WHEEL], w[data.TO_COMMAND] = end, remaining
    effort = ramp * fma(start, start, ramp * fma(start, slope, ramp * slope * slope * (1.0 / 3.0)))
    effort += u * u * rest
    effort += fma(0.5 * remaining, fma(-fallen, fallen, 1.0), -2.0 * u * (1.0 - fallen)) * remaining * lag
    w[data.EFFORT] += select(length > 0.0, effort, 0.0)
    w[data.TRAVEL] += abs(corner - start) + abs(end - corner)
    peak = select(immediate, abs(end), max(max(abs(start), abs(corner)), abs(end)))
    w[data.DELTA_PEAK] = max(w[data.DELTA_PEAK], select(length > 0.0, peak, 0.0))
    return any_lane(ramp > 0.0)


@numba.njit(forceinline=True, **OPTIONS)
def _decayed(w):
    """The parabola of a substep without a ramp, and what then remains to the command."""
    u, remaining = w[data.COMMAND], w[data.TO_COMMAND]
    w[data.TO_COMMAND] = remaining * w[data.LAG_SUBSTEP]
    start, mid, end = w[data.LAG_START], w[data.LAG_MID], w[data.LAG_END]
    return fma(-remaining, start, u), fma(-remaining, mid, u), fma(-remaining, end, u)


@numba.njit(**OPTIONS)
def along_decay(w):
    """The parabola that has the steering angle's mean, first and second moment over a substep, where none ramps."""
    w[data.DELTA_START], w[data.DELTA_MID], w[data.DELTA_END] = _decayed(w)


@numba.njit(**OPTIONS)
def along_ramp(setting, w, j):
    """The same in substep j where one ramps, or did."""
    lag = setting[data.LAG]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    a_0, a_1, a_2 = _decayed(w)
    u, slope, ramp = w[data.COMMAND], w[data.RAMP_RATE], w[data.RAMP_TIME]
    start, h = w[data.RAMP_START], w[data.SUBSTEP_LENGTH]
    a = j * h
    # in parts of the substep: a ramp from 0 to q, then a decay
    q = min(max((ramp - a) / max(h, 1e-300), 0.0), 1.0)
    b, c = fma(slope, a, start), slope * h
    rest = 1.0 - q
    remaining = select(lag > 0.0, u - fma(slope, ramp, start), 0.0)
    remaining *= decay(-max(a - ramp, 0.0) * per_lag)
    i_0, i_1, i_2 = moments(h * per_lag * rest, rest)
    m_0 = q * fma(0.5 * c, q, b) + fma(u, rest, -remaining * i_0)
    m_1 = q * q * fma(c, q * (1.0 / 3.0), 0.5 * b) + fma(0.5 * u, fma(-q, q, 1.0), -remaining * fma(q, i_0, i_1))
    m_2 = q * q * q * fma(0.25 * c, q, b * (1.0 / 3.0)) + u * fma(-q * q, q, 1.0) * (1.0 / 3.0)
    m_2 -= remaining * fma(q, fma(q, i_0, 2.0 * i_1), i_2)
    b_0, b_1, b_2 = parabola(m_0, m_1, m_2)
    w[data.DELTA_START] = select(ramp > 0.0, b_0, a_0)
    w[data.DELTA_MID] = select(ramp > 0.0, b_1, a_1)
    w[data.DELTA_END] = select(ramp > 0.0, b_2, a_2)
