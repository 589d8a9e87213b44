"""Conditions on scenarios: which departures of a model are wanted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.scenario_model.parts import SideModel

Given = Mapping[str, float | tuple[float | None, float | None]]
"""Parameter -> its value, or (lower, upper) between which it lies; None is open. SI units."""


@dataclasses.dataclass(frozen=True)
class Condition:
    """One parameter between two values, or at one.

    Attributes
    ----------
    name : str
        Of the parameter.
    low, high : float
        Infinite where open; equal for one value.
    """

    name: str
    low: float
    high: float

    def __str__(self) -> str:
        unit = PARAMETER_UNITS[PARAMETER_NAMES.index(self.name)]
        if self.low == self.high:
            return f"{self.name} = {self.low:g} {unit}"
        if math.isinf(self.high):
            return f"{self.name} above {self.low:g} {unit}"
        if math.isinf(self.low):
            return f"{self.name} below {self.high:g} {unit}"
        return f"{self.name} from {self.low:g} to {self.high:g} {unit}"


def conditions(given: Given | None) -> tuple[Condition, ...]:
    """The conditions in the order of `PARAMETER_NAMES`; those that are open on both sides are left out.

    Parameters
    ----------
    given : mapping, optional
        Parameter -> value or (lower, upper).

    Raises
    ------
    InputError
        For an unknown parameter, or what is neither a number nor an ascending pair.

    Examples
    --------
    >>> [str(condition) for condition in conditions({"c_0": 0.001, "v_mean": (25, 35), "T": (3, None)})]
    ['T above 3 s', 'v_mean from 25 to 35 m/s', 'c_0 = 0.001 1/m']
    """
    if given is not None and not isinstance(given, Mapping):
        raise InputError(f"given: {given!r}; allowed: a mapping of parameters")
    found = {}
    for name, wanted in (given or {}).items():
        if name not in PARAMETER_NAMES:
            raise InputError(f"given: no parameter {name!r}; {nearest(str(name), PARAMETER_NAMES)}")
        low, high = _ends(name, wanted)
        if low > -math.inf or high < math.inf:
            found[name] = Condition(name, low, high)
    return tuple(found[name] for name in PARAMETER_NAMES if name in found)


def _ends(name: str, wanted: Any) -> tuple[float, float]:
    allowed = "allowed: a number, or (lower, upper) with lower < upper, None for open"
    pair = (wanted, wanted) if _is_number(wanted) and math.isfinite(wanted) else wanted
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise InputError(f"given[{name!r}]: {wanted!r}; {allowed}")
    ends = []
    for end, fill in zip(pair, (-math.inf, math.inf), strict=True):
        if end is not None and not _is_number(end):
            raise InputError(f"given[{name!r}]: {wanted!r}; {allowed}")
        ends.append(fill if end is None else float(end))
    low, high = ends
    one_value = pair is not wanted or low == high
    if not low <= high or (one_value and not math.isfinite(low)):
        raise InputError(f"given[{name!r}]: {wanted!r}; {allowed}")
    return low, high


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def mixture_conditions(
    wanted: tuple[Condition, ...], side: SideModel, label: str
) -> dict[int, float | tuple[float, float]]:
    """Column of the side's mixture -> value or (lower, upper).

    Raises
    ------
    InputError
        If a constant of the side, or its box, does not meet a condition.
    """
    constants = dict(side.constants)
    lower, upper = side.bounds()
    out: dict[int, float | tuple[float, float]] = {}
    for condition in wanted:
        low, high = condition.low, condition.high
        if condition.name in constants:
            value = constants[condition.name]
            if not low <= value <= high:
                raise InputError(
                    f"given[{condition.name!r}]: {condition}; allowed: {value:g}, as in every {label} departure of "
                    "this model"
                )
            continue
        j = side.names.index(condition.name)
        a, b = float(lower[j]), float(upper[j])
        if (not a < low < b) if low == high else (high <= a or low >= b):
            raise InputError(
                f"given[{condition.name!r}]: {condition}; allowed: between {a:g} and {b:g}, the bounds of the {label} "
                "departures of this model"
            )
        out[j] = low if low == high else (max(low, a), min(high, b))
    return out
