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
from ldctoolkit.numba_internals import OPTIONS, copy, fma, larger
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.actuator import parabola
from ldctoolkit.simulation.kernel.block_table import ACTIVE, SAME, L
from ldctoolkit.simulation.kernel.road import lay_time
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
def _recorded_motion(setting, w, motion, block):
    """Rates y' and y'' of the recorded path at the times in `TIME`, into `WORK_0` and `WORK_1`.

    After T the driver straightens: y'' = (A + B s) exp(-s/tau) goes on with the value and the slope that it has at T.
    """
    h, tau, table = 0.5 * setting[data.DT], data.STRAIGHTENS_IN, motion.shape[0] > 0
    for l in range(L if table else 0):
        i = min(block * L + l, motion.shape[0] - 1)
        at = (w[data.TIME + l] - w[data.T_0 + l]) / h
        j = min(int(at + SAME), motion.shape[1] - 2)
        u = min(max(at - j, 0.0), 1.0)
        # the cubic through y' at both ends with the slopes y'', and its own slope
        rate, bend, bend_after = motion[i, j, 0], motion[i, j, 1], motion[i, j + 1, 1]
        rise = motion[i, j + 1, 0] - rate
        a, b = h * (bend + bend_after) - 2.0 * rise, 3.0 * rise - h * (2.0 * bend + bend_after)
        w[data.WORK_0 + l] = rate + u * (h * bend + u * (b + u * a))
        w[data.WORK_1 + l] = bend + u * (2.0 * b + 3.0 * u * a) / h
    for l in range(0 if table else int(setting[data.WIDTH])):
        a, b = w[data.T_0 + l], min(w[data.TIME + l], w[data.T + l])
        c_0, c_1, c_2, after = w[data.BEND_0 + l], w[data.BEND_1 + l], w[data.BEND_2 + l], w[data.TIME + l] - b
        bend, slope = fma(b, fma(b, c_2, c_1), c_0), fma(2.0 * b, c_2, c_1)
        whole = b * fma(b, fma(b, c_2 * (1.0 / 3.0), 0.5 * c_1), c_0)
        rate = w[data.HOLD_RATE + l] + (whole - a * fma(a, fma(a, c_2 * (1.0 / 3.0), 0.5 * c_1), c_0))
        fallen, steep = decay(-max(after, 0.0) / tau), fma(bend, 1.0 / tau, slope)
        w[data.WORK_0 + l] = rate + tau * (fma(tau, steep, bend) * (1.0 - fallen) - steep * after * fallen)
        w[data.WORK_1 + l] = fma(steep, after, bend) * fallen


@numba.njit(forceinline=True, **OPTIONS)
def _angle_of_force(w, l, force, shape, slip):
    """Slip angle of a front tyre with this force over the mass, by two of Newton's steps from an angle nearby."""
    share = force / w[data.GRIP_F + l]
    for _ in range(2):
        stiff = w[data.STIFFNESS_F + l] * slip
        angle = shape * arctan(stiff)
        slope = shape * w[data.STIFFNESS_F + l] * max(cosine(angle), 0.02) / fma(stiff, stiff, 1.0)
        slip -= (sine(angle) - share) / slope
        largest = 3.0 / w[data.STIFFNESS_F + l]
        slip = min(max(slip, -largest), largest)
    return slip


