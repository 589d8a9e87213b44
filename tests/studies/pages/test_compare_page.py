# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The page of a comparison whose numbers are made up, each where it belongs; text escaped, the same bytes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.pages import EVIL, Page, whole
from studies import Comparison
from studies.comparison.comparison import CaseComparison
from studies.comparison.paired import PairedDifferences, SharedScenarios, Verdict, Winners
from studies.design import Design
from studies.pages.compare_page import compare_page, write_compare_page
from studies.results import Case, FailedDesign

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
CASE = CaseComparison(Case("departure", "consistent"), DESIGNS, S, (3, 1, 0, 2), (4, 0, 5, 6), WORSE)
SHARED = SharedScenarios(np.arange(5), np.array([10, 11, 12, 13, 14]), np.array([1, 1, 1, -1, -1]), 3)
COMPARISON = Comparison(
    "out/old", "out/new", "before", "after", ("plant.actuator.lag: 0.0 -> 0.2",), SHARED, (CASE,),
    (Design.of(PreviewProportional(), 0.2),), (Design.of(LQR(), 0.3),), (), (), (), (), 200, 0.95,
)  # fmt: skip
NOTHING = np.zeros(0)
NONE = PairedDifferences(
    NOTHING, NOTHING, NOTHING, NOTHING, NOTHING, NOTHING.astype(int), NOTHING, NOTHING.astype(int), ()
)


def page_of(**changes: Any) -> Page:
    page = Page(compare_page(dataclasses.replace(COMPARISON, **changes)))
    whole(page)
    return page


def of_case(**changes: Any) -> Page:
    return page_of(cases=(dataclasses.replace(CASE, **changes),))


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
        "departure window, "
            "consistent", "7 study scenarios", "1.0000", "1.2500", "+0.2500", "+25.0", "+0.2000 to +0.3000",
        "worse",
    ]  # fmt: skip
    assert "1 better, 1 worse, 1 not separated, 1 the same" in words


def test_a_difference_without_practical_weight_says_so() -> None:
    small = dataclasses.replace(WORSE, difference=0.004, low=0.001, high=0.007)
    page = of_case(winners=small)
    assert "rises by 0.0040 m·s, less than the 0.01 m·s that matter in practice" in page.words("verdict")
    assert page.filled("verdict")[0][1][-1] == "worse, too little to matter"


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
    words = of_case(winners=given).words("verdict")
    assert "On shared fresh scenarios the new winner, LQR, ys=0.05 m, " + text in words


def test_one_vocabulary(page: Page) -> None:
    """The page said "cannot be told" and "most worse" of one design."""
    for never in ("cannot be told", "most worse", "told", "said"):
        assert never not in page.all_words


def test_the_table_holds_the_numbers_of_the_comparison(page: Page) -> None:
    (table,) = page.filled("designs")
    assert table[0] == [
        "Verdict", "Design", "Old S [m·s]", "New S [m·s]", "New − old [m·s]", "Interval [m·s]", "Scenarios changed",
        "Largest change [m·s]", "Failed, old / new",
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
    given = of_case(
        designs=many,
        S=PairedDifferences(**wide, verdict=S.verdict[1:] * 10),
        failed_old=(0,) * 30,
        failed_new=(0,) * 30,
    )
    assert "Show all 30" in given.all_words


def test_differences_and_designs_of_one_study(page: Page) -> None:
    assert ["plant.actuator.lag", "0.0 → 0.2"] in page.filled("differences")[0]
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
    page = of_case(designs=(), S=NONE, failed_old=(), failed_new=(), winners=None)
    assert "No design is in both studies" in page.words("verdict")
    assert "there is no winner to compare" in page.words("verdict")
    assert "Winners are not compared here: a race" in of_case(winners=None, raced_elsewhere=True).words("verdict")


def test_charts_hold_the_changes(page: Page) -> None:
    assert any("differences of mean S" in one for one in page.images)
    assert any("old against new" in one for one in page.images)


def test_the_same_bytes(tmp_path: Path) -> None:
    first = write_compare_page(COMPARISON, tmp_path / "a.html").read_bytes()
    assert first == write_compare_page(COMPARISON, tmp_path / "b.html").read_bytes()
