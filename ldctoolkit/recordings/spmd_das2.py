"""Reader for the SPMD table HV_Primary (data acquisition system 2): lane tracker, vehicle and GPS in one row."""

import codecs
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.preparation import cut_at
from ldctoolkit.recordings.recording import Problem, Recording, measured
from ldctoolkit.recordings.trip_tables import (
    TableLayout,
    TripPart,
    TripReader,
    check_trip_columns,
    read_header,
    read_trips,
)

TABLE: Final = "HV_Primary"
KEY: Final = ("DeviceID", "Trip")
LEFT: Final = "LaneTrack_Distance_Left_Marker"
RIGHT: Final = "LaneTrack_Distance_Right_Marker"
WIDTH: Final = "LaneTrack_Lane_Width"
LEFT_PROBABILITY: Final = "LaneTrack_Probability_Left_Exist"
RIGHT_PROBABILITY: Final = "LaneTrack_Probability_Right_Exists"
SPEED: Final = "InVehicle_Longitudinal_Speed"
YAW_RATE: Final = "InVehicle_Yaw_Rate"
LEFT_SIGNAL: Final = "InVehicle_Turn_Signal_Left"
RIGHT_SIGNAL: Final = "InVehicle_Turn_Signal_Right"
GPS_VALID: Final = "GPS_Valid"
GPS_HEADING: Final = "GPS_Heading"
GPS_SPEED: Final = "GPS_Speed"

REQUIRED: Final = ("Time", LEFT, RIGHT, LEFT_PROBABILITY, RIGHT_PROBABILITY, SPEED)
OPTIONAL: Final = (WIDTH, YAW_RATE, LEFT_SIGNAL, RIGHT_SIGNAL, GPS_VALID, GPS_HEADING, GPS_SPEED)

POSITIONS: Final = (
    "DeviceID", "Trip", "Time", "GPS_Elevation", "GPS_Fix_Quality", "GPS_Hdop", "GPS_Heading", "GPS_Latitude",
    "GPS_Longitude", "GPS_Number_Satellites", "GPS_Pdop", "GPS_Speed", "GPS_UTC_Time", "GPS_Valid", "DAS_Roll_Rate",
    "DAS_Pitch_Rate", "InVehicle_ABS_State", "InVehicle_Brake_Status", "InVehicle_Headlight_Status",
    "InVehicle_Longitudinal_Accel", "InVehicle_Longitudinal_Speed", "InVehicle_PRNDL",
    "InVehicle_Stability_Control_Status", "InVehicle_Steering_Position", "InVehicle_Throttle_Position",
    "InVehicle_Traction_Control_Status", "InVehicle_Turn_Signal_Left", "InVehicle_Turn_Signal_Right",
    "InVehicle_Wiper_Status", "InVehicle_Yaw_Rate", "LaneTrack_Crossing_Left", "LaneTrack_Crossing_Right",
    "LaneTrack_Distance_Left_Marker", "LaneTrack_Distance_Right_Marker", "LaneTrack_Lane_Width",
    "LaneTrack_Probability_Left_Exist", "LaneTrack_Probability_Right_Exists", "LaneTrack_Shift_Aborted",
    "LaneTrack_Shift_Left", "LaneTrack_Shift_Right", "LaneTrack_Shift_Successful",
    "LaneTrack_Type_LeftLane_LeftMarker", "LaneTrack_Type_LeftLane_RightMarker", "LaneTrack_Type_RightLane_LeftMarker",
    "LaneTrack_Type_RightLane_RightMarker",
    "Video_Frame", "Video_Front", "Video_Overlay", "Object_Left_F", "Object_Right_F", "Object_Left_B", "Object_Right_B",
    "DVISwitchState",
)  # fmt: skip
"""Names of the columns in the order of the one-day table. The two-month table has no header."""

CELLS: Final = (45, 53)
"""Cells of a row: the table comes with and without the last eight columns, also both in one file."""

LOOKED_AT: Final = 20
"""A table without a header is recognised by so many first lines, of which the first may be an odd one."""


