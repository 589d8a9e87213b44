"""Runs a study: every design on the same scenarios, in worker processes, stored as it goes."""

from __future__ import annotations

import concurrent.futures
import contextlib
import itertools
import logging
import multiprocessing
import os
import pickle
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Literal

from ldctoolkit import LdcError, Scenarios, controller_class
from ldctoolkit.errors import InputError
from ldctoolkit.scenario_model import ScenarioModel, load_model
from studies.manifest import Manifest
from studies.model_notes import model_notes
from studies.results import StudyResults
from studies.run_table import FailedRun, RunResult, RunTable
from studies.simulate_designs import Block, Job, Simulator, start_worker, work
from studies.spec import Study
from studies.store import Store

_log = logging.getLogger("studies")

_STORE_EVERY = 5.0
"""Seconds between parts: what a kill can cost at most."""

_ROWS_A_PART = 1_000_000
"""Rows after which a part is stored before its time: results that wait are in memory twice."""

_LISTEN_EVERY = 0.2
"""Seconds after which an interrupt is noticed at the latest."""

_PATIENCE = 5.0
"""Seconds that a worker which is told to end has for sending its last result."""

_SCENARIO_RUNS_A_BLOCK = 2000
"""Scenarios times designs in one task: enough to hide the cost of sending it, little enough to spread slow designs."""

StartMethod = Literal["fork", "spawn", "forkserver"]


