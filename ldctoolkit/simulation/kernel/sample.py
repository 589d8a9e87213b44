"""One sample of one scenario: the steering actuator, the plant behind it, and what is scored on the way."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

from ldctoolkit.simulation.kernel.data import (
    A_Y,
    AREA,
    BACK,
    DEEP,
    DELTA,
    EFFORT,
    FRONT,
    JERK,
    OVER,
    RATE,
    SCORES,
    TRAVEL,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, accelerations, curvature, move, speed, substeps

_NEWTON_PASSES = 60
_SAME = 1e-9
"""Parts of a sample that are rounding."""


@numba.njit(**OPTIONS)
def hermite_peak(f_0, m_0, f_1, m_1, h):
    """Largest value of the cubic with these ends and slopes, where it rises first and falls last."""
    peak = max(f_0, f_1)
    if m_0 > 0.0 > m_1:
        m_0, m_1, rise = m_0 * h, m_1 * h, f_1 - f_0
        a, b = m_0 + m_1 - 2.0 * rise, 3.0 * rise - 2.0 * m_0 - m_1
        # 3 a u^2 + 2 b u + m_0 = 0 between 0 and 1, in the form that does not cancel
        root = math.sqrt(max(b * b - 3.0 * a * m_0, 0.0))
        u = m_0 / (root - b) if b < 0.0 else (-(b + root) / (3.0 * a) if a != 0.0 else 0.0)
        if 0.0 < u < 1.0:
            peak = max(peak, f_0 + u * (m_0 + u * (b + u * a)))
    return peak


@numba.njit(**OPTIONS)
def _time_at(scene, setting, i, x, t, h, e_end, level, offset, slope, decay, s_0, work):
    """When e_y is at a level within a substep that starts at x; the integral of e_y up to then."""
    end, K = work.end, work.K
    low, high = 0.0, h
    above = x[0] - level
    s = h * above / (x[0] - e_end)
    for _ in range(_NEWTON_PASSES):
        move(scene, setting, i, x, t, s, offset, slope, decay, s_0, end, K)
        value = end[0] - level
        if value * above < 0.0:
            high = s
        else:
            low = s
        following = s - value / end[1]
        if not low < following < high:
            following = 0.5 * (low + high)
        if value == 0.0 or abs(following - s) <= 1e-15 * h:
            break
        s = following
    return s, end[4]


@numba.njit(**OPTIONS)
def _smooth(scene, setting, state, i, t, h, offset, slope, decay, counted, work):
    """A piece on which the steering angle is offset + slope s + decay exp(-s/lag)."""
    x, score, after = state.x[i], state.score[i], work.after
    parts = substeps(scene, setting, i, t, h, decay)
    part = h / parts
    for n in range(parts):
        s_0 = n * part
        at = t + s_0
        move(scene, setting, i, x, at, part, offset, slope, decay, s_0, after, work.K)
        if score[BACK] == math.inf and x[0] >= setting.offset > after[0]:
            level = setting.offset
            s, _ = _time_at(scene, setting, i, x, at, part, after[0], level, offset, slope, decay, s_0, work)
            score[BACK] = at + s
        if counted:
            if x[0] * after[0] < 0.0:
                _, before = _time_at(scene, setting, i, x, at, part, after[0], 0.0, offset, slope, decay, s_0, work)
                score[AREA] += abs(before) + abs(after[4] - before)
            else:
                score[AREA] += abs(after[4])
        x[0], x[1], x[2], x[3] = after[0], after[1], after[2], after[3]
    fallen = math.exp(-h / setting.lag) if decay != 0.0 else 0.0
    end = offset + slope * h + decay * fallen
    score[EFFORT] += h * (offset * offset + h * (offset * slope + h * slope * slope / 3.0))
    if decay != 0.0:
        lag = setting.lag
        score[EFFORT] += 2.0 * offset * decay * lag * (1.0 - fallen) + 0.5 * decay * decay * lag * (1.0 - fallen * fallen)
    score[TRAVEL] += abs(end - state.wheel[i])
    score[DELTA] = max(score[DELTA], abs(end))
    state.wheel[i] = end


@numba.njit(**OPTIONS)
def _steer(scene, setting, state, i, t, h, u, counted, work):
    """A piece with one target u of the steering angle."""
    lag, rate = setting.lag, setting.rate_max
    if lag == 0.0 and rate == math.inf:
        score = state.score[i]
        score[TRAVEL] += abs(u - state.wheel[i])
        score[DELTA] = max(score[DELTA], abs(u))
        state.wheel[i] = u
        _smooth(scene, setting, state, i, t, h, u, 0.0, 0.0, counted, work)
        return
    distance = u - state.wheel[i]
    ramp = 0.0
    if rate < math.inf:
        # the rate is at its limit until u is within rate times lag
        ramp = min(max((abs(distance) - rate * lag) / rate, 0.0), h)
        if ramp > 0.0:
            _smooth(scene, setting, state, i, t, ramp, state.wheel[i], math.copysign(rate, distance), 0.0, counted, work)
    if ramp < h:
        if lag == 0.0:
            state.wheel[i] = u
            _smooth(scene, setting, state, i, t + ramp, h - ramp, u, 0.0, 0.0, counted, work)
        else:
            decay = state.wheel[i] - u
            _smooth(scene, setting, state, i, t + ramp, h - ramp, u, 0.0, decay, counted, work)


@numba.njit(**OPTIONS)
def earlier(left, right, before, position, from_left):
    """Lateral acceleration at a past position, in samples, from rings of both limits; constant before the first."""
    if position < -_SAME:
        return before
    size = left.shape[0]
    j = int(math.floor(position + _SAME))
    part = position - j
    if part <= _SAME:
        if from_left:
            return left[j % size] if j > 0 else before
        return right[j % size]
    start, end = right[j % size], left[(j + 1) % size]
    return start + part * (end - start)


@numba.njit(**OPTIONS)
def _diverge(scene, setting, state, i, t, counted, inwards):
    """Score the bound from the start of the stretch that left it."""
    score = state.score[i]
    if counted:
        score[AREA] += setting.bound * (scene.T[i] - t)
        if not inwards:
            score[DEEP] = score[FRONT] = setting.bound
    if inwards:
        score[OVER] = setting.bound
    state.diverged[i] = True
    state.alive[i] = False


@numba.njit(**OPTIONS)
def _extremes(setting, score, x, y, h, counted):
    """Depth and overshoot over a stretch from x to y."""
    if counted:
        score[DEEP] = max(score[DEEP], hermite_peak(x[0], x[1], y[0], y[1], h))
        l_f = setting.l_f
        peak = hermite_peak(x[0] + l_f * x[2], x[1] + l_f * x[3], y[0] + l_f * y[2], y[1] + l_f * y[3], h)
        score[FRONT] = max(score[FRONT], peak)
    score[OVER] = max(score[OVER], hermite_peak(-x[0], -x[1], -y[0], -y[1], h))


@numba.njit(**OPTIONS)
def record(paths, state, i, t):
    """Put the present state into the path of a chosen scenario."""
    c = paths.slot[i]
    if c >= 0:
        n = paths.count[c]
        paths.t[c, n] = t
        for j in range(4):
            paths.x[c, n, j] = state.x[i, j]
        paths.delta[c, n] = state.wheel[i]
        paths.count[c] = n + 1


@numba.njit(**OPTIONS)
def length(scene, setting, i, k):
    """Length of step k, and how much of it lies before T."""
    full, rest = scene.full[i], scene.rest[i]
    h = rest if k + 1 == scene.steps[i] and rest > 0.0 else setting.dt
    return h, (h if k < full else (rest if k == full else 0.0))


@numba.njit(**OPTIONS)
def drive(scene, setting, state, paths, i, k, stale, fresh, work):
    """Drive scenario i from sample k to the next, or to its end; False if it diverged.

    The target of the steering angle is `stale` until the fraction of the delay has passed, then `fresh`. Both limits
    of a_y, after sample k and before the next, are left in `work.limits`.
    """
    x, score = state.x[i], state.score[i]
    h, counted_until = length(scene, setting, i, k)
    t, switch = scene.start[i] + k * setting.dt, setting.delay_part
    at_once = setting.lag == 0.0 and setting.rate_max == math.inf
    angle = (stale if switch > 0.0 else fresh) if at_once else state.wheel[i]
    v, _ = speed(scene, setting, i, t)
    r = v * curvature(scene, i, t)
    _, _, work.limits[0] = accelerations(scene, setting, i, t, r, x[1], x[2], x[3], angle)
    if paths.slot[i] >= 0:
        paths.delta[paths.slot[i], paths.count[paths.slot[i]] - 1] = angle

    s = 0.0
    while s < h:
        counted = s < counted_until
        stop = counted_until if counted and counted_until < h else h
        for n in range(4):
            work.x[n] = x[n]
        for n in range(SCORES):
            work.score[n] = score[n]
        wheel, first = state.wheel[i], s
        while s < stop:
            piece = switch if s < switch < stop else stop
            _steer(scene, setting, state, i, t + s, piece - s, stale if s < switch else fresh, counted, work)
            s = piece
        if not abs(x[0]) <= setting.bound:  # also true for NaN
            inwards = x[0] < 0.0
            for n in range(SCORES):
                score[n] = work.score[n]
            state.wheel[i] = wheel
            _diverge(scene, setting, state, i, t + first, counted, inwards)
            return False
        _extremes(setting, score, work.x, x, stop - first, counted)
        if stop < h:
            record(paths, state, i, scene.T[i])

    end = t + h
    v, _ = speed(scene, setting, i, end)
    r = v * curvature(scene, i, end)
    _, _, work.limits[1] = accelerations(scene, setting, i, end, r, x[1], x[2], x[3], state.wheel[i])
    return True


@numba.njit(**OPTIONS)
def advance(scene, setting, state, paths, i, k, command, work):
    """Everything between sample k and the next of scenario i, with the command given at k."""
    if not math.isfinite(command):
        command = state.command[i]
        state.failed[i] += 1
    state.command[i] = command
    ring = state.commands.shape[1]
    state.commands[i, k % ring] = min(max(command, -setting.delta_max), setting.delta_max)
    fresh = state.commands[i, (k - setting.delay_samples) % ring]
    stale = state.commands[i, (k - setting.delay_samples - 1) % ring]
    wheel_before = state.wheel[i]
    if not drive(scene, setting, state, paths, i, k, stale, fresh, work):
        return

    dt, window, score = setting.dt, setting.window, state.score[i]
    left, right, before = state.a_left[i], state.a_right[i], scene.a_before[i]
    right[k % right.shape[0]] = work.limits[0]
    left[(k + 1) % left.shape[0]] = work.limits[1]
    h, _ = length(scene, setting, i, k)
    arrival = k + (h / dt if h < dt else 1.0)
    jerk = abs(work.limits[0] - earlier(left, right, before, k - window, False))
    jerk = max(jerk, abs(work.limits[1] - earlier(left, right, before, arrival - window, True)))
    score[JERK] = max(score[JERK], jerk / (window * dt))
    score[A_Y] = max(score[A_Y], max(abs(work.limits[0]), abs(work.limits[1])))
    score[RATE] = max(score[RATE], abs(state.wheel[i] - wheel_before) / dt)
    last, full, rest = k + 1 == scene.steps[i], scene.full[i], scene.rest[i]
    at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
    record(paths, state, i, scene.T[i] if at_T else scene.start[i] + k * dt + h)
    if last:
        state.alive[i] = False
