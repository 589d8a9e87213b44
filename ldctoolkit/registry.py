"""Controllers by name: registered in the running program, or found by the entry-point group of installed packages.

What a study file names as ``FILE.py:NAME`` is loaded here too, whatever it is.
"""

import functools
import hashlib
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import Any

from ldctoolkit.code_content import content_of
from ldctoolkit.control import Controller, check_class
from ldctoolkit.declared import undeclared_fields
from ldctoolkit.errors import InputError, LdcError, UnknownNameError
from ldctoolkit.version import entry_points

GROUP = "ldctoolkit.controllers"

_registered: dict[str, type[Controller]] = {}

_by_code: dict[tuple[str, str], type[Controller]] = {}  # classes that designs were made with, by name and content


def register(controller: type[Controller]) -> type[Controller]:
    """Make a controller class known under its ``name``; usable as a decorator.

    Raises `InputError` if it is not a controller class as `Controller` asks for, takes anything that is neither gain
    nor option, or another class already has the name.

    Parameters
    ----------
    controller : type
        A concrete subclass of `Controller`; all that its constructor takes is made with `gain` and `option`.

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
        raise InputError("controller", value=controller, allowed="a subclass of Controller")
    _check(controller)
    name, present, point = controller.name, _registered.get(controller.name), entry_points(GROUP).get(controller.name)
    if present is not None:
        same = (present.__module__, present.__qualname__) == (controller.__module__, controller.__qualname__)
    else:
        # the entry point may name the class in its own module, or in a package above that hands it on
        same = point is None or (
            point.attr == controller.__qualname__ and f"{controller.__module__}.".startswith(f"{point.module}.")
        )
    if not same:
        raise InputError(
            f"{controller.__name__}.name", "is the name of another controller", value=name, hint="choose another"
        )
    _registered[name] = controller
    return controller


def registered() -> tuple[type[Controller], ...]:
    """Classes that `register` made known in this process, by name."""
    return tuple(_registered[name] for name in sorted(_registered))


def forget(name: str) -> None:
    """Undo `register`; a name that was not registered is left alone."""
    _registered.pop(name, None)


def _check(controller: type[Controller]) -> None:
    """Raise if a class cannot be used by name: studies see, write and compare its gains and nothing else."""
    check_class(controller)
    for field in undeclared_fields(controller):
        raise InputError(f"{controller.__name__}.{field}", "a plain field", allowed="one made with gain() or option()")


def controller_names() -> tuple[str, ...]:
    """Names of all known controllers, sorted.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> "lqr" in ldc.controller_names()
    True
    """
    return tuple(sorted({*_registered, *entry_points(GROUP)}))


def laws_inside(kind: type[Controller], gains: Mapping[str, Any]) -> Iterable[type[Controller]]:
    """Classes of the laws that options of a design name."""
    for name in kind.law_options:
        yield controller_class(gains[name] if name in gains else getattr(kind, name))


def code_of(kind: type[Controller], gains: Mapping[str, Any]) -> str:
    """The content of a law's class and of the laws inside it, which the class is kept under."""
    contents = [content for content in map(content_of, (kind, *laws_inside(kind, gains))) if content]
    code = hashlib.sha256("".join(contents).encode()).hexdigest()[:16] if len(contents) > 1 else "".join(contents)
    if code:
        _by_code[kind.name, code] = kind
    return code


Keyed = tuple[tuple[tuple[str, str], type[Controller]], ...]


def keyed(kinds: Iterable[type[Controller]]) -> Keyed:
    """Classes with the names and contents that designs of this process know them by."""
    by_code = {(kind.name, content_of(kind)): kind for kind in kinds}
    return tuple((by_code | {key: kind for key, kind in _by_code.items() if kind in by_code.values()}).items())


def learn(classes: Keyed) -> None:
    """Make classes of another process known; those of an earlier job are forgotten."""
    for key, kind in classes:
        forget(kind.name)
        register(kind)
        _by_code[key] = kind


def bound_class(name: str, code: str, *, same: bool = False) -> type[Controller]:
    """The class that a design was made with, or else the present one of its name; with `same` only of the same code."""
    kind = _by_code.get((name, code)) or controller_class(name)
    if same and (name, code) not in _by_code and content_of(kind) not in ("", code):
        raise LdcError("law", "does not have the code of the design", value=name, hint="run the study again")
    return kind


def with_content(name: str, content: str) -> type[Controller] | None:
    """The class of a name whose content is this one now; None where no such class is known."""
    kinds = (_by_code.get((name, content)), controller_class(name))
    return next((kind for kind in kinds if kind is not None and content_of(kind) == content), None)


def controller_class(name: str) -> type[Controller]:
    """The controller class of that name.

    Raises `UnknownNameError` for a name that is not known; `LdcError` if the installed controller cannot be loaded, or
    does not follow `Controller`.

    Parameters
    ----------
    name : str
        Registry key.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.controller_class("lqr").title
    'LQR'
    """
    if name in _registered:
        return _registered[name]
    point = entry_points(GROUP).get(name)
    if point is None:
        hint = "a class of your own needs an entry point, or ldctoolkit.register(...) in each program"
        raise UnknownNameError("law", "is not a known control law", value=name, allowed=controller_names(), hint=hint)
    return _load(name, point)


@functools.cache
def _load(name: str, point: EntryPoint) -> type[Controller]:
    where = f"controller {name!r} ({point.value})"
    try:
        loaded = point.load()
    except Exception as error:  # whatever third-party code raises
        kind = "" if isinstance(error, LdcError | ImportError) else f"{type(error).__name__}: "
        raise LdcError(where, f"cannot be loaded: {kind}{error}") from error
    if not (isinstance(loaded, type) and issubclass(loaded, Controller)):
        raise LdcError(where, value=loaded, allowed="a subclass of Controller")
    _check(loaded)
    if loaded.name != name:
        raise LdcError(f"{where}: name", value=loaded.name, allowed=repr(name))
    return loaded
