"""Extractions of any size: the parts of a source go to workers, are stored as they finish, and joined in order."""

import dataclasses
import hashlib
import itertools
import json
import os
import pickle
import uuid
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import cloudpickle

import ldctoolkit.departures as departures
from ldctoolkit.code_content import content_of
from ldctoolkit.declared import checked_whole
from ldctoolkit.departures import Departures, DepartureSignals, ExtraColumn
from ldctoolkit.errors import LdcError, RecordingError
from ldctoolkit.recordings.departures_table import Extraction, PartResult, write_departures
from ldctoolkit.recordings.extract import extract_part, merge_results
from ldctoolkit.recordings.extraction_statistics import Account, Drawn, DrawnEvent, Origin, QualityStatistics
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import (
    GROUP,
    CombinedReader,
    Label,
    OpenedRecordings,
    Problem,
    RecordingPart,
    RecordingReader,
    RecordingSource,
    part_name,
)
from ldctoolkit.version import entry_points, versions

from .running.dispatch import Lost, Work, closing, run_works
from .running.executors import make_executor
from .storage.checked_parts import Parts, planned_parts, remove_unfinished

PACKAGES: Final = ("numpy", "polars", "numba")  # packages that read files or decide numbers


@dataclasses.dataclass(frozen=True, eq=False)
class PartWork(Work):
    """Reads one part and finds its departures. There is no time limit: how long a file takes depends on the disk."""

    index: int  # Of the part in its source
    part: RecordingPart
    criteria: Criteria  # What counts as a departure
    preparation: Preparation  # How recordings are brought to a common form
    keep_signals: bool = False  # Whether y(t), v(t) and c(t) of each departure are kept

    def run(self, cache: dict[str, Any]) -> PartResult | str:  # noqa: ARG002
        """Read the part. A fault in it, or in its reader, ends this part alone: then the reason, one sentence."""
        try:
            return extract_part(self.part, self.criteria, self.preparation, keep_signals=self.keep_signals)
        except LdcError as error:
            return str(error)
        except Exception as error:  # a reader may be third-party code
            return f"{type(error).__name__}: {error}"


_MEANINGS: Final = {
    "files": "the files have changed",
    "parts": "they are divided in another way",
    "program": "the program has changed",
    "readers": "the code of a reader has changed",
    "run": "the files are not known",
}
"""What it means where a digest differs."""


def plan_of(
    reader: RecordingReader,
    source: RecordingSource,
    criteria: Criteria,
    preparation: Preparation,
    keep_signals: bool = False,
) -> dict[str, Any]:
    """What decides the numbers of all parts."""
    home = Path(departures.__file__).parent
    keys = json.dumps([part.key for part in source.parts])
    # the package that a reader comes with, and its version; of each, where several work together
    names = reader.name.split(" + ")
    points = [point for name, point in entry_points(GROUP).items() if name in names]
    return {
        "reader": reader.name,
        "program": _program(home),
        "readers": _readers(reader, source.parts),
        "versions": dict(versions(("ldctoolkit", *PACKAGES)))
        | {point.dist.name: point.dist.version for point in points if point.dist is not None},
        "criteria": dataclasses.asdict(criteria),
        "preparation": dataclasses.asdict(preparation),
        "signals": keep_signals,
        "files": [[file.name, file.bytes, file.sha256] for file in source.files],
        "parts": [len(source.parts), hashlib.sha256(keys.encode()).hexdigest()],
        # without digests it is not known whether the files are the same
        "run": "" if source.files else uuid.uuid4().hex,
    }


