"""Shows that closed loops are compiled, which numba does at the first call; it keeps them on disk."""

import contextlib
import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Final

TEXT: Final = "compiling the closed loops, once, about a minute"

Display = Callable[[str], AbstractContextManager[object]]
"""Shows a text while its block runs."""

_modules: set[str] = set()


@functools.cache
def _print_once(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        print(text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def line(text: str) -> Iterator[None]:
    """One line on stderr, in each process the first time."""
    _print_once(text)
    yield


_displays: list[Display] = [line]


@contextlib.contextmanager
def shown_by(display: Display) -> Iterator[None]:
    """Use another display meanwhile, `contextlib.nullcontext` for none."""
    _displays.append(display)
    try:
        yield
    finally:
        _displays.remove(display)


def silence() -> None:
    """Show nothing in this process from now on, whose output nobody reads."""
    _displays.append(contextlib.nullcontext)


def watch(module: str) -> None:
    """Show it when a function of this module is compiled."""
    _modules.add(module)
    _listen()


@functools.cache
def _listen() -> None:
    from numba.core import event

    class Listener(event.Listener):
        """What is compiled for a function that is compiled is part of it; numba compiles in one thread at a time."""

        outermost: Any = None

        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"]
            if self.outermost is None and function.py_func.__module__ in _modules:
                self.outermost, self.shown = function, contextlib.ExitStack()
                self.shown.enter_context(_displays[-1](TEXT))

        def on_end(self, event: Any) -> None:
            if event.data["dispatcher"] is self.outermost:
                self.outermost = None
                self.shown.close()

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
