"""Criteria exactly on their edges. All times and offsets are exact in binary, and so are durations and mean speeds."""

from typing import Any

import numpy as np
import pytest

from helpers.recordings import drive
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Criteria, Preparation, Recording, extract_departures

STEP = 0.125


def fate(beyond: int, *, criteria: dict[str, Any] | None = None, **columns: Any) -> str:
    """Extract a recording with one stretch of some samples beyond the left line; "departure", or why it is refused. It
    starts and ends on a sample that lies on the line itself, so it lasts (beyond + 1) steps. The lane is 3 m wide, the
    vehicle 2 m, the speed 16 m/s."""
    y = np.full(beyond + 12, -0.25)
    y[5:-5] = 0.0
    y[6:-6] = 0.25
    one, given = np.ones(y.size), {"lane": np.ones(y.size, dtype=np.int64), "curvature": np.zeros(y.size)} | columns
    base: dict[str, Any] = {"t": STEP * np.arange(y.size), "lane_offset": 0.5 + y, "lane_width": 3.0 * one}
    base |= {"speed": 16.0 * one, "valid": one > 0}
    found = extract_departures([Recording("a", **(base | given))], **({"vehicle_width": 2.0} | (criteria or {})))
    assert found.candidates == 1
    return next((reason for reason, count in found.refused.items() if count), "departure")


@pytest.mark.parametrize(
    ("beyond", "criteria", "expected"),
    [
        (3, {}, "departure"),  # 0.5 s, and three samples
        (3, {"min_duration": np.nextafter(0.5, 1.0)}, "too_short"),
        (2, {}, "too_short"),
        (2, {"min_duration": 0.375}, "too_few_samples"),
        (79, {}, "departure"),  # 10 s
        (79, {"max_duration": np.nextafter(10.0, 0.0)}, "too_long"),
        (80, {}, "too_long"),
    ],
)
def test_the_allowed_durations_include_both_ends(beyond, criteria, expected):
    assert fate(beyond, criteria=criteria) == expected


@pytest.mark.parametrize(("speed", "expected"), [(5.0, "slow"), (5.0001, "departure")])
def test_the_mean_speed_lies_above_the_limit(speed, expected):
    assert fate(15, speed=np.full(27, speed)) == expected
    assert fate(15, speed=np.full(27, speed), criteria={"min_speed": 4.0}) == "departure"


def later(rows: int, seconds: float, beyond: int = 15, step: float = STEP) -> np.ndarray:
    """Times with one step longer by some seconds."""
    t = step * np.arange(beyond + 12)
    return t + seconds * (np.arange(t.size) > rows)


@pytest.mark.parametrize(
    ("t", "criteria", "expected"),
    [
        (later(12, 0.375), {"max_gap": 0.5}, "departure"),
        (later(12, 0.375), {"max_gap": np.nextafter(0.5, 0.0)}, "gap"),
        # 2.5 median steps
        (later(12, 0.1875), {}, "departure"),
        (later(12, 0.1876), {}, "gap"),
        # at least 0.25 s
        (later(12, 0.1875, step=0.0625), {}, "departure"),
        (later(12, 0.1876, step=0.0625), {}, "gap"),
    ],
)
def test_a_step_as_long_as_the_limit_is_no_gap(t, criteria, expected):
    assert fate(15, t=t, criteria=criteria) == expected


@pytest.mark.parametrize(("step", "expected"), [(0.5, "departure"), (0.53125, "jump")])
def test_a_step_of_the_offset_as_large_as_the_limit_is_no_jump(step, expected):
    offset = np.full(27, 0.25)
    offset[6:-6] = 0.25 + step
    assert fate(15, lane_offset=offset, criteria={"max_jump": 0.5}) == expected


@pytest.mark.parametrize(("reach", "expected"), [(2.8, "lane_change"), (np.nextafter(2.8, 0.0), "departure")])
def test_an_offset_that_reaches_the_next_lane(reach, expected):
    """0.7 lane widths; the steps are too small for a jump."""
    offset = np.concatenate([np.zeros(4), np.linspace(0.0, 2.5, 8), [reach] * 3, np.linspace(2.5, 0.0, 8), np.zeros(4)])
    assert fate(15, lane=None, lane_offset=offset, lane_width=np.full(27, 4.0)) == expected


@pytest.mark.parametrize(
    ("step", "expected"), [(2.75, "jump"), (2.85, "lane_change"), (5.15, "lane_change"), (5.25, "jump")]
)
def test_a_step_of_the_offset_by_about_a_lane_width(step, expected):
    """0.7 to 1.3 of 4 m."""
    offset = np.full(27, 1.125)
    offset[12:] -= step
    offset[:6] = 0.5
    assert fate(15, lane=None, lane_offset=offset, lane_width=np.full(27, 4.0)) == expected


@pytest.mark.parametrize(("width", "expected"), [(2.0, "implausible"), (2.03125, "departure")])
def test_a_lane_as_wide_as_the_vehicle(width, expected):
    widths = np.full(27, 3.0)
    widths[12] = width
    assert fate(15, lane_width=widths) == expected


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"lane_width": 1e9}, "invalid"), ({"speed": np.nextafter(1e9, 0.0)}, "implausible"),
        ({"speed": -1e9}, "invalid"), ({"lane_width": 0.0}, "invalid"), ({"curvature": 1e9}, "invalid"),
    ],
)  # fmt: skip
def test_numbers_that_are_no_measurement(columns, expected):
    """1e9 or more in size, or a lane without a width."""
    ((name, value),) = columns.items()
    values = np.full(27, {"lane_width": 3.0, "speed": 16.0, "curvature": 0.0}[name])
    values[12] = value
    assert fate(15, **{name: values}) == expected


@pytest.mark.parametrize(
    ("kind", "name", "good", "bad"),
    [
        (Criteria, "vehicle_width", (0.5, 4.0), (0.49, 4.01)), (Criteria, "min_duration", (0.0, 9.9), (-0.01, 10.0)),
        (Criteria, "max_duration", (0.51, 1e6), (0.5, np.inf)), (Criteria, "min_speed", (0.0,), (-0.01, np.inf)),
        (Criteria, "max_gap", (1e-3, None), (0.0, np.inf, np.nan)), (Criteria, "max_jump", (1e-3,), (0.0, np.nan)),
        (Preparation, "step", (0.01, 1.0, None), (0.0099, 1.01, np.nan)),
        (Preparation, "max_gap", (1e-3, 10.0), (0.0, 10.01, np.inf)),
        (Preparation, "nominal_lane_width", (2.0, 6.0, None), (1.99, 6.01)),
        (Preparation, "yaw_rate_factor", (-1.0, 1e-3), (0.0, np.nan, np.inf)),
    ],
)  # fmt: skip
def test_the_ends_of_what_is_allowed(kind, name, good, bad):
    for value in good:
        kind(**{name: value})
    for value in bad:
        with pytest.raises(InputError, match=rf"^{name if name != 'min_duration' or value < 0 else 'max_duration'}: "):
            kind(**{name: value})


def test_the_hours_count_a_step_as_long_as_the_limit():
    t = np.array([0.0, 0.125, 0.25, 0.5, 0.625, 1.0, 1.125])
    found = extract_departures([drive(t=t, lane_offset=0.0)], max_gap=0.25)
    assert found.hours * 3600.0 == 0.75
