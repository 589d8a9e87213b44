"""What the compiled loops read and write: one row of numbers a scenario, and the numbers that all of them share.

A compiled function counts references to every array that it is handed in a tuple, which costs more than the step of a
plant: the scenarios are therefore one array, with the columns named here. The m triggered
scenarios come in the takeover's order. Nothing that is imported here needs the compiler.
"""

import itertools
import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.plant_options import whole_multiple
from ldctoolkit.setup import Setup
from ldctoolkit.vehicle import Plant

PIECE: Final = 2  # substeps after which scores are taken: about half of the fastest time constant

STIFF: Final = 8
"""Substeps a sample above which even the ideal plant takes them: about two of the fastest time constants."""

# columns of a scenario: constant over a run
START: Final = 0  # [s] trigger
T_END: Final = 1  # [s] departure's end T
FULL: Final = 2  # whole steps from the trigger to T
REST: Final = 3  # [s] what remains of T after them
STEPS: Final = 4  # steps to the end of the settling horizon, a last shorter one included
SIDE: Final = 5  # +1 left, -1 right
INDEX: Final = 6  # identity, for random draws
SPEED: Final = 7  # [m/s] at the trigger
V_MEAN: Final = 8
A_MEAN: Final = 9
C_0: Final = 10
DC: Final = 11
X_0: Final = 12  # 4 columns: start state
DELTA_0: Final = 16
# the row of e_y'' in the linear model, and its weights of delta and psi_l'
A_11, A_12, A_13, B_1, E_1 = range(17, 22)
# true vehicle; PRINTED is 4 C_ar l_r/m where the printed matrix is meant
C_AF, C_AR, L_F, L_R, MASS, I_Z, MU, PRINTED = range(22, 30)
CURVATURE_BIAS: Final = 30  # [1/m] outward
SUBSTEPS: Final = 31  # least number of Runge-Kutta steps a sample, not rounded
BEND: Final = 32  # 3 columns: y'' of the recorded path without residuals as a polynomial in t
# a driver: what he means, as a position in `INTENTS`; share or stiffness [N m/rad]; reaction time [s]; lateral
# acceleration outward, frequency of the return; steering angle and front force over the mass per lateral acceleration;
# aligning torque at the steering wheel per front force over the mass [N m s^2/m]
DRIVER: Final = 35  # 8 columns, in this order
SCENE: Final = 43  # then, in this order: amplitudes of the speed residual, frames before the trigger, the Kalman filter

# the filter's own columns: gain (4 x 2), A (4 x 4); 4 each: weights of the younger of two commands, of the lane's yaw
# rate at both ends, of the older command, of the wheel angle; first estimate
GAIN, MODEL_A, MODEL_B, MODEL_E_0, MODEL_E_1, MODEL_OLD, MODEL_WHEEL, FIRST, FILTER = 0, 8, 24, 28, 32, 36, 40, 44, 48


# the area, the metrics of a scenario in the order of their table, and the state of the assist
SCORES: Final = 2 + len(SCENARIO_METRICS)

# columns of a path's entry
P_TIME, P_X, P_DELTA, P_A_Y, P_COMMAND, P_TORQUE, P_ASSIST, P_AUTHORITY, P_STATE, PATH = 0, 1, 5, 6, 7, 8, 9, 10, 11, 12

# columns of a linear law, then pairs of weights of yaw rate and heading for every lookahead time, then of past commands
LAW_F, LAW_U, LAW_I, LAW_WHEEL, LAW_CONDITIONED, LAW = 0, 4, 5, 6, 7, 8

# columns of the ideal plant over a step: A[:, 1:4], B, E_0, E_1 row by row, then the weights of the area
EX_B, EX_E_0, EX_E_1, EX_X, EX_DELTA, EX_R_0, EX_R_1, EXACT = 12, 16, 20, 24, 28, 29, 30, 31

# ------------------------------------------------------------------------------------------------ the table of a block
#
# Eight scenarios stand side by side: a row holds one quantity of all of them. In the loops `w` is this table, w[row]
# the quantity of all lanes and w[row, l] that of lane l. The rows come in the order in which they are named here.

_rows = itertools.count()


def _next(count: int) -> Iterator[int]:
    """The next so many rows."""
    return itertools.islice(_rows, count)


