"""An executor whose workers die by plan."""

import random
from collections.abc import Callable
from typing import Any

from ldctoolkit.studies.running.dispatch import Ended, Work


class DyingWorkers:
    """Runs up to `workers` tasks at a time, ends them in any order, and loses the whole pool at a deadly one."""

    name, isolated = "processes", True

    def __init__(self, deadly: Callable[[Any], bool], *, workers: int = 2, seed: int = 0) -> None:
        self.deadly, self.workers = deadly, workers
        self.chance = random.Random(seed)
        self.tasks: list[Work] = []
        self.cache: dict[str, Any] = {}

    def start(self, task: Work) -> None:
        self.tasks.append(task)

    def wait(self) -> list[Ended]:
        under_way, queued = self.tasks[: self.workers], self.tasks[self.workers :]
        if not under_way:
            return []
        task = self.chance.choice(under_way)
        if self.deadly(task):
            self.tasks = []
            lost = [Ended(other) for other in queued]
            return lost + [Ended(other, None, "died", len(under_way) == 1) for other in under_way]
        self.tasks.remove(task)
        return [Ended(task, task.run(self.cache))]

    def close(self, *, orderly: bool) -> None:
        pass
