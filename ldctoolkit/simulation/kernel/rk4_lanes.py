"""Any plant, eight scenarios side by side: fixed steps of the classical Runge-Kutta method, branch-free.

A sample is cut into segments where something jumps, at a command that arrives within it and at T; a segment into equal
substeps, at most a quarter of the fastest time constant long. The steering angle is known in closed form along a
segment, a ramp at the rate limit and then a decay with the lag; a substep sees the parabola with the same mean, first
and second moment, so that neither the end of the ramp nor a lag far shorter than the substep costs accuracy. Scores are
taken after pieces of at most `PIECE` substeps.

Every lane does the same arithmetic, and a lane that needs fewer substeps than its neighbours goes on with length 0, so
that the numbers of a scenario do not depend on its neighbours. A loop over the lanes is compiled into vector
instructions if its body is long; a short one is unrolled instead, and its lanes are moved one by one.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.lane_functions import arctan, cosine, decay, moments, sine, touches
from ldctoolkit.numba_internals import OPTIONS, copy, fma, larger
from ldctoolkit.simulation.kernel import data as at
from ldctoolkit.simulation.kernel import lanes, sight
from ldctoolkit.simulation.kernel.lanes import L, rings
from ldctoolkit.simulation.kernel.sight import HEADER, POINT_SIZE
from ldctoolkit.vehicle.bicycle import GRAVITY

_SPUN: Final = 1.5
"""|e_psi| [rad] at which saturating tyres have lost the vehicle: its equations end at a right angle to the lane."""


# ------------------------------------------------------------------------------------------------ the plant


@numba.njit(forceinline=True, **OPTIONS)
def _linear(w, l, p, psi, turn, v, dv, per_v, lane, delta, shape):  # noqa: ARG001
    """e_y'' and e_psi'' on linear tyres, and the part of a_y that is not the lane's.

    With w = de_y/dt - v e_psi and omega = de_psi/dt + r (Rajamani's eq. 2.45; dv/dt e_psi where the speed changes),

        F_f/m = (2 C_af/m) (delta - (w + l_f omega)/v),    F_r/m = (2 C_ar/m) (l_r omega - w)/v,
        e_y''   = F_f/m + F_r/m - v r + dv/dt e_psi,       e_psi'' = (l_f F_f - l_r F_r)/I_z;

    the printed matrix takes `PRINTED_TERM` de_psi/dt/v from e_y''.
    """
    across, omega = fma(-v, psi, p), turn + lane
    front = w[at.STIFFNESS_F + l] * fma(-per_v, fma(w[at.AXLE_F + l], omega, across), delta)
    rear = w[at.STIFFNESS_R + l] * (per_v * fma(w[at.AXLE_R + l], omega, -across))
    own = fma(-v, lane, fma(-w[at.PRINTED_TERM + l] * turn, per_v, front + rear))
    return fma(dv, psi, own), fma(w[at.ARM_F + l], front, -w[at.ARM_R + l] * rear), own


@numba.njit(forceinline=True, **OPTIONS)
def _saturating(w, l, p, psi, turn, v, dv, per_v, lane, delta, shape):
    """The same on tyres that saturate, `ldctoolkit.vehicle._nonlinear_compiled` term by term.

    With v_y = (de_y/dt - v sin e_psi)/cos e_psi and the slips a_f = delta - atan((v_y + l_f omega)/v), a_r =
    atan((l_r omega - v_y)/v),

        F_i/m = (D_i/m) sin(C atan(B_i a_i)),    a_y = F_f/m cos delta + F_r/m,    B_i = 2 C_ai/(C D_i),
        e_y'' = dv/dt sin e_psi + de_psi/dt (v cos e_psi - v_y sin e_psi) + (a_y - v omega) cos e_psi.
    """
    sin_psi, cos_psi, omega = sine(psi), cosine(psi), turn + lane
    across = fma(-v, sin_psi, p) / cos_psi
    slip_front = delta - arctan(fma(w[at.AXLE_F + l], omega, across) * per_v)
    slip_rear = arctan(fma(w[at.AXLE_R + l], omega, -across) * per_v)
    front = w[at.GRIP_F + l] * sine(shape * arctan(w[at.STIFFNESS_F + l] * slip_front)) * cosine(delta)
    rear = w[at.GRIP_R + l] * sine(shape * arctan(w[at.STIFFNESS_R + l] * slip_rear))
    a_y = front + rear
    lateral = fma(dv, sin_psi, turn * fma(v, cos_psi, -across * sin_psi)) + fma(-v, omega, a_y) * cos_psi
    return lateral, fma(w[at.ARM_F + l], front, -w[at.ARM_R + l] * rear), fma(-v, lane, a_y)


def _with_tyres(slopes):
    """A substep of the Runge-Kutta method, and the accelerations at a point, for `_linear` or `_saturating`.

    They are inlined where they are called: as functions, those of both tyres would have one name for the linker, which
    takes the first that it meets where entries were compiled by different processes.
    """

    @numba.njit(forceinline=True, **OPTIONS)
    def substep(w, road, point, shape):
        """One step of the state in the rows from `NEXT_E_Y` on, in place.

        k_1 = f(t, x), k_2 = f(t + h/2, x + h/2 k_1), k_3 = f(t + h/2, x + h/2 k_2), k_4 = f(t + h, x + h k_3),
        x+ = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4).
        """
        copy(w, at.V_START, road, point, 12)
        for l in range(L):
            h = w[at.H + l]
            half, sixth = 0.5 * h, h * (1.0 / 6.0)
            y, p, psi = w[at.NEXT_E_Y + l], w[at.NEXT_E_Y_RATE + l], w[at.NEXT_E_PSI + l]
            turn = w[at.NEXT_E_PSI_RATE + l]
            v, dv, per_v = w[at.V_START + l], w[at.DV_START + l], w[at.PER_V_START + l]
            lane, delta = w[at.LANE_START + l], w[at.DELTA_START + l]
            a_1, b_1, _ = slopes(w, l, p, psi, turn, v, dv, per_v, lane, delta, shape)
            v, dv, per_v = w[at.V_MID + l], w[at.DV_MID + l], w[at.PER_V_MID + l]
            lane, delta = w[at.LANE_MID + l], w[at.DELTA_MID + l]
            p_2, psi_2, turn_2 = fma(half, a_1, p), fma(half, turn, psi), fma(half, b_1, turn)
            a_2, b_2, _ = slopes(w, l, p_2, psi_2, turn_2, v, dv, per_v, lane, delta, shape)
            p_3, psi_3, turn_3 = fma(half, a_2, p), fma(half, turn_2, psi), fma(half, b_2, turn)
            a_3, b_3, _ = slopes(w, l, p_3, psi_3, turn_3, v, dv, per_v, lane, delta, shape)
            v, dv, per_v = w[at.V_END + l], w[at.DV_END + l], w[at.PER_V_END + l]
            lane, delta = w[at.LANE_END + l], w[at.DELTA_END + l]
            p_4, psi_4, turn_4 = fma(h, a_3, p), fma(h, turn_3, psi), fma(h, b_3, turn)
            a_4, b_4, _ = slopes(w, l, p_4, psi_4, turn_4, v, dv, per_v, lane, delta, shape)
            # e_y feeds back into nothing: its values at the stages follow from its rates there
            w[at.PIECE_AREA + l] = fma(h, fma(sixth, p + p_2 + p_3, y), w[at.PIECE_AREA + l])
            w[at.NEXT_E_Y + l] = fma(sixth, fma(2.0, p_2 + p_3, p + p_4), y)
            w[at.NEXT_E_Y_RATE + l] = fma(sixth, fma(2.0, a_2 + a_3, a_1 + a_4), p)
            w[at.NEXT_E_PSI + l] = fma(sixth, fma(2.0, turn_2 + turn_3, turn + turn_4), psi)
            w[at.NEXT_E_PSI_RATE + l] = fma(sixth, fma(2.0, b_2 + b_3, b_1 + b_4), turn)
            w[at.PIECE_TIME + l] += h

    @numba.njit(forceinline=True, **OPTIONS)
    def accelerations(w, road, point, delta, to, shape, width):
        """a_y at a point of the road with the steering angle in row `delta`, and its own part two rows further."""
        copy(w, at.V_START, road, point, 4)
        copy(w, at.WORK_0, w, delta, 1)
        for l in range(width):
            p, psi, turn = w[at.NEXT_E_Y_RATE + l], w[at.NEXT_E_PSI + l], w[at.NEXT_E_PSI_RATE + l]
            v, dv, per_v, lane = (
                w[at.V_START + l], w[at.DV_START + l], w[at.PER_V_START + l], w[at.LANE_START + l],
            )  # fmt: skip
            _, _, own = slopes(w, l, p, psi, turn, v, dv, per_v, lane, w[at.WORK_0 + l], shape)
            w[at.WORK_1 + l], w[at.WORK_2 + l] = fma(v, lane, own), own
        copy(w, to, w, at.WORK_1, 1)
        copy(w, to + 2 * L, w, at.WORK_2, 1)

    return substep, accelerations


_linear_substep, _linear_accelerations = _with_tyres(_linear)
_saturating_substep, _saturating_accelerations = _with_tyres(_saturating)


@numba.njit(**OPTIONS)
def _accelerations(setting, w, road, point, delta, to):
    if setting[at.SATURATING] > 0.0:
        _saturating_accelerations(w, road, point, delta, to, setting[at.SHAPE], int(setting[at.WIDTH]))
    else:
        _linear_accelerations(w, road, point, delta, to, 0.0, int(setting[at.WIDTH]))


# ------------------------------------------------------------------------------------------------ the steering angle


@numba.njit(**OPTIONS)
def _steer(setting, w):
    """Steering angle over a segment, and its scores; True if it ramps in a lane.

        d delta/dt = (u - delta)/lag, at most `RATE_MAX` in size:

    a ramp until u is within rate times lag, then delta = u - left exp(-s/lag). Without a lag the ramp ends at u.
    """
    lag, rate = setting[at.LAG], setting[at.RATE_MAX]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    at_once = lag == 0.0 and rate == math.inf
    limited, ramps = rate < math.inf, False
    for l in range(L):
        u, start, length = w[at.COMMAND + l], w[at.WHEEL + l], w[at.SEGMENT_LENGTH + l]
        distance = u - start
        slope = math.copysign(rate, distance) if limited else 0.0
        # the rate is at its limit until u is within rate times lag
        ramp = min(max((abs(distance) - rate * lag) / rate, 0.0), length) if limited else 0.0
        corner = fma(slope, ramp, start)
        rest = length - ramp
        left = u - corner if lag > 0.0 else 0.0  # after the ramp the angle is u - left exp(-s/lag)
        fallen = decay(-rest * per_lag) if ramp > 0.0 else w[at.LAG_SEGMENT + l]
        end = fma(-left, fallen, u) if lag > 0.0 else (corner if limited and ramp == length else u)
        end = end if length > 0.0 else start
        w[at.RAMP_RATE + l], w[at.RAMP_TIME + l], w[at.RAMP_START + l], w[at.WHEEL + l] = slope, ramp, start, end
        w[at.TO_COMMAND + l] = left
        effort = ramp * fma(start, start, ramp * fma(start, slope, ramp * slope * slope * (1.0 / 3.0)))
        effort += u * u * rest
        effort += fma(0.5 * left, fma(-fallen, fallen, 1.0), -2.0 * u * (1.0 - fallen)) * left * lag
        w[at.EFFORT + l] += effort if length > 0.0 else 0.0
        w[at.TRAVEL + l] += abs(corner - start) + abs(end - corner)
        peak = abs(end) if at_once else max(max(abs(start), abs(corner)), abs(end))
        w[at.DELTA_PEAK + l] = max(w[at.DELTA_PEAK + l], peak if length > 0.0 else 0.0)
        ramps |= ramp > 0.0
    return ramps


@numba.njit(forceinline=True, **OPTIONS)
def _decayed(w, l):
    """The parabola of a substep without a ramp, and what then remains to the command."""
    u, left = w[at.COMMAND + l], w[at.TO_COMMAND + l]
    w[at.TO_COMMAND + l] = left * w[at.LAG_SUBSTEP + l]
    return (
        fma(-left, w[at.LAG_START + l], u), fma(-left, w[at.LAG_MID + l], u),
        fma(-left, w[at.LAG_END + l], u),
    )  # fmt: skip


@numba.njit(**OPTIONS)
def _along_decay(setting, w):
    """The parabola that has the steering angle's mean, first and second moment over a substep, where none ramps."""
    for l in range(int(setting[at.WIDTH])):
        a, b, c = _decayed(w, l)
        w[at.DELTA_START + l], w[at.DELTA_MID + l], w[at.DELTA_END + l] = a, b, c


