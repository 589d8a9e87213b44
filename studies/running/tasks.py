"""What a worker is sent, and what it sends back: plain data."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Self

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios, VehicleParameters
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.simulation import InitialYawRate, Window
from ldctoolkit.vehicle import Convention
from studies.design import Design

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

RunKey = tuple[str, str]
"""Identifier of a design and a convention: what one simulation is called."""

_numbers = itertools.count()


@dataclasses.dataclass(frozen=True)
class Job:
    """What all designs of a study share.

    Attributes
    ----------
    token : str
        Tells one job from another.
    vehicle : VehicleParameters
    dt : float [s]
    windows : tuple of {"departure", "control"}
    initial_yaw_rate : {"path", "zero"}
    options : PlantOptions
        What differs from the ideal plant.
    settle : float [s]
        How long the loop goes on after a departure's end.
    seed : int
        Of what is drawn for each scenario.
    laws : bytes
        Controller classes that no installed package offers; empty where there are none.
    time_limit : float [s]
        Of one task; 0 for none.
    """

    token: str
    vehicle: VehicleParameters
    dt: float
    windows: tuple[Window, ...]
    initial_yaw_rate: InitialYawRate
    options: PlantOptions
    settle: float
    seed: int
    laws: bytes = b""
    time_limit: float = 0.0

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the floating-point columns of a result."""
        scores = [f"{name}_{window}" for window in self.windows for name in ("S", "S_uncorrected")]
        return (*scores, *COMPANION_UNITS)


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """Some designs on some scenarios.

    Attributes
    ----------
    job : Job
    convention : {"consistent", "as_printed"}
    designs : tuple of Design
        k designs of one law, by rising y_s.
    rows : (m,) int
        Row numbers of the scenarios in the study.
    scenarios : Scenarios
        These m scenarios.
    piece : int
        Number of the piece that they are, or a part of.
    piece_size : int
        Number of scenarios of the whole piece.
    number : int
        Of this task in this process.
    """

    job: Job
    convention: Convention
    designs: tuple[Design, ...]
    rows: IntArray
    scenarios: Scenarios
    piece: int
    piece_size: int
    number: int = dataclasses.field(default_factory=lambda: next(_numbers))

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
class TaskResult:
    """Results of k designs on m scenarios.

    Attributes
    ----------
    keys : tuple of (str, str)
        Design id and convention, k of them.
    rows : (m,) int
        Row numbers of the scenarios in the study.
    values : (c, k, m)
        `Job.columns`.
    status : (k, m) int8
    failed_solves : (k, m) int32
    law_seconds : (k,) [s]
        Wall time inside the laws' own steps.
    commands : (k,) int
        Scenarios times samples that they gave a command for.
    kernel_seconds : float [s]
        Wall time inside the closed loop, all designs together.
    seconds : float [s]
        Wall time of the whole task.
    """

    keys: tuple[RunKey, ...]
    rows: IntArray
    values: FloatArray
    status: npt.NDArray[np.int8]
    failed_solves: npt.NDArray[np.int32]
    law_seconds: FloatArray
    commands: IntArray
    kernel_seconds: float = 0.0
    seconds: float = 0.0

    def take(self, places: list[int]) -> TaskResult:
        """The same for some of the designs."""
        return dataclasses.replace(
            self,
            keys=tuple(self.keys[i] for i in places),
            values=self.values[:, places],
            status=self.status[places],
            failed_solves=self.failed_solves[places],
            law_seconds=self.law_seconds[places],
            commands=self.commands[places],
        )

    def sorted_by_row(self) -> TaskResult:
        """The same with rising row numbers."""
        order = np.argsort(self.rows)
        return dataclasses.replace(
            self,
            rows=self.rows[order],
            values=self.values[:, :, order],
            status=self.status[:, order],
            failed_solves=self.failed_solves[:, order],
        )


@dataclasses.dataclass(frozen=True)
class FailedRun:
    """A run that a law's own fault ended.

    Attributes
    ----------
    key : (str, str)
        Design id and convention.
    piece : int
        Number of the piece of scenarios in which it did.
    reason : str
        One sentence.
    """

    key: RunKey
    piece: int
    reason: str


@dataclasses.dataclass(frozen=True, eq=False)
class Done:
    """What came out of a task.

    Attributes
    ----------
    result : TaskResult
        Of the designs that ran; may hold none.
    failed : tuple of FailedRun
        The others.
    """

    result: TaskResult
    failed: tuple[FailedRun, ...] = ()
