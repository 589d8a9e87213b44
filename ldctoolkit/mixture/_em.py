"""Truncated EM on standardised data: short runs from several starts, then the best one to convergence."""

from __future__ import annotations

import dataclasses
from typing import Final, Literal

import numpy as np

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._expectation import Components, FloatArray, Statistics, expectation
from ldctoolkit.mixture._maximisation import Prior, Step, maximise, predicted_gain
from ldctoolkit.mixture._starts import local_covariance, start_from_clusters
from ldctoolkit.mixture.truncated_normal import MOMENT_POINTS, TruncatedNormal

_SHORT_POINTS: Final = 1021
_SMALL_DIMENSION: Final = 6
"""Up to so many bounded dimensions 1,021 points are enough for a whole fit (ln P to 1e-5)."""

_WINDOW: Final = 5
_LEAST_WEIGHT: Final = 1e-12

_STATIONARY: Final = 1e-6
"""A component that finds no step is at its optimum if its mean could add less than this per event [nats]: about 1e-3
standard deviations. The lattice's moments are its likelihood's gradient no better than to about 1e-4."""

_FALL: Final = 1e-8
"""A relative fall of the objective beyond this is no rounding: the E-step has lost its digits."""

StopReason = Literal["converged", "max_iter", "stuck", "collapsed"]


@dataclasses.dataclass(frozen=True)
class EMSettings:
    """What `fit_components` needs; bounds in the data's standardised units."""

    K: int
    lower: FloatArray
    upper: FloatArray
    seed: int
    n_init: int
    short_iter: int
    subsample: int
    tol: float
    max_iter: int
    prior_strength: float
    step: Step


@dataclasses.dataclass(frozen=True)
class EMResult:
    """Components at the end of a run, the penalised log-likelihood per event after each pass, and why it ended.

    "stuck": no step raised the objective, though it is not at a maximum. "collapsed": the objective fell, because a
    component had become too thin for the arithmetic; the components before that pass are kept.
    """

    components: Components
    history: FloatArray
    stop_reason: StopReason


def fit_components(x: FloatArray, s: EMSettings) -> EMResult:
    """Fit K components to standardised data (n, d) strictly inside the box.

    Raises
    ------
    InputError
        If a component shrinks onto so few distinct events that its covariance is singular: without a prior the
        likelihood has no maximum there.

    Notes
    -----
    The points and the order of integration are frozen during a run, so the likelihood is one smooth function. The
    prior's target is frozen too: for a short run the clusters' covariances, for the final run the covariances of the
    events around each component at its start.
    """
    try:
        return _fit(x, s)
    except np.linalg.LinAlgError:
        raise InputError(
            f"X: the likelihood has no maximum, a component shrinks onto too few distinct events with K = {s.K}, "
            f"prior_strength = {s.prior_strength:g}; raise prior_strength or fit fewer components"
        ) from None


def _fit(x: FloatArray, s: EMSettings) -> EMResult:
    n = x.shape[0]
    rng = np.random.default_rng([s.seed, 0])
    short = x if n <= s.subsample else x[np.sort(rng.choice(n, s.subsample, replace=False))]
    best: EMResult | None = None
    for run in range(s.n_init if s.K > 1 else 1):
        start = start_from_clusters(short, s.K, np.random.default_rng([s.seed, 1, run]))
        prior = Prior(s.prior_strength, start[2])
        result = _run(short, start, prior, s, s.short_iter, _SHORT_POINTS)
        if best is None or result.history[-1] > best.history[-1]:
            best = result
    if best is None:
        raise RuntimeError("no start was run")
    c = best.components
    stats = expectation(x, c)
    overall = np.cov(x.T, bias=True).reshape(x.shape[1], x.shape[1])
    prior = Prior(s.prior_strength, local_covariance(stats.scatter, stats.counts, overall))
    bounded = int(np.sum(np.isfinite(s.lower) | np.isfinite(s.upper)))
    points = _SHORT_POINTS if bounded <= _SMALL_DIMENSION else MOMENT_POINTS
    return _run(x, (c.weights, c.mu, c.Sigma), prior, s, s.max_iter, points)


def _run(
    x: FloatArray,
    start: tuple[FloatArray, FloatArray, FloatArray],
    prior: Prior,
    s: EMSettings,
    passes: int,
    points: int,
) -> EMResult:
    n = x.shape[0]
    weights = start[0] / start[0].sum()
    t = TruncatedNormal(start[1], start[2], s.lower, s.upper, points=points)

    def look() -> tuple[Statistics, float]:
        stats = expectation(x, Components(weights, t.mu, t.Sigma, t.log_probability))
        return stats, (stats.log_likelihood + float(prior.value(t.Sigma).sum())) / n

    stats, value = look()
    history = [value]
    reason: StopReason = "max_iter"
    for _ in range(passes):
        kept = weights, t
        new, moved = maximise(stats, prior, t, s.step, points)
        stuck = bool(np.any(~moved & (predicted_gain(stats, t) > _STATIONARY * n)))
        t = new
        weights = np.maximum(stats.counts, _LEAST_WEIGHT)
        weights = weights / weights.sum()
        stats, value = look()
        if not value >= history[-1] - _FALL * max(abs(history[-1]), 1.0):
            weights, t = kept
            reason = "collapsed"
            break
        history.append(value)
        if len(history) > _WINDOW and history[-1] - history[-1 - _WINDOW] < s.tol * _WINDOW:
            reason = "stuck" if stuck else "converged"
            break
    return EMResult(Components(weights, t.mu, t.Sigma, t.log_probability), np.array(history), reason)
