"""Expectation-maximisation of a bounded Gaussian mixture: the iteration, and split and merge of components."""

from __future__ import annotations

import collections
import dataclasses
from collections.abc import Callable
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture._distribution import Components, log_terms, natural, shares
from ldctoolkit.mixture._maximisation import (
    LEAST_LOG_PROBABILITY,
    Prior,
    Statistics,
    maximise,
    objective,
    predicted_gain,
)
from ldctoolkit.mixture.checks import Events, Profile, sums_of
from ldctoolkit.mixture.truncated_normal import TruncatedNormal, moment_points

_LLOYD_PASSES: Final = 20
_VARIANCE_FLOOR: Final = 1e-6
"""Least eigenvalue of a local covariance, in units of the data's variance: repeated rows have none."""


def kmeans_labels(x: FloatArray, weight: FloatArray | None, K: int, rng: np.random.Generator) -> IntArray:
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
            members = label == k
            centres[k] = w[members] @ x[members] / counts[k]
        for k in [int(i) for i in np.flatnonzero(~(counts > 0))]:
            farthest = int(np.argmax(w * np.sum((x - centres[label]) ** 2, axis=1)))
            centres[k], label[farthest] = x[farthest], k
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
        rows, share = x[label == k], w[label == k]
        counts[k] = share.sum()
        if counts[k] > 0:
            mean[k] = share @ rows / counts[k]
            scatter[k] = ((rows - mean[k]).T * share) @ (rows - mean[k]) / counts[k]
    centre = w @ x / w.sum()
    overall = ((x - centre).T * w) @ (x - centre) / w.sum()
    Sigma = local_covariance(scatter, counts, overall)
    return Components((counts + 1.0) / (w.sum() + K), mean, Sigma, np.zeros(K))


_MERGER_STEPS: Final = 4
_LEAST_SHARE: Final = 1e-3  # events of which a component has less than this share tell nothing of its shape

_JITTER: Final = 1e-9
_WITHIN: Final = (0.4, 1.6)
_PAIRS: Final = 3  # mergers that are looked at, times K: those of the most overlapping pairs

_REPEATS: Final = 2
_SPLITS: Final = 12  # components that are tried to be split: those with most events, where a misfit counts most


Run = Callable[[FloatArray, FloatArray, Components], tuple[Components, float]]
"""From rows, weights and two components: these after a few passes, and the log-likelihood of the rows."""


@dataclasses.dataclass(frozen=True)
class Move:
    """One candidate for an escape: a component is split, two others are merged."""

    split: int  # the component that is split
    merged: tuple[int, int]  # the two that are merged
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
    """Splits with mergers, by the least gain of log-likelihood that their bounds promise, best first."""
    pairs, mu_m, Sigma_m, log_p_m, merger_gain = _mergers(weight, stats, now, shares_now, strength, points)
    out = []
    largest = np.argsort(-stats.counts, kind="stable")[:_SPLITS]
    for k in np.sort(largest).tolist():
        halves = _split(z, weight * shares_now[:, k], now, k, run, rng)
        if halves is None:
            continue
        two, split_gain = halves
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
            out.append(Move(k, (i, j), split_gain + float(merger_gain[m]), start))
    return _varied(sorted(out, key=lambda move: -move.gain))


def _varied(ranked: list[Move]) -> list[Move]:
    """Each split and each merger twice at most: their neighbours in the ranking are alike."""
    used: collections.Counter[object] = collections.Counter()
    out = []
    for move in ranked:
        if max(used[move.split], used[move.merged]) < _REPEATS:
            used.update((move.split, move.merged))
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
    whole = Components(np.ones(1), now.mu[[k]], now.Sigma[[k]], now.log_probability[[k]])
    return two, value - float(w @ log_terms(x, whole)[:, 0])


def _mergers(
    weight: FloatArray, stats: Statistics, now: TruncatedNormal, shares_now: FloatArray, strength: float, points: int
) -> tuple[list[tuple[int, int]], FloatArray, FloatArray, FloatArray, FloatArray]:
    """Pairs, the components in their place with ln P, and what the mergers gain at least (a loss, as a rule)."""
    K = now.mu.shape[0]
    overlap = (shares_now * weight[:, None]).T @ shares_now
    size = np.sqrt(np.diagonal(overlap))
    overlap /= np.maximum(np.outer(size, size), 1e-300)
    i, j = np.triu_indices(K, 1)
    closest = np.sort(np.argsort(-overlap[i, j], kind="stable")[: _PAIRS * K])
    i, j = i[closest], j[closest]
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
        t, _ = maximise(merged, prior, t, points)
    plain = Prior(0.0, stats.scatter)
    separate = objective(stats, plain, now) + _x_log_x(stats.counts)
    joined = objective(merged, Prior(0.0, target), t) + _x_log_x(n)
    entropy = weight @ _x_log_x(shares_now)
    joint = np.array([weight @ _x_log_x(shares_now[:, p] + shares_now[:, q]) for p, q in zip(i, j, strict=True)])
    gain = joined - separate[i] - separate[j] + entropy[i] + entropy[j] - joint
    return [(int(p), int(q)) for p, q in zip(i, j, strict=True)], t.mu, t.Sigma, t.log_probability, gain