@numba.njit(**OPTIONS)
def _steer_along(setting, w):
    """Front force, steering angle and yaw acceleration with which the twin moves as recorded.

    The equations of `rk4_loop`, solved for the front force, from y' and y'' in `WORK_0` and `WORK_1`.
    """
    saturating, shape = setting[data.SATURATING] > 0.0, setting[data.SHAPE]
    for l in range(int(setting[data.WIDTH])):
        p, bend = w[data.WORK_0 + l], w[data.WORK_1 + l]
        psi, turn = w[data.TWIN_PSI + l], w[data.TWIN_TURN + l]
        v, per_v, lane = w[data.V_START + l], w[data.PER_V_START + l], w[data.LANE_START + l]
        dv = w[data.MOTION_DV + l] if w[data.TIME + l] < w[data.T + l] else 0.0
        omega, delta = turn + lane, w[data.TWIN_DELTA + l]
        if saturating:
            sin_psi, cos_psi = sine(psi), cosine(psi)
            across = fma(-v, sin_psi, p) / cos_psi
            slip_rear = arctan(fma(w[data.AXLE_R + l], omega, -across) * per_v)
            rear = w[data.GRIP_R + l] * sine(shape * arctan(w[data.STIFFNESS_R + l] * slip_rear))
            a_y = (bend - fma(dv, sin_psi, turn * fma(v, cos_psi, -across * sin_psi))) / cos_psi + v * omega
            most = _MOST * w[data.GRIP_F + l] * cosine(delta)  # beyond it the path is not driven
            front = min(max(a_y - rear, -most), most)
            slip = _angle_of_force(w, l, front / cosine(delta), shape, w[data.TWIN_SLIP + l])
            delta = slip + arctan(fma(w[data.AXLE_F + l], omega, across) * per_v)
        else:
            across = fma(-v, psi, p)
            rear = w[data.STIFFNESS_R + l] * (per_v * fma(w[data.AXLE_R + l], omega, -across))
            slip = 0.0
            front = fma(v, lane, fma(w[data.PRINTED_TERM + l] * turn, per_v, fma(-dv, psi, bend))) - rear
            delta = front / w[data.STIFFNESS_F + l] + per_v * fma(w[data.AXLE_F + l], omega, across)
        moves, yaw = w[data.TWIN_H + l] > 0.0, fma(w[data.ARM_F + l], front, -w[data.ARM_R + l] * rear)
        w[data.TWIN_SLIP + l] = slip if moves else w[data.TWIN_SLIP + l]  # no more of Newton's steps than alone
        w[data.TWIN_DELTA + l] = delta if moves else w[data.TWIN_DELTA + l]
        w[data.TWIN_FRONT + l] = front if moves else w[data.TWIN_FRONT + l]
        w[data.TWIN_YAW + l] = yaw if moves else w[data.TWIN_YAW + l]


@numba.njit(**OPTIONS)
def lay_recorded(setting, w, motion, block, k, intended, to):
    """Recorded steering over sample k, from `to` on: angle, front force at its start, middle and end; y'' at its start.

    The yaw motion of a twin on the recorded path, by Runge and Kutta's method; each sample once and in order.
    """
    half, most = 0.5 * setting[data.DT], 1
    for l in range(L):
        w[data.TWIN_STEPS + l] = math.ceil(max(w[data.N_SUBSTEPS + l], 1.0) * (1.0 / 6.0))
        most = max(most, int(w[data.TWIN_STEPS + l]))
        w[data.TIME + l], w[data.TWIN_H + l] = w[data.T_0 + l] + k * setting[data.DT], 1.0
    if k == 0:
        copy(w, data.HOLD_RATE, w, data.E_Y_RATE, 1)
        copy(w, data.TWIN_PSI, w, data.E_PSI, 2)
        copy(w, data.TWIN_DELTA, w, data.WHEEL, 1)
        for l in range(L):
            w[data.TWIN_SLIP + l] = 0.0
    lay_time(setting, w)
    _recorded_motion(setting, w, motion, block)
    for _ in range(4 if k == 0 else 0):
        _steer_along(setting, w)
    copy(intended, to + 6 * L, w, data.WORK_1, 1)
    for n in range(3):
        copy(intended, to + n * L, w, data.TWIN_DELTA, 1)
        copy(intended, to + (3 + n) * L, w, data.TWIN_FRONT, 1)
        for j in range(most if n < 2 else 0):
            _twin_step(setting, w, motion, block, k * setting[data.DT] + half * n, j)


