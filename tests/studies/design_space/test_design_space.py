"""Design spaces: what a table stands for, against SciPy's and SALib's own samples, and what each mistake says."""

import dataclasses
import itertools
import json
import math
import re
import sys
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from SALib.sample import sobol
from scipy.stats import qmc

from helpers.errors import assert_fields
from ldctoolkit import Controller, Plant, controller_class, gain, register, registry
from ldctoolkit.declared import find_gain
from ldctoolkit.errors import InputError, StudyError
from ldctoolkit.studies import Design, Study
from ldctoolkit.studies.design_space import (
    Y_S,
    Choices,
    Condition,
    DesignBlock,
    LawSpace,
    SampleSettings,
    Span,
    check_blocks,
    expand,
    next_value,
    read_entry,
    unit_points,
)

pytestmark = pytest.mark.usefixtures("laws")

CONTINUOUS = {"y_s": {"from": 0.05, "to": 0.3}, "gains": {"K": {"from": -0.8, "to": -0.1}, "N": {"from": 1, "to": 50}}}


def block(**parts: Any) -> DesignBlock:
    return Study.from_dict({"name": "a", "design": [{"law": "toy"} | parts]}).design[0]


def gains(design: Design) -> dict[str, Any]:
    return dict(design.gains)


# ---- several laws, conditions
def test_a_gain_goes_to_the_laws_that_have_it() -> None:
    found = block(law=["lqr", "linear_mpc"], y_s=[0.1, 0.2], gains={"r_delta": [50, 500], "horizon": [5, 10, 15]})
    expected = [Design.from_gains("lqr", y_s, {"r_delta": r}) for y_s in (0.1, 0.2) for r in (50, 500)]
    expected += [
        Design.from_gains("linear_mpc", y_s, {"r_delta": r, "horizon": n})
        for y_s, r, n in itertools.product((0.1, 0.2), (50, 500), (5, 10, 15))
    ]
    assert found.designs() == expected
    assert found.size == len(expected) == 16


def test_laws_of_one_table_are_those_of_one_table_each() -> None:
    """The same identifiers, so the same results, however a study is written; samples too."""
    for sample in ({}, {"sample": {"method": "sobol", "count": 8, "seed": 4}}):
        shared = {"gains": {"r_delta": {"from": 50, "to": 500, "count": 4, "scale": "log"}}, "y_s": [0.1, 0.2]} | sample
        together = block(law=["lqr", "linear_mpc"], **shared).designs()
        apart = block(law="lqr", **shared).designs() + block(law="linear_mpc", **shared).designs()
        assert [d.id for d in together] == [d.id for d in apart]


def test_a_gain_with_a_condition_keeps_its_default_otherwise() -> None:
    found = block(
        law="linear_mpc", gains={"blocks": [0, 3, 5], "solver": ["osqp", "daqp"]}, when={"blocks": {"solver": "osqp"}}
    ).designs()
    assert [(gains(d)["solver"], gains(d)["blocks"]) for d in found] == [
        ("osqp", 0), ("daqp", 0), ("osqp", 3), ("osqp", 5),
    ]  # fmt: skip


@given(
    st.lists(st.sampled_from([True, False]), min_size=1, max_size=2, unique=True),
    st.lists(st.integers(1, 50), min_size=1, max_size=4, unique=True),
    st.sampled_from(["as_printed", "consistent"]),
)
def test_conditions_leave_exactly_the_designs_that_differ(on: list[bool], N: list[int], convention: str) -> None:
    """Against the full grid, with the conditional gain put back by hand."""
    given_gains = {"N": N, "on": on, "convention": ["as_printed", "consistent"]}
    when = {"N": {"on": on[0], "convention": convention}}
    found = block(gains=given_gains, when=when).designs()
    expected = {
        Design.from_gains(
            "toy", 0.2, {"on": o, "convention": c} | ({"N": n} if o == on[0] and c == convention else {})
        ).id
        for n, o, c in itertools.product(N, on, ("as_printed", "consistent"))
    }
    assert (len(found), {d.id for d in found}) == (len(expected), expected)


