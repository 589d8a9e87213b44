"""Events of a fit: blocks, profiles, sums; values on a bound moved inside."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from helpers.bits import assert_same_bits
from helpers.examples import examples
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import Events, inside_bounds, profile_of, sums_of

INF = np.inf
ROWS = 24_653  # three whole blocks and a part of one


def rows(n=ROWS, d=3, seed=0):
    rng = np.random.default_rng(seed)
    return rng.gamma(2.0, size=(n, d)) + 0.01, rng.integers(0, 4, size=n).astype(float)


def test_profile_against_numpy():
    x, w = rows()
    w[:17_000] = 0.0  # two whole blocks without an event
    found = profile_of(Events(x, w))
    mean = np.average(x, axis=0, weights=w)
    assert (found.rows, found.used, found.events) == (ROWS, np.count_nonzero(w), w.sum())
    # sums of 24,653 terms in another order: their rounding is about 1e-13
    assert found.mean == pytest.approx(mean, rel=1e-12)
    assert found.scale == pytest.approx(np.sqrt(np.average((x - mean) ** 2, axis=0, weights=w)), rel=1e-12)
    assert np.array_equal(found.least, x.min(axis=0))
    assert np.array_equal(found.most, x.max(axis=0))


def test_a_profile_keeps_small_spreads_beside_large_means():
    x = 1e9 + np.random.default_rng(0).normal(size=(20_000, 1))
    # a value is rounded to 1.2e-7 of a spread of one
    assert profile_of(Events(x)).scale == pytest.approx(x.std(axis=0), rel=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_numbers_depend_on_neither_threads_nor_order_in_memory(weighted):
    x, w = rows()
    w = w if weighted else None
    theta = np.random.default_rng(1).normal(size=(3, 10)) * 0.1
    one, *others = (Events(x, w, 1), Events(x, w, 3), Events(x, w), Events(np.asfortranarray(x), w, 2))
    for other in others:
        assert_same_bits(profile_of(one), profile_of(other))
        a, b = (sums_of(events, np.full(3, 2.0), np.full(3, 1.5), theta) for events in (one, other))
        assert_same_bits(a, b)


def test_nothing_to_fit():
    with pytest.raises(InputError, match=r"^X: no rows; allowed: at least one event$"):
        profile_of(Events(np.empty((0, 2))))
    with pytest.raises(InputError, match=r"^X: the weights of all 5 rows are zero; allowed: at least one event$"):
        profile_of(Events(np.ones((5, 2)), np.zeros(5)))


# values on a bound and constant columns
def test_values_on_a_bound_move_inside():
    x, w = rows()
    lower, upper = np.array([0.0, 0.0, -INF, 0.0]), np.array([INF, 30.0, INF, 9.0])
    x = np.column_stack([x, np.full(ROWS, 9.0)])
    x[[1, 9001], 0] = 0.0
    x[9, 1], x[10, 1] = 30.0, 0.0
    before = x.copy()
    found = inside_bounds(Events(x, w), lower, upper)
    assert (found.varies.tolist(), found.moved.tolist()) == ([True, True, True, False], [2, 2, 0, 0])
    assert found.events.weight is w
    y = found.events.x
    off = (x[:, :3] != lower[:3]) & (x[:, :3] != upper[:3])
    assert np.array_equal(y[off], x[:, :3][off])
    assert np.array_equal(x, before)
    spread = profile_of(Events(x, w)).scale

    def distance(j, bound):
        others = np.abs(x[:, j] - bound)
        return min(0.5 * others[others > 0].min(), 1e-3 * spread[j])

    assert y[[1, 9001], 0].tolist() == [distance(0, 0.0)] * 2
    assert y[9, 1] == 30.0 - distance(1, 30.0)
    assert y[10, 1] == distance(1, 0.0)
    assert distance(0, 0.0) > 1e-3 * spread[0] * 0.999  # both rules are at work: here the spread,
    close = inside_bounds(Events(np.array([[0.0], [1e-6], [1.0]])), np.zeros(1), np.ones(1) * INF)
    assert close.events.x[0, 0] == 0.5e-6  # and here the nearest other value


def test_nothing_on_a_bound_changes_nothing():
    events = Events(rows()[0])
    found = inside_bounds(events, np.zeros(3), np.full(3, INF))
    assert found.events is events
    assert found.moved.tolist() == [0, 0, 0]


@given(arrays(float, (12, 2), elements=st.sampled_from([0.0, 1.0, 1e-300, 5e-324, 0.5, np.nextafter(1.0, 0.0), 0.25])))
@examples(200)
def test_moved_values_are_strictly_inside(x):
    found = inside_bounds(Events(x), np.zeros(2), np.ones(2))
    y = found.events.x
    assert np.all((y > 0.0) & (y < 1.0))
    assert y.shape[1] == found.varies.sum()
    assert np.array_equal(found.moved, np.where(found.varies, ((x == 0.0) | (x == 1.0)).sum(axis=0), 0))


def test_what_is_outside_or_not_finite_is_left_to_the_fit():
    x, _ = rows()
    x[5, 0], x[6, 1], x[7, 2] = -1.0, np.nan, 0.0
    found = inside_bounds(Events(x), np.zeros(3), np.full(3, INF))
    assert found.varies.all()
    assert found.events.x[5, 0] == -1.0
    assert np.isnan(found.events.x[6, 1])
    assert found.events.x[7, 2] > 0.0
    with pytest.raises(InputError, match=r"column 1, row 6: nan"):
        BoundedGaussianMixture(1, lower=0.0).fit(found.events.x)


def test_a_constant_outside_its_bounds():
    x = np.column_stack([rows()[0], np.full(ROWS, 12.0)])
    with pytest.raises(InputError, match=r"^X: column 'T' is 12.0 in all 24653 rows; allowed: 0.5 to 10$"):
        inside_bounds(Events(x), np.array([0, 0, 0, 0.5]), np.array([INF, INF, INF, 10]), ["a", "b", "c", "T"])


def test_bad_data_in_a_later_block_are_named():
    x, _ = rows()
    for value, allowed in ((np.nan, "finite numbers"), (0.0, "strictly between the bounds 0 and inf")):
        bad = x.copy()
        bad[[8199, 16_384], 1] = value
        bad[3, 2] = value
        message = rf"^X: column 'd_y', row 8199: {value!r}; allowed: {allowed}.* \(2 of 24653 rows"
        with pytest.raises(InputError, match=message):
            BoundedGaussianMixture(2, lower=0.0, names=["T", "d_y", "v"]).fit(bad)
