"""Truncated normals, easy and hard, and events drawn from mixtures."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize, minimize_scalar
from scipy.stats import truncnorm

from helpers.bits import examples
from helpers.errors import refused
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import SAMPLE_BLOCK, BoundedGaussianMixture, TruncatedNormal
from ldctoolkit.mixture._separation import Restricted
from ldctoolkit.mixture.truncated_normal import Sampler

INF = np.inf
LOWER = np.array([0.0, 0.0, -1.0, -INF, 0.0, -INF, -INF, -2.0])
UPPER = np.array([INF, 2.0, 1.0, 3.0, INF, INF, INF, 2.0])


def draw(t, n, seed, component=0):
    return Sampler(t, component).draw(n, np.random.default_rng(seed))


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
    share = np.bincount(label, minlength=10) / n
    assert np.all(np.abs(share - eta) < 4.0 * np.sqrt(eta * (1.0 - eta) / n))
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
        with refused("component 1", ModelError):
            model.sample(n, 0)
    with refused("component 1", ModelError):
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
def test_interval_equals_quadrature_and_scipy(a, b):
    A, B = np.array([a]), np.array([b])
    whole = Restricted.of(A, B)
    mean, variance = whole.moments()
    expected = interval(A, B)
    np.testing.assert_allclose(whole.log_mass, expected[0], rtol=1e-11)
    np.testing.assert_allclose(mean, truncnorm.mean(a, b), rtol=1e-6)  # scipy's loses digits on narrow intervals
    np.testing.assert_allclose(mean, expected[1], rtol=1e-11)
    np.testing.assert_allclose(variance, expected[2], rtol=1e-7)


@examples(200)
@given(st.floats(-30, 30), st.floats(1e-3, 50), st.floats(1e-6, 1 - 1e-6))
def test_quantile_inverts_the_mass(a, width, u):
    A, B, U = np.array([a]), np.array([a + width]), np.array([u])
    whole = Restricted.of(A, B)
    total, z = whole.log_mass, whole.quantile(U, 1.0 - U)
    assert a <= z[0] <= a + width
    if a < z[0] < a + width:
        share = np.exp(Restricted.of(A, z).log_mass - total)
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
    x = draw(t, n, 1)
    assert np.all((x > lower) & (x < upper))
    error = np.sqrt(np.diag(t.covariance[0]) / n)
    assert np.all(np.abs(x.mean(axis=0) - t.mean[0]) < 4.5 * error)
    scale = np.sqrt(np.outer(np.diag(t.covariance[0]), np.diag(t.covariance[0])))
    # a product of two nearly exponential variables has a relative standard error of about 3/sqrt(n)
    assert np.all(np.abs(np.cov(x.T) - t.covariance[0]) < 4.5 * 3.0 / np.sqrt(n) * scale)
    assert np.array_equal(x, draw(t, n, 1))


@pytest.mark.parametrize(
    ("mu", "Sigma", "lower", "upper", "path"),
    [
        ([[0.0]], [[[1.0]]], [1.0], [0.0], "bounds"),
        ([[0.0]], [[[1.0]]], [np.nan], [0.0], "bounds"),
        ([[0.0, 0.0]], [[[1.0, 2.0], [2.0, 1.0]]], [0.0, 0.0], [1.0, 1.0], "truncated normal"),
        ([0.0], [[[1.0]]], [0.0], [1.0], "truncated normal"),
        ([[np.inf]], [[[1.0]]], [0.0], [1.0], "truncated normal"),
    ],
)
def test_bad_input(mu, Sigma, lower, upper, path):
    with refused(path):
        TruncatedNormal(mu, Sigma, lower, upper)


@pytest.mark.parametrize(("d", "points"), [(2, 1023), (11, 1021)])
def test_lattices_that_there_are_not(d, points):
    with refused("truncated normal", allowed="[1021, 4093, 16381] in at most 10"):
        TruncatedNormal(np.zeros((1, d)), [np.eye(d)], np.zeros(d), np.full(d, INF), points=points)


NODES, WEIGHTS = np.polynomial.legendre.leggauss(80)
LOG_ROOT_2PI = 0.5 * np.log(2.0 * np.pi)


def interval(a, b):
    """Log mass, mean and variance of the standard normal on (a, b): two panels about the peak."""
    peak = np.clip(0.0, a, b)
    reach = 80.0 / (np.abs(peak) + np.sqrt(peak**2 + 80.0))  # where the density has fallen to exp(-40)
    low, high = np.maximum(a, peak - reach), np.minimum(b, peak + reach)
    half = 0.25 * (high - low)[..., None]
    t = np.concatenate([half * (NODES + 1.0), half * (NODES + 3.0)], axis=-1)
    offset = (low - peak)[..., None] + t
    density = np.exp(-offset * peak[..., None] - 0.5 * offset**2) * half * np.concatenate([WEIGHTS, WEIGHTS])
    total = density.sum(axis=-1)
    mean = (density * offset).sum(axis=-1) / total
    variance = (density * (offset - mean[..., None]) ** 2).sum(axis=-1) / total
    return np.log(total) - 0.5 * peak**2 - LOG_ROOT_2PI, peak + mean, variance


def reference(mu, loadings, lower, upper):
    """ln P, mean and covariance; unit variances."""
    own = np.sqrt(1.0 - np.sum(loadings**2, axis=1))
    q = loadings.shape[1]

    def given(f):
        shift = mu + f @ loadings.T
        log_mass, mean, variance = interval((lower - shift) / own, (upper - shift) / own)
        return (
            log_mass.sum(axis=1) - 0.5 * np.sum(f**2, axis=1) - q * LOG_ROOT_2PI,
            shift + own * mean,
            own**2 * variance,
        )

    def log_density(f):
        return float(given(np.reshape(f, (1, q)))[0][0])

    best = minimize(
        lambda f: -log_density(f), np.zeros(q), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8}
    )

    def profile(axis, value):
        if q == 1:
            return log_density([value])
        rest = best.x[1 - axis]
        line = minimize_scalar(
            lambda w: -log_density([value, w] if axis == 0 else [w, value]), bracket=(rest - 0.1, rest + 0.1), tol=1e-4
        )
        return -line.fun

    panels, axes = 10 if q == 1 else 6, []
    for axis in range(q):
        ends = []
        for sign in (-1.0, 1.0):
            step = 1e-3
            while profile(axis, best.x[axis] + sign * step) > -best.fun - 40.0:
                step *= 1.5
            ends.append(best.x[axis] + sign * step)
        x, w = np.polynomial.legendre.leggauss(60 if q == 1 else 16)
        edges = np.linspace(*ends, panels + 1)
        half = 0.5 * np.diff(edges)[:, None]
        axes.append(((half * (x + 1.0) + edges[:-1, None]).ravel(), (half * w).ravel()))
    f = np.stack([g.ravel() for g in np.meshgrid(*(axis[0] for axis in axes), indexing="ij")], axis=1)
    weight = axes[0][1] if q == 1 else np.outer(axes[0][1], axes[1][1]).ravel()
    value, centre, variance = (np.concatenate(p) for p in zip(*(given(r) for r in np.array_split(f, 8)), strict=True))
    share = weight * np.exp(value - value.max())
    total = share.sum()
    share /= total
    mean = share @ centre
    gap = centre - mean
    return np.log(total) + value.max(), mean, (gap * share[:, None]).T @ gap + np.diag(share @ variance)


def equal(d, r):
    """Loadings of equal correlations r; of alternating signs where r is negative."""
    sign = (-1.0) ** np.arange(d) if r < 0.0 else np.ones(d)
    return (np.sqrt(abs(r)) * sign)[:, None]


def hard_list(d):
    """Name -> mu, loadings, lower, upper."""
    zero, ones, out = np.zeros(d), np.ones(d), {}
    for r in (0.95, -0.9, 0.5):
        out[f"r = {r}, one-sided"] = zero, equal(d, r), zero, INF * ones
        out[f"r = {r}, two-sided"] = 0.3 * ones, equal(d, r), -0.5 * ones, 0.7 * ones
    for distance in (4.0, 30.0):
        for where in sorted({1, min(3, d)}):
            mu = np.where(np.arange(d) < where, -distance, 0.0)
            for r in (0.5, 0.95, -0.9):
                out[f"{distance:g} sigma out in {where}, r = {r}"] = mu, equal(d, r), zero, INF * ones
    for j in (0, d - 1):
        slab = np.arange(d) == j
        for r in (0.5, 0.95, -0.9):
            out[f"slab in {j}, r = {r}"] = zero, equal(d, r), np.where(slab, 0.5, -1.0), np.where(slab, 0.6, 1.5)
    out["P about 1e-8"] = np.full(d, -4.6 - 0.15 * d), equal(d, 0.8), zero, INF * ones
    for seed in range(3):  # seeds that no choice of points was made on
        rng = np.random.default_rng([seed, d])
        loadings = rng.normal(size=(d, 2))
        loadings *= (rng.uniform(0.3, 0.97, d) / np.linalg.norm(loadings, axis=1))[:, None]
        upper = np.where(rng.random(d) < 0.5, 1.5, INF)
        out[f"two factors, seed {seed}"] = 1.5 * rng.normal(size=d), loadings, zero, upper
    return out


def covariance_of(loadings):
    Sigma = loadings @ loadings.T
    np.fill_diagonal(Sigma, 1.0)
    return Sigma


def errors(t, Sigma, expected):
    """Of ln P, whitened mean and whitened covariance."""
    log_p, mean, covariance = expected
    inverse = np.linalg.inv(np.linalg.cholesky(Sigma))
    return (
        abs(t.log_probability[0] - log_p),
        np.abs(inverse @ (t.mean[0] - mean)).max(),
        np.abs(inverse @ (t.covariance[0] - covariance) @ inverse.T).max(),
    )


def check(name, mu, Sigma, lower, upper, expected, points):
    t = TruncatedNormal([mu], [Sigma], lower, upper, points=points)
    result = errors(t, Sigma, expected)
    # ln P to 1e-4, whitened mean to 2e-4, whitened covariance to 1e-3: what a fit needs to keep its 1e-6 a pass honest
    assert all(np.array(result) <= (1e-4, 2e-4, 1e-3)), f"{name}, {points} points: {result}"
    return t


@pytest.mark.parametrize("d", [2, *(pytest.param(d, marks=pytest.mark.slow) for d in (1, 3, 5))])
def test_hard_boxes_equal_the_factor_integral(d):
    """Both numbers of points, 1,021 of the fits and 4,093."""
    for name, (mu, loadings, lower, upper) in hard_list(d).items():
        Sigma = covariance_of(loadings)
        expected = reference(mu, loadings, lower, upper)
        check(name, mu, Sigma, lower, upper, expected, 1021)
        t = check(name, mu, Sigma, lower, upper, expected, 4093)
        # in units of the moments inside the box, 30 sigma outside included: measured 3e-6 and 2e-5
        inverse = np.linalg.inv(np.linalg.cholesky(expected[2]))
        assert np.abs(inverse @ (t.mean[0] - expected[1])).max() < 2e-5, name
        assert np.abs(inverse @ (t.covariance[0] - expected[2]) @ inverse.T).max() < 2e-4, name


@pytest.mark.slow
@pytest.mark.parametrize("d", [6, 8])
def test_hard_boxes_in_many_dimensions_equal_the_factor_integral(d):
    for name, (mu, loadings, lower, upper) in hard_list(d).items():
        Sigma = covariance_of(loadings)
        check(name, mu, Sigma, lower, upper, reference(mu, loadings, lower, upper), None)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_five_bounded_of_eight_equal_the_factor_integral(seed):
    rng = np.random.default_rng([seed, 58])
    loadings = rng.normal(size=(8, 2))
    loadings *= (rng.uniform(0.3, 0.97, 8) / np.linalg.norm(loadings, axis=1))[:, None]
    lower = np.array([0.0, -INF, 0.0, 0.0, -INF, -1.0, -INF, -INF])
    upper = np.array([INF, INF, 1.5, INF, INF, 2.0, 0.5, INF])
    mu = 1.5 * rng.normal(size=8)
    expected = reference(mu, loadings, lower, upper)
    for points in (1021, 4093):
        check(f"seed {seed}", mu, covariance_of(loadings), lower, upper, expected, points)


FAR = (-40.0, -300.0, -14142.0, -3e5)  # the last but one: ln P = -1e8


@pytest.mark.parametrize("d", [1, 2, 5])
@pytest.mark.parametrize("r", [0.5, -0.9])
def test_far_outside_is_exact_to_rounding(d, r):
    """A box so far off that the density inside is exponential: independent ones, where the reference allows it."""
    for distance in FAR:
        mu, Sigma = np.full(d, distance), covariance_of(equal(d, r))
        rate = np.linalg.solve(Sigma, -mu)  # slope of the log-density at the corner
        t = TruncatedNormal([mu], [Sigma], np.zeros(d), np.full(d, INF))
        if rate.min() > 0.0:
            # density exp(-rate.x - x Sigma^-1 x/2), whose curvature moves the moments by 1/rate^2 relative
            log_p = 0.5 * mu @ rate - np.log(rate).sum()
            log_p -= 0.5 * np.linalg.slogdet(Sigma)[1] + d * LOG_ROOT_2PI
            # and whitened points of size sqrt(-2 ln P) are rounded, against a spread of its inverse
            loose = 20.0 * np.linalg.inv(Sigma).max() / rate.min() ** 2 + 1e-4 - 2e-15 * log_p
            np.testing.assert_allclose(t.log_probability[0], log_p, rtol=1e-12, atol=loose)
            np.testing.assert_allclose(t.mean[0] * rate, 1.0, atol=loose)
            np.testing.assert_allclose(np.diag(t.covariance[0]) * rate**2, 1.0, atol=4 * loose)
        x = draw(t, 1000, 3)
        assert np.all(x > 0.0)
        # five standard errors, ten comparisons a case: one false alarm in 2e5
        assert np.all(np.abs(x.mean(axis=0) - t.mean[0]) < 5.0 * np.sqrt(np.diag(t.covariance[0]) / 1000)), distance


@pytest.mark.slow
def test_nearly_opposite_variables_in_a_far_corner_are_tilted():
    """Plain Newton steps do not find this tilt; ln P = -9e4 in a box that is 1e-3 wide one way and open the other."""
    r = -0.999999
    mu, Sigma = np.full(2, -0.3), np.array([[1.0, r], [r, 1.0]])
    t = TruncatedNormal([mu], [Sigma], [0.0, 0.0], [2.0, INF])
    rate = np.linalg.solve(Sigma, -mu)
    # exp(-rate.(x1 + x2) - (x1 - x2)^2/(4 (1 - |r|))...): along x1 + x2 exponential of rate 3e5, across it no bound
    # of x1 - x2 is felt before the corner's faces: log-density by brute force on a grid in x * rate
    g = (np.arange(4000) + 0.5) / 100.0
    x, y = np.meshgrid(g / rate[0], g / rate[1], indexing="ij")
    precision = np.linalg.inv(Sigma)
    exponent = -(rate[0] * x + rate[1] * y)
    exponent -= 0.5 * (precision[0, 0] * x * x + 2 * precision[0, 1] * x * y + precision[1, 1] * y * y)
    cell = (0.01 / rate[0]) * (0.01 / rate[1])
    expected = np.log(np.exp(exponent).sum() * cell) - 0.5 * mu @ np.linalg.solve(Sigma, mu)
    expected -= 0.5 * np.log(1.0 - r * r) + 2 * LOG_ROOT_2PI
    # Sigma itself is rounded to 1e-16/1e-6 relative, which moves ln P by 9e4 times that
    np.testing.assert_allclose(t.log_probability[0], expected, atol=1e-4)
    sample = draw(t, 2000, 1)
    assert np.all((sample > 0.0) & (sample[:, :1] < 2.0))
    weight = np.exp(exponent)
    np.testing.assert_allclose(t.mean[0, 0], (weight * x).sum() / weight.sum(), rtol=1e-3)


@pytest.mark.parametrize("width", [1e-12, 1e-6, 1e3, 1e10, 1e150])
@pytest.mark.parametrize("far", [0.3, -30.0])
def test_tiny_and_huge_boxes(width, far):
    d = 3
    Sigma = covariance_of(equal(d, 0.7))
    lower = np.zeros(d) if width < 1.0 else np.full(d, -width)
    lower = np.zeros(d) if far < 0.0 else lower
    with np.errstate(all="raise", under="ignore"):
        t = TruncatedNormal([np.full(d, far)], [Sigma], lower, np.full(d, width))
    x = draw(t, 500, 2)
    assert np.all((x > lower) & (x < width))
    assert np.all((t.mean >= lower) & (t.mean <= width))
    if width == 1e-12 and far > 0.0:  # uniform on the cube
        flat = -0.5 * np.full(d, far) @ np.linalg.solve(Sigma, np.full(d, far)) - 0.5 * np.linalg.slogdet(Sigma)[1]
        np.testing.assert_allclose(t.log_probability[0], d * (np.log(width) - LOG_ROOT_2PI) + flat, atol=1e-4)
        np.testing.assert_allclose(t.mean[0], 0.5 * width, rtol=1e-3)  # 0.3 + 1e-12 keeps four digits of 1e-12
    if width >= 1e3 and far > 0.0:
        assert t.log_probability[0] == pytest.approx(0.0, abs=1e-12)
        np.testing.assert_allclose(t.covariance[0], Sigma, atol=1e-5)


def test_a_tilt_that_was_not_found_is_an_error(monkeypatch):
    from ldctoolkit.mixture import _separation

    lost = lambda strict, a, b: (np.zeros_like(a), np.full(a.shape[0], INF))  # noqa: E731
    monkeypatch.setattr(_separation, "minimax_tilt", lost)
    t = TruncatedNormal([[-5.0, 0.0]], [covariance_of(equal(2, 0.5))], [0.0, 0.0], [INF, INF])
    with refused("truncated normal", ModelError):
        draw(t, 1, 0)


def test_calls_repeat_and_leave_their_inputs_alone():
    mu = np.array([[0.2, -6.0], [1.0, 0.5]])
    Sigma = np.array([covariance_of(equal(2, 0.5)), covariance_of(equal(2, -0.8))])
    lower, upper = np.array([0.0, 0.0]), np.array([1.0, INF])
    given = [a.copy() for a in (mu, Sigma, lower, upper)]
    normal, same = TruncatedNormal(mu, Sigma, lower, upper), TruncatedNormal(mu, Sigma, lower, upper)
    for name in ("log_probability", "mean", "covariance"):
        assert np.array_equal(getattr(normal, name), getattr(same, name))
    first = [draw(normal, 100, 4, k) for k in (0, 1)]
    again = [draw(normal, 100, 4, k) for k in (0, 1)]
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert all(np.array_equal(a, b) for a, b in zip(given, (mu, Sigma, lower, upper), strict=True))


def test_components_do_not_depend_on_their_neighbours():
    """One at a time, all at once, and in pieces (4,093 points take four at once) are the same numbers."""
    rng = np.random.default_rng(5)
    mu, Sigma = rng.normal(size=(7, 3)) - 2.0, np.repeat(covariance_of(equal(3, 0.6))[None], 7, axis=0)
    lower, upper = np.zeros(3), np.array([INF, 1.0, 2.0])
    together = TruncatedNormal(mu, Sigma, lower, upper)
    for k in range(7):
        alone = TruncatedNormal(mu[k : k + 1], Sigma[k : k + 1], lower, upper)
        np.testing.assert_allclose(alone.log_probability[0], together.log_probability[k], rtol=1e-13)
        np.testing.assert_allclose(alone.covariance[0], together.covariance[k], rtol=1e-11, atol=1e-14)


def test_independent_variables_are_exact_however_few_the_points():
    """With equal weights nothing but the known conditional moments is left, in eight dimensions too."""
    d = 8
    mu = np.linspace(-30.0, 2.0, d)
    upper = np.where(np.arange(d) % 2 == 0, 1.5, INF)
    t = TruncatedNormal([mu], [np.eye(d)], np.zeros(d), upper, points=1021)
    log_p, mean, variance = interval(-mu, upper - mu)
    # rounding of both quadratures; the lattice alone is wrong by 5e-2 here
    np.testing.assert_allclose(t.log_probability[0], log_p.sum(), rtol=1e-12)
    np.testing.assert_allclose(t.mean[0], mu + mean, rtol=1e-8)
    np.testing.assert_allclose(t.covariance[0], np.diag(variance), rtol=1e-6, atol=1e-9)