@numba.njit(**OPTIONS)
def _twin_step(setting, w, motion, block, since, j):
    """Step j of the twin in the half sample that begins so long after the trigger."""
    for l in range(L):
        w[data.TWIN_H + l] = 0.5 * setting[data.DT] / w[data.TWIN_STEPS + l] if j < w[data.TWIN_STEPS + l] else 0.0
    copy(w, data.TWIN_PSI_BEFORE, w, data.TWIN_PSI, 2)
    copy(w, data.TWIN_PSI_AFTER, w, data.TWIN_PSI, 2)
    for stage in range(4):
        weight, reach = (1.0 / 6.0) if stage % 3 == 0 else (1.0 / 3.0), 0.5 if stage < 2 else 1.0
        for l in range(int(setting[data.WIDTH])):
            h, turn, yaw = w[data.TWIN_H + l], w[data.TWIN_TURN + l], w[data.TWIN_YAW + l]
            w[data.TIME + l] = w[data.T_0 + l] + (since + min(fma(h, reach, j * h), 0.5 * setting[data.DT]))
            w[data.TIME + l] += 0.5 * setting[data.DT] if h == 0.0 else 0.0
            psi_after = fma(weight * h, turn, w[data.TWIN_PSI_AFTER + l])
            turn_after = fma(weight * h, yaw, w[data.TWIN_TURN_AFTER + l])
            w[data.TWIN_PSI_AFTER + l], w[data.TWIN_TURN_AFTER + l] = psi_after, turn_after
            psi, rate = (
                fma(reach * h, turn, w[data.TWIN_PSI_BEFORE + l]),
                fma(reach * h, yaw, w[data.TWIN_TURN_BEFORE + l]),
            )
            w[data.TWIN_PSI + l] = psi_after if stage == 3 else psi
            w[data.TWIN_TURN + l] = turn_after if stage == 3 else rate
        if stage % 2 == 0:
            lay_time(setting, w)
            _recorded_motion(setting, w, motion, block)
        _steer_along(setting, w)


# ------------------------------------------------------------------------------------------------ what he means


@numba.njit(**OPTIONS)
def begin_sample(setting, w, k, intended, to):
    """What the driver means over sample k, how tense he is, and the assist's authority."""
    dt = setting[data.DT]
    at_once = setting[data.RAMP] == 0.0
    ramp = 1.0 if at_once else dt / setting[data.RAMP]
    copy(w, data.MEANT_START, intended, to, 6)
    if k == 0:
        copy(w, data.HOLD_FRONT, intended, to + 3 * L, 1)
        copy(w, data.HOLD_ANGLE, w, data.WHEEL, 1)
    copy(w, data.WORK_0, intended, to + 6 * L, 1)
    t, steers_out = k * dt, k * dt < _ACROSS_FOR - SAME
    for l in range(int(setting[data.WIDTH])):
        intent, reaction, f = w[data.INTENT + l], w[data.REACTION + l], w[data.FREQUENCY + l]
        back = -f * fma(f, w[data.E_Y + l], 2.0 * setting[data.RETURN_DAMPING] * w[data.E_Y_RATE + l])
        back = min(max(back, -_HARDEST), _HARDEST)
        returns, holds = (intent == _RETURNS) & (t >= reaction - SAME), intent == _STRAIGHT
        target = back if returns else (w[data.ACROSS + l] if steers_out else 0.0)
        target = target - w[data.WORK_0 + l] if returns | (intent == _AGAINST) else 0.0
        w[data.OWN_TARGET + l] = target
        angle, force = w[data.HOLD_ANGLE + l], w[data.HOLD_FRONT + l]
        for n in range(3):
            w[data.MEANT_START + n * L + l] = angle if holds else w[data.MEANT_START + n * L + l]
            w[data.MEANT_FORCE_START + n * L + l] = force if holds else w[data.MEANT_FORCE_START + n * L + l]
        late = min(max((t - reaction) * (1.0 / _RELAXES_IN), 0.0), 1.0)
        later = min(max((t + dt - reaction) * (1.0 / _RELAXES_IN), 0.0), 1.0)
        gives = _RELAXED - 1.0 if intent == _FOLLOWS else 0.0
        w[data.TENSE_START + l], w[data.TENSE_END + l] = fma(gives, late, 1.0), fma(gives, later, 1.0)
        authority = w[data.AUTHORITY + l]
        end = authority + (ramp if w[data.ASSIST_STATE + l] == ACTIVE else -ramp)
        end = 1.0 if end > 1.0 - SAME else (end if end > SAME else 0.0)  # whole ramps, whatever their rounding
        w[data.AUTHORITY_START + l], w[data.AUTHORITY + l] = end if at_once else authority, end


