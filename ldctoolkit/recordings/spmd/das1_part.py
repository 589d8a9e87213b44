"""Trips of the SPMD tables DataLane and DataWsu as recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.spmd.nearest_rows import nearest_rows
from ldctoolkit.recordings.table import LARGEST, measured
from ldctoolkit.recordings.trips.table_text import Cells
from ldctoolkit.recordings.trips.trip_index import Stretch
from ldctoolkit.recordings.trips.trip_rows import TripTable, read_trips, told

TripPlace = tuple[tuple[Stretch, ...], tuple[Stretch, ...]]

TOLERANCE: Final = 5.0
"""Half a step of 10 Hz [centiseconds]: the largest distance in time between rows that belong together."""

USABLE_QUALITY: Final = (2.0, 3.0)
PLACEHOLDER: Final = (-1.875, 1.875)
"""Distances to the left and right that stand for "no lane"."""

ALONE: Final = "no rows in DataWsu, so that speed and yaw rate are not known"

LANE: Final = ("Time", "LaneDistanceLeft", "LaneDistanceRight", "LaneQualityLeft", "LaneQualityRight")
WSU: Final = (
    "Time", "ValidCanWsu", "SpeedWsu", "YawRateWsu", "TurnSngLWsu", "TurnSngRWsu",
    "GpsValidWsu", "GpsSpeedWsu", "GpsHeadingWsu",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Das1Part:
    """Some trips of a lane table, and where the other table holds them.

    Attributes
    ----------
    key : str
        Names the lane table and the first trip.
    lane, wsu : TripTable
        The two tables.
    trips : tuple of (tuple of Stretch, tuple of Stretch)
        Each trip's place in both.
    """

    key: str
    lane: TripTable
    wsu: TripTable
    trips: tuple[TripPlace, ...]

    @property
    def bytes(self) -> int:
        """Text that is read."""
        return sum(map(trip_bytes, self.trips))

    def read(self) -> Iterator[Recording | Problem]:
        """What could not be used, then recordings in the order of the lane table.

        Raises
        ------
        RecordingError
            If a table cannot be read or has changed since it was looked through.
        """
        lane = read_trips(self.lane, [one for one, _ in self.trips], self.lane.spelled(LANE), time="Time")
        wsu = read_trips(self.wsu, [one for _, one in self.trips], self.wsu.spelled(WSU), time="Time")
        yield from lane.problems
        yield from wsu.problems
        match = nearest_rows(lane.trip, lane.cells["Time"], wsu.trip, wsu.cells["Time"], TOLERANCE)
        signals = _signals(lane.cells, wsu.cells, match)
        ends = np.searchsorted(lane.trip, np.arange(len(self.trips) + 1)).tolist()
        joined = np.concatenate([[0], np.cumsum(match >= 0)])
        apart: list[tuple[int, str, str]] = []
        for (stretches, there), begin, end in zip(self.trips, ends[:-1], ends[1:], strict=True):
            first = stretches[0]
            name = f"{first.device}/{first.trip}"
            if begin == end:
                continue  # every row was left out, and told
            if there and joined[begin] == joined[end]:
                near = f"no row of {self.wsu.name} lies within {TOLERANCE:g} centiseconds of any of its rows"
                apart.append((first.line, "apart", f"trip {name}: {near}; it is left out"))
                continue
            own = {column: values[begin:end] for column, values in signals.items()}
            yield Recording(name, source=self.lane.name, notes=() if there else (ALONE,), **own)
        yield from told(self.lane.name, apart)


def trip_bytes(trip: TripPlace) -> int:
    """Text of a trip in both tables."""
    return sum(one.end - one.begin for stretches in trip for one in stretches)


def _signals(lane: Cells, wsu: Cells, match: IntArray) -> dict[str, Any]:
    """Columns of a `Recording` from the cells of rows; those without a partner have no speed.

    Numbers of 1e9 or more in size count as missing.
    """
    left, right = measured(lane["LaneDistanceLeft"]), measured(lane["LaneDistanceRight"])
    placeholder = (left == PLACEHOLDER[0]) & (right == PLACEHOLDER[1])
    quality = np.isin(lane["LaneQualityLeft"], USABLE_QUALITY) & np.isin(lane["LaneQualityRight"], USABLE_QUALITY)
    found = match >= 0

    def partner(values: FloatArray) -> FloatArray:
        taken = np.full(match.size, np.nan)
        taken[found] = values[match[found]]
        return taken

    can, gps = wsu["ValidCanWsu"] == 1.0, wsu["GpsValidWsu"] == 1.0
    gps_speed = np.where(gps, measured(wsu["GpsSpeedWsu"]), np.nan)
    speed = np.where(can & (np.abs(wsu["SpeedWsu"]) < LARGEST), wsu["SpeedWsu"] / 3.6, gps_speed)
    signal = (wsu["TurnSngLWsu"] > 0.0).astype(np.float64) - (wsu["TurnSngRWsu"] > 0.0)  # both: a hazard light
    return {
        "t": lane["Time"] / 100.0,
        "lane_offset": 0.5 * (left + right),
        "lane_width": right - left,
        "speed": partner(speed),
        "valid": quality & ~placeholder & (right > left),
        "yaw_rate": partner(np.where(can, np.radians(measured(wsu["YawRateWsu"])), np.nan)),
        "turn_signal": np.nan_to_num(partner(signal)).astype(np.int64),
        "heading": partner(np.where(gps, -np.radians(measured(wsu["GpsHeadingWsu"])), np.nan)),
    }
