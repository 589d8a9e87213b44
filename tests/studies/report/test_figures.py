# ruff: noqa: RUF001 - the page shows true minus signs, dashes and Greek letters
"""Figures and what is computed for them, against independent arithmetic."""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET

import matplotlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from controllers import LQR, NoControl
from helpers.examples import examples
from helpers.pages import Page
from studies.design import Design
from studies.report.figures.landscape import color_range, on_the_edge, swept_axes
from studies.report.figures.landscape_figures import Landscape, heat_map
from studies.report.figures.landscape_panels import landscape_panels
from studies.report.figures.scores import Curve, distribution_figure, interleaved, running_mean, sides_figure
from studies.report.look.style import RECORDED, law_styles
from studies.report.look.svg import inline_svg
from studies.report.replay.picks import choose
from studies.report.words.text import compact, number, percent, printable, shorten, signed, symbols, unit_text

RNG = np.random.default_rng(0)
STYLE = law_styles(["a"])["a"]


def labels(figure: Figure) -> set[str]:
    return {axes.get_xlabel() for axes in figure.axes} | {axes.get_ylabel() for axes in figure.axes}


def test_running_mean_is_the_mean_and_its_error() -> None:
    values = 1e6 + RNG.normal(size=700)  # large offset: a difference of sums of squares would lose the variance
    count, mean, error = running_mean(values)
    assert count[-1] == 700
    for k, m, e in zip(count, mean, error, strict=True):
        assert m == pytest.approx(values[:k].mean(), rel=1e-13)
        assert e == pytest.approx(1.96 * values[:k].std(ddof=1) / np.sqrt(k), rel=1e-6)


@given(st.integers(0, 40), st.integers(0, 40))
def test_interleaving_is_a_permutation_with_even_shares(left: int, right: int) -> None:
    side = np.repeat([1, -1], [left, right])
    order = interleaved(side)
    assert sorted(order) == list(range(left + right))
    if left and right:
        seen = np.cumsum(side[order] == 1)
        expected = np.arange(1, left + right + 1) * left / (left + right)
        assert np.abs(seen - expected).max() <= 1.0
    for value in (1, -1):  # each side keeps its own order
        assert np.all(np.diff(order[side[order] == value]) > 0)


def test_bars_have_the_length_of_the_means() -> None:
    S = RNG.lognormal(size=400)
    figure = sides_figure([Curve("none", RECORDED, S), Curve("law", STYLE, 0.5 * S, 0.5)], "Left")
    (axes,) = figure.axes
    assert [bar.get_width() for bar in axes.patches] == [S.mean(), 0.5 * S.mean()]
    (first, second) = axes.collections
    assert first.get_segments()[0][:, 0] == pytest.approx(np.quantile(S, [0.1, 0.9]), rel=1e-14)
    assert second.get_segments()[0][:, 0] == pytest.approx(np.quantile(0.5 * S, [0.1, 0.9]), rel=1e-14)
    assert {text.get_text() for text in axes.texts} == {number(S.mean()), f"{number(0.5 * S.mean())} (−50.0\u00a0%)"}
    assert "Score S [m·s]" in labels(figure)


def grid() -> tuple[Design, ...]:
    combinations = itertools.product((0.05, 0.2, 0.1), (1.0, 10.0), (300.0, 30.0))
    return (Design.of(NoControl(), 0.1), *(Design.of(LQR(q_y=q, r_delta=r), y) for y, q, r in combinations))


def panels_of(designs: tuple[Design, ...], S: np.ndarray, winner: int) -> list[Landscape]:
    shown = landscape_panels(designs, S, winner).shown
    return sorted((one for one in shown if isinstance(one, Landscape)), key=lambda one: one.y.name if one.y else "")


def test_edge_of_the_sweep_is_named() -> None:
    designs = grid()
    lowest = next(i for i, d in enumerate(designs) if d.y_s == 0.05 and dict(d.gains).get("q_y") == 10.0)
    assert on_the_edge(designs, lowest)[:2] == ("y_s (lowest tried)", "q_y (highest tried)")
    three = tuple(Design.of(LQR(), y) for y in (0.1, 0.2, 0.3))
    assert on_the_edge(three, 1) == ()
    assert swept_axes(three[:1]) == ()


