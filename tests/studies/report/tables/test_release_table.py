"""The table of what a release asks for: coming back inside is told apart from staying there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from studies.report import ReportInput
from studies.report.context import Context
from studies.report.tables.release_table import against_limits, limits_table


@pytest.mark.parametrize(("most", "far"), [(3.59, False), (14.35, True)])
def test_more_than_a_lane_beyond_the_other_line_is_marked(report: ReportInput, most: float, far: bool) -> None:
    context = Context.of(report)
    ranking, table = context.ranking, context.primary
    release = dataclasses.replace(
        ranking.release,
        opposite_crossing_max=np.full(len(ranking.designs), most),
        opposite_crossed_share=np.full(len(ranking.designs), 0.5),
    )
    ranking = dataclasses.replace(ranking, release=release)
    (group,) = (one for one in limits_table(report, table, ranking).groups if one.title == "Back to the lane")
    (line,) = (one for one in group.lines if "by at most" in one.name)
    for cell in line.cells[:-1]:
        assert ('class="bad"' in cell) == ("more than the lane\u2019s width" in cell) == far
        assert f"{most:.2f}" in cell
    assert line.cells[-1] == "\u2013"  # no control
    said = " ".join(against_limits(report, table, ranking))
    assert "the edge comes back inside at some time" in said
    assert ("more than the lane\u2019s width" in said) == far
