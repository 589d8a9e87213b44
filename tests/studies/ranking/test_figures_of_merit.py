"""Figures of merit by name, and requirements on them."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
import types
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit.errors import InputError, LdcError, UnknownNameError
from studies import rank_study, read_manifest, read_results
from studies.ranking.figures import (
    FIGURES,
    check_figure,
    check_requirement,
    figure,
    figure_values,
    parse_requirement,
)
from studies.ranking.ranking_csv import write_csv
from studies.ranking.release import COLUMNS, ReleaseFigures


def test_every_release_figure_is_a_figure_under_its_column_too() -> None:
    assert {field.name for field in dataclasses.fields(ReleaseFigures)} <= set(FIGURES)
    for name, column in COLUMNS.items():
        assert figure(column) is figure(name)
        assert figure(name).column == column


@pytest.mark.parametrize(
    ("name", "unit", "better"),
    [
        ("S", "m s", "less"),
        ("S_cvar95", "m s", "less"),
        ("S_p95", "m s", "less"),
        ("reduction", "1", "more"),
        ("dtle_p5", "m", "more"),
        ("within_dtle", "share", "more"),
        ("needless", "share", "less"),
        ("deeper", "share", "less"),
        ("triggered", "share", "less"),
        ("overshoot_share", "share", "less"),
        ("back_inside", "share", "more"),
        ("t_back_median", "s", "less"),
        ("a_y_peak_p95", "m/s^2", "less"),
        ("jerk_peak_max", "m/s^3", "less"),
        ("comfortable", "share", "more"),
        ("delta_peak_max", "rad", "less"),
        ("delta_rate_peak_max", "rad/s", "less"),
        ("effort_mean", "rad^2 s", "less"),
        ("travel_mean", "rad", "less"),
        ("law_time", "us", "less"),
        ("crashed", "count", "less"),
    ],
)
def test_units_and_directions(name: str, unit: str, better: str) -> None:
    assert (figure(name).unit, figure(name).better) == (unit, better)


def test_names_of_a_ranking_csv_row_are_all_aliases() -> None:
    assert figure("S_m_s").name == "S"
    assert figure("a_y_peak_p95_m_s2").name == figure("ay_p95").name == "a_y_peak_p95"
    assert figure("dtle_0p3_share").name == figure("within_dtle_share").name == "within_dtle"
    assert figure("deeper_than_D_y_share").name == "deeper"


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=r"figure 'a_y_peak_p96'.*did you mean 'a_y_peak_p95'\?"):
        figure("a_y_peak_p96")
    with pytest.raises(InputError, match="did you mean 'S_left'"):
        check_figure("S_lef")
    assert check_figure("ay_p95") == "a_y_peak_p95"


def test_values_come_from_mappings_objects_and_their_release() -> None:
    release = types.SimpleNamespace(a_y_peak_p95=np.array([2.0, 3.0]))
    ranking = types.SimpleNamespace(S=np.array([0.1, 0.2]), crashed=np.array([0, 4]), release=release)
    assert figure_values("ay_p95", ranking).tolist() == [2.0, 3.0]
    assert figure_values("crashed", ranking).tolist() == [0.0, 4.0]
    assert figure_values("crashed", ranking).dtype == np.float64
    assert figure_values("S", {"S": ranking.S}, release).tolist() == [0.1, 0.2]
    assert figure_values("a_y_peak_p95", {"S": ranking.S}, release).tolist() == [2.0, 3.0]
    with pytest.raises(InputError, match="figure effort_mean: not among these results"):
        figure_values("effort", ranking)


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("ay_p95 <= 3.0", "a_y_peak_p95 <= 3"),
        ("dtle_0p3_share>=0.99", "within_dtle >= 0.99"),
        ("  S<.5 ", "S < 0.5"),
        ("dtle_min > -0.3", "dtle_min > -0.3"),
        ("jerk_peak_max_m_s3 <= 1e2", "jerk_peak_max <= 100"),
        ("crashed <= 0", "crashed <= 0"),
        ("reduction >= -1e-12", "reduction >= -1e-12"),
    ],
)
def test_requirements_are_read(text: str, canonical: str) -> None:
    assert check_requirement(text) == canonical
    assert check_requirement(canonical) == canonical


@pytest.mark.parametrize(
    "text", ["", "S", "S <=", "<= 3", "3 >= S", "S == 3", "S <= 3 m s", "S <= 3, S <= 4", "S =< 3"]
)
def test_what_is_no_requirement_is_named(text: str) -> None:
    with pytest.raises(InputError, match=r"requirement '.*': cannot be read; allowed: a figure"):
        parse_requirement(text)


def test_an_unknown_figure_of_a_requirement_is_named_with_its_text() -> None:
    with pytest.raises(UnknownNameError, match=r"requirement 'ay_p59 <= 3': figure 'ay_p59'.*allowed: S"):
        parse_requirement("ay_p59 <= 3")
    with pytest.raises(InputError, match=r"requirement 'comfortble >= 0.5'.*did you mean 'comfortable'"):
        check_requirement("comfortble >= 0.5")


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("S <= inf", "a finite number"),
        ("S <= nan", "a finite number"),
        ("S <= three", "a finite number"),
        ("within_dtle >= 99", "a share from 0 to 1"),
        ("crashed <= -1", "a number >= 0"),
    ],
)
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
    st.sampled_from(sorted(name for name, one in FIGURES.items() if one.unit not in ("share", "count"))),
    st.sampled_from(["<=", "<", ">=", ">"]),
    st.floats(allow_nan=False, allow_infinity=False),
)
def test_the_text_reads_back_to_the_same(name: str, operator: str, limit: float) -> None:
    one = parse_requirement(f"{name} {operator} {limit!r}")
    assert parse_requirement(one.text) == one
    assert one.limit == limit


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused_as_input(text: str) -> None:
    with contextlib.suppress(LdcError):
        assert parse_requirement(text).text


def test_a_ranking_and_its_table_hold_every_figure(small_run: Path, tmp_path: Path) -> None:
    ranking = rank_study(read_results(small_run), read_manifest(small_run).read_study())[0]
    write_csv([ranking], tmp_path / "ranking.csv")
    header = (tmp_path / "ranking.csv").read_text().partition("\n")[0].split(",")
    for name, one in FIGURES.items():
        assert figure_values(name, ranking).shape == (len(ranking),)
        assert one.column in header


def test_the_page_lists_every_figure_with_unit_and_direction() -> None:
    page = (Path(__file__).parents[3] / "docs/requirements.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| `")]
    named = {name: row for row in rows for name in re.findall(r"`(\w+)`", row[0])}
    assert set(named) == set(FIGURES)
    units = str.maketrans({"²": "^2", "³": "^3", "µ": "u"})
    for name, one in FIGURES.items():
        assert one.unit in named[name][1].translate(units).split(", ")
        assert one.better == named[name][2]
