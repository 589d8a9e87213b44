"""Recordings of a lane-keeping camera: signals over time, where they came from, and what is wrong with them."""

from __future__ import annotations

import dataclasses
import hashlib
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar, Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, ReadOnly
from ldctoolkit.errors import RecordingError


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


def _text(value: object, what: str) -> str:
    """A text in a form that can be printed."""
    if not isinstance(value, str):
        raise RecordingError(f"{what} is of type {type(value).__name__}; allowed: str")
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
            object.__setattr__(self, attribute, _text(getattr(self, attribute), f"a label's {attribute}"))


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
        """What an error says of a file; its path is the place in it."""
        return cls(file, error.path, "; ".join(text for text in (error.without_path, outcome) if text))

    def __str__(self) -> str:
        return f"{self.file}, {self.place}: {self.what}" if self.place else f"{self.file}: {self.what}"


@dataclasses.dataclass(frozen=True)
class Recording(ReadOnly):
    """m samples of one drive, in SI units and with the signs of ISO 8855.

    What every reader gives. Numbers of samples that cannot be used may be NaN. Texts are made printable. Raises
    `RecordingError` for columns of different lengths, times that fall or are not finite, an empty name, or what is no
    text.

    Examples
    --------
    >>> t = np.arange(3) * 0.1
    >>> one = Recording("a", t, np.zeros(3), np.full(3, 3.6), np.full(3, 25.0), np.ones(3, bool))
    >>> one.samples
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
        "steering", "engaged", "cut", "yaw_rate_measured",
    )  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        name = _text(self.name, "a recording's name")
        if not name:
            raise RecordingError("a recording's name is empty")
        if name != self.name:  # names that differ in what cannot be printed alone still have to differ
            digest = hashlib.blake2b(self.name.encode("utf-8", "surrogatepass"), digest_size=4).hexdigest()
            object.__setattr__(self, "name", f"{name} ({digest})")
        whose = f"recording {self.name!r}:"
        object.__setattr__(self, "source", _text(self.source, f"{whose} source"))
        for attribute, kind in (("notes", str), ("labels", Label)):
            values = getattr(self, attribute)
            if not isinstance(values, tuple | list) or not all(isinstance(value, kind) for value in values):
                raise RecordingError(f"{whose} {attribute} are {values!r:.60}; allowed: a tuple of {kind.__name__}")
        object.__setattr__(self, "notes", tuple(map(printable, self.notes)))
        object.__setattr__(self, "labels", tuple(self.labels))
        for column in self.COLUMNS:
            values = getattr(self, column)
            if values is not None and values.shape != (self.samples,):
                what = f"{column} has the shape {values.shape}; allowed: ({self.samples},), as t"
                raise RecordingError(f"{whose} {what}")
        if not np.isfinite(self.t).all():
            raise RecordingError(f"{whose} t[{int(np.argmin(np.isfinite(self.t)))}] is not finite")
        if (self.t[1:] < self.t[:-1]).any():
            i = int(np.argmax(self.t[1:] < self.t[:-1]))
            what = f"t[{i + 1}] = {float(self.t[i + 1])!r} s after {float(self.t[i])!r} s"
            raise RecordingError(f"{whose} {what}; allowed: times that do not fall")

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
    """NaN for numbers of absurd size, which are none; sums of such would overflow."""
    return np.where(np.abs(values) < LARGEST, values, np.nan)


def usable_samples(samples: RecordingTable | Recording) -> BoolArray:
    """Samples that the source allows and whose numbers that take part are there, (m,); times are not looked at."""
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
    offsets: IntArray  # (r + 1,): recording i owns the samples ``offsets[i]:offsets[i + 1]``
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
    """The same with other values in some of the columns, as far as they are there."""
    columns = {name: getattr(samples, name) for name in names}
    changed = {name: change(values) for name, values in columns.items() if values is not None}
    return dataclasses.replace(samples, **changed)
