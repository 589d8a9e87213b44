"""What a study leaves in its folder: see "What a study leaves" in ``docs/reference/study-file.md`` for its files.

Every file is written whole or not at all, and holds a checksum that is checked when it is read. Parts of results are
only ever added; writing the same runs again gives the same file. A run is identified by its design's content, which the
code of its law belongs to. The next run into a folder computes only what is missing, also after a kill. A folder that
holds another model, seed, vehicle or plant is refused; designs and scenarios may be added and left out. Absolute paths,
the host and the user are not recorded, unless a law's own error message names them.
"""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ldctoolkit.errors import LdcError, StoreError
from ldctoolkit.scenarios import Scenarios

from ..design import Design
from ..results import FailedRun, RefitScores, StudyResults, TaskResult
from ..study_file import Study
from .checked_parts import read_part
from .folder_files import SCENARIOS, output_folder, read_fields, read_scenarios, write_scenarios
from .manifest import (
    DESIGNS,
    FAILURES,
    TIMING_FILE,
    LawTime,
    Manifest,
    read_designs,
    read_failures,
    read_manifest,
    read_times,
    refuse_other,
    write_failures,
    write_manifest,
    write_times,
)
from .measure_table import MEASURES, MeasureTable
from .run_table import PATTERN, AllFailedError, RunTable, parse_part, prefetched, write_results

_log = logging.getLogger("studies")

REFITS_FILE = "refits.json"
ROBUSTNESS = "robustness.json"
FINALISTS = "finalists"
REPLAYED = "replayed"
SCORES = {FINALISTS: "fresh scores", REPLAYED: "scores on the replayed departures"}

_MOST_IN_MEMORY = 5_000_000  # runs whose metrics are kept in memory when a study is read (480 MB)


def make_folder(folder: Path) -> None:
    """Make the folder of a study, if it is not there."""
    strange = folder.exists() and not (folder / "manifest.json").exists()
    if strange and (not folder.is_dir() or any((folder / "results").glob("*"))):
        raise StoreError(folder, "exists, but is not the folder of a study", hint="choose another folder")
    output_folder(folder)
    output_folder(folder / "results")


def _clear(folder: Path, *patterns: str) -> None:
    """Remove files that belong to another run. Its manifest stays until it is replaced: a run that is killed here ends
    with a folder of that run, and the next one clears the rest.
    """
    try:
        for path in (path for pattern in patterns for path in folder.glob(pattern)):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(folder, f"cannot be cleared: {error.strerror or error}") from None


