"""What a model's file keeps of its departures: right numbers, none of the departures, back from a file bit by bit."""

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from helpers.models import one_component_model
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture.checks import Events
from ldctoolkit.scenario_model import ScenarioModel, SourceSummary, fit_scenario_model, summarize
from ldctoolkit.scenario_model.provenance import UNIT, summarize_events, weighted_ranks

NAMES = ("T", "d_y", "v_mean")


@pytest.fixture(scope="module")
def x():
    rng = np.random.default_rng(3)
    z = rng.normal(size=(6000, 3)) @ np.array([[1.0, 0.7, 0.0], [0.0, 0.5, 0.3], [0.0, 0.0, 1.0]])
    return np.column_stack([np.exp(z[:, 0]), 0.2 * np.exp(0.5 * z[:, 1]), 25.0 + z[:, 2]])


def test_quantiles_ranks_and_cells_agree_with_other_programs(x):
    found = summarize(x, names=NAMES)
    assert (found.departures, found.effective, found.b) == (6000, 6000.0, 12)
    wanted = np.quantile(x, found.probabilities, axis=0, method="hazen").T
    # windows of 10 in 6000 are narrow
    np.testing.assert_allclose(np.array(found.quantiles), wanted, rtol=5e-3)
    ranks = stats.spearmanr(x).statistic
    np.testing.assert_allclose(found.rank_correlations, [ranks[0, 1], ranks[0, 2], ranks[1, 2]], atol=6e-5)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        counts, _, _ = np.histogram2d(x[:, i], x[:, j], bins=(found.edges(i), found.edges(j)))
        counts[counts < 5] = 0
        np.testing.assert_allclose(found.pair(i, j), counts / 6000, atol=1.01 / UNIT)
        assert found.rank_correlation(i, j) == pytest.approx(ranks[i, j], abs=6e-5)


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
    found = summarize(x[:n], names=NAMES)
    m = found.probabilities.size
    assert m <= n // 10
    held = np.array([[float(f"{value:.6g}") for value in column] for column in x[:n].T])
    for row, column in zip(found.quantiles, held, strict=True):
        assert not np.isin(row, column).any()
    # ten departures or more behind each quantile: moving the largest one away moves the last by a tenth of that
    moved = x[:n].copy()
    moved[np.argmax(moved[:, 2]), 2] += 100.0
    assert abs(summarize(moved, names=NAMES).quantiles[2][-1] - found.quantiles[2][-1]) <= 10.0 + 1e-3
    cells = np.array(found.cells)
    assert cells[cells > 0].min() >= int(UNIT * 5 / n)


def test_too_few_departures_behind_the_weights_leave_it_out(x):
    weight = np.full(100, 1e-3)
    weight[:5] = 1.0
    assert summarize(x[:100], weight, names=NAMES) is None
    assert summarize(x[:9], names=NAMES) is None


def test_equal_values_and_one_parameter(x):
    column = np.where(np.arange(400) < 390, 0.0, 1.0)
    found = summarize(np.column_stack([column, x[:400, 0]]), names=("c_0", "T"))
    assert np.all(np.diff(found.edges(0)) > 0)
    assert found.at(0.5)[0] == 0.0
    alone = summarize(x[:400, :1], names=("T",))
    assert (alone.cells, alone.rank_correlations, alone.b) == ((), (), 0)


@pytest.mark.slow
def test_fits_keep_it(departures, tmp_path):
    table = departures(300)
    model = fit_scenario_model(table, components=1, n_init=1)
    left = model.provenance.left.source_summary
    assert left.names == model.left_side.names == NAMES
    assert left == summarize(table.matrix()[table.side == 1][:, [0, 1, 3]], names=NAMES)
    path = tmp_path / "model.json"
    model.save(path)
    back = ScenarioModel.load(path)
    assert (back.provenance, back.content_hash) == (model.provenance, model.content_hash)
    # a table cut in two weights: the same departures, half the weight each
    weighted = fit_scenario_model(table, components=1, n_init=1, weights=np.full(600, 0.5))
    assert weighted.provenance.left.source_summary == left


def test_of_many_departures_evenly_spread_ones_are_looked_at():
    ramp = np.arange(120_000.0)[:, None] + 0.5
    found = summarize_events(Events(ramp, np.linspace(1.0, 1.1, 120_000)), ("T",))
    assert found.departures == 50_000
    # 10 % more weight at the end than at the begin lift the median by 1.2 %
    np.testing.assert_allclose(found.quantiles[0], 120_000 * found.probabilities, atol=0.0125 * 120_000)
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
    ("change", "message"),
    [
        ({"names": ["T", "d_z"]}, r"left\.source_summary\.names: 'd_z'; did you mean 'd_y'"),
        ({"names": []}, "each parameter once, at least one"),
        ({"extra": 1}, "extra: no such key"),
        ({"departures": -1}, "departures: -1; allowed: a number above 0"),
        ({"effective": 0}, "effective: 0; allowed: a number above 0"),
        ({"quantiles": [[1.0], [1.0]]}, "quantiles: allowed: 2 lists of two or more"),
        ({"quantiles": [[1.0, 2.0], [2.0, 1.0]]}, r"quantiles\[1\]: not ascending"),
        ({"quantiles": [[1.0, 2.0]]}, r"quantiles: shape \(1, 2\); allowed: \(2, 2\)"),
        ({"rank_correlations": [1.001]}, r"rank_correlations\[0\]: 1.001; allowed: -1 to 1"),
        ({"cells": []}, "cells: 0 strings"),
        ({"cells": ["1 2 3"]}, r"cells\[0\]: '1 2 3'; allowed"),
        ({"cells": ["1 2 3 x"]}, r"cells\[0\]: '1 2 3 x'; allowed: a list"),
        ({"cells": ["9000 0 0 1001"]}, r"cells\[0\].*sum to 10000 at most"),
        ({"cells": [[1, 2, 3, 4]]}, r"cells\[0\]"),
    ],
)
def test_a_wrong_value_is_named(tmp_path, change, message):
    path = tmp_path / "model.json"
    one_component_model().save(path)
    content = json.loads(path.read_text())
    good = {
        "names": ["T", "d_y"],
        "departures": 100,
        "effective": 100.0,
        "quantiles": [[1.0, 1.0], [0.1, 0.2]],
        "rank_correlations": [-1.0],
        "cells": ["9000 0 0 1000"],  # all on the edge of what is allowed
    }
    content["provenance"]["left"]["source_summary"] = copy.deepcopy(good)
    path.write_text(json.dumps(content))
    assert isinstance(ScenarioModel.load(path).provenance.left.source_summary, SourceSummary)
    content["provenance"]["left"]["source_summary"] = good | change
    path.write_text(json.dumps(content))
    with pytest.raises(ModelError, match=message):
        ScenarioModel.load(path)
