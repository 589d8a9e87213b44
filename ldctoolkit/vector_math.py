"""Compiled functions of a few numbers, of lanes and floats alike without a branch; cubics and quartics; series."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import functools
import math
from collections.abc import Callable
from typing import Final

import numba
import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.lanes import any_lane, fma, select
from ldctoolkit.numba_internals import OPTIONS

_MOST_PASSES: Final = 40
_NEAR: Final = 1e-6  # Error of a zero, in parts of the piece; what it costs an integral is its square


@numba.njit(forceinline=True, **OPTIONS)
def quartic_root(f_0, m_0, f_1, m_1, mean):
    """Root between 0 and 1 of the quartic with these ends, of opposite signs, slopes and mean."""
    q = 30.0 * (mean - 0.5 * (f_0 + f_1) - (m_0 - m_1) / 12.0)
    a, b = 2.0 * (f_0 - f_1) + m_0 + m_1 - 2.0 * q, 3.0 * (f_1 - f_0) - 2.0 * m_0 - m_1 + q
    u = f_0 / (f_0 - f_1)
    for _ in range(4):
        value = f_0 + u * (m_0 + u * (b + u * (a + u * q)))
        following = u - value / (m_0 + u * (2.0 * b + u * (3.0 * a + u * 4.0 * q)))
        if not 0.0 < following < 1.0:
            return u
        if abs(following - u) < 1e-3:
            return following
        u = following
    return u


@numba.njit(**OPTIONS)
def _between(c, low, high):
    """Zero of the polynomial c_0 + c_1 u + ... + c_4 u^4 between two arguments with values of different signs."""
    at_low = c[0] + low * (c[1] + low * (c[2] + low * (c[3] + low * c[4])))
    at_high = c[0] + high * (c[1] + high * (c[2] + high * (c[3] + high * c[4])))
    u = low + (high - low) * at_low / (at_low - at_high)
    for _ in range(_MOST_PASSES):
        value = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * c[4])))
        if value * at_low > 0.0:
            low = u
        else:
            high = u
        slope = c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * 4.0 * c[4]))
        following = u - value / slope if slope != 0.0 else low
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - u) < _NEAR:
            return following
        u = following
    return u


@numba.njit(**OPTIONS)
def quartic_peak(f_0, m_0, f_1, m_1, mean):
    """Largest value on [0, 1] of the quartic with these ends, slopes and mean, where it rises first and falls last."""
    peak = max(f_0, f_1)
    if m_0 > 0.0 > m_1:
        q = 30.0 * (mean - 0.5 * (f_0 + f_1) - (m_0 - m_1) / 12.0)
        a, b = 2.0 * (f_0 - f_1) + m_0 + m_1 - 2.0 * q, 3.0 * (f_1 - f_0) - 2.0 * m_0 - m_1 + q
        u = _between((m_0, 2.0 * b, 3.0 * a, 4.0 * q, 0.0), 0.0, 1.0)
        peak = max(peak, f_0 + u * (m_0 + u * (b + u * (a + u * q))))
    return peak


@numba.njit(**OPTIONS)
def absolute_area(x_0, x_1, n_0, n_1, area, h):
    """Integral of |e_y| over a piece, split where the quartic with its ends, slopes and integral changes its sign."""
    m_0, m_1, mean = h * x_1, h * n_1, area / h
    q = 30.0 * (mean - 0.5 * (x_0 + n_0) - (m_0 - m_1) / 12.0)
    c = (x_0, m_0, 3.0 * (n_0 - x_0) - 2.0 * m_0 - m_1 + q, 2.0 * (x_0 - n_0) + m_0 + m_1 - 2.0 * q, q)
    first = last = 1.0
    if x_0 * n_0 < 0.0:
        first = _between(c, 0.0, 1.0)
    else:  # over and back, where the path turns between its ends
        turn = _between((c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c[4], 0.0), 0.0, 1.0)
        if (c[0] + turn * (c[1] + turn * (c[2] + turn * (c[3] + turn * c[4])))) * x_0 < 0.0:
            first, last = _between(c, 0.0, turn), _between(c, turn, 1.0)
    to_first = first * (c[0] + first * (c[1] / 2.0 + first * (c[2] / 3.0 + first * (c[3] / 4.0 + first * c[4] / 5.0))))
    to_last = last * (c[0] + last * (c[1] / 2.0 + last * (c[2] / 3.0 + last * (c[3] / 4.0 + last * c[4] / 5.0))))
    return h * (abs(to_first) + abs(to_last - to_first) + abs(mean - to_last))


@numba.njit(forceinline=True, **OPTIONS)
def touches(e_0, rate_0, e_1, rate_1, h):
    """Whether a path with both ends on one side turns so close to zero in between that it may reach over."""
    turns = (e_0 * e_1 >= 0.0) & (e_0 * rate_0 < 0.0) & (e_1 * rate_1 > 0.0)
    return turns & (min(abs(e_0), abs(e_1)) < h * (abs(rate_0) + abs(rate_1)))


NEAR: Final = 0.4142135623730951  # sqrt(2) - 1, to which `arctan_near` reaches


@numba.njit(forceinline=True, **OPTIONS)
def arctan(x):
    """Arc tangent to 3e-10, without a branch."""
    a = abs(x)
    far, mid = a > 2.414213562373095, a > NEAR
    z = select(far, -1.0, select(mid, a - 1.0, a)) / select(far, a, select(mid, a + 1.0, 1.0))
    offset = select(far, 0.5 * math.pi, select(mid, 0.25 * math.pi, 0.0))
    return math.copysign(fma(z, _arctan_series(z * z), offset), x)


@numba.njit(forceinline=True, **OPTIONS)
def arctan_near(x):
    """The same bits between -NEAR and NEAR, without a division."""
    return x * _arctan_series(x * x)


@numba.njit(forceinline=True, **OPTIONS)
def _arctan_series(s):
    s_2 = s * s
    high = fma(s, -0.14239520492592156, 0.19998182383953952)
    high = fma(s_2, fma(s, -0.060260709468774064, 0.10569738007378487), high)
    return fma(s_2, high, fma(s, -0.3333330688086095, 0.999999999370875))


@numba.njit(forceinline=True, **OPTIONS)
def sine(x):
    """Sine of an angle between -pi and pi to 3e-11, without a branch."""
    a = abs(x)
    z = min(a, math.pi - a)
    s = z * z
    p = fma(s, fma(s, -2.3889103098752917e-08, 2.752526342288838e-06), -0.00019840861056042458)
    return math.copysign(
        z * fma(s, fma(s, fma(s, p, 0.00833333097324863), -0.16666666616789771), 0.9999999999829079), x
    )


@numba.njit(forceinline=True, **OPTIONS)
def cosine(x):
    """Cosine of an angle between -3/2 pi and 3/2 pi, without a branch."""
    return sine(0.5 * math.pi - abs(x))


@numba.njit(forceinline=True, **OPTIONS)
def sine_and_cosine(x):
    """Both of an angle between -pi/2 and pi/2 to 3e-11 and 3e-10."""
    s = x * x
    s_2 = s * s
    high = fma(s, -0.0001984086117768862, 0.00833333097418828)
    high = fma(s_2, fma(s, -2.3889217031975295e-08, 2.752526975389417e-06), high)
    sin_x = x * fma(s_2, high, fma(s, -0.16666666616814685, 0.9999999999829183))
    high = fma(s, -0.0013888360284140843, 0.041666636159695604)
    high = fma(s_2, fma(s, -2.60506573321564e-07, 2.4760109662353647e-05), high)
    return sin_x, fma(s_2, high, fma(s, -0.49999999355436703, 0.999999999779153))


_TERMS: Final = 12  # of each series of a tyre
TYRE_SERIES: Final = 2 * _TERMS + 2


@functools.lru_cache
def tyre_series(shape: float) -> FloatArray:
    """Numbers by which `tyre_force` works for a shape factor C from 1 to 2.

    Series in x^2 of sin(C arctan x)/x and of cos(C arctan x) on [0, 1], interpolated at Chebyshev's points, then sine
    and cosine of C pi/2.
    """
    from numpy.polynomial import Chebyshev, Polynomial

    def series(function: Callable[[FloatArray], FloatArray]) -> FloatArray:
        fitted = Chebyshev.interpolate(lambda s: function(np.sqrt(s)), _TERMS - 1, domain=[0.0, 1.0])
        return np.asarray(fitted.convert(kind=Polynomial).coef)

    sines = series(lambda x: np.sin(shape * np.arctan(x)) / x)
    cosines = series(lambda x: np.cos(shape * np.arctan(x)))
    limit = 0.5 * math.pi * shape
    return np.concatenate([sines, cosines, [math.sin(limit), math.cos(limit)]])


@numba.njit(forceinline=True, **OPTIONS)
def _series(c, k, s):
    """Sum of twelve terms c_k, c_k+1 s, ..."""
    s_2 = s * s
    s_4 = s_2 * s_2
    low = fma(s_2, fma(s, c[k + 3], c[k + 2]), fma(s, c[k + 1], c[k]))
    mid = fma(s_2, fma(s, c[k + 7], c[k + 6]), fma(s, c[k + 5], c[k + 4]))
    high = fma(s_2, fma(s, c[k + 11], c[k + 10]), fma(s, c[k + 9], c[k + 8]))
    return fma(s_4, fma(s_4, high, mid), low)


@numba.njit(forceinline=True, **OPTIONS)
def tyre_force(c, k, x):
    """Lanes of sin(C arctan x) to 2e-9, with the numbers of `tyre_series` in c from k on.

    Beyond 1, with the arc tangent a of 1/x: sin(C (pi/2 - a)). Where no lane is, the same bits without a division.
    """
    a = abs(x)
    if not any_lane(a > 1.0):
        return x * _series(c, k, x * x)
    far = a > 1.0
    z = select(far, 1.0, a) / select(far, a, 1.0)
    sin_z, cos_z = z * _series(c, k, z * z), _series(c, k + _TERMS, z * z)
    return math.copysign(select(far, fma(c[k + 2 * _TERMS], cos_z, -c[k + 2 * _TERMS + 1] * sin_z), sin_z), x)


@numba.njit(forceinline=True, **OPTIONS)
def decay(x):
    """Exponential function of x <= 0 to 1e-12, without a branch; that of -60 below."""
    y = max(x, -60.0) * (1.0 / 256.0)
    p = fma(y, fma(y, 1.0 / 3628800.0, 1.0 / 362880.0), 1.0 / 40320.0)
    p = fma(y, fma(y, fma(y, p, 1.0 / 5040.0), 1.0 / 720.0), 1.0 / 120.0)
    p = fma(y, fma(y, fma(y, p, 1.0 / 24.0), 1.0 / 6.0), 0.5)
    p = fma(y, fma(y, p, 1.0), 1.0)
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return p * p


@numba.njit(forceinline=True, **OPTIONS)
def moments(z, rest):
    """Integrals of y^n exp(-z y/rest) from 0 to the rest, n = 0, 1, 2; without a branch."""
    fallen = decay(-z)
    # 2/3! + 2 z/4! + ..., the series of the last one where the closed form cancels
    s = fma(z, fma(z, 2.0 / 87178291200.0, 2.0 / 6227020800.0), 2.0 / 479001600.0)
    s = fma(z, fma(z, fma(z, s, 2.0 / 39916800.0), 2.0 / 3628800.0), 2.0 / 362880.0)
    s = fma(z, fma(z, fma(z, s, 2.0 / 40320.0), 2.0 / 5040.0), 2.0 / 720.0)
    s = fma(z, fma(z, fma(z, s, 2.0 / 120.0), 2.0 / 24.0), 2.0 / 6.0)
    far = (2.0 - fallen * (2.0 + z * (2.0 + z))) / max(z * z * z, 1e-300)
    i_2 = select(z < 1.0, fallen * s, far)
    i_1 = 0.5 * fma(z, i_2, fallen)
    i_0 = fma(z, i_1, fallen)
    return rest * i_0, rest * rest * i_1, rest * rest * rest * i_2


_BLOCK = 64


@numba.njit(cache=True, **OPTIONS)  # the same operations in the same order for every point
def clenshaw(z: FloatArray, coefficients: FloatArray, out: FloatArray) -> None:
    """Evaluate k series of at least three terms, `coefficients` (terms, k), at z (n,) into `out` (n, k).

    The recurrence of C. W. Clenshaw (1955), operation by operation as in ``numpy.polynomial.chebyshev.chebval``.
    """
    terms = coefficients.shape[0]
    inner, outer, twice = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    for start in range(0, z.size, _BLOCK):
        count = min(_BLOCK, z.size - start)
        for i in range(count):
            twice[i] = 2.0 * z[start + i]
        for j in range(coefficients.shape[1]):
            inner[:] = coefficients[terms - 2, j]
            outer[:] = coefficients[terms - 1, j]
            for term in range(terms - 3, -1, -1):
                c = coefficients[term, j]
                for i in range(count):
                    before = inner[i]
                    inner[i] = c - outer[i]
                    outer[i] = before + outer[i] * twice[i]
            for i in range(count):
                out[start + i, j] = inner[i] + outer[i] * z[start + i]
