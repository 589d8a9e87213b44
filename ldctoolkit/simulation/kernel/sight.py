"""How a law sees the lane and the state: camera, frames and Kalman filter."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.numba_internals import LARGEST_FLOAT, OPTIONS, copy, fma
from ldctoolkit.paths.kernels import normal_pair
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.kernel.block_table import SAME, L, rings
from ldctoolkit.simulation.kernel.road import along

_CAMERA: Final = 4  # stream of random numbers; see `ldctoolkit.paths.uncorrected`
_FRAME_ZERO: Final = 1 << 20  # counter of the frame at the trigger: earlier ones have numbers too


@numba.njit(**OPTIONS)
def frame_of(setting, k):
    """The latest frame that has arrived at sample k; frame 0 is that of the trigger."""
    return math.floor((k * setting[data.DT] - setting[data.CAMERA_DELAY]) / setting[data.PERIOD] + SAME)


@numba.njit(**OPTIONS)
def preview_lane(setting, k, w, times, preview, to):
    """The lane at sample k, from `to` on: yaw rate at the filter's time; it and turn at each lookahead time."""
    gain, width = 1.0 + setting[data.CURVATURE_GAIN], int(setting[data.WIDTH])
    for j in range(0 if setting[data.FILTERED] > 0.0 else 1, times.shape[0] + 2):
        # the time of the filter's state, now, and then the lookahead times
        late = -setting[data.KNOWN_AGE] if j == 0 else (times[j - 2] if j > 1 else 0.0)
        for l in range(width):
            w[data.TIME + l] = w[data.T_0 + l] + k * setting[data.DT] + late
        along(setting, w, True)
        if j == 1:
            copy(w, data.WAY_NOW, w, data.MOTION_WAY, 2)
            continue
        for l in range(width):
            curve = fma(w[data.CURVATURE_RATE + l], min(w[data.TIME + l], w[data.T + l]), w[data.CURVATURE_0 + l])
            way, turn = w[data.MOTION_WAY + l] - w[data.WAY_NOW + l], w[data.MOTION_TURN + l] - w[data.TURN_NOW + l]
            w[data.MOTION_V + l] *= fma(gain, curve, w[data.CURVE_BIAS + l])
            w[data.MOTION_DV + l] = fma(gain, turn, w[data.CURVE_BIAS + l] * way)
        if j == 0:
            copy(preview, to, w, data.MOTION_V, 1)
        else:
            copy(preview, to + (2 * j - 3) * L, w, data.MOTION_V, 2)


@numba.njit(**OPTIONS)
def noise_of(setting, k, w, noise, to):
    """Standard normal numbers of the frame that the law sees at sample k, from `to` on."""
    if setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[data.SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[data.SEED_LOW])
        frame = np.uint64(_FRAME_ZERO + frame_of(setting, k))
        for l in range(L):
            noise[to + l], noise[to + L + l] = normal_pair(seed, np.uint64(w[data.SCENARIO + l]), _CAMERA, frame)


@numba.njit(**OPTIONS)
def _first_after(setting, k):
    """First sample that may see a frame taken at sample k or after."""
    return k + math.floor(setting[data.CAMERA_DELAY] / setting[data.DT] + SAME)


