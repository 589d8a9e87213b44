"""At the widths of a desk and of a hand, light and dark: nothing over anything else, nothing cut, nothing sideways."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from helpers.looking import faults_of_layout

pytestmark = [pytest.mark.browser, pytest.mark.slow]

SIZES = pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)], ids=["desk", "hand"])
PAGES = (
    "ordinary", "hostile", "thousand", "zero-triggered", "one-design", "only-no-control", "left-only", "one-scenario",
    "all-failures", "nothing-ranked",
)  # fmt: skip


@pytest.mark.parametrize("name", PAGES)
@SIZES
def test_nothing_overlaps(open_page: Callable[..., Any], made: Any, name: str, width: int, height: int) -> None:
    page = open_page(made(name).path, width=width, height=height)
    assert faults_of_layout(page) == []


@SIZES
def test_nor_without_script(open_page: Callable[..., Any], made: Any, width: int, height: int) -> None:
    page = open_page(made("ordinary").path, width=width, height=height, script=False)
    assert faults_of_layout(page) == []


@SIZES
def test_nor_in_the_dark_with_everything_open(
    open_page: Callable[..., Any], made: Any, width: int, height: int
) -> None:
    page = open_page(made("ordinary").path, width=width, height=height, dark=True)
    page.evaluate("document.querySelectorAll('main details').forEach((one) => { one.open = true; })")
    assert faults_of_layout(page) == []


def test_a_picture_of_the_first_screen_is_no_blank(open_page: Callable[..., Any], made: Any) -> None:
    light = open_page(made("ordinary").path).screenshot()
    dark = open_page(made("ordinary").path, dark=True).screenshot()
    assert min(len(light), len(dark)) > 20_000
    assert light != dark
