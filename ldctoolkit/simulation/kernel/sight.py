"""The road that a block of scenarios drives along, and what a law sees of it and of the state."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.paths.philox import normal_pair
from ldctoolkit.simulation.kernel import data as at
from ldctoolkit.simulation.kernel.lanes import LARGEST, OPTIONS, SAME, L, copy, decay, fma, length_of, moments, rings

# a segment of the road: its length, whether it is before T and after the delay, the length of a substep, what a lag
# leaves of a distance over both lengths, and the parabola of that over a substep; then two points a substep and one
HEADER: Final = 9 * L
POINT_SIZE: Final = 4 * L

_CAMERA: Final = 4
"""Stream of random numbers; see `ldctoolkit.paths.random_streams`."""

_FRAME_ZERO: Final = 1 << 20
"""Counter of the frame at the trigger: earlier ones have numbers too."""


@numba.njit(**OPTIONS)
def speed(scene, setting, i, t):
    """Speed and its rate."""
    if setting[at.PROFILE] == 0.0:
        return scene[i, at.SPEED], 0.0
    T = scene[i, at.T_END]
    s = min(t, T)
    v = scene[i, at.V_MEAN] + scene[i, at.A_MEAN] * (s - 0.5 * T)
    rate = scene[i, at.A_MEAN]
    if setting[at.MODES] > 0.0:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * s), math.sin(w * s)
        c, d = 1.0, 0.0
        for j in range(int(setting[at.MODES])):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            v += scene[i, at.SCENE + j] * c
            rate -= scene[i, at.SCENE + j] * (j + 1) * w * d
    return v, rate


@numba.njit(**OPTIONS)
def curvature(scene, i, t):
    """Lane curvature, held beyond T."""
    return scene[i, at.C_0] + scene[i, at.DC] * min(t / scene[i, at.T_END], 1.0)


@numba.njit(**OPTIONS)
def _turned(scene, setting, i, t):
    """Integral of v(t) (c(t), 1) from 0 to t, t at most T, in closed form."""
    T, c_0, slope = scene[i, at.T_END], scene[i, at.C_0], scene[i, at.DC] / scene[i, at.T_END]
    v_0 = scene[i, at.V_MEAN] - 0.5 * scene[i, at.A_MEAN] * T
    a = scene[i, at.A_MEAN]
    way = t * (v_0 + 0.5 * a * t)
    turn = c_0 * way + slope * t * t * (0.5 * v_0 + a * t / 3.0)
    if setting[at.MODES] > 0.0:
        w = math.pi / T
        cos_1, sin_1 = math.cos(w * t), math.sin(w * t)
        c, d = 1.0, 0.0
        for j in range(int(setting[at.MODES])):
            c, d = c * cos_1 - d * sin_1, d * cos_1 + c * sin_1
            f = (j + 1) * w
            part = scene[i, at.SCENE + j] * d / f
            way += part
            turn += part * (c_0 + slope * t) + scene[i, at.SCENE + j] * slope * (c - 1.0) / (f * f)
    return turn, way


@numba.njit(**OPTIONS)
def heading(scene, setting, i, t_0, t_1):
    """Turn of the lane between two times, and the way driven."""
    T, c_0, dc = scene[i, at.T_END], scene[i, at.C_0], scene[i, at.DC]
    if setting[at.PROFILE] == 0.0:
        v = scene[i, at.SPEED]
        in_0, in_1 = min(t_0, T), min(t_1, T)
        turn = c_0 * (t_1 - t_0) + dc * (
            0.5 * (in_1 * in_1 - in_0 * in_0) / T + (max(t_1 - T, 0.0) - max(t_0 - T, 0.0))
        )
        return v * turn, v * (t_1 - t_0)
    turn_0, way_0 = _turned(scene, setting, i, min(t_0, T))
    turn_1, way_1 = _turned(scene, setting, i, min(t_1, T))
    after = max(t_1 - T, 0.0) - max(t_0 - T, 0.0)
    v, _ = speed(scene, setting, i, T)
    return turn_1 - turn_0 + v * (c_0 + dc) * after, way_1 - way_0 + v * after


@numba.njit(**OPTIONS)
def lane_ahead(scene, setting, i, t, ahead):
    """Yaw rate and turn of the lane at a lookahead time, as the law sees them."""
    v, _ = speed(scene, setting, i, t + ahead)
    c = curvature(scene, i, t + ahead)
    turn, way = heading(scene, setting, i, t, t + ahead)
    if setting[at.CAMERA] == 0.0:
        return v * c, turn
    gain, bias = 1.0 + setting[at.CURVATURE_GAIN], scene[i, at.CURVATURE_BIAS]
    return v * (gain * c + bias), gain * turn + bias * way


@numba.njit(**OPTIONS)
def substeps_of(scene, block):
    """Most substeps that a scenario of a block needs for a segment."""
    most = 1
    for i in range(block * L, min((block + 1) * L, scene.shape[0])):
        most = max(most, int(scene[i, at.SUBSTEPS]))
    return most


@numba.njit(**OPTIONS)
def segment_size(parts):
    """Numbers of a segment with so many substeps."""
    return HEADER + (2 * parts + 1) * POINT_SIZE


@numba.njit(**OPTIONS)
def lay_road(scene, setting, block, k, w, parts, road, to):
    """Segments of sample k and the road along their substeps, from `to` on; where they end."""
    dt, switch, lag, cut = setting[at.DT], setting[at.DELAY_PART], setting[at.LAG], False
    for l in range(L):
        h, until = length_of(scene, setting, min(block * L + l, scene.shape[0] - 1), k)
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
            length, own = last - first, w[at.PARTS + l]
            counted = last <= until and until > 0.0
            road[to + l], road[to + 3 * L + l] = length, length / own
            road[to + L + l] = 1.0 if counted else 0.0
            road[to + 2 * L + l] = 1.0 if first >= switch else 0.0
            z, m_0, m_1, m_2 = length / (own * lag) if lag > 0.0 else math.inf, 0.0, 0.0, 0.0
            if lag > 0.0:
                m_0, m_1, m_2 = moments(z, 1.0)
            road[to + 4 * L + l], road[to + 5 * L + l] = decay(-z * own), decay(-z)
            u_0, u_1, u_2 = parabola(m_0, m_1, m_2)
            road[to + 6 * L + l], road[to + 7 * L + l], road[to + 8 * L + l] = u_0, u_1, u_2
            t = scene[i, at.START] + k * dt + first
            for j in range(2 * parts + 1):
                s = t + length * min(0.5 * j / own, 1.0)
                v, dv = speed(scene, setting, i, s)
                point = to + HEADER + j * POINT_SIZE + l
                road[point], road[point + 2 * L], road[point + 3 * L] = v, 1.0 / v, v * curvature(scene, i, s)
                road[point + L] = dv if counted else 0.0  # beyond T the speed stays
        to += segment_size(parts)
    return to


@numba.njit(**OPTIONS)
def parabola(m_0, m_1, m_2):
    """Start, middle and end of the parabola with these moments over [0, 1]."""
    tilt, bend = 3.0 * (2.0 * m_1 - m_0), 5.0 * (6.0 * (m_2 - m_1) + m_0)
    return m_0 - tilt + bend, m_0 - 0.5 * bend, m_0 + tilt + bend


@numba.njit(**OPTIONS)
def frame_of(setting, k):
    """The latest frame that has arrived at sample k; frame 0 is that of the trigger."""
    return math.floor((k * setting[at.DT] - setting[at.LATE]) / setting[at.PERIOD] + SAME)


@numba.njit(**OPTIONS)
def look_ahead(scene, setting, block, k, times, ahead, place):
    """The lane at sample k, from `place` on: yaw rate at the filter's time; it and turn at each lookahead time."""
    for l in range(L):
        i = min(block * L + l, scene.shape[0] - 1)
        t = scene[i, at.START] + k * setting[at.DT]
        if setting[at.FILTERED] > 0.0:
            ahead[place + l], _ = lane_ahead(scene, setting, i, t, -setting[at.KNOWN_AGE])
        for j in range(times.shape[0]):
            rate, turn = lane_ahead(scene, setting, i, t, times[j])
            ahead[place + (1 + 2 * j) * L + l], ahead[place + (2 + 2 * j) * L + l] = rate, turn


