"""The built documentation in a browser: no page scrolls sideways on a phone, and its first pages are accessible."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.cli import ROOT
from helpers.pages import faults_of_access

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SITE = ROOT / "out" / "docs"

# What scrolls with the heading is the page, whether the window or a box of the theme does; tables and code have boxes.
_WIDE = """() => {
  const head = document.querySelector("h1") || document.querySelector("article"), boxes = [];
  for (let e = head; e; e = e.parentElement) boxes.push(e);
  const page = boxes.filter((e) => e.scrollWidth > Math.min(e.clientWidth || 390, 390) + 1);
  if (!page.length) return "";
  const free = (e) => {
    for (e = e.parentElement; e && !boxes.includes(e); e = e.parentElement) {
      if (getComputedStyle(e).overflowX !== "visible") return false;
    }
    return true;
  };
  const wide = [...page[0].querySelectorAll("*")].filter((e) => e.checkVisibility() && !boxes.includes(e) && free(e));
  const [right, e] = wide.map((e) => [e.getBoundingClientRect().right, e]).reduce((a, b) => (b[0] > a[0] ? b : a));
  const told = `${e.localName}.${e.className} "${e.textContent.trim().slice(0, 60)}" to ${Math.round(right)}`;
  return `${page[0].scrollWidth} px: ${told}`;
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


def test_no_page_scrolls_sideways_on_a_phone(visit: Any, site_pages: list[Path]) -> None:
    page, found = visit(390), []
    for path in site_pages:
        page.goto(path.as_uri())
        if wide := page.evaluate(_WIDE):
            found.append(f"{path.relative_to(SITE)}: {wide}")
    assert len(site_pages) > 150
    assert found == []
    # the check itself
    page.goto((SITE / "reference" / "commands.html").as_uri())
    page.evaluate("document.querySelector('article').insertAdjacentHTML('beforeend', '<p style=width:600px>wide</p>')")
    assert '"wide" to' in page.evaluate(_WIDE)


FIRST = (
    "index.html", "tutorial.html", "gallery/index.html", "gallery/driver.html", "reference/index.html",
    "reference/commands.html", "reference/study-file.html", "reference/metrics.html", "reference/laws.html",
)  # fmt: skip


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1366, 390], ids=["desk", "hand"])
def test_first_pages_are_accessible(visit: Any, site_pages: list[Path], axe: str, width: int, dark: bool) -> None:
    page, found = visit(width, dark=dark), []
    for name in FIRST:
        page.goto((SITE / name).as_uri())
        page.wait_for_load_state("load")
        found += [f"{name}: {fault}" for fault in faults_of_access(page, axe)]
    assert found == []


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_pictures_are_seen_once_and_described(visit: Any, site_pages: list[Path], dark: bool) -> None:
    """Light or dark, and with words for those who do not see them."""
    page, seen = visit(1366, dark=dark), 0
    for path in (path for path in site_pages if "<img" in path.read_text(encoding="utf-8")):
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


def test_the_first_screen_shows_what_the_toolkit_does(visit: Any, site_pages: list[Path]) -> None:
    page = visit(1366)
    page.goto((SITE / "index.html").as_uri())
    boxes = [picture.bounding_box() for picture in page.locator("article img:visible").all()]
    assert len(boxes) == 3
    assert max(box["y"] + box["height"] for box in boxes) < 768
    assert page.locator("article .cell_output").first.bounding_box()["y"] < 700  # with its first rows
    assert "lqr" in page.locator("article .cell_output").first.inner_text().lower()
    page.goto((SITE / "gallery" / "index.html").as_uri())
    cards = page.locator(".examples li")
    assert cards.count() == 13
    cards.last.click(position={"x": 40, "y": 40})  # all of a card is its link
    assert page.url.endswith("gallery/openscenario.html")
