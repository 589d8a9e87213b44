"""A leap from three points of an EM run (SQUAREM: Varadhan and Roland, Scand. J. Statist. 35:335-353, 2008, eq. 8).

Where components overlap, EM creeps: each pass goes nearly as far as the last one, in nearly the same direction. With
r = p1 - p0 and v = p2 - 2 p1 + p0 the leap is p0 + 2 s r + s^2 v, s = |r|/|v|; s = 1 is p2, and where each pass shrinks
the error by one factor the leap ends at the limit. Points are natural parameters and logarithms of weights: there a
normal that lies far outside its box moves along a straight line. Whoever leaps must check that the objective gained.
"""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._maximisation import LEAST_LOG_PROBABILITY
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

_SHORTEST: Final = 1.01
_LEAST_PRECISION: Final = 0.1
"""A leap keeps this share of every precision, in units of the middle point's."""


@dataclasses.dataclass(frozen=True)
class Point:
    """Weights (K,) and components of one pass."""

    weights: FloatArray
    truncated: TruncatedNormal


@dataclasses.dataclass(frozen=True)
class Leap:
    """Where a leap ended, and its length s."""

    point: Point
    length: float


def leap(first: Point, second: Point, third: Point, *, longest: float, points: int) -> Leap | None:
    """A point beyond the third of three successive ones.

    Parameters
    ----------
    first, second, third : Point
        Of the same K components, in the same order of integration.
    longest : float
        Largest length s that is trusted.
    points : int
        Lattice points.

    Returns
    -------
    Leap or None
        None where nothing longer than the way to the third point leaves components that can be integrated.
    """
    G = np.linalg.cholesky(second.truncated.Sigma)
    centre = second.truncated.mean
    places = [_whitened(p, G, centre, second.weights) for p in (first, second, third)]
    # components count by their share of the events
    share = np.sqrt(second.weights)[:, None]
    r, v = (share * step for step in (places[1] - places[0], places[2] - 2.0 * places[1] + places[0]))
    s = float(np.clip(np.linalg.norm(r) / max(float(np.linalg.norm(v)), 1e-300), 1.0, longest))
    while s > _SHORTEST:
        target = places[0] + 2.0 * s * (places[1] - places[0]) + s**2 * (places[2] - 2.0 * places[1] + places[0])
        end = _unwhitened(target, G, centre, second.truncated, points)
        if end is not None:
            return Leap(end, s)
        s = 1.0 + 0.5 * (s - 1.0)
    return None


def _whitened(p: Point, G: FloatArray, centre: FloatArray, typical: FloatArray) -> FloatArray:
    """Log weight, slope of the log-density at `centre` and precision, in units of G, (K, 1 + d + d^2)."""
    log_weight = np.log(p.weights)
    log_weight = log_weight - typical @ log_weight  # their common part is the sum's, and no straight line
    K, d = centre.shape
    precision = np.linalg.inv(p.truncated.Sigma)
    slope = precision @ (p.truncated.mu - centre)[:, :, None]
    flat = (G.transpose(0, 2, 1) @ precision @ G).reshape(K, d * d)
    return np.concatenate([log_weight[:, None], (G.transpose(0, 2, 1) @ slope)[:, :, 0], np.sqrt(0.5) * flat], axis=1)


def _unwhitened(
    place: FloatArray, G: FloatArray, centre: FloatArray, like: TruncatedNormal, points: int
) -> Point | None:
    K, d = centre.shape
    precision = np.sqrt(2.0) * place[:, 1 + d :].reshape(K, d, d)
    precision = 0.5 * (precision + precision.transpose(0, 2, 1))
    if not np.isfinite(place).all() or np.linalg.eigvalsh(precision)[:, 0].min() < _LEAST_PRECISION:
        return None
    white = np.linalg.inv(precision)
    mu = centre + (G @ white @ place[:, 1 : 1 + d, None])[:, :, 0]
    Sigma = G @ white @ G.transpose(0, 2, 1)
    Sigma = 0.5 * (Sigma + Sigma.transpose(0, 2, 1))
    order = None if like.box is None else like.box.order
    t = TruncatedNormal(mu, Sigma, like.lower, like.upper, points=points, order=order)
    if t.log_probability.min() < LEAST_LOG_PROBABILITY or (t.box is not None and not np.isfinite(t.box.log_peak).all()):
        return None
    weights = np.exp(place[:, 0] - place[:, 0].max())
    return Point(weights / weights.sum(), t)
