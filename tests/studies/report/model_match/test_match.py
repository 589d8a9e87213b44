"""Generated departures against their source and their model, by other routes than the module's."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from ldctoolkit import Scenarios
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, Departures
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import ScenarioModel, SideModel, load_model, summarize
from studies.report.model_match.match import match, rank_limits, within_bounds


def table(scenarios: Scenarios, **changed: np.ndarray) -> Departures:
    """The same departures as if they were recorded."""
    n = len(scenarios)
    columns = {name: getattr(scenarios, name) for name in PARAMETER_NAMES} | changed
    return Departures(
        scenarios.side, **columns, recording=np.full(n, "r"), start_time=np.zeros(n), samples=np.full(n, 9)
    )


@pytest.fixture(scope="module")
def model() -> ScenarioModel:
    return load_model("reference")


@pytest.fixture(scope="module")
def generated(model: ScenarioModel) -> Scenarios:
    return model.sample(300, 200, seed=5)


def without_summary(model: ScenarioModel) -> ScenarioModel:
    card = model.provenance
    sides = {key: dataclasses.replace(getattr(card, key), source_summary=None) for key in ("left", "right")}
    return dataclasses.replace(model, provenance=dataclasses.replace(card, **sides))


@pytest.mark.slow
def test_a_departures_table_is_compared_exactly(model: ScenarioModel, generated: Scenarios) -> None:
    source = table(model.sample(900, 700, seed=6))
    left, right = match(generated, model, source=source)
    assert (left.key, left.origin, left.generated, left.source) == ("left", "table", 300, 900)
    assert (right.key, right.generated, right.source) == ("right", 200, 700)
    rows, mine = source.side == LEFT, generated.side == LEFT
    for margin in left.margins:
        own, other = getattr(generated, margin.name)[mine], getattr(source, margin.name)[rows]
        assert margin.to_source.value == pytest.approx(stats.ks_2samp(own, other).statistic, abs=1e-12)
        assert margin.source == pytest.approx(np.histogram(other, margin.edges)[0] / 900)
        assert margin.generated == pytest.approx(np.histogram(own, margin.edges)[0] / 300)
        assert margin.source_at == pytest.approx(np.quantile(other, (0.05, 0.5, 0.95)))
        # 5 % in eight parameters together, as one sample of as many effective events
        exact = stats.kstwo.ppf(1 - 0.05 / 8, 225)
        assert margin.to_source.limit == pytest.approx(exact, rel=0.05)
    ranks = stats.spearmanr(np.column_stack([getattr(generated, name)[mine] for name in left.names])).statistic
    known = stats.spearmanr(np.column_stack([getattr(source, name)[rows] for name in left.names])).statistic
    for pair in left.pairs:
        i, j = left.names.index(pair.first), left.names.index(pair.second)
        assert pair.generated_rank == pytest.approx(ranks[i, j], abs=1e-9)
        assert pair.reference_rank == pytest.approx(known[i, j], abs=1e-4)
        counts, _, _ = np.histogram2d(
            getattr(generated, pair.first)[mine], getattr(generated, pair.second)[mine],
            bins=(pair.first_edges, pair.second_edges),
        )  # fmt: skip
        assert pair.generated == pytest.approx(counts / 300)
        assert pair.limits == pytest.approx(rank_limits(pair.reference_rank, 300, 900, 28))
        assert pair.limits[0] < pair.reference_rank < pair.limits[1]
    assert left.widest_pair is max(left.pairs, key=lambda pair: pair.off)
    assert [pair.beyond for pair in left.pairs] == [pair.off > 1.0 for pair in left.pairs]


@pytest.mark.slow
def test_the_models_summary_stands_for_the_departures(model: ScenarioModel, generated: Scenarios) -> None:
    """A summary of a table gives nearly the numbers of the table."""
    source = table(model.sample(4000, 4000, seed=6))
    summary = summarize(source.matrix()[source.side == LEFT], names=PARAMETER_NAMES)
    card = model.provenance
    held = dataclasses.replace(card, left=dataclasses.replace(card.left, source_summary=summary))
    left, _ = match(generated, dataclasses.replace(model, provenance=held))
    exact, _ = match(generated, model, source=source)
    assert (left.origin, left.source) == ("summary", 4000)
    for one, other in zip(left.margins, exact.margins, strict=True):
        assert one.to_source.value == pytest.approx(other.to_source.value, abs=0.02)
        assert one.to_source.value <= other.to_source.value + 0.004
        assert np.abs(one.source - other.source).max() < 0.02
    for one, other in zip(left.pairs, exact.pairs, strict=True):
        assert one.reference == pytest.approx(other.reference)
        assert one.reference_rank == other.reference_rank


@pytest.mark.slow
def test_other_driving_is_beyond_chance(model: ScenarioModel, generated: Scenarios) -> None:
    faster = table(model.sample(800, 800, seed=6))
    faster = dataclasses.replace(faster, v_mean=faster.v_mean + 4.0)
    for side in match(generated, model, source=faster):
        assert [margin.name for margin in side.margins if margin.to_source.beyond] == ["v_mean"]
        assert not any(margin.to_model.beyond for margin in side.margins)


def test_margins_of_the_model_are_exact() -> None:
    """One normal, cut at zero: the truncated normal's own distribution."""
    mixture = BoundedGaussianMixture.from_parameters(
        [1.0], [[2.0, 0.1, 25.0]], np.diag([0.25, 0.01, 9.0])[None], lower=[0.5, 0.0, 5.0], upper=[10.0, np.inf, np.inf]
    )
    rest = tuple((name, 0.0) for name in PARAMETER_NAMES if name not in ("T", "d_y", "v_mean"))
    side = SideModel(mixture, ("T", "d_y", "v_mean"), rest)
    model = dataclasses.replace(load_model("reference"), left_side=side)
    scenarios = model.sample(200, 0, seed=1)
    (left,) = match(scenarios, without_summary(model))
    assert (left.names, left.origin, left.source) == (("T", "d_y", "v_mean"), "none", None)
    cut = stats.truncnorm(-1.0, np.inf, loc=0.1, scale=0.1)
    d_y = left.margins[1]
    assert d_y.model == pytest.approx(np.diff(cut.cdf(d_y.edges)), abs=3e-3)
    assert d_y.to_model.value == pytest.approx(stats.kstest(scenarios.d_y, cut.cdf).statistic, abs=2e-3)
    assert d_y.to_source is None
    assert all(pair.reference is not None for pair in left.pairs)
    inside = stats.norm.sf(-3.0) * stats.norm.sf(-1.0) * stats.norm.sf(-20 / 3)
    assert within_bounds(side) == pytest.approx(inside, rel=1e-4)
    assert left.drawing.within_bounds == pytest.approx(inside, rel=1e-4)