def test_heat_map_marks_what_is_worse_than_no_control() -> None:
    designs = grid()
    S = np.linspace(1.0, 2.0, len(designs))
    panels = panels_of(designs, S, 1)
    low, high = color_range(panels, 1.6)
    assert high <= 1.6 < S.max()
    figure = heat_map(panels[0], low, high, 1.6)
    axes = figure.axes[0]
    grey = [p for p in axes.patches if matplotlib.colors.to_hex(p.get_facecolor()) == "#d4d4d4" and p.get_fill()]
    assert len(grey) == int((panels[0].S > 1.6).sum()) > 0
    shown = {text.get_text().removeprefix("★\n") for text in axes.texts}
    assert shown == {number(v) for v in panels[0].S.ravel()}
    assert {"y_s [m]", "q_y [1/m²]", "Mean S [m·s]"} <= labels(figure)


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30))
def test_examples_are_the_least_median_and_greatest(values: list[float]) -> None:
    reduction = np.array(values)
    rows = [row for row, _ in choose(reduction, np.arange(reduction.size))]
    assert len(rows) == len(set(rows)) == min(3, len({*rows}))
    assert reduction[rows].min() == reduction.min()
    assert reduction[rows].max() == reduction.max()
    assert np.quantile(reduction, 0.5, method="inverted_cdf") in reduction[rows]


def test_styles_differ_even_without_colour() -> None:
    styles = law_styles([f"law{i}" for i in range(12)])
    assert len({(s.color, s.dash) for s in styles.values()}) == 12
    assert len({s.dash for s in list(styles.values())[:5]}) == 5
    assert law_styles(["none"])["none"] is RECORDED


def test_svg_is_self_contained_and_prefixed() -> None:
    figure = distribution_figure([Curve("K_psi & <b> $x$", RECORDED, RNG.lognormal(size=50))], "y_s, K_psi: tests")
    text = str(inline_svg(figure, "p7", "A & B"))
    again = str(inline_svg(figure, "p7", "A & B"))
    assert text == again
    assert "http" not in text
    root = ET.fromstring(text)
    identifiers = [e.attrib["id"] for e in root.iter() if "id" in e.attrib]
    assert len(identifiers) == len(set(identifiers))
    assert all(name.startswith("p7-") for name in identifiers)
    spoken = ["".join(e.itertext()).replace("\u200b", "") for e in root.iter("text")]
    assert "ys, Kψ: tests" in spoken
    assert "Kψ & <b> $x$" in spoken
    assert root.find("title").text == "A & B"  # type: ignore[union-attr]


def test_figures_leave_the_settings_of_matplotlib_alone() -> None:
    before = dict(matplotlib.rcParams)
    inline_svg(sides_figure([Curve("x", RECORDED, np.ones(3))], "t"), "p", "t")
    assert dict(matplotlib.rcParams) == before


@examples(200)
@given(st.text(max_size=40))
def test_symbols_never_let_markup_through(text: str) -> None:
    page = Page(str(symbols(text)))
    assert set(page.counts) <= {"sub"}
    if "_" not in text:
        assert page.text[""] == printable(text)


def test_numbers_as_text() -> None:
    assert [number(-0.0004), number(float("inf")), number(-2.5, 1)] == ["0.000", "∞", "−2.5"]
    assert [signed(0.25), signed(-0.25), signed(0.0), signed(0.0001)] == ["+0.250", "−0.250", "0.000", "0.000"]
    assert percent(-0.0001) == "0.0\u00a0%"
    assert [compact(-3), compact("a-b"), compact(False), compact(1e-6)] == ["−3", "a-b", "false", "1e−06"]
    assert [unit_text("1"), unit_text("rad/m"), unit_text("s^2/rad^2"), unit_text("kg m^2")] == [
        "", "rad/m", "s²/rad²", "kg·m²"]  # fmt: skip
    assert str(symbols("q_psi_rate, delta_max, rate_max")) == "q<sub>ψ, rate</sub>, δ<sub>max</sub>, rate_max"
    assert shorten("abc", 3) == "abc"
