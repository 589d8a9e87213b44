"""What the compiled loops read and write: tuples of arrays, one row a scenario, that numba takes as they are.

The m triggered scenarios come in the takeover's order. No module that is imported here needs the compiler.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# columns of `State.score`
AREA: Final = 0  # integral of |e_y| up to T
DEEP: Final = 1  # max of e_y up to T
FRONT: Final = 2  # max of e_y + l_f e_psi up to T
BACK: Final = 3  # time of the first crossing back inside
OVER: Final = 4  # max of -e_y
A_Y: Final = 5
JERK: Final = 6
DELTA: Final = 7
RATE: Final = 8
EFFORT: Final = 9
TRAVEL: Final = 10
SCORES: Final = 11

# columns of `Scene.linear`: the rows of e_y'' and e_psi'' in the linear model, and their weights of delta and psi_l'
A_11, A_12, A_13, A_31, A_32, A_33, B_1, B_3, E_1, E_3 = range(10)

# columns of `Scene.vehicle`
C_AF, C_AR, L_F, L_R, MASS, I_Z, MU, PRINTED = range(8)


class Scene(NamedTuple):
    """The scenarios: m rows, constant over a run."""

    start: FloatArray  # (m,) [s] trigger
    T: FloatArray  # (m,) [s]
    full: IntArray  # (m,) whole steps from the trigger to T
    rest: FloatArray  # (m,) [s] what remains of T after them
    steps: IntArray  # (m,) steps to the end of the settling horizon, a last shorter one included
    side: FloatArray  # (m,) +1 left, -1 right
    index: IntArray  # (m,) identity, for random draws
    v: FloatArray  # (m,) [m/s] speed at the trigger
    v_mean: FloatArray  # (m,) [m/s]
    a_mean: FloatArray  # (m,) [m/s^2]
    c_0: FloatArray  # (m,) [1/m]
    dc: FloatArray  # (m,) [1/m]
    modes_v: FloatArray  # (m, J) [m/s] cosine amplitudes of the speed residual
    linear: FloatArray  # (m, 10)
    vehicle: FloatArray  # (m, 8) true parameters
    fastest: FloatArray  # (m,) [1/s] fastest mode times speed, for the number of substeps
    x_0: FloatArray  # (m, 4)
    delta_0: FloatArray  # (m,) [rad]
    a_before: FloatArray  # (m,) [m/s^2] lateral acceleration with x_0 and delta_0


class Setting(NamedTuple):
    """Numbers of the run that hold for every scenario."""

    dt: float
    offset: float  # [m] e_y with the edge on the line
    l_f: float  # [m]
    bound: float  # [m] |e_y| that counts as diverged
    window: float  # samples in the moving average of the jerk
    profile: bool  # v(t) instead of the trigger's speed
    saturating: bool  # tyres
    shape: float  # of the tyres
    delta_max: float  # infinite for none
    rate_max: float  # infinite for none
    lag: float
    delay_samples: int
    delay_part: float  # [s] what remains of the delay after whole samples


class Camera(NamedTuple):
    """What the law sees instead of the state and the lane."""

    ideal: bool
    period: int  # samples
    delay: int  # samples
    noise: FloatArray  # (2,) of e_y, e_psi
    bias: FloatArray  # (2,) in the road's frame
    step: FloatArray  # (2,) of quantisation
    earlier: FloatArray  # (m, frames, 2) what frame -1, -2, ... saw of the recorded path
    curvature_gain: float
    curvature_bias: FloatArray  # (m,) outward
    seed: int
    filtered: bool
    gain: FloatArray  # (m, 4, 2) of the Kalman filter
    A: FloatArray  # (m, 4, 4) its model, one step
    B: FloatArray  # (m, 4)
    E_0: FloatArray  # (m, 4)
    E_1: FloatArray  # (m, 4)


class Law(NamedTuple):
    """A linear law of m scenarios and p lookahead times."""

    F: FloatArray  # (m, 4)
    times: FloatArray  # (p,)
    G_yaw_rate: FloatArray  # (m, p)
    G_heading: FloatArray  # (m, p)
    f_u: FloatArray  # (m,)


class State(NamedTuple):
    """Everything that changes along a run, one row a scenario."""

    x: FloatArray  # (m, 4)
    wheel: FloatArray  # (m,) steering angle
    command: FloatArray  # (m,) last command
    commands: FloatArray  # (m, delay + 2) ring of limited commands
    frames: FloatArray  # (m, frames, 2) ring of what the camera saw at samples
    estimate: FloatArray  # (m, 4) of the Kalman filter
    a_left: FloatArray  # (m, ring) lateral acceleration just before each sample
    a_right: FloatArray  # (m, ring) just after it
    score: FloatArray  # (m, SCORES)
    alive: npt.NDArray[np.bool_]  # (m,) neither ended nor diverged
    diverged: npt.NDArray[np.bool_]  # (m,)
    failed: IntArray  # (m,) commands that were not finite, or came from a fallback


class Paths(NamedTuple):
    """Paths of chosen scenarios; `slot` says where, or -1."""

    slot: IntArray  # (m,)
    count: IntArray  # (c,) entries so far
    t: FloatArray  # (c, k)
    x: FloatArray  # (c, k, 4)
    delta: FloatArray  # (c, k)


class Exact(NamedTuple):
    """The ideal plant over one whole step; see `ldctoolkit.vehicle.Discretization`."""

    A: FloatArray  # (m, 4, 4)
    B: FloatArray  # (m, 4)
    E_0: FloatArray
    E_1: FloatArray
    area_x: FloatArray  # (m, 4)
    area_delta: FloatArray  # (m,)
    area_r_0: FloatArray
    area_r_1: FloatArray


class Designs(NamedTuple):
    """d linear laws of the same m scenarios."""

    F: FloatArray  # (d, m, 4)
    times: FloatArray  # (d, p)
    G_yaw_rate: FloatArray  # (d, m, p)
    G_heading: FloatArray  # (d, m, p)
    f_u: FloatArray  # (d, m)
