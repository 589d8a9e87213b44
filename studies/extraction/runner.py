"""Runs an extraction: sends the parts of a source to workers, stores what comes back, joins it in the parts' order."""

from __future__ import annotations

import contextlib
import os
import pickle
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, Protocol

import cloudpickle

from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.departures_table import write_departures
from ldctoolkit.recordings.extract import merge_results
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.opened import OpenedRecordings
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.result import Extraction, PartResult
from ldctoolkit.recordings.sources import part_name
from studies.extraction.plan import PACKAGES, PartWork, Probe, Unread, plan_of
from studies.extraction.work_folder import holds_parts, parts_folder, work_folder
from studies.running.executors import Executor, make_executor
from studies.running.tasks import Faults
from studies.storage.files import remove_unfinished

SMALL: Final = 16 << 20
"""Bytes that this process has read before others would have started."""

MOST_SAID: Final = 3
"""Problems that a `NothingReadError` puts into its message."""

Progress = Callable[[int, int], None]


class NothingReadError(RecordingError):
    """No recording could be read.

    Attributes
    ----------
    problems : tuple of Problem
        Why.
    """

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        told = "; ".join(map(str, problems[:MOST_SAID])) or "the files hold no recording"
        more = f" ({len(problems):,} problems in all)" if len(problems) > MOST_SAID else ""
        super().__init__(f"{told}{more}")
        self.problems = problems


def run_extraction(
    recordings: OpenedRecordings,
    criteria: Criteria | None = None,
    preparation: Preparation | None = None,
    *,
    output: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
    before_removal: Callable[[Extraction], None] | None = None,
) -> Extraction:
    r"""Find the lane departures in recordings of any size; goes on where an earlier run was stopped.

    Parameters
    ----------
    recordings : OpenedRecordings
        From `ldctoolkit.recordings.opened.open_recordings`.
    criteria : Criteria, optional
        What counts as a departure; the paper's criteria with the reader's vehicle width by default.
    preparation : Preparation, optional
        How recordings are brought to a common form; the reader's time step by default.
    output : path, optional
        Departures table to write. Finished parts wait in a folder of this name with ``.parts`` behind it until all are
        there; then it is removed. Without an output, or with one part alone, nothing is kept; a folder that another
        extraction has left there is removed all the same.
    workers : int, optional
        Processes; 1 runs in this process. By default all cores, or 1 where less than 16 MiB have to be read.
    dask : str, optional
        Address of a Dask scheduler, or ``"local"``. Its workers open the same paths.
    progress : callable, optional
        Called as ``progress(bytes_done, bytes_total)``.
    before_removal : callable, optional
        Called with the result when the table is written and the finished parts are still there. If it fails or is
        stopped, the next run begins with it.

    Returns
    -------
    Extraction
        The same bits for any number of workers, with Dask, and however often it was stopped.

    Raises
    ------
    NothingReadError
        If no recording could be read; nothing is written.
    StoreError
        If the folder holds other things, is in use, or cannot be written.
    InputError
        For arguments outside what is allowed.
    LdcError
        If workers or a cluster cannot be used.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from ldctoolkit.recordings.opened import open_recordings
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "drive.csv")
    >>> _ = path.write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\na,0.1,0.2,3.6,25\n")
    >>> run_extraction(open_recordings(path)).recordings
    1
    >>> folder.cleanup()
    """
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 1):
        raise InputError(f"workers: {workers!r}; allowed: a whole number >= 1")
    reader, source = recordings.reader, recordings.source
    criteria = criteria or Criteria(reader.vehicle_width)
    preparation = preparation or Preparation(step=reader.step)
    works = tuple(PartWork(i, part, criteria, preparation) for i, part in enumerate(source.parts))
    with contextlib.ExitStack() as stack:
        store: _Store = _Memory()
        if output is not None and (len(works) > 1 or holds_parts(parts_folder(output))):
            plan = plan_of(reader, source, criteria, preparation)
            store = stack.enter_context(work_folder(parts_folder(output), plan))
            remove_unfinished(Path(output))
        unread = _fill(store, works, workers, dask, progress)
        results = _in_order(source.problems, works, store, unread)
        extraction = merge_results(results, criteria, preparation, reader=reader.name, files=source.files)
        if extraction.recordings == 0:
            store.remove()
            raise NothingReadError(extraction.problems)
        if output is not None:
            write_departures(output, extraction.departures, extraction.provenance)
        if before_removal is not None:
            before_removal(extraction)
        store.remove()
    return extraction


