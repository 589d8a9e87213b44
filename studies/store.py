"""What a study leaves in its folder.

::

    DIR/manifest.json            what was asked for, with which versions, on which machine
    DIR/scenarios.parquet        the scenarios that every design was run on
    DIR/results/part-*.parquet   per-scenario results of some designs, one row a scenario

Guarantees. Every file is written whole or not at all. Parts are only ever added; a part's name follows from the runs it
holds, so that writing the same runs again gives the same file. A run is a design under one convention, identified by
the design's content. What a killed study had stored survives it, and the next run into the same folder computes only
what is missing. A folder that holds another study, model, seed or toolkit version is refused. Absolute paths, the host
and the user are not recorded.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.errors import StoreError
from ldctoolkit.simulation import Window
from studies.files import read_parquet, read_scenarios, scenario_table, write_parquet
from studies.manifest import Manifest, read_manifest, refuse_other, write_manifest
from studies.results import CaseResults, StudyResults
from studies.spec import Study

if TYPE_CHECKING:
    import polars as pl

FloatArray = npt.NDArray[np.float64]

RunKey = tuple[str, str]
"""Identifier of a design and a convention: what one simulation is called."""


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
    deepest : (n,) [m]
    failed_solves : (n,) int
    """

    key: RunKey
    S: FloatArray
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]
    deepest: FloatArray
    failed_solves: npt.NDArray[np.int64]


class Store:
    """The folder of one study. Made with `create` or `open`.

    Attributes
    ----------
    folder : Path
    manifest : Manifest
    broken : tuple of str
        Messages about parts that could not be read when the folder was opened for writing; they were removed.
    """

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.folder = folder
        self.manifest = manifest
        self.broken: tuple[str, ...] = ()
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

    def add(self, runs: Sequence[RunResult]) -> None:
        """Store finished runs as one part."""
        if not runs:
            return
        keys = hashlib.sha256(json.dumps([run.key for run in runs]).encode()).hexdigest()[:16]
        write_parquet(self.folder / "results" / f"part-{keys}.parquet", self._table(runs))

    def load(self, *, repair: bool = False) -> dict[RunKey, RunResult]:
        """All stored runs.

        Parameters
        ----------
        repair : bool
            Remove parts that are broken and remember them in `broken`, instead of raising.

        Raises
        ------
        StoreError
            Naming the first part that is broken.
        """
        n = self._study.scenarios.left + self._study.scenarios.right
        runs: dict[RunKey, RunResult] = {}
        messages = []
        for path in sorted((self.folder / "results").glob("part-*.parquet")):
            try:
                for run in self._runs(path, n):
                    runs[run.key] = run
            except StoreError as error:
                if not repair:
                    raise StoreError(f"{error}; run the study into this folder again to compute it anew") from None
                messages.append(f"{error}; its results are computed anew")
                path.unlink()
        self.broken = tuple(messages)
        return runs

    def results(self) -> StudyResults:
        """Everything in memory.

        Raises
        ------
        StoreError
            If something is missing or broken.
        """
        scenarios = read_scenarios(self.folder / "scenarios.parquet")
        return assemble(self._study, scenarios, self.load(), source=str(self.folder))

    def _schema(self) -> dict[str, Any]:
        import polars as pl

        scores = [f"{name}_{window}_m_s" for window in self._windows for name in ("S", "S_uncorrected")]
        return {
            "design": pl.String(),
            "convention": pl.String(),
            "scenario": pl.UInt32(),
            **dict.fromkeys(scores, pl.Float64()),
            "status": pl.Int8(),
            "deepest_m": pl.Float64(),
            "failed_solves": pl.Int64(),
        }

    def _table(self, runs: Sequence[RunResult]) -> pl.DataFrame:
        import polars as pl

        count = runs[0].status.size
        columns: dict[str, Any] = {
            "design": [run.key[0] for run in runs for _ in range(count)],
            "convention": [run.key[1] for run in runs for _ in range(count)],
            "scenario": np.tile(np.arange(count, dtype=np.uint32), len(runs)),
        }
        for w, window in enumerate(self._windows):
            columns[f"S_{window}_m_s"] = np.concatenate([run.S[w] for run in runs])
            columns[f"S_uncorrected_{window}_m_s"] = np.concatenate([run.S_uncorrected[w] for run in runs])
        columns["status"] = np.concatenate([run.status for run in runs])
        columns["deepest_m"] = np.concatenate([run.deepest for run in runs])
        columns["failed_solves"] = np.concatenate([run.failed_solves for run in runs])
        return pl.DataFrame(columns, schema=self._schema())

    def _runs(self, path: Path, n: int) -> Iterable[RunResult]:
        table = read_parquet(path, self._schema())
        if table.height % n or not np.array_equal(table["scenario"].to_numpy() % n, np.arange(table.height) % n):
            raise StoreError(f"{path}: broken: {table.height} rows; needed: {n} a run, one a scenario")
        columns = {name: table[name].to_numpy().reshape(-1, n) for name in table.columns[2:]}
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
                    deepest=columns["deepest_m"][i],
                    failed_solves=columns["failed_solves"][i],
                )
            )
        return runs


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


def assemble(study: Study, scenarios: Scenarios, runs: dict[RunKey, RunResult], *, source: str) -> StudyResults:
    """Put stored runs into the study's own order.

    Raises
    ------
    StoreError
        If runs are missing.
    """
    wanted = [(design.id, convention) for convention in study.simulation.convention for design in study.designs]
    missing = [key for key in wanted if key not in runs]
    if missing:
        raise StoreError(f"{source}: {len(missing)} of {len(wanted)} runs are not there yet; run the study again")

    cases = []
    for each in study.cases:
        w = study.simulation.window.index(each.window)
        chosen = [runs[design.id, each.convention] for design in study.designs]
        cases.append(
            CaseResults(
                case=each,
                S=np.stack([run.S[w] for run in chosen]),
                S_uncorrected=np.stack([run.S_uncorrected[w] for run in chosen]),
                status=np.stack([run.status for run in chosen]),
                deepest=np.stack([run.deepest for run in chosen]),
                failed_solves=np.stack([run.failed_solves for run in chosen]),
            )
        )
    return StudyResults(designs=study.designs, scenarios=scenarios, cases=tuple(cases))
