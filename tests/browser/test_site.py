"""The built documentation in a browser: no page scrolls sideways on a phone, and its first pages are accessible."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.cli import ROOT
from helpers.pages import faults_of_access

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SITE = ROOT / "out" / "docs"

_WIDE = """() => {
  const over = document.scrollingElement.scrollWidth;
  if (over <= 390) return "";
  const wide = [...document.querySelectorAll("body *")].map((e) => [e.getBoundingClientRect().right, e]);
  const [right, e] = wide.filter(([right, e]) => e.checkVisibility()).reduce((a, b) => (b[0] > a[0] ? b : a));
  return `${over} px: ${e.localName}.${e.className} "${e.textContent.trim().slice(0, 60)}" to ${Math.round(right)}`;
}"""


@pytest.fixture
def visit(browser: Any) -> Iterator[Any]:
    """Open pages of one size and colour scheme, one after the other."""
    opened = []

    def visited(width: int, *, dark: bool = False) -> Any:
        scheme = "dark" if dark else "light"
        opened.append(browser.new_context(viewport={"width": width, "height": 844}, color_scheme=scheme))
        return opened[-1].new_page()

    yield visited
    for context in opened:
        context.close()


def test_no_page_scrolls_sideways_on_a_phone(visit: Any, pages: list[Path]) -> None:
    page, found = visit(390), []
    for path in pages:
        page.goto(path.as_uri())
        if wide := page.evaluate(_WIDE):
            found.append(f"{path.relative_to(SITE)}: {wide}")
    assert len(pages) > 150
    assert found == []


FIRST = (
    "index.html", "tutorial.html", "gallery/index.html", "gallery/driver.html", "reference/index.html",
    "reference/commands.html", "reference/study-file.html", "reference/metrics.html", "reference/laws.html",
)  # fmt: skip


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1366, 390], ids=["desk", "hand"])
def test_first_pages_are_accessible(visit: Any, pages: list[Path], axe: str, width: int, dark: bool) -> None:
    page, found = visit(width, dark=dark), []
    for name in FIRST:
        page.goto((SITE / name).as_uri())
        page.wait_for_load_state("load")
        found += [f"{name}: {fault}" for fault in faults_of_access(page, axe)]
    assert found == []


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_pictures_are_seen_once_and_described(visit: Any, pages: list[Path], dark: bool) -> None:
    """Light or dark, and with words for those who do not see them."""
    page, seen = visit(1366, dark=dark), 0
    for path in pages:
        page.goto(path.as_uri())
        pictures = page.locator("article img:visible").evaluate_all(
            "(all) => all.map((e) => [e.classList.contains('only-dark'), e.getAttribute('alt') || '', e.naturalWidth])"
        )
        for of_the_dark, words, width in pictures:
            assert of_the_dark == dark, path
            assert len(words.split()) > 4, (path, words)
            assert width > 100, (path, words)
        seen += len(pictures)
    assert seen >= 3 + 13 + 14  # first page, cards, figures


def test_the_first_screen_shows_what_the_toolkit_does(visit: Any, pages: list[Path]) -> None:
    page = visit(1366)
    page.goto((SITE / "index.html").as_uri())
    boxes = [picture.bounding_box() for picture in page.locator("article img:visible").all()]
    assert len(boxes) == 3
    assert max(box["y"] + box["height"] for box in boxes) < 768
    assert page.locator("article .cell_input").first.bounding_box()["y"] < 768
    assert "lqr" in page.locator("article .cell_output").first.inner_text().lower()
    page.goto((SITE / "gallery" / "index.html").as_uri())
    cards = page.locator(".examples li")
    assert cards.count() == 13
    cards.last.click(position={"x": 40, "y": 40})  # all of a card is its link
    assert page.url.endswith("gallery/openscenario.html")
