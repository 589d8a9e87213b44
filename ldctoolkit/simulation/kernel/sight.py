"""The road that a block of scenarios drives along, and what a law sees of it and of the state."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import math
from typing import Final

import numba
import numpy as np

from ldctoolkit.lane_functions import OPTIONS, cosine, decay, fma, moments, sine
from ldctoolkit.paths.kernels import normal_pair
from ldctoolkit.simulation.kernel import data as at
from ldctoolkit.simulation.kernel.lanes import LARGEST, SAME, L, copy, length_of, rings

# a segment of the road: its length, whether it is before T and after the delay, the length of a substep, what a lag
# leaves of a distance over both lengths, and the parabola of that over a substep; then two points a substep and one
HEADER: Final = 9 * L
POINT_SIZE: Final = 4 * L

_CAMERA: Final = 4  # stream of random numbers; see `ldctoolkit.paths.uncorrected`
_FRAME_ZERO: Final = 1 << 20  # counter of the frame at the trigger: earlier ones have numbers too


@numba.njit(**OPTIONS)
def along(setting, w, turns):
    """Speed and its rate at `TIMES`, held beyond T; on request the way driven since t = 0, and the lane's turn."""
    width = int(setting[at.WIDTH])
    for l in range(width):
        s, v_0, a = min(w[at.TIMES + l], w[at.T + l]), w[at.ROAD + l], w[at.ROAD + L + l]
        way = s * fma(0.5 * a, s, v_0)
        turn = w[at.ROAD + 3 * L + l] * s * s * fma(a * (1.0 / 3.0), s, 0.5 * v_0)
        w[at.MOTION + l], w[at.MOTION + L + l] = fma(a, s, v_0), a
        w[at.MOTION + 2 * L + l], w[at.MOTION + 3 * L + l] = way, fma(w[at.ROAD + 2 * L + l], way, turn)
    if w[at.USED] > 0.0:
        _, _, modes, _ = rings(setting)
        for l in range(width):
            angle = w[at.ROAD + 4 * L + l] * min(w[at.TIMES + l], w[at.T + l])
            w[at.WAVE + l], w[at.WAVE + L + l] = cosine(angle), sine(angle)
            w[at.WAVE + 2 * L + l], w[at.WAVE + 3 * L + l] = 1.0, 0.0
        for j in range(int(w[at.USED])):
            copy(w, at.WAVE + 4 * L, w, modes + j * L, 1)
            _add_mode(w, j + 1.0, width)
            if turns:
                _add_turn(w, 1.0 / (math.pi * (j + 1.0)), width)
    if turns:
        for l in range(width):
            after = max(w[at.TIMES + l] - w[at.T + l], 0.0) * w[at.MOTION + l]
            w[at.MOTION + 2 * L + l] += after
            curve = fma(w[at.ROAD + 3 * L + l], w[at.T + l], w[at.ROAD + 2 * L + l])
            w[at.MOTION + 3 * L + l] = fma(after, curve, w[at.MOTION + 3 * L + l])


@numba.njit(**OPTIONS)
def _add_mode(w, number, width):
    """What a mode of the residual adds to the speed and its rate."""
    for l in range(width):
        cos_1, sin_1, c, d = w[at.WAVE + l], w[at.WAVE + L + l], w[at.WAVE + 2 * L + l], w[at.WAVE + 3 * L + l]
        c, d, b = fma(c, cos_1, -d * sin_1), fma(d, cos_1, c * sin_1), w[at.WAVE + 4 * L + l]
        w[at.WAVE + 2 * L + l], w[at.WAVE + 3 * L + l] = c, d
        w[at.MOTION + l] = fma(b, c, w[at.MOTION + l])
        w[at.MOTION + L + l] = fma(-b * number * w[at.ROAD + 4 * L + l], d, w[at.MOTION + L + l])


@numba.njit(**OPTIONS)
def _add_turn(w, per_angle, width):
    """And to the way and the turn."""
    for l in range(width):
        T, slope, per_rate = w[at.T + l], w[at.ROAD + 3 * L + l], per_angle * w[at.T + l]
        curve = fma(slope, min(w[at.TIMES + l], T), w[at.ROAD + 2 * L + l])
        part = w[at.WAVE + 4 * L + l] * per_rate
        way = part * w[at.WAVE + 3 * L + l]
        w[at.MOTION + 2 * L + l] += way
        turn = fma(way, curve, part * per_rate * slope * (w[at.WAVE + 2 * L + l] - 1.0))
        w[at.MOTION + 3 * L + l] += turn


