"""The report in a browser: the first screen, the table of designs, the departures explorer, text of users."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]

EVIL = "<script>alert(1)</script>"
NUMBER = "(row) => Number(row.cells[{}].dataset.v)"


def shown(page: Any) -> list[list[str]]:
    """Cells of the rows that are in view, in their order."""
    rows: list[list[str]] = page.locator("#designs tbody tr:visible").evaluate_all(
        "(rows) => rows.map((row) => [...row.cells].map((cell) => cell.textContent))"
    )
    return rows


# ------------------------------------------------------------------------------------------------ first screen


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])
def test_the_first_screen_has_the_verdict_and_the_lights(
    open_page: Callable[..., Any], made: Any, width: int, height: int
) -> None:
    page = open_page(made("ordinary").path, width=width, height=height)
    for part in ("#verdict .verdict", "#verdict .lights li:nth-child(1)", "#verdict .lights li:nth-child(3)"):
        box = page.locator(part).bounding_box()
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= height
    if width > 1000:
        chart = page.locator("#verdict svg.chart").bounding_box()
        assert chart["y"] + 0.9 * chart["height"] <= height


def test_text_in_charts_is_large_enough_on_a_phone(open_page: Callable[..., Any], made: Any) -> None:
    """It was 5.6 px high."""
    page = open_page(made("ordinary").path, width=390, height=844)
    sizes = page.evaluate(
        """() => [...document.querySelectorAll("svg.chart")].filter((svg) => svg.clientWidth).map((svg) =>
        parseFloat(getComputedStyle(svg).fontSize) * svg.clientWidth / svg.viewBox.baseVal.width)"""
    )
    assert min(sizes) >= 9.5


def test_charts_are_dark_in_the_dark(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path, dark=True)
    colours = page.evaluate(
        """() => [getComputedStyle(document.documentElement).backgroundColor,
        getComputedStyle(document.querySelector("#verdict svg.chart text")).fill]"""
    )
    back, ink = ([int(part) for part in colour[4:-1].split(",")] for colour in colours)
    assert max(back) < 60
    assert min(ink) > 150
    assert page.locator("svg.chart rect[fill='#fff']").count() == 0


def test_the_first_link_skips_to_the_content(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    assert page.evaluate("location.hash") == "#main"


# ------------------------------------------------------------------------------------------------ the table


def test_a_heading_sorts(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    page.get_by_role("button", name="Show all").click()
    every = len(shown(page))
    assert every == len(made("ordinary").rows())
    for title, column in (("Mean S", 4), ("ay p95", 7)):
        head = page.locator("#designs thead th", has_text=title.removeprefix("ay ")).nth(0)
        for order in ("ascending", "descending"):
            head.get_by_role("button").click()
            assert head.get_attribute("aria-sort") == order
            values = page.locator("#designs tbody tr").evaluate_all(f"(rows) => rows.map({NUMBER.format(column)})")
            known = [value for value in values if value == value]
            assert known == sorted(known, reverse=order == "descending")
            assert values[: len(known)] == known  # what is no number stands last
    assert len(shown(page)) == every


def test_the_search_takes_text_and_comparisons(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    rows = made("ordinary").rows()
    search, hint = page.get_by_role("searchbox", name="Search designs"), page.locator("#ranking .hint")
    first = len(shown(page))
    search.fill("lqr")
    assert len(shown(page)) == sum(row["law"] == "lqr" for row in rows)
    values = sorted(float(row["S_m_s"]) for row in rows)
    limit = 0.5 * (values[3] + values[4])
    search.fill(f"S<{limit:.6f}")
    assert len(shown(page)) == 4
    assert hint.inner_text() == f"4 of {len(rows)} rows"
    search.fill(f"S < {limit:.6f} lqr")
    assert all(row[1] == "LQR" for row in shown(page))
    search.fill("T<0.6")
    assert "no column t: compare" in hint.inner_text()
    search.fill("")
    assert len(shown(page)) == first


def test_a_thousand_designs_are_asked_for(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("thousand").path)
    assert len(shown(page)) < 25
    assert any("baseline" in row[-1] for row in shown(page))
    more = page.get_by_role("button", name="Show all 1,000")
    more.click()
    assert more.get_attribute("aria-pressed") == "true"
    assert len(shown(page)) == 1000


def test_no_button_shows_all_where_all_are_shown(open_page: Callable[..., Any], made: Any) -> None:
    assert open_page(made("left-only").path).get_by_role("button", name="Show all").count() == 0


# ------------------------------------------------------------------------------------------------ the explorer


def test_departures_are_drawn_and_chosen(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path)
    choice = page.get_by_role("combobox", name="Departure")
    assert page.locator("#paths svg").count() == 3
    before = page.locator("#paths").inner_html()
    page.get_by_role("button", name="Next").click()
    assert choice.input_value() == "1"
    assert page.locator("#paths").inner_html() != before
    page.get_by_role("button", name="Previous").click()
    page.get_by_role("button", name="Previous").click()
    assert int(choice.input_value()) == choice.locator("option").count() - 1
    boxes = page.locator("#departure-table input")
    curves = page.locator("#paths .panel").first.locator(".curve").count()
    boxes.nth(0).uncheck()
    assert page.locator("#paths .panel").first.locator(".curve").count() == curves - 1
    assert page.evaluate("document.activeElement.type") == "checkbox"


def test_paths_lie_inside_their_charts(open_page: Callable[..., Any], made: Any) -> None:
    """The default axis cut the winner's acceleration."""
    page = open_page(made("ordinary").path)
    for k in range(0, page.locator("#departure option").count(), 7):
        page.get_by_role("combobox", name="Departure").select_option(str(k))
        beyond = page.evaluate(
            """() => [...document.querySelectorAll("#paths svg")].flatMap((svg) => [...svg.querySelectorAll(".curve")]
            .map((one) => one.getBBox()).filter((box) => box.y < 7 || box.y + box.height > 179 || box.x < 51))"""
        )
        assert beyond == []


# ------------------------------------------------------------------------------------------------ text of users


@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_names_are_text(open_page: Callable[..., Any], made: Any, script: bool) -> None:
    page = open_page(made("hostile").path, script=script)
    assert page.locator("script").count() == 2
    assert EVIL in page.get_by_role("heading", level=1).inner_text()
    assert page.title().startswith(f"</script>{EVIL} & \"quoted\" 'x'")
    assert page.locator("#designs tbody").inner_text().count(EVIL) >= 6
    assert page.locator("b b, main img").count() == 0
    if script:
        page.get_by_role("searchbox", name="Search designs").fill("<script>alert(1)")
        assert len(shown(page)) >= 2
