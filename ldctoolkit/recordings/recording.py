"""Recordings of a lane-keeping camera: signals over time, the readers that give them, and what is wrong with them."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import os
import re
import stat
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar, runtime_checkable

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, ReadOnly
from ldctoolkit.errors import InputError, LdcError, RecordingError, UnknownNameError, closest
from ldctoolkit.version import entry_points


@dataclasses.dataclass(frozen=True)
class SourceFile:
    """A file that was read."""

    name: str  # File name without its folder; for files that share names, with the folders inside the source
    bytes: int  # Size
    sha256: str  # Digest of the content, hexadecimal

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", printable(self.name))


def printable(text: str) -> str:
    r"""A text on one line, to show and store; names of files may hold line ends and bytes that are no text."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def source_file(path: Path, name: str = "") -> SourceFile:
    """Read a file for its digest; raises `RecordingError` under its name."""
    name = name or path.name
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would wait for ever
            raise RecordingError(name, "is not a regular file")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256")
            size = stream.tell()
    except OSError as error:
        raise RecordingError(name, f"cannot be read: {error.strerror}") from None
    return SourceFile(name, size, digest.hexdigest())


def _text(value: object, field: str) -> str:
    """A text in a form that can be printed."""
    if not isinstance(value, str):
        raise RecordingError(field, f"of type {type(value).__name__}", allowed="str")
    return printable(value)


@dataclasses.dataclass(frozen=True)
class Label:
    """A property of a recording that departures can be grouped by. Its texts are made printable.

    Raises `RecordingError` for what is no text.
    """

    name: str  # Becomes a column of the departures table: ``driver``, ``behaviour``, ``road``
    value: str

    def __post_init__(self) -> None:
        for attribute in ("name", "value"):
            object.__setattr__(self, attribute, _text(getattr(self, attribute), f"label.{attribute}"))


@dataclasses.dataclass(frozen=True)
class Problem:
    """Something in a source that could not be used; the rest is. Its texts are made printable.

    Examples
    --------
    >>> str(Problem("DataLane.csv", "line 17", "the time runs backwards; the row is left out"))
    'DataLane.csv, line 17: the time runs backwards; the row is left out'
    """

    file: str  # Name of the file, without folders of this machine
    place: str  # ``"line 17"``, ``"row 5"``; empty for the file as a whole
    what: str  # What is wrong and what was done about it

    def __post_init__(self) -> None:
        for name in ("file", "place", "what"):
            object.__setattr__(self, name, printable(getattr(self, name)))

    @classmethod
    def of(cls, file: str, error: RecordingError, outcome: str = "") -> Problem:
        """The problem of a file that an error states; the error's path is the place in the file."""
        return cls(file, error.path, "; ".join(text for text in (error.without_path, outcome) if text))

    @property
    def error(self) -> RecordingError:
        """The problem as an error."""
        return RecordingError(f"{self.file}, {self.place}" if self.place else self.file, self.what)

    def __str__(self) -> str:
        return str(self.error)


