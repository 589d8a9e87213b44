"""The explorer of departures draws what it says: paths are compared with simulations made here, roles with scores."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ldctoolkit import BicycleModel, VehicleParameters, simulate
from studies import Study, run_study

pytestmark = [pytest.mark.browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def results(made: Any) -> Any:
    """The study's own results, read from its folder."""
    folder: Path = made("ordinary").folder
    return run_study(Study.from_toml(folder.with_suffix(".toml")), directory=folder, workers=1)


class Explorer:
    """The explorer, by roles and names."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.root = page.get_by_role("group", name="Departures explorer")
        self.departure = self.root.get_by_role("combobox", name="Departure")
        self.number = self.root.get_by_role("spinbutton", name="Scenario number")
        self.designs = self.root.get_by_role("group", name="Designs, up to four").get_by_role("checkbox")

    def choose(self, *places: int) -> None:
        for k in range(self.designs.count()):
            self.designs.nth(k).set_checked(False)
        for k in places:
            self.designs.nth(k).set_checked(True)

    def said(self) -> str:
        text: str = self.root.locator("[aria-live]").first.inner_text()
        return text

    def drawn(self) -> list[np.ndarray]:
        """Points of every path in the drawing, in the order of drawing; a stair's corners are left out."""
        found = self.root.get_by_role("img", name="position, steering angle").locator("path[data-samples]")
        return [
            np.array([[float(x) for x in pair.split()] for pair in re.split("[ML]", re.sub(r"H[-\d.]+", "", one))[1:]])
            for one in found.evaluate_all("(all) => all.map((e) => e.getAttribute('d'))")
        ]

    def options(self) -> dict[str, int]:
        """What can be chosen by name -> number of the scenario."""
        texts = self.departure.locator("option").all_text_contents()
        return {one.split(" (scenario")[0]: int(re.search(r"scenario (\d+)\)", one)[1]) for one in texts if "(" in one}

    def ids(self) -> list[str]:
        """Identifiers of the designs that can be chosen."""
        return [one["id"] for one in self.page.evaluate("LDC.data('departures').designs")]


@pytest.fixture
def explorer(open_page: Callable[..., Any], made: Any) -> Explorer:
    return Explorer(open_page(made("ordinary").path))


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
    place = explorer.departure.locator("option", has_text="Left: worst S")
    explorer.departure.select_option(place.first.get_attribute("value"))
    row = options["Left: worst S"]
    assert explorer.number.input_value() == str(row)
    assert f"Left departure, scenario {row}" in explorer.said()
    facts = explorer.root.get_by_role("region", name="Parameters of this departure").inner_text()
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
    explorer.choose(place)
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
    said = explorer.root.get_by_role("region", name="Designs on this departure").inner_text()
    stored = results.cases[0].S[results.designs.index(design), row]
    assert f"{stored:.3f}" in said
    assert outcome.S[row] == pytest.approx(stored, rel=1e-9)


def _fits(numbers: np.ndarray, places: np.ndarray, least: float) -> bool:
    try:
        straight(numbers, places, least)
    except AssertionError:
        return False
    return True
