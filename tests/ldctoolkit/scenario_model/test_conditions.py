"""Conditions on drawn departures, fits of several tables, the example of the documentation."""

import dataclasses
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from helpers.errors import refused
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Plausibility
from ldctoolkit.errors import RecordingError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.recordings import Preparation, Provenance, SourceFile
from ldctoolkit.recordings.departures_table import merged_provenance
from ldctoolkit.scenario_model import (
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    ScenarioModel,
    SideFidelity,
    SideModel,
    SideSummary,
    conditions,
    load_model,
)
from ldctoolkit.scenario_model.json_form import VERSION, parts_to_json
from ldctoolkit.scenarios import SPEED_FLOOR, slowest_speed


@pytest.fixture(scope="module")
def reference():
    return load_model("reference")


def box(names):
    return (np.array([PHYSICAL_BOUNDS[name][end] for name in names]) for end in (0, 1))


@pytest.fixture(scope="module")
def constant():
    """Two components a side; dc is 0 in every event, T and d_y were fitted after a map."""
    names = PARAMETER_NAMES[:-1]
    lower, upper = box(names)
    mean = np.array([[-1.0, -1.6, 0.05, 25.0, 0.0, 0.04, 0.0], [-1.0, -1.2, 0.04, 12.0, 0.2, 0.05, 1e-3]])
    spread = np.array([0.5, 0.4, 0.02, 4.0, 0.3, 0.02, 1e-3])
    correlation = np.eye(7)
    correlation[0, 1] = correlation[1, 0] = 0.6
    correlation[3, 6] = correlation[6, 3] = -0.4
    cov = np.stack([correlation * spread[:, None] * spread] * 2)
    transform = ["logit", "log", "none", "none", "none", "none", "none"]
    shares = [0.6, 0.4]
    mixture = BoundedGaussianMixture.from_parameters(shares, mean, cov, lower=lower, upper=upper, transform=transform)
    side = SideModel(mixture, names, (("dc", 0.0),))
    return ScenarioModel(side, side, ModelProvenance({}))


def same_distribution(drawn, filtered, names):
    """Two-sample Kolmogorov-Smirnov in every parameter and a few products: none far beyond chance."""
    first, second = drawn.matrix(), filtered.matrix()
    columns = [PARAMETER_NAMES.index(name) for name in names]
    for j in columns:
        assert stats.ks_2samp(first[:, j], second[:, j]).pvalue > 1e-4, PARAMETER_NAMES[j]
    for j in columns:
        for k in columns:
            if j < k:
                a, b = (((x[:, j] - second[:, j].mean()) * (x[:, k] - second[:, k].mean())) for x in (first, second))
                assert stats.ks_2samp(a, b).pvalue > 1e-5, (PARAMETER_NAMES[j], PARAMETER_NAMES[k])


@pytest.mark.parametrize("which", [pytest.param("reference", marks=pytest.mark.slow), "constant"])
def test_conditional_scenarios_are_those_that_filtering_leaves(which, request):
    model = request.getfixturevalue(which)
    given = {"v_mean": (22.0, 30.0), "T": (1.5, None), "c_0": (None, 5e-4)}
    drawn = model.sample(4000, 0, seed=1, given=given)
    all_of_them = model.sample(60_000, 0, seed=2)
    met = (np.abs(all_of_them.v_mean - 26.0) < 4.0) & (all_of_them.T > 1.5) & (all_of_them.c_0 < 5e-4)
    filtered = all_of_them.take(met)
    assert len(filtered) > 5000
    assert drawn.v_mean.min() > 22.0
    assert drawn.v_mean.max() < 30.0
    assert drawn.T.min() > 1.5
    assert drawn.c_0.max() < 5e-4
    same_distribution(drawn, filtered, PARAMETER_NAMES if which == "reference" else PARAMETER_NAMES[:-1])


