"""Separation of variables for Gaussians truncated to one box: reordering, Cholesky factor, minimax tilt, integration.

All functions work on K components at once; the bounds are relative to each component's mean, (K, p).

Frozen integration points: a rank-1 lattice with Sidi's sine transformation.

The points depend on their number and dimension only, never on the integrand, so whatever is computed from them is a
smooth deterministic function of a component's parameters.

References
----------
Genz (1992); Gibson, Glasbey, Elston (1994) for the order; Botev, JRSS B 79(1):125-148 (2017) for the tilt.
Sloan and Joe, *Lattice Methods for Multiple Integration*, 1994; Nuyens and Cools, Math. Comp. 75:903-920, 2006
(component by component); Sidi, *A new variable transformation for numerical integration*, 1993.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture._tilt import minimax_tilt
from ldctoolkit.mixture._univariate import Restricted, log_mass

_CACHED: Final = 16_384
"""Points times components handled at once, so that they stay in the second cache; it changes no number."""


@dataclasses.dataclass(frozen=True)
class Separation:
    """K boxes made ready for one-variable-at-a-time integration.

    Attributes
    ----------
    order : (K, p) int
        Variables in the order in which they are integrated.
    factor : (K, p, p)
        G with x - mu = G z and G G^T = Sigma; its rows are in the caller's order of variables.
    strict : (K, p, p)
        Cholesky factor in the integration order, rows over their diagonal, without the diagonal.
    lower, upper : (K, p)
        Bounds in the integration order over the factor's diagonal.
    tilt : (K, p)
        Minimax tilt; the last entry is zero, and so is the whole row where Newton's method failed.
    log_peak : (K,)
        Largest value of the log weight psi over the box at that tilt; infinite where Newton's method failed.
    """

    order: IntArray
    factor: FloatArray
    strict: FloatArray
    lower: FloatArray
    upper: FloatArray
    tilt: FloatArray
    log_peak: FloatArray


@dataclasses.dataclass(frozen=True)
class WhitenedMoments:
    """Results of the integration in whitened coordinates z.

    Attributes
    ----------
    log_p : (K,)
        Logarithm of the probability of the box.
    mean : (K, p)
        E z inside the box.
    second : (K, p, p)
        E z z^T inside the box.
    covariance : (K, p, p)
        Covariance of z inside the box, without the cancellation of a far mean.
    points : (K, p, n)
        Weighted points inside the box.
    weights : (K, n)
        Their weights, summing to one.
    """

    log_p: FloatArray
    mean: FloatArray
    second: FloatArray
    covariance: FloatArray
    points: FloatArray
    weights: FloatArray


def integration_order(covariance: FloatArray, lower: FloatArray, upper: FloatArray) -> IntArray:
    """Variables with the least conditional probability first (Gibson, Glasbey and Elston), (K, p)."""
    K, p = lower.shape
    S = covariance.copy()  # conditional covariance given the variables chosen so far
    shift = np.zeros((K, p))  # conditional mean, the chosen ones at their truncated mean
    order = np.empty((K, p), dtype=np.int64)
    left = np.ones((K, p), dtype=bool)
    rows = np.arange(K)
    for step in range(p):
        deviation = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 1e-300))
        a, b = (lower - shift) / deviation, (upper - shift) / deviation
        mass = log_mass(a, b)
        pick = np.argmin(np.where(left, mass, np.inf), axis=1)
        order[:, step], left[rows, pick] = pick, False
        at = (rows, pick)
        mean, _ = Restricted.of(a[at], b[at]).moments()
        column = S[rows, :, pick]
        shift = shift + column * (mean / deviation[at])[:, None]
        S = S - column[:, :, None] * column[:, None, :] / (deviation[at] ** 2)[:, None, None]
    return order


def separate(covariance: FloatArray, lower: FloatArray, upper: FloatArray, order: IntArray | None = None) -> Separation:
    """Order, factorise and tilt.

    Parameters
    ----------
    covariance : (K, p, p)
        Positive definite.
    lower, upper : (K, p)
        Bounds minus the component's mean.
    order : (K, p) int, optional
        A given order: frozen during a fit, where a change of order would make the likelihood jump.

    Raises
    ------
    InputError
        If a covariance is not positive definite.
    """
    K, p = lower.shape
    order = integration_order(covariance, lower, upper) if order is None else order
    rows = np.arange(K)[:, None]
    ordered = covariance[rows[:, :, None], order[:, :, None], order[:, None, :]]
    try:
        L = np.linalg.cholesky(ordered)
    except np.linalg.LinAlgError:
        raise InputError("truncated normal: a covariance matrix is not positive definite") from None
    diagonal = np.diagonal(L, axis1=1, axis2=2)
    strict = L / diagonal[:, :, None]
    strict[:, np.arange(p), np.arange(p)] = 0.0
    factor = np.empty_like(L)
    factor[rows, order] = L
    a, b = lower[rows, order] / diagonal, upper[rows, order] / diagonal
    if p > 1:
        tilt, log_peak = minimax_tilt(strict, a, b)
    else:
        tilt, log_peak = np.zeros((K, p)), log_mass(a, b)[:, 0]
    return Separation(order, factor, strict, a, b, tilt, log_peak)


def integrate(box: Separation, points: int) -> WhitenedMoments:
    """Probability and moments by the frozen lattice; the last variable is integrated analytically.

    Parameters
    ----------
    box : Separation
        K boxes.
    points : int
        Lattice points, an odd prime.

    Returns
    -------
    WhitenedMoments
        The last coordinate of `points` is drawn too (for the Fisher matrix), the moments use its conditional
        expectation instead.

    Notes
    -----
    Each variable is drawn from a distribution whose mean and variance given the ones before it are known. The moments
    are therefore sums of known ones and of differences from them, and those differences are weighted by how far the
    weights are from their average (control variates): where the weights are nearly equal, a far box or a weak
    correlation, the lattice's own error drops out.
    """
    K, p = box.lower.shape
    grid = lattice(points, p)
    at_once = max(1, _CACHED // points)
    parts = [_integrate(_component_rows(box, slice(k, k + at_once)), grid) for k in range(0, K, at_once)]
    if len(parts) == 1:
        return parts[0]
    names = [field.name for field in dataclasses.fields(WhitenedMoments)]
    return WhitenedMoments(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _component_rows(box: Separation, rows: slice) -> Separation:
    return Separation(**{field.name: getattr(box, field.name)[rows] for field in dataclasses.fields(Separation)})


def _integrate(box: Separation, grid: Lattice) -> WhitenedMoments:
    """All components at once."""
    K, p = box.lower.shape
    z = np.empty((K, p, grid.weight.size))
    expected, variance = np.empty_like(z), np.empty_like(z)
    log_weight = np.zeros((K, grid.weight.size))
    for j in range(p):
        mu = box.tilt[:, j, None]
        shift = (box.strict[:, j, None, :j] @ z[:, :j])[:, 0] + mu
        inner = Restricted.of(box.lower[:, j, None] - shift, box.upper[:, j, None] - shift)
        mean, variance[:, j] = inner.moments()
        expected[:, j] = mean + mu
        z[:, j] = inner.quantile(grid.u[j], grid.v[j]) + mu
        log_weight += inner.log_mass - z[:, j] * mu
    log_weight += 0.5 * np.sum(box.tilt**2, axis=1)[:, None]
    peak = log_weight.max(axis=1, keepdims=True)
    weights = np.exp(log_weight - peak) * grid.weight
    total = weights.sum(axis=1, keepdims=True)
    weights /= total
    drawn = weights * grid.last
    drawn /= drawn.sum(axis=1, keepdims=True)
    log_p = peak[:, 0] + np.log(total[:, 0])
    return _moments(z, expected, variance, weights, grid.weight, log_p, drawn)


def _moments(
    z: FloatArray,
    expected: FloatArray,
    variance: FloatArray,
    weights: FloatArray,
    lattice_weights: FloatArray,
    log_p: FloatArray,
    drawn: FloatArray,
) -> WhitenedMoments:
    """Mean and covariance with control variates, from points, their conditional moments and both sets of weights."""
    last = z.shape[1] - 1
    smooth = z.copy()
    smooth[:, last] = expected[:, last]
    noise = smooth - expected  # of expectation zero given the variables before; none in the last one
    W, L = weights[:, None, :], lattice_weights
    origin = smooth[:, :, 0]  # far outside, points differ in their last digits only: sums are taken from one of them
    mean = origin + (weights[:, None] @ (smooth - origin[:, :, None]).transpose(0, 2, 1))[:, 0] - noise @ L
    centred = smooth - mean[:, :, None]
    covariance = (centred * W) @ centred.transpose(0, 2, 1)
    # an entry i < j loses the lattice's sum of (z_i - mean_i) noise_j, an entry j, j that of noise_j^2 - variance_j
    # + 2 noise_j (expected_j - mean_j), all of expectation zero
    cross = np.triu((centred * L) @ noise.transpose(0, 2, 1), 1)
    covariance -= cross + cross.transpose(0, 2, 1)
    own = noise * (noise + 2.0 * (expected - mean[:, :, None])) - variance
    own[:, last] = 0.0
    diagonal = np.arange(last + 1)
    covariance[:, diagonal, diagonal] -= own @ L
    covariance[:, last, last] += np.sum(weights * variance[:, last], axis=1)
    second = covariance + mean[:, :, None] * mean[:, None, :]
    return WhitenedMoments(log_p, mean, second, covariance, z, drawn)


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