def run_study(
    study: Study,
    *,
    directory: str | Path,
    model: str | Path | ScenarioModel | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    block_size: int | None = None,
    start_method: StartMethod | None = None,
) -> StudyResults:
    """Run every design of a study on the same scenarios and store the results; resumes where a run was stopped.

    Parameters
    ----------
    study : Study
        What to run.
    directory : path
        Folder of the results; made if need be.
    model : path, str or ScenarioModel, optional
        Use this scenario model instead of the study's.
    workers : int, optional
        Worker processes; all cores by default, 1 runs in this process.
    progress : bool, optional
        Show a progress bar on stderr; by default where that is a terminal.
    block_size : int, optional
        Designs in one task; chosen from the number of scenarios by default. No number depends on it.
    start_method : {"fork", "spawn", "forkserver"}, optional
        How worker processes start; Python's default for the platform. No number depends on it.

    Returns
    -------
    StudyResults
        The same bits for any number of workers, block size and start method. Designs whose law raised, or gave what
        no law may give, are in `StudyResults.failed` with the reason; the others are not touched by it.

    Raises
    ------
    StoreError
        If the folder holds another study, model or seed, or cannot be written.
    ModelError, UnknownNameError
        If the scenario model cannot be used.
    LdcError
        If every design fails; the message names the first and what it raised.

    Examples
    --------
    >>> import tempfile
    >>> from studies import Study, run_study
    >>> study = Study.from_dict({"name": "small", "scenarios": {"left": 5, "right": 5}, "design": [{"law": "none"}]})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> results.cases[0].S.shape
    (1, 10)
    """
    started = time.monotonic()
    count = _positive("workers", workers, os.cpu_count() or 1)
    generator = study_model(study, model)
    wanted = study.scenarios
    scenarios = generator.sample(wanted.left, wanted.right, seed=study.seed, given=wanted.given)
    size = _positive("block_size", block_size, max(1, _SCENARIO_RUNS_A_BLOCK // len(scenarios)))
    fresh = Manifest.of(
        study,
        model=study.scenarios.model if model is None else "in memory" if generator is model else str(model),
        model_hash=generator.content_hash,
        model_notes=model_notes(generator, study.vehicle, study.scenarios.given),
        model_synthetic=generator.provenance.synthetic,
    )
    store = Store.create(Path(directory), fresh, scenarios)
    done = store.load(repair=True)
    for message in store.broken:
        _log.warning(message)

    blocks = _blocks(study, done, size)
    show = sys.stderr.isatty() if progress is None else progress
    complete = False
    try:
        with contextlib.closing(_run(study, scenarios, blocks, min(count, len(blocks)), start_method)) as finished:
            _collect(finished, store, done, sum(len(block.designs) for block in blocks), show)
        complete = True
    finally:
        seconds = time.monotonic() - started
        store.write_manifest(store.manifest.ended(seconds=seconds, workers=count, complete=complete))
    results = done.results(scenarios, store.times, store.failures, source=study.name)
    if results.failed:
        share, first = f"{len(results.failed)} of {len(study.designs)}", results.failed[0].sentence
        _log.warning("failed and not ranked: %s designs; the first, %s", share, first)
    return results


def study_model(study: Study, model: str | Path | ScenarioModel | None = None) -> ScenarioModel:
    """The scenario model of a study: the one given, a bundled one, or a file beside the study file."""
    if isinstance(model, ScenarioModel):
        return model
    if model is not None:
        return load_model(model)
    return load_model(study.model_path if study.model_path.suffix else study.scenarios.model)


def _positive(name: str, value: int | None, default: int) -> int:
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise InputError(f"{name}: {value!r}; allowed: a whole number >= 1")
    return value


def _blocks(study: Study, done: RunTable, size: int) -> list[Block]:
    """What is still to do, designs of one threshold together."""
    blocks = []
    for convention in study.simulation.convention:
        todo = sorted((d for d in study.designs if (d.id, convention) not in done), key=lambda d: d.y_s)
        for _, same in itertools.groupby(todo, key=lambda d: d.y_s):
            designs = list(same)
            blocks += [Block(convention, tuple(designs[i : i + size])) for i in range(0, len(designs), size)]
    return blocks


def _run(
    study: Study, scenarios: Scenarios, blocks: Sequence[Block], workers: int, start_method: StartMethod | None
) -> Generator[list[RunResult | FailedRun], None, None]:
    job = Job(
        scenarios=scenarios,
        vehicle=study.vehicle,
        dt=study.simulation.dt,
        windows=study.simulation.window,
        initial_yaw_rate=study.simulation.initial_yaw_rate,
        options=study.plant,
        settle=study.simulation.settle,
        seed=study.seed,
    )
    if workers <= 1:
        simulator = Simulator(job)
        return (simulator.run(block) for block in blocks)
    return _run_in_processes(job, blocks, workers, start_method)


def _run_in_processes(
    job: Job, blocks: Sequence[Block], workers: int, start_method: StartMethod | None
) -> Generator[list[RunResult | FailedRun], None, None]:
    context = multiprocessing.get_context(start_method)
    kinds = tuple(controller_class(law) for law in sorted({d.law for block in blocks for d in block.designs}))
    if context.get_start_method() != "fork":
        _check_importable(kinds)
    children = set(multiprocessing.active_children())
    with _single_threaded_blas():
        pool = concurrent.futures.ProcessPoolExecutor(
            workers, mp_context=context, initializer=start_worker, initargs=(job, kinds)
        )
        try:
            pending = {pool.submit(work, block) for block in blocks}
            while pending:
                # never an endless wait: polars installs a signal handler that restarts system calls, so that an
                # interrupt is seen only once Python code runs again
                finished, pending = concurrent.futures.wait(pending, _LISTEN_EVERY, concurrent.futures.FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
            pool.shutdown()
        except BrokenProcessPool:
            raise LdcError(
                "a worker process ended abruptly (out of memory, or killed); what was finished is stored: "
                "run the study again to go on, with fewer workers if memory was short"
            ) from None
        finally:
            # after an error or an interrupt nothing waits for designs that nobody will read; but for the pool's own
            # thread, which else would still be at work while Python ends
            running = set(multiprocessing.active_children()) - children
            for process in running:
                process.terminate()
            for process in running:
                process.join(_PATIENCE)
                process.kill()  # one that sends to a pool that reads no more; nothing for those that have ended
            pool.shutdown(wait=True, cancel_futures=True)


def _check_importable(kinds: Sequence[type]) -> None:
    for kind in kinds:
        try:
            pickle.dumps(kind)
        except (pickle.PicklingError, AttributeError) as error:
            raise LdcError(
                f"controller {kind.__name__} cannot be sent to worker processes ({error}); "
                "define it at the top of a module, or use workers=1"
            ) from None


@contextlib.contextmanager
def _single_threaded_blas() -> Iterator[None]:
    """Processes that start meanwhile use one BLAS thread each: the designs are what runs in parallel."""
    names = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _collect(
    finished: Iterator[list[RunResult | FailedRun]], store: Store, done: RunTable, total: int, show: bool
) -> None:
    """Store runs as they come, a part every few seconds; whatever happens, what is finished is stored."""
    waiting: list[RunResult | FailedRun] = []
    stored = time.monotonic()
    try:
        with _progress_bar(total, show) as advance:
            for ended in finished:
                waiting += ended
                for run in ended:
                    if isinstance(run, RunResult):
                        done.put(run)
                advance(len(ended))
                rows = sum(run.status.size for run in waiting if isinstance(run, RunResult))
                if rows > _ROWS_A_PART or time.monotonic() - stored > _STORE_EVERY:
                    store.add(waiting)
                    waiting, stored = [], time.monotonic()
    finally:
        store.add(waiting)


@contextlib.contextmanager
def _progress_bar(total: int, show: bool) -> Iterator[Callable[[int], None]]:
    if not show or not total:
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("designs"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("designs", total=total)
        yield lambda count: bar.advance(task, count)
