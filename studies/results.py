"""The results of a study, in memory: what the store reads and what ranking and report are made from."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.metrics import Companions
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention
from studies.design import Design

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Case:
    """One way to score a study: the window of S and the reading of the paper."""

    window: Window
    convention: Convention

    @property
    def label(self) -> str:
        """``"departure window, consistent"``."""
        return f"{self.window} window, {self.convention.replace('_', ' ')}"


@dataclasses.dataclass(frozen=True)
class CaseResults:
    """Per-scenario results of all d designs on all n scenarios in one case.

    Attributes
    ----------
    case : Case
    S : (d, n) [m s]
        NaN in a scenario that cannot be driven (`EventStatus.INVALID`), and nowhere else.
    S_uncorrected : (d, n) [m s]
        The recorded path's score over the same window; equal for all designs in the departure window, dependent on the
        design's y_s in the control window.
    status : (d, n) int8
        `ldctoolkit.EventStatus`.
    companions : Companions
        Arrays (d, n) in single precision: seven digits, which is more than any of them is known to.
    failed_solves : (d, n) int32
    law_time : (d,) [s]
        Mean wall time of the law's own step per command; 0 for a linear law, which has none, NaN where it was not
        measured. The one number here that another run does not give again.
    """

    case: Case
    S: FloatArray
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]
    companions: Companions
    failed_solves: npt.NDArray[np.int32]
    law_time: FloatArray

    @property
    def drivable(self) -> BoolArray:
        """Scenarios that every design could be driven on, (n,)."""
        result: BoolArray = (self.status != EventStatus.INVALID).all(axis=0)
        return result

    def take(self, columns: BoolArray) -> CaseResults:
        """The same for some of the scenarios."""
        changes: dict[str, Any] = {
            name: getattr(self, name)[:, columns] for name in ("S", "S_uncorrected", "status", "failed_solves")
        }
        return dataclasses.replace(self, **changes, companions=per_scenario(self.companions, lambda a: a[:, columns]))


def per_scenario(companions: Companions, change: Any) -> Companions:
    """Companions with a function applied to every array."""
    values: dict[str, Any] = {
        field.name: change(getattr(companions, field.name)) for field in dataclasses.fields(Companions)
    }
    return Companions(**values)


@dataclasses.dataclass(frozen=True)
class FailedDesign:
    """A design without results, because its law raised or gave what no law may give.

    Attributes
    ----------
    design : Design
    reason : str
        One sentence: what happened.
    """

    design: Design
    reason: str

    @property
    def sentence(self) -> str:
        """The design and the reason: ``"design 0123456789ab (Boom, y_s=0.2 m, K=5): ZeroDivisionError: K is 5"``."""
        return f"design {self.design.id} ({self.design.label}): {self.reason}"


@dataclasses.dataclass(frozen=True)
class StudyResults:
    """Everything a finished study knows.

    Attributes
    ----------
    designs : tuple of Design
        d designs, in the study's own order, without those that failed.
    scenarios : Scenarios
        The n scenarios that every design was run on: left ones first.
    cases : tuple of CaseResults
        The first one is the study's primary case.
    failed : tuple of FailedDesign
        Designs whose law failed, in any case: they are in no array here, and never ranked.
    """

    designs: tuple[Design, ...]
    scenarios: Scenarios
    cases: tuple[CaseResults, ...]
    failed: tuple[FailedDesign, ...] = ()

    def drivable(self) -> StudyResults:
        """The same without the scenarios that some design could not be driven on in some case; often all of it."""
        rows = np.logical_and.reduce([case.drivable for case in self.cases])
        if rows.all():
            return self
        cases = tuple(case.take(rows) for case in self.cases)
        return StudyResults(self.designs, self.scenarios.take(np.flatnonzero(rows)), cases, self.failed)
