# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The page of an extraction: whole, its verdict first, right about every number, for every kind of extraction."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from helpers.extractions import make_extraction
from helpers.pages import EVIL, Page, whole
from helpers.recordings import drive
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings import Extraction, SourceFile, extract_departures
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.quality import Origin
from ldctoolkit.recordings.recording import Problem
from studies.pages.extraction_page import extraction_page, extraction_verdict, hours, rate, size, write_extraction_page

SECTIONS = ["verdict", "read", "sides", "refusals", "parameters", "widths", "deepest", "random"]


def parsed(extraction: Extraction) -> Page:
    page = Page(extraction_page(extraction))
    whole(page)
    assert [section for section in page.text if section] == SECTIONS
    return page


@pytest.fixture(scope="module")
def three() -> Extraction:
    return make_extraction(3, (30, 20), labels=True)


@pytest.fixture(scope="module")
def page(three: Extraction) -> Page:
    return parsed(three)


def test_the_verdict_says_what_the_departures_are_enough_for(page: Page) -> None:
    assert page.words("verdict").startswith(
        "Verdict Enough to compare designs on the recorded departures; too few for a model (60 right;"
    )
    assert extraction_verdict(0, 0).startswith("No departures were found")
    assert extraction_verdict(400, 12) == "Too few departures for a model of both sides (12 right; 30 a side at least)."
    assert extraction_verdict(200, 300).startswith("Good enough for a scenario model and mean S of designs; too few")
    assert extraction_verdict(1000, 2000).startswith("Good enough for a scenario model, and for the worst 5 %")


def test_every_row_holds_the_numbers_of_its_account(three: Extraction, page: Page) -> None:
    rows = page.captioned("By source")[1:]
    assert [row[0] for row in rows] == ["D1", "D2", "D3", "All"]
    for row, account in zip(rows, three.accounts, strict=False):
        assert row[1:8] == ["4", "2.00", "1.67", "30", "20", "18.0", "12.0"]
        assert row[8] == str(int(account.refused.sum()))
    assert rows[3][:6] == ["All", "12", "6.00", "5.00", "90", "60"]
    assert int(rows[3][8]) == three.refused.total


def test_the_first_numbers_are_those_of_all_accounts(three: Extraction, page: Page) -> None:
    refused = sum(account.refused.sum(axis=0) for account in three.accounts)
    most = REASONS[int(np.argmax(refused))].replace("_", " ")
    candidates = 150 + int(refused.sum())
    words = page.words("verdict")
    assert "5.00 h of 6.00 h read are valid (83 %)" in words
    assert f"{refused.sum():,} of {candidates:,} candidates were refused, most often: {most}." in words
    assert "12 recordings, 216,000 samples, 180,000 of them valid" in page.words("read")


def test_reasons_are_counted_by_source_and_side() -> None:
    extraction = make_extraction(2)
    found = parsed(extraction)
    table = found.captioned(f"{extraction.refused.total} of {extraction.candidates} candidates refused, by reason")
    by_reason = {row[0].replace(" ", "_"): row[2:] for row in table[1:]}
    assert list(by_reason) == [reason for reason, count in extraction.refused.items() if count]
    for reason, (left, right, share) in by_reason.items():
        count = getattr(extraction.refused, reason)
        assert int(left) + int(right) == count
        assert float(share) == pytest.approx(100 * count / extraction.candidates, abs=0.051)


def test_nothing_refused_and_nothing_read() -> None:
    one = make_extraction(1)
    nothing = dataclasses.replace(one.accounts[0], refused=np.zeros_like(one.accounts[0].refused))
    assert "No candidate was refused" in parsed(dataclasses.replace(one, accounts=(nothing,))).text["refusals"]
    assert "Nothing was read from these recordings." in parsed(extract_departures([])).words("sides")


