"""The declared options of plant and simulation: read from a study file, and shown to a reader again."""

from collections.abc import Iterator
from typing import Any, Final

from ldctoolkit.declared import Declaration, declarations
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.setup import Setup, simulation_options

_ALWAYS_SHOWN: Final = ("tyres", "sensors.kalman", "residuals")
"""Tables whose defaults say something as soon as the table is used."""


def read_plant(entry: Any) -> Any:
    """The plant options of what stands under ``plant``; what is no table is handed on for the field's own message."""
    return read_table(PlantOptions, entry) if isinstance(entry, dict) else entry


def read_table(kind: type, table: dict[str, Any], prefix: str = "") -> Any:
    """A frozen value of declared fields from a table of a file; errors are at the key path behind the prefix."""
    values = dict(table)
    for key, entry in table.items():
        path, keys = f"{prefix}{key}", vars(kind)["__dataclass_fields__"]  # fps too, which is not kept
        if key not in keys:
            raise InputError(path, "no such key", allowed=[*keys])
        declaration = declarations(kind).get(key)
        if declaration and declaration.kind and not (entry is None and declaration.default is None):
            if not isinstance(entry, dict):
                raise InputError(path, value=entry, allowed="a table of keys")
            values[key] = read_table(declaration.kind, entry, f"{path}.")
    return kind(**values)


def not_ideal(options: PlantOptions) -> Iterator[Declaration]:
    """The declarations of what differs from the ideal plant."""
    ideal = PlantOptions()
    for name, declaration in declarations(PlantOptions).items():
        if getattr(options, name) != getattr(ideal, name):
            yield declaration


def simulation_settings(setup: Setup) -> Iterator[tuple[str, str]]:
    """What each option of the simulation is, and its value with its unit."""
    for declaration in simulation_options():
        yield declaration.description, _text(getattr(setup, declaration.name), declaration)


def plant_settings(options: PlantOptions) -> Iterator[tuple[str, str]]:
    """Key and value, with its unit, of everything that differs from the ideal plant."""
    for declaration in not_ideal(options):
        value = getattr(options, declaration.name)
        if declaration.kind:
            yield from _shown(value, declaration.name)
        else:
            yield declaration.name, _text(value, declaration)


def _shown(part: Any, path: str) -> Iterator[tuple[str, str]]:
    for declaration in declarations(part.__class__).values():
        value, key = getattr(part, declaration.name), f"{path}.{declaration.name}"
        if declaration.kind and value is not None:
            yield from _shown(value, key)
        elif value is not None and (path in _ALWAYS_SHOWN or value != declaration.default):
            yield key, _text(value, declaration)


def _text(value: Any, declaration: Declaration) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    return f"{value:g} {declaration.unit}".removesuffix(" 1") if isinstance(value, float) else str(value)
