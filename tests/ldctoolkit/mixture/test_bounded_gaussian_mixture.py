"""Truncated EM against known truths, its rules, and what it refuses."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, truncnorm

from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture, TruncatedNormal, _em

INF = np.inf


def small(seed=0, n=3000):
    """Two components in two dimensions, one bound cutting each."""
    mixture = BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[0.2, 0.0], [2.0, 3.0]], [[[1.0, 0.5], [0.5, 1.0]], [[0.5, -0.2], [-0.2, 0.8]]], lower=[0.0, -INF]
    )
    return mixture, mixture.sample(n, seed)[0]


@pytest.mark.parametrize("step", ["newton", "lee_scott"])
def test_the_likelihood_never_falls_and_the_fit_is_near_the_truth(step):
    true, X = small()
    model = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=1, n_init=4, step=step, max_iter=300).fit(X)
    assert np.min(np.diff(model.lower_bounds_)) >= -1e-8 * abs(model.lower_bound_)
    assert model.n_iter_ == model.lower_bounds_.size - 1
    held_out = true.sample(20_000, 9)[0]
    assert true.score(held_out) - model.score(held_out) < 4.0 * model.n_parameters() / (2 * 3000)


def test_one_component_without_prior_matches_the_data_moments():
    """Maximum likelihood of a truncated normal sets its mean and covariance inside the box to the sample's."""
    rng = np.random.default_rng(4)
    X = np.column_stack([truncnorm.rvs(-0.5, 4, size=4000, random_state=1), rng.normal(size=4000)])
    X[:, 1] += 0.5 * X[:, 0]
    low = [-0.5, -INF]
    model = BoundedGaussianMixture(1, lower=low, prior_strength=0.0, tol=1e-12, random_state=0).fit(X)
    t = model.distribution.truncated
    np.testing.assert_allclose(t.mean[0], X.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(t.covariance[0], np.cov(X.T, bias=True), atol=1e-5)


def test_without_bounds_it_is_an_ordinary_mixture():
    X = np.random.default_rng(0).normal(size=(500, 3)) @ np.diag([1.0, 5.0, 0.1])
    model = BoundedGaussianMixture(1, prior_strength=0.0, random_state=0).fit(X)
    np.testing.assert_allclose(model.means_[0], X.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(model.covariances_[0], np.cov(X.T, bias=True), rtol=1e-9, atol=1e-12)
    expected = multivariate_normal(X.mean(axis=0), np.cov(X.T, bias=True)).logpdf(X)
    np.testing.assert_allclose(model.score_samples(X), expected, rtol=1e-10)
    np.testing.assert_allclose(model.bic(X), -2 * expected.sum() + 9 * np.log(500), rtol=1e-10)


def test_units_do_not_matter():
    """Scaling a column scales the fit: everything is standardised inside."""
    _, X = small(n=800)
    scale = np.array([1e-4, 1e3])
    one = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=0, n_init=2, max_iter=30).fit(X)
    two = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=0, n_init=2, max_iter=30).fit(X * scale)
    np.testing.assert_allclose(two.means_, one.means_ * scale, rtol=1e-6)
    np.testing.assert_allclose(two.score(X * scale), one.score(X) - np.log(scale).sum(), rtol=1e-8)


def mean_residual(model, X):
    """Weighted data mean minus mean inside the box, in standard deviations of the data: 0 at a maximum. The prior does
    not depend on mu, so this holds with and without it."""
    share = model.predict_proba(X)
    weighted = (share.T @ X) / share.sum(axis=0)[:, None]
    inside = model.distribution.truncated.mean
    return np.abs((weighted - inside) / X.std(axis=0))


@pytest.mark.parametrize("K", [1, 2])
def test_a_fit_ends_at_a_maximum(K):
    """Data that pile up at the corner, where mean and covariance must change together by much."""
    X = np.random.default_rng(1).gamma(0.8, size=(300, 4))
    model = BoundedGaussianMixture(K, lower=0.0, random_state=0, n_init=4, tol=1e-8).fit(X)
    assert model.converged_
    # 5e-4: what the last gains below `tol` and the lattice's error still leave (1.2e-4); a stalled fit has 0.03 to 0.08
    assert mean_residual(model, X).max() < 5e-4


def test_a_fit_that_finds_no_step_does_not_say_that_it_converged(monkeypatch):
    X = np.random.default_rng(1).gamma(0.8, size=(300, 2))
    still = lambda stats, prior, now, step, points: (now, np.zeros(now.mu.shape[0], dtype=bool))  # noqa: E731
    monkeypatch.setattr(_em, "maximise", still)
    model = BoundedGaussianMixture(1, lower=0.0, random_state=0).fit(X)
    assert (model.converged_, model.stop_reason_) == (False, "stuck")
    monkeypatch.undo()
    assert BoundedGaussianMixture(1, lower=0.0, random_state=0, max_iter=3).fit(X).stop_reason_ == "max_iter"


def test_the_rule_for_stopping():
    """Five passes that gain less than 5 tol together: the last five do, the five before the last pass do not."""
    _, X = small(n=800)
    model = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=0, n_init=2).fit(X)
    h = model.lower_bounds_
    assert model.converged_
    assert model.n_iter_ > 10
    assert h[-1] - h[-6] < 5.0 * model.tol <= h[-2] - h[-7]


