"""Which task is to blame for the end of a worker, and when a design has had enough of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ldctoolkit.errors import LdcError
from studies.results import RunKey
from studies.running.executors.protocol import Ended, Executor, Fault, Work
from studies.running.tasks import Task

_STRIKES: Final = 2
"""A task that has ended its worker so often is cut to find the scenario at fault: once may be bad luck."""

_MOST_SCENARIOS: Final = 3
"""Scenarios of a design that may end or stop a worker; with one more the design has failed."""

_MOST_LOST: Final = 25
"""Times in a row that tasks are lost which are not to blame, before it is plain that workers cannot live here."""

_WORDS: Final[dict[Fault, str]] = {"died": "ends its worker process", "late": "takes longer than the time limit"}


class Faults:
    """What is known of tasks that ended their workers."""

    def __init__(self) -> None:
        self._strikes: dict[int, int] = {}
        self._scenarios: dict[RunKey, dict[int, Fault]] = {}
        self._lost = 0
        self.workers_live = False

    def guilty(self, task: Work, fault: Fault, *, certain: bool) -> bool:
        """Whether a task has to be cut, after one more end of its worker."""
        strikes = self._strikes[task.number] = self._strikes.get(task.number, 0) + 1
        return certain and (fault == "late" or strikes >= _STRIKES)

    def inherit(self, half: Task) -> None:
        """Half of a guilty task is under suspicion from the start."""
        self._strikes[half.number] = _STRIKES - 1

    def same_strikes(self, task: Task, other: Task) -> None:
        """Another task, with some of the designs, is as suspect as this one."""
        self._strikes[other.number] = self._strikes.get(task.number, 0)

    def record(self, key: RunKey, row: int, fault: Fault) -> str:
        """Note a scenario at fault; a sentence if the design has failed with that."""
        rows = self._scenarios.setdefault(key, {})
        rows[row] = fault
        if len(rows) <= _MOST_SCENARIOS:
            return ""
        named = ", ".join(f"{row} ({_WORDS[kind]})" for row, kind in sorted(rows.items()))
        return f"ends or stops its worker process in scenarios {named}"

    def came_back(self, came: Iterable[Ended]) -> None:
        """Count whether tasks were lost that are not to blame: once, however many a broken pool held."""
        if not any(ended.done is None and ended.fault is None for ended in came):
            return
        self._lost += 1
        if self._lost >= _MOST_LOST:
            raise LdcError(
                "worker processes end before they have done anything (out of memory, or killed from outside); what was "
                "stored is kept: run it again, with fewer workers if memory was short"
            )

    def check_workers(self, executor: Executor, harmless: Work) -> None:
        """Where nothing has ended well yet, see whether a worker lives at all; nothing else may be under way."""
        if self.workers_live:
            return
        executor.start(harmless)
        while not (came := executor.wait()):
            pass
        if came[0].done is None:
            raise LdcError("worker processes end whatever they run; what was stored is kept")
        self.ended_well()

    def ended_well(self) -> None:
        """A task gave its result."""
        self._lost = 0
        self.workers_live = True
