"""Tests of regulations and Euro NCAP as data: their cells, and the limits that a design has to keep."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.checked_files import read_toml
from ldctoolkit.departures import RIGHT
from ldctoolkit.errors import InputError, StudyError, UnknownNameError
from ldctoolkit.plant_options import Driver
from ldctoolkit.scenarios import Drifts, Scenarios
from ldctoolkit.validation import Part, as_tuples, first_problem

FOLDER: Final = Path(__file__).parent / "catalog" / "standards"

KM_H: Final = 1.0 / 3.6  # [m/s]

AFTER: Final = 10.0  # [s] from the time when a cell's path reaches the line to its end

_FASTEST: Final = 5.0  # [m/s] largest lateral velocity of a vehicle that goes straight on in a bend

VEHICLES: Final[Mapping[str, Mapping[str, float]]] = {
    "light": {"m": 0.85, "I_z": 0.85},
    "heavy": {"m": 1.3, "I_z": 1.3},
    "soft": {"C_af": 0.8, "C_ar": 0.8},
    "stiff": {"C_af": 1.2, "C_ar": 1.2},
}
"""Named vehicles: factors of quantities of the study's vehicle; the other quantities are nominal."""

QuantityName = Literal[
    "dtle",
    "tyre_distance",
    "opposite_crossing",
    "a_y_added_peak",
    "jerk_added_peak",
    "jerk",
    "steering_wheel_rate",
    "lateral_velocity_after",
    "driver_torque_peak",
    "against_parallel",
]

OF_A_DRIVER: Final[tuple[QuantityName, ...]] = ("driver_torque_peak", "against_parallel")
"""Quantities that a plant has with a driver at the wheel only."""

ADD_DRIVER: Final = "add [plant.driver] to the study"

Positive = Annotated[float, Field(gt=0)]


class Grid(Part):
    """``[[cells]]``: speeds by lateral velocities of a drift, or by lateral accelerations of a bend."""

    range: Literal["standard", "extended"] = "standard"
    speed_km_h: Annotated[tuple[Positive, ...], Field(min_length=1)]
    lateral_velocity_m_s: tuple[Positive, ...] = ()
    lateral_acceleration_m_s2: tuple[Positive, ...] = ()

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if bool(self.lateral_velocity_m_s) == bool(self.lateral_acceleration_m_s2):
            raise InputError(allowed="one of lateral_velocity_m_s and lateral_acceleration_m_s2")
        return self


class Drift(Part):
    """``[drift]``: the path of a passive driver to the line."""

    # (lowest speed [km/h], radius of the arc [m])
    radius_m: Annotated[tuple[tuple[float, Positive], ...], Field(min_length=1)]
    lateral_velocity_m_s: tuple[Positive, ...]
    distance_m: tuple[Positive, ...]  # For each lateral velocity: lateral distance from the end of the arc to the line


class Condition(Part):
    """``[[condition]]``: the limit of a quantity in every cell."""

    quantity: QuantityName
    # A number, or a number for each lateral velocity of the drift: [m], [m/s], [m/s^2], [m/s^3] or, of a wheel, [deg/s]
    limit: float | tuple[float, ...]
    from_speed_km_h: float = 0.0
    what: str = ""  # The requirement in words, for a plant on which it is not assessable


class NotAssessable(Part):
    """``[[not_assessable]]``: a requirement of the standard that no simulation here can assess, and the reason."""

    what: str
    why: str


