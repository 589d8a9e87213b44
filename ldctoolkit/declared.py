"""One declaration on a dataclass's field gives its default, unit, limits, choices and check.

Gains of a controller (`gain`, `option`), options of plant and simulation, criteria, settings and thresholds
(`declared`) are declared the same way and checked by the same `Declaration.check`. Sweeps, the command line, the keys
of a study file and the columns of a report follow from the declaration; nothing is listed twice. `checked_number`,
`checked_whole`, `checked_choice` and `checked_seed` are the checks behind it, for arguments that are no field.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import re
import sys
import warnings
from collections.abc import Collection, Mapping
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.errors import InputError, UnknownNameError, plain

_KEY: Final = "ldctoolkit.declaration"

GainValue = float | int | str | bool
Scale = Literal["linear", "log"]

INF: Final = math.inf
MOST_SEED: Final = 2**63 - 1


def is_number(value: object) -> bool:
    """Whether a value is a finite Python number, and no truth value."""
    most = sys.float_info.max  # whole numbers may be larger
    return isinstance(value, int | float) and not isinstance(value, bool) and -most <= value <= most


def checked_number(
    path: str,
    value: Any,
    *,
    above: float = -INF,
    lower: float = -INF,
    upper: float = INF,
    unit: str = "1",
    finite: bool = True,
) -> float:
    """A number > `above`, >= `lower`, <= `upper`, as a float; NumPy's numbers are numbers, truth values are not.

    Raises `InputError` at `path` for anything else, with `finite` also for an infinite one; `unit` is that of the
    limits.
    """
    value = plain(value)
    good = is_number(value) or (not finite and value in (-INF, INF))
    if not good or not (value > above or above == -INF) or not lower <= value <= upper:
        kind = "number" if not finite or (lower > -INF and upper < INF) else "finite number"
        raise InputError(path, value=value, allowed=f"a {kind} {limits_text(above, lower, upper, unit)}".rstrip())
    return float(value)


def checked_whole(path: str, value: object, *, lower: float = -INF, upper: float = INF, unit: str = "1") -> int:
    """A whole number >= `lower` and <= `upper`, as an int; NumPy's integers are whole, 2.0 and True are not.

    Raises `InputError` at `path` for anything else; `unit` is that of the limits.
    """
    value = plain(value)
    if isinstance(value, bool) or not isinstance(value, int) or not lower <= value <= upper:
        raise InputError(path, value=value, allowed=f"a whole number {limits_text(-INF, lower, upper, unit)}".rstrip())
    return value


def checked_seed(seed: object, path: str = "seed") -> int:
    """The seed of a random stream as an int; raises `InputError` at `path` for anything else."""
    return checked_whole(path, seed, lower=0, upper=MOST_SEED)


def checked_choice(path: str, value: object, choices: Collection[str]) -> str:
    """A word of `choices`; raises `InputError` at `path` for anything else, with the nearest word."""
    value = plain(value)
    if not isinstance(value, str) or value not in choices:
        raise InputError(path, value=value, allowed=choices)
    return value


def limits_text(above: float, lower: float, upper: float, unit: str = "1") -> str:
    """Limits as ``"> 0 and <= 10 s"`` or ``"from 1 to 5"``; empty for none."""
    texts = ["2^63 - 1" if bound == MOST_SEED else f"{bound:g}" for bound in (above, lower, upper)]
    bounds = zip((">", ">=", "<="), texts, strict=True)
    limits = " and ".join(f"{sign} {text}" for sign, text in bounds if "inf" not in text)
    if above == -INF < lower and upper < INF:
        limits = f"from {texts[1]} to {texts[2]}"
    return f"{limits} {unit}" if limits and unit != "1" else limits


@dataclasses.dataclass(frozen=True, kw_only=True)
class Declaration:
    """What is known of a declared field; made with `declared`, read with `declarations`."""

    name: str = ""  # Field name, the literature's symbol
    unit: str = "1"  # SI unit, ``"1"`` for a pure number
    default: Any = None  # Value of an instance that does not set it; None where it may be absent
    above: float = -INF  # It has to be greater than this; infinite for no limit
    lower: float = -INF  # Allowed range, ends included; infinite for none
    upper: float = INF  # Allowed range, ends included; infinite for none
    choices: tuple[str, ...] = ()  # Allowed words; empty for a number, a switch, or any text
    text: bool = False  # Any text is allowed
    whole: bool = False  # A whole number
    pair: Literal["", "ascending", "descending"] = ""  # Two numbers, the second no smaller, or no larger
    kind: type | None = None  # Class of a field that is a table of declared fields itself
    usual: tuple[float, float] | None = None  # The narrower range that a study file allows
    description: str = ""  # One line

    @property
    def switch(self) -> bool:
        """Whether the declared value is a truth value."""
        return isinstance(self.default, bool)

    @property
    def in_files(self) -> Declaration:
        """The declaration with the narrower range that a study file allows."""
        lower, upper = self.usual or (self.lower, self.upper)
        return dataclasses.replace(self, above=-INF if self.usual else self.above, lower=lower, upper=upper)

    @property
    def limits(self) -> str:
        """What is allowed: words, or limits as ``"> 0 and <= 10"``; empty for anything."""
        return " or ".join(self.choices) or limits_text(self.above, self.lower, self.upper)

    def check(self, value: Any, owner: str = "") -> Any:
        """Return the value in the field's own type, or raise.

        Raises `InputError` naming ``owner.name``, the value and what is allowed.

        Parameters
        ----------
        value : object
            What was given.
        owner : str
            What the error names before the field: the law, or the table; empty for nothing.
        """
        path = f"{owner}.{self.name}" if owner else self.name
        value = plain(value)
        if value is None and self.default is None:
            return None
        if self.kind is not None:
            if not isinstance(value, self.kind):
                absent = ", or None" if self.default is None else ""
                raise InputError(path, value=value, allowed=f"an instance of {self.kind.__name__}{absent}")
            return value
        if self.choices:
            return checked_choice(path, value, self.choices)
        if self.text and not isinstance(value, str):
            raise InputError(path, value=value, allowed="text")
        if self.switch and not isinstance(value, bool):
            raise InputError(path, value=value, allowed="true or false")
        if self.text or self.switch:
            return value
        if self.pair:
            numbers = tuple(map(plain, value)) if isinstance(value, tuple | list | np.ndarray) else ()
            try:
                first, second = (self._number(path, number) for number in numbers)
                if first <= second if self.pair == "ascending" else first >= second:
                    return first, second
            except (InputError, ValueError):
                pass
            limits = limits_text(self.above, self.lower, self.upper, self.unit)
            raise InputError(path, value=numbers or value, allowed=f"two {self.pair} numbers {limits}".rstrip())
        return self._number(path, value)

    def _number(self, path: str, value: Any) -> float:
        if self.whole:
            number = int(value) if isinstance(value, float) and value.is_integer() else value
            return checked_whole(path, number, lower=self.lower, upper=self.upper, unit=self.unit)
        return checked_number(path, value, above=self.above, lower=self.lower, upper=self.upper, unit=self.unit)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gain(Declaration):
    """Declaration of one gain or option of a controller.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> declared = ldc.LQR.gains()[-1]
    >>> declared.name, declared.unit, declared.default
    ('r_delta', '1/rad^2', 20000.0)
    """

    scale: Scale = "linear"  # How a sweep should space its values

    def parsed(self, text: str) -> Any:
        """The value that a text stands for; a text that stands for none is returned for `check` to refuse."""
        if isinstance(self.default, str):
            return text
        if self.switch:
            return {"true": True, "false": False}.get(text, text)
        try:
            return float(text)
        except ValueError:
            return text

    def contradiction(self, kind: str) -> InputError | None:
        """What is wrong with the declaration of a field of a `kind`."""
        default, lower, upper = self.default, self.lower, self.upper
        if self.choices or self.text:
            if not (isinstance(self.choices, tuple) and all(isinstance(word, str) for word in self.choices)):
                return InputError("choices", value=self.choices, allowed="a tuple of words, e.g. ('one', 'other')")
            if kind in ("float", "int", "bool"):
                return InputError("", f"an option on a field of type {kind}", allowed="str")
        elif isinstance(default, str):
            return InputError("default", value=default, allowed="a number, or option(...) with choices for words")
        elif kind in (types := {"bool": bool, "int": int, "float": float, "str": str}) and (
            type(default) is not types[kind]  # exactly: True is an int too
        ):
            return InputError("default", f"on a field of type {kind}", value=default, allowed="a value of that type")
        elif not (isinstance(lower, numbers.Real) and isinstance(upper, numbers.Real) and lower <= upper):
            return InputError("", f"lower={lower!r}, upper={upper!r}", allowed="numbers, lower <= upper")
        elif self.scale not in ("linear", "log"):
            return InputError("scale", value=self.scale, allowed=("linear", "log"))
        elif self.scale == "log" and lower <= 0:
            return InputError("scale", f"with lower={lower!r}", value="log", allowed="lower > 0")
        try:
            self.check(default)
        except InputError as error:
            return error.at("default")
        return None


def declared(default: Any = None, **limits: Any) -> Any:
    """Declare a number, a switch, a word or a table as a dataclass field.

    The class calls `check_declared` in its ``__post_init__``.

    Parameters
    ----------
    default : float, int, bool, str, tuple, type or None
        Value of an instance that does not set it; a dataclass for a table whose default is an instance of it; None
        where it may be absent.
    **limits
        Fields of `Declaration`.
    """
    if isinstance(default, type):
        table = Declaration(**limits, kind=default, default=default)
        return dataclasses.field(default_factory=default, metadata={_KEY: table})
    return dataclasses.field(default=default, metadata={_KEY: Declaration(**limits, default=default)})


def gain(
    default: float | int | bool,
    *,
    unit: str,
    description: str,
    lower: float = -INF,
    upper: float = INF,
    scale: Scale = "linear",
) -> Any:
    """Declare a numeric gain as a dataclass field.

    The field's annotation says what it is: ``float`` a number, ``int`` a whole number, ``bool`` a switch; with any
    other annotation the type of the default does. A declaration that contradicts itself is named when a design is made
    or its class registered.

    Parameters
    ----------
    default : float, int or bool
        Value of a design that does not set it, within its bounds.
    unit : str
        SI unit, ``"1"`` for a pure number.
    description : str
        One line.
    lower, upper : float
        Allowed range, ends included.
    scale : {"linear", "log"}
        How a sweep should space its values; "log" needs ``lower > 0``.

    Examples
    --------
    >>> import dataclasses
    >>> @dataclasses.dataclass(frozen=True)
    ... class Law:
    ...     K: float = gain(-0.2, unit="rad/rad", lower=-5.0, upper=0.0, description="heading gain")
    >>> Law().K
    -0.2
    """
    return _gain(Gain(default=default, unit=unit, lower=lower, upper=upper, scale=scale, description=description))


def option(default: str, *, choices: tuple[str, ...] | None, description: str) -> Any:
    """Declare an option of words as a dataclass field.

    Parameters
    ----------
    default : str
        Choice of a design that does not set it.
    choices : tuple of str, or None
        Allowed words; None for any text, which the class then checks itself.
    description : str
        One line.

    Examples
    --------
    >>> import dataclasses
    >>> @dataclasses.dataclass(frozen=True)
    ... class Law:
    ...     solver: str = option("osqp", choices=("osqp", "daqp"), description="who solves the QP")
    >>> Law().solver
    'osqp'
    """
    words = () if choices is None else choices
    return _gain(Gain(default=default, choices=words, text=choices is None, description=description))


def _gain(declaration: Gain) -> Any:
    """The dataclass field of a declaration."""
    default = declaration.default
    if type(default).__hash__ is None:  # a list or an array, for which dataclasses would suggest a factory
        raise InputError("default", value=default, allowed="one number, truth value or word")
    return dataclasses.field(default=default, metadata={_KEY: declaration})


@functools.cache  # used for every design that is made
def declarations(owner: type) -> Mapping[str, Declaration]:
    """The declarations of a dataclass by the names of its fields, in their order."""
    return {field.name: _named(field) for field in dataclasses.fields(owner) if _KEY in field.metadata}


def _kind(field: dataclasses.Field[Any]) -> str:
    """The annotation, as a word (it is a string already under ``from __future__ import annotations``)."""
    kind = field.type
    return (kind if isinstance(kind, str) else getattr(kind, "__name__", str(kind))).removesuffix(" | None")


def _named(field: dataclasses.Field[Any]) -> Declaration:
    """The declaration with the field's name, and its default in the type that the annotation requires."""
    declaration: Declaration = field.metadata[_KEY]
    default, kind = plain(declaration.default), _kind(field)
    whole = declaration.whole or kind == "int"
    if isinstance(default, int | float) and not isinstance(default, bool):
        if kind == "float" or (kind != "int" and isinstance(default, float)):
            default, whole = float(default), False
        elif default == default // 1:
            default, whole = int(default), True
    return dataclasses.replace(declaration, name=field.name, default=default, whole=whole)