def _x_log_x(x: FloatArray) -> FloatArray:
    return np.asarray(x * np.log(np.maximum(x, 1e-300)))


_SHORT_POINTS: Final = 1021
_FEW_DIMENSIONS: Final = 3  # up to so many bounded dimensions 1,021 points are enough for a whole fit (ln P to 1e-8)
_FEW_EVENTS: Final = 2_000  # up to so many events too: their sampling error is far larger than the lattice's

_WINDOW: Final = 5
_LEAST_WEIGHT: Final = 1e-12

_ESCAPE_TOL: Final = 1e-5
_ESCAPE_PASSES: Final = 40
_ESCAPE_TRIALS: Final = 5
_SPLIT_PASSES: Final = 8
"""Escapes from a local optimum: tolerance and passes of a run, candidates tried; K escapes at most."""

_HOPELESS: Final = 0.1
"""Candidates whose bound on the gain is a greater loss than this [nats an event] are not tried. Measured: where groups
are apart the bounds are right to 0.01, on data with skewed margins EM gains up to 0.08 on them."""

_FIRST_LEAP: Final = 4.0
_SHORTEST_LEAP: Final = 2.0
_LONGER: Final = 4.0
"""Largest length of a leap at first, when it has been too long, and how it grows when it was used up."""

_STATIONARY: Final = 1e-6
"""A component that finds no step is at its optimum if its mean could add less than this per event [nats]: about 1e-3
standard deviations. The lattice's moments are its likelihood's gradient no better than to about 1e-4."""

_FALL: Final = 1e-8  # a relative fall of the objective beyond this is no rounding: the E-step has lost its digits

StopReason = Literal["converged", "max_iter", "stuck", "collapsed"]
Progress = Callable[[str], None]


@dataclasses.dataclass(frozen=True)
class EMSettings:
    """Settings of `fit_components`."""

    lower: FloatArray  # (d,) bounds in the data's standardised units
    upper: FloatArray
    seed: int
    split_merge: bool
    n_components: int
    n_init: int
    short_iter: int
    subsample: int
    max_iter: int
    tol: float
    prior_strength: float


@dataclasses.dataclass(frozen=True)
class EMResult:
    """Components at the end of a run, the penalised log-likelihood per event after each pass, why it ended, passes.

    "stuck": no step raised the objective, though it is not at a maximum. "collapsed": the objective fell, because a
    component had become too thin for the arithmetic; the components before that pass are kept.
    """

    components: Components
    history: FloatArray
    stop_reason: StopReason
    passes: int


@dataclasses.dataclass(frozen=True)
class _Standardised:
    """Rows seen in units of their own spread; `events` is the sum of their weights."""

    rows: Events
    location: FloatArray
    scale: FloatArray
    events: float

    def evaluate(self, c: Components) -> Statistics:
        value, sums = sums_of(self.rows, self.location, self.scale, natural(c))
        return Statistics.of(value, sums, self.rows.dimension)


def fit_components(
    events: Events, profile: Profile, s: EMSettings, report: Progress, start: Components | None = None
) -> EMResult:
    """Fit K components to events strictly inside the box; components are in units of the profile's mean and scale.

    The points and the order of integration are frozen during a run, so the likelihood is one smooth function. The
    prior's target is frozen too: for a short run the clusters' covariances, for the final run the covariances of the
    events around each component at its start.
    """
    data = _Standardised(events, profile.mean, profile.scale, profile.events)
    bounded = int(np.sum(np.isfinite(s.lower) | np.isfinite(s.upper)))
    passes, needs_many_points = 0, bounded > _FEW_DIMENSIONS and data.events > _FEW_EVENTS
    try:
        c = start or _best_start(data, s, report)
        if needs_many_points:
            # most of the way on few points: many take longer than the pass over the events
            first_run = _run(data, c, _local_prior(data, c, s), s, s.max_iter, _SHORT_POINTS, report, "nearing")
            c, passes = first_run.components, first_run.passes
        points = moment_points(bounded) if needs_many_points else _SHORT_POINTS
        final_run = _run(data, c, _local_prior(data, c, s), s, max(s.max_iter - passes, 1), points, report)
        return dataclasses.replace(final_run, passes=passes + final_run.passes)
    except np.linalg.LinAlgError:
        raise InputError(
            "X",
            "the likelihood has no maximum, a component shrinks onto too few distinct events or onto a plane with "
            f"K = {s.n_components}, prior_strength = {s.prior_strength:g}",
            hint="raise prior_strength or fit fewer components",
        ) from None


