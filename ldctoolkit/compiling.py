"""Numba in this program: closed loops are compiled at the first call, which is shown, and kept on disk."""

import contextlib
import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Final

from ldctoolkit.surroundings import guard_caches

TEXT: Final = "compiling the closed loops, once, about a minute"

# where the functions are that take long
MODULES: Final = {f"ldctoolkit.{m}" for m in ("simulation.kernel.entry", "paths.kernels", "controllers._mpc_kernel")}

Display = Callable[[str], AbstractContextManager[object]]  # shows a text while its block runs


@functools.cache
def line(text: str) -> AbstractContextManager[object]:
    """Print a line on stderr, once in each process."""
    with contextlib.suppress(OSError, ValueError):  # stderr may be closed
        print(text, file=sys.stderr, flush=True)
    return contextlib.nullcontext()


_displays: list[Display] = [line]


@contextlib.contextmanager
def shown_by(display: Display) -> Iterator[None]:
    """Show compilations with another display inside the block."""
    _displays.append(display)
    try:
        yield
    finally:
        _displays.remove(display)


def silence() -> None:
    """Show nothing in this process from now on."""
    _displays.append(contextlib.nullcontext)


@functools.cache
def listen() -> None:
    """Have numba tell what it compiles, and use no cache that others can write; before functions are declared."""
    guard_caches()
    from numba.core import event

    class Listener(event.Listener):
        """What a function calls is compiled with it, and shown with it; numba compiles in one thread at a time."""

        outermost: Any = None

        def on_start(self, event: Any) -> None:
            function = event.data["dispatcher"]
            if self.outermost is None and function.py_func.__module__ in MODULES:
                self.outermost, self.shown = function, _displays[-1](TEXT)
                self.shown.__enter__()

        def on_end(self, event: Any) -> None:
            if event.data["dispatcher"] is self.outermost:
                self.outermost = None
                self.shown.__exit__(None, None, None)

    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
