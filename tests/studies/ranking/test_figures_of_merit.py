"""Metrics of a design by name, and requirements on them."""

import contextlib
import math
import re
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit.errors import InputError, LdcError, UnknownNameError
from ldctoolkit.metrics import METRICS
from studies import rank_study, read_manifest, read_results
from studies.ranking.design_metrics import mean_reduction
from studies.ranking.ranking import write_csv
from studies.ranking.requirements import metric, metric_values, parse_requirement

NAN = math.nan


def test_every_metric_answers_to_its_column() -> None:
    for name, one in METRICS.items():
        assert metric(one.column) is metric(name) is one
    assert len({one.column for one in METRICS.values()}) == len(METRICS)


def test_names_of_a_ranking_csv_row_are_all_aliases() -> None:
    assert metric("S_m_s").name == "S"
    assert metric("a_y_peak_p95_m_s2").name == metric("ay_p95").name == "a_y_peak_p95"
    assert metric("ay_added_max").name == "a_y_added_peak_max"
    # what earlier versions called it
    assert metric("overshoot_max").name == metric("overshoot_max_m").name == "opposite_crossing_max"
    assert metric("overshoot_share").name == "opposite_crossed_share"
    assert metric("dtle_0p3_share").name == metric("within_dtle_share").name == "within_dtle"
    assert metric("deeper_than_D_y_share").name == "deeper"


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=r"metric 't_back_medain'.*did you mean 't_back_median'\?"):
        metric("t_back_medain")
    with pytest.raises(UnknownNameError, match="did you mean 'S_left'"):
        metric("S_lef")


def test_values_come_from_mappings_objects_and_their_release() -> None:
    release = types.SimpleNamespace(a_y_peak_p95=np.array([2.0, 3.0]))
    ranking = types.SimpleNamespace(S=np.array([0.1, 0.2]), crashed=np.array([0, 4]), release=release)
    assert metric_values("ay_p95", ranking).tolist() == [2.0, 3.0]
    assert metric_values("crashed", ranking).tolist() == [0.0, 4.0]
    assert metric_values("crashed", ranking).dtype == np.float64
    assert metric_values("S", {"S": ranking.S}, release).tolist() == [0.1, 0.2]
    assert metric_values("a_y_peak_p95", {"S": ranking.S}, release).tolist() == [2.0, 3.0]
    with pytest.raises(InputError, match="metric effort_mean: not among these results"):
        metric_values("effort", ranking)


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("ay_p95 <= 3.0", "a_y_peak_p95 <= 3"), ("dtle_0p3_share>=0.99", "within_dtle >= 0.99"), ("  S<.5 ", "S < 0.5"),
        ("dtle_min > -0.3", "dtle_min > -0.3"), ("jerk_peak_max_m_s3 <= 1e2", "jerk_peak_max <= 100"),
        ("crashed <= 0", "crashed <= 0"), ("reduction >= -1e-12", "reduction >= -1e-12"),
    ],
)  # fmt: skip
def test_requirements_are_read(text: str, canonical: str) -> None:
    assert parse_requirement(text).text == canonical
    assert parse_requirement(canonical).text == canonical


@pytest.mark.parametrize(
    "text", ["", "S", "S <=", "<= 3", "3 >= S", "S == 3", "S <= 3 m s", "S <= 3, S <= 4", "S =< 3"]
)
def test_what_is_no_requirement_is_named(text: str) -> None:
    with pytest.raises(InputError, match=r"requirement '.*': cannot be read; allowed: a set \(stable"):
        parse_requirement(text)


def test_an_unknown_figure_of_a_requirement_is_named_with_its_text() -> None:
    with pytest.raises(UnknownNameError, match=r"requirement 'ay_p59 <= 3': metric 'ay_p59'.*allowed: S"):
        parse_requirement("ay_p59 <= 3")
    with pytest.raises(UnknownNameError, match=r"requirement 'comfortble >= 0.5'.*did you mean 'comfortable'"):
        parse_requirement("comfortble >= 0.5")


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("S <= inf", "a finite number"), ("S <= nan", "a finite number"), ("S <= three", "a finite number"),
        ("within_dtle >= 99", "a share from 0 to 1"), ("crashed <= -1", "a number >= 0"),
    ],
)  # fmt: skip
def test_a_limit_that_makes_no_sense_is_refused(text: str, allowed: str) -> None:
    with pytest.raises(InputError, match=f"the limit is .*; allowed: {allowed}"):
        parse_requirement(text)


def test_a_figure_that_a_design_lacks_meets_nothing() -> None:
    values = [1.0, 2.0, 3.0, math.nan, math.inf, -math.inf]
    for operator, met in {
        "<=": [True, True, False, False, False, True],
        "<": [True, False, False, False, False, True],
        ">=": [False, True, True, False, True, False],
        ">": [False, False, True, False, True, False],
    }.items():
        assert parse_requirement(f"t_back_median {operator} 2").met(values).tolist() == met


@given(
    st.sampled_from(sorted(name for name, one in METRICS.items() if one.unit not in ("share", "count"))),
    st.sampled_from(["<=", "<", ">=", ">"]),
    st.floats(allow_nan=False, allow_infinity=False),
)
def test_the_text_reads_back_to_the_same(name: str, operator: str, limit: float) -> None:
    one = parse_requirement(f"{name} {operator} {limit!r}")
    assert (parse_requirement(one.text), one.limit) == (one, limit)


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused_as_input(text: str) -> None:
    with contextlib.suppress(LdcError):
        assert parse_requirement(text).text


def test_a_ranking_and_its_table_hold_every_figure(small_run: Path, tmp_path: Path) -> None:
    ranking = rank_study(read_results(small_run), read_manifest(small_run).read_study())[0]
    write_csv([ranking], tmp_path / "ranking.csv")
    header = (tmp_path / "ranking.csv").read_text().partition("\n")[0].split(",")
    for name, one in METRICS.items():
        assert metric_values(name, ranking).shape == (len(ranking),)
        assert one.column in header


def test_the_page_lists_every_metric_with_unit_and_direction() -> None:
    """Aggregates need no row of their own: docs/metrics.md holds the metrics that they are taken from."""
    page = (Path(__file__).parents[3] / "docs/requirements.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| `")]
    named = {name: row for row in rows for name in re.findall(r"`(\w+)`", row[0])}
    assert set(named) <= set(METRICS)
    units = str.maketrans({"²": "^2", "³": "^3"})
    for name, row in named.items():
        assert METRICS[name].unit in row[1].translate(units).split(", ")
        assert METRICS[name].better == row[2]
    assert set(named) >= {name for name, one in METRICS.items() if not one.aggregate}


def test_a_time_is_no_metric() -> None:
    with pytest.raises(UnknownNameError, match="requirement 'law_time <= 5': metric 'law_time': no such metric;"):
        parse_requirement("law_time <= 5")


def test_nothing_to_reduce_is_a_reduction_of_nothing() -> None:
    found = mean_reduction(np.array([0.0, 0.2, 0.1, NAN]), np.array([0.0, 0.0, 0.4, NAN]))
    np.testing.assert_array_equal(found, [0.0, 0.0, 0.75, NAN])