def test_groups_by_label() -> None:
    """Six drivers, three behaviours; one more source without labels."""
    extraction = make_extraction(6, (30, 20), labels=True)
    bare = dataclasses.replace(extraction.accounts[0], origin=Origin("D9"))
    found = parsed(dataclasses.replace(extraction, accounts=(*extraction.accounts, bare)))
    rows = found.captioned("By behaviour")[1:]
    assert [row[0] for row in rows] == ["aggressive", "drowsy", "normal", "not known"]
    assert [row[4] for row in rows] == ["60", "60", "60", "30"]


def test_parameters_are_those_of_the_departures(three: Extraction, page: Page) -> None:
    rows = {row[0]: row[1:] for row in page.captioned("Parameters in numbers")[1:]}
    left = three.departures.T[three.departures.side == 1]
    assert [float(cell) for cell in rows["T [s]: duration"][:3]] == pytest.approx(
        np.quantile(left, (0.05, 0.5, 0.95)), rel=6e-3
    )
    medians = {row[0]: row for row in page.captioned("Medians of both sides")[1:]}
    assert medians["D2"][1] == "50"


def test_a_curvature_of_zero_everywhere_is_no_curvature(three: Extraction) -> None:
    """It was called recorded by the source."""
    measured = dataclasses.replace(three, provenance=dataclasses.replace(three.provenance, curvature="measured"))
    assert "recorded by the source" in parsed(measured).words("read")
    zero = np.zeros(three.departures.n)
    flat = dataclasses.replace(measured, departures=dataclasses.replace(three.departures, c_0=zero, dc=zero))
    words = parsed(flat).words("read")
    assert "0 in every departure: the source gives no curvature" in words
    assert "recorded by the source" not in words


def test_problems_and_warnings_are_counted_and_text() -> None:
    one = make_extraction(1)
    problems = tuple(Problem(f"f{i}.csv", f"line {i}", EVIL) for i in range(400))
    many = dataclasses.replace(one.provenance, warnings=tuple(f"{EVIL} {i}" for i in range(70)))
    found = parsed(dataclasses.replace(one, problems=problems, provenance=many))
    assert "the first 300 of 400" in found.words("verdict")
    assert "and 10 more warnings" in found.words("verdict")
    assert "<script>alert(1)" not in found.html
    assert "No problems: every file was read whole." in parsed(dataclasses.replace(one, problems=())).words("verdict")


def test_files_are_listed() -> None:
    one = make_extraction(1)
    files = tuple(SourceFile(f"a{i}.csv", 1500 * (i + 1), f"{i:064d}") for i in range(3))
    given = dataclasses.replace(one, provenance=dataclasses.replace(one.provenance, sources=files))
    assert ["a1.csv", "3.0 kB", "000000000000"] in parsed(given).filled("read")[0]


def test_single_departures_are_drawn(page: Page) -> None:
    assert sum("samples and fit" in one for one in page.images) == 2 * 2 * 4 * 3
    assert "d_y" not in page.words("deepest")
    assert "dy = " in page.words("deepest")


def test_one_real_drive(tmp_path: Path) -> None:
    extraction = extract_departures([drive()])
    path = write_extraction_page(tmp_path / "q.html", extraction)
    whole(Page(path.read_text(encoding="utf-8")))
    assert path.read_bytes() == write_extraction_page(tmp_path / "r.html", extraction).read_bytes()
    with pytest.raises(StoreError):
        write_extraction_page(tmp_path / "no" / "q.html", extraction)


def test_numbers_of_any_size() -> None:
    assert [size(n) for n in (999, 1000, 99_950, 1_500_000, 10**15)] == [
        "999 B",
        "1.0 kB",
        "100 kB",
        "1.5 MB",
        "1000 TB",
    ]
    assert [rate(x) for x in (0.05, 2.345, 12.34, 123.4, float("nan"))] == ["0.050", "2.35", "12.3", "123", "–"]
    assert [hours(x) for x in (1.234, 12.34, 1234.5)] == ["1.23", "12.3", "1,234"]
