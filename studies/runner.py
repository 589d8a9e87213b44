"""Runs a study: plans its designs, fills its store, scores the finalists again; resumes where a run was stopped."""

import contextlib
import dataclasses
import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.declared import checked_number, checked_whole
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import InputError, LdcError, StoreError, expect
from ldctoolkit.scenario_model import ScenarioModel, load_model
from ldctoolkit.scenario_model.refit import FEWEST, REFITS
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.surroundings import temporary_folder

from .design import FOLLOWS_STUDY, Design
from .design_space import THRESHOLD, next_value
from .measures import measured
from .ranking.design_metrics import find_baseline
from .ranking.ranking import Ranking, rank_study
from .ranking.verdict import sweep_ends
from .results import StudyResults
from .running.campaign import Campaign
from .running.dispatch import Executor, Progress, closing, displayed
from .running.executors import make_executor
from .running.refits import scores_of_refits
from .search import run_search
from .storage.checked_parts import locked, remove_unfinished
from .storage.manifest import Manifest, read_manifest, write_designs
from .storage.run_table import AllFailedError, check_room
from .storage.scenario_source import (
    ReplayedDepartures,
    Source,
    model_notes,
    model_warnings,
    read_replayed,
    with_counts,
    with_recorded_widths,
    write_model,
)
from .storage.store import FINALISTS, REFITS_FILE, REPLAYED, SCORES, Store, make_folder
from .study_file import Study
from .text import compact

_log = logging.getLogger("studies")

EXTEND: Final = 6  # values beyond the end of a sweep where it is requested, and the study says no number
TIME_LIMIT = 600.0  # seconds that a task may take: a thousand times what it is made for
_LIMITS = (0.1, 1e7)  # seconds that a limit may be
_STREAM: Final = 0x66696E61  # keeps the finalists' scenarios apart from those that they were chosen on

_LEAST: Final = 3
"""Finalists, where there are so many designs: a single one would show its own optimism, and nothing of its rivals."""