@numba.njit(**OPTIONS)
def _along_ramp(setting, w, j):
    """The same in substep j where one ramps, or did."""
    lag = setting[at.LAG]
    per_lag = 1.0 / lag if lag > 0.0 else 1.0
    for l in range(L):
        a_0, a_1, a_2 = _decayed(w, l)
        u, slope, ramp, start, h = (
            w[at.COMMAND + l], w[at.RAMP_RATE + l], w[at.RAMP_TIME + l], w[at.RAMP_START + l], w[at.SUBSTEP_LENGTH + l],
        )  # fmt: skip
        a = j * h
        # in parts of the substep: a ramp from 0 to q, then a decay
        q = min(max((ramp - a) / max(h, 1e-300), 0.0), 1.0)
        b, c = fma(slope, a, start), slope * h
        rest = 1.0 - q
        left = u - fma(slope, ramp, start) if lag > 0.0 else 0.0
        left *= decay(-max(a - ramp, 0.0) * per_lag)
        i_0, i_1, i_2 = moments(h * per_lag * rest, rest)
        m_0 = q * fma(0.5 * c, q, b) + fma(u, rest, -left * i_0)
        m_1 = q * q * fma(c, q * (1.0 / 3.0), 0.5 * b) + fma(0.5 * u, fma(-q, q, 1.0), -left * fma(q, i_0, i_1))
        m_2 = q * q * q * fma(0.25 * c, q, b * (1.0 / 3.0)) + u * fma(-q * q, q, 1.0) * (1.0 / 3.0)
        m_2 -= left * fma(q, fma(q, i_0, 2.0 * i_1), i_2)
        b_0, b_1, b_2 = sight.parabola(m_0, m_1, m_2)
        w[at.DELTA_START + l] = b_0 if ramp > 0.0 else a_0
        w[at.DELTA_MID + l] = b_1 if ramp > 0.0 else a_1
        w[at.DELTA_END + l] = b_2 if ramp > 0.0 else a_2


