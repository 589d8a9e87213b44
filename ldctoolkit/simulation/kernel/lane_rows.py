"""The table of a block of eight scenarios side by side, for the loop that drives any plant: its rows, its start.

All of it is one array with fixed distances, so that the compiler sees that rows do not overlap and works on the lanes
of a row together. The name of a row is the place of its first number.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba

from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.plant import OPTIONS
from ldctoolkit.vehicle.parameters import GRAVITY

L: Final = data.LANES

_SIZES: Final = {
    "x": 4,  # state at the start of a substep
    "y": 4,  # after a substep
    "k": 4,  # slopes of a stage
    "sum": 5,  # their weighted sum, and that of e_y
    "a_y": 1,
    "point": 5,  # at a stage: v, its rate, 1/v, the lane's yaw rate, the steering angle
    "substeps": 1,
    "h": 1,  # length of a substep
    "length": 1,  # of a segment
    "part": 1,  # of a substep of it
    "now": 1,  # time since the departure's start
    "counted": 1,  # 1 before T
    "target": 1,  # of the steering angle
    "slope": 1,  # of its ramp
    "ramp": 1,  # how long that lasts
    "from": 1,  # steering angle at the segment's start
    "wheel": 1,  # at present, or at the segment's end
    "command": 1,
    "parabola": 3,  # steering angle at the start, the middle and the end of a substep
    "z": 1,  # integral of e_y as the law sees it
    "seen": 4,
    "estimate": 4,  # the Kalman filter's
    "rate_seen": 1,  # the lane's yaw rate at the last sample
    "alive": 1,
    "diverged": 1,
    "failed": 1,
    "entries": 1,  # of the path so far
    "area": 1,  # integral of |e_y| over a substep
    "flag": 1,
    "score": data.SCORES,
    "saved": data.SCORES,
    "limits": 2,  # of a_y, at the start and the end of a sample
    "past": 2,  # what they were a window earlier
    "began": 2,  # time and steering angle at the start of a segment, of a sample
    # the scenario
    "start": 1,
    "T": 1,
    "before": 1,
    "side": 1,
    "car": 9,
    "law": 6,
    "filter": data.FILTER,
}
(
    X, Y, K, SUM, A, POINT, N, H, LENGTH, PART, NOW, COUNTED, TARGET, SLOPE, RAMP, FROM, WHEEL, COMMAND, PARABOLA, Z,
    SEEN, ESTIMATE, RATE_SEEN, ALIVE, DIVERGED, FAILED, ENTRIES, STEP_AREA, FLAG, S, SAVED, LIMITS, PAST, BEGAN, T_0, T,
    BEFORE, OUTWARD, CAR, OF_LAW, OF_FILTER, RINGS,
) = (L * sum(tuple(_SIZES.values())[:i]) for i in range(len(_SIZES) + 1))  # fmt: skip

SAME: Final = 1e-9
"""Parts of a sample that are rounding."""


@numba.njit(**OPTIONS)
def rings(setting):
    """First rows of the rings of commands, of frames, and of a_y just after and just before each sample; the end."""
    frames = RINGS + L * int(setting[data.COMMANDS])
    right = frames + 2 * L * int(setting[data.FRAMES])
    left = right + L * int(setting[data.RING])
    return frames, right, left, left + L * int(setting[data.RING])


@numba.njit(**OPTIONS)
def frame_of(setting, k):
    """The latest frame that has arrived at sample k; frame 0 is that of the trigger."""
    return math.floor((k * setting[data.DT] - setting[data.LATE]) / setting[data.PERIOD] + SAME)


@numba.njit(**OPTIONS)
def load(scene, setting, block, w):
    """Scenario data of a block; lanes beyond the last scenario repeat it and are never alive."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        w[T_0 + l], w[T + l] = scene[i, data.START], scene[i, data.T_END]
        w[OUTWARD + l], w[N + l] = scene[i, data.SIDE], scene[i, data.SUBSTEPS]
        mass, I_z, l_f, l_r = scene[i, data.MASS], scene[i, data.I_Z], scene[i, data.L_F], scene[i, data.L_R]
        # forces over the mass: of an axle per slip angle, or its largest; lever arms over the yaw inertia, times mass
        front, rear = 2.0 * scene[i, data.C_AF] / mass, 2.0 * scene[i, data.C_AR] / mass
        w[CAR + l], w[CAR + L + l] = front, rear
        w[CAR + 2 * L + l], w[CAR + 3 * L + l] = l_f, l_r
        w[CAR + 4 * L + l], w[CAR + 5 * L + l] = l_f * mass / I_z, l_r * mass / I_z
        w[CAR + 6 * L + l] = scene[i, data.PRINTED]
        if setting[data.SATURATING] > 0.0:
            grip = scene[i, data.MU] * GRAVITY / (l_f + l_r)
            w[CAR + 7 * L + l], w[CAR + 8 * L + l] = grip * l_r, grip * l_f
            w[CAR + l] = front / (setting[data.SHAPE] * grip * l_r)
            w[CAR + L + l] = rear / (setting[data.SHAPE] * grip * l_f)
        if setting[data.FILTERED] > 0.0:
            model = data.SCENE + int(setting[data.MODES]) + 2 * int(setting[data.EARLIER])
            for n in range(data.FILTER):
                w[OF_FILTER + n * L + l] = scene[i, model + n]


