"""The page of a comparison and the page of a fit: silent, in order, open to all, printable."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.looking import faults_of_access, faults_of_layout

pytestmark = [pytest.mark.browser, pytest.mark.slow]

PAGES = pytest.mark.parametrize("name", ["compare", "fit"])
SIZES = pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])


@PAGES
@SIZES
def test_nothing_overlaps(open_page: Callable[..., Any], made: Any, name: str, width: int, height: int) -> None:
    assert faults_of_layout(open_page(made(name).path, width=width, height=height)) == []


@PAGES
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_no_serious_violation(open_page: Callable[..., Any], made: Any, axe: str, name: str, dark: bool) -> None:
    assert faults_of_access(open_page(made(name).path, dark=dark), axe) == []


@PAGES
def test_reads_without_script(open_page: Callable[..., Any], made: Any, name: str) -> None:
    page = open_page(made(name).path, script=False)
    assert page.locator("table:visible").count() >= 1
    assert [one.inner_text() for one in page.locator("button:visible, select:visible, input:visible").all()] == []
    assert faults_of_layout(page) == []


@PAGES
def test_prints(open_page: Callable[..., Any], made: Any, name: str) -> None:
    paper = open_page(made(name).path).pdf(format="A4")
    assert paper.startswith(b"%PDF")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", paper)) <= 20


def test_figures_of_the_fit_are_drawn(open_page: Callable[..., Any], made: Any) -> None:
    page = open_page(made("fit").path)
    drawings = page.locator(".panel svg, .pairgrid svg")
    assert drawings.count() == 2 * (4 + 2 + 1 + 1 + 1) + 4
    for box in drawings.evaluate_all("(all) => all.map((e) => [e.clientWidth, e.clientHeight])"):
        assert box[0] >= 200
        assert box[1] >= 100
    # two maps of T and d_y with their colour bars, and twelve of pairs, a side
    assert page.locator("svg image").count() == 2 * (4 + 12)


def test_verdicts_are_told_and_filtered(open_page: Callable[..., Any], made: Any) -> None:
    compare: Path = made("compare").path
    page = open_page(compare)
    assert page.get_by_role("heading", level=1).is_visible()
    words = page.locator("main").inner_text()
    for word in ("lag", "winner"):
        assert word in words


def test_what_is_no_number_is_sorted_last(open_page: Callable[..., Any], made: Any, tmp_path: Path) -> None:
    text = made("compare").path.read_text(encoding="utf-8")
    found = re.search(r'(<script type="application/json" id="ldc-data">)(.*?)(</script>)', text, re.DOTALL)
    assert found is not None
    data = json.loads(found[2])
    packed = data["compare"]["cases"][0]["S_new"]
    values = np.frombuffer(base64.b64decode(packed["data"]), dtype=f"<{packed['type']}").copy()
    values[1] = np.nan
    packed["data"] = base64.b64encode(values.tobytes()).decode("ascii")
    changed = tmp_path / "compare.html"
    changed.write_text(text.replace(found[2], json.dumps(data).replace("<", "\\u003c")), encoding="utf-8")
    page = open_page(changed)
    head = page.locator(".block[data-case='0'] th[data-sort=S_new] button")
    for down in (False, True):
        head.click()
        cells = page.locator(".block[data-case='0'] tbody tr td:nth-child(4)").all_inner_texts()
        assert cells[-1] == "–"  # noqa: RUF001
        known = [float(cell) for cell in cells[:-1]]
        assert known == sorted(known, reverse=down)
        assert len(known) == values.size - 1
