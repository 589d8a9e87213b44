"""Declared options: one line on a frozen dataclass's field gives its default, unit, limits and what it is.

Checks, the keys of a study file and the settings that a report lists follow from the declaration.
"""

import dataclasses
import math
import warnings
from typing import Any, Final

from ldctoolkit.errors import InputError, plain


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


def short_repr(part: Any) -> str:
    """``__repr__`` of a dataclass whose fields all have defaults: what differs from them."""
    usual = type(part)()
    values = ((field.name, getattr(part, field.name)) for field in dataclasses.fields(part))
    shown = (f"{name}={value!r}" for name, value in values if value != getattr(usual, name))
    return f"{type(part).__name__}({', '.join(shown)})"


_KEY = "ldctoolkit.option"

MOST_SEED: Final = 2**63 - 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class Declaration:
    """What is known of an option."""

    unit: str = "1"  # SI unit, ``"1"`` for a pure number
    # It has to be > `above`, >= `least`, <= `most`
    above: float | None = None
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()  # Allowed texts; empty for a number or a switch
    usual: tuple[float, float] | None = None  # The narrower range that a study file allows
    kind: type | None = None  # Of a table of options that is absent by default
    description: str = ""  # A short text; of a plant's option, for where it is not ideal


def declaration(**limits: Any) -> dict[str, Declaration]:
    """Metadata of a dataclass field, from the fields of `Declaration`."""
    return {_KEY: Declaration(**limits)}


def declared(default: float | bool | None, **limits: Any) -> Any:
    """Declare a number or a switch as a dataclass field.

    Parameters
    ----------
    default : float, bool or None
        None where the option may be absent.
    **limits
        Fields of `Declaration`.

    Examples
    --------
    >>> @dataclasses.dataclass(frozen=True)
    ... class Lamp:
    ...     power: float = declared(5.0, unit="W", above=0.0)
    ...     def __post_init__(self) -> None:
    ...         check_declared(self, "lamp")
    >>> Lamp(power=-1)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: lamp.power: -1; allowed: a finite number > 0
    """
    return dataclasses.field(default=default, metadata=declaration(**limits))


def declaration_of(field: dataclasses.Field[Any]) -> Declaration:
    """The declaration of a dataclass's field; that of a pure number where there is none."""
    found: Declaration = field.metadata.get(_KEY, Declaration())
    return found


def kind_of(field: dataclasses.Field[Any]) -> type | None:
    """The dataclass of a field that is a table of options itself; None for any other."""
    made: Any = field.default_factory
    return declaration_of(field).kind if made is dataclasses.MISSING else made


def check_declared(owner: Any, table: str = "") -> None:
    """Check every declared number, text and switch of a frozen value, and make the numbers floats."""
    for field in dataclasses.fields(owner):
        if _KEY in field.metadata:
            _check(owner, field, f"{table}.{field.name}" if table else field.name)


def _check(owner: Any, field: dataclasses.Field[Any], where: str) -> None:
    value, limits, kind = getattr(owner, field.name), declaration_of(field), kind_of(field)
    if value is None and field.default is None:
        return
    if kind is not None:
        if not isinstance(value, kind):
            none = ", or None" if field.default is None else ""
            raise InputError(where, value=value, allowed=f"an instance of {kind.__name__}{none}")
    elif limits.choices:
        if value not in limits.choices:
            raise InputError(where, value=value, allowed=limits.choices)
    elif isinstance(field.default, bool):
        if not isinstance(value, bool):
            raise InputError(where, value=value, allowed="true or false")
    else:
        number = checked_number(where, value, above=limits.above, least=limits.least, most=limits.most)
        object.__setattr__(owner, field.name, number)


def is_number(value: object) -> bool:
    """Whether a value is a finite number, and no truth value."""
    return not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value)


def checked_number(
    where: str, value: Any, *, above: float | None = None, least: float | None = None, most: float | None = None
) -> float:
    """A finite number within limits, as a float."""
    value = plain(value)
    bounds = [f"{sign} {bound:g}" for sign, bound in ((">", above), (">=", least), ("<=", most)) if bound is not None]
    if not is_number(value) or not (
        (above is None or value > above) and (least is None or value >= least) and (most is None or value <= most)
    ):
        allowed = " ".join(["a finite number", *([" and ".join(bounds)] if bounds else [])])
        raise InputError(where, value=value, allowed=allowed)
    return float(value)


def checked_whole(where: str, value: object, *, least: int = 1, most: int | None = None) -> int:
    """A whole number within limits."""
    whole = plain(value)
    if isinstance(whole, bool) or not isinstance(whole, int) or whole < least or (most is not None and whole > most):
        limits = f">= {least}" if most is None else f"from {least} to {most:g}"
        raise InputError(where, value=value, allowed=f"a whole number {limits}")
    return whole


def checked_seed(seed: object) -> int:
    """The seed as an int, 0 to 2^63 - 1."""
    whole = plain(seed)
    if isinstance(whole, bool) or not isinstance(whole, int) or not 0 <= whole <= MOST_SEED:
        raise InputError("seed", value=seed, allowed="a whole number from 0 to 2^63 - 1")
    return whole
