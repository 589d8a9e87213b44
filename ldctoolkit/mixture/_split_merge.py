"""Ways out of a local optimum: one component is split, two others are merged, and EM decides.

EM from k-means often ends with two components on one group and one component across two. Such faults are found by
bounds that need no run: with the shares r_k of the events held, Jensen's inequality gives for any change of some
components the least that the log-likelihood gains, up to events of which a component that is split has next to no
share. For a merger of i and j it needs their added statistics only, for a split of k a small EM on the events weighted
by r_k.

References
----------
Ueda, Nakano, Ghahramani, Hinton, *SMEM algorithm for mixture models*, Neural Computation 12:2109-2128, 2000: the moves;
the bounds that rank them are written down here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._expectation import Components, Statistics, log_terms
from ldctoolkit.mixture._maximisation import Prior, maximise, objective
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

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


_MERGER_STEPS: Final = 4
_LEAST_SHARE: Final = 1e-3
"""Events of which a component has less than this share tell nothing of its shape."""

_JITTER: Final = 1e-9
_WITHIN: Final = (0.4, 1.6)
_PAIRS: Final = 3
"""Mergers that are looked at, times K: those of the most overlapping pairs."""

_REPEATS: Final = 2
_SPLITS: Final = 12
"""Components that are tried to be split: those with most events, where a misfit counts most."""


Run = Callable[[FloatArray, FloatArray, Components], tuple[Components, float]]
"""From rows, weights and two components: these after a few passes, and the log-likelihood of the rows."""


@dataclasses.dataclass(frozen=True)
class Move:
    """One candidate."""

    split: int  # which component is split and which two are merged
    merged: tuple[int, int]  # which component is split and which two are merged
    gain: float  # least change of the log-likelihood, by the bounds
    start: Components  # where EM is to go on from


def best_moves(
    z: FloatArray,
    weight: FloatArray,
    stats: Statistics,
    now: TruncatedNormal,
    shares_now: FloatArray,
    *,
    strength: float,
    points: int,
    run: Run,
    rng: np.random.Generator,
) -> list[Move]:
    """Candidates, the most promising first."""
    pairs, mu_m, Sigma_m, log_p_m, merger = _mergers(weight, stats, now, shares_now, strength, points)
    out = []
    largest = np.argsort(-stats.counts, kind="stable")[:_SPLITS]
    for k in np.sort(largest).tolist():
        found = _split(z, weight * shares_now[:, k], now, k, run, rng)
        if found is None:
            continue
        two, split = found
        for m, (i, j) in enumerate(pairs):
            if k in (i, j):
                continue
            weights, mu, Sigma = stats.counts / stats.counts.sum(), now.mu.copy(), now.Sigma.copy()
            mu[i], Sigma[i] = mu_m[m], Sigma_m[m]
            mu[[k, j]], Sigma[[k, j]] = two.mu, two.Sigma
            weights[i] += weights[j]
            weights[[k, j]] = weights[k] * two.weights
            log_p = now.log_probability.copy()
            log_p[i], log_p[[k, j]] = log_p_m[m], two.log_p
            start = Components(weights, mu, Sigma, log_p)
            out.append(Move(k, (i, j), split + float(merger[m]), start))
    return _varied(sorted(out, key=lambda move: -move.gain))


def _varied(ranked: list[Move]) -> list[Move]:
    """Each split and each merger twice at most: their neighbours in the ranking tell the same."""
    used: dict[object, int] = {}
    out = []
    for move in ranked:
        if max(used.get(move.split, 0), used.get(move.merged, 0)) < _REPEATS:
            for part in (move.split, move.merged):
                used[part] = used.get(part, 0) + 1
            out.append(move)
    return out


def _split(
    z: FloatArray, weight: FloatArray, now: TruncatedNormal, k: int, run: Run, rng: np.random.Generator
) -> tuple[Components, float] | None:
    """Two components for the events of one, and what they gain at least; None where the events do not carry two."""
    rows = weight > _LEAST_SHARE
    x, w = z[rows], weight[rows]
    if w.size == 0 or w.sum() < 2.0 * (z.shape[1] + 1):
        return None
    d = x.shape[1]
    shape = np.cov(x.T, aweights=w, bias=True).reshape(d, d) + _JITTER * np.eye(d)
    # side by side, sought in the component's own shape (its misfit counts, not its length), or one within the other
    beside = start_from_clusters(x, w, 2, rng, whiten=np.asarray(np.linalg.cholesky(shape), dtype=float))
    centre = np.tile(w @ x / w.sum(), (2, 1))
    within = Components(np.array([0.5, 0.5]), centre, np.array(_WITHIN)[:, None, None] * shape, np.zeros(2))
    two, value = max((run(x, w, start) for start in (beside, within)), key=lambda end: end[1])
    one = Components(np.ones(1), now.mu[[k]], now.Sigma[[k]], now.log_probability[[k]])
    return two, value - float(w @ log_terms(x, one)[:, 0])


def _mergers(
    weight: FloatArray,
    stats: Statistics,
    now: TruncatedNormal,
    shares_now: FloatArray,
    strength: float,
    points: int,
) -> tuple[list[tuple[int, int]], FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pairs, the components in their place with ln P, and what the mergers gain at least (a loss, as a rule)."""
    K = now.mu.shape[0]
    overlap = (shares_now * weight[:, None]).T @ shares_now
    size = np.sqrt(np.diagonal(overlap))
    overlap /= np.maximum(np.outer(size, size), 1e-300)
    i, j = np.triu_indices(K, 1)
    chosen = np.sort(np.argsort(-overlap[i, j], kind="stable")[: _PAIRS * K])
    i, j = i[chosen], j[chosen]
    n_i, n_j = stats.counts[i], stats.counts[j]
    n = np.maximum(n_i + n_j, 1e-300)
    a, b = (n_i / n)[:, None], (n_j / n)[:, None]
    mean = a * stats.mean[i] + b * stats.mean[j]
    gap = stats.mean[i] - stats.mean[j]
    scatter = a[:, :, None] * stats.scatter[i] + b[:, :, None] * stats.scatter[j]
    scatter += (a * b)[:, :, None] * gap[:, :, None] * gap[:, None, :]
    merged = Statistics(0.0, n, mean, scatter)
    target = local_covariance(scatter, n, np.einsum("k,kij->ij", n / n.sum(), scatter))
    t = TruncatedNormal(mean, target, now.lower, now.upper, points=points)
    prior = Prior(strength, target)
    for _ in range(_MERGER_STEPS):
        t, _ = maximise(merged, prior, t, "newton", points)
    plain = Prior(0.0, stats.scatter)
    alone = objective(stats, plain, now) + _x_log_x(stats.counts)
    together = objective(merged, Prior(0.0, target), t) + _x_log_x(n)
    own = weight @ _x_log_x(shares_now)
    both = np.array([weight @ _x_log_x(shares_now[:, p] + shares_now[:, q]) for p, q in zip(i, j, strict=True)])
    gain = together - alone[i] - alone[j] + own[i] + own[j] - both
    return [(int(p), int(q)) for p, q in zip(i, j, strict=True)], t.mu, t.Sigma, t.log_probability, gain


def _x_log_x(x: FloatArray) -> FloatArray:
    out: FloatArray = x * np.log(np.maximum(x, 1e-300))
    return out