@numba.njit(**OPTIONS)
def supervise(setting, w, k):
    """State of the assist at the end of sample k, which is that of the next: override, hand-over, return."""
    share = min(1.0, _STEP / setting[data.RAMP]) if setting[data.RAMP] > 0.0 else 1.0
    dt, after = setting[data.DT], setting[data.RETURN_AFTER]
    hold, calm = setting[data.OVERRIDE_TIME] - SAME, after - SAME if after > 0.0 else math.inf
    firm, limit = setting[data.OVERRIDE_TORQUE], setting[data.TORQUE_MAX] * (1.0 - SAME)
    for l in range(int(setting[data.WIDTH])):
        alive, state, authority = w[data.ALIVE + l] > 0.0, w[data.ASSIST_STATE + l], w[data.AUTHORITY + l]
        beyond, step = abs(w[data.TORQUE + l]) > firm, abs(w[data.ASSIST + l]) * share
        count = w[data.BEYOND + l] + 1.0
        long_beyond = count if beyond else 0.0
        trips = (state == ACTIVE) & beyond & (long_beyond * dt >= hold)
        leaves = (authority == 0.0) & ((state == _OVERRIDDEN) | trips)
        long_calm = 0.0 if beyond else (1.0 if leaves else count)
        comes_back = ((state == _RELEASED) | leaves) & (long_calm * dt >= calm)
        after_it = _OVERRIDDEN if trips else state
        after_it = ACTIVE if comes_back else (_RELEASED if leaves else after_it)
        passed = long_beyond if state == ACTIVE else long_calm
        w[data.BEYOND + l] = 0.0 if comes_back | trips else passed
        w[data.ASSIST_STATE + l] = after_it if alive else state
        w[data.OVERRIDDEN + l] = 1.0 if trips & alive else w[data.OVERRIDDEN + l]
        hands_over = trips | ((k + 1 == w[data.ALL_STEPS + l]) & (after_it == ACTIVE))
        w[data.HANDOVER_STEP + l] = larger(w[data.HANDOVER_STEP + l], step if hands_over & alive else 0.0)
        yields = (abs(w[data.ASSIST + l]) >= limit) | (after_it != ACTIVE) | (authority < 1.0)
        w[data.YIELDING + l] = 1.0 if yields else w[data.YIELDING + l]


# ------------------------------------------------------------------------------------------------ the column


@numba.njit(**OPTIONS)
def begin_segment(w):
    """Take back what the actuator scored: the wheels move otherwise, and its angle is what the assist follows."""
    copy(w, data.REFERENCE, w, data.WHEEL, 1)
    copy(w, data.WHEEL, w, data.HELD_WHEEL, 1)
    for row in (data.DELTA_PEAK, data.EFFORT, data.TRAVEL):
        copy(w, row, w, data.SAVED + row - data.SCORE, 1)


