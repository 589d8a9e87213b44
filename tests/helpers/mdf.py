"""MDF logs as an engineer's logger writes them: planted departures, a camera and a bus with clocks of their own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from helpers.planted import Planted

WIDTH, VEHICLE = 3.5, 1.8  # of lane and vehicle [m]
END = 96.0  # of the drive [s]
BEND = 2.0 * np.pi / 48.0  # [rad/s] of the curvature: 24 s to the left, 24 s to the right


# in left bends (t mod 48 below 24 s) and in right ones, to either side
PLANTED = (
    Planted(1, 8.013, 2.0, 0.30), Planted(-1, 14.7, 3.1, 0.42), Planted(1, 30.22, 1.4, 0.21),
    Planted(-1, 38.91, 2.6, 0.35), Planted(1, 62.5, 2.2, 0.5), Planted(-1, 80.04, 1.8, 0.28),
)  # fmt: skip


def lane_offset(t: np.ndarray) -> np.ndarray:
    """[m] Positive to the left; between departures the vehicle goes straight in the lane."""
    offset = np.zeros_like(t)
    for departure in PLANTED:
        offset += departure.side * np.maximum(departure.y(t) + (WIDTH - VEHICLE) / 2.0, 0.0)
    return offset


def curvature(t: np.ndarray) -> np.ndarray:
    """[1/m] Positive to the left."""
    return 1.5e-3 * np.sin(BEND * t)


def speed(t: np.ndarray) -> np.ndarray:
    """[m/s]."""
    return 24.0 + 3.0 * np.sin(0.15 * t)


Group = tuple[str, np.ndarray, dict[str, tuple[Any, str]]]  # name, times, and samples with unit by name


def groups(end: float = END) -> list[Group]:
    """The camera at 25 Hz in cm, positive to the right; the bus at 50 Hz; a GPS receiver at 1 Hz; a switch."""
    camera, bus, gps = np.arange(0.0, end, 0.04), np.arange(0.0071, end + 0.1, 0.02), np.arange(0.3, end, 1.0)
    return [
        ("Camera", camera, {
            "LaneOffset": (-100.0 * lane_offset(camera), "cm"),
            "LaneWidth": (np.full(camera.size, WIDTH), "m"),
            "LaneQuality": (np.full(camera.size, 3, np.uint8), ""),
        }),
        ("Bus", bus, {
            "VehicleSpeed": (3.6 * speed(bus), "km/h"),
            "YawRate": (np.degrees(curvature(bus) * speed(bus)), "deg/s"),
            "RoadCurvature": (-1000.0 * curvature(bus), "1/km"),
            "TurnSignal": (np.zeros(bus.size, np.uint8), ""),
        }),
        ("GPS", gps, {"VehicleSpeed": (speed(gps), "m/s")}),
    ]  # fmt: skip


MAP = """
[lane_offset]
channel = "LaneOffset"
scale = -1
[lane_width]
channel = "LaneWidth"
[speed]
channel = "VehicleSpeed"
group = "Bus"
[curvature]
channel = "RoadCurvature"
scale = -1
[[valid]]
channel = "LaneQuality"
min = 2
"""


def write_log(
    path: Path, content: Sequence[Group] | None = None, version: str = "4.10", compression: int = 0, **signals: Any
) -> Path:
    """Write a log; `signals`: further arguments of channels by their names, as ``LaneOffset={"conversion": ...}``.

    What follows ``#`` in the name of a channel is not written: ``Speed`` and ``Speed#2`` share a name in the log.
    """
    from asammdf import MDF, Signal, Source

    with MDF(version=version) as log:
        for name, t, channels in groups() if content is None else content:
            source = Source(name=name, path=name, comment="", source_type=1, bus_type=2)
            log.append(
                [
                    Signal(np.asarray(v), t, unit=unit, name=name.split("#")[0], source=source, **signals.get(name, {}))
                    for name, (v, unit) in channels.items()
                ],
                acq_name=name,
                comment=name,
                common_timebase=True,
            )
        saved = log.save(path, overwrite=True, compression=compression)
    assert saved == path
    return path
