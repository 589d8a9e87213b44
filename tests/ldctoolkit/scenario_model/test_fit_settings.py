"""Settings of a fit, and summaries of its departures."""

import copy
import dataclasses
import importlib.metadata
import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from helpers.errors import refused
from helpers.models import one_component_model
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, Plausibility
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import Distribution
from ldctoolkit.mixture.checks import Events
from ldctoolkit.recordings import Criteria
from ldctoolkit.scenario_model import ScenarioModel, SourceSummary, fit_scenario_model, load_model, summarize
from ldctoolkit.scenario_model.provenance import UNIT, cell_edges, summarize_events, weighted_ranks

INF = np.inf
ANYTHING = Plausibility(y_rate=INF, y_acceleration=INF, a_y=INF)


def box(model):
    """Bounds of the left side by name, and where they come from."""
    side = model.left_side
    lower, upper = side.bounds()
    origins = {name: (low, high) for name, low, high in model.provenance.left.bounds_from}
    return {n: (float(a), float(b), *origins[n]) for n, a, b in zip(side.names, lower, upper, strict=True)}


def test_bounds_default_to_physics_then_to_the_extraction(departures):
    bounds = box(fit_scenario_model(departures(40), components=1))
    assert bounds == {
        "T": (0.5, 10.0, "physical", "physical"),
        "d_y": (0.0, INF, "physical", "physical"),
        "v_mean": (5.0, INF, "physical", "physical"),
    }
    extraction = Criteria(min_duration=0.3, max_duration=12.0, min_speed=7.0)
    model = fit_scenario_model(departures(40), components=1, extraction=extraction, bounds={"d_y": (0.0, 1.5)})
    assert box(model) == {
        "T": (0.3, 12.0, "extraction criteria", "extraction criteria"),
        "d_y": (0.0, 1.5, "given", "given"),
        "v_mean": (7.0, INF, "extraction criteria", "physical"),
    }
    assert model.provenance.source["criteria"] == dataclasses.asdict(extraction)


@pytest.mark.parametrize(
    ("told", "hours", "distance"),
    [
        ({"hours": 1.5, "distance": 72_000}, 1.5, 72_000.0),
        ({"hours": 1.5, "distance": 0.0}, 1.5, None),  # a table of an earlier version
        ({"hours": "long", "distance": -1.0}, None, None),
        ("made up", None, None),
    ],
)
def test_the_model_keeps_the_hours_and_the_distance_of_its_recordings(departures, told, hours, distance):
    origin = fit_scenario_model(departures(40), components=1, source_provenance=told).provenance
    assert (origin.hours, origin.distance) == (hours, distance)


@pytest.mark.slow
def test_one_end_can_be_open(departures):
    d = departures(300, seed=1, a_mean=np.random.default_rng(0).normal(0.0, 0.3, 600))
    given = {"a_mean": (None, 3.0), "d_y": (None, 2.0), "T": (0.25, None)}
    bounds = box(fit_scenario_model(d, components=1, bounds=given))
    assert bounds["a_mean"] == (-INF, 3.0, "given", "given")
    assert bounds["d_y"] == (0.0, 2.0, "physical", "given")  # no departure below 0 can be driven
    assert bounds["T"] == (0.25, INF, "given", "given")
    opened = box(fit_scenario_model(d, components=1, bounds={"a_mean": (-INF, INF)}))
    assert opened["a_mean"] == (-INF, INF, "given", "given")


@pytest.mark.parametrize(
    ("bounds", "path", "allowed"),
    [
        (3, "bounds", "a mapping of parameters"),
        *(({"d_y": bad}, "bounds['d_y']", "(lower, upper)") for bad in ("fixed", (1.0,), ("a", 2), 2.0, None)),
        *(({"d_y": bad}, "bounds['d_y']", "0 <= lower < upper") for bad in ((2.0, 1.0), (-1.0, 1.0), (np.nan, 1.0))),
        ({"c_0": (0.0, 0.0)}, "bounds['c_0']", "-inf <= lower < upper"),
        ({"T": (0.5, 1.0)}, "departures (left): T", "0.5 to 1"),
        ({"dy": (0.0, 1.0)}, "bounds", PARAMETER_NAMES),
    ],
)
def test_wrong_bounds(departures, bounds, path, allowed):
    with refused(path, allowed=allowed):
        fit_scenario_model(departures(40), components=1, bounds=bounds)


