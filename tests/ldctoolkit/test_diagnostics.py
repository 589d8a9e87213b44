"""Diagnoses of a fit: findings and numbers."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from helpers.bits import examples
from helpers.errors import refused
from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.diagnostics import (
    ModelMarginal,
    SideDiagnostics,
    _joint_density,
    _marginal,
    bin_edges,
    box_share,
    calibrate,
    diagnose,
    diagnose_model,
    kolmogorov_limit,
    model_marginal,
)
from ldctoolkit.mixture import BoundedGaussianMixture, Distribution
from ldctoolkit.scenario_model import ModelProvenance, ScenarioModel, SideModel, SideSummary, load_model

INF = np.inf


def skewed_events(n: int, seed: int = 0) -> np.ndarray:
    """Two log-normal margins that crowd near their bound, and a normal one."""
    rng = np.random.default_rng(seed)
    return np.column_stack([np.exp(rng.normal(size=(n, 2))), rng.normal(size=n)])


@pytest.fixture(scope="module")
def misfit() -> SideDiagnostics:
    x = skewed_events(3000)
    model = BoundedGaussianMixture(1, lower=[0.0, 0.0, -INF], random_state=0, n_init=1).fit(x)
    return diagnose(model, x, names=("T", "d_y", "c_0"), label="left", n_model=20_000)


def test_a_misfit_is_a_warning(misfit: SideDiagnostics) -> None:
    text = "\n".join(misfit.warnings)
    assert "Kolmogorov distance beyond" in text
    assert all(c.distance > c.limit for c in misfit.calibrations[:2])
    assert "c_0" not in text  # the normal margin is described well


def test_a_right_model_has_no_warning() -> None:
    model = BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[1.0, 0.0], [3.0, 2.0]], [np.eye(2), np.eye(2)], lower=[0.0, -INF]
    )
    x, _ = model.sample(4000, 8)
    diagnostics = diagnose(model, x, n_model=20_000)
    assert diagnostics.warnings == ()


def test_same_seed_same_numbers_whatever_the_order() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.0]], [[[1.0]]])
    x, _ = model.sample(500, 1)
    first, second = (diagnose(model, rows, seed=4, n_model=5000) for rows in (x, x))
    assert first.calibrations[0].distance == second.calibrations[0].distance
    np.testing.assert_array_equal(first.marginals[0].model, second.marginals[0].model)
    turned = diagnose(model, x[::-1], seed=4, n_model=5000)
    assert turned.calibrations[0].distance == pytest.approx(first.calibrations[0].distance, abs=1e-12)


def test_weights_and_repeated_rows_agree() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
    x, _ = model.sample(200, 1)
    times = np.random.default_rng(1).integers(1, 4, 200)
    weighted = diagnose(model, x, weights=times, n_model=5000)
    repeated = diagnose(model, np.repeat(x, times, axis=0), n_model=5000)
    assert weighted.effective_events == pytest.approx(times.sum() ** 2 / (times**2).sum())
    assert weighted.calibrations[0].distance == pytest.approx(repeated.calibrations[0].distance, abs=1e-12)
    np.testing.assert_allclose(weighted.marginals[0].data.sum(), repeated.marginals[0].data.sum(), atol=0.02)
    # fewer effective events: a wider limit
    assert weighted.calibrations[0].limit > repeated.calibrations[0].limit


def summary(**changes: object) -> SideSummary:
    plain = SideSummary(200, (1, 2), (10.0, 5.0), (0.0, 0.1), True, (), 0.0)
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("share", "advice"),
    [(0.1, "the best may be larger, try more"), (0.001, "more departures are needed, not more components")],
)
def test_each_warning_about_the_fit(share: float, advice: str) -> None:
    """A component of 6 parameters in two dimensions: 600 events carry one with a share of 0.1, and none of 0.001."""
    model = BoundedGaussianMixture.from_parameters(
        [0.9 - share, 0.1, share], [[2.0, 2.0], [0.5, 2.0], [4.0, 4.0]], np.tile(np.eye(2), (3, 1, 1)), lower=0.0
    )
    x, _ = model.sample(600, 2)
    given = summary(converged=False, n_components=(1, 2, 3), moved_inside=(("T", 3),))
    assert diagnose(model, x, n_model=5000, summary=given, label="left").warnings == (
        "the fit stopped before it had converged",
        f"the chosen K = 3 is the largest that was tried: {advice}",
        "3 events had T exactly on a bound, moved just inside",
    )


def test_events_outside_are_left_out_and_counted() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
    x, _ = model.sample(100, 1)
    diagnostics = diagnose(model, np.vstack([x, [[-1.0]], [[-2.0]], [[0.0]]]), names=["T"], n_model=5000)
    assert (diagnostics.events, diagnostics.outside) == (101, (("T", 2),))
    assert any("left out (T 2)" in line for line in diagnostics.warnings)


ONE = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
GOOD = np.linspace(0.1, 2.0, 20)[:, None]


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ({"X": np.ones((20, 2))}, "X"), ({"X": [["a"]]}, "X"), ({"X": GOOD[:9]}, "X"), ({"X": -GOOD}, "X"),
        ({"X": np.where(GOOD > 1.9, np.nan, GOOD)}, "X: column 'x0', row 19"),
        ({"weights": np.ones(3)}, "weights"), ({"weights": np.full(20, -1.0)}, "weights: row 0"),
        ({"weights": "heavy"}, "weights"), ({"names": ("T", "d_y")}, "names"), ({"n_model": 10}, "n_model"),
        ({"seed": -1}, "seed"),
    ],
)  # fmt: skip
def test_bad_input(change: dict[str, object], path: str) -> None:
    given = {"X": GOOD, "n_model": 1000} | change
    with refused(path):
        diagnose(ONE, given.pop("X"), **given)  # type: ignore[arg-type]


def test_ten_events_and_a_thousand_draws_are_enough() -> None:
    assert diagnose(ONE, GOOD[:10], n_model=1000).events == 10


def departures_of(model: ScenarioModel, n: int, seed: int = 1) -> Departures:
    drawn = model.sample(n, n, seed)
    zero = np.zeros(2 * n, dtype=np.int64)
    columns = {name: getattr(drawn, name) for name in ("side", *PARAMETER_NAMES)}
    return Departures(**columns, recording=zero.astype(str), start_time=1.0 * zero, samples=zero)


def two_parameter_model() -> ScenarioModel:
    mixture = BoundedGaussianMixture.from_parameters(
        [1.0], [[2.0, 0.3]], [[[0.5, 0.05], [0.05, 0.02]]], lower=[0.5, 0.0], upper=[10.0, INF]
    )
    rest = {"sigma_y": 0.02, "v_mean": 25.0, "a_mean": 0.0, "sigma_v": 0.1, "c_0": 0.0, "dc": 0.0}
    side = SideModel(mixture, ("T", "d_y"), tuple(rest.items()))
    return ScenarioModel(side, side, ModelProvenance({}))


def test_both_sides_and_progress() -> None:
    model = two_parameter_model()
    steps: list[tuple[str, int, int]] = []
    diagnostics = diagnose_model(model, departures_of(model, 300), n_model=5000, progress=lambda *a: steps.append(a))
    assert (diagnostics.left.label, diagnostics.right.label) == ("left", "right")
    assert diagnostics.left.names == ("T", "d_y")
    assert diagnostics.left.joint is not None
    assert steps == [("left", 0, 2), ("right", 1, 2), ("done", 2, 2)]


def test_a_constant_that_varies_is_a_warning() -> None:
    model = two_parameter_model()
    rows = departures_of(model, 50)
    rows = dataclasses.replace(rows, c_0=np.linspace(0.0, 1e-3, 100))
    warnings = diagnose_model(model, rows, n_model=2000).left.warnings
    assert any(line.startswith("the model holds c_0 at 0") for line in warnings)


def test_too_few_departures_name_the_side() -> None:
    model = two_parameter_model()
    rows = departures_of(model, 20)
    with refused("departures (right): X", allowed="10 or more"):
        diagnose_model(model, rows.take(rows.side == 1), n_model=2000)


@pytest.mark.slow
def test_the_reference_model_describes_its_own_events() -> None:
    model = load_model("reference")
    rows = departures_of(model, 6000).matrix()[:6000]
    diagnostics = diagnose(model.left_side, rows, n_model=50_000)
    assert (diagnostics.warnings, diagnostics.events) == ((), 6000)
    assert diagnostics.joint is not None


def independent(transform: str | None = None) -> BoundedGaussianMixture:
    """Two components without correlation, so that margins are sums of univariate truncated normals."""
    return BoundedGaussianMixture.from_parameters(
        [0.3, 0.7], [[0.2, 3.0], [2.0, -1.0]], [np.diag([1.0, 4.0]), np.diag([0.25, 1.0])], lower=[0.0, -INF],
        upper=[INF, 40.0], transform=transform,
    )  # fmt: skip


def margin_cdf(x: np.ndarray, j: int) -> np.ndarray:
    """Of `independent`, by scipy."""
    low, high = [(0.0, INF), (-INF, 40.0)][j]
    out = np.zeros_like(x)
    for eta, mu, sigma in zip([0.3, 0.7], [[0.2, 3.0], [2.0, -1.0]], [[1.0, 2.0], [0.5, 1.0]], strict=True):
        m, s = mu[j], sigma[j]
        out += eta * stats.truncnorm((low - m) / s, (high - m) / s, loc=m, scale=s).cdf(x)
    return out


def correlated() -> Distribution:
    return BoundedGaussianMixture.from_parameters(
        [0.6, 0.4], [[0.0, 0.5], [1.5, 1.0]], [[[1.0, 0.6], [0.6, 0.8]], [[0.5, -0.2], [-0.2, 0.4]]], lower=[0.0, 0.0],
        upper=[INF, 3.0],
    ).distribution  # fmt: skip


def test_box_share_is_the_univariate_one() -> None:
    # separation of variables is exact here up to its lattice: 1e-6
    lower, upper = np.array([0.0, -INF]), np.array([1.3, 40.0])
    assert box_share(independent().distribution, lower, upper) == pytest.approx(
        margin_cdf(np.array([1.3]), 0)[0], abs=2e-6
    )


def test_box_share_with_correlation_against_scipys_cdf() -> None:
    model = correlated()
    lower, upper = np.array([0.0, 0.4]), np.array([0.9, 1.7])
    expected = 0.0
    for eta, mu, sigma in zip(model.weights, model.truncated.mu, model.truncated.Sigma, strict=True):
        normal = stats.multivariate_normal(mu, sigma)
        part = normal.cdf(upper, lower_limit=lower)
        expected += eta * part / normal.cdf(np.array([50.0, 3.0]), lower_limit=np.array([0.0, 0.0]))
    assert box_share(model, lower, upper) == pytest.approx(expected, abs=1e-5)  # scipy's own error in two dimensions


def test_box_share_of_a_transformed_mixture() -> None:
    """exp of a normal: the share below a value is the normal's at its logarithm."""
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.3]], [[[0.49]]], lower=0.0, transform="log")
    actual = box_share(model.distribution, np.array([0.0]), np.array([2.0]))
    assert actual == pytest.approx(stats.lognorm(0.7, scale=np.exp(0.3)).cdf(2.0), abs=1e-7)
    whole = box_share(model.distribution, np.array([0.0]), np.array([INF]))
    assert whole == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("j", [0, 1])