def test_conditions_hold_in_a_sample_too() -> None:
    found = block(
        gains={"N": {"from": 10, "to": 50}, "on": [True, False]},
        when={"N": {"on": True}},
        sample={"method": "latin_hypercube", "count": 40},
    ).designs()
    off = [gains(d)["N"] for d in found if not gains(d)["on"]]
    assert len(off) == 20  # every value of a list gets its share
    assert set(off) == {5}  # the default, which is outside the range
    assert all(10 <= gains(d)["N"] <= 50 for d in found if gains(d)["on"])


# ---- samples
@pytest.mark.parametrize(("count", "dimensions"), [(1, 1), (7, 3), (16, 2)])
def test_points_are_scipys_own(count: int, dimensions: int) -> None:
    lhs = unit_points(SampleSettings(method="latin_hypercube", count=count, seed=7), dimensions)
    np.testing.assert_array_equal(lhs, qmc.LatinHypercube(dimensions, rng=np.random.default_rng(7)).random(count))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # also where the count is no power of two
        points = unit_points(SampleSettings(method="sobol", count=count, seed=7), dimensions)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = qmc.Sobol(dimensions, rng=np.random.default_rng(7)).random(count)
    np.testing.assert_array_equal(points, expected)


def test_saltelli_points_are_salibs_own() -> None:
    settings = SampleSettings(method="saltelli", count=16, seed=3)
    cube = {"num_vars": 3, "names": ["a", "b", "c"], "bounds": [[0, 1]] * 3}
    expected = sobol.sample(cube, 16, calc_second_order=False, seed=3)
    np.testing.assert_array_equal(unit_points(settings, 3), expected)
    assert settings.points(3) == 16 * 5 == len(expected)


@given(st.floats(0, 1), st.floats(1e-6, 1e6), st.floats(1e-6, 1e6), st.sampled_from([1.0, -1.0]))
def test_a_log_range_is_even_in_the_logarithm(share: float, first: float, last: float, sign: float) -> None:
    value = Span(sign * first, sign * last, "log").at(share)
    expected = sign * first * (last / first) ** share
    # twelve digits are kept: half of the last one is 5e-12 of a number that begins with 1
    assert value == pytest.approx(expected, rel=5e-12 + 1e-11 * abs(math.log(last / first)))
    assert min(first, last) <= abs(float(value)) <= max(first, last)


def test_ranges_by_literals() -> None:
    """Ends as they are written, in either order; 0.3 between them, and not 0.30000000000000004."""
    assert [Span(0.1, 0.5).at(share) for share in (0.0, 0.5, 1.0)] == [0.1, 0.3, 0.5]
    assert [Span(0.5, 0.1).at(share) for share in (0.0, 0.25, 1.0)] == [0.5, 0.4, 0.1]
    assert [Span(-0.01, -1.0, "log").at(share) for share in (0.0, 0.5, 1.0)] == [-0.01, -0.1, -1.0]
    assert Span(1 / 3, 2 / 3).at(0.0) == 1 / 3
    assert Span(1 / 3, 2 / 3).at(1.0) == 2 / 3
    assert [Choices((1, 2, 3)).at(share) for share in (0.0, 0.33, 0.34, 0.66, 0.67, 1.0)] == [1, 1, 2, 2, 3, 3]


@given(st.integers(-40, 40), st.integers(-40, 40), st.sampled_from(["linear", "log"]))
def test_whole_numbers_all_get_a_share(first: int, last: int, scale: Any) -> None:
    if first == last or (scale == "log" and first * last <= 0):
        return
    span = Span(first, last, scale, whole=True)
    values = [span.at(share) for share in np.linspace(0, 1, 2001)]
    step = 1 if last > first else -1
    assert list(dict.fromkeys(values)) == list(range(first, last + step, step))
    assert span.size == abs(last - first) + 1
    assert all(type(value) is int for value in values)
    if scale == "linear":
        counts = np.unique(values, return_counts=True)[1]
        assert counts.max() - counts.min() <= 2  # two borders of the shares, each may fall on a grid point
    elif 0 < first < last:
        # 1 gets [0.5, 1.5] in the logarithm, and so on
        at_first = math.log((first + 0.5) / (first - 0.5)) / math.log((last + 0.5) / (first - 0.5))
        assert values.count(first) / 2001 == pytest.approx(at_first, abs=2e-3)