# ------------------------------------------------------------------------------------------------ scores


@numba.njit(**OPTIONS)
def _score(setting, w):
    """Scores of pieces that end here, and which hold an event; True if one does."""
    l_f, offset = setting[at.L_FRONT], setting[at.OFFSET]
    rare = False
    for l in range(L):
        h, due = w[at.PIECE_TIME + l], w[at.PIECE_ENDS + l] > 0.0
        counted = due & (w[at.BEFORE_T + l] > 0.0)
        x_0, x_1, n_0, n_1 = w[at.E_Y + l], w[at.E_Y_RATE + l], w[at.NEXT_E_Y + l], w[at.NEXT_E_Y_RATE + l]
        g_0, f_0 = fma(l_f, w[at.E_PSI + l], x_0), fma(l_f, w[at.E_PSI_RATE + l], x_1)
        g_1, f_1 = fma(l_f, w[at.NEXT_E_PSI + l], n_0), fma(l_f, w[at.NEXT_E_PSI_RATE + l], n_1)
        deep, front = w[at.DEEPEST + l], w[at.FRONT_DEEPEST + l]
        over = w[at.OPPOSITE + l]
        event = counted & ((x_0 * n_0 < 0.0) | touches(x_0, x_1, n_0, n_1, h))
        event |= (w[at.T_BACK + l] == math.inf) & (x_0 >= offset) & (n_0 < offset)
        # an extreme within the piece that may be a new one
        event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (fma(h, x_1 - n_1, max(x_0, n_0)) > deep)
        event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (fma(h, f_0 - f_1, max(g_0, g_1)) > front)
        event |= (x_1 < 0.0) & (n_1 > 0.0) & (fma(h, n_1 - x_1, -min(x_0, n_0)) > max(over, offset))
        event &= due & (h > 0.0)
        w[at.EVENT + l] = 1.0 if event else 0.0
        rare |= event
        w[at.DEEPEST + l] = larger(deep, n_0 if counted else deep)
        w[at.FRONT_DEEPEST + l] = larger(front, g_1 if counted else front)
        w[at.OPPOSITE + l] = larger(over, -n_0 if due else over)
    return rare


