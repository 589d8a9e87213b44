"""Any plant, eight scenarios side by side: steps of the classical Runge-Kutta method.

A sample is cut into segments where something jumps, at a command that arrives within it and at T; a segment into equal
substeps, at most 0.25 or 0.3 of the fastest time constant long, which a lane takes in shorter parts where its tyres are
used and its slopes disagree. The steering angle is known in closed form along a
segment, a ramp at the rate limit and then a decay with the lag; a substep sees the parabola with the same mean, first
and second moment, so that neither the end of the ramp nor a lag far shorter than the substep costs accuracy. Scores are
taken after pieces of at most `PIECE` substeps.

Every lane does the same arithmetic, and a lane that needs fewer substeps than its neighbours goes on with length 0, so
that the numbers of a scenario do not depend on its neighbours.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba

from ldctoolkit.lanes import any_lane, fma, largest, select, smallest
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.simulation.kernel import actuator, block_table, data, driver, sight
from ldctoolkit.simulation.kernel.block_table import L, rings
from ldctoolkit.simulation.kernel.road import HEADER, IN_T, POINT, lay_road, motion_at
from ldctoolkit.vector_math import NEAR, arctan, arctan_near, cosine, sine_and_cosine, touches, tyre_force
from ldctoolkit.vehicle.bicycle import GRAVITY

# shorter steps where an argument of a tyre's formula is beyond so much, and the slopes in the middle of a step differ
# by more than so much [m/s^2, rad/s^2]
_PARTS: Final = 4
_USED: Final = 0.3
_UNEVEN: Final = 0.001
_SPUN: Final = 1.5
"""|e_psi| [rad] at which saturating tyres have lost the vehicle: its equations end at a right angle to the lane."""


# ------------------------------------------------------------------------------------------------ the plant


@numba.njit(forceinline=True, **OPTIONS)
def _linear_forces(setting, w, v_y, turn, v, per_v, lane, delta):  # noqa: ARG001
    """a_y and e_psi'' on linear tyres, dv_y/dt, the front force over the mass, and a number without use.

    With the lateral velocity v_y of the vehicle in its own frame and its yaw rate omega = de_psi/dt + r, of which the
    model lets the lane's part r jump along (Rajamani's eq. 2.45),

        F_f/m = (2 C_af/m) (delta - (v_y + l_f omega)/v),    F_r/m = (2 C_ar/m) (l_r omega - v_y)/v,
        a_y = F_f/m + F_r/m,    dv_y/dt = a_y - v omega,    e_psi'' = (l_f F_f - l_r F_r)/I_z;

    the printed matrix takes `PRINTED_TERM` de_psi/dt/v from a_y.
    """
    omega = turn + lane
    front = w[data.STIFFNESS_F] * fma(-per_v, fma(w[data.AXLE_F], omega, v_y), delta)
    rear = w[data.STIFFNESS_R] * (per_v * fma(w[data.AXLE_R], omega, -v_y))
    a_y = fma(-w[data.PRINTED_TERM] * turn, per_v, front + rear)
    return a_y, fma(w[data.ARM_F], front, -w[data.ARM_R] * rear), fma(-v, omega, a_y), front, front


@numba.njit(forceinline=True, **OPTIONS)
def _saturating_forces(setting, w, v_y, turn, v, per_v, lane, delta):
    """The same on tyres that saturate (Pacejka's Magic Formula), for large angles; last, the larger |B_i a_i|.

    With the slips a_f = delta - atan((v_y + l_f omega)/v), a_r = atan((l_r omega - v_y)/v),

        F_i/m = (D_i/m) sin(C atan(B_i a_i)),    a_y = F_f/m cos delta + F_r/m,    B_i = 2 C_ai/(C D_i).
    """
    omega = turn + lane
    across_front, across_rear = fma(w[data.AXLE_F], omega, v_y) * per_v, fma(w[data.AXLE_R], omega, -v_y) * per_v
    if any_lane(max(abs(across_front), abs(across_rear)) > NEAR):
        across_front, across_rear = arctan(across_front), arctan(across_rear)
    else:  # the same bits without a division
        across_front, across_rear = arctan_near(across_front), arctan_near(across_rear)
    used_front, used_rear = w[data.STIFFNESS_F] * (delta - across_front), w[data.STIFFNESS_R] * across_rear
    front = w[data.GRIP_F] * tyre_force(setting, data.TYRE, used_front)
    rear = w[data.GRIP_R] * tyre_force(setting, data.TYRE, used_rear)
    front *= cosine(delta)
    a_y, yaw, used = (
        front + rear,
        fma(w[data.ARM_F], front, -w[data.ARM_R] * rear),
        max(abs(used_front), abs(used_rear)),
    )
    return a_y, yaw, fma(-v, omega, a_y), front, used


@numba.njit(forceinline=True, **OPTIONS)
def _linear_rate(v, v_y, psi):
    return fma(v, psi, v_y)


@numba.njit(forceinline=True, **OPTIONS)
def _rate(v, v_y, psi):
    sine, cosine = sine_and_cosine(psi)
    return fma(v, sine, v_y * cosine)


def _plant(forces, rate, saturating, held):
    """A substep of the Runge-Kutta method for these forces and this de_y/dt, without or with the arms of a driver.

    Plants are inlined where they are called: as functions, all would have one name for the linker, which takes the
    first that it meets where entries were compiled by different processes.
    """

    @numba.njit(forceinline=True, **OPTIONS)
    def substep(setting, w, road, point):
        """One step of the state, in place; `PARTS` shorter ones in lanes whose slopes in the middle disagree.

        k_1 = f(t, x), k_2 = f(t + h/2, x + h/2 k_1), k_3 = f(t + h/2, x + h/2 k_2), k_4 = f(t + h, x + h k_3),
        x+ = x + h/6 (k_1 + 2 k_2 + 2 k_3 + k_4) for x = (v_y, de_psi/dt, e_psi) and the column, with

            de_y/dt = v sin e_psi + v_y cos e_psi.

        e_y feeds back into nothing: it follows by Simpson's rule, with the state in the middle from the same stages.
        """
        h, again, since = w[data.H], w[data.H] < 0.0, 0.0 * w[data.H]
        v_0, per_v_0, lane_0 = road[point], road[point + 1], road[point + 2]
        v_1, per_v_1, lane_1 = road[point + 3], road[point + 4], road[point + 5]
        v_2, per_v_2, lane_2 = road[point + 6], road[point + 7], road[point + 8]
        delta_1, delta_2, delta_4 = w[data.DELTA_START], w[data.DELTA_MID], w[data.DELTA_END]
        for part in range(_PARTS + 1 if saturating else 1):
            if part > 0:
                s, e = (part - 1) / _PARTS, part / _PARTS
                h, since = select(again, w[data.H] * (1.0 / _PARTS), 0.0), s * w[data.H]
                v_0, v_1, v_2 = _along(road, point, s), _along(road, point, 0.5 * (s + e)), _along(road, point, e)
                per_v_0, per_v_1, per_v_2 = 1.0 / v_0, 1.0 / v_1, 1.0 / v_2
                lane_0, lane_2 = _along(road, point + 2, s), _along(road, point + 2, e)
                lane_1 = _along(road, point + 2, 0.5 * (s + e))
                delta_1, delta_4 = _between(w, s), _between(w, e)
                delta_2 = _between(w, 0.5 * (s + e))
            y, rate_0, psi = w[data.NEXT_E_Y], w[data.NEXT_E_Y_RATE], w[data.NEXT_E_PSI]
            v_y, turn, half = w[data.V_Y], w[data.NEXT_E_PSI_RATE], 0.5 * h
            delta_3 = delta_2
            if held:
                trail, per_ratio = w[data.TRAIL_TORQUE], 1.0 / setting[data.RATIO]
                angle, speed = w[data.COLUMN], w[data.COLUMN_RATE]
                delta_1 = angle * per_ratio
            _, b_1, a_1, force, used = forces(setting, w, v_y, turn, v_0, per_v_0, lane_0, delta_1)
            v_y_2, turn_2 = fma(half, a_1, v_y), fma(half, b_1, turn)
            if held:
                c_1, assist_before, before = driver.column(setting, w, since, angle, speed, trail * force)
                angle_2, speed_2 = fma(half, speed, angle), fma(half, c_1, speed)
                delta_2 = angle_2 * per_ratio
            _, b_2, a_2, force, _ = forces(setting, w, v_y_2, turn_2, v_1, per_v_1, lane_1, delta_2)
            v_y_3, turn_3 = fma(half, a_2, v_y), fma(half, b_2, turn)
            if held:
                c_2, _, _ = driver.column(setting, w, since + half, angle_2, speed_2, trail * force)
                angle_3, speed_3 = fma(half, speed_2, angle), fma(half, c_2, speed)
                delta_3 = angle_3 * per_ratio
            _, b_3, a_3, force, _ = forces(setting, w, v_y_3, turn_3, v_1, per_v_1, lane_1, delta_3)
            v_y_4, turn_4 = fma(h, a_3, v_y), fma(h, b_3, turn)
            if held:
                c_3, _, middle = driver.column(setting, w, since + half, angle_3, speed_3, trail * force)
                angle_4, speed_4 = fma(h, speed_3, angle), fma(h, c_3, speed)
                delta_4 = angle_4 * per_ratio
            _, b_4, a_4, force, used_4 = forces(setting, w, v_y_4, turn_4, v_2, per_v_2, lane_2, delta_4)
            if saturating and part == 0:
                again = (max(used, used_4) > _USED) & (abs(a_2 - a_3) + abs(b_2 - b_3) > _UNEVEN)
                h = select(again, 0.0, h)  # not with this step
            sixth = h * (1.0 / 6.0)
            if held:
                c_4, _, _ = driver.column(setting, w, since + h, angle_4, speed_4, trail * force)
                end = fma(sixth, fma(2.0, speed_2 + speed_3, speed + speed_4), angle)
                speed = fma(sixth, fma(2.0, c_2 + c_3, c_1 + c_4), speed)
                driver.end_step(setting, w, since, h, before, assist_before, middle, angle, end, speed, trail * force)
            psi_mid = fma(h, fma(1.0 / 6.0, turn_2 + turn_3, fma(5.0 / 24.0, turn, (-1.0 / 24.0) * turn_4)), psi)
            v_y_mid = fma(h, fma(1.0 / 6.0, a_2 + a_3, fma(5.0 / 24.0, a_1, (-1.0 / 24.0) * a_4)), v_y)
            psi_0, psi = psi, fma(sixth, fma(2.0, turn_2 + turn_3, turn + turn_4), psi)
            v_y = fma(sixth, fma(2.0, a_2 + a_3, a_1 + a_4), v_y)
            rate_1, rate_2 = rate(v_1, v_y_mid, psi_mid), rate(v_2, v_y, psi)
            w[data.PIECE_AREA] = fma(h, fma(sixth, fma(2.0, rate_1, rate_0), y), w[data.PIECE_AREA])
            w[data.PIECE_TURN] = fma(sixth, fma(4.0, psi_mid, psi_0 + psi), w[data.PIECE_TURN])
            w[data.NEXT_E_Y] = fma(sixth, fma(4.0, rate_1, rate_0 + rate_2), y)
            w[data.NEXT_E_Y_RATE] = select(h > 0.0, rate_2, rate_0)
            w[data.NEXT_E_PSI], w[data.V_Y] = psi, v_y
            w[data.NEXT_E_PSI_RATE] = fma(sixth, fma(2.0, b_2 + b_3, b_1 + b_4), turn)
            w[data.PIECE_TIME] += h
            if part == 0 and not any_lane(again):
                break

    return substep


@numba.njit(forceinline=True, **OPTIONS)
def _along(road, point, s):
    """Between the points of a substep, on the parabola."""
    start, mid, end = road[point], road[point + POINT], road[point + 2 * POINT]
    return fma((1.0 - s) * (1.0 - 2.0 * s), start, fma(4.0 * s * (1.0 - s), mid, s * (2.0 * s - 1.0) * end))


@numba.njit(forceinline=True, **OPTIONS)
def _between(w, s):
    """The steering angle there."""
    start, mid, end = w[data.DELTA_START], w[data.DELTA_MID], w[data.DELTA_END]
    return fma((1.0 - s) * (1.0 - 2.0 * s), start, fma(4.0 * s * (1.0 - s), mid, s * (2.0 * s - 1.0) * end))


_linear, _linear_held = (_plant(_linear_forces, _linear_rate, False, held) for held in (False, True))
_saturating, _saturating_held = (_plant(_saturating_forces, _rate, True, held) for held in (False, True))


@numba.njit(**OPTIONS)
def _accelerations(setting, w, v, per_v, lane, delta, to):
    """a_y on the road at a moment, with the steering angle; relative to the road two rows further."""
    if setting[data.SATURATING] > 0.0:
        a_y, _, _, _, _ = _saturating_forces(setting, w, w[data.V_Y], w[data.NEXT_E_PSI_RATE], v, per_v, lane, delta)
    else:
        a_y, _, _, _, _ = _linear_forces(setting, w, w[data.V_Y], w[data.NEXT_E_PSI_RATE], v, per_v, lane, delta)
    w[to], w[to + 2] = a_y, fma(-v, lane, a_y)


# ------------------------------------------------------------------------------------------------ scores


@numba.njit(**OPTIONS)
def _score(setting, w):
    """Scores of pieces that end here, and which hold an event; True if one does."""
    l_f, offset = setting[data.L_FRONT], setting[data.OFFSET]
    h, due = w[data.PIECE_TIME], w[data.PIECE_ENDS] > 0.0
    counted = due & (w[data.BEFORE_T] > 0.0)
    x_0, x_1, n_0, n_1 = w[data.E_Y], w[data.E_Y_RATE], w[data.NEXT_E_Y], w[data.NEXT_E_Y_RATE]
    g_0, f_0 = fma(l_f, w[data.E_PSI], x_0), fma(l_f, w[data.E_PSI_RATE], x_1)
    g_1, f_1 = fma(l_f, w[data.NEXT_E_PSI], n_0), fma(l_f, w[data.NEXT_E_PSI_RATE], n_1)
    deep, front = w[data.DEEPEST], w[data.FRONT_DEEPEST]
    over = w[data.OPPOSITE]
    event = counted & ((x_0 * n_0 < 0.0) | touches(x_0, x_1, n_0, n_1, h))
    event |= (w[data.T_BACK] == math.inf) & (x_0 >= offset) & (n_0 < offset)
    # an extreme within the piece that may be a new one
    event |= counted & (x_1 > 0.0) & (n_1 < 0.0) & (fma(h, x_1 - n_1, max(x_0, n_0)) > deep)
    event |= counted & (f_0 > 0.0) & (f_1 < 0.0) & (fma(h, f_0 - f_1, max(g_0, g_1)) > front)
    event |= (x_1 < 0.0) & (n_1 > 0.0) & (fma(h, n_1 - x_1, -min(x_0, n_0)) > max(over, offset))
    event &= due & (h > 0.0)
    w[data.EVENT] = select(event, 1.0, 0.0)
    w[data.DEEPEST] = max(deep, select(counted, n_0, deep))
    w[data.FRONT_DEEPEST] = max(front, select(counted, g_1, front))
    w[data.OPPOSITE] = max(over, select(due, -n_0, over))
    return any_lane(event)


@numba.njit(**OPTIONS)
def _next_piece(w):
    """S of the pieces that end here; the next ones begin."""
    due, area = w[data.PIECE_ENDS] > 0.0, abs(w[data.PIECE_AREA]) * w[data.BEFORE_T]
    now = w[data.PIECE_TIME]
    w[data.AREA] += select(due, area, 0.0)
    w[data.PIECE_START] += select(due, now, 0.0)
    signed, x_0, x_1, x_2 = w[data.PIECE_AREA], w[data.E_Y], w[data.E_Y_RATE], w[data.E_PSI]
    x_3, n_0, n_1 = w[data.E_PSI_RATE], w[data.NEXT_E_Y], w[data.NEXT_E_Y_RATE]
    n_2, n_3 = w[data.NEXT_E_PSI], w[data.NEXT_E_PSI_RATE]
    w[data.PIECE_AREA], w[data.PIECE_TIME] = select(due, 0.0, signed), select(due, 0.0, now)
    w[data.PIECE_TURN] = select(due, 0.0, w[data.PIECE_TURN])
    w[data.E_Y], w[data.E_Y_RATE] = select(due, n_0, x_0), select(due, n_1, x_1)
    w[data.E_PSI], w[data.E_PSI_RATE] = select(due, n_2, x_2), select(due, n_3, x_3)


# ------------------------------------------------------------------------------------------------ one sample


@numba.njit(**OPTIONS)
def begin_sample(setting, w, k):
    """Command of sample k from `COMMAND`, delayed and limited; the steering angle just after it."""
    ring, whole = int(setting[data.COMMAND_RING]), k - int(setting[data.DELAY_SAMPLES])
    newest = data.RINGS + (k % ring)
    fresh, stale = data.RINGS + (whole % ring), data.RINGS + ((whole - 1) % ring)
    # the steering angle at the trigger is not limited
    most = setting[data.DELTA_MAX] if whole >= 0 else math.inf
    most_stale = setting[data.DELTA_MAX] if whole >= 1 else math.inf
    split = setting[data.DELAY_PART] > 0.0
    w[newest] = w[data.COMMAND]
    w[data.LAST_COMMAND] = w[data.COMMAND]
    w[data.YOUNG_COMMAND] = w[fresh]
    w[data.OLD_COMMAND] = w[stale]
    w[data.WHEEL_START] = w[data.WHEEL]
    w[data.PIECE_START] = w[data.SAMPLE_START] = w[data.T_0] + k * setting[data.DT]
    young = min(max(w[data.YOUNG_COMMAND], -most), most)
    w[data.YIELDING] = select(young != w[data.YOUNG_COMMAND], 1.0, 0.0)
    old = min(max(w[data.OLD_COMMAND], -most_stale), most_stale)
    w[data.YOUNG_COMMAND], w[data.OLD_COMMAND] = young, old
    w[data.DELTA_START] = select(setting[data.IMMEDIATE] > 0.0, select(split, old, young), w[data.WHEEL])


@numba.njit(**OPTIONS)
def correct_paths(w, paths):
    """Steering angle and lateral acceleration just after the command, in the paths' latest entries."""
    for l in range(L if paths.shape[0] else 0):
        if w[data.ALIVE, l] > 0.0 and w[data.PATH_ROW, l] >= 0.0:
            block_table.correct_record(paths, w, l, w[data.DELTA_START, l], w[data.A_Y_START, l])


@numba.njit(**OPTIONS)
def begin_segment(setting, w, road, segment):
    """Lengths, command and wheel angle of a segment; True if the wheels ramp in a lane."""
    for n in range(HEADER):
        w[data.SEGMENT_LENGTH + n] = road[segment + n]
    w[data.SEGMENT_START] = w[data.PIECE_START]
    alive, young, old = w[data.ALIVE], w[data.YOUNG_COMMAND], w[data.OLD_COMMAND]
    u = select(w[data.SEGMENT_AFTER_DELAY] > 0.0, young, old)
    w[data.SEGMENT_LENGTH] *= alive
    w[data.SUBSTEP_LENGTH] *= alive
    w[data.BEFORE_T] = w[data.SEGMENT_IN_T] * alive
    w[data.COMMAND] = w[data.DELTA_START] = w[data.DELTA_MID] = w[data.DELTA_END] = u
    for n in range(data.SCORES):
        w[data.SAVED + n] = w[data.SCORE + n]
    if setting[data.HELD] > 0.0:
        w[data.HELD_WHEEL] = w[data.WHEEL]
        w[data.WHEEL] = w[data.REFERENCE]
    ramps = actuator.steer(setting, w)
    if setting[data.HELD] > 0.0:
        driver.begin_segment(w)
    return ramps


@numba.njit(**OPTIONS)
def begin_substep(setting, w, j, ramps):
    """Length of substep j in each lane, and the steering angle along it."""
    whole = (j + 1) % data.PIECE == 0
    going = w[data.N_SUBSTEPS] > j
    w[data.H] = select(going, w[data.SUBSTEP_LENGTH], 0.0)
    w[data.PIECE_ENDS] = select((w[data.N_SUBSTEPS] == j + 1.0) | (going & whole), 1.0, 0.0)
    if setting[data.LAG] > 0.0 or setting[data.RATE_MAX] < math.inf:
        if ramps:
            actuator.along_ramp(setting, w, j)
        else:
            actuator.along_decay(w)
    if setting[data.HELD] > 0.0:
        driver.lay(setting, w)
        if setting[data.ARMS] == 0.0:
            driver.hold(setting, w)


@numba.njit(**OPTIONS)
def end_piece(setting, w, k):
    """Frames and scores of the pieces that end here; the next ones begin."""
    if setting[data.FRAMES_BETWEEN] > 0.0:
        sight.take_between(setting, k, w)
    if _score(setting, w):
        for l in range(L):
            if w[data.EVENT, l] > 0.0:
                block_table.look_closer(
                    setting, w, l, w[data.PIECE_START, l], w[data.PIECE_TIME, l], w[data.BEFORE_T, l] > 0.0
                )
    _next_piece(w)


@numba.njit(**OPTIONS)
def end_segment(setting, w):
    """Lanes that have left the bound in a segment end."""
    spun = _SPUN if setting[data.SATURATING] > 0.0 else math.inf
    for l in range(L):
        inside = (abs(w[data.NEXT_E_Y, l]) <= setting[data.BOUND]) & (abs(w[data.NEXT_E_PSI, l]) < spun)
        if not inside and w[data.ALIVE, l] > 0.0:
            for n in range(data.SCORES):
                w[data.SCORE + n, l] = w[data.SAVED + n, l]
            block_table.diverge(setting, w, l, w[data.SEGMENT_START, l], w[data.BEFORE_T, l] > 0.0)
            w[data.DIVERGED, l], w[data.ALIVE, l] = 1.0, 0.0


@numba.njit(**OPTIONS)
def _drive_segment(setting, w, k, road, segment):
    """All lanes over a segment."""
    ramps, substeps, point = begin_segment(setting, w, road, segment), w[data.N_SUBSTEPS], segment + HEADER
    least, most = int(smallest(substeps)), int(largest(substeps))
    for j in range(most):
        begin_substep(setting, w, j, ramps)
        if setting[data.ARMS] > 0.0:
            if setting[data.SATURATING] > 0.0:
                _saturating_held(setting, w, road, point)
            else:
                _linear_held(setting, w, road, point)
        elif setting[data.SATURATING] > 0.0:
            _saturating(setting, w, road, point)
        else:
            _linear(setting, w, road, point)
        point += 2 * POINT
        if j + 1 >= least or (j + 1) % data.PIECE == 0:
            end_piece(setting, w, k)
    end_segment(setting, w)
    return point  # of the segment's end


@numba.njit(**OPTIONS)
def advance(setting, w, k, road, segment, end, bend, bend_row, intended, intended_row, paths):
    """Sample k with the command in `COMMAND`: segments of the road from `segment` to `end`. Lanes that go on after."""
    begin_sample(setting, w, k)
    if setting[data.HELD] > 0.0:
        driver.begin_sample(setting, w, k, intended, intended_row)
    point = segment + HEADER
    # a steering angle that does not jump leaves a_y as it was
    w[data.A_Y_START], w[data.A_Y_RELATIVE_START] = w[data.A_Y_END], w[data.A_Y_RELATIVE_END]
    if setting[data.IMMEDIATE] > 0.0:
        _accelerations(setting, w, road[point], road[point + 1], road[point + 2], w[data.DELTA_START], data.A_Y_START)
    correct_paths(w, paths)
    while segment < end:
        point = _drive_segment(setting, w, k, road, segment)
        segment = point + POINT
        if segment < end and any_lane((w[data.SEGMENT_IN_T] > 0.0) & (road[segment + IN_T] == 0.0)):
            v, per_v, lane = road[point], road[point + 1], road[point + 2]
            _accelerations(setting, w, v, per_v, lane, w[data.WHEEL], data.A_Y_START_PAST)
            at_T(w, road, segment, paths)
    settle(setting, w)
    if setting[data.HELD] > 0.0:
        driver.supervise(setting, w, k)
    _accelerations(setting, w, road[point], road[point + 1], road[point + 2], w[data.WHEEL], data.A_Y_END)
    for n in range(4):
        w[data.BEND_START + n] = bend[bend_row + n]
    return end_sample(setting, w, k, paths)


@numba.njit(**OPTIONS)
def settle(setting, w):
    """The next sample starts where this one ended; a lane that has ended stays finite."""
    alive = w[data.ALIVE] > 0.0
    w[data.E_Y] = w[data.NEXT_E_Y] = select(alive, w[data.NEXT_E_Y], 0.0)
    w[data.E_Y_RATE] = w[data.NEXT_E_Y_RATE] = select(alive, w[data.NEXT_E_Y_RATE], 0.0)
    w[data.E_PSI] = w[data.NEXT_E_PSI] = select(alive, w[data.NEXT_E_PSI], 0.0)
    w[data.E_PSI_RATE] = w[data.NEXT_E_PSI_RATE] = select(alive, w[data.NEXT_E_PSI_RATE], 0.0)
    w[data.V_Y] = select(alive, w[data.V_Y], 0.0)
    rate = abs(w[data.WHEEL] - w[data.WHEEL_START]) / setting[data.DT]
    w[data.DELTA_RATE_PEAK] = max(w[data.DELTA_RATE_PEAK], select(alive, rate, 0.0))


@numba.njit(**OPTIONS)
def end_sample(setting, w, k, paths):
    """Scores of the acceleration over sample k, and paths; the number of lanes that go on."""
    block_table.look_back(setting, w, k)
    for l in range(L):
        if w[data.ALIVE, l] > 0.0 and k + 1 == w[data.ALL_STEPS, l]:
            block_table.look_back_from_end(setting, w, l, k)
    block_table.score_limits(setting, w)
    return block_table.end_sample(setting, w, k, paths)


@numba.njit(**OPTIONS)
def at_T(w, road, segment, paths):
    """Lanes whose T is where the segment from `segment` on begins: just after it nothing is recorded any more.

    Their accelerations stand in the rows from `A_Y_START_PAST` on.
    """
    for l in range(L):
        if w[data.BEFORE_T, l] * w[data.ALIVE, l] > 0.0 and road[segment + 1, l] == 0.0 and road[segment, l] > 0.0:
            peak = abs(w[data.A_Y_RELATIVE_START_PAST, l])
            w[data.A_Y_ADDED_PEAK, l] = max(w[data.A_Y_ADDED_PEAK, l], peak)
            if paths.shape[0] and w[data.PATH_ROW, l] >= 0.0:
                block_table.record(paths, w, l, w[data.T, l], w[data.A_Y_START_PAST, l])


# ------------------------------------------------------------------------------------------------ a whole run


@numba.njit(**OPTIONS)
def start(scene, setting, block, w, paths, path_rows):
    """Everything before the first sample of a block."""
    frames, _, modes, rows = rings(setting)
    for n in range(rows):
        w[n] = 0.0
    block_table.begin(scene, setting, block, w, paths, path_rows)
    size, count = int(setting[data.FRAME_RING]), int(setting[data.MODES])
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        w[data.OUTWARD, l], w[data.SUBSTEPS_A_SAMPLE, l] = scene[i, data.SIDE], scene[i, data.SUBSTEPS]
        w[data.SCENARIO, l], w[data.CURVE_BIAS, l] = scene[i, data.INDEX], scene[i, data.CURVATURE_BIAS]
        T, v, a = scene[i, data.T_END], scene[i, data.SPEED], 0.0
        if setting[data.PROFILE] > 0.0:
            v, a = scene[i, data.V_MEAN] - 0.5 * scene[i, data.A_MEAN] * T, scene[i, data.A_MEAN]
        road = (v, a, scene[i, data.C_0], scene[i, data.DC] / T, math.pi / T)
        for n in range(5):
            w[data.V_0 + n, l] = road[n]
        for j in range(count):
            w[modes + j, l] = scene[i, data.SCENE + j]
            if setting[data.PROFILE] > 0.0 and scene[i, data.SCENE + j] != 0.0:
                w[data.MODES_USED, 0] = max(w[data.MODES_USED, 0], j + 1.0)
        mass, I_z, l_f, l_r = scene[i, data.MASS], scene[i, data.I_Z], scene[i, data.L_F], scene[i, data.L_R]
        # forces over the mass: of an axle per slip angle, or its largest; lever arms over the yaw inertia, times mass
        front, rear = 2.0 * scene[i, data.C_AF] / mass, 2.0 * scene[i, data.C_AR] / mass
        grip = scene[i, data.MU] * GRAVITY / (l_f + l_r)
        if setting[data.SATURATING] > 0.0:
            front, rear = front / (setting[data.SHAPE] * grip * l_r), rear / (setting[data.SHAPE] * grip * l_f)
        arms = l_f * mass / I_z, l_r * mass / I_z
        car = (front, rear, l_f, l_r, *arms, scene[i, data.PRINTED], grip * l_r, grip * l_f)
        for n in range(9):
            w[data.STIFFNESS_F + n, l] = car[n]
        w[data.REFERENCE, l] = scene[i, data.DELTA_0]
        w[data.COLUMN, l] = scene[i, data.DELTA_0] * setting[data.RATIO] if setting[data.ARMS] > 0.0 else 0.0
        for n in range(8):
            w[data.INTENT + n, l] = scene[i, data.DRIVER + n]
        for n in range(2 * int(setting[data.COMMAND_RING])):
            w[data.RINGS + n, l] = scene[i, data.DELTA_0]
        if setting[data.FILTERED] > 0.0:
            model = data.SCENE + count + 2 * int(setting[data.EARLIER_FRAMES])
            for n in range(data.FILTER):
                w[data.FILTER_ROWS + n, l] = scene[i, model + n]
            for n in range(4):
                w[data.ESTIMATE + n, l] = scene[i, model + data.FIRST + n] * w[data.ALIVE, l]
        k = 0
        while setting[data.CAMERA] > 0.0 and sight.frame_of(setting, k) < 0:
            for n in range(2):
                column = data.SCENE + count + 2 * (-sight.frame_of(setting, k) - 1) + n
                w[frames + 2 * (k % size) + n, l] = scene[i, column]
            k += 1
    w[data.WHEEL_SEEN], w[data.SEGMENT_START] = w[data.LAST_COMMAND], w[data.T_0]
    v, _, lane = motion_at(setting, w, w[data.T_0])
    psi, rate = w[data.E_PSI], w[data.E_Y_RATE]
    sine_psi, cosine_psi = sine_and_cosine(psi)
    w[data.V_Y] = fma(-v, psi, rate)
    if setting[data.SATURATING] > 0.0:
        w[data.V_Y] = fma(-v, sine_psi, rate) / cosine_psi
    _accelerations(setting, w, v, 1.0 / v, lane, w[data.WHEEL], data.A_Y_END)
    w[data.A_Y_BEFORE] = w[data.A_Y_END]


@numba.njit(**OPTIONS)
def drive_block_any(
    scene, setting, law, times, recorded, motion, paths, path_rows, block, score, diverged, failed, tables, ends
):
    """Every design of a law on one block of scenarios; what designs share is worked out once."""
    w, lane_weights, bend, road, preview, noise, intended = tables
    m, lookaheads, columns = scene.shape[0], times.shape[1], law.shape[2] - data.LAW
    start(scene, setting, block, w, paths[:0], path_rows)
    most, wide = 0, 1 + 2 * lookaheads
    for l in range(L):
        most = max(most, int(w[data.ALL_STEPS, l]))
    for k in range(most):
        if setting[data.HELD] > 0.0:
            driver.lay_recorded(setting, w, motion, block, k, intended, 7 * k)
        ends[k + 1] = lay_road(setting, k, w, True, road, ends[k])
        block_table.lay_bend(setting, recorded, block, k, w, bend, 4 * k)
        sight.noise_of(setting, k, w, noise, 2 * k)
    for design in range(law.shape[0]):
        same = design > 0
        for j in range(lookaheads):
            same &= times[design, j] == times[design - 1, j]
        if not same:
            for k in range(most):
                sight.preview_lane(setting, k, w, times[design], preview, k * wide)
        start(scene, setting, block, w, paths, path_rows)
        for l in range(L):
            i = min(block * L + l, m - 1)
            for n in range(data.LAW):
                w[data.F_E_Y + n, l] = law[design, i, n]
            for j in range(columns):
                lane_weights[j, l] = law[design, i, data.LAW + j]
        for k in range(most):
            sight.see(setting, w, k, preview, k * wide, noise, 2 * k)
            sight.command(setting, w, k, lane_weights, preview, k * wide, lookaheads, columns - 2 * lookaheads)
            if not advance(setting, w, k, road, ends[k], ends[k + 1], bend, 4 * k, intended, 7 * k, paths):
                break
        block_table.store_scores(w, design, block, score, diverged, failed)
