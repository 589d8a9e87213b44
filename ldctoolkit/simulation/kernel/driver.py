"""The driver at the wheel: what he means to do, how arms and column move the wheels, when the assist yields.

Angles of the column and torques are those at the steering wheel, in the outward frame; with authority a, tension s,

    arms:  (J_w + J_d) theta'' = T_a + T_d - T_s - b_w theta',
           T_a = a sat(k_a (theta_a - theta) - b_a theta' + T_s),
           T_d = s (k_d (theta_d - theta) + b_d (theta_d' - theta')) + (1 - a) T_ff,
    grip:  delta = delta_d + z,    s g tau_d z' = (1 - g) a sat(delta_a - delta_d - z) - s g z,    T_d = -T_a.

theta_a is what the actuator makes of the command; theta_d and T_ff are the angle and the aligning torque that the
driver means, parabolas over a sample. The arms go with the vehicle through the substeps of `rk4_loop`; the grip is
driven in closed form.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.control import AssistState
from ldctoolkit.lanes import fma, select
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.actuator import parabola
from ldctoolkit.simulation.kernel.block_table import ACTIVE, SAME, L
from ldctoolkit.simulation.kernel.road import motion_at
from ldctoolkit.vector_math import arctan, cosine, decay, moments, sine

_OVERRIDDEN: Final = float(AssistState.OVERRIDDEN)
_RELEASED: Final = float(AssistState.RELEASED)
_STRAIGHT, _FOLLOWS, _AGAINST, _RETURNS = 1.0, 2.0, 3.0, 4.0  # positions in `plant_options.INTENTS`

_LAG: Final = 1.0 / data.NEUROMUSCULAR_LAG
_ACROSS_FOR: Final = 1.0  # [s] that a driver who means to leave the lane steers outward
_RELAXES_IN: Final = 0.3  # [s] in which a driver gives way
_RELAXED: Final = 0.05  # share of the tension that stays
_HARDEST: Final = 2.0  # [m/s^2] that a driver who corrects steers for
_FELT: Final = 1.0  # [N m] from which a torque against the assist counts
_STEP: Final = 0.1  # [s] within which the torque at a hand-over may change
_MOST: Final = 0.999  # share of its largest force that a tyre is steered to


# ------------------------------------------------------------------------------------------------ the recorded steering


@numba.njit(**OPTIONS)
def _recorded_motion(setting, w, motion, block, t):
    """Rates y' and y'' of the recorded path at times t.

    After T the driver straightens: y'' = (A + B s) exp(-s/tau) goes on with the value and the slope that it has at T.
    """
    h, tau = 0.5 * setting[data.DT], data.STRAIGHTENS_IN
    if motion.shape[0] > 0:
        w[data.RECORDED_RATE] = (t - w[data.T_0]) / h
        for l in range(L):
            i, at = min(block * L + l, motion.shape[0] - 1), w[data.RECORDED_RATE, l]
            j = min(int(at + SAME), motion.shape[1] - 2)
            u = min(max(at - j, 0.0), 1.0)
            # the cubic through y' at both ends with the slopes y'', and its own slope
            rate, bend, bend_after = motion[i, j, 0], motion[i, j, 1], motion[i, j + 1, 1]
            rise = motion[i, j + 1, 0] - rate
            a, b = h * (bend + bend_after) - 2.0 * rise, 3.0 * rise - h * (2.0 * bend + bend_after)
            w[data.RECORDED_RATE, l] = rate + u * (h * bend + u * (b + u * a))
            w[data.RECORDED_BEND, l] = bend + u * (2.0 * b + 3.0 * u * a) / h
        return w[data.RECORDED_RATE], w[data.RECORDED_BEND]
    start, end = w[data.T_0], min(t, w[data.T])
    c_0, c_1, c_2, after = w[data.BEND_0], w[data.BEND_1], w[data.BEND_2], t - end
    bend_at_end, slope = fma(end, fma(end, c_2, c_1), c_0), fma(2.0 * end, c_2, c_1)
    whole = end * fma(end, fma(end, c_2 * (1.0 / 3.0), 0.5 * c_1), c_0)
    rate_at_end = w[data.HOLD_RATE] + (whole - start * fma(start, fma(start, c_2 * (1.0 / 3.0), 0.5 * c_1), c_0))
    fallen, steep = decay(-max(after, 0.0) / tau), fma(bend_at_end, 1.0 / tau, slope)
    faded = fma(tau, steep, bend_at_end) * (1.0 - fallen) - steep * after * fallen
    return rate_at_end + tau * faded, fma(steep, after, bend_at_end) * fallen


@numba.njit(forceinline=True, **OPTIONS)
def _angle_of_force(w, force, shape, slip):
    """Slip angle of a front tyre with this force over the mass, by two of Newton's steps from an angle nearby."""
    share = force / w[data.GRIP_F]
    for _ in range(2):
        stiff = w[data.STIFFNESS_F] * slip
        angle = shape * arctan(stiff)
        slope = shape * w[data.STIFFNESS_F] * max(cosine(angle), 0.02) / fma(stiff, stiff, 1.0)
        slip -= (sine(angle) - share) / slope
        largest = 3.0 / w[data.STIFFNESS_F]
        slip = min(max(slip, -largest), largest)
    return slip


