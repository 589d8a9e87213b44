"""Report and extraction page in a browser."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from helpers.pages import faults_of_access, faults_of_layout
from helpers.recordings import make_extraction
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.studies.pages.extraction_page import write_extraction_page

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
    open_page: Callable[..., Any], built: Any, width: int, height: int
) -> None:
    page = open_page(built("ordinary").path, width=width, height=height)
    for part in ("#verdict .verdict", "#verdict .lights li:nth-child(1)", "#verdict .lights li:nth-child(3)"):
        box = page.locator(part).bounding_box()
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= height
    if width > 1000:
        chart = page.locator("#verdict svg.chart").bounding_box()
        assert chart["y"] + 0.9 * chart["height"] <= height


def test_text_in_charts_is_large_enough_on_a_phone(open_page: Callable[..., Any], built: Any) -> None:
    """It was 5.6 px high."""
    page = open_page(built("ordinary").path, width=390, height=844)
    sizes = page.evaluate(
        """() => [...document.querySelectorAll("svg.chart")].filter((svg) => svg.clientWidth).map((svg) =>
        parseFloat(getComputedStyle(svg).fontSize) * svg.clientWidth / svg.viewBox.baseVal.width)"""
    )
    assert min(sizes) >= 9.5


WORDS = """<table><tr><th scope="row">interventions</th></tr></table>
<p style="width: 4em">in-ter-ven-tions <a style="overflow-wrap: anywhere">interventions</a></p>"""


def test_a_broken_word_is_found(open_page: Callable[..., Any], tmp_path: Path) -> None:
    """A hyphen may end a line; a table's heading of 60 px and a column of 4 em break a word."""
    (tmp_path / "words.html").write_text(
        f"<style>table {{ width: 60px }} th {{ overflow-wrap: anywhere }}</style>{WORDS}"
    )
    found = faults_of_layout(open_page(tmp_path / "words.html", width=390, height=844))
    assert [fault.partition(":")[0] for fault in found] == ["broken word interventions"] * 2


@pytest.mark.parametrize("name", ["ordinary", "driver"])
def test_words_are_whole_on_a_phone(open_page: Callable[..., Any], built: Any, name: str) -> None:
    """The limits broke "Needless interventions" into "intervention" and "s"."""
    page = opened(open_page(built(name).path, width=390, height=844))
    page.evaluate(
        """() => { document.querySelector("#limits th[scope=row]").textContent = "Needless interventions"; }"""
    )
    assert faults_of_layout(page) == []


