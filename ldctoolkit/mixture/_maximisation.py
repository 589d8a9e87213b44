"""M-step of the truncated EM: new means and covariances from the weighted statistics of an E-step.

Per component the objective is Q = N [E_data ln g(x) - ln P] + prior, where
``prior = -n0/2 [ln|Sigma| + tr(Sigma^-1 S0)]``, up to a constant, stands for n0
pseudo-events with covariance S0 about the component's own mean. Two steps are offered:

- ``lee_scott``: mu' = mu + (xbar - E x), Sigma' = Sigma + (C - V), with E x and V the moments inside the box
  (Lee and Scott 2012: weighted mean minus m, weighted scatter about the new mean plus H);
- ``newton``: a Newton step with the Fisher matrix on the bounded dimensions, exact regression on the open ones.

Either is shortened until Q does not fall, so the penalised log-likelihood never falls. Where no length of the one will
do, the other is tried: near a bound the fixed-point step need not point uphill, and a Newton step may be very short.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.mixture._expectation import Statistics
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

Step = Literal["newton", "lee_scott"]

_TRIALS: Final = 8  # lengths tried of the chosen step; only those that keep Sigma positive definite are counted

_OTHER_TRIALS: Final = 4
_SHORTER: Final = 0.25
"""Next length tried over the last: where the whole Newton step fails, far shorter ones are wanted."""

_VALID_HALVINGS: Final = 40
_LEAST_PRECISION: Final = 0.1
"""A Newton step leaves at least this share of every whitened precision; the next goes further."""

LEAST_LOG_PROBABILITY: Final = -1e5
"""No step goes below this ln P. Where density piles up at a bound without end, the likelihood may rise for ever, by
less and less: at -1e5 a component is an exponential to 1 part in 1e5, and it can still be integrated and sampled."""


@dataclasses.dataclass(frozen=True)
class Prior:
    """Pseudo-events per component."""

    strength: float  # n0, their number
    covariance: FloatArray  # (K, d, d): S0

    def value(self, Sigma: FloatArray) -> FloatArray:
        """Log penalty per component, (K,), at most zero: zero at Sigma = S0."""
        if self.strength == 0.0:
            return np.zeros(Sigma.shape[0])
        ratio = np.linalg.solve(Sigma, self.covariance)
        _, log_det = np.linalg.slogdet(ratio)
        trace = np.trace(ratio, axis1=1, axis2=2)
        out: FloatArray = 0.5 * self.strength * (log_det - trace + Sigma.shape[1])
        return out


def objective(stats: Statistics, prior: Prior, t: TruncatedNormal) -> FloatArray:
    """Q per component, (K,)."""
    gap = stats.mean - t.mu
    with np.errstate(over="ignore", invalid="ignore"):  # far off: not finite, and the step is refused
        scatter = stats.scatter + gap[:, :, None] * gap[:, None, :]
        _, log_det = np.linalg.slogdet(t.Sigma)
        trace = np.trace(np.linalg.solve(t.Sigma, scatter), axis1=1, axis2=2)
        out: FloatArray = stats.counts * (-0.5 * (log_det + trace) - t.log_probability) + prior.value(t.Sigma)
    return out


def maximise(
    stats: Statistics, prior: Prior, now: TruncatedNormal, step: Step, points: int
) -> tuple[TruncatedNormal, BoolArray]:
    """New components; those whose objective cannot be raised stay as they are."""
    before = objective(stats, prior, now)
    order = now.box.order if now.box is not None else None
    makers: list[Callable[[Statistics, Prior, TruncatedNormal], _NewtonPath | _LeeScottPath]]
    # with the change of each whitened precision held in its range, where one that runs away does not hold up the rest;
    # then as it is solved: uphill for certain, where the held one need not be
    makers = [functools.partial(_newton_path, held=True), functools.partial(_newton_path, held=False)]
    makers.insert(0 if step == "lee_scott" else 2, _LeeScottPath)
    result = now
    waiting = np.ones(now.mu.shape[0], dtype=bool)
    for make, trials in zip(makers, (_TRIALS, _OTHER_TRIALS, _OTHER_TRIALS), strict=True):
        path = make(stats, prior, now)
        t = path.trusted()
        for _ in range(trials):
            mu_t, Sigma_t, valid = _shortened(path, t, waiting)
            rows = np.flatnonzero(waiting & valid)
            if rows.size == 0:
                break
            rows_order = order[rows] if order is not None else None
            trial = TruncatedNormal(mu_t[rows], Sigma_t[rows], now.lower, now.upper, points=points, order=rows_order)
            after = objective(_rows(stats, rows), Prior(prior.strength, prior.covariance[rows]), trial)
            which = np.flatnonzero(np.isfinite(after) & (after >= before[rows]) & _usable(trial, now, rows))
            result = result.with_components(rows[which], trial, which)
            waiting[rows[which]] = False
            t[waiting] *= _SHORTER
        if not waiting.any():
            break
    return result, ~waiting


def _shortened(
    path: _NewtonPath | _LeeScottPath, t: FloatArray, waiting: BoolArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Points on the path, steps `t` halved in place where they leave the positive definite matrices."""
    for _ in range(_VALID_HALVINGS):
        mu, Sigma, valid = path.at(t)
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
    out: FloatArray = 0.5 * stats.counts * residual.max(axis=1)
    return out


