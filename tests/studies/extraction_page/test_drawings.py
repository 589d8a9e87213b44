"""Drawings of the page, read back from their coordinates: histograms, departures and their fits, ticks."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.extractions import make_extraction
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.recordings.drawn import KEPT
from studies.extraction_page import event_plots
from studies.extraction_page.panels import MOST_BINS, Shares, histogram, shared_edges, width_shares
from studies.extraction_page.svg_plot import PARAMETERS, Axis

NUMBER = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"


def paths(svg: str, kind: str) -> list[str]:
    return re.findall(rf'<path class="{kind}" d="([^"]*)"', svg)


def ticks_of(svg: str) -> list[tuple[float, float, float]]:
    """x, y and number of each tick label."""
    found = re.findall(rf'<text x="({NUMBER})" y="({NUMBER})" text-anchor="\w+">([^<]*)</text>', svg)
    return [(float(x), float(y), float(words.replace("\N{MINUS SIGN}", "-"))) for x, y, words in found]


def scale(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """Slope and origin of value over place, from the first and the last tick."""
    (a, low), (b, high) = pairs[0], pairs[-1]
    slope = (high - low) / (b - a)
    return slope, low - slope * a


def test_a_histogram_shows_the_shares() -> None:
    rng = np.random.default_rng(0)
    left, right = rng.gamma(2.0, 1.0, 400), rng.gamma(3.0, 1.0, 50)
    edges = shared_edges(np.concatenate([left, right]), 0.1)
    svg = histogram(PARAMETERS[0], {"left": Shares.of(left, edges), "right": Shares.of(right, edges)}, "x")
    ticks = ticks_of(svg)
    across = scale([(x, v) for x, y, v in ticks if y == max(y for _, y, _ in ticks)])
    down = scale([(y - 4.0, v) for x, y, v in ticks if x == min(x for x, _, _ in ticks)])
    assert across[0] > 0 > down[0]  # to the right and upwards
    for kind, values in (("left", left), ("right", right)):
        (d,) = paths(svg, f"steps {kind}")
        corners = [(float(y), float(x)) for y, x in re.findall(rf"V({NUMBER})H({NUMBER})", d)]
        assert len(corners) == edges.size - 1
        before = float(re.match(rf"M({NUMBER})", d)[1])  # type: ignore[index]
        for y, x in corners:
            low, high = across[0] * before + across[1], across[0] * x + across[1]
            inside = [v for v in values.tolist() if low + 0.02 < v < high - 0.02]
            near = [v for v in values.tolist() if low - 0.02 < v < high + 0.02]
            share = down[0] * y + down[1]
            assert 100 * len(inside) / values.size - 0.2 <= share <= 100 * len(near) / values.size + 0.2
            before = x


def test_a_departure_and_its_fit_stand_where_their_axes_say() -> None:
    event = make_extraction(1, (20, 0), seed=4).drawn.deepest[0]
    svg = event_plots.event_panel(event).svg
    T, d_y, v_mean, a_mean = (float(event.parameters[i]) for i in (0, 1, 3, 4))
    ticks = ticks_of(svg)
    lowest = max(y for _, y, _ in ticks)
    across = scale([(x, v) for x, y, v in ticks if y == lowest])
    down = [
        scale([(y - 4.0, v) for x, y, v in ticks if y != lowest and low < y < high])
        for low, high in ((20.0, 140.0), (150.0, 225.0), (240.0, 312.0))
    ]
    assert across[0] > 0 > max(slope for slope, _ in down)
    dots = paths(svg, "dots left")
    for d, (slope, zero), signal, factor in zip(dots, down, (event.y, event.v, event.c), (1, 1, 1000), strict=True):
        points = re.findall(rf"M({NUMBER}) ({NUMBER})h0", d)
        rows = np.linspace(0, event.t.size - 1, len(points)).round().astype(int)
        for (x, y), row in zip(points, rows, strict=True):
            assert across[0] * float(x) + across[1] == pytest.approx(event.t[row], abs=2e-3 * T + 0.02)
            assert slope * float(y) + zero == pytest.approx(factor * signal[row], abs=abs(slope) * 0.6)
    parabola, speed, _ = paths(svg, "fit")
    heights = [down[0][0] * float(y) + down[0][1] for y in re.findall(rf" ({NUMBER})", parabola)]
    assert max(heights) == pytest.approx(d_y, abs=abs(down[0][0]) * 0.6 + 0.003 * d_y)
    assert heights[0] == pytest.approx(0.0, abs=abs(down[0][0]) * 0.6)
    assert heights[-1] == pytest.approx(0.0, abs=abs(down[0][0]) * 0.6)
    ends = [down[1][0] * float(y) + down[1][1] for y in re.findall(rf" ({NUMBER})", speed)]
    assert ends == pytest.approx([v_mean - a_mean * T / 2, v_mean + a_mean * T / 2], abs=abs(down[1][0]) * 0.6)


def test_the_deepest_of_all_sources() -> None:
    extraction = make_extraction(3, (20, 20))
    found = event_plots.deepest_of_all(extraction.drawn.deepest)
    assert [one.side for one in found] == ["left", "right"]
    for one, side in zip(found, (LEFT, RIGHT), strict=True):
        depths = extraction.departures.d_y[extraction.departures.side == side]
        deepest = sorted(depths.tolist(), reverse=True)[:KEPT]
        assert [panel.values.split(",")[0] for panel in one.panels] == [f"d_y = {value:.2f} m" for value in deepest]
        assert {panel.side for panel in one.panels} == {one.side}


def test_a_side_without_departures_has_no_heading() -> None:
    drawn = make_extraction(2, (3, 0)).drawn
    (found, _) = event_plots.by_source(drawn.deepest, drawn.by_lot, ["D1", "D2"])
    assert [one.side for one in (*found.deepest, *found.by_lot)] == ["left", "left"]
    assert [one.side for one in event_plots.by_lot_of_all(drawn.by_lot)] == ["left"]


@given(st.floats(-1e9, 1e9), st.floats(1e-6, 1e9), st.integers(2, 40))
def test_ticks_are_round_even_and_inside(low: float, width: float, most: int) -> None:
    axis = Axis.around(np.array([low, low + width]), least=1e-3, margin=0.0)
    ticks = axis.ticks(most)
    assert len(ticks) <= most + 1
    slack = 1e-6 * (axis.high - axis.low) + 1e-9 * abs(low)
    assert all(axis.low - slack <= tick <= axis.high + slack for tick in ticks)
    step = axis.step(most)
    assert np.allclose(np.diff(ticks), step, rtol=1e-6, atol=1e-9 * abs(low))
    assert float(f"{step:.0e}"[0]) in (1, 2, 5)
    if abs(low) + width < 9e4:
        assert len({axis.label(tick, most) for tick in ticks}) == len(ticks)


@given(st.lists(st.floats(-1e9, 1e9) | st.just(float("nan")) | st.just(0.3), max_size=60), st.sampled_from([0.01, 0.1]))
def test_bins_hold_all_values_of_a_few(values: list[float], least: float) -> None:
    given_values = np.array(values, dtype=np.float64)
    edges = shared_edges(given_values, least)
    assert 2 <= edges.size <= MOST_BINS + 3
    assert (np.diff(edges) > 0).all()
    shares = Shares.of(given_values, edges)
    assert shares.n == sum(value == value for value in values)
    assert shares.beyond <= 1e-9


def test_what_is_never_negative_has_no_axis_below_zero() -> None:
    assert shared_edges(np.full(9, 0.01), 0.1)[0] == 0.0
    assert shared_edges(np.array([-0.01, 0.01]), 0.1)[0] < 0.0


def test_bins_of_many_leave_out_the_ends_and_say_so() -> None:
    values = np.concatenate([np.linspace(0.0, 10.0, 9990), np.full(10, 1e6)])
    edges = shared_edges(values, 0.1)
    assert edges[-1] <= 10.5
    assert Shares.of(values, edges).beyond == pytest.approx(1e-3)


@given(st.lists(st.tuples(st.integers(0, 79), st.integers(1, 10**9)), max_size=5))
def test_lane_widths_of_any_account(cells: list[tuple[int, int]]) -> None:
    count = np.zeros(80, dtype=np.int64)
    for place, number in cells:
        count[place] += number
    (one,) = width_shares([count])
    assert one.edges.size == one.share.size + 1 >= 2
    assert one.n == count.sum()
    if one.n:
        assert 0.98 <= one.share.sum() <= 1.0 + 1e-9
        middle = one.median / 0.1
        most = (0.5 + 2e-6) * one.n  # as much as the margins below may hold
        assert count[: int(np.floor(middle + 1e-6))].sum() <= most
        assert count[int(np.ceil(middle - 1e-6)) :].sum() <= most
