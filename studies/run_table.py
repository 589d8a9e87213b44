"""Runs of a study in memory: one row a design and convention, filled as they come."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.metrics import Companions
from studies.results import CaseResults, FailedDesign, StudyResults
from studies.spec import Study

FloatArray = npt.NDArray[np.float64]

RunKey = tuple[str, str]
"""Identifier of a design and a convention: what one simulation is called."""

COMPANIONS = tuple(field.name for field in dataclasses.fields(Companions))


@dataclasses.dataclass(frozen=True)
class LawTime:
    """Wall time inside a law's own steps.

    Attributes
    ----------
    seconds : float [s]
        Of all steps of one run.
    commands : int
        Scenarios times samples that they gave a command for.
    """

    seconds: float
    commands: int

    @property
    def per_command(self) -> float:
        """Mean wall time per command [s]; 0 where nobody was steered."""
        return self.seconds / self.commands if self.commands else 0.0


@dataclasses.dataclass(frozen=True)
class RunResult:
    """Per-scenario results of one design under one convention; w windows, n scenarios.

    Attributes
    ----------
    key : (str, str)
        Design id and convention.
    S, S_uncorrected : (w, n) [m s]
        In the order of the study's windows.
    status : (n,) int8
    companions : Companions
        Arrays of n in single precision.
    failed_solves : (n,) int32
    law_time : LawTime or None
        None where it is not known: parts of a study hold only what a second run gives again.
    """

    key: RunKey
    S: FloatArray
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]
    companions: Companions
    failed_solves: npt.NDArray[np.int32]
    law_time: LawTime | None = None


@dataclasses.dataclass(frozen=True)
class FailedRun:
    """A run that a law's own fault ended.

    Attributes
    ----------
    key : (str, str)
        Design id and convention.
    reason : str
        One sentence.
    """

    key: RunKey
    reason: str


class RunTable:
    """Room for every run of a study, taken once, so that no run is in memory twice.

    Parameters
    ----------
    study : Study
    n : int
        Number of scenarios.
    """

    def __init__(self, study: Study, n: int) -> None:
        self._study = study
        conventions = study.simulation.convention
        self._place = {
            (design.id, convention): (c, d)
            for c, convention in enumerate(conventions)
            for d, design in enumerate(study.designs)
        }
        shape = (len(conventions), len(study.designs), n)
        windows = len(study.simulation.window)
        self._S = np.empty((windows, *shape))
        self._S_uncorrected = np.empty((windows, *shape))
        self._status = np.empty(shape, dtype=np.int8)
        self._failed = np.empty(shape, dtype=np.int32)
        self._companions = {name: np.empty(shape, dtype=np.float32) for name in COMPANIONS}
        self._there: set[RunKey] = set()

    def __contains__(self, key: object) -> bool:
        return key in self._there

    def put(self, run: RunResult) -> None:
        """Add one run; one that the study does not hold is left out."""
        if run.key not in self._place:
            return
        at = self._place[run.key]
        self._S[:, *at] = run.S
        self._S_uncorrected[:, *at] = run.S_uncorrected
        self._status[at] = run.status
        self._failed[at] = run.failed_solves
        for name, values in self._companions.items():
            values[at] = getattr(run.companions, name)
        self._there.add(run.key)

    def results(
        self,
        scenarios: Scenarios,
        times: Mapping[RunKey, LawTime],
        failures: Mapping[RunKey, str],
        *,
        source: str,
    ) -> StudyResults:
        """Everything in the study's own order; the arrays are this table's, and copies only if a design failed.

        Parameters
        ----------
        scenarios : Scenarios
        times : mapping of RunKey to LawTime
            Those that are known.
        failures : mapping of RunKey to str
            Why runs that are not here failed.
        source : str
            What a message names first.

        Raises
        ------
        StoreError
            If runs are missing that did not fail.
        LdcError
            If every design failed.
        """
        lost: dict[RunKey, str] = {}
        for key in self._place:
            if key not in self._there and key in failures:
                lost[key] = failures[key]
        missing = len(self._place) - len(self._there) - len(lost)
        if missing:
            raise StoreError(f"{source}: {missing} of {len(self._place)} runs are not there yet; run the study again")
        study, cases = self._study, []
        failed = _failed_designs(study, lost)
        if len(failed) == len(study.designs):
            first = failed[0].sentence
            raise LdcError(f"{source}: every design failed; the first, {first}; all of them are in failures.json")
        gone = {one.design.id for one in failed}
        designs = tuple(design for design in study.designs if design.id not in gone)
        kept = np.flatnonzero([design.id not in gone for design in study.designs]) if gone else slice(None)
        for case in study.cases:
            w, c = study.simulation.window.index(case.window), study.simulation.convention.index(case.convention)
            companions: dict[str, Any] = {name: values[c, kept] for name, values in self._companions.items()}
            known = [times.get((design.id, case.convention)) for design in designs]
            cases.append(
                CaseResults(
                    case=case,
                    S=self._S[w, c, kept],
                    S_uncorrected=self._S_uncorrected[w, c, kept],
                    status=self._status[c, kept],
                    companions=Companions(**companions),
                    failed_solves=self._failed[c, kept],
                    law_time=np.array([np.nan if one is None else one.per_command for one in known]),
                )
            )
        return StudyResults(designs=designs, scenarios=scenarios, cases=tuple(cases), failed=failed)


def _failed_designs(study: Study, lost: Mapping[RunKey, str]) -> tuple[FailedDesign, ...]:
    """Designs with a run that failed, in the study's own order."""
    conventions = study.simulation.convention
    failed = []
    for design in study.designs:
        where = tuple(convention for convention in conventions if (design.id, convention) in lost)
        if where:
            # it may fail in one reading of the paper only
            only = f"in the convention {', '.join(where)}: " if len(where) < len(conventions) else ""
            failed.append(FailedDesign(design, only + lost[design.id, where[0]]))
    return tuple(failed)
