# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The departures explorer: choosing a departure and designs, reading values, and numbers that are the stored ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import polars as pl
import pytest

from studies.report.words.text import number

pytestmark = [pytest.mark.browser, pytest.mark.slow]


class Explorer:
    """The explorer, by labels and names."""

    def __init__(self, page: Any) -> None:
        self.page, self.region = page, page.get_by_role("group", name="Departures explorer")
        self.role = self.region.get_by_label("Departure", exact=True)
        self.number = self.region.get_by_label("Scenario number")
        self.time = self.region.get_by_label("Time since the crossing")
        self.boxes = self.region.get_by_role("group", name="Designs, up to four").get_by_role("checkbox")

    def said(self) -> str:
        return " ".join(self.region.locator("#explorer-said").inner_text().split())

    def offer(self) -> str:
        text: str = self.region.locator("#explorer-offer").inner_text()
        return text

    def rows(self, table: str) -> list[list[str]]:
        found: list[list[str]] = self.region.locator(f"#explorer-{table}").evaluate(
            "(e) => Array.from(e.tBodies[0].rows).map((r) => Array.from(r.cells).map((c) =>"
            " c.innerText.replace(/\\s+/g, ' ').trim()))"
        )
        return found

    def paths(self) -> int:
        """Lines drawn in all three parts."""
        count: int = self.region.locator("#explorer-plot path[data-samples]").count()
        return count

    def chosen(self) -> int:
        return sum(self.boxes.nth(k).is_checked() for k in range(self.boxes.count()))


@pytest.fixture
def explorer(open_page: Callable[..., Any], made: Any) -> Explorer:
    return Explorer(open_page(made("ordinary").path))


def test_a_departure_is_chosen_by_its_role_by_number_and_by_neighbours(explorer: Explorer) -> None:
    explorer.role.select_option(
        label=next(o for o in explorer.role.locator("option").all_inner_texts() if "Right: worst" in o)
    )
    said = explorer.said()
    assert re.match(r"Right departure, scenario \d+ \((.*, )?worst S", said)
    at = int(explorer.number.input_value())
    assert f"scenario {at} " in said
    explorer.region.get_by_role("button", name="Previous").click()
    assert explorer.number.input_value() == str(at - 1)  # all of the study are in the page
    explorer.region.get_by_role("button", name="Next").click()
    assert explorer.said() == said
    explorer.number.fill("0")
    explorer.number.press("Enter")
    assert "Left departure, scenario 0" in explorer.said()
    assert explorer.region.get_by_role("button", name="Previous").is_disabled()
    explorer.number.fill("700")
    explorer.number.press("Enter")
    assert "Scenario 700 is not in this page; scenario 59 is shown" in explorer.offer()
    assert "Right departure, scenario 59" in explorer.said()


def test_four_designs_and_not_a_fifth(explorer: Explorer) -> None:
    count = explorer.boxes.count()
    for k in range(count):
        explorer.boxes.nth(k).uncheck()
    assert "No design is chosen." in explorer.said()
    assert explorer.paths() == 2  # without control: position and acceleration
    for k in range(min(count, 4)):
        explorer.boxes.nth(k).check()
    assert len(explorer.rows("designs")) == len(explorer.rows("values")) == 1 + min(count, 4)
    if count > 4:
        explorer.boxes.nth(4).click()
        assert not explorer.boxes.nth(4).is_checked()
        assert "Four designs at most" in explorer.region.locator("#explorer-refused").inner_text()


def test_numbers_are_the_stored_ones(explorer: Explorer, made: Any) -> None:
    stored = pl.read_parquet(made("ordinary").folder / "results" / "*.parquet")
    stored = stored.filter((pl.col("convention") == "consistent") & (pl.col("scenario") == 41))
    explorer.number.fill("41")
    explorer.number.press("Enter")
    for row in explorer.rows("designs")[1:]:
        (identity,) = re.findall(r"[0-9a-f]{12}", row[0])
        (one,) = stored.filter(pl.col("design") == identity).to_dicts()
        S, S_0 = one["S_departure_m_s"], one["S_uncorrected_departure_m_s"]
        assert row[1] == number(S)
        assert row[2].replace("−", "-").startswith(f"{100 * (S / S_0 - 1):+.1f}")
        assert row[3] == number(one["deepest_m"])
        assert row[4] == number(one["a_y_peak_m_s2"], 2)


def test_the_time_is_moved_with_the_keyboard(explorer: Explorer) -> None:
    explorer.time.focus()
    explorer.time.press("Home")
    assert "At t = 0.00 s" in explorer.region.locator("#explorer-values caption").inner_text()
    assert [row[1] for row in explorer.rows("values")] == ["0.000"] * (1 + explorer.chosen())  # on the line
    for _ in range(3):
        explorer.time.press("ArrowRight")
    assert "At t = 0.15 s" in explorer.region.locator("#explorer-values caption").inner_text()
    assert "0.15" in explorer.time.get_attribute("aria-valuetext")
    explorer.time.press("End")
    last = explorer.rows("values")
    assert last[0][1] == "–"  # the departure is over
    assert all(row[1] != "–" for row in last[1:])


