"""How something public goes: it works as before for one minor version at least, and warns."""

import argparse
import dataclasses
import functools
import inspect
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T", bound=Callable[..., Any])


class LdcDeprecationWarning(DeprecationWarning):
    """Something public is used that a later version removes; commands show it too."""


@dataclasses.dataclass(frozen=True)
class Deprecation:
    """What is announced; as a decorator it marks functions, methods (below `property`) and classes."""

    since: str  # version
    removed_in: str
    instead: str = ""  # name that is used from then on, empty for none

    def warn(self, what: str) -> None:
        """Warn at the line that calls what was decorated."""
        text = f"{what} is deprecated since {self.since} and will be removed in {self.removed_in}"
        warnings.warn(f"{text}; use {self.instead}" if self.instead else text, LdcDeprecationWarning, stacklevel=4)

    def __call__(self, thing: T) -> T:
        """The same function or class, which warns where it is called."""
        marked: T = _first(thing, lambda _: self.warn(thing.__qualname__))
        marked.__deprecated__ = self  # type: ignore[attr-defined]
        return marked

    def argument(self, old: str) -> Callable[[T], T]:
        """A decorator: a function or class takes its argument `instead` by a former name too."""

        def rename(thing: str, named: dict[str, Any]) -> None:
            if old in named and self.instead not in named:
                self.warn(f"argument {old} of {thing}")
                named[self.instead] = named.pop(old)

        more = inspect.Parameter(old, inspect.Parameter.KEYWORD_ONLY, default=self)
        return lambda thing: _first(thing, functools.partial(rename, thing.__qualname__), more)

    def option(self, action: argparse.Action) -> None:
        """Make an option of a command warn where it is given, and leave it out of the help."""
        kind: Any = type(action)

        def call(action: Any, parser: argparse.ArgumentParser, *rest: Any) -> None:
            self.warn(f"{rest[-1]} of {parser.prog}")
            kind.__call__(action, parser, *rest)

        action.__class__ = type(kind.__name__, (kind,), {"__call__": call, "__deprecated__": self})
        action.help = argparse.SUPPRESS

    def key(self, table: dict[str, Any], old: str) -> dict[str, Any]:
        """A table of a file with the value of a former key, ``"part.old"``, under its name `instead`."""
        part, _, rest = old.partition(".")
        if rest and isinstance(table.get(part), dict):
            return {**table, part: self.key(table[part], rest)}
        if rest or old not in table or self.instead in table:
            return table
        self.warn(f"key {old}")
        return {self.instead if key == old else key: value for key, value in table.items()}


def _first(thing: T, act: Callable[[dict[str, Any]], None], *more: inspect.Parameter) -> T:
    """The same function, or class, with more arguments by name, with which something is done before each call."""
    run: Any = thing.__init__ if isinstance(thing, type) else thing  # type: ignore[misc]

    @functools.wraps(run)
    def called(*given: Any, **named: Any) -> Any:
        act(named)
        return run(*given, **named)

    parameters = sorted((*inspect.signature(run).parameters.values(), *more), key=lambda one: one.kind)
    called.__signature__ = inspect.signature(run).replace(parameters=parameters)  # type: ignore[attr-defined]
    if isinstance(thing, type):
        thing.__init__ = called  # type: ignore[misc]
    return thing if isinstance(thing, type) else called  # type: ignore[return-value]
