"""What the compiled loops read and write: one row of numbers a scenario, and the numbers that all of them share.

A compiled function counts references to every array that it is handed in a tuple, which costs more than the step of a
plant: the scenarios are therefore one array, with the columns named here. The m triggered
scenarios come in the takeover's order. Nothing that is imported here needs the compiler.
"""

import math
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.plant_options import whole_multiple
from ldctoolkit.setup import Setup
from ldctoolkit.vehicle import Plant

LANES: Final = 8  # scenarios side by side, in the vector registers of the processor
PIECE: Final = 4  # substeps after which scores are taken: about one of the fastest time constants

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
SUBSTEPS: Final = 31  # of the Runge-Kutta method in a segment
BEND: Final = 32  # 3 columns: y'' of the recorded path without residuals as a polynomial in t
SCENE: Final = 35  # then, in this order: amplitudes of the speed residual, frames before the trigger, the Kalman filter

# the filter's own columns: gain (4 x 2), A (4 x 4); 4 each: weights of the younger of two commands, of the lane's yaw
# rate at both ends, of the older command, of the wheel angle; first estimate
GAIN, MODEL_A, MODEL_B, MODEL_E_0, MODEL_E_1, MODEL_OLD, MODEL_WHEEL, FIRST, FILTER = 0, 8, 24, 28, 32, 36, 40, 44, 48


def score_column(metric: str) -> int:
    """Row of a metric of a scenario among the scores: in the order of their table, behind the area."""
    return 1 + tuple(SCENARIO_METRICS).index(metric)


AREA: Final = 0  # integral of |e_y| up to T
DEEP: Final = score_column("deepest")  # max of e_y up to T
FRONT: Final = score_column("dtle")  # max of e_y + l_f e_psi up to T
BACK: Final = score_column("t_back")  # time of the first crossing back inside
OPPOSITE: Final = score_column("opposite_crossing")  # max of -e_y
A_Y: Final = score_column("a_y_peak")
JERK: Final = score_column("jerk_peak")
A_Y_ADDED: Final = score_column("a_y_added_peak")
JERK_ADDED: Final = score_column("jerk_added_peak")
DELTA: Final = score_column("delta_peak")
RATE: Final = score_column("delta_rate_peak")
EFFORT: Final = score_column("effort")
TRAVEL: Final = score_column("travel")
SCORES: Final = 1 + len(SCENARIO_METRICS)

P_TIME, P_X, P_DELTA, PATH = 0, 1, 5, 6  # columns of a path's entry

# columns of a linear law, then pairs of weights of yaw rate and heading for every lookahead time, then of past commands
LAW_F, LAW_U, LAW_I, LAW_WHEEL, LAW = 0, 4, 5, 6, 7

# columns of the ideal plant over a step: A[:, 1:4], B, E_0, E_1 row by row, then the weights of the area
EX_B, EX_E_0, EX_E_1, EX_X, EX_DELTA, EX_R_0, EX_R_1, EXACT = 12, 16, 20, 24, 28, 29, 30, 31

# rows of the table of a block, `LANES` numbers each. All of it is one array with fixed distances, so that the compiler
# sees that rows do not overlap and works on the lanes of a row together. A name is the place of a row's first number.
_SIZES: Final = {
    "x": 4,  # state at the start of a piece of the path
    "n": 4,  # at its end
    "signed": 1,  # integral of e_y over it
    "command": 1,  # the last
    "target": 1,  # command to be driven
    "z": 1,  # integral of e_y as the law sees it
    "counted": 1,  # 1 before T
    "alive": 1,
    "flag": 1,  # 1 where a piece needs a closer look
    "scores": SCORES,
    "diverged": 1,
    "failed": 1,
    "entries": 1,  # of the path so far
    "wheel": 1,  # steering angle at present, or at the segment's end
    "next_cut": 1,  # first sample at which a lane passes its T or ends, in the first lane
    "single": 1,  # 1 where a step was driven by itself
    "lane": 1,  # the lane's yaw rate at the last sample that was looked at
    "c_0": 1,  # v c_0
    "dc": 1,  # v dc
    # up to here is what an exact run changes
    "limits": 4,  # a_y at the start and the end of a sample, then without the lane's part v^2 c
    "past": 4,  # what they were a window earlier
    "recorded": 4,  # y'' of the recorded path at both ends of a sample, and a window before them
    # the scenario
    "t_0": 1,
    "T": 1,
    "stop": 1,  # end of the settling horizon
    "ends": 3,  # whole steps to T, the rest of T, steps to the end
    "index": 1,
    "kept": 1,  # place of the path among those that are kept, or -1
    "road": 5,  # speed and its rate at t = 0 without residuals, c_0, dc/T, pi/T
    "bend": 3,
    "before": 1,  # a_y before the trigger
    "law": LAW,
    # exact steps
    "weights": 2,  # of yaw rate and turn at a single lookahead time
    "v": 1,
    "per_T": 1,
    "a": 5,  # row of e_y'': 3 states, delta, the lane's yaw rate
    "step": EXACT,
    # Runge-Kutta steps
    "times": 1,  # at which the road is wanted
    "motion": 4,  # speed, its rate, way since t = 0, and turn of the lane along it
    "way": 2,  # way and turn at the present sample
    "curve_bias": 1,  # error of the previewed curvature
    "wave": 5,  # cosine and sine of pi t/T, and of its multiple; amplitude
    "modes": 1,  # of the speed residual that are in use in the block, in every lane
    "substeps": 1,
    "h": 1,  # length of a substep
    "span": 1,  # of a piece so far
    "now": 1,  # its start, since the departure's
    "due": 1,  # 1 where it ends
    "points": 12,  # of the road along a substep, see `kernel.sight`
    "segment": 9,
    "driven": 2,  # limited command from the switch on, and before it
    "work": 4,  # rows from elsewhere that are worked on together with others
    "slope": 1,  # of the ramp of the steering angle
    "ramp": 1,  # how long that lasts
    "from": 1,  # steering angle at the segment's start
    "left": 1,  # what remains to the command
    "parabola": 3,  # steering angle at the start, the middle and the end of a substep
    "began": 2,  # time at a segment's start, steering angle at a sample's
    "saved": SCORES,
    "seen": 4,
    "wheel_seen": 2,  # steering angle as a design knows it, now and at the last sample
    "estimate": 4,  # the Kalman filter's
    "rate_seen": 1,  # the lane's yaw rate at the last sample
    "side": 1,
    "car": 9,
    "filter": FILTER,
}
(
    X, N, SIGNED, LAST, TARGET, Z, COUNTED, ALIVE, FLAG, S, DIVERGED, FAILED, ENTRIES, WHEEL, NEXT_CUT, SINGLE, LANE,
    V_C_0, V_DC, LIMITS, PAST, RECORDED, T_0, T, STOP, ENDS, NUMBER, KEPT, ROAD, POLYNOMIAL, BEFORE, OF_LAW, WEIGHTS, V,
    PER_T, OF_A, STEP, TIMES, MOTION, WAY, CURVE_BIAS, WAVE, USED, PARTS, H, SPAN, NOW, DUE, POINTS, SEGMENT, DRIVEN,
    WORK, SLOPE, RAMP, FROM, LEFT, PARABOLA, BEGAN, SAVED, SEEN, WHEEL_SEEN, ESTIMATE, RATE_SEEN, OUTWARD, CAR,
    OF_FILTER, RINGS,
) = (LANES * sum(tuple(_SIZES.values())[:i]) for i in range(len(_SIZES) + 1))  # fmt: skip
"""`RINGS`: then come the rings, of a length that the run decides; see `kernel.lanes.rings`."""


