"""Sampling of whole mixtures: exact, inside, and a function of the seed alone."""

import numpy as np
import pytest

from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import SAMPLE_BLOCK, BoundedGaussianMixture

INF = np.inf
LOWER = np.array([0.0, 0.0, -1.0, -INF, 0.0, -INF, -INF, -2.0])
UPPER = np.array([INF, 2.0, 1.0, 3.0, INF, INF, INF, 2.0])


def ten_components():
    """K = 10 in eight dimensions, six of them bounded; ln P from -0.07 to -13."""
    rng = np.random.default_rng(10)
    A = rng.normal(size=(10, 8, 8))
    Sigma = (A @ A.transpose(0, 2, 1) / 8 + 0.1 * np.eye(8)) * np.linspace(0.1, 1.0, 10)[:, None, None]
    mu = rng.normal(size=(10, 8)) * np.linspace(0.1, 2.5, 10)[:, None] + 0.5
    weights = rng.uniform(0.5, 1.5, 10)
    return BoundedGaussianMixture.from_parameters(weights / weights.sum(), mu, Sigma, lower=LOWER, upper=UPPER)


@pytest.mark.parametrize("n", [60_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_events_have_the_shares_and_moments(n):
    model = ten_components()
    x, label = model.sample(n, 20)
    assert np.all((x > LOWER) & (x < UPPER))
    t, eta = model.distribution.truncated, model.weights_
    assert t.log_probability.min() < -10.0  # both ways of drawing are at work
    assert t.log_probability.max() > np.log(0.25)
    # 10 shares, 80 means and 360 covariances within four standard errors: for a fresh seed a false alarm in 36
    found = np.bincount(label, minlength=10) / n
    assert np.all(np.abs(found - eta) < 4.0 * np.sqrt(eta * (1.0 - eta) / n))
    for k in range(10):
        y = x[label == k]
        m = y.shape[0]
        gap = y - t.mean[k]
        # the moments of the lattice themselves are right to 1e-4 of the spread, a tenth of a standard error
        assert np.all(np.abs(gap.mean(axis=0)) < 4.0 * y.std(axis=0) / np.sqrt(m))
        for j in range(8):
            products = gap * gap[:, j : j + 1]
            error = products.std(axis=0) / np.sqrt(m)
            assert np.all(np.abs(products.mean(axis=0) - t.covariance[k, j]) < 4.0 * error), (k, j)


def test_events_do_not_depend_on_how_many_are_drawn():
    model = ten_components()
    n = 3 * SAMPLE_BLOCK + 17
    x, label = model.sample(n, 5)
    for m in (0, 1, SAMPLE_BLOCK, SAMPLE_BLOCK + 1, n - 1):
        fewer, few_labels = model.sample(m, 5)
        assert np.array_equal(fewer, x[:m])
        assert np.array_equal(few_labels, label[:m])
    assert not np.array_equal(model.sample(10, 6)[0], x[:10])


def test_a_block_is_the_stream_of_its_key():
    distribution = ten_components().distribution
    x, label = distribution.sample_block(5, (1,))
    assert x.shape == (SAMPLE_BLOCK, 8)
    whole, labels = distribution.sample(2 * SAMPLE_BLOCK, 5)
    assert np.array_equal(whole[SAMPLE_BLOCK:], x)
    assert np.array_equal(labels[SAMPLE_BLOCK:], label)
    assert not np.array_equal(distribution.sample_block(5, (0, 1))[0], x)


def test_an_unreachable_component_is_an_error_that_names_it():
    """And one without weight is never drawn."""
    mu, Sigma = np.array([[0.5], [-1e8]]), np.ones((2, 1, 1))
    model = BoundedGaussianMixture.from_parameters([0.5, 0.5], mu, Sigma, lower=0.0)
    for n in (10, 2 * SAMPLE_BLOCK):
        with pytest.raises(ModelError, match=r"component 1: .*no proposal reaches it"):
            model.sample(n, 0)
    with pytest.raises(ModelError, match="component 1"):
        model.distribution.check_samplable()
    without = BoundedGaussianMixture.from_parameters([1.0, 0.0], mu, Sigma, lower=0.0)
    without.distribution.check_samplable()
    assert without.sample(100, 0)[1].max() == 0
