"""The estimator: settings, weights, what a fit reports, and its optimum."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, truncnorm

from helpers.errors import refused
from ldctoolkit.errors import NOT_GIVEN, UnknownArgumentError
from ldctoolkit.mixture import BoundedGaussianMixture, TruncatedNormal, _em
from ldctoolkit.mixture._distribution import Components, log_terms, shares

INF = np.inf


TRUE = BoundedGaussianMixture.from_parameters(
    [0.4, 0.6], [[0.2, 0.0], [2.0, 3.0]], [[[1.0, 0.5], [0.5, 1.0]], [[0.5, -0.2], [-0.2, 0.8]]], lower=[0.0, -INF]
)


def events(n=900):
    """Two components in two dimensions, a bound cutting one."""
    return TRUE.sample(n, 0)[0]


def assert_equal_fits(one, two, tolerance):
    """Parameters in units of the data's spread, here about one."""
    np.testing.assert_allclose(one.weights_, two.weights_, atol=tolerance)
    np.testing.assert_allclose(one.means_, two.means_, atol=tolerance)
    np.testing.assert_allclose(one.covariances_, two.covariances_, atol=tolerance)


def assert_same_bits(one, two):
    for name in ("weights_", "means_", "covariances_", "log_probabilities_", "lower_bounds_"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


FEW = {"lower": [0.0, -INF], "random_state": 0, "n_init": 2, "max_iter": 30}


def test_a_fit_returns_the_estimator_and_leaves_its_settings_as_they_were():
    lower, names = [0.0, -INF], ["a", "b"]
    model, other = (
        BoundedGaussianMixture(2, lower=lower, names=names, random_state=3, n_init=1, max_iter=5) for _ in range(2)
    )
    before = repr(model)
    assert model.fit(events()) is model
    assert repr(model) == before
    assert model.lower is lower
    assert_same_bits(model.fit(events()), other.fit(events()))  # once more: nothing is left of the first fit


def test_threads_change_no_bit():
    X = np.tile(events(4000), (5, 1))  # three blocks
    one = BoundedGaussianMixture(2, n_jobs=1, **FEW | {"max_iter": 8}).fit(X)
    for jobs in (2, 5, None):
        assert_same_bits(BoundedGaussianMixture(2, n_jobs=jobs, **FEW | {"max_iter": 8}).fit(X), one)


def test_single_precision_is_widened():
    X = events().astype(np.float32)
    X = X[X[:, 0] > 0.0]
    assert_same_bits(BoundedGaussianMixture(2, **FEW).fit(X), BoundedGaussianMixture(2, **FEW).fit(X.astype(float)))


@pytest.mark.parametrize("transform", [None, "auto"])
def test_the_data_are_not_changed(transform):
    X = events()
    weight = np.random.default_rng(0).uniform(size=X.shape[0])
    before, weight_before = X.copy(), weight.copy()
    model = BoundedGaussianMixture(2, transform=transform, **FEW).fit(X, sample_weight=weight)
    for method in (model.score_samples, model.score, model.bic):
        method(X)
    np.testing.assert_array_equal(X, before)
    np.testing.assert_array_equal(weight, weight_before)


# one component: no start is drawn, so fits to other rows take the same way
ONE = {"lower": [0.0, -INF], "tol": 1e-10, "max_iter": 2000, "random_state": 0}


def test_whole_weights_are_repeated_rows():
    X = events(400)
    weight = np.random.default_rng(1).integers(1, 5, size=400)
    by_weight = BoundedGaussianMixture(1, **ONE).fit(X, sample_weight=weight)
    by_rows = BoundedGaussianMixture(1, **ONE).fit(np.repeat(X, weight, axis=0))
    # the same sums in another order
    np.testing.assert_allclose(by_weight.lower_bound_, by_rows.lower_bound_, rtol=1e-11)
    assert_equal_fits(by_weight, by_rows, 1e-7)
    np.testing.assert_allclose(by_weight.score(X, sample_weight=weight), by_rows.score(np.repeat(X, weight, axis=0)))


def test_rows_without_weight_are_absent_from_the_starts_too():
    X = np.vstack([events(600), np.full((50, 2), 40.0)])
    weight = np.concatenate([np.ones(600), np.zeros(50)])
    model = BoundedGaussianMixture(2, **FEW).fit(X, sample_weight=weight)
    assert model.means_.max() < 10.0


def test_without_a_prior_the_scale_of_the_weights_does_not_matter():
    X = events(600)
    weight = np.random.default_rng(2).uniform(0.1, 3.0, size=600)
    first = BoundedGaussianMixture(1, prior_strength=0.0, **ONE).fit(X, sample_weight=weight)
    second = BoundedGaussianMixture(1, prior_strength=0.0, **ONE).fit(X, sample_weight=1e-3 * weight)
    assert_equal_fits(first, second, 1e-7)


@pytest.mark.parametrize(
    ("weight", "path", "allowed"),
    [
        (np.ones(5), "sample_weight", "(900,), one number a row"),
        (np.r_[np.ones(899), -1.0], "sample_weight: row 899", "finite numbers >= 0"),
        (np.r_[np.nan, np.ones(899)], "sample_weight: row 0", "finite numbers >= 0"),
        (np.zeros(900), "sample_weight", "at least one event"),
        (["a"] * 900, "sample_weight", "one number >= 0 a row"),
    ],
)
def test_wrong_weights(weight, path, allowed):
    with refused(path, allowed=allowed):
        BoundedGaussianMixture(2, **FEW).fit(events(), sample_weight=weight)


def test_progress_is_written_on_stderr_and_only_on_demand(capsys):
    X = events()
    silent = BoundedGaussianMixture(2, **FEW).fit(X)
    out, err = capsys.readouterr()
    assert (out, err) == ("", "")
    verbose = BoundedGaussianMixture(2, verbose=1, **FEW).fit(X)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert all(line.startswith("K = 2: ") for line in lines)
    assert sum("start 1 of 2" in line for line in lines) == 1
    assert sum(line.startswith("K = 2: pass ") for line in lines) == verbose.n_iter_
    assert f"pass {verbose.n_iter_}: {verbose.lower_bound_:.8f} nats an event" in lines[-1]
    assert_same_bits(verbose, silent)


def test_the_best_start_is_continued(capsys):
    X = np.random.default_rng(3).gamma(1.5, size=(400, 2))
    few = {"n_init": 4, "short_iter": 5, "max_iter": 2, "split_merge": False, "verbose": 1}
    model = BoundedGaussianMixture(4, lower=0.0, random_state=0, **few).fit(X)
    ends = [float(line.split()[-4]) for line in capsys.readouterr().err.splitlines() if " of 4: " in line]
    # the long run, of another prior's target, begins 0.006 above the end of its start: less than these lie apart
    assert ends[2] == max(ends) > ends[0] + 0.015
    assert model.lower_bounds_[0] > max(ends)


def test_few_rows_with_weight_are_drawn_for_the_starts():
    X = events()
    weight = np.zeros(X.shape[0])
    weight[::90] = 1.0
    model = BoundedGaussianMixture(1, lower=[0.0, -INF], subsample=9, n_init=1, random_state=3)
    np.testing.assert_allclose(model.fit(X, sample_weight=weight).means_, model.fit(X[::90]).means_, rtol=1e-6)
    with refused("X", allowed="at least K (d + 1) = 6 for K = 2, d = 2"):
        BoundedGaussianMixture(2, random_state=0).fit(X, sample_weight=np.arange(X.shape[0]) < 5)


def test_rows_of_no_weight_may_lie_outside():
    model = BoundedGaussianMixture.from_parameters([0.5, 0.5], [[0.0], [3.0]], np.ones((2, 1, 1)), lower=0.0)
    X, weight = [[-1.0], [1.0], [2.5]], [0.0, 2.0, 1.0]
    repeated = [[1.0], [1.0], [2.5]]
    for question in (model.score, model.bic):
        answer = question(X, sample_weight=weight)
        assert answer == pytest.approx(question(repeated), rel=1e-12)


def test_the_likelihood_never_falls_and_the_fit_is_near_the_truth():
    X = events(3000)
    model = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=1, n_init=4, max_iter=300).fit(X)
    assert np.min(np.diff(model.lower_bounds_)) >= -1e-8 * abs(model.lower_bound_)
    assert model.n_iter_ == model.lower_bounds_.size - 1
    held_out = TRUE.sample(20_000, 9)[0]
    assert TRUE.score(held_out) - model.score(held_out) < 4.0 * model.n_parameters() / (2 * 3000)


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
    X = events(800)
    scale = np.array([1e-4, 1e3])
    first = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=0, n_init=2, max_iter=30).fit(X)
    second = BoundedGaussianMixture(2, lower=[0.0, -INF], random_state=0, n_init=2, max_iter=30).fit(X * scale)
    np.testing.assert_allclose(second.means_, first.means_ * scale, rtol=1e-6)
    np.testing.assert_allclose(second.score(X * scale), first.score(X) - np.log(scale).sum(), rtol=1e-8)


