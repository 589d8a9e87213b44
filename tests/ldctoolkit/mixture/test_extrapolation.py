"""The leap of an EM run against sequences whose limit is known."""

import numpy as np
import pytest

from ldctoolkit.mixture import TruncatedNormal
from ldctoolkit.mixture._em import Point, leap

LOWER, UPPER = np.array([0.0, -np.inf]), np.array([np.inf, 3.0])
POINTS = 1021


def at(share, start, end):
    """The point of natural parameters and log weights that is this share of the way from start to end."""
    w, mu, Sigma = ((1.0 - share) * a + share * b for a, b in zip(natural(*start), natural(*end), strict=True))
    weights, covariance = np.exp(w), np.linalg.inv(Sigma)
    mean = (covariance @ mu[:, :, None])[:, :, 0]
    return Point(weights / weights.sum(), TruncatedNormal(mean, covariance, LOWER, UPPER, points=POINTS, order=ORDER))


def natural(weights, mu, Sigma):
    precision = np.linalg.inv(Sigma)
    return np.log(weights), (precision @ mu[:, :, None])[:, :, 0], precision


ORDER = np.array([[0, 1], [0, 1]])
START = (np.array([0.3, 0.7]), np.array([[0.0, 1.0], [1.0, 2.0]]), np.tile(np.eye(2), (2, 1, 1)))
END = (
    np.array([0.5, 0.5]),
    np.array([[-1.0, 0.5], [1.5, 1.0]]),
    np.array([[[1.6, 0.3], [0.3, 0.8]], [[0.7, -0.2], [-0.2, 1.2]]]),
)


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99])
def test_a_geometric_sequence_ends_at_its_limit(rate):
    """Errors that shrink by one factor a pass: s = 1/(1 - rate), and the leap is the limit."""
    three = [at(1.0 - rate**k, START, END) for k in range(3)]
    end = leap(*three, longest=1e6, points=POINTS)
    limit = at(1.0, START, END)
    # differences of 1e-4 for the rate of 0.99 keep 12 digits, and are multiplied by 1e4
    np.testing.assert_allclose(end.length, 1.0 / (1.0 - rate), rtol=1e-7)
    np.testing.assert_allclose(end.point.weights, limit.weights, rtol=1e-7)
    np.testing.assert_allclose(end.point.truncated.mu, limit.truncated.mu, rtol=1e-6)
    np.testing.assert_allclose(end.point.truncated.Sigma, limit.truncated.Sigma, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(end.point.truncated.log_probability, limit.truncated.log_probability, rtol=1e-6)


def test_a_leap_is_no_longer_than_it_is_trusted():
    three = [at(1.0 - 0.99**k, START, END) for k in range(3)]
    assert leap(*three, longest=4.0, points=POINTS).length == 4.0


def test_a_leap_out_of_the_covariances_is_shortened():
    """Towards a precision of nought and beyond: the leap keeps a tenth of the present one."""
    wide = (END[0], END[1], np.tile(np.diag([1e3, 1.0]), (2, 1, 1)))
    three = [at(0.2 * k, START, wide) for k in range(3)]  # a straight, even way: without a bound s would be infinite
    end = leap(*three, longest=1e3, points=POINTS)
    assert 1.0 < end.length < 10.0
    assert np.linalg.eigvalsh(end.point.truncated.Sigma).min() > 0.0


def test_where_nothing_moves_any_more_or_the_steps_shrink_at_once_there_is_no_leap():
    one = at(0.5, START, END)
    assert leap(one, one, one, longest=100.0, points=POINTS) is None
    # the second step turns back as far as the first one went: s = 1/2, not beyond the third point
    assert leap(one, at(0.6, START, END), one, longest=100.0, points=POINTS) is None
