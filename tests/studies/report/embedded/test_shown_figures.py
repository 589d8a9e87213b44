"""Every figure has words of its own, and factors that turn its unit into the one that is shown."""

from __future__ import annotations

import math

import pytest

from studies.ranking.figures import FIGURES
from studies.report.embedded.shown_figures import GROUPS, SHOWN, shown_figure


def test_every_figure_has_a_title() -> None:
    assert {one.name for one in SHOWN} == set(FIGURES)
    assert len({one.title for one in SHOWN}) == len(SHOWN)
    assert not {one.name for one in SHOWN} & {one.title for one in SHOWN} - {"S"}
    assert list(dict.fromkeys(one.group for one in SHOWN)) == list(GROUPS)


@pytest.mark.parametrize(
    ("name", "value", "shown", "unit"),
    [
        ("deeper", 0.064, 6.4, "%"),
        ("reduction", 0.25, 25.0, "%"),
        ("delta_peak_max", math.pi / 2, 90.0, "°"),
        ("effort_mean", (math.pi / 180.0) ** 2, 1.0, "°²·s"),
        ("a_y_peak_p95", 3.0, 3.0, "m/s²"),
        ("diverged", 3.0, 3.0, ""),
    ],
)
def test_units(name: str, value: float, shown: float, unit: str) -> None:
    one = shown_figure(name)
    assert value * one.scale == pytest.approx(shown)
    assert one.unit == unit
