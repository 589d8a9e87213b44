"""Frozen integration points: a rank-1 lattice with Sidi's sine transformation.

The points depend on their number and dimension only, never on the integrand, so whatever is computed from them is a
smooth deterministic function of a component's parameters.

References
----------
Sloan and Joe, *Lattice Methods for Multiple Integration*, 1994; Nuyens and Cools, Math. Comp. 75:903-920, 2006
(component by component); Sidi, *A new variable transformation for numerical integration*, 1993.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_GAMMA: Final = 0.5
_GENERATORS: Final = {
    1021: (1, 374, 420, 154, 352, 61, 50, 383, 407, 391),
    4093: (1, 1715, 452, 289, 799, 1457, 1217, 595, 1034, 1738),
}
"""Results of `generator`, kept because the search takes half a second."""


_SMOOTH_UP_TO: Final = 6
"""Most variables for which Sidi's second order pays; beyond, its uneven weights cost more than its smoothness gains
(measured: eight variables, 4,093 points, covariance error 1.3e-3 by the first order and 2.1e-3 by the second)."""


@dataclasses.dataclass(frozen=True)
class Lattice:
    """n points in the unit cube as logarithms of u and 1 - u, and their weights.

    Attributes
    ----------
    log_u, log_1mu : (dimension, n)
        Both logarithms, so that neither end loses digits.
    log_weight : (n,)
        Logarithm of the weights, summing to one, for integrands of all variables but the last.
    log_last : (n,)
        What the last variable adds to `log_weight` for integrands of all variables.
    """

    log_u: FloatArray
    log_1mu: FloatArray
    log_weight: FloatArray
    log_last: FloatArray


def generator(n: int, dimension: int) -> tuple[int, ...]:
    """Component-by-component generating vector for n points (an odd prime) in a Korobov space of smoothness 2.

    An entry is used once only: a repeated one would make two coordinates equal.

    Examples
    --------
    >>> generator(1021, 3)
    (1, 374, 420)
    """
    k = np.arange(n)
    kernel = _GAMMA * 2.0 * np.pi**2 * ((k / n) ** 2 - k / n + 1.0 / 6.0)
    candidates = np.arange(1, (n + 1) // 2)
    table = kernel[np.outer(candidates, k) % n]
    chosen = [1]
    product = 1.0 + kernel
    while len(chosen) < dimension:
        error = table @ product
        error[np.array(chosen) - 1] = np.inf
        chosen.append(int(candidates[np.argmin(error)]))
        product *= 1.0 + kernel[(chosen[-1] * k) % n]
    return tuple(chosen[:dimension])


@functools.lru_cache(maxsize=32)
def lattice(n: int, dimension: int) -> Lattice:
    """The points for `dimension` variables; n is an odd prime."""
    known = _GENERATORS.get(n, ())
    z = np.array(known[:dimension] if dimension <= len(known) else generator(n, dimension), dtype=np.int64)
    # half a cell off the origin: with n odd no coordinate is ever 0 or 1
    t = ((np.outer(z, np.arange(n)) % n) / n + 0.5) % 1.0
    if dimension <= _SMOOTH_UP_TO:
        u, rest = _sidi(t), _sidi(1.0 - t)
        log_jacobian = np.log(1.0 - np.cos(2.0 * np.pi * t))
    else:
        u, rest = np.sin(0.5 * np.pi * t) ** 2, np.cos(0.5 * np.pi * t) ** 2
        log_jacobian = np.log(0.5 * np.pi * np.sin(np.pi * t))
    log_weight = np.sum(log_jacobian[:-1], axis=0)
    log_weight -= np.log(np.sum(np.exp(log_weight)))
    points = Lattice(np.log(u), np.log(rest), log_weight, log_jacobian[-1])
    for array in (points.log_u, points.log_1mu, points.log_weight, points.log_last):
        array.setflags(write=False)
    return points


def _sidi(t: FloatArray) -> FloatArray:
    """Sidi's transformation of order two, t - sin(2 pi t)/(2 pi); a series keeps it exact near zero."""
    angle = 2.0 * np.pi * t
    small = angle < 0.05
    series = angle**3 / 6.0 * (1.0 - angle**2 / 20.0 * (1.0 - angle**2 / 42.0))
    out: FloatArray = np.where(small, series, angle - np.sin(angle)) / (2.0 * np.pi)
    return out
