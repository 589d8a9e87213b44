"""Distributions: shares beyond the limits are those of the ranking's table, each of the right point of the vehicle."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from controllers import LQR
from helpers.reports import PRIMARY, invented_scenarios, report_input, run, said_in
from studies.design import Design
from studies.report.context import Context
from studies.report.figures.limit_figure import (
    LimitCurve,
    axis_ends,
    axle_curves,
    comfort_curves,
    depth_curves,
    limit_figure,
)
from studies.report.inputs import ReportInput
from studies.report.look.style import RECORDED
from studies.report.sections import distributions


def test_shares_beyond_are_those_of_the_ranking(report: ReportInput) -> None:
    context = Context.of(report)
    ranking, case = context.ranking, context.case
    baseline = next(k for k, design in enumerate(ranking.designs) if design.is_baseline)
    places = [baseline, *(row.place for row in context.shown)]
    assert [curve.beyond for curve in depth_curves(context)] == pytest.approx(ranking.deeper[places], abs=1e-12)
    within = ranking.release.within_dtle[places]
    assert [1.0 - curve.beyond for curve in axle_curves(context)] == pytest.approx(within, abs=1e-12)
    a_y, jerk = comfort_curves(context, "a_y_added_peak"), comfort_curves(context, "jerk_added_peak")
    assert len(a_y) == len(jerk) == len(context.shown)
    for row, one, other in zip(context.shown, a_y, jerk, strict=True):
        acted = case.companions.delta_peak[row.index] > 0  # 0 where nobody intervened
        assert one.values.size == acted.sum() > 0
        assert one.values.max() == pytest.approx(ranking.release.a_y_added_peak_max[row.place])
        assert one.beyond == np.mean([peak > 3.0 for peak in case.companions.a_y_added_peak[row.index][acted]])
        assert other.beyond == np.mean([peak > 5.0 for peak in case.companions.jerk_added_peak[row.index][acted]])
        # kept by both limits at once is at most what is kept by one of them
        assert ranking.release.comfortable[row.place] <= 1.0 - max(one.beyond, other.beyond) + 1e-12


def test_depth_is_positive_outwards_at_both_points(report: ReportInput) -> None:
    context = Context.of(report)
    centre, axle = depth_curves(context)[0], axle_curves(context)[0]
    assert centre.values == pytest.approx(context.scenarios.d_y, rel=1e-3)  # the recorded path's peak
    # the front axle is ahead of the centre of gravity and, on the way out, further out
    assert np.all(axle.values >= centre.values - 1e-6)


def test_depth_without_a_design_that_does_nothing_is_the_fitted_one() -> None:
    results = run([Design.of(LQR(), 0.05)], invented_scenarios(8, 8), [PRIMARY])
    context = Context.of(report_input(results))
    first, _ = depth_curves(context)
    assert (first.label, first.values.tolist()) == ("No control", results.scenarios.d_y.tolist())
    assert [curve.label for curve in axle_curves(context)] == ["LQR"]
    assert "that of the fitted path" in said_in(distributions.section, context)


def test_the_limit_stands_in_the_figure_with_the_shares() -> None:
    rng = np.random.default_rng(0)
    values = rng.uniform(0.0, 1.0, 1000)
    figure = limit_figure([LimitCurve("law", RECORDED, values, 0.4)], "Depth", "Depth [m]", 0.6, "0.6 m of a test")
    axes = figure.axes[0]
    curve, limit = axes.lines
    assert np.interp(0.25, *curve.get_data()) == pytest.approx((values < 0.25).mean(), abs=0.01)
    assert limit.get_xdata() == [0.6, 0.6]
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["law: 40.0\u00a0% beyond", "0.6 m of a test"]


@pytest.mark.parametrize("values", [np.full(5, 20.0), np.full(5, 1e-3), np.linspace(-0.2, 0.1, 9)])
def test_the_axis_always_holds_the_limit_and_most_values(values: npt.NDArray[np.float64]) -> None:
    low, high = axis_ends([LimitCurve("law", RECORDED, values, 0.0)], 0.5)
    assert low <= 0.0 < 0.5 < high
    assert low <= np.quantile(values, 0.1)
    assert high >= np.quantile(values, 0.7)