def test_model_marginal_against_scipy(j: int) -> None:
    model = independent().distribution
    sample, _ = model.sample(50_000, 3)
    marginal = model_marginal(model, sample, j)
    x = np.linspace(-4.0, 5.0, 300)
    # what is left is the sample's noise inside 16 stretches: 0.5/sqrt(50,000 * 16) = 0.00056, four of them
    np.testing.assert_allclose(marginal.cdf(x), margin_cdf(x, j), atol=0.0023)
    at_knots = marginal.ordered[marginal.rank[1:-1] - 1]
    np.testing.assert_allclose(marginal.cdf(at_knots), margin_cdf(at_knots, j), atol=5e-5)


def exact_marginal(n: int = 400_000) -> ModelMarginal:
    """The uniform distribution."""
    return ModelMarginal((np.arange(n) + 0.5) / n, np.array([0, n]), np.array([0.0, 1.0]))


@examples(40)
@given(st.integers(1, 60), st.integers(0, 10**6), st.booleans())
def test_kolmogorov_distance_is_scipys(n: int, seed: int, ties: bool) -> None:
    x = np.random.default_rng(seed).random(n)
    x = np.round(x, 1) if ties else x
    calibration = calibrate("T", x, np.full(n, 1.0 / n), exact_marginal(), 0.1)
    expected = stats.kstest(x, "uniform").statistic
    assert calibration.distance == pytest.approx(expected, abs=5e-6)  # half a step of the grid