@numba.njit(**OPTIONS)
def _steer_along(setting, w, t, v, dv, lane, p, bend):
    """Front force, steering angle and yaw acceleration with which the twin moves as recorded at times t.

    The equations of `rk4_loop`, solved for the front force, from y' and y'' of the path, the speed, its rate before T
    and the lane's yaw rate.
    """
    saturating, shape = setting[data.SATURATING] > 0.0, setting[data.SHAPE]
    psi, turn = w[data.TWIN_PSI], w[data.TWIN_TURN]
    per_v, dv = 1.0 / v, select(t < w[data.T], dv, 0.0)
    omega, delta, slip = turn + lane, w[data.TWIN_DELTA], w[data.TWIN_SLIP]
    if saturating:
        sin_psi, cos_psi = sine(psi), cosine(psi)
        across = fma(-v, sin_psi, p) / cos_psi
        slip_rear = arctan(fma(w[data.AXLE_R], omega, -across) * per_v)
        rear = w[data.GRIP_R] * sine(shape * arctan(w[data.STIFFNESS_R] * slip_rear))
        a_y = (bend - fma(dv, sin_psi, turn * fma(v, cos_psi, -across * sin_psi))) / cos_psi + v * omega
        most = _MOST * w[data.GRIP_F] * cosine(delta)  # beyond it the path is not driven
        front = min(max(a_y - rear, -most), most)
        slip = _angle_of_force(w, front / cosine(delta), shape, slip)
        delta = slip + arctan(fma(w[data.AXLE_F], omega, across) * per_v)
    else:
        across = fma(-v, psi, p)
        rear = w[data.STIFFNESS_R] * (per_v * fma(w[data.AXLE_R], omega, -across))
        front = fma(v, lane, fma(w[data.PRINTED_TERM] * turn, per_v, fma(-dv, psi, bend))) - rear
        delta = front / w[data.STIFFNESS_F] + per_v * fma(w[data.AXLE_F], omega, across)
    moves, yaw = w[data.TWIN_H] > 0.0, fma(w[data.ARM_F], front, -w[data.ARM_R] * rear)
    w[data.TWIN_SLIP] = select(moves, slip, w[data.TWIN_SLIP])  # no more of Newton's steps than alone
    w[data.TWIN_DELTA] = select(moves, delta, w[data.TWIN_DELTA])
    w[data.TWIN_FRONT] = select(moves, front, w[data.TWIN_FRONT])
    w[data.TWIN_YAW] = select(moves, yaw, w[data.TWIN_YAW])


