"""Runs of a study in memory: one row a design and convention, filled as they come, scenarios in any order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from studies.design import Design
from studies.results import CaseResults, FailedDesign, StudyResults
from studies.running.tasks import RunKey, TaskResult
from studies.storage.timing import LawTime
from studies.study_file.spec import Study

IntArray = npt.NDArray[np.int64]

_GROWS: Final = 1.5


class AllFailedError(LdcError):
    """Every design of a study failed: there is nothing to rank."""


class RunTable:
    """Room for the runs of a study, taken once, so that no run is in memory twice.

    Parameters
    ----------
    study : Study
    n : int
        Number of scenarios.
    designs : sequence of Design
        More can be added.
    keep : bool
        Keep results of designs that have no room yet, until they are added.
    """

    def __init__(self, study: Study, n: int, designs: Sequence[Design], *, keep: bool = False) -> None:
        self._study = study
        self.n = n
        self._conventions = study.simulation.convention
        self._columns = 2 * len(study.simulation.window) + len(COMPANION_UNITS)
        self._place: dict[str, int] = {}
        self._kept: dict[str, list[TaskResult]] | None = {} if keep else None
        self.designs: list[Design] = []
        self._make_room(len(designs))
        self.add_designs(designs)

    def _make_room(self, size: int) -> None:
        shape = (len(self._conventions), size, self.n)
        before = len(self.designs)
        fresh: dict[str, Any] = {
            "_values": np.empty((self._columns, *shape)),
            "_status": np.empty(shape, dtype=np.int8),
            "_failed_solves": np.empty(shape, dtype=np.int32),
            "_there": np.zeros(shape, dtype=np.bool_),
        }
        for name, array in fresh.items():
            if before:
                array[..., :before, :] = getattr(self, name)[..., :before, :]
            setattr(self, name, array)

    def add_designs(self, designs: Sequence[Design]) -> None:
        """Make room for designs; those that are there already keep theirs."""
        new = [design for design in designs if design.id not in self._place]
        if len(self.designs) + len(new) > self._values.shape[2]:
            self._make_room(int(_GROWS * (len(self.designs) + len(new))))
        for design in new:
            self._place[design.id] = len(self.designs)
            self.designs.append(design)
            for result in (self._kept or {}).pop(design.id, ()):
                self.put(result)

    _values: npt.NDArray[np.float64]
    _status: npt.NDArray[np.int8]
    _failed_solves: npt.NDArray[np.int32]
    _there: npt.NDArray[np.bool_]

    def has(self, key: RunKey, rows: IntArray) -> bool:
        """Whether a run's results in some scenarios are there."""
        return bool(self._there[*self._at(key), rows].all())

    def missing(self, key: RunKey) -> int:
        """Number of scenarios that a run's results are not there of."""
        return self.n - int(np.count_nonzero(self._there[self._at(key)]))

    def rows_with(self, key: RunKey, status: EventStatus) -> IntArray:
        """Row numbers of the scenarios that are there and have a status."""
        at = self._at(key)
        return np.flatnonzero(self._there[at] & (self._status[at] == status))

    def _at(self, key: RunKey) -> tuple[int, int]:
        design, convention = key
        return self._conventions.index(convention), self._place[design]

    def put(self, result: TaskResult) -> None:
        """Add results; those of designs that have no room here are kept for later, or left out."""
        places = [i for i, (design, _) in enumerate(result.keys) if design in self._place]
        if self._kept is not None:
            for i in set(range(len(result.keys))) - set(places):
                self._kept.setdefault(result.keys[i][0], []).append(result.take([i]))
        if len(places) < len(result.keys):
            result = result.take(places)
        if not places:
            return
        rows: Any = result.rows
        if rows[-1] - rows[0] + 1 == rows.size:
            rows = slice(int(rows[0]), int(rows[-1]) + 1)  # a stretch, as nearly always: several times faster
        for i, key in enumerate(result.keys):
            at = self._at(key)
            self._values[:, *at, rows] = result.values[:, i]
            self._status[*at, rows] = result.status[i]
            self._failed_solves[*at, rows] = result.failed_solves[i]
            self._there[*at, rows] = True

    def results(
        self,
        scenarios: Scenarios,
        times: Mapping[RunKey, LawTime],
        failures: Mapping[RunKey, str],
        *,
        source: str,
        designs: Sequence[Design] | None = None,
        rows: IntArray | None = None,
    ) -> StudyResults:
        """Everything of the designs asked for; the arrays are this table's, and copies only if something is left out.

        Parameters
        ----------
        scenarios : Scenarios
            All n of them.
        times : mapping of RunKey to LawTime
            Those that are known.
        failures : mapping of RunKey to str
            Why runs that are not here failed.
        source : str
            What a message names first.
        designs : sequence of Design, optional
            All by default.
        rows : (m,) int, optional
            Row numbers of the scenarios; all by default.

        Raises
        ------
        StoreError
            If runs are missing that did not fail.
        AllFailedError
            If every design failed.
        """
        wanted = list(self.designs if designs is None else designs)
        at = np.array([self._place[design.id] for design in wanted], dtype=np.int64)
        some_there = self._there[:, at] if rows is None else self._there[:, at][:, :, rows]
        there: npt.NDArray[np.bool_] = np.all(some_there, axis=2)
        lost: dict[RunKey, str] = {}
        for c, convention in enumerate(self._conventions):
            for i in np.flatnonzero(~there[c]):
                key = (wanted[i].id, convention)
                if key in failures:
                    lost[key] = failures[key]
        if np.count_nonzero(~there) > len(lost):
            raise StoreError(f"{source}: {self._incomplete(wanted, there, lost, some_there)}; run the study again")
        failed = _failed_designs(wanted, self._conventions, lost)
        if wanted and len(failed) == len(wanted):
            first = failed[0].sentence
            raise AllFailedError(f"{source}: every design failed; the first, {first}; all of them are in failures.json")
        gone = {one.design.id for one in failed}
        kept = [i for i, design in enumerate(wanted) if design.id not in gone]
        ran = tuple(wanted[i] for i in kept)
        at = at[kept]
        whole = rows is None and np.array_equal(at, np.arange(self._values.shape[2]))
        windows = self._study.simulation.window
        cases = []
        for case in self._study.cases:
            c = self._conventions.index(case.convention)
            w = 2 * windows.index(case.window)

            def some(array: Any, c: int = c) -> Any:
                if whole:
                    return array[c]
                return array[c][at] if rows is None else array[c][np.ix_(at, rows)]

            after = 2 * len(windows)
            companions: dict[str, Any] = {name: some(self._values[after + i]) for i, name in enumerate(COMPANION_UNITS)}
            known = [times.get((design.id, case.convention)) for design in ran]
            cases.append(
                CaseResults(
                    case=case,
                    S=some(self._values[w]),
                    S_uncorrected=some(self._values[w + 1]),
                    status=some(self._status),
                    companions=Companions(**companions),
                    failed_solves=some(self._failed_solves),
                    law_time=np.array([np.nan if one is None else one.per_command for one in known]),
                )
            )
        return StudyResults(
            designs=ran,
            scenarios=scenarios if rows is None else scenarios.take(rows),
            cases=tuple(cases),
            failed=failed,
        )

    def _incomplete(
        self,
        designs: Sequence[Design],
        there: npt.NDArray[np.bool_],
        lost: Mapping[RunKey, str],
        some_there: npt.NDArray[np.bool_],
    ) -> str:
        """How many designs wait for results that did not fail, and how much is there of all."""
        waits = {
            design.id
            for c, convention in enumerate(self._conventions)
            for design, done in zip(designs, there[c], strict=True)
            if not done and (design.id, convention) not in lost
        }
        # rounded down: all of it would be no reason to complain
        share = 100 * int(np.count_nonzero(some_there)) // some_there.size
        return (
            f"{len(waits)} of {len(designs)} design{'' if len(designs) == 1 else 's'} "
            f"{'is' if len(waits) == 1 else 'are'} not complete ({share} % of the scenario runs are there)"
        )


def _failed_designs(
    designs: Sequence[Design], conventions: Sequence[str], lost: Mapping[RunKey, str]
) -> tuple[FailedDesign, ...]:
    """Designs with a run that failed, in their own order."""
    failed = []
    for design in designs:
        where = tuple(convention for convention in conventions if (design.id, convention) in lost)
        if where:
            # it may fail in one reading of the paper only
            only = f"in the convention {', '.join(where)}: " if len(where) < len(conventions) else ""
            failed.append(FailedDesign(design, only + lost[design.id, where[0]]))
    return tuple(failed)
