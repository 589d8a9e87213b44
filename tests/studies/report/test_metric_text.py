# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""Every metric as a page shows it: title, unit, digits and direction, as literals."""

from __future__ import annotations

import math

import pytest

from ldctoolkit.metrics import GROUPS, METRICS
from studies.report.words.metric_text import SHOWN, metric_text


@pytest.mark.parametrize(
    ("name", "group", "label", "better", "value", "text"),
    [
        ("S", "score", "Mean S [m·s]", "less", 0.12345, "0.123"),
        ("S_left", "score", "Mean S, left [m·s]", "less", 0.12345, "0.123"),
        ("S_right", "score", "Mean S, right [m·s]", "less", 0.12345, "0.123"),
        ("S_p95", "score", "S, 95 % quantile [m·s]", "less", 0.12345, "0.123"),
        ("S_cvar95", "score", "S, mean of the worst 5 % [m·s]", "less", 0.12345, "0.123"),
        ("reduction", "score", "Mean S saved against no control [%]", "more", -0.12345, "−12.3\u00a0%"),
        ("reduction_left", "score", "Saved, left [%]", "more", 0.12345, "12.3\u00a0%"),
        ("reduction_right", "score", "Saved, right [%]", "more", 0.12345, "12.3\u00a0%"),
        ("deeper", "lane", "Deeper than D_y [%]", "less", 0.06418, "6.4\u00a0%"),
        ("deepest_mean", "lane", "Deepest crossing, mean [m]", "less", -0.12345, "−0.123"),
        ("deepest_p95", "lane", "Deepest crossing, 95 % quantile [m]", "less", 0.12345, "0.123"),
        ("dtle_mean", "lane", "DTLE, mean [m]", "more", 0.12345, "0.123"),
        ("dtle_p5", "lane", "DTLE, 5 % quantile [m]", "more", 0.12345, "0.123"),
        ("dtle_min", "lane", "DTLE at its worst [m]", "more", -0.31234, "−0.312"),
        ("within_dtle", "lane", "DTLE stays above −0.3 m [%]", "more", 0.98765, "98.8\u00a0%"),
        ("opposite_crossed_share", "back", "Opposite line crossed [%]", "less", 0.06418, "6.4\u00a0%"),
        ("opposite_crossing_max", "back", "Opposite line crossed by at most [m]", "less", 0.12345, "0.123"),
        ("back_inside", "back", "Back inside [%]", "more", 0.98765, "98.8\u00a0%"),
        ("t_back_median", "back", "Back inside after, median [s]", "less", 1.23456, "1.23"),
        ("a_y_peak_mean", "comfort", "Peak a_y, mean [m/s²]", "less", 2.34567, "2.35"),
        ("a_y_peak_p95", "comfort", "Peak a_y, 95 % quantile [m/s²]", "less", 2.34567, "2.35"),
        ("a_y_peak_max", "comfort", "Peak a_y, largest [m/s²]", "less", 2.34567, "2.35"),
        ("jerk_peak_p95", "comfort", "Peak lateral jerk, 95 % quantile [m/s³]", "less", 2.34567, "2.35"),
        ("a_y_added_peak_p95", "comfort", "Peak added a_y, 95 % quantile [m/s²]", "less", 2.34567, "2.35"),
        ("jerk_added_peak_p95", "comfort", "Peak added jerk, 95 % quantile [m/s³]", "less", 2.34567, "2.35"),
        ("comfortable", "comfort", "Both limits of ISO 11270 kept [%]", "more", 0.98765, "98.8\u00a0%"),
        ("delta_peak_max", "steering", "Steering angle, largest [°]", "less", 0.05, "2.86"),
        ("delta_rate_peak_max", "steering", "Steering rate, largest [°/s]", "less", 0.5, "28.6"),
        ("effort_mean", "steering", "Steering effort, mean [°²·s]", "less", 0.001, "3.283"),
        ("travel_mean", "steering", "Steering travel, mean [°]", "less", 0.05, "2.86"),
        ("triggered", "interventions", "Taken over [%]", "less", 0.98765, "98.8\u00a0%"),
        ("needless", "interventions", "Needless interventions [%]", "less", 0.06418, "6.4\u00a0%"),
        ("solver_failed", "failures", "Departures with a failed solve", "less", 3.0, "3"),
        ("diverged", "failures", "Departures that diverged", "less", 3.0, "3"),
        ("timed_out", "failures", "Departures that timed out", "less", 3.0, "3"),
        ("crashed", "failures", "Departures that crashed", "less", 3.0, "3"),
        ("failed_solves", "failures", "Failed solves [commands]", "less", 3.0, "3"),
    ],
)
def test_what_a_page_shows(name: str, group: str, label: str, better: str, value: float, text: str) -> None:
    one = METRICS[name]
    assert (one.group, one.label, one.better) == (group, label, better)
    assert metric_text(name, value) == text
    assert metric_text(name, math.nan) == "–"


def test_every_metric_is_shown_in_its_group() -> None:
    assert {one.name for one in SHOWN} == set(METRICS)
    assert len({one.title for one in SHOWN}) == len(SHOWN)
    assert list(dict.fromkeys(one.group for one in SHOWN)) == list(GROUPS)