@numba.njit(**OPTIONS)
def _next_piece(setting, w):
    """S of the pieces that end here; the next ones begin."""
    for l in range(int(setting[at.WIDTH])):
        due, area = w[at.PIECE_ENDS + l] > 0.0, abs(w[at.PIECE_AREA + l]) * w[at.BEFORE_T + l]
        now = w[at.PIECE_TIME + l]
        w[at.AREA + l] += area if due else 0.0
        w[at.PIECE_START + l] += now if due else 0.0
        signed, x_0, x_1, x_2 = w[at.PIECE_AREA + l], w[at.E_Y + l], w[at.E_Y_RATE + l], w[at.E_PSI + l]
        x_3, n_0, n_1 = w[at.E_PSI_RATE + l], w[at.NEXT_E_Y + l], w[at.NEXT_E_Y_RATE + l]
        n_2, n_3 = w[at.NEXT_E_PSI + l], w[at.NEXT_E_PSI_RATE + l]
        w[at.PIECE_AREA + l], w[at.PIECE_TIME + l] = 0.0 if due else signed, 0.0 if due else now
        w[at.E_Y + l], w[at.E_Y_RATE + l] = n_0 if due else x_0, n_1 if due else x_1
        w[at.E_PSI + l], w[at.E_PSI_RATE + l] = n_2 if due else x_2, n_3 if due else x_3