def run_study(
    study: Study,
    directory: str | Path | None = None,
    *,
    model: str | Path | Source | None = None,
    scenarios: Scenarios | None = None,
    workers: int | None = None,
    executor: Literal["serial", "processes", "dask"] | None = None,
    dask: str | None = None,
    progress: bool | Progress | None = None,
    block_size: int | None = None,
    time_limit: float = TIME_LIMIT,
    refits: int = REFITS,
    extend: bool | None = None,
) -> StudyResults:
    """Run every design of a study on the same scenarios and store the results; resumes where a run was stopped.

    Raises `StoreError` if the folder holds another study's results, model or seed, is in use, or cannot be written;
    `ModelError` or `UnknownNameError` if the scenario model cannot be used; `InputError` for arguments outside what is
    allowed; `LdcError` if every design fails, the message names the first and what it raised; if workers or a cluster
    cannot be used.

    Parameters
    ----------
    study : Study
        What to run.
    directory : path, optional
        Folder of the results; made if need be. Without one the results are in memory only.
    model : path, str or ScenarioModel, optional
        Use this scenario model instead of the study's. Where a study replays a table, the vehicle and the lane have the
        widths that its departures were found with, unless the study chooses others.
    scenarios : Scenarios, optional
        Departures to run on, instead of a model or table. The results have the left ones first; their ``index``, and
        the column ``scenario`` of a data frame, is the row here.
    workers : int, optional
        Worker processes; all cores by default, 1 runs in this process.
    executor : {"serial", "processes", "dask"}, optional
        Where designs run: in this process, in processes of this machine (the default), or on a Dask cluster.
    dask : str, optional
        Address of a Dask scheduler, or ``"local"`` for a cluster on this machine.
    progress : bool or Progress, optional
        Show a progress bar on stderr; by default where that is a terminal.
    block_size : int, optional
        Designs in one task; chosen from the law's pace by default. No number depends on it.
    time_limit : float [s]
        A task that takes longer ends its worker, and the scenario at fault is found; 0 for no limit. Not in this
        process, which could not go on.
    refits : int
        Models refitted to resampled clusters of the recorded departures, on which winner and baseline are driven too,
        for the interval of the recordings; at least 5, 0 for none.
    extend : bool, optional
        Whether to add designs beyond the end of a sweep while the winner lies there: `ranking.extend` values at most,
        or 6 if the study has 0; as the study says by default. The study in the folder is the one with these designs.

    Returns
    -------
    StudyResults
        The same bits for any executor, number of workers and block size. Designs whose law raised, or gave what no
        law may give, are in `StudyResults.failed` with the reason; the others are not touched by it.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> results = ldc.run_study(ldc.study(ldc.NoControl, left=5, right=5), workers=1)
    >>> results.S.shape
    (1, 10)
    """
    expect("study", study, Study)
    expect("scenarios", scenarios, Scenarios | None)
    expect("extend", extend, bool | None)
    block_size = None if block_size is None else checked_whole("block_size", block_size, lower=1)
    refits = checked_whole("refits", refits, lower=0, upper=1000)
    if 0 < refits < FEWEST:
        raise InputError("refits", value=refits, allowed=f"0, or {FEWEST} and more")
    if time_limit is False or time_limit != 0:
        least, most = _LIMITS
        checked_number("time_limit", time_limit, lower=least, upper=most, unit="s (0 for none)")
    if directory is None:
        with temporary_folder() as folder:
            return run_study(
                study, folder, model=model, scenarios=scenarios, workers=workers, executor=executor, dask=dask,
                progress=progress, block_size=block_size, time_limit=time_limit, refits=refits, extend=extend,
            )  # fmt: skip
    if scenarios is not None:
        if model is not None:
            raise InputError("model, scenarios", "both are given", allowed="one of them")
        left = int((scenarios.side == LEFT).sum())
        model = ReplayedDepartures("given", dataclasses.replace(scenarios, index=np.arange(scenarios.n)))
        study = study.changed(scenarios={"left": left, "right": scenarios.n - left})
    if extend is not None:
        study = study.changed(ranking={"extend": (study.ranking.extend or EXTEND) if extend else 0})
    if study.laws():
        study = study.changed()  # its designs are those of the code as it is now
    source = study_source(study, model)
    if model is None and isinstance(source, ReplayedDepartures):
        study = with_recorded_widths(study, source)
    study = with_counts(study, source)
    named = study.scenarios.model if model is None else "in memory" if source is model else str(model)
    if isinstance(source, ReplayedDepartures):
        named = source.name
    runs_on = make_executor(executor, workers, dask)
    with displayed(progress) as shown, closing(runs_on):
        results = _Run(source, named, runs_on, shown, time_limit, block_size).whole(study, Path(directory), refits)
    if results.failed:
        share, first = f"{len(results.failed)} of {len(results.failed) + len(results.designs)}", results.failed[0]
        _log.warning("failed and not ranked: %s designs; the first, %s", share, first.sentence)
    if results.fresh is not None and results.fresh.failed:
        count, first = len(results.fresh.failed), results.fresh.failed[0]
        _log.warning("failed on fresh scenarios: %s of the finalists; the first, %s", count, first.sentence)
    return results


def study_source(study: Study, model: str | Path | Source | None = None) -> Source:
    """What the scenarios of a study come from: the model given, a bundled one, a file beside the study, or a table."""
    if isinstance(model, Source):
        return model
    if model is not None:
        return load_model(model)
    if not study.scenarios.model:
        return read_replayed(study)
    return load_model(study.model_path if study.model_path.suffix else study.scenarios.model)


