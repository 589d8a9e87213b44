# ruff: noqa: RUF001 - the page shows true minus signs
"""The page of a comparison: numbers as in the comparison, text escaped, the same bytes, every kind of comparison."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from studies import Comparison, Study, compare, run_study
from studies.compare_page import write_compare_page
from studies.compare_page.figures import most_changed, scatter_figure
from studies.compare_page.page import SECTIONS, make_page
from studies.comparison.paired_verdicts import PairedDifferences, Verdict
from studies.comparison.shared_scenarios import SharedScenarios
from studies.results import FailedDesign

STUDY: dict[str, Any] = {
    "name": "before",
    "seed": 2,
    "scenarios": {"left": 60, "right": 40},
    "simulation": {"window": ["departure", "control"]},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.2]}, {"law": "preview_proportional"}],
}
EVIL = "<script>alert(1)</script>"


class Parsed(HTMLParser):
    """Rows of tables by section, and text; refuses tags that are not closed in order."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.rows: dict[str, list[list[str]]] = {}
        self.text: dict[str, str] = {}
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.scripts = 0
        self.section = ""
        self.feed(page)
        self.close()
        assert self.tags == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._note(tag, attrs)
        if tag not in ("meta", "br", "input"):
            self.tags.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._note(tag, attrs)

    def _note(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.addresses += [found[key] or "" for key in ("href", "src") if key in found]
        self.scripts += tag == "script"
        if tag == "section":
            self.section = found["id"] or ""
            self.rows[self.section], self.text[self.section] = [], ""
        if tag == "tr":
            self.rows[self.section].append([])
        if tag in ("td", "th"):
            self.rows[self.section][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.tags.pop() == tag
        if tag == "section":
            self.section = ""

    def handle_data(self, data: str) -> None:
        if not self.section:
            return
        self.text[self.section] += data
        if {"td", "th"} & set(self.tags):
            self.rows[self.section][-1][-1] += data


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """A slower actuator, one design more and one less."""
    root = tmp_path_factory.mktemp("compare_page")
    changed = {
        "name": "after",
        "plant": {"actuator": {"lag": 0.2}},
        "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.2]}, {"law": "pid"}],
    }
    for folder, parts in (("old", {}), ("new", changed)):
        run_study(Study.from_dict(STUDY | parts), directory=root / folder, workers=1)
    found = compare(root / "old", root / "new")
    return dataclasses.replace(found, old="out/old", new="out/new")


def plain(number: str) -> float:
    return float(number.replace("−", "-"))


def data_of(page: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="ldc-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    content: dict[str, Any] = json.loads(found[1])
    return content


def unpacked(one: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(one["data"]), dtype=f"<{one['type']}")


def test_the_table_holds_the_numbers_of_the_comparison(comparison: Comparison) -> None:
    rows = [row for row in Parsed(make_page(comparison)).rows["designs"] if not row[0].startswith("Verdict")]
    expected = [(case, i) for case in comparison.cases for i in case.order]
    assert len(rows) == len(expected) == 8
    for row, (case, i) in zip(rows, expected, strict=True):
        assert row[0].endswith(str(case.S.verdict[i]))
        assert case.designs[i].law in row[1]
        assert plain(row[2]) == pytest.approx(case.S.S_old[i], abs=6e-5)
        assert plain(row[3]) == pytest.approx(case.S.S_new[i], abs=6e-5)
        assert plain(row[4].split("[")[0]) == pytest.approx(case.S.difference[i], abs=6e-5)
        if np.isfinite(case.S.low[i]):
            low, high = re.findall(r"[+−]?[\d.]+(?:e[+−]\d+)?", row[4].split("[")[1])
            assert plain(low) == pytest.approx(case.S.low[i], abs=6e-5)
            assert plain(high) == pytest.approx(case.S.high[i], abs=6e-5)
        assert int(row[5]) == case.S.changed[i]
        assert row[7] == f"{case.failed_old[i]}, {case.failed_new[i]}"


def test_the_script_gets_the_same_numbers(comparison: Comparison) -> None:
    given = data_of(make_page(comparison))["compare"]
    for packed, case in zip(given["cases"], comparison.cases, strict=True):
        order = list(case.order)
        assert packed["labels"] == [case.designs[i].label for i in order]
        assert [given["verdicts"][k] for k in unpacked(packed["verdict"])] == [str(case.S.verdict[i]) for i in order]
        for name in ("S_old", "S_new", "difference", "low", "high", "changed", "largest"):
            np.testing.assert_allclose(unpacked(packed[name]), getattr(case.S, name)[order], rtol=1e-6, atol=1e-9)
        assert [packed["laws"][k] for k in unpacked(packed["law"])] == [case.designs[i].law for i in order]
        at = comparison.shared.new[case.S.largest_at[order]]
        np.testing.assert_array_equal(unpacked(packed["largest_at"]), at)


def test_the_answer_says_winners_and_counts(comparison: Comparison) -> None:
    page, first = Parsed(make_page(comparison)), comparison.cases[0]
    said = " ".join(page.text["answer"].split())
    assert first.winners is not None
    assert f"{first.count(Verdict.WORSE)} worse" in said
    assert f"{first.winners.S_new:.4f} m·s now" in said.replace("\xa0", " ")
    assert "is worse now" in said or "is worse than" in said
    assert "plant.actuator.lag" in page.text["differences"]
    assert "0.0 → 0.2" in page.text["differences"]
    assert "PID" in page.text["only"]
    assert "Preview P" in page.text["only"]


def test_the_first_tile_is_the_winners_difference(comparison: Comparison) -> None:
    found = comparison.cases[0].winners
    assert found is not None
    tiles = re.findall(r"<li><span class=\"value\">(.*?)</li>", make_page(comparison), re.DOTALL)
    assert len(tiles) == 5
    assert plain(tiles[0].split("<")[0]) == pytest.approx(found.difference, abs=6e-5)
    assert "worse" in tiles[0] if found.verdict is Verdict.WORSE else str(found.verdict) in tiles[0]
    low, high = map(plain, re.findall(r"[+−][\d.]+", tiles[0].split("interval")[1]))
    assert (low, high) == pytest.approx((found.low, found.high), abs=6e-5)
    nobody = dataclasses.replace(comparison.cases[0], winners=None)
    page = make_page(dataclasses.replace(comparison, cases=(nobody,)))
    assert len(re.findall(r"<li><span class=\"value\">", page)) == 4


def test_the_scatter_is_large_and_names_laws_by_their_titles(comparison: Comparison) -> None:
    case = comparison.cases[0]
    figure = scatter_figure(case)
    assert figure is not None
    assert min(figure.get_size_inches()) >= 6.0
    titles = [text.get_text() for text in figure.legends[0].get_texts()]
    best_first = sorted(range(len(case)), key=lambda i: float(case.S.S_new[i]))
    assert titles == list(dict.fromkeys(case.designs[i].label.split(",")[0] for i in best_first))


def test_says_what_the_score_is(comparison: Comparison) -> None:
    text = Parsed(make_page(comparison)).text["answer"]
    assert "S is the integral over time of |ey|, the distance of the vehicle’s centre from the lane’s centre" in text
    assert "beyond the line" not in text


def test_one_file_with_all_sections_that_asks_the_network_for_nothing(comparison: Comparison) -> None:
    page = make_page(comparison)
    parsed = Parsed(page)
    assert list(parsed.rows) == [id for id, _ in SECTIONS]
    assert all(address.startswith("#") for address in parsed.addresses)
    assert "http://" not in page
    assert "https://" not in page
    assert page.count("<svg") >= 4  # intervals and scatter, both cases


def test_same_comparison_same_bytes(comparison: Comparison, tmp_path: Path) -> None:
    first = write_compare_page(comparison, tmp_path / "a.html").read_bytes()
    assert write_compare_page(comparison, tmp_path / "b.html").read_bytes() == first


def test_text_of_users_is_text(comparison: Comparison) -> None:
    design = comparison.cases[0].designs[1]
    named = dataclasses.replace(
        comparison,
        old=EVIL,
        new_name=EVIL,
        differences=(f"law: {EVIL} -> {EVIL}",),
        new_failures=(FailedDesign(design, EVIL),),
        warnings=(EVIL,),
    )
    parsed = Parsed(make_page(named))
    assert parsed.scripts == 2
    assert parsed.text["failures"].count(EVIL) == 1
    assert parsed.text["answer"].count(EVIL) == 1


def emptied(comparison: Comparison, **changes: Any) -> Comparison:
    """No design in both studies."""
    nothing = np.zeros(0)
    S = PairedDifferences(nothing, nothing, nothing, nothing, nothing, nothing.astype(int), nothing,
                          nothing.astype(int), ())  # fmt: skip
    cases = tuple(
        dataclasses.replace(case, designs=(), S=S, failed_old=(), failed_new=(), **changes) for case in comparison.cases
    )
    return dataclasses.replace(comparison, cases=cases)


def test_no_design_in_both(comparison: Comparison) -> None:
    parsed = Parsed(make_page(emptied(comparison)))
    assert "no design is in both studies" in parsed.text["designs"]
    assert "No design is in both studies" in parsed.text["scatter"]
    assert "No departure of any design" in parsed.text["changes"]


def test_no_winner_to_compare(comparison: Comparison) -> None:
    without = tuple(dataclasses.replace(case, winners=None) for case in comparison.cases)
    raced = tuple(dataclasses.replace(case, winners=None, raced_elsewhere=True) for case in comparison.cases)
    assert "no winner to compare" in Parsed(make_page(dataclasses.replace(comparison, cases=without))).text["answer"]
    assert "a race of one" in Parsed(make_page(dataclasses.replace(comparison, cases=raced))).text["answer"]


def test_nothing_changed(comparison: Comparison) -> None:
    def same(S: PairedDifferences) -> PairedDifferences:
        zero, none = np.zeros(len(S)), np.full(len(S), np.nan)
        return PairedDifferences(S.S_old, S.S_old, zero, none, none, zero.astype(int), zero, zero.astype(int),
                                 (Verdict.SAME,) * len(S))  # fmt: skip

    cases = tuple(dataclasses.replace(case, S=same(case.S)) for case in comparison.cases)
    unchanged = dataclasses.replace(comparison, cases=cases, differences=())
    parsed = Parsed(make_page(unchanged))
    assert "comes from the code of a law" in parsed.text["differences"]
    assert "too few departures changed" in parsed.text["designs"]
    assert most_changed(cases[0]) == ()


def test_many_designs_stay_light(comparison: Comparison) -> None:
    """5,000 designs: the table without the script is short, and all rows are there for the script."""
    case, k = comparison.cases[0], 5000
    rows = np.arange(k) % len(case)
    S = PairedDifferences(*(getattr(case.S, f.name)[rows] for f in dataclasses.fields(PairedDifferences)[:-1]),
                          verdict=tuple(case.S.verdict[i] for i in rows))  # fmt: skip
    many = dataclasses.replace(
        case,
        designs=tuple(dataclasses.replace(case.designs[i], y_s=0.01 + 1e-5 * n) for n, i in enumerate(rows)),
        S=S,
        failed_old=(0,) * k,
        failed_new=(0,) * k,
    )
    page = make_page(dataclasses.replace(comparison, cases=(many,)))
    assert len(data_of(page)["compare"]["cases"][0]["labels"]) == k
    assert len(Parsed(page).rows["designs"]) == 101
    assert len(page) < 2_000_000


def test_one_side_only(comparison: Comparison) -> None:
    shared = comparison.shared.take(comparison.shared.side > 0)
    assert isinstance(shared, SharedScenarios)
    text = make_page(dataclasses.replace(comparison, shared=shared))
    assert "60 left, 0 right" in text
