"""Tables HV_Primary in the schema of SPMD DAS2, made by code from the same drives as `das1_tables` makes."""

from collections.abc import Sequence
from typing import Any

import numpy as np

HEADER = (
    "DeviceID,Trip,Time,GPS_Elevation,GPS_Fix_Quality,GPS_Hdop,GPS_Heading,GPS_Latitude,GPS_Longitude,"
    "GPS_Number_Satellites,GPS_Pdop,GPS_Speed,GPS_UTC_Time,GPS_Valid,DAS_Roll_Rate,DAS_Pitch_Rate,InVehicle_ABS_State,"
    "InVehicle_Brake_Status,InVehicle_Headlight_Status,InVehicle_Longitudinal_Accel,InVehicle_Longitudinal_Speed,"
    "InVehicle_PRNDL,InVehicle_Stability_Control_Status,InVehicle_Steering_Position,InVehicle_Throttle_Position,"
    "InVehicle_Traction_Control_Status,InVehicle_Turn_Signal_Left,InVehicle_Turn_Signal_Right,InVehicle_Wiper_Status,"
    "InVehicle_Yaw_Rate,LaneTrack_Crossing_Left,LaneTrack_Crossing_Right,LaneTrack_Distance_Left_Marker,"
    "LaneTrack_Distance_Right_Marker,LaneTrack_Lane_Width,LaneTrack_Probability_Left_Exist,"
    "LaneTrack_Probability_Right_Exists,LaneTrack_Shift_Aborted,LaneTrack_Shift_Left,LaneTrack_Shift_Right,"
    "LaneTrack_Shift_Successful,LaneTrack_Type_LeftLane_LeftMarker,LaneTrack_Type_LeftLane_RightMarker,"
    "LaneTrack_Type_RightLane_LeftMarker,LaneTrack_Type_RightLane_RightMarker,Video_Frame,Video_Front,Video_Overlay,"
    "Object_Left_F,Object_Right_F,Object_Left_B,Object_Right_B,DVISwitchState"
)
COLUMNS = HEADER.split(",")


def rows_of(drive: Any, *, probability: int = 900, **cells: Any) -> list[dict[str, str]]:
    """Cells of a drive's rows by column; `cells` replaces whole columns. A drive's time is in centiseconds."""
    time = np.asarray(drive.time)
    m = time.size
    half = 500.0 * np.broadcast_to(drive.lane_width, m)
    middle = 1000.0 * np.broadcast_to(drive.lane_offset, m)
    heading = np.degrees(-np.broadcast_to(drive.heading, m)) % 360.0
    columns: dict[str, Any] = dict.fromkeys(COLUMNS[:45], 0) | {
        "DeviceID": drive.device,
        "Trip": drive.trip,
        "Time": 10 * time,
        "GPS_Heading": [f"{one:.6f}" for one in heading],
        "GPS_Speed": [f"{one:.17g}" for one in np.broadcast_to(drive.speed, m)],
        "GPS_Valid": drive.valid_gps,
        "InVehicle_ABS_State": "2         ",
        "InVehicle_Brake_Status": "15        ",
        "InVehicle_Longitudinal_Speed": [f"{one:.6f}" for one in np.broadcast_to(drive.speed, m)],
        "InVehicle_Yaw_Rate": [f"{one:.16E}" for one in np.degrees(np.broadcast_to(drive.yaw_rate, m))],
        "InVehicle_Turn_Signal_Left": np.asarray(np.equal(drive.turn_signal, 1), int),
        "InVehicle_Turn_Signal_Right": np.asarray(np.equal(drive.turn_signal, -1), int),
        "LaneTrack_Distance_Left_Marker": [f"{one:.1f}" for one in middle - half],
        "LaneTrack_Distance_Right_Marker": [f"{one:.1f}" for one in middle + half],
        "LaneTrack_Lane_Width": [f"{one:.10f}" for one in 2.0 * half],
        "LaneTrack_Probability_Left_Exist": probability,
        "LaneTrack_Probability_Right_Exists": probability,
    }
    columns |= cells
    spread = {
        name: [str(one) for one in (np.broadcast_to(values, m) if np.ndim(values) == 0 else values)]
        for name, values in columns.items()
    }
    return [{name: values[i] for name, values in spread.items()} for i in range(m)]


def lines_of(rows: Sequence[dict[str, str]], cells: int = 53) -> list[str]:
    """Rows as text, with or without the last eight columns, which hold nothing."""
    return [",".join([*row.values(), *["NULL"] * (cells - 45)]) for row in rows]


ODD_FIRST = "10,1417715,1970" + "," * 27 + ",0" * 15 + "," * 8
"""First row of the table without a header: 53 cells, most of them empty."""
