# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The report as a reader's browser parses it: the verdict first, complete, correct, escaped, the same each time."""

import csv
import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from helpers.browser_pages import HOSTILE, ORDINARY, Made
from helpers.pages import EVIL, Page
from helpers.results import SECTIONS, grid, invented_scenarios, only, page_of, report_input, run, said_in, scored
from ldctoolkit import EventStatus, PlantOptions, Setup
from ldctoolkit.controllers import LQR, NoControl, PreviewProportional
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import METRICS
from ldctoolkit.plant_options import Driver
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.pages import (
    confidence_section,
    landscape_section,
    ranking_section,
    robustness_section,
    verdict_section,
)
from ldctoolkit.studies.pages.context import Context, ReportInput
from ldctoolkit.studies.pages.report import report_page, settings_section, write_report
from ldctoolkit.studies.results import FailedDesign, StudyResults
from ldctoolkit.studies.robustness import RobustnessTask, work_out

LIMITS = ("stable", "comfort", "physical")


def lights(page: Page) -> dict[str, str]:
    """State of each light by its name, as a screen reader has it."""
    items = re.findall(
        r'<li class="(\w+)"><span class="light \w+" role="img" aria-label="([^"]+)">.*?<b>([^<]+)</b>', page.html
    )
    return {name: state for state, _, name in items}


# ------------------------------------------------------------------------------------------------ the verdict


def test_the_verdict_stands_first(page: Page, report: ReportInput) -> None:
    words = page.words("verdict")
    assert words.startswith("Verdict Smallest S")
    assert list(lights(page)) == ["Score", "Stable", "Limits", "Other plants"]
    assert page.html.index('id="verdict"') < page.html.index('id="ranking"')
    S = report.ranking.metrics.S[0]
    assert f"Mean S {S:.3f} m·s" in words
    assert "how well the model represents traffic" in words or "not for other traffic" in words


def test_none_meets_the_limits_is_the_first_answer(results: StudyResults) -> None:
    """What a study of the ideal plant must say, and not the name of a winner."""
    page = page_of(report_input(results, require=["comfort"]))
    acting = sum(not design.is_baseline for design in results.designs)
    words = page.words("verdict")
    assert words.startswith(f"Verdict None of {acting} designs meets the limits Nearest: ")
    assert "limit 5.00 m/s³" in words
    assert "What to try:" in words
    assert lights(page)["Limits"] == "bad"
    (table,) = page.headed("Rank", "Law", "Verdict")
    assert not any("winner" in row[-1] for row in table)


def test_an_unstable_design_has_a_red_light(results: StudyResults) -> None:
    status = results.status.copy()
    best = int(results.S.mean(axis=1).argmin())
    status[best, :2] = EventStatus.DIVERGED
    changed = dataclasses.replace(results, status=status)
    page = page_of(report_input(changed))
    assert lights(page)["Stable"] == "bad"
    words = page.words("verdict")
    assert "It diverges in 2 of 100 departures." in words
    assert "Smallest S, but not usable" in words


def test_acceleration_beyond_friction_is_named(results: StudyResults) -> None:
    peak = results.metrics.a_y_peak.copy()
    best = int(results.S.mean(axis=1).argmin())
    peak[best, 0] = 85.0
    metrics = dataclasses.replace(results.metrics, a_y_peak=peak)
    changed = dataclasses.replace(results, metrics=metrics)
    page = page_of(report_input(changed))
    assert "85 m/s² (8.7 g) is physically impossible" in page.words("verdict")
    assert lights(page)["Limits"] == "bad"


def test_the_best_that_meets_the_limits_is_filled_and_ringed(results: StudyResults) -> None:
    report = report_input(results, require=["a_y_added_peak_p95 <= 8"])
    page = page_of(report)
    ranking = report.ranking
    assert ranking.ranked not in (0, len(ranking))
    assert page.words("verdict").startswith("Verdict Best design that meets the limits: ")
    chart = page.html[page.html.index('<figure><svg class="chart"') :].split("</svg>")[0]
    acting = [i for i, design in enumerate(ranking.designs) if not design.is_baseline]
    assert len(re.findall(r'class="mark c\d open"', chart)) == sum(bool(ranking.missed[i]) for i in acting)
    assert len(re.findall(r'class="mark c\d"', chart)) == sum(not ranking.missed[i] for i in acting)
    assert chart.count('class="ring"') == 1
    assert chart.count('class="shade"') == 1


