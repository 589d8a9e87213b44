"""Work in this process, one piece after the other."""

from __future__ import annotations

from collections import deque
from typing import Any

from studies.running.executors.protocol import Ended, Work


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
