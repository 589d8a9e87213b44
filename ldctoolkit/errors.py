"""The one family of errors that the toolkit raises on purpose.

An error is data: where it is (`path`), what was given (`value`), what is wrong with it (`problem`), what is `allowed`,
and a `hint`. The sentence is made where it is shown; no code takes a sentence apart. Every leaf also derives from the
builtin that a caller would expect, so ``except ValueError`` keeps working.
"""

import difflib
import functools
import inspect
import itertools
import re
import traceback
from collections.abc import Collection, Iterable, Sequence
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Final, Self, TypeVar, get_args


class _NotGiven:
    def __repr__(self) -> str:
        return "NOT_GIVEN"

    def __reduce__(self) -> str:
        return "NOT_GIVEN"


_Error = TypeVar("_Error", bound="LdcError")

NOT_GIVEN: Final = _NotGiven()
"""`LdcError.value` where nothing was given, or where what was given says nothing."""


class LdcError(Exception):
    """Base of every error that the toolkit raises on purpose.

    Parameters
    ----------
    path : str or path
        The field (``"lqr.r_delta"``), the key of a file (``"study.toml: gains.lqr"``), or file and line.
    problem : str
        What is wrong, where the value and what is allowed do not say it.
    value : object
        What was given; left out where nothing was.
    allowed : str or collection of str
        What is allowed: a phrase (``"a number > 0"``), or the names that exist, of which the nearest is proposed.
    listing : str
        A phrase that stands for the names where they are too many to be shown.
    hint : str
        What to do about it.

    Attributes
    ----------
    path, problem, value, allowed, hint
        As given. `str` makes the sentence of them.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> try:
    ...     ldc.load_model("referense")
    ... except ldc.LdcError as error:
    ...     print(type(error).__name__, error.value)
    UnknownNameError referense
    """

    def __init__(
        self,
        path: str | PathLike[str] = "",
        problem: str = "",
        *,
        value: object = NOT_GIVEN,
        allowed: str | Collection[str] = "",
        listing: str = "",
        hint: str = "",
    ) -> None:
        self.path = str(path)
        super().__init__(self.path, problem)
        self.problem, self.value = problem, value
        self.allowed = allowed if isinstance(allowed, str) else tuple(allowed)
        self.listing, self.hint = listing, hint

    def __reduce__(self) -> tuple[Any, ...]:
        fields = self.__dict__
        if not isinstance(self.value, str | float | int | None | _NotGiven):  # it may be anything, also unpicklable
            fields = fields | {"value": _Repr(short(self.value))}
        return _made, (type(self), fields)

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.path, self.without_path)))

    @property
    def without_path(self) -> str:
        """The sentence behind its path: for a list whose rows name the path themselves."""
        value = "" if self.value is NOT_GIVEN else short(self.value)
        if isinstance(self.allowed, str):
            allowed = self.allowed and f"allowed: {self.allowed}"
        else:  # a mistyped name is the value, or the end of the path
            name = re.split("[. ]", self.path)[-1] if self.value is NOT_GIVEN else str(self.value)
            allowed = nearest(name, self.allowed, self.listing)
        problem = " ".join(filter(None, (value, self.problem)))
        return "; ".join(filter(None, (problem, allowed, self.hint)))

    def within(self, outer: str, separator: str = ".") -> Self:
        """The same error, as seen from outside: `outer` stands before its path."""
        joined = f"{outer}{'' if self.path.startswith('[') else separator}{self.path}" if self.path else outer
        return self.at(joined if outer else self.path)

    def at(self, path: str) -> Self:
        """The same error with another path."""
        return self._changed(path=path)

    def hinted(self, hint: str) -> Self:
        """The same error with a further hint."""
        return self._changed(hint="; ".join(filter(None, (self.hint, hint))))

    def _changed(self, **fields: str) -> Self:
        return _made(type(self), self.__dict__ | fields)

    @classmethod
    def of(cls, error: "LdcError") -> Self:
        """An error of this class with the fields of another error."""
        return cls()._changed(**error.__dict__)


def _made(kind: type[_Error], fields: dict[str, Any]) -> _Error:
    """An error of a kind with these fields, whatever its own `__init__` takes."""
    error = kind.__new__(kind, fields["path"], fields["problem"])
    error.__dict__.update(fields)
    return error


