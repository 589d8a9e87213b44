"""Sources of events: blocks, profiles, sums, transforms; values on a bound moved inside wherever the events lie."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ldctoolkit.errors import InputError
from ldctoolkit.mixture import ArrayEvents, BoundedGaussianMixture, EventSource
from ldctoolkit.mixture._transform import Transform
from ldctoolkit.mixture.bounded_events import MappedEvents, inside_bounds
from ldctoolkit.mixture.sources import BLOCK, Pass, Profile, TransformedEvents, profile_of, sums_of, transformed

INF = np.inf


class Stream:
    """A source that is no array: what a file or a cluster would give."""

    def __init__(self, x, weight=None):
        self.inner = ArrayEvents(x, weight, 1)
        self.dimension = x.shape[1]

    def map_blocks(self, work):
        return (pickle.loads(pickle.dumps(part)) for part in self.inner.map_blocks(pickle.loads(pickle.dumps(work))))

    def take(self, rows):
        return self.inner.take(rows)

    def blocks(self):
        return self.inner.blocks()


def events(n=3 * BLOCK + 77, d=3, seed=0):
    rng = np.random.default_rng(seed)
    return rng.gamma(2.0, size=(n, d)) + 0.01, rng.integers(0, 4, size=n).astype(float)


def a_pass(d=3, K=3):
    theta = np.random.default_rng(1).normal(size=(K, 1 + d + d * (d + 1) // 2)) * 0.1
    return Pass(np.full(d, 2.0), np.full(d, 1.5), theta)


def same(a, b):
    """Bit by bit."""
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))


def test_profile_against_numpy():
    x, w = events()
    found = profile_of(ArrayEvents(x, w))
    mean = np.average(x, axis=0, weights=w)
    assert (found.rows, found.events) == (x.shape[0], w.sum())
    # sums of 24,653 terms in another order: their rounding is about 1e-13
    assert found.mean == pytest.approx(mean, rel=1e-12)
    assert found.scale == pytest.approx(np.sqrt(np.average((x - mean) ** 2, axis=0, weights=w)), rel=1e-12)
    assert np.array_equal(found.least, x.min(axis=0))
    assert np.array_equal(found.most, x.max(axis=0))


def test_a_profile_keeps_small_spreads_beside_large_means():
    x = 1e9 + np.random.default_rng(0).normal(size=(2 * BLOCK, 1))
    # a value is rounded to 1.2e-7 of a spread of one
    assert profile_of(ArrayEvents(x)).scale == pytest.approx(x.std(axis=0), rel=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_numbers_depend_on_neither_threads_nor_order_in_memory(weighted):
    x, w = events()
    w = w if weighted else None
    one = ArrayEvents(x, w, 1)
    for other in (ArrayEvents(x, w, 3), ArrayEvents(np.asfortranarray(x), w, 2), Stream(x, w)):
        assert isinstance(other, EventSource)
        assert same(profile_of(one), profile_of(other))
        (value, sums), (other_value, other_sums) = sums_of(one, a_pass()), sums_of(other, a_pass())
        assert value == other_value
        assert np.array_equal(sums, other_sums)
        assert [b.shape for b in one.blocks()] == [b.shape for b in other.blocks()]
        taken = other.take(np.array([0, 5, x.shape[0] - 1]))[0]
        assert taken.flags.c_contiguous
        assert np.array_equal(taken, x[[0, 5, -1]])


def test_whole_weights_count_as_repeated_rows():
    x, w = events(n=2000)
    found, repeated = profile_of(ArrayEvents(x, w)), profile_of(ArrayEvents(np.repeat(x, w.astype(int), axis=0)))
    assert found.events == repeated.rows
    assert found.mean == pytest.approx(repeated.mean, rel=1e-12)  # the same sums, in another order
    assert found.scale == pytest.approx(repeated.scale, rel=1e-12)


def test_nothing_to_fit():
    with pytest.raises(InputError, match=r"^X: no rows; allowed: at least one event$"):
        profile_of(Stream(np.empty((0, 2))))
    with pytest.raises(InputError, match=r"^X: the weights of all 5 rows are zero; allowed: at least one event$"):
        profile_of(Stream(np.ones((5, 2)), np.zeros(5)))


def test_a_transform_of_a_stream_is_that_of_the_array():
    x, w = events()
    transform = Transform.of("auto", np.zeros(3), np.array([INF, 100.0, INF]))
    stream = transformed(Stream(x, w), transform)
    array = ArrayEvents(transform.forward(x), w)
    assert isinstance(stream, TransformedEvents)
    assert stream.dimension == 3
    assert same(profile_of(stream), profile_of(array))
    assert np.array_equal(stream.take(np.array([3, 4]))[0], array.x[3:5])
    assert np.array_equal(np.concatenate(list(stream.blocks())), array.x)


@pytest.mark.parametrize("transform", [None, "auto"])
def test_a_fit_to_a_stream_is_the_fit_to_the_array(transform):
    x, w = events(n=BLOCK + 500, d=2)
    settings = {"lower": 0.0, "random_state": 3, "n_init": 2, "max_iter": 15, "transform": transform}
    one = BoundedGaussianMixture(2, **settings).fit(x, sample_weight=w)
    other = BoundedGaussianMixture(2, **settings).fit(Stream(x, w))
    for name in ("weights_", "means_", "covariances_", "lower_bounds_"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


def test_bad_data_of_a_stream_are_named():
    x, _ = events()
    for value, allowed in ((np.nan, "finite numbers"), (0.0, "strictly between the bounds 0 and inf")):
        bad = x.copy()
        bad[[BLOCK + 7, 2 * BLOCK], 1] = value
        with pytest.raises(InputError, match=rf"^X: column 'd_y', row {BLOCK + 7}: .*{allowed}.* \(2 of 24653 rows\)"):
            BoundedGaussianMixture(2, lower=0.0, names=["T", "d_y", "v"]).fit(Stream(bad))


# values on a bound and constant columns


@pytest.mark.parametrize("wrap", [ArrayEvents, Stream])
def test_values_on_a_bound_move_inside(wrap):
    x, _ = events()
    lower, upper = np.array([0.0, 0.0, -INF, 0.0]), np.array([INF, 30.0, INF, 9.0])
    x = np.column_stack([x, np.full(x.shape[0], 9.0)])
    x[[1, BLOCK + 1], 0] = 0.0
    x[9, 1], x[10, 1] = 30.0, 0.0
    found = inside_bounds(wrap(x), lower, upper)
    assert found.varies.tolist() == [True, True, True, False]
    assert found.moved.tolist() == [2, 2, 0, 0]
    assert found.source.dimension == 3
    y = np.concatenate(list(found.source.blocks()))
    off = (x[:, :3] != lower[:3]) & (x[:, :3] != upper[:3])
    assert np.array_equal(y[off], x[:, :3][off])

    def distance(column, bound):
        others = np.abs(column - bound)
        return min(0.5 * others[others > 0].min(), 1e-3 * column.std())

    # the spread is summed in another order
    assert y[[1, BLOCK + 1], 0] == pytest.approx([distance(x[:, 0], 0.0)] * 2, rel=1e-12)
    assert 30.0 - y[9, 1] == pytest.approx(distance(x[:, 1], 30.0), rel=1e-9)  # 30 minus a little loses digits
    assert y[10, 1] == pytest.approx(distance(x[:, 1], 0.0), rel=1e-12)
    assert np.array_equal(found.source.take(np.array([0, 1]))[0], y[:2])


def test_stream_and_array_move_to_the_same_places():
    x, w = events()
    x[::50, 0] = 0.0
    lower, upper = np.zeros(3), np.full(3, INF)
    stream, array = inside_bounds(Stream(x, w), lower, upper), inside_bounds(ArrayEvents(x, w), lower, upper)
    assert isinstance(stream.source, MappedEvents)
    assert isinstance(array.source, ArrayEvents)
    assert same(profile_of(stream.source), profile_of(array.source))
    logs = Transform.of("log", lower, upper)
    assert same(profile_of(transformed(stream.source, logs)), profile_of(transformed(array.source, logs)))


def test_nothing_on_a_bound_changes_nothing():
    source = ArrayEvents(events()[0])
    found = inside_bounds(source, np.zeros(3), np.full(3, INF))
    assert found.source is source
    assert found.moved.tolist() == [0, 0, 0]


@given(
    arrays(float, (12, 2), elements=st.sampled_from([0.0, 1.0, 1e-300, 5e-324, 0.5, np.nextafter(1.0, 0.0), 0.25])),
)
@settings(max_examples=200, deadline=None)
def test_moved_values_are_strictly_inside(x):
    lower, upper = np.zeros(2), np.ones(2)
    found = inside_bounds(Stream(x), lower, upper)
    y = np.concatenate(list(found.source.blocks()))
    assert np.all((y > 0.0) & (y < 1.0))
    assert y.shape[1] == found.varies.sum()


def test_what_is_outside_or_not_finite_is_left_to_the_fit():
    x, _ = events()
    x[5, 0], x[6, 1], x[7, 2] = -1.0, np.nan, 0.0
    found = inside_bounds(Stream(x), np.zeros(3), np.full(3, INF))
    assert found.varies.all()
    y = next(iter(found.source.blocks()))
    assert y[5, 0] == -1.0
    assert np.isnan(y[6, 1])
    with pytest.raises(InputError, match=r"column 1, row 6: nan"):
        BoundedGaussianMixture(1, lower=0.0).fit(found.source)


def test_a_constant_outside_its_bounds():
    x = np.column_stack([events()[0], np.full(3 * BLOCK + 77, 12.0)])
    with pytest.raises(InputError, match=r"^X: column 'T' is 12.0 in all 24653 rows; allowed: 0.5 to 10$"):
        inside_bounds(Stream(x), np.array([0, 0, 0, 0.5]), np.array([INF, INF, INF, 10]), ["a", "b", "c", "T"])


def test_profiles_add_up():
    x, w = events(n=50)
    whole, parts = Profile.of_block(x, w), Profile.of_block(x[:20], w[:20]) + Profile.of_block(x[20:], w[20:])
    assert parts.square == pytest.approx(whole.square, rel=1e-12)  # rounding of 50 terms
    nothing = Profile.of_block(x[:5], np.zeros(5))
    assert (nothing + nothing).events == 0.0
    assert (nothing + whole).mean == pytest.approx(whole.mean, rel=1e-14)
