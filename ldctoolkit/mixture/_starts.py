"""Starting values: k-means on standardised data, covariances of the clusters."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.mixture._expectation import hard_statistics

FloatArray = npt.NDArray[np.float64]

_LLOYD_PASSES: Final = 20
_VARIANCE_FLOOR: Final = 1e-6
"""Least eigenvalue of a local covariance, in units of the data's variance: repeated rows have none."""


def kmeans_labels(x: FloatArray, K: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Clusters (n,) by k-means++ seeding and Lloyd's passes; a cluster that empties restarts at the farthest row."""
    centres = np.empty((K, x.shape[1]))
    centres[0] = x[rng.integers(x.shape[0])]
    nearest = np.sum((x - centres[0]) ** 2, axis=1)
    for k in range(1, K):
        total = nearest.sum()
        chance = nearest / total if total > 0 else None
        centres[k] = x[rng.choice(x.shape[0], p=chance)]
        nearest = np.minimum(nearest, np.sum((x - centres[k]) ** 2, axis=1))
    label = np.full(x.shape[0], -1, dtype=np.int64)
    for _ in range(_LLOYD_PASSES):
        distance = np.sum(centres**2, axis=1) - 2.0 * x @ centres.T  # plus |x|^2, the same for every centre
        new = np.argmin(distance, axis=1).astype(np.int64)
        if np.array_equal(new, label):
            break
        label = new
        counts = np.bincount(label, minlength=K)
        for k in [int(i) for i in np.flatnonzero(counts)]:
            centres[k] = x[label == k].mean(axis=0)
        for k in [int(i) for i in np.flatnonzero(counts == 0)]:
            own = np.sum((x - centres[label]) ** 2, axis=1)
            far = int(np.argmax(own))
            centres[k], label[far] = x[far], k
    return label


def local_covariance(scatter: FloatArray, counts: FloatArray, overall: FloatArray) -> FloatArray:
    """Covariances (K, d, d) fit to be a prior's target: few events are shrunk to the overall shape, floors kept."""
    d = overall.shape[0]
    share = (d + 1.0) / (np.maximum(counts, 0.0) + d + 1.0)
    # a group of n events says nothing about its size when n is small: the overall variances, shrunk with K groups
    size = np.trace(scatter, axis1=1, axis2=2) / np.trace(overall)
    typical = float(np.average(size, weights=np.maximum(counts, 1e-12)))
    target = np.diag(np.diag(overall)) * max(typical, _VARIANCE_FLOOR)
    mixed = (1.0 - share)[:, None, None] * scatter + share[:, None, None] * target
    values, vectors = np.linalg.eigh(0.5 * (mixed + mixed.transpose(0, 2, 1)))
    floored = np.maximum(values, _VARIANCE_FLOOR)
    out: FloatArray = (vectors * floored[:, None, :]) @ vectors.transpose(0, 2, 1)
    return 0.5 * (out + out.transpose(0, 2, 1))


def start_from_clusters(x: FloatArray, K: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights (K,), means (K, d) and covariances (K, d, d) of k-means clusters."""
    label = kmeans_labels(x, K, rng)
    counts, mean, scatter = hard_statistics(x, label, K)
    Sigma = local_covariance(scatter, counts, np.cov(x.T, bias=True).reshape(x.shape[1], x.shape[1]))
    return (counts + 1.0) / (x.shape[0] + K), mean, Sigma