@numba.njit(**OPTIONS)
def lay_recorded(setting, w, motion, block, k, intended, to):
    """Recorded steering over sample k, from `to` on: angle, front force at its start, middle and end; y'' at its start.

    The yaw motion of a twin on the recorded path, by Runge and Kutta's method; each sample once and in order.
    """
    half, most, t = 0.5 * setting[data.DT], 1, w[data.T_0] + k * setting[data.DT]
    for l in range(L):
        w[data.TWIN_STEPS, l] = math.ceil(math.ceil(max(w[data.SUBSTEPS_A_SAMPLE, l], 1.0) - SAME) * (1.0 / 6.0))
        most = max(most, int(w[data.TWIN_STEPS, l]))
    w[data.TWIN_H] = 1.0
    if k == 0:
        w[data.HOLD_RATE], w[data.TWIN_DELTA], w[data.TWIN_SLIP] = w[data.E_Y_RATE], w[data.WHEEL], 0.0
        w[data.TWIN_PSI], w[data.TWIN_TURN] = w[data.E_PSI], w[data.E_PSI_RATE]
    v, dv, lane = motion_at(setting, w, t)
    rate, bend = _recorded_motion(setting, w, motion, block, t)
    for _ in range(4 if k == 0 else 0):
        _steer_along(setting, w, t, v, dv, lane, rate, bend)
    intended[to + 6] = bend
    for n in range(3):
        intended[to + n], intended[to + 3 + n] = w[data.TWIN_DELTA], w[data.TWIN_FRONT]
        for j in range(most if n < 2 else 0):
            _twin_step(setting, w, motion, block, k * setting[data.DT] + half * n, j)


@numba.njit(**OPTIONS)
def _twin_step(setting, w, motion, block, since, j):
    """Step j of the twin in the half sample that begins so long after the trigger."""
    half = 0.5 * setting[data.DT]
    h = select(w[data.TWIN_STEPS] > j, half / w[data.TWIN_STEPS], 0.0)
    w[data.TWIN_H] = h
    psi_before, turn_before = w[data.TWIN_PSI], w[data.TWIN_TURN]
    psi_after, turn_after = psi_before, turn_before
    v, dv, lane, rate, bend = h, h, h, h, h
    for stage in range(4):
        weight, reach = (1.0 / 6.0) if stage % 3 == 0 else (1.0 / 3.0), 0.5 if stage < 2 else 1.0
        turn, yaw = w[data.TWIN_TURN], w[data.TWIN_YAW]
        psi_after, turn_after = fma(weight * h, turn, psi_after), fma(weight * h, yaw, turn_after)
        w[data.TWIN_PSI], w[data.TWIN_TURN] = fma(reach * h, turn, psi_before), fma(reach * h, yaw, turn_before)
        if stage == 3:
            w[data.TWIN_PSI], w[data.TWIN_TURN] = psi_after, turn_after
        t = w[data.T_0] + (since + min(fma(h, reach, j * h), half)) + select(h == 0.0, half, 0.0)
        if stage % 2 == 0:
            v, dv, lane = motion_at(setting, w, t)
            rate, bend = _recorded_motion(setting, w, motion, block, t)
        _steer_along(setting, w, t, v, dv, lane, rate, bend)


# ------------------------------------------------------------------------------------------------ what he means


@numba.njit(**OPTIONS)
def begin_sample(setting, w, k, intended, to):
    """What the driver means over sample k, how tense he is, and the assist's authority."""
    dt = setting[data.DT]
    at_once = setting[data.RAMP] == 0.0
    ramp = 1.0 if at_once else dt / setting[data.RAMP]
    for n in range(6):
        w[data.MEANT_START + n] = intended[to + n]
    if k == 0:
        w[data.HOLD_FRONT] = intended[to + 3]
        w[data.HOLD_ANGLE] = w[data.WHEEL]
    t, steers_out = k * dt, k * dt < _ACROSS_FOR - SAME
    intent, reaction, f = w[data.INTENT], w[data.REACTION], w[data.FREQUENCY]
    back = -f * fma(f, w[data.E_Y], 2.0 * setting[data.RETURN_DAMPING] * w[data.E_Y_RATE])
    back = min(max(back, -_HARDEST), _HARDEST)
    returns, holds = (intent == _RETURNS) & (t >= reaction - SAME), intent == _STRAIGHT
    target = select(returns, back, select(steers_out, w[data.ACROSS], 0.0))
    target = select(returns | (intent == _AGAINST), target - intended[to + 6], 0.0)
    w[data.OWN_TARGET] = target
    angle, force = w[data.HOLD_ANGLE], w[data.HOLD_FRONT]
    for n in range(3):
        w[data.MEANT_START + n] = select(holds, angle, w[data.MEANT_START + n])
        w[data.MEANT_FORCE_START + n] = select(holds, force, w[data.MEANT_FORCE_START + n])
    late = min(max((t - reaction) * (1.0 / _RELAXES_IN), 0.0), 1.0)
    later = min(max((t + dt - reaction) * (1.0 / _RELAXES_IN), 0.0), 1.0)
    gives = select(intent == _FOLLOWS, _RELAXED - 1.0, 0.0)
    w[data.TENSE_START], w[data.TENSE_END] = fma(gives, late, 1.0), fma(gives, later, 1.0)
    authority = w[data.AUTHORITY]
    end = authority + select(w[data.ASSIST_STATE] == ACTIVE, ramp, -ramp)
    end = select(end > 1.0 - SAME, 1.0, select(end > SAME, end, 0.0))  # whole ramps, whatever their rounding
    w[data.AUTHORITY_START], w[data.AUTHORITY] = select(at_once, end, authority), end