def test_draws_within_the_bounds_by_drawing(model: ScenarioModel) -> None:
    """The mixture without bounds, component k with a share as eta_k/P_k."""
    half = model.left_side
    distribution, rng = half.mixture.distribution, np.random.default_rng(0)
    share = distribution.weights * np.exp(-distribution.truncated.log_probability)
    counts = rng.multinomial(40_000, share / share.sum())
    lower, upper = half.bounds()
    kept = 0
    for k, count in enumerate(counts):
        x = rng.multivariate_normal(half.mixture.means_[k], half.mixture.covariances_[k], count)
        kept += int(np.all((x >= lower) & (x <= upper), axis=1).sum())
    assert within_bounds(half) == pytest.approx(kept / 40_000, abs=0.01)


@pytest.mark.slow
def test_conditions_hold_for_the_source_too(model: ScenarioModel) -> None:
    given = {"v_mean": (25.0, 35.0)}
    scenarios = model.sample(300, 300, seed=5, given=given)
    source = table(model.sample(2000, 2000, seed=6))
    left, _ = match(scenarios, model, source=source, given=given)
    rows = (source.side == LEFT) & (source.v_mean >= 25.0) & (source.v_mean <= 35.0)
    assert left.source == rows.sum()
    assert not any(margin.to_source.beyond or margin.to_model.beyond for margin in left.margins)
    assert left.drawing.met == pytest.approx(rows.sum() / 2000, abs=0.03)
    # not known of a summary: left out, and said
    left, _ = match(scenarios, model, given=given)
    assert (left.origin, left.source) == ("none", None)
    assert "conditions" in left.reason
    assert not any(margin.to_model.beyond for margin in left.margins)
    few, _ = match(scenarios, model, source=source.take(rows & (np.cumsum(rows) <= 12)), given=given)
    assert few.origin == "none"
    assert "holds 12 departures of this side that meet the study" in few.reason


def test_one_value_of_a_parameter_leaves_it_out(model: ScenarioModel) -> None:
    given = {"c_0": 0.0}
    scenarios = model.sample(100, 0, seed=5, given=given)
    (left,) = match(scenarios, model, source=table(model.sample(100, 100, seed=6)), given=given)
    assert "c_0" not in left.names
    assert (left.origin, left.drawing.met) == ("none", None)
    assert "one value of c_0" in left.reason
    every = {name: float(getattr(scenarios, name)[0]) for name in PARAMETER_NAMES}
    (left,) = match(model.sample(5, 0, seed=5, given=every), model, given=every)
    assert (left.margins, left.pairs) == ((), ())


@pytest.mark.slow
def test_without_a_model_and_few_departures(model: ScenarioModel) -> None:
    (left,) = match(model.sample(40, 0, seed=1), None)
    assert (left.origin, left.pairs, left.drawing) == ("none", (), None)
    assert all(margin.model is None and margin.source is None for margin in left.margins)
    (right,) = match(model.sample(0, 1, seed=1), model)
    assert right.pairs == ()
    assert all(0.0 <= margin.to_model.value <= margin.to_model.limit <= 1.0 for margin in right.margins)
    source = table(model.sample(100, 100, seed=6))
    (left,) = match(model.sample(40, 0, seed=1), None, source=source)
    assert (left.origin, left.source) == ("table", 100)