# numbers of a run that hold for every scenario, see `setting_row`; yes is 1
(
    DT, OFFSET, AXLE, BOUND, WINDOW, PROFILE, SATURATING, SHAPE, DELTA_MAX, RATE_MAX, LAG, DELAY_SAMPLES,
    DELAY_PART, MODES, EARLIER, CAMERA, PERIOD, LATE, NOISE_Y, NOISE_PSI, BIAS_Y, BIAS_PSI, STEP_Y, STEP_PSI,
    CURVATURE_GAIN, SEED_LOW, SEED_HIGH, FILTERED, KNOWN_DELAY, KNOWN_AGE, COMMANDS, FRAMES, RING, WIDTH,
) = range(34)  # fmt: skip


def setting_row(setup: Setup, plant: Plant, *, modes: int, bound: float, window: float) -> FloatArray:
    """The numbers of a run that hold for every scenario; `plant` is what a design knows."""
    actuator, sensors, dt = setup.options.actuator, setup.options.sensors, setup.dt
    whole = math.floor(actuator.delay / dt + 1e-9)
    part = actuator.delay - whole * dt
    known = math.floor(plant.delay / dt + 1e-9)
    period, late = sensors.period or dt, sensors.delay
    values = {
        DT: dt,
        OFFSET: setup.vehicle.edge_offset,  # [m] e_y with the edge on the line
        AXLE: setup.vehicle.l_f,  # [m]
        BOUND: bound,  # [m] |e_y| that counts as diverged
        WINDOW: whole_multiple(window, dt) / dt,  # samples in the moving average of the jerk
        PROFILE: setup.options.speed == "profile",  # v(t) instead of the trigger's speed
        SATURATING: not setup.options.tyres.ideal,  # tyres
        SHAPE: setup.options.tyres.shape,  # of the tyres
        DELTA_MAX: math.inf if actuator.delta_max is None else actuator.delta_max,  # infinite for none
        RATE_MAX: math.inf if actuator.rate_max is None else actuator.rate_max,  # infinite for none
        LAG: actuator.lag,
        DELAY_SAMPLES: whole,
        DELAY_PART: part if part > 1e-9 * dt else 0.0,  # [s] what remains of the delay after whole samples
        MODES: modes,  # columns of the speed residual
        EARLIER: math.ceil(late / period - 1e-9),  # frames before the trigger
        CAMERA: not sensors.ideal,  # the law sees frames, not the state
        PERIOD: period,  # [s] between frames
        LATE: late,  # [s] until a frame arrives
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
        KNOWN_DELAY: known,  # whole samples of delay that a design knows
        KNOWN_AGE: plant.age,  # [s] of the camera's
        # length of the rings of commands and of wheel angles
        COMMANDS: max(whole, known, math.ceil(plant.age / dt)) + 3,
        FRAMES: 0 if sensors.ideal else math.ceil((late + period) / dt) + 2,  # length of the ring of frames
        # length of the ring of lateral accelerations, a power of two
        RING: 2 ** math.ceil(math.log2(math.ceil(window / dt) + 3)),
        WIDTH: LANES,  # unknown to the compiler, which would unroll a short loop over the lanes instead
    }
    return np.array([values[n] for n in range(len(values))], dtype=np.float64)
