"""Extractions of any size: the parts of a source go to workers, are stored as they finish, and joined in order."""

import contextlib
import dataclasses
import hashlib
import importlib.metadata
import io
import json
import logging
import os
import pickle
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Final

import cloudpickle
import numpy as np

import ldctoolkit.departures as departures
from ldctoolkit.code_content import content_of
from ldctoolkit.declared import checked_whole
from ldctoolkit.departures import Departures, DepartureSignals, ExtraColumn
from ldctoolkit.errors import LdcError, RecordingError, StoreError, plain
from ldctoolkit.recordings.departures_table import Extraction, PartResult, write_departures
from ldctoolkit.recordings.extract import extract_part, merge_results
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.quality import Account, Drawn, DrawnEvent, Origin, QualityStatistics
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
from ldctoolkit.version import versions
from ldctoolkit.whole_file import write_whole

from .running.executors import Executor, make_executor
from .running.tasks import Faults
from .storage.files import locked, read_bytes, read_json, remove_leftovers, remove_unfinished, write_json

PACKAGES: Final = ("numpy", "polars", "numba")  # packages that read files or decide numbers


@dataclasses.dataclass(frozen=True)
class Unread:
    """Why nothing came out of a part."""

    reason: str  # One sentence


@dataclasses.dataclass(frozen=True, eq=False)
class Probe:
    """Does nothing: tells whether workers live at all."""

    number: int  # Of the work; of a part, its place in its source
    time_limit: ClassVar[float] = 0.0  # [s] None: how long a file takes depends on the disk

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Nothing is needed."""

    def run(self, kept: dict[str, Any]) -> Any:  # noqa: ARG002
        """Say so."""
        return True


@dataclasses.dataclass(frozen=True, eq=False)
class PartWork(Probe):
    """Reads one part and finds its departures."""

    part: RecordingPart  # What is read
    criteria: Criteria  # What counts as a departure
    preparation: Preparation  # How recordings are brought to a common form
    keep_signals: bool = False  # Whether y(t), v(t) and c(t) of each departure are kept

    def run(self, kept: dict[str, Any]) -> PartResult | Unread:  # noqa: ARG002
        """Read the part; a fault in it, or in its reader, ends this part alone."""
        try:
            return extract_part(self.part, self.criteria, self.preparation, keep_signals=self.keep_signals)
        except LdcError as error:
            return Unread(str(error))
        except Exception as error:  # a reader may be third-party code
            return Unread(f"{type(error).__name__}: {error}")


FORMAT_VERSION: Final = 1

_DESCRIPTIONS: Final = {
    "files": "the files have changed",
    "parts": "they are divided in another way",
    "program": "the program has changed",
    "readers": "the code of a reader has changed",
}
"""What it means where a digest differs."""

Plan = dict[str, Any]  # content of a work folder's manifest, as JSON reads it back


def plan_of(
    reader: RecordingReader,
    source: RecordingSource,
    criteria: Criteria,
    preparation: Preparation,
    keep_signals: bool = False,
) -> Plan:
    """What decides the numbers of all parts."""
    home = Path(departures.__file__).parent
    keys = json.dumps([part.key for part in source.parts])
    # The package that a reader comes with, and its version; of each, where several work together
    names = reader.name.split(" + ")
    points = [point for point in importlib.metadata.entry_points(group=GROUP) if point.name in names]
    plan = {
        "format_version": FORMAT_VERSION,
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
    }
    content: Plan = json.loads(json.dumps(plan))
    return content


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
    members = (getattr(one, name) for one in readers if isinstance(one, ModuleType) for name in ("recognise", "open"))
    classes = {type(one) for one in (*readers, *parts) if not isinstance(one, ModuleType)}
    return sorted(filter(None, map(content_of, (*classes, *members))))


def what_differs(there: Plan, now: Plan) -> str:
    """Half a sentence on what differs between two plans; at most three things are named."""
    found: list[str] = []
    for key in {**now, **there}:
        a, b = there.get(key), now.get(key)
        if a != b and key in _DESCRIPTIONS:
            found.append(_DESCRIPTIONS[key])
            continue
        if not (isinstance(a, dict) and isinstance(b, dict)):
            a, b = {key: a}, {key: b}
        for name in {**b, **a}:
            if a.get(name) != b.get(name):
                then, new = ("not set" if one.get(name) is None else one[name] for one in (a, b))
                found.append(f"{name}: {then} there, {new} now")
    more = f"; and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(found[:3]) + more


_log = logging.getLogger("studies")

_MANIFEST: Final = "manifest.json"
_LOCK: Final = ".lock"
_PART = re.compile(r"part-(\d+)-([0-9a-f]{16})\.npz")
_DIGITS: Final = 16
_KEPT_THERE: Final = "finished parts are kept there: move it, or choose another output"


class WorkFolder:
    """Finished parts of one extraction. Made by `work_folder`, which holds it for this process. A part's name has its
    number and a checksum of its content: a file that was cut short or has a flipped bit is found out, and the part
    is read again.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts: dict[int, Path] = {}
        for file in sorted(path.iterdir()):
            found = _PART.fullmatch(file.name)
            if found is None:
                continue
            # all are read once here, so that what is missing is known before anything is computed
            content = read_bytes(file)
            try:
                if _checksum(content) != found[2]:
                    raise StoreError("broken", "its content is not what was written (the checksum in its name differs)")
                read_part(content)
            except StoreError as error:
                _log.warning("%s: %s; this part is read again", file, error)
                _unlink(file)
            else:
                self._parts[int(found[1])] = file

    @property
    def finished(self) -> frozenset[int]:
        """Numbers of the parts that are there."""
        return frozenset(self._parts)

    def write(self, number: int, result: PartResult) -> None:
        """Store a part, whole or not at all."""
        content = part_bytes(result)
        path = self.path / f"part-{number:06d}-{_checksum(content)}.npz"
        write_whole(path, content, StoreError)
        self._parts[number] = path

    def read(self, number: int) -> PartResult:
        """A part that is there."""
        path = self._parts[number]
        content = read_bytes(path)
        if not path.stem.endswith(_checksum(content)):
            raise StoreError(path, "changed while parts were read", hint="run it again to go on")
        return read_part(content)

    def remove(self) -> None:
        """Remove everything that this program wrote, and the folder if nothing else is in it."""
        _clear(self.path)
        _unlink(self.path / _LOCK)
        with contextlib.suppress(OSError):
            self.path.rmdir()