@numba.njit(**OPTIONS)
def begin(scene, setting, block, w):
    """Start of a block."""
    frames, _, _, end = rings(setting)
    for n in range(X, T_0):
        if not N <= n < N + L:
            w[n] = 0.0
    for n in range(RINGS, end):
        w[n] = 0.0
    size, earlier = int(setting[data.FRAMES]), data.SCENE + int(setting[data.MODES])
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        alive = block * L + l < scene.shape[0] and scene[i, data.STEPS] > 0.0
        w[ALIVE + l] = 1.0 if alive else 0.0
        for n in range(4):
            w[X + n * L + l] = w[ESTIMATE + n * L + l] = scene[i, data.X_0 + n] if alive else 0.0
        for n in range(int(setting[data.COMMANDS])):
            w[RINGS + n * L + l] = scene[i, data.DELTA_0]
        w[WHEEL + l] = w[COMMAND + l] = scene[i, data.DELTA_0]
        w[S + data.DEEP * L + l] = scene[i, data.X_0]
        w[S + data.FRONT * L + l] = scene[i, data.X_0] + setting[data.AXLE] * scene[i, data.X_0 + 2]
        w[S + data.BACK * L + l] = math.inf
        w[S + data.OVER * L + l] = -scene[i, data.X_0]
        if setting[data.CAMERA] > 0.0:
            k = 0
            while frame_of(setting, k) < 0:
                at = earlier + 2 * (-frame_of(setting, k) - 1)
                for n in range(2):
                    w[frames + (2 * (k % size) + n) * L + l] = scene[i, at + n]
                k += 1


@numba.njit(**OPTIONS)
def take_law(law, block, w, g):
    """A linear law (m, columns) in lanes; weights of the lane ahead into `g`."""
    for l in range(L):
        i = min(block * L + l, law.shape[0] - 1)
        for n in range(data.LAW):
            w[OF_LAW + n * L + l] = law[i, n]
        for j in range(law.shape[1] - data.LAW):
            g[j * L + l] = law[i, data.LAW + j]


@numba.njit(**OPTIONS)
def record(paths, place, w, l, t):
    """Put the present state into the path of a chosen scenario."""
    n = int(w[ENTRIES + l])
    paths[place, n, data.P_TIME] = t
    for j in range(4):
        paths[place, n, data.P_X + j] = w[X + j * L + l]
    paths[place, n, data.P_DELTA] = w[WHEEL + l]
    w[ENTRIES + l] = n + 1