class _Store(Protocol):
    """Where finished parts wait."""

    @property
    def finished(self) -> frozenset[int]:
        """Numbers of those that are there."""

    def write(self, number: int, result: PartResult) -> None:
        """Keep one."""

    def read(self, number: int) -> PartResult:
        """Give one back."""

    def remove(self) -> None:
        """They are not needed any more."""


class _Memory:
    """Finished parts in memory."""

    def __init__(self) -> None:
        self._parts: dict[int, PartResult] = {}

    @property
    def finished(self) -> frozenset[int]:
        return frozenset(self._parts)

    def write(self, number: int, result: PartResult) -> None:
        self._parts[number] = result

    def read(self, number: int) -> PartResult:
        return self._parts[number]

    def remove(self) -> None:
        self._parts.clear()


def _fill(
    store: _Store, works: tuple[PartWork, ...], workers: int | None, dask: str | None, progress: Progress | None
) -> dict[int, Unread]:
    """Run what is missing; the parts that nothing came out of."""
    unread: dict[int, Unread] = {}
    missing = [work for work in works if work.number not in store.finished]
    total = sum(work.part.bytes for work in works)
    done = total - sum(work.part.bytes for work in missing)
    if not missing:
        return unread
    if progress is not None:
        progress(done, total)
    if dask is None:
        workers = workers or (1 if total - done < SMALL else os.cpu_count() or 1)
        workers = min(workers, len(missing))
    executor = make_executor(None, workers, dask, PACKAGES)
    try:
        _check_sendable(executor, missing[0])
        for work, came in send_parts(executor, missing):
            if isinstance(came, Unread):
                unread[work.number] = came
            else:
                store.write(work.number, came)
            done += work.part.bytes
            if progress is not None:
                progress(done, total)
    except BaseException:
        executor.close(orderly=False)
        raise
    executor.close(orderly=True)
    return unread


def _check_sendable(executor: Executor, work: PartWork) -> None:
    """Refuse parts that hold more than plain data; a third party's may."""
    if executor.name == "serial":
        return
    dumps = pickle.dumps if executor.name == "dask" else cloudpickle.dumps
    try:
        dumps(work)
    except Exception as error:  # a part may hold anything
        kind = type(work.part).__name__
        raise LdcError(
            f"parts of the kind {kind} cannot be sent to other processes ({error}); use one worker"
        ) from None


def _in_order(
    problems: Sequence[Problem], works: tuple[PartWork, ...], store: _Store, unread: dict[int, Unread]
) -> Iterator[PartResult]:
    """The source's own problems, then the parts as they follow each other."""
    yield PartResult(problems=tuple(problems))
    for work in works:
        if work.number in unread:
            yield PartResult(problems=(Problem(part_name(work.part), "", unread[work.number].reason),))
        else:
            yield store.read(work.number)


_AHEAD: Final = 2
"""Parts a worker that are under way or wait in the executor."""

_ENDED = "ended its worker process each time it was read (out of memory?); it is left out"


def send_parts(executor: Executor, works: Sequence[PartWork]) -> Iterator[tuple[PartWork, PartResult | Unread]]:
    """Run parts, and give each with what came out as soon as it is there. A part that may have ended its worker is run
    again alone. If it ends that one too, it is `Unread`.
    """
    waiting, alone = deque(works), deque[PartWork]()
    faults = Faults()
    under_way = 0
    while waiting or alone or under_way:
        if alone:
            if not under_way:
                executor.start(alone.popleft())
                under_way = 1
        else:
            most = 1 if executor.workers == 1 else _AHEAD * executor.workers
            while under_way < most and waiting:
                executor.start(waiting.popleft())
                under_way += 1
        came = executor.wait()
        faults.came_back(came)
        for ended in came:
            under_way -= 1
            work: PartWork = ended.task
            if ended.done is not None:
                faults.ended_well()
                yield work, ended.done
            elif ended.fault is None:
                waiting.append(work)
            elif not faults.guilty(work, ended.fault, certain=ended.certain):
                alone.append(work)
            else:
                faults.check_workers(executor, Probe(1 + max(one.number for one in works)))
                yield work, Unread(_ENDED)
