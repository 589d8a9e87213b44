"""A simulation's task as executors run it: the simulator that it needs, and what a fresh worker has to load."""

from __future__ import annotations

import dataclasses
import threading
from typing import Any

from ldctoolkit import controller_class, register, registry
from ldctoolkit.simulation import drive
from studies.running.simulate_designs import Simulator
from studies.running.tasks import Done, Job, Task

_JOBS_KEPT = 2

_WARM_LAWS = ("preview_proportional", "pid")
"""A law of each kind of loop: linear, and step by step."""

_lock = threading.Lock()
_warm: set[str] = set()


@dataclasses.dataclass(frozen=True, eq=False)
class SimulationTask(Task):
    """A `Task` that an executor can run. Tasks of one job in one place share their simulator, hence takeovers."""

    @property
    def time_limit(self) -> float:
        """Of the job [s]."""
        return self.job.time_limit

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Make the job's own controllers known, and load the compiled loops: the time limit counts a law's own time."""
        simulators = _simulators(kept)
        if self.job.token not in simulators:
            while len(simulators) >= _JOBS_KEPT:
                del simulators[next(iter(simulators))]
            _learn(self.job.laws)
        _warm_up(_simulator(simulators, self.job), self)

    def run(self, kept: dict[str, Any]) -> Done:
        """Drive the designs."""
        return _simulator(_simulators(kept), self.job).run(self)


def _simulators(kept: dict[str, Any]) -> dict[str, Simulator]:
    simulators: dict[str, Simulator] = kept.setdefault("simulators", {})
    return simulators


def _simulator(simulators: dict[str, Simulator], job: Job) -> Simulator:
    if job.token not in simulators:
        simulators[job.token] = Simulator(job)
    return simulators[job.token]


def _learn(laws: bytes) -> None:
    """Make controllers known that no installed package offers."""
    if not laws:
        return
    import cloudpickle

    for law in cloudpickle.loads(laws):
        with _lock:
            registry.forget(law.name)  # of an earlier job
            register(law)


def _warm_up(chosen: Simulator, task: Task) -> None:
    if task.job.token in _warm or not task.job.time_limit:
        return
    takeover = chosen.takeover(task.designs[0].y_s, task.convention, task.scenarios.take([0]))
    for name in _WARM_LAWS:
        drive(controller_class(name)(), takeover, threads=1)
    _warm.add(task.job.token)