class _Repr(str):
    """What a value looked like, where the value itself did not travel."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def short(value: object) -> str:
    """The text of a value in a message, at most 80 characters."""
    text = repr(plain(value))
    return text if len(text) <= 80 else text[:77] + "..."


class InputError(LdcError, ValueError):
    """An argument, an array or a gain is outside what is allowed."""


class RecordingError(LdcError, ValueError):
    """A driving recording or a departures table cannot be used; `path` names file, column and row."""


class ModelError(LdcError, ValueError):
    """A scenario model file is broken, of another schema, or does not fit its own bounds."""


class StudyError(LdcError, ValueError):
    """A study file is wrong; `path` names the key."""


class StoreError(LdcError, RuntimeError):
    """Stored results are missing, broken, or belong to another study."""


class ClusterError(LdcError, RuntimeError):
    """A Dask cluster cannot do the work: it has no workers, or they die."""


class UnknownNameError(LdcError, KeyError):
    """A name (law, gain, model, catalog study) is not known; `allowed` lists what is."""


class UnknownArgumentError(LdcError, TypeError):
    """A keyword argument does not exist; `allowed` lists what does."""


class CheckedArguments:
    """Base of dataclasses that a user fills: a wrong name of a field is named with the nearest right one."""

    if not TYPE_CHECKING:  # what may be given is what `__init__` takes

        def __new__(cls, *_, **given):
            """Raise `UnknownArgumentError` for a name that `__init__` does not know."""
            for name in given:
                if name not in (names := _arguments(cls) or given):
                    raise UnknownArgumentError(cls.__name__, "is not an argument", value=name, allowed=tuple(names))
            return super().__new__(cls)


@functools.cache
def _arguments(kind: type) -> tuple[str, ...]:
    """Names of the arguments of an `__init__`; empty where it takes any name."""
    _, *parameters = inspect.signature(kind.__init__).parameters.values()  # type: ignore[misc]
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    return () if takes_any else tuple(parameter.name for parameter in parameters)


def nearest(name: str, allowed: Iterable[str], listing: str = "") -> str:
    """What a mistyped name was likely meant to be, and all that is allowed, or the `listing` that stands for it.

    Examples
    --------
    >>> nearest("lqq", ["lqr", "none"])
    "did you mean 'lqr'? (allowed: lqr, none)"
    """
    names = sorted(allowed)
    listing = f"allowed: {listing or ', '.join(names)}"
    close = closest(name, names)
    return f"did you mean '{close}'? ({listing})" if close else listing


def closest(name: str, names: Sequence[str], cutoff: float = 0.5) -> str:
    """The name that a mistyped one resembles by a share of its letters or more, whatever its case; or an empty text."""
    lower = {word.lower(): word for word in reversed(names)}
    for words, share in ((lower, max(cutoff, 0.6)), ([word for word in lower if len(word) > 3], cutoff)):
        if close := difflib.get_close_matches(name.lower(), words, n=1, cutoff=share):
            return lower[close[0]]
    return ""  # short words have two letters in common by chance


def first_line(error: BaseException) -> str:
    """The first line of another library's error message."""
    text = str(error)
    return text.partition("\n")[0].strip() or type(error).__name__


def expect(name: str, value: object, kind: type | UnionType) -> None:
    """Raise `InputError` for an argument of a wrong type."""
    if not isinstance(value, kind):
        description = (
            f"the class {value.__name__}" if isinstance(value, type) else f"an object of type {type(value).__name__}"
        )
        kinds = " or ".join("None" if t is NoneType else t.__name__ for t in get_args(kind) or (kind,))
        raise InputError(name, description, allowed=kinds)


def plain(value: Any) -> Any:
    """A NumPy scalar as the Python number it holds, anything else as it is: for checks and for messages."""
    is_scalar = type(value).__module__ == "numpy" and getattr(value, "shape", None) == ()
    return value.item() if is_scalar else value


_OURS: Final = tuple(Path(__file__).resolve().parents[1] / package for package in ("ldctoolkit", "studies"))
_LONGEST_LINE: Final = 500


def raised(error: BaseException) -> str:
    """What was raised, in one line, with the law's own file and line; messages of the toolkit as they are."""
    text = " ".join(f"{error}".encode("utf-8", "backslashreplace").decode().split())
    if not isinstance(error, LdcError):
        text = f"{type(error).__name__}: {text}" if text else type(error).__name__
    if len(text) > _LONGEST_LINE:
        text = f"{text[: _LONGEST_LINE - 4]} ..."

    def is_ours(frame: traceback.FrameSummary) -> bool:
        return any(Path(frame.filename).resolve().is_relative_to(folder) for folder in _OURS)

    # the innermost line in the file that the toolkit called
    frames = list(itertools.dropwhile(is_ours, traceback.extract_tb(error.__traceback__)))
    inside = [frame for frame in frames if frame.filename == frames[0].filename]
    if not inside or isinstance(error, LdcError):
        return text
    return f"{text} ({Path(inside[-1].filename).name}, line {inside[-1].lineno})"