@numba.njit(**OPTIONS)
def supervise(setting, w, k):
    """State of the assist at the end of sample k, which is that of the next: override, hand-over, return."""
    share = min(1.0, _STEP / setting[data.RAMP]) if setting[data.RAMP] > 0.0 else 1.0
    dt, after = setting[data.DT], setting[data.RETURN_AFTER]
    hold, calm = setting[data.OVERRIDE_TIME] - SAME, after - SAME if after > 0.0 else math.inf
    firm, limit = setting[data.OVERRIDE_TORQUE], setting[data.TORQUE_MAX] * (1.0 - SAME)
    alive, state, authority = w[data.ALIVE] > 0.0, w[data.ASSIST_STATE], w[data.AUTHORITY]
    beyond, step = abs(w[data.TORQUE]) > firm, abs(w[data.ASSIST]) * share
    count = w[data.BEYOND] + 1.0
    long_beyond = select(beyond, count, 0.0)
    trips = (state == ACTIVE) & beyond & (long_beyond * dt >= hold)
    leaves = (authority == 0.0) & ((state == _OVERRIDDEN) | trips)
    long_calm = select(beyond, 0.0, select(leaves, 1.0, count))
    comes_back = ((state == _RELEASED) | leaves) & (long_calm * dt >= calm)
    after_it = select(trips, _OVERRIDDEN, state)
    after_it = select(comes_back, ACTIVE, select(leaves, _RELEASED, after_it))
    passed = select(state == ACTIVE, long_beyond, long_calm)
    w[data.BEYOND] = select(comes_back | trips, 0.0, passed)
    w[data.ASSIST_STATE] = select(alive, after_it, state)
    w[data.OVERRIDDEN] = select(trips & alive, 1.0, w[data.OVERRIDDEN])
    hands_over = trips | ((k + 1 == w[data.ALL_STEPS]) & (after_it == ACTIVE))
    w[data.HANDOVER_STEP] = max(w[data.HANDOVER_STEP], select(hands_over & alive, step, 0.0))
    yields = (abs(w[data.ASSIST]) >= limit) | (after_it != ACTIVE) | (authority < 1.0)
    w[data.YIELDING] = select(yields, 1.0, w[data.YIELDING])


# ------------------------------------------------------------------------------------------------ the column


@numba.njit(**OPTIONS)
def begin_segment(w):
    """Take back what the actuator scored: the wheels move otherwise, and its angle is what the assist follows."""
    w[data.REFERENCE] = w[data.WHEEL]
    w[data.WHEEL] = w[data.HELD_WHEEL]
    for row in (data.DELTA_PEAK, data.EFFORT, data.TRAVEL):
        w[row] = w[data.SAVED + row - data.SCORE]