def _local_prior(data: _Standardised, c: Components, s: EMSettings) -> Prior:
    """Pseudo-events with the covariance of the events around each component; the data's own correlation is one."""
    stats = data.evaluate(c)
    # the whole from its parts: counts, means and scatters of the shares add up to those of the events
    share = stats.counts / stats.counts.sum()
    gap = stats.mean - share @ stats.mean
    overall = np.einsum("k,kij->ij", share, stats.scatter) + np.einsum("k,ki,kj->ij", share, gap, gap)
    return Prior(s.prior_strength, local_covariance(stats.scatter, stats.counts, overall))


def _best_start(data: _Standardised, s: EMSettings, report: Progress) -> Components:
    """The best of several short runs from k-means clusters."""
    rng = np.random.default_rng([s.seed, 0])
    rows = np.arange(data.rows.rows) if data.rows.weight is None else np.flatnonzero(data.rows.weight > 0.0)
    used = data.rows.take(rows if rows.size <= s.subsample else np.sort(rng.choice(rows, s.subsample, replace=False)))
    z, weight = (used.x - data.location) / data.scale, used.weight
    events = float(z.shape[0]) if weight is None else float(weight.sum())
    d = z.shape[1]
    short = _Standardised(Events(z, weight, data.rows.threads), np.zeros(d), np.ones(d), events)
    results = []
    starts = s.n_init if s.n_components > 1 else 1
    for run in range(starts):
        first = start_from_clusters(z, weight, s.n_components, np.random.default_rng([s.seed, 1, run]))
        result = _run(short, first, Prior(s.prior_strength, first.Sigma), s, s.short_iter, _SHORT_POINTS, leaps=False)
        report(f"start {run + 1} of {starts}: {result.history[-1]:.6f} nats an event")
        results.append(result)
    best = max(results, key=lambda result: float(result.history[-1]))
    if s.n_components < 3 or not s.split_merge:
        return best.components
    return _escape(short, best.components, s, report)


def _escape(data: _Standardised, c: Components, s: EMSettings, report: Progress) -> Components:
    """Split one component and merge two others, as long as that leads higher."""
    loose = dataclasses.replace(s, tol=_ESCAPE_TOL)
    rng = np.random.default_rng([s.seed, 2])
    now = _run(data, c, _local_prior(data, c, s), loose, _ESCAPE_PASSES, _SHORT_POINTS, leaps=False)
    for _ in range(s.n_components):
        try:
            higher = _one_escape(data, now, loose, rng, report)
        except (np.linalg.LinAlgError, InputError):  # too few distinct events for a move
            break
        if higher is None:
            break
        now = higher
    return now.components


def _one_escape(
    data: _Standardised, now: EMResult, s: EMSettings, rng: np.random.Generator, report: Progress
) -> EMResult | None:
    """The first of the most promising moves that leads higher."""
    z, weight = data.rows.x, data.rows.weight
    c = now.components
    t = TruncatedNormal(c.mu, c.Sigma, s.lower, s.upper, points=_SHORT_POINTS)

    def split_run(x: FloatArray, w: FloatArray, two: Components) -> tuple[Components, float]:
        part = _Standardised(Events(x, w, data.rows.threads), data.location, data.scale, float(w.sum()))
        prior = Prior(s.prior_strength, two.Sigma)
        end = _run(part, two, prior, s, _SPLIT_PASSES, _SHORT_POINTS, leaps=False).components
        return end, part.evaluate(end).log_likelihood

    candidates = best_moves(
        z,
        np.ones(data.rows.rows) if weight is None else weight,
        data.evaluate(c),
        t,
        shares(log_terms(z, c)),
        strength=s.prior_strength,
        points=_SHORT_POINTS,
        run=split_run,
        rng=rng,
    )
    for move in [m for m in candidates if m.gain > -_HOPELESS * data.events][:_ESCAPE_TRIALS]:
        prior = _local_prior(data, move.start, s)
        trial = _run(data, move.start, prior, s, _ESCAPE_PASSES, _SHORT_POINTS, leaps=False)
        gain = trial.history[-1] - now.history[-1]
        if gain > _WINDOW * _ESCAPE_TOL:
            i, j = move.merged
            report(f"component {move.split} split, {i} and {j} merged: {gain:.6f} nats an event more")
            return trial
    return None