def _program(home: Path) -> str:
    """Digest of the toolkit's code that decides the numbers: a checkout changes without another version."""
    digest = hashlib.sha256()
    for path in sorted((*(home / "recordings").rglob("*.py"), home / "departures.py")):
        content = path.read_bytes() if path.is_file() else b""
        digest.update(f"{path.relative_to(home).as_posix()} {hashlib.sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def _readers(reader: RecordingReader, parts: Iterable[RecordingPart]) -> list[str]:
    """Content of the code of readers and parts that are not the toolkit's."""
    readers = reader.readers if isinstance(reader, CombinedReader) else (reader,)
    members = (
        getattr(module, name) for module in readers if isinstance(module, ModuleType) for name in ("recognise", "open")
    )
    classes = {type(item) for item in (*readers, *parts) if not isinstance(item, ModuleType)}
    return sorted(filter(None, map(content_of, (*classes, *members))))


def parts_folder(output: str | os.PathLike[str]) -> Path:
    """Where the finished parts of an extraction wait."""
    return Path(f"{os.fspath(output)}.parts")


PART_CLASSES: Final[dict[str, type]] = {
    kind.__name__: kind
    for kind in (
        PartResult, Departures, DepartureSignals, ExtraColumn, Account, Origin, Label, QualityStatistics, Drawn,
        DrawnEvent, Problem,
    )
}  # fmt: skip
"""Everything that a part is made of."""

SMALL: Final = 16 << 20  # bytes that this process has read before others would have started
MOST_NAMED: Final = 3  # problems that a `NothingReadError` puts into its message

Progress = Callable[[int, int], None]


class NothingReadError(RecordingError):
    """No recording could be read."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        text = "; ".join(map(str, problems[:MOST_NAMED])) or "the files hold no recording"
        more = f" ({len(problems):,} problems in all)" if len(problems) > MOST_NAMED else ""
        super().__init__(problem=f"{text}{more}")
        self.problems = problems


def run_extraction(
    recordings: OpenedRecordings,
    criteria: Criteria | None = None,
    preparation: Preparation | None = None,
    *,
    keep_signals: bool = False,
    force: bool = False,
    output: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
    before_removal: Callable[[Extraction], None] | None = None,
) -> Extraction:
    r"""Find the lane departures in recordings of any size; goes on where an earlier run was stopped.

    Raises `NothingReadError` if no recording could be read, `RecordingError` for recordings whose units, signs or
    references cannot be right; nothing is written; `StoreError` if the folder holds other
    things, is in use, or cannot be written; `InputError` for arguments outside what is allowed; `LdcError` if workers
    or a cluster cannot be used.

    Parameters
    ----------
    recordings : OpenedRecordings
        From `ldctoolkit.recordings.recording.open_recordings`.
    criteria : Criteria, optional
        What counts as a departure; the paper's criteria with the reader's vehicle width by default.
    preparation : Preparation, optional
        How recordings are brought to a common form; the reader's time step by default.
    keep_signals : bool
        Keep y(t), v(t) and c(t) of every departure; with an output, in a second table beside it, ``d.signals.parquet``
        of ``d.parquet``.
    force : bool
        Go on where units, signs or references cannot be what is needed.
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

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from ldctoolkit.recordings.recording import open_recordings
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "drive.csv")
    >>> _ = path.write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\na,0.1,0.2,3.6,25\n")
    >>> run_extraction(open_recordings(path)).recordings
    1
    >>> folder.cleanup()
    """
    workers = None if workers is None else checked_whole("workers", workers, lower=1)
    reader, source = recordings.reader, recordings.source
    criteria = criteria or Criteria(reader.vehicle_width)
    preparation = preparation or Preparation(step=reader.step)
    works = tuple(PartWork(i, part, criteria, preparation, keep_signals) for i, part in enumerate(source.parts))
    folder = None if output is None else parts_folder(output)
    # a folder that another extraction has left is taken over, too; `isfile` raises nothing where it may not be read
    if folder is not None and len(works) < 2 and not os.path.isfile(folder / "manifest.json"):  # noqa: PTH113
        folder = None
    plan = {} if folder is None else plan_of(reader, source, criteria, preparation, keep_signals)
    with planned_parts(folder, plan, PART_CLASSES, replace=True, meanings=_MEANINGS) as parts:
        if folder is not None and output is not None:
            remove_unfinished(Path(output).parent, Path(output).name)
        unread = _read_missing(parts, works, workers, dask, progress)
        # the source's own problems, then the parts as they follow each other
        results = itertools.chain(
            [PartResult(problems=tuple(source.problems))],
            (
                PartResult(problems=(Problem(part_name(work.part), "", unread[work.index]),))
                if work.index in unread
                else parts.read(work.index)
                for work in works
            ),
        )
        extraction = merge_results(results, criteria, preparation, reader=reader.name, files=source.files, force=force)
        if extraction.recordings == 0:
            parts.remove()
            raise NothingReadError(extraction.problems)
        if output is not None:
            write_departures(output, extraction.departures, extraction.provenance)
        if before_removal is not None:
            before_removal(extraction)
        parts.remove()
    return extraction


_ENDED: Final = "ended its worker process each time it was read (out of memory?); it is left out"


def _read_missing(
    parts: Parts, works: tuple[PartWork, ...], workers: int | None, dask: str | None, progress: Progress | None
) -> dict[int, str]:
    """Run what is missing; for each part that nothing came out of, the reason."""
    unread: dict[int, str] = {}
    missing = [work for work in works if work.index not in parts.finished]
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
    with closing(executor):
        try:
            if executor.name != "serial":
                (pickle if executor.name == "dask" else cloudpickle).dumps(missing[0])
        except Exception as error:  # a third party's part may hold anything
            kind = type(missing[0].part).__name__
            problem = f"parts of the kind {kind} cannot be sent to other processes ({error})"
            raise LdcError(problem=problem, hint="use one worker") from None
        for work, result in run_works(executor, missing):
            if isinstance(result, PartResult):
                parts.write(work.index, result)
            else:
                unread[work.index] = _ENDED if isinstance(result, Lost) else result
            done += work.part.bytes
            if progress is not None:
                progress(done, total)
    return unread
