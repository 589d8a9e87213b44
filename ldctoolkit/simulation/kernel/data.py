"""What the compiled loops read and write: one row of numbers a scenario, and the numbers that all of them share.

A compiled function counts references to every array that it is handed in a tuple, which costs more than the step of a
plant: the scenarios are therefore one array, with the columns named here. The m triggered
scenarios come in the takeover's order. Nothing that is imported here needs the compiler.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.setup import Setup

LANES: Final = 8
"""Scenarios side by side, in the vector registers of the processor."""

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
SCENE: Final = 32
"""Then, in this order: amplitudes of the speed residual, frames before the trigger, the Kalman filter."""

# the filter's own columns: gain (4 x 2), A (4 x 4), B, E_0, E_1 (4 each)
GAIN, MODEL_A, MODEL_B, MODEL_E_0, MODEL_E_1, FILTER = 0, 8, 24, 28, 32, 36


def score_column(metric: str) -> int:
    """Row of a metric of a scenario among the scores: in the order of their table, behind the area."""
    return 1 + tuple(SCENARIO_METRICS).index(metric)


AREA: Final = 0  # integral of |e_y| up to T
DEEP: Final = score_column("deepest")  # max of e_y up to T
FRONT: Final = score_column("dtle")  # max of e_y + l_f e_psi up to T
BACK: Final = score_column("t_back")  # time of the first crossing back inside
OVER: Final = score_column("overshoot")  # max of -e_y
A_Y: Final = score_column("a_y_peak")
JERK: Final = score_column("jerk_peak")
DELTA: Final = score_column("delta_peak")
RATE: Final = score_column("delta_rate_peak")
EFFORT: Final = score_column("effort")
TRAVEL: Final = score_column("travel")
SCORES: Final = 1 + len(SCENARIO_METRICS)

# columns of a path's entry
P_TIME, P_X, P_DELTA, PATH = 0, 1, 5, 6

# columns of a linear law, then pairs of weights of yaw rate and heading for every lookahead time
LAW_F, LAW_U, LAW_I, LAW = 0, 4, 5, 6

# columns of the ideal plant over a step: A[:, 1:4], B, E_0, E_1 row by row, then the weights of the area
EX_B, EX_E_0, EX_E_1, EX_X, EX_DELTA, EX_R_0, EX_R_1, EXACT = 12, 16, 20, 24, 28, 29, 30, 31


# numbers of a run that hold for every scenario; yes is 1
SETTINGS: Final = (
    "dt",
    "offset",  # [m] e_y with the edge on the line
    "l_f",  # [m]
    "bound",  # [m] |e_y| that counts as diverged
    "window",  # samples in the moving average of the jerk
    "profile",  # v(t) instead of the trigger's speed
    "saturating",  # tyres
    "shape",  # of the tyres
    "delta_max",  # infinite for none
    "rate_max",  # infinite for none
    "lag",
    "delay_samples",
    "delay_part",  # [s] what remains of the delay after whole samples
    "modes",  # columns of the speed residual
    "earlier",  # frames before the trigger
    "camera",  # the law sees frames, not the state
    "period",  # [s] between frames
    "late",  # [s] until a frame arrives
    "noise_y",
    "noise_psi",
    "bias_y",  # in the road's frame
    "bias_psi",
    "step_y",  # of quantisation
    "step_psi",
    "curvature_gain",
    "seed_low",
    "seed_high",
    "filtered",
    "commands",  # length of the ring of commands
    "frames",  # length of the ring of frames
    "ring",  # length of the rings of lateral accelerations, a power of two
)
(
    DT,
    OFFSET,
    AXLE,
    BOUND,
    WINDOW,
    PROFILE,
    SATURATING,
    SHAPE,
    DELTA_MAX,
    RATE_MAX,
    LAG,
    DELAY_SAMPLES,
    DELAY_PART,
    MODES,
    EARLIER,
    CAMERA,
    PERIOD,
    LATE,
    NOISE_Y,
    NOISE_PSI,
    BIAS_Y,
    BIAS_PSI,
    STEP_Y,
    STEP_PSI,
    CURVATURE_GAIN,
    SEED_LOW,
    SEED_HIGH,
    FILTERED,
    COMMANDS,
    FRAMES,
    RING,
) = range(len(SETTINGS))


def setting_row(setup: Setup, *, modes: int, bound: float, window: float) -> npt.NDArray[np.float64]:
    """The numbers of a run that hold for every scenario, in the order of `SETTINGS`.

    Parameters
    ----------
    setup : Setup
    modes : int
        Columns of the speed residual.
    bound : float [m]
        |e_y| that counts as diverged.
    window : float [s]
        Of the moving average of the jerk.
    """
    actuator, sensors, dt = setup.options.actuator, setup.options.sensors, setup.dt
    whole = math.floor(actuator.delay / dt + 1e-9)
    part = actuator.delay - whole * dt
    period, late = sensors.period or dt, sensors.delay
    values = {
        "dt": dt,
        "offset": setup.vehicle.edge_offset,
        "l_f": setup.vehicle.l_f,
        "bound": bound,
        "window": window / dt,
        "profile": setup.options.speed == "profile",
        "saturating": not setup.options.tyres.ideal,
        "shape": setup.options.tyres.shape,
        "delta_max": math.inf if actuator.delta_max is None else actuator.delta_max,
        "rate_max": math.inf if actuator.rate_max is None else actuator.rate_max,
        "lag": actuator.lag,
        "delay_samples": whole,
        "delay_part": part if part > 1e-9 * dt else 0.0,
        "modes": modes,
        "earlier": math.ceil(late / period - 1e-9),
        "camera": not sensors.ideal,
        "period": period,
        "late": late,
        "noise_y": sensors.e_y_noise,
        "noise_psi": sensors.e_psi_noise,
        "bias_y": sensors.e_y_bias,
        "bias_psi": sensors.e_psi_bias,
        "step_y": sensors.e_y_step,
        "step_psi": sensors.e_psi_step,
        "curvature_gain": sensors.curvature_gain,
        "seed_low": setup.seed & 0xFFFFFFFF,
        "seed_high": setup.seed >> 32,
        "filtered": sensors.kalman is not None,
        "commands": whole + 2,
        "frames": 0 if sensors.ideal else math.ceil((late + period) / dt) + 2,
        "ring": 2 ** math.ceil(math.log2(math.ceil(window / dt) + 3)),
    }
    return np.array([values[name] for name in SETTINGS], dtype=np.float64)