@numba.njit(**OPTIONS)
def noise_of(scene, setting, block, k, noise, place):
    """Standard normal numbers of the frame that the law sees at sample k, from `place` on."""
    if setting[at.NOISE_Y] + setting[at.NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[at.SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[at.SEED_LOW])
        frame = np.uint64(_FRAME_ZERO + frame_of(setting, k))
        for l in range(L):
            i = min(block * L + l, scene.shape[0] - 1)
            noise[place + l], noise[place + L + l] = normal_pair(seed, np.uint64(scene[i, at.INDEX]), _CAMERA, frame)


@numba.njit(**OPTIONS)
def _first_after(setting, k):
    """First sample that may see a frame taken at sample k or after."""
    return k + math.floor(setting[at.LATE] / setting[at.DT] + SAME)


@numba.njit(**OPTIONS)
def _take_frames(setting, k, w):
    """Frames that are taken at sample k itself: e_y and e_psi."""
    frames, _, _ = rings(setting)
    size, j = int(setting[at.FRAMES]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[at.PERIOD] / setting[at.DT] - k
        if late > SAME:
            return
        if late >= -SAME:
            frame = frames + 2 * (j % size) * L
            for l in range(L):
                w[frame + l], w[frame + L + l] = w[at.X + l], w[at.X + 2 * L + l]
        j += 1


@numba.njit(**OPTIONS)
def take_between(setting, k, w):
    """Frames that are taken within a piece: on the cubics through its ends."""
    frames, _, _ = rings(setting)
    size, j = int(setting[at.FRAMES]), _first_after(setting, k)
    while True:
        late = frame_of(setting, j) * setting[at.PERIOD] - k * setting[at.DT]
        if late >= setting[at.DT] * (1.0 - SAME):
            return
        if late > setting[at.DT] * SAME:
            for l in range(L):
                h = w[at.SPAN + l]
                s = w[at.T_0 + l] + k * setting[at.DT] + late - w[at.NOW + l]
                if 0.0 <= s <= h and w[at.DUE + l] > 0.0:
                    u, frame = s / h, frames + 2 * (j % size) * L + l
                    a, b = u * u * (3.0 - 2.0 * u), h * u * (1.0 - u)
                    for n in range(2):
                        row = 2 * n * L + l
                        x, m = w[at.X + row], (1.0 - u) * w[at.X + L + row] - u * w[at.N + L + row]
                        w[frame + n * L] = x + a * (w[at.N + row] - x) + b * m
        j += 1


@numba.njit(**OPTIONS)
def see(setting, w, k, ahead, now, noise, place):
    """What the law sees of the state at sample k; each sample once and in order."""
    ring, age = int(setting[at.COMMANDS]), setting[at.KNOWN_AGE] / setting[at.DT]
    wheels, newer = at.RINGS + ring * L, k - math.floor(age + SAME)
    share = max(age - math.floor(age + SAME), 0.0)
    for l in range(L):
        w[at.WHEEL_SEEN + L + l] = w[at.WHEEL_SEEN + l]
        w[wheels + (k % ring) * L + l] = w[at.WHEEL + l]
        angle = w[wheels + (newer % ring) * L + l]
        w[at.WHEEL_SEEN + l] = angle + share * (w[wheels + ((newer - 1) % ring) * L + l] - angle)
    for n in range(4 * L):
        w[at.SEEN + n] = w[at.X + n]
    if setting[at.CAMERA] == 0.0:
        return
    _take_frames(setting, k, w)
    frames, _, _ = rings(setting)
    frame, noisy = frames + 2 * (k % int(setting[at.FRAMES])) * L, setting[at.NOISE_Y] + setting[at.NOISE_PSI] > 0.0
    draws, lane = at.POINTS, at.POINTS + 2 * L  # what is worked on together lies in one array
    if noisy:
        copy(w, draws, noise, place, 2)
    for l in range(L):
        for n in range(2):
            spread, bias, step = setting[at.NOISE_Y + n], setting[at.BIAS_Y + n], setting[at.STEP_Y + n]
            value = w[frame + n * L + l] + w[at.OUTWARD + l] * bias
            if noisy:
                value += spread * w[draws + n * L + l]
            w[at.SEEN + 2 * n * L + l] = step * np.rint(value / step) if step > 0.0 else value
    if setting[at.FILTERED] == 0.0:
        return
    young = at.RINGS + ((k - 1 - int(setting[at.KNOWN_DELAY])) % ring) * L
    old = at.RINGS + ((k - 2 - int(setting[at.KNOWN_DELAY])) % ring) * L
    copy(w, lane, ahead, now, 1)
    if k > 0:
        copy(w, draws, w, young, 1)
        copy(w, draws + L, w, old, 1)
        for l in range(L):
            z_0, z_1 = w[at.ESTIMATE + l], w[at.ESTIMATE + L + l]
            z_2, z_3 = w[at.ESTIMATE + 2 * L + l], w[at.ESTIMATE + 3 * L + l]
            for n in range(4):
                row = at.OF_FILTER + n * L + l
                value = w[row + at.MODEL_B * L] * w[draws + l] + w[row + at.MODEL_E_0 * L] * w[at.RATE_SEEN + l]
                value = fma(w[row + at.MODEL_OLD * L], w[draws + L + l], value)
                value = fma(w[row + at.MODEL_WHEEL * L], w[at.WHEEL_SEEN + L + l], value)
                value = fma(w[row + at.MODEL_E_1 * L], w[lane + l], value)
                row = at.OF_FILTER + (at.MODEL_A + 4 * n) * L + l
                value = fma(w[row], z_0, fma(w[row + L], z_1, value))
                w[at.ESTIMATE + n * L + l] = fma(w[row + 2 * L], z_2, fma(w[row + 3 * L], z_3, value))
    if k == 0 or frame_of(setting, k) != frame_of(setting, k - 1):
        for l in range(L):
            a, b = w[at.SEEN + l] - w[at.ESTIMATE + l], w[at.SEEN + 2 * L + l] - w[at.ESTIMATE + 2 * L + l]
            for n in range(4):
                row = at.OF_FILTER + (at.GAIN + 2 * n) * L + l
                w[at.ESTIMATE + n * L + l] += w[row] * a + w[row + L] * b
    copy(w, at.RATE_SEEN, w, lane, 1)
    copy(w, at.SEEN, w, at.ESTIMATE, 4)


@numba.njit(**OPTIONS)
def command(setting, w, k, g, ahead, now, lookaheads, past, width):
    """Command of a linear law into `TARGET`; once a sample, for the integral of e_y goes on with it.

    The width is that of a block, but unknown to the compiler, which would unroll a small loop instead.
    """
    for l in range(L):
        w[at.TARGET + l] = w[at.OF_LAW + at.LAW_I * L + l] * w[at.Z + l]
        w[at.Z + l] = fma(setting[at.DT], w[at.SEEN + l], w[at.Z + l])
    for j in range(2 * lookaheads):
        for l in range(width):
            w[at.TARGET + l] = fma(g[j * L + l], ahead[now + (1 + j) * L + l], w[at.TARGET + l])
    for j in range(past):
        row = at.RINGS + ((k - 2 - j) % int(setting[at.COMMANDS])) * L
        for l in range(width):
            w[at.TARGET + l] = fma(g[(2 * lookaheads + j) * L + l], w[row + l], w[at.TARGET + l])
    for l in range(L):
        value = fma(w[at.OF_LAW + at.LAW_U * L + l], w[at.LAST + l], w[at.TARGET + l])
        value = fma(w[at.OF_LAW + l], w[at.SEEN + l], fma(w[at.OF_LAW + L + l], w[at.SEEN + L + l], value))
        value = fma(w[at.OF_LAW + 2 * L + l], w[at.SEEN + 2 * L + l], value)
        value = fma(w[at.OF_LAW + 3 * L + l], w[at.SEEN + 3 * L + l], value)
        value = fma(w[at.OF_LAW + at.LAW_WHEEL * L + l], w[at.WHEEL_SEEN + l], value)
        wrong = not abs(value) < LARGEST
        w[at.FAILED + l] += w[at.ALIVE + l] if wrong else 0.0
        w[at.TARGET + l] = w[at.LAST + l] if wrong else value
