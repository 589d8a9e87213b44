"""Everything on one design, opened and closed with the keyboard; its numbers are those of ranking.csv."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from studies import Study
from studies.report.words.text import number

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.mark.parametrize("k", [0, 4, 27])
def test_a_row_opens_its_design(open_page: Callable[..., Any], made: Any, k: int) -> None:
    page, row = open_page(made("ordinary").path), made("ordinary").rows()[k]
    opener = page.locator("#ranking").get_by_role("region").first.locator("tbody tr").nth(k).get_by_role("button")
    opener.focus()
    page.keyboard.press("Enter")
    details = page.get_by_role("dialog")
    text = details.inner_text()
    assert row["design"] in text
    assert row["law"] in text
    assert ("Not ranked" in text or "not ranked" in text.lower()) == (int(row["rank"] or 0) <= 0)
    assert number(float(row["S_m_s"])) in text
    assert f"[{number(float(row['S_low_m_s']))} to {number(float(row['S_high_m_s']))}]" in text
    assert number(100 * float(row["deeper_than_D_y_share"]), 1) in text
    # the focus stays inside until the dialog is closed, then it is where it was
    for _ in range(12):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement === document.body || !!document.activeElement.closest('dialog')")
    page.keyboard.press("Escape")
    assert not details.is_visible()
    assert opener.evaluate("(e) => e === document.activeElement")


def test_its_table_of_a_study_file_makes_it_again(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    for k, row in enumerate(made("ordinary").rows()):
        page.locator("#ranking").get_by_role("region").first.locator("tbody tr").nth(k).get_by_role("button").click()
        text = page.get_by_role("dialog").locator("pre").inner_text()
        assert len(tomllib.loads(text)["design"]) == 1
        (design,) = Study.from_dict({"name": "one", **tomllib.loads(text)}).designs
        assert design.id == row["design"]
        page.get_by_role("dialog").get_by_role("button", name="Close the details").click()


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])
def test_open_details_are_in_order(
    open_page: Callable[..., Any], made: Any, look: ModuleType, axe: str, width: int, height: int, dark: bool
) -> None:
    page = open_page(made("ordinary").path, width=width, height=height, dark=dark)
    page.locator("#ranking").get_by_role("region").first.locator("tbody tr").first.get_by_role("button").click()
    assert look.faults_of_access(page, axe) == []
    box = page.get_by_role("dialog").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= height
    assert page.get_by_role("dialog").evaluate("(e) => e.scrollWidth - e.clientWidth") <= 0
