"""The steering actuator: rate limit and lag, in closed form along a segment, and as a parabola over a substep.

d delta/dt = (u - delta)/lag, at most `RATE_MAX` in size: a ramp at the rate limit, then a decay with the lag.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math

import numba

from ldctoolkit.numba_internals import OPTIONS, fma
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.block_table import L
from ldctoolkit.vector_math import decay, moments


@numba.njit(**OPTIONS)
def lay_lag(w, per_lag):
    """Decay exp(-s/lag) over a segment and over a substep, and its parabola over a substep."""
    for l in range(L):
        z = w[data.SUBSTEP_LENGTH + l] * per_lag
        m_0, m_1, m_2 = moments(z, 1.0)
        a, b, c = parabola(m_0, m_1, m_2)
        w[data.LAG_SEGMENT + l], w[data.LAG_SUBSTEP + l] = decay(-w[data.SEGMENT_LENGTH + l] * per_lag), decay(-z)
        w[data.LAG_START + l], w[data.LAG_MID + l], w[data.LAG_END + l] = a, b, c


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
    limited, ramps = rate < math.inf, False
    for l in range(L):
        u, start, length = w[data.COMMAND + l], w[data.WHEEL + l], w[data.SEGMENT_LENGTH + l]
        distance = u - start
        slope = math.copysign(rate, distance) if limited else 0.0
        # the rate is at its limit until u is within rate times lag
        ramp = min(max((abs(distance) - rate * lag) / rate, 0.0), length) if limited else 0.0
        corner = fma(slope, ramp, start)
        rest = length - ramp
        remaining = u - corner if lag > 0.0 else 0.0  # after the ramp the angle is u - remaining exp(-s/lag)
        fallen = decay(-rest * per_lag) if ramp > 0.0 else w[data.LAG_SEGMENT + l]
        end = fma(-remaining, fallen, u) if lag > 0.0 else (corner if limited and ramp == length else u)
        end = end if length > 0.0 else start
        w[data.RAMP_RATE + l], w[data.RAMP_TIME + l], w[data.RAMP_START + l], w[data.WHEEL + l] = (
            slope,
            ramp,
            start,
            end,
        )
        w[data.TO_COMMAND + l] = remaining
        effort = ramp * fma(start, start, ramp * fma(start, slope, ramp * slope * slope * (1.0 / 3.0)))
        effort += u * u * rest
        effort += fma(0.5 * remaining, fma(-fallen, fallen, 1.0), -2.0 * u * (1.0 - fallen)) * remaining * lag
        w[data.EFFORT + l] += effort if length > 0.0 else 0.0
        w[data.TRAVEL + l] += abs(corner - start) + abs(end - corner)
        peak = abs(end) if immediate else max(max(abs(start), abs(corner)), abs(end))
        w[data.DELTA_PEAK + l] = max(w[data.DELTA_PEAK + l], peak if length > 0.0 else 0.0)
        ramps |= ramp > 0.0
    return ramps


@numba.njit(forceinline=True, **OPTIONS)
def _decayed(w, l):
    """The parabola of a substep without a ramp, and what then remains to the command."""
    u, remaining = w[data.COMMAND + l], w[data.TO_COMMAND + l]
    w[data.TO_COMMAND + l] = remaining * w[data.LAG_SUBSTEP + l]
    return (
        fma(-remaining, w[data.LAG_START + l], u), fma(-remaining, w[data.LAG_MID + l], u),
        fma(-remaining, w[data.LAG_END + l], u),
    )  # fmt: skip


@numba.njit(**OPTIONS)
def along_decay(setting, w):
    """The parabola that has the steering angle's mean, first and second moment over a substep, where none ramps."""
    for l in range(int(setting[data.WIDTH])):
        a, b, c = _decayed(w, l)
        w[data.DELTA_START + l], w[data.DELTA_MID + l], w[data.DELTA_END + l] = a, b, c


@numba.njit(**OPTIONS)
def along_ramp(setting, w, j):
    """The same in substep j where one ramps, or did."""
    lag = setting[data.LAG]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    for l in range(L):
        a_0, a_1, a_2 = _decayed(w, l)
        u, slope, ramp = w[data.COMMAND + l], w[data.RAMP_RATE + l], w[data.RAMP_TIME + l]
        start, h = w[data.RAMP_START + l], w[data.SUBSTEP_LENGTH + l]
        a = j * h
        # in parts of the substep: a ramp from 0 to q, then a decay
        q = min(max((ramp - a) / max(h, 1e-300), 0.0), 1.0)
        b, c = fma(slope, a, start), slope * h
        rest = 1.0 - q
        remaining = u - fma(slope, ramp, start) if lag > 0.0 else 0.0
        remaining *= decay(-max(a - ramp, 0.0) * per_lag)
        i_0, i_1, i_2 = moments(h * per_lag * rest, rest)
        m_0 = q * fma(0.5 * c, q, b) + fma(u, rest, -remaining * i_0)
        m_1 = q * q * fma(c, q * (1.0 / 3.0), 0.5 * b) + fma(0.5 * u, fma(-q, q, 1.0), -remaining * fma(q, i_0, i_1))
        m_2 = q * q * q * fma(0.25 * c, q, b * (1.0 / 3.0)) + u * fma(-q * q, q, 1.0) * (1.0 / 3.0)
        m_2 -= remaining * fma(q, fma(q, i_0, 2.0 * i_1), i_2)
        b_0, b_1, b_2 = parabola(m_0, m_1, m_2)
        w[data.DELTA_START + l] = b_0 if ramp > 0.0 else a_0
        w[data.DELTA_MID + l] = b_1 if ramp > 0.0 else a_1
        w[data.DELTA_END + l] = b_2 if ramp > 0.0 else a_2
