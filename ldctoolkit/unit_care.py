"""Values that are likely to be meant in another unit: a warning that names it."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Final


class UnitWarning(UserWarning):
    """A value is so far from what is usual that another unit is likely."""


@dataclasses.dataclass(frozen=True)
class Slip:
    """A range of values [unit] of a field that are likely to be in another unit: times `factor` they are plausible."""

    low: float
    high: float
    unit: str
    meant: str
    factor: float


_DEG: Final = 3.141592653589793 / 180.0
_INF: Final = float("inf")

_SLIPS: Final[dict[str, tuple[Slip, ...]]] = {
    "vehicle.m": (Slip(0.3, 100.0, "kg", "tonnes", 1000.0),),
    "vehicle.I_z": (Slip(0.3, 100.0, "kg m^2", "t m^2", 1000.0),),
    "vehicle.C_af": (Slip(5.0, 500.0, "N/rad", "kN/rad", 1000.0),),
    "vehicle.C_ar": (Slip(5.0, 500.0, "N/rad", "kN/rad", 1000.0),),
    **{
        f"vehicle.{name}": (Slip(40.0, 900.0, "m", "centimetres", 0.01), Slip(900.0, 9000.0, "m", "millimetres", 0.001))
        for name in ("l_f", "l_r", "w_v", "w_l")
    },
    "actuator.rate_max": (Slip(15.0, _INF, "rad/s", "degrees per second", _DEG),),
    "actuator.delta_max": (Slip(2.0, _INF, "rad", "degrees", _DEG),),
    **{f"{part}.{name}": (Slip(5.0, _INF, "s", "milliseconds", 0.001),)
       for part, name in (("actuator", "lag"), ("actuator", "delay"), ("sensors", "delay"))},
    "y_s": (Slip(7.0, _INF, "m", "centimetres", 0.01),),
    "v_mean": (Slip(70.0, _INF, "m/s", "km/h", 1.0 / 3.6),),
}  # fmt: skip


def unit_slip(name: str, value: object) -> str:
    """What is likely wrong with a value; empty for nothing."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        for slip in _SLIPS.get(name, ()):
            if slip.low < value < slip.high:
                return (
                    f"{name}: {value:g} {slip.unit}; likely {slip.meant} were meant: "
                    f"{value * slip.factor:.4g} {slip.unit}"
                )
    return ""


def warn_of_units(name: str, part: object) -> None:
    """Warn of the fields of a dataclass that are likely to be in another unit."""
    for field in dataclasses.fields(part):  # type: ignore[arg-type]
        slip = unit_slip(f"{name}.{field.name}", getattr(part, field.name))
        if slip:
            warnings.warn(slip, UnitWarning, stacklevel=4)
