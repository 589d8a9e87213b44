"""Every page in a browser: it opens, lies right at all widths, is accessible and light."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.pages import faults_of_access, faults_of_layout
from helpers.results import SECTIONS

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = (
    "ordinary", "hostile", "thousand", "zero-triggered", "one-design", "only-no-control", "left-only", "right-only",
    "one-scenario", "all-failures", "nothing-ranked", "planning", "driver",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_opens_in_silence(open_page: Callable[..., Any], built: Any, name: str, script: bool) -> None:
    page = open_page(built(name).path, script=script)
    seen = [section.get_attribute("id") for section in page.locator("main > section").all()]
    assert [id for id in seen if id in SECTIONS] == list(SECTIONS)
    for section in page.locator("main > section").all():
        assert section.locator("h2").first.is_visible()
        assert len(section.inner_text().split()) > 5
    # links of the page lead to something
    for link in page.locator("a[href]").all():
        target = link.get_attribute("href")
        assert target.startswith("#")
        assert page.locator(f'[id="{target[1:]}"]').count() == 1
    visible = page.locator(".script-only:visible").count()
    if script:
        assert page.locator(".script-only").count() == 0 or visible > 0
    else:
        assert visible == 0
        # nothing that does nothing
        assert [
            control.inner_text() for control in page.locator("button:visible, select:visible, input:visible").all()
        ] == []
        assert page.locator("table:visible").count() >= 2
    words = page.locator("main").inner_text()
    for never in ("undefined", "[object", "NaN", "None of None", "Infinity"):
        assert never not in words


def test_no_script_runs_but_the_pages_own(browser: Any, built: Any, tmp_path: Path) -> None:
    original = built("one-design").path.read_text(encoding="utf-8")
    planted = original.replace("</main>", '<script>document.title = "planted"</script></main>', 1)
    titles = []
    for text in (planted, planted.replace("Content-Security-Policy", "other")):
        (tmp_path / "page.html").write_text(text, encoding="utf-8")
        page = browser.new_page()
        page.goto((tmp_path / "page.html").as_uri())
        titles.append(page.title())
        assert page.locator(".script-only:visible").count() > 0  # its own does
        page.close()
    assert titles[0] != "planted"
    assert titles[1] == "planted"


def test_one_address_leads_to_a_section(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
    page.get_by_role("navigation", name="Sections").get_by_role("link", name="Confidence").press("Enter")
    heading = page.locator("#confidence h2").bounding_box()
    bar = page.get_by_role("navigation", name="Sections").bounding_box()
    assert bar["y"] + bar["height"] <= heading["y"] < 400  # below the sticky list, not under it


@pytest.mark.parametrize("name", ["ordinary", "driver", "hostile", "all-failures", "thousand"])
def test_prints(open_page: Callable[..., Any], built: Any, tmp_path: Path, name: str) -> None:
    page = open_page(built(name).path, dark=True)
    paper = page.pdf(format="A4", prefer_css_page_size=True)
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 6
    page.emulate_media(media="print")
    baseline = page.locator("#designs tbody tr.baseline")
    assert [row.is_visible() for row in baseline.all()] == [True] * baseline.count()
    assert page.locator("#designs tbody tr:visible").count() <= 22
    assert page.locator("#verdict .verdict").is_visible()
    assert page.locator("#limits table").first.is_visible()
    for part in ("#trade-offs svg.chart", "#confidence svg.chart"):
        assert [chart.is_visible() for chart in page.locator(part).all()] == [True] * page.locator(part).count()
    assert page.locator("#trade-offs h2").is_visible()
    assert page.locator("#confidence h2").is_visible()
    assert not page.locator("#landscape h2").is_visible()
    assert not page.get_by_role("navigation", name="Sections").is_visible()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") in (
        "rgb(255, 255, 255)",
        "rgba(0, 0, 0, 0)",
    )
    # no control stands on paper; buttons that are heads are read as text
    controls = page.locator("select:visible, input:visible, button:not(table *):visible")
    assert controls.evaluate_all("(all) => all.map((e) => (e.id || e.localName) + ' ' + e.textContent)") == []


SIZES = pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])
PAGES_LAYOUT = (
    "ordinary", "hostile", "thousand", "zero-triggered", "one-design", "planning", "only-no-control", "left-only",
    "one-scenario", "all-failures", "nothing-ranked",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES_LAYOUT)
@SIZES
def test_nothing_overlaps(open_page: Callable[..., Any], built: Any, name: str, width: int, height: int) -> None:
    page = open_page(built(name).path, width=width, height=height)
    assert faults_of_layout(page) == []


@SIZES
def test_nor_without_script(open_page: Callable[..., Any], built: Any, width: int, height: int) -> None:
    page = open_page(built("ordinary").path, width=width, height=height, script=False)
    assert faults_of_layout(page) == []


@SIZES
def test_nor_in_the_dark_with_everything_open(
    open_page: Callable[..., Any], built: Any, width: int, height: int
) -> None:
    page = open_page(built("ordinary").path, width=width, height=height, dark=True)
    page.evaluate("document.querySelectorAll('main details').forEach((element) => { element.open = true; })")
    assert faults_of_layout(page) == []


def test_a_picture_of_the_first_screen_is_no_blank(open_page: Callable[..., Any], built: Any) -> None:
    light = open_page(built("ordinary").path).screenshot()
    dark = open_page(built("ordinary").path, dark=True).screenshot()
    assert min(len(light), len(dark)) > 20_000
    assert light != dark


PAGES_ACCESSIBILITY = (
    "ordinary", "hostile", "zero-triggered", "one-design", "planning", "only-no-control", "left-only", "right-only",
    "one-scenario", "all-failures", "nothing-ranked",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES_ACCESSIBILITY)
def test_no_serious_violation(open_page: Callable[..., Any], built: Any, axe: str, name: str) -> None:
    assert faults_of_access(open_page(built(name).path), axe) == []


@pytest.mark.parametrize(("width", "dark"), [(1366, False), (390, True)], ids=["light-desk", "dark-hand"])
def test_nor_with_everything_open(open_page: Callable[..., Any], built: Any, axe: str, width: int, dark: bool) -> None:
    page = open_page(built("ordinary").path, width=width, dark=dark)
    page.evaluate("document.querySelectorAll('main details').forEach((element) => { element.open = true; })")
    assert faults_of_access(page, axe) == []


def test_axe_finds_what_is_wrong(open_page: Callable[..., Any], built: Any, axe: str) -> None:
    """The check itself: grey on grey, and a field without a name."""
    page = open_page(built("one-design").path)
    page.evaluate(
        """() => { document.querySelector("main p").style.cssText = "color:#999;background:#aaa";
        document.querySelector("main").appendChild(document.createElement("input")); }"""
    )
    faults = faults_of_access(page, axe)
    assert any(fault.startswith("color-contrast") for fault in faults)
    assert any(fault.startswith("label") for fault in faults)


def test_a_keyboard_sees_where_it_is(open_page: Callable[..., Any], built: Any) -> None:
    """Tab goes through the page; whatever has the focus is in view and marked."""
    page = open_page(built("ordinary").path)
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


PAGES_OTHER_PAGES = pytest.mark.parametrize("name", ["compare", "fit", "paper"])


@PAGES_OTHER_PAGES
@SIZES
def test_nothing_overlaps_other_pages(
    open_page: Callable[..., Any], built: Any, name: str, width: int, height: int
) -> None:
    assert faults_of_layout(open_page(built(name).path, width=width, height=height)) == []


@PAGES_OTHER_PAGES
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_serious_violation_other_pages(
    open_page: Callable[..., Any], built: Any, axe: str, name: str, dark: bool
) -> None:
    page = open_page(built(name).path, dark=dark)
    page.evaluate("document.querySelectorAll('main details').forEach((element) => { element.open = true; })")
    assert faults_of_access(page, axe) == []


@PAGES_OTHER_PAGES
def test_reads_without_script(open_page: Callable[..., Any], built: Any, name: str) -> None:
    page = open_page(built(name).path, script=False)
    assert page.locator("table:visible").count() >= 1
    assert [
        control.inner_text() for control in page.locator("button:visible, select:visible, input:visible").all()
    ] == []
    assert faults_of_layout(page) == []


@PAGES_OTHER_PAGES
def test_prints_other_pages(open_page: Callable[..., Any], built: Any, name: str) -> None:
    page = open_page(built(name).path)
    paper = page.pdf(format="A4")
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 6


def test_verdicts_are_sorted_and_searched(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("compare").path)
    every = page.locator("#designs-1 tbody tr").count()
    page.locator("#designs [data-table=designs-1] input").fill("difference>0")
    shown = page.locator("#designs-1 tbody tr:visible").evaluate_all(
        "(rows) => rows.map((r) => Number(r.cells[4].dataset.v))"
    )
    assert 0 < len(shown) <= every
    assert min(shown) > 0
    assert "lag" in page.locator("#differences").inner_text()


def test_a_thousand_designs_weigh_less_than_3_MB(built: Any) -> None:
    page: Path = built("thousand").path
    assert page.stat().st_size < 3_000_000
    assert page.stat().st_size > 400_000  # all of them are in it


def test_same_bytes_whatever_the_hash_salt(built: Any) -> None:
    folder: Path = built("ordinary").folder
    pages = []
    for salt in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": salt, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-m", "ldctoolkit", "report", str(folder), "--no-figures"]
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=300)
        pages.append((folder / "report.html").read_bytes())
    assert pages[0] == pages[1]
