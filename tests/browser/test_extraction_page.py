"""The quality report of an extraction: silent, in order, open to all, printable, light and dark, desk and hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.extractions import make_extraction
from helpers.looking import faults_of_access, faults_of_layout
from ldctoolkit.recordings.recording import Problem
from studies.pages.extraction_page import write_extraction_page

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = pytest.mark.parametrize("name", ["one", "six", "fifty", "left-only", "nothing-found", "nothing-read"])

PROBLEMS = tuple(
    Problem(f"D1/20151110175712-16km-D1-NORMAL{k}-SECONDARY/RAW_GPS.txt", f"line {17 * k}", "the time runs backwards")
    for k in range(1, 30)
)
WARNINGS = (
    "the yaw rate turns against the GPS heading (correlation -0.93): it is positive to the right; give "
    "--yaw-rate-factor -1, or all curvatures have the wrong sign",
)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Pages by name, each made when it is first asked for."""
    root = tmp_path_factory.mktemp("extraction_pages")
    makers = {
        "one": lambda: make_extraction(1, (300, 200), problems=PROBLEMS, warnings=WARNINGS),
        "six": lambda: make_extraction(6, (60, 40), labels=True, problems=PROBLEMS[:3], warnings=WARNINGS),
        "fifty": lambda: make_extraction(50, (40, 30), labels=True, dt=0.02),
        "left-only": lambda: make_extraction(1, (7, 0)),
        "nothing-found": lambda: make_extraction(2, (0, 0)),
        "nothing-read": lambda: make_extraction(0, (0, 0), problems=PROBLEMS),
    }

    def page(name: str) -> Path:
        target = root / f"{name}.html"
        return target if target.exists() else write_extraction_page(target, makers[name]())

    return page


def opened(page: Any) -> Any:
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    return page


@PAGES
@pytest.mark.parametrize(
    ("width", "height", "dark"), [(1366, 768, False), (390, 844, True)], ids=["light-desk", "dark-hand"]
)
def test_nothing_overlaps_and_everybody_can_read_it(
    open_page: Callable[..., Any],
    pages: Callable[[str], Path],
    axe: str,
    name: str,
    width: int,
    height: int,
    dark: bool,
) -> None:
    page = opened(open_page(pages(name), width=width, height=height, dark=dark))
    assert faults_of_layout(page) == []
    assert faults_of_access(page, axe) == []


@PAGES
def test_reads_without_script(open_page: Callable[..., Any], pages: Callable[[str], Path], name: str) -> None:
    page = open_page(pages(name), script=False)
    for section in page.locator("main > section").all():
        assert section.locator("h2").first.is_visible()
        assert len(section.inner_text().split()) > 4
    for link in page.locator("a[href]").all():
        assert page.locator(f'[id="{link.get_attribute("href")[1:]}"]').count() == 1
    assert page.locator("button, select, input, script").count() == 0
    assert faults_of_layout(page) == []


def test_drawings_are_seen_in_the_dark(open_page: Callable[..., Any], pages: Callable[[str], Path]) -> None:
    """Curves, fits and text have other colours than what they stand on."""
    for dark in (False, True):
        page = open_page(pages("one"), dark=dark)
        ground = page.evaluate("getComputedStyle(document.documentElement).backgroundColor")
        seen = [
            page.locator(f"#{place}").first.evaluate(f"(e) => getComputedStyle(e)['{how}']")
            for place, how in (
                ("deepest .mark", "stroke"),
                ("deepest .curve.recorded", "stroke"),
                ("deepest .chart text", "fill"),
                ("parameters .bar.c0", "fill"),
                ("parameters .bar.c1", "fill"),
            )
        ]
        assert not {ground, "none"} & set(seen)
        assert len(set(seen[1:])) == 4
        levels = [sum(map(int, re.findall(r"\d+", color)[:3])) for color in (ground, seen[2])]
        assert (levels[0] < levels[1]) == dark


def test_drawings_have_room(open_page: Callable[..., Any], pages: Callable[[str], Path]) -> None:
    for width in (1366, 390):
        page = open_page(pages("one"), width=width)
        for box in page.locator("svg.chart").evaluate_all("(all) => all.map((e) => [e.clientWidth, e.clientHeight])"):
            assert box[0] >= 240
            assert box[1] >= 100
        letters = page.locator("svg.chart text").evaluate_all(
            "(all) => all.map((e) => parseFloat(getComputedStyle(e).fontSize) * e.getScreenCTM().a)"
        )
        assert min(size for size in letters if size) >= 9.0  # closed details have none


@pytest.mark.parametrize("name", ["one", "fifty"])
def test_prints(open_page: Callable[..., Any], pages: Callable[[str], Path], name: str) -> None:
    page = open_page(pages(name), dark=True)
    paper = page.pdf(format="A4")
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 30
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 718, "height": 1000})  # A4 with margins of 1 cm
    assert page.evaluate("document.documentElement.scrollWidth") <= 718
    assert not page.get_by_role("navigation", name="Sections").is_visible()
