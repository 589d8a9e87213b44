"""Any plant, eight scenarios side by side: fixed steps of the classical Runge-Kutta method, branch-free.

A sample is cut into segments where something jumps, at a command that arrives within it and at T; a segment into equal
substeps, at most a quarter of the fastest time constant long. The steering angle is known in closed form along a
segment, a ramp at the rate limit and then a decay with the lag; a substep sees the parabola with the same mean, first
and second moment, so that neither the end of the ramp nor a lag far shorter than the substep costs accuracy.

Every lane does the same arithmetic, and a lane that needs fewer substeps than its neighbours goes on with length 0, so
that the numbers of a scenario do not depend on its neighbours. The table of a block is one array with fixed distances,
so that the compiler sees that rows do not overlap. Names of rows hold their first element.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.between import (
    absolute_area,
    arctan,
    cosine,
    decay,
    hermite_peak,
    quartic_root,
    sine,
    touches,
)
from ldctoolkit.simulation.kernel.lane_rows import (
    ALIVE,
    BEFORE,
    BEGAN,
    CAR,
    COMMAND,
    COUNTED,
    DIVERGED,
    ENTRIES,
    FAILED,
    FLAG,
    FROM,
    LENGTH,
    LIMITS,
    NOW,
    PARABOLA,
    PART,
    PAST,
    POINT,
    RAMP,
    RINGS,
    SAME,
    SAVED,
    SLOPE,
    STEP_AREA,
    SUM,
    T_0,
    TARGET,
    WHEEL,
    A,
    H,
    K,
    L,
    N,
    S,
    T,
    X,
    Y,
    begin,
    load,
    record,
    rings,
    take_law,
)
from ldctoolkit.simulation.kernel.lane_sight import (
    HEADER,
    POINT_SIZE,
    command,
    lay_road,
    look_ahead,
    noise_of,
    see,
    segment_size,
    substeps_of,
    take_between,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, curvature, length_of, speed

_SPUN: Final = 1.5
"""|e_psi| [rad] at which saturating tyres have lost the vehicle: its equations end at a right angle to the lane."""


# ------------------------------------------------------------------------------------------------ the plant


# A loop over the lanes is compiled into vector instructions if its body is long; a short one is unrolled instead,
# and its lanes are moved one by one. What belongs to a stage therefore stands in one loop.


@numba.njit(**OPTIONS)
def _stand(w, road, at, delta):
    """The road at a point, and the steering angle in row `delta`."""
    for n in range(4 * L):
        w[POINT + n] = road[at + n]
    for l in range(L):
        w[POINT + 4 * L + l] = w[delta + l]


@numba.njit(**OPTIONS)
def _state(w, l, share, first):
    """State of a stage: that of the substep's start, and a share of the way along the slopes of the stage before."""
    y, p, psi, turn = w[X + l], w[X + L + l], w[X + 2 * L + l], w[X + 3 * L + l]
    h = share * w[H + l]
    y = y if first else y + h * w[K + l]
    p = p if first else p + h * w[K + L + l]
    psi = psi if first else psi + h * w[K + 2 * L + l]
    turn = turn if first else turn + h * w[K + 3 * L + l]
    return y, p, psi, turn


@numba.njit(**OPTIONS)
def _keep(w, l, weight, first, y, p, lateral, turn, yaw, a_y):
    """Slopes of a stage, and what it adds to their weighted sums."""
    w[K + l], w[K + L + l], w[K + 2 * L + l], w[K + 3 * L + l], w[A + l] = p, lateral, turn, yaw, a_y
    w[SUM + l] = (0.0 if first else w[SUM + l]) + weight * p
    w[SUM + L + l] = (0.0 if first else w[SUM + L + l]) + weight * lateral
    w[SUM + 2 * L + l] = (0.0 if first else w[SUM + 2 * L + l]) + weight * turn
    w[SUM + 3 * L + l] = (0.0 if first else w[SUM + 3 * L + l]) + weight * yaw
    w[SUM + 4 * L + l] = (0.0 if first else w[SUM + 4 * L + l]) + weight * y


