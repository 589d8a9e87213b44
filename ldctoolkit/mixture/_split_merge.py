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

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._expectation import Components, Statistics, log_terms
from ldctoolkit.mixture._maximisation import Prior, maximise, objective
from ldctoolkit.mixture._starts import local_covariance, start_from_clusters
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

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
    """One candidate.

    Attributes
    ----------
    split, merged : int, (int, int)
        Which component is split and which two are merged.
    gain : float
        Least change of the log-likelihood, by the bounds.
    start : Components
        Where EM is to go on from.
    """

    split: int
    merged: tuple[int, int]
    gain: float
    start: Components


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
    """Candidates, the most promising first.

    Parameters
    ----------
    z : (n, d)
        Standardised events.
    weight : (n,)
        Events that each row stands for.
    stats : Statistics
        Of the E-step at `now`.
    now : TruncatedNormal
        K components.
    shares_now : (n, K)
        Their shares in the rows.
    strength : float
        Pseudo-events of the prior.
    points : int
        Lattice points.
    run : callable
        A small EM, for the splits.
    rng : Generator
        For the splits' starts.
    """
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