def test_whole_gains_and_lists_are_sampled_as_declared() -> None:
    found = block(
        **CONTINUOUS | {"gains": CONTINUOUS["gains"] | {"on": [True, False], "convention": ["as_printed"]}},  # type: ignore[operator]
        sample={"method": "sobol", "count": 64, "seed": 1},
    ).designs()
    assert {type(gains(d)["N"]) for d in found} == {int}
    assert sum(gains(d)["on"] for d in found) == 32  # a Sobol sequence is balanced
    assert {gains(d)["convention"] for d in found} == {"as_printed"}
    # N declares a log scale: half of the points are below the geometric mean of 0.5 and 50.5
    assert sum(gains(d)["N"] <= 5 for d in found) == pytest.approx(32, abs=2)


def test_a_sample_depends_on_what_is_written_only() -> None:
    sample = {"method": "sobol", "count": 16}
    content = {"name": "a", "seed": 1, "design": [{"law": "toy", "sample": sample} | CONTINUOUS]}
    first = Study.from_dict(content).designs
    assert Study.from_dict(content | {"seed": 2, "design": [{"law": "none"}, *content["design"]]}).designs[1:] == first  # type: ignore[misc]
    other = [{"law": "toy", "sample": sample | {"seed": 1}} | CONTINUOUS]
    assert not set(first) & set(Study.from_dict(content | {"design": other}).designs)


def test_a_sampled_design_that_comes_twice_runs_once() -> None:
    """A hundred points of six designs."""
    table = {"law": "toy", "y_s": [0.1, 0.2], "gains": {"N": {"from": 3, "to": 5}}}
    study = Study.from_dict({"name": "a", "design": [table | {"sample": {"method": "sobol", "count": 100}}]})
    assert len(study.design[0].designs()) == 100
    assert {(d.y_s, gains(d)["N"]) for d in study.designs} == set(itertools.product((0.1, 0.2), (3, 4, 5)))
    assert len(study.designs) == 6


def test_a_sample_of_nothing_that_varies_is_one_design() -> None:
    for method in ("sobol", "latin_hypercube", "saltelli"):
        found = block(law=["none", "toy"], y_s=0.1, gains={"N": [3, 4]}, sample={"method": method, "count": 4})
        assert [d.law for d in found.designs()].count("none") == 1
        assert found.size == len(found.designs()) == 1 + (12 if method == "saltelli" else 4)


def test_without_salib_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    sampled = block(**CONTINUOUS, sample={"method": "saltelli", "count": 4})
    monkeypatch.setitem(sys.modules, "SALib.sample", None)
    with pytest.raises(InputError, match=r"'saltelli' needs SALib.*pip install \"ldctoolkit\[sensitivity\]\""):
        sampled.designs()


# ---- size, space, round trip
@pytest.mark.parametrize(
    "parts",
    [
        {"y_s": [0.1, 0.2], "gains": {"N": [3, 4, 5]}},
        CONTINUOUS | {"sample": {"method": "sobol", "count": 5, "seed": 9}},
        CONTINUOUS | {"sample": {"method": "saltelli", "count": 8}},
        CONTINUOUS | {"law": ["toy", "boom"], "sample": {"method": "latin_hypercube", "count": 5}},
        {"gains": {"N": [3, 4], "on": [True, False]}, "when": {"N": {"on": [True]}}},
        {"gains": {"K": {"from": -1, "to": -0.1, "scale": "log"}}, "sample": {"method": "sobol", "count": 2}},
    ],
)
def test_content_goes_through_json_and_back(parts: dict[str, Any]) -> None:
    if parts.get("law"):
        parts = parts | {"gains": {"K": [0, 0], "N": {"from": 1, "to": 9}}}
    study = Study.from_dict({"name": "a", "design": [{"law": "toy"} | parts]})
    text = json.dumps(study.content())
    again = Study.from_dict(json.loads(text))
    assert (again, again.designs) == (study, study.designs)
    assert json.dumps(again.content()) == text
    assert len(study.designs) <= study.design[0].size