def _usable(trial: TruncatedNormal, now: TruncatedNormal, rows: IntArray) -> BoolArray:
    """Whether components can still be integrated and sampled, or are at least no worse off than before."""
    good: BoolArray = (trial.log_probability >= LEAST_LOG_PROBABILITY) | (
        trial.log_probability >= now.log_probability[rows]
    )
    if trial.box is None or now.box is None:
        return good
    return good & (np.isfinite(trial.box.log_peak) | ~np.isfinite(now.box.log_peak[rows]))


def _rows(stats: Statistics, rows: IntArray) -> Statistics:
    return Statistics(stats.log_likelihood, stats.counts[rows], stats.mean[rows], stats.scatter[rows])


@dataclasses.dataclass(frozen=True)
class _LeeScottPath:
    stats: Statistics
    prior: Prior
    now: TruncatedNormal

    def trusted(self) -> FloatArray:
        """The whole step, (K,)."""
        return np.ones(self.now.mu.shape[0])

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        n = self.stats.counts[:, None, None]
        n0 = self.prior.strength
        mu = self.now.mu + t[:, None] * (self.stats.mean - self.now.mean)
        plain = n * (self.now.Sigma + self.stats.scatter - self.now.covariance)
        full = (plain + n0 * self.prior.covariance) / np.maximum(n + n0, 1e-300)
        Sigma = self.now.Sigma + t[:, None, None] * (full - self.now.Sigma)
        return mu, Sigma, _positive(Sigma)


@dataclasses.dataclass(frozen=True)
class _NewtonPath:
    """Bounded block: whitened precision I - t M, density times exp(t a u + t u M u/2); open block: regression on it.

    The objective is concave along this line of natural parameters. Near a bound mean and covariance must change
    together by much for the density inside to change by little: a line in mean and covariance leaves that valley.
    """

    now: TruncatedNormal
    bounded: IntArray
    free: IntArray
    factor: FloatArray
    a: FloatArray
    M: FloatArray
    data_mean: FloatArray
    slope: FloatArray
    rest: FloatArray

    def trusted(self) -> FloatArray:
        """The whole step, (K,), or as much of it as keeps a share of every whitened precision."""
        K, p = self.a.shape
        if p == 0:
            return np.ones(K)
        most = np.linalg.eigvalsh(self.M)[:, -1]
        out: FloatArray = np.minimum(1.0, (1.0 - _LEAST_PRECISION) / np.maximum(most, 1e-12))
        return out

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        b, f = self.bounded, self.free
        mu, Sigma = self.now.mu.copy(), self.now.Sigma.copy()
        if b.size:
            white = np.linalg.inv(np.eye(b.size) - t[:, None, None] * self.M)
            a = white @ (t[:, None] * self.a)[:, :, None]
            G = self.factor
            mu[:, b] += (G @ a)[:, :, 0]
            Sigma[:, b[:, None], b] = _symmetric(G @ white @ G.transpose(0, 2, 1))
        if f.size:
            A = self.slope
            S_b = Sigma[:, b[:, None], b]
            cross = A @ S_b
            mu[:, f] = self.data_mean[:, f] + (A @ (mu[:, b] - self.data_mean[:, b])[:, :, None])[:, :, 0]
            Sigma[:, f[:, None], b] = cross
            Sigma[:, b[:, None], f] = cross.transpose(0, 2, 1)
            Sigma[:, f[:, None], f] = _symmetric(self.rest + cross @ A.transpose(0, 2, 1))
        return mu, Sigma, _positive(Sigma)


