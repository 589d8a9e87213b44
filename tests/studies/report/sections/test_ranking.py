# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""Tables of the section that read without script: which designs, their tags, bars and requirements."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.reports import page_of, report_input, scored, section_of
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.embedded.designs import designs_data
from studies.report.sections.ranking import listed_rows, section
from studies.report.words.text import number
from studies.results import StudyResults


def rows(body: str, table: int = 0) -> list[str]:
    """Rows of the table's body, as they stand."""
    part = body.split('<table class="ranking">')[table + 1].split("<tbody>")[1].split("</tbody>")[0]
    return re.findall(r"<tr.*?</tr>", part, re.DOTALL)


def test_each_number_stands_in_its_column() -> None:
    """A design that is 0.6 m s worse than the first and, with 1.2 times S without control, worse than nothing."""
    designs = [Design.of(LQR(), 0.05), Design.of(PreviewProportional(), 0.2)]
    study = scored([[0.9, 1.4, 0.7, 1.8], [1.1, 2.6, 1.3, 2.2]], [1.0, 2.0, 1.0, 2.0], designs)
    given = {
        "S_low": 1.7, "S_high": 1.95, "difference_low": 0.5, "difference_high": 0.8, "triggered": 0.567,
        "deeper": 0.345, "solver_failed": 1, "diverged": 20, "timed_out": 300, "crashed": 4000,
        "beyond_delta_max": 7, "invalid": 50000,
    }  # fmt: skip
    ranking = Ranking.of(study, study.cases[0], bootstrap=50)
    ranking = dataclasses.replace(ranking, **{name: np.full(2, value) for name, value in given.items()})
    page = page_of(dataclasses.replace(report_input(study), rankings=(ranking,)))
    (table,) = page.headed("Rank", "Gains")
    assert table[2] == [
        "2", "Preview P Table Ipreview_proportional", "0.2", "defaults", "1.800 [1.700 to 1.950]",
        "+20.0 %", "1.850+23.3 %", "1.750+16.7 %", "+0.600[0.500 to 0.800]", "56.7 %", "34.5 %", "54321",
    ]  # fmt: skip
    assert [table[1][5], *table[1][6:9]] == ["−20.0 %", "1.150−23.3 %", "1.250−16.7 %", "–"]
    (failed,) = page.headed("Crashed [departures]")
    shown = dict(zip(failed[0], failed[2], strict=True))
    assert [shown[name] for name in shown if "[departures]" in name] == ["1", "20", "300", "4000", "50000"]


def test_bars_have_the_interval_and_end_at_the_panels_edge(report: ReportInput) -> None:
    ranking = report.rankings[0]
    assert designs_data(Context.of(report))["full"] == 1.2
    full = 1.2 * ranking.S_uncorrected[0]
    for row, *ends in zip(
        rows(section_of(section, report)[0].body), ranking.S, ranking.S_low, ranking.S_high, strict=True
    ):
        found = [float(one) for one in re.findall(r"--[wlh]:([\d.]+)%", row)]
        assert found == pytest.approx([min(100 * end / full, 100.0) for end in ends], abs=0.051)


def test_many_designs_show_the_first_and_the_tagged() -> None:
    designs = [Design.of(NoControl(), 0.2), Design.of(PreviewProportional(), 0.2)]
    designs += [Design.of(LQR(r_delta=r), 0.05) for r in np.geomspace(10.0, 1e5, 130)]
    S = np.linspace(1.0, 2.0, 132)[:, None] * [1.0, 1.1, 0.9, 1.05]
    context = Context.of(report_input(scored(S[[131, 130, *range(130)]], [3.0] * 4, designs)))
    listed = listed_rows(context.primary)
    assert [row.place for row in listed[:100]] == list(range(100))
    assert 100 < len(listed) < 132
    assert {row.design.law for row in listed} == {"none", "preview_proportional", "lqr"}
    assert listed == listed_rows(context.primary, most=100)
    assert [row.place for row in listed] == sorted({row.place for row in listed})
    few = listed_rows(context.primary, most=1)
    places = {row.place for row in few}
    assert {context.primary.best.place, context.primary.baseline.place, context.primary.paper_design.place} <= places  # type: ignore[union-attr]
    assert len(few) <= 6
    body = section_of(section, context)[0].body
    assert f"{len(listed)} of 132; <code>ranking.csv</code> holds all." in body
    assert len(rows(body)) == len(listed)


def test_requirements_met_and_missed(results: StudyResults) -> None:
    ranking = Ranking.of(
        results, results.cases[0], bootstrap=100, require=["S <= 0.6", "triggered <= 2e-1", "a_y_peak_p95 <= 5"]
    )
    alone = dataclasses.replace(results, cases=results.cases[:1])
    body = section_of(section, dataclasses.replace(report_input(alone), rankings=(ranking,)))[0].body
    for row, unmet in zip(rows(body), ranking.unmet, strict=True):
        assert ("meets all requirements" in row) == (not unmet)
        missed = re.findall(r'<small class="missed">misses (.*?)</small>', row)
        units = {
            "S <= 0.6": "S &lt;= 0.6 m·s",
            "triggered <= 0.2": "triggered &lt;= 0.2",
            "a_y_peak_p95 <= 5": "a_y_peak_p95 &lt;= 5 m/s²",
        }
        assert missed == ([", ".join(units[text] for text in unmet)] if unmet else [])
    for row, a_y in zip(rows(body), ranking.release.a_y_peak_p95, strict=True):
        assert f">{number(a_y, 2)}<br><small>≤ 5</small></td>" in row
    assert body.count("Peak a<sub>y</sub>, 95 % quantile [m/s²]</th>") == 1
    assert "Filters" not in body  # what only works with script is made by the script
