"""Declared gains: one line on a controller's field gives its default, unit, bounds, scale and check.

Sweeps, the command line, study validation and report columns all read this declaration; nothing is listed twice.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import re
from typing import Any, Literal

from ldctoolkit.errors import InputError, UnknownNameError, nearest, plain

_KEY = "ldctoolkit.gain"

GainValue = float | int | str | bool


@dataclasses.dataclass(frozen=True)
class Gain:
    """Declaration of one gain or option of a controller.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> declared = ldc.LQR.gains()[-1]
    >>> declared.name, declared.unit, declared.default
    ('r_delta', '1/rad^2', 20000.0)
    """

    name: str  # Field name on the controller, the literature's symbol
    unit: str  # SI unit, ``"1"`` for a pure number
    default: GainValue  # Value of a design that does not set it
    lower: float  # Allowed range, ends included; infinite for none
    upper: float  # Allowed range, ends included; infinite for none
    scale: Literal["linear", "log"]  # How a sweep should space its values
    choices: tuple[str, ...]  # Allowed words of an option; empty for a number, or for any text
    description: str  # One line
    text: bool = False  # An option that takes any text

    def check(self, value: Any, owner: str) -> GainValue:
        """Return the value in the gain's own type, or raise.

        Raises `InputError` naming ``owner.name``, the value and what is allowed.

        Parameters
        ----------
        value : object
            What was given.
        owner : str
            What the message names before the gain: the law.
        """
        where, value = f"{owner}.{self.name}", plain(value)
        if self.choices:
            if value not in self.choices:
                raise InputError(where, value=value, allowed=self.choices)
            return str(value)
        if self.text:
            if not isinstance(value, str):
                raise InputError(where, value=value, allowed="text")
            return str(value)
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise InputError(where, value=value, allowed="true or false")
            return value
        number = _number(value)
        whole = isinstance(self.default, int)
        if number is None or (whole and number != int(number)) or not self.lower <= number <= self.upper:
            kind = "a whole number" if whole else "a number"
            unit = "" if self.unit == "1" else f" {self.unit}"
            raise InputError(where, value=value, allowed=f"{kind} from {self.lower:g} to {self.upper:g}{unit}")
        return int(number) if whole else number

    def parsed(self, text: str) -> Any:
        """What a text stands for; what it cannot be is left to `check`."""
        if isinstance(self.default, str):
            return text
        if isinstance(self.default, bool):
            return {"true": True, "false": False}.get(text, text)
        try:
            return float(text)
        except ValueError:
            return text


def _number(value: Any) -> float | None:
    """The value as a finite float; None for anything else (numpy scalars are numbers, booleans are not)."""
    if isinstance(value, bool | str) or value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None


def gain(
    default: float | int | bool,
    *,
    unit: str,
    description: str,
    lower: float = -math.inf,
    upper: float = math.inf,
    scale: Literal["linear", "log"] = "linear",
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
    return _field(default, unit, lower, upper, scale, (), description)


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
    allowed = () if choices is None else choices
    return _field(default, "1", -math.inf, math.inf, "linear", allowed, description, text=choices is None)


def _field(
    default: GainValue,
    unit: str,
    lower: float,
    upper: float,
    scale: Literal["linear", "log"],
    choices: tuple[str, ...],
    description: str,
    *,
    text: bool = False,
) -> Any:
    if type(default).__hash__ is None:  # a list or an array, for which dataclasses would suggest a factory
        raise InputError(f"default {default!r} of a gain or option; allowed: one number, truth value or word")
    # the name is known only once the class exists; `declared_gains` fills it in
    declaration = Gain("", unit, default, lower, upper, scale, choices, description, text)
    return dataclasses.field(default=default, metadata={_KEY: declaration})


def declared_gains(owner: Any) -> tuple[Gain, ...]:
    """The gains declared on a dataclass or an instance of one, in the order of its fields."""
    return _declared(owner if isinstance(owner, type) else type(owner))


@functools.cache  # used for every design that is made
def _declared(owner: type) -> tuple[Gain, ...]:
    return tuple(_named(field) for field in dataclasses.fields(owner) if _KEY in field.metadata)


def undeclared_fields(owner: Any) -> tuple[str, ...]:
    """Fields of a dataclass that a caller sets but that are made with neither `gain` nor `option`."""
    return tuple(field.name for field in dataclasses.fields(owner) if field.init and _KEY not in field.metadata)


def _kind(field: dataclasses.Field[Any]) -> str:
    """The annotation, as a word (it is a string already under ``from __future__ import annotations``)."""
    return field.type if isinstance(field.type, str) else getattr(field.type, "__name__", "")


def _named(field: dataclasses.Field[Any]) -> Gain:
    """The declaration with the field's name, and its default in the type that the annotation requires."""
    declared: Gain = dataclasses.replace(field.metadata[_KEY], name=field.name)
    default, kind = declared.default, _kind(field)
    if isinstance(default, numbers.Real) and not isinstance(default, bool):
        if kind == "float" or (kind != "int" and not isinstance(default, numbers.Integral)):
            return dataclasses.replace(declared, default=float(default))
        if isinstance(default, numbers.Integral) or float(default).is_integer():
            return dataclasses.replace(declared, default=int(default))
    return declared


