"""The one family of errors that the toolkit raises on purpose.

Every leaf also derives from the builtin that a caller would expect, so ``except ValueError`` keeps working.
A message names the field (or the file and line), the value, what is allowed and the nearest valid name.
"""

import difflib
import functools
import inspect
from collections.abc import Iterable
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, get_args


class LdcError(Exception):
    """Base of every error that the toolkit raises on purpose.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> try:
    ...     ldc.load_model("referense")
    ... except ldc.LdcError as error:
    ...     print(type(error).__name__)
    UnknownNameError
    """


class InputError(LdcError, ValueError):
    """An argument, an array or a gain is outside what is allowed."""


class RecordingError(LdcError, ValueError):
    """A driving recording or a departures table cannot be used; the message names file, column and row."""


class ModelError(LdcError, ValueError):
    """A scenario model file is broken, of another schema, or does not fit its own bounds."""


class StudyError(LdcError, ValueError):
    """A study file is wrong; the message names the key path."""


class StoreError(LdcError, RuntimeError):
    """Stored results are missing, broken, or belong to another study."""


class ClusterError(LdcError, RuntimeError):
    """A Dask cluster cannot do the work: it has no workers, or they die."""


class UnknownNameError(LdcError, KeyError):
    """A name (law, gain, model, catalog study) is not known; the message lists what is."""

    def __str__(self) -> str:
        return str(self.args[0])  # KeyError would print the repr


class UnknownArgumentError(LdcError, TypeError):
    """A keyword argument does not exist; the message names the nearest that does."""


class CheckedArguments:
    """Base of dataclasses that a user fills: a wrong name of a field is named with the nearest right one."""

    if not TYPE_CHECKING:  # what may be given is what `__init__` takes

        def __new__(cls, *_, **given):
            """Raise `UnknownArgumentError` for a name that `__init__` does not know."""
            for name in given:
                if name not in (known := _arguments(cls) or given):
                    raise UnknownArgumentError(f"{cls.__name__}: no argument {name!r}; {nearest(name, known)}")
            return super().__new__(cls)


@functools.cache
def _arguments(kind: type) -> tuple[str, ...]:
    """Names that an `__init__` takes; none where it takes any."""
    _, *known = inspect.signature(kind.__init__).parameters.values()  # type: ignore[misc]
    return () if any(one.kind is one.VAR_KEYWORD for one in known) else tuple(one.name for one in known)


def nearest(name: str, allowed: Iterable[str], listing: str = "") -> str:
    """Half a sentence that helps someone who mistyped a name.

    Parameters
    ----------
    name : str
        The name that was given.
    allowed : iterable of str
        The names that exist.
    listing : str
        What stands for all of them where they are too many to be shown.

    Returns
    -------
    str
        ``"did you mean 'lqr'? (allowed: lqr, none)"``, or only the allowed names when none is near.

    Examples
    --------
    >>> nearest("lqq", ["lqr", "none"])
    "did you mean 'lqr'? (allowed: lqr, none)"
    """
    names = sorted(allowed)
    listing = f"allowed: {listing or ', '.join(names)}"
    lower = {one.lower(): one for one in reversed(names)}
    close = difflib.get_close_matches(name.lower(), lower, n=1, cutoff=0.5)
    return f"did you mean '{lower[close[0]]}'? ({listing})" if close else listing


def expect(name: str, value: object, kind: type | UnionType) -> None:
    """Raise `InputError` for an argument of a wrong type."""
    if not isinstance(value, kind):
        given = (
            f"the class {value.__name__}" if isinstance(value, type) else f"an object of type {type(value).__name__}"
        )
        kinds = " or ".join("None" if one is NoneType else one.__name__ for one in get_args(kind) or (kind,))
        raise InputError(f"{name}: {given}; allowed: {kinds}")


def plain(value: Any) -> Any:
    """A NumPy scalar as the Python number it holds, anything else as it is: for checks and for messages."""
    is_scalar = type(value).__module__ == "numpy" and getattr(value, "shape", None) == ()
    return value.item() if is_scalar else value
