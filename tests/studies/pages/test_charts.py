"""Charts: axes with round numbers, points where the numbers are, nothing beyond the frame."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.pages import charts
from studies.pages.charts import (
    Axis,
    Cloud,
    Dot,
    Series,
    Style,
    bars,
    dots,
    ecdf,
    heat_map,
    law_styles,
    lines,
    nice_step,
    scatter,
)
from studies.pages.shell import Cell, Column, TableRow, details, packed, script_json, table
from studies.pages.text import number, symbols

BLUE = Style(0, "", "o")


def points(body: str) -> list[tuple[float, float]]:
    """Centres of round markers."""
    return [(float(x) + 3.6, float(y)) for x, y in re.findall(r'class="mark c0" d="M([\d.-]+) ([\d.-]+)a', body)]


def test_round_steps() -> None:
    assert nice_step(1.0, 5) == pytest.approx(0.2)
    assert nice_step(43.0, 4) == 20.0
    assert nice_step(0.013, 5) == pytest.approx(0.005)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_lie_inside_and_are_round(low: float, span: float) -> None:
    axis = Axis("", low, low + span)
    if not axis.low < axis.high:
        return
    for value, text in axis.ticks(300.0):
        assert low - 1e-6 * span <= value <= low + span * (1 + 1e-6)
        assert len(text) < 16


def test_an_axis_around_nothing_is_an_axis() -> None:
    axis = Axis.around("x", np.array([np.nan]))
    assert axis.low < axis.high
    assert Axis.around("x", [2.0, 2.0]).low < 2.0 < Axis.around("x", [2.0, 2.0]).high
    assert Axis.around("x", [1.0, 5.0], zero=True).low == 0.0


def test_log_axes_have_tens() -> None:
    axis = Axis.around("n", [2.0, 5000.0], log=True)
    assert [text for _, text in axis.ticks(300.0)] == ["10", "100", "1000"]
    assert axis.at([axis.low, axis.high]).tolist() == [0.0, 1.0]


def test_points_are_where_the_numbers_are() -> None:
    x, y = np.array([0.0, 5.0, 10.0]), np.array([1.0, 3.0, 2.0])
    cloud = Cloud(x, y, BLUE, np.array([True, True, True]), ("a", "b", "c"))
    found = points(scatter("s", "title", [cloud], Axis("x", 0.0, 10.0), Axis("y", 0.0, 4.0)).body)
    assert [a for a, _ in found] == pytest.approx([58.0, 234.0, 410.0], abs=0.1)
    assert found[0][1] > found[2][1] > found[1][1]


def test_a_missing_number_is_no_point() -> None:
    cloud = Cloud(np.array([1.0, np.nan]), np.array([1.0, 2.0]), BLUE, np.array([True, True]), ("a", "b"))
    assert len(points(scatter("s", "t", [cloud], Axis("x", 0, 2), Axis("y", 0, 2)).body)) == 1


def test_curves_bands_limits_and_rings() -> None:
    x = np.linspace(0.0, 1.0, 5)
    one = Series("a <b>", x, x, BLUE, low=x - 0.1, high=x + 0.1, points=True)
    body = lines(
        "l", "t", [one], Axis("x", 0, 1), Axis("y", 0, 1), limit=(0.5, "limit"), level=0.3, ring=(1.0, 1.0)
    ).body
    assert body.count('class="band c0"') == 1
    assert "a &lt;b&gt;" in body
    assert body.count('class="limit"') == body.count('class="ring"') == 1


def test_a_distribution_rises_to_one() -> None:
    body = ecdf("e", "t", [("a", np.array([1.0, 2.0, 3.0]), BLUE)], Axis("x", 0, 4), "share").body
    path = re.search(r'class="curve c0" d="([^"]+)"', body)
    assert path is not None
    heights = [float(one) for one in re.findall(r"V([\d.]+)", path[1])]
    assert heights == sorted(heights, reverse=True)
    assert heights[-1] == pytest.approx(10.0)  # the top of the frame


def test_intervals_without_ends_have_none() -> None:
    rows = [[Dot("a", 1.0, 0.5, 1.5, BLUE)], [Dot("b", 1.0, np.nan, np.nan, BLUE, open=True)]]
    body = dots("d", "t", rows, Axis("x", 0, 2), at=1.0, at_text="here").body
    assert body.count('class="curve c0"') == 1
    assert body.count('class="mark c0 open"') == 1


def test_bars_and_outlines() -> None:
    edges = np.array([0.0, 1.0, 2.0])
    body = bars(
        "b", "t", edges, [("a", np.array([1.0, 2.0]), BLUE)], "x", "y", outlines=[("m", np.array([2.0, 1.0]), BLUE)]
    ).body
    assert body.count('class="bar c0"') == 1
    assert body.count('class="curve c0"') == 1


def test_a_heat_map_shows_its_numbers_and_leaves_gaps() -> None:
    values = np.array([[1.0, 2.0], [np.nan, 3.0]])
    body = heat_map("h", "t", values, [["1", "2"], ["", "3"]], ("x", ["a", "b"]), ("y", ["c", "d"]), ring=(0, 0)).body
    assert body.count("<rect") == 4  # three cells and the frame around one
    assert "<title>3</title>" in body


def test_law_styles_differ() -> None:
    styles = law_styles(["none", *(f"law{i}" for i in range(12))])
    assert styles["none"] is charts.RECORDED
    assert len(set(styles.values())) == 13


def test_tables_escape_and_sort_by_numbers() -> None:
    columns = [Column("A", text=True), Column("S", "m", key="S")]
    rows = [TableRow(("<b>", Cell("0.5", 0.5, bad=True)), "winner", later=True)]
    made = str(table("c", columns, rows, id="t", sortable=True))
    assert "&lt;b&gt;" in made
    assert '<tr class="winner later">' in made
    assert 'data-v="0.5"' in made
    assert 'data-key="S"' in made
    assert "data-sortable" in made


def test_data_cannot_end_a_script() -> None:
    assert "</" not in script_json({"a": "</script>"})
    assert packed([1, 2, 3], "u1") == {"type": "u1", "data": "AQID"}


def test_text_of_numbers_and_symbols() -> None:
    assert number(-0.0004, 3) == "0.000"
    assert str(symbols("K_psi <= 0")) == "K<sub>ψ</sub> &lt;= 0"
    assert "<summary>" in details("a", symbols("b"))
