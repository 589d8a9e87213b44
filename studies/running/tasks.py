"""What a worker is sent, and what it sends back: plain data."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Final, Self

import numpy as np

from ldctoolkit import Scenarios, Setup
from ldctoolkit.arrays import IntArray
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import FailedRun, RunKey, TaskResult
from studies.running.executors.protocol import Ended, Executor, Fault, Work

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


FIRST_ROUND: Final = 100
"""Scenarios of the first round: with fewer, tails as far out as many designs need are guesswork."""

_WORTH_A_ROUND = 1.5
"""A round is held where it leaves out a third of all scenarios or more; a later one would save little."""


@dataclasses.dataclass(frozen=True, eq=False)
class Piece:
    """Scenarios that are driven as one batch."""

    number: int  # its place among the pieces of its batch size
    rows: IntArray  # (m,): row numbers of the scenarios, rising


@dataclasses.dataclass(frozen=True, eq=False)
class Prefixes:
    """Nested prefixes of a study's scenarios, each side in proportion."""

    side: IntArray  # (n,): of all scenarios
    stops: tuple[int, ...]  # sizes of the prefixes, rising; the last is n

    def rows(self, size: int) -> IntArray:
        """Row numbers of the first `size` scenarios, rising: about the same share of each side."""
        return prefix_rows(self.side, size)

    def pieces(self, batch: int) -> tuple[Piece, ...]:
        """All scenarios in pieces of at most `batch`, none across the end of a prefix."""
        found: list[Piece] = []
        for first, last in zip((0, *self.stops), self.stops, strict=False):
            before = self.rows(first) if first else np.zeros(0, dtype=np.int64)
            new = np.setdiff1d(self.rows(last), before, assume_unique=True)
            count = -(-new.size // batch)
            # even shares of both sides would change no number; stretches are simpler to name
            found += [Piece(len(found) + i, rows) for i, rows in enumerate(np.array_split(new, count))]
        return tuple(found)


def schedule(n: int) -> tuple[int, ...]:
    """Number of scenarios after each round of a race over n: 100, then twice as many every time, and all at the end."""
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise InputError(f"n: {n!r}; allowed: a whole number >= 1")
    sizes, size = [], FIRST_ROUND
    while size * _WORTH_A_ROUND <= n:
        sizes.append(size)
        size *= 2
    return (*sizes, int(n))


def prefix_rows(side: IntArray, m: int) -> IntArray:
    """The scenarios of a round: the first ones of each side, as many as is its share."""
    side = np.asarray(side)
    if not 1 <= m <= side.size:
        raise InputError(f"m: {m!r}; allowed: 1 to {side.size}, the number of scenarios")
    which, counts = np.unique(side, return_counts=True)
    # cumulative shares, rounded: each count rises with m, and together they make m
    ends = np.floor(np.cumsum(counts) * m / side.size + 0.5).astype(np.int64)
    taken = np.diff(ends, prepend=0)
    rows = [np.flatnonzero(side == one)[:count] for one, count in zip(which, taken, strict=True)]
    return np.sort(np.concatenate(rows))


_numbers = itertools.count()


@dataclasses.dataclass(frozen=True)
class Job:
    """What all designs of a study share."""

    token: str  # tells one job from another
    setup: Setup  # of the first convention; tasks name theirs
    windows: tuple[Window, ...]
    laws: bytes = b""  # controller classes that no installed package offers; empty where there are none
    time_limit: float = 0.0  # [s]: of one task; 0 for none

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the floating-point columns of a result."""
        scores = [f"{name}_{window}" for window in self.windows for name in ("S", "S_uncorrected")]
        return (*scores, *COMPANION_UNITS)


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Some designs on some scenarios."""

    job: Job
    convention: Convention
    designs: tuple[Design, ...]  # k designs of one law, by rising y_s
    rows: IntArray  # (m,): row numbers of the scenarios in the study
    scenarios: Scenarios  # these m scenarios
    piece: int  # number of the piece that they are, or a part of
    piece_size: int  # number of scenarios of the whole piece
    number: int = dataclasses.field(default_factory=lambda: next(_numbers))  # of this task in this process

    @property
    def whole(self) -> bool:
        """Whether the scenarios are all of the piece."""
        return self.rows.size == self.piece_size

    @property
    def runs(self) -> int:
        """Scenario runs: designs times scenarios."""
        return len(self.designs) * self.rows.size

    def halves(self) -> tuple[Self, ...]:
        """Two tasks that together are this one, first by designs, then by scenarios; none for one run."""
        if len(self.designs) > 1:
            middle = len(self.designs) // 2
            return tuple(self.only(part) for part in (self.designs[:middle], self.designs[middle:]))
        if self.rows.size > 1:
            middle = self.rows.size // 2
            places = np.split(np.arange(self.rows.size), [middle])
            return tuple(self._with(rows=self.rows[at], scenarios=self.scenarios.take(at)) for at in places)
        return ()

    def only(self, designs: tuple[Design, ...]) -> Self:
        """The same with some of the designs."""
        return self._with(designs=designs)

    def _with(self, **changes: object) -> Self:
        return dataclasses.replace(self, number=next(_numbers), **changes)  # type: ignore[arg-type]


@dataclasses.dataclass(frozen=True, eq=False)
class Done:
    """What came out of a task."""

    result: TaskResult  # of the designs that ran; may hold none
    failed: tuple[FailedRun, ...] = ()  # the others