def parts_folder(output: str | os.PathLike[str]) -> Path:
    """Where the finished parts of an extraction wait."""
    return Path(f"{os.fspath(output)}.parts")


@contextlib.contextmanager
def work_folder(path: Path, plan: Plan) -> Iterator[WorkFolder]:
    """Hold a work folder, made if need be, with the parts of the same plan that are in it. Parts of another plan are
    removed, with a warning that says what differs. A folder without a finished part is removed when the block ends
    in an error.
    """
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError:
        raise StoreError(path, "is no folder", hint=_KEPT_THERE) from None
    except OSError as error:
        raise StoreError(path, f"cannot be made: {error.strerror or error}") from None
    with locked(path):
        try:
            remove_leftovers(path)
            _keep_only(path, plan)
            folder = WorkFolder(path)
        except OSError as error:  # the run that held it may have ended, and taken it away, at this moment
            raise StoreError(path, f"cannot be used: {error.strerror or error}") from None
        try:
            yield folder
        except BaseException:
            if not folder.finished:
                folder.remove()
            raise


def _keep_only(path: Path, plan: Plan) -> None:
    """Leave nothing in the folder but parts of this plan, and the plan itself."""
    manifest = path / _MANIFEST
    if manifest.exists():
        try:
            differs = what_differs(read_json(manifest), plan)
        except StoreError:
            differs = "its manifest is broken"
        if not differs and plan["files"]:  # without digests it is not known whether the files are the same
            return
        if any(_PART.fullmatch(file.name) for file in path.iterdir()):
            why = differs or "the files are not known"
            _log.warning("%s: its parts are of another extraction and are removed (%s)", path, why)
    else:
        others = [file.name for file in path.iterdir() if file.name != _LOCK and not _PART.fullmatch(file.name)]
        if others:
            what = f"is not the work folder of an extraction (it holds {min(others)})"
            raise StoreError(path, what, hint=_KEPT_THERE)
    _clear(path)
    write_json(manifest, plan)


def _clear(path: Path) -> None:
    """Remove parts and manifest; the manifest first, so that no part is ever taken for one of another plan."""
    if not path.is_dir():
        return  # removed before
    _unlink(path / _MANIFEST)
    for file in list(path.iterdir()):
        if _PART.fullmatch(file.name):
            _unlink(file)