# a piece of the path: the state at its start and at its end, and the integrals of e_y [m s] and of e_psi [rad s]
E_Y, E_Y_RATE, E_PSI, E_PSI_RATE = _next(4)
NEXT_E_Y, NEXT_E_Y_RATE, NEXT_E_PSI, NEXT_E_PSI_RATE, PIECE_AREA, PIECE_TURN = _next(6)
LAST_COMMAND, COMMAND = _next(2)  # [rad] of the sample before, and the present one
E_Y_INTEGRAL = next(_rows)  # [m s] z, as the law sees it
BEFORE_T, ALIVE = _next(2)  # 1 or 0
EVENT = next(_rows)  # 1 where a piece needs a closer look
SCORE, *_ = _next(SCORES)
DIVERGED, FAILED = _next(2)  # 1 or 0; number of commands that were not finite
PATH_ENTRIES = next(_rows)  # of the path so far
WHEEL = next(_rows)  # [rad] steering angle at present, or at the segment's end
NEXT_CUT = next(_rows)  # first sample at which a lane passes its T or ends; in the first lane
SINGLE = next(_rows)  # 1 where a step was driven by itself
LANE_RATE, V_C_0, V_DC = _next(3)  # [rad/s] the lane's yaw rate at the last sample; v c_0 and v dc
# up to here is what an exact run changes

# [m/s^2] a_y at the start and the end of a sample, the same relative to the road, without v^2 c; what they were a jerk
# window earlier; y'' of the recorded path at the start and the end, of this sample and a jerk window earlier
A_Y_START, A_Y_END, A_Y_RELATIVE_START, A_Y_RELATIVE_END = _next(4)
A_Y_START_PAST, A_Y_END_PAST, A_Y_RELATIVE_START_PAST, A_Y_RELATIVE_END_PAST = _next(4)
BEND_START, BEND_END, BEND_START_PAST, BEND_END_PAST = _next(4)

# the scenario
T_0, T, STOP = _next(3)  # [s] trigger, end of the departure, end of the settling horizon
WHOLE_STEPS, REST_OF_T, ALL_STEPS = _next(3)  # whole steps to T, what remains of T [s], steps to the end
SCENARIO, PATH_ROW = _next(2)  # its number; row of its path, or -1
V_0, A_0, CURVATURE_0, CURVATURE_RATE, PI_PER_T = _next(5)  # v = V_0 + A_0 t, c = CURVATURE_0 + CURVATURE_RATE t
BEND_0, BEND_1, BEND_2 = _next(3)  # y'' of the recorded path as a polynomial in t
A_Y_BEFORE = next(_rows)  # [m/s^2] a_y before the trigger
# weights of a linear law; 1 where its integral stops while the assist yields
F_E_Y, F_E_Y_RATE, F_E_PSI, F_E_PSI_RATE, F_U, F_I, F_WHEEL, F_CONDITIONED = _next(LAW)

# exact steps
G_YAW_RATE, G_HEADING = _next(2)  # weights of the lane at a single lookahead time
V, PER_T = _next(2)  # v, 1/T
DDE_E_Y_RATE, DDE_E_PSI, DDE_E_PSI_RATE, DDE_DELTA, DDE_LANE = _next(5)  # row of e_y''
STEP, *_ = _next(EXACT)
STEP_E_Y, STEP_E_Y_RATE, STEP_E_PSI, STEP_E_PSI_RATE = (STEP + 3 * n for n in range(4))  # rows of A
STEP_B, STEP_E_0, STEP_E_1, STEP_AREA_X, STEP_AREA_DELTA, STEP_AREA_R_0, STEP_AREA_R_1 = (
    STEP + n for n in (EX_B, EX_E_0, EX_E_1, EX_X, EX_DELTA, EX_R_0, EX_R_1)
)

CURVE_BIAS = next(_rows)  # [1/m] error of the previewed curvature
MODES_USED = next(_rows)  # modes of the speed in the block, in every lane