@numba.njit(**OPTIONS)
def lay_point(setting, w, substep):
    """The road after so many substeps of a segment into the first of the rows `POINTS`."""
    width = int(setting[at.WIDTH])
    for l in range(width):
        w[at.TIMES + l] = w[at.BEGAN + l] + min(substep * w[at.SEGMENT + 3 * L + l], w[at.SEGMENT + l])
    along(setting, w, False)
    for l in range(width):
        v, s = w[at.MOTION + l], min(w[at.TIMES + l], w[at.T + l])
        dv = w[at.MOTION + L + l] * w[at.SEGMENT + L + l]  # beyond T the speed stays
        w[at.POINTS + l], w[at.POINTS + L + l], w[at.POINTS + 2 * L + l] = v, dv, 1.0 / v
        w[at.POINTS + 3 * L + l] = v * fma(w[at.ROAD + 3 * L + l], s, w[at.ROAD + 2 * L + l])


@numba.njit(**OPTIONS)
def substeps_of(w):
    """Most substeps that a scenario of a block needs for a segment."""
    most = 1
    for l in range(L):
        most = max(most, int(w[at.PARTS + l]))
    return most


@numba.njit(**OPTIONS)
def segment_size(parts):
    """Numbers of a segment with so many substeps."""
    return HEADER + (2 * parts + 1) * POINT_SIZE


@numba.njit(**OPTIONS)
def lay_road(setting, k, w, parts, road, to):
    """Segments of sample k and the road along their substeps, from `to` on; where they end."""
    dt, switch, lag, cut = setting[at.DT], setting[at.DELAY_PART], setting[at.LAG], False
    for l in range(L):
        h, until = length_of(setting, w, l, k)
        cut |= 0.0 < until < h
    segments = 1 + int(cut) + int(switch > 0.0)
    for n in range(segments):
        for l in range(L):
            h, until = length_of(setting, w, l, k)
            inside = until if 0.0 < until < h else h
            low, high = (min(inside, switch), max(inside, switch)) if segments == 3 else (inside, h)
            if segments == 2 and not cut:
                low = switch
            first = 0.0 if n == 0 else min(low if n == 1 else high, h)
            last = h if n + 1 == segments else min(low if n == 0 else high, h)
            w[at.SEGMENT + l], w[at.SEGMENT + 3 * L + l] = last - first, (last - first) / w[at.PARTS + l]
            w[at.SEGMENT + L + l] = 1.0 if last <= until and until > 0.0 else 0.0
            w[at.SEGMENT + 2 * L + l] = 1.0 if first >= switch else 0.0
            w[at.BEGAN + l] = w[at.T_0 + l] + k * dt + first
        if lag > 0.0:
            _lay_lag(w, 1.0 / lag)
        copy(road, to, w, at.SEGMENT, 9)
        for j in range(2 * parts + 1):
            lay_point(setting, w, 0.5 * j)
            copy(road, to + HEADER + j * POINT_SIZE, w, at.POINTS, 4)
        to += segment_size(parts)
    return to


@numba.njit(**OPTIONS)
def _lay_lag(w, per_lag):
    """What a lag leaves of a distance over a segment and over a substep, and the parabola of that."""
    for l in range(L):
        z = w[at.SEGMENT + 3 * L + l] * per_lag
        m_0, m_1, m_2 = moments(z, 1.0)
        a, b, c = parabola(m_0, m_1, m_2)
        w[at.SEGMENT + 4 * L + l], w[at.SEGMENT + 5 * L + l] = decay(-w[at.SEGMENT + l] * per_lag), decay(-z)
        w[at.SEGMENT + 6 * L + l], w[at.SEGMENT + 7 * L + l], w[at.SEGMENT + 8 * L + l] = a, b, c


@numba.njit(forceinline=True, **OPTIONS)
def parabola(m_0, m_1, m_2):
    """Start, middle and end of the parabola with these moments over [0, 1]."""
    tilt, bend = 3.0 * (2.0 * m_1 - m_0), 5.0 * (6.0 * (m_2 - m_1) + m_0)
    return m_0 - tilt + bend, m_0 - 0.5 * bend, m_0 + tilt + bend


@numba.njit(**OPTIONS)
def frame_of(setting, k):
    """The latest frame that has arrived at sample k; frame 0 is that of the trigger."""
    return math.floor((k * setting[at.DT] - setting[at.LATE]) / setting[at.PERIOD] + SAME)


