"""The declared options of plant and simulation: read from a study file, and shown to a reader again."""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.option_checks import declaration_of, kind_of
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.setup import Setup, simulation_options
from ldctoolkit.validation import fail

_ALWAYS_SHOWN: Final = ("tyres", "sensors.kalman", "residuals")
"""Tables whose defaults say something as soon as the table is used."""


def read_plant(entry: Any) -> Any:
    """The plant options of what stands under ``plant``; what is no table is handed on for the field's own message."""
    if not isinstance(entry, dict):
        return entry
    try:
        return _read(PlantOptions, entry, "")
    except InputError as error:
        path, _, message = str(error).partition(": ")
        raise fail(path, message) from None


def _read(kind: type, table: dict[str, Any], prefix: str) -> Any:
    fields: dict[str, dataclasses.Field[Any]] = vars(kind)["__dataclass_fields__"]  # fps too, which is not kept
    given = {}
    for key, entry in table.items():
        path = f"{prefix}{key}"
        if key not in fields:
            raise fail(path, f"no such key; {nearest(str(key), fields)}")
        inner = kind_of(fields[key])
        if inner is None or (entry is None and fields[key].default is None):
            given[key] = entry
        elif isinstance(entry, dict):
            given[key] = _read(inner, entry, f"{path}.")
        else:
            raise fail(path, f"{entry!r}; allowed: a table of keys")
    return kind(**given)


def differences(options: PlantOptions) -> tuple[str, ...]:
    """What is not ideal about a plant, a few words each; empty for the ideal one."""
    found = []
    for field in _not_ideal(options):
        value = getattr(options, field.name)
        inside = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
        further = [declaration_of(one).description for one in inside if getattr(value, one.name) is not None]
        found.append(" with ".join([declaration_of(field).description, *filter(None, further)]))
    return tuple(found)


def _not_ideal(options: PlantOptions) -> Iterator[dataclasses.Field[Any]]:
    ideal = PlantOptions()
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if not getattr(value, "ideal", value == getattr(ideal, field.name)):
            yield field


def simulation_settings(setup: Setup) -> Iterator[tuple[str, str]]:
    """What each option of the simulation is, and its value with its unit."""
    for field in simulation_options():
        yield declaration_of(field).description, _text(getattr(setup, field.name), field)


def plant_settings(options: PlantOptions) -> Iterator[tuple[str, str]]:
    """Key and value, with its unit, of everything that differs from the ideal plant."""
    for field in _not_ideal(options):
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            yield from _shown(value, field.name)
        else:
            yield field.name, _text(value, field)


def _shown(part: Any, path: str) -> Iterator[tuple[str, str]]:
    for field in dataclasses.fields(part):
        value, key = getattr(part, field.name), f"{path}.{field.name}"
        if dataclasses.is_dataclass(value):
            yield from _shown(value, key)
        elif value is not None and (path in _ALWAYS_SHOWN or value != field.default):
            yield key, _text(value, field)


def _text(value: Any, field: dataclasses.Field[Any]) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    unit = declaration_of(field).unit
    return f"{value:g} {unit}".removesuffix(" 1") if isinstance(value, float) else str(value)
