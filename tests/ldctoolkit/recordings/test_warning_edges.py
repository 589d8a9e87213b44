"""The limits of the warnings that docs/recordings.md names, on both sides of each."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.recordings import drive
from ldctoolkit.recordings.extract import few_usable, quality_warnings, table_of
from ldctoolkit.recordings.quality import no_statistics, unit_counts, unit_warnings
from ldctoolkit.recordings.recording import usable_samples


def reported(**changes: Any) -> str:
    plain = dataclasses.replace(no_statistics(), kinds=("yaw_rate",), bends=np.array([10_000, 5_000]))
    arrays = {name: np.array(value) for name, value in changes.items()}
    return "; ".join(quality_warnings(dataclasses.replace(plain, **arrays), 1.8, None))


@pytest.mark.parametrize(
    ("name", "silent", "warned", "words"),
    [
        # windows, and the sums of h^2, h r, r^2 over them
        ("turns", (99, 9.0, -9.0, 9.0), (100, 9.0, -9.0, 9.0), "turns against the GPS heading"),
        ("turns", (500, 9.0, 4.6, 9.0), (500, 9.0, 4.4, 9.0), "do not agree"),
        ("turns", (500, 0.79, 0.0, 9.0), (500, 0.81, 0.0, 9.0), "do not agree"),  # 0.04 rad in the root mean square
        ("turns", (500, 9.0, 9 * 1.24, 9 * 1.24**2), (500, 9.0, 9 * 1.26, 9 * 1.26**2), "1.26 times what"),
        ("turns", (500, 9.0, 9 * 0.81, 9 * 0.81**2), (500, 9.0, 9 * 0.79, 9 * 0.79**2), "0.79 times what"),
        ("bends", (10_000, 10), (10_000, 9), "the lane is straight in nearly all samples"),
        ("bends", (1000, 0), (1001, 0), "the lane is straight in nearly all samples"),
        ("median_widths", [2.8], [2.79], "median lane width"),
        ("median_widths", [4.3], [4.31], "median lane width"),
        ("median_widths", [2.4] + [3.5] * 20, [2.4] * 2 + [3.5] * 19, "median lane width"),  # the outer 5 %
        ("median_widths", [2.5, 3.0, 3.2], [2.5, 3.0, 3.3], "median lane width"),  # by more than a quarter
    ],
)
def test_evidence(name, silent, warned, words):
    assert reported(**{name: silent}) == ""
    assert words in reported(**{name: warned})


def test_a_quarter_of_the_samples_is_enough():
    assert few_usable(100, 25) == ()
    assert few_usable(100, 24) == (
        "only 24 of 100 samples can be used (24.0%): in the others the lane, the speed or the yaw rate is missing, or "
        "the source itself distrusts them",
    )


@pytest.mark.parametrize(
    ("name", "most", "words"),
    [
        ("speed > 60", 10, "above 60 m/s"), ("speed > 42", 500, "above 42 m/s"), ("speed > 1000", 500, "mm/s"),
        ("speed < 0", 500, "negative"), ("width > 1000", 500, "looks like mm"), ("width > 100", 500, "looks like cm"),
        ("width > 6", 500, "feet"), ("width < 2", 500, "not half"), ("width <= vehicle", 500, "no wider"),
        ("offset > 10", 500, "beyond 10"), ("offset > width", 50, "further than a lane width"),
        ("step > 2", 20, "above 2"), ("step < 0.002", 20, "below 0.002"), ("curvature > 0.2", 10, "beyond 0.2 1/m"),
        ("yaw rate > 1.5", 10, "beyond 1.5 rad/s"),
    ],
)  # fmt: skip
def test_shares_of_samples_or_recordings(name, most, words):
    counts = {"samples": 1000, "recordings": 40}
    assert unit_warnings(counts | {name: most}, 1.8) == []
    (warning,) = unit_warnings(counts | {name: most + 1}, 1.8)
    assert words in warning


@pytest.mark.parametrize(
    ("column", "limit", "name"),
    [
        ("speed", 60.0, "speed > 60"), ("speed", 42.0, "speed > 42"), ("speed", 1000.0, "speed > 1000"),
        ("lane_width", 1000.0, "width > 1000"), ("lane_width", 100.0, "width > 100"), ("lane_width", 6.0, "width > 6"),
        ("lane_offset", -10.0, "offset > 10"), ("lane_offset", 3.6, "offset > width"),
        ("curvature", -0.2, "curvature > 0.2"), ("yaw_rate", -1.5, "yaw rate > 1.5"),
    ],
)  # fmt: skip
def test_values_are_counted_beyond_their_limit(column, limit, name):
    own = {"lane_offset": 0.0} | ({"curvature": None} if column == "yaw_rate" else {})
    for value, counted in ((limit, 0), (np.nextafter(limit, np.sign(limit) * np.inf), 3)):
        one = table_of([drive(t=[0.0, 0.1, 0.2], **(own | {column: value}))])
        assert dict(unit_counts(one, usable_samples(one), np.array([0.1]), 1.8))[name] == counted


def test_values_that_are_counted_below_a_limit():
    def counted(step: float = 0.1, **columns: float) -> dict[str, int]:
        one = table_of([drive(t=[0.0, 0.1, 0.2], lane_offset=0.0, **columns)])
        return dict(unit_counts(one, usable_samples(one), np.array([step, np.nan]), 1.8))

    below = np.nextafter(2.0, 0.0)
    assert (counted(lane_width=2.0)["width < 2"], counted(lane_width=below)["width < 2"]) == (0, 3)
    assert (counted(lane_width=1.8)["width <= vehicle"], counted(lane_width=1.81)["width <= vehicle"]) == (3, 0)
    assert (counted(speed=0.0)["speed < 0"], counted(speed=-0.1)["speed < 0"]) == (0, 3)
    assert (counted(2.0)["step > 2"], counted(2.1)["step > 2"]) == (0, 1)
    assert (counted(0.002)["step < 0.002"], counted(0.0019)["step < 0.002"]) == (0, 1)