def check_declared(owner: Any, table: str = "") -> None:
    """Check every declared field of a frozen value, and give it its own type; `table` names the value in errors."""
    for name, declaration in declarations(owner.__class__).items():
        object.__setattr__(owner, name, declaration.check(getattr(owner, name), table))


def declared_gains(owner: type) -> dict[str, Gain]:
    """The gains declared on a dataclass by their names, in the order of its fields."""
    return {name: gain for name, gain in declarations(owner).items() if isinstance(gain, Gain)}


def undeclared_fields(owner: type) -> tuple[str, ...]:
    """Fields of a dataclass that a caller sets but that are made with neither `gain` nor `option`."""
    gains = declared_gains(owner)
    return tuple(field.name for field in dataclasses.fields(owner) if field.init and field.name not in gains)


def find_gain(law: Any, name: str) -> Gain:
    """The declared gain of that name of a law's class."""
    gains = declared_gains(law)
    if name not in gains:
        raise UnknownNameError(f"{law.name}.{name}", "no such gain", allowed=gains)
    return gains[name]


def check_declarations(owner: type) -> None:
    """Raise if a gain or option of a dataclass contradicts itself."""
    gains = declared_gains(owner)
    for field in dataclasses.fields(owner):
        if field.name in gains and (error := gains[field.name].contradiction(_kind(field))):
            raise error.within(f"{owner.__name__}.{field.name}")


