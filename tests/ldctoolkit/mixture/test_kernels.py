"""The compiled E-step against plain numpy in extended precision."""

import numpy as np
import pytest

from ldctoolkit.mixture._kernels import log_density_of_rows, statistics_of_rows


def problem(K, d, n, seed=0, size=1.0):
    """Rows, location, scale, and coefficients of K normals in standardised coordinates."""
    rng = np.random.default_rng(seed)
    location, scale = rng.normal(size=d), rng.uniform(0.5, 2.0, size=d)
    x = location + scale * rng.normal(size=(n, d))
    i, j = np.triu_indices(d)
    theta = np.empty((K, 1 + d + i.size))
    for k in range(K):
        A = rng.normal(size=(d, d))
        precision = A @ A.T / d + 0.3 * np.eye(d)
        mu = size * rng.normal(size=d)
        linear = precision @ mu
        theta[k] = np.concatenate(
            [[rng.normal() - 0.5 * mu @ linear], linear, -precision[i, j] * np.where(i == j, 0.5, 1.0)]
        )
    return x, location, scale, theta


def by_numpy(x, weight, location, scale, theta, floor=-100.0):
    """Log-density and statistics by long doubles, shares raised to the floor as the kernel states."""
    x, location, scale, theta = (np.asarray(a, dtype=np.longdouble) for a in (x, location, scale, theta))
    z = (x - location) / scale
    i, j = np.triu_indices(x.shape[1])
    features = np.concatenate([np.ones((x.shape[0], 1), dtype=np.longdouble), z, z[:, i] * z[:, j]], axis=1)
    logits = features @ theta.T
    peak = logits.max(axis=1, keepdims=True)
    share = np.exp(np.maximum(logits - peak, floor))
    total = share.sum(axis=1, keepdims=True)
    density = (peak + np.log(total))[:, 0]
    w = np.ones(x.shape[0]) if weight is None else weight
    return density, (w * density).sum(), (share / total * w[:, None]).T @ features, np.abs(features).T @ w


SHAPES = [(K, d, n) for K in (1, 2, 3, 15) for d, n in ((1, 1), (2, 257), (3, 255), (5, 1000), (8, 513), (10, 300))]


@pytest.mark.parametrize(("K", "d", "n"), SHAPES)
@pytest.mark.parametrize("weighted", [False, True])
def test_statistics_equal_those_of_numpy(K, d, n, weighted):
    x, location, scale, theta = problem(K, d, n)
    weight = np.random.default_rng(1).uniform(0.0, 3.0, size=n) if weighted else None
    density, value, sums, size = by_numpy(x, weight, location, scale, theta)
    got_value, got_sums = statistics_of_rows(x, weight, location, scale, theta)
    # logits of size L carry errors of some 1e-16 L (F terms): they are errors of the shares
    largest = max(float(np.abs(theta).sum(axis=1).max()), 1.0)
    assert abs(got_value - float(value)) <= 1e-13 * np.abs(density).sum() * max(weight.max() if weighted else 1.0, 1.0)
    assert np.max(np.abs(got_sums - sums.astype(float)) / size.astype(float)) <= 1e-15 * largest
    got = log_density_of_rows(x, location, scale, theta)
    np.testing.assert_allclose(got, density.astype(float), rtol=1e-13, atol=1e-15 * largest)


def test_far_apart_components_share_nothing_but_the_floor():
    """Shares below e^-100 are raised to it: nothing a sum of doubles could see, and no denormal number."""
    x, location, scale, theta = problem(4, 3, 500, size=200.0)
    density, value, sums, size = by_numpy(x, None, location, scale, theta)
    got_value, got_sums = statistics_of_rows(x, None, location, scale, theta)
    exact, _, without, _ = by_numpy(x, None, location, scale, theta, floor=-np.inf)
    np.testing.assert_allclose(density.astype(float), exact.astype(float), rtol=1e-15)
    # the differences of logits of 1e4 to 1e5 hold 11 digits
    np.testing.assert_allclose(got_value, float(value), rtol=1e-13)
    assert np.max(np.abs(got_sums - sums.astype(float)) / size.astype(float)) < 1e-10
    assert np.max(np.abs(sums - without) / size) < 1e-40
    assert np.isfinite(got_sums).all()


def test_a_component_without_weight_takes_no_events():
    x, location, scale, theta = problem(3, 2, 300)
    theta[1, 0] = -1e300
    value, sums = statistics_of_rows(x, None, location, scale, theta)
    others, rest = statistics_of_rows(x, None, location, scale, theta[[0, 2]])
    np.testing.assert_allclose(value, others, rtol=1e-14)
    np.testing.assert_allclose(sums[[0, 2]], rest, rtol=1e-13, atol=1e-12)
    assert sums[1, 0] < 1e-40


def test_nan_in_a_row_stays_one():
    x, location, scale, theta = problem(3, 2, 300)
    x[7, 1] = np.nan
    density = log_density_of_rows(x, location, scale, theta)
    assert np.isnan(density[7])
    assert np.isfinite(np.delete(density, 7)).all()


def test_a_row_does_not_depend_on_its_neighbours():
    x, location, scale, theta = problem(5, 4, 1000)
    whole = log_density_of_rows(x, location, scale, theta)
    np.testing.assert_allclose(log_density_of_rows(x[300:301], location, scale, theta), whole[300:301], rtol=1e-15)
    assert log_density_of_rows(x[:0], location, scale, theta).size == 0


def test_views_and_orders_of_memory_give_the_same_bits():
    x, location, scale, theta = problem(3, 4, 600)
    weight = np.random.default_rng(2).uniform(size=600)
    value, sums = statistics_of_rows(x, weight, location, scale, theta)
    wide, long = np.repeat(x, 2, axis=1), np.repeat(weight, 3)
    for rows, w in ((np.asfortranarray(x), weight), (wide[:, ::2], long[::3])):
        other, same = statistics_of_rows(rows, w, location, scale, theta)
        assert other == value
        np.testing.assert_array_equal(same, sums)
