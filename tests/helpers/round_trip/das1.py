"""Measured drives as the tables DataLane and DataWsu."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from .sensors import Measured

DEVICES = 20  # vehicles that the trips are spread over

DECIMALS = 9


def trip_name(trip: npt.ArrayLike) -> list[str]:
    """Names that the reader gives to trips, ``device/trip``."""
    return [f"{10001 + number % DEVICES}/{number // DEVICES + 1}" for number in np.asarray(trip).tolist()]


def write_tables(folder: Path, measured: Measured) -> list[Path]:
    """Write both tables of the one-day kind; the lane table begins with a byte order mark, as the real one does."""
    key = {"Device": 10001 + measured.trip % DEVICES, "Trip": measured.trip // DEVICES + 1, "Time": 10 * measured.tick}
    size = measured.trip.size
    three, zero, one = (np.full(size, value, dtype=np.int64) for value in (3, 0, 1))
    lane = pl.DataFrame(
        {
            **key, "LaneDistanceLeft": measured.left, "LaneDistanceRight": measured.right,
            "LaneHeading": measured.lane_heading, "LaneQualityRight": three, "LaneQualityLeft": three,
        }
    )  # fmt: skip
    wsu = pl.DataFrame(
        {
            **key,
            "GpsValidWsu": one,
            "GpsTimeWsu": 1349093298700 + 100 * np.arange(size),
            "LatitudeWsu": np.full(size, 42.3),  # positions are not read
            "LongitudeWsu": np.full(size, -83.7),
            "AltitudeWsu": np.full(size, 250.0),
            "GpsHeadingWsu": measured.heading,
            "GpsSpeedWsu": measured.gps_speed,
            "HdopWsu": one,
            "PdopWsu": one,
            "FixQualityWsu": one,
            "GpsCoastingWsu": zero,
            "ValidCanWsu": one,
            "YawRateWsu": measured.yaw_rate,
            "SpeedWsu": measured.speed,
            "TurnSngRWsu": zero,
            "TurnSngLWsu": zero,
            "BrakeAbsTcsWsu": zero,
            "AxWsu": zero,
            "PrndlWsu": np.full(size, 5, dtype=np.int64),
            "VsaActiveWsu": zero,
            "HeadlampWsu": zero,
            "WiperWsu": zero,
            "ThrottleWsu": zero,
            "SteerWsu": zero,
        }
    )
    paths = [folder / "DataLane.csv", folder / "DataWsu.csv"]
    lane.write_csv(paths[0], include_bom=True, float_precision=DECIMALS)
    wsu.write_csv(paths[1], float_precision=DECIMALS)
    return paths