@dataclasses.dataclass(frozen=True)
class _Run:
    """What the stages of one run share."""

    source: Source
    name: str
    executor: Executor
    progress: Progress
    time_limit: float
    block_size: int | None

    def whole(self, study: Study, folder: Path, refits: int) -> StudyResults:
        """All stages; once more, with what was added, while the winner lies at the end of a sweep that may go on."""
        check_room(study, sum(study.scenarios.counts))  # before anything is made
        make_folder(folder)
        with locked(folder):
            extension = _extension_in(folder, study)
            first = study.with_content(study.content() | {"design": extension["extended_from"]})
            results = self.stages(study, folder, extension)
            while study.ranking.extend:
                study, more = extended(study, rank_study(results, study), first)
                if not more:
                    break
                self.progress.phase(f"beyond the ends of sweeps: {'; '.join(more)}")
                extension["extended"] += more
                results = self.stages(study, folder, extension)
            if not refits:
                (folder / REFITS_FILE).unlink(missing_ok=True)
            if not refits or not isinstance(self.source, ScenarioModel) or not results.drivable.any():
                return results
            designs: list[Design] = []
            if self.source.provenance.recorded is not None:
                self.progress.phase("choosing the winner")
                ranking = rank_study(results, study)
                positions = dict.fromkeys(i for i in (ranking.winner, ranking.baseline) if i is not None)
                designs = [ranking.designs[i] for i in positions]
                if ranking.winner is None or not set(results.unsafe).isdisjoint(designs):
                    return results
            scores = scores_of_refits(
                study, designs, self.source, folder, self.executor, self.progress, refits=refits,
                time_limit=self.time_limit,
            )  # fmt: skip
            return dataclasses.replace(results, refits=scores)

    def stages(self, study: Study, folder: Path, extension: Mapping[str, Any]) -> StudyResults:
        """The study itself, and its finalists on fresh scenarios."""
        results = self.study(study, folder, extension=extension)
        if not study.ranking.finalists or len(results.designs) < 2 or isinstance(self.source, ReplayedDepartures):
            return results
        self.progress.phase("choosing the finalists")
        best = _finalists(rank_study(results, study), study.ranking.finalists)
        if not best:
            return results  # nothing meets the requirements
        reference = find_baseline(study.ranking.baseline, results)
        if reference is not None and results.designs[reference] not in best:
            best = (*best, results.designs[reference])  # so that the gain is known there too
        again = _finalist_study(study, best)
        results = dataclasses.replace(results, fresh=self.again(study, again, folder / FINALISTS))
        if not study.scenarios.replayed:
            return results
        table = read_replayed(study)
        again = again.changed(scenarios={"model": "", "left": None, "right": None})
        run = dataclasses.replace(self, source=table, name=table.name)
        return dataclasses.replace(results, replayed=run.again(study, with_counts(again, table), folder / REPLAYED))

    def again(self, study: Study, again: Study, folder: Path) -> StudyResults | None:
        """The finalists on other scenarios; None if all of them fail there."""
        make_folder(folder)
        try:
            return self.study(again, folder, stage=folder.name, part_of=study.ranked_as)
        except AllFailedError as error:
            _log.warning("no %s: %s", SCORES[folder.name], error)
            return None

    def study(
        self, study: Study, folder: Path, *, stage: str = "designs", part_of: str = "",
        extension: Mapping[str, Any] | None = None,
    ) -> StudyResults:  # fmt: skip
        """One study into one folder."""
        started = time.monotonic()
        source = self.source
        scenarios = source.sample(*study.scenarios.counts, seed=study.seed, given=study.scenarios.given)
        manifest = Manifest.of(
            study,
            model=self.name,
            model_hash=source.content_hash,
            model_notes=model_notes(source, study.scenarios.given),
            model_warnings=tuple(model_warnings(source, study.vehicle, study.scenarios.given)),
            model_synthetic=isinstance(source, ScenarioModel) and source.provenance.synthetic,
            part_of=part_of,
            **(extension or {}),
        )
        store = Store.create(folder, manifest, scenarios, study)
        # finalists are drawn from the same model; another file may have other recordings behind it
        if not part_of and isinstance(source, ScenarioModel) and not write_model(folder, source):
            (folder / REFITS_FILE).unlink(missing_ok=True)
        for room in (folder, folder / "results"):
            remove_unfinished(room)
        table = store.load(study.designs, repair=True)
        for message in store.broken:
            _log.warning(message)
        campaign = Campaign(
            study,
            scenarios,
            store,
            table,
            self.executor,
            self.progress,
            time_limit=self.time_limit,
            block_size=self.block_size,
        )
        complete = False
        try:
            designs: Sequence[Design] = study.designs
            if study.search is not None:
                designs = run_search(campaign)
            else:
                write_designs(folder, designs)
                campaign.complete(designs, stage)
            results = table.results(scenarios, store.times, store.failures, source=study.name, designs=designs)
            if not part_of:
                self.progress.phase("loop margins, named vehicles and standards")
                results = measured(results, store.measures, study.setup(), study.vehicles, study.standards)
            complete = True
        except AllFailedError:
            complete = True  # nothing is left to be run
            raise
        finally:
            ended = store.manifest.ended(
                seconds=time.monotonic() - started,
                executor=self.executor.name,
                workers=self.executor.workers,
                complete=complete,
            )
            # where the disk is full, why the run ended says more than that this cannot be written either
            with contextlib.suppress(*(() if complete else (StoreError,))):
                store.write_manifest(ended)
        return results