@numba.njit(**OPTIONS)
def lay(setting, w):
    """What acts along a substep, as polynomials in the time since its start."""
    direct = setting[data.LAG] == 0.0 and setting[data.RATE_MAX] == math.inf
    per_dt, ratio = 1.0 / setting[data.DT], setting[data.RATIO] if setting[data.ARMS] > 0.0 else 1.0
    w[data.PARALLEL] = select(w[data.NEXT_E_Y_RATE] <= 0.0, 1.0, w[data.PARALLEL])
    w[data.MOMENT_0] = w[data.MOMENT_1] = w[data.MOMENT_2] = 0.0
    h, u = w[data.H], w[data.COMMAND]
    a, b, c = w[data.DELTA_START], w[data.DELTA_MID], w[data.DELTA_END]
    a, b, c = select(direct, u, a), select(direct, u, b), select(direct, u, c)
    per_h = select(h > 0.0, 1.0 / h, 0.0)
    w[data.REF_0], w[data.REF_1] = ratio * a, ratio * (4.0 * b - 3.0 * a - c) * per_h
    w[data.REF_2] = ratio * 2.0 * (a + c - 2.0 * b) * per_h * per_h
    s = (w[data.PIECE_START] + w[data.PIECE_TIME] - w[data.SAMPLE_START]) * per_dt
    half = decay(-0.5 * _LAG * h)  # what his own acceleration wants, at start, middle and end of the substep
    u, e = fma(0.5 * h, per_dt, s), fma(h, per_dt, s)
    target = w[data.OWN_TARGET]
    q_a = w[data.OWN_A_Y]
    q_b = fma(q_a - target, half, target)
    q_c = fma(q_b - target, half, target)
    w[data.OWN_A_Y] = select(h > 0.0, q_c, q_a)
    a, b, c = w[data.MEANT_START], w[data.MEANT_MID], w[data.MEANT_END]
    d_1, d_2, gain = 4.0 * b - 3.0 * a - c, 2.0 * (a + c - 2.0 * b), w[data.DELTA_PER_A_Y]
    b, c = ratio * fma(gain, q_b, fma(u, fma(u, d_2, d_1), a)), ratio * fma(gain, q_c, fma(e, fma(e, d_2, d_1), a))
    a = ratio * fma(gain, q_a, fma(s, fma(s, d_2, d_1), a))
    w[data.MEANT_0], w[data.MEANT_1] = a, (4.0 * b - 3.0 * a - c) * per_h
    w[data.MEANT_2] = 2.0 * (a + c - 2.0 * b) * per_h * per_h
    a, b, c = w[data.MEANT_FORCE_START], w[data.MEANT_FORCE_MID], w[data.MEANT_FORCE_END]
    d_1, d_2, gain = 4.0 * b - 3.0 * a - c, 2.0 * (a + c - 2.0 * b), w[data.FORCE_PER_A_Y]
    trail = w[data.TRAIL_TORQUE]
    b, c = trail * fma(gain, q_b, fma(u, fma(u, d_2, d_1), a)), trail * fma(gain, q_c, fma(e, fma(e, d_2, d_1), a))
    a = trail * fma(gain, q_a, fma(s, fma(s, d_2, d_1), a))
    w[data.FEED_0], w[data.FEED_1] = a, (4.0 * b - 3.0 * a - c) * per_h
    w[data.FEED_2] = 2.0 * (a + c - 2.0 * b) * per_h * per_h
    for n in range(2):
        start, end = w[data.TENSE_START + 2 * n], w[data.TENSE_END + 2 * n]
        w[data.TENSE_0 + 2 * n] = fma(s, end - start, start)
        w[data.TENSE_1 + 2 * n] = (end - start) * per_dt


@numba.njit(forceinline=True, **OPTIONS)
def column(setting, w, s, angle, rate, align):
    """Acceleration of the column, and both torques, at the time s of a substep with this aligning torque."""
    k_a, b_a, limit = setting[data.ASSIST_STIFFNESS], setting[data.ASSIST_DAMPING], setting[data.TORQUE_MAX]
    meant = fma(s, fma(s, w[data.MEANT_2], w[data.MEANT_1]), w[data.MEANT_0])
    meant_rate = fma(2.0 * s, w[data.MEANT_2], w[data.MEANT_1])
    reference = fma(s, fma(s, w[data.REF_2], w[data.REF_1]), w[data.REF_0])
    feed = fma(s, fma(s, w[data.FEED_2], w[data.FEED_1]), w[data.FEED_0])
    tense, authority = fma(s, w[data.TENSE_1], w[data.TENSE_0]), fma(s, w[data.AUTH_1], w[data.AUTH_0])
    assist = authority * min(max(fma(k_a, reference - angle, fma(-b_a, rate, align)), -limit), limit)
    arms = tense * fma(w[data.STRENGTH], meant - angle, setting[data.ARM_DAMPING] * (meant_rate - rate))
    torque = fma(1.0 - authority, feed, arms)
    acceleration = (assist + torque - align - setting[data.WHEEL_DAMPING] * rate) / setting[data.INERTIA]
    return acceleration, assist, torque


