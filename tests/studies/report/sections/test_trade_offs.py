"""Axes of the scatter, its figure without script, and the table of what a release asks for."""

from __future__ import annotations

import dataclasses

import pytest

from controllers import LQR
from helpers.reports import only, said_in, section_of
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
    assert section_of(trade_offs.section, context)[0].data == dict(zip("xy", axes, strict=True))


def test_the_caption_tells_what_is_drawn(report: ReportInput, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trade_offs, "MOST_POINTS", 4)
    said = said_in(trade_offs.section, report)
    acting = sum(not design.is_baseline for design in report.rankings[0].designs)
    assert f" of {acting} designs (the front, the best of each law and every so many by rank)" in said
    assert "Peak ay, 95 % quantile over Mean S" in said


@pytest.mark.parametrize(("require", "said"), [((), False), (("S <= 100",), True), (("S <= 0",), False)])
def test_the_line_is_told_of_designs_that_meet_the_requirements(
    report: ReportInput, results: StudyResults, require: tuple[str, ...], said: bool
) -> None:
    rankings = tuple(Ranking.of(results, case, bootstrap=100, require=require) for case in results.cases)
    caption = said_in(trade_offs.section, dataclasses.replace(report, rankings=rankings)).partition("How far")[0]
    assert ("that meets the requirements" in caption) == said


def test_one_design_is_told_as_one() -> None:
    assert ", 1 design. " in said_in(trade_offs.section, only(Design.of(LQR(), 0.05)))
