"""What a study leaves in its folder.

::

    DIR/manifest.json            what was asked for, with which versions, on which machine
    DIR/scenarios.parquet        the scenarios that every design was run on
    DIR/results/part-*.parquet   per-scenario results of some designs, one row a scenario
    DIR/failures.json            designs whose law failed, and why; not there if none did
    DIR/timing.json              how long the laws took; the one file that a second run does not give again

Guarantees. Every file is written whole or not at all. Parts are only ever added; a part's name follows from the runs it
holds, so that writing the same runs again gives the same file. A run is a design under one convention, identified by
the design's content. What a killed study had stored survives it, and the next run into the same folder computes only
what is missing; a design that failed is missing, and so is tried again. A folder that holds another study, model, seed
or toolkit version is refused. Absolute paths, the host and the user are not recorded, unless a law's own error message
names them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.errors import StoreError
from ldctoolkit.metrics import COMPANION_COLUMNS, Companions
from ldctoolkit.simulation import Window
from studies.failures import FAILURES, read_failures, write_failures
from studies.files import read_parquet, read_scenarios, scenario_table, write_parquet
from studies.manifest import Manifest, read_manifest, refuse_other, write_manifest
from studies.results import StudyResults
from studies.run_table import FailedRun, LawTime, RunKey, RunResult, RunTable
from studies.timing import FILE_NAME, read_times, write_times

if TYPE_CHECKING:
    import polars as pl

_ENDLESS = "t_back"
"""The companion that may be infinite: the edge is not back inside by the end."""


class Store:
    """The folder of one study. Made with `create` or `open`.

    Attributes
    ----------
    folder : Path
    manifest : Manifest
    broken : tuple of str
        Messages about files that could not be read when the folder was opened for writing; they were removed.
    times : dict of RunKey to LawTime
        How long the laws of stored runs took, as far as it is known.
    failures : dict of RunKey to str
        Why runs failed that are not stored.
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.folder = folder
        self.manifest = manifest
        self.broken: tuple[str, ...] = ()
        self.times: dict[RunKey, LawTime] = {}
        self.failures: dict[RunKey, str] = {}
        self._study = manifest.read_study()
        self._windows: tuple[Window, ...] = self._study.simulation.window

    @classmethod
    def create(cls, folder: Path, manifest: Manifest, scenarios: Scenarios) -> Store:
        """Start a folder, or resume the same study in it.

        Raises
        ------
        StoreError
            If the folder holds something else; the message says what differs.
        """
        path = folder / "manifest.json"
        if path.exists():
            found = read_manifest(folder)
            refuse_other(folder, found, manifest)
            manifest = found.resumed(manifest)
        elif folder.exists() and (not folder.is_dir() or (folder / "results").exists()):
            raise StoreError(f"{folder}: exists and is not the folder of a study (no manifest.json); choose another")
        try:
            (folder / "results").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{folder}: cannot be made: {error.strerror or error}") from None
        store = cls(folder, manifest)
        # the scenarios follow from model and seed, which are the same: writing them again cannot change them
        write_parquet(folder / "scenarios.parquet", scenario_table(scenarios))
        store.write_manifest(manifest)
        return store

    @classmethod
    def open(cls, folder: str | Path) -> Store:
        """Open the folder of a study that was run.

        Raises
        ------
        StoreError
            If there is none.
        """
        return cls(Path(folder), read_manifest(folder))

    def write_manifest(self, manifest: Manifest) -> None:
        """Replace the manifest."""
        write_manifest(self.folder, manifest)
        self.manifest = manifest

    def add(self, ended: Sequence[RunResult | FailedRun]) -> None:
        """Store finished runs as one part, the times of their laws, and why others failed."""
        runs = [run for run in ended if isinstance(run, RunResult)]
        if runs:
            keys = hashlib.sha256(json.dumps([run.key for run in runs]).encode()).hexdigest()[:16]
            write_parquet(self.folder / "results" / f"part-{keys}.parquet", self._table(runs))
            self.times |= {run.key: run.law_time for run in runs if run.law_time is not None}
            write_times(self.folder, self.times)
        failures = self.failures | {run.key: run.reason for run in ended if isinstance(run, FailedRun)}
        for run in runs:
            failures.pop(run.key, None)  # it failed in an earlier run
        if failures != self.failures:
            write_failures(self.folder, failures)
            self.failures = failures

    def load(self, *, repair: bool = False) -> RunTable:
        """All stored runs; their times are in `times`, and runs that failed in `failures`, afterwards.

        Parameters
        ----------
        repair : bool
            Remove files that are broken and remember them in `broken`, instead of raising.

        Raises
        ------
        StoreError
            Naming the first file that is broken.
        """
        n = self._study.scenarios.left + self._study.scenarios.right
        table = RunTable(self._study, n)
        messages = []
        for path in sorted((self.folder / "results").glob("part-*.parquet")):
            try:
                for run in self._runs(path, n):
                    table.put(run)
            except StoreError as error:
                if not repair:
                    raise StoreError(f"{error}; run the study into this folder again to compute it anew") from None
                messages.append(f"{error}; its results are computed anew")
                path.unlink()
        for read, name in ((self._read_times, FILE_NAME), (self._read_failures, FAILURES)):
            try:
                read()
            except StoreError as error:
                if not repair:
                    raise
                messages.append(str(error))
                (self.folder / name).unlink()
        self.broken = tuple(messages)
        return table

    def _read_times(self) -> None:
        self.times = read_times(self.folder)

    def _read_failures(self) -> None:
        self.failures = read_failures(self.folder)

    def results(self) -> StudyResults:
        """Everything in memory.

        Raises
        ------
        StoreError
            If something is missing or broken.
        """
        scenarios = read_scenarios(self.folder / "scenarios.parquet")
        return self.load().results(scenarios, self.times, self.failures, source=str(self.folder))

    def _schema(self) -> dict[str, Any]:
        import polars as pl

        scores = [f"{name}_{window}_m_s" for window in self._windows for name in ("S", "S_uncorrected")]
        return {
            "design": pl.String(),
            "convention": pl.String(),
            "scenario": pl.UInt32(),
            **dict.fromkeys(scores, pl.Float64()),
            "status": pl.Int8(),
            **dict.fromkeys(COMPANION_COLUMNS.values(), pl.Float32()),
            "failed_solves": pl.Int32(),
        }

    def _table(self, runs: Sequence[RunResult]) -> pl.DataFrame:
        import polars as pl

        count = runs[0].status.size
        # names are repeated by the library: a million strings of Python would take longer than the simulation
        names = pl.DataFrame([run.key for run in runs], schema=["design", "convention"], orient="row")
        repeated = names.select(pl.all().repeat_by(count).list.explode())
        columns: dict[str, Any] = {"scenario": np.tile(np.arange(count, dtype=np.uint32), len(runs))}
        for w, window in enumerate(self._windows):
            columns[f"S_{window}_m_s"] = np.concatenate([run.S[w] for run in runs])
            columns[f"S_uncorrected_{window}_m_s"] = np.concatenate([run.S_uncorrected[w] for run in runs])
        columns["status"] = np.concatenate([run.status for run in runs])
        for name, column in COMPANION_COLUMNS.items():
            columns[column] = np.concatenate([getattr(run.companions, name) for run in runs])
        columns["failed_solves"] = np.concatenate([run.failed_solves for run in runs])
        schema = self._schema()
        numbers = pl.DataFrame(columns, schema={name: schema[name] for name in columns})
        return pl.concat([repeated, numbers], how="horizontal")

    def _runs(self, path: Path, n: int) -> Iterable[RunResult]:
        table = read_parquet(path, self._schema(), finite=False)
        if table.height % n or not np.array_equal(table["scenario"].to_numpy() % n, np.arange(table.height) % n):
            raise StoreError(f"{path}: broken: {table.height} rows; needed: {n} a run, one a scenario")
        columns = {name: table[name].to_numpy().reshape(-1, n) for name in table.columns[2:]}
        for name in self._not_numbers(columns):
            raise StoreError(f"{path}: broken: column {name} holds a value that is not finite")
        keys = table.select("design", "convention")
        runs = []
        for i in range(table.height // n):
            block = keys[i * n : (i + 1) * n]
            if block.n_unique() != 1:
                raise StoreError(f"{path}: broken: the rows of one run name several designs")
            runs.append(
                RunResult(
                    key=block.row(0),
                    S=np.stack([columns[f"S_{window}_m_s"][i] for window in self._windows]),
                    S_uncorrected=np.stack([columns[f"S_uncorrected_{window}_m_s"][i] for window in self._windows]),
                    status=columns["status"][i],
                    companions=Companions(**{name: columns[column][i] for name, column in COMPANION_COLUMNS.items()}),
                    failed_solves=columns["failed_solves"][i],
                )
            )
        return runs

    def _not_numbers(self, columns: dict[str, Any]) -> Iterator[str]:
        """Columns that hold what is no number in a scenario that was driven."""
        driven = columns["status"] != EventStatus.INVALID
        for name, values in columns.items():
            if values.dtype.kind == "f":
                bad = np.isnan(values) if name == COMPANION_COLUMNS[_ENDLESS] else ~np.isfinite(values)
                if (bad & driven).any():
                    yield name


def read_results(folder: str | Path) -> StudyResults:
    """Read the results of a finished study.

    Parameters
    ----------
    folder : path
        What `run_study` wrote into.

    Returns
    -------
    StudyResults

    Raises
    ------
    StoreError
        If the folder holds no study, or something in it is missing or broken.
    """
    return Store.open(folder).results()
