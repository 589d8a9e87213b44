"""Sources of recordings: files and folders of a format, cut into parts, and several sources read as one."""

import dataclasses
import functools
import importlib.metadata
import itertools
import os
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, Generic, Protocol, TypeVar, runtime_checkable

from ldctoolkit.errors import InputError, LdcError, RecordingError, UnknownNameError, nearest
from ldctoolkit.recordings.recording import Problem, Recording, SourceFile

GROUP: Final = "ldctoolkit.recordings"  # entry-point group of readers

AUTO: Final = "auto"


@runtime_checkable
class RecordingPart(Protocol):
    """A share of a source that is read in one go: whole recordings, which fit into memory together.

    It is sent to worker processes, so it is plain data. Which recordings lie in which part depends on the source alone.
    Problems of a whole part are reported under its attribute `shown`, if it has one, or else under its key.
    """

    @property
    def key(self) -> str:
        """Unique in the source, and the same whenever the source is opened again."""

    @property
    def bytes(self) -> int:
        """About how much is read, for the progress."""

    def read(self) -> Iterator[Recording | Problem]:
        """Recordings in a fixed order, and what could not be used; raises `LdcError` if nothing of it can."""


def part_name(part: RecordingPart) -> str:
    """What a part is called in messages: its `shown`, if it has one, or else its key."""
    name = getattr(part, "shown", "")
    return name if isinstance(name, str) and name else part.key


@runtime_checkable
class RecordingSource(Protocol):
    """Files that a reader has looked through."""

    @property
    def parts(self) -> Sequence[RecordingPart]:
        """In a fixed order."""

    @property
    def files(self) -> Sequence[SourceFile]:
        """What was found, with digests."""

    @property
    def problems(self) -> Sequence[Problem]:
        """What was seen while looking; parts report their own while they are read."""


P = TypeVar("P", bound=RecordingPart)


@dataclasses.dataclass(frozen=True)
class FoundParts(Generic[P]):
    """A `RecordingSource` as plain data."""

    parts: tuple[P, ...]  # in a fixed order
    files: tuple[SourceFile, ...]  # what was found, with digests
    problems: tuple[Problem, ...]  # what was seen while looking


@runtime_checkable
class RecordingReader(Protocol):
    """Reads one kind of recordings.

    Found by the entry-point group ``ldctoolkit.recordings``; the entry point's name is the reader's, its value an
    object (an instance, a class that is made without arguments, or a module) with these members.
    """

    @property
    def name(self) -> str:
        """As given to ``ldc extract --format``."""

    @property
    def title(self) -> str:
        """A short text."""

    @property
    def vehicle_width(self) -> float:
        """[m] Taken unless the user gives another."""

    @property
    def step(self) -> float | None:
        """[s] That recordings are resampled to unless the user gives another; None leaves them as they are."""

    def recognise(self, paths: Sequence[Path]) -> str:
        """What was found, in a short text, if these paths are of this kind; otherwise an empty text.

        It looks at names, folders and first lines only, and raises nothing for content of another kind.
        """

    def open(self, paths: Sequence[Path]) -> RecordingSource:
        """Look through files and folders.

        Raises `RecordingError` if nothing can be used; single faults are problems of the source.
        """


@functools.cache
def _installed() -> dict[str, importlib.metadata.EntryPoint]:
    return {point.name: point for point in importlib.metadata.entry_points(group=GROUP)}


def reader_names() -> tuple[str, ...]:
    """Names of all installed readers, sorted."""
    return tuple(sorted(_installed()))


@functools.cache
def recording_reader(name: str) -> RecordingReader:
    """The reader of that name.

    Raises `UnknownNameError` naming the nearest known reader; `LdcError` if it cannot be loaded, or is not made as
    `RecordingReader` asks for.

    Examples
    --------
    >>> recording_reader("uah-driveset").step
    0.1
    """
    point = _installed().get(name)
    if point is None:
        raise UnknownNameError("format", "is no reader", value=name, allowed=(AUTO, *reader_names()))
    try:
        reader = point.load()
        if isinstance(reader, type):
            reader = reader()
    except Exception as error:  # the file may be third-party code: whatever it raises must name the reader
        kind = "" if isinstance(error, LdcError | ImportError) else f"{type(error).__name__}: "
        raise LdcError(f"format {name!r} ({point.value}) cannot be loaded: {kind}{error}") from error
    if not isinstance(reader, RecordingReader):
        raise LdcError(f"format {name!r} ({point.value})", "allowed: name, title, vehicle_width, step, recognise, open")
    if reader.name != name:
        raise LdcError(f"format {name!r} ({point.value})", f"its name is {reader.name!r}", allowed="the same as here")
    return reader


DEPTH: Final = 2  # folders inside a folder are looked into this many levels down

