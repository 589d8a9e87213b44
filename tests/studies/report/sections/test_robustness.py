# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The section on other plants, as a reader sees it."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.reports import PRIMARY, invented_scenarios, report_input, run, said_in, section_of
from studies.design import Design
from studies.report import ReportInput
from studies.report.sections.robustness import section
from studies.report.words.text import number
from studies.robustness.robustness import Robustness, RobustnessTask, work_out


def with_robustness(report: ReportInput, plants: int | None = None) -> ReportInput:
    ranking = report.rankings[0]
    task = RobustnessTask.of(report.results, ranking, report.setup, per_side=8)
    return dataclasses.replace(report, robustness=work_out(dataclasses.replace(task, plants=task.plants[:plants])))


@pytest.fixture(scope="module")
def driven(report: ReportInput) -> ReportInput:
    return with_robustness(report, 6)


def found_of(report: ReportInput) -> Robustness:
    assert report.robustness is not None
    return report.robustness


def test_table_holds_the_numbers(driven: ReportInput) -> None:
    (made, page), found = section_of(section, driven), found_of(driven)
    table, details = page.filled()[:2]
    assert len(table) == 1 + len(found.plants)
    for k, line in enumerate(table[1:]):
        assert line[0].startswith(found.titles[k])
        for i, cell in enumerate(line[1:]):
            detail = details[1 + k * len(found.designs) + i]
            assert detail[2] == number(float(found.S[k, i]))
            assert detail[4] == number(100 * (1 - found.S[k, i] / found.S_uncorrected[k, i]), 1) + " %"
            assert (number(float(found.S[k, i])) in cell) == (k == 0)
            a, b = found.rank[0, i], found.rank[k, i]
            assert (f"rank {a} → {b}" if a != b else f"rank {b}") in cell
            assert (f"{found.failures[k, i]} failed" in cell) == bool(found.failures[k, i])
            assert ("worse than none" in cell) == bool(found.excess_low[k, i] > 0)
            if k:
                change = 100 * (found.S[k, i] / found.S[0, i] - 1)
                assert float(re.findall(r"([+−]?[\d.]+) %", cell)[0].replace("−", "-")) == pytest.approx(
                    change, abs=0.051 if abs(change) < 100 else 0.51
                )
    assert [one.name for one in made.drawings] == [
        "robustness-ranks", "margin-gain", "margin-phase", "margin-delay",
    ]  # fmt: skip


def changed(report: ReportInput, **changes: object) -> str:
    found = dataclasses.replace(found_of(report), **changes)  # type: ignore[arg-type]
    return said_in(section, dataclasses.replace(report, robustness=found))


def test_sentences_say_who_stays_first_what_hurts_and_who_fails(driven: ReportInput) -> None:
    found = found_of(driven)
    p, d = found.rank.shape
    rank = np.tile(np.arange(1, d + 1), (p, 1))
    nothing = np.zeros((p, d), dtype=np.int64)
    calm = {"rank": rank, "failures": nothing, "diverged": nothing, "lead_low": np.full(p, -0.4),
            "lead_high": np.full(p, -0.2),
            "excess": np.full((p, d), -9.0), "excess_low": np.full((p, d), -9.5)}  # fmt: skip
    said = changed(driven, **calm)
    assert f"the winner, is clearly first on all {p - 1} other plants, by mean S" in said
    assert "No design fails in more departures" in said
    assert "Worse than no control" not in said

    change, low, high, S = (getattr(found, name).copy() for name in ("change", "low", "high", "S"))
    S[0, 0], S[2, 0], change[:, 0] = 1.0, 2.5, 0.0
    change[2, 0], low[2, 0], high[2, 0] = 1.5, 1.0, 2.0
    rank, failures, diverged = rank.copy(), nothing.copy(), nothing.copy()
    rank[2, 0], failures[2, 0], diverged[2, 0] = 3, 7, 5
    lead, lead_low, lead_high = np.full(p, -0.3), np.full(p, -0.5), np.full(p, -0.1)
    lead[2], lead_low[2], lead_high[2] = 0.4, 0.3, 0.5
    excess, excess_low = calm["excess"].copy(), calm["excess_low"].copy()
    excess[2, 0], excess_low[2, 0] = 0.5, 0.1
    said = changed(driven, rank=rank, failures=failures, diverged=diverged, change=change, low=low, high=high, S=S,
                   lead=lead, lead_low=lead_low, lead_high=lead_high, excess=excess, excess_low=excess_low)  # fmt: skip
    assert f"is clearly first on {p - 2} of the {p - 1} other plants and behind on 1 (Actuator lag, rank 3), by" in said
    shown = dataclasses.replace(driven, robustness=dataclasses.replace(found, failures=failures, diverged=diverged))
    assert section_of(section, shown)[1].filled()[1][1 + 2 * d][5:7] == ["7", "5"]
    rival = next(iter(re.findall(r"On Actuator lag (.*?) is better by", said)))
    assert rival.startswith(("Preview P", "LQR", "No control"))
    assert "is better by 0.400 m·s (interval 0.300 to 0.500)" in said
    assert "Of single options Actuator lag" in said
    assert "1.000 → 2.500 m·s, +150 % (interval 100 to 200 %)" in said
    assert "LQR fails on Actuator lag in 7 of 16 departures (none on the study’s plant); 5 of these left ±20 m." in said
    assert "Worse than no control, though not on the study’s plant: LQR on Actuator lag." in said


