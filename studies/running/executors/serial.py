"""Tasks in this process, one after the other."""

from __future__ import annotations

from collections import deque

from studies.running.executors.protocol import Ended
from studies.running.simulate_designs import Simulator
from studies.running.tasks import Task


class SerialExecutor:
    """Runs tasks in the calling process; a law that ends its process ends this one, and no time limit holds."""

    name = "serial"
    isolated = False

    def __init__(self) -> None:
        self._waiting: deque[Task] = deque()
        self._simulators: dict[str, Simulator] = {}

    @property
    def workers(self) -> int:
        """One."""
        return 1

    def start(self, task: Task) -> None:
        """Queue a task."""
        self._waiting.append(task)

    def wait(self) -> list[Ended]:
        """Run the next task."""
        if not self._waiting:
            return []
        task = self._waiting.popleft()
        if task.job.token not in self._simulators:
            self._simulators[task.job.token] = Simulator(task.job)
        return [Ended(task, self._simulators[task.job.token].run(task))]

    def close(self, *, orderly: bool) -> None:  # noqa: ARG002
        """Forget what was queued."""
        self._waiting.clear()