def test_a_large_increase_is_a_multiple() -> None:
    """S rises twelvefold, and not by 1059.1 % of its S."""
    S = np.random.default_rng(0).gamma(2.0, 0.3, 40)
    words = page_of(report_input(scored([11.59 * S], S, [Design.of(LQR(r_delta=100.0), 0.1)]))).words("verdict")
    assert "11.6 times that without control" in words
    assert "%" not in words.split("times that")[1].split(";")[0]


def test_warnings_come_once(results: StudyResults) -> None:
    report = report_input(results)
    words = page_of(report).words("verdict")
    assert words.count("Speed looks like km/h.") == 1
    assert words.count("fitted to invented driving") == 1


def test_the_head_counts_what_is_left_out(results: StudyResults) -> None:
    """Designs that failed, and departures that cannot be driven."""
    status, S, S_0 = results.status.copy(), results.S.copy(), results.S_uncorrected.copy()
    status[:, :3], S[:, :3], S_0[:, :3] = EventStatus.INVALID, np.nan, np.nan
    failed = FailedDesign(Design.of(LQR(r_delta=77.0), 0.1), "ValueError: no")
    page = page_of(report_input(dataclasses.replace(results, status=status, S=S, S_uncorrected=S_0, failed=(failed,))))
    assert f"{len(results.designs) + 1} designs" in page.words()
    assert "100 departures" in page.words()
    assert "97 study scenarios (57 left, 40 right), 3 more cannot be driven" in page.words("verdict")


# ------------------------------------------------------------------------------------------------ numbers


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Made:
    root = tmp_path_factory.mktemp("pages")
    return Made(root)


def test_each_number_is_that_of_ranking_csv(built: Made) -> None:
    study = built("ordinary")
    page, rows = Page(study.path.read_text(encoding="utf-8")), study.rows()
    (table,) = page.headed("Rank", "Law", "Verdict")
    head, *cells = table
    assert len(cells) == len(rows)
    columns = {
        "Mean S [m·s]": ("S_m_s", 1.0, 3), "Reduction [%]": ("reduction", 100.0, 1),
        "ay p95 [m/s²]": ("a_y_added_peak_p95_m_s2", 1.0, 2), "Jerk p95 [m/s³]": ("jerk_added_peak_p95_m_s3", 1.0, 2),
        "Needless [%]": ("needless_share", 100.0, 1), "Fresh S [m·s]": ("fresh_S_m_s", 1.0, 3),
    }  # fmt: skip
    for row, given in zip(cells, rows, strict=True):
        assert row[0] == (given["rank"] or "–")
        for title, (column, factor, digits) in columns.items():
            shown = row[head.index(title)]
            expected = f"{factor * float(given[column]):.{digits}f}".replace("-", "−") if given[column] else "–"
            assert shown == expected.replace("−0.0", "0.0"), (title, given["design"])
        low, high = (f"{float(given[f'S_{end}_m_s']):.3f}" for end in ("low", "high"))
        assert row[5] == f"{low} to {high}"
        assert bool(given["unmet"]) == ("breaks" in row[-1])
        assert ("winner" in row[-1]) == (given["winner"] == "true")


def test_the_same_number_is_the_same_text_everywhere(page: Page, report: ReportInput) -> None:
    """4.25 was 4.2 in one place and 4.3 in another."""
    ranking = report.ranking
    value = float(ranking.metrics.beside["a_y_added_peak_p95"][0])
    text = f"{value:.2f}"
    assert text in page.words("verdict")
    assert text in page.words("limits")
    (table,) = page.headed("Rank", "Law", "Verdict")
    assert text in table[1]


def test_limits_say_how_many_designs_meet_them(results: StudyResults) -> None:
    report = report_input(results, require=["comfort", "S <= 0.6"])
    ranking = report.ranking
    rows = {row[0]: row for row in page_of(report).captioned("Limits")[1:]}
    met = int((ranking.metrics.S <= 0.6).sum())
    assert rows["Mean S"][1:3] == ["≤ 0.6 m·s", "own"]
    assert rows["Mean S"][5] == str(met)
    assert rows["Peak added jerk, 95 % quantile"][1:3] == ["≤ 5 m/s³", "comfort"]
    assert rows["Departures that diverged though friction allows their recorded path"][2] == "stable (not required)"
    assert rows["Peak ay, largest"][1] == "≤ 9.81 m/s²"


