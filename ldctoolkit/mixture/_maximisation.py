"""M-step of the truncated EM: new means and covariances from the weighted statistics of an E-step.

Per component the objective is Q = N [E_data ln g(x) - ln P] + prior, where
``prior = -n0/2 [ln|Sigma| + tr(Sigma^-1 S0)]``, up to a constant, stands for n0
pseudo-events with covariance S0 about the component's own mean. The step is Newton's, with the Fisher matrix on the
bounded dimensions and exact regression on the open ones; it is shortened until Q does not fall, so the penalised
log-likelihood never falls. Where no length will do, the fixed-point step of Lee and Scott (2012) is tried.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

_TRIALS: Final = 8  # lengths tried of the held step; only those that keep Sigma positive definite are counted
_FURTHER_TRIALS: Final = 4  # of the step as it is solved
_SHORTER: Final = 0.25
"""Next length tried over the last: where the whole Newton step fails, far shorter ones are wanted."""

_VALID_HALVINGS: Final = 40
_LEAST_PRECISION: Final = 0.1
"""A Newton step leaves at least this share of every whitened precision; the next goes further."""

_LEAST_SPREAD: Final = 1e-13
"""Least variance in any direction over the second moment of a component's events and pseudo-events: what rounding
leaves of a difference of moments. Below it the events of a component are too few, or in a plane: Sigma shrinks for
ever and the likelihood with it rises. Whether a solver calls such a matrix singular is chance."""

Path = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""From step lengths t (K,), zero where the component stays, to means and covariances."""

LEAST_LOG_PROBABILITY: Final = -1e5
"""No step goes below this ln P. Where density piles up at a bound without end, the likelihood may rise for ever, by
less and less: at -1e5 a component is an exponential to 1 part in 1e5, and it can still be integrated and sampled."""


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Weighted moments of the events of each component, from an E-step."""

    log_likelihood: float  # sum of ln f over the events
    counts: FloatArray  # (K,): expected events N_k
    mean: FloatArray  # (K, d): weighted means
    scatter: FloatArray  # (K, d, d): weighted covariances about those means

    @classmethod
    def of(cls, log_likelihood: float, sums: FloatArray, d: int) -> Statistics:
        """Weighted moments from sums (K, features) of the features (1, x_i, x_i x_j)."""
        i, j = np.triu_indices(d)
        counts = sums[:, 0]
        safe = np.maximum(counts, 1e-300)[:, None]
        mean = sums[:, 1 : 1 + d] / safe
        second = np.empty((sums.shape[0], d, d))
        second[:, i, j] = second[:, j, i] = sums[:, 1 + d :] / safe
        return cls(log_likelihood, counts, mean, second - mean[:, :, None] * mean[:, None, :])


@dataclasses.dataclass(frozen=True)
class Prior:
    """Prior of the covariances: pseudo-events of each component."""

    strength: float  # n0, their number
    covariance: FloatArray  # (K, d, d): S0

    def value(self, Sigma: FloatArray) -> FloatArray:
        """Log penalty per component, (K,), at most zero: zero at Sigma = S0."""
        if self.strength == 0.0:
            return np.zeros(Sigma.shape[0])
        ratio = np.linalg.solve(Sigma, self.covariance)
        _, log_det = np.linalg.slogdet(ratio)
        trace = np.trace(ratio, axis1=1, axis2=2)
        return np.asarray(0.5 * self.strength * (log_det - trace + Sigma.shape[1]))


Step = Callable[[Statistics, Prior, TruncatedNormal], tuple[FloatArray, Path]]
"""From an E-step, the prior and the components to the step lengths (K,) to be tried first, and their path."""


def objective(stats: Statistics, prior: Prior, t: TruncatedNormal) -> FloatArray:
    """Objective Q of the M-step for each component, (K,)."""
    gap = stats.mean - t.mu
    with np.errstate(over="ignore", invalid="ignore"):  # far off: not finite, and the step is refused
        scatter = stats.scatter + gap[:, :, None] * gap[:, None, :]
        _, log_det = np.linalg.slogdet(t.Sigma)
        trace = np.trace(np.linalg.solve(t.Sigma, scatter), axis1=1, axis2=2)
        return np.asarray(stats.counts * (-0.5 * (log_det + trace) - t.log_probability) + prior.value(t.Sigma))


def maximise(stats: Statistics, prior: Prior, now: TruncatedNormal, points: int) -> tuple[TruncatedNormal, BoolArray]:
    """New components; those whose objective cannot be raised stay as they are.

    Raises LinAlgError where the covariance of a component's events and pseudo-events is singular.
    """
    covariance, mean = _with_prior(stats.scatter, stats, prior), stats.mean
    size = np.trace(covariance, axis1=1, axis2=2) + np.einsum("ki,ki->k", mean, mean)
    if not np.all(np.linalg.eigvalsh(covariance)[:, 0] > _LEAST_SPREAD * size):
        raise np.linalg.LinAlgError("the events of a component have no spread in some direction")
    before = objective(stats, prior, now)
    order = now.box.order if now.box is not None else None
    result = now
    waiting = np.ones(now.mu.shape[0], dtype=bool)
    # the change of each whitened precision held in its range, so that one that runs away does not hold up the rest;
    # then as it is solved: uphill for certain, where the held one need not be; last the fixed point's step
    steps: tuple[Step, ...] = (
        functools.partial(_newton, held=True),
        functools.partial(_newton, held=False),
        _fixed_point,
    )
    for step, trials in zip(steps, (_TRIALS, _FURTHER_TRIALS, _FURTHER_TRIALS), strict=True):
        t, path = step(stats, prior, now)
        for _ in range(trials):
            mu_t, Sigma_t, valid = _shortened(path, t, waiting)
            rows = np.flatnonzero(waiting & valid)
            if rows.size == 0:
                break
            rows_order = order[rows] if order is not None else None
            trial = TruncatedNormal(mu_t[rows], Sigma_t[rows], now.lower, now.upper, points=points, order=rows_order)
            part = Statistics(stats.log_likelihood, stats.counts[rows], stats.mean[rows], stats.scatter[rows])
            after = objective(part, Prior(prior.strength, prior.covariance[rows]), trial)
            which = np.flatnonzero(np.isfinite(after) & (after >= before[rows]) & _usable(trial, now, rows))
            result = result.with_components(rows[which], trial, which)
            waiting[rows[which]] = False
            t[waiting] *= _SHORTER
        if not waiting.any():
            break
    return result, ~waiting


def _shortened(path: Path, t: FloatArray, waiting: BoolArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Points on the path, steps `t` halved in place where they leave the positive definite matrices."""
    for _ in range(_VALID_HALVINGS):
        mu, Sigma = path(t)
        valid = _positive(Sigma)
        short = waiting & ~valid
        if not short.any():
            break
        t[short] *= 0.5
    return mu, Sigma, valid


