"""Every page opens from the disk, alone and in silence, with scripts and without them, and prints."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.reports import SECTIONS

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = (
    "ordinary", "hostile", "thousand", "zero-triggered", "one-design", "only-no-control", "left-only", "right-only",
    "one-scenario", "all-failures", "nothing-ranked",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_opens_in_silence(open_page: Callable[..., Any], made: Any, name: str, script: bool) -> None:
    page = open_page(made(name).path, script=script)
    seen = [section.get_attribute("id") for section in page.locator("main > section").all()]
    assert [one for one in seen if one in SECTIONS] == list(SECTIONS)
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
        assert [one.inner_text() for one in page.locator("button:visible, select:visible, input:visible").all()] == []
        assert page.locator("table:visible").count() >= 2
    words = page.locator("main").inner_text()
    for never in ("undefined", "[object", "NaN", "None of None", "Infinity"):
        assert never not in words


def test_one_address_leads_to_a_section(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    page.get_by_role("navigation", name="Sections").get_by_role("link", name="Confidence").press("Enter")
    heading = page.locator("#confidence h2").bounding_box()
    bar = page.get_by_role("navigation", name="Sections").bounding_box()
    assert bar["y"] + bar["height"] <= heading["y"] < 400  # below the sticky list, not under it


@pytest.mark.parametrize("name", ["ordinary", "hostile", "all-failures", "thousand"])
def test_prints(open_page: Callable[..., Any], made: Any, tmp_path: Path, name: str) -> None:
    page = open_page(made(name).path, dark=True)
    paper = page.pdf(format="A4", prefer_css_page_size=True)
    assert paper.startswith(b"%PDF")
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 6
    page.emulate_media(media="print")
    baseline = page.locator("#designs tbody tr.baseline")
    assert [one.is_visible() for one in baseline.all()] == [True] * baseline.count()
    assert page.locator("#designs tbody tr:visible").count() <= 22
    assert page.locator("#verdict .verdict").is_visible()
    assert page.locator("#limits table").first.is_visible()
    assert not page.get_by_role("navigation", name="Sections").is_visible()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") in (
        "rgb(255, 255, 255)",
        "rgba(0, 0, 0, 0)",
    )
    # no control stands on paper; buttons that are heads are read as text
    controls = page.locator("select:visible, input:visible, button:not(table *):visible")
    assert controls.evaluate_all("(all) => all.map((e) => (e.id || e.localName) + ' ' + e.textContent)") == []