@numba.njit(**OPTIONS)
def _stage_linear(w, share, weight, first):
    """One stage on linear tyres."""
    for l in range(L):
        y, p, psi, turn = _state(w, l, share, first)
        v, dv, per_v = w[POINT + l], w[POINT + L + l], w[POINT + 2 * L + l]
        across, omega = p - v * psi, turn + w[POINT + 3 * L + l]
        front = w[CAR + l] * (w[POINT + 4 * L + l] - (across + w[CAR + 2 * L + l] * omega) * per_v)
        rear = w[CAR + L + l] * ((w[CAR + 3 * L + l] * omega - across) * per_v)
        a_y = front + rear - w[CAR + 6 * L + l] * turn * per_v
        yaw = w[CAR + 4 * L + l] * front - w[CAR + 5 * L + l] * rear
        _keep(w, l, weight, first, y, p, a_y - v * w[POINT + 3 * L + l] + dv * psi, turn, yaw, a_y)


@numba.njit(**OPTIONS)
def _stage_saturating(w, share, weight, first, shape):
    """One stage on tyres that saturate: the equations of `ldctoolkit.vehicle._nonlinear_compiled`."""
    for l in range(L):
        y, p, psi, turn = _state(w, l, share, first)
        v, dv, per_v, delta = w[POINT + l], w[POINT + L + l], w[POINT + 2 * L + l], w[POINT + 4 * L + l]
        sin_psi, cos_psi = sine(psi), cosine(psi)
        omega = turn + w[POINT + 3 * L + l]
        across = (p - v * sin_psi) / cos_psi
        slip_front = delta - arctan((across + w[CAR + 2 * L + l] * omega) * per_v)
        slip_rear = arctan((w[CAR + 3 * L + l] * omega - across) * per_v)
        front = w[CAR + 7 * L + l] * sine(shape * arctan(w[CAR + l] * slip_front)) * cosine(delta)
        rear = w[CAR + 8 * L + l] * sine(shape * arctan(w[CAR + L + l] * slip_rear))
        a_y = front + rear
        lateral = dv * sin_psi + v * cos_psi * turn + (a_y - v * omega) * cos_psi - across * sin_psi * turn
        yaw = w[CAR + 4 * L + l] * front - w[CAR + 5 * L + l] * rear
        _keep(w, l, weight, first, y, p, lateral, turn, yaw, a_y)


@numba.njit(**OPTIONS)
def _stage(setting, w, share, weight, first):
    """One stage at the point where the vehicle stands."""
    if setting[data.SATURATING] > 0.0:
        _stage_saturating(w, share, weight, first, setting[data.SHAPE])
    else:
        _stage_linear(w, share, weight, first)


@numba.njit(**OPTIONS)
def _runge_kutta(setting, w, road, at):
    """The four stages of a substep: weighted sums of the slopes, and of e_y."""
    _stand(w, road, at, PARABOLA)
    _stage(setting, w, 0.0, 1.0, True)
    _stand(w, road, at + POINT_SIZE, PARABOLA + L)
    _stage(setting, w, 0.5, 2.0, False)
    _stage(setting, w, 0.5, 2.0, False)
    _stand(w, road, at + 2 * POINT_SIZE, PARABOLA + 2 * L)
    _stage(setting, w, 1.0, 1.0, False)


# ------------------------------------------------------------------------------------------------ the steering angle


