# ruff: noqa: RUF001 - the page shows dashes
"""Everything on one design, opened and closed with the keyboard; its numbers are those of ranking.csv."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import Any

import pytest

from helpers.looking import faults_of_access
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


def test_what_a_design_does_not_have_is_a_dash(open_page: Callable[..., Any], made: Any) -> None:
    page, rows = open_page(made("ordinary").path), made("ordinary").rows()
    body = page.locator("#ranking").get_by_role("region").first.locator("tbody tr")

    def said(k: int) -> dict[str, str]:
        """Figure -> text of this design."""
        body.nth(k).get_by_role("button").click()
        details = page.get_by_role("dialog")
        lines = details.get_by_role("region", name="Figures").locator("tbody tr:not(.group)")
        found = dict(lines.evaluate_all("(all) => all.map((r) => [r.cells[0].innerText, r.cells[1].innerText])"))
        found["kind"] = details.locator(".kind").inner_text().lower()
        page.keyboard.press("Escape")
        return found

    idle = said(next(k for k, row in enumerate(rows) if row["law"] == "none"))
    for title in ("Taken over", "Needless interventions", "Back inside"):
        assert idle[title] == "–"
    assert not any("–\u00a0%" in text for text in idle.values())
    first = said(0)
    assert "%" in first["Taken over"]
    ranked = sum(int(row["rank"] or 0) > 0 for row in rows)
    assert 0 < ranked < len(rows)
    assert first["kind"] == f"rank 1 of {ranked} ranked designs"


def test_the_explorer_is_offered_where_it_holds_paths(open_page: Callable[..., Any], made: Any) -> None:
    page, rows = open_page(made("ordinary").path), made("ordinary").rows()
    held = page.evaluate("LDC.data('departures').designs.map((one) => one.place)")
    assert 0 < len(held) < len(rows)
    details = page.get_by_role("dialog")
    for k in (held[0], next(k for k in range(len(rows)) if k not in held)):
        page.locator("#ranking").get_by_role("region").first.locator("tbody tr").nth(k).get_by_role("button").click()
        assert details.get_by_role("button", name="Show in departures").is_enabled() == (k in held)
        assert (f"ldc report DIR --design {rows[k]['design']}" in details.inner_text()) == (k not in held)
        page.keyboard.press("Escape")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])
def test_open_details_are_in_order(
    open_page: Callable[..., Any], made: Any, axe: str, width: int, height: int, dark: bool
) -> None:
    page = open_page(made("ordinary").path, width=width, height=height, dark=dark)
    page.locator("#ranking").get_by_role("region").first.locator("tbody tr").first.get_by_role("button").click()
    assert faults_of_access(page, axe) == []
    box = page.get_by_role("dialog").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= height
    assert page.get_by_role("dialog").evaluate("(e) => e.scrollWidth - e.clientWidth") <= 0