def test_weights_count_as_repetitions() -> None:
    x = np.random.default_rng(2).beta(2, 3, 50)
    times = np.random.default_rng(3).integers(1, 5, 50)
    weighted = calibrate("T", x, times / times.sum(), exact_marginal(), 0.1)
    repeated = calibrate("T", np.repeat(x, times), np.full(times.sum(), 1 / times.sum()), exact_marginal(), 0.1)
    assert weighted.distance == pytest.approx(repeated.distance, abs=1e-12)


@pytest.mark.parametrize(
    ("n", "parameters"),
    [(40, 1), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((700, 1), (30_000, 1), (700, 8)))],
)
def test_kolmogorov_limit_is_the_known_quantile(n: int, parameters: int) -> None:
    """By drawing: events of the model are uniform numbers, and the limit is exceeded in 5 % of the draws."""
    repetitions = 4000 if n < 1000 else 400
    u = np.sort(np.random.default_rng(n).random((repetitions, n)), axis=1)
    step = np.arange(n + 1) / n
    distance = np.maximum((step[1:] - u).max(axis=1), (u - step[:-1]).max(axis=1))
    share = 0.05 / parameters
    error = np.sqrt(share * (1.0 - share) / repetitions)
    assert np.mean(distance > kolmogorov_limit(n, parameters)) == pytest.approx(share, abs=4.0 * error)


