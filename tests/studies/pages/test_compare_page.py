# ruff: noqa: RUF001
"""The page of a comparison, and charts."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ldctoolkit as ldc
from helpers.pages import EVIL, Page, unpacked, whole
from helpers.results import invented_scenarios, only, report_input, section_of
from ldctoolkit import Scenarios
from ldctoolkit.controllers import LQR, NoControl, NonlinearMPC, PreviewProportional
from ldctoolkit.errors import InputError, UnknownNameError
from ldctoolkit.studies import Comparison
from ldctoolkit.studies.comparison.paired import PairedDifferences, SharedScenarios, Verdict, Winners
from ldctoolkit.studies.design import Design, named_designs
from ldctoolkit.studies.pages import charts, explorer
from ldctoolkit.studies.pages.charts import (
    Axis,
    Chart,
    Dot,
    Series,
    Style,
    bars,
    dots,
    ecdf,
    heat_map,
    law_styles,
    nice_step,
)
from ldctoolkit.studies.pages.compare_page import compare_page, write_compare_page
from ldctoolkit.studies.pages.context import Context, ReportInput
from ldctoolkit.studies.pages.replay import explorer_departures, explorer_designs, replay, rows_of_numbers
from ldctoolkit.studies.pages.shell import details, packed, script_json
from ldctoolkit.studies.results import FailedDesign, StudyResults
from ldctoolkit.studies.text import number, symbols

DESIGNS = (Design.of(NoControl(), 0.2), *(Design.of(LQR(), y_s) for y_s in (0.05, 0.1, 0.2)))
S = PairedDifferences(
    S_old=np.array([2.0, 1.0, 0.5, 4.0]),
    S_new=np.array([2.0, 1.25, 0.4, 4.0002]),
    difference=np.array([0.0, 0.25, -0.1, 0.0002]),
    low=np.array([np.nan, 0.2, -0.15, -0.0001]),
    high=np.array([np.nan, 0.3, -0.05, 0.0005]),
    changed=np.array([0, 5, 4, 2]),
    largest=np.array([0.0, 0.75, -0.6, 0.01]),
    largest_at=np.array([0, 2, 1, 4]),
    verdict=(Verdict.SAME, Verdict.WORSE, Verdict.BETTER, Verdict.NOT_SEPARATED),
)
WORSE = Winners(DESIGNS[1], DESIGNS[1], 1.0, 1.25, 0.25, 0.2, 0.3, Verdict.WORSE, 7, fresh=False)
SHARED = SharedScenarios(np.arange(5), np.array([10, 11, 12, 13, 14]), np.array([1, 1, 1, -1, -1]), 3)
COMPARISON = Comparison(
    "out/old", "out/new", "before", "after", ("plant.actuator.lag: 0.0 -> 0.2",), SHARED,
    "departure", "departure window, consistent", DESIGNS, S, (3, 1, 0, 2), (4, 0, 5, 6), WORSE,
    (Design.of(PreviewProportional(), 0.2),), (Design.of(LQR(), 0.3),), (), (), (), 200, 0.95,
)  # fmt: skip
NOTHING = np.zeros(0)
NONE = PairedDifferences(
    NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING.astype(int), NOTHING, NOTHING.astype(int), ()
)


def page_of(**changes: Any) -> Page:
    page = Page(compare_page(dataclasses.replace(COMPARISON, **changes)))
    whole(page)
    return page


@pytest.fixture(scope="module")
def page() -> Page:
    return page_of()


def test_it_opens_with_the_winners(page: Page) -> None:
    words = page.words("verdict")
    assert words.startswith(
        "Verdict LQR, ys=0.05 m is the winner of both studies; on shared study scenarios its mean S rises by "
        "0.2500 m·s."
    )
    assert page.filled("verdict")[0][1] == [
        "7 study scenarios", "1.0000", "1.2500", "+0.2500", "+25.0", "+0.2000 to +0.3000",
        "worse",
    ]  # fmt: skip
    assert "1 better, 1 worse, 1 not separated, 1 the same" in words


def test_a_difference_without_practical_weight_says_so() -> None:
    small = dataclasses.replace(WORSE, difference=0.004, low=0.001, high=0.007)
    page = page_of(winners=small)
    assert "rises by 0.0040 m·s, less than the 0.01 m·s that matter in practice" in page.words("verdict")
    assert page.filled("verdict")[0][1][-1] == "worse, too little to matter"


@pytest.mark.parametrize(("difference", "small"), [(-0.25, False), (-0.004, True), (-0.01, False)])
def test_a_better_winner_has_a_minus_and_its_weight(difference: float, small: bool) -> None:
    better = dataclasses.replace(WORSE, difference=difference, low=1.5 * difference, high=0.5 * difference,
                                 S_new=1.0 + difference, verdict=Verdict.BETTER)  # fmt: skip
    page = page_of(winners=better)
    row = page.filled("verdict")[0][1]
    assert row[4] == f"−{-100.0 * difference:.1f}"
    assert row[-1] == ("better, too little to matter" if small else "better")
    end = ", less than the 0.01 m·s that matter in practice" if small else "."
    assert f"falls by {-difference:.4f} m·s{end}" in page.words("verdict")


@pytest.mark.parametrize(
    ("verdict", "text"),
    [
        (Verdict.BETTER, "is better than the old one, LQR, ys=0.1 m, by 0.2500"),
        (Verdict.NOT_SEPARATED, "is not separated from the old one, LQR, ys=0.1 m"),
        (Verdict.SAME, "is as good as the old one, LQR, ys=0.1 m"),
    ],
)
def test_a_new_winner_on_fresh_scenarios(verdict: Verdict, text: str) -> None:
    given = dataclasses.replace(WORSE, old=DESIGNS[2], verdict=verdict, fresh=True)
    words = page_of(winners=given).words("verdict")
    assert "On shared fresh scenarios the new winner, LQR, ys=0.05 m, " + text in words


def test_one_vocabulary(page: Page) -> None:
    """The page said "cannot be told" and "most worse" of one design."""
    for never in ("cannot be told", "most worse", "told", "said"):
        assert never not in page.all_words


def test_the_table_holds_the_numbers_of_the_comparison(page: Page) -> None:
    (table,) = page.filled("designs")
    assert table[0] == [
        "Verdict", "Design", "Old S [m·s]", "New S [m·s]", "New − old [m·s]", "95 % interval [m·s]",
        "Scenarios changed", "Largest change [m·s]", "Failed, old / new",
    ]  # fmt: skip
    assert table[1:] == [
        ["worse", "LQR, ys=0.05 m", "1.0000", "1.2500", "+0.2500", "+0.2000 to "
            "+0.3000", "5", "+0.7500 (no. 12)", "1 / 0"],
        ["better", "LQR, ys=0.1 m", "0.5000", "0.4000", "−0.1000", "−0.1500 to "
            "−0.0500", "4", "−0.6000 (no. 11)", "0 / 5"],
        ["not separated", "LQR, ys=0.2 m", "4.0000", "4.0002", "+2.0e−04", "−1.0e−04 to "
            "+5.0e−04", "2", "+0.0100 (no. 14)",
         "2 / 6"],
        ["the same", "No control, ys=0.2 m", "2.0000", "2.0000", "0", "too few departures changed", "0", "–", "3 / 4"],
    ]  # fmt: skip


def test_no_button_shows_all_where_all_are_shown(page: Page) -> None:
    assert "Show all" not in page.all_words
    many = tuple(DESIGNS[1 + i % 3] for i in range(30))
    wide = {
        field.name: np.resize(getattr(S, field.name), 30) for field in dataclasses.fields(S) if field.name != "verdict"
    }
    given = page_of(
        designs=many,
        S=PairedDifferences(**wide, verdict=S.verdict[1:] * 10),
        failed_old=(0,) * 30,
        failed_new=(0,) * 30,
    )
    assert "Show all 30" in given.all_words


def test_differences_and_designs_of_one_study(page: Page) -> None:
    assert "plant.actuator.lag: 0.0 → 0.2" in page.words("differences")
    assert "Only in the old study: 1 design" in page.words("only")
    assert "Preview P" in page.words("only")
    assert "what differs below is in the code of a law" in page_of(differences=()).words("differences")


def test_failures_are_named() -> None:
    failed = FailedDesign(DESIGNS[1], f"ValueError: {EVIL}")
    page = page_of(new_failures=(failed,), warnings=(EVIL,))
    assert "1 design that ran before fails now." in page.words("verdict")
    assert "Fails now, ran before" in page.words("only")
    assert "<script>alert(1)" not in page.html


def test_no_design_in_both_and_no_winner() -> None:
    page = page_of(designs=(), S=NONE, failed_old=(), failed_new=(), winners=None)
    assert "No design is in both studies" in page.words("verdict")
    assert "there is no winner to compare" in page.words("verdict")


def test_charts_hold_the_changes(page: Page) -> None:
    assert any("differences of mean S" in image for image in page.images)
    assert any("old against new" in image for image in page.images)


def test_the_same_bytes(tmp_path: Path) -> None:
    first = write_compare_page(COMPARISON, tmp_path / "a.html").read_bytes()
    assert first == write_compare_page(COMPARISON, tmp_path / "b.html").read_bytes()


BLUE = Style(0, "", "o")


def points(body: str) -> list[tuple[float, float]]:
    """Centres of round markers."""
    return [(float(x) + 3.6, float(y)) for x, y in re.findall(r'class="mark c0" d="M([\d.-]+) ([\d.-]+)a', body)]


def test_round_steps() -> None:
    assert nice_step(1.0, 5) == pytest.approx(0.2)
    assert nice_step(43.0, 4) == 20.0
    assert nice_step(0.013, 5) == pytest.approx(0.005)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_lie_inside_and_are_round(low: float, span: float) -> None:
    axis = Axis("", low, low + span)
    if not axis.low < axis.high:
        return
    for value, text in axis.ticks(300.0):
        assert low - 1e-6 * span <= value <= low + span * (1 + 1e-6)
        assert len(text) < 16


def test_an_axis_around_nothing_is_an_axis() -> None:
    axis = Axis.around("x", np.array([np.nan]))
    assert axis.low < axis.high
    assert Axis.around("x", [2.0, 2.0]).low < 2.0 < Axis.around("x", [2.0, 2.0]).high
    assert Axis.around("x", [1.0, 5.0], zero=True).low == 0.0


def test_log_axes_have_tens() -> None:
    axis = Axis.around("n", [2.0, 5000.0], log=True)
    assert [text for _, text in axis.ticks(300.0)] == ["10", "100", "1000"]
    assert axis.fraction([axis.low, axis.high]).tolist() == [0.0, 1.0]


def test_points_are_where_the_numbers_are() -> None:
    x, y = np.array([0.0, 5.0, 10.0]), np.array([1.0, 3.0, 2.0])
    cloud = Series("", x, y, BLUE, kind="points", tips=("a", "b", "c"))
    centres = points(Chart("s", "title", Axis("x", 0.0, 10.0), Axis("y", 0.0, 4.0), [cloud]).body)
    assert [a for a, _ in centres] == pytest.approx([58.0, 234.0, 410.0], abs=0.1)
    assert centres[0][1] > centres[2][1] > centres[1][1]


def test_a_missing_number_is_no_point() -> None:
    cloud = Series("", np.array([1.0, np.nan]), np.array([1.0, 2.0]), BLUE, kind="points")
    assert len(points(Chart("s", "t", Axis("x", 0, 2), Axis("y", 0, 2), [cloud]).body)) == 1


def test_curves_bands_limits_and_rings() -> None:
    x = np.linspace(0.0, 1.0, 5)
    curve = Series("a <b>", x, x, BLUE, low=x - 0.1, high=x + 0.1, kind="marked")
    body = Chart(
        "l", "t", Axis("x", 0, 1), Axis("y", 0, 1), [curve], limit=(0.5, "limit"), level=0.3, ring=(1.0, 1.0, "")
    ).body
    assert body.count('class="mark c0"') == 5
    assert body.count('class="band c0"') == 1
    assert "a &lt;b&gt;" in body
    assert body.count('class="limit"') == body.count('class="ring"') == 1


def test_a_distribution_rises_to_one() -> None:
    body = ecdf("e", "t", [("a", np.array([1.0, 2.0, 3.0]), BLUE)], Axis("x", 0, 4), "share").body
    path = re.search(r'class="curve c0" d="([^"]+)"', body)
    assert path is not None
    heights = [float(height) for height in re.findall(r"V([\d.]+)", path[1])]
    assert heights == sorted(heights, reverse=True)
    assert heights[-1] == pytest.approx(10.0)  # the top of the frame


def test_intervals_without_ends_have_none() -> None:
    rows = [[Dot("a", 1.0, 0.5, 1.5, BLUE)], [Dot("b", 1.0, np.nan, np.nan, BLUE, open=True)]]
    body = dots("d", "t", rows, Axis("x", 0, 2), upright=(1.0, "here")).body
    assert body.count('class="curve c0"') == 1
    assert body.count('class="mark c0 open"') == 1


def test_bars_and_outlines() -> None:
    edges = np.array([0.0, 1.0, 2.0])
    body = bars(
        "b", "t", edges, [("a", np.array([1.0, 2.0]), BLUE)], "x", "y", outlines=[("m", np.array([2.0, 1.0]), BLUE)]
    ).body
    assert body.count('class="bar c0"') == 1
    assert body.count('class="curve c0"') == 1


def test_a_heat_map_shows_its_numbers_and_leaves_gaps() -> None:
    values = np.array([[1.0, 2.0], [np.nan, 3.0]])
    body = heat_map("h", "t", values, [["1", "2"], ["", "3"]], ("x", ["a", "b"]), ("y", ["c", "d"]), ring=(0, 0)).body
    assert body.count("<rect") == 4  # three cells and the frame around one
    assert "<title>3</title>" in body


def test_law_styles_differ() -> None:
    styles = law_styles(["none", *(f"law{i}" for i in range(12))])
    assert styles["none"] is charts.RECORDED
    assert len(set(styles.values())) == 13


def test_data_cannot_end_a_script() -> None:
    assert "</" not in script_json({"a": "</script>"})
    assert packed([1, 2, 3], "u1") == {"type": "u1", "data": "AQID"}


def test_text_of_numbers_and_symbols() -> None:
    assert number(-0.0004, 3) == "0.000"
    assert str(symbols("K_psi <= 0")) == "K<sub>ψ</sub> &lt;= 0"
    assert "<summary>" in details("a", symbols("b"))


def data_of(report: ReportInput) -> dict[str, Any]:
    section, _ = section_of(explorer.section, report)
    assert section.data is not None
    return dict(section.data)


def test_departures_are_named_by_the_shown_designs_scores(report: ReportInput) -> None:
    context = Context.of(report)
    departures = explorer_departures(context, explorer_designs(context))
    roles = {role: departure.row for departure in departures for role in departure.roles}
    S, side = context.S(context.shown), context.scenarios.side
    for which, name in ((1, "left"), (-1, "right")):
        rows = np.flatnonzero(side == which)
        assert roles[f"largest S, {name}"] == rows[S[rows].argmax()]
        order = rows[np.argsort(S[rows], kind="stable")]
        assert roles[f"median S, {name}"] == order[(rows.size - 1) // 2]
    assert len({departure.row for departure in departures}) == len(departures)


def test_designs_are_the_shown_one_the_best_of_each_law_and_table_1(report: ReportInput) -> None:
    context = Context.of(report)
    shown = explorer_designs(context)
    assert shown[0].position == context.shown
    laws = [context.ranking.designs[design.position].law for design in shown]
    assert {"lqr", "preview_proportional"} <= set(laws)
    assert "none" not in laws
    assert "Table I of the paper" in [design.reason for design in shown] or any(
        design.reason == "best of its law" and context.ranking.designs[design.position].law == "preview_proportional"
        for design in shown
    )


def test_what_a_user_asks_for_is_there(report: ReportInput) -> None:
    requested = report.results.designs[-1]
    given = dataclasses.replace(report, departures=(7, 93), shown_designs=(requested.id[:8],))
    data = data_of(given)
    assert [entry["number"] for entry in data["departures"][:2]] == ["7", "93"]
    assert "requested" in data["departures"][0]["name"]
    assert "requested" in [entry["why"] for entry in data["designs"]]


def test_asked_for_but_not_there(results: StudyResults) -> None:
    with pytest.raises(InputError, match=r"departure: 100; no departure .* the nearest is 99"):
        rows_of_numbers(results.scenarios, [100])
    with pytest.raises(UnknownNameError, match="'zz': no such design"):
        named_designs(results.designs, ["zz"])
    same = [dataclasses.replace(results.designs[0]), results.designs[0]]
    with pytest.raises(InputError, match="the ids of 2 designs start so"):
        named_designs(same, [same[0].id[:6]])


def test_the_script_draws_what_was_driven(report: ReportInput) -> None:
    context = Context.of(report)
    designs = explorer_designs(context)
    departures = explorer_departures(context, designs)
    again, data = replay(context, departures, designs), data_of(report)
    assert again.mismatch < 1e-9
    count, start = unpacked(data["count"]), unpacked(data["start"])
    y, a_y = (unpacked(data["paths"][name]) * data["resolution"][name] for name in ("y", "a_y"))
    first = np.concatenate([[0], np.cumsum(count)])
    for i, k in ((0, 0), (1, 5), (len(designs) - 1, len(departures) - 1)):
        at, paths = i * len(departures) + k, again.paths[i]
        t = start[at] + data["step"] * np.arange(count[at])
        known = np.isfinite(paths.t[k])
        for name, drawn in (("y", y), ("a_y", a_y)):
            exact = np.interp(t, paths.t[k][known], getattr(paths, name)[k][known])
            assert drawn[first[at] : first[at + 1]] == pytest.approx(exact, abs=data["resolution"][name])


def test_the_script_draws_what_was_planned() -> None:
    """The plans of every fifth sample, from when their first commands act, against `ldctoolkit.plans`."""
    design, scenarios = NonlinearMPC(horizon=6), Scenarios.from_arrays(T=[3.0, 4.0], d_y=[0.5, 0.8], v_mean=25.0)
    section, page = section_of(
        explorer.section, only(Design.of(LQR(), 0.1), Design.of(design, 0.1), scenarios=scenarios)
    )
    data = section.data
    assert data is not None
    drawn = {entry["name"].partition(",")[0]: plan for entry, plan in zip(data["designs"], data["plans"], strict=True)}
    assert drawn["LQR"]["departures"] == []
    plan = drawn["Nonlinear MPC"]
    assert (sorted(plan["departures"]), data["plan_step"], data["dt"]) == ([0, 1], 0.25, 0.05)
    numbers = unpacked(plan["values"]).reshape(-1, *plan["shape"])
    found = ldc.plans(design, scenarios, 0.1)
    for place, k in enumerate(plan["departures"]):
        row = int(data["departures"][k]["number"])
        rows = np.flatnonzero((found.row == row) & (found.sample % 5 == 0))
        np.testing.assert_allclose(numbers[place, : rows.size, 1:], found.x[rows, :, 0] - 0.85, atol=1e-6)
        np.testing.assert_array_equal(numbers[place, : rows.size, 0], 0.0)
        assert np.isnan(numbers[place, rows.size :]).all()
    assert "Plans at" in page.words()


def test_no_axis_cuts_what_is_drawn(report: ReportInput) -> None:
    """The default axis cut an acceleration at -5.5 of 43 m/s^2."""
    data = data_of(report)
    for name in ("y", "delta", "a_y"):
        values = unpacked(data["paths"][name]) * data["resolution"][name]
        low, high = min(0.0, values.min()), max(0.0, values.max())
        assert any(scale["low"] <= low and high <= scale["high"] for scale in data["scales"][name])
        for scale in data["scales"][name]:
            assert all(scale["low"] <= value <= scale["high"] for value, _ in scale["ticks"])
            assert 2 <= len(scale["ticks"]) <= 12


def test_facts_are_the_stored_ones(report: ReportInput) -> None:
    context, data = Context.of(report), data_of(report)
    designs = explorer_designs(context)
    departures = explorer_departures(context, designs)
    S = context.S(designs[0].position)[departures[3].row]
    assert data["facts"][0][3][0] == f"{S:.3f}"
    assert re.fullmatch(r"[\d.−–]+", data["facts"][0][3][3])


def test_recorded_paths_begin_and_end_on_the_line(report: ReportInput) -> None:
    data = data_of(report)
    count = unpacked(data["recorded"]["count"])
    y = unpacked(data["recorded"]["y"]) * data["resolution"]["y"]
    ends = np.cumsum(count)
    assert np.abs(y[np.concatenate([[0], ends[:-1]])]).max() < 0.002
    assert np.abs(y[ends - 1]).max() < 0.002


def test_recorded_acceleration_is_that_of_the_lane_and_of_the_path() -> None:
    """y'' of the parabola, outward, and v^2 c, both from the parameters."""
    T, d_y, v, c_0, dc = np.array([4.0, 5.0]), np.array([0.5, 0.7]), 22.0, 0.003, -0.002
    scenarios = Scenarios.from_arrays(T=T, d_y=d_y, v_mean=v, c_0=c_0, dc=dc, side=[1, -1])
    section, _ = section_of(explorer.section, only(Design.of(LQR(), 0.1), scenarios=scenarios))
    data = section.data
    assert data is not None
    count = unpacked(data["recorded"]["count"])
    a_y = np.split(unpacked(data["recorded"]["a_y"]) * data["resolution"]["a_y"], np.cumsum(count)[:-1])
    for departure, shown in zip(data["departures"], a_y, strict=True):
        i = int(departure["number"])
        t = np.minimum(np.arange(shown.size) * data["step"], T[i])
        expected = -8.0 * d_y[i] / T[i] ** 2 + v**2 * (c_0 + dc * t / T[i])
        np.testing.assert_allclose(shown, expected, rtol=0, atol=0.5001 * data["resolution"]["a_y"])


def test_the_explorer_opens_where_the_winner_acts() -> None:
    """Not at its largest S, a departure that it leaves alone; what was requested comes first."""
    scenarios = Scenarios.from_arrays(
        T=[9.0, 9.0, 3.0, 3.0, 3.0], d_y=[0.29, 0.29, 0.5, 0.6, 0.55], v_mean=25.0, side=[1, -1, 1, 1, -1]
    )
    given = only(Design.of(LQR(), 0.3), scenarios=scenarios)
    data = section_of(explorer.section, given)[0].data
    assert data is not None
    opened = data["departures"][data["open"]]
    acts = unpacked(data["count"])[: len(data["departures"])] > 0
    assert "largest S" in data["departures"][0]["name"]
    assert not acts[0]
    assert acts[data["open"]]
    assert int(opened["number"]) >= 2
    for requested, first in (((0,), "0"), ((1, 3), "3"), ((3, 4), "3")):
        data = section_of(explorer.section, dataclasses.replace(given, departures=requested))[0].data
        assert data is not None
        assert data["departures"][data["open"]]["number"] == first
    alone = section_of(explorer.section, only(Design.of(LQR(), 3.0), scenarios=scenarios))[0].data
    assert alone is not None
    assert alone["open"] == 0


def test_a_study_of_no_control_has_no_explorer() -> None:
    section, page = section_of(explorer.section, only(Design.of(NoControl(), 0.2)))
    assert section.data is not None or "No design intervenes" in page.words()


def test_another_machines_scores_are_reported(results: StudyResults) -> None:
    given = report_input(dataclasses.replace(results, S=1.01 * results.S))
    _, page = section_of(explorer.section, given)
    assert "differ from the stored ones by up to 1.0 %" in page.words()


def test_distributions_hold_every_value(report: ReportInput) -> None:
    section, _ = section_of(explorer.section, report)
    names = [chart.name for chart in section.charts]
    assert names == [
        "distribution-S-left", "distribution-S-right", "distribution-deepest", "distribution-dtle",
        "distribution-a-y-added-peak", "distribution-jerk-added-peak",
    ]  # fmt: skip
    assert "ISO 11270" in section.charts[4].body
    assert "Euro NCAP" in section.charts[3].body


def test_the_worst_part_of_S() -> None:
    scenarios = invented_scenarios(40, 40)
    given = only(Design.of(LQR(r_delta=100.0), 0.1), scenarios=scenarios)
    context = Context.of(given)
    S = np.sort(context.S(0))[::-1]
    share = 100 * S[:4].sum() / S.sum()
    assert f"The worst 5 % of departures (4) make up {share:.0f}\u00a0% of the sum" in explorer.worst_sentence(context)