# Runge-Kutta steps: least number of substeps a sample, not rounded, length of the present one [s]; of the piece: its
# length so far, its start since that of the departure [s], 1 where it ends
SUBSTEPS_A_SAMPLE, H, PIECE_TIME, PIECE_START, PIECE_ENDS = _next(5)
V_Y = next(_rows)  # [m/s] lateral velocity of the vehicle in its own frame
# a segment: its length [s], 1 before T, 1 after the delay, substeps, length of one [s]; decay of a lag over both
# lengths, and the parabola of that over a substep, see `kernel.road`
SEGMENT_LENGTH, SEGMENT_IN_T, SEGMENT_AFTER_DELAY, N_SUBSTEPS, SUBSTEP_LENGTH = _next(5)
LAG_SEGMENT, LAG_SUBSTEP, LAG_START, LAG_MID, LAG_END = _next(5)
YOUNG_COMMAND, OLD_COMMAND = _next(2)  # [rad] limited command from the switch on, and before it
# the steering angle along a segment: rate and duration of its ramp, where that starts, what then remains to the command
RAMP_RATE, RAMP_TIME, RAMP_START, TO_COMMAND = _next(4)
DELTA_START, DELTA_MID, DELTA_END = _next(3)  # [rad] steering angle of a substep as a parabola
ROAD_V, ROAD_DV, ROAD_LANE = _next(3)  # speed, its rate and yaw rate of the lane at a moment
SEGMENT_START, WHEEL_START = _next(2)  # [s] start of a segment; [rad] steering angle at the start of a sample
SAVED, *_ = _next(SCORES)  # scores at the start of the segment

# what a law sees: the state, the steering angle now and at the last sample, the Kalman filter's estimate, the lane's
# yaw rate at the last sample; side of the departure (1 or -1)
SEEN_E_Y, SEEN_E_Y_RATE, SEEN_E_PSI, SEEN_E_PSI_RATE, WHEEL_SEEN, WHEEL_SEEN_BEFORE = _next(6)
ESTIMATE, *_ = _next(4)
INNOVATION_Y, INNOVATION_PSI = _next(2)
LANE_RATE_SEEN, OUTWARD = _next(2)
# the vehicle: cornering stiffness of each axle over the mass (over its largest force where tyres saturate), distance of
# the axles [m], the same times m/I_z, what the printed matrix adds, largest force of each axle over the mass
STIFFNESS_F, STIFFNESS_R, AXLE_F, AXLE_R, ARM_F, ARM_R, PRINTED_TERM, GRIP_F, GRIP_R = _next(9)
# a driver, see `kernel.driver`: the columns of the scenario
INTENT, STRENGTH, REACTION, ACROSS, FREQUENCY, DELTA_PER_A_Y, FORCE_PER_A_Y, TRAIL_TORQUE = _next(8)
# the recorded path: y' at the trigger, and the twin that drives it; steering and force that are held
HOLD_RATE, HOLD_ANGLE, HOLD_FRONT = _next(3)
TWIN_PSI, TWIN_TURN, TWIN_YAW, TWIN_DELTA, TWIN_FRONT, TWIN_SLIP, TWIN_H, TWIN_STEPS = _next(8)
RECORDED_RATE, RECORDED_BEND = _next(2)
# over a sample: its start [s]; angle and front force that the driver means at start, middle and end; lateral
# acceleration of his own now, and where it goes; tension and authority at both ends
SAMPLE_START = next(_rows)
MEANT_START, MEANT_MID, MEANT_END, MEANT_FORCE_START, MEANT_FORCE_MID, MEANT_FORCE_END, OWN_A_Y, OWN_TARGET = _next(8)
TENSE_START, TENSE_END, AUTHORITY_START, AUTHORITY = _next(4)
# column angle and rate at the steering wheel, or z of a grip in the first; torques of driver and assist; samples that
# the torque has been beyond its limit, or below; 1 where the law has to know that the assist yields; 1 from the moment
# the vehicle was parallel; the present stretch against the driver [s]; the angle that the assist follows
COLUMN, COLUMN_RATE, TORQUE, ASSIST, BEYOND, YIELDING, PARALLEL, STRETCH, REFERENCE, HELD_WHEEL = _next(10)
# polynomials over a substep: angle that the assist follows, angle and torque that the driver means, tension,
# authority; moments of z
REF_0, REF_1, REF_2, MEANT_0, MEANT_1, MEANT_2, FEED_0, FEED_1, FEED_2 = _next(9)
TENSE_0, TENSE_1, AUTH_0, AUTH_1, MOMENT_0, MOMENT_1, MOMENT_2 = _next(7)
FILTER_ROWS, *_ = _next(FILTER)
RINGS = next(_rows)  # then come the rings, of a length that the run decides; see `kernel.block_table.rings`


def _score(metric: str) -> int:
    """Row of the score of a metric."""
    return SCORE + 1 + tuple(SCENARIO_METRICS).index(metric)


