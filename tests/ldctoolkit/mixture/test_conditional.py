"""Mixtures under conditions against filtering, quadrature and formulas."""

import numpy as np
import pytest
from scipy.stats import ks_2samp, multivariate_normal, norm, truncnorm

from helpers.errors import refused
from ldctoolkit.errors import NOT_GIVEN
from ldctoolkit.mixture import SAMPLE_BLOCK, BoundedGaussianMixture

INF = np.inf
NAMES = ["T", "d_y", "v_mean"]


def three_columns(transform=None):
    """K = 3; one column bounded below, one on both sides, one open."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3, 3))
    mu = np.array([[1.0, 0.5, -1.0], [-0.5, 1.2, 1.0], [2.0, 0.2, 0.5]])
    Sigma = A @ A.transpose(0, 2, 1) / 3 + 0.2 * np.eye(3)
    lower, upper = np.array([0.0, 0.0, -INF]), np.array([INF, 1.0, INF])
    return BoundedGaussianMixture.from_parameters(
        [0.5, 0.3, 0.2], mu, Sigma, lower=lower, upper=upper, transform=transform, names=NAMES
    )


def filtered(model, given, blocks=30):
    """Rows of the whole mixture that meet intervals, and their components."""
    x, label = model.sample(blocks * SAMPLE_BLOCK, 11)
    keep = np.ones(x.shape[0], dtype=bool)
    for name, (low, high) in given.items():
        column = x[:, NAMES.index(name)]
        keep &= (column > (-INF if low is None else low)) & (column < (INF if high is None else high))
    return x[keep], label[keep], keep.mean()


INTERVALS = (
    {"v_mean": (0.5, 1.5)},
    {"T": (0.5, None), "d_y": (None, 0.4)},
    {"T": (-3.0, 0.8), "d_y": (0.2, 5.0), "v_mean": (-INF, 0.0)},  # reaches over the box: its common part counts
)
MAPS = ("auto", ["none", "logit", "none"], None)


@pytest.mark.parametrize(
    ("i", "j"), [pytest.param(i, j, marks=[] if i == j else pytest.mark.slow) for i in range(3) for j in range(3)]
)
def test_conditional_samples_are_filtered_ones(i, j):
    given, model = INTERVALS[i], three_columns(MAPS[j])
    brute, brute_label, share = filtered(model, given)
    n = 20_000
    x, label = model.sample(n, 4, given=given)
    conditional = model.distribution.condition(given, NAMES)
    assert np.all(conditional.inside(x))
    for name, (low, high) in given.items():
        column = x[:, NAMES.index(name)]
        assert low is None or column.min() > low
        assert high is None or column.max() < high
    # false alarms: nine cases of three columns and their sum at 1e-4, one in 280 for fresh seeds
    for j in range(3):
        assert ks_2samp(x[:, j], brute[:, j]).pvalue > 1e-4
    assert ks_2samp(x @ [1.0, 2.0, -0.5], brute @ [1.0, 2.0, -0.5]).pvalue > 1e-4
    # shares of components and the condition's probability within 4.5 standard errors: one in 4,000
    counts, expected = np.bincount(brute_label, minlength=3) / brute_label.size, conditional.weights
    assert np.all(np.abs(counts - expected) < 4.5 * np.sqrt(expected * (1 - expected) / brute_label.size))
    assert np.all(np.abs(np.bincount(label, minlength=3) / n - expected) < 4.5 * np.sqrt(expected * (1 - expected) / n))
    P = np.exp(conditional.log_mass)
    assert abs(share - P) < 4.5 * np.sqrt(P * (1.0 - P) / (30 * SAMPLE_BLOCK))


def midpoints(low, high, n):
    h = (high - low) / n
    return low + h * (np.arange(n) + 0.5), h


@pytest.mark.parametrize("transform", [None, "auto"])
def test_density_integrates_to_one(transform):
    model = BoundedGaussianMixture.from_parameters(
        [0.6, 0.4], [[-1.0, 0.4], [0.8, -0.5]], [[[0.6, 0.2], [0.2, 0.4]], [[0.3, -0.1], [-0.1, 0.5]]], lower=0.0,
        transform=transform,
    )  # fmt: skip
    given = {0: (0.3, 1.1), 1: (0.2, None)}
    (x, hx), (y, hy) = midpoints(0.3, 1.1, 100), midpoints(0.2, 60.0 if transform else 6.0, 1500)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    # midpoint rule, cells of 0.008 by 0.04 at most: measured 2e-5
    assert abs(np.exp(model.log_prob(grid, given=given)).sum() * hx * hy - 1.0) < 1e-4
    # Bayes: the joint density over the condition's probability
    gap = model.log_prob(grid[::1000], given=given) - model.score_samples(grid[::1000])
    np.testing.assert_allclose(gap, -model.distribution.condition(given).log_mass, atol=1e-9)
    # a value: one column is left; the joint density over the marginal one, by quadrature along the line
    line = np.stack([np.full(y.size, 0.7), y], axis=1)
    inside = model.log_prob(line, given={0: 0.7, 1: (0.2, None)})
    assert abs(np.exp(inside).sum() * hy - 1.0) < 1e-4
    marginal = np.exp(model.score_samples(line)).sum() * hy
    np.testing.assert_allclose(np.exp(inside), np.exp(model.score_samples(line)) / marginal, rtol=1e-4)
    condition = model.distribution.condition({0: 0.7, 1: (0.2, None)})
    np.testing.assert_allclose(condition.log_mass, np.log(marginal), atol=1e-4)


def test_rows_that_do_not_meet_the_conditions_have_no_density():
    model = three_columns()
    rows = [[1.0, 0.5, 0.5], [1.0, 0.5, 1.6], [1.5, 0.5, 0.5], [-1.0, 0.5, 0.5]]
    density = model.log_prob(rows, given={"v_mean": (0.0, 1.5), "T": 1.0})
    assert np.isfinite(density[0])
    assert np.all(density[1:] == -INF)
    assert np.array_equal(model.log_prob(rows), model.score_samples(rows))


def test_a_value_is_the_formula_of_the_conditional_normal():
    """One component: x_R given x_F is a normal, truncated to the box; here one-dimensional, so scipy knows it."""
    mu, Sigma = np.array([0.3, -0.4]), np.array([[1.0, 0.7], [0.7, 2.0]])
    model = BoundedGaussianMixture.from_parameters([1.0], [mu], [Sigma], lower=[0.0, 0.0], upper=[INF, 3.0])
    value = 1.4
    centre = mu[1] + 0.7 * (value - mu[0])
    deviation = np.sqrt(2.0 - 0.49)
    law = truncnorm((0.0 - centre) / deviation, (3.0 - centre) / deviation, centre, deviation)
    y = np.linspace(0.01, 2.99, 50)
    density = model.log_prob(np.stack([np.full(50, value), y], axis=1), given={0: value})
    np.testing.assert_allclose(density, law.logpdf(y), rtol=1e-9)
    x, label = model.sample(20_000, 8, given={0: value})
    assert np.all(x[:, 0] == value)
    assert np.all(label == 0)
    assert ks_2samp(x[:, 1], law.rvs(20_000, random_state=1)).pvalue > 1e-4


def test_shares_at_a_value_are_bayes_rule():
    model = three_columns()
    t, eta = model.distribution.truncated, model.weights_
    conditional = model.distribution.condition({"v_mean": 0.8}, NAMES)
    joint = []
    for k in range(3):
        slope = t.Sigma[k, :2, 2] / t.Sigma[k, 2, 2]
        centre = t.mu[k, :2] + slope * (0.8 - t.mu[k, 2])
        rest = t.Sigma[k, :2, :2] - np.outer(slope, t.Sigma[k, 2, :2])
        # P(T > 0, 0 < d_y < 1) by scipy's bivariate normal
        law = multivariate_normal(centre, rest)
        P = law.cdf([INF, 1.0], lower_limit=[0.0, 0.0])
        marginal = norm(t.mu[k, 2], np.sqrt(t.Sigma[k, 2, 2])).pdf(0.8)
        joint.append(eta[k] * marginal * P / np.exp(t.log_probability[k]))
    np.testing.assert_allclose(conditional.weights, np.array(joint) / np.sum(joint), rtol=1e-6)
    np.testing.assert_allclose(conditional.log_mass, np.log(np.sum(joint)), atol=1e-6)


def test_a_condition_as_rare_as_1e_50_is_met():
    """T > 15 deviations out of a half-normal and a correlated neighbour: exponential of a known rate."""
    Sigma = np.array([[1.0, 0.6], [0.6, 1.0]])
    model = BoundedGaussianMixture.from_parameters(
        [0.7, 0.3], [[0.0, 0.0], [-2.0, 0.0]], [Sigma, Sigma], lower=[0.0, -INF]
    )
    conditional = model.distribution.condition({0: (15.0, None)})
    expected = np.log(0.7) + norm.logsf(15.0) - norm.logsf(0.0)
    np.testing.assert_allclose(conditional.log_mass, expected, rtol=1e-9)  # the other component is 17 deviations off
    assert conditional.log_mass < np.log(1e-49)
    assert conditional.weights[1] < 1e-10
    x, _ = conditional.sample(20_000, 3)
    law = truncnorm(15.0, INF)
    assert x[:, 0].min() > 15.0
    assert ks_2samp(x[:, 0], law.rvs(20_000, random_state=2)).pvalue > 1e-4
    # x_1 given x_0 is normal about 0.6 x_0
    assert ks_2samp((x[:, 1] - 0.6 * x[:, 0]) / 0.8, norm.rvs(size=20_000, random_state=3)).pvalue > 1e-4


def test_conditional_events_do_not_depend_on_how_many_are_drawn():
    model = three_columns("auto")
    given = {"T": (0.5, 1.0), "v_mean": 0.2}
    n = SAMPLE_BLOCK + 5
    x, label = model.sample(n, 5, given=given)
    for m in (0, 1, SAMPLE_BLOCK):
        fewer, labels = model.sample(m, 5, given=given)
        assert np.array_equal(fewer, x[:m])
        assert np.array_equal(labels, label[:m])
    block, _ = model.distribution.condition(given, NAMES).sample_block(5, (0,))
    assert np.array_equal(block, x[:SAMPLE_BLOCK])


def test_no_condition_changes_nothing():
    model = three_columns("auto")
    everywhere = model.distribution.condition({"T": (None, None)}, NAMES)
    rows = model.sample(50, 1)[0]
    np.testing.assert_allclose(everywhere.log_mass, 0.0, atol=1e-12)
    np.testing.assert_allclose(everywhere.log_density(rows), model.score_samples(rows), rtol=1e-12)
    assert np.array_equal(model.sample(50, 1, given={})[0], rows)


def test_an_interval_next_to_a_mapped_bound():
    """The logarithm sends the bound to minus infinity; an interval from the bound is open there, and sampled inside."""
    model = three_columns("auto")
    x, _ = model.sample(5000, 6, given={"T": (None, 1e-3), "d_y": (0.999, None)})
    assert np.all((x[:, 0] > 0.0) & (x[:, 0] < 1e-3))
    assert np.all((x[:, 1] > 0.999) & (x[:, 1] < 1.0))


@pytest.mark.parametrize(
    ("given", "path", "value"),
    [
        ({"v_maen": (1, 2)}, "given", "v_maen"),
        ({3: (1, 2)}, "given", 3),
        ({-1: 1.0}, "given", -1),
        ({True: 1.0}, "given", True),
        ({"d_y": (1.5, 2.0)}, "given['d_y']", (1.5, 2.0)),
        ({"d_y": (1.0, None)}, "given['d_y']", (1.0, None)),
        ({"d_y": (0.5, 0.2)}, "given['d_y']", (0.5, 0.2)),
        ({1: 1.0}, "given['d_y']", 1.0),
        ({"d_y": np.float64(-2)}, "given['d_y']", -2.0),
        ({"d_y": INF}, "given['d_y']", INF),
        ({"d_y": (INF, INF)}, "given['d_y']", (INF, INF)),
        ({"d_y": "fast"}, "given['d_y']", "fast"),
        ({"d_y": ("0", 1)}, "given['d_y']", ("0", 1)),
        ({"d_y": (True, 1)}, "given['d_y']", (True, 1)),
        ({"d_y": (0, 1, 2)}, "given['d_y']", (0, 1, 2)),
        ({"d_y": (np.nan, 1)}, "given['d_y']", (np.nan, 1)),
        ({"d_y": None}, "given['d_y']", None),
        ({"d_y": 0.5, 1: (0.1, 0.2)}, "given['d_y']", NOT_GIVEN),
        ({"T": 1.0, "d_y": 0.5, "v_mean": 0.0}, "given", NOT_GIVEN),
        ([("d_y", 0.5)], "given", [("d_y", 0.5)]),
    ],
)
def test_bad_conditions(given, path, value):
    model = three_columns()
    with refused(path, value=value):
        model.sample(1, 0, given=given)
    with refused(path, value=value):
        model.log_prob([[1.0, 0.5, 0.0]], given=given)


def test_a_pair_of_equal_ends_is_a_value():
    model = three_columns()
    assert np.array_equal(model.sample(5, 1, given={"d_y": (0.5, 0.5)})[0], model.sample(5, 1, given={1: 0.5})[0])


def test_names_without_names_and_conditions_on_conditions():
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.0, 0.0]], [np.eye(2)])
    with refused("given", value="T", allowed="a number 0 to 1; the columns have no names"):
        model.sample(1, 0, given={"T": 1.0})
    conditional = model.distribution.condition({0: 1.0})
    with refused("given", allowed="all conditions at once"):
        conditional.condition({1: (0.0, 1.0)})
