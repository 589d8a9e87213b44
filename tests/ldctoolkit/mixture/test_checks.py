"""What a fit is given: events, bounds, transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import norm

from helpers.bits import assert_same_bits, examples
from helpers.errors import refused
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture._distribution import Transform
from ldctoolkit.mixture.checks import Events, inside_bounds, profile_of, sums_of

INF = np.inf
ROWS = 24_653  # three whole blocks and a part of one


def rows(n=ROWS, d=3, seed=0):
    rng = np.random.default_rng(seed)
    return rng.gamma(2.0, size=(n, d)) + 0.01, rng.integers(0, 4, size=n).astype(float)


def test_profile_against_numpy():
    x, w = rows()
    w[:17_000] = 0.0  # two whole blocks without an event
    profile = profile_of(Events(x, w))
    mean = np.average(x, axis=0, weights=w)
    assert (profile.rows, profile.used, profile.events) == (ROWS, np.count_nonzero(w), w.sum())
    # sums of 24,653 terms in another order: their rounding is about 1e-13
    assert profile.mean == pytest.approx(mean, rel=1e-12)
    assert profile.scale == pytest.approx(np.sqrt(np.average((x - mean) ** 2, axis=0, weights=w)), rel=1e-12)
    assert np.array_equal(profile.least, x.min(axis=0))
    assert np.array_equal(profile.most, x.max(axis=0))


def test_a_profile_keeps_small_spreads_beside_large_means():
    x = 1e9 + np.random.default_rng(0).normal(size=(20_000, 1))
    # a value is rounded to 1.2e-7 of a spread of one
    assert profile_of(Events(x)).scale == pytest.approx(x.std(axis=0), rel=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_numbers_depend_on_neither_threads_nor_order_in_memory(weighted):
    x, w = rows()
    w = w if weighted else None
    theta = np.random.default_rng(1).normal(size=(3, 10)) * 0.1
    first, *others = (Events(x, w, 1), Events(x, w, 3), Events(x, w), Events(np.asfortranarray(x), w, 2))
    for second in others:
        assert_same_bits(profile_of(first), profile_of(second))
        a, b = (sums_of(events, np.full(3, 2.0), np.full(3, 1.5), theta) for events in (first, second))
        assert_same_bits(a, b)


def test_nothing_to_fit():
    for events in (Events(np.empty((0, 2))), Events(np.ones((5, 2)), np.zeros(5))):
        with refused("X", allowed="at least one event"):
            profile_of(events)


# values on a bound and constant columns
def test_values_on_a_bound_move_inside():
    x, w = rows()
    lower, upper = np.array([0.0, 0.0, -INF, 0.0]), np.array([INF, 30.0, INF, 9.0])
    x = np.column_stack([x, np.full(ROWS, 9.0)])
    x[[1, 9001], 0] = 0.0
    x[9, 1], x[10, 1] = 30.0, 0.0
    before = x.copy()
    inside = inside_bounds(Events(x, w), lower, upper)
    assert (inside.varies.tolist(), inside.moved.tolist()) == ([True, True, True, False], [2, 2, 0, 0])
    assert inside.events.weight is w
    y = inside.events.x
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
    inside = inside_bounds(events, np.zeros(3), np.full(3, INF))
    assert inside.events is events
    assert inside.moved.tolist() == [0, 0, 0]


@given(arrays(float, (12, 2), elements=st.sampled_from([0.0, 1.0, 1e-300, 5e-324, 0.5, np.nextafter(1.0, 0.0), 0.25])))
@examples(200)
def test_moved_values_are_strictly_inside(x):
    inside = inside_bounds(Events(x), np.zeros(2), np.ones(2))
    y = inside.events.x
    assert np.all((y > 0.0) & (y < 1.0))
    assert y.shape[1] == inside.varies.sum()
    assert np.array_equal(inside.moved, np.where(inside.varies, ((x == 0.0) | (x == 1.0)).sum(axis=0), 0))


def test_what_is_outside_or_not_finite_is_left_to_the_fit():
    x, _ = rows()
    x[5, 0], x[6, 1], x[7, 2] = -1.0, np.nan, 0.0
    inside = inside_bounds(Events(x), np.zeros(3), np.full(3, INF))
    assert inside.varies.all()
    assert inside.events.x[5, 0] == -1.0
    assert np.isnan(inside.events.x[6, 1])
    assert inside.events.x[7, 2] > 0.0
    with refused("X: column 1, row 6"):
        BoundedGaussianMixture(1, lower=0.0).fit(inside.events.x)


def test_a_constant_outside_its_bounds():
    x = np.column_stack([rows()[0], np.full(ROWS, 12.0)])
    with refused("X: column 'T'", value=12.0, allowed="0.5 to 10"):
        inside_bounds(Events(x), np.array([0, 0, 0, 0.5]), np.array([INF, INF, INF, 10]), ["a", "b", "c", "T"])


def test_bad_data_in_a_later_block_are_named():
    x, _ = rows()
    for value, allowed, others in (
        (np.inf, "finite numbers, at most 1e+100 in size", ", also in column 'v'"),
        (0.0, "strictly between the bounds 0 and inf", ""),
    ):
        bad = x.copy()
        bad[[8199, 16_384], 1] = value
        bad[3, 2] = value
        problem = f"(2 of 24653 rows{others})"
        with refused("X: column 'd_y', row 8199", value=value, problem=problem, allowed=allowed):
            BoundedGaussianMixture(2, lower=0.0, names=["T", "d_y", "v"]).fit(bad)


ends = st.floats(-1e3, 1e3)
lengths = st.floats(1e-2, 1e3)
shares = st.lists(st.floats(1e-6, 1.0 - 1e-6), min_size=1, max_size=20)


def box(kind, low, length):
    """A transform of one column: ``above`` a lower bound, ``below`` an upper one, between ``both`` or ``open``."""
    lower = np.array([-INF if kind in ("below", "open") else low])
    upper = np.array([INF if kind in ("above", "open") else low + length])
    return Transform.of("auto", lower, upper)


@examples(150)
@given(kind=st.sampled_from(["above", "below", "both", "open"]), low=ends, length=lengths, shares=shares)
def test_there_and_back(kind, low, length, shares):
    t = box(kind, low, length)
    x = (low + length * np.array(shares))[:, None]
    x = x[np.all((x > t.lower) & (x < t.upper), axis=1)]
    back = t.inverse(t.forward(x))
    # rounding of x - bound, which is exact to half a unit in the last place of the larger of the two
    np.testing.assert_allclose(back, x, rtol=1e-12, atol=8 * np.spacing(abs(low) + length))


@examples(100)
@given(
    kind=st.sampled_from(["above", "below", "both"]), low=ends, length=lengths, share=st.floats(0.01, 0.99),
    other=st.floats(0.01, 0.99),
)  # fmt: skip
def test_the_slope_is_the_derivative_and_rises(kind, low, length, share, other):
    t = box(kind, low, length)
    x = low + length * share
    h = 1e-4 * length * min(share, 1.0 - share)
    y = t.forward(np.array([[x - h], [x + h]]))[:, 0]
    assert y[1] > y[0]
    # the finite difference errs by its third derivative, 1e-8, and by rounding, 1e-16 low/h
    error = 1e-7 + 4e-16 * (abs(low) + length) / h
    np.testing.assert_allclose((y[1] - y[0]) / (2 * h), np.exp(t.log_slope(np.array([[x]])))[0], rtol=error)
    assert (low + length * other > x) == (
        t.forward(np.array([[low + length * other]]))[0, 0] > t.forward(np.array([[x]]))[0, 0]
    )


@pytest.mark.parametrize("y", [-800.0, -50.0, 0.0, 50.0, 800.0, INF, -INF])
def test_extreme_values_stay_strictly_inside(y):
    t = Transform.of("auto", np.array([0.0, -INF, 1.0]), np.array([INF, 3.0, 2.0]))
    x = t.inverse(np.full((1, 3), y))
    assert np.isfinite(x).all()
    assert np.all((x > t.lower) & (x < t.upper))


def test_values_on_and_outside_a_bound():
    t = Transform.of("auto", np.array([0.0, 0.0]), np.array([INF, 1.0]))
    assert t.forward(np.array([[0.0, 0.0]])).tolist() == [[-INF, -INF]]
    assert t.forward(np.array([[1.0, 1.0]]))[0, 1] == INF
    assert np.isnan(t.forward(np.array([[-1.0, 2.0]]))).all()
    model = BoundedGaussianMixture.from_parameters(
        [1.0], [[0.0, 0.0]], [np.eye(2)], lower=[0.0, 0.0], upper=[INF, 1.0], transform="auto"
    )
    assert model.score_samples([[0.0, 0.5], [1.0, 1.0], [-1.0, 0.5], [1.0, 2.0]]).tolist() == [-INF] * 4


@pytest.mark.parametrize(
    ("transform", "path", "value"),
    [
        ("lgo", "transform", "lgo"),
        ("", "transform", ""),
        (["log", "lgo", "none"], "transform['b']", "lgo"),
        (["logit", "none", "none"], "transform['a']", "logit"),
        (["none", "log", "none"], "transform['b']", "log"),
        ("log", "transform['b']", "log"),
        (["none", "none", "log"], "transform['c']", "log"),
    ],
)
def test_maps_that_the_bounds_do_not_allow(transform, path, value):
    bounds = np.array([0.0, 0.0, -INF]), np.array([INF, 1.0, INF])
    with refused(path, value=value):
        Transform.of(transform, *bounds, names=("a", "b", "c"))
    with refused("transform", allowed="one name, or 3, one per column"):
        Transform.of(["log"], *bounds)


def test_a_log_normal_density_is_scipys():
    """One component, ln x: the density is the normal one over x."""
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.3]], [[[0.49]]], lower=0.0, transform="log")
    x = np.array([1e-8, 0.1, 1.0, 30.0])
    np.testing.assert_allclose(
        model.score_samples(x[:, None]), norm(0.3, 0.7).logpdf(np.log(x)) - np.log(x), rtol=1e-12
    )


@pytest.mark.parametrize("kind", ["above", "below", "both"])
def test_one_dimension_integrates_to_one(kind):
    low, high = (-INF if kind == "below" else 1.0), (INF if kind == "above" else 3.0)
    model = BoundedGaussianMixture.from_parameters(
        [0.3, 0.7], [[-1.0], [0.5]], [[[0.4]], [[0.9]]], lower=low, upper=high, transform="auto"
    )
    t = model.distribution.transform
    # a grid that is even in the mapped coordinate covers both tails; the trapezoidal rule errs by its own curvature
    x = t.inverse(np.linspace(-9.0, 9.0, 40_001)[:, None])
    assert abs(np.trapezoid(np.exp(model.score_samples(x)), x[:, 0]) - 1.0) < 1e-6


def test_two_dimensions_integrate_to_one_with_one_column_mapped():
    """A log column beside a truncated one: the box of the second is still normalised; midpoint rule on 600 x 600."""
    model = BoundedGaussianMixture.from_parameters(
        [0.6, 0.4], [[0.0, 0.2], [-1.0, 1.5]], [[[0.3, 0.2], [0.2, 0.8]], [[0.2, -0.1], [-0.1, 0.5]]], lower=[0.0, 0.0],
        upper=[INF, 2.0], transform=["log", "none"],
    )  # fmt: skip
    edges = np.exp(np.linspace(-7.0, 5.0, 601))
    x, dx = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    y = (np.arange(600) + 0.5) / 300.0
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    mass = np.exp(model.score_samples(grid)).reshape(600, 600) * dx[:, None] / 300.0
    assert abs(mass.sum() - 1.0) < 1e-4
    drawn = model.sample(40_000, 1)[0]
    assert np.all((drawn > 0.0) & (drawn[:, 1:] < 2.0))
    # shares of quadrants by samples and by the grid, four standard errors of a share of one half
    inside = (grid[:, 0] < 0.7) & (grid[:, 1] < 1.0)
    assert abs(np.mean((drawn[:, 0] < 0.7) & (drawn[:, 1] < 1.0)) - mass.ravel()[inside].sum()) < 4 * 0.5 / 200.0


def test_a_transform_fit_is_a_plain_fit_of_the_mapped_events():
    X = np.random.default_rng(0).gamma(1.5, size=(600, 2))
    mapped = BoundedGaussianMixture(2, lower=0.0, transform="log", random_state=0, n_init=2).fit(X)
    plain = BoundedGaussianMixture(2, random_state=0, n_init=2).fit(np.log(X))
    np.testing.assert_array_equal(mapped.means_, plain.means_)
    np.testing.assert_array_equal(mapped.covariances_, plain.covariances_)
    np.testing.assert_allclose(mapped.score(X), plain.score(np.log(X)) - np.log(X).sum(axis=1).mean(), rtol=1e-12)


def gamma_like(d, n, seed):
    """Correlated gamma margins with shapes 1 to 2.5: a normal copula of correlation 0.4."""
    from scipy.stats import gamma

    z = np.random.default_rng(seed).normal(size=(n, d + 1))
    u = norm.cdf(np.sqrt(0.6) * z[:, :d] + np.sqrt(0.4) * z[:, d:])
    return gamma.ppf(u, np.linspace(1.0, 2.5, d))


@pytest.mark.slow
def test_a_transform_wins_on_gamma_margins():
    """In eight dimensions; in two, as many components make up for what the bounds leave. Standard error about 0.012."""
    X, held_out = gamma_like(8, 8000, 1), gamma_like(8, 10_000, 2)
    plain = BoundedGaussianMixture(3, lower=0.0, random_state=0, n_init=4).fit(X)
    mapped = BoundedGaussianMixture(3, lower=0.0, transform="log", random_state=0, n_init=4).fit(X)
    assert mapped.score(held_out) - plain.score(held_out) > 0.05
