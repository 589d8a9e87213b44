"""Compiled loops of paths and random numbers. The compiler takes a while to import: import this where it is called."""

# mypy: disable-error-code="untyped-decorator"

import math
from typing import Any, Final, NamedTuple

import numba
import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.numba_internals import OPTIONS

# numba makes a float of uint64 with int64: every number below is unsigned
_MULTIPLIER_0: Final = np.uint64(0xD2511F53)
_MULTIPLIER_1: Final = np.uint64(0xCD9E8D57)
_WEYL_0: Final = np.uint64(0x9E3779B9)
_WEYL_1: Final = np.uint64(0xBB67AE85)
_LOW: Final = np.uint64(0xFFFFFFFF)
_32: Final = np.uint64(32)
_12: Final = np.uint64(12)


@numba.njit(**OPTIONS)
def philox(c0: Any, c1: Any, c2: Any, c3: Any, k0: Any, k1: Any) -> Any:
    """Philox4x32-10: four random words from a counter of four and a key of two, 32 bits each, held in uint64."""
    c0, c1, c2, c3 = np.uint64(c0) & _LOW, np.uint64(c1) & _LOW, np.uint64(c2) & _LOW, np.uint64(c3) & _LOW
    k0, k1 = np.uint64(k0) & _LOW, np.uint64(k1) & _LOW
    for _ in range(10):
        product_0, product_1 = _MULTIPLIER_0 * c0, _MULTIPLIER_1 * c2
        c0, c2 = (product_1 >> _32) ^ c1 ^ k0, (product_0 >> _32) ^ c3 ^ k1
        c1, c3 = product_1 & _LOW, product_0 & _LOW
        k0, k1 = (k0 + _WEYL_0) & _LOW, (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@numba.njit(**OPTIONS)
def uniform_pair(seed: Any, index: Any, stream: Any, counter: Any) -> Any:
    """Two uniform numbers on (0, 1), odd multiples of 2^-53: neither 0 nor 1 can occur."""
    key, number = np.uint64(seed), np.uint64(index)
    a, b, c, d = philox(number, number >> _32, np.uint64(stream), np.uint64(counter), key, key >> _32)
    first = np.float64(((b << _32) | a) >> _12)
    second = np.float64(((d << _32) | c) >> _12)
    return (first + 0.5) * 2.0**-52, (second + 0.5) * 2.0**-52


@numba.njit(**OPTIONS)
def normal_pair(seed: Any, index: Any, stream: Any, counter: Any) -> Any:
    """Two independent standard normal numbers (Box and Muller, Ann. Math. Statist. 29, 1958)."""
    first, second = uniform_pair(seed, index, stream, counter)
    radius = math.sqrt(-2.0 * math.log(first))
    angle = 2.0 * math.pi * second
    return radius * math.cos(angle), radius * math.sin(angle)


@numba.njit(**OPTIONS, cache=True)
def fill_pairs(seed: int, index: IntArray, stream: int, normal: bool, out: FloatArray) -> None:
    """Uniform or normal numbers into `out` (n, count): column j is element j % 2 of the pair at counter j // 2."""
    n, count = out.shape
    for i in range(n):
        for pair in range((count + 1) // 2):
            if normal:
                first, second = normal_pair(seed, index[i], stream, pair)
            else:
                first, second = uniform_pair(seed, index[i], stream, pair)
            out[i, 2 * pair] = first
            if 2 * pair + 1 < count:
                out[i, 2 * pair + 1] = second


POSITION, SPEED, SPEED_RATE, LATERAL, LATERAL_RATE, LATERAL_ACCELERATION = range(6)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_CELLS_PER_HALF_WAVE: Final = 16
_MOST_CELLS: Final = 100_000
_PASSES: Final = 200


class Path(NamedTuple):
    """Columns of n paths; modes_y (n, J_y) and modes_v (n, J_v), of which the first count_y, count_v are in use."""

    T: FloatArray
    d_y: FloatArray
    v_mean: FloatArray
    a_mean: FloatArray
    modes_y: FloatArray
    modes_v: FloatArray
    count_y: IntArray
    count_v: IntArray


@numba.njit(**OPTIONS, cache=True)
def along(path: Any, i: int, t: float) -> Any:
    """Motion along the lane: distance x, speed v and its rate."""
    T, v_mean, a_mean = path.T[i], path.v_mean[i], path.a_mean[i]
    omega = math.pi / T
    cos_1, sin_1 = math.cos(omega * t), math.sin(omega * t)
    c, s = 1.0, 0.0
    way, eps, rate = 0.0, 0.0, 0.0
    for j in range(1, path.count_v[i] + 1):
        c, s = c * cos_1 - s * sin_1, s * cos_1 + c * sin_1
        b = path.modes_v[i, j - 1]
        way += b * s / j
        eps += b * c
        rate -= b * s * j
    x = v_mean * t + 0.5 * a_mean * (t - T) * t + way / omega
    return x, v_mean + a_mean * (t - 0.5 * T) + eps, a_mean + rate * omega


@numba.njit(**OPTIONS, cache=True)
def motion(path: Any, i: int, t: float) -> Any:
    """Motion along the lane as `along`, then the lateral distance y and its first two derivatives."""
    T, v_mean, a_mean = path.T[i], path.v_mean[i], path.a_mean[i]
    omega = math.pi / T
    cos_1, sin_1 = math.cos(omega * t), math.sin(omega * t)
    c, s = 1.0, 0.0
    way, eps_v, rate_v = 0.0, 0.0, 0.0
    eps_y, rate_y, bend = 0.0, 0.0, 0.0
    count_y, count_v = path.count_y[i], path.count_v[i]
    for j in range(1, max(count_y, count_v) + 1):
        c, s = c * cos_1 - s * sin_1, s * cos_1 + c * sin_1
        if j <= count_v:
            b = path.modes_v[i, j - 1]
            way += b * s / j
            eps_v += b * c
            rate_v -= b * s * j
        if j <= count_y:
            a = path.modes_y[i, j - 1]
            eps_y += a * s
            rate_y += a * c * j
            bend -= a * s * (j * j)
    x = v_mean * t + 0.5 * a_mean * (t - T) * t + way / omega
    v, dv = v_mean + a_mean * (t - 0.5 * T) + eps_v, a_mean + rate_v * omega
    d_x = v_mean * T
    share = x / d_x
    slope = 4.0 * path.d_y[i] / d_x * (1.0 - 2.0 * share)
    y = 4.0 * path.d_y[i] * share * (1.0 - share) + eps_y
    ddy = -8.0 * path.d_y[i] / d_x**2 * v**2 + slope * dv + bend * omega**2
    return x, v, dv, y, slope * v + rate_y * omega, ddy


@numba.njit(**OPTIONS, cache=True)
def values(path: Any, quantity: int, t: FloatArray, out: FloatArray) -> None:
    """One quantity at times t (n, k) into `out`."""
    for i in range(t.shape[0]):
        for k in range(t.shape[1]):
            if quantity <= SPEED_RATE:
                x, v, dv = along(path, i, t[i, k])
                out[i, k] = x if quantity == POSITION else (v if quantity == SPEED else dv)
            else:
                _, _, _, y, dy, ddy = motion(path, i, t[i, k])
                out[i, k] = y if quantity == LATERAL else (dy if quantity == LATERAL_RATE else ddy)


@numba.njit(**OPTIONS, cache=True)
def areas(path: Any, t: FloatArray, out: FloatArray) -> None:
    """Integral of y from 0 to t (n, k) into `out`: Gauss and Legendre's rule for the parabola, eps_y in closed form.

    Twelve nodes for each half wave of the highest mode of eps_v integrate its square to rounding.
    """
    for i in range(t.shape[0]):
        omega = math.pi / path.T[i]
        d_x = path.v_mean[i] * path.T[i]
        for k in range(t.shape[1]):
            end = t[i, k]
            half_waves = abs(end) / path.T[i] * max(path.count_v[i], 1)
            if not half_waves < _MOST_CELLS:
                out[i, k] = np.nan
                continue
            cells = int(half_waves) + 1
            h = end / cells
            total = 0.0
            for cell in range(cells):
                part = 0.0
                for q in range(_NODES.size):
                    x, _, _ = along(path, i, (cell + 0.5 + 0.5 * _NODES[q]) * h)
                    share = x / d_x
                    part += _WEIGHTS[q] * share * (1.0 - share)
                total += part
            area = 4.0 * path.d_y[i] * total * 0.5 * h
            cos_1, sin_1 = math.cos(omega * end), math.sin(omega * end)
            c, s = 1.0, 0.0
            for j in range(1, path.count_y[i] + 1):
                c, s = c * cos_1 - s * sin_1, s * cos_1 + c * sin_1
                area += path.modes_y[i, j - 1] / (j * omega) * (1.0 - c)
            out[i, k] = area


@numba.njit(**OPTIONS, cache=True)
def _curve(path: Any, i: int, lead_time: float, t: float) -> Any:
    """The edge with its rate carried `lead_time` seconds on, and the slope of that."""
    _, _, _, y, dy, ddy = motion(path, i, t)
    return y + lead_time * dy, dy + lead_time * ddy


@numba.njit(**OPTIONS, cache=True)
def _zero(path: Any, i: int, lead_time: float, level: float, of_slope: bool, low: float, high: float) -> Any:
    """Zero of curve - level (or of -slope) between low, where it is <= 0, and high, where it is > 0.

    False position after Illinois (Dowell and Jarratt, BIT 11, 1971), halved where that is slow.
    """
    value, slope = _curve(path, i, lead_time, low)
    f_low = -slope if of_slope else value - level
    value, slope = _curve(path, i, lead_time, high)
    f_high = -slope if of_slope else value - level
    last, length = 0, high - low
    for step in range(_PASSES):
        t = high - f_high * (high - low) / (f_high - f_low)
        if step % 4 == 3:
            if high - low > 0.25 * length:
                t, last = 0.5 * (low + high), 0
            length = high - low
        if not low < t < high:
            t = 0.5 * (low + high)
            if not low < t < high:
                break
        value, slope = _curve(path, i, lead_time, t)
        f = -slope if of_slope else value - level
        if f == 0.0:
            return t
        if f > 0.0:
            high, f_high = t, f
            f_low = 0.5 * f_low if last == 1 else f_low
            last = 1
        else:
            low, f_low = t, f
            f_high = 0.5 * f_high if last == -1 else f_high
            last = -1
        if high - low < 1e-14 * path.T[i]:
            break
    return 0.5 * (low + high)


@numba.njit(**OPTIONS, cache=True)
def _cells(path: Any, i: int, span: float) -> int:
    """Cells for a search over `span` seconds: 16 for each half wave of the highest mode, 0 for no search at all."""
    waves = span / path.T[i] * max(path.count_y[i], path.count_v[i], 2)
    if not (waves >= 0.0 and waves * _CELLS_PER_HALF_WAVE < _MOST_CELLS):
        return 0
    return int(waves * _CELLS_PER_HALF_WAVE) + 1


@numba.njit(**OPTIONS, cache=True)
def crossings(path: Any, lead_time: float, y_s: float, out: FloatArray) -> None:
    """First time in [0, T] at which y + lead_time dy/dt exceeds y_s, into `out` (n,); infinite where it never does."""
    for i in range(out.size):
        out[i] = np.inf
        T = path.T[i]
        cells = _cells(path, i, T)
        if cells == 0:
            continue
        h = T / cells
        before, rising = _curve(path, i, lead_time, 0.0)
        if before > y_s or (before == y_s and rising > 0.0):
            out[i] = 0.0
            continue
        for cell in range(cells):
            left = cell * h
            right = T if cell == cells - 1 else (cell + 1) * h
            value, slope = _curve(path, i, lead_time, right)
            if value > y_s:
                out[i] = _zero(path, i, lead_time, y_s, False, left, right)
                break
            if rising > 0.0 and slope < 0.0:
                peak = _zero(path, i, lead_time, 0.0, True, left, right)
                top, _ = _curve(path, i, lead_time, peak)
                if top > y_s:
                    out[i] = _zero(path, i, lead_time, y_s, False, left, peak)
                    break
            rising = slope


@numba.njit(**OPTIONS, cache=True)
def shape_speed_modes(sigma: FloatArray, count: IntArray, modes: FloatArray) -> None:
    """Standard normal numbers (n, J) to modes b_j in place: orthogonal to a straight line, deviation sigma.

    Over [0, T], cos(j theta) times t - T/2 has the integral -2 T^2/(j pi)^2 for odd j, and 0 for even.
    """
    for i in range(modes.shape[0]):
        product, norm = 0.0, 0.0
        for j in range(1, count[i] + 1, 2):
            product += modes[i, j - 1] / j**2
            norm += 1.0 / j**4
        for j in range(1, count[i] + 1, 2):
            modes[i, j - 1] -= product / norm / j**2
        power = 0.0
        for j in range(count[i]):
            power += 0.5 * modes[i, j] ** 2
        for j in range(modes.shape[1]):
            modes[i, j] = modes[i, j] * (sigma[i] / math.sqrt(power)) if j < count[i] else 0.0


@numba.njit(**OPTIONS, cache=True)
def shape_lateral_modes(path: Any, sigma: FloatArray, count: IntArray, modes: FloatArray) -> None:
    """Standard normal numbers (n, J) to modes a_j in place: orthogonal to the path's parabola, deviation sigma.

    The parabola is 4 s (1 - s) in time, s = x(t)/d_x with eps_v in it. The deviation is about the residual's own mean,
    which is 2 a_j/(j pi) summed over odd j.
    """
    weight = np.empty(modes.shape[1])
    for i in range(modes.shape[0]):
        J, T = count[i], path.T[i]
        weight[:] = 0.0
        cells = max(J, path.count_v[i])
        for cell in range(cells):
            for q in range(_NODES.size):
                t = (cell + 0.5 + 0.5 * _NODES[q]) * (T / cells)
                x, _, _ = along(path, i, t)
                share = x / (path.v_mean[i] * T)
                height = _WEIGHTS[q] * share * (1.0 - share)
                cos_1, sin_1 = math.cos(math.pi * t / T), math.sin(math.pi * t / T)
                c, s = 1.0, 0.0
                for j in range(J):
                    c, s = c * cos_1 - s * sin_1, s * cos_1 + c * sin_1
                    weight[j] += height * s
        product, norm = 0.0, 0.0
        for j in range(J):
            product += modes[i, j] * weight[j]
            norm += weight[j] ** 2
        power, mean = 0.0, 0.0
        for j in range(J):
            modes[i, j] -= product / norm * weight[j]
            power += 0.5 * modes[i, j] ** 2
            if j % 2 == 0:
                mean += 2.0 * modes[i, j] / ((j + 1) * math.pi)
        for j in range(modes.shape[1]):
            modes[i, j] = modes[i, j] * (sigma[i] / math.sqrt(power - mean**2)) if j < J else 0.0