@numba.njit(**OPTIONS)
def lay(setting, w):
    """What acts along a substep, as polynomials in the time since its start."""
    direct = setting[data.LAG] == 0.0 and setting[data.RATE_MAX] == math.inf
    per_dt, ratio = 1.0 / setting[data.DT], setting[data.RATIO] if setting[data.ARMS] > 0.0 else 1.0
    for l in range(int(setting[data.WIDTH])):
        w[data.PARALLEL + l] = 1.0 if w[data.NEXT_E_Y_RATE + l] <= 0.0 else w[data.PARALLEL + l]
        w[data.MOMENT_0 + l] = w[data.MOMENT_1 + l] = w[data.MOMENT_2 + l] = 0.0
        h, u = w[data.H + l], w[data.COMMAND + l]
        a, b, c = w[data.DELTA_START + l], w[data.DELTA_MID + l], w[data.DELTA_END + l]
        a, b, c = u if direct else a, u if direct else b, u if direct else c
        per_h = 1.0 / h if h > 0.0 else 0.0
        w[data.REF_0 + l], w[data.REF_1 + l] = ratio * a, ratio * (4.0 * b - 3.0 * a - c) * per_h
        w[data.REF_2 + l] = ratio * 2.0 * (a + c - 2.0 * b) * per_h * per_h
        s = (w[data.PIECE_START + l] + w[data.PIECE_TIME + l] - w[data.SAMPLE_START + l]) * per_dt
        half = decay(-0.5 * _LAG * h)  # what his own acceleration wants, at start, middle and end of the substep
        u, e = fma(0.5 * h, per_dt, s), fma(h, per_dt, s)
        target = w[data.OWN_TARGET + l]
        q_a = w[data.OWN_A_Y + l]
        q_b = fma(q_a - target, half, target)
        q_c = fma(q_b - target, half, target)
        w[data.OWN_A_Y + l] = q_c if h > 0.0 else q_a
        a, b, c = w[data.MEANT_START + l], w[data.MEANT_MID + l], w[data.MEANT_END + l]
        d_1, d_2, gain = 4.0 * b - 3.0 * a - c, 2.0 * (a + c - 2.0 * b), w[data.DELTA_PER_A_Y + l]
        b, c = ratio * fma(gain, q_b, fma(u, fma(u, d_2, d_1), a)), ratio * fma(gain, q_c, fma(e, fma(e, d_2, d_1), a))
        a = ratio * fma(gain, q_a, fma(s, fma(s, d_2, d_1), a))
        w[data.MEANT_0 + l], w[data.MEANT_1 + l] = a, (4.0 * b - 3.0 * a - c) * per_h
        w[data.MEANT_2 + l] = 2.0 * (a + c - 2.0 * b) * per_h * per_h
        a, b, c = w[data.MEANT_FORCE_START + l], w[data.MEANT_FORCE_MID + l], w[data.MEANT_FORCE_END + l]
        d_1, d_2, gain = 4.0 * b - 3.0 * a - c, 2.0 * (a + c - 2.0 * b), w[data.FORCE_PER_A_Y + l]
        trail = w[data.TRAIL_TORQUE + l]
        b, c = trail * fma(gain, q_b, fma(u, fma(u, d_2, d_1), a)), trail * fma(gain, q_c, fma(e, fma(e, d_2, d_1), a))
        a = trail * fma(gain, q_a, fma(s, fma(s, d_2, d_1), a))
        w[data.FEED_0 + l], w[data.FEED_1 + l] = a, (4.0 * b - 3.0 * a - c) * per_h
        w[data.FEED_2 + l] = 2.0 * (a + c - 2.0 * b) * per_h * per_h
        for n in range(2):
            start, end = w[data.TENSE_START + 2 * n * L + l], w[data.TENSE_END + 2 * n * L + l]
            w[data.TENSE_0 + 2 * n * L + l] = fma(s, end - start, start)
            w[data.TENSE_1 + 2 * n * L + l] = (end - start) * per_dt