class Standard(Part):
    """A test: its source, cells and conditions. Read with `load_standard`."""

    name: str
    title: str
    source: str
    second_hand: bool  # Taken from excerpts, not from the original text
    lane_width_m: tuple[Positive, Positive]  # Narrowest and widest
    speed_tolerance_km_h: float = Field(default=0.0, ge=0)
    lateral_velocity_tolerance_m_s: float = Field(default=0.0, ge=0)
    extended_from: float = 0.0  # Share of standard cells that must pass before the extended range counts
    extended_points: tuple[tuple[float, float], ...] = ()  # (least share of its cells that pass, share of the points)
    drift: Drift | None = None
    cells: Annotated[tuple[Grid, ...], Field(min_length=1)]
    condition: Annotated[tuple[Condition, ...], Field(min_length=1)]
    required: tuple[int, int] | None = None  # How many conditions have to hold, of how many; all by default
    not_assessable: tuple[NotAssessable, ...] = ()

    @model_validator(mode="after")
    def _check_fields(self) -> Self:
        drift = self.drift
        rates = () if drift is None else drift.lateral_velocity_m_s
        for rate in (rate for grid in self.cells for rate in grid.lateral_velocity_m_s):
            if rate not in rates:
                allowed = f"one of {rates}"
                raise InputError("cells", "is not among lateral_velocity_m_s of [drift]", value=rate, allowed=allowed)
        if drift is not None and len(drift.distance_m) != len(rates):
            raise InputError("drift.distance_m", f"{len(drift.distance_m)} values", allowed="one per lateral velocity")
        slowest = min(speed for grid in self.cells for speed in grid.speed_km_h)
        if drift is not None and drift.radius_m[0][0] > slowest:
            problem = f"begins at {drift.radius_m[0][0]:g} km/h"
            raise InputError("drift.radius_m", problem, allowed=f"at {slowest:g} or below")
        if self.lane_width_m[0] > self.lane_width_m[1]:
            raise InputError("lane_width_m", value=self.lane_width_m, allowed="narrowest, widest")
        if self.required is not None and not len(self.condition) <= self.required[1] >= self.required[0] >= 1:
            raise InputError("required", value=self.required, allowed="how many conditions, and of how many")
        bends = any(grid.lateral_acceleration_m_s2 for grid in self.cells)
        for i, condition in enumerate(self.condition):
            path, limit = f"condition[{i}].limit", condition.limit
            if isinstance(limit, tuple) and bends:
                raise InputError(path, "a list beside cells in bends", allowed="a number")
            if isinstance(limit, tuple) and len(limit) != len(rates):
                raise InputError(path, f"{len(limit)} values", allowed="one per lateral velocity")
        return self

    def assessable(self, driver: Driver) -> Self:
        """The test on a plant: without a driver, conditions on the torque of one are not assessable."""
        left = [condition for condition in self.condition if condition.quantity in OF_A_DRIVER]
        if not (driver.ideal and left):
            return self
        if len(left) == len(self.condition):
            problem = "has only conditions on a driver's torque"
            raise InputError("standard", problem, value=self.name, hint=ADD_DRIVER)
        why = f"it needs a driver's torque, which the vehicle model does not have; {ADD_DRIVER}"
        parts = tuple(NotAssessable(what=condition.what or condition.quantity, why=why) for condition in left)
        kept = tuple(condition for condition in self.condition if condition not in left)
        return self.model_copy(update={"condition": kept, "not_assessable": parts + self.not_assessable})

    @property
    def every_cell(self) -> Cells:
        """The cells of all grids, grid by grid and speed by speed."""
        rows = [
            (speed, second, not grid.lateral_velocity_m_s, grid.range == "extended")
            for grid in self.cells
            for speed in grid.speed_km_h
            for second in grid.lateral_velocity_m_s or grid.lateral_acceleration_m_s2
        ]
        speed, second, bend, extended = (np.array(column) for column in zip(*rows, strict=True))
        return Cells(speed * KM_H, second, bend, extended)

    def limits(self, condition: Condition, cells: Cells) -> FloatArray:
        """The limit of a condition in each of n cells, (n,)."""
        if isinstance(condition.limit, tuple):
            assert self.drift is not None
            table = dict(zip(self.drift.lateral_velocity_m_s, condition.limit, strict=True))
            return np.array([table[rate] for rate in cells.second.tolist()])
        return np.full(cells.n, condition.limit)

    def scenarios(
        self, cells: Cells, offset: float, speed: float | FloatArray = 0.0, rate: float | FloatArray = 0.0
    ) -> Scenarios:
        """The drifts of n cells, on the passenger's side of a country that drives on the right.

        `offset` [m] is the distance between the vehicle's edges and the lines in the middle of the lane. `speed` and
        `rate` [m/s] are added to speed and lateral velocity; the arc stays that of the cell.
        """
        v, kmh = cells.speed + speed, cells.speed / KM_H
        drifting = ~cells.bend
        radius, straight = v**2 / np.where(cells.bend, cells.second, 1.0), np.zeros(cells.n)
        lateral = np.where(cells.bend, np.minimum(_FASTEST, 0.5 * v), cells.second + rate)
        if self.drift is not None:
            table = dict(zip(self.drift.lateral_velocity_m_s, self.drift.distance_m, strict=True))
            straight = np.array([table.get(second, 0.0) for second in cells.second.tolist()])
            for first, arc in self.drift.radius_m:
                radius[drifting & (kmh >= first - 1e-6)] = arc
        arc_time, covered = Drifts(lateral, radius, straight).arc(v)
        # in a bend the vehicle starts in the middle of the lane and reaches the line on the arc
        to_line = np.where(drifting, arc_time + straight / lateral, np.sqrt(2.0 * offset * radius) / v)
        return Scenarios.from_drifts(
            v=v, lateral_velocity=lateral, radius=radius, side=RIGHT, T=to_line + AFTER,
            distance=np.where(drifting, covered + straight, offset),
            c=np.where(cells.bend, -1.0 / radius, 0.0),
        )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Cells:
    """n cells of a test."""

    speed: FloatArray  # (n,) [m/s]
    second: FloatArray  # (n,) Lateral velocity [m/s] of a drift; lateral acceleration [m/s^2] of a bend
    bend: BoolArray  # (n,) Whether it is in a bend; else it is a drift
    extended: BoolArray  # (n,) Whether it is in the extended range

    @property
    def n(self) -> int:
        """Number of cells."""
        return int(self.speed.size)

    def times(self, count: int) -> Cells:
        """The cells repeated `count` times as a whole."""
        rows = np.tile(np.arange(self.n), count)
        return Cells(self.speed[rows], self.second[rows], self.bend[rows], self.extended[rows])

    def name(self, i: int) -> str:
        """A cell for a reader: ``"70 km/h, 0.4 m/s"``."""
        return f"{self.speed[i] / KM_H:.0f} km/h, {self.second[i]:g} {'m/s²' if self.bend[i] else 'm/s'}"


def standard_names() -> tuple[str, ...]:
    """Names of the tests in the catalog, sorted."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_standard(name_or_path: str | Path) -> Standard:
    """A test of the catalog by its name, or any other by the path of its TOML file.

    Raises `UnknownNameError` for what is neither; `StudyError` naming file, key path, value and what is allowed.

    Examples
    --------
    >>> load_standard("euroncap-2026-elk-road-edge").every_cell.n
    36
    """
    path = Path(name_or_path)
    if str(name_or_path) in standard_names():
        path = FOLDER / f"{name_or_path}.toml"
    elif path.suffix != ".toml":
        problem = "is neither a file nor in the catalog"
        raise UnknownNameError("standard", problem, value=str(name_or_path), allowed=standard_names())
    content = read_toml(path, StudyError)
    try:
        return Standard.model_validate(as_tuples(content))
    except ValidationError as error:
        raise StudyError.of(first_problem(error, content, Standard, "standard").within(str(path), ": ")) from None