@numba.njit(**OPTIONS)
def _steer(setting, w):
    """Where the steering angle goes in a segment, and what that adds to its scores."""
    lag, rate = setting[data.LAG], setting[data.RATE_MAX]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    at_once = lag == 0.0 and rate == math.inf
    limited = rate < math.inf
    for l in range(L):
        u, start, length = w[TARGET + l], w[WHEEL + l], w[LENGTH + l]
        distance = u - start
        slope = math.copysign(rate, distance) if limited else 0.0
        # the rate is at its limit until u is within rate times lag
        ramp = min(max((abs(distance) - rate * lag) / rate, 0.0), length) if limited else 0.0
        corner = start + slope * ramp if limited else start
        rest = length - ramp
        left = u - corner if lag > 0.0 else 0.0  # after the ramp the angle is u - left exp(-s/lag)
        fallen = decay(-rest * per_lag)
        end = u - left * fallen if lag > 0.0 else (corner if limited and ramp == length else u)
        end = end if length > 0.0 else start
        w[SLOPE + l], w[RAMP + l], w[FROM + l], w[WHEEL + l] = slope, ramp, start, end
        w[PART + l] = length / w[N + l]
        effort = ramp * (start * start + ramp * (start * slope + ramp * slope * slope / 3.0))
        effort += u * u * rest
        effort += (0.5 * left * (1.0 - fallen * fallen) - 2.0 * u * (1.0 - fallen)) * left * lag
        w[S + data.EFFORT * L + l] += effort
        w[S + data.TRAVEL * L + l] += abs(corner - start) + abs(end - corner)
        peak = abs(end) if at_once else max(max(abs(start), abs(corner)), abs(end))
        w[S + data.DELTA * L + l] = max(w[S + data.DELTA * L + l], peak if length > 0.0 else 0.0)


@numba.njit(**OPTIONS)
def _parabola(setting, w, j):
    """The parabola that has the steering angle's mean, first and second moment over substep j of a segment."""
    lag = setting[data.LAG]
    if lag == 0.0 and setting[data.RATE_MAX] == math.inf:
        for l in range(L):
            w[PARABOLA + l] = w[PARABOLA + L + l] = w[PARABOLA + 2 * L + l] = w[TARGET + l]
        return
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    for l in range(L):
        u, slope, ramp, start, h = w[TARGET + l], w[SLOPE + l], w[RAMP + l], w[FROM + l], w[PART + l]
        a = j * h
        # in parts of the substep: a ramp from 0 to q, then a decay
        q = min(max((ramp - a) / max(h, 1e-300), 0.0), 1.0)
        b, c = start + slope * a, slope * h
        m_0 = q * (b + 0.5 * c * q)
        m_1 = q * q * (0.5 * b + c * q / 3.0)
        m_2 = q * q * q * (b / 3.0 + 0.25 * c * q)
        rest, kappa = 1.0 - q, h * per_lag
        left = u - (start + slope * ramp) if lag > 0.0 else 0.0
        left *= decay(-max(a - ramp, 0.0) * per_lag)
        # integrals of y^n exp(-kappa y) from 0 to the rest
        z = kappa * rest
        fallen = decay(-z)
        s = 2.0 / 87178291200.0
        s = 2.0 / 6227020800.0 + z * s
        s = 2.0 / 479001600.0 + z * s
        s = 2.0 / 39916800.0 + z * s
        s = 2.0 / 3628800.0 + z * s
        s = 2.0 / 362880.0 + z * s
        s = 2.0 / 40320.0 + z * s
        s = 2.0 / 5040.0 + z * s
        s = 2.0 / 720.0 + z * s
        s = 2.0 / 120.0 + z * s
        s = 2.0 / 24.0 + z * s
        s = 2.0 / 6.0 + z * s
        near = rest * rest * rest * fallen * s
        far = (2.0 - fallen * (2.0 + z * (2.0 + z))) / max(kappa * kappa * kappa, 1e-300)
        i_2 = near if z < 1.0 else far
        i_1 = 0.5 * (kappa * i_2 + rest * rest * fallen)
        i_0 = kappa * i_1 + rest * fallen
        m_0 += u * rest - left * i_0
        m_1 += 0.5 * u * (1.0 - q * q) - left * (i_1 + q * i_0)
        m_2 += u * (1.0 - q * q * q) / 3.0 - left * (i_2 + q * (2.0 * i_1 + q * i_0))
        tilt, bend = 3.0 * (2.0 * m_1 - m_0), 5.0 * (6.0 * (m_2 - m_1) + m_0)
        w[PARABOLA + l] = m_0 - tilt + bend
        w[PARABOLA + L + l] = m_0 - 0.5 * bend
        w[PARABOLA + 2 * L + l] = m_0 + tilt + bend