# ------------------------------------------------------------------------------------------------ one sample


@numba.njit(**OPTIONS)
def _drive_segment(setting, w, k, parts, road, segment):
    """All lanes over a segment; True if one of them has left the bound."""
    width = int(setting[at.WIDTH])
    copy(w, at.SEGMENT_LENGTH, road, segment, 9)
    copy(w, at.SEGMENT_START, w, at.PIECE_START, 1)
    for l in range(width):
        alive, young, old = w[at.ALIVE + l], w[at.YOUNG_COMMAND + l], w[at.OLD_COMMAND + l]
        u = young if w[at.SEGMENT_AFTER_DELAY + l] > 0.0 else old
        w[at.SEGMENT_LENGTH + l] *= alive
        w[at.SUBSTEP_LENGTH + l] *= alive
        w[at.BEFORE_T + l] = w[at.SEGMENT_IN_T + l] * alive
        w[at.COMMAND + l] = w[at.DELTA_START + l] = w[at.DELTA_MID + l] = w[at.DELTA_END + l] = u
    for n in range(at.SCORES * L):
        w[at.SAVED + n] = w[at.SCORE + n]
    ramps = _steer(setting, w)
    moves, least = setting[at.LAG] > 0.0 or setting[at.RATE_MAX] < math.inf, parts
    for l in range(L):
        least = min(least, int(w[at.N_SUBSTEPS + l]))
    for j in range(parts):
        ends = j + 1 >= least or (j + 1) % at.PIECE == 0
        whole = (j + 1) % at.PIECE == 0
        for l in range(width):
            going = j < w[at.N_SUBSTEPS + l]
            w[at.H + l] = w[at.SUBSTEP_LENGTH + l] if going else 0.0
            w[at.PIECE_ENDS + l] = 1.0 if (j + 1 == w[at.N_SUBSTEPS + l]) | (going & whole) else 0.0
        if moves and ramps:
            _along_ramp(setting, w, j)
        elif moves:
            _along_decay(setting, w)
        if setting[at.SATURATING] > 0.0:
            _saturating_substep(w, road, segment + HEADER + 2 * j * POINT_SIZE, setting[at.SHAPE])
        else:
            _linear_substep(w, road, segment + HEADER + 2 * j * POINT_SIZE, 0.0)
        if ends:
            if setting[at.CAMERA] > 0.0:
                sight.take_between(setting, k, w)
            if _score(setting, w):
                for l in range(L):
                    if w[at.EVENT + l] > 0.0:
                        lanes.look_closer(
                            setting, w, l, w[at.PIECE_START + l], w[at.PIECE_TIME + l], w[at.BEFORE_T + l] > 0.0
                        )
            _next_piece(setting, w)
    spun = _SPUN if setting[at.SATURATING] > 0.0 else math.inf
    lost = False
    for l in range(L):
        inside = (abs(w[at.NEXT_E_Y + l]) <= setting[at.BOUND]) & (abs(w[at.NEXT_E_PSI + l]) < spun)
        w[at.EVENT + l] = w[at.ALIVE + l] if not inside else 0.0
        lost |= w[at.EVENT + l] > 0.0
    return lost


