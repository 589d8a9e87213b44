"""Reader for the SPMD tables DataLane and DataWsu (data acquisition system 1).

The lane table has the camera's distances, the other one the vehicle's own signals and its GPS; rows of both belong
together by device, trip and time, which is in centiseconds.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.recordings.preparation import cut_at, nearest_times
from ldctoolkit.recordings.recording import LARGEST, Problem, Recording, measured
from ldctoolkit.recordings.text_table import LineFault, grouped_problems
from ldctoolkit.recordings.trip_tables import (
    TableLayout,
    TripPart,
    TripReader,
    check_trip_columns,
    read_header,
    read_trips,
)

TOLERANCE: Final = 5.0
"""Half a step of 10 Hz [centiseconds]: the largest distance in time between rows that belong together."""

USABLE_QUALITY: Final = (2.0, 3.0)
PLACEHOLDER: Final = (-1.875, 1.875)  # distances to the left and right that stand for "no lane"

ALONE: Final = "no rows in DataWsu, so that speed and yaw rate are not known"

LANE: Final = ("Time", "LaneDistanceLeft", "LaneDistanceRight", "LaneQualityLeft", "LaneQualityRight")
WSU: Final = (
    "Time", "ValidCanWsu", "SpeedWsu", "YawRateWsu", "TurnSngLWsu", "TurnSngRWsu",
    "GpsValidWsu", "GpsSpeedWsu", "GpsHeadingWsu",
)  # fmt: skip


def _recordings_of(part: TripPart) -> Iterator[Recording | Problem]:
    """What could not be used, then recordings in the order of the lane table."""
    lane_table, wsu_table = part.tables
    lane, wsu = read_trips(lane_table, part.stretches(0), LANE), read_trips(wsu_table, part.stretches(1), WSU)
    yield from lane.problems
    yield from wsu.problems
    lane_t = lane.columns["Time"]
    match = nearest_rows(lane.trip, lane_t, wsu.trip, wsu.columns["Time"], TOLERANCE)
    signals = _signals(lane.columns, wsu.columns, match)
    ends = np.searchsorted(lane.trip, np.arange(len(part.trips) + 1)).tolist()
    partner_rows = np.bincount(wsu.trip, minlength=len(part.trips))
    joined = np.concatenate([[0], np.cumsum(match >= 0)])
    faults: list[LineFault] = []
    for i, (stretches, partners) in enumerate(part.trips):
        begin, end, name = ends[i], ends[i + 1], stretches[0].name
        if begin == end or (partners and not partner_rows[i]):
            continue  # every row was left out, and reported
        if partners and joined[begin] == joined[end]:
            near = f"no row of {wsu_table.name} lies within {TOLERANCE:g} centiseconds of any of its rows"
            faults.append(LineFault(stretches[0].line, "apart", f"trip {name}: {near}; it is left out"))
            continue
        columns = {column: values[begin:end] for column, values in signals.items()}
        columns["cut"], inside = cut_at(lane_t[begin:end], np.concatenate([lane.joins(i), wsu.joins(i)]))
        columns["valid"] &= ~inside
        yield Recording(name, source=lane_table.name, notes=() if partners else (ALONE,), **columns)
    yield from grouped_problems(lane_table.name, faults)


def _signals(lane: Mapping[str, FloatArray], wsu: Mapping[str, FloatArray], match: IntArray) -> dict[str, Any]:
    """Columns of a `Recording` from the cells of rows; those without a partner have no speed.

    Numbers of 1e9 or more in size count as missing.
    """
    left, right = measured(lane["LaneDistanceLeft"]), measured(lane["LaneDistanceRight"])
    placeholder = (left == PLACEHOLDER[0]) & (right == PLACEHOLDER[1])
    quality = np.isin(lane["LaneQualityLeft"], USABLE_QUALITY) & np.isin(lane["LaneQualityRight"], USABLE_QUALITY)
    matched = match >= 0

    def partner(values: FloatArray) -> FloatArray:
        partners = np.full(match.size, np.nan)
        partners[matched] = values[match[matched]]
        return partners

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


def nearest_rows(
    trip: IntArray, t: FloatArray, other_trip: IntArray, other_t: FloatArray, tolerance: float
) -> IntArray:
    """For each row, the row of the other table of the same trip that is nearest in time; -1 where none is near enough.

    Of two as near the earlier one, of rows with one time the first. Neither trips nor the times of a trip fall.
    """
    match = np.full(t.size, -1, dtype=np.int64)
    for number in np.unique(trip):
        (low, high), (first, last) = (np.searchsorted(trips, [number, number + 1]) for trips in (trip, other_trip))
        times, other_times = t[low:high], other_t[first:last]
        if not other_times.size:
            continue
        if np.array_equal(times, other_times) and (times[1:] > times[:-1]).all():  # as usual
            match[low:high] = np.arange(first, last)
            continue
        nearest = nearest_times(other_times, times)
        match[low:high] = np.where(np.abs(other_times[nearest] - times) <= tolerance, first + nearest, -1)
    return match


KEY: Final = ("Device", "Trip")
_COLUMNS: Final = {"DataLane": LANE, "DataWsu": WSU}
_RECOGNISED_BY: Final = {"DataLane": ("LaneDistanceLeft", "LaneDistanceRight"), "DataWsu": ("SpeedWsu", "YawRateWsu")}
_NAMED: Final = re.compile(r"data[ _-]?(lane|wsu)", re.IGNORECASE)


def _kind(columns: Sequence[str]) -> str:
    """Which table has these columns; empty for neither."""
    lower = {name.lower() for name in columns}
    for kind, typical in _RECOGNISED_BY.items():
        if lower.issuperset(name.lower() for name in typical):
            return kind
    return ""


def _named(path: Path) -> str:
    """Which table the file's name speaks of; empty for none."""
    match = _NAMED.search(path.name)
    if match is None or "summary" in path.name.lower():
        return ""
    return "DataLane" if match[1].lower() == "lane" else "DataWsu"


def _layout_of(path: Path) -> TableLayout:
    """Which table a file is, and what is odd about it."""
    header = read_header(path)
    kind = _kind(header.columns)
    if not kind:
        shown = ", ".join(header.columns[:8]) + (", ..." if len(header.columns) > 8 else "")
        note = f"neither the columns of DataLane nor those of DataWsu: {shown[:120]}; the file is left out"
        return dataclasses.replace(header, note=note)
    check_trip_columns(header.columns, KEY, _COLUMNS[kind])
    note = f"the columns are those of {kind}, the name is not; read as {kind}. Are two files swapped?"
    return dataclasses.replace(header, kind=kind, note=note if _named(path) not in ("", kind) else "")


READER: Final = TripReader(
    name="spmd-das1",
    title="SPMD tables DataLane and DataWsu",
    kinds={kind: f"table {kind} (columns {', '.join((*KEY, *columns))})" for kind, columns in _COLUMNS.items()},
    named=_named,
    kind_of=lambda path: _kind(read_header(path).columns),
    layout_of=_layout_of,
    recordings_of=_recordings_of,
    part_bytes=24 << 20,
)
