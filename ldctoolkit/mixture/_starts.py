"""Starting values: k-means on standardised data, covariances of the clusters."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._expectation import Components

_LLOYD_PASSES: Final = 20
_VARIANCE_FLOOR: Final = 1e-6
"""Least eigenvalue of a local covariance, in units of the data's variance: repeated rows have none."""


def kmeans_labels(x: FloatArray, weight: FloatArray | None, K: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Clusters (n,) by k-means++ seeding and Lloyd's passes; a cluster that empties restarts at the farthest row."""
    w = np.ones(x.shape[0]) if weight is None else weight
    centres = np.empty((K, x.shape[1]))
    centres[0] = x[rng.choice(x.shape[0], p=w / w.sum())]
    nearest = np.sum((x - centres[0]) ** 2, axis=1)
    for k in range(1, K):
        total = (w * nearest).sum()
        chance = w * nearest / total if total > 0 else None
        centres[k] = x[rng.choice(x.shape[0], p=chance)]
        nearest = np.minimum(nearest, np.sum((x - centres[k]) ** 2, axis=1))
    label = np.full(x.shape[0], -1, dtype=np.int64)
    for _ in range(_LLOYD_PASSES):
        distance = np.sum(centres**2, axis=1) - 2.0 * x @ centres.T  # plus |x|^2, the same for every centre
        new = np.argmin(distance, axis=1).astype(np.int64)
        if np.array_equal(new, label):
            break
        label = new
        counts = np.bincount(label, weights=w, minlength=K)
        for k in [int(i) for i in np.flatnonzero(counts > 0)]:
            own = label == k
            centres[k] = w[own] @ x[own] / counts[k]
        for k in [int(i) for i in np.flatnonzero(~(counts > 0))]:
            far = int(np.argmax(w * np.sum((x - centres[label]) ** 2, axis=1)))
            centres[k], label[far] = x[far], k
    return label


def local_covariance(scatter: FloatArray, counts: FloatArray, overall: FloatArray) -> FloatArray:
    """Covariances (K, d, d) fit to be a prior's target: few events are shrunk to the overall shape, floors kept."""
    d = overall.shape[0]
    share = (d + 1.0) / (np.maximum(counts, 0.0) + d + 1.0)
    # a group of n events says nothing about its size when n is small: the overall variances, shrunk with K groups
    size = np.trace(scatter, axis1=1, axis2=2) / max(float(np.trace(overall)), 1e-300)
    typical = float(np.average(size, weights=np.maximum(counts, 1e-12)))
    target = np.diag(np.diag(overall)) * max(typical, _VARIANCE_FLOOR)
    mixed = (1.0 - share)[:, None, None] * scatter + share[:, None, None] * target
    values, vectors = np.linalg.eigh(0.5 * (mixed + mixed.transpose(0, 2, 1)))
    floored = np.maximum(values, _VARIANCE_FLOOR)
    out: FloatArray = (vectors * floored[:, None, :]) @ vectors.transpose(0, 2, 1)
    return 0.5 * (out + out.transpose(0, 2, 1))


def start_from_clusters(
    x: FloatArray, weight: FloatArray | None, K: int, rng: np.random.Generator, whiten: FloatArray | None = None
) -> Components:
    """Shares, means and covariances of k-means clusters, sought in ``whiten^-1 x``; the box is not looked at."""
    label = kmeans_labels(
        x if whiten is None else np.asarray(np.linalg.solve(whiten, x.T).T, dtype=float), weight, K, rng
    )
    w = np.ones(x.shape[0]) if weight is None else weight
    d = x.shape[1]
    counts, mean, scatter = np.zeros(K), np.zeros((K, d)), np.zeros((K, d, d))
    for k in range(K):
        rows, own = x[label == k], w[label == k]
        counts[k] = own.sum()
        if counts[k] > 0:
            mean[k] = own @ rows / counts[k]
            scatter[k] = ((rows - mean[k]).T * own) @ (rows - mean[k]) / counts[k]
    centre = w @ x / w.sum()
    overall = ((x - centre).T * w) @ (x - centre) / w.sum()
    Sigma = local_covariance(scatter, counts, overall)
    return Components((counts + 1.0) / (w.sum() + K), mean, Sigma, np.zeros(K))