def test_the_space_of_a_table_is_one_for_each_law() -> None:
    (mpc, lqr) = block(
        law=["linear_mpc", "lqr"],
        y_s={"from": 0.1, "to": 0.3},
        gains={"horizon": {"from": 5, "to": 30}, "r_delta": {"from": 50, "to": 500}, "solver": ["osqp", "daqp"]},
        when={"horizon": {"solver": "osqp"}},
        sample={"method": "sobol", "count": 4},
    ).space()
    assert lqr == LawSpace(controller_class("lqr"), Span(0.1, 0.3), (("r_delta", Span(50.0, 500.0, "log")),))
    assert mpc == LawSpace(
        controller_class("linear_mpc"),
        Span(0.1, 0.3),
        (
            ("horizon", Span(5, 30, "linear", whole=True)),
            ("r_delta", Span(50.0, 500.0, "log")),
            ("solver", Choices(("osqp", "daqp"))),
        ),
        (Condition("horizon", "solver", ("osqp",)),),
    )
    assert mpc.varying == ("y_s", "horizon", "r_delta", "solver")
    assert mpc.size is None


def test_a_range_without_count_needs_a_sample_or_a_search() -> None:
    with pytest.raises(InputError) as caught:
        check_blocks([DesignBlock(law="none"), DesignBlock.model_validate({"law": "toy"} | CONTINUOUS)], searched=False)
    assert caught.value.path == "design[1].y_s.count"
    searched = DesignBlock.model_validate({"law": "toy"} | CONTINUOUS)
    check_blocks([searched], searched=True)
    assert searched.size == 0
    with pytest.raises(InputError, match="y_s: a range without a count makes no grid"):
        searched.designs()
    sampled = DesignBlock.model_validate({"law": "toy", "sample": {"method": "sobol", "count": 2}} | CONTINUOUS)
    check_blocks([sampled], searched=False)
    with pytest.raises(InputError) as caught:
        check_blocks([sampled], searched=True)
    assert caught.value.path == "design[0].sample"


# ---- mistakes

UNCONDITIONAL = "a gain without one"
SAMPLE: Any = {"method": "sobol", "count": 4}
Y_S_ALLOWED = "a finite number >= -10 m, below 0 before the line"
MPC: Any = {"law": "linear_mpc", "gains": {"blocks": [0, 3], "solver": ["osqp", "daqp"], "horizon": [5, 9]}}
SPAN: Any = {"gains": {"N": [3, 4], "K": {"from": -1, "to": 0}}, "sample": SAMPLE}
BOTH: Any = {"law": ["toy", "boom"], "gains": {"K": 0, "on": [True, False]}}