@dataclasses.dataclass(frozen=True)
class Recording(ReadOnly):
    """m samples of one drive, in SI units and with the signs of ISO 8855.

    What every reader gives. Numbers of samples that cannot be used may be NaN. Texts are made printable. Raises
    `RecordingError` for columns of different lengths, times that fall or are not finite, an empty name, or what is no
    text.

    Examples
    --------
    >>> t = np.arange(3) * 0.1
    >>> recording = Recording("a", t, np.zeros(3), np.full(3, 3.6), np.full(3, 25.0), np.ones(3, bool))
    >>> recording.samples
    3
    """

    # Identifier, unique among the recordings of a source. One that had to be made printable ends in a digest, so that
    # two stay two.
    name: str
    # (m,) [s] Time on the recording's own clock, finite; repeated times are allowed, falling ones are not
    t: FloatArray
    lane_offset: FloatArray  # (m,) [m] Vehicle's centre from the lane's centre, positive to the left
    lane_width: FloatArray  # (m,) [m] Width of the lane that the vehicle is in
    speed: FloatArray  # (m,) [m/s] Speed along the road
    valid: BoolArray  # (m,) False where the source itself says that the sample cannot be used
    curvature: FloatArray | None = None  # (m,) [1/m] Lane curvature, positive to the left
    # (m,) [rad/s] Yaw rate, positive to the left; used only where `curvature` is None
    yaw_rate: FloatArray | None = None
    lane: IntArray | None = None  # (m,) Label of the lane; only equality counts
    turn_signal: IntArray | None = None  # (m,) +1 left, -1 right, 0 none
    # (m,) [rad] Course over ground, counter-clockwise, NaN where there is none; a check of yaw rate and offset
    heading: FloatArray | None = None
    # (m,) [rad] Steering angle of the road wheels or the steering wheel, positive to the left
    steering: FloatArray | None = None
    # (m,) [rad] Commanded steering angle, of the same wheel as `steering`
    steering_command: FloatArray | None = None
    engaged: BoolArray | None = None  # (m,) True while a system steers, not the driver
    # (m,) True where the source lost samples before this one: nothing is joined or interpolated across
    cut: BoolArray | None = None
    labels: tuple[Label, ...] = ()  # What departures can be grouped by
    source: str = ""  # What it came from, for the account: a file or a folder
    lane_scale: float = 1.0  # Factor that offset and width were multiplied with; 1 for none
    notes: tuple[str, ...] = ()  # What the recording lacks, as text
    # (m,) False where `yaw_rate` was worked out from the heading, which it cannot be checked against;
    # None for nowhere
    yaw_rate_measured: BoolArray | None = None
    continues: bool = False  # Goes on from the recording before it, of the same name: it counts as no other recording

    COLUMNS: ClassVar[tuple[str, ...]] = (
        "t", "lane_offset", "lane_width", "speed", "valid", "curvature", "yaw_rate", "lane", "turn_signal", "heading",
        "steering", "steering_command", "engaged", "cut", "yaw_rate_measured",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        name = _text(self.name, "recording.name")
        if not name:
            raise RecordingError("recording.name", "empty")
        if name != self.name:  # names that differ in what cannot be printed alone still have to differ
            digest = hashlib.blake2b(self.name.encode("utf-8", "surrogatepass"), digest_size=4).hexdigest()
            object.__setattr__(self, "name", f"{name} ({digest})")
        whose = f"recording {self.name!r}"
        object.__setattr__(self, "source", _text(self.source, f"{whose}: source"))
        for attribute, kind in (("notes", str), ("labels", Label)):
            values = getattr(self, attribute)
            if not isinstance(values, tuple | list) or not all(isinstance(value, kind) for value in values):
                what = f"{attribute} are {values!r:.60}"
                raise RecordingError(whose, what, allowed=f"a tuple of {kind.__name__}")
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))
        object.__setattr__(self, "labels", tuple(self.labels))
        for column in self.COLUMNS:
            values = getattr(self, column)
            if values is not None and values.shape != (self.samples,):
                what = f"{column} has the shape {values.shape}"
                raise RecordingError(whose, what, allowed=f"({self.samples},), as t")
        if not np.isfinite(self.t).all():
            raise RecordingError(whose, f"t[{int(np.argmin(np.isfinite(self.t)))}] is not finite")
        if (self.t[1:] < self.t[:-1]).any():
            i = int(np.argmax(self.t[1:] < self.t[:-1]))
            times = f"t[{i + 1}] = {float(self.t[i + 1])!r} s after {float(self.t[i])!r} s"
            raise RecordingError(whose, times, allowed="times that do not fall")

    @property
    def samples(self) -> int:
        """Number of samples, m."""
        return int(self.t.size)

    def take(self, rows: IntArray | BoolArray | slice) -> Recording:
        """The same recording with chosen samples."""
        return changed_columns(self, self.COLUMNS, lambda values: values[rows])


MIN_LANE_WIDTH: Final = 2.0  # [m]
MAX_LANE_WIDTH: Final = 7.0

LARGEST: Final = 1e9  # a number of this size or more is not a measurement in any unit; its sample is invalid


