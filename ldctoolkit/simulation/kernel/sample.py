"""One sample of one scenario: the steering actuator, the plant behind it, and what is scored on the way."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math

import numba

from ldctoolkit.simulation.kernel.between import hermite_peak, quartic_root, touches
from ldctoolkit.simulation.kernel.data import (
    A_BEFORE,
    A_Y,
    ALIVE,
    AREA,
    AXLE,
    BACK,
    BOUND,
    COMMAND,
    COMMANDS,
    COUNT,
    DEEP,
    DELAY_PART,
    DELAY_SAMPLES,
    DELTA,
    DELTA_MAX,
    DIVERGED,
    DT,
    EFFORT,
    FAILED,
    FRAMES,
    FRONT,
    FULL,
    JERK,
    LAG,
    OFFSET,
    OVER,
    P_DELTA,
    P_TIME,
    P_X,
    RATE,
    RATE_MAX,
    REST,
    RING,
    SATURATING,
    SCORE,
    SCORES,
    SLOT,
    START,
    STATE,
    STEPS,
    T_END,
    TRAVEL,
    W_AFTER,
    W_END,
    W_LIMITS,
    W_SCORE,
    W_X,
    WHEEL,
    WINDOW,
    X,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, accelerations, curvature, move, speed, substeps

_NEWTON_PASSES = 60
_HALVINGS = 40
_SPUN = 1.5
"""|e_psi| [rad] at which saturating tyres have lost the vehicle: its equations end at a right angle to the lane."""

_SAME = 1e-9
"""Parts of a sample that are rounding."""


@numba.njit(**OPTIONS)
def time_at(scene, setting, i, state, t, h, level, offset, slope, decay, s_0, work):
    """When e_y is at a level within a substep that was moved over; the integral of e_y up to then."""
    above, below = state[i, X] - level, work[W_AFTER] - level
    mean = work[W_AFTER + 4] / h - level
    s = h * quartic_root(above, h * state[i, X + 1], below, h * work[W_AFTER + 1], mean)
    return time_near(scene, setting, i, state, t, h, s, level, offset, slope, decay, s_0, work)


@numba.njit(**OPTIONS)
def time_near(scene, setting, i, state, t, h, s, level, offset, slope, decay, s_0, work):
    """The same from a guess s; what the substep led to need not be known."""
    above = state[i, X] - level
    low, high = 0.0, h
    for _ in range(_NEWTON_PASSES):
        move(scene, setting, i, state, t, s, offset, slope, decay, s_0, work, W_END)
        value = work[W_END] - level
        if value * above < 0.0:
            high = s
        else:
            low = s
        following = s - value / work[W_END + 1]
        if not low <= following <= high:
            following = 0.5 * (low + high)
        # Newton squares the error: after a change of this size little is left
        if value == 0.0 or abs(following - s) <= 1e-6 * h:
            return following, work[W_END + 4] + (0.5 * value + level) * (following - s)
        s = following
    return s, work[W_END + 4]


@numba.njit(**OPTIONS)
def _through(scene, setting, i, state, t, h, e_0, area, offset, slope, decay, s_0, work):
    """Integral of |e_y| over a substep whose ends lie on one side but which may cross zero twice."""
    low, high, rate_0 = 0.0, h, state[i, X + 1]
    for _ in range(_HALVINGS):  # the extreme, between ends of different slopes
        s = 0.5 * (low + high)
        move(scene, setting, i, state, t, s, offset, slope, decay, s_0, work, W_END)
        if work[W_END] * e_0 < 0.0:
            break
        low, high = (s, high) if work[W_END + 1] * rate_0 > 0.0 else (low, s)
    if work[W_END] * e_0 >= 0.0:
        return abs(area)
    over, total, before = s, 0.0, 0.0
    for side in range(2):
        low, high = (0.0, over) if side == 0 else (over, h)
        for _ in range(_HALVINGS):
            s = 0.5 * (low + high)
            move(scene, setting, i, state, t, s, offset, slope, decay, s_0, work, W_END)
            beyond = work[W_END] * e_0 < 0.0
            low, high = (low, s) if beyond == (side == 0) else (s, high)
        total += abs(work[W_END + 4] - before)
        before = work[W_END + 4]
    return total + abs(area - before)


@numba.njit(**OPTIONS)
def _smooth(scene, setting, state, i, t, h, offset, slope, decay, counted, work):
    """A piece on which the steering angle is offset + slope s + decay exp(-s/lag)."""
    parts = substeps(scene, setting, i, t, h, decay)
    part = h / parts
    for n in range(parts):
        s_0 = n * part
        at = t + s_0
        move(scene, setting, i, state, at, part, offset, slope, decay, s_0, work, W_AFTER)
        e_0, e_1, area = state[i, X], work[W_AFTER], work[W_AFTER + 4]
        if state[i, SCORE + BACK] == math.inf and e_0 >= setting[OFFSET] > e_1:
            level = setting[OFFSET]
            s, _ = time_at(scene, setting, i, state, at, part, level, offset, slope, decay, s_0, work)
            state[i, SCORE + BACK] = at + s
        if counted:
            if e_0 * e_1 < 0.0:
                _, before = time_at(scene, setting, i, state, at, part, 0.0, offset, slope, decay, s_0, work)
                state[i, SCORE + AREA] += abs(before) + abs(area - before)
            elif touches(e_0, state[i, X + 1], e_1, work[W_AFTER + 1], part):
                state[i, SCORE + AREA] += _through(
                    scene, setting, i, state, at, part, e_0, area, offset, slope, decay, s_0, work
                )
            else:
                state[i, SCORE + AREA] += abs(area)
        for j in range(4):
            state[i, X + j] = work[W_AFTER + j]
    fallen = math.exp(-h / setting[LAG]) if decay != 0.0 else 0.0
    end = offset + slope * h + decay * fallen
    state[i, SCORE + EFFORT] += h * (offset * offset + h * (offset * slope + h * slope * slope / 3.0))
    if decay != 0.0:
        lag = setting[LAG]
        cross, square = 2.0 * offset * decay * (1.0 - fallen), 0.5 * decay * decay * (1.0 - fallen * fallen)
        state[i, SCORE + EFFORT] += lag * (cross + square)
    state[i, SCORE + TRAVEL] += abs(end - state[i, WHEEL])
    state[i, SCORE + DELTA] = max(state[i, SCORE + DELTA], abs(offset + decay), abs(end))
    state[i, WHEEL] = end


@numba.njit(**OPTIONS)
def _steer(scene, setting, state, i, t, h, u, counted, work):
    """A piece with one target u of the steering angle."""
    lag, rate = setting[LAG], setting[RATE_MAX]
    if lag == 0.0 and rate == math.inf:
        state[i, SCORE + TRAVEL] += abs(u - state[i, WHEEL])
        state[i, WHEEL] = u
        _smooth(scene, setting, state, i, t, h, u, 0.0, 0.0, counted, work)
        return
    distance = u - state[i, WHEEL]
    ramp = 0.0
    if rate < math.inf:
        # the rate is at its limit until u is within rate times lag
        ramp = min(max((abs(distance) - rate * lag) / rate, 0.0), h)
        if ramp > 0.0:
            slope = math.copysign(rate, distance)
            _smooth(scene, setting, state, i, t, ramp, state[i, WHEEL], slope, 0.0, counted, work)
    if ramp < h:
        decay = state[i, WHEEL] - u if lag > 0.0 else 0.0
        _smooth(scene, setting, state, i, t + ramp, h - ramp, u, 0.0, decay, counted, work)


@numba.njit(**OPTIONS)
def rings(setting):
    """First columns of the rings of commands, frames, and a_y just before and just after each sample."""
    frames = STATE + int(setting[COMMANDS])
    left = frames + 2 * int(setting[FRAMES])
    return STATE, frames, left, left + int(setting[RING])


@numba.njit(inline="always", **OPTIONS)
def past_sample(position, from_left):
    """Sample at or before a past position, and the share of the step from it; -1 for before the first."""
    j = math.floor(position + _SAME)
    share = position - j
    if share <= _SAME:
        share = 0.0
        if from_left and j == 0:
            j = -1
    return max(j, -1), share


@numba.njit(**OPTIONS)
def earlier(setting, state, i, before, position, from_left):
    """Lateral acceleration at a past position, in samples; linear between samples, constant before the first."""
    j, share = past_sample(position, from_left)
    if j < 0:
        return before
    _, _, left, right = rings(setting)
    mask = int(setting[RING]) - 1
    start, end = state[i, right + (j & mask)], state[i, left + ((j + 1) & mask)]
    if share == 0.0:
        return state[i, left + (j & mask)] if from_left else start
    return start + share * (end - start)


@numba.njit(**OPTIONS)
def before_end(setting, state, i, before, k, h, a_right, a_left):
    """Lateral acceleration a window before the end of step k, whose ends have these."""
    length_in_samples = h / setting[DT] if h < setting[DT] else 1.0
    past = k + length_in_samples - setting[WINDOW]
    if past > k:  # inside this very step, which may be shorter than the others
        return a_right + (past - k) / length_in_samples * (a_left - a_right)
    return earlier(setting, state, i, before, past, True)


@numba.njit(**OPTIONS)
def _diverge(scene, setting, state, i, t, counted, inwards):
    """Score the bound from the start of the stretch that left it."""
    if counted:
        state[i, SCORE + AREA] += setting[BOUND] * (scene[i, T_END] - t)
        if not inwards:
            state[i, SCORE + DEEP] = state[i, SCORE + FRONT] = setting[BOUND]
    if inwards:
        state[i, SCORE + OVER] = setting[BOUND]
    state[i, DIVERGED] = 1.0
    state[i, ALIVE] = 0.0


@numba.njit(**OPTIONS)
def _extremes(setting, state, i, h, counted, work):
    """Depth and overshoot over a stretch from the state in `work` to the present one."""
    x_0, x_1, y_0, y_1 = work[W_X], work[W_X + 1], state[i, X], state[i, X + 1]
    if counted:
        state[i, SCORE + DEEP] = max(state[i, SCORE + DEEP], hermite_peak(x_0, x_1, y_0, y_1, h))
        l_f = setting[AXLE]
        f_0, f_1 = x_0 + l_f * work[W_X + 2], x_1 + l_f * work[W_X + 3]
        g_0, g_1 = y_0 + l_f * state[i, X + 2], y_1 + l_f * state[i, X + 3]
        state[i, SCORE + FRONT] = max(state[i, SCORE + FRONT], hermite_peak(f_0, f_1, g_0, g_1, h))
    state[i, SCORE + OVER] = max(state[i, SCORE + OVER], hermite_peak(-x_0, -x_1, -y_0, -y_1, h))


@numba.njit(**OPTIONS)
def record(paths, state, i, t):
    """Put the present state into the path of a chosen scenario."""
    c = int(state[i, SLOT])
    if c >= 0:
        n = int(state[i, COUNT])
        paths[c, n, P_TIME] = t
        for j in range(4):
            paths[c, n, P_X + j] = state[i, X + j]
        paths[c, n, P_DELTA] = state[i, WHEEL]
        state[i, COUNT] = n + 1


@numba.njit(inline="always", **OPTIONS)
def length(scene, setting, i, k):
    """Length of step k, and how much of it lies before T."""
    full, rest = scene[i, FULL], scene[i, REST]
    h = rest if k + 1 == scene[i, STEPS] and rest > 0.0 else setting[DT]
    return h, (h if k < full else (rest if k == full else 0.0))


@numba.njit(**OPTIONS)
def _acceleration(scene, setting, state, i, t, delta):
    """Lateral acceleration in the present state."""
    v, _ = speed(scene, setting, i, t)
    r = v * curvature(scene, i, t)
    _, _, a_y = accelerations(scene, setting, i, t, r, state[i, X + 1], state[i, X + 2], state[i, X + 3], delta)
    return a_y


@numba.njit(**OPTIONS)
def drive(scene, setting, state, paths, i, k, stale, fresh, work):
    """Drive scenario i from sample k to the next, or to its end; False if it diverged.

    The target of the steering angle is `stale` until the fraction of the delay has passed, then `fresh`. Both limits
    of a_y, after sample k and before the next, are left in `work`.
    """
    h, counted_until = length(scene, setting, i, k)
    t, switch = scene[i, START] + k * setting[DT], setting[DELAY_PART]
    at_once = setting[LAG] == 0.0 and setting[RATE_MAX] == math.inf
    angle = (stale if switch > 0.0 else fresh) if at_once else state[i, WHEEL]
    work[W_LIMITS] = _acceleration(scene, setting, state, i, t, angle)
    if state[i, SLOT] >= 0.0:
        paths[int(state[i, SLOT]), int(state[i, COUNT]) - 1, P_DELTA] = angle

    s = 0.0
    while s < h:
        counted = s < counted_until
        stop = counted_until if counted and counted_until < h else h
        for n in range(4):
            work[W_X + n] = state[i, X + n]
        for n in range(SCORES):
            work[W_SCORE + n] = state[i, SCORE + n]
        wheel, first = state[i, WHEEL], s
        while s < stop:
            piece = switch if s < switch < stop else stop
            _steer(scene, setting, state, i, t + s, piece - s, stale if s < switch else fresh, counted, work)
            s = piece
        spun = setting[SATURATING] > 0.0 and not abs(state[i, X + 2]) < _SPUN
        if spun or not abs(state[i, X]) <= setting[BOUND]:  # also true for NaN
            for n in range(SCORES):
                state[i, SCORE + n] = work[W_SCORE + n]
            state[i, WHEEL] = wheel
            _diverge(scene, setting, state, i, t + first, counted, state[i, X] < 0.0)
            return False
        _extremes(setting, state, i, stop - first, counted, work)
        if stop < h:
            record(paths, state, i, scene[i, T_END])

    work[W_LIMITS + 1] = _acceleration(scene, setting, state, i, t + h, state[i, WHEEL])
    return True


@numba.njit(**OPTIONS)
def advance(scene, setting, state, paths, i, k, command, work):
    """Everything between sample k and the next of scenario i, with the command given at k."""
    if not math.isfinite(command):
        command = state[i, COMMAND]
        state[i, FAILED] += 1.0
    state[i, COMMAND] = command
    commands, _, left, right = rings(setting)
    ring, whole = int(setting[COMMANDS]), k - int(setting[DELAY_SAMPLES])
    state[i, commands + k % ring] = min(max(command, -setting[DELTA_MAX]), setting[DELTA_MAX])
    fresh, stale = state[i, commands + whole % ring], state[i, commands + (whole - 1) % ring]
    wheel_before = state[i, WHEEL]
    if not drive(scene, setting, state, paths, i, k, stale, fresh, work):
        return

    dt, window, mask = setting[DT], setting[WINDOW], int(setting[RING]) - 1
    a_right, a_left, before = work[W_LIMITS], work[W_LIMITS + 1], scene[i, A_BEFORE]
    state[i, right + (k & mask)] = a_right
    state[i, left + ((k + 1) & mask)] = a_left
    h, _ = length(scene, setting, i, k)
    jerk = abs(a_right - earlier(setting, state, i, before, k - window, False))
    passed = before_end(setting, state, i, before, k, h, a_right, a_left)
    jerk = max(jerk, abs(a_left - passed))
    state[i, SCORE + JERK] = max(state[i, SCORE + JERK], jerk / (window * dt))
    state[i, SCORE + A_Y] = max(state[i, SCORE + A_Y], max(abs(a_right), abs(a_left)))
    state[i, SCORE + RATE] = max(state[i, SCORE + RATE], abs(state[i, WHEEL] - wheel_before) / dt)
    last, full, rest = k + 1 == scene[i, STEPS], scene[i, FULL], scene[i, REST]
    at_T = (k == full and h == rest) or (k + 1 == full and rest == 0.0)
    record(paths, state, i, scene[i, T_END] if at_T else scene[i, START] + k * dt + h)
    if last:
        state[i, ALIVE] = 0.0
