"""SPMD tables made for tests."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from helpers.planted import Planted

VEHICLE_WIDTH = 1.82
LANE_WIDTH = 3.6
BEND_PERIOD = 120.0  # the planted road turns left for half of this time [s], then right

LANE_COLUMNS = (
    "Device", "Trip", "Time", "LaneDistanceLeft", "LaneDistanceRight", "LaneHeading", "LaneQualityRight",
    "LaneQualityLeft",
)  # fmt: skip
WSU_COLUMNS = (
    "Device", "Trip", "Time", "GpsValidWsu", "GpsTimeWsu", "LatitudeWsu", "LongitudeWsu", "AltitudeWsu",
    "GpsHeadingWsu", "GpsSpeedWsu", "HdopWsu", "PdopWsu", "FixQualityWsu", "GpsCoastingWsu", "ValidCanWsu",
    "YawRateWsu", "SpeedWsu", "TurnSngRWsu", "TurnSngLWsu", "BrakeAbsTcsWsu", "AxWsu", "PrndlWsu", "VsaActiveWsu",
    "HeadlampWsu", "WiperWsu", "ThrottleWsu", "SteerWsu",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Drive:
    """One trip at the times of both tables. `time` is in centiseconds, everything else in SI units: offset, yaw rate
    and heading positive to the left."""

    device: int
    trip: int
    time: Any
    lane_offset: Any
    lane_width: Any
    speed: Any
    yaw_rate: Any
    heading: Any = 0.0
    quality: Any = 3
    turn_signal: Any = 0
    valid_can: Any = 1
    valid_gps: Any = 1


def curvature_at(t: np.ndarray) -> np.ndarray:
    """Of the planted road [1/m], positive to the left."""
    return 0.002 * np.sin(2.0 * np.pi * t / BEND_PERIOD)


# left and right, in a left bend that tightens and opens, and in a right bend
PLANTED = (
    Planted(1, 8.03, 2.31, 0.31), Planted(-1, 17.45, 1.9, 0.27), Planted(1, 38.9, 3.1, 0.42),
    Planted(-1, 48.31, 2.0, 0.22), Planted(1, 68.02, 1.25, 0.18), Planted(-1, 79.6, 4.2, 0.35),
    Planted(1, 98.77, 0.8, 0.12), Planted(-1, 107.15, 2.6, 0.5),
)  # fmt: skip


def planted_drive(
    device: int, trip: int, planted: Sequence[Planted] = PLANTED, *, first: int = 0, rows: int = 1200, **changes: Any
) -> Drive:
    """A drive on the planted road; `first` is its first time in centiseconds."""
    t = np.arange(rows) * 0.1
    inside = 0.5 * (VEHICLE_WIDTH - LANE_WIDTH)  # the edge's distance from a line when the vehicle is in the centre
    offset = np.zeros(rows)
    for departure in planted:
        # where the parabola lies more than 0.5 m inside, the vehicle goes on that far from the line
        y = departure.y(t)
        near = y > -0.5
        offset[near] = departure.side * (y[near] - inside)
    speed = 25.0 + np.sin(0.1 * t)
    yaw_rate = curvature_at(t) * speed
    heading = np.concatenate([[0.0], np.cumsum(0.05 * (yaw_rate[1:] + yaw_rate[:-1]))])
    drive = Drive(device, trip, first + 10 * np.arange(rows), offset, LANE_WIDTH, speed, yaw_rate, heading)
    return dataclasses.replace(drive, **changes)


def _columns(drives: Sequence[Drive], name: str, kind: type = float) -> np.ndarray:
    return np.concatenate([np.broadcast_to(np.asarray(getattr(r, name), kind), len(r.time)) for r in drives])


def lane_frame(drives: Sequence[Drive]) -> pl.DataFrame:
    """Rows of DataLane."""
    offset, width = _columns(drives, "lane_offset"), _columns(drives, "lane_width")
    quality = _columns(drives, "quality", int)
    zero = np.zeros(offset.size)
    columns = (
        _columns(drives, "device", int), _columns(drives, "trip", int), _columns(drives, "time", int),
        np.round(np.round((offset - 0.5 * width) * 256) / 256, 6),
        np.round(np.round((offset + 0.5 * width) * 256) / 256, 6), zero, quality, quality,
    )  # fmt: skip
    return pl.DataFrame(dict(zip(LANE_COLUMNS, columns, strict=True)))


def wsu_frame(drives: Sequence[Drive], *, lag: int = 0) -> pl.DataFrame:
    """Rows of DataWsu; its clock may be off by `lag` centiseconds."""
    time = _columns(drives, "time", int)
    speed, signal = _columns(drives, "speed"), _columns(drives, "turn_signal", int)
    ones, zero = np.ones(time.size, int), np.zeros(time.size)
    columns = {
        "Device": _columns(drives, "device", int),
        "Trip": _columns(drives, "trip", int),
        "Time": time + lag,
        "GpsValidWsu": _columns(drives, "valid_gps", int),
        "GpsTimeWsu": 1349093298700 + 10 * time,
        "LatitudeWsu": np.round(42.387165 + 1e-6 * (time % 1000), 6),
        "LongitudeWsu": np.round(-83.441833 - 1e-6 * (time % 1000), 6),
        "AltitudeWsu": np.round(183.78 + 1e-3 * (time % 100), 2),
        "GpsHeadingWsu": np.round(-np.degrees(_columns(drives, "heading")) % 360.0, 5),
        "GpsSpeedWsu": np.round(speed, 5),
        "ValidCanWsu": _columns(drives, "valid_can", int),
        "YawRateWsu": np.round(np.degrees(_columns(drives, "yaw_rate")), 7),
        "SpeedWsu": np.round(3.6 * speed, 4),
        "TurnSngRWsu": (signal < 0).astype(float),
        "TurnSngLWsu": (signal > 0).astype(float),
        "HdopWsu": ones.astype(float),
        "PdopWsu": ones + 0.7,
        "FixQualityWsu": ones,
        "AxWsu": np.round(0.01 * np.sin(time), 8),
        "PrndlWsu": 5 * ones,
    }
    whole = {"GpsCoastingWsu", "BrakeAbsTcsWsu", "VsaActiveWsu", "HeadlampWsu", "WiperWsu"}
    zeros = {name: zero.astype(int) if name in whole else zero for name in WSU_COLUMNS}
    return pl.DataFrame({name: columns.get(name, zeros[name]) for name in WSU_COLUMNS})


def text_of(frame: pl.DataFrame, *, bom: bool = False, crlf: bool = True, header: bool = True) -> bytes:
    """A table as the real files have it."""
    end = "\r\n" if crlf else "\n"
    return b"\xef\xbb\xbf" * bom + frame.write_csv(line_terminator=end, include_header=header).encode()


def write_tables(folder: Path, drives: Sequence[Drive], *, lag: int = 0, suffix: str = "") -> tuple[Path, Path]:
    """DataLane (with a byte order mark, as one of the real files) and DataWsu in a folder."""
    lane, wsu = folder / f"DataLane{suffix}.csv", folder / f"DataWsu{suffix}.csv"
    lane.write_bytes(text_of(lane_frame(drives), bom=True))
    wsu.write_bytes(text_of(wsu_frame(drives, lag=lag)))
    return lane, wsu


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
        "GPS_Heading": [f"{value:.6f}" for value in heading],
        "GPS_Speed": [f"{value:.17g}" for value in np.broadcast_to(drive.speed, m)],
        "GPS_Valid": drive.valid_gps,
        "InVehicle_ABS_State": "2         ",
        "InVehicle_Brake_Status": "15        ",
        "InVehicle_Longitudinal_Speed": [f"{cell:.6f}" for cell in np.broadcast_to(drive.speed, m)],
        "InVehicle_Yaw_Rate": [f"{cell:.16E}" for cell in np.degrees(np.broadcast_to(drive.yaw_rate, m))],
        "InVehicle_Turn_Signal_Left": np.asarray(np.equal(drive.turn_signal, 1), int),
        "InVehicle_Turn_Signal_Right": np.asarray(np.equal(drive.turn_signal, -1), int),
        "LaneTrack_Distance_Left_Marker": [f"{cell:.1f}" for cell in middle - half],
        "LaneTrack_Distance_Right_Marker": [f"{cell:.1f}" for cell in middle + half],
        "LaneTrack_Lane_Width": [f"{cell:.10f}" for cell in 2.0 * half],
        "LaneTrack_Probability_Left_Exist": probability,
        "LaneTrack_Probability_Right_Exists": probability,
    }
    columns |= cells
    spread = {
        name: [str(cell) for cell in (np.broadcast_to(values, m) if np.ndim(values) == 0 else values)]
        for name, values in columns.items()
    }
    return [{name: values[i] for name, values in spread.items()} for i in range(m)]


def lines_of(rows: Sequence[dict[str, str]], cells: int = 53) -> list[str]:
    """Rows as text, with or without the last eight columns, which hold nothing."""
    return [",".join([*row.values(), *["NULL"] * (cells - 45)]) for row in rows]


ODD_FIRST = "10,1417715,1970" + "," * 27 + ",0" * 15 + "," * 8
"""First row of the table without a header: 53 cells, most of them empty."""