# pieces of a sample on a vehicle model: what it is asked, and what follows from its answer
ASK_AT_TRIGGER, AT_TRIGGER, ASK_COMMANDED, COMMANDED, ASK_STEP, STEPPED, ASK_CUT, AT_CUT, ASK_END, AT_END = range(10)
QUESTION: Final = 17  # numbers that a model gets for a lane, see `kernel.model_loop`
HEADER: Final = 10  # rows of a segment of the road without its substeps, see `kernel.road`; a sample has at most four

AREA: Final = SCORE  # integral of |e_y| up to T
DEEPEST: Final = _score("deepest")  # max of e_y up to T
FRONT_DEEPEST: Final = _score("dtle")  # max of e_y + l_f e_psi up to T
T_BACK: Final = _score("t_back")  # time of the first crossing back inside
OPPOSITE: Final = _score("opposite_crossing")  # max of -e_y
A_Y_PEAK: Final = _score("a_y_peak")
JERK_PEAK: Final = _score("jerk_peak")
A_Y_ADDED_PEAK: Final = _score("a_y_added_peak")
JERK_ADDED_PEAK: Final = _score("jerk_added_peak")
DELTA_PEAK: Final = _score("delta_peak")
DELTA_RATE_PEAK: Final = _score("delta_rate_peak")
EFFORT: Final = _score("effort")
TRAVEL: Final = _score("travel")
DRIVER_PEAK: Final = _score("driver_torque_peak")
DRIVER_MEAN: Final = _score("driver_torque_mean")  # integral of |T_d| here
AGAINST_TIME: Final = _score("against_time")
AGAINST_PARALLEL: Final = _score("against_parallel")
OVERRIDDEN: Final = _score("overridden")
HANDOVER_STEP: Final = _score("handover_step")
ASSIST_STATE: Final = SCORE + SCORES - 1  # `AssistState`


# ------------------------------------------------------------------------------------------------ numbers of a run

# numbers of a run that hold for every scenario, see `setting_row`; yes is 1
(
    DT, OFFSET, L_FRONT, BOUND, WINDOW, PROFILE, SATURATING, SHAPE, DELTA_MAX, RATE_MAX, LAG, DELAY_SAMPLES, DELAY_PART,
    MODES, EARLIER_FRAMES, CAMERA, PERIOD, CAMERA_DELAY, NOISE_Y, NOISE_PSI, BIAS_Y, BIAS_PSI, STEP_Y, STEP_PSI,
    CURVATURE_GAIN, SEED_LOW, SEED_HIGH, FILTERED, KNOWN_DELAY, KNOWN_AGE, COMMAND_RING, FRAME_RING, A_Y_RING,
    HELD, ARMS, RATIO, ASSIST_STIFFNESS, ASSIST_DAMPING, TORQUE_MAX, ARM_DAMPING, ARM_LAG, WHEEL_DAMPING, INERTIA,
    RETURN_DAMPING, OVERRIDE_TORQUE, OVERRIDE_TIME, RAMP, RETURN_AFTER, GRIP_STEPS, IMMEDIATE, FRAMES_BETWEEN,
) = range(51)  # fmt: skip
TYRE: Final = 51  # then, for `tyre_force`, the numbers of `tyre_series`


