"""The standard normal restricted to an interval: mass, moments and quantiles that keep their digits in the tails."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_LOG_ROOT_2PI: Final = 0.5 * float(np.log(2.0 * np.pi))
_NARROW: Final = 1e-3
"""Below this width (times 1 + |midpoint|) the mass is taken from a series: the difference of two CDFs cancels."""


def _log_density(z: FloatArray) -> FloatArray:
    out: FloatArray = -0.5 * z * z - _LOG_ROOT_2PI
    return out


def log_mass(a: FloatArray, b: FloatArray) -> FloatArray:
    """Logarithm of Phi(b) - Phi(a), for a < b, infinite ends allowed.

    Examples
    --------
    >>> import numpy as np
    >>> round(float(log_mass(np.array([30.0]), np.array([np.inf]))[0]), 6)
    -454.321244
    """
    from scipy.special import log_ndtr  # here, so that importing the package stays fast

    low, high, _ = _to_left_tail(a, b)
    return _log_mass_left(low, high, log_ndtr(low), log_ndtr(high))


def _to_left_tail(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Mirror the intervals that lie mostly right of zero: log_ndtr and ndtri_exp are exact on the left."""
    flip = a > -b
    return np.where(flip, -b, a), np.where(flip, -a, b), flip


def _log_mass_left(low: FloatArray, high: FloatArray, log_low: FloatArray, log_high: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        out: FloatArray = log_high + np.log1p(-np.exp(log_low - log_high))
        width, middle = high - low, 0.5 * (high + low)
        narrow = width * (1.0 + np.abs(middle)) < _NARROW
        if np.any(narrow):
            series = np.log(width) + _log_density(middle) + np.log1p(width**2 * (middle**2 - 1.0) / 24.0)
            out = np.where(narrow, series, out)
    return out


def mean_and_second(a: FloatArray, b: FloatArray, log_p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """E z and E z^2 of the standard normal on (a, b), given ``log_p = log_mass(a, b)``."""
    density_a, density_b = np.exp(_log_density(a) - log_p), np.exp(_log_density(b) - log_p)
    mean: FloatArray = density_a - density_b
    ends = np.where(np.isfinite(a), a, 0.0) * density_a - np.where(np.isfinite(b), b, 0.0) * density_b
    return mean, 1.0 + ends


def mass_and_quantile(
    a: FloatArray, b: FloatArray, log_u: FloatArray, log_1mu: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`log_mass`, and the z in (a, b) below which a share u of that mass lies; u is given as log u and log(1 - u)."""
    from scipy.special import log_ndtr, ndtri_exp

    low, high, flip = _to_left_tail(a, b)
    log_low, log_high = log_ndtr(low), log_ndtr(high)
    mass = _log_mass_left(low, high, log_low, log_high)
    upper_share = np.where(flip, log_1mu, log_u)
    lower_share = np.where(flip, log_u, log_1mu)
    z = ndtri_exp(np.minimum(np.logaddexp(lower_share + log_low, upper_share + log_high), 0.0))
    z = np.where(flip, -z, z)
    out: FloatArray = np.clip(z, a, b)
    return mass, out