class Store:
    """The folder of one study. Made with `create` or `open`."""

    def __init__(self, folder: Path, manifest: Manifest, study: Study) -> None:
        self.folder = folder
        self.manifest = manifest
        self.study = study
        self.broken: tuple[str, ...] = ()
        self.times: dict[str, LawTime] = {}
        self.failures: dict[str, str] = {}
        self.measures = MeasureTable(folder)

    @classmethod
    def create(cls, folder: Path, manifest: Manifest, scenarios: Scenarios, study: Study) -> Store:
        """Start a folder of `make_folder`, or resume the same study in it."""
        if (folder / "manifest.json").exists():
            former = read_manifest(folder)
            refuse_other(folder, former, manifest)
            notices = [
                f"the code of law {name!r} has changed since the last run: its designs are run again"
                for name, content in manifest.laws.items()
                if former.laws.get(name, content) != content
            ]
            codes = {metric["name"]: metric["code"] for metric in former.study.get("metrics", ())}
            notices += [
                f"the code of metric {metric.name!r} has changed since the last run: all designs are run again"
                for metric in study.metrics
                if codes.get(metric.name, metric.code) != metric.code
            ]
            name = study.vehicle_model
            was, now = (m.vehicle_models.get(name, ("", ""))[1] for m in (former, manifest))
            if (others := former.other_versions()) or was != now:
                what = f"was made with {others}" if others else "the vehicle model has changed since the last run"
                notices = [f"{what}; everything is computed anew"]
                _clear(folder, DESIGNS, FAILURES, TIMING_FILE, MEASURES, REFITS_FILE, ROBUSTNESS, f"results/{PATTERN}")
            else:
                # their steering ratios differ, which decide no run, but scores in standards
                if former.study["vehicle"] != manifest.study["vehicle"]:
                    _clear(folder, MEASURES)
                manifest = former.resumed(manifest)
            for notice in notices if not manifest.part_of else ():
                _log.warning("%s: %s", folder, notice)
        store = cls(folder, manifest, study)
        store.scenarios = scenarios
        # the scenarios follow from model and seed, which are the same: those that were there do not change
        write_scenarios(folder, scenarios)
        store.write_manifest(manifest)
        return store

    @classmethod
    def open(cls, folder: str | Path, *, current: bool = True) -> Store:
        """Open the folder of a study that was run; its code is the present one, unless only numbers are read."""
        manifest, folder = read_manifest(folder), Path(folder)
        try:
            study = manifest.read_study(current=current)
        except LdcError as error:
            raise StoreError.of(error.within(str(folder / "manifest.json"), ": ")) from None
        if current and (others := manifest.other_versions()):
            _log.warning("%s: was run with %s; its numbers are read as they are", folder, others)
        return cls(folder, manifest, study)

    @functools.cached_property
    def scenarios(self) -> Scenarios:
        """The scenarios that every design was run on."""
        return read_scenarios(self.folder / SCENARIOS)

    def write_manifest(self, manifest: Manifest) -> None:
        """Replace the manifest."""
        write_manifest(self.folder, manifest)
        self.manifest = manifest

    def add(self, results: Sequence[TaskResult], failed: Sequence[FailedRun] = ()) -> None:
        """Store finished runs as one part, the times of their laws, and why others failed."""
        if results:
            window, metrics = self.study.simulation.window, self.study.metrics
            write_results(self.folder / "results", results, window, self.scenarios.index, metrics)
            for result in results:
                for id, seconds, commands in zip(result.ids, result.law_seconds, result.commands, strict=True):
                    self.times[id] = self.times.get(id, LawTime(0.0, 0)) + LawTime(float(seconds), int(commands))
            write_times(self.folder, self.times)
        if failed:
            self.write_failures(self.failures | {run.id: run.reason for run in failed})

    def write_failures(self, failures: dict[str, str]) -> None:
        """Replace what is known of failed runs."""
        if failures != self.failures:
            write_failures(self.folder, failures)
            self.failures = failures

    def load(self, designs: Sequence[Design] | None = None, *, repair: bool = False) -> RunTable:
        """All stored runs; their times are in `times`, and runs that failed in `failures`, afterwards."""
        n = self.scenarios.n
        designs = self.designs() if designs is None else designs
        mapped = not repair and len(designs) * n > _MOST_IN_MEMORY
        table = RunTable(self.study, n, designs, keep=repair and self.study.search is not None, mapped=mapped)
        messages = []
        for path, content in prefetched(read_part, sorted((self.folder / "results").glob(PATTERN))):
            try:
                window, numbers = self.study.simulation.window, self.scenarios.index
                for result in list(parse_part(path, content.result(), window, numbers, self.study.metrics)):
                    table.put(result)
                table.release()
            except StoreError as error:
                if not repair:
                    raise error.hinted("run the study into this folder again to compute it anew") from None
                messages.append(f"{error}; its results are computed anew")
                path.unlink()
        files: tuple[tuple[str, Callable[[Path], Any], str], ...] = (
            ("times", read_times, TIMING_FILE), ("failures", read_failures, FAILURES),
            ("measures", MeasureTable.read, MEASURES),
        )  # fmt: skip
        for attribute, read, name in files:
            try:
                setattr(self, attribute, read(self.folder))
            except StoreError as error:
                if not repair:
                    raise
                messages.append(str(error))
                (self.folder / name).unlink()
        self.broken = tuple(messages)
        return table

    def designs(self) -> tuple[Design, ...]:
        """The designs of the last run: those of the study, or those that its search requested."""
        return read_designs(self.folder / DESIGNS)

    def known_designs(self) -> tuple[Design, ...]:
        """The designs that an earlier run wrote down; none where that cannot be read."""
        try:
            return read_designs(self.folder / DESIGNS)
        except StoreError:
            return ()

    def results(self) -> StudyResults:
        """Everything in memory: all designs that were run to the end, with the finalists' other results."""
        designs = self.designs()
        if self.study.search is not None and not self.manifest.finished:
            raise StoreError(self.folder, "its search is not over yet", hint="run the study again")
        table = self.load(designs)
        results = table.results(self.scenarios, self.times, self.failures, source=str(self.folder))
        measures = self.measures.of(results.designs)
        if "gain_margin" not in measures and not self.manifest.part_of:
            _log.warning("%s: no loop margins of these designs yet; run the study again to have them", self.folder)
        fresh, replayed = (self._again(name, results) for name in (FINALISTS, REPLAYED))
        known = self.manifest.ranked_as, self.manifest.model_hash
        refits = None if self.manifest.part_of else read_refits(self.folder, *known)
        return dataclasses.replace(results, measures=measures, fresh=fresh, replayed=replayed, refits=refits)

    def _again(self, name: str, results: StudyResults) -> StudyResults | None:
        """The finalists on other scenarios; None where there are none, or not all yet, or of other results."""
        folder = self.folder / name
        if not self.study.ranking.finalists or len(results.designs) < 2 or not (folder / "manifest.json").exists():
            return None
        store = Store.open(folder, current=False)  # the same code and versions as here, or it is not taken
        identity = (store.manifest.part_of, store.manifest.versions)
        if not store.manifest.finished or identity != (self.manifest.ranked_as, self.manifest.versions):
            _log.warning("%s: no %s of this ranking yet; run the study again to have them", self.folder, SCORES[name])
            return None
        try:
            again = store.results()
        except AllFailedError:
            return None
        # a design that failed in this run and not in an earlier one
        return again if {design.id for design in again.designs} <= {design.id for design in results.designs} else None


def read_refits(folder: Path, *key: str) -> RefitScores | None:
    """What a folder holds of refits, whose key begins so; None where there is nothing."""
    stored = read_fields(folder / REFITS_FILE, RefitScores)
    return stored if stored is not None and stored.key[: len(key)] == key else None


def read_results(folder: str | Path) -> StudyResults:
    """Read the results of a finished study.

    Raises `StoreError` if the folder holds no study, or something in it is missing or broken.

    Parameters
    ----------
    folder : path
        What `run_study` wrote into.

    Examples
    --------
    >>> import tempfile
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = ldc.run_study(study, directory=folder, workers=1)
    ...     again = ldc.read_results(folder)
    >>> again.designs == results.designs
    True
    """
    return Store.open(folder).results()