def test_the_prior_is_ten_pseudo_events():
    """Without bounds, K = 1: Sigma = (n C + 10 S0)/(n + 10), S0 the events' covariance, correlations shrunk by s."""
    X = np.random.default_rng(0).normal(size=(50, 2)) @ np.array([[1.0, 0.6], [0.0, 1.0]])
    C = np.cov(X.T, bias=True)
    s = 3.0 / (50.0 + 3.0)
    expected = C * (50.0 + 10.0 * (1.0 - s)) / 60.0 + 10.0 * s * np.diag(np.diag(C)) / 60.0
    np.testing.assert_allclose(BoundedGaussianMixture(1, random_state=0).fit(X).covariances_[0], expected, rtol=1e-9)


@pytest.mark.parametrize(("size", "message"), [(1e200, "column 0, row .*1e\\+100"), (1e-200, "column 0 spreads over")])
def test_numbers_whose_squares_are_none(size, message):
    with pytest.raises(InputError, match=message):
        BoundedGaussianMixture(1, lower=0.0, random_state=0).fit(np.random.default_rng(0).random((50, 2)) * size)


def test_a_fall_is_no_convergence(monkeypatch):
    """A pass that loses ground ends the fit and is taken back."""
    X = np.random.default_rng(1).gamma(0.8, size=(300, 2))
    true, seen = _em.maximise, []

    def worse(stats, prior, now, step, points):
        new, moved = true(stats, prior, now, step, points)
        seen.append(now)
        if len(seen) < 5:
            return new, moved
        return TruncatedNormal(now.mu + 5.0, now.Sigma, now.lower, now.upper), moved

    monkeypatch.setattr(_em, "maximise", worse)
    model = BoundedGaussianMixture(1, lower=0.0, random_state=0, short_iter=2).fit(X)
    assert (model.converged_, model.stop_reason_, model.n_iter_) == (False, "collapsed", 4 - 2)
    np.testing.assert_allclose((model.means_ - X.mean(axis=0)) / X.std(axis=0), seen[-1].mu)
    assert np.min(np.diff(model.lower_bounds_)) >= 0.0


def test_wrong_names_and_no_fit_are_told():
    model = BoundedGaussianMixture(2, lower=0.0)
    assert model.set_params(tol=1e-3).tol == 1e-3
    assert "lower" in repr(model)
    with pytest.raises(InputError, match="did you mean 'lower'"):
        model.set_params(lowr=1)
    with pytest.raises(InputError, match="not fitted"):
        model.score([[1.0, 1.0]])


def rows(value, row=1, column=1):
    X = np.random.default_rng(0).uniform(0.1, 0.9, size=(30, 2))
    X[row, column] = value
    return X


@pytest.mark.parametrize(
    ("X", "settings", "message"),
    [
        (rows(0.0), {}, r"column 'b', row 1: .*0\.0.*strictly between the bounds 0 and 1 \(1 of 30 rows\)"),
        (rows(7.0), {}, r"column 'b', row 1: 7\.0"),
        (rows(np.nan), {}, r"column 'b', row 1: .*nan.*finite"),
        (rows(0.5)[:3], {"n_components": 2}, r"3 rows; allowed: at least K \(d \+ 1\) = 6"),
        (np.column_stack([rows(0.5)[:, 0], np.full(30, 0.5)]), {}, "column 'b' is constant"),
        (rows(0.5)[:, 0], {}, r"shape \(30,\); allowed: \(n, d\)"),
        ([["a", "b"]], {}, "not a table of numbers"),
        (rows(0.5), {"lower": [0.0, 2.0]}, r"lower\[1\] = 2\.0, upper\[1\] = 1\.0; allowed: lower < upper"),
        (rows(0.5), {"lower": [0.0]}, r"lower: shape \(1,\)"),
        (rows(0.5), {"n_components": 0}, "n_components: 0; allowed: an integer >= 1"),
        (rows(0.5), {"step": "newtn"}, "did you mean 'newton'"),
        (rows(0.5), {"prior_strength": -1.0}, "prior_strength: -1.0"),
        (rows(0.5), {"random_state": -1}, "random_state: -1"),
    ],
)
def test_bad_input(X, settings, message):
    arguments = {"n_components": 1, "lower": 0.0, "upper": 1.0, "names": ("a", "b"), "random_state": 0} | settings
    with pytest.raises(InputError, match=message):
        BoundedGaussianMixture(**arguments).fit(X)


def test_bad_parameters():
    with pytest.raises(InputError, match=r"weights: sum 0\.9"):
        BoundedGaussianMixture.from_parameters([0.5, 0.4], np.zeros((2, 1)), np.ones((2, 1, 1)))
    for off in (-1.1e-6, 1.1e-6):
        with pytest.raises(InputError, match=r"weights: sum (0\.9999989|1\.0000011), least"):
            BoundedGaussianMixture.from_parameters([0.5, 0.5 + off], np.zeros((2, 1)), np.ones((2, 1, 1)))
        BoundedGaussianMixture.from_parameters([0.5, 0.5 + 0.8 * off], np.zeros((2, 1)), np.ones((2, 1, 1)))
    with pytest.raises(InputError, match=r"weights: sum 1, least -0\.1"):
        BoundedGaussianMixture.from_parameters([1.1, -0.1], np.zeros((2, 1)), np.ones((2, 1, 1)))
    with pytest.raises(InputError, match=r"allowed: \(K,\) and \(K, d\)"):
        BoundedGaussianMixture.from_parameters([1.0], np.zeros((2, 1)), np.ones((2, 1, 1)))
