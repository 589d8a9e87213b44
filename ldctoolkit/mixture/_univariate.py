"""The standard normal restricted to intervals: mass, moments and quantiles that keep their digits in the tails."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray

_LOG_ROOT_2PI: Final = 0.5 * float(np.log(2.0 * np.pi))
_NARROW: Final = 1e-2
"""Below this width (times 1 + distance from zero) differences of CDFs and densities cancel: quadrature instead."""

_FAR: Final = 20.0
"""So far from zero the moments cancel too."""

_DEEP: Final = 36.0
"""So far from zero the CDF nears the smallest double: quantiles are taken from logarithms."""

_THREAD: Final = 1e-3
"""On intervals narrower than this the density is an exponential to seven digits: its quantile is explicit."""

_DEPTH: Final = 45.0
"""A far interval is integrated to where its density has fallen to exp(-45) of its largest."""

_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(32)


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Standard normals restricted to intervals, mirrored so that each lies mostly left of zero."""

    low: FloatArray  # (...): ends of the mirrored intervals
    high: FloatArray  # (...): ends of the mirrored intervals
    flip: BoolArray  # (...): which ones are mirrored
    at_low: FloatArray  # (...): phi(low), and Phi(high) - Phi(low)
    share: FloatArray  # (...)
    log_mass: FloatArray  # (...): logarithm of the mass
    special: BoolArray  # (...): far or narrow ones, whose mass and moments come from quadrature
    offset: FloatArray  # (special,): for those: high - E z, and Var z
    spread: FloatArray  # (special,)

    @classmethod
    def of(cls, a: FloatArray, b: FloatArray) -> Restricted:
        """Intervals (a, b), a < b; infinite ends are allowed."""
        from scipy.special import ndtr  # here, so that importing the package stays fast

        flip = a > -b
        low, high = np.where(flip, -b, a), np.where(flip, -a, b)
        at_low = ndtr(low)
        share = ndtr(high) - at_low
        with np.errstate(divide="ignore", invalid="ignore"):
            log_mass = np.log(share)
        special = (high < -_FAR) | (high - low < _NARROW / (1.0 + np.abs(high)))
        offset = spread = np.empty(0)
        if special.any():
            log_mass[special], offset, spread = _quadrature(low[special], high[special])
        return cls(low, high, flip, at_low, share, log_mass, special, offset, spread)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """E z and Var z, in the caller's orientation."""
        root = float(np.exp(-_LOG_ROOT_2PI))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at_low = root * np.exp(-0.5 * self.low**2) / self.share
            at_high = root * np.exp(-0.5 * self.high**2) / self.share
            mean = at_low - at_high
            # an infinite end has no density: 0 in place of 0 times infinity
            variance = 1.0 + np.where(at_low > 0.0, self.low, 0.0) * at_low
            variance -= np.where(at_high > 0.0, self.high, 0.0) * at_high + mean * mean
        if self.offset.size:
            mean[self.special] = self.high[self.special] - self.offset
            variance[self.special] = self.spread
        return np.where(self.flip, -mean, mean), variance

    def mean_between(self, a: FloatArray, b: FloatArray, shift: FloatArray) -> FloatArray:
        """E z + shift, where a and b are the ends plus that shift: no digits are lost to a large one."""
        out: FloatArray = self.moments()[0] + shift
        if self.offset.size:
            k = self.special
            out[k] = np.where(self.flip[k], a[k] + self.offset, b[k] - self.offset)
        return out

    def quantile(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """The z below which a share u of the mass lies; v = 1 - u, given apart so that neither end loses digits."""
        from scipy.special import ndtr, ndtri

        below, above = np.where(self.flip, v, u), np.where(self.flip, u, v)
        left, right = self.at_low + below * self.share, ndtr(-self.high) + above * self.share
        z = ndtri(np.minimum(left, right))
        z = np.where(left <= right, z, -z)
        if self.offset.size:
            k = self.special
            z[k] = _special_quantile(self.low[k], self.high[k], below[k], above[k], z[k])
        z = np.minimum(np.maximum(z, self.low), self.high)
        out: FloatArray = np.where(self.flip, -z, z)
        return out


def log_mass(a: FloatArray, b: FloatArray) -> FloatArray:
    """Logarithm of Phi(b) - Phi(a), for a < b, infinite ends allowed."""
    return Restricted.of(a, b).log_mass


def _quadrature(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithm of the mass, high - E z and Var z: Gauss-Legendre in the distance from the end nearer to zero."""
    depth = np.maximum(-high, 0.0)
    reach = np.minimum(high - low, 2.0 * _DEPTH / (depth + np.sqrt(depth**2 + 2.0 * _DEPTH)))
    reach = np.maximum(reach, np.spacing(depth))  # ends that rounding has made equal
    total, first, second = np.zeros_like(low), np.zeros_like(low), np.zeros_like(low)
    for t, w in zip(0.5 * (_NODES + 1.0), 0.5 * _NODE_WEIGHTS, strict=True):
        s = t * reach
        density = w * np.exp(s * (high - 0.5 * s))
        total += density
        first += density * t
        second += density * t * t
    first, second = first / total, second / total
    log_p = np.log(total * reach) - 0.5 * high**2 - _LOG_ROOT_2PI
    return log_p, first * reach, (second - first**2) * reach**2


def _special_quantile(
    low: FloatArray, high: FloatArray, below: FloatArray, above: FloatArray, z: FloatArray
) -> FloatArray:
    """`z`, bettered where it lies so deep, or the interval is so narrow, that the CDF has no digits left."""
    from scipy.special import log_ndtr, ndtri_exp

    deep = high < -_DEEP
    if deep.any():
        with np.errstate(divide="ignore"):
            one, two = np.log(above[deep]) + log_ndtr(low[deep]), np.log(below[deep]) + log_ndtr(high[deep])
        z[deep] = ndtri_exp(np.logaddexp(one, two))
    thread = high - low < _THREAD
    if thread.any():
        width = high[thread] - low[thread]
        rate = 0.5 * width - high[thread]
        width = np.maximum(width, 1e-300)  # ends that rounding has made equal
        rate = np.where(np.abs(rate * width) < 1e-9, 1e-9 / width, rate)
        z[thread] = high[thread] + np.log1p(above[thread] * np.expm1(-rate * width)) / rate
    return z
