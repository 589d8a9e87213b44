"""The diagnosis as a whole: what it warns of, what it compares, what it refuses."""

import dataclasses

import numpy as np
import pytest

from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.diagnostics import SideDiagnostics, diagnose, diagnose_model
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture
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


def test_a_misfit_is_told_in_words(misfit: SideDiagnostics) -> None:
    text = "\n".join(misfit.warnings)
    assert all(line.startswith("left: ") for line in misfit.warnings)
    assert "Kolmogorov distance beyond" in text
    assert "mass next to bounds is not that of the events" in text
    assert "T lower" in text
    assert "after a logarithm or logit" in text
    assert all(c.distance > c.limit for c in misfit.calibrations[:2])
    assert "c_0" not in text  # the normal margin is described well


def test_the_transform_wins_where_it_should(misfit: SideDiagnostics) -> None:
    comparison = misfit.comparison
    assert comparison.transforms == (("T", "log"), ("d_y", "log"))
    assert comparison.difference == pytest.approx(comparison.transformed - comparison.bounded, abs=1e-12)
    assert comparison.difference > 4 * comparison.standard_error
    assert (comparison.events_fit, comparison.events_held_out) == (1500, 1500)


def test_a_right_model_has_no_warning() -> None:
    model = BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[1.0, 0.0], [3.0, 2.0]], [np.eye(2), np.eye(2)], lower=[0.0, -INF]
    )
    x, _ = model.sample(4000, 8)
    found = diagnose(model, x, n_model=20_000)
    assert found.warnings == ()
    assert found.comparison.difference < 0
    # of a right model, its own likelihood: both halves are within a few hundredths of it
    assert found.comparison.bounded == pytest.approx(model.score(x), abs=0.1)


def test_same_seed_same_numbers_whatever_the_order() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.0]], [[[1.0]]])
    x, _ = model.sample(500, 1)
    one, two = (diagnose(model, rows, seed=4, n_model=5000) for rows in (x, x))
    assert one.calibrations[0].distance == two.calibrations[0].distance
    np.testing.assert_array_equal(one.marginals[0].model, two.marginals[0].model)
    turned = diagnose(model, x[::-1], seed=4, n_model=5000)
    assert turned.calibrations[0].distance == pytest.approx(one.calibrations[0].distance, abs=1e-12)


def test_weights_and_repeated_rows_agree() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
    x, _ = model.sample(200, 1)
    times = np.random.default_rng(1).integers(1, 4, 200)
    weighted = diagnose(model, x, weights=times, n_model=5000)
    repeated = diagnose(model, np.repeat(x, times, axis=0), n_model=5000)
    assert weighted.effective_events == pytest.approx(times.sum() ** 2 / (times**2).sum())
    assert weighted.calibrations[0].distance == pytest.approx(repeated.calibrations[0].distance, abs=1e-12)
    assert weighted.components[0].events == pytest.approx(times.sum())
    assert weighted.strips[0].data == pytest.approx(repeated.strips[0].data, abs=1e-12)
    # fewer effective events: a wider limit
    assert weighted.calibrations[0].limit > repeated.calibrations[0].limit


def summary(**changes: object) -> SideSummary:
    plain = SideSummary(200, (1, 2), (10.0, 5.0), (0.0, 0.1), True, (), 0.0)
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


def bad_components() -> BoundedGaussianMixture:
    """A right one, one far outside with hardly any probability inside, one nearly flat and almost empty."""
    flat = np.array([[1.0, 1.0 - 1e-5], [1.0 - 1e-5, 1.0]])
    return BoundedGaussianMixture.from_parameters(
        [0.899, 0.1, 0.001], [[2.0, 2.0], [-8.0, 2.0], [4.0, 4.0]], [np.eye(2), np.eye(2), flat], lower=[0.0, 0.0]
    )


def test_each_warning_about_components_and_the_fit() -> None:
    model = bad_components()
    x, _ = model.sample(600, 2)
    told = summary(converged=False, n_components=(1, 2, 3), moved_inside=(("T", 3),))
    said = "\n".join(diagnose(model, x, n_model=5000, summary=told).warnings)
    assert "stopped before it had converged" in said
    assert "K = 3 is the largest that was tried" in said
    assert "tails of normals that lie outside the bounds" in said
    assert "component 1 (P = 10^-15, mean 8.0" in said
    assert "component 2 rests on fewer effective events" in said
    assert "nearly flat, by the condition number of the correlation matrix: component 2 (" in said
    assert "3 events had T exactly on a bound, moved just inside" in said


