"""What the dispatcher asks of an executor."""

from __future__ import annotations

import dataclasses
from typing import Literal, Protocol

from studies.running.tasks import Done, Task

Fault = Literal["died", "late"]


@dataclasses.dataclass(frozen=True, eq=False)
class Ended:
    """A task that is no longer under way.

    Attributes
    ----------
    task : Task
    done : Done or None
        What came out; None if the worker is gone, or the task never began.
    fault : {"died", "late"} or None
        The worker ended during the task, by itself or by the time limit; None where the task is not to blame.
    certain : bool
        No other task can have been the reason.
    """

    task: Task
    done: Done | None = None
    fault: Fault | None = None
    certain: bool = False


class Executor(Protocol):
    """Runs tasks, in any order.

    Attributes
    ----------
    name : str
        ``"serial"``, ``"processes"`` or ``"dask"``.
    workers : int
        How many tasks run at the same time.
    isolated : bool
        Whether a task that ends its process leaves this one alive.
    """

    name: str
    isolated: bool

    @property
    def workers(self) -> int:
        """How many tasks run at the same time."""

    def start(self, task: Task) -> None:
        """Begin a task, or queue it."""

    def wait(self) -> list[Ended]:
        """Some tasks that have ended; none if nothing did for a moment."""

    def close(self, *, orderly: bool) -> None:
        """Give back what was taken; if not `orderly`, tasks under way are given up."""
