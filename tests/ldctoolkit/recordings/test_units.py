"""Columns in another unit: a warning in words, no crash."""

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.recordings import extract_departures


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (
            {"speed": 25.0 * 3.6},
            "column 'speed': 100% of the samples are above 60 m/s (216 km/h); the unit looks like km/h",
        ),
        ({"speed": np.where(T < 9.7, 40.0, 61.0)}, "the unit looks like km/h"),  # in town, but sometimes 61 km/h
        ({"speed": 50.0}, "most samples are above 42 m/s"),  # in town, at a steady 50 km/h
        ({"speed": 25_000.0}, "the unit looks like mm/s"),
        ({"speed": -25.0}, "column 'speed': most values are negative"),
        ({"lane_offset": 1000.0 * OFFSET}, "column 'lane_offset': most values are beyond 10; the unit looks like mm"),
        ({"lane_offset": OFFSET + 3.6}, "further than a lane width from the lane's centre"),
        ({"lane_width": 3600.0}, "column 'lane_width': most values are above 1000; the unit looks like mm"),
        ({"lane_width": 360.0}, "the unit looks like cm"),
        ({"lane_width": 12.0}, "is the unit feet?"),
        ({"lane_width": 1.85}, "most lanes are narrower than 2 m"),
        ({"t": 1000.0 * T}, "column 't': the time step is above 2 in most recordings; the unit looks like ms"),
        ({"t": T / 3600.0}, "column 't': the time step is below 0.002"),
        ({"curvature": 800.0}, "column 'curvature': 100% of the samples are beyond 0.2 1/m"),
        ({"curvature": None, "yaw_rate": 2.0}, "the unit looks like deg/s"),
    ],
)
def test_a_warning_names_column_and_unit(columns, words):
    found = extract_departures([drive(**columns)], vehicle_width=1.8)
    assert len(found.warnings) == 1
    assert words in found.warnings[0]


def test_all_in_mm_and_kmh():
    found = extract_departures([drive(lane_offset=1000 * OFFSET, lane_width=3600.0, speed=90.0)], vehicle_width=1.8)
    assert [warning.split(":")[0] for warning in found.warnings] == [
        "column 'speed'",
        "column 'lane_width'",
        "column 'lane_offset'",
    ]


def test_a_vehicle_as_wide_as_the_lane():
    found = extract_departures([drive(lane_width=2.5)], vehicle_width=2.55)
    assert found.warnings == ("vehicle width 2.55 m: most lanes are no wider than that",)


def test_plausible_recordings_give_none():
    assert extract_departures([drive(speed=41.0, t=T * 10, curvature=0.05)], vehicle_width=1.8).warnings == ()