def test_all_metrics_are_there(report: ReportInput) -> None:
    table = page_of(report).captioned("All metrics")
    titles = [row[0] for row in table[1:]]
    assert {"Mean S", "Both limits of ISO 11270 kept", "Gain margin, least over speed"} <= set(titles)
    assert len(titles) > 40
    i = report.ranking.winner
    row = table[
        1
        + titles.index(
            "Steering effort, mean [°²·s]" if "Steering effort, mean [°²·s]" in titles else "Steering effort, mean"
        )
    ]
    rate = table[1 + titles.index("Steering rate, largest")]
    assert i is not None
    assert rate[1] == f"{57.29577951308232 * report.ranking.metrics.beside['delta_rate_peak_max'][i]:.1f} °/s"
    assert row[1] == f"{METRICS['effort_mean'].scale * report.ranking.metrics.beside['effort_mean'][i]:.3f} °²·s"


# ------------------------------------------------------------------------------------------------ sections


def test_what_is_printed(page: Page) -> None:
    """The first screen, the ranking and the limits; the rest says so by its class."""
    printed = [name for name in SECTIONS if f'<section id="{name}" class="screen"' not in page.html]
    assert printed == ["verdict", "ranking", "limits", "trade-offs", "confidence"]


def test_the_printed_rows_are_the_first_twenty_and_the_baseline(built: Made) -> None:
    html = built("thousand").path.read_text(encoding="utf-8")
    body = html[html.index('<table id="designs"') :].split("</table>")[0]
    rows = re.findall(r"<tr(?: class=\"([^\"]*)\")?><td", body)
    near = [kinds for kinds in rows if "far" not in kinds.split()]
    assert len(rows) >= 1000
    assert sum("baseline" in kinds for kinds in near) == 1
    assert 20 <= len(near) <= 22


def test_the_front_has_one_number(page: Page, report: ReportInput) -> None:
    """11 designs in one place and 52 in another."""
    words = page.words("trade-offs")
    count = int(report.ranking.pareto.sum())
    if report.ranking.pareto_metrics:
        assert f"{count} design" in words
    assert "front of these two metrics alone" in words


def test_trade_offs_list_the_front(results: StudyResults) -> None:
    from ldctoolkit.studies.ranking.ranking import Ranking

    ranking = Ranking.of(results, bootstrap=200, pareto=["S", "effort_mean"])
    report = dataclasses.replace(report_input(results), ranking=ranking)
    words = said_in(verdict_section.trade_offs, report)
    count = int(ranking.pareto.sum())
    assert f"Pareto front over Mean S; Steering effort, mean: {count} designs" in words


def test_the_landscape_has_the_least_S_of_each_cell(report: ReportInput) -> None:
    landscape = landscape_section.section(Context.of(report))
    ranking = report.ranking
    (chart,) = [chart for chart in landscape.charts if chart.name == "landscape-lqr"]
    shown = {float(text) for text in re.findall(r"<title>([\d.]+)</title>", chart.body)}
    least_S = [
        float(f"{S:.3f}") for S, design in zip(ranking.metrics.S, ranking.designs, strict=True) if design.law == "lqr"
    ]
    assert shown == set(least_S)
    assert min(least_S) in shown


def test_a_law_without_a_sweep_has_no_landscape() -> None:
    words = said_in(landscape_section.section, only(Design.of(LQR(r_delta=100.0), 0.1), Design.of(NoControl(), 0.1)))
    assert "there is no landscape to show" in words


def test_confidence_tells_the_second_and_what_intervals_leave_out(report: ReportInput) -> None:
    words = said_in(confidence_section.section, report)
    ranking = report.ranking
    assert f"{ranking.inference.difference[1]:+.4f} m·s from rank 1" in words
    assert ("do not separate the two" in words) == bool(ranking.inference.set_of_best[1])


def test_two_equal_designs_are_not_separated() -> None:
    S = np.random.default_rng(0).gamma(2.0, 0.3, 40)
    noise = 0.05 * np.random.default_rng(1).normal(size=40)
    designs = [Design.of(LQR(r_delta=100.0), 0.1), Design.of(LQR(r_delta=100.0), 0.2)]
    given = report_input(scored([S, S + noise], 2 * S, designs))
    words = said_in(confidence_section.section, given)
    assert "the scenarios do not separate the two" in words
    match = re.search(r"about ([\d,]+) scenarios separate the two with a probability of 50 %", words)
    ranking = given.ranking
    half = 0.5 * (ranking.inference.difference_high[1] - ranking.inference.difference_low[1])
    assert match is not None
    # an interval is as wide as the root of one over the number of scenarios
    assert float(match[1].replace(",", "")) == pytest.approx(
        40 * (half / ranking.inference.difference[1]) ** 2, rel=0.06
    )


