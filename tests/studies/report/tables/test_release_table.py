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
        overshoot_max=np.full(len(ranking.designs), most),
        overshoot_share=np.full(len(ranking.designs), 0.5),
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


def test_known_numbers_are_shown_in_the_units_of_their_lines(report: ReportInput) -> None:
    context = Context.of(report)
    ranking, table = context.ranking, context.primary
    known = {
        "within_dtle": 0.98765, "dtle_p5": -0.2345, "dtle_min": -0.4567, "needless": 0.0642, "overshoot_share": 0.01,
        "overshoot_max": 0.1234, "back_inside": 0.9, "t_back_median": 1.2345, "a_y_peak_mean": 1.0, "a_y_peak_p95": 2.0,
        "a_y_peak_max": 3.0, "jerk_peak_mean": 4.0, "jerk_peak_p95": 5.0, "jerk_peak_max": 6.0, "comfortable": 0.75,
        "delta_peak_max": 0.05, "delta_rate_peak_max": 0.5, "effort_mean": 0.001,
    }  # fmt: skip
    d = len(ranking.designs)
    release = dataclasses.replace(ranking.release, **{name: np.full(d, value) for name, value in known.items()})
    made = limits_table(report, table, dataclasses.replace(ranking, release=release, deeper=np.full(d, 0.0642)))
    shown = {str(line.name): (line.cells[0], line.limit) for group in made.groups for line in group.lines[:4]}
    assert {name: cell for name, cell in shown.items() if not name.startswith("Departures")} == {
        "DTLE stays above \u22120.3\u00a0m": ("98.8\u00a0%", "Euro NCAP LSS, EU 2021/646"),
        "DTLE, 5\u00a0% quantile [m]": ("\u22120.23", ""),
        "DTLE at its worst [m]": ("\u22120.46", ""),
        "Deeper than D<sub>y</sub> = 0.5\u00a0m": ("6.4\u00a0%", ""),
        "Back inside at some time": ("90.0\u00a0%", ""),
        "Back inside after, median [s]": ("1.23", ""),
        "Opposite line crossed": ("1.0\u00a0%", ""),
        "Opposite line crossed by at most [m]": ("0.12", ""),
        "Both limits kept": ("75.0\u00a0%", "ISO 11270"),
        "Peak lateral acceleration [m/s²]": ("1.0 / 2.0 / 3.0", "limit 3"),
        "Peak lateral jerk [m/s³]": ("4.0 / 5.0 / 6.0", "limit 5"),
        "Largest angle [°]": ("2.9", ""),
        "Largest rate [°/s]": ("28.6", ""),
        "Mean effort ∫δ² dt [°²·s]": ("3.28", ""),
        "Needless: without control not deeper than 0.5\u00a0m": ("6.4\u00a0%", ""),
    }
