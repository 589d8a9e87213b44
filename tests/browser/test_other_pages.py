"""The page of a comparison and the page of a fit: silent, in order, open to all, printable."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from helpers.looking import faults_of_access, faults_of_layout

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = pytest.mark.parametrize("name", ["compare", "fit"])
SIZES = pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])


@PAGES
@SIZES
def test_nothing_overlaps(open_page: Callable[..., Any], made: Any, name: str, width: int, height: int) -> None:
    assert faults_of_layout(open_page(made(name).path, width=width, height=height)) == []


@PAGES
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_serious_violation(open_page: Callable[..., Any], made: Any, axe: str, name: str, dark: bool) -> None:
    page = open_page(made(name).path, dark=dark)
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    assert faults_of_access(page, axe) == []


@PAGES
def test_reads_without_script(open_page: Callable[..., Any], made: Any, name: str) -> None:
    page = open_page(made(name).path, script=False)
    assert page.locator("table:visible").count() >= 1
    assert [one.inner_text() for one in page.locator("button:visible, select:visible, input:visible").all()] == []
    assert faults_of_layout(page) == []


@PAGES
def test_prints(open_page: Callable[..., Any], made: Any, name: str) -> None:
    page = open_page(made(name).path)
    paper = page.pdf(format="A4")
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 6


def test_verdicts_are_sorted_and_searched(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("compare").path)
    every = page.locator("#designs-1 tbody tr").count()
    page.locator("#designs [data-table=designs-1] input").fill("difference>0")
    shown = page.locator("#designs-1 tbody tr:visible").evaluate_all(
        "(rows) => rows.map((r) => Number(r.cells[4].dataset.v))"
    )
    assert 0 < len(shown) <= every
    assert min(shown) > 0
    assert "lag" in page.locator("#differences").inner_text()