def _newton_path(stats: Statistics, prior: Prior, now: TruncatedNormal, held: bool) -> _NewtonPath:
    b = now.bounded
    f = np.setdiff1d(np.arange(now.mu.shape[1]), b)
    n, n0 = stats.counts, prior.strength
    # open dimensions given the bounded ones: weighted least squares with the pseudo-events' cross products added
    total = np.maximum(n + n0, 1e-300)[:, None, None]
    C = (n[:, None, None] * stats.scatter + n0 * prior.covariance) / total
    slope = np.asarray(np.linalg.solve(C[:, b[:, None], b], C[:, b[:, None], f]).transpose(0, 2, 1), dtype=float)
    rest = C[:, f[:, None], f] - slope @ C[:, b[:, None], f]
    factor, a, M = _newton_direction(stats, prior, now, held)
    return _NewtonPath(now, b, f, factor, a, M, stats.mean, slope, rest)


def _newton_direction(
    stats: Statistics, prior: Prior, now: TruncatedNormal, held: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve Fisher x direction = gradient in whitened natural parameters (a, M): density times exp(a u + u M u/2).

    The equations are solved in v = u - E u, where the features v and v v^T stay apart: far outside the box u is nearly
    constant on it, and u and u u^T nearly the same.
    """
    K = now.mu.shape[0]
    if now.box is None or now.whitened is None:
        empty = np.empty((K, 0, 0))
        return empty, np.empty((K, 0)), empty
    b, G, w = now.bounded, now.box.factor, now.whitened
    p = b.size
    i, j = np.triu_indices(p)
    half = np.where(i == j, 0.5, 1.0)
    gap = stats.mean[:, b] - now.mu[:, b]
    v = np.linalg.solve(G, gap[:, :, None])[:, :, 0] - w.mean
    excess = _sandwich(G, stats.scatter[:, b[:, None], b]) + v[:, :, None] * v[:, None, :]
    excess -= w.second - w.mean[:, :, None] * w.mean[:, None, :]
    n = stats.counts[:, None]
    gradient = n * np.concatenate([v, half * excess[:, i, j]], axis=1)
    at = w.points - w.mean[:, :, None]
    features = np.concatenate([at, half[:, None] * at[:, i] * at[:, j]], axis=1)
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
        left = gradient[:, :p] - (hessian[:, :p, p:] @ M[:, i, j, None])[:, :, 0]
        direction = _solve(hessian[:, :p, :p], left)
    return G, direction[:, :p] - (M @ w.mean[:, :, None])[:, :, 0], M


def _solve(hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """Solution of hessian x = gradient with a unit diagonal, (K, m), safe where the hessian is nearly singular."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(hessian, axis1=1, axis2=2), 1e-300))
    scaled = hessian * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(hessian.shape[1])
    out: FloatArray = scale * np.linalg.solve(scaled, (gradient * scale)[:, :, None])[:, :, 0]
    return out


def _sandwich(G: FloatArray, S: FloatArray) -> FloatArray:
    """G^-1 S G^-T."""
    half = np.linalg.solve(G, S)
    return np.linalg.solve(G, half.transpose(0, 2, 1))


def _symmetric(S: FloatArray) -> FloatArray:
    out: FloatArray = 0.5 * (S + S.transpose(0, 2, 1))
    return out


def _positive(Sigma: FloatArray) -> BoolArray:
    """Whether each Sigma is safely positive definite: correlations bounded away from one by rounding."""
    deviation = np.sqrt(np.maximum(np.diagonal(Sigma, axis1=1, axis2=2), 1e-300))
    least = np.linalg.eigvalsh(Sigma / (deviation[:, :, None] * deviation[:, None, :]))[:, 0]
    out: BoolArray = least > 1e-11
    return out