_TABLE: Final = re.compile(r"\.(csv|txt|csv\.gz|csv\.bz2|csv\.xz|csv\.zip)$", re.IGNORECASE)


def find_tables(paths: Iterable[Path], names: re.Pattern[str] = _TABLE) -> list[tuple[Path, bool]]:
    """Files named by the user, and files in named folders that may be tables by their names; each once."""
    found: dict[str, tuple[Path, bool]] = {}
    for path in paths:
        named = not os.path.isdir(path)  # noqa: PTH112 - this one raises nothing, whatever the path
        inside = [path] if named else [one for one in _walk(path, DEPTH) if names.search(one.name)]
        for one in inside:
            place = place_of(one)
            known = found.get(place)
            found[place] = (known[0] if known else one, named or (known is not None and known[1]))
    return list(found.values())


def place_of(path: Path) -> str:
    """Where a file is, whatever links lead there."""
    try:
        return os.path.realpath(path)
    except ValueError:  # a NUL in the name; opening it tells
        return str(path)


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    try:
        inside = sorted(folder.iterdir(), key=lambda one: one.name)
    except OSError:
        return
    for one in inside:
        if os.path.isdir(one):  # noqa: PTH112
            if depth > 0 and not one.name.startswith("."):
                yield from _walk(one, depth - 1)
        elif not one.name.startswith(".") and os.path.isfile(one):  # noqa: PTH113
            yield one


def shown_names(paths: Sequence[Path]) -> list[str]:
    """Names to tell files apart by: as few of the last folders as it takes."""
    whole = [path.absolute().parts for path in paths]
    names = [parts[-1] for parts in whole]
    for length in range(2, max(map(len, whole), default=1) + 1):
        count = Counter(names)
        if len(count) == len(names):
            break
        names = [
            "/".join(parts[-length:]) if count[name] > 1 else name for name, parts in zip(names, whole, strict=True)
        ]
    return names


def check_columns(
    columns: Sequence[str], required: Sequence[str], optional: Sequence[str] = (), same: Callable[[str], str] = str
) -> None:
    """Refuse a header that lacks a column or repeats one; with ``same=str.lower`` letters may be of either case."""
    there, known = list(map(same, columns)), list(map(same, (*required, *optional)))
    for name in (*required, *optional):
        if (count := there.count(same(name))) > 1:
            raise RecordingError("", f"column '{name}' appears {count} times; allowed: once")
    for name in required:
        if same(name) not in there:
            # the nearest name is looked for among the file's own, which is what its author has to rename
            unknown = [one for one in columns[:64] if one and same(one) not in known]
            hint = textwrap.shorten(nearest(name, unknown).replace("allowed:", "columns not known here:"), 400)
            hint = hint if unknown else "no other column of the file could be it"
            raise RecordingError("", f"column '{name}' is missing; {hint}. Needed: {', '.join(required)}")


class CombinedReader:
    """Readers with the same vehicle width and step, for paths that hold files of each."""

    def __init__(self, readers: tuple[RecordingReader, ...]) -> None:
        self.readers = readers  # two or more, by name
        self.name = " + ".join(reader.name for reader in readers)
        self.title = "; ".join(reader.title for reader in readers)
        self.vehicle_width = readers[0].vehicle_width
        self.step = readers[0].step

    def recognise(self, paths: Sequence[Path]) -> str:
        """What each of them finds."""
        texts = ((reader.name, reader.recognise(paths)) for reader in self.readers)
        return "; ".join(f"{name}: {text}" for name, text in texts if text)

    def open(self, paths: Sequence[Path]) -> FoundParts[RecordingPart]:
        """Look through the paths with each; each passes over the others' files."""
        sources: list[RecordingSource] = []
        errors: list[RecordingError] = []
        unread: list[Problem] = []
        owner: dict[str, str] = {}
        files = [path for path, _ in find_tables(paths)]
        names = shown_names(files)
        for reader in self.readers:
            try:
                source = reader.open(paths)
            except RecordingError as error:
                errors.append(error)
                known = (name for path, name in zip(files, names, strict=True) if reader.recognise([path]))
                unread.append(Problem(next(known, paths[0].name), "", str(error)))
                continue
            sources.append(source)
            for file in source.files:
                if owner.setdefault(file.sha256, reader.name) != reader.name:
                    raise RecordingError(
                        file.name,
                        f"several readers know such files ({self.recognise(paths)})",
                        hint="choose one with --format",
                    )
        if not sources:
            raise errors[0]
        owned = [{file.name for file in source.files} for source in sources]
        read = set().union(*owned)
        problems = [
            problem
            for source, own in zip(sources, owned, strict=True)
            for problem in source.problems
            if problem.file in own or problem.file not in read  # else a file that another one is for
        ]
        parts = tuple(part for source in sources for part in source.parts)
        found = tuple(file for source in sources for file in source.files)
        return FoundParts(parts, found, (*problems, *unread))