def check_declarations(owner: type) -> None:
    """Raise if a gain or option of a dataclass contradicts itself."""
    for field in dataclasses.fields(owner):
        if _KEY in field.metadata:
            declared = _named(field)
            wrong = _contradiction(declared, _kind(field))
            if wrong:
                raise InputError(f"{owner.__name__}.{declared.name}", wrong)
            try:
                declared.check(declared.default, owner.__name__)
            except InputError as error:
                raise InputError(f"default of {error}") from None


def _contradiction(declared: Gain, kind: str) -> str:
    """What is wrong with a declaration, the bounds on its default apart; empty for nothing."""
    default, lower, upper, choices = declared.default, declared.lower, declared.upper, declared.choices
    if choices or declared.text:
        if not (isinstance(choices, tuple) and all(isinstance(word, str) for word in choices)):
            return f"choices={choices!r}; allowed: a tuple of words, e.g. ('one', 'other')"
        return f"an option on a field of type {kind}; allowed: str" if kind in ("float", "int", "bool") else ""
    if isinstance(default, str):
        return f"default {default!r}; allowed: a number, or option(...) with choices for words"
    fits = {"bool": bool, "int": int, "float": float, "str": str}.get(kind)
    if fits is not None and type(default) is not fits:  # exactly: True is an int too
        return f"default {default!r} on a field of type {kind}; allowed: a value of that type"
    if not (isinstance(lower, numbers.Real) and isinstance(upper, numbers.Real) and lower <= upper):
        return f"lower={lower!r}, upper={upper!r}; allowed: numbers, lower <= upper"
    if declared.scale not in ("linear", "log"):
        return f"scale={declared.scale!r}; {nearest(str(declared.scale), ('linear', 'log'))}"
    return f"scale='log' with lower={lower!r}; allowed: lower > 0" if declared.scale == "log" and lower <= 0 else ""


def document_gains(owner: type) -> None:
    """Add the declared gains to a class's documentation, as its section of parameters."""
    rows = [
        f"    {one.name} : {type(one.default).__name__}{'' if one.unit == '1' else f' [{one.unit}]'}\n"
        f"        {one.description[:1].upper()}{one.description[1:]}."
        for one in declared_gains(owner)
    ]
    text = owner.__doc__ or ""
    if rows and "\n    Parameters\n" not in text:
        first = re.search(r"\n    \w+\n    -{3,}\n", text)
        place = first.start() if first else len(text)
        section = "\n".join(["    Parameters", "    ----------", *rows])
        owner.__doc__ = f"{text[:place].rstrip()}\n\n{section}\n{text[place:] or '    '}"


def find_gain(owner: Any, name: str, owner_name: str) -> Gain:
    """The declared gain of that name."""
    gains = {g.name: g for g in declared_gains(owner)}
    if name not in gains:
        raise UnknownNameError(f"{owner_name}.{name}", "no such gain", allowed=gains)
    return gains[name]