MISTAKES: list[tuple[dict[str, Any], str, Any, str | set[str]]] = [
    ({"law": []}, "law", (), "text, or a list of different laws"),
    ({"law": ["toy", 3]}, "law", ("toy", 3), "text, or a list of different laws"),
    ({"law": ["toy", "toy"]}, "law", ("toy", "toy"), "each law once"),
    ({"law": ["toy", "bom"]}, "law[1]", "bom", {"boom"}),
    ({"law": ["toy", "boom"], "gains": {"M": 3}}, "gains.M", ..., {"K"}),
    ({"law": ["toy", "boom"], "gains": {"K": -0.5}}, "gains.K", -0.5, "a number from 0 to 9"),
    ({"gains": {"K": {"from": -2, "to": -0.5}}, "sample": SAMPLE}, "gains.K", -2, "a number from -1 to 0 rad/rad"),
    ({"gains": {"K": {"from": -0.5, "to": 1}}, "sample": SAMPLE}, "gains.K", 1, "a number from -1 to 0 rad/rad"),
    ({"gains": {"N": {"from": 1.5, "to": 3}}, "sample": SAMPLE}, "gains.N", 1.5, "a whole number from 1 to 50 samples"),
    ({"gains": {"N": {"from": 5.5, "to": 7.5, "count": 3}}}, "gains.N", 5.5, "a whole number from 1 to 50 samples"),
    ({"gains": {"N": {"from": 5, "to": 7.5, "count": 3}}}, "gains.N", 7.5, "a whole number from 1 to 50 samples"),
    ({"gains": {"on": {"from": 0, "to": 1}}, "sample": SAMPLE}, "gains.on", 0, "true or false"),
    ({"gains": {"K": {"from": -1, "to": -1}}, "sample": SAMPLE}, "gains.K", -1, "two different numbers"),
    ({"gains": {"K": {"from": -1, "two": 0}}, "sample": SAMPLE}, "gains.K.two", ..., {"to"}),
    ({"y_s": {"from": -11, "to": 0.2}, "sample": SAMPLE}, "y_s", -11, Y_S_ALLOWED),
    ({"y_s": {"from": 0.1}, "sample": SAMPLE}, "y_s.to", ..., ""),
    ({"y_s": {"from": 0.1, "to": 0.2, "scale": "lin"}}, "y_s.scale", "lin", {"linear"}),
    ({"sample": 3}, "sample", 3, "a table of keys"),
    ({"sample": {"method": "sobl", "count": 4}}, "sample.method", "sobl", {"sobol"}),
    ({"sample": {"method": "sobol"}}, "sample.count", ..., ""),
    ({"sample": {"method": "sobol", "count": 2.0}}, "sample.count", 2.0, "a whole number"),
    ({"sample": {"method": "sobol", "count": 4, "sed": 1}}, "sample.sed", ..., {"seed"}),
    ({"sample": {"method": "saltelli", "count": 100}}, "sample.count", 100, "a power of two, e.g. 64 or 128"),
    ({"when": 3}, "when", 3, "a table of keys"),
    ({**MPC, "when": {"block": {"solver": "osqp"}}}, "when.block", ..., {"blocks"}),
    ({**MPC, "when": {"blocks": "osqp"}}, "when.blocks", "osqp", "a table of other gains and their values"),
    ({**MPC, "when": {"blocks": {}}}, "when.blocks", {}, "a table of other gains and their values"),
    ({**MPC, "when": {"blocks": {"solvr": "osqp"}}}, "when.blocks.solvr", ..., {"solver"}),
    ({**MPC, "when": {"blocks": {"blocks": 3}}}, "when.blocks.blocks", ..., {"horizon"}),
    ({**MPC, "when": {"blocks": {"solver": "osq"}}}, "when.blocks.solver", "osq", {"osqp"}),
    ({**MPC, "when": {"blocks": {"solver": []}}}, "when.blocks.solver", ..., "1 to 10000"),
    (
        {**MPC, "when": {"blocks": {"solver": "osqp"}, "horizon": {"blocks": 3}}},
        "when.horizon.blocks",
        ...,
        UNCONDITIONAL,
    ),
    ({**SPAN, "when": {"N": {"K": -1}}}, "when.N.K", ..., "a gain with a list of values"),
    ({**BOTH, "when": {"K": {"on": True}}}, "when.K.on", ..., "a gain of the same law"),
    ({"gains": {"N": [3, 4], "on": [True, False]}, "when": {"N": {"on": 1}}}, "when.N.on", 1, {"False"}),
]


@pytest.mark.parametrize(("parts", "key", "value", "allowed"), MISTAKES)
def test_a_mistake_is_named_by_key_path_value_and_what_is_allowed(
    parts: dict[str, Any], key: str, value: Any, allowed: str | set[str]
) -> None:
    with pytest.raises(StudyError) as caught:
        Study.from_dict({"name": "a", "design": [{"law": "toy"} | parts]}, source="s.toml")
    assert_fields(caught.value, f"s.toml: design[0].{key}", value, allowed)
    assert not caught.value.hint.endswith("in this study")


@pytest.fixture
def other_law() -> Iterator[None]:
    @dataclasses.dataclass(frozen=True)
    class Other(Controller):
        name = "other"
        title = "Other"

        N: float = gain(5.0, unit="s", lower=1.0, upper=50.0, description="no whole number, even on a linear scale")

        def prepare(self, plant: Plant) -> Any:
            raise NotImplementedError

    register(Other)
    yield
    registry.forget("other")


