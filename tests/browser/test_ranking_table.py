# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The ranking table does what its buttons and boxes say, and its numbers are those of the study's folder."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import polars as pl
import pytest

from studies.report.words.text import change, number, percent, signed

pytestmark = [pytest.mark.browser, pytest.mark.slow]


class Table:
    """The table of the primary case, by roles and names."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.region = page.locator("#ranking").get_by_role("region").first
        self.filters = page.get_by_role("group", name="Filters of the ranking")

    def heads(self) -> list[str]:
        return [" ".join(one.split()) for one in self.region.locator("thead th").all_inner_texts()]

    def head(self, title: str) -> Any:
        return self.region.locator("thead th").nth(self.heads().index(title))

    def cells(self) -> list[list[str]]:
        """Text of every cell of the body, words parted by one space."""
        found: list[list[str]] = self.region.evaluate(
            "(e) => Array.from(e.querySelector('tbody').rows).map((r) => Array.from(r.cells).map((c) =>"
            " c.innerText.replace(/[ \\n]+/g, ' ').trim()))"
        )
        return found

    def column(self, title: str) -> list[str]:
        place = self.heads().index(title)
        return [row[place] for row in self.cells()]

    def count(self) -> str:
        text: str = self.page.locator("#ranking [aria-live]").first.inner_text()
        return text


@pytest.fixture
def table(open_page: Callable[..., Any], made: Any) -> Table:
    return Table(open_page(made("ordinary").path))


def value(row: dict[str, str], column: str) -> float:
    return float(row[column]) if row[column] else math.nan


def shown_rank(row: dict[str, str]) -> str:
    return row["rank"] if int(row["rank"] or 0) > 0 else "–"


def test_numbers_are_those_of_the_folder(table: Table, made: Any) -> None:
    ordinary = made("ordinary")
    rows = ordinary.rows()
    stored = pl.read_parquet(ordinary.folder / "results" / "*.parquet").filter(pl.col("convention") == "consistent")
    mean = dict(stored.group_by("design").agg(pl.col("S_departure_m_s").mean()).iter_rows())
    heads, cells = table.heads(), table.cells()
    assert len(cells) == len(rows) == len(mean) == 28

    def cell(k: int, title: str) -> str:
        return cells[k][heads.index(title)]

    for k, row in enumerate(rows):
        idle = row["law"] == "none"
        assert cell(k, "Rank") == shown_rank(row)
        assert row["law"] in cell(k, "Design")
        assert ("winner" in cell(k, "Design")) == (row["winner"] == "true")
        assert ("Pareto" in cell(k, "Design")) == (row["pareto"] == "true")
        assert ("misses" in cell(k, "Design")) == bool(row["unmet"] or row["fresh_unmet"])
        assert cell(k, "ys [m]") == ("–" if idle else f"{value(row, 'y_s_m'):g}")
        assert cell(k, "Mean S [m·s]").split()[0] == number(mean[row["design"]])
        ends = [value(row, name) for name in ("S_low_m_s", "S_high_m_s")]
        assert cell(k, "Mean S [m·s]").endswith(f"[{number(ends[0])} to {number(ends[1])}]")
        assert cell(k, "Against no control") == change(value(row, "reduction"))
        for side in ("left", "right"):
            said = f"{number(value(row, f'S_{side}_m_s'))} {change(value(row, f'reduction_{side}'))}"
            assert cell(k, f"{side.capitalize()} S") == said
        if k:
            assert cell(k, "Difference to best [m·s]").split()[0] == signed(value(row, "difference_to_best_m_s"))
        if not idle:
            assert cell(k, "Difference to baseline [m·s]").split()[0] == signed(value(row, "baseline_difference_m_s"))
        if row["fresh_S_m_s"]:
            assert cell(k, "Fresh S [m·s]").split()[0] == number(value(row, "fresh_S_m_s"))
        else:
            assert cell(k, "Fresh S [m·s]") == "–"
        assert cell(k, "Taken over") == ("–" if idle else percent(value(row, "triggered_share")))
        assert cell(k, "Deeper than Dy") == percent(value(row, "deeper_than_D_y_share"))
        assert cell(k, "Peak ay, 95 % quantile [m/s²]") == f"{number(value(row, 'a_y_peak_p95_m_s2'), 2)} ≤ 14"
        assert cell(k, "Failures") == "0"


SORTED = {
    "Rank": lambda row: float(row["rank"]) if int(row["rank"] or 0) > 0 else math.nan,
    "ys [m]": lambda row: math.nan if row["law"] == "none" else value(row, "y_s_m"),
    "Mean S [m·s]": lambda row: value(row, "S_m_s"),
    "Against no control": lambda row: -value(row, "reduction"),
    "Left S": lambda row: value(row, "S_left_m_s"),
    "Right S": lambda row: value(row, "S_right_m_s"),
    "Difference to best [m·s]": lambda row: value(row, "difference_to_best_m_s"),
    "Difference to baseline [m·s]": lambda row: value(row, "baseline_difference_m_s"),
    "Fresh S [m·s]": lambda row: value(row, "fresh_S_m_s"),
    "Taken over": lambda row: math.nan if row["law"] == "none" else value(row, "triggered_share"),
    "Deeper than Dy": lambda row: value(row, "deeper_than_D_y_share"),
    "Failures": lambda row: 0.0,
}
"""Head -> the number in ranking.csv that orders the rows."""


@pytest.mark.parametrize("title", SORTED)
def test_every_column_sorts_up_and_down(table: Table, made: Any, title: str) -> None:
    rows, key = made("ordinary").rows(), SORTED[title]
    at = [table.heads().index(one) for one in ("Rank", "Design", "Mean S [m·s]")]

    def order() -> list[float]:
        found = []
        for cells in table.cells():
            rank, design, S = (cells[one] for one in at)
            (row,) = (
                row
                for row in rows
                if shown_rank(row) == rank
                and row["law"] in design.split()
                and number(value(row, "S_m_s")) == S.split()[0]
            )
            found.append(key(row))
        return found

    if title != "Rank":
        assert table.head(title).get_attribute("aria-sort") in (None, "none")
        table.head(title).get_by_role("button").click()
    assert table.head(title).get_attribute("aria-sort") == "ascending"
    up = order()
    told = [one for one in up if not math.isnan(one)]
    assert told == sorted(told)
    assert all(math.isnan(one) for one in up[len(told) :])  # what has no number comes last
    table.head(title).get_by_role("button").press("Enter")
    assert table.head(title).get_attribute("aria-sort") == "descending"
    down = order()
    assert [one for one in down if not math.isnan(one)] == sorted(told, reverse=True)
    assert all(math.isnan(one) for one in down[len(told) :])
    assert table.region.locator("thead th[aria-sort=ascending], thead th[aria-sort=descending]").count() == 1


def test_laws_are_filtered(table: Table, made: Any) -> None:
    rows = made("ordinary").rows()
    assert "28 of 28" in table.count()
    table.filters.get_by_text("Laws (").press("Enter")
    table.filters.get_by_role("checkbox", name="LQR", exact=True).press("Space")
    left = [row for row in rows if row["law"] != "lqr"]
    assert f"{len(left)} of 28" in table.count()
    assert table.column("Rank") == [shown_rank(row) for row in left]
    assert not any("lqr" in one.split() for one in table.column("Design"))
    table.filters.get_by_role("button", name="None", exact=True).first.click()
    assert "0 of 28" in table.count()
    assert len(table.cells()) == 1
    table.filters.get_by_role("button", name="Reset").press("Enter")
    assert "28 of 28" in table.count()
    assert len(table.cells()) == 28


def test_words_are_searched(table: Table, made: Any) -> None:
    rows = made("ordinary").rows()
    field = table.filters.get_by_role("searchbox", name="Search")
    field.fill(rows[5]["design"][:8])
    assert "1 of 28" in table.count()
    assert table.column("Mean S [m·s]")[0].startswith(number(value(rows[5], "S_m_s")))
    field.fill("k_y=-0.02 K_psi=-0.5")
    found = [row for row in rows if row["gain_K_y_rad_per_m"] == "-0.02" and row["gain_K_psi_rad_per_rad"] == "-0.5"]
    assert len(found) == 3
    assert table.column("Rank") == [shown_rank(row) for row in found]
    field.fill("no such design")
    assert "0 of 28" in table.count()
    field.fill("")
    assert len(table.cells()) == 28


def test_gains_are_searched_as_numbers(table: Table, made: Any) -> None:
    rows = made("ordinary").rows()
    field = table.filters.get_by_role("searchbox", name="Search")

    def ranks(holds: Callable[[dict[str, str]], bool]) -> list[str]:
        return [shown_rank(row) for row in rows if holds(row)]

    def r_delta(row: dict[str, str]) -> float:
        (column,) = (name for name in row if name.startswith("gain_r_delta"))
        return value(row, column)

    for text, holds in (
        ("r_delta=10", lambda row: r_delta(row) == 10),
        ("rδ = 10", lambda row: r_delta(row) == 10),
        ("r_delta=1e2", lambda row: r_delta(row) == 100),
        ("r_delta > 10", lambda row: r_delta(row) > 10),
        (
            "Kψ\u00a0=\u00a0−0.20 ys >= 0.2",
            lambda row: row["gain_K_psi_rad_per_rad"] == "-0.2" and value(row, "y_s_m") > 0.1,
        ),
        ("LQR y_s<0.1", lambda row: row["law"] == "lqr" and value(row, "y_s_m") < 0.1),
        ("winner", lambda row: row["winner"] == "true"),
        ("baseline", lambda row: row["law"] == "none"),
        ("misses", lambda row: row["unmet"] or row["fresh_unmet"]),
    ):
        field.fill(text)
        found = ranks(holds)  # type: ignore[arg-type]
        assert table.column("Rank") == found, text
        assert 0 < len(found) < 28


def test_the_papers_design_is_found_by_its_tag(open_page: Callable[..., Any], made: Any) -> None:
    table = Table(open_page(made("thousand").path))
    tagged = [one for one in table.column("Design") if "Table I" in one.split(" Preview")[0]]
    table.filters.get_by_role("searchbox", name="Search").fill("table i")
    table.page.wait_for_timeout(300)
    found = table.column("Design")
    assert len(found) >= max(1, len(tagged))
    assert all("Table I" in one for one in found)


def test_tags_and_requirements_are_filtered(table: Table, made: Any) -> None:
    rows = made("ordinary").rows()
    for name, kept in (
        ("meets requirements", [row for row in rows if not row["unmet"]]),
        ("set of best", [row for row in rows if row["set_of_best"] == "true"]),
        ("Pareto front", [row for row in rows if row["pareto"] == "true"]),
        ("with failures", []),
    ):
        box = table.filters.get_by_role("checkbox", name=name)
        box.press("Space")
        assert f"{len(kept)} of 28" in table.count()
        if kept:
            assert [one.split()[0] for one in table.column("Mean S [m·s]")] == [
                number(value(row, "S_m_s")) for row in kept
            ]
        box.press("Space")
    assert 0 < sum(not row["unmet"] for row in rows) < 28  # else the first line would show nothing


def test_columns_are_chosen(table: Table, made: Any) -> None:
    rows, before = made("ordinary").rows(), table.heads()
    table.filters.get_by_text("Columns (").press("Enter")
    assert "Effort" not in " ".join(before)
    boxes = table.filters.locator("details").last.get_by_role("checkbox")
    names = [" ".join(one.split()) for one in table.filters.locator("details").last.locator("label").all_inner_texts()]
    peak = names.index("Peak lateral jerk, 95 % quantile [m/s³]")
    boxes.nth(peak).press("Space")
    (added,) = set(table.heads()) - set(before)
    assert added == names[peak]
    digits = len(table.column(added)[0].split(".")[-1])
    said = [number(value(row, "jerk_peak_p95_m_s3"), digits) for row in rows]
    assert table.column(added) == said
    assert "–" in said  # no control has no interventions
    table.head(added).get_by_role("button").click()
    numbers = [float(one.replace("−", "-")) for one in table.column(added) if one != "–"]
    assert numbers == sorted(numbers)
    assert table.column(added)[-1] == "–"
    boxes.nth(peak).press("Space")
    assert table.heads() == before


def test_a_thousand_designs_are_turned_page_by_page(open_page: Callable[..., Any], made: Any) -> None:
    table = Table(open_page(made("thousand").path))
    assert "1,000 of 1,000" in table.count()
    pages = table.page.get_by_role("group", name="Pages of the ranking")
    first = table.column("Rank")
    assert first[:3] == ["1", "2", "3"]
    assert pages.get_by_role("button", name="Previous").is_disabled()
    pages.get_by_role("button", name="Next").press("Enter")
    assert table.column("Rank")[0] == str(len(first) + 1)
    table.head("Mean S [m·s]").get_by_role("button").click()
    table.head("Mean S [m·s]").get_by_role("button").click()
    S = [float(one.split()[0]) for one in table.column("Mean S [m·s]")]
    assert sorted(S, reverse=True) == S
    table.head("Rank").get_by_role("button").click()
    assert table.column("Rank") == first
    assert float(table.column("Mean S [m·s]")[0].split()[0]) < S[-1]


def test_the_table_fits_on_paper(table: Table) -> None:
    table.page.set_viewport_size({"width": 718, "height": 1047})  # A4 upright, margins of 10 mm
    table.page.emulate_media(media="print")
    wide = table.page.locator("#ranking .scroll").evaluate_all("(all) => all.map((e) => e.scrollWidth - e.clientWidth)")
    assert len(wide) == 2
    assert max(wide) <= 0
    assert not table.filters.is_visible()


def test_other_cases_sort_too(table: Table) -> None:
    other = table.page.get_by_role("region", name="Ranking, control window")
    head = other.locator("thead th").filter(has_text="Mean S")
    head.get_by_role("button").press("Enter")
    S = [float(one.split()[0]) for one in other.locator("tbody td.S").all_inner_texts()]
    assert sorted(S) == S
    head.get_by_role("button").press("Enter")
    S = [float(one.split()[0]) for one in other.locator("tbody td.S").all_inner_texts()]
    assert sorted(S, reverse=True) == S
    assert head.get_attribute("aria-sort") == "descending"