@pytest.mark.parametrize("parameters", [1, 8])
def test_kolmogorov_limit_is_close_to_the_exact_quantile(parameters: int) -> None:
    n = np.array([20, 50, 149, 1000, 30_000])
    limits = [kolmogorov_limit(size, parameters) for size in n]
    np.testing.assert_allclose(limits, stats.kstwo.isf(0.05 / parameters, n), rtol=6e-3)
    np.testing.assert_allclose(limits[2:], stats.kstwo.isf(0.05 / parameters, n[2:]), rtol=1e-3)


def test_kolmogorov_limit_falls_with_the_effective_number() -> None:
    limits = [kolmogorov_limit(n, 8) for n in (0.0, 1.0, 9.0, 149.25, 149.9, 150.0, 150.5, 2000.0, 1e6)]
    assert limits[0] == limits[1] == 1.0
    assert all(first > second for first, second in itertools.pairwise(limits[1:]))


def test_the_joint_density_is_numpys_histogram() -> None:
    model = correlated()
    drawn, _ = model.sample(3000, 5)
    x, _ = model.sample(500, 6)
    weight = np.random.default_rng(0).random(500)
    weight /= weight.sum()
    joint = _joint_density(model, ("T", "d_y"), x, weight, drawn)
    edges = [joint.first_edges, joint.second_edges]
    np.testing.assert_allclose(joint.data, np.histogram2d(*x.T, bins=edges, weights=weight)[0], atol=1e-12)
    np.testing.assert_allclose(joint.model, np.histogram2d(*drawn.T, bins=edges)[0] / 3000, atol=1e-12)


def test_bins_end_at_a_bound_that_is_close() -> None:
    x = np.random.default_rng(1).exponential(size=(5000, 1))
    at_zero, remote = (
        BoundedGaussianMixture.from_parameters([1.0], [[1.0]], [[[1.0]]], lower=low).distribution for low in (0.0, -50)
    )
    edges = bin_edges(at_zero, x, x, 0, 40)
    assert (edges[0], edges[-1]) == (0.0, pytest.approx(np.quantile(x, 0.997)))
    assert bin_edges(remote, x, x, 0, 40)[0] == pytest.approx(np.quantile(x, 0.003))
    values = np.array([-0.1, 0.0, edges[-1], edges[-1] + 1.0])  # the last bin holds its right edge
    line = ModelMarginal(np.sort(x[:, 0]), np.array([0, x.size]), np.array([0.0, 1.0]))
    marginal = _marginal("T", values, np.array([0.1, 0.2, 0.3, 0.4]), line, edges)
    assert (marginal.data[0], marginal.data[39], marginal.data.sum()) == (0.2, 0.3, 0.5)


def test_histograms_count_all_events() -> None:
    model = independent()
    x, _ = model.sample(3000, 4)
    diagnostics = diagnose(model, x, n_model=20_000)
    for j, marginal in enumerate(diagnostics.marginals):
        np.testing.assert_allclose(marginal.data, np.histogram(x[:, j], marginal.edges)[0] / 3000, atol=1e-12)
        np.testing.assert_allclose(
            marginal.model, np.diff(margin_cdf(marginal.edges, j)), atol=0.003
        )  # sample of 20,000
    assert diagnostics.log_likelihood == pytest.approx(model.score(x))
