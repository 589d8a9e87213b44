"""Declared gains: one line on a controller's field gives its default, unit, bounds, scale and check.

Sweeps, the command line, study validation and report columns all read this declaration; nothing is listed twice.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

from ldctoolkit.errors import InputError, UnknownNameError, nearest

_KEY = "ldctoolkit.gain"

GainValue = float | int | str | bool


@dataclasses.dataclass(frozen=True)
class Gain:
    """Declaration of one gain or option of a controller.

    Attributes
    ----------
    name : str
        Field name on the controller, the literature's symbol.
    unit : str
        SI unit, ``"1"`` for a pure number.
    default : float, int, str or bool
        Value of a design that does not set it.
    lower, upper : float
        Allowed range, ends included; infinite for none.
    scale : {"linear", "log"}
        How a sweep should space its values.
    choices : tuple of str
        Allowed words of an option; empty for a number.
    description : str
        One line.
    """

    name: str
    unit: str
    default: GainValue
    lower: float
    upper: float
    scale: Literal["linear", "log"]
    choices: tuple[str, ...]
    description: str

    def check(self, value: Any, owner: str) -> GainValue:
        """Return the value in the gain's own type, or raise.

        Parameters
        ----------
        value : object
            What was given.
        owner : str
            What the message names before the gain: the law.

        Returns
        -------
        float, int, str or bool

        Raises
        ------
        InputError
            Naming ``owner.name``, the value and what is allowed.
        """
        where = f"{owner}.{self.name}"
        if self.choices:
            if value not in self.choices:
                raise InputError(f"{where}: {value!r}; {nearest(str(value), self.choices)}")
            return str(value)
        if isinstance(self.default, bool):
            if not isinstance(value, bool):
                raise InputError(f"{where}: {value!r}; allowed: true or false")
            return value
        number = _number(value)
        whole = isinstance(self.default, int)
        if number is None or (whole and number != int(number)) or not self.lower <= number <= self.upper:
            kind = "a whole number" if whole else "a number"
            unit = "" if self.unit == "1" else f" {self.unit}"
            raise InputError(f"{where}: {value!r}; allowed: {kind} from {self.lower:g} to {self.upper:g}{unit}")
        return int(number) if whole else number


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
    """Declare a numeric gain as a dataclass field; an ``int`` default makes it a whole number, a ``bool`` a switch.

    Parameters
    ----------
    default : float, int or bool
        Value of a design that does not set it.
    unit : str
        SI unit, ``"1"`` for a pure number.
    description : str
        One line.
    lower, upper : float
        Allowed range, ends included.
    scale : {"linear", "log"}
        How a sweep should space its values.

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


def option(default: str, *, choices: tuple[str, ...], description: str) -> Any:
    """Declare an option with named choices as a dataclass field.

    Parameters
    ----------
    default : str
        Choice of a design that does not set it.
    choices : tuple of str
        Allowed words.
    description : str
        One line.
    """
    return _field(default, "1", -math.inf, math.inf, "linear", choices, description)


def _field(
    default: GainValue,
    unit: str,
    lower: float,
    upper: float,
    scale: Literal["linear", "log"],
    choices: tuple[str, ...],
    description: str,
) -> Any:
    # the name is known only once the class exists; `declared_gains` fills it in
    declaration = Gain("", unit, default, lower, upper, scale, choices, description)
    return dataclasses.field(default=default, metadata={_KEY: declaration})


def declared_gains(owner: Any) -> tuple[Gain, ...]:
    """The gains declared on a dataclass or an instance of one, in the order of its fields."""
    return tuple(
        dataclasses.replace(field.metadata[_KEY], name=field.name)
        for field in dataclasses.fields(owner)
        if _KEY in field.metadata
    )


def find_gain(owner: Any, name: str, owner_name: str) -> Gain:
    """The declared gain of that name.

    Raises
    ------
    UnknownNameError
        Naming the nearest gain.
    """
    gains = {g.name: g for g in declared_gains(owner)}
    if name not in gains:
        raise UnknownNameError(f"{owner_name}.{name}: no such gain; {nearest(name, gains)}")
    return gains[name]
