"""What a worker is sent, and what it sends back: plain data."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Self

import numpy as np

from ldctoolkit import Scenarios, Setup
from ldctoolkit.arrays import IntArray
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import FailedRun, TaskResult

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