def mean_residual(model, X):
    """Weighted data mean minus mean inside the box, in standard deviations of the data: 0 at a maximum. The prior does
    not depend on mu, so this holds with and without it."""
    t = model.distribution.truncated
    share = shares(log_terms(X, Components(model.weights_, t.mu, t.Sigma, t.log_probability)))
    weighted = (share.T @ X) / share.sum(axis=0)[:, None]
    return np.abs((weighted - t.mean) / X.std(axis=0))


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
    still = lambda stats, prior, now, points: (now, np.zeros(now.mu.shape[0], dtype=bool))  # noqa: E731
    monkeypatch.setattr(_em, "maximise", still)
    model = BoundedGaussianMixture(1, lower=0.0, random_state=0).fit(X)
    assert (model.converged_, model.stop_reason_) == (False, "stuck")
    monkeypatch.undo()
    short = BoundedGaussianMixture(2, lower=0.0, random_state=0, max_iter=3).fit(X)
    assert (short.converged_, short.stop_reason_) == (False, "max_iter")


def test_the_rule_for_stopping():
    """Five passes that gain less than 5 tol together: the last five do, the five before the last pass do not."""
    X = events(800)
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


@pytest.mark.parametrize(("size", "path"), [(1e200, "X: column 0, row 0"), (1e-200, "X: column 0")])
def test_numbers_whose_squares_overflow_or_vanish(size, path):
    with refused(path):
        BoundedGaussianMixture(1, lower=0.0, random_state=0).fit(np.random.default_rng(0).random((50, 2)) * size)


