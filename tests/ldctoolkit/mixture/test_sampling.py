"""Drawn events, and truncated normals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import truncnorm

from helpers.examples import examples
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import SAMPLE_BLOCK, BoundedGaussianMixture, TruncatedNormal
from ldctoolkit.mixture._separation import Restricted, log_mass

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


def equicorrelated(d, r):
    return np.full((d, d), r) + (1.0 - r) * np.eye(d)


@pytest.mark.parametrize(
    ("a", "b"),
    [(-1.0, 2.0), (0.0, INF), (-INF, -3.0), (5.0, 6.0), (30.0, INF), (-40.0, -39.5), (-1e-4, 2e-4), (3.0, 3.0001)],
)
def test_interval_equals_scipy(a, b):
    A, B = np.array([a]), np.array([b])
    mass = log_mass(A, B)
    mean, variance = Restricted.of(A, B).moments()
    # scipy's own mass loses digits on narrow intervals: there the midpoint rule, exact to width^2, is the reference
    if b - a < 1e-3:
        middle = 0.5 * (a + b)
        np.testing.assert_allclose(mass, np.log(b - a) - 0.5 * middle**2 - 0.5 * np.log(2 * np.pi), rtol=1e-7)
    else:
        np.testing.assert_allclose(mass, _reference_mass(a, b), rtol=1e-11)
    np.testing.assert_allclose(mean, truncnorm.mean(a, b), rtol=1e-6)
    assert variance[0] > 0.0


def _reference_mass(a, b):
    """Logarithm of the mass by quadrature of the density scaled by its peak."""
    peak = min(max(0.0, a), b)
    x, w = np.polynomial.legendre.leggauss(400)
    low, high = max(a, peak - 12.0), min(b, peak + 12.0)
    if abs(peak) > 1.0 and not (a < 0 < b):  # exponential tail: a few scale lengths are enough
        low, high = max(low, peak - 40.0 / abs(peak)), min(high, peak + 40.0 / abs(peak))
    z = 0.5 * (high - low) * x + 0.5 * (high + low)
    value = np.sum(w * np.exp(-0.5 * (z**2 - peak**2))) * 0.5 * (high - low)
    return np.log(value) - 0.5 * peak**2 - 0.5 * np.log(2 * np.pi)


@examples(200)
@given(st.floats(-30, 30), st.floats(1e-3, 50), st.floats(1e-6, 1 - 1e-6))
def test_quantile_inverts_the_mass(a, width, u):
    A, B, U = np.array([a]), np.array([a + width]), np.array([u])
    whole = Restricted.of(A, B)
    total, z = whole.log_mass, whole.quantile(U, 1.0 - U)
    assert a <= z[0] <= a + width
    if a < z[0] < a + width:
        share = np.exp(log_mass(A, z) - total)
        # z itself is rounded: the share moves by (density at z) x (spacing of z), worst in tails at |z| = 30
        np.testing.assert_allclose(share, U, rtol=1e-6, atol=1e-9)


def test_orthant_of_the_equicorrelated_normal():
    """P(all > 0) at correlation 1/2 is 1/(d + 1), exactly."""
    for d, tolerance in ((3, 1e-9), (5, 1e-6), (8, 1e-4)):  # measured 3e-13, 1e-8, 3e-5
        t = TruncatedNormal(np.zeros((1, d)), [equicorrelated(d, 0.5)], np.zeros(d), np.full(d, INF))
        np.testing.assert_allclose(t.log_probability[0], -np.log(d + 1), atol=tolerance)


def test_open_dimensions_are_regression():
    """Dimensions without bounds change nothing for the others, and follow them linearly."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(5, 5))
    Sigma = A @ A.T + 0.2 * np.eye(5)
    mu = rng.normal(size=5)
    lower, upper = np.array([0.0, -INF, 0.5, -INF, -1.0]), np.array([INF, INF, 2.0, INF, 1.0])
    full = TruncatedNormal([mu], [Sigma], lower, upper)
    b, f = np.array([0, 2, 4]), np.array([1, 3])
    part = TruncatedNormal([mu[b]], [Sigma[np.ix_(b, b)]], lower[b], upper[b])
    assert full.log_probability[0] == part.log_probability[0]
    slope = Sigma[np.ix_(f, b)] @ np.linalg.inv(Sigma[np.ix_(b, b)])
    np.testing.assert_allclose(full.mean[0, f], mu[f] + slope @ (part.mean[0] - mu[b]), rtol=1e-10)
    rest = Sigma[np.ix_(f, f)] - slope @ Sigma[np.ix_(b, f)]
    expected = rest + slope @ part.covariance[0] @ slope.T
    np.testing.assert_allclose(full.covariance[0][np.ix_(f, f)], expected, rtol=1e-8)


@pytest.mark.parametrize("shift", [0.5, -1.5, -6.0, -30.0])
def test_samples_have_the_moments_and_stay_inside(shift):
    """From plain rejection (P = 0.6) to a box 30 deviations away (ln P = -690)."""
    mu = np.array([shift, shift, shift, 0.0, 0.0])
    lower, upper = np.array([0.0, 0.0, 0.0, -INF, 0.0]), np.array([INF, INF, INF, INF, 2.0])
    t = TruncatedNormal([mu], [equicorrelated(5, 0.5)], lower, upper)
    n = 20_000
    x = t.sample(n, 1)
    assert np.all((x > lower) & (x < upper))
    error = np.sqrt(np.diag(t.covariance[0]) / n)
    assert np.all(np.abs(x.mean(axis=0) - t.mean[0]) < 4.5 * error)
    scale = np.sqrt(np.outer(np.diag(t.covariance[0]), np.diag(t.covariance[0])))
    # a product of two nearly exponential variables has a relative standard error of about 3/sqrt(n)
    assert np.all(np.abs(np.cov(x.T) - t.covariance[0]) < 4.5 * 3.0 / np.sqrt(n) * scale)
    assert np.array_equal(x, t.sample(n, 1))


@pytest.mark.parametrize(
    ("mu", "Sigma", "lower", "upper", "message"),
    [
        ([[0.0]], [[[1.0]]], [1.0], [0.0], r"lower\[0\] = .*allowed: lower < upper"),
        ([[0.0]], [[[1.0]]], [np.nan], [0.0], r"lower\[0\]"),
        ([[0.0, 0.0]], [[[1.0, 2.0], [2.0, 1.0]]], [0.0, 0.0], [1.0, 1.0], "not positive definite"),
        ([0.0], [[[1.0]]], [0.0], [1.0], "shapes"),
        ([[np.inf]], [[[1.0]]], [0.0], [1.0], "finite"),
    ],
)
def test_bad_input(mu, Sigma, lower, upper, message):
    with pytest.raises(InputError, match=message):
        TruncatedNormal(mu, Sigma, lower, upper)