@numba.njit(**OPTIONS)
def look_ahead(setting, k, w, times, ahead, place):
    """The lane at sample k, from `place` on: yaw rate at the filter's time; it and turn at each lookahead time."""
    gain, width = 1.0 + setting[at.CURVATURE_GAIN], int(setting[at.WIDTH])
    for j in range(0 if setting[at.FILTERED] > 0.0 else 1, times.shape[0] + 2):
        # the time of the filter's state, now, and then the lookahead times
        late = -setting[at.KNOWN_AGE] if j == 0 else (times[j - 2] if j > 1 else 0.0)
        for l in range(width):
            w[at.TIMES + l] = w[at.T_0 + l] + k * setting[at.DT] + late
        along(setting, w, True)
        if j == 1:
            copy(w, at.WAY, w, at.MOTION + 2 * L, 2)
            continue
        for l in range(width):
            curve = fma(w[at.ROAD + 3 * L + l], min(w[at.TIMES + l], w[at.T + l]), w[at.ROAD + 2 * L + l])
            way, turn = w[at.MOTION + 2 * L + l] - w[at.WAY + l], w[at.MOTION + 3 * L + l] - w[at.WAY + L + l]
            w[at.MOTION + l] *= fma(gain, curve, w[at.CURVE_BIAS + l])
            w[at.MOTION + L + l] = fma(gain, turn, w[at.CURVE_BIAS + l] * way)
        if j == 0:
            copy(ahead, place, w, at.MOTION, 1)
        else:
            copy(ahead, place + (2 * j - 3) * L, w, at.MOTION, 2)


@numba.njit(**OPTIONS)
def noise_of(setting, k, w, noise, place):
    """Standard normal numbers of the frame that the law sees at sample k, from `place` on."""
    if setting[at.NOISE_Y] + setting[at.NOISE_PSI] > 0.0:
        seed = (np.uint64(setting[at.SEED_HIGH]) << np.uint64(32)) | np.uint64(setting[at.SEED_LOW])
        frame = np.uint64(_FRAME_ZERO + frame_of(setting, k))
        for l in range(L):
            noise[place + l], noise[place + L + l] = normal_pair(seed, np.uint64(w[at.NUMBER + l]), _CAMERA, frame)


@numba.njit(**OPTIONS)
def _first_after(setting, k):
    """First sample that may see a frame taken at sample k or after."""
    return k + math.floor(setting[at.LATE] / setting[at.DT] + SAME)


@numba.njit(**OPTIONS)
def _take_frames(setting, k, w):
    """Frames that are taken at sample k itself: e_y and e_psi."""
    frames, _, _, _ = rings(setting)
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
    frames, _, _, _ = rings(setting)
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


@numba.njit(forceinline=True, **OPTIONS)
def _predict(w, n, width):
    """A state of the filter, from the estimate and the lane's yaw rate in `POINTS` and two commands in `WORK`."""
    row, from_state = at.OF_FILTER + n * L, at.OF_FILTER + (at.MODEL_A + 4 * n) * L
    for l in range(width):
        value = w[row + at.MODEL_B * L + l] * w[at.WORK + 2 * L + l]
        value = fma(w[row + at.MODEL_E_0 * L + l], w[at.RATE_SEEN + l], value)
        value = fma(w[row + at.MODEL_OLD * L + l], w[at.WORK + 3 * L + l], value)
        value = fma(w[row + at.MODEL_WHEEL * L + l], w[at.WHEEL_SEEN + L + l], value)
        value = fma(w[row + at.MODEL_E_1 * L + l], w[at.POINTS + l], value)
        z_0, z_1 = w[at.POINTS + L + l], w[at.POINTS + 2 * L + l]
        value = fma(w[from_state + l], z_0, fma(w[from_state + L + l], z_1, value))
        z_2, z_3 = w[at.POINTS + 3 * L + l], w[at.POINTS + 4 * L + l]
        w[at.ESTIMATE + n * L + l] = fma(w[from_state + 2 * L + l], z_2, fma(w[from_state + 3 * L + l], z_3, value))


@numba.njit(forceinline=True, **OPTIONS)
def _correct(w, n, width):
    """The same state with the innovations in `WORK`."""
    row = at.OF_FILTER + (at.GAIN + 2 * n) * L
    for l in range(width):
        value = w[row + l] * w[at.WORK + l] + w[row + L + l] * w[at.WORK + L + l]
        w[at.ESTIMATE + n * L + l] += value


