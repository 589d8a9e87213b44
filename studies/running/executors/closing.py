"""Ending what may not answer any more."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable


def attempt(action: Callable[[], object], seconds: float) -> None:
    """Do something that may fail or hang, and wait for it only so long.

    Parameters
    ----------
    action : callable
        Its errors are nobody's business: what it was to end is given up anyway.
    seconds : float [s]
        After these it goes on alone, in a thread that does not keep the process alive.
    """

    def quietly() -> None:
        with contextlib.suppress(Exception):
            action()

    thread = threading.Thread(target=quietly, daemon=True)
    thread.start()
    thread.join(seconds)
