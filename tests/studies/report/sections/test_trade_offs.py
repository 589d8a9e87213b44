"""Axes of the scatter, its figure without script, and the table of what a release asks for."""

from __future__ import annotations

import dataclasses
from types import ModuleType

import numpy as np
import pytest

from controllers import LQR, NoControl
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.sections import trade_offs
from studies.results import StudyResults


def with_pareto(report: ReportInput, results: StudyResults, figures: list[str]) -> Context:
    rankings = tuple(Ranking.of(results, case, bootstrap=100, pareto=figures) for case in results.cases)
    return Context.of(dataclasses.replace(report, rankings=rankings))


@pytest.mark.parametrize(
    ("figures", "axes"),
    [
        ([], ("S", "a_y_peak_p95")),
        (["S"], ("S", "a_y_peak_p95")),
        (["S", "effort_mean", "needless"], ("S", "effort_mean")),
        (["S", "needless", "effort_mean"], ("S", "effort_mean")),  # needless is the same for all designs of a y_s
        (["jerk_peak_p95", "S"], ("jerk_peak_p95", "S")),
    ],
)
def test_axes_at_first(report: ReportInput, results: StudyResults, figures: list[str], axes: tuple[str, str]) -> None:
    context = with_pareto(report, results, figures)
    assert trade_offs.default_axes(context) == axes
    assert trade_offs.section(context).data == dict(zip("xy", axes, strict=True))


def test_figure_holds_every_design_that_has_both(report: ReportInput) -> None:
    made = trade_offs.section(Context.of(report))
    ranking = report.rankings[0]
    (axes,) = made.drawings[0].figure.axes
    points = {
        (x, y)
        for line in axes.lines
        if line.get_linestyle() == "None"
        for x, y in zip(*(np.asarray(part) for part in line.get_data()), strict=True)
    }
    wanted = zip(ranking.S, ranking.release.a_y_peak_p95, strict=True)
    assert points == {(x, y) for x, y in wanted if np.isfinite(y)}
    assert "Peak a<sub>y</sub>, 95 % quantile over Mean S" in made.body
    assert 'id="limits"' in made.body


def test_many_designs_are_thinned_and_told(report: ReportInput, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trade_offs, "MOST_POINTS", 4)
    made = trade_offs.section(Context.of(report))
    acting = sum(not design.is_baseline for design in report.rankings[0].designs)
    assert f" of {acting} designs (the front, the best of each law and every so many by rank)" in made.body


@pytest.mark.parametrize(("require", "said"), [((), False), (("S <= 100",), True), (("S <= 0",), False)])
def test_the_line_is_told_of_designs_that_meet_the_requirements(
    report: ReportInput, results: StudyResults, require: tuple[str, ...], said: bool
) -> None:
    rankings = tuple(Ranking.of(results, case, bootstrap=100, require=require) for case in results.cases)
    body = trade_offs.section(Context.of(dataclasses.replace(report, rankings=rankings))).body
    caption = body.split("<figcaption>")[1].split("</figcaption>")[0]
    assert ("that meets the requirements" in caption) == said


def test_one_design_is_told_as_one(make: ModuleType) -> None:
    results = make.run([Design.of(LQR(), 0.05)], make.invented_scenarios(5, 5), [make.PRIMARY])
    assert ", 1 design. " in trade_offs.section(Context.of(make.report_input(results))).body


def test_no_intervention_means_no_point(make: ModuleType) -> None:
    designs = [Design.of(LQR(), 5.0), Design.of(NoControl(), 5.0)]
    made = trade_offs.section(
        Context.of(make.report_input(make.run(designs, make.invented_scenarios(5, 5), [make.PRIMARY])))
    )
    assert made.drawings == ()
    assert "No design has both figures" in made.body
    assert 'id="limits"' in made.body