def predicted_gain(stats: Statistics, now: TruncatedNormal) -> FloatArray:
    """What the mean alone could still add to the log-likelihood, (K,), to second order; zero at a fixed point.

    The prior does not depend on mu, so at a fixed point the weighted mean of the data is the mean inside the box.
    """
    residual = (stats.mean - now.mean) ** 2 / np.maximum(np.diagonal(now.covariance, axis1=1, axis2=2), 1e-300)
    return np.asarray(0.5 * stats.counts * residual.max(axis=1))


def _usable(trial: TruncatedNormal, now: TruncatedNormal, rows: IntArray) -> BoolArray:
    """Whether components can still be integrated and sampled, or are at least no worse off than before."""
    good: BoolArray = (trial.log_probability >= LEAST_LOG_PROBABILITY) | (
        trial.log_probability >= now.log_probability[rows]
    )
    if trial.box is None or now.box is None:
        return good
    return good & (np.isfinite(trial.box.log_peak) | ~np.isfinite(now.box.log_peak[rows]))


def _with_prior(covariance: FloatArray, stats: Statistics, prior: Prior) -> FloatArray:
    """A covariance (K, d, d) of the events of each component, with the pseudo-events added."""
    n = stats.counts[:, None, None]
    return np.asarray((n * covariance + prior.strength * prior.covariance) / np.maximum(n + prior.strength, 1e-300))


