"""Controllers by name: registered in the running program, or found by the entry-point group of installed packages."""

from __future__ import annotations

import functools
import importlib.metadata
import importlib.util
import sys
from pathlib import Path

from ldctoolkit.control import Controller
from ldctoolkit.errors import InputError, LdcError, ShadowedPackageError, UnknownNameError, nearest

GROUP = "ldctoolkit.controllers"

_registered: dict[str, type[Controller]] = {}


def register(controller: type[Controller]) -> type[Controller]:
    """Make a controller class known under its ``name``; usable as a decorator.

    Parameters
    ----------
    controller : type
        A concrete subclass of `Controller`.

    Returns
    -------
    type
        The same class.

    Raises
    ------
    InputError
        If it is not a controller, has no name, or another class already has the name.

    Examples
    --------
    >>> import dataclasses
    >>> from ldctoolkit import Controller, RecordedPath, register
    >>> @register
    ... @dataclasses.dataclass(frozen=True)
    ... class Idle(Controller):
    ...     name = "idle"
    ...     title = "Idle"
    ...     def prepare(self, plant):
    ...         return RecordedPath()
    """
    if not (isinstance(controller, type) and issubclass(controller, Controller)):
        raise InputError(f"register: {controller!r}; allowed: a subclass of Controller")
    name = getattr(controller, "name", None)
    if not isinstance(name, str) or not name:
        raise InputError(f"register: {controller.__name__}.name is {name!r}; allowed: a non-empty word")
    known = _registered.get(name)
    same = known is not None and (known.__module__, known.__qualname__) == (
        controller.__module__,
        controller.__qualname__,
    )
    if (known is not None and not same) or (known is None and name in _installed()):
        raise InputError(f"register: a controller named {name!r} is already registered; choose another name")
    _registered[name] = controller
    return controller


@functools.cache
def _installed() -> dict[str, importlib.metadata.EntryPoint]:
    return {point.name: point for point in importlib.metadata.entry_points(group=GROUP)}


def controller_names() -> tuple[str, ...]:
    """Names of all known controllers, sorted."""
    return tuple(sorted({*_registered, *_installed()}))


def controller_class(name: str) -> type[Controller]:
    """The controller class of that name.

    Parameters
    ----------
    name : str
        Registry key.

    Returns
    -------
    type

    Raises
    ------
    UnknownNameError
        Naming the nearest known controller.
    ShadowedPackageError
        If a user's own folder hides the package that should hold it.
    LdcError
        If the installed controller cannot be loaded; the message carries the reason.
    """
    if name in _registered:
        return _registered[name]
    point = _installed().get(name)
    if point is None:
        raise UnknownNameError(f"law {name!r}: no such controller; {nearest(name, controller_names())}")
    check_not_shadowed(point.value.partition(":")[0].partition(".")[0])
    try:
        loaded = point.load()
    except (ImportError, AttributeError) as error:
        raise LdcError(f"controller {name!r} ({point.value}) cannot be loaded: {error}") from error
    if not (isinstance(loaded, type) and issubclass(loaded, Controller)):
        raise LdcError(f"controller {name!r} ({point.value}) is not a subclass of Controller")
    return loaded


def check_not_shadowed(package: str) -> None:
    """Raise if one of the toolkit's own packages is, or would be, imported from a user's folder of the same name.

    ``controllers`` and ``studies`` are general names; a folder so called in the working directory or on
    ``PYTHONPATH`` comes before the installed one. Nothing of the user's is run to find out.

    Raises
    ------
    ShadowedPackageError
        Naming the folder.
    """
    if package not in ("controllers", "studies"):
        return
    home = Path(__file__).resolve().parent.parent / package
    module = sys.modules.get(package)
    if module is not None:
        places = [*getattr(module, "__path__", []), getattr(module, "__file__", None) or package]
    else:
        spec = importlib.util.find_spec(package)
        if spec is None:
            return  # not there at all: the import itself says so
        places = [*(spec.submodule_search_locations or []), spec.origin or package]
    place = Path(places[0]).resolve()
    if place == home:
        return
    raise ShadowedPackageError(
        f"{place} shadows the toolkit's own package {package!r} at {home}: rename it, or start Python elsewhere"
    )
