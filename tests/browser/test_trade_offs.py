# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The scatter: points lie where their numbers say, on whatever axes are chosen; a point opens its design."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]


class Scatter:
    """The scatter, by roles and names."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.across = page.get_by_role("combobox", name="Horizontal")
        self.up = page.get_by_role("combobox", name="Vertical")
        self.section = page.locator("#trade-offs")
        self.note = self.section.get_by_role("status")

    def points(self) -> list[tuple[str, float, float]]:
        """Identifier of the design, and where its point is, from the leftmost on, as arrow keys meet them."""
        cursor = self.section.get_by_role("button", name="open the design")
        cursor.focus()
        cursor.press("Home")
        found, count = [], int(re.match(r"[\d,]+", self.note.inner_text())[0].replace(",", ""))
        for _ in range(count):
            x, y = (float(one) for one in re.findall(r"[-\d.]+", cursor.get_attribute("transform")))
            found.append((cursor.get_attribute("aria-label"), x, y))
            cursor.press("ArrowRight")
        return found


def label_of(row: dict[str, str], page: Any) -> str:
    """The design's label, from the page: names only, its numbers are what is tested."""
    said: str = page.evaluate(
        """(id) => Array.from({ length: LDC.designs.count }, (_, i) => LDC.designs.place(i))
            .find((one) => one.id === id).label""",
        row["design"],
    )
    return said.replace("-", "−")


@pytest.fixture
def scatter(open_page: Callable[..., Any], made: Any) -> Scatter:
    return Scatter(open_page(made("ordinary").path))


def check(scatter: Scatter, rows: list[dict[str, str]], across: str, up: str) -> None:
    """Every point is at a place that is linear in the numbers of ranking.csv, and each design with both has one."""
    by_label = {label_of(row, scatter.page): row for row in rows}
    assert len(by_label) == len(rows)
    found = scatter.points()
    seen = {label.split("; ")[0]: (x, y) for label, x, y in found}
    assert set(seen) == {label for label, row in by_label.items() if row[across] and row[up]}
    for k, column in enumerate((across, up)):
        number = np.array([float(by_label[label][column]) for label in seen])
        place = np.array([at[k] for at in seen.values()])
        slope, start = np.polyfit(number, place, 1)
        assert slope > 0 if k == 0 else slope < 0  # up is less in a drawing
        assert np.abs(start + slope * number - place).max() < 0.11  # places are written to 0.1
        assert np.ptp(place) > 100


def test_points_follow_the_axes(scatter: Scatter, made: Any) -> None:
    rows = made("ordinary").rows()
    scatter.section.get_by_role("checkbox", name="all points").check()
    scatter.across.select_option("S")
    scatter.up.select_option("a_y_peak_p95")
    check(scatter, rows, "S_m_s", "a_y_peak_p95_m_s2")
    scatter.up.select_option("deepest_p95")
    scatter.across.select_option("effort_mean")
    check(scatter, rows, "effort_mean_rad2_s", "deepest_p95_m")
    scatter.section.get_by_role("button", name="Swap axes").press("Enter")
    assert (scatter.across.input_value(), scatter.up.input_value()) == ("deepest_p95", "effort_mean")
    check(scatter, rows, "deepest_p95_m", "effort_mean_rad2_s")


def test_a_logarithmic_axis_is_one(scatter: Scatter, made: Any) -> None:
    rows = made("ordinary").rows()
    scatter.section.get_by_role("checkbox", name="all points").check()
    scatter.across.select_option("effort_mean")
    scatter.up.select_option("S")
    log = scatter.section.get_by_role("checkbox", name="Horizontal axis logarithmic")
    assert log.is_enabled()
    log.press("Space")
    for row in rows:
        row["log"] = str(np.log(float(row["effort_mean_rad2_s"]))) if row["effort_mean_rad2_s"] else ""
    check(scatter, rows, "log", "S_m_s")


