"""Tables of the section that read without script: which designs, their tags, bars and requirements."""

from __future__ import annotations

import dataclasses
import re
from types import ModuleType

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
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


def test_all_designs_of_a_small_study_are_listed(report: ReportInput) -> None:
    body = section(Context.of(report)).body
    for k, ranking in enumerate(report.rankings):
        found = rows(body, k)
        assert len(found) == len(ranking)
        for row, S in zip(found, ranking.S, strict=True):
            assert f"<b>{number(S)}</b>" in row
    assert "ranking-more" not in body


def test_bars_have_the_interval_and_end_at_the_panels_edge(report: ReportInput) -> None:
    ranking = report.rankings[0]
    assert designs_data(Context.of(report))["full"] == 1.2
    full = 1.2 * ranking.S_uncorrected[0]
    for row, *ends in zip(
        rows(section(Context.of(report)).body), ranking.S, ranking.S_low, ranking.S_high, strict=True
    ):
        found = [float(one) for one in re.findall(r"--[wlh]:([\d.]+)%", row)]
        assert found == pytest.approx([min(100 * end / full, 100.0) for end in ends], abs=0.051)


def test_many_designs_show_the_first_and_the_tagged(make: ModuleType) -> None:
    designs = [Design.of(NoControl(), 0.2), Design.of(PreviewProportional(), 0.2)]
    designs += [Design.of(LQR(r_delta=r), 0.05) for r in np.geomspace(10.0, 1e5, 130)]
    report = make.report_input(make.run(designs, make.invented_scenarios(5, 4), [make.PRIMARY]))
    context = Context.of(report)
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
    body = section(context).body
    assert f"{len(listed)} of 132; <code>ranking.csv</code> holds all." in body
    assert len(rows(body)) == len(listed)


def test_requirements_met_and_missed(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(
        results, results.cases[0], bootstrap=100, require=["S <= 0.6", "triggered <= 2e-1", "a_y_peak_p95 <= 5"]
    )
    alone = dataclasses.replace(results, cases=results.cases[:1])
    body = section(Context.of(dataclasses.replace(make.report_input(alone), rankings=(ranking,)))).body
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


@pytest.mark.parametrize("case", ["one", "baseline", "idle", "left", "one scenario", "failures"])
def test_unusual_studies(make: ModuleType, with_failures: StudyResults, case: str) -> None:
    none, lqr = Design.of(NoControl(), 0.2), Design.of(LQR(), 0.05)
    designs = {"one": [lqr], "baseline": [none], "idle": [Design.of(LQR(), 5.0), none]}.get(case, [lqr, none])
    sides = {"left": (9, 0), "one scenario": (1, 0)}.get(case, (6, 6))
    results = (
        with_failures if case == "failures" else make.run(designs, make.invented_scenarios(*sides), [make.PRIMARY])
    )
    report = make.report_input(results)
    made = section(Context.of(report))
    found = rows(made.body)
    assert len(found) == len(results.designs)
    assert made.data is not None
    assert made.data["count"] == len(results.designs)
    assert "nan" not in re.sub(r"<[^>]*>", " ", made.body).lower().split()
    if case == "failures":
        assert all("bad" in row for row in found)
