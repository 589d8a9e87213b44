"""The table of runs: scores of designs by scenario, the parts of a folder that hold them, and what is missing."""

from __future__ import annotations

import hashlib
import io
import json
import math
import mmap
import os
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus
from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.metrics import DRIVER_METRICS, METRIC_COLUMNS, METRIC_UNITS, MetricValues, UserMetric
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import Window
from ldctoolkit.surroundings import free_memory

from ..design import Design
from ..results import FailedDesign, StudyResults, TaskResult
from ..study_file import Study
from .checked_parts import write_part
from .folder_files import parse_parquet
from .manifest import LawTime

if TYPE_CHECKING:
    import polars as pl


Item = TypeVar("Item")
Result = TypeVar("Result")


def prefetched(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[tuple[Item, Future[Result]]]:
    """Call a function on each item in a thread; at most two results wait."""
    with ThreadPoolExecutor(1) as pool:
        waiting: deque[tuple[Item, Future[Result]]] = deque()
        for item in items:
            waiting.append((item, pool.submit(function, item)))
            if len(waiting) > 1:
                yield waiting.popleft()
        yield from waiting


PATTERN = "part-*.parquet"

_ENDLESS = "t_back"  # the metric that may be infinite: the edge is not back inside by the end
_WITH_A_DRIVER: Final = frozenset(METRIC_COLUMNS[name] for name in DRIVER_METRICS)  # NaN without one
_DIGITS = 16


_USER: Final = "metric:"  # how columns of designers' metrics begin


def float_columns(window: Window, metrics: Sequence[UserMetric] = ()) -> tuple[str, ...]:
    """Columns of a part in the order of `TaskResult.values`; a designer's metric is known by its content."""
    users = (f"{_USER}{metric.name}:{metric.code}" for metric in metrics)
    return f"S_{window}_m_s", f"S_uncorrected_{window}_m_s", *METRIC_COLUMNS.values(), *users


def schema(window: Window, metrics: Sequence[UserMetric] = ()) -> dict[str, Any]:
    """Columns of a part and their types."""
    import polars as pl

    return {
        "design": pl.String(),
        "scenario": pl.UInt32(),
        **dict.fromkeys(float_columns(window, metrics), pl.Float64()),
        "status": pl.Int8(),
        "failed_solves": pl.Int32(),
    }


def write_results(
    folder: Path, results: Sequence[TaskResult], window: Window, numbers: IntArray, metrics: Sequence[UserMetric] = ()
) -> Path:
    """Write results as one part; the same results in the same order make the same file.

    It holds the numbers (n,) of its scenarios, which other scenarios added later do not change.
    """
    content = io.BytesIO()
    # nearly all columns are noise to a compressor: a fast one loses little
    _results_frame(results, window, numbers, metrics).write_parquet(content, compression="lz4", statistics=False)
    what = json.dumps([[result.ids, numbers[result.rows[[0, -1]]].tolist()] for result in results])
    return write_part(folder, hashlib.sha256(what.encode()).hexdigest()[:_DIGITS], content.getvalue(), "parquet")


def _results_frame(
    results: Sequence[TaskResult], window: Window, numbers: IntArray, metrics: Sequence[UserMetric]
) -> pl.DataFrame:
    import polars as pl

    ids = pl.Series("design", [id for result in results for id in result.ids], dtype=pl.String())
    counts = np.concatenate([np.full(len(result.ids), result.rows.size) for result in results])
    # names are repeated by the library: a million strings of Python would take longer than the simulation
    columns: dict[str, Any] = {
        "design": ids[np.repeat(np.arange(counts.size, dtype=np.uint32), counts)],
        "scenario": np.concatenate(
            [np.tile(numbers[result.rows].astype(np.uint32), len(result.ids)) for result in results]
        ),
    }
    for i, column in enumerate(float_columns(window, metrics)):
        columns[column] = np.concatenate([result.values[i].ravel() for result in results])
    columns["status"] = np.concatenate([result.status.ravel() for result in results])
    columns["failed_solves"] = np.concatenate([result.failed_solves.ravel() for result in results])
    return pl.DataFrame(columns, schema=schema(window, metrics))


def parse_part(
    path: Path, data: bytes, window: Window, numbers: IntArray, metrics: Sequence[UserMetric] = ()
) -> Iterator[TaskResult]:
    """Results that a part holds of scenarios with these numbers, one design and stretch of scenarios at a time.

    None of a part without the column of one of the designer's metrics: its designs have to run again.
    """
    import polars as pl

    order = np.argsort(numbers, kind="stable")
    table = parse_parquet(path, data, schema(window), finite=False, beside=_USER)
    columns = float_columns(window, metrics)
    if not set(columns) <= set(table.columns):
        return
    position = np.searchsorted(numbers[order], table["scenario"].to_numpy()).clip(0, numbers.size - 1)
    is_known = numbers[order[position]] == table["scenario"].to_numpy()
    if not is_known.all():  # of a run on more scenarios
        table, position = table.filter(pl.Series(is_known)), position[is_known]
    status, failed = table["status"].to_numpy(), table["failed_solves"].to_numpy()
    for column in float_columns(window):
        good = table[column].is_not_nan() if column == METRIC_COLUMNS[_ENDLESS] else table[column].is_finite()
        if column in _WITH_A_DRIVER and not good.any():
            continue
        if not good.all() and not good.to_numpy()[status != EventStatus.INVALID].all():
            raise StoreError(path, f"broken: column {column} holds a value that is not finite")
    floats = np.stack([table[column].to_numpy() for column in columns])
    rows = order[position]
    ids = table["design"]
    other = ids.ne_missing(ids.shift(1)).to_numpy()
    ends = np.flatnonzero(other[1:] | (np.diff(rows) <= 0)) + 1
    for a, b in zip([0, *ends.tolist()], [*ends.tolist(), rows.size], strict=True):
        if a == b:
            continue
        yield TaskResult(
            ids=(ids[a],),
            rows=rows[a:b],
            values=floats[:, None, a:b],
            status=status[None, a:b],
            failed_solves=failed[None, a:b],
            law_seconds=np.zeros(1),
            commands=np.zeros(1, dtype=np.int64),
        )


class SharedRows:
    """Room for d rows of n numbers, as for scores without control, which differ between designs in one window only."""

    def __init__(self, size: int, n: int) -> None:
        self._size = size
        self._row = np.empty(n)
        self._known = np.zeros(n, dtype=np.bool_)
        self._table: FloatArray | None = None

    def put(self, row: int, columns: Any, values: FloatArray) -> None:
        """Set some numbers of a row; `columns` is a slice or an array of int."""
        if self._table is None:
            is_known = self._known[columns]
            # bits: NaN stands for a scenario that cannot be driven
            same = self._row[columns].view(np.int64) == np.ascontiguousarray(values).view(np.int64)
            if (same | ~is_known).all():
                if not is_known.all():
                    self._row[columns] = values
                    self._known[columns] = True
                return
            self._table = np.empty((self._size, self._row.size))
            self._table[:] = self._row
        self._table[row, columns] = values

    def grow(self, size: int) -> None:
        """Make room for more rows."""
        if self._table is not None:
            table = np.empty((size, self._row.size))
            table[: self._size] = self._table
            self._table = table
        self._size = size

    def take(self, rows: IntArray | None) -> FloatArray:
        """Some rows, all by default; a read-only view of one row where there is only one."""
        if self._table is not None:
            return self._table if rows is None else self._table[rows]
        return np.broadcast_to(self._row, (self._size if rows is None else rows.size, self._row.size))


_GROWS: Final = 1.5


class AllFailedError(LdcError):
    """Every design of a study failed: there is nothing to rank."""


def _mapped(shape: tuple[int, ...]) -> FloatArray:
    """Room in a temporary file that is mapped into memory, where the system keeps what it has room for."""
    size = 8 * math.prod(shape)
    try:
        with tempfile.TemporaryFile(prefix="ldc-") as file:
            # a full disk is found now: a page that cannot be written later would end the process
            os.posix_fallocate(file.fileno(), 0, size)
            return np.frombuffer(mmap.mmap(file.fileno(), size), dtype=np.float64).reshape(shape)
    except (OSError, AttributeError):  # no room there, or no such call on this system
        return np.empty(shape)


def release(values: Any) -> None:
    """Give the memory of an array back where its numbers are in a mapped file."""
    while isinstance(values, np.ndarray):
        values = values.base
    mapping = getattr(values, "obj", None)
    if isinstance(mapping, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapping.madvise(mmap.MADV_DONTNEED)


def check_room(study: Study, n: int) -> None:
    """Raise `LdcError` where the table of a study on n scenarios is larger than the memory that is free."""
    designs = study.search.trials if study.search else len(study.designs)
    free = free_memory()
    if (size := designs * n * (8 * (1 + len(METRIC_UNITS) + len(study.metrics)) + 6)) > free:
        what = f"{designs:,} designs on {n:,} scenarios need {size / 2**30:,.1f} GiB of memory"
        raise LdcError(problem=f"{what}, {free / 2**30:,.1f} are free", allowed="fewer designs or scenarios")


class RunTable:
    """Room for the runs of a study, taken once, so that no run is in memory twice."""

    def __init__(
        self, study: Study, n: int, designs: Sequence[Design], *, keep: bool = False, mapped: bool = False
    ) -> None:
        self._study = study
        self.n = n
        self._mapped = mapped
        self._uncorrected = SharedRows(0, n)
        self._row_of: dict[str, int] = {}
        self._waiting: dict[str, list[TaskResult]] | None = {} if keep else None
        self.designs: list[Design] = []
        self._make_room(len(designs))
        self.add_designs(designs)

    def _make_room(self, size: int) -> None:
        shape = (size, self.n)
        before = len(self.designs)
        fresh: dict[str, Any] = {
            "_S": np.empty(shape),
            "_metrics": (_mapped if self._mapped else np.empty)((len(METRIC_UNITS) + len(self._study.metrics), *shape)),
            "_status": np.empty(shape, dtype=np.int8),
            # zeros take no memory until something else is written
            "_failed_solves": np.zeros(shape, dtype=np.int32),
            "_there": np.zeros(shape, dtype=np.bool_),
        }
        for name, array in fresh.items():
            if before:
                array[..., :before, :] = getattr(self, name)[..., :before, :]
            setattr(self, name, array)
        self._uncorrected.grow(size)

    def add_designs(self, designs: Sequence[Design]) -> None:
        """Make room for designs; those that are there already keep theirs."""
        new = [design for design in designs if design.id not in self._row_of]
        if len(self.designs) + len(new) > self._status.shape[0]:
            self._make_room(int(_GROWS * (len(self.designs) + len(new))))
        for design in new:
            self._row_of[design.id] = len(self.designs)
            self.designs.append(design)
            for result in (self._waiting or {}).pop(design.id, ()):
                self.put(result)

    _S: FloatArray
    _metrics: FloatArray
    _status: npt.NDArray[np.int8]
    _failed_solves: npt.NDArray[np.int32]
    _there: BoolArray

    def release(self) -> None:
        """Give back the memory of what is in a file."""
        release(self._metrics)

    def __contains__(self, design: str) -> bool:
        return design in self._row_of

    def has(self, id: str, rows: IntArray) -> bool:
        """Whether a design's results in some scenarios are there."""
        return bool(self._there[self._row_of[id], rows].all())

    def missing(self, id: str) -> int:
        """Number of scenarios for which the results of a design are missing."""
        return self.n - int(np.count_nonzero(self._there[self._row_of[id]]))

    def rows_with(self, id: str, status: EventStatus) -> IntArray:
        """Row numbers of the scenarios that are there and have a status."""
        row = self._row_of[id]
        return np.flatnonzero(self._there[row] & (self._status[row] == status))

    def put(self, result: TaskResult) -> None:
        """Add results; results of designs without room wait until they have it, or are left out."""
        positions = [i for i, id in enumerate(result.ids) if id in self._row_of]
        if self._waiting is not None:
            for i in set(range(len(result.ids))) - set(positions):
                self._waiting.setdefault(result.ids[i], []).append(result.take([i]))
        if len(positions) < len(result.ids):
            result = result.take(positions)
        if not positions:
            return
        columns: Any = result.rows
        if columns[-1] - columns[0] + 1 == columns.size:
            columns = slice(int(columns[0]), int(columns[-1]) + 1)  # a stretch, as nearly always: several times faster
        for i, id in enumerate(result.ids):
            row, values = self._row_of[id], result.values[:, i]
            self._S[row, columns] = values[0]
            self._uncorrected.put(row, columns, values[1])
            self._metrics[:, row, columns] = values[2:]
            self._status[row, columns] = result.status[i]
            if self._there[row, columns].any() or result.failed_solves[i].any():
                self._failed_solves[row, columns] = result.failed_solves[i]
            self._there[row, columns] = True

    def results(
        self,
        scenarios: Scenarios,
        times: Mapping[str, LawTime],
        failures: Mapping[str, str],
        *,
        source: str,
        designs: Sequence[Design] | None = None,
    ) -> StudyResults:
        """Everything of the designs requested; the arrays are this table's, copies only if something is left out."""
        designs = self.designs if designs is None else designs
        rows = np.array([self._row_of[design.id] for design in designs], dtype=np.int64)
        is_complete: BoolArray = np.all(self._there[rows], axis=1)
        missing = [design for design, complete in zip(designs, is_complete, strict=True) if not complete]
        failed = tuple(FailedDesign(design, failures[design.id]) for design in missing if design.id in failures)
        if waiting := len(missing) - len(failed):
            # rounded down: all of it would be no reason to complain
            share = 100 * int(np.count_nonzero(self._there[rows])) // self._there[rows].size
            what = f"{waiting} of {len(rows)} design{'' if len(rows) == 1 else 's'} {'is' if waiting == 1 else 'are'} "
            what += f"not complete ({share} % of the scenario runs are there)"
            raise StoreError(source, what, hint="run the study again")
        if designs and len(failed) == len(designs):
            first = failed[0].sentence
            raise AllFailedError(
                source, "every design failed", hint=f"the first, {first}; all of them are in failures.json"
            )
        ran = tuple(design for design, complete in zip(designs, is_complete, strict=True) if complete)
        rows = rows[is_complete]
        whole = np.array_equal(rows, np.arange(self._status.shape[0]))

        def of_designs(array: Any) -> Any:
            return array if whole else array[rows]

        known = [times.get(design.id) for design in ran]
        simulation = self._study.simulation
        return StudyResults(
            designs=ran,
            scenarios=scenarios,
            window=simulation.window,
            convention=simulation.convention,
            S=of_designs(self._S),
            S_uncorrected=self._uncorrected.take(None if whole else rows),
            status=of_designs(self._status),
            metrics=MetricValues(*(of_designs(values) for values in self._metrics[: len(METRIC_UNITS)])),
            user_rows={metric.name: metric for metric in self._study.metrics},
            user_metrics={
                metric.name: of_designs(values)
                for metric, values in zip(self._study.metrics, self._metrics[len(METRIC_UNITS) :], strict=True)
            },
            failed_solves=of_designs(self._failed_solves),
            law_time=np.array([np.nan if time is None else time.per_command for time in known]),
            failed=failed,
            setup=self._study.setup(),
        )