def setting_row(setup: Setup, plant: Plant, *, modes: int, bound: float, window: float) -> FloatArray:
    """The numbers of a run that hold for every scenario; `plant` is what a design knows."""
    actuator, sensors, driver, dt = setup.options.actuator, setup.options.sensors, setup.options.driver, setup.dt
    whole = math.floor(actuator.delay / dt + 1e-9)
    part = actuator.delay - whole * dt
    known_delay = math.floor(plant.delay / dt + 1e-9)
    period, late = sensors.period or dt, sensors.delay
    values = {
        DT: dt,
        OFFSET: setup.vehicle.edge_offset,  # [m] e_y with the edge on the line
        L_FRONT: setup.vehicle.l_f,  # [m]
        BOUND: bound,  # [m] |e_y| that counts as diverged
        WINDOW: whole_multiple(window, dt) / dt,  # samples in the moving average of the jerk
        PROFILE: setup.options.speed == "profile",  # v(t) instead of the trigger's speed
        SATURATING: not setup.options.tyres.ideal or setup.vehicle_model is not None,  # tyres
        SHAPE: setup.options.tyres.shape,  # of the tyres
        DELTA_MAX: math.inf if actuator.delta_max is None else actuator.delta_max,  # infinite for none
        RATE_MAX: math.inf if actuator.rate_max is None else actuator.rate_max,  # infinite for none
        LAG: actuator.lag,
        DELAY_SAMPLES: whole,
        DELAY_PART: part if part > 1e-9 * dt else 0.0,  # [s] what remains of the delay after whole samples
        MODES: modes,  # columns of the speed residual
        EARLIER_FRAMES: math.ceil(late / period - 1e-9),  # frames before the trigger
        CAMERA: not sensors.ideal,  # the law sees frames, not the state
        PERIOD: period,  # [s] between frames
        CAMERA_DELAY: late,  # [s] until a frame arrives
        NOISE_Y: sensors.e_y_noise,
        NOISE_PSI: sensors.e_psi_noise,
        BIAS_Y: sensors.e_y_bias,  # in the road's frame
        BIAS_PSI: sensors.e_psi_bias,
        STEP_Y: sensors.e_y_step,  # of quantisation
        STEP_PSI: sensors.e_psi_step,
        CURVATURE_GAIN: sensors.curvature_gain,
        SEED_LOW: setup.seed & 0xFFFFFFFF,
        SEED_HIGH: setup.seed >> 32,
        FILTERED: sensors.kalman is not None,
        KNOWN_DELAY: known_delay,  # whole samples of delay that a design knows
        KNOWN_AGE: plant.age,  # [s] of the camera's
        # length of the rings of commands and of wheel angles
        COMMAND_RING: max(whole, known_delay, math.ceil(plant.age / dt)) + 3,
        FRAME_RING: 0 if sensors.ideal else math.ceil((late + period) / dt) + 2,  # length of the ring of frames
        # length of the ring of lateral accelerations, a power of two
        A_Y_RING: 2 ** math.ceil(math.log2(math.ceil(window / dt) + 3)),
        HELD: driver.holds,  # a driver holds the wheel
        ARMS: driver.holds and driver.model == "arms",
        RATIO: setup.vehicle.steering_ratio,
        ASSIST_STIFFNESS: driver.assist_stiffness,
        ASSIST_DAMPING: driver.assist_damping,
        TORQUE_MAX: driver.torque_max,
        ARM_DAMPING: driver.damping,
        ARM_LAG: driver.arm_lag,
        WHEEL_DAMPING: driver.wheel_damping,
        INERTIA: driver.wheel_inertia + driver.inertia,
        RETURN_DAMPING: driver.return_damping,
        OVERRIDE_TORQUE: driver.override_torque,
        OVERRIDE_TIME: driver.override_time,
        RAMP: driver.ramp,
        RETURN_AFTER: driver.return_after,
        GRIP_STEPS: 4,  # within a substep
        # the steering angle jumps with the command
        IMMEDIATE: actuator.lag == 0.0 and actuator.rate_max is None and not driver.holds,
        FRAMES_BETWEEN: not sensors.ideal and abs(period / dt - round(period / dt)) > 1e-9,  # samples
    }
    from ldctoolkit.vector_math import tyre_series

    row = np.array([values[n] for n in range(len(values))], dtype=np.float64)
    return np.concatenate([row, tyre_series(setup.options.tyres.shape)])


STRAIGHTENS_IN: Final = 0.2  # [s] of a driver after the end of the recorded path
NEUROMUSCULAR_LAG: Final = 0.1  # [s] of a driver between what he wants and what his arms do
_COLUMN_REACH: Final = 0.4  # step of the column in units of its fastest time constant
LONGEST: Final = 0.03  # [s] longest substep of the Runge-Kutta method: the law's own poles are no slower at high speed


def column_steps(setup: Setup) -> int:
    """Least number of substeps a sample that the arms of a driver need; one more where commands jump."""
    driver, actuator = setup.options.driver, setup.options.actuator
    if not driver.holds or driver.model == "grip":
        return 1
    inertia = driver.wheel_inertia + driver.inertia
    damping = driver.damping + driver.assist_damping + driver.wheel_damping
    vehicle, tyres = setup.vehicle, setup.options.mismatch.C_af[1] * (1.0 - driver.boost) * driver.trail
    tyres *= 2.0 * vehicle.C_af / vehicle.steering_ratio**2  # stiffness of the aligning torque at the steering wheel
    swings = math.sqrt((driver.assist_stiffness + driver.stiffness[1] + tyres) / inertia)
    jumps = actuator.lag == 0.0 and actuator.rate_max is None
    return math.ceil(setup.dt * max(swings, damping / inertia) / _COLUMN_REACH) + jumps
