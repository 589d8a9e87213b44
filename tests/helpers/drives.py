"""Drives of a vehicle that sways in its lane, departs and changes lanes, with all signals consistent."""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.recordings import Recording

FloatArray = npt.NDArray[np.float64]

VEHICLE = 1.8


def clean(seed: int, *, T: float = 120.0, rate: float = 0.0, noise: float = -1.0, name: str = "") -> Recording:
    """A drive without a fault: 10 to 100 Hz, 8 to 45 m/s, bends to 1/200 m, noise of 0 to 5 cm on offset and width."""
    rng = np.random.default_rng(seed)
    rate = rate or float(rng.choice([10.0, 12.5, 20.0, 25.0, 30.0, 50.0, 100.0]))
    noise = rng.uniform(0.0, 0.05) if noise < 0.0 else noise
    t = np.arange(int(T * rate)) / rate
    speed = rng.uniform(8.0, 45.0) * (1.0 + 0.03 * np.sin(0.13 * t + rng.uniform(0.0, 6.0)))
    bend = sum(rng.normal() * np.sin(2.0 * np.pi * t / rng.uniform(20.0, 120.0) + rng.uniform(0, 6)) for _ in range(4))
    bend *= min(rng.uniform(0.0, 1.0 / 200.0), 6.0 / speed.max() ** 2) / np.abs(bend).max()
    width = rng.uniform(3.0, 3.9)
    y = np.full(t.size, rng.uniform(-0.25, 0.25))
    for _ in range(5):
        y += rng.uniform(0.03, 0.12) * np.sin(2.0 * np.pi * t * rng.uniform(0.02, 0.35) + rng.uniform(0.0, 6.0))
    for start in np.arange(20.0, T - 20.0, rng.uniform(20.0, 60.0)):
        reach = rng.choice([-1.0, 1.0]) * (0.5 * (width - VEHICLE) + rng.uniform(0.05, 0.5))
        y += reach * np.exp(-(((t - start) / rng.uniform(2.0, 5.0) * 2.0) ** 2))
    for start in rng.uniform(0.0, T - 10.0, rng.integers(0, 4)):
        share = np.clip((t - start) / rng.uniform(3.0, 9.0), 0.0, 1.0)
        y += rng.choice([-1.0, 1.0]) * width * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    drift = np.gradient(y, t) / speed
    heading = np.cumsum(speed * bend) / rate + drift
    yaw_rate = speed * bend + np.gradient(drift, t)

    def measured(values: FloatArray, deviation: float) -> FloatArray:
        return values + deviation * rng.standard_normal(t.size)

    y -= width * np.round(y / width)
    return Recording(
        name or f"r{seed}", t, measured(y, noise), measured(np.full(t.size, width), noise),
        measured(speed, 0.05), np.ones(t.size, dtype=bool), curvature=measured(bend, 1e-5),
        yaw_rate=measured(yaw_rate, 0.002), heading=measured(heading, 0.003),
        steering=measured(42.0 * bend * (1.0 + 0.002 * speed**2), 0.002),
    )  # fmt: skip


def only(recording: Recording, *columns: str, **changes: Any) -> Recording:
    """The drive with some of its optional signals, and with changes."""
    names = {"curvature", "yaw_rate", "heading", "steering"} - {*columns}
    return dataclasses.replace(recording, **(dict.fromkeys(names) | changes))


def lane(t: FloatArray, offset: Any, width: Any = 3.6, speed: Any = 25.0, **columns: Any) -> Recording:
    """A recording of arrays or numbers, without a bend."""
    ones = np.ones(t.size)
    columns = {"curvature": 0.0 * ones} | columns
    return Recording("a", t, offset * ones, width * ones, speed * ones, ones > 0, **columns)


def planted(rate: float, side: int, *, T: float = 40.0, noise: float = 0.01) -> tuple[FloatArray, FloatArray]:
    """Times and offsets: a departure of 3 s by 0.3 m at 10.3 s to one side, one by 0.25 m at 22.7 s to the other, in a
    lane of 3.6 m; the vehicle sways between them."""
    t = np.arange(int(T * rate)) / rate
    y = 0.05 * np.sin(0.7 * t)
    for middle, towards, depth in ((10.3, side, 0.3), (22.7, -side, 0.25)):
        path = depth * (1.0 - ((t - middle) / 1.5) ** 2)
        y = np.where(np.abs(t - middle) > 2.5, y, 0.0) + towards * np.maximum(path + 0.9, 0.0) * (path > -0.9)
    return t, y + noise * np.random.default_rng(7).standard_normal(t.size)


def held(values: FloatArray, t: FloatArray, every: float) -> FloatArray:
    """Values that are refreshed so seldom [s]."""
    rows = np.searchsorted(t, np.floor(t / every + 1e-9) * every - 1e-9)
    return values[np.minimum(rows, t.size - 1)]
