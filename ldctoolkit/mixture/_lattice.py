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

from ldctoolkit.arrays import FloatArray

_GAMMA: Final = {1021: 0.3, 4093: 0.5, 16381: 0.25}
"""Weight of a further variable in the search, for each number of points: of 0.2, 0.25, 0.3 and 0.5 the one with the
smallest worst error over hard boxes (equal correlations of 0.95 and -0.9, slabs, means far outside)."""

_GENERATORS: Final = {
    1021: (1, 374, 228, 286, 174, 355, 195, 31, 251, 43),
    4093: (1, 1210, 1542, 1785, 842, 1113, 1495, 437, 254, 1130),
    16381: (1, 6768, 7521, 2297, 7750, 1248, 7478, 1032, 5094, 5961),
}
"""Results of `generator`, kept so that no rounding within the search can change them."""

_FEWEST_FOR_SECOND_ORDER: Final = {7: 10_000, 8: 10_000}
"""Points from which Sidi's second order pays, by the number of variables: always up to six, never beyond eight; with
fewer points its uneven weights cost more than its smoothness gains (worst whitened covariance over hard boxes, eight
variables: 4,093 points, 6e-3 by the first order and 4e-2 by the second; 16,381 points, 6e-4 and 7e-4)."""


@dataclasses.dataclass(frozen=True)
class Lattice:
    """n points in the unit cube and their weights.

    Attributes
    ----------
    u, v : (dimension, n)
        Coordinates and one minus them, so that neither end loses digits.
    weight : (n,)
        Weights, summing to one, for integrands of all variables but the last.
    last : (n,)
        What the last variable multiplies `weight` by for integrands of all variables.
    """

    u: FloatArray
    v: FloatArray
    weight: FloatArray
    last: FloatArray


def generator(n: int, dimension: int) -> tuple[int, ...]:
    """Component-by-component generating vector for n points (an odd prime) in a Korobov space of smoothness 4.

    An entry is used once only: a repeated one would make two coordinates equal. The sums over points are convolutions
    over the multiplicative group modulo n, done by Fourier transform.

    Examples
    --------
    >>> generator(1021, 3)
    (1, 374, 228)
    """
    gamma = _GAMMA.get(n, 0.3)
    k = np.arange(n)
    x = k / n
    kernel = -gamma * (2.0 * np.pi) ** 4 / 24.0 * (x**4 - 2.0 * x**3 + x**2 - 1.0 / 30.0)
    power = _powers_of_a_root(n)
    inverse = np.roll(power[::-1], 1)
    spectrum = np.fft.rfft(kernel[power])
    chosen = [1]
    product = 1.0 + kernel
    while len(chosen) < dimension:
        error = np.empty(n)
        error[power] = np.fft.irfft(spectrum * np.fft.rfft(product[inverse]), n - 1)
        candidates = np.arange(1, (n + 1) // 2)  # n - z gives the same points as z
        candidates = np.setdiff1d(candidates, chosen)
        chosen.append(int(candidates[np.argmin(error[candidates])]))
        product *= 1.0 + kernel[(chosen[-1] * k) % n]
    return tuple(chosen[:dimension])


def _powers_of_a_root(n: int) -> npt.NDArray[np.int64]:
    """All powers of the least primitive root modulo the prime n, (n - 1,)."""
    for root in range(2, n):
        powers = [1]
        while (following := powers[-1] * root % n) != 1:
            powers.append(following)
        if len(powers) == n - 1:
            return np.array(powers, dtype=np.int64)
    raise ValueError(f"lattice: {n} points; allowed: an odd prime")


@functools.lru_cache(maxsize=32)
def lattice(n: int, dimension: int) -> Lattice:
    """The points for `dimension` variables; n is an odd prime."""
    known = _GENERATORS.get(n, ())
    z = np.array(known[:dimension] if dimension <= len(known) else generator(n, dimension), dtype=np.int64)
    # half a cell off the origin: with n odd no coordinate is ever 0 or 1
    t = ((np.outer(z, np.arange(n)) % n) / n + 0.5) % 1.0
    if n >= _FEWEST_FOR_SECOND_ORDER.get(dimension, 0 if dimension < 7 else n + 1):
        u, v = _sidi(t), _sidi(1.0 - t)
        jacobian = 1.0 - np.cos(2.0 * np.pi * t)
    else:
        u, v = np.sin(0.5 * np.pi * t) ** 2, np.cos(0.5 * np.pi * t) ** 2
        jacobian = 0.5 * np.pi * np.sin(np.pi * t)
    weight = np.prod(jacobian[:-1], axis=0)
    points = Lattice(u, v, weight / weight.sum(), jacobian[-1])
    for array in (points.u, points.v, points.weight, points.last):
        array.setflags(write=False)
    return points


def _sidi(t: FloatArray) -> FloatArray:
    """Sidi's transformation of order two, t - sin(2 pi t)/(2 pi); a series keeps it exact near zero."""
    angle = 2.0 * np.pi * t
    small = angle < 0.05
    series = angle**3 / 6.0 * (1.0 - angle**2 / 20.0 * (1.0 - angle**2 / 42.0))
    out: FloatArray = np.where(small, series, angle - np.sin(angle)) / (2.0 * np.pi)
    return out