def test_transforms_per_parameter(departures, tmp_path):
    d = departures(150)
    model = fit_scenario_model(d, components=1, transform={"d_y": "log", "T": "auto"})
    assert dict(zip(model.left_side.names, model.left_side.transform(), strict=True)) == {
        "T": "logit", "d_y": "log", "v_mean": "none"
    }  # fmt: skip
    # one mapped component: mean and spread of ln d_y are those of the data but for 10 pseudo-events of 150
    j = model.left_side.names.index("d_y")
    log_d_y = np.log(d.d_y[d.side == LEFT])
    np.testing.assert_allclose(model.left.means_[0, j], log_d_y.mean(), atol=1e-3)
    np.testing.assert_allclose(np.sqrt(model.left.covariances_[0, j, j]), log_d_y.std(), rtol=0.02)
    model.save(tmp_path / "m.json")
    back = load_model(tmp_path / "m.json")
    assert back.content_hash == model.content_hash
    assert np.array_equal(back.sample(9, 9, 1).matrix(), model.sample(9, 9, 1).matrix())
    assert fit_scenario_model(d, components=1, transform="auto").left_side.transform() == ("logit", "log", "log")
    plain = fit_scenario_model(d, components=1)
    assert fit_scenario_model(d, components=1, transform="none").content_hash == plain.content_hash
    assert set(plain.left_side.transform()) == {"none"}


def test_a_weight_of_two_is_two_events(departures):
    """Weights 1, 2 and 0 against the rows repeated once, twice and not at all: the same maximum."""
    d = departures(120)
    weight = np.random.default_rng(5).integers(0, 3, 240)
    repeated = d.take(np.repeat(np.arange(240), weight))
    weighted = fit_scenario_model(d, components=1, weights=weight, plausibility=ANYTHING)
    plain = fit_scenario_model(repeated, components=1, plausibility=ANYTHING)
    # sums in another order, and two runs that stop within the tolerance
    np.testing.assert_allclose(weighted.left.means_, plain.left.means_, rtol=1e-4)
    np.testing.assert_allclose(weighted.left.covariances_, plain.left.covariances_, rtol=1e-3, atol=1e-4)
    left = weighted.provenance.left
    assert left.weight == weight[:120].sum()
    assert left.events == np.count_nonzero(weight[:120])
    assert plain.provenance.left.weight is None
    np.testing.assert_allclose(left.bic, plain.provenance.left.bic, rtol=1e-6)


