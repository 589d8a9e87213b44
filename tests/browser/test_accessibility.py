"""What axe-core finds, and what a keyboard can reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from helpers.looking import faults_of_access

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = (
    "ordinary", "hostile", "zero-triggered", "one-design", "only-no-control", "left-only", "right-only", "one-scenario",
    "all-failures", "nothing-ranked",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
def test_no_serious_violation(open_page: Callable[..., Any], made: Any, axe: str, name: str) -> None:
    assert faults_of_access(open_page(made(name).path), axe) == []


@pytest.mark.parametrize(("width", "dark"), [(1366, False), (390, True)], ids=["light-desk", "dark-hand"])
def test_nor_with_everything_open(open_page: Callable[..., Any], made: Any, axe: str, width: int, dark: bool) -> None:
    page = open_page(made("ordinary").path, width=width, dark=dark)
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    assert faults_of_access(page, axe) == []


def test_axe_finds_what_is_wrong(open_page: Callable[..., Any], made: Any, axe: str) -> None:
    """The check itself: grey on grey, and a field without a name."""
    page = open_page(made("one-design").path)
    page.evaluate(
        """() => { document.querySelector("main p").style.cssText = "color:#999;background:#aaa";
        document.querySelector("main").appendChild(document.createElement("input")); }"""
    )
    found = faults_of_access(page, axe)
    assert any(one.startswith("color-contrast") for one in found)
    assert any(one.startswith("label") for one in found)


def test_a_keyboard_sees_where_it_is(open_page: Callable[..., Any], made: Any) -> None:
    """Tab goes through the page; whatever has the focus is in view and marked."""
    page = open_page(made("ordinary").path)
    seen = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        state = page.evaluate(
            """() => { const e = document.activeElement, box = e.getBoundingClientRect(), style = getComputedStyle(e);
            return { tag: e.tagName, text: (e.getAttribute("aria-label") || e.textContent).trim().slice(0, 40),
              inside: box.bottom > 0 && box.top < innerHeight, size: box.width * box.height,
              marked: e.matches(":focus-visible") && (style.outlineStyle !== "none" || style.boxShadow !== "none" ||
                style.textDecorationLine !== "none" || style.backgroundColor !== "rgba(0, 0, 0, 0)") }; }"""
        )
        if state["tag"] == "BODY":
            break
        assert state["inside"], state
        assert state["marked"], state
        seen.add((state["tag"], state["text"]))
    assert len(seen) >= 15
