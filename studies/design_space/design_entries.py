"""Reads what a ``[[design]]`` table writes for laws, thresholds, gains and conditions; says what is wrong with it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from ldctoolkit import Controller, LdcError, controller_class
from ldctoolkit.errors import nearest
from ldctoolkit.gains import declared_gains, find_gain
from studies.design_space.dimensions import Span
from studies.design_space.grid import EntryError, expand, read_entry
from studies.study_file._part import fail

Kinds = Sequence[type[Controller]]


def read_laws(entry: Any) -> tuple[tuple[str, ...], Kinds]:
    """The laws of a table: names and classes.

    Raises
    ------
    pydantic_core.PydanticCustomError
        With the key path in the table.
    """
    names = (entry,) if isinstance(entry, str) else entry
    if not isinstance(names, list | tuple) or not names or not all(isinstance(name, str) for name in names):
        raise fail("law", f"{entry!r}; allowed: text, or a list of different laws")
    if len(set(names)) != len(names):
        raise fail("law", f"{entry!r}; allowed: each law once")
    kinds = []
    for i, name in enumerate(names):
        try:
            kinds.append(controller_class(name))
        except LdcError as error:
            raise fail("law" if isinstance(entry, str) else f"law[{i}]", str(error).removeprefix("law ")) from None
    return tuple(names), kinds


def read_thresholds(entry: Any) -> tuple[float, ...] | Span:
    """The trigger thresholds [m] of a table.

    Raises
    ------
    pydantic_core.PydanticCustomError
        With the key path in the table.
    """
    try:
        dimension = read_entry(entry)
    except EntryError as error:
        raise fail(f"y_s{error.path}", str(error)) from None
    if isinstance(dimension, Span):
        return dataclasses.replace(dimension, first=_threshold(dimension.first), last=_threshold(dimension.last))
    return tuple(_threshold(value) for value in dimension.values)


def _threshold(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not (math.isfinite(value) and value >= 0):
        raise fail("y_s", f"{value!r}; allowed: a finite number >= 0 [m]")
    return float(value) + 0.0


def read_gain(kinds: Kinds, name: str, entry: Any) -> tuple[Any, ...] | Span:
    """The values of a gain, which the laws that declare it must take for the same.

    Parameters
    ----------
    kinds : sequence of type
        The table's laws.
    name : str
        Of the gain.
    entry : object
        As written.

    Raises
    ------
    pydantic_core.PydanticCustomError
        With the key path in the table.
    """
    readings = {kind.name: _reading(kind, name, entry, len(kinds) > 1) for kind in _declaring(kinds, name, "gains")}
    (first, reading), *others = readings.items()
    for law, other in others:
        if other != reading:
            message = f"{first!r} and {law!r} space this range differently"
            raise fail(f"gains.{name}", f"{message}; allowed: a list, a range with scale, or a [[design]] for each law")
    return reading


def _declaring(kinds: Kinds, name: str, table: str) -> Kinds:
    found = [kind for kind in kinds if any(gain.name == name for gain in declared_gains(kind))]
    if not found:
        every = {gain.name for kind in kinds for gain in declared_gains(kind)}
        raise fail(f"{table}.{name}", f"no such gain; {nearest(name, every)}")
    return found


def _reading(kind: type[Controller], name: str, entry: Any, name_law: bool) -> tuple[Any, ...] | Span:
    """What one law takes an entry for, every value checked."""
    declared = find_gain(kind, name, kind.name)
    whole = isinstance(declared.default, int) and not isinstance(declared.default, bool)
    try:
        dimension = read_entry(entry, declared.scale, whole=whole)
        if not isinstance(dimension, Span):
            return tuple(declared.check(value, kind.name) for value in dimension.values)
        for end in (dimension.first, dimension.last):
            declared.check(end, kind.name)
    except EntryError as error:
        raise fail(f"gains.{name}{error.path}", str(error)) from None
    except LdcError as error:
        raise _outside(f"gains.{name}", error, kind, name, name_law) from None
    number = int if whole else float
    return dataclasses.replace(dimension, first=number(dimension.first), last=number(dimension.last))


def _outside(path: str, error: LdcError, kind: type[Controller], name: str, name_law: bool) -> Exception:
    # the path in the study file says more than the law's own prefix
    message = str(error).removeprefix(f"{kind.name}.{name}: ")
    return fail(path, f"{message} ({kind.name})" if name_law else message)


def read_conditions(kinds: Kinds, when: dict[str, Any], gains: dict[str, Any]) -> dict[str, dict[str, tuple[Any, ...]]]:
    """``[design.when]``: gain -> other gain -> the values of the other for which the gain varies.

    Parameters
    ----------
    kinds : sequence of type
        The table's laws.
    when : dict
        As written.
    gains : dict
        The table's gains as read.

    Raises
    ------
    pydantic_core.PydanticCustomError
        With the key path in the table.
    """
    read = {name: _condition_table(kinds, name, table, gains) for name, table in when.items()}
    for name, others in read.items():
        for on in others:
            if on in read:
                raise fail(f"when.{name}.{on}", f"{on!r} has a condition itself; allowed: a gain without one")
    return read


def _condition_table(kinds: Kinds, name: str, table: Any, gains: dict[str, Any]) -> dict[str, tuple[Any, ...]]:
    """``[design.when.NAME]``: other gain -> its values."""
    path = f"when.{name}"
    if name not in gains:
        raise fail(path, f"no such gain in [design.gains]; {nearest(name, gains)}")
    if not isinstance(table, dict) or not table:
        raise fail(path, f"{table!r}; allowed: a table of other gains and their values")
    return {on: _condition(kinds, name, on, entry, gains) for on, entry in table.items()}


def _condition(kinds: Kinds, name: str, on: str, entry: Any, gains: dict[str, Any]) -> tuple[Any, ...]:
    path = f"when.{name}.{on}"
    if on not in gains or on == name:
        raise fail(path, f"no such other gain in [design.gains]; {nearest(on, set(gains) - {name})}")
    if isinstance(gains[on], Span):
        raise fail(path, f"gains.{on} is a range without a count; allowed: a gain with a list of values")
    for kind in _declaring(kinds, name, "when"):
        if all(gain.name != on for gain in declared_gains(kind)):
            raise fail(path, f"no gain of {kind.name!r}, which has {name!r}; allowed: a gain of the same law")
    try:
        values = expand(entry)
    except EntryError as error:
        raise fail(path + error.path, str(error)) from None
    for value in values:
        if not any(value == known and isinstance(value, bool) == isinstance(known, bool) for known in gains[on]):
            raise fail(path, f"{value!r} is not among gains.{on}; {nearest(str(value), map(str, gains[on]))}")
    return values