@pytest.mark.usefixtures("other_law")
def test_a_range_must_be_one_for_all_laws_and_a_list_may_be_shared() -> None:
    for entry in ({"from": 1, "to": 50, "count": 4}, {"from": 1, "to": 50}):
        with pytest.raises(StudyError, match=r"design\[0\]\.gains\.N: 'toy' and 'other' space this range differently"):
            block(law=["toy", "other"], gains={"N": entry}, sample=SAMPLE)
    found = block(law=["toy", "other"], gains={"N": [3, 4.0]}).designs()
    assert [(d.law, gains(d)["N"], type(gains(d)["N"])) for d in found] == [
        *(("toy", 3, int), ("toy", 4, int)),
        *(("other", 3.0, float), ("other", 4.0, float)),
    ]


def test_entries_are_read_as_values_or_as_a_range() -> None:
    assert read_entry(3) == Choices((3,))
    assert read_entry({"from": 3, "to": 1, "count": 3}) == Choices(expand({"from": 3, "to": 1, "count": 3}))
    assert read_entry({"from": -3, "to": -1}, "log", whole=True) == Span(-3, -1, "log", whole=True)
    assert read_entry({"from": -3, "to": 1}, "log").scale == "linear"  # type: ignore[union-attr]
    with pytest.raises(InputError, match="both ends of one sign"):
        read_entry({"from": 0, "to": 1, "scale": "log"})


def test_the_pages_examples_are_read() -> None:
    page = (Path(__file__).parents[3] / "docs/reference/study-file.md").read_text(encoding="utf-8")
    examples = re.findall(r"```toml\n(.*?)```", page.partition("## Design spaces and search")[2], re.DOTALL)
    found = [Study.from_dict({"name": "a"} | tomllib.loads(example)) for example in examples]
    assert [len(study.designs) for study in found if study.search is None] == [10 + 30, 4, 64]
    assert [len(study.design) for study in found if study.search] == [2]


R_DELTA = find_gain(controller_class("lqr"), "r_delta")  # 1e-3 to 1e6, logarithmic
K_Y = find_gain(controller_class("preview_proportional"), "K_y")  # at most 0
HORIZON = find_gain(controller_class("linear_mpc"), "horizon")  # whole


@pytest.mark.parametrize(
    ("values", "of", "below", "above"),
    [
        ([5000.0, 10_000.0, 20_000.0], R_DELTA, 2500.0, 40_000.0),
        ([20_000.0, 5000.0], R_DELTA, 1250.0, 80_000.0),
        ([1000.0, 2000.0, 3000.0], R_DELTA, 500.0, 4000.0),  # a difference, which would make the lower one 0
        ([2000.0, 3000.0, 4000.0], R_DELTA, 1000.0, 5000.0),
        ([1000.0, 2000.0, 3000.0, 6000.0], R_DELTA, 500.0, 12_000.0),  # neither: the last step, as the gain is spaced
        ([0.002, 1.0, 500_000.0], R_DELTA, 0.001, 1e6),  # ends at the limits
        ([0.001, 1e6], R_DELTA, None, None),
        ([0.05, 0.1, 0.15, 0.2, 0.3], Y_S, 0.0, 0.4),
        ([0.0, 0.05, 0.1], Y_S, -0.05, 0.15),
        ([0.05, 0.1, 0.2, 0.4], Y_S, 0.025, 0.8),
        ([-9.9, -9.0], Y_S, -10.0, -8.1),
        ([-0.005, -0.002], K_Y, -0.008, -0.0008),  # a difference would change the sign
        ([5, 10, 15], HORIZON, 2, 20),
        ([4, 6, 8], HORIZON, 2, 10),
    ],
)
def test_the_value_beyond_an_end_goes_on_as_the_list(
    values: list[float], of: Any, below: float | None, above: float | None
) -> None:
    for order in (values, values[::-1]):
        assert (next_value(order, of, upper=False), next_value(order, of, upper=True)) == (below, above)
    assert type(next_value([5, 10, 15], HORIZON, upper=False)) is int