@numba.njit(forceinline=True, **OPTIONS)
def end_step(setting, w, since, h, before, assist_before, middle, angle_before, angle, rate, align):
    """Column and wheels at the end of a substep, with the driver's torque before it and in its middle; their scores."""
    _, assist, torque = column(setting, w, since + h, angle, rate, align)
    mean, per_ratio = (1.0 / 6.0) * (abs(before) + 4.0 * abs(middle) + abs(torque)), 1.0 / setting[data.RATIO]
    wheel_before, wheel = angle_before * per_ratio, angle * per_ratio
    score(w, h, before, assist_before, torque, assist, middle, mean, wheel_before, wheel)
    w[data.COLUMN], w[data.COLUMN_RATE], w[data.WHEEL] = angle, rate, wheel


@numba.njit(forceinline=True, **OPTIONS)
def score(w, h, before, assist_before, torque, assist, middle, mean, angle_before, angle):
    """Torques and angle at both ends of a step of the length h; the driver's torque in its middle, its mean size."""
    moved, size_before, size = h > 0.0, abs(before), abs(torque)
    opposes_before = (before * assist_before < 0.0) & (size_before > _FELT)
    opposes = (torque * assist < 0.0) & (size > _FELT)
    count = select(opposes_before, 0.5, 0.0) + select(opposes, 0.5, 0.0)
    peak = max(max(size_before, size), abs(middle))
    w[data.DRIVER_PEAK] = max(w[data.DRIVER_PEAK], select(moved, peak, 0.0))
    w[data.DRIVER_MEAN] = fma(h, mean, w[data.DRIVER_MEAN])
    w[data.AGAINST_TIME] = fma(h, count, w[data.AGAINST_TIME])
    stretch = fma(h, count * w[data.PARALLEL], w[data.STRETCH])
    w[data.AGAINST_PARALLEL] = max(w[data.AGAINST_PARALLEL], stretch)
    w[data.STRETCH] = select(opposes | ~moved, stretch, 0.0)
    w[data.TORQUE] = select(moved, torque, w[data.TORQUE])
    w[data.ASSIST] = select(moved, assist, w[data.ASSIST])
    w[data.DELTA_PEAK] = max(w[data.DELTA_PEAK], select(moved, max(abs(angle_before), abs(angle)), 0.0))
    w[data.TRAVEL] += abs(angle - angle_before)
    middle = 0.5 * (angle_before + angle)
    w[data.EFFORT] += h * (1.0 / 6.0) * fma(4.0 * middle, middle, fma(angle, angle, angle_before * angle_before))


@numba.njit(forceinline=True, **OPTIONS)
def _relax(z, base, slope, fall):
    """End of z = base + slope s + (z - base) exp(-fall s) at s = 1, and its integrals of s^n z, n = 0, 1, 2."""
    remaining = z - base
    i_0, i_1, i_2 = moments(fall, 1.0)
    m_0, m_1 = fma(remaining, i_0, fma(0.5, slope, base)), fma(remaining, i_1, fma(1.0 / 3.0, slope, 0.5 * base))
    return (
        fma(remaining, decay(-fall), base + slope),
        m_0,
        m_1,
        fma(remaining, i_2, fma(0.25, slope, base * (1.0 / 3.0))),
    )


