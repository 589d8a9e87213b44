"""Runs of a study in memory: one row a design and convention, filled as they come, scenarios in any order."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.metrics import COMPANION_COLUMNS, COMPANION_UNITS, Companions
from ldctoolkit.vehicle import Convention
from studies.design import Design
from studies.results import CaseResults, FailedDesign, RunKey, StudyResults, TaskResult
from studies.storage.folder_tables import LawTime
from studies.storage.stored_columns import PartIndex, StoredColumn
from studies.study_file import Study


class SharedRows:
    """Room for d rows of n numbers, as for scores without control, which differ between designs in few windows."""

    def __init__(self, size: int, n: int) -> None:
        self._size = size
        self._row = np.empty(n)
        self._known = np.zeros(n, dtype=np.bool_)
        self._table: FloatArray | None = None

    def put(self, place: int, columns: Any, values: FloatArray) -> None:
        """Set some numbers of a row; `columns` is a slice or an array of int."""
        if self._table is None:
            known = self._known[columns]
            # bits: NaN stands for a scenario that cannot be driven
            same = self._row[columns].view(np.int64) == np.ascontiguousarray(values).view(np.int64)
            if (same | ~known).all():
                if not known.all():
                    self._row[columns] = values
                    self._known[columns] = True
                return
            self._table = np.empty((self._size, self._row.size))
            self._table[:] = self._row
        self._table[place, columns] = values

    def grow(self, size: int) -> None:
        """Make room for more rows."""
        if self._table is not None:
            table = np.empty((size, self._row.size))
            table[: self._size] = self._table
            self._table = table
        self._size = size

    def take(self, rows: IntArray | None, columns: IntArray | None = None) -> FloatArray:
        """Some rows and columns, all by default; a read-only view of one row where there is only one."""
        if self._table is not None:
            table = self._table if rows is None else self._table[rows]
            return table if columns is None else table[:, columns]
        row = self._row if columns is None else self._row[columns]
        return np.broadcast_to(row, (self._size if rows is None else rows.size, row.size))


_GROWS: Final = 1.5


class AllFailedError(LdcError):
    """Every design of a study failed: there is nothing to rank."""


class RunTable:
    """Room for the runs of a study, taken once, so that no run is in memory twice."""

    def __init__(
        self,
        study: Study,
        n: int,
        designs: Sequence[Design],
        *,
        keep: bool = False,
        stored: PartIndex | None = None,
    ) -> None:
        self._study = study
        self.n = n
        self._conventions = study.simulation.convention
        self._windows = study.simulation.window
        self._stored = stored
        self._uncorrected: dict[tuple[int, int], SharedRows] = {}
        self._place: dict[str, int] = {}
        self._kept: dict[str, list[TaskResult]] | None = {} if keep else None
        self.designs: list[Design] = []
        self._make_room(len(designs))
        self.add_designs(designs)

    def _make_room(self, size: int) -> None:
        shape = (len(self._conventions), size, self.n)
        before = len(self.designs)
        companions = 0 if self._stored else len(COMPANION_UNITS)
        fresh: dict[str, Any] = {
            "_S": np.empty((len(self._windows), *shape)),
            "_companions": np.empty((companions, *shape)),
            "_status": np.empty(shape, dtype=np.int8),
            # zeros take no memory until something else is written
            "_failed_solves": np.zeros(shape, dtype=np.int32),
            "_there": np.zeros(shape, dtype=np.bool_),
        }
        for name, array in fresh.items():
            if before:
                array[..., :before, :] = getattr(self, name)[..., :before, :]
            setattr(self, name, array)
        for which in itertools.product(range(len(self._windows)), range(len(self._conventions))):
            self._uncorrected.setdefault(which, SharedRows(size, self.n)).grow(size)

    def add_designs(self, designs: Sequence[Design]) -> None:
        """Make room for designs; those that are there already keep theirs."""
        new = [design for design in designs if design.id not in self._place]
        if len(self.designs) + len(new) > self._status.shape[1]:
            self._make_room(int(_GROWS * (len(self.designs) + len(new))))
        for design in new:
            self._place[design.id] = len(self.designs)
            self.designs.append(design)
            for result in (self._kept or {}).pop(design.id, ()):
                self.put(result)

    _S: npt.NDArray[np.float64]
    _companions: npt.NDArray[np.float64]
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
            scores, values = 2 * len(self._windows), result.values[:, i]
            self._S[:, *at, rows] = values[:scores:2]
            for w in range(len(self._windows)):
                self._uncorrected[w, at[0]].put(at[1], rows, values[2 * w + 1])
            if self._stored is None:
                self._companions[:, *at, rows] = values[scores:]
            self._status[*at, rows] = result.status[i]
            if self._there[*at, rows].any() or result.failed_solves[i].any():
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
        """Everything of the designs asked for; the arrays are this table's, copies only if something is left out."""
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
        whole = rows is None and np.array_equal(at, np.arange(self._status.shape[1]))

        def some(array: Any) -> Any:
            if whole:
                return array
            return array[at] if rows is None else array[np.ix_(at, rows)]

        cases = []
        for case in self._study.cases:
            c, w = self._conventions.index(case.convention), self._windows.index(case.window)
            known = [times.get((design.id, case.convention)) for design in ran]
            cases.append(
                CaseResults(
                    case=case,
                    S=some(self._S[w, c]),
                    S_uncorrected=self._uncorrected[w, c].take(None if whole else at, rows),
                    status=some(self._status[c]),
                    companions=Companions(**self._companions_of(ran, case.convention, rows, some)),
                    failed_solves=some(self._failed_solves[c]),
                    law_time=np.array([np.nan if one is None else one.per_command for one in known]),
                )
            )
        return StudyResults(
            designs=ran,
            scenarios=scenarios if rows is None else scenarios.take(rows),
            cases=tuple(cases),
            failed=failed,
        )

    def _companions_of(
        self, designs: Sequence[Design], convention: Convention, rows: IntArray | None, some: Callable[[Any], Any]
    ) -> dict[str, Any]:
        """Companions by name: arrays, or columns that are read from the parts."""
        if self._stored is None:
            c = self._conventions.index(convention)
            return {name: some(self._companions[i, c]) for i, name in enumerate(COMPANION_UNITS)}
        keys = [(design.id, convention) for design in designs]
        return {
            name: StoredColumn(self._stored, column, keys, self.n, rows) for name, column in COMPANION_COLUMNS.items()
        }

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