# ------------------------------------------------------------------------------------------------ scores


@numba.njit(**OPTIONS)
def _score(setting, w):
    """The state after a substep, into `Y`, and its scores; True if something happens within it in a lane."""
    l_f, offset = setting[data.AXLE], setting[data.OFFSET]
    rare = False
    for l in range(L):
        h, counted = w[H + l], w[COUNTED + l] > 0.0
        sixth = h * (1.0 / 6.0)
        x_0, x_1 = w[X + l], w[X + L + l]
        n_0, n_1 = x_0 + sixth * w[SUM + l], x_1 + sixth * w[SUM + L + l]
        n_2, n_3 = w[X + 2 * L + l] + sixth * w[SUM + 2 * L + l], w[X + 3 * L + l] + sixth * w[SUM + 3 * L + l]
        area = sixth * w[SUM + 4 * L + l]
        w[Y + l], w[Y + L + l], w[Y + 2 * L + l], w[Y + 3 * L + l] = n_0, n_1, n_2, n_3
        g_0, f_0 = x_0 + l_f * w[X + 2 * L + l], x_1 + l_f * w[X + 3 * L + l]
        g_1, f_1 = n_0 + l_f * n_2, n_1 + l_f * n_3
        deep, front, over = w[S + data.DEEP * L + l], w[S + data.FRONT * L + l], w[S + data.OVER * L + l]
        event = counted & ((x_0 * n_0 < 0.0) | touches(x_0, x_1, n_0, n_1, h))
        event |= (w[S + data.BACK * L + l] == math.inf) & (x_0 >= offset) & (n_0 < offset)
        # an extreme within the substep that may be a new one
        event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (max(x_0, n_0) + h * (x_1 - n_1) > deep)
        event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (max(g_0, g_1) + h * (f_0 - f_1) > front)
        event |= (x_1 < 0.0) & (n_1 > 0.0) & (h * (n_1 - x_1) - min(x_0, n_0) > max(over, offset))
        event &= h > 0.0
        w[FLAG + l] = 1.0 if event else 0.0
        rare |= event
        w[SUM + 4 * L + l], w[STEP_AREA + l] = area, abs(area) if counted else 0.0
        w[S + data.DEEP * L + l] = max(deep, n_0 if counted else deep)
        w[S + data.FRONT * L + l] = max(front, g_1 if counted else front)
        w[S + data.OVER * L + l] = max(over, -n_0)
    return rare


@numba.njit(**OPTIONS)
def _look_closer(setting, w, l):
    """What happens within a substep of one lane."""
    h, l_f, offset, counted = w[H + l], setting[data.AXLE], setting[data.OFFSET], w[COUNTED + l] > 0.0
    x_0, x_1, n_0, n_1, area = w[X + l], w[X + L + l], w[Y + l], w[Y + L + l], w[SUM + 4 * L + l]
    if w[S + data.BACK * L + l] == math.inf and x_0 >= offset > n_0:
        u = quartic_root(x_0 - offset, h * x_1, n_0 - offset, h * n_1, area / h - offset)
        w[S + data.BACK * L + l] = w[NOW + l] + h * u
    if counted and (x_0 * n_0 < 0.0 or touches(x_0, x_1, n_0, n_1, h)):
        w[STEP_AREA + l] = absolute_area(x_0, x_1, n_0, n_1, area, h)
    if counted:
        w[S + data.DEEP * L + l] = max(w[S + data.DEEP * L + l], hermite_peak(x_0, x_1, n_0, n_1, h))
        g_0, f_0 = x_0 + l_f * w[X + 2 * L + l], x_1 + l_f * w[X + 3 * L + l]
        g_1, f_1 = n_0 + l_f * w[Y + 2 * L + l], n_1 + l_f * w[Y + 3 * L + l]
        w[S + data.FRONT * L + l] = max(w[S + data.FRONT * L + l], hermite_peak(g_0, f_0, g_1, f_1, h))
    w[S + data.OVER * L + l] = max(w[S + data.OVER * L + l], hermite_peak(-x_0, -x_1, -n_0, -n_1, h))


