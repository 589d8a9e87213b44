"""The road that a block of scenarios drives along, and what a law sees of it and of the state."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.simulation._philox import normal_pair
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.lane_rows import (
    ALIVE,
    COMMAND,
    ESTIMATE,
    FAILED,
    NOW,
    OF_FILTER,
    OF_LAW,
    OUTWARD,
    RATE_SEEN,
    SAME,
    SEEN,
    T_0,
    TARGET,
    H,
    L,
    N,
    X,
    Y,
    Z,
    frame_of,
    rings,
)
from ldctoolkit.simulation.kernel.plant import OPTIONS, curvature, lane_ahead, length_of, speed

# a segment of the road: its length, whether it is before T and after the delay, then three points a substep
HEADER: Final = 3 * L
POINT_SIZE: Final = 4 * L

_CAMERA: Final = 4
"""Stream of random numbers; see `ldctoolkit.simulation.random_streams`."""

_FRAME_ZERO: Final = 1 << 20
"""Counter of the frame at the trigger: earlier ones have numbers too."""


@numba.njit(**OPTIONS)
def substeps_of(scene, block):
    """Most substeps that a scenario of a block needs for a segment."""
    most = 1
    for i in range(block * L, min((block + 1) * L, scene.shape[0])):
        most = max(most, int(scene[i, data.SUBSTEPS]))
    return most


@numba.njit(**OPTIONS)
def segment_size(parts):
    """Numbers of a segment with so many substeps."""
    return HEADER + 3 * parts * POINT_SIZE


@numba.njit(**OPTIONS)
def lay_road(scene, setting, block, k, w, parts, road, at):
    """Segments of sample k and the road along their substeps, from `at` on; where they end."""
    dt, switch, cut = setting[data.DT], setting[data.DELAY_PART], False
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        h, until = length_of(scene, setting, i, k)
        cut |= 0.0 < until < h
    segments = 1 + int(cut) + int(switch > 0.0)
    for n in range(segments):
        for l in range(L):
            i = min(block * L + l, scene.shape[0] - 1)
            h, until = length_of(scene, setting, i, k)
            inside = until if 0.0 < until < h else h
            low, high = (min(inside, switch), max(inside, switch)) if segments == 3 else (inside, h)
            if segments == 2 and not cut:
                low = switch
            first = 0.0 if n == 0 else min(low if n == 1 else high, h)
            last = h if n + 1 == segments else min(low if n == 0 else high, h)
            length = last - first
            counted = last <= until and until > 0.0
            road[at + l] = length
            road[at + L + l] = 1.0 if counted else 0.0
            road[at + 2 * L + l] = 1.0 if first >= switch else 0.0
            t, own = scene[i, data.START] + k * dt + first, w[N + l]
            for j in range(parts):
                for point in range(3):
                    to = at + HEADER + (3 * j + point) * POINT_SIZE + l
                    if j > 0 and point == 0:  # where the substep before ended
                        for row in range(4):
                            road[to + row * L] = road[to + row * L - POINT_SIZE]
                        continue
                    s = t + length * min((j + 0.5 * point) / own, 1.0)
                    v, dv = speed(scene, setting, i, s)
                    road[to] = v
                    road[to + L] = dv if counted else 0.0  # beyond T the speed stays
                    road[to + 2 * L] = 1.0 / v
                    road[to + 3 * L] = v * curvature(scene, i, s)
        at += segment_size(parts)
    return at


@numba.njit(**OPTIONS)
def look_ahead(scene, setting, block, k, times, ahead, at):
    """The lane as the law sees it at sample k, from `at` on: yaw rate now; yaw rate and turn at each lookahead time."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        t = scene[i, data.START] + k * setting[data.DT]
        if setting[data.FILTERED] > 0.0:
            ahead[at + l], _ = lane_ahead(scene, setting, i, t, 0.0)
        for j in range(times.shape[0]):
            rate, turn = lane_ahead(scene, setting, i, t, times[j])
            ahead[at + (1 + 2 * j) * L + l], ahead[at + (2 + 2 * j) * L + l] = rate, turn


@numba.njit(**OPTIONS)
def noise_of(scene, setting, block, k, noise, at):
    """Standard normal numbers of the frame that the law sees at sample k, from `at` on."""
    if setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[data.SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[data.SEED_LOW])
        frame = np.uint64(_FRAME_ZERO + frame_of(setting, k))
        for l in range(L):
            i = min(block * L + l, scene.shape[0] - 1)
            noise[at + l], noise[at + L + l] = normal_pair(seed, np.uint64(scene[i, data.INDEX]), _CAMERA, frame)


@numba.njit(**OPTIONS)
def _first_after(setting, k):
    """First sample that may see a frame taken at sample k or after."""
    return k + math.floor(setting[data.LATE] / setting[data.DT] + SAME)


