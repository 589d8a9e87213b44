"""Vehicle, lane and their default numbers (Table I of the paper)."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

from ldctoolkit.errors import InputError
from ldctoolkit.unit_care import warn_of_units

GRAVITY: Final = 9.81
"""Gravitational acceleration [m/s^2]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class VehicleParameters:
    """Single-track vehicle and the lane it drives in; the defaults are the paper's Table I.

    Attributes
    ----------
    C_af, C_ar : float [N/rad]
        Cornering stiffness of one front and one rear tyre.
    l_f, l_r : float [m]
        Distance from the centre of gravity to the front and rear axle.
    m : float [kg]
        Mass.
    I_z : float [kg m^2]
        Yaw inertia.
    w_l : float [m]
        Lane width.
    w_v : float [m]
        Vehicle width, less than the lane's.

    Raises
    ------
    InputError
        Where a value is not a finite number > 0, or the vehicle is not narrower than the lane.

    Examples
    --------
    >>> VehicleParameters().edge_offset
    0.85
    """

    C_af: float = 80000.0
    C_ar: float = 80000.0
    l_f: float = 1.43
    l_r: float = 1.47
    m: float = 1000.0
    I_z: float = 3344.0
    w_l: float = 3.6
    w_v: float = 1.9

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"vehicle.{field.name}: {value!r}; allowed: a number > 0")
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"vehicle.{field.name}: {value!r}; allowed: a finite number > 0")
        if self.w_v >= self.w_l:
            raise InputError(f"vehicle.w_v: {self.w_v!r} m; allowed: less than the lane's width w_l = {self.w_l!r} m")
        warn_of_units("vehicle", self)

    @property
    def edge_offset(self) -> float:
        """Offset of the vehicle's centre when its edge is on the line, (w_l - w_v)/2 [m]."""
        return round((self.w_l - self.w_v) / 2.0, 12)