def test_swapped_axes_keep_their_logarithm_only_where_it_exists(scatter: Scatter) -> None:
    logs = [
        scatter.section.get_by_role("checkbox", name=f"{name} axis logarithmic") for name in ("Horizontal", "Vertical")
    ]
    scatter.section.get_by_role("checkbox", name="all points").check()
    scatter.across.select_option("effort_mean")
    scatter.up.select_option("reduction")  # below zero for some, 0 for no control
    logs[0].check()
    swap = scatter.section.get_by_role("button", name="Swap axes")
    swap.click()
    assert [log.is_enabled() for log in logs] == [False, True]
    assert [log.is_checked() for log in logs] == [False, True]
    assert all(np.isfinite(place[1:]).all() for place in scatter.points())
    swap.click()
    assert [log.is_checked() for log in logs] == [True, False]
    assert [log.is_enabled() for log in logs] == [True, False]


def test_points_outside_are_counted(scatter: Scatter) -> None:
    note = scatter.note.inner_text()
    box = scatter.section.get_by_role("checkbox", name="all points")
    outside = re.search(r"(\d+) (?:lies|lie) outside", note)
    count = int(note.split()[0])
    box.check()
    assert "outside" not in scatter.note.inner_text()
    assert int(scatter.note.inner_text().split()[0]) == count + (int(outside[1]) if outside else 0)


def test_it_fits_on_paper(scatter: Scatter) -> None:
    drawing = scatter.section.get_by_role("group", name="one point a design")
    drawn = drawing.evaluate("(e) => e.viewBox.baseVal.width")
    scatter.page.emulate_media(media="print")
    panel = scatter.section.locator(".panel.plot")
    # measured in the same turn of the page, before it makes another drawing for the new width: on paper it does not
    narrow = """(e) => {
        e.style.width = '700px';
        return e.querySelector('svg[role="group"]').getBoundingClientRect().width;
    }"""
    assert drawn > 1000
    assert 0 < panel.evaluate(narrow) <= 700


def test_laws_are_switched_off(scatter: Scatter, made: Any) -> None:
    rows = made("ordinary").rows()
    scatter.section.get_by_role("checkbox", name="all points").check()
    scatter.across.select_option("S")
    scatter.up.select_option("deepest_p95")
    assert scatter.note.inner_text().startswith("28 of 28")
    law = scatter.section.get_by_role("list", name="Laws").get_by_role("button", name="LQR")
    law.press("Enter")
    assert law.get_attribute("aria-pressed") == "false"
    kept = sum(row["law"] != "lqr" for row in rows)
    assert scatter.note.inner_text().startswith(f"{kept} of 28")
    assert not any(label.startswith("LQR") for label, _, _ in scatter.points())
    law.press("Space")
    assert scatter.note.inner_text().startswith("28 of 28")


def test_the_front_is_the_best_of_both(scatter: Scatter, made: Any) -> None:
    ranked = [row for row in made("ordinary").rows() if not row["unmet"] and row["a_y_peak_p95_m_s2"]]
    scatter.across.select_option("S")
    scatter.up.select_option("a_y_peak_p95")
    pairs = {(float(row["S_m_s"]), float(row["a_y_peak_p95_m_s2"])) for row in ranked}
    best = [a for a in pairs if not any(b != a and b[0] <= a[0] and b[1] <= a[1] for b in pairs)]
    assert f"{len(best)} on the front" in scatter.note.inner_text()


def test_a_point_opens_its_design_and_gives_the_focus_back(scatter: Scatter, made: Any) -> None:
    page, rows = scatter.page, made("ordinary").rows()
    cursor = scatter.section.get_by_role("button", name="open the design")
    cursor.focus()
    cursor.press("End")
    label = cursor.get_attribute("aria-label").split("; ")[0]
    (row,) = (row for row in rows if label_of(row, page) == label)
    cursor.press("Enter")
    details = page.get_by_role("dialog")
    assert details.is_visible()
    assert row["design"] in details.inner_text()
    page.keyboard.press("Escape")
    assert not details.is_visible()
    assert page.evaluate("document.activeElement.getAttribute('aria-label')").startswith(label)


def test_a_mouse_points_and_opens(scatter: Scatter) -> None:
    _, x, y = scatter.points()[3]
    drawing = scatter.section.get_by_role("group", name="one point a design")
    drawing.scroll_into_view_if_needed()
    box = drawing.bounding_box()
    scatter.page.mouse.move(box["x"] + x, box["y"] + y)
    tip = scatter.section.locator(".tip")
    assert tip.is_visible()
    scatter.page.mouse.click(box["x"] + x, box["y"] + y)
    assert scatter.page.get_by_role("dialog").is_visible()
