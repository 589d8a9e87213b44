# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The departures explorer: choosing a departure and designs, reading values, and numbers that are the stored ones."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from ldctoolkit import BicycleModel, VehicleParameters, simulate
from studies import Study, run_study
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

    def drawn(self) -> list[np.ndarray]:
        """Points of every path in the drawing, in the order of drawing; a stair's corners are left out."""
        found = self.region.get_by_role("img", name="position, steering angle").locator("path[data-samples]")
        return [
            np.array([[float(x) for x in pair.split()] for pair in re.split("[ML]", re.sub(r"H[-\d.]+", "", one))[1:]])
            for one in found.evaluate_all("(all) => all.map((e) => e.getAttribute('d'))")
        ]

    def options(self) -> dict[str, int]:
        """What can be chosen by name -> number of the scenario."""
        texts = self.role.locator("option").all_text_contents()
        return {one.split(" (scenario")[0]: int(re.search(r"scenario (\d+)\)", one)[1]) for one in texts if "(" in one}

    def ids(self) -> list[str]:
        """Identifiers of the designs that can be chosen."""
        return [one["id"] for one in self.page.evaluate("LDC.data('departures').designs")]


@pytest.fixture(scope="module")
def results(made: Any) -> Any:
    """The study's own results, read from its folder."""
    folder: Path = made("ordinary").folder
    return run_study(Study.from_toml(folder.with_suffix(".toml")), directory=folder, workers=1)


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


def test_worst_and_best_are_those_of_the_winner(explorer: Explorer, made: Any, results: Any) -> None:
    (winner,) = (row["design"] for row in made("ordinary").rows() if row["winner"] == "true")
    S = results.cases[0].S[[d.id for d in results.designs].index(winner)]
    options = explorer.options()
    for side, rows in (
        ("Left", np.flatnonzero(results.scenarios.side > 0)),
        ("Right", np.flatnonzero(results.scenarios.side < 0)),
    ):
        assert options[f"{side}: worst S"] == rows[S[rows].argmax()]
        assert options[f"{side}: best S"] == rows[S[rows].argmin()]
    place = explorer.role.locator("option", has_text="Left: worst S")
    explorer.role.select_option(place.first.get_attribute("value"))
    row = options["Left: worst S"]
    assert explorer.number.input_value() == str(row)
    assert f"Left departure, scenario {row}" in explorer.said()
    facts = explorer.region.get_by_role("region", name="Parameters of this departure").inner_text()
    for name, digits in (("T", 2), ("d_y", 3), ("v_mean", 2), ("sigma_v", 3)):
        assert f"{getattr(results.scenarios, name)[row]:.{digits}f}" in facts


def straight(numbers: np.ndarray, places: np.ndarray, least: float) -> None:
    """Places in a drawing, to 0.1 px, are linear in the numbers."""
    slope, start = np.polyfit(numbers, places, 1)
    assert np.abs(start + slope * numbers - places).max() < 0.06 + least * abs(slope)


def test_drawn_paths_are_those_of_a_simulation(explorer: Explorer, results: Any) -> None:
    by_id = {design.id: design for design in results.designs}
    ids = explorer.ids()
    place = next(k for k, one in enumerate(ids) if by_id[one].law == "lqr")
    for k in range(explorer.boxes.count()):
        explorer.boxes.nth(k).set_checked(k == place)
    design, row = by_id[ids[place]], explorer.options()["Right: worst S"]
    explorer.number.fill(str(row))
    explorer.number.press("Enter")
    assert f"Right departure, scenario {row}" in explorer.said()
    outcome = simulate(
        design.controller("consistent"),
        results.scenarios,
        vehicle=BicycleModel(VehicleParameters()),
        y_s=design.y_s,
        trajectories=True,
    )
    kept = outcome.trajectories
    assert kept is not None
    lines = explorer.drawn()
    assert len(lines) == 5  # two without control, three of the design
    known = np.isfinite(kept.t[row])
    lengths = [len(line) for line in lines]
    (length,) = (one for one in set(lengths) if lengths.count(one) == 3)  # those of the design
    ordered = [line for line in lines if len(line) == length]
    t = kept.t[row, known][0] + 0.05 * np.arange(length)
    at = np.abs(kept.t[row, known][:, None] - t).argmin(axis=0)
    assert np.abs(kept.t[row, known][at] - t).max() < 1e-9
    # of the three lines of the design, one is its position and one its steering angle
    positions = [line for line in ordered if _fits(kept.x[row, known][at, 0], line[:, 1], 1e-3)]
    angles = [line for line in ordered if _fits(np.degrees(kept.delta[row, known][at]), line[:, 1], 1e-3)]
    assert len(positions) == len(angles) == 1
    straight(t, positions[0][:, 0], 0.0)
    assert np.ptp(positions[0][:, 1]) > 20
    # the table below tells the stored score
    said = explorer.region.get_by_role("region", name="Designs on this departure").inner_text()
    stored = results.cases[0].S[results.designs.index(design), row]
    assert f"{stored:.3f}" in said
    assert outcome.S[row] == pytest.approx(stored, rel=1e-9)


def _fits(numbers: np.ndarray, places: np.ndarray, least: float) -> bool:
    try:
        straight(numbers, places, least)
    except AssertionError:
        return False
    return True