def _layout_of(path: Path) -> TableLayout:
    """How a file's rows are laid out, or why it is another table."""
    header = read_header(path)
    columns, lower = header.columns, [name.lower() for name in header.columns]
    if {LEFT.lower(), RIGHT.lower()}.intersection(lower):
        check_trip_columns(columns, KEY, REQUIRED, OPTIONAL)
        usual = lower == [name.lower() for name in POSITIONS[: len(columns)]]
        cells = tuple(sorted({*CELLS, len(columns)})) if usual else (len(columns),)
        return TableLayout((*columns, *POSITIONS[len(columns) : max(cells)]), header.begin, kind=TABLE, cells=cells)
    try:
        with path.open("rb") as stream:
            lines = [stream.readline(1 << 16) for _ in range(LOOKED_AT)]
    except OSError as error:
        raise RecordingError("", f"cannot be read: {error.strerror}") from None
    begin = len(codecs.BOM_UTF8) if lines[0].startswith(codecs.BOM_UTF8) else 0
    lines[0] = lines[0][begin:]
    filled = [line for line in lines if line.strip()]
    counts = [line.count(b",") + 1 if _has_key(line) else 0 for line in filled]
    # a line may be at fault, but most must look right
    if 2 * sum(count in CELLS for count in counts) > len(filled):
        return TableLayout(POSITIONS, begin, line=1, kind=TABLE, cells=CELLS)
    needed = f"columns of {TABLE} nor rows of {' or '.join(map(str, CELLS))} cells that begin with numbers"
    return TableLayout(columns, begin, note=f"neither the {needed}; the file is left out")


def _has_key(line: bytes) -> bool:
    """Whether a line begins with three numbers: device, trip, time."""
    try:
        for cell in line.split(b",", 3)[:3]:
            float(cell.strip(b' \t"'))
    except ValueError:
        return False
    return True


USABLE_PROBABILITY: Final = 500.0  # both markers must exist with at least this probability, of 1000

WIDTH_TOLERANCE: Final = 0.5
"""The markers must be as far apart as the tracker's lane width says, within this [m]: else one of them is not the
lane's, and the width is an assumed one (12 feet)."""


def _recordings_of(part: TripPart) -> Iterator[Recording | Problem]:
    """Recordings in the order of the table; problems come first."""
    (table,) = part.tables
    rows = read_trips(table, part.stretches(0), (*REQUIRED, *OPTIONAL))
    yield from rows.problems
    columns = signals_of(rows.columns)
    missing = [name for name in OPTIONAL if name not in rows.columns]
    notes = (f"no column {', '.join(missing)}",) if missing else ()
    ends = np.searchsorted(rows.trip, np.arange(len(part.trips) + 1)).tolist()
    for i, ((stretches,), begin, end) in enumerate(zip(part.trips, ends[:-1], ends[1:], strict=True)):
        if begin == end:
            continue  # every row was left out, and reported
        rows_of_trip = slice(begin, end)
        signals: dict[str, Any] = {name: x if x is None else x[rows_of_trip] for name, x in columns.items()}
        cut, _ = cut_at(rows.columns["Time"][rows_of_trip], rows.joins(i))
        yield Recording(stretches[0].name, source=table.name, notes=notes, cut=cut, **signals)


def signals_of(cells: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Columns of a `Recording` from the cells of rows, by column.

    Numbers of 1e9 or more in size count as missing. The tracker's flags for crossings and lane changes are not used:
    what sets them is not documented.
    """

    def column(name: str) -> FloatArray:
        return measured(cells[name]) if name in cells else np.full(cells["Time"].size, np.nan)

    left, right, recorded = column(LEFT) / 1000.0, column(RIGHT) / 1000.0, column(WIDTH) / 1000.0
    width = right - left
    agree = ~(recorded > 0.0) | (np.abs(width - recorded) <= WIDTH_TOLERANCE)  # without one nothing contradicts
    seen = np.minimum(column(LEFT_PROBABILITY), column(RIGHT_PROBABILITY)) >= USABLE_PROBABILITY
    gps = column(GPS_VALID) == 1.0
    speed = column(SPEED)
    signal = (column(LEFT_SIGNAL) > 0.0).astype(np.int64) - (column(RIGHT_SIGNAL) > 0.0)
    return {
        "t": cells["Time"] / 1000.0,
        "lane_offset": 0.5 * (left + right),
        "lane_width": width,
        "speed": np.where(np.isfinite(speed), speed, np.where(gps, column(GPS_SPEED), np.nan)),
        "valid": seen & agree & (width > 0.0),
        "yaw_rate": np.radians(column(YAW_RATE)) if YAW_RATE in cells else None,
        "heading": np.where(gps, -np.radians(column(GPS_HEADING)), np.nan),
        "turn_signal": signal.astype(np.int64),
    }


def _named(path: Path) -> str:
    """The table, if the file's name speaks of it."""
    return TABLE if re.search(r"hv[ _-]?primary", path.name, re.IGNORECASE) else ""


def _kind(path: Path) -> str:
    """The kind of a file's table, and whether a header is missing; empty for another file."""
    layout = _layout_of(path)
    return f"{layout.kind} without a header" if layout.kind and layout.line == 1 else layout.kind


READER: Final = TripReader(
    name="spmd-das2",
    title="SPMD table HV_Primary",
    kinds={TABLE: f"trip of a table {TABLE}"},
    named=_named,
    kind_of=_kind,
    layout_of=_layout_of,
    recordings_of=_recordings_of,
    part_bytes=32 << 20,
)