@numba.njit(**OPTIONS)
def advance(setting, w, k, parts, road, segment, end, bend, bend_at, paths):
    """Sample k with the command in `COMMAND`: segments of the road from `segment` to `end`. Lanes that go on after."""
    ring, whole, size = int(setting[at.COMMAND_RING]), k - int(setting[at.DELAY_SAMPLES]), sight.segment_size(parts)
    newest = at.RINGS + (k % ring) * L
    fresh, stale = at.RINGS + (whole % ring) * L, at.RINGS + ((whole - 1) % ring) * L
    # the steering angle at the trigger is not limited
    most = setting[at.DELTA_MAX] if whole >= 0 else math.inf
    most_stale = setting[at.DELTA_MAX] if whole >= 1 else math.inf
    at_once = setting[at.LAG] == 0.0 and setting[at.RATE_MAX] == math.inf
    width, split = int(setting[at.WIDTH]), setting[at.DELAY_PART] > 0.0
    copy(w, newest, w, at.COMMAND, 1)
    copy(w, at.LAST_COMMAND, w, at.COMMAND, 1)
    copy(w, at.YOUNG_COMMAND, w, fresh, 1)
    copy(w, at.OLD_COMMAND, w, stale, 1)
    copy(w, at.WHEEL_START, w, at.WHEEL, 1)
    for l in range(width):
        w[at.PIECE_START + l] = w[at.T_0 + l] + k * setting[at.DT]
        young = min(max(w[at.YOUNG_COMMAND + l], -most), most)
        old = min(max(w[at.OLD_COMMAND + l], -most_stale), most_stale)
        w[at.YOUNG_COMMAND + l], w[at.OLD_COMMAND + l] = young, old
        w[at.DELTA_START + l] = (old if split else young) if at_once else w[at.WHEEL + l]
    _accelerations(setting, w, road, segment + HEADER, at.DELTA_START, at.A_Y_START)
    if paths.shape[0]:
        for l in range(L):
            c = int(w[at.PATH_ROW + l])
            if w[at.ALIVE + l] > 0.0 and c >= 0:
                paths[c, int(w[at.PATH_ENTRIES + l]) - 1, at.P_DELTA] = w[at.DELTA_START + l]
    while segment < end:
        if _drive_segment(setting, w, k, parts, road, segment):
            for l in range(L):
                if w[at.EVENT + l] > 0.0:
                    for n in range(at.SCORES):
                        w[at.SCORE + n * L + l] = w[at.SAVED + n * L + l]
                    lanes.diverge(setting, w, l, w[at.SEGMENT_START + l], w[at.BEFORE_T + l] > 0.0)
                    w[at.DIVERGED + l], w[at.ALIVE + l] = 1.0, 0.0
        if segment + size < end:
            _at_T(setting, w, road, segment + size, paths)
        segment += size
    for l in range(width):  # a lane that has ended stays finite
        alive = w[at.ALIVE + l] > 0.0
        w[at.E_Y + l] = w[at.NEXT_E_Y + l] = w[at.NEXT_E_Y + l] if alive else 0.0
        w[at.E_Y_RATE + l] = w[at.NEXT_E_Y_RATE + l] = w[at.NEXT_E_Y_RATE + l] if alive else 0.0
        w[at.E_PSI + l] = w[at.NEXT_E_PSI + l] = w[at.NEXT_E_PSI + l] if alive else 0.0
        w[at.E_PSI_RATE + l] = w[at.NEXT_E_PSI_RATE + l] = w[at.NEXT_E_PSI_RATE + l] if alive else 0.0
        rate = abs(w[at.WHEEL + l] - w[at.WHEEL_START + l]) / setting[at.DT]
        w[at.DELTA_RATE_PEAK + l] = larger(w[at.DELTA_RATE_PEAK + l], rate if alive else 0.0)
    _accelerations(setting, w, road, end - POINT_SIZE, at.WHEEL, at.A_Y_END)
    copy(w, at.BEND_START, bend, bend_at, 4)
    lanes.look_back(setting, w, k)
    for l in range(L):
        if w[at.ALIVE + l] > 0.0 and k + 1 == w[at.ALL_STEPS + l]:
            lanes.look_back_from_end(setting, w, l, k)
    lanes.score_limits(setting, w)
    return lanes.end_sample(setting, w, k, paths)