def measured(values: FloatArray) -> FloatArray:
    """Values with NaN in place of numbers of absurd size, whose sums would overflow."""
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def usable_samples(samples: RecordingTable | Recording) -> BoolArray:
    """Samples, (m,), that are marked valid and whose offset, width, speed and bend are numbers of sensible size."""
    usable: BoolArray = samples.valid & (samples.lane_width > 0.0)
    bend = samples.curvature if samples.curvature is not None else samples.yaw_rate
    for column in (samples.lane_offset, samples.lane_width, samples.speed, bend):
        if column is not None:
            usable &= np.abs(column) < LARGEST  # False for NaN
    return usable


@dataclasses.dataclass(frozen=True)
class RecordingTable:
    """r whole recordings of m samples in all, in flat arrays."""

    names: npt.NDArray[np.str_]  # (r,): identifier of each recording
    offsets: IntArray  # (r + 1,): recording i has the samples ``offsets[i]:offsets[i + 1]``
    t: FloatArray  # (m,) [s]: time on the recording's own clock, not falling inside a recording
    lane_offset: FloatArray  # (m,) [m]: vehicle's centre from the lane's centre, positive to the left
    lane_width: FloatArray  # (m,) [m]: width of the lane that the vehicle is in
    speed: FloatArray  # (m,) [m/s]: speed along the road
    valid: BoolArray  # (m,): false where the source itself says that the sample cannot be used
    curvature: FloatArray | None = None  # (m,) [1/m]: lane curvature, positive to the left (ISO 8855)
    yaw_rate: FloatArray | None = None  # (m,) [rad/s]: yaw rate, positive to the left
    lane: IntArray | None = None  # (m,): label of the lane; only equality counts
    turn_signal: IntArray | None = None  # (m,): +1 left, -1 right, 0 none
    engaged: BoolArray | None = None  # (m,): true while a system steers

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> RecordingTable:
        """Recordings that have the same columns."""
        names = [field.name for field in dataclasses.fields(cls) if field.name not in ("names", "offsets")]
        columns = {name: [getattr(recording, name) for recording in recordings] for name in names}
        return cls(
            names=np.array([recording.name for recording in recordings], dtype=np.str_),
            offsets=np.concatenate([[0], np.cumsum([recording.samples for recording in recordings])]).astype(np.int64),
            **{name: np.concatenate(parts) for name, parts in columns.items() if parts[0] is not None},
        )

    @property
    def samples(self) -> int:
        """Number of samples, m."""
        return int(self.t.size)

    @property
    def recording_index(self) -> IntArray:
        """Index of the recording that each sample belongs to, (m,)."""
        return np.repeat(np.arange(self.names.size), np.diff(self.offsets))


Samples = TypeVar("Samples", Recording, RecordingTable)


def changed_columns(samples: Samples, names: Iterable[str], change: Callable[[Any], Any]) -> Samples:
    """The same samples with changed values in the named columns; columns that they lack are passed over."""
    columns = {name: getattr(samples, name) for name in names}
    changed = {name: change(values) for name, values in columns.items() if values is not None}
    return dataclasses.replace(samples, **changed)


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
        """The files that are read, with digests."""

    @property
    def problems(self) -> Sequence[Problem]:
        """Problems of opening the source; each part reports its own while it is read."""


P = TypeVar("P", bound=RecordingPart)


@dataclasses.dataclass(frozen=True)
class FoundParts(Generic[P]):
    """A `RecordingSource` as plain data."""

    parts: tuple[P, ...]  # in a fixed order
    files: tuple[SourceFile, ...]  # with digests
    problems: tuple[Problem, ...]  # of opening the source


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


def reader_names() -> tuple[str, ...]:
    """Names of all installed readers, sorted."""
    return tuple(sorted(entry_points(GROUP)))


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
    point = entry_points(GROUP).get(name)
    if point is None:
        raise UnknownNameError("format", "is not a known reader", value=name, allowed=(AUTO, *reader_names()))
    where = f"format {name!r} ({point.value})"
    try:
        reader = point.load()
        if isinstance(reader, type):
            reader = reader()
    except Exception as error:  # the file may be third-party code: whatever it raises must name the reader
        kind = "" if isinstance(error, LdcError | ImportError) else f"{type(error).__name__}: "
        raise LdcError(where, f"cannot be loaded: {kind}{error}") from error
    if not isinstance(reader, RecordingReader):
        members = "name, title, vehicle_width, step, recognise, open"
        raise LdcError(where, "no reader of recordings", allowed=members)
    if reader.name != name:
        raise LdcError(where, f"its name is {reader.name!r}", allowed="the same as here")
    return reader