def test_the_card_tells_how_the_model_was_made(departures, tmp_path):
    model = fit_scenario_model(
        departures(150), components=(1, 2), kind="mixture", seed=5, prior_strength=20,
        n_init=np.int64(3), source_provenance={"refused": {"gap": 3}},
    )  # fmt: skip
    card, left = model.provenance, model.provenance.left
    assert list(card.versions) == ["ldctoolkit", "python", "numpy", "scipy", "numba"]
    assert card.versions["scipy"] == importlib.metadata.version("scipy")
    assert dataclasses.astuple(card.settings) == (20, 1e-7, 3, 500)
    assert left.kind == "mixture"
    assert left.reason.startswith(f"K = {model.left.weights_.size}, ")
    assert (left.stop_reason, left.passes, left.failed) == ("converged", model.left.n_iter_, ())
    K, d, n = np.array(left.n_components), 3, left.events
    assert left.n_parameters == tuple(K * (d + d * (d + 1) // 2) + K - 1)
    deviance = -2.0 * n * np.array(left.log_likelihood)
    np.testing.assert_allclose(left.bic, deviance + np.array(left.n_parameters) * np.log(n), rtol=1e-12)
    assert [name for name, *_ in left.bounds_from] == list(PARAMETER_NAMES)
    model.save(tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").provenance == card


def test_one_number_of_components_is_not_called_a_choice(departures):
    requested = fit_scenario_model(departures(40), components=1).provenance.left
    assert requested.reason == "K = 1, as requested"
    few = fit_scenario_model(departures(32), components=range(6, 9), kind="mixture", plausibility=ANYTHING).provenance
    assert few.left.n_components == (6,)
    assert few.left.reason == "K = 6, the only one of the range that the events carry"
    assert "left: 32 events carry no more than K = 6; larger K were not tried" in few.warnings


@pytest.mark.parametrize(
    ("setting", "path"),
    [
        ({"prior_strength": -1.0}, "prior_strength"), ({"tol": np.nan}, "tol"), ({"n_init": 0}, "n_init"),
        ({"max_iter": 1.5}, "max_iter"), ({"workers": 0}, "workers"), ({"kind": "smooth"}, "kind"),
        ({"transform": {"d_y": "lgo"}}, "transform['d_y']"), ({"transform": {"dy": "log"}}, "transform"),
        ({"transform": ""}, "transform"), ({"transform": 5}, "transform"),
    ],
)  # fmt: skip
def test_wrong_settings(departures, setting, path):
    with refused(path):
        fit_scenario_model(departures(40), components=1, **setting)


@pytest.mark.slow
def test_what_runs_the_fits_may_be_passed_in(departures):
    """As `map`; with few departures K are fitted one after the other, and nothing else is asked."""
    calls = []

    def fit_each(fit, models):
        calls.append([model.n_components for model in models])
        return map(fit, models)

    few = departures(40)
    assert (
        fit_scenario_model(few, components=[1, 2], kind="mixture", fit_each=fit_each).content_hash
        == fit_scenario_model(few, components=[1, 2], kind="mixture").content_hash
    )
    assert calls == []
    fit_scenario_model(departures(2600), components=[1, 2], kind="mixture", n_init=1, max_iter=1, fit_each=fit_each)
    assert calls == [[2, 1], [2, 1]]


def test_a_failed_K_of_a_range_is_a_warning(departures):
    """Half of the events are the same: without a prior a second component shrinks onto them."""
    d = departures(60)
    same, columns = np.arange(120) % 60 < 40, {name: getattr(d, name) for name in ("T", "d_y", "v_mean")}
    d = dataclasses.replace(d, **{name: np.where(same, column[0], column) for name, column in columns.items()})
    model = fit_scenario_model(d, components=[1, 2], prior_strength=0.0, n_init=2)
    assert model.provenance.left.n_components == (1,)
    ((K, message),) = model.provenance.left.failed
    assert (K, message[:38]) == (2, "X: the likelihood has no maximum, a co")
    assert any(w.startswith("left: K = 2 could not be fitted (X: the likelihood") for w in model.provenance.warnings)
    with refused("departures (left): X", hint="raise prior_strength or fit fewer components"):
        fit_scenario_model(d, components=2, prior_strength=0.0, n_init=2)


@pytest.mark.slow
def test_a_K_that_cannot_be_sampled_gives_way_to_another(departures, monkeypatch):
    usable = Distribution.check_samplable

    def unreachable(self):
        if self.weights.size == 1:
            raise ModelError("component 0 cannot be sampled")
        usable(self)

    monkeypatch.setattr(Distribution, "check_samplable", unreachable)
    model = fit_scenario_model(departures(60), components=[1, 2], n_init=1)
    assert model.left.weights_.size == 2
    assert model.provenance.left.failed == ((1, "component 0 cannot be sampled"),)
    assert "right: K = 1 could not be fitted (component 0 cannot be sampled)" in model.provenance.warnings
    with refused("departures (left): component 0 cannot be sampled", ModelError):
        fit_scenario_model(departures(60), components=1)


@pytest.mark.slow
def test_neither_workers_nor_verbosity_change_a_number(departures, capfd):
    first = fit_scenario_model(departures(60), components=[1, 2], workers=1)
    assert capfd.readouterr().err == ""
    second = fit_scenario_model(departures(60), components=[1, 2], workers=2, verbose=True)
    assert second.content_hash == first.content_hash
    assert "K = 2: " in capfd.readouterr().err


NAMES = ("T", "d_y", "v_mean")


@pytest.fixture(scope="module")
def x():
    rng = np.random.default_rng(3)
    z = rng.normal(size=(6000, 3)) @ np.array([[1.0, 0.7, 0.0], [0.0, 0.5, 0.3], [0.0, 0.0, 1.0]])
    return np.column_stack([np.exp(z[:, 0]), 0.2 * np.exp(0.5 * z[:, 1]), 25.0 + z[:, 2]])


def test_quantiles_ranks_and_cells_agree_with_other_programs(x):
    summary = summarize(x, names=NAMES)
    assert (summary.departures, summary.effective) == (6000, 6000.0)
    expected = np.quantile(x, summary.probabilities, axis=0, method="hazen").T
    # windows of 10 in 6000 are narrow
    np.testing.assert_allclose(np.array(summary.quantiles), expected, rtol=5e-3)
    ranks = stats.spearmanr(x).statistic
    np.testing.assert_allclose(summary.rank_correlations, [ranks[0, 1], ranks[0, 2], ranks[1, 2]], atol=6e-5)
    edges = [cell_edges(np.array(row), 12) for row in summary.quantiles]
    for (i, j), cells in zip(((0, 1), (0, 2), (1, 2)), summary.cells, strict=True):
        counts, _, _ = np.histogram2d(x[:, i], x[:, j], bins=(edges[i], edges[j]))
        counts[counts < 5] = 0
        np.testing.assert_allclose(np.array(cells) / UNIT, counts.ravel() / 6000, atol=1.01 / UNIT)


def test_a_weight_is_as_many_equal_departures(x):
    small, weight = x[:3000], np.random.default_rng(1).integers(0, 3, 3000)
    weighted = summarize(small, weight.astype(float), names=NAMES)
    repeated = summarize(np.repeat(small, weight, axis=0), names=NAMES)
    np.testing.assert_allclose(weighted.rank_correlations, repeated.rank_correlations, atol=1.1e-4)
    np.testing.assert_allclose(np.array(weighted.quantiles), np.array(repeated.quantiles), rtol=0.02)
    assert weighted.departures == int((weight > 0).sum())
    assert weighted.effective == pytest.approx(weight.sum() ** 2 / (weight**2).sum(), rel=1e-5)
    np.testing.assert_allclose(
        weighted_ranks(np.array([1.0, 1.0, 4.0]), np.array([0.25, 0.25, 0.5])), [0.25, 0.25, 0.75]
    )


@pytest.mark.parametrize("n", [30, 57, 200, 430])
def test_no_departure_stands_in_it(n, x):
    """Every quantile differs from every departure, and moves little with any of them."""
    summary = summarize(x[:n], names=NAMES)
    m = summary.probabilities.size
    assert m <= n // 10
    held = np.array([[float(f"{value:.6g}") for value in column] for column in x[:n].T])
    for row, column in zip(summary.quantiles, held, strict=True):
        assert not np.isin(row, column).any()
    # ten departures or more behind each quantile: moving the largest one away moves the last by a tenth of that
    moved = x[:n].copy()
    moved[np.argmax(moved[:, 2]), 2] += 100.0
    assert abs(summarize(moved, names=NAMES).quantiles[2][-1] - summary.quantiles[2][-1]) <= 10.0 + 1e-3
    cells = np.array(summary.cells)
    assert cells[cells > 0].min() >= int(UNIT * 5 / n)


def test_too_few_departures_behind_the_weights_leave_it_out(x):
    weight = np.full(100, 1e-3)
    weight[:5] = 1.0
    assert summarize(x[:100], weight, names=NAMES) is None
    assert summarize(x[:9], names=NAMES) is None


def test_equal_values_and_one_parameter(x):
    column = np.where(np.arange(400) < 390, 0.0, 1.0)
    summary = summarize(np.column_stack([column, x[:400, 0]]), names=("c_0", "T"))
    assert np.all(np.diff(cell_edges(np.array(summary.quantiles[0]), 4)) > 0)
    assert summary.at(0.5)[0] == 0.0
    alone = summarize(x[:400, :1], names=("T",))
    assert (alone.cells, alone.rank_correlations) == ((), ())


@pytest.mark.slow
def test_fits_keep_it(departures, tmp_path):
    table = departures(300)
    model = fit_scenario_model(table, components=1, n_init=1, plausibility=ANYTHING)
    left = model.provenance.left.source_summary
    assert left.names == model.left_side.names == NAMES
    assert left == summarize(table.matrix()[table.side == 1][:, [0, 1, 3]], names=NAMES)
    path = tmp_path / "model.json"
    model.save(path)
    back = ScenarioModel.load(path)
    assert (back.provenance, back.content_hash) == (model.provenance, model.content_hash)
    # a table cut in two weights: the same departures, half the weight each
    weighted = fit_scenario_model(table, components=1, n_init=1, weights=np.full(600, 0.5), plausibility=ANYTHING)
    assert weighted.provenance.left.source_summary == left


def test_of_many_departures_evenly_spread_ones_are_looked_at():
    ramp = np.arange(120_000.0)[:, None] + 0.5
    summary = summarize_events(Events(ramp, np.linspace(1.0, 1.1, 120_000)), ("T",))
    assert summary.departures == 50_000
    # 10 % more weight at the end than at the begin lift the median by 1.2 %
    np.testing.assert_allclose(summary.quantiles[0], 120_000 * summary.probabilities, atol=0.0125 * 120_000)
    assert summarize_events(Events(ramp[:50_001]), ("T",)).departures == 50_000
    assert summarize_events(Events(ramp[:50_000]), ("T",)) == summarize(ramp[:50_000], names=("T",))


def test_both_sides_take_less_than_60_kb():
    path = Path(__file__).parents[3] / "ldctoolkit" / "models" / "reference.json"
    content = json.loads(path.read_text())
    whole = len(json.dumps(content, indent=1))
    for side in ("left", "right"):
        assert content["provenance"][side]["source_summary"]["departures"] == 30_000
        content["provenance"][side]["source_summary"] = None
    assert 20_000 < whole - len(json.dumps(content, indent=1)) < 60_000


@pytest.mark.parametrize(
    ("change", "path"),
    [
        ({"names": ["T", "d_z"]}, "names"), ({"names": []}, "names"), ({"names": ["T", "T"]}, "names"),
        ({"departures": -1}, "departures"), ({"effective": 0}, "effective"),
        ({"quantiles": [[1.0], [1.0]]}, "quantiles"), ({"quantiles": [[1.0, 2.0]]}, "quantiles"),
        ({"quantiles": [[1.0, 2.0], [2.0, 1.0]]}, "quantiles[1]"),
        ({"rank_correlations": [1.001]}, "rank_correlations[0]"), ({"cells": []}, "cells"),
        ({"cells": ["1 2 3"]}, "cells[0]"), ({"cells": ["9000 0 0 1001"]}, "cells[0]"),
    ],
)  # fmt: skip
def test_a_wrong_value_is_named(tmp_path, change, path):
    file = tmp_path / "model.json"
    one_component_model().save(file)
    content = json.loads(file.read_text())
    del content["checksum"]
    good = {
        "names": ["T", "d_y"],
        "departures": 100,
        "effective": 100.0,
        "quantiles": [[1.0, 1.0], [0.1, 0.2]],
        "rank_correlations": [-1.0],
        "cells": ["9000 0 0 1000"],  # all on the edge of what is allowed
    }
    content["provenance"]["left"]["source_summary"] = copy.deepcopy(good)
    file.write_text(json.dumps(content))
    assert isinstance(ScenarioModel.load(file).provenance.left.source_summary, SourceSummary)
    content["provenance"]["left"]["source_summary"] = good | change
    file.write_text(json.dumps(content))
    with refused(f"{file}: provenance.left.source_summary.{path}", ModelError):
        ScenarioModel.load(file)
    for odd, message in (({"extra": 1}, "extra: no such key"), ({"cells": ["1 2 3 x"]}, r"cells\[0\]: '1 2 3 x'")):
        content["provenance"]["left"]["source_summary"] = good | odd
        file.write_text(json.dumps(content))
        with pytest.raises(ModelError, match=message):
            ScenarioModel.load(file)