@numba.njit(**OPTIONS)
def _at_T(setting, w, road, segment, paths):
    """Lanes whose T is where the segment from `segment` on begins: just after it nothing is recorded any more."""
    _accelerations(setting, w, road, segment + HEADER, at.WHEEL, at.A_Y_START_PAST)
    for l in range(L):
        if w[at.BEFORE_T + l] * w[at.ALIVE + l] > 0.0 and road[segment + L + l] == 0.0 and road[segment + l] > 0.0:
            peak = abs(w[at.A_Y_OWN_START_PAST + l])
            w[at.A_Y_ADDED_PEAK + l] = max(w[at.A_Y_ADDED_PEAK + l], peak)
            if paths.shape[0] and w[at.PATH_ROW + l] >= 0.0:
                lanes.record(paths, w, l, w[at.T + l])


# ------------------------------------------------------------------------------------------------ a whole run


@numba.njit(**OPTIONS)
def start(scene, setting, block, w, paths, chosen):
    """Everything before the first sample of a block."""
    w[:] = 0.0
    lanes.begin(scene, setting, block, w, paths, chosen)
    size, count, modes = int(setting[at.FRAME_RING]), int(setting[at.MODES]), rings(setting)[2]
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        w[at.OUTWARD + l], w[at.N_SUBSTEPS + l] = scene[i, at.SIDE], scene[i, at.SUBSTEPS]
        w[at.SCENARIO + l], w[at.CURVE_BIAS + l] = scene[i, at.INDEX], scene[i, at.CURVATURE_BIAS]
        T, v, a = scene[i, at.T_END], scene[i, at.SPEED], 0.0
        if setting[at.PROFILE] > 0.0:
            v, a = scene[i, at.V_MEAN] - 0.5 * scene[i, at.A_MEAN] * T, scene[i, at.A_MEAN]
        road = (v, a, scene[i, at.C_0], scene[i, at.DC] / T, math.pi / T)
        for n in range(5):
            w[at.V_0 + n * L + l] = road[n]
        for j in range(count):
            w[modes + j * L + l] = scene[i, at.SCENE + j]
            if setting[at.PROFILE] > 0.0 and scene[i, at.SCENE + j] != 0.0:
                w[at.MODES_USED] = max(w[at.MODES_USED], j + 1.0)
        mass, I_z, l_f, l_r = scene[i, at.MASS], scene[i, at.I_Z], scene[i, at.L_F], scene[i, at.L_R]
        # forces over the mass: of an axle per slip angle, or its largest; lever arms over the yaw inertia, times mass
        front, rear = 2.0 * scene[i, at.C_AF] / mass, 2.0 * scene[i, at.C_AR] / mass
        grip = scene[i, at.MU] * GRAVITY / (l_f + l_r)
        if setting[at.SATURATING] > 0.0:
            front, rear = front / (setting[at.SHAPE] * grip * l_r), rear / (setting[at.SHAPE] * grip * l_f)
        car = (front, rear, l_f, l_r, l_f * mass / I_z, l_r * mass / I_z, scene[i, at.PRINTED], grip * l_r, grip * l_f)
        for n in range(9):
            w[at.STIFFNESS_F + n * L + l] = car[n]
        for n in range(2 * int(setting[at.COMMAND_RING])):
            w[at.RINGS + n * L + l] = scene[i, at.DELTA_0]
        w[at.WHEEL_SEEN + l] = w[at.LAST_COMMAND + l]
        if setting[at.FILTERED] > 0.0:
            model = at.SCENE + count + 2 * int(setting[at.EARLIER_FRAMES])
            for n in range(at.FILTER):
                w[at.FILTER_ROWS + n * L + l] = scene[i, model + n]
            for n in range(4):
                w[at.ESTIMATE + n * L + l] = scene[i, model + at.FIRST + n] * w[at.ALIVE + l]
        if setting[at.CAMERA] > 0.0:
            k = 0
            while sight.frame_of(setting, k) < 0:
                frame = rings(setting)[0] + 2 * (k % size) * L + l
                for n in range(2):
                    w[frame + n * L] = scene[i, at.SCENE + count + 2 * (-sight.frame_of(setting, k) - 1) + n]
                k += 1
        w[at.SEGMENT_START + l] = w[at.T_0 + l]
    sight.lay_point(setting, w, 0.0)
    _accelerations(setting, w, w, at.V_START, at.WHEEL, at.A_Y_START)
    copy(w, at.A_Y_BEFORE, w, at.A_Y_START, 1)