def test_without_robustness_the_page_says_how_to_get_it(report: ReportInput) -> None:
    assert "leave --no-robustness out" in said_in(robustness_section.section, report)


def test_a_report_without_a_driver_says_so_and_has_no_section(page: Page) -> None:
    assert "driver" not in page.ids
    assert "Nobody holds the wheel in this study" in page.words("robustness")
    assert "docs/explanation/driver.md" in page.words("robustness")


def test_without_robustness_the_light_of_the_driver_is_not_known(results: StudyResults) -> None:
    page = page_of(report_input(results, setup=Setup(options=PlantOptions(driver=Driver(straight=1.0)))))
    assert lights(page)["Driver"] == "unknown"
    assert "leave --no-robustness out" in page.words("driver")
    assert "Nobody holds the wheel" not in page.words("robustness")


def test_the_section_with_a_driver_has_every_design_with_every_driver(results: StudyResults) -> None:
    """Three laws; the numbers of the table are those of the file that the light is from."""
    driver = Driver(straight=0.5, recorded=0.2, against=0.3, grip=(0.3, 0.3))
    setup = Setup(options=PlantOptions(driver=driver))
    designs = [Design.of(LQR(r_delta=100.0), 0.05), Design.of(PreviewProportional(), 0.05), Design.of(NoControl(), 0.2)]
    report = report_input(run(designs, invented_scenarios(60, 40), options=setup.options), setup=setup)
    found = work_out(RobustnessTask.of(report.results, report.ranking, setup, per_side=10))
    page = page_of(dataclasses.replace(report, robustness=found))
    assert list(lights(page)) == ["Score", "Stable", "Limits", "Other plants", "Driver"]
    words = page.words("driver")
    assert "The study’s drivers: 20 % recorded, 50 % straight, 30 % against." in words
    assert "on 20 of the study scenarios" in words
    head, *rows = page.captioned("Kinds of drivers, 95 % intervals; against: the departure is wanted, torque counts")
    assert head[:4] == ["Driver", "Law", "Place", "Mean S [m·s]"]
    kinds = ["all together", "nobody", "recorded (20 %)", "straight (50 %)", "follows", "against (30 %)", "returns"]
    assert [row[0] for row in rows] == [kind for kind in kinds for _ in range(2)]
    laws = [row[1] for row in rows[:2]]
    assert sorted(laws) == ["LQR", "Preview P"]
    for (first, second), kind in zip(zip(rows[::2], rows[1::2], strict=True), kinds, strict=True):
        p = found.drivers[kind.split(" (")[0]] if kind != "all together" else 0
        assert [first[3], second[3]] == [f"{S:.3f}" for S in found.S[p, :2]]
        assert (first[4], first[6]) == (f"{found.S_ends[0, p, 0]:.3f} to {found.S_ends[1, p, 0]:.3f}", "")
        assert second[5].replace("−", "-") == f"{found.S[p, 1] - found.S[p, 0]:+.3f}"
        low, high = found.difference_ends[:, p, 1]
        assert second[6].replace("−", "-") == f"{low:+.3f} to {high:+.3f}"
        places = ["1", "2"] if found.S[p, 0] < found.S[p, 1] else ["2", "1"]
        assert [first[2], second[2]] == (["", ""] if "against" in kind else places)
        felt = found.felt[:, p, 1] * [1.0, 1.0, 1.0, 100.0]
        shown = (
            ["–"] * 4 if kind == "nobody" else [f"{felt[0]:.2f}", f"{felt[1]:.2f}", f"{felt[2]:.2f}", f"{felt[3]:.0f}"]
        )
        assert second[7:] == shown
    kept = [k for k in range(2) if len({rows[2 * kinds.index(kind) + k][2] for kind in kinds[:1] + kinds[2:4]}) == 1]
    stay = ", ".join(f"{laws[k]} ({rows[k][2]})" for k in kept) or "none"
    assert f"Laws that keep their place with recorded and straight: {stay}." in words
    # the other plants are not mixed with drivers
    others = [row[0] for row in page.captioned("Mean S on other plants")]
    assert not [name for name in others if name.startswith("Driver")]
    assert f"on {len(others) - 2} other plants, 20 of the study scenarios each" in page.words("robustness")