def document_gains(owner: type) -> None:
    """Add the declared gains to a class's documentation, as its section of parameters."""
    rows = [
        f"    {gain.name} : {type(gain.default).__name__}{'' if gain.unit == '1' else f' [{gain.unit}]'}\n"
        f"        {gain.description[:1].upper()}{gain.description[1:]}."
        for gain in declared_gains(owner).values()
    ]
    text = owner.__doc__ or ""
    if rows and "\n    Parameters\n" not in text:
        first = re.search(r"\n    \w+\n    -{3,}\n", text)
        end = first.start() if first else len(text)
        section = "\n".join(["    Parameters", "    ----------", *rows])
        owner.__doc__ = f"{text[:end].rstrip()}\n\n{section}\n{text[end:] or '    '}"


def short_repr(part: Any) -> str:
    """``__repr__`` of a dataclass whose fields all have defaults: what differs from them."""
    usual = type(part)()
    values = ((field.name, getattr(part, field.name)) for field in dataclasses.fields(part))
    shown = (f"{name}={value!r}" for name, value in values if value != getattr(usual, name))
    return f"{type(part).__name__}({', '.join(shown)})"


class UnitWarning(UserWarning):
    """A value is so far from what is usual that another unit is likely."""


# field: (more than, less than, unit, the unit that was likely meant, its size): a value between the two is implausible
_LENGTH: Final = ((40.0, 900.0, "m", "centimetres", 0.01), (900.0, 9000.0, "m", "millimetres", 0.001))
_SLIPS: Final[dict[str, tuple[tuple[float, float, str, str, float], ...]]] = {
    **dict.fromkeys(("vehicle.m", "data_sheet.mass"), ((0.3, 100.0, "kg", "tonnes", 1000.0),)),
    **dict.fromkeys(("vehicle.I_z", "data_sheet.yaw_inertia"), ((0.3, 100.0, "kg m^2", "t m^2", 1000.0),)),
    **dict.fromkeys(("vehicle.C_af", "vehicle.C_ar"), ((5.0, 500.0, "N/rad", "kN/rad", 1000.0),)),
    **dict.fromkeys(("vehicle.l_f", "vehicle.l_r", "vehicle.w_v", "vehicle.w_l"), _LENGTH),
    **dict.fromkeys(("data_sheet.wheelbase", "data_sheet.width", "data_sheet.lane_width"), _LENGTH),
    "data_sheet.understeer_gradient": (
        (0.02, 0.7, "rad/(m/s^2)", "degrees per m/s^2", math.pi / 180.0),
        (0.7, 20.0, "rad/(m/s^2)", "degrees per g", math.pi / 180.0 / 9.81),
    ),
    "data_sheet.rear_cornering_coefficient": ((0.02, 1.0, "1/rad", "1/deg", 180.0 / math.pi),),
    "actuator.rate_max": ((15.0, INF, "rad/s", "degrees per second", math.pi / 180.0),),
    "actuator.delta_max": ((2.0, INF, "rad", "degrees", math.pi / 180.0),),
    **dict.fromkeys(("actuator.lag", "actuator.delay", "sensors.delay"), ((5.0, INF, "s", "milliseconds", 0.001),)),
    "y_s": ((7.0, INF, "m", "centimetres", 0.01),),
    "v_mean": ((70.0, INF, "m/s", "km/h", 1.0 / 3.6),),
}


def unit_slip(name: str, value: Any) -> str:
    """What is likely wrong with the unit of a value; empty for nothing."""
    for low, high, unit, meant, size in _SLIPS.get(name, ()):
        if is_number(value) and low < value < high:
            return f"{name}: {value:g} {unit}; likely {meant} were meant: {value * size:.4g} {unit}"
    return ""


def warn_of_units(table: str, owner: Any) -> None:
    """Warn of the fields of a dataclass that are likely to be in another unit."""
    for field in dataclasses.fields(owner):
        if slip := unit_slip(f"{table}.{field.name}", getattr(owner, field.name)):
            warnings.warn(slip, UnitWarning, stacklevel=4)
