"""The table ``[plant]`` of a study file: read into `PlantOptions`, and told to a reader again."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.plant_options import (
    Actuator,
    KalmanFilter,
    Mismatch,
    PlantOptions,
    Residuals,
    Sensors,
    Tyres,
)
from studies.study_file._part import fail

_TABLES: Final[dict[str, type]] = {
    "actuator": Actuator,
    "mismatch": Mismatch,
    "tyres": Tyres,
    "sensors": Sensors,
    "kalman": KalmanFilter,
    "residuals": Residuals,
}
"""Key that holds a table of its own -> what the table is read into."""

UNITS: Final = {
    "actuator.delta_max": "rad",
    "actuator.rate_max": "rad/s",
    "actuator.lag": "s",
    "actuator.delay": "s",
    "sensors.e_y_noise": "m",
    "sensors.e_psi_noise": "rad",
    "sensors.e_y_bias": "m",
    "sensors.e_psi_bias": "rad",
    "sensors.e_y_step": "m",
    "sensors.e_psi_step": "rad",
    "sensors.period": "s",
    "sensors.delay": "s",
    "sensors.curvature_bias": "1/m",
    "sensors.curvature_noise": "1/m",
    "sensors.kalman.q_y": "m/s^2/sqrt(Hz)",
    "sensors.kalman.q_psi": "rad/s^2/sqrt(Hz)",
    "sensors.kalman.r_y": "m",
    "sensors.kalman.r_psi": "rad",
    "residuals.bandwidth": "Hz",
}
"""Key -> unit; a key that is not here is a pure number or a word."""

_ALWAYS_TOLD: Final = ("tyres", "sensors.kalman", "residuals")
"""Tables whose defaults say something as soon as the table is used."""


def read_plant(entry: Any) -> Any:
    """The plant options of what stands under ``plant``; what is no table is handed on for the field's own message.

    Parameters
    ----------
    entry : dict or object
        Keys as in a study file; None where a key may be absent.

    Returns
    -------
    PlantOptions or object

    Raises
    ------
    PydanticCustomError
        With the key path below ``plant``, the value and what is allowed.

    Examples
    --------
    >>> read_plant({"speed": "profile", "actuator": {"rate_max": 0.5}}).actuator.rate_max
    0.5
    """
    if not isinstance(entry, dict):
        return entry
    try:
        return _read(PlantOptions, entry, "")
    except InputError as error:
        path, _, message = str(error).partition(": ")
        raise fail(path, message) from None


def _read(kind: type, table: dict[str, Any], prefix: str) -> Any:
    defaults = {field.name: field.default for field in dataclasses.fields(kind)}
    given = {}
    for key, entry in table.items():
        path = f"{prefix}{key}"
        if key not in defaults:
            raise fail(path, f"no such key; {nearest(str(key), defaults)}")
        inner = _TABLES.get(key)
        if inner is None or (entry is None and defaults[key] is None):
            given[key] = entry
        elif isinstance(entry, dict):
            given[key] = _read(inner, entry, f"{path}.")
        else:
            raise fail(path, f"{entry!r}; allowed: a table of keys")
    return kind(**given)


def differences(options: PlantOptions) -> tuple[str, ...]:
    """What is not ideal about a plant, a few words each; empty for the ideal one.

    Examples
    --------
    >>> differences(PlantOptions(speed="profile", actuator=Actuator(lag=0.1)))
    ('the speed follows its profile', 'a steering actuator')
    """
    words = {
        "the speed follows its profile": options.speed == "profile",
        "a steering actuator": not options.actuator.ideal,
        "vehicles that differ from the one that the laws were designed on": not options.mismatch.ideal,
        "saturating tyres": not options.tyres.ideal,
        "a lane camera with a Kalman filter": options.sensors.kalman is not None,
        "a lane camera": options.sensors.kalman is None and not options.sensors.ideal,
        "residuals of the recorded path": not options.residuals.ideal,
    }
    return tuple(text for text, holds in words.items() if holds)


def plant_settings(options: PlantOptions) -> Iterator[tuple[str, str]]:
    """Key and value, with its unit, of everything that differs from the ideal plant.

    Parameters
    ----------
    options : PlantOptions

    Yields
    ------
    (str, str)

    Examples
    --------
    >>> list(plant_settings(PlantOptions(actuator=Actuator(rate_max=0.5))))
    [('actuator.rate_max', '0.5 rad/s')]
    """
    if options.speed != "frozen":
        yield "speed", options.speed
    for name in ("actuator", "mismatch", "tyres", "sensors", "residuals"):
        part = getattr(options, name)
        if not part.ideal:
            yield from _told(part, name)


def _told(part: Any, path: str) -> Iterator[tuple[str, str]]:
    for field in dataclasses.fields(part):
        value, key = getattr(part, field.name), f"{path}.{field.name}"
        if dataclasses.is_dataclass(value):
            yield from _told(value, key)
        elif value is not None and (path in _ALWAYS_TOLD or value != field.default):
            yield key, _text(value, UNITS.get(key, ""))


def _text(value: Any, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return " to ".join(f"{end:g}" for end in value)
    return f"{value:g} {unit}".rstrip() if isinstance(value, float) else str(value)