@numba.njit(**OPTIONS)
def _grip(setting, w, n, parts):
    """Step n of so many of the grip within a substep, in closed form; its moments over the substep add up.

    First the assist's torque is at its limit, if it is, until one of Newton's steps after the first guess; then the
    angle that it follows is a straight line.
    """
    stiffness, tau = setting[data.ASSIST_STIFFNESS] * setting[data.RATIO], setting[data.ARM_LAG]
    limit, per_tau, part, first = setting[data.TORQUE_MAX] / stiffness, 1.0 / tau, 1.0 / parts, n / parts
    h, g, z = w[data.H] * part, w[data.STRENGTH], w[data.COLUMN]
    s = n * h
    e, middle, per_h = s + h, fma(0.5, h, s), select(h > 0.0, 1.0 / h, 0.0)
    r_0 = w[data.REF_0] - w[data.MEANT_0]
    r_1, r_2 = w[data.REF_1] - w[data.MEANT_1], w[data.REF_2] - w[data.MEANT_2]
    before, after = fma(s, fma(s, r_2, r_1), r_0), fma(e, fma(e, r_2, r_1), r_0)
    rate = (after - before) * per_h
    holds = g * fma(middle, w[data.TENSE_1], w[data.TENSE_0])
    pushes = (1.0 - g) * fma(middle, w[data.AUTH_1], w[data.AUTH_0])
    # at the limit: how long
    excess = abs(before - z) - limit
    sign, base = math.copysign(1.0, before - z), pushes * math.copysign(limit, before - z) / holds
    falls = sign * fma(base - z, per_tau, -rate)
    at = select(falls > 0.0, min(excess / falls, h), h)
    remaining = (z - base) * decay(-at * per_tau)
    falls = sign * fma(-remaining, per_tau, -rate)
    left = sign * (fma(rate, at, before) - base - remaining) - limit
    at = select(falls > 0.0, min(max(at + left / falls, 0.0), h), h)
    at = select(excess > 0.0, at, 0.0)
    z_at, m_0, m_1, m_2 = _relax(z, base, 0.0, at * per_tau)
    share, rest = at * per_h, h - at
    # then without it
    firm = holds + pushes
    fall = rest * firm / holds * per_tau
    slope = pushes * rate * rest / firm
    r_at = fma(rate, at, before)
    base = pushes * r_at / firm - select(fall > 0.0, slope / fall, 0.0)
    z_end, n_0, n_1, n_2 = _relax(z_at, base, slope, fall)
    z_end = select(h > 0.0, z_end, z)
    # integrals over the substep, whose parts begin at `first` and `a`
    p, q, a = part * share, part * (1.0 - share), fma(part, share, first)
    w[data.MOMENT_0] += fma(p, m_0, q * n_0)
    w[data.MOMENT_1] += p * fma(first, m_0, p * m_1) + q * fma(a, n_0, q * n_1)
    w[data.MOMENT_2] += p * fma(first * first, m_0, p * fma(2.0 * first, m_1, p * m_2))
    w[data.MOMENT_2] += q * fma(a * a, n_0, q * fma(2.0 * a, n_1, q * n_2))
    a_0, a_1 = fma(s, w[data.AUTH_1], w[data.AUTH_0]), fma(e, w[data.AUTH_1], w[data.AUTH_0])
    assist_before = a_0 * stiffness * min(max(before - z, -limit), limit)
    assist = a_1 * stiffness * min(max(after - z_end, -limit), limit)
    same = (r_at - z_at) * (after - z_end) > 0.0
    mean = select(same, abs(0.5 * (r_at + after) - n_0), 0.5 * (abs(r_at - z_at) + abs(after - z_end)))
    mean = 0.5 * (a_0 + a_1) * stiffness * fma(share, limit - mean, mean)
    angle_before = z + fma(s, fma(s, w[data.MEANT_2], w[data.MEANT_1]), w[data.MEANT_0])
    angle = z_end + fma(e, fma(e, w[data.MEANT_2], w[data.MEANT_1]), w[data.MEANT_0])
    score(w, h, -assist_before, assist_before, -assist, assist, assist, mean, angle_before, angle)
    w[data.COLUMN] = z_end


@numba.njit(**OPTIONS)
def hold(setting, w):
    """The wheels' angle that a grip makes of it over a substep, as the parabola that the vehicle sees; its scores."""
    parts = int(setting[data.GRIP_STEPS])
    for n in range(parts):
        _grip(setting, w, n, parts)
    h = w[data.H]
    z_0, z_1, z_2 = parabola(w[data.MOMENT_0], w[data.MOMENT_1], w[data.MOMENT_2])
    a, b, c = w[data.MEANT_0], w[data.MEANT_1], w[data.MEANT_2]
    w[data.DELTA_START], w[data.DELTA_MID] = a + z_0, fma(0.5 * h, fma(0.5 * h, c, b), a) + z_1
    end = fma(h, fma(h, c, b), a)
    w[data.DELTA_END], w[data.WHEEL] = end + z_2, select(h > 0.0, end + w[data.COLUMN], w[data.WHEEL])