def _unlink(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(path, f"cannot be removed: {error.strerror or error}") from None


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


_CLASSES: Final[dict[str, Any]] = {
    kind.__name__: kind
    for kind in (
        PartResult, Departures, DepartureSignals, ExtraColumn, Account, Origin, Label, QualityStatistics, Drawn,
        DrawnEvent, Problem,
    )
}  # fmt: skip
"""Everything that a result is made of."""

_TREE: Final = "tree"  # entry that holds the JSON


def part_bytes(result: PartResult) -> bytes:
    """A result as the content of a file."""
    arrays: list[np.ndarray[Any, Any]] = []

    def packed(value: Any) -> Any:
        """What JSON does not know; arrays are put aside and named by their place."""
        if isinstance(value, np.ndarray):
            arrays.append(value)
            return {"array": len(arrays) - 1}
        if type(value).__name__ in _CLASSES:
            fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
            return {"class": type(value).__name__, "fields": fields}
        return plain(value)

    text = json.dumps(result, default=packed, ensure_ascii=False)
    content = io.BytesIO()
    entries = {str(i): array for i, array in enumerate(arrays)}
    np.savez(content, allow_pickle=False, **{_TREE: np.frombuffer(text.encode(), dtype=np.uint8)}, **entries)
    return content.getvalue()


def read_part(content: bytes) -> PartResult:
    """The result that `part_bytes` made the content of."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as entries:
            tree = json.loads(entries[_TREE].tobytes().decode())
            result = _unpacked(tree, entries)
    except Exception as error:  # any byte of it may be another
        raise StoreError("broken", f"{error or type(error).__name__}") from None
    if not isinstance(result, PartResult):
        raise StoreError("broken", f"holds {type(result).__name__}")
    return result


def _unpacked(value: Any, arrays: Any) -> Any:
    if isinstance(value, list):
        return tuple(_unpacked(item, arrays) for item in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[str(value["array"])]
    return _CLASSES[value["class"]](**{name: _unpacked(item, arrays) for name, item in value["fields"].items()})


SMALL: Final = 16 << 20  # bytes that this process has read before others would have started
MOST_NAMED: Final = 3  # problems that a `NothingReadError` puts into its message

Progress = Callable[[int, int], None]


class NothingReadError(RecordingError):
    """No recording could be read."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        text = "; ".join(map(str, problems[:MOST_NAMED])) or "the files hold no recording"
        more = f" ({len(problems):,} problems in all)" if len(problems) > MOST_NAMED else ""
        super().__init__(f"{text}{more}")
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
    with contextlib.ExitStack() as stack:
        store: _Store = _Memory()
        # a folder that another extraction has left is taken over, too; `isfile` raises nothing where it may not be read
        if output is not None and (len(works) > 1 or os.path.isfile(parts_folder(output) / _MANIFEST)):  # noqa: PTH113
            plan = plan_of(reader, source, criteria, preparation, keep_signals)
            store = stack.enter_context(work_folder(parts_folder(output), plan))
            remove_unfinished(Path(output))
        unread = _fill(store, works, workers, dask, progress)
        results = _in_order(source.problems, works, store, unread)
        extraction = merge_results(results, criteria, preparation, reader=reader.name, files=source.files, force=force)
        if extraction.recordings == 0:
            store.remove()
            raise NothingReadError(extraction.problems)
        if output is not None:
            write_departures(output, extraction.departures, extraction.provenance)
        if before_removal is not None:
            before_removal(extraction)
        store.remove()
    return extraction


class _Memory(dict[int, PartResult]):
    """Finished parts in memory, in place of a `WorkFolder`."""

    @property
    def finished(self) -> frozenset[int]:
        return frozenset(self)

    write = dict.__setitem__
    read = dict.__getitem__
    remove = dict.clear


_Store = WorkFolder | _Memory


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
        dumps = pickle.dumps if executor.name == "dask" else cloudpickle.dumps
        try:
            if executor.name != "serial":
                dumps(missing[0])
        except Exception as error:  # a third party's part may hold anything
            what = f"parts of the kind {type(missing[0].part).__name__} cannot be sent to other processes ({error})"
            raise LdcError(f"{what}; use one worker") from None
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


_PREFETCH: Final = 2  # parts a worker that are under way or wait in the executor

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
            most = 1 if executor.workers == 1 else _PREFETCH * executor.workers
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
