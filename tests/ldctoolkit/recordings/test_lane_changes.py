"""Lane changes in all the ways that sources show them; none of them is a departure."""

from typing import Any

import numpy as np
import pytest

from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.recordings import Extraction, Preparation, Recording, extract_departures
from ldctoolkit.recordings.find_departures import REASONS

WIDTH = 3.6
VEHICLE = 1.8
RATE = 20.0
T = np.arange(round(30.0 * RATE)) / RATE


def crossing(side: int, start: float = 10.0, duration: float = 4.0, reach: float = WIDTH) -> np.ndarray:
    """Lateral way [m] of a change by `reach`, smooth."""
    share = np.clip((T - start) / duration, 0.0, 1.0)
    return side * reach * share**2 * (3.0 - 2.0 * share)


def drive(way: np.ndarray, offset: np.ndarray, **columns: Any) -> Recording:
    n = way.size
    given = {"lane_width": np.full(n, WIDTH), "speed": np.full(n, 25.0), "valid": np.ones(n, bool)}
    return Recording("a", T, offset, **(given | {"curvature": np.zeros(n)} | columns))


def handed_over(way: np.ndarray) -> np.ndarray:
    """Offset from the centre of the nearest lane: the tracker changes where the centre crosses the line."""
    return way - WIDTH * np.round(way / WIDTH)


def extract(recording: Recording, step: float | None) -> Extraction:
    return extract_departures([recording], vehicle_width=VEHICLE, preparation=Preparation(step))


def reported(found: Extraction) -> dict[str, tuple[int, int]]:
    """Refused candidates by reason: left, right."""
    (account,) = found.accounts
    counts = {reason: (int(a), int(b)) for reason, a, b in zip(REASONS, *account.refused.tolist(), strict=True)}
    return {reason: count for reason, count in counts.items() if any(count)}


def one_of(side: int) -> tuple[int, int]:
    return (1, 0) if side == LEFT else (0, 1)


both_sides = pytest.mark.parametrize("side", [LEFT, RIGHT])
any_step = pytest.mark.parametrize("step", [None, 0.1])


@both_sides
@any_step
@pytest.mark.parametrize("start", [10.0, 10.01, 10.023, 10.037])
def test_a_jump_of_the_offset_by_a_lane_width(side, step, start):
    way = crossing(side, start)
    found = extract(drive(way, handed_over(way)), step)
    assert len(found.departures) == 0
    assert reported(found) == {"lane_change": one_of(side)}


@both_sides
@any_step
def test_the_reason_outranks_how_long_it_took(side, step):
    """An old lane kept for longer than a departure may last, and a turn signal on: still a lane change."""
    way = crossing(side) - crossing(side, start=24.0)
    signal = np.full(T.size, side)
    assert reported(extract(drive(way, way, turn_signal=signal), step)) == {"lane_change": one_of(side)}


@both_sides
@any_step
def test_a_lane_column(side, step):
    """It alone decides: a change of it is a lane change, a great offset in the same lane is not."""
    way = crossing(side)
    lane = np.where(np.abs(way) > 0.5 * WIDTH, 2, 1)
    assert reported(extract(drive(way, handed_over(way), lane=lane), step)) == {"lane_change": one_of(side)}
    # a small step of the offset where lanes merge
    merge = crossing(side, reach=0.3 * WIDTH) - crossing(side, start=15.0, reach=0.3 * WIDTH)
    found = extract(drive(merge, merge, lane=np.where(T > 13.0, 2, 1)), step)
    assert reported(found) == {"lane_change": one_of(side)}
    back = crossing(side, reach=0.8 * WIDTH) - crossing(side, start=15.0, reach=0.8 * WIDTH)
    found = extract(drive(back, back, lane=np.ones(T.size, dtype=np.int64)), step)
    assert (reported(found), len(found.departures)) == ({}, 1)


@both_sides
@any_step
@pytest.mark.parametrize(
    ("shown", "when", "intended"),
    [("towards", (11.0, 12.5), True), ("away", (11.0, 12.5), False), ("towards", (1.0, 5.0), False)],
)
def test_the_turn_signal(side, step, shown, when, intended):
    way = crossing(side, reach=0.4 * WIDTH) - crossing(side, start=14.0, reach=0.4 * WIDTH)
    signal = np.where((when[0] <= T) & (when[1] > T), side if shown == "towards" else -side, 0)
    found = extract(drive(way, way, turn_signal=signal), step)
    assert reported(found) == ({"intended": one_of(side)} if intended else {})
    assert len(found.departures) == (not intended)


@any_step
def test_sides_of_several(step):
    """Two changes to the left, one to the right, one departure to the right."""
    way = crossing(LEFT, 2.0) + crossing(LEFT, 8.0) + crossing(RIGHT, 14.0)
    drift = crossing(RIGHT, 22.0, 2.0, 1.2) - crossing(RIGHT, 25.0, 2.0, 1.2)
    found = extract(drive(way, handed_over(way) + drift), step)
    assert (reported(found), found.departures.side.tolist()) == ({"lane_change": (2, 1)}, [RIGHT])
    assert found.accounts[0].departures.tolist() == [0, 1]
