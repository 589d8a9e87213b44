"""Columns of the SPMD table HV_Primary: by its header, or by position where it has none."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.trips.table_header import TableLayout, check_columns, read_header

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
"""A table without a header is told by so many first lines, of which the first may be an odd one."""


def layout_of(path: Path) -> TableLayout | None:
    """How a file's rows are laid out; None if it is another table.

    Raises
    ------
    RecordingError
        If it cannot be read as a table at all, or it is HV_Primary but lacks a column.
    """
    header = read_header(path)
    lower = {name.lower() for name in header.columns}
    if {LEFT.lower(), RIGHT.lower()} & lower:
        check_columns(header.columns, KEY, REQUIRED, OPTIONAL)
        usual = [name.lower() for name in header.columns] == [name.lower() for name in POSITIONS[: len(header.columns)]]
        cells = tuple(sorted({*CELLS, len(header.columns)})) if usual else (len(header.columns),)
        return TableLayout(_padded(header.columns, cells), header.begin, cells=cells)
    return _without_header(path)


def _padded(columns: Sequence[str], cells: Sequence[int]) -> tuple[str, ...]:
    return (*columns, *POSITIONS[len(columns) : max(cells)])


def _without_header(path: Path) -> TableLayout | None:
    try:
        with path.open("rb") as stream:
            lines = [stream.readline(1 << 16) for _ in range(LOOKED_AT)]
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror or error}") from None
    begin = len(codecs.BOM_UTF8) if lines[0].startswith(codecs.BOM_UTF8) else 0
    lines[0] = lines[0][begin:]
    filled = [line for line in lines if line.strip()]
    counts = [line.count(b",") + 1 if _has_key(line) else 0 for line in filled]
    # a line may be at fault, but most must look right
    if 2 * sum(count in CELLS for count in counts) <= len(filled):
        return None
    return TableLayout(POSITIONS, begin, line=1, cells=CELLS)


def _has_key(line: bytes) -> bool:
    """Whether a line begins with three numbers: device, trip, time."""
    try:
        for cell in line.split(b",", 3)[:3]:
            float(cell.strip(b' \t"'))
    except ValueError:
        return False
    return True
