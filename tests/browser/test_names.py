"""Names that could be markup are text wherever they stand: no dialog opens, nothing is added, nothing is lost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]

EVIL = "<script>alert(1)</script>"


@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_names_are_text(open_page: Callable[..., Any], made: Any, script: bool) -> None:
    page = open_page(made("hostile").path, script=script)
    assert page.locator("script").count() == 2
    assert EVIL in page.get_by_role("heading", level=1).inner_text()
    assert page.title().startswith(f"</script>{EVIL} & \"quoted\" 'x'")
    rows = page.locator("#ranking").get_by_role("region").first.locator("tbody")
    assert rows.inner_text().count(EVIL) >= 6
    assert "</script>&amp;\"'" in rows.inner_text()
    assert page.locator("b b, main img").count() == 0


def test_they_stay_text_when_the_script_shows_them(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("hostile").path)
    page.get_by_role("searchbox", name="Search").fill("word=<script>alert(1)")
    rows = page.locator("#ranking").get_by_role("region").first.locator("tbody tr")
    assert rows.count() >= 2
    rows.first.get_by_role("button").press("Enter")
    details = page.get_by_role("dialog")
    assert EVIL in details.get_by_role("heading").first.inner_text()
    assert EVIL in details.locator("pre").inner_text()
    page.keyboard.press("Escape")
    page.locator("#trade-offs").get_by_role("combobox", name="Horizontal").select_option("S")
    page.locator("#trade-offs").get_by_role("combobox", name="Vertical").select_option("deepest_p95")
    cursor = page.locator("#trade-offs").get_by_role("button", name="open the design")
    cursor.focus()
    cursor.press("End")
    assert page.locator("#trade-offs").inner_text().count(EVIL) >= 1  # in the legend, and where it points
    explorer = page.get_by_role("group", name="Departures explorer")
    boxes = explorer.get_by_role("group", name="Designs, up to four")
    assert EVIL in boxes.inner_text()
    for k in range(boxes.get_by_role("checkbox").count()):
        boxes.get_by_role("checkbox").nth(k).set_checked(True) if k < 4 else None
    assert EVIL in explorer.get_by_role("region", name="Designs on this departure").inner_text()
    assert page.locator("script").count() == 2