@dataclasses.dataclass(frozen=True)
class OpenedRecordings:
    """Recordings that a reader has looked through."""

    reader: RecordingReader  # What reads them
    source: RecordingSource  # Parts, files, problems
    found: str  # What was found, in a short text


def open_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    format: str = AUTO,
    channels: str | os.PathLike[str] | None = None,
) -> OpenedRecordings:
    """Look through files and folders of recordings of one kind, to be given to `extract_departures`.

    Raises `RecordingError` if a path does not exist or is given twice, or nothing of it can be used; `UnknownNameError`
    for a reader that is not known; `InputError` if no path is given; `LdcError` if the reader fails over the paths, or
    two of its parts have the same key.

    Parameters
    ----------
    paths : path or iterable of paths
    format : str
        Name of a reader; "auto" looks at columns and folders.
    channels : path, optional
        Channel map of MDF logs, a TOML file.

    Examples
    --------
    >>> open_recordings("nowhere.csv")
    Traceback (most recent call last):
    ldctoolkit.errors.RecordingError: nowhere.csv: does not exist
    """
    given = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    if not given:
        raise InputError("paths", "none given", hint="at least one file or folder of recordings is needed")
    seen: set[Path] = set()
    for path in given:
        if not os.path.exists(path):  # noqa: PTH110 - this one raises nothing, whatever the path
            raise RecordingError(path, "does not exist")
        if path.resolve() in seen:
            raise RecordingError(path.name, "given twice")
        seen.add(path.resolve())
    reader, found = _recognised(given) if format == AUTO else (recording_reader(format), "")
    if channels is not None:
        if not hasattr(reader, "channels"):
            raise InputError("channels", f"{channels}; format {reader.name!r} takes no channel map", allowed="mdf")
        reader = dataclasses.replace(reader, channels=Path(channels))  # type: ignore[type-var]
    try:
        source = reader.open(given)
        keys = Counter(part.key for part in source.parts)
    except LdcError:
        raise
    except Exception as error:  # the reader may be third-party code
        raise LdcError(f"format {reader.name!r}", f"open fails with {type(error).__name__}: {error}") from error
    for key, count in keys.items():
        if count > 1:
            raise LdcError(
                f"format {reader.name!r}", f"{count} parts have the key {key!r}", allowed="a key for each part"
            )
    return OpenedRecordings(reader, source, found or reader.title)


def _recognised(paths: list[Path]) -> tuple[RecordingReader, str]:
    """The reader for these paths, and what it found; several readers as one where one set of options serves them."""
    found: list[tuple[RecordingReader, str]] = []
    for reader in map(recording_reader, reader_names()):
        try:
            text = reader.recognise(paths)
        except Exception as error:  # the reader may be third-party code
            raise LdcError(
                f"format {reader.name!r}", f"recognise fails with {type(error).__name__}: {error}"
            ) from error
        if text:
            found.append((reader, text))
    if len(found) == 1:
        return found[0]
    shown = ", ".join(path.name or str(path) for path in paths[:3]) + (", ..." if len(paths) > 3 else "")
    if not found:
        raise RecordingError(
            shown,
            "no reader knows such files",
            allowed=f"{', '.join(reader_names())} (named with --format, a reader says what it misses)",
        )
    texts = "; ".join(f"{reader.name}: {text}" for reader, text in found)
    readers = tuple(reader for reader, _ in found)
    if len({(reader.vehicle_width, reader.step) for reader in readers}) > 1:
        raise RecordingError(shown, f"several readers know such files ({texts})", hint="choose one with --format")
    return CombinedReader(readers), texts


def read_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    format: str = AUTO,
    channels: str | os.PathLike[str] | None = None,
) -> Iterator[Recording]:
    r"""Read driving recordings, whole ones in the order of the files, and stop at the first fault.

    `paths`, `format` and `channels` are those of `open_recordings`, which goes on with what is sound, and names what is
    not. The content is read, and checked, while iterating. Raises `RecordingError` as `open_recordings`; while
    iterating, for content that cannot be used, naming file and place.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "drive.csv")
    >>> _ = path.write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\na,0.1,0.2,3.6,25\n")
    >>> [(recording.name, recording.samples) for recording in read_recordings(path)]
    [('a', 2)]
    >>> folder.cleanup()
    """
    return _sound(open_recordings(paths, format=format, channels=channels))


def _sound(opened: OpenedRecordings) -> Iterator[Recording]:
    source = opened.source
    for item in itertools.chain(source.problems, *(part.read() for part in source.parts)):
        if isinstance(item, Problem):
            raise RecordingError(str(item))
        yield item