def test_events_outside_are_left_out_and_counted() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
    x, _ = model.sample(100, 1)
    found = diagnose(model, np.vstack([x, [[-1.0]], [[-2.0]], [[0.0]]]), names=["T"], n_model=5000)
    assert (found.events, found.outside) == (101, (("T", 2),))
    assert any("left out (T 2)" in line for line in found.warnings)


def test_without_bounds_nothing_is_compared() -> None:
    model = BoundedGaussianMixture.from_parameters([1.0], [[0.0]], [[[1.0]]])
    found = diagnose(model, np.random.default_rng(0).normal(size=(50, 1)), n_model=2000)
    assert found.comparison is None
    assert "no parameter has a finite bound" in found.comparison_note
    assert found.strips == ()


def test_too_few_events_for_a_comparison_is_said() -> None:
    found = diagnose(bad_components(), bad_components().sample(16, 1)[0], n_model=2000)
    assert found.comparison is None
    assert found.comparison_note == "half of the events, 8, are fewer than the 17 parameters of the mixture"
    assert any("no comparison with a transformed mixture" in line for line in found.warnings)


ONE = BoundedGaussianMixture.from_parameters([1.0], [[0.5]], [[[1.0]]], lower=0.0)
GOOD = np.linspace(0.1, 2.0, 20)[:, None]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"X": np.ones((20, 2))}, r"X: shape \(20, 2\); allowed: \(n, 1\)"), ({"X": [["a"]]}, "not a table of numbers"),
        ({"X": np.where(GOOD > 1.9, np.nan, GOOD)}, "X: x0 = nan in row 19"),
        ({"X": GOOD[:9]}, "9 of 9 events lie inside"), ({"X": -GOOD}, "0 of 20 events lie inside"),
        ({"weights": np.ones(3)}, r"weights: shape \(3,\)"), ({"weights": np.full(20, -1.0)}, "weights: -1.0 in row 0"),
        ({"weights": "heavy"}, "weights: not numbers"), ({"names": ("T", "d_y")}, "names: 2 names; allowed: 1"),
        ({"n_model": 10}, "n_model: 10; allowed: an integer >= 1000"),
        ({"seed": -1}, "seed: -1; allowed: an integer >= 0"),
    ],
)  # fmt: skip
def test_bad_input(change: dict[str, object], message: str) -> None:
    given = {"X": GOOD, "n_model": 1000} | change
    with pytest.raises(InputError, match=message):
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
    found = diagnose_model(model, departures_of(model, 300), n_model=5000, progress=lambda *a: steps.append(a))
    assert (found.left.label, found.right.label) == ("left", "right")
    assert found.left.names == ("T", "d_y")
    assert found.left.joint is not None
    assert (steps[0], steps[-1]) == (("left: margins", 0, 8), ("done", 8, 8))
    assert [done for _, done, _ in steps] == sorted({done for _, done, _ in steps})


def test_a_constant_that_varies_is_told() -> None:
    model = two_parameter_model()
    rows = departures_of(model, 50)
    rows = dataclasses.replace(rows, c_0=np.linspace(0.0, 1e-3, 100))
    warnings = diagnose_model(model, rows, n_model=2000).left.warnings
    assert any(line.startswith("left: the model holds c_0 at 0") for line in warnings)


def test_too_few_departures_name_the_side() -> None:
    model = two_parameter_model()
    rows = departures_of(model, 20)
    with pytest.raises(InputError, match=r"departures \(right\): X: 0 of 0 events"):
        diagnose_model(model, rows.take(rows.side == 1), n_model=2000)


@pytest.mark.slow
def test_the_reference_model_describes_its_own_events() -> None:
    model = load_model("reference")
    rows = departures_of(model, 2000).matrix()[:2000]
    found = diagnose(model.left_side, rows, n_model=50_000)
    assert (found.warnings, sum(one.events for one in found.components)) == ((), pytest.approx(2000))
    assert found.joint is not None