def _run(
    data: _Standardised,
    start: Components,
    prior: Prior,
    s: EMSettings,
    passes: int,
    points: int,
    report: Progress | None = None,
    word: str = "pass",
    *,
    leaps: bool = True,
) -> EMResult:
    """EM from given components until it converges, is stuck or falls, or has no passes left."""
    n = data.events
    t = TruncatedNormal(start.mu, start.Sigma, s.lower, s.upper, points=points)
    now = Point(start.weights / start.weights.sum(), t)

    def evaluate(point: Point) -> tuple[Statistics, float]:
        stats = data.evaluate(_components(point))
        return stats, (stats.log_likelihood + float(prior.value(point.truncated.Sigma).sum())) / n

    stats, value = evaluate(now)
    history, trail, longest = [value], [now], _FIRST_LEAP
    reason: StopReason = "max_iter"
    for _ in range(passes):
        before = now
        t, moved = maximise(stats, prior, now.truncated, points)
        stuck = bool(np.any(~moved & (predicted_gain(stats, now.truncated) > _STATIONARY * n)))
        weights = np.maximum(stats.counts, _LEAST_WEIGHT)
        now = Point(weights / weights.sum(), t)
        trail.append(now)
        beyond = None
        if len(trail) == 3:
            # the first passes turn too sharply to be continued straight on
            go = leaps and len(history) >= _WINDOW
            beyond = leap(*trail, longest=longest, points=points) if go else None
            trail = []
        if beyond is not None:
            point, length = beyond
            stats, value = evaluate(point)
            if value >= history[-1]:
                now = point
                longest *= _LONGER if length >= 0.99 * longest else 1.0
            else:
                longest, beyond = max(_SHORTEST_LEAP, 0.5 * longest), None
        if beyond is None:
            stats, value = evaluate(now)
        trail = trail or [now]
        if not value >= history[-1] - _FALL * max(abs(history[-1]), 1.0):
            now = before
            reason = "collapsed"
            break
        history.append(value)
        if report is not None:
            report(f"{word} {len(history) - 1}: {value:.8f} nats an event, gained {value - history[-2]:.2e}")
        still = not moved.any() and np.array_equal(now.weights, before.weights)  # the next pass would be this one
        if still or (len(history) > _WINDOW and history[-1] - history[-1 - _WINDOW] < s.tol * _WINDOW):
            reason = "stuck" if stuck else "converged"
            break
    return EMResult(_components(now), np.array(history), reason, len(history) - 1)


def _components(point: Point) -> Components:
    t = point.truncated
    return Components(point.weights, t.mu, t.Sigma, t.log_probability)


_SHORTEST: Final = 1.01
_LEAST_PRECISION: Final = 0.1  # a leap keeps this share of every precision, in units of the middle point's


@dataclasses.dataclass(frozen=True)
class Point:
    """Weights (K,) and components of one pass."""

    weights: FloatArray
    truncated: TruncatedNormal


def leap(first: Point, second: Point, third: Point, *, longest: float, points: int) -> tuple[Point, float] | None:
    """A point beyond the third of three successive ones, and the length s of the leap."""
    G = np.linalg.cholesky(second.truncated.Sigma)
    centre = second.truncated.mean
    a, b, c = (_whitened(p, G, centre, second.weights) for p in (first, second, third))
    # components count by their share of the events
    share = np.sqrt(second.weights)[:, None]
    r, v = (share * step for step in (b - a, c - 2.0 * b + a))
    s = float(np.clip(np.linalg.norm(r) / max(float(np.linalg.norm(v)), 1e-300), 1.0, longest))
    while s > _SHORTEST:
        end = _unwhitened(a + 2.0 * s * (b - a) + s**2 * (c - 2.0 * b + a), G, centre, second.truncated, points)
        if end is not None:
            return end, s
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
    coordinates: FloatArray, G: FloatArray, centre: FloatArray, like: TruncatedNormal, points: int
) -> Point | None:
    """The point at whitened natural coordinates; None where a precision is not positive definite."""
    K, d = centre.shape
    precision = np.sqrt(2.0) * coordinates[:, 1 + d :].reshape(K, d, d)
    precision = 0.5 * (precision + precision.transpose(0, 2, 1))
    if not np.isfinite(coordinates).all() or np.linalg.eigvalsh(precision)[:, 0].min() < _LEAST_PRECISION:
        return None
    covariance = np.linalg.inv(precision)
    mu = centre + (G @ covariance @ coordinates[:, 1 : 1 + d, None])[:, :, 0]
    Sigma = G @ covariance @ G.transpose(0, 2, 1)
    Sigma = 0.5 * (Sigma + Sigma.transpose(0, 2, 1))
    order = None if like.box is None else like.box.order
    t = TruncatedNormal(mu, Sigma, like.lower, like.upper, points=points, order=order)
    if t.log_probability.min() < LEAST_LOG_PROBABILITY or (t.box is not None and not np.isfinite(t.box.log_peak).all()):
        return None
    weights = np.exp(coordinates[:, 0] - coordinates[:, 0].max())
    return Point(weights / weights.sum(), t)