@numba.njit(**OPTIONS)
def _take_frames(setting, k, w):
    """Frames that are taken at sample k itself."""
    frames, _, _, _ = rings(setting)
    size, j = int(setting[data.FRAMES]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[data.PERIOD] / setting[data.DT] - k
        if late > SAME:
            return
        if late >= -SAME:
            for l in range(L):
                w[frames + 2 * (j % size) * L + l] = w[X + l]
                w[frames + (2 * (j % size) + 1) * L + l] = w[X + 2 * L + l]
        j += 1


@numba.njit(**OPTIONS)
def take_between(setting, k, w):
    """Frames that are taken within a substep: on the cubics through its ends."""
    frames, _, _, _ = rings(setting)
    size, j = int(setting[data.FRAMES]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[data.PERIOD] - k * setting[data.DT]
        if late >= setting[data.DT] * (1.0 - SAME):
            return
        if late > setting[data.DT] * SAME:
            for l in range(L):
                h = w[H + l]
                s = w[T_0 + l] + k * setting[data.DT] + late - w[NOW + l]
                if 0.0 <= s <= h and h > 0.0:
                    u = s / h
                    a, b = u * u * (3.0 - 2.0 * u), u * (1.0 - u)
                    for n in range(2):
                        x_0, x_1 = w[X + 2 * n * L + l], w[X + (2 * n + 1) * L + l]
                        n_0, n_1 = w[Y + 2 * n * L + l], w[Y + (2 * n + 1) * L + l]
                        between = x_0 + a * (n_0 - x_0) + h * b * ((1.0 - u) * x_1 - u * n_1)
                        w[frames + (2 * (j % size) + n) * L + l] = between
        j += 1


@numba.njit(**OPTIONS)
def see(setting, w, k, ahead, now, noise, at):
    """What the law sees of the state at sample k; each sample once and in order."""
    for n in range(4 * L):
        w[SEEN + n] = w[X + n]
    if setting[data.CAMERA] == 0.0:
        return
    _take_frames(setting, k, w)
    frames, _, _, _ = rings(setting)
    frame, noisy = (
        frames + 2 * (k % int(setting[data.FRAMES])) * L,
        setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0,
    )
    for n in range(2):
        spread, bias, step = setting[data.NOISE_Y + n], setting[data.BIAS_Y + n], setting[data.STEP_Y + n]
        for l in range(L):
            value = w[frame + n * L + l] + w[OUTWARD + l] * bias
            if noisy:
                value += spread * noise[at + n * L + l]
            w[SEEN + 2 * n * L + l] = step * np.rint(value / step) if step > 0.0 else value
    if setting[data.FILTERED] == 0.0:
        return
    fresh = k == 0 or frame_of(setting, k) != frame_of(setting, k - 1)
    for l in range(L):
        y, psi = w[SEEN + l], w[SEEN + 2 * L + l]
        if k > 0:
            z_0, z_1, z_2, z_3 = (
                w[ESTIMATE + l], w[ESTIMATE + L + l], w[ESTIMATE + 2 * L + l], w[ESTIMATE + 3 * L + l],
            )  # fmt: skip
            for n in range(4):
                value = w[OF_FILTER + (data.MODEL_B + n) * L + l] * w[COMMAND + l]
                value += w[OF_FILTER + (data.MODEL_E_0 + n) * L + l] * w[RATE_SEEN + l]
                value += w[OF_FILTER + (data.MODEL_E_1 + n) * L + l] * ahead[now + l]
                row = OF_FILTER + (data.MODEL_A + 4 * n) * L + l
                w[ESTIMATE + n * L + l] = value + (
                    w[row] * z_0 + w[row + L] * z_1 + (w[row + 2 * L] * z_2 + w[row + 3 * L] * z_3)
                )
        w[RATE_SEEN + l] = ahead[now + l]
        if fresh:
            a, b = y - w[ESTIMATE + l], psi - w[ESTIMATE + 2 * L + l]
            for n in range(4):
                row = OF_FILTER + (data.GAIN + 2 * n) * L + l
                w[ESTIMATE + n * L + l] += w[row] * a + w[row + L] * b
    for n in range(4 * L):
        w[SEEN + n] = w[ESTIMATE + n]


@numba.njit(**OPTIONS)
def command(setting, w, g, ahead, now, lookaheads):
    """Command of a linear law into `TARGET`; once a sample, for the integral of e_y goes on with it."""
    for l in range(L):
        value = w[OF_LAW + data.LAW_U * L + l] * w[COMMAND + l] + w[OF_LAW + data.LAW_I * L + l] * w[Z + l]
        w[Z + l] += setting[data.DT] * w[SEEN + l]
        for n in range(4):
            value += w[OF_LAW + (data.LAW_F + n) * L + l] * w[SEEN + n * L + l]
        w[TARGET + l] = value
    for j in range(2 * lookaheads):
        for l in range(L):
            w[TARGET + l] += g[j * L + l] * ahead[now + (1 + j) * L + l]
    for l in range(L):
        wrong = not abs(w[TARGET + l]) < math.inf
        w[FAILED + l] += w[ALIVE + l] if wrong else 0.0
        w[TARGET + l] = w[COMMAND + l] if wrong else w[TARGET + l]