@numba.njit(**OPTIONS)
def _diverge(setting, w, l, t):
    """Score the bound from the segment's start on."""
    for n in range(data.SCORES):
        w[S + n * L + l] = w[SAVED + n * L + l]
    inwards = w[X + l] < 0.0
    if w[COUNTED + l] > 0.0:
        w[S + data.AREA * L + l] += setting[data.BOUND] * (w[T + l] - t)
        if not inwards:
            w[S + data.DEEP * L + l] = w[S + data.FRONT * L + l] = setting[data.BOUND]
    if inwards:
        w[S + data.OVER * L + l] = setting[data.BOUND]
    w[DIVERGED + l], w[ALIVE + l] = 1.0, 0.0


@numba.njit(**OPTIONS)
def _past(setting, position, from_left):
    """Row in the rings, and share of the next, of a_y at a past position in samples; -1 for before the trigger."""
    _, right, left, _ = rings(setting)
    j = math.floor(position + SAME)
    share = position - j
    mask = int(setting[data.RING]) - 1
    if share <= SAME:
        if j < 0 or (from_left and j == 0):
            return -1, -1, 0.0
        row = (left if from_left else right) + (j & mask) * L
        return row, row, 0.0
    if j < 0:
        return -1, -1, 0.0
    return right + (j & mask) * L, left + ((j + 1) & mask) * L, share


@numba.njit(**OPTIONS)
def _jerk(scene, setting, block, k, w):
    """Peaks of a_y and its moving average at both ends of sample k."""
    _, right, left, _ = rings(setting)
    mask, window, dt = int(setting[data.RING]) - 1, setting[data.WINDOW], setting[data.DT]
    for l in range(L):
        w[right + (k & mask) * L + l] = w[LIMITS + l]
        w[left + ((k + 1) & mask) * L + l] = w[LIMITS + L + l]
    for n in range(2):
        start, end, share = _past(setting, k + n - window, n == 1)
        for l in range(L):
            before = w[BEFORE + l]
            w[PAST + n * L + l] = before if start < 0 else w[start + l] + share * (w[end + l] - w[start + l])
    for l in range(L):
        i = block * L + l
        if w[ALIVE + l] > 0.0 and k + 1 == scene[i, data.STEPS]:  # a last sample that may be shorter
            length, _ = length_of(scene, setting, i, k)
            part = length / dt if length < dt else 1.0
            past = k + part - window
            if past > k:
                low, high = w[LIMITS + l], w[LIMITS + L + l]
                w[PAST + L + l] = low + (past - k) / part * (high - low)
            else:
                start, end, share = _past(setting, past, True)
                before = w[BEFORE + l]
                w[PAST + L + l] = before if start < 0 else w[start + l] + share * (w[end + l] - w[start + l])
    for l in range(L):
        a, b = w[LIMITS + l], w[LIMITS + L + l]
        jerk = max(abs(a - w[PAST + l]), abs(b - w[PAST + L + l])) / (window * dt)
        alive = w[ALIVE + l] > 0.0
        w[S + data.JERK * L + l] = max(w[S + data.JERK * L + l], jerk if alive else 0.0)
        w[S + data.A_Y * L + l] = max(w[S + data.A_Y * L + l], max(abs(a), abs(b)) if alive else 0.0)


# ------------------------------------------------------------------------------------------------ one sample