def test_conditional_scenarios_are_nested_and_sides_apart(reference):
    given = {"v_mean": (25.0, 35.0), "c_0": 0.001}
    s = reference.sample(1500, 300, 7, given=given)
    assert s.side.tolist() == [LEFT] * 1500 + [RIGHT] * 300
    fewer = reference.sample(10, 5, 7, given=given)
    assert np.array_equal(fewer.matrix()[:10], s.matrix()[:10])
    assert np.array_equal(fewer.matrix()[10:], s.matrix()[1500:1505])
    assert np.unique(s.T).size == 1800
    assert not np.array_equal(reference.sample(10, 0, 8, given=given).matrix(), s.matrix()[:10])
    assert slowest_speed(s.v_mean, s.a_mean, s.T).min() >= SPEED_FLOOR


def test_no_condition_is_the_model_itself(reference):
    plain = reference.sample(20, 20, 1).matrix()
    for nothing in (None, {}, {"T": (None, None)}, {"c_0": (-np.inf, np.inf)}):
        assert np.array_equal(reference.sample(20, 20, 1, given=nothing).matrix(), plain)


def test_all_parameters_can_be_given(constant):
    values = dict.fromkeys(PARAMETER_NAMES, 0.1) | {"T": 2.0, "v_mean": 20.0, "c_0": 0.0, "dc": 0.0}
    s = constant.sample(3, 2, 1, given=values)
    assert np.array_equal(s.matrix(), np.tile([values[name] for name in PARAMETER_NAMES], (5, 1)))


def test_a_constant_must_meet_its_condition(constant):
    plain = constant.sample(9, 9, 1).matrix()
    for met in (0.0, (-1.0, 1.0), (0.0, None), (None, 0.0)):
        assert np.array_equal(constant.sample(9, 9, 1, given={"dc": met}).matrix(), plain)
    for not_met in (1e-3, (0.1, 1.0)):
        with refused("given['dc']", allowed="0, as in every left departure of this model"):
            constant.sample(9, 9, 1, given={"dc": not_met})


def test_a_side_that_is_not_drawn_need_not_meet_a_condition(reference, constant):
    mixed = dataclasses.replace(reference, right_side=constant.right_side)
    assert len(mixed.sample(5, 0, 1, given={"dc": 1e-4})) == 5
    with refused("given['dc']", allowed="0, as in every right departure of this model"):
        mixed.sample(5, 1, 1, given={"dc": 1e-4})


NUMBER = "a number, or (lower, upper) with lower < upper and None where open"
WRONG = ("fast", True, np.nan, np.inf, (3.0,), (3.0, "x"), (np.nan, 3.0), (30.0, 20.0), None, (np.inf, np.inf))
LEFT_BOUNDS = "the bounds of the left departures of this model"


@pytest.mark.parametrize(
    ("given", "path", "fields"),
    [
        ({"v": 3.0}, "given", {"value": "v", "allowed": PARAMETER_NAMES}),
        ([("v_mean", 3.0)], "given", {"value": [("v_mean", 3.0)], "allowed": "a mapping of parameters"}),
        *(({"v_mean": value}, "given['v_mean']", {"value": value, "allowed": NUMBER}) for value in WRONG),
        ({"T": 0.5}, "given['T']", {"problem": "T = 0.5 s", "allowed": f"between 0.5 and 10, {LEFT_BOUNDS}"}),
        ({"T": (10.0, 12.0)}, "given['T']", {"problem": "T from 10 to 12 s"}),
        ({"d_y": (None, 0.0)}, "given['d_y']",
         {"problem": "d_y below 0 m", "allowed": f"between 0 and inf, {LEFT_BOUNDS}"}),
    ],
)  # fmt: skip
def test_wrong_conditions(reference, given, path, fields):
    with refused(path, **fields):
        reference.sample(5, 5, 1, given=given)