def test_a_fall_is_no_convergence(monkeypatch):
    """A pass that loses ground ends the fit and is taken back."""
    X = np.random.default_rng(1).gamma(0.8, size=(300, 2))
    true, seen = _em.maximise, []

    def worse(stats, prior, now, points):
        new, moved = true(stats, prior, now, points)
        seen.append(now)
        if len(seen) < 5:
            return new, moved
        return TruncatedNormal(now.mu + 5.0, now.Sigma, now.lower, now.upper), moved

    monkeypatch.setattr(_em, "maximise", worse)
    model = BoundedGaussianMixture(1, lower=0.0, random_state=0, short_iter=2).fit(X)
    assert (model.converged_, model.stop_reason_, model.n_iter_) == (False, "collapsed", 4 - 2)
    np.testing.assert_allclose((model.means_ - X.mean(axis=0)) / X.std(axis=0), seen[-1].mu)
    assert np.min(np.diff(model.lower_bounds_)) >= 0.0


def test_wrong_names_and_a_missing_fit():
    assert "lower" in repr(BoundedGaussianMixture(2, lower=0.0))
    with refused("BoundedGaussianMixture", UnknownArgumentError, value="lowr"):
        BoundedGaussianMixture(2, lowr=0.0)
    with refused("BoundedGaussianMixture", hint="call fit first"):
        BoundedGaussianMixture(2, lower=0.0).score([[1.0, 1.0]])


def rows(value, row=1, column=1):
    X = np.random.default_rng(0).uniform(0.1, 0.9, size=(30, 2))
    X[row, column] = value
    return X


@pytest.mark.parametrize(
    ("X", "settings", "path", "value"),
    [
        (rows(0.0), {}, "X: column 'b', row 1", 0.0),
        (rows(7.0), {}, "X: column 'b', row 1", 7.0),
        (rows(INF), {}, "X: column 'b', row 1", INF),
        (rows(0.5)[:3], {"n_components": 2}, "X", NOT_GIVEN),
        (np.column_stack([rows(0.5)[:, 0], np.full(30, 0.5)]), {}, "X: column 'b'", NOT_GIVEN),
        (rows(0.5)[:, 0], {}, "X", NOT_GIVEN),
        ([["a", "b"]], {}, "X", NOT_GIVEN),
        (rows(0.5), {"lower": [0.0, 2.0]}, "bounds", NOT_GIVEN),
        (rows(0.5), {"lower": [0.0]}, "lower", NOT_GIVEN),
        (rows(0.5), {"n_components": 0}, "n_components", 0),
        (rows(0.5), {"max_iter": 1.5}, "max_iter", 1.5),
        (rows(0.5), {"prior_strength": -1.0}, "prior_strength", -1.0),
        (rows(0.5), {"random_state": -1}, "random_state", -1),
        (rows(0.5), {"n_jobs": 0}, "n_jobs", 0),
        (rows(0.5), {"names": ("a",)}, "names", NOT_GIVEN),
    ],
)
def test_bad_input(X, settings, path, value):
    arguments = {"n_components": 1, "lower": 0.0, "upper": 1.0, "names": ("a", "b"), "random_state": 0} | settings
    with refused(path, value=value):
        BoundedGaussianMixture(**arguments).fit(X)


@pytest.mark.parametrize("weights", [[0.5, 0.4], [0.5, 0.5 - 1.1e-6], [0.5, 0.5 + 1.1e-6], [1.1, -0.1]])
def test_bad_parameters(weights):
    with refused("weights", allowed="shares >= 0 that sum to 1"):
        BoundedGaussianMixture.from_parameters(weights, np.zeros((2, 1)), np.ones((2, 1, 1)))
    for off in (-0.9e-6, 0.9e-6):
        BoundedGaussianMixture.from_parameters([0.5, 0.5 + off], np.zeros((2, 1)), np.ones((2, 1, 1)))
    with refused("weights, means", allowed="(K,), (K, d)"):
        BoundedGaussianMixture.from_parameters([1.0], np.zeros((2, 1)), np.ones((2, 1, 1)))