def test_what_may_be_chance_is_level(driven: ReportInput) -> None:
    found = found_of(driven)
    p, d = found.rank.shape
    rank = np.tile(np.r_[2, 1, 3 : d + 1], (p, 1))  # second by estimate everywhere
    lead, low, high = np.full(p, 2e-4), np.full(p, -1e-4), np.full(p, 5e-4)
    one = np.full(p, 1)
    name = section_of(section, driven)[1].filled()[0][0][2]
    said = changed(driven, rank=rank, lead=lead, lead_low=low, lead_high=high, rival=one)
    assert f"is level with {name} on all {p - 1} other plants" in said
    assert f"On the study’s own plant it is level with {name}" in said
    assert "is better by" not in said
    # behind on one plant, by less than three decimals show; first on another; equal to the last bit but one on a third
    low[3], high[3] = 1e-4, 3.1e-4
    low[4], high[4] = -0.3, -0.1
    lead[5] = low[5] = high[5] = 3e-9
    two = changed(driven, rank=rank, lead=lead, lead_low=low, lead_high=high, rival=one)
    assert f"is clearly first on 1 of the {p - 1} other plants, level with {name} on {p - 3} and behind on 1 (" in two
    assert f"({found.titles[3]}, rank 2)" in two
    assert f"On {found.titles[3]} {name} is better by 2.0e−4 m·s (interval 1.0e−4 to 3.1e−4)." in two
    several = changed(driven, rank=rank, lead=lead, lead_low=low, lead_high=high, rival=1 + np.arange(p) % 2)
    assert f"level with the best other design on {p - 3}" in several


def test_small_changes_are_not_shown_as_none(driven: ReportInput) -> None:
    found = found_of(driven)
    low, high = found.low.copy(), found.high.copy()
    low[2, 0], high[2, 0] = -1.2e-5, 4e-4
    assert "−1.2e−5 to 4.0e−4" in changed(driven, low=low, high=high)


def test_failures_are_told_in_short_sentences(driven: ReportInput) -> None:
    found = found_of(driven)
    failures, diverged = np.zeros(found.S.shape, dtype=np.int64), np.zeros(found.S.shape, dtype=np.int64)
    name = section_of(section, driven)[1].filled()[0][0][2]
    failures[3, 1] = diverged[3, 1] = 9
    failures[4, 1], failures[0, 1] = 5, 2
    said = changed(driven, failures=failures, diverged=diverged)
    where = f"{name} fails on {found.titles[3]} in 9 of 16 departures (2 on the study’s plant)"
    assert f"{where}; all 9 left ±20 m. It fails more often on 1 other plant too." in said
    diverged[3, 1], failures[4, 1] = 0, 2
    assert f"{where}." in changed(driven, failures=failures, diverged=diverged)
    failures[3], diverged[3] = 1, 1
    failures[0] = 0
    said = changed(driven, failures=failures, diverged=diverged)
    assert "in 1 of 16 departures (none on the study’s plant); it left ±20 m." in said
    assert f"{found.S.shape[1] - 3} other design" in said