DEPTH: Final = 2  # folders inside a folder are looked into this many levels down

_TABLE: Final = re.compile(r"\.(csv|txt|csv\.gz|csv\.bz2|csv\.xz|csv\.zip)$", re.IGNORECASE)


def find_tables(paths: Iterable[Path], names: re.Pattern[str] = _TABLE) -> list[tuple[Path, bool]]:
    """Files named by the user, and files in named folders that may be tables by their names; each once."""
    tables: dict[str, tuple[Path, bool]] = {}
    for path in paths:
        by_user = not os.path.isdir(path)  # noqa: PTH112 - this one raises nothing, whatever the path
        for file in [path] if by_user else [file for file in _walk(path, DEPTH) if names.search(file.name)]:
            first, named = tables.get(real_path(file), (file, False))
            tables[real_path(file)] = (first, named or by_user)
    return list(tables.values())


def real_path(path: Path) -> str:
    """The path of a file behind all links."""
    try:
        return os.path.realpath(path)
    except ValueError:  # a NUL in the name; opening it tells
        return str(path)


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """Files in a folder and so many levels of folders below it, by name; hidden ones are left out."""
    try:
        inside = sorted(folder.iterdir(), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in inside:
        if os.path.isdir(entry):  # noqa: PTH112
            if depth > 0 and not entry.name.startswith("."):
                yield from _walk(entry, depth - 1)
        elif not entry.name.startswith(".") and os.path.isfile(entry):  # noqa: PTH113
            yield entry


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
    present, expected = list(map(same, columns)), list(map(same, (*required, *optional)))
    for name in (*required, *optional):
        if (count := present.count(same(name))) > 1:
            raise RecordingError("", f"column '{name}' appears {count} times", allowed="once")
    for name in required:
        if same(name) not in present:
            # the nearest name is looked for among the file's own, which is what its author has to rename
            unknown = [column for column in columns[:64] if column and same(column) not in expected]
            raise missing_column(name, unknown, f"needed: {', '.join(required)}")


def missing_column(name: str, unknown: Sequence[str], hint: str = "") -> RecordingError:
    """The error for a table that lacks a column; it proposes the nearest of the columns that are not known."""
    near = closest(name, unknown)
    proposal = textwrap.shorten(f"columns not known here: {', '.join(sorted(unknown))}", 400)
    if not unknown:
        proposal = "no other column of the file could be it"
    elif near:
        proposal = f"did you mean {near!r}? ({proposal})"
    return RecordingError("", f"column '{name}' is missing", hint="; ".join(filter(None, (proposal, hint))))


class CombinedReader:
    """Readers with the same vehicle width and step, for paths that hold files of each."""

    def __init__(self, readers: tuple[RecordingReader, ...]) -> None:
        self.readers = readers  # two or more, by name
        self.name = " + ".join(reader.name for reader in readers)
        self.title = "; ".join(reader.title for reader in readers)
        self.vehicle_width = readers[0].vehicle_width
        self.step = readers[0].step

    def recognise(self, paths: Sequence[Path]) -> str:
        """What each of the readers recognises."""
        texts = ((reader.name, reader.recognise(paths)) for reader in self.readers)
        return "; ".join(f"{name}: {text}" for name, text in texts if text)

    def open(self, paths: Sequence[Path]) -> FoundParts[RecordingPart]:
        """Look through the paths with each; each passes over the others' files."""
        sources: list[RecordingSource] = []
        errors: list[RecordingError] = []
        unread: list[Problem] = []
        reader_of: dict[str, str] = {}  # by a file's digest
        files = [path for path, _ in find_tables(paths)]
        names = shown_names(files)
        for reader in self.readers:
            try:
                source = reader.open(paths)
            except RecordingError as error:
                errors.append(error)
                recognised = (name for path, name in zip(files, names, strict=True) if reader.recognise([path]))
                unread.append(Problem(next(recognised, paths[0].name), "", str(error)))
                continue
            sources.append(source)
            for file in source.files:
                if reader_of.setdefault(file.sha256, reader.name) != reader.name:
                    raise RecordingError(
                        file.name,
                        f"several readers recognise this file ({self.recognise(paths)})",
                        hint="choose one with --format",
                    )
        if not sources:
            raise errors[0]
        files_of = [{file.name for file in source.files} for source in sources]
        read = set().union(*files_of)
        problems = [
            problem
            for source, names_read in zip(sources, files_of, strict=True)
            for problem in source.problems
            if problem.file in names_read or problem.file not in read  # else it is a file for another reader
        ]
        parts = tuple(part for source in sources for part in source.parts)
        return FoundParts(parts, tuple(file for source in sources for file in source.files), (*problems, *unread))


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
    lane: bool = True,
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
    lane : bool
        False where the lane is not needed: of MDF logs, signals of the vehicle at the times of the steering command.

    Examples
    --------
    >>> open_recordings("nowhere.csv")
    Traceback (most recent call last):
    ldctoolkit.errors.RecordingError: nowhere.csv: does not exist
    """
    sources = [Path(path) for path in ([paths] if isinstance(paths, str | os.PathLike) else paths)]
    if not sources:
        raise InputError("paths", "no file is given", hint="at least one file or folder of recordings is needed")
    seen: set[Path] = set()
    for path in sources:
        if not os.path.exists(path):  # noqa: PTH110 - this one raises nothing, whatever the path
            raise RecordingError(path, "does not exist")
        if path.resolve() in seen:
            raise RecordingError(path.name, "given twice")
        seen.add(path.resolve())
    reader, description = _recognised(sources) if format == AUTO else (recording_reader(format), "")
    if channels is not None:
        if not hasattr(reader, "channels"):
            problem, allowed = f"for format {reader.name!r}", "a channel map for MDF logs only"
            raise InputError("channels", problem, value=os.fspath(channels), allowed=allowed)
        of_vehicle = {"lane": False} if not lane and hasattr(reader, "lane") else {}
        reader = dataclasses.replace(reader, channels=Path(channels), **of_vehicle)  # type: ignore[type-var]
    try:
        source = reader.open(sources)
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
    return OpenedRecordings(reader, source, description or reader.title)


def _recognised(paths: list[Path]) -> tuple[RecordingReader, str]:
    """The reader for these paths, and what it recognises; several readers of the same options are combined."""
    matches: list[tuple[RecordingReader, str]] = []
    for reader in map(recording_reader, reader_names()):
        try:
            text = reader.recognise(paths)
        except Exception as error:  # the reader may be third-party code
            raise LdcError(
                f"format {reader.name!r}", f"recognise fails with {type(error).__name__}: {error}"
            ) from error
        if text:
            matches.append((reader, text))
    if len(matches) == 1:
        return matches[0]
    shown = ", ".join(path.name or str(path) for path in paths[:3]) + (", ..." if len(paths) > 3 else "")
    if not matches:
        raise RecordingError(
            shown,
            "no reader recognises this file",
            allowed=f"{', '.join(reader_names())} (with --format NAME a reader says what is missing)",
        )
    texts = "; ".join(f"{reader.name}: {text}" for reader, text in matches)
    readers = tuple(reader for reader, _ in matches)
    if len({(reader.vehicle_width, reader.step) for reader in readers}) > 1:
        raise RecordingError(shown, f"several readers recognise this file ({texts})", hint="choose one with --format")
    return CombinedReader(readers), texts


def read_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    format: str = AUTO,
    channels: str | os.PathLike[str] | None = None,
    lane: bool = True,
) -> Iterator[Recording]:
    r"""Read driving recordings, whole ones in the order of the files, and stop at the first fault.

    `paths`, `format`, `channels` and `lane` are those of `open_recordings`, which goes on with what is sound, and names
    what is not. The content is read, and checked, while iterating. Raises `RecordingError` as `open_recordings`; while
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
    return _sound(open_recordings(paths, format=format, channels=channels, lane=lane))


def _sound(opened: OpenedRecordings) -> Iterator[Recording]:
    """The recordings of a source; raises at its first problem."""
    source = opened.source
    for item in itertools.chain(source.problems, *(part.read() for part in source.parts)):
        if isinstance(item, Problem):
            raise item.error
        yield item