@numba.njit(forceinline=True, **OPTIONS)
def column(w, l, s, angle, rate, align, k_a, b_a, b_d, b_w, limit, per_inertia):
    """Acceleration of the column, and both torques, at the time s of a substep with this aligning torque."""
    meant = fma(s, fma(s, w[data.MEANT_2 + l], w[data.MEANT_1 + l]), w[data.MEANT_0 + l])
    meant_rate = fma(2.0 * s, w[data.MEANT_2 + l], w[data.MEANT_1 + l])
    reference = fma(s, fma(s, w[data.REF_2 + l], w[data.REF_1 + l]), w[data.REF_0 + l])
    feed = fma(s, fma(s, w[data.FEED_2 + l], w[data.FEED_1 + l]), w[data.FEED_0 + l])
    tense, authority = fma(s, w[data.TENSE_1 + l], w[data.TENSE_0 + l]), fma(s, w[data.AUTH_1 + l], w[data.AUTH_0 + l])
    assist = authority * min(max(fma(k_a, reference - angle, fma(-b_a, rate, align)), -limit), limit)
    arms = tense * fma(w[data.STRENGTH + l], meant - angle, b_d * (meant_rate - rate))
    torque = fma(1.0 - authority, feed, arms)
    return (assist + torque - align - b_w * rate) * per_inertia, assist, torque