@numba.njit(**OPTIONS)
def _take_frames(setting, k, w):
    """Frames that are taken at sample k itself: e_y and e_psi."""
    frames, _, _, _ = rings(setting)
    size, j = int(setting[data.FRAME_RING]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[data.PERIOD] / setting[data.DT] - k
        if late > SAME:
            return
        if late >= -SAME:
            frame = frames + 2 * (j % size) * L
            for l in range(L):
                w[frame + l], w[frame + L + l] = w[data.E_Y + l], w[data.E_PSI + l]
        j += 1


@numba.njit(**OPTIONS)
def take_between(setting, k, w):
    """Frames that are taken within a piece: on the cubics through its ends."""
    frames, _, _, _ = rings(setting)
    size, j = int(setting[data.FRAME_RING]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[data.PERIOD] - k * setting[data.DT]
        if late >= setting[data.DT] * (1.0 - SAME):
            return
        if late > setting[data.DT] * SAME:
            for l in range(L):
                h = w[data.PIECE_TIME + l]
                s = w[data.T_0 + l] + k * setting[data.DT] + late - w[data.PIECE_START + l]
                if 0.0 <= s <= h and w[data.PIECE_ENDS + l] > 0.0:
                    u, frame = s / h, frames + 2 * (j % size) * L + l
                    a, b = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u)
                    for n in range(2):
                        row = 2 * n * L + l
                        x, m = w[data.E_Y + row], (1.0 - u) * w[data.E_Y_RATE + row] - u * w[data.NEXT_E_Y_RATE + row]
                        w[frame + n * L] = x + a * (w[data.NEXT_E_Y + row] - x) + b * m
        j += 1


@numba.njit(forceinline=True, **OPTIONS)
def _predict(w, n, width):
    """Predict the n-th state: x+ = A x + B delta_young + B_old delta_old + W wheel + E_0 r + E_1 r+.

    x and r+ stand in the rows from `POINTS` on, both commands in `WORK_2` and `WORK_3`.
    """
    row, from_state = data.FILTER_ROWS + n * L, data.FILTER_ROWS + (data.MODEL_A + 4 * n) * L
    for l in range(width):
        value = w[row + data.MODEL_B * L + l] * w[data.WORK_2 + l]
        value = fma(w[row + data.MODEL_E_0 * L + l], w[data.LANE_RATE_SEEN + l], value)
        value = fma(w[row + data.MODEL_OLD * L + l], w[data.WORK_3 + l], value)
        value = fma(w[row + data.MODEL_WHEEL * L + l], w[data.WHEEL_SEEN_BEFORE + l], value)
        value = fma(w[row + data.MODEL_E_1 * L + l], w[data.POINTS + l], value)
        z_0, z_1 = w[data.POINTS + L + l], w[data.POINTS + 2 * L + l]
        value = fma(w[from_state + l], z_0, fma(w[from_state + L + l], z_1, value))
        z_2, z_3 = w[data.POINTS + 3 * L + l], w[data.POINTS + 4 * L + l]
        w[data.ESTIMATE + n * L + l] = fma(w[from_state + 2 * L + l], z_2, fma(w[from_state + 3 * L + l], z_3, value))


@numba.njit(forceinline=True, **OPTIONS)
def _correct(w, n, width):
    """Correct it by K times the innovations of e_y and e_psi, in `WORK_0` and `WORK_1`."""
    row = data.FILTER_ROWS + (data.GAIN + 2 * n) * L
    for l in range(width):
        value = w[row + l] * w[data.WORK_0 + l] + w[row + L + l] * w[data.WORK_1 + l]
        w[data.ESTIMATE + n * L + l] += value


@numba.njit(**OPTIONS)
def see(setting, w, k, preview, preview_offset, noise, noise_offset):
    """The state as the law sees it at sample k; each sample once and in order.

    The camera gives e_y and e_psi of the latest frame that has arrived, q round((y + bias + noise)/q) each; the filter
    predicts with every sample and corrects with every new frame.
    """
    ring, age, width = (
        int(setting[data.COMMAND_RING]),
        setting[data.KNOWN_AGE] / setting[data.DT],
        int(setting[data.WIDTH]),
    )
    wheels, newer = data.RINGS + ring * L, k - math.floor(age + SAME)
    share = max(age - math.floor(age + SAME), 0.0)
    copy(w, wheels + (k % ring) * L, w, data.WHEEL, 1)
    copy(w, data.WHEEL_SEEN_BEFORE, w, data.WHEEL_SEEN, 1)
    copy(w, data.WORK_0, w, wheels + (newer % ring) * L, 1)
    copy(w, data.WORK_1, w, wheels + ((newer - 1) % ring) * L, 1)
    for l in range(width):
        w[data.WHEEL_SEEN + l] = w[data.WORK_0 + l] + share * (w[data.WORK_1 + l] - w[data.WORK_0 + l])
    copy(w, data.SEEN_E_Y, w, data.E_Y, 4)
    if setting[data.CAMERA] == 0.0:
        return
    _take_frames(setting, k, w)
    frames, _, _, _ = rings(setting)
    draws, lane = data.WORK_2, data.POINTS  # what is worked on together lies in one array
    copy(w, data.WORK_0, w, frames + 2 * (k % int(setting[data.FRAME_RING])) * L, 2)
    if setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0:
        copy(w, draws, noise, noise_offset, 2)
    else:
        for n in range(2 * L):
            w[draws + n] = 0.0
    for n in range(2):
        spread, bias, step = setting[data.NOISE_Y + n], setting[data.BIAS_Y + n], setting[data.STEP_Y + n]
        for l in range(width):
            w[data.WORK_0 + l] += fma(w[data.OUTWARD + l], bias, spread * w[draws + l])
        if step > 0.0:
            for l in range(L):
                w[data.WORK_0 + l] = step * np.rint(w[data.WORK_0 + l] / step)
        copy(w, data.SEEN_E_Y + 2 * n * L, w, data.WORK_0, 1)
        copy(w, data.WORK_0, w, data.WORK_1, 1)
        copy(w, draws, w, draws + L, 1)
    if setting[data.FILTERED] == 0.0:
        return
    young = data.RINGS + ((k - 1 - int(setting[data.KNOWN_DELAY])) % ring) * L
    old = data.RINGS + ((k - 2 - int(setting[data.KNOWN_DELAY])) % ring) * L
    copy(w, lane, preview, preview_offset, 1)
    if k > 0:
        copy(w, draws, w, young, 1)
        copy(w, draws + L, w, old, 1)
        copy(w, data.POINTS + L, w, data.ESTIMATE, 4)
        _predict(w, 0, width)
        _predict(w, 1, width)
        _predict(w, 2, width)
        _predict(w, 3, width)
    if k == 0 or frame_of(setting, k) != frame_of(setting, k - 1):
        for l in range(width):
            w[data.WORK_0 + l] = w[data.SEEN_E_Y + l] - w[data.ESTIMATE + l]
            w[data.WORK_1 + l] = w[data.SEEN_E_PSI + l] - w[data.ESTIMATE + 2 * L + l]
        _correct(w, 0, width)
        _correct(w, 1, width)
        _correct(w, 2, width)
        _correct(w, 3, width)
    copy(w, data.LANE_RATE_SEEN, w, lane, 1)
    copy(w, data.SEEN_E_Y, w, data.ESTIMATE, 4)


@numba.njit(**OPTIONS)
def command(setting, w, k, lane_weights, preview, preview_offset, lookaheads, past):
    """Command of a linear law, as in `exact_loop`, into `COMMAND`; once a sample, since it integrates e_y."""
    width = int(setting[data.WIDTH])
    for l in range(width):
        w[data.COMMAND + l] = w[data.F_I + l] * w[data.E_Y_INTEGRAL + l]
        stops = w[data.F_CONDITIONED + l] * w[data.YIELDING + l] > 0.0
        w[data.E_Y_INTEGRAL + l] = fma(
            0.0 if stops else setting[data.DT], w[data.SEEN_E_Y + l], w[data.E_Y_INTEGRAL + l]
        )
    for j in range(2 * lookaheads + past):
        copy(w, data.WORK_0, lane_weights, j * L, 1)
        if j < 2 * lookaheads:
            copy(w, data.WORK_1, preview, preview_offset + (1 + j) * L, 1)
        else:
            copy(
                w, data.WORK_1, w, data.RINGS + ((k - 2 - j + 2 * lookaheads) % int(setting[data.COMMAND_RING])) * L, 1
            )
        for l in range(width):
            w[data.COMMAND + l] = fma(w[data.WORK_0 + l], w[data.WORK_1 + l], w[data.COMMAND + l])
    for l in range(width):
        value = fma(w[data.F_U + l], w[data.LAST_COMMAND + l], w[data.COMMAND + l])
        value = fma(
            w[data.F_E_Y + l], w[data.SEEN_E_Y + l], fma(w[data.F_E_Y_RATE + l], w[data.SEEN_E_Y_RATE + l], value)
        )
        value = fma(w[data.F_E_PSI + l], w[data.SEEN_E_PSI + l], value)
        value = fma(w[data.F_E_PSI_RATE + l], w[data.SEEN_E_PSI_RATE + l], value)
        value = fma(w[data.F_WHEEL + l], w[data.WHEEL_SEEN + l], value)
        wrong = not abs(value) < LARGEST_FLOAT
        alive, last = w[data.ALIVE + l], w[data.LAST_COMMAND + l]
        w[data.FAILED + l] += alive if wrong else 0.0
        w[data.COMMAND + l] = last if wrong else value