def _fixed_point(stats: Statistics, prior: Prior, now: TruncatedNormal) -> tuple[FloatArray, Path]:
    """The step of Lee and Scott: the difference of the moments of data and model, as a line in mean and covariance."""
    full = _with_prior(now.Sigma + stats.scatter - now.covariance, stats, prior)

    def path(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        return now.mu + t[:, None] * (stats.mean - now.mean), now.Sigma + t[:, None, None] * (full - now.Sigma)

    return np.ones(now.mu.shape[0]), path


def _newton(stats: Statistics, prior: Prior, now: TruncatedNormal, held: bool) -> tuple[FloatArray, Path]:
    """Bounded block: whitened precision I - t M, density times exp(t a u + t u M u/2); open block: regression on it.

    The objective is concave along this line of natural parameters. Near a bound mean and covariance must change
    together by much for the density inside to change by little: a line in mean and covariance leaves that valley.
    The step is the whole one (t = 1), or as much of it as keeps a share of every whitened precision.
    """
    b = now.bounded
    f = np.setdiff1d(np.arange(now.mu.shape[1]), b)
    # open dimensions given the bounded ones: weighted least squares with the pseudo-events' cross products added
    C = _with_prior(stats.scatter, stats, prior)
    slope = np.asarray(np.linalg.solve(C[:, b[:, None], b], C[:, b[:, None], f]).transpose(0, 2, 1), dtype=float)
    rest = C[:, f[:, None], f] - slope @ C[:, b[:, None], f]
    trusted = np.ones(stats.counts.size)
    if b.size:
        G, a, M = _newton_direction(stats, prior, now, held)
        largest = np.linalg.eigvalsh(M)[:, -1]
        trusted = np.minimum(1.0, (1.0 - _LEAST_PRECISION) / np.maximum(largest, 1e-12))

    def path(t: FloatArray) -> tuple[FloatArray, FloatArray]:
        mu, Sigma = now.mu.copy(), now.Sigma.copy()
        if b.size:
            white = np.linalg.inv(np.eye(b.size) - t[:, None, None] * M)
            mu[:, b] += (G @ (white @ (t[:, None] * a)[:, :, None]))[:, :, 0]
            Sigma[:, b[:, None], b] = _symmetric(G @ white @ G.transpose(0, 2, 1))
        if f.size:
            cross = slope @ Sigma[:, b[:, None], b]
            mu[:, f] = stats.mean[:, f] + (slope @ (mu[:, b] - stats.mean[:, b])[:, :, None])[:, :, 0]
            Sigma[:, f[:, None], b] = cross
            Sigma[:, b[:, None], f] = cross.transpose(0, 2, 1)
            Sigma[:, f[:, None], f] = _symmetric(rest + cross @ slope.transpose(0, 2, 1))
        return mu, Sigma

    return trusted, path


def _newton_direction(
    stats: Statistics, prior: Prior, now: TruncatedNormal, held: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve Fisher x direction = gradient in whitened natural parameters (a, M): density times exp(a u + u M u/2).

    The equations are solved in v = u - E u, where the features v and v v^T stay apart: far outside the box u is nearly
    constant on it, and u and u u^T nearly the same.
    """
    if now.box is None or now.whitened is None:
        raise TypeError("no bounded dimension")
    K, b, G, w = now.mu.shape[0], now.bounded, now.box.factor, now.whitened
    p = b.size
    i, j = np.triu_indices(p)
    half = np.where(i == j, 0.5, 1.0)
    gap = stats.mean[:, b] - now.mu[:, b]
    v = np.linalg.solve(G, gap[:, :, None])[:, :, 0] - w.mean
    excess = _sandwich(G, stats.scatter[:, b[:, None], b]) + v[:, :, None] * v[:, None, :]
    excess -= w.second - w.mean[:, :, None] * w.mean[:, None, :]
    n = stats.counts[:, None]
    gradient = n * np.concatenate([v, half * excess[:, i, j]], axis=1)
    deviation = w.points - w.mean[:, :, None]
    features = np.concatenate([deviation, half[:, None] * deviation[:, i] * deviation[:, j]], axis=1)
    centre = np.einsum("kfn,kn->kf", features, w.weights)
    features = features - centre[:, :, None]
    fisher = (features * w.weights[:, None, :]) @ features.transpose(0, 2, 1)
    # the prior's part: its gradient and its Hessian n0/2 tr(M^2) at the present Sigma (= I when whitened)
    local = _sandwich(G, prior.covariance[:, b[:, None], b]) - np.eye(p)
    gradient[:, p:] += prior.strength * half * local[:, i, j]
    ridge = np.concatenate([np.zeros(p), prior.strength * half])
    hessian = n[:, :, None] * fisher + (np.eye(p + i.size) * ridge)
    direction = _solve(hessian, gradient)
    M = np.empty((K, p, p))
    M[:, i, j] = M[:, j, i] = direction[:, p:]
    if held:
        # near the least ln P the precision may hardly fall any more: ln P grows no faster than its inverse
        room = np.clip(LEAST_LOG_PROBABILITY / np.minimum(now.log_probability, -1.0), 1.0, 1.0 / _LEAST_PRECISION)
        values, vectors = np.linalg.eigh(M)
        M = (vectors * np.minimum(values, 1.0 - 1.0 / room[:, None])[:, None, :]) @ vectors.transpose(0, 2, 1)
        remainder = gradient[:, :p] - (hessian[:, :p, p:] @ M[:, i, j, None])[:, :, 0]
        direction = _solve(hessian[:, :p, :p], remainder)
    return G, direction[:, :p] - (M @ w.mean[:, :, None])[:, :, 0], M


def _solve(hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """Solution (K, m) of hessian x = gradient, scaled to a unit diagonal and safe for a nearly singular hessian."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(hessian, axis1=1, axis2=2), 1e-300))
    scaled = hessian * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(hessian.shape[1])
    return np.asarray(scale * np.linalg.solve(scaled, (gradient * scale)[:, :, None])[:, :, 0])


def _sandwich(G: FloatArray, S: FloatArray) -> FloatArray:
    """G^-1 S G^-T."""
    half = np.linalg.solve(G, S)
    return np.linalg.solve(G, half.transpose(0, 2, 1))


def _symmetric(S: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (S + S.transpose(0, 2, 1)))


def _positive(Sigma: FloatArray) -> BoolArray:
    """Whether each Sigma is safely positive definite: correlations bounded away from one by rounding."""
    deviation = np.sqrt(np.maximum(np.diagonal(Sigma, axis1=1, axis2=2), 1e-300))
    least = np.linalg.eigvalsh(Sigma / (deviation[:, :, None] * deviation[:, None, :]))[:, 0]
    return np.asarray(least > 1e-11)
