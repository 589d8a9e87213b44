"""Trips in the schema of UAH-DriveSet, made by code, with departures planted in bends."""

import copy
import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np

from helpers.planted import Planted

NAME = "20151110175712-16km-D1-NORMAL1-SECONDARY"
VEHICLE, LANE_WIDTH = 1.8, 3.5
BEND_PERIOD = 40.0


# left and right, each in a left and in a right bend; the clock starts at 9.32 s
PLANTED = (
    Planted(1, 22.7, 2.3, 0.31), Planted(-1, 31.05, 1.9, 0.27), Planted(1, 41.9, 3.1, 0.42),
    Planted(-1, 63.3, 2.0, 0.22), Planted(1, 71.45, 1.25, 0.18), Planted(-1, 82.6, 4.2, 0.35),
)  # fmt: skip
BEGIN, END = 9.32, 112.0


def offset_at(t: np.ndarray, planted: tuple[Planted, ...] = PLANTED) -> np.ndarray:
    """Vehicle's centre from the lane's, positive to the left."""
    offset = 0.1 * np.sin(t)
    for departure in planted:
        y = departure.y(t)
        near = y > -0.45
        offset[near] = departure.side * (y + 0.5 * (LANE_WIDTH - VEHICLE))[near]
    return offset


def speed_at(t: np.ndarray) -> np.ndarray:
    return 25.0 + 0.03 * t


def curvature_at(t: np.ndarray) -> np.ndarray:
    """Left and right bends in turns, positive to the left."""
    return 2e-3 * np.sin(2.0 * np.pi * t / BEND_PERIOD)


def yaw_at(t: np.ndarray) -> np.ndarray:
    """Integral of curvature times speed, in closed form; it runs through pi several times, twice in a departure."""
    w = 2.0 * np.pi / BEND_PERIOD
    level = -np.cos(w * t) / w
    rising = -t * np.cos(w * t) / w + np.sin(w * t) / w**2
    return 3.415 + 2e-3 * (25.0 * level + 0.03 * rising)


def lane_rows(rng: np.random.Generator, *, scale: float = 1.0, noise: float = 0.0) -> np.ndarray:
    """Near 30 Hz, irregular, times of two decimals of which some are repeated, all states, gaps between departures."""
    t = np.round(np.cumsum(rng.uniform(0.02, 0.047, 4000)) + BEGIN, 2)
    t = t[t < END]
    t = np.sort(np.concatenate([t, rng.choice(t, 60)]))
    # a gap of nearly 9 s, and some that are bridged
    t = t[~((t > 89.0) & (t < 97.9))]
    t = t[~((t % 7.0 > 3.0) & (t % 7.0 < 3.15))]
    x = -scale * (offset_at(t) + noise * rng.standard_normal(t.size))  # positive to the right
    width = np.full(t.size, scale * LANE_WIDTH) + 0.01 * rng.standard_normal(t.size)
    state = np.full(t.size, 2.0)
    state[t < 12.0], state[t < 11.0], state[t < 10.0] = 1.0, 0.0, -1.0
    state[(t > 52.0) & (t < 55.0)] = 1.0
    x[(t > 52.0) & (t < 55.0)] = 9.0
    rows = np.column_stack([t, np.round(x, 4), np.full(t.size, 0.01), np.round(width, 4), state])
    rows[t > 108.0, 1:] = -9.0
    return rows


def gps_rows(rng: np.random.Generator) -> np.ndarray:
    t = np.arange(BEGIN - 0.4, END + 1.0, 1.0)
    t = np.round(t + rng.uniform(-0.05, 0.05, t.size), 2)
    course = np.mod(np.degrees(-yaw_at(t)) + 180.0, 360.0)
    course[t < 14.0] = -1.0
    zeros = np.zeros(t.size)
    columns = [t, 3.6 * speed_at(t), 40.51 + 1e-4 * t, -3.4 - 1e-4 * t, 610.0 + zeros, 6.0 + zeros, 10.0 + zeros]
    return np.round(np.column_stack([*columns, course, *([zeros] * 5)]), 6)


def accelerometer_rows(rng: np.random.Generator) -> np.ndarray:
    t = np.arange(BEGIN, END, 0.1)
    t = np.round(t + rng.uniform(-0.02, 0.02, t.size), 2)
    yaw = np.mod(yaw_at(t) + np.pi, 2.0 * np.pi) - np.pi
    forces = rng.normal(0.0, 0.05, (t.size, 6))
    return np.column_stack([t, np.ones(t.size), forces, np.zeros((t.size, 2)), np.round(yaw, 5)])


def text_of(rows: np.ndarray) -> str:
    return _text(rows.tobytes(), rows.shape[1])


@functools.cache
def _text(data: bytes, width: int) -> str:
    rows = np.frombuffer(data).reshape(-1, width)
    return "".join(" ".join(f"{value:.10g}" for value in row) + " \n" for row in rows)


@dataclasses.dataclass
class Trip:
    """Rows of one trip, to be changed before it is written."""

    lane: np.ndarray
    gps: np.ndarray
    accelerometers: np.ndarray

    def write(self, root: Path, name: str = NAME, driver: str = "D1") -> Path:
        folder = root / driver / name
        folder.mkdir(parents=True)
        (folder / "PROC_LANE_DETECTION.txt").write_text(text_of(self.lane))
        (folder / "RAW_GPS.txt").write_text(text_of(self.gps))
        (folder / "RAW_ACCELEROMETERS.txt").write_text(text_of(self.accelerometers))
        (folder / "EVENTS_INERTIAL.txt").write_text("3.2 1 1 40.5 -3.4 3\n")
        return folder


def make_trip(seed: int = 1, **lane: Any) -> Trip:
    """A trip of its own each time."""
    return copy.deepcopy(_trip(seed, **lane))


@functools.cache
def _trip(seed: int, **lane: Any) -> Trip:
    rng = np.random.default_rng(seed)
    return Trip(lane_rows(rng, **lane), gps_rows(rng), accelerometer_rows(rng))


TRUTH = {"offset": offset_at, "speed": speed_at, "curvature": curvature_at, "yaw": yaw_at}
