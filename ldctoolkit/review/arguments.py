"""Arguments of a review that have nothing to do with the design."""

from __future__ import annotations

from typing import Final

import numpy.typing as npt

from ldctoolkit.errors import InputError, plain
from ldctoolkit.option_checks import is_number
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.setup import PlantKnowledge, known_plant
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.bicycle import checked_speeds
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE

LONGEST: Final = 200
"""Samples of delay of the actuator, or of the camera, up to which the loop is worked out: each one is a state."""


def review_plant(
    model: BicycleModel,
    dt: float,
    options: PlantOptions,
    speeds: npt.ArrayLike,
    plant_knowledge: PlantKnowledge = "nominal",
) -> Plant:
    """The nominal vehicle of a review at its speeds.

    Parameters
    ----------
    model : BicycleModel
    dt : float [s]
    options : PlantOptions
        Its delays are checked.
    speeds : (n,) [m/s]
    plant_knowledge : {"nominal", "ideal"}

    Returns
    -------
    Plant

    Raises
    ------
    InputError
        For a sample time or speeds outside what is allowed, or a delay of too many samples.

    Examples
    --------
    >>> review_plant(BicycleModel(), 0.05, PlantOptions(), [20.0, 30.0]).n
    2
    """
    dt = positive("dt", dt, "s")
    v = checked_speeds(speeds)
    if v.size == 0 or v.max() > SPEED_RANGE[1] or v.min() < SPEED_RANGE[0]:
        shown = f"{v.min():g} to {v.max():g} m/s" if v.size else "none"
        raise InputError(f"speeds: {shown}; allowed: one or more from {SPEED_RANGE[0]:g} to {SPEED_RANGE[1]:g} m/s")
    for name, delay in (("actuator", options.actuator.delay), ("sensors", options.sensors.delay)):
        if delay > LONGEST * dt * (1 + 1e-9):
            raise InputError(
                f"{name}.delay: {delay:g} s with dt = {dt:g} s is {delay / dt:.6g} samples; allowed: at most {LONGEST}"
            )
    return known_plant(model, v, dt, options, plant_knowledge)


def positive(name: str, value: object, unit: str) -> float:
    """A finite number above 0.

    Parameters
    ----------
    name : str
        For the message.
    value : object
    unit : str

    Returns
    -------
    float

    Raises
    ------
    InputError
        For anything else.
    """
    given = plain(value)
    if not is_number(given) or not given > 0:
        raise InputError(f"{name}: {given!r} {unit}; allowed: a finite number > 0")
    return float(given)
