# ruff: noqa: RUF001 - the page shows true minus signs
"""The page of a comparison whose numbers are made up, each where it belongs; text escaped, the same bytes."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.pages import EVIL, Page, unpacked, whole
from studies import Comparison
from studies.compare_page import write_compare_page
from studies.compare_page.page import SECTIONS, make_page
from studies.comparison.comparison import CaseComparison
from studies.comparison.paired_verdicts import PairedDifferences, Verdict
from studies.comparison.shared_scenarios import SharedScenarios
from studies.comparison.winners import Winners
from studies.design import Design
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
    verdict=(Verdict.SAME, Verdict.WORSE, Verdict.BETTER, Verdict.UNTOLD),
)
WORSE = Winners(DESIGNS[1], DESIGNS[1], 1.0, 1.25, 0.25, 0.2, 0.3, Verdict.WORSE, 7, fresh=False)
CASE = CaseComparison(Case("departure", "consistent"), DESIGNS, S, (3, 1, 0, 2), (4, 0, 5, 6), WORSE)
SHARED = SharedScenarios(np.arange(5), np.array([10, 11, 12, 13, 14]), np.array([1, 1, 1, -1, -1]), 3)
COMPARISON = Comparison(
    "out/old", "out/new", "before", "after", ("plant.actuator.lag: 0.0 -> 0.2",), SHARED, (CASE,),
    (Design.of(PreviewProportional(), 0.2),), (Design.of(LQR(), 0.3),), (), (), (), (), 200, 0.95,
)  # fmt: skip
NOTHING = np.zeros(0)


def page_of(**changes: Any) -> Page:
    return Page(make_page(dataclasses.replace(COMPARISON, **changes)))


def of_case(**changes: Any) -> Page:
    return page_of(cases=(dataclasses.replace(CASE, **changes),))


@pytest.fixture(scope="module")
def page() -> Page:
    found = page_of()
    whole(found)
    return found


def test_the_table_holds_the_numbers_of_the_comparison(page: Page) -> None:
    assert page.filled("designs")[0][1:] == [
        ["▲worse", "LQR, ys=0.05 mlqr", "1.0000", "1.2500", "+0.2500[+0.2000 to +0.3000]", "5",
         "+0.7500 (no. 12)", "1, 0"],
        ["▼better", "LQR, ys=0.1 mlqr", "0.5000", "0.4000", "−0.1000[−0.1500 to −0.0500]", "4",
         "−0.6000 (no. 11)", "0, 5"],
        ["?cannot be told", "LQR, ys=0.2 mlqr", "4.0000", "4.0002", "+2.0e−04[−1.0e−04 to +5.0e−04]", "2",
         "+0.0100 (no. 14)", "2, 6"],
        ["=same", "No control, ys=0.2 mnone", "2.0000", "2.0000", "0[too few departures changed]", "0", "–", "3, 4"],
    ]  # fmt: skip
    assert page.filled("designs")[0][0][2:5] == ["Old S [m·s]", "New S [m·s]", "New − old [m·s]"]


def test_the_script_gets_the_same_numbers(page: Page) -> None:
    given, order = page.data["compare"], [1, 2, 3, 0]
    (packed,) = given["cases"]
    assert packed["labels"] == [DESIGNS[i].label for i in order]
    assert [given["verdicts"][k] for k in unpacked(packed["verdict"])] == ["worse", "better", "cannot be told", "same"]
    for name in ("S_old", "S_new", "difference", "low", "high", "changed", "largest"):
        np.testing.assert_allclose(unpacked(packed[name]), getattr(S, name)[order], rtol=1e-6)
    assert [packed["laws"][k] for k in unpacked(packed["law"])] == ["lqr", "lqr", "lqr", "none"]
    assert unpacked(packed["largest_at"]).tolist() == [12, 11, 14, 10]
    assert unpacked(packed["failed_old"]).tolist() == [1, 0, 2, 3]
    assert unpacked(packed["failed_new"]).tolist() == [0, 5, 6, 4]


def test_the_answer_says_winners_and_counts(page: Page) -> None:
    said = page.words("answer")
    for words in (
        "+0.2500 m·sS, LQR, ys=0.05 m, winner of both: worseinterval +0.2000 to +0.3000",
        "LQR, ys=0.05 m is the winner of both studies and is worse now: S = 1.0000 m·s before, 1.2500 m·s now: "
        "+0.2500 m·s (interval +0.2000 to +0.3000) on 7 shared departures.",
        "1 better, 1 worse, 1 cannot be told, 1 the same",
        "Most worse: LQR, ys=0.05 m, +0.2500 m·s, +25.0 % (interval +0.2000 to +0.3000), changed in 5 departures.",
        "Most better: LQR, ys=0.1 m, −0.1000 m·s, −20.0 % (interval −0.1500 to −0.0500), changed in 4 departures.",
        "with 95 % confidence",
        "S is the integral over time of |ey|, the distance of the vehicle’s centre from the lane’s centre",
    ):
        assert words in said
    assert "beyond the line" not in said
    assert "5 shared departures (3 left, 2 right) · 4 designs in both · 1 case" in page.words()
    assert ["plant.actuator.lag", "0.0 → 0.2"] in page.filled("differences")[0]
    old, new = page.filled("only")
    assert (old[1][1], new[1][1]) == ("Preview P, ys=0.2 m", "LQR, ys=0.3 m")
    settings = dict(row for row in page.filled("settings")[0] if len(row) == 2)
    assert settings["shared departures"] == "3 left, 2 right"
    assert settings["same departure, other draws"] == "3"


@pytest.mark.parametrize(
    ("verdict", "same", "other"),
    [
        (Verdict.BETTER, "is better now", "is better than"),
        (Verdict.WORSE, "is worse now", "is worse than"),
        (Verdict.SAME, "scores the same", "is as good as"),
        (Verdict.UNTOLD, "whether its score changed cannot be told", "cannot be told apart from"),
    ],
)
def test_every_verdict_of_winners(verdict: Verdict, same: str, other: str) -> None:
    said = of_case(winners=dataclasses.replace(WORSE, verdict=verdict)).words("answer")
    assert f"LQR, ys=0.05 m is the winner of both studies and {same}:" in said
    said = of_case(winners=dataclasses.replace(WORSE, old=DESIGNS[2], verdict=verdict, fresh=True)).words("answer")
    assert f"The new winner LQR, ys=0.05 m {other} the old one, LQR, ys=0.1 m:" in said
    assert "on 7 fresh shared departures" in said


@pytest.mark.slow
def test_no_winner_to_compare(page: Page) -> None:
    tiles = [found.html.count('<li><span class="value">') for found in (page, of_case(winners=None))]
    assert tiles == [5, 4]
    assert "no winner to compare" in of_case(winners=None).text["answer"]
    assert "a race of one" in of_case(winners=None, raced_elsewhere=True).text["answer"]


def test_one_file_with_all_sections(page: Page) -> None:
    assert [section for section in page.text if section] == [id for id, _ in SECTIONS]
    assert page.counts["svg"] == 2  # intervals and scatter
    for words in ("New minus old mean S [m·s]; left of 0 is better", "Old mean S [m·s]", "New mean S [m·s]", "LQR"):
        assert words in page.drawn


def test_same_comparison_same_bytes(page: Page, tmp_path: Path) -> None:
    assert write_compare_page(COMPARISON, tmp_path / "a.html").read_bytes() == page.html.encode()


def test_text_of_users_is_text() -> None:
    named = page_of(
        old=EVIL, new_name=EVIL, differences=(f"law: {EVIL} -> {EVIL}",), warnings=(EVIL,),
        new_failures=(FailedDesign(DESIGNS[1], EVIL),), repaired=(FailedDesign(DESIGNS[2], "was broken"),),
    )  # fmt: skip
    assert named.counts["script"] == 2
    assert "1 design that ran before fails now." in named.words("answer")
    assert "1 design that failed before runs now." in named.words("answer")
    fails, runs = named.filled("failures")
    assert fails[1] == ["LQR, ys=0.05 m", EVIL.replace("\u202e", "\ufffd")]
    assert runs[1] == ["LQR, ys=0.1 m", "was broken"]
    assert named.text["answer"].count("<script>alert(1)</script>") == 1


def test_no_design_in_both() -> None:
    nothing = PairedDifferences(*[NOTHING] * 5, NOTHING.astype(int), NOTHING, NOTHING.astype(int), ())
    page = of_case(designs=(), S=nothing, failed_old=(), failed_new=())
    assert "no design is in both studies" in page.text["designs"]
    assert "No design is in both studies" in page.text["scatter"]
    assert "No departure of any design" in page.text["changes"]


def test_nothing_changed() -> None:
    zero, none = np.zeros(4), np.full(4, np.nan)
    same = PairedDifferences(S.S_old, S.S_old, zero, none, none, zero.astype(int), zero, zero.astype(int),
                             (Verdict.SAME,) * 4)  # fmt: skip
    page = page_of(cases=(dataclasses.replace(CASE, S=same),), differences=())
    assert "comes from the code of a law" in page.text["differences"]
    assert "No departure of any design" in page.text["changes"]
    assert "Most" not in page.words("answer")


@pytest.mark.slow
def test_many_designs_stay_light() -> None:
    """5,000 designs: the table without the script is short, and all rows are there for the script."""
    k, rows = 5000, np.arange(5000) % 4
    arrays = {f.name: getattr(S, f.name)[rows] for f in dataclasses.fields(S) if f.name != "verdict"}
    page = of_case(
        designs=tuple(dataclasses.replace(DESIGNS[i], y_s=0.01 + 1e-5 * n) for n, i in enumerate(rows)),
        S=PairedDifferences(**arrays, verdict=tuple(S.verdict[i] for i in rows)),
        failed_old=(0,) * k,
        failed_new=(0,) * k,
    )
    assert len(page.data["compare"]["cases"][0]["labels"]) == k
    assert len(page.filled("designs")[0]) == 101
    assert "The first 100 of 5,000 designs" in page.words("designs")
    assert len(re.sub(r"<svg.*?</svg>", "", page.html, flags=re.DOTALL)) < 1_000_000