@numba.njit(forceinline=True, **OPTIONS)
def score(w, l, h, before, assist_before, torque, assist, middle, mean, angle_before, angle):
    """Torques and angle at both ends of a step of the length h; the driver's torque in its middle, its mean size."""
    moved, size_before, size = h > 0.0, abs(before), abs(torque)
    opposes_before = (before * assist_before < 0.0) & (size_before > _FELT)
    opposes = (torque * assist < 0.0) & (size > _FELT)
    count = (0.5 if opposes_before else 0.0) + (0.5 if opposes else 0.0)
    peak = larger(larger(size_before, size), abs(middle))
    w[data.DRIVER_PEAK + l] = larger(w[data.DRIVER_PEAK + l], peak if moved else 0.0)
    w[data.DRIVER_MEAN + l] = fma(h, mean, w[data.DRIVER_MEAN + l])
    w[data.AGAINST_TIME + l] = fma(h, count, w[data.AGAINST_TIME + l])
    stretch = fma(h, count * w[data.PARALLEL + l], w[data.STRETCH + l])
    w[data.AGAINST_PARALLEL + l] = larger(w[data.AGAINST_PARALLEL + l], stretch)
    w[data.STRETCH + l] = stretch if opposes | (not moved) else 0.0
    w[data.TORQUE + l], w[data.ASSIST + l] = (
        torque if moved else w[data.TORQUE + l],
        assist if moved else w[data.ASSIST + l],
    )
    w[data.DELTA_PEAK + l] = larger(w[data.DELTA_PEAK + l], larger(abs(angle_before), abs(angle)) if moved else 0.0)
    w[data.TRAVEL + l] += abs(angle - angle_before)
    middle = 0.5 * (angle_before + angle)
    w[data.EFFORT + l] += h * (1.0 / 6.0) * fma(4.0 * middle, middle, fma(angle, angle, angle_before * angle_before))


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
    for l in range(int(setting[data.WIDTH])):
        h, g, z = w[data.H + l] * part, w[data.STRENGTH + l], w[data.COLUMN + l]
        s = n * h
        e, middle, per_h = s + h, fma(0.5, h, s), 1.0 / h if h > 0.0 else 0.0
        r_0 = w[data.REF_0 + l] - w[data.MEANT_0 + l]
        r_1, r_2 = w[data.REF_1 + l] - w[data.MEANT_1 + l], w[data.REF_2 + l] - w[data.MEANT_2 + l]
        before, after = fma(s, fma(s, r_2, r_1), r_0), fma(e, fma(e, r_2, r_1), r_0)
        rate = (after - before) * per_h
        holds = g * fma(middle, w[data.TENSE_1 + l], w[data.TENSE_0 + l])
        pushes = (1.0 - g) * fma(middle, w[data.AUTH_1 + l], w[data.AUTH_0 + l])
        # at the limit: how long
        excess = abs(before - z) - limit
        sign, base = math.copysign(1.0, before - z), pushes * math.copysign(limit, before - z) / holds
        falls = sign * fma(base - z, per_tau, -rate)
        at = min(excess / falls, h) if falls > 0.0 else h
        remaining = (z - base) * decay(-at * per_tau)
        falls = sign * fma(-remaining, per_tau, -rate)
        left = sign * (fma(rate, at, before) - base - remaining) - limit
        at = min(max(at + left / falls, 0.0), h) if falls > 0.0 else h
        at = at if excess > 0.0 else 0.0
        z_at, m_0, m_1, m_2 = _relax(z, base, 0.0, at * per_tau)
        share, rest = at * per_h, h - at
        # then without it
        firm = holds + pushes
        fall = rest * firm / holds * per_tau
        slope = pushes * rate * rest / firm
        r_at = fma(rate, at, before)
        base = pushes * r_at / firm - (slope / fall if fall > 0.0 else 0.0)
        z_end, n_0, n_1, n_2 = _relax(z_at, base, slope, fall)
        z_end = z_end if h > 0.0 else z
        # integrals over the substep, whose parts begin at `first` and `a`
        p, q, a = part * share, part * (1.0 - share), fma(part, share, first)
        w[data.MOMENT_0 + l] += fma(p, m_0, q * n_0)
        w[data.MOMENT_1 + l] += p * fma(first, m_0, p * m_1) + q * fma(a, n_0, q * n_1)
        w[data.MOMENT_2 + l] += p * fma(first * first, m_0, p * fma(2.0 * first, m_1, p * m_2))
        w[data.MOMENT_2 + l] += q * fma(a * a, n_0, q * fma(2.0 * a, n_1, q * n_2))
        a_0, a_1 = fma(s, w[data.AUTH_1 + l], w[data.AUTH_0 + l]), fma(e, w[data.AUTH_1 + l], w[data.AUTH_0 + l])
        assist_before = a_0 * stiffness * min(max(before - z, -limit), limit)
        assist = a_1 * stiffness * min(max(after - z_end, -limit), limit)
        same = (r_at - z_at) * (after - z_end) > 0.0
        mean = abs(0.5 * (r_at + after) - n_0) if same else 0.5 * (abs(r_at - z_at) + abs(after - z_end))
        mean = 0.5 * (a_0 + a_1) * stiffness * fma(share, limit - mean, mean)
        angle_before = z + fma(s, fma(s, w[data.MEANT_2 + l], w[data.MEANT_1 + l]), w[data.MEANT_0 + l])
        angle = z_end + fma(e, fma(e, w[data.MEANT_2 + l], w[data.MEANT_1 + l]), w[data.MEANT_0 + l])
        score(w, l, h, -assist_before, assist_before, -assist, assist, assist, mean, angle_before, angle)
        w[data.COLUMN + l] = z_end


@numba.njit(**OPTIONS)
def hold(setting, w):
    """The wheels' angle that a grip makes of it over a substep, as the parabola that the vehicle sees; its scores."""
    parts = int(setting[data.GRIP_STEPS])
    for n in range(parts):
        _grip(setting, w, n, parts)
    for l in range(int(setting[data.WIDTH])):
        h = w[data.H + l]
        z_0, z_1, z_2 = parabola(w[data.MOMENT_0 + l], w[data.MOMENT_1 + l], w[data.MOMENT_2 + l])
        a, b, c = w[data.MEANT_0 + l], w[data.MEANT_1 + l], w[data.MEANT_2 + l]
        w[data.DELTA_START + l], w[data.DELTA_MID + l] = a + z_0, fma(0.5 * h, fma(0.5 * h, c, b), a) + z_1
        end = fma(h, fma(h, c, b), a)
        w[data.DELTA_END + l], w[data.WHEEL + l] = end + z_2, end + w[data.COLUMN + l] if h > 0.0 else w[data.WHEEL + l]
