"""E-step as matrix products: log N(x; mu, Sigma) is linear in the features (1, x_i, x_i x_j)."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_BLOCK: Final = 4096
"""Rows at a time; fixed, so that sums are formed in one order whatever the data's size."""

_FLOOR: Final = -100.0
"""Logits this far below a row's largest are raised to it: smaller shares would be denormal numbers, which are slow."""


@dataclasses.dataclass(frozen=True)
class Components:
    """Parameters of K components in the coordinates of the data.

    Attributes
    ----------
    weights : (K,)
        eta_k, the share of events.
    mu : (K, d)
        Means before truncation.
    Sigma : (K, d, d)
        Covariances before truncation.
    log_p : (K,)
        Logarithm of the probability of the box.
    """

    weights: FloatArray
    mu: FloatArray
    Sigma: FloatArray
    log_p: FloatArray


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Sums of an E-step.

    Attributes
    ----------
    log_likelihood : float
        Sum of ln f over the rows.
    counts : (K,)
        Expected events N_k.
    mean : (K, d)
        Weighted means.
    scatter : (K, d, d)
        Weighted covariances about those means.
    """

    log_likelihood: float
    counts: FloatArray
    mean: FloatArray
    scatter: FloatArray


def _features(x: FloatArray) -> FloatArray:
    i, j = np.triu_indices(x.shape[1])
    return np.concatenate([np.ones((x.shape[0], 1)), x, x[:, i] * x[:, j]], axis=1)


def _natural(c: Components) -> FloatArray:
    """Coefficients (features, K) of ln(eta_k g_k/P_k)."""
    d = c.mu.shape[1]
    i, j = np.triu_indices(d)
    precision = np.linalg.inv(c.Sigma)
    linear = (precision @ c.mu[:, :, None])[:, :, 0]
    _, log_det = np.linalg.slogdet(c.Sigma)
    with np.errstate(divide="ignore"):
        constant = np.log(c.weights) - c.log_p
    constant = constant - 0.5 * (d * np.log(2.0 * np.pi) + log_det + np.sum(c.mu * linear, axis=1))
    quadratic = -precision[:, i, j] * np.where(i == j, 0.5, 1.0)
    return np.concatenate([np.maximum(constant, -1e300)[:, None], linear, quadratic], axis=1).T


def log_terms(x: FloatArray, c: Components) -> FloatArray:
    """ln(eta_k g_k(x)/P_k), (n, K), without a check that x is inside the box."""
    theta = _natural(c)
    blocks = [_features(x[start : start + _BLOCK]) @ theta for start in range(0, x.shape[0], _BLOCK)]
    return np.concatenate(blocks) if blocks else np.empty((0, c.mu.shape[0]))


def log_sum(logits: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Row-wise ln sum exp, (n,), and the shares, (n, K)."""
    peak = logits.max(axis=1, keepdims=True)
    share = np.exp(np.maximum(logits - peak, _FLOOR))
    total = share.sum(axis=1, keepdims=True)
    return (peak + np.log(total))[:, 0], share / total


def expectation(x: FloatArray, c: Components) -> Statistics:
    """One pass over the data."""
    K, d = c.mu.shape
    theta = _natural(c)
    sums = np.zeros((K, theta.shape[0]))
    total = 0.0
    for start in range(0, x.shape[0], _BLOCK):
        features = _features(x[start : start + _BLOCK])
        value, share = log_sum(features @ theta)
        total += float(value.sum())
        sums += share.T @ features
    return Statistics(total, *_moments(sums, d))


def hard_statistics(x: FloatArray, label: npt.NDArray[np.int64], K: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Counts, means and covariances of given groups."""
    d = x.shape[1]
    sums = np.zeros((K, 1 + d + d * (d + 1) // 2))
    for k in range(K):
        sums[k] = _features(x[label == k]).sum(axis=0)
    return _moments(sums, d)


def _moments(sums: FloatArray, d: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    i, j = np.triu_indices(d)
    counts = sums[:, 0]
    safe = np.maximum(counts, 1e-300)[:, None]
    mean = sums[:, 1 : 1 + d] / safe
    second = np.empty((sums.shape[0], d, d))
    second[:, i, j] = second[:, j, i] = sums[:, 1 + d :] / safe
    return counts, mean, second - mean[:, :, None] * mean[:, None, :]