@numba.njit(**OPTIONS)
def see(setting, w, k, ahead, now, noise, place):
    """What the law sees of the state at sample k; each sample once and in order."""
    ring, age, width = int(setting[at.COMMANDS]), setting[at.KNOWN_AGE] / setting[at.DT], int(setting[at.WIDTH])
    wheels, newer = at.RINGS + ring * L, k - math.floor(age + SAME)
    share = max(age - math.floor(age + SAME), 0.0)
    copy(w, wheels + (k % ring) * L, w, at.WHEEL, 1)
    copy(w, at.WHEEL_SEEN + L, w, at.WHEEL_SEEN, 1)
    copy(w, at.WORK, w, wheels + (newer % ring) * L, 1)
    copy(w, at.WORK + L, w, wheels + ((newer - 1) % ring) * L, 1)
    for l in range(width):
        w[at.WHEEL_SEEN + l] = w[at.WORK + l] + share * (w[at.WORK + L + l] - w[at.WORK + l])
    copy(w, at.SEEN, w, at.X, 4)
    if setting[at.CAMERA] == 0.0:
        return
    _take_frames(setting, k, w)
    frames, _, _, _ = rings(setting)
    draws, lane = at.WORK + 2 * L, at.POINTS  # what is worked on together lies in one array
    copy(w, at.WORK, w, frames + 2 * (k % int(setting[at.FRAMES])) * L, 2)
    if setting[at.NOISE_Y] + setting[at.NOISE_PSI] > 0.0:
        copy(w, draws, noise, place, 2)
    else:
        for n in range(2 * L):
            w[draws + n] = 0.0
    for n in range(2):
        spread, bias, step = setting[at.NOISE_Y + n], setting[at.BIAS_Y + n], setting[at.STEP_Y + n]
        for l in range(width):
            w[at.WORK + l] += fma(w[at.OUTWARD + l], bias, spread * w[draws + l])
        if step > 0.0:
            for l in range(L):
                w[at.WORK + l] = step * np.rint(w[at.WORK + l] / step)
        copy(w, at.SEEN + 2 * n * L, w, at.WORK, 1)
        copy(w, at.WORK, w, at.WORK + L, 1)
        copy(w, draws, w, draws + L, 1)
    if setting[at.FILTERED] == 0.0:
        return
    young = at.RINGS + ((k - 1 - int(setting[at.KNOWN_DELAY])) % ring) * L
    old = at.RINGS + ((k - 2 - int(setting[at.KNOWN_DELAY])) % ring) * L
    copy(w, lane, ahead, now, 1)
    if k > 0:
        copy(w, draws, w, young, 1)
        copy(w, draws + L, w, old, 1)
        copy(w, at.POINTS + L, w, at.ESTIMATE, 4)
        _predict(w, 0, width)
        _predict(w, 1, width)
        _predict(w, 2, width)
        _predict(w, 3, width)
    if k == 0 or frame_of(setting, k) != frame_of(setting, k - 1):
        for l in range(width):
            w[at.WORK + l] = w[at.SEEN + l] - w[at.ESTIMATE + l]
            w[at.WORK + L + l] = w[at.SEEN + 2 * L + l] - w[at.ESTIMATE + 2 * L + l]
        _correct(w, 0, width)
        _correct(w, 1, width)
        _correct(w, 2, width)
        _correct(w, 3, width)
    copy(w, at.RATE_SEEN, w, lane, 1)
    copy(w, at.SEEN, w, at.ESTIMATE, 4)


@numba.njit(**OPTIONS)
def command(setting, w, k, g, ahead, now, lookaheads, past):
    """Command of a linear law into `TARGET`; once a sample, for the integral of e_y goes on with it."""
    width = int(setting[at.WIDTH])
    for l in range(width):
        w[at.TARGET + l] = w[at.OF_LAW + at.LAW_I * L + l] * w[at.Z + l]
        w[at.Z + l] = fma(setting[at.DT], w[at.SEEN + l], w[at.Z + l])
    for j in range(2 * lookaheads + past):
        copy(w, at.WORK, g, j * L, 1)
        if j < 2 * lookaheads:
            copy(w, at.WORK + L, ahead, now + (1 + j) * L, 1)
        else:
            copy(w, at.WORK + L, w, at.RINGS + ((k - 2 - j + 2 * lookaheads) % int(setting[at.COMMANDS])) * L, 1)
        for l in range(width):
            w[at.TARGET + l] = fma(w[at.WORK + l], w[at.WORK + L + l], w[at.TARGET + l])
    for l in range(width):
        value = fma(w[at.OF_LAW + at.LAW_U * L + l], w[at.LAST + l], w[at.TARGET + l])
        value = fma(w[at.OF_LAW + l], w[at.SEEN + l], fma(w[at.OF_LAW + L + l], w[at.SEEN + L + l], value))
        value = fma(w[at.OF_LAW + 2 * L + l], w[at.SEEN + 2 * L + l], value)
        value = fma(w[at.OF_LAW + 3 * L + l], w[at.SEEN + 3 * L + l], value)
        value = fma(w[at.OF_LAW + at.LAW_WHEEL * L + l], w[at.WHEEL_SEEN + l], value)
        wrong = not abs(value) < LARGEST
        alive, last = w[at.ALIVE + l], w[at.LAST + l]
        w[at.FAILED + l] += alive if wrong else 0.0
        w[at.TARGET + l] = last if wrong else value