def test_conditions_in_words():
    given = {"c_0": 1e-3, "v_mean": [25, None], "T": (None, 3), "d_y": (0.1, 0.5), "dc": (None, None), "a_mean": (1, 1)}
    assert [str(c) for c in conditions(given)] == [
        "T below 3 s", "d_y from 0.1 to 0.5 m", "v_mean above 25 m/s", "a_mean = 1 m/s^2", "c_0 = 0.001 1/m"
    ]  # fmt: skip
    assert conditions(None) == conditions({}) == ()


def origin(number: int, *more: SourceFile, **changed: Any) -> Provenance:
    return Provenance(sources=(SourceFile(f"{number}.csv", 10, f"{number:064d}"), *more), **changed)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ({"step": 0.1}, {"step": None}, "step = None, a.parquet with 0.1"),
        ({}, {"nominal_lane_width": 3.5}, "nominal_lane_width = 3.5, a.parquet with None"),
        ({}, {"yaw_rate_factor": -1.0}, "yaw_rate_factor = -1.0, a.parquet with 1.0"),
        ({}, {"max_gap": 0.5}, "max_gap = 0.5, a.parquet with 0.25"),
    ],
)
def test_different_preparations(first: dict[str, Any], second: dict[str, Any], words: str) -> None:
    tables = [origin(0, preparation=Preparation(**first)), origin(1, preparation=Preparation(**second))]
    with pytest.raises(RecordingError, match=f"^b.parquet: extracted with {words}; allowed: .* the same preparation$"):
        merged_provenance(["a.parquet", "b.parquet"], tables)
    tables[1] = origin(1, preparation=Preparation(**first))
    assert merged_provenance(["a.parquet", "b.parquet"], tables).preparation == Preparation(**first)


def test_empty_files_are_no_recordings() -> None:
    """Two folders of trips may each hold an empty file; their digests are the same."""
    nothing = [SourceFile(f"{name}/RAW_GPS.txt", 0, hashlib.sha256(b"").hexdigest()) for name in ("D1", "D2")]
    merged = merged_provenance(["a.parquet", "b.parquet"], [origin(i, one) for i, one in enumerate(nothing)])
    assert [source.name for source in merged.sources] == ["0.csv", "D1/RAW_GPS.txt", "1.csv", "D2/RAW_GPS.txt"]


def test_hours_and_distances_of_tables_are_summed() -> None:
    tables = [origin(0, hours=1.5, distance=72_000.25), origin(1), origin(2, hours=0.25, distance=18_000.5)]
    merged = merged_provenance(["a.parquet", "b.parquet", "c.parquet"], tables)
    assert (merged.hours, merged.distance) == (1.75, 90_000.75)
    # driven, but of an earlier version: part of the distance is not the distance
    tables[1] = origin(1, hours=2.0)
    merged = merged_provenance(["a.parquet", "b.parquet", "c.parquet"], tables)
    assert (merged.hours, merged.distance) == (3.75, 0.0)


PAGE = (Path(__file__).parents[3] / "docs/explanation/scenario-model.md").read_text(encoding="utf-8")


def test_the_code_runs(capsys):
    """One block goes on where the one before ended."""
    space = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE, flags=re.S):
        exec(compile(code, "scenario-model.md", "exec"), space)
    assert (capsys.readouterr().out, len(space["motorway"])) == ("K = 1, as requested\n", 400)


def test_every_key_of_a_file_is_described():
    section = PAGE[PAGE.index("## File") : PAGE.index("## The bundled model")]
    described = set(re.findall(r"`\.?([a-z_]+)`", section))
    model = load_model("reference")
    content = parts_to_json(model.left_side, model.right_side, model.provenance, model.plausibility)
    keys = {*content, *content["sides"]["left"]} - {"sides"}
    for kind in (ModelProvenance, SideSummary, SideFidelity, FitSettings, Plausibility):
        keys |= {field.name for field in dataclasses.fields(kind)}
    assert keys <= described, keys - described
    assert f"`, {VERSION} |" in section
    assert json.dumps(content)