def test_the_pointer_moves_the_time(explorer: Explorer) -> None:
    box = explorer.region.locator("#explorer-plot svg").bounding_box()
    explorer.region.locator("#explorer-plot svg").hover(position={"x": box["width"] / 2, "y": 60})
    middle = float(explorer.time.input_value())
    assert 0.3 * float(explorer.time.get_attribute("max")) < middle < 0.7 * float(explorer.time.get_attribute("max"))


def test_a_design_chosen_elsewhere_is_drawn(explorer: Explorer, made: Any) -> None:
    def choose(place: int) -> None:
        explorer.page.evaluate(
            "(k) => document.dispatchEvent(new CustomEvent('ldc:departures', {detail: {place: k}}))", place
        )

    for k in range(explorer.boxes.count()):
        explorer.boxes.nth(k).uncheck()
    choose(0)
    assert explorer.boxes.nth(0).is_checked()
    assert explorer.paths() == 5
    held = explorer.page.evaluate("() => LDC.data('departures').designs.map((one) => one.place)")
    missing = next(k for k in range(100) if k not in held)
    choose(missing)
    identity = made("ordinary").rows()[missing]["design"]
    refused = explorer.region.locator("#explorer-refused")
    assert f"holds no paths of design {identity}; ldc report DIR --design {identity} " in refused.inner_text()
    explorer.region.get_by_role("button", name="Next").click()
    assert refused.inner_text() == ""
    choose(missing)
    explorer.time.press("End")
    assert refused.inner_text() == ""


def test_a_fifth_design_takes_the_place_of_the_last(explorer: Explorer) -> None:
    held = explorer.page.evaluate("() => LDC.data('departures').designs")
    assert len(held) > 4
    for k in range(len(held)):
        explorer.boxes.nth(k).uncheck()
    for k in range(4):
        explorer.boxes.nth(k).check()
    explorer.page.evaluate(
        "(k) => document.dispatchEvent(new CustomEvent('ldc:departures', {detail: {place: k}}))", held[4]["place"]
    )
    said = explorer.region.locator("#explorer-refused")
    assert f"{held[4]['id']}, takes the place of" in said.inner_text()
    assert held[3]["id"] in said.inner_text()
    explorer.boxes.nth(3).click()
    explorer.boxes.nth(4).uncheck()
    assert said.inner_text() == ""


def test_a_few_far_values_do_not_set_the_range(explorer: Explorer) -> None:
    def drawn(peak: float, full: bool) -> dict[str, Any]:
        result: dict[str, Any] = explorer.page.evaluate(
            """([peak, full]) => {
              const n = 400, t = Array.from({length: n}, (_, i) => i / 100), flat = t.map(() => 0.1);
              const a = t.map((_, i) => i === 7 ? peak : 2 * Math.sin(i)), holder = document.createElement("div");
              document.body.append(holder);
              const style = {color: "#000", dash: []}, line = {t: t, y: flat, delta: flat, a_y: a, deepest: 0.1};
              const plot = LDC.departurePlot(holder, {T: 4, far: -1.7, zoom: false, full: full,
                recorded: {line: line, style: style}, designs: [{line: line, style: style}]}, "test", () => {});
              const limits = holder.querySelectorAll(".limit");
              const apart = Math.abs(limits[0].getAttribute("y1") - limits[1].getAttribute("y1"));
              holder.remove();
              return {cut: plot.cut, apart: apart};
            }""",
            [peak, full],
        )
        return result

    calm, spike, full = drawn(2.0, False), drawn(80.0, False), drawn(80.0, True)
    assert (calm["cut"], spike["cut"], full["cut"]) == (False, True, False)
    assert spike["apart"] == pytest.approx(calm["apart"])  # as if the far value were not there
    assert full["apart"] < 0.2 * spike["apart"]
    assert calm["apart"] == pytest.approx(130 * 6 / (7.2 * 1.08), rel=0.01)  # 1.2 times the limit is always inside


def test_the_full_range_is_offered_where_something_is_cut(explorer: Explorer) -> None:
    choice, note = explorer.region.locator("#explorer-full"), explorer.region.locator("#explorer-cut")
    cut = False
    for k in range(explorer.role.locator("option").count() - 1):
        explorer.role.select_option(index=k + 1)
        assert choice.is_visible() == bool(note.inner_text())
        cut = cut or choice.is_visible()
        if cut:
            break
    if cut:
        explorer.region.get_by_label("Full range of steering and acceleration").check()
        assert note.inner_text() == ""
        assert choice.is_visible()


def test_the_drawing_follows_the_width(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path, width=390, height=800)
    plot = page.locator("#explorer-plot svg")
    assert plot.bounding_box()["width"] <= 390
    page.set_viewport_size({"width": 1000, "height": 800})
    page.wait_for_function("document.querySelector('#explorer-plot svg').getBoundingClientRect().width > 600")


def test_without_script_the_examples_stand_alone(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("ordinary").path, script=False)
    assert not page.locator("#explorer").is_visible()
    assert page.locator("#departures svg[role=img]").count() == 6