@numba.njit(**OPTIONS)
def _drive_segment(setting, w, k, parts, road, at):
    """All lanes over a segment; True if one of them has left the bound."""
    for l in range(L):
        w[LENGTH + l] = road[at + l] * w[ALIVE + l]
        w[COUNTED + l] = road[at + L + l] * w[ALIVE + l]
    for n in range(data.SCORES * L):
        w[SAVED + n] = w[S + n]
    _steer(setting, w)
    between = setting[data.CAMERA] > 0.0
    for j in range(parts):
        for l in range(L):
            w[H + l] = w[PART + l] if j < w[N + l] else 0.0
        _parabola(setting, w, j)
        _runge_kutta(setting, w, road, at + HEADER + 3 * j * POINT_SIZE)
        rare = _score(setting, w)
        if between:
            take_between(setting, k, w)
        if rare:
            for l in range(L):
                if w[FLAG + l] > 0.0:
                    _look_closer(setting, w, l)
        for l in range(L):
            w[S + data.AREA * L + l] += w[STEP_AREA + l]
            w[NOW + l] += w[H + l]
        for n in range(4 * L):
            w[X + n] = w[Y + n]
    spun = _SPUN if setting[data.SATURATING] > 0.0 else math.inf
    lost = False
    for l in range(L):
        lost |= (w[ALIVE + l] > 0.0) & ((not abs(w[X + l]) <= setting[data.BOUND]) | (not abs(w[X + 2 * L + l]) < spun))
    return lost


@numba.njit(**OPTIONS)
def advance(scene, setting, block, w, k, parts, road, at, end, paths, place):
    """Sample k with the command in `TARGET`: segments of the road from `at` to `end`. Lanes that go on after it."""
    ring, whole, mine = int(setting[data.COMMANDS]), k - int(setting[data.DELAY_SAMPLES]), segment_size(parts)
    dt, at_once = setting[data.DT], setting[data.LAG] == 0.0 and setting[data.RATE_MAX] == math.inf
    newest, fresh, stale = RINGS + (k % ring) * L, RINGS + (whole % ring) * L, RINGS + ((whole - 1) % ring) * L
    first = stale if setting[data.DELAY_PART] > 0.0 else fresh
    for l in range(L):
        w[COMMAND + l] = w[TARGET + l]
        w[newest + l] = min(max(w[TARGET + l], -setting[data.DELTA_MAX]), setting[data.DELTA_MAX])
        w[NOW + l] = w[T_0 + l] + k * dt
    for l in range(L):
        w[BEGAN + L + l] = w[WHEEL + l]
        w[PARABOLA + l] = w[first + l] if at_once else w[WHEEL + l]
    _stand(w, road, at + HEADER, PARABOLA)
    _stage(setting, w, 0.0, 0.0, True)
    for l in range(L):
        w[LIMITS + l] = w[A + l]
        if paths.shape[0] and w[ALIVE + l] > 0.0:
            c = place[block * L + l]
            if c >= 0:
                paths[c, int(w[ENTRIES + l]) - 1, data.P_DELTA] = w[PARABOLA + l]
    while at < end:
        for l in range(L):
            w[TARGET + l] = w[fresh + l] if road[at + 2 * L + l] > 0.0 else w[stale + l]
            w[BEGAN + l] = w[NOW + l]
        if _drive_segment(setting, w, k, parts, road, at):
            spun = _SPUN if setting[data.SATURATING] > 0.0 else math.inf
            for l in range(L):
                if w[ALIVE + l] > 0.0 and not (abs(w[X + l]) <= setting[data.BOUND] and abs(w[X + 2 * L + l]) < spun):
                    _diverge(setting, w, l, w[BEGAN + l])
        if at + mine < end and paths.shape[0]:
            for l in range(L):
                c = place[min(block * L + l, scene.shape[0] - 1)]
                ends = w[COUNTED + l] * w[ALIVE + l] > 0.0 and road[at + mine + L + l] == 0.0
                if ends and road[at + mine + l] > 0.0 and c >= 0:
                    record(paths, c, w, l, w[T + l])
        at += mine
    for l in range(L):
        if not w[ALIVE + l] > 0.0:  # a lane that has ended stays finite
            w[X + l] = w[X + L + l] = w[X + 2 * L + l] = w[X + 3 * L + l] = 0.0
    for l in range(L):
        w[S + data.RATE * L + l] = max(
            w[S + data.RATE * L + l], abs(w[WHEEL + l] - w[BEGAN + L + l]) / dt if w[ALIVE + l] > 0.0 else 0.0
        )
    _stand(w, road, end - POINT_SIZE, WHEEL)
    _stage(setting, w, 0.0, 0.0, True)
    for l in range(L):
        w[LIMITS + L + l] = w[A + l]
    _jerk(scene, setting, block, k, w)
    going = 0
    for l in range(L):
        if w[ALIVE + l] > 0.0:
            i = block * L + l
            if paths.shape[0] and place[i] >= 0:
                h, _ = length_of(scene, setting, i, k)
                full, rest = scene[i, data.FULL], scene[i, data.REST]
                at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
                record(paths, place[i], w, l, w[T + l] if at_T else w[T_0 + l] + k * dt + h)
            if k + 1 == scene[i, data.STEPS]:
                w[ALIVE + l] = 0.0
            else:
                going += 1
    return going


