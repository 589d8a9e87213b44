"""Separation of variables for Gaussians truncated to one box: reordering, Cholesky factor, minimax tilt, integration.

All functions work on K components at once; the bounds are relative to each component's mean, (K, p).

References
----------
Genz (1992); Gibson, Glasbey, Elston (1994) for the order; Botev, JRSS B 79(1):125-148 (2017) for the tilt.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._lattice import lattice
from ldctoolkit.mixture._univariate import FloatArray, log_mass, mass_and_quantile, mean_and_second

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

_NEWTON_STEPS: Final = 60
_TILT_TOLERANCE: Final = 1e-9


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
    points : (K, p, n)
        Weighted points inside the box.
    weights : (K, n)
        Their weights, summing to one.
    """

    log_p: FloatArray
    mean: FloatArray
    second: FloatArray
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
        mean, _ = mean_and_second(a[at], b[at], mass[at])
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
        tilt, log_peak = _minimax_tilt(strict, a, b)
    else:
        tilt, log_peak = np.zeros((K, p)), log_mass(a, b)[:, 0]
    return Separation(order, factor, strict, a, b, tilt, log_peak)


def _tilt_terms(
    strict: FloatArray, a: FloatArray, b: FloatArray, x: FloatArray, mu: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log weight psi (K,), its gradient (K, 2p) and the derivative of the truncated means (K, p)."""
    c = np.einsum("kij,kj->ki", strict, x)
    low, high = a - c - mu, b - c - mu
    mass = log_mass(low, high)
    mean, second = mean_and_second(low, high, mass)
    psi = np.sum(0.5 * mu**2 - x * mu + mass, axis=1)
    by_x = -mu + np.einsum("kij,ki->kj", strict, mean)
    by_mu = mu - x + mean
    return psi, np.concatenate([by_x, by_mu], axis=1), second - 1.0 - mean**2


def _minimax_tilt(strict: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Saddle point of psi(x; mu) by damped Newton, all components at once."""
    K, p = a.shape
    m = p - 1  # x_p and mu_p stay zero
    free = np.r_[0:m, p : p + m]
    eye = np.eye(m)
    # start: every variable at its truncated mean given the ones before it
    x = np.zeros((K, p))
    for j in range(m):
        c = np.einsum("ki,ki->k", strict[:, j], x)
        low, high = (a[:, j] - c), (b[:, j] - c)
        x[:, j], _ = mean_and_second(low, high, log_mass(low, high))
    mu = np.zeros((K, p))
    psi, gradient, slope = _tilt_terms(strict, a, b, x, mu)
    norm = np.linalg.norm(gradient[:, free], axis=1)
    # not below the rounding of the terms themselves, which grow with the distance to the box
    scale = 1.0 + np.abs(x).max(axis=1)
    open_ = norm > _TILT_TOLERANCE * scale
    for _ in range(_NEWTON_STEPS):
        if not open_.any():
            break
        k = np.flatnonzero(open_)
        J = np.zeros((k.size, 2 * m, 2 * m))
        s, d = strict[k], slope[k]
        J[:, :m, :m] = np.einsum("kia,ki,kib->kab", s[:, :, :m], d, s[:, :, :m])
        cross = d[:, :m, None] * s[:, :m, :m] - eye
        J[:, m:, :m] = cross
        J[:, :m, m:] = cross.transpose(0, 2, 1)
        J[:, m:, m:] = eye * (1.0 + d[:, :m])[:, :, None]
        try:
            step = np.linalg.solve(J, -gradient[k][:, free][:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            break
        t = np.ones(k.size)
        waiting = np.arange(k.size)
        for _ in range(30):
            kk = k[waiting]
            x_new, mu_new = x[kk].copy(), mu[kk].copy()
            x_new[:, :m] += t[waiting, None] * step[waiting, :m]
            mu_new[:, :m] += t[waiting, None] * step[waiting, m:]
            psi_new, gradient_new, slope_new = _tilt_terms(strict[kk], a[kk], b[kk], x_new, mu_new)
            norm_new = np.linalg.norm(gradient_new[:, free], axis=1)
            good = norm_new < (1.0 - 1e-3 * t[waiting]) * norm[kk]
            done = kk[good]
            x[done], mu[done], psi[done] = x_new[good], mu_new[good], psi_new[good]
            gradient[done], slope[done], norm[done] = gradient_new[good], slope_new[good], norm_new[good]
            waiting = waiting[~good]
            t[waiting] *= 0.5
            if waiting.size == 0:
                break
        scale = 1.0 + np.abs(x).max(axis=1)
        open_[k] = norm[k] > _TILT_TOLERANCE * scale[k]
        open_[k[waiting]] = False  # no further descent: judged below
    failed = ~(norm <= 1e-6 * scale)
    return np.where(failed[:, None], 0.0, mu), np.where(failed, np.inf, psi)


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
        The last coordinate of `points` is drawn too (for the Fisher matrix), mean and second moments use its
        conditional expectation instead.
    """
    K, p = box.lower.shape
    grid = lattice(points, p)
    z = np.empty((K, p, points))
    log_weight = np.repeat(grid.log_weight[None], K, axis=0)
    for j in range(p):
        c = np.einsum("ki,kin->kn", box.strict[:, j, :j], z[:, :j])
        mu = box.tilt[:, j, None]
        low, high = box.lower[:, j, None] - c - mu, box.upper[:, j, None] - c - mu
        mass, within = mass_and_quantile(low, high, grid.log_u[j], grid.log_1mu[j])
        z[:, j] = within + mu
        log_weight += 0.5 * mu**2 - z[:, j] * mu + mass
    mean_last, second_last = mean_and_second(low, high, mass)
    peak = log_weight.max(axis=1, keepdims=True)
    weights = np.exp(log_weight - peak)
    total = weights.sum(axis=1, keepdims=True)
    weights /= total
    log_p = peak[:, 0] + np.log(total[:, 0])
    smooth = np.concatenate([z[:, :-1], np.broadcast_to(mean_last[:, None], (K, 1, points))], axis=1)
    weighted = smooth * weights[:, None, :]
    mean = weighted.sum(axis=2)
    second = weighted @ smooth.transpose(0, 2, 1)
    second[:, -1, -1] = np.sum(weights * second_last, axis=1)
    drawn = weights * np.exp(grid.log_last)
    drawn /= drawn.sum(axis=1, keepdims=True)
    return WhitenedMoments(log_p, mean, second, z, drawn)
