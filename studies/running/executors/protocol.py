"""What an executor runs, and what is asked of it."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Literal, Protocol

Fault = Literal["died", "late"]


class Work(Protocol):
    """Something to be done in one go, anywhere: plain data that can be sent, and how it is done.

    Attributes
    ----------
    number : int
        Of this piece of work in the process that sends it.
    time_limit : float [s]
        How long `run` may take where the worker can be ended; 0 for as long as it likes.
    """

    @property
    def number(self) -> int:
        """Of this piece of work in the process that sends it."""

    @property
    def time_limit(self) -> float:
        """How long `run` may take; 0 for as long as it likes."""

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Load in a worker process what it lacks; no time limit holds."""

    def run(self, kept: dict[str, Any]) -> Any:
        """Do it; what may serve the next work in the same place is left in `kept`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Ended:
    """Work that is no longer under way.

    Attributes
    ----------
    task : Work
        As it was given to `Executor.start`.
    done : object or None
        What its `run` gave; None if the worker is gone, or the work never began.
    fault : {"died", "late"} or None
        The worker ended during the work, by itself or by the time limit; None where the work is not to blame.
    certain : bool
        No other work can have been the reason.
    """

    task: Any
    done: Any = None
    fault: Fault | None = None
    certain: bool = False


class Executor(Protocol):
    """Runs work, in any order.

    Attributes
    ----------
    name : str
        ``"serial"``, ``"processes"`` or ``"dask"``.
    workers : int
        How many pieces of work run at the same time.
    isolated : bool
        Whether work that ends its process leaves this one alive.
    """

    name: str
    isolated: bool

    @property
    def workers(self) -> int:
        """How many pieces of work run at the same time."""

    def start(self, task: Work) -> None:
        """Begin a piece of work, or queue it."""

    def wait(self) -> list[Ended]:
        """Some work that has ended; none if nothing did for a moment."""

    def close(self, *, orderly: bool) -> None:
        """Give back what was taken; if not `orderly`, work under way is given up."""


class SerialExecutor:
    """Runs work in the calling process; what ends its process ends this one, and no time limit holds."""

    name = "serial"
    isolated = False

    def __init__(self) -> None:
        self._waiting: deque[Work] = deque()
        self._kept: dict[str, Any] = {}

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def start(self, task: Work) -> None:
        """Queue a piece of work."""
        self._waiting.append(task)

    def wait(self) -> list[Ended]:
        """Run the next piece."""
        if not self._waiting:
            return []
        task = self._waiting.popleft()
        return [Ended(task, task.run(self._kept))]

    def close(self, *, orderly: bool) -> None:  # noqa: ARG002
        """Forget what was queued."""
        self._waiting.clear()


def attempt(action: Callable[[], object], seconds: float) -> None:
    """Do something that may fail or hang, and wait for it only so long."""

    def quietly() -> None:
        with contextlib.suppress(Exception):
            action()

    thread = threading.Thread(target=quietly, daemon=True)
    thread.start()
    thread.join(seconds)
