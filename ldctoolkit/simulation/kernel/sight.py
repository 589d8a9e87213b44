"""How a law sees the lane and the state: camera, frames and Kalman filter."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.lanes import fma, rint, select
from ldctoolkit.numba_internals import LARGEST_FLOAT, OPTIONS
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
    gain, bias, now = 1.0 + setting[data.CURVATURE_GAIN], w[data.CURVE_BIAS], w[data.T_0] + k * setting[data.DT]
    if setting[data.FILTERED] > 0.0:
        t = now - setting[data.KNOWN_AGE]
        v, _, _, _ = along(setting, w, t, False)
        preview[to] = v * fma(gain, fma(w[data.CURVATURE_RATE], min(t, w[data.T]), w[data.CURVATURE_0]), bias)
    _, _, way_now, turn_now = along(setting, w, now, True)
    for j in range(times.shape[0]):
        t = now + times[j]
        v, _, way, turn = along(setting, w, t, True)
        curve = fma(w[data.CURVATURE_RATE], min(t, w[data.T]), w[data.CURVATURE_0])
        preview[to + 1 + 2 * j] = v * fma(gain, curve, bias)
        preview[to + 2 + 2 * j] = fma(gain, turn - turn_now, bias * (way - way_now))


@numba.njit(**OPTIONS)
def noise_of(setting, k, w, noise, to):
    """Standard normal numbers of the frame that the law sees at sample k, from `to` on."""
    if setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[data.SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[data.SEED_LOW])
        frame = np.uint64(_FRAME_ZERO + frame_of(setting, k))
        for l in range(L):
            noise[to, l], noise[to + 1, l] = normal_pair(seed, np.uint64(w[data.SCENARIO, l]), _CAMERA, frame)


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
            frame = frames + 2 * (j % size)
            w[frame], w[frame + 1] = w[data.E_Y], w[data.E_PSI]
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
            h, frame = w[data.PIECE_TIME], frames + 2 * (j % size)
            s = w[data.T_0] + k * setting[data.DT] + late - w[data.PIECE_START]
            within = (s >= 0.0) & (s <= h) & (w[data.PIECE_ENDS] > 0.0)
            u = s / h
            a, b = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u)
            for n in range(2):
                x, following = w[data.E_Y + 2 * n], w[data.NEXT_E_Y + 2 * n]
                slope = (1.0 - u) * w[data.E_Y_RATE + 2 * n] - u * w[data.NEXT_E_Y_RATE + 2 * n]
                w[frame + n] = select(within, x + a * (following - x) + b * slope, w[frame + n])
        j += 1


@numba.njit(**OPTIONS)
def see(setting, w, k, preview, preview_row, noise, noise_row):
    """The state as the law sees it at sample k; each sample once and in order.

    The camera gives e_y and e_psi of the latest frame that has arrived, q round((y + bias + noise)/q) each; the filter
    predicts with every sample and corrects with every new frame.
    """
    ring, age = int(setting[data.COMMAND_RING]), setting[data.KNOWN_AGE] / setting[data.DT]
    wheels, newer = data.RINGS + ring, k - math.floor(age + SAME)
    share = max(age - math.floor(age + SAME), 0.0)
    w[wheels + k % ring] = w[data.WHEEL]
    w[data.WHEEL_SEEN_BEFORE] = w[data.WHEEL_SEEN]
    wheel = w[wheels + newer % ring]
    w[data.WHEEL_SEEN] = wheel + share * (w[wheels + (newer - 1) % ring] - wheel)
    for n in range(4):
        w[data.SEEN_E_Y + n] = w[data.E_Y + n]
    if setting[data.CAMERA] > 0.0:
        _take_frames(setting, k, w)
        frames, _, _, _ = rings(setting)
        frame = frames + 2 * (k % int(setting[data.FRAME_RING]))
        noisy = setting[data.NOISE_Y] + setting[data.NOISE_PSI] > 0.0
        for n in range(2):
            spread, bias, step = setting[data.NOISE_Y + n], setting[data.BIAS_Y + n], setting[data.STEP_Y + n]
            error = w[data.OUTWARD] * bias
            if noisy:
                error = fma(w[data.OUTWARD], bias, spread * noise[noise_row + n])
            value = w[frame + n] + error
            w[data.SEEN_E_Y + 2 * n] = step * rint(value / step) if step > 0.0 else value
        if setting[data.FILTERED] > 0.0:
            _filter(setting, w, k, preview[preview_row])


@numba.njit(forceinline=True, **OPTIONS)
def _filter(setting, w, k, lane_rate):
    """The Kalman filter's estimate at sample k instead of the frame; the lane's yaw rate is that at its time.

    x+ = A x + B delta_young + B_old delta_old + W wheel + E_0 r + E_1 r+, then x + K (frame - x).
    """
    ring, model = int(setting[data.COMMAND_RING]), data.FILTER_ROWS
    if k > 0:
        young = w[data.RINGS + (k - 1 - int(setting[data.KNOWN_DELAY])) % ring]
        old = w[data.RINGS + (k - 2 - int(setting[data.KNOWN_DELAY])) % ring]
        before, wheel = w[data.LANE_RATE_SEEN], w[data.WHEEL_SEEN_BEFORE]
        z_0, z_1, z_2, z_3 = w[data.ESTIMATE], w[data.ESTIMATE + 1], w[data.ESTIMATE + 2], w[data.ESTIMATE + 3]
        for n in range(4):
            value = w[model + data.MODEL_B + n] * young
            value = fma(w[model + data.MODEL_E_0 + n], before, value)
            value = fma(w[model + data.MODEL_OLD + n], old, value)
            value = fma(w[model + data.MODEL_WHEEL + n], wheel, value)
            value = fma(w[model + data.MODEL_E_1 + n], lane_rate, value)
            row = model + data.MODEL_A + 4 * n
            value = fma(w[row], z_0, fma(w[row + 1], z_1, value))
            w[data.ESTIMATE + n] = fma(w[row + 2], z_2, fma(w[row + 3], z_3, value))
    if k == 0 or frame_of(setting, k) != frame_of(setting, k - 1):
        y, psi = w[data.SEEN_E_Y] - w[data.ESTIMATE], w[data.SEEN_E_PSI] - w[data.ESTIMATE + 2]
        w[data.INNOVATION_Y], w[data.INNOVATION_PSI] = y, psi
        for n in range(4):
            row = model + data.GAIN + 2 * n
            w[data.ESTIMATE + n] += w[row] * y + w[row + 1] * psi
    w[data.LANE_RATE_SEEN] = lane_rate
    for n in range(4):
        w[data.SEEN_E_Y + n] = w[data.ESTIMATE + n]


@numba.njit(**OPTIONS)
def command(setting, w, k, lane_weights, preview, preview_row, lookaheads, past):
    """Command of a linear law, as in `exact_loop`, into `COMMAND`; once a sample, since it integrates e_y."""
    e_y, ring = w[data.SEEN_E_Y], int(setting[data.COMMAND_RING])
    value = w[data.F_I] * w[data.E_Y_INTEGRAL]
    stops = w[data.F_CONDITIONED] * w[data.YIELDING] > 0.0
    w[data.E_Y_INTEGRAL] = fma(select(stops, 0.0, setting[data.DT]), e_y, w[data.E_Y_INTEGRAL])
    for j in range(2 * lookaheads):
        value = fma(lane_weights[j], preview[preview_row + 1 + j], value)
    for j in range(past):
        value = fma(lane_weights[2 * lookaheads + j], w[data.RINGS + (k - 2 - j) % ring], value)
    value = fma(w[data.F_U], w[data.LAST_COMMAND], value)
    value = fma(w[data.F_E_Y], e_y, fma(w[data.F_E_Y_RATE], w[data.SEEN_E_Y_RATE], value))
    value = fma(w[data.F_E_PSI], w[data.SEEN_E_PSI], value)
    value = fma(w[data.F_E_PSI_RATE], w[data.SEEN_E_PSI_RATE], value)
    value = fma(w[data.F_WHEEL], w[data.WHEEL_SEEN], value)
    wrong = ~(abs(value) < LARGEST_FLOAT)
    w[data.FAILED] += select(wrong, w[data.ALIVE], 0.0)
    w[data.COMMAND] = select(wrong, w[data.LAST_COMMAND], value)
