"""Moves out of local optima: their bounds hold, and they lead to the optimum that k-means starts miss."""

import numpy as np
import pytest

from ldctoolkit.mixture import BoundedGaussianMixture, TruncatedNormal, _em
from ldctoolkit.mixture._em import best_moves
from ldctoolkit.mixture._expectation import Components, log_terms, natural, shares, statistics
from ldctoolkit.mixture._kernels import statistics_of_rows

POINTS = 1021


def groups(seed: int, K: int = 8, n: int = 6000) -> tuple[BoundedGaussianMixture, np.ndarray]:
    """K groups of unlike size on a quarter plane, some cut by its bounds."""
    rng = np.random.default_rng(seed)
    mu = rng.uniform(-0.5, 12.0, size=(K, 2))
    A = rng.normal(size=(K, 2, 2))
    Sigma = 0.3 * A @ A.transpose(0, 2, 1) + 0.1 * np.eye(2)
    true = BoundedGaussianMixture.from_parameters(rng.dirichlet(np.full(K, 3.0)), mu, Sigma, lower=0.0)
    return true, true.sample(n, seed)[0]


def log_likelihood(z: np.ndarray, c: Components, t: TruncatedNormal) -> float:
    """Sum of ln f at the components, by the plain formula."""
    terms = log_terms(z, Components(c.weights, t.mu, t.Sigma, t.log_probability))
    return float(np.logaddexp.reduce(terms, axis=1).sum())


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_a_move_gains_at_least_its_bound(seed: int) -> None:
    """Jensen's inequality, for the components as they are handed on, before any EM."""
    _, X = groups(seed, K=5, n=1500)
    z = (X - X.mean(axis=0)) / X.std(axis=0)
    low = -X.mean(axis=0) / X.std(axis=0)
    high = np.full(2, np.inf)
    rng = np.random.default_rng(seed)
    mu, Sigma = z[rng.choice(z.shape[0], 5)], np.tile(0.2 * np.eye(2), (5, 1, 1))
    t = TruncatedNormal(mu, Sigma, low, high, points=POINTS)
    now = Components(np.full(5, 0.2), mu, Sigma, t.log_probability)
    # one pass, so that the weights are those of the shares, as after any EM
    value, sums = statistics_of_rows(z, None, np.zeros(2), np.ones(2), natural(now))
    stats = statistics(value, sums, 2)
    now = Components(stats.counts / z.shape[0], mu, Sigma, t.log_probability)
    value, sums = statistics_of_rows(z, None, np.zeros(2), np.ones(2), natural(now))
    stats = statistics(value, sums, 2)

    def run(x: np.ndarray, w: np.ndarray, two: Components) -> tuple[Components, float]:
        pair = TruncatedNormal(two.mu, two.Sigma, low, high, points=POINTS)
        terms = log_terms(x, Components(two.weights / two.weights.sum(), pair.mu, pair.Sigma, pair.log_probability))
        end = Components(two.weights / two.weights.sum(), pair.mu, pair.Sigma, pair.log_probability)
        return end, float(w @ np.logaddexp.reduce(terms, axis=1))

    found = best_moves(
        z, np.ones(z.shape[0]), stats, t, shares(log_terms(z, now)), strength=0.0, points=POINTS, run=run,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    assert len(found) >= 5
    gains = [move.gain for move in found]
    assert gains == sorted(gains, reverse=True)
    before = log_likelihood(z, now, t)
    for move in found:
        after = TruncatedNormal(move.start.mu, move.start.Sigma, low, high, points=POINTS)
        assert move.start.weights.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(move.start.log_p, after.log_probability, atol=1e-9)
        assert log_likelihood(z, move.start, after) - before >= move.gain


def shortfall(model: BoundedGaussianMixture, true: BoundedGaussianMixture, X: np.ndarray) -> float:
    """Nats an event below the optimum that EM reaches from the truth."""
    best = BoundedGaussianMixture.from_parameters(true.weights_, true.means_, true.covariances_, lower=0.0)
    best.set_params(warm_start=True).fit(X)
    return best.score(X) - model.score(X)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 0, 1, 3])
def test_moves_lead_out_of_local_optima(seed: int) -> None:
    """Two k-means starts each: without the moves some fits end at a worse optimum, with them none does. A fit from the
    truth is the measure; 1e-3 nats is what its own tolerance and the prior's target leave open."""
    true, X = groups(seed)
    model = BoundedGaussianMixture(8, lower=0.0, n_init=2, random_state=0)
    assert shortfall(model.fit(X), true, X) < 1e-3
    if seed == 2:
        assert shortfall(model.set_params(split_merge=False).fit(X), true, X) > 0.005


@pytest.mark.slow
def test_a_failed_move_keeps_those_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search ends where a move meets a singular covariance; what it has found stands."""
    _, X = groups(2)
    model = BoundedGaussianMixture(8, lower=0.0, n_init=1, random_state=0)
    start = model.set_params(split_merge=False).fit(X).score(X)
    calls = []

    def second_fails(*args: object, **named: object) -> list[object]:
        calls.append(len(calls))
        if len(calls) > 1:
            raise np.linalg.LinAlgError
        return best_moves(*args, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(_em, "best_moves", second_fails)
    after = model.set_params(split_merge=True).fit(X).score(X)
    assert len(calls) == 2
    assert after > start + 0.005
