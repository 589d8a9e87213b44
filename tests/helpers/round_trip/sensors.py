"""What the instruments make of a drive: noise, resolution, held values."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from .drive import Drive
from .planted import STEP

FloatArray = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Noise:
    """Errors of the instruments; white noise by its standard deviation.

    Attributes
    ----------
    lane : float [m]
        Of the distance to each line.
    lane_resolution : float [m]
        0 for none.
    speed : float [m/s]
        Of the speed on the vehicle's bus and of the one by GPS, each.
    yaw_rate : float [deg/s]
        Of the yaw rate.
    yaw_rate_rows : int
        Rows for which a yaw rate stays: the table is written at 10 Hz, the message comes at 5 Hz.
    heading : float [deg]
        Of the course by GPS.
    """

    lane: float = 0.004
    lane_resolution: float = 1.0 / 256.0
    speed: float = 0.01
    yaw_rate: float = 0.06
    yaw_rate_rows: int = 2
    heading: float = 0.05

    @classmethod
    def none(cls) -> Noise:
        """Perfect instruments: only the sampling is left."""
        return cls(0.0, 0.0, 0.0, 0.0, 1, 0.0)

    def times(self, factor: float) -> Noise:
        """White noise so many times as large, the rest as it is."""
        white = {name: factor * getattr(self, name) for name in ("lane", "speed", "yaw_rate", "heading")}
        return dataclasses.replace(self, **white)


@dataclasses.dataclass(frozen=True)
class Measured:
    """What the tables hold, m rows, in their units and signs.

    Attributes
    ----------
    trip, tick : (m,) int
        As in `Drive`.
    left, right : (m,) [m]
        Distances from the vehicle's centre to the lines, left negative.
    lane_heading : (m,) [rad]
        Of the vehicle to the lane.
    speed : (m,) [km/h]
    gps_speed : (m,) [m/s]
    yaw_rate : (m,) [deg/s]
        Positive to the left.
    heading : (m,) [deg]
        Clockwise from north.
    """

    trip: npt.NDArray[np.int64]
    tick: npt.NDArray[np.int64]
    left: FloatArray
    right: FloatArray
    lane_heading: FloatArray
    speed: FloatArray
    gps_speed: FloatArray
    yaw_rate: FloatArray
    heading: FloatArray


def measure(drive: Drive, noise: Noise, seed: int, *, own_turning: bool = False) -> Measured:
    """Measure a drive.

    Parameters
    ----------
    drive : Drive
        What was driven.
    noise : Noise
        Errors of the instruments.
    seed : int
        Draws them.
    own_turning : bool
        Add to the yaw rate what the vehicle turns relative to its lane; without, it is speed times curvature.
    """
    rng = np.random.default_rng(seed)

    def noisy(values: FloatArray, deviation: float) -> FloatArray:
        return values + deviation * rng.standard_normal(values.size)

    inside = np.diff(drive.trip, prepend=-1, append=drive.trip[-1] + 1) == 0
    to_lane = np.arctan(_rate(drive.lane_offset, inside) / drive.speed)
    turning = drive.speed * drive.curvature
    if own_turning:
        turning = turning + _rate(to_lane, inside)
    yaw_rate = noisy(np.degrees(turning), noise.yaw_rate)
    held = np.arange(yaw_rate.size) - drive.tick % noise.yaw_rate_rows
    left, right = (
        _rounded(noisy(distance, noise.lane), noise.lane_resolution)
        for distance in (drive.lane_offset - 0.5 * drive.lane_width, drive.lane_offset + 0.5 * drive.lane_width)
    )
    turned = np.degrees(np.cumsum(turning) * STEP)  # a trip's course at its start is anybody's guess
    return Measured(
        trip=drive.trip, tick=drive.tick, left=left, right=right, lane_heading=_rounded(to_lane, 0.0005),
        speed=3.6 * noisy(drive.speed, noise.speed), gps_speed=noisy(drive.speed, noise.speed), yaw_rate=yaw_rate[held],
        heading=np.mod(noisy(90.0 - turned, noise.heading), 360.0),
    )  # fmt: skip


def _rate(values: FloatArray, inside: npt.NDArray[np.bool_]) -> FloatArray:
    """Derivative by central differences, one-sided at the ends of trips."""
    step = np.diff(values)
    before, after = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    has_before, has_after = inside[:-1], inside[1:]
    return np.asarray(np.where(has_before, np.where(has_after, 0.5 * (before + after), before), after) / STEP)


def _rounded(values: FloatArray, resolution: float) -> FloatArray:
    return np.rint(values / resolution) * resolution if resolution > 0.0 else values
