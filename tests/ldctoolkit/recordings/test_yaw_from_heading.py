"""Yaw rates that are missing come from the heading, and nothing else is touched."""

import dataclasses

import numpy as np

from ldctoolkit.recordings import Preparation, Recording, extract_departures
from ldctoolkit.recordings.preparation import FILLED, NONE, with_yaw_rate

N = 300
T = np.arange(N) * 0.1


def bend(**changes: object) -> Recording:
    """A left bend of 1/1000 m at 25 m/s, the vehicle 0.3 m over the left line for 2 s around t = 15 s."""
    beyond = np.clip(0.3 * (1.0 - (T - 15.0) ** 2), -0.4, None)
    ones = np.ones(N)
    one = Recording(
        "a", T, 0.9 + beyond, 3.6 * ones, 25.0 * ones, ones > 0, yaw_rate=0.025 * ones,
        heading=3.0 + 0.025 * T - 2.0 * np.pi * (T > 5.0),
    )  # fmt: skip
    return dataclasses.replace(one, **changes)  # type: ignore[arg-type]


def test_a_whole_yaw_rate_stays() -> None:
    one = bend()
    assert with_yaw_rate(one) is one
    none = bend(yaw_rate=None)
    assert with_yaw_rate(none) is none


def test_a_hole_is_filled_through_a_turn_of_the_heading() -> None:
    rate = np.full(N, 0.03)
    rate[40:160] = np.nan
    filled = with_yaw_rate(bend(yaw_rate=rate))
    assert (filled.yaw_rate[:40] == 0.03).all()
    assert (filled.yaw_rate[160:] == 0.03).all()
    np.testing.assert_allclose(filled.yaw_rate[40:160], 0.025, atol=1e-9)  # rounding of the slope
    assert np.flatnonzero(~filled.yaw_rate_measured).tolist() == list(range(40, 160))
    # what a reader has marked stays marked
    own = with_yaw_rate(bend(yaw_rate=rate, yaw_rate_measured=T > 1.0))
    assert np.flatnonzero(~own.yaw_rate_measured).tolist() == [*range(11), *range(40, 160)]
    assert filled.notes == (FILLED,)


def test_holes_in_the_heading_stay_holes() -> None:
    heading = bend().heading.copy()
    heading[100:200] = np.nan
    filled = with_yaw_rate(bend(yaw_rate=np.full(N, np.nan), heading=heading))
    lost = np.isnan(filled.yaw_rate)
    assert lost[110:190].all()  # a heading holds for a second beyond the last
    assert not lost[:100].any()
    assert not lost[200:].any()


def test_without_both_the_lane_counts_as_straight() -> None:
    nothing = np.full(N, np.nan)
    one = with_yaw_rate(bend(yaw_rate=nothing, heading=nothing))
    assert one.yaw_rate is None
    assert one.yaw_rate_measured is None
    assert one.notes == (NONE,)
    # nor is the speed known: the yaw rate is the least of its troubles
    lost = with_yaw_rate(bend(yaw_rate=nothing, heading=None, speed=nothing))
    assert lost.notes == ()
    assert lost.yaw_rate is not None


def test_a_departure_is_not_lost_for_its_yaw_rate() -> None:
    rate = np.full(N, 0.025)
    rate[100:200] = np.nan
    found = extract_departures([bend(yaw_rate=rate)], vehicle_width=1.8, preparation=Preparation(0.1))
    assert found.departures.n == 1
    np.testing.assert_allclose(found.departures.c_0, 1e-3, rtol=1e-6)