@numba.njit(**OPTIONS)
def drive_block_any(scene, setting, law, times, recorded, paths, chosen, block, score, diverged, failed):
    """Every design of a law on one block of scenarios; what designs share is worked out once."""
    m, lookaheads, columns = scene.shape[0], times.shape[1], law.shape[2] - at.LAW
    _, _, _, size = rings(setting)
    w = np.empty(size)
    start(scene, setting, block, w, paths[:0], chosen)
    parts, most, segments = sight.substeps_of(w), 0, 2 if setting[at.DELAY_PART] > 0.0 else 1
    for l in range(L):
        most = max(most, int(w[at.ALL_STEPS + l]))
    g, bend, wide = np.empty(columns * L), np.empty(4 * most * L), (1 + 2 * lookaheads) * L
    road, ends = np.empty((segments * most + 2 * L) * sight.segment_size(parts)), np.zeros(most + 1, dtype=np.int64)
    ahead, noise = np.empty(most * wide), np.empty(most * 2 * L)
    for k in range(most):
        ends[k + 1] = sight.lay_road(setting, k, w, parts, road, ends[k])
        lanes.lay_bend(setting, recorded, block, k, w, bend, 4 * k * L)
        sight.noise_of(setting, k, w, noise, k * 2 * L)
    for design in range(law.shape[0]):
        same = design > 0
        for j in range(lookaheads):
            same &= times[design, j] == times[design - 1, j]
        if not same:
            for k in range(most):
                sight.look_ahead(setting, k, w, times[design], ahead, k * wide)
        start(scene, setting, block, w, paths, chosen)
        for l in range(L):
            i = min(block * L + l, m - 1)
            for n in range(at.LAW):
                w[at.F_E_Y + n * L + l] = law[design, i, n]
            for j in range(columns):
                g[j * L + l] = law[design, i, at.LAW + j]
        for k in range(most):
            sight.see(setting, w, k, ahead, k * wide, noise, k * 2 * L)
            sight.command(setting, w, k, g, ahead, k * wide, lookaheads, columns - 2 * lookaheads)
            if not advance(setting, w, k, parts, road, ends[k], ends[k + 1], bend, 4 * k * L, paths):
                break
        lanes.hand_over(w, design, block, score, diverged, failed)