def test_failed_designs_are_listed(results: StudyResults) -> None:
    failed = FailedDesign(Design.of(LQR(r_delta=77.0), 0.1), f"ValueError: {EVIL}")
    words = said_in(settings_section, report_input(dataclasses.replace(results, failed=(failed,))))
    assert "1 design failed and is not ranked:" in words
    assert "r_δ=77" in words or "rδ=77" in words


# ------------------------------------------------------------------------------------------------ odd studies


ODD = {
    "one design": lambda: only(Design.of(PreviewProportional(), 0.2)),
    "only no control": lambda: only(Design.of(NoControl(), 0.2)),
    "nothing triggered": lambda: only(Design.of(PreviewProportional(), 5.0), Design.of(LQR(r_delta=100.0), 6.0)),
    "left only": lambda: only(*grid()[:6], scenarios=invented_scenarios(14, 0)),
    "right only": lambda: only(*grid()[:6], scenarios=invented_scenarios(0, 14)),
    "one scenario": lambda: only(*grid()[:4], scenarios=invented_scenarios(1, 0)),
    "nothing ranked": lambda: report_input(run(grid()[:6], invented_scenarios(12, 9)), require=["S <= 0"]),
    "every limit": lambda: report_input(run(grid()[:6], invented_scenarios(12, 9)), require=list(LIMITS)),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_studies_have_a_whole_page(name: str) -> None:
    page = page_of(ODD[name]())
    assert list(lights(page)) == ["Score", "Stable", "Limits", "Other plants"]


def test_all_departures_failed(with_failures: StudyResults) -> None:
    page = page_of(report_input(with_failures))
    assert lights(page)["Stable"] == "bad"
    assert "diverged in 50 departures" in page.words("settings")


def test_users_text_stays_text(built: Made) -> None:
    assert HOSTILE
    assert ORDINARY
    page = Page(built("hostile").path.read_text(encoding="utf-8"))
    assert "<script>alert(1)" not in page.html
    assert page.counts["script"] == 2
    assert "alert(1)" in page.all_words
    assert "\u202e" not in page.html


def test_a_thousand_designs_are_light(built: Made) -> None:
    study = built("thousand")
    page = Page(study.path.read_text(encoding="utf-8"))
    (table,) = page.headed("Rank", "Law", "Verdict")
    assert len(table) - 1 >= 1000
    assert study.path.stat().st_size < 3_000_000


def test_the_same_input_gives_the_same_page(report: ReportInput) -> None:
    first, second = (report_page(report) for _ in range(2))
    assert first[0] == second[0]
    assert [chart.document for chart in first[1]] == [chart.document for chart in second[1]]


def test_nothing_to_report_on_is_refused(results: StudyResults, report: ReportInput) -> None:
    with pytest.raises(InputError, match="no designs or no scenarios"):
        report_page(dataclasses.replace(report, results=dataclasses.replace(results, designs=())))


def test_files_of_charts_stand_alone(report: ReportInput, tmp_path: Path) -> None:
    from xml.etree import ElementTree

    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "old.svg").write_text("<svg/>")
    write_report(report, tmp_path / "report.html", figures=tmp_path / "figures")
    files = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert {"trade-off.svg", "intervals.svg", "landscape-lqr.svg"} <= set(files)
    assert "old.svg" not in files
    for path in (tmp_path / "figures").iterdir():
        root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
        assert root.tag == "{http://www.w3.org/2000/svg}svg"


def test_no_word_of_an_earlier_page(page: Page) -> None:
    for never in (" told", " said ", "nobody", "minds", "where designs were chosen", "companions", "figure of merit"):
        assert never not in page.all_words


def test_a_skip_link_leads_to_the_content(page: Page) -> None:
    assert page.links[0] == "#main"


def test_a_legend_has_no_entry_without_a_point(report: ReportInput) -> None:
    legend = verdict_section.cloud_legend(Context.of(report))
    chart = verdict_section.trade_off(Context.of(report), "a_y_added_peak_p95", "x")
    drawn = set(re.findall(r'class="mark (c\d|recorded)', chart.body))
    assert set(re.findall(r'class="mark (c\d|recorded)', str(legend))) == drawn


def test_rows_beyond_a_thousand_are_in_the_csv_only(report: ReportInput, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ranking_section, "MOST_ROWS", 5)
    words = said_in(ranking_section.section, report)
    assert f"of {len(report.ranking)} designs; all of them are in ranking.csv" in words


def test_csv_of_the_ordinary_study_has_margins(built: Made) -> None:
    with (built("ordinary").folder / "ranking.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        assert bool(row["gain_margin"]) == (row["law"] in ("lqr", "preview_proportional"))