# ------------------------------------------------------------------------------------------------ a whole run


@numba.njit(**OPTIONS)
def start(scene, setting, block, w, paths, place):
    """Everything before the first sample of a block."""
    load(scene, setting, block, w)
    begin(scene, setting, block, w)
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        v, dv = speed(scene, setting, i, w[T_0 + l])
        w[POINT + l], w[POINT + L + l], w[POINT + 2 * L + l] = v, dv, 1.0 / v
        w[POINT + 3 * L + l], w[POINT + 4 * L + l] = v * curvature(scene, i, w[T_0 + l]), w[WHEEL + l]
    _stage(setting, w, 0.0, 0.0, True)
    for l in range(L):
        w[BEFORE + l] = w[A + l]
        if paths.shape[0] and w[ALIVE + l] > 0.0 and place[block * L + l] >= 0:
            record(paths, place[block * L + l], w, l, w[T_0 + l])


@numba.njit(**OPTIONS)
def drive_block_any(scene, setting, law, times, paths, place, block, score, diverged, failed):
    """Every design of a law on one block of scenarios; what designs share is worked out once."""
    m, lookaheads = scene.shape[0], times.shape[1]
    count, parts, most, segments = min(L, m - block * L), substeps_of(scene, block), 0, 1
    for l in range(count):
        most = max(most, int(scene[block * L + l, data.STEPS]))
    if setting[data.DELAY_PART] > 0.0:
        segments = 2
    _, _, _, size = rings(setting)
    w, g = np.empty(size), np.empty(2 * lookaheads * L)
    road, ends = np.empty((segments * most + 2 * L) * segment_size(parts)), np.zeros(most + 1, dtype=np.int64)
    width = (1 + 2 * lookaheads) * L
    ahead, noise = np.empty(most * width), np.empty(most * 2 * L)
    load(scene, setting, block, w)
    for k in range(most):
        ends[k + 1] = lay_road(scene, setting, block, k, w, parts, road, ends[k])
        noise_of(scene, setting, block, k, noise, k * 2 * L)
    for design in range(law.shape[0]):
        same = design > 0
        for j in range(lookaheads):
            same &= times[design, j] == times[design - 1, j]
        if not same:
            for k in range(most):
                look_ahead(scene, setting, block, k, times[design], ahead, k * width)
        start(scene, setting, block, w, paths, place)
        take_law(law[design], block, w, g)
        for k in range(most):
            see(setting, w, k, ahead, k * width, noise, k * 2 * L)
            command(setting, w, g, ahead, k * width, lookaheads)
            if not advance(scene, setting, block, w, k, parts, road, ends[k], ends[k + 1], paths, place):
                break
        for l in range(count):
            i = block * L + l
            for n in range(data.SCORES):
                score[design, n, i] = w[S + n * L + l]
            diverged[design, i] = w[DIVERGED + l] > 0.0
            failed[design, i] = int(w[FAILED + l])
