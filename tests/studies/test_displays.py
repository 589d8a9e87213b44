"""What notebooks show of rankings, results, comparisons and outcomes: right numbers, escaped, no script."""

import dataclasses
import html
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers import LQR, NoControl
from helpers.pages import Page
from ldctoolkit import EventStatus, Scenarios, simulate
from studies import Ranking, Study, StudyResults, compare, rank_study, run_study

EVIL = "<script>alert(1)</script>"
STUDY: dict[str, Any] = {
    "name": "shown",
    "seed": 3,
    "scenarios": {"left": 30, "right": 20},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": [round(0.05 + 0.01 * i, 2) for i in range(24)]}],
}


def rows_of(text: str) -> list[list[str]]:
    """Cells of all rows; refuses anything that is not plain, closed HTML."""
    page = Page(text)
    assert set(page.counts) <= {"div", "b", "br", "table", "thead", "tbody", "tr", "th", "td", "span"}
    assert set(re.findall(r' ([a-z-]+)="', text)) <= {"style", "title", "scope"}
    return [row for table in page.filled() for row in table]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_study(Study.from_dict(STUDY), directory=tmp_path_factory.mktemp("display") / "s", workers=1)


@pytest.fixture(scope="module")
def ranking(results: StudyResults) -> Ranking:
    return rank_study(results, Study.from_dict(STUDY))[0]


def test_ranking(ranking: Ranking) -> None:
    text = ranking._repr_html_()
    _, *rows = rows_of(text)
    assert len(rows) == 21  # and no control, which is the last
    for row, i in zip(rows, [*range(20), 24], strict=True):
        assert (row[0], row[1]) == (str(ranking.rank[i]), "LQR" if i < 20 else "No control")
        assert float(row[2]) == ranking.designs[i].y_s
        S, low, high = map(float, row[4].replace("..", " ").split())
        assert pytest.approx(ranking.S[i], abs=6e-4) == S
        assert (low, high) == pytest.approx((ranking.S_low[i], ranking.S_high[i]), abs=6e-3)
        assert row[5] == f"{100 * ranking.reduction[i]:.1f}".replace("-", "\u2212")
    assert "and 4 more" in text
    assert "winner" in rows[0][-1]
    assert "baseline" in rows[-1][-1]


def test_numbers_have_true_minus_signs_and_do_not_break(ranking: Ranking) -> None:
    worse = dataclasses.replace(ranking, reduction=-1.0 - ranking.reduction)
    text = worse._repr_html_()
    _, *rows = rows_of(text)
    assert rows[0][5].startswith("\u22121")
    assert not any(re.search(r"-\d", cell) for row in rows for cell in row)
    cells = re.findall(r'<td style="([^"]*)">', text)
    assert all("white-space:nowrap" in style for style in cells[4::10])


def test_text_of_users_is_text(ranking: Ranking) -> None:
    text = dataclasses.replace(ranking, warnings=(EVIL,))._repr_html_()
    assert EVIL not in text
    assert html.escape(EVIL) in text


def test_nothing_ranked_and_one_design(results: StudyResults) -> None:
    none = Ranking.of(results, results.cases[0], bootstrap=50, require=["S <= 0"])
    assert "None meets the requirements." in none._repr_html_()
    assert {row[0] for row in rows_of(none._repr_html_())[1:]} == {"–"}  # noqa: RUF001


def test_results(results: StudyResults) -> None:
    lines = {row[0]: row[1] for row in rows_of(results._repr_html_())}
    assert (lines["designs"], lines["scenarios"]) == ("25: none (1), lqr (24)", "50 (30 left, 20 right)")
    assert lines["cases"] == results.cases[0].case.label


@pytest.mark.slow
def test_comparison(results: StudyResults, tmp_path: Path) -> None:
    content = STUDY | {"design": STUDY["design"][:1], "vehicle": {"m": 1200.0}}
    for name, parts in (("a", {"vehicle": {}}), ("b", {})):
        run_study(Study.from_dict(content | parts), directory=tmp_path / name, workers=1)
    found = dataclasses.replace(compare(tmp_path / "a", tmp_path / "b"), new_name=EVIL)
    text = found._repr_html_()
    assert EVIL not in text
    assert html.escape(found.summary) in text
    row = rows_of(text)[1]
    assert row[0] == str(found.cases[0].S.verdict[0])
    assert float(row[2]) == pytest.approx(found.cases[0].S.S_old[0], abs=6e-5)
    assert float(row[4].replace("\u2212", "-")) == pytest.approx(found.cases[0].S.difference[0], rel=1e-3)
    assert "-" not in "".join(row[2:])
    assert text.count("white-space:nowrap") == 5 * (len(rows_of(text)) - 1)


def test_outcome() -> None:
    scenarios = Scenarios.from_arrays(
        T=[3.0, 2.0, 2.0, 2.0], d_y=[0.6, 0.4, 0.02, 0.3], v_mean=25.0, side=[1, -1, -1, 1]
    )
    scenarios = dataclasses.replace(scenarios, v_mean=np.array([25.0, 25.0, 25.0, 95.0]))
    outcome = simulate(LQR(r_delta=100.0), scenarios, y_s=0.1)
    lines = {row[0]: row[1] for row in rows_of(outcome._repr_html_())}
    driven = outcome.status != EventStatus.INVALID
    S, S_0 = np.mean(outcome.S[driven]), np.mean(outcome.S_uncorrected[driven])
    assert lines["mean S with control"] == f"{S:.4f} m s, {100 * (S / S_0 - 1):+.1f} %".replace("-", "\u2212")
    assert lines["mean S without control, left (1)"] == f"{outcome.S_uncorrected[0]:.4f} m s"
    assert lines["mean S with control, right (2)"].startswith(f"{np.mean(outcome.S[1:3]):.4f} m s")
    assert lines["deepest beyond the line"] == f"{np.max(outcome.deepest[driven]):.3f} m (no. 0)"
    counts = {"taken over and driven to the end": "2", "never triggered": "1", "cannot be driven": "1", "failures": "0"}
    assert counts.items() <= lines.items()


def test_an_outcome_without_scenarios_to_speak_of() -> None:
    bad = dataclasses.replace(Scenarios.from_arrays(T=[2.0], d_y=0.3, v_mean=25.0), v_mean=np.array([95.0]))
    lines = {row[0]: row[1] for row in rows_of(simulate(NoControl(), bad)._repr_html_())}
    assert lines == {"cannot be driven": "1", "failures": "0"}


def test_showing_a_ranking_loads_no_templates_and_no_plots() -> None:
    code = (
        "import sys, studies.ranking.ranking, studies.comparison.comparison\n"
        "print(*sorted({'jinja2', 'matplotlib', 'polars'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