def _finalists(ranking: Ranking, most: int) -> tuple[Design, ...]:
    """The designs in the set of best, best first; at least three and at most `most`; none where nothing is ranked."""
    best = [i for i in range(len(ranking)) if ranking.inference.set_of_best[i]]
    others = [i for i in range(len(ranking)) if not ranking.inference.set_of_best[i] and ranking.rank[i] > 0]
    return tuple(ranking.designs[i] for i in (best + others[: max(0, _LEAST - len(best))])[:most])


def _finalist_study(study: Study, designs: Sequence[Design]) -> Study:
    """The study of some designs on as many fresh scenarios."""
    content = study.content()
    seed = int(np.random.SeedSequence([study.seed, _STREAM]).generate_state(1, np.uint64)[0] >> 1)
    content |= {
        "name": "finalists",
        "title": f"Finalists of {study.title or study.name}",
        "seed": seed,
        "search": None,
        "design": [
            {"law": d.law, "y_s": d.y_s, "gains": {name: v for name, v in d.gains if v != FOLLOWS_STUDY}}
            for d in designs
        ],
    }
    content["ranking"] |= {"finalists": 0, "require": [], "baseline": "", "extend": 0}
    return study.with_content(content)


def _extension_in(folder: Path, study: Study) -> dict[str, Any]:
    """What was added to a study beyond ends of sweeps, and to which tables, as the manifest of its folder has it."""
    tables = study.content()["design"]
    with contextlib.suppress(StoreError):  # none yet
        stored = read_manifest(folder)
        if stored.extended_from and stored.study["design"] == tables:
            return {"extended": stored.extended, "extended_from": stored.extended_from}
    return {"extended": (), "extended_from": tables}


def extended(study: Study, ranking: Ranking, first: Study) -> tuple[Study, tuple[str, ...]]:
    """The study with one more value beyond each end of a list at which the winner lies, and what was added.

    At most `extend` values a list more than the `first` study has, and twice its designs; none that the laws or the
    memory forbid. It follows from study and results alone: a run that is resumed adds the same.
    """
    added: tuple[str, ...] = ()
    if ranking.winner is None:
        return study, added
    winner = ranking.designs[ranking.winner]
    i = next((i for i, block in enumerate(study.design) if not block.sample and winner in block.designs()), None)
    for end in sweep_ends(ranking, ranking.winner) if i is not None else ():
        name, content = end.gain.name, study.content()
        tables = (of["design"][i] for of in (content, first.content()))
        now, before = ((table if name == THRESHOLD else table["gains"]).get(name, []) for table in tables)
        if not 2 <= len(now) < len(before) + study.ranking.extend or end.value not in (min(now), max(now)):
            continue
        if (value := next_value(now, end.gain, upper=end.upper)) is not None:
            now.append(value)
            with contextlib.suppress(LdcError):  # another law of the table allows less
                longer = study.with_content(content)
                check_room(longer, sum(longer.scenarios.counts))
                if len(longer.designs) <= 2 * len(first.designs):
                    study, added = longer, (*added, f"{winner.law}: {name} = {compact(value)}")
    return study, added