def test_charts_of_S_say_which_side_and_which_direction(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
    texts = page.locator("#departures svg.chart").evaluate_all("(all) => all.map((e) => e.textContent)")
    for side in ("left", "right"):
        assert sum(f"S, departures to the {side} [m·s], less is better" in text for text in texts) == 1
    assert "Mean S [m·s]: \u2190 better, worse \u2192" in page.locator("#confidence svg.chart").first.text_content()
    names = page.locator("#confidence svg.chart, #departures svg.chart").evaluate_all(
        "(all) => all.map((e) => e.getAttribute('aria-label'))"
    )
    assert {"Distribution: S of departures to the left", "Distribution: S of departures to the right"} <= set(names)
    assert "Mean S with intervals, better to the left" in names
    chart = open_page(built("driver").path).locator("#driver svg.chart")
    assert "Difference of mean S [m·s]: \u2190 better, worse \u2192" in chart.text_content()
    assert chart.get_attribute("aria-label").endswith("with each kind of driver, better to the left")


def test_charts_are_dark_in_the_dark(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path, dark=True)
    colours = page.evaluate(
        """() => [getComputedStyle(document.documentElement).backgroundColor,
        getComputedStyle(document.querySelector("#verdict svg.chart text")).fill]"""
    )
    back, ink = ([int(part) for part in colour[4:-1].split(",")] for colour in colours)
    assert max(back) < 60
    assert min(ink) > 150
    assert page.locator("svg.chart rect[fill='#fff']").count() == 0


def test_the_first_link_skips_to_the_content(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    page.keyboard.press("Enter")
    assert page.evaluate("location.hash") == "#main"


# ------------------------------------------------------------------------------------------------ the table


def test_a_heading_sorts(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
    page.get_by_role("button", name="Show all").click()
    every = len(shown(page))
    assert every == len(built("ordinary").rows())
    for title, column in (("Mean S", 4), ("ay p95", 7)):
        head = page.locator("#designs thead th", has_text=title).nth(0)
        for order in ("ascending", "descending"):
            head.get_by_role("button").click()
            assert head.get_attribute("aria-sort") == order
            values = page.locator("#designs tbody tr").evaluate_all(f"(rows) => rows.map({NUMBER.format(column)})")
            known = [value for value in values if value == value]
            assert known == sorted(known, reverse=order == "descending")
            assert values[: len(known)] == known  # what is no number stands last
    assert len(shown(page)) == every


def test_the_search_takes_text_and_comparisons(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
    rows = built("ordinary").rows()
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


def test_a_thousand_designs_are_asked_for(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("thousand").path)
    assert len(shown(page)) < 25
    assert any("baseline" in row[-1] for row in shown(page))
    more = page.get_by_role("button", name="Show all 1,000")
    more.click()
    assert more.get_attribute("aria-pressed") == "true"
    assert len(shown(page)) == 1000


def test_no_button_shows_all_where_all_are_shown(open_page: Callable[..., Any], built: Any) -> None:
    assert open_page(built("left-only").path).get_by_role("button", name="Show all").count() == 0


# ------------------------------------------------------------------------------------------------ the explorer


def test_departures_are_drawn_and_chosen(open_page: Callable[..., Any], built: Any) -> None:
    page = open_page(built("ordinary").path)
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


def test_a_plan_is_chosen_by_its_sample(open_page: Callable[..., Any], built: Any) -> None:
    """Wide, over what was driven, of ticked designs that plan; without any there is nothing to choose."""
    page = open_page(built("planning").path)
    slider, wide = page.get_by_role("slider", name="Plans at"), page.locator("#paths .curve.planned")
    assert (slider.is_visible(), wide.count()) == (True, 1)
    first = wide.get_attribute("d")
    slider.fill("2")
    assert page.locator("#plan-time").inner_text() == "0.50 s after the trigger"
    assert wide.get_attribute("d") != first
    row = page.locator("#departure-table tr").filter(has_text="Nonlinear MPC")
    row.locator("input").uncheck()
    assert (slider.is_visible(), wide.count()) == (False, 0)
    assert not open_page(built("ordinary").path).locator("#plan").is_visible()


def test_paths_lie_inside_their_charts(open_page: Callable[..., Any], built: Any) -> None:
    """The default axis cut the winner's acceleration."""
    page = open_page(built("ordinary").path)
    for k in range(0, page.locator("#departure option").count(), 7):
        page.get_by_role("combobox", name="Departure").select_option(str(k))
        beyond = page.evaluate(
            """() => [...document.querySelectorAll("#paths svg")].flatMap((svg) => [...svg.querySelectorAll(".curve")]
            .map((path) => path.getBBox()).filter((box) => box.y < 7 || box.y + box.height > 179 || box.x < 51))"""
        )
        assert beyond == []


# ------------------------------------------------------------------------------------------------ text of users


@pytest.mark.parametrize("script", [True, False], ids=["script", "no-script"])
def test_names_are_text(open_page: Callable[..., Any], built: Any, script: bool) -> None:
    page = open_page(built("hostile").path, script=script)
    assert page.locator("script").count() == 2
    assert EVIL in page.get_by_role("heading", level=1).inner_text()
    assert page.title().startswith(f"</script>{EVIL} & \"quoted\" 'x'")
    assert page.locator("#designs tbody").inner_text().count(EVIL) >= 6
    assert page.locator("b b, main img").count() == 0
    if script:
        page.get_by_role("searchbox", name="Search designs").fill("<script>alert(1)")
        assert len(shown(page)) >= 2


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
    """Pages by name, each built when it is first asked for."""
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
    page.evaluate("document.querySelectorAll('main details').forEach((element) => { element.open = true; })")
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
