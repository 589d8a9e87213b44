"""A law inside another: its design from two words of text, and as a law that is stepped."""

from __future__ import annotations

from typing import Any

from ldctoolkit import Controller, Gain, LinearLaw, LinearSteps, Plant, SteeringLaw, controller_class
from ldctoolkit.errors import InputError, UnknownNameError, nearest


def inner_design(inner: str, inner_gains: str, owner: type[Controller]) -> Controller:
    """The design that the options `inner` and `inner_gains` of a law name.

    Parameters
    ----------
    inner : str
        Registry key of a law that steers and is not the owner.
    inner_gains : str
        ``"gain=value, gain=value"``; empty for the defaults.
    owner : type
        The law whose options they are, for messages.

    Returns
    -------
    Controller

    Raises
    ------
    InputError
        For a law that cannot be inside, or a gain that is written wrongly or lies outside its declaration.
    UnknownNameError
        For an unknown law or gain, with the nearest name.

    Examples
    --------
    >>> from controllers.barrier_filter import BarrierFilter
    >>> inner_design("preview_proportional", "K_y=-0.02, T_lp=0.5", BarrierFilter).T_lp
    0.5
    """
    try:
        kind = controller_class(inner)
    except UnknownNameError as error:
        raise UnknownNameError(f"{owner.name}.inner: {str(error).removeprefix('law ')}") from None
    if issubclass(kind, owner):
        raise InputError(f"{owner.name}.inner: {inner!r}; allowed: a law other than itself")
    if inner == "none":
        raise InputError(f"{owner.name}.inner: 'none'; allowed: a law that steers, the recorded path has no command")
    where = f"{owner.name}.inner_gains"
    declared = {gain.name: gain for gain in kind.gains()}
    given: dict[str, Any] = {}
    for entry in inner_gains.split(",") if inner_gains.strip() else ():
        name, equals, value = (part.strip() for part in entry.partition("="))
        if not (name and equals and value):
            raise InputError(f"{where}: {entry.strip()!r}; allowed: gain=value, separated by commas")
        if name not in declared:
            raise UnknownNameError(f"{where}: {inner}.{name}: no such gain; {nearest(name, declared)}")
        if name in given:
            raise InputError(f"{where}: {name!r} is given twice; allowed: once")
        given[name] = _value(declared[name], value)
    try:
        return kind(**given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _value(declared: Gain, word: str) -> Any:
    """What a word stands for; the gain's own check names what is not allowed."""
    if declared.choices or declared.text:
        return word
    if isinstance(declared.default, bool):
        return {"true": True, "false": False}.get(word, word)
    try:
        return float(word)
    except ValueError:
        return word


def steering_law(design: Controller, plant: Plant, owner: str) -> SteeringLaw:
    """Prepare a design as a law that is stepped, whatever its kind.

    Parameters
    ----------
    design : Controller
    plant : Plant
        Model, speeds (n,) and sample time.
    owner : str
        The law around it, for messages.

    Returns
    -------
    SteeringLaw

    Raises
    ------
    InputError
        If it does not steer.
    """
    law = design.prepare(plant)
    if isinstance(law, LinearLaw):
        return LinearSteps.of(law, plant)
    if isinstance(law, SteeringLaw):
        return law
    what = type(law).__name__
    raise InputError(f"{owner}.inner: {design.name!r} prepared a {what}; allowed: a LinearLaw or a SteeringLaw")