def test_two_designs_of_a_law_are_told_apart_by_their_rank(driven: ReportInput) -> None:
    heads = section_of(section, driven)[1].filled()[0][0]
    assert "Preview P (Table I)" in heads
    assert any(re.fullmatch(r"Preview P \(rank \d+\)", head) for head in heads)


def test_unstable_speeds_are_those(driven: ReportInput) -> None:
    found = found_of(driven)
    v = np.linspace(10.0, 34.0, 7)
    for unstable, told in (
        ([], "no"),
        ([0], "at 10.0 m/s"),
        ([0, 1, 2], "at 10.0 to 18.0 m/s"),
        ([0, 3, 5, 6], "at 10.0, 22.0, 30.0 to 34.0 m/s"),
    ):
        stable = np.ones(7, dtype=np.bool_)
        stable[unstable] = False
        margins = (dataclasses.replace(found.margins[0], stable=stable), *found.margins[1:])
        shown = dataclasses.replace(driven, robustness=dataclasses.replace(found, v=v, margins=margins))
        assert section_of(section, shown)[1].filled()[-1][1][5] == told


def test_worse_than_no_control_is_said_beyond_chance_only(driven: ReportInput) -> None:
    found = found_of(driven)
    excess, low = np.full(found.S.shape, -9.0), np.full(found.S.shape, -9.5)
    for estimate, lowest, worse, not_shown in (
        (0.5, 0.1, 1, 0),
        (0.5, -0.1, 0, 1),
        (0.5, np.nan, 0, 1),
        (-0.5, -1.0, 0, 0),
        (0.0, 0.0, 0, 0),
    ):
        excess[2, 0], low[2, 0] = estimate, lowest
        said = changed(driven, excess=excess, excess_low=low)
        assert said.count("worse than none") == said.count("Worse than no control") == worse
        assert said.count("not shown better than none") == not_shown


def test_without_numbers_it_says_how_to_get_them(report: ReportInput) -> None:
    assert report.robustness is None
    made, page = section_of(section, report)
    assert "ldc report DIR" in page.words()
    assert not made.drawings


def test_numbers_of_other_designs_are_not_shown(driven: ReportInput) -> None:
    assert "No design of this ranking" in changed(driven, designs=("0" * 12,) * len(found_of(driven).designs))


LONE = (Design.of(LQR(), 0.05),)
NO_CONTROL = (Design.of(NoControl(), 0.2),)
NEVER = (Design.of(PreviewProportional(), 5.0), Design.of(NoControl(), 5.0))


@pytest.mark.parametrize(
    ("left", "right", "designs"), [(9, 0, LONE), (0, 9, NEVER), (1, 0, LONE), (5, 5, NO_CONTROL), (5, 5, NEVER)]
)
def test_small_and_odd_studies(left: int, right: int, designs: tuple[Design, ...]) -> None:
    report = report_input(run(designs, invented_scenarios(left, right), [PRIMARY]))
    said = said_in(section, with_robustness(report, 4))
    assert "nan" not in said.lower().split()
    assert ("stands alone here" in said) == (len(designs) == 1)
    assert f"the first {min(left, 8)} left and {min(right, 8)} right departures" in said


def test_titles_and_reasons_are_text(driven: ReportInput) -> None:
    found, evil = found_of(driven), "<script>alert(1)</script>"
    margins = tuple(dataclasses.replace(one, notes=(evil,)) for one in found.margins)
    hostile = dataclasses.replace(
        found, raised=((1, 0, evil),), unsafe=(evil,), left_out=((evil, evil),), margins=margins
    )
    _, page = section_of(section, dataclasses.replace(driven, robustness=hostile))
    assert page.counts["script"] == 0
    assert page.words().count(evil) >= 4
