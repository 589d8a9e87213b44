"""Reader of ASAM MDF logs (.mf4, .mdf, .dat): a channel map says which channel holds what."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import math
import os
import pickle
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from pydantic import Field, ValidationError, model_validator

from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.preparation import LONGEST_GAP, MAX_GAP
from ldctoolkit.recordings.recording import Problem, Recording, source_file
from ldctoolkit.recordings.sources import FoundParts, find_tables, shown_names
from ldctoolkit.validation import Part, as_tuples, fail, first_problem
from ldctoolkit.whole_file import read_toml

_NAMES: Final = re.compile(r"\.(mf4|mdf|dat)$", re.IGNORECASE)

_DEG: Final = math.pi / 180.0
UNITS: Final = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 1e-3, "ft": 0.3048, "in": 0.0254},
    "speed": {"m/s": 1.0, "km/h": 1 / 3.6, "kph": 1 / 3.6, "kmh": 1 / 3.6, "mph": 0.44704, "kn": 1852 / 3600},
    "curvature": {"1/m": 1.0, "m^-1": 1.0, "rad/m": 1.0, "1/km": 1e-3, "km^-1": 1e-3},
    "yaw rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEG, "°/s": _DEG, "deg/sec": _DEG},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": _DEG, "°": _DEG},
    "time": {"s": 1.0, "": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "": {},
}
"""Factors to SI, by what is measured, none for a state; capital letters and blanks do not count."""


def si_factor(unit: str, dimension: str) -> float | None:
    """SI for one of a unit; None for a unit that is not known."""
    return UNITS[dimension].get(unit.lower().replace(" ", "").replace("⁻¹", "^-1"))


_LEFT, _RIGHT = r"(left|lft|_l_|_l$|^l_)", r"(right|rgt|_r_|_r$|^r_)"
_LINE, _TURN, _NO_SIDE = r"(lane|line|mark|dist)", r"(turn|blink|indicat)", rf"^(?!.*{_LEFT}|.*{_RIGHT}).*"
QUANTITIES: Final = {
    "lane_offset": ("length", rf"{_NO_SIDE}((lane|lat|cent).*(off|dev|pos|dist)|(off|dev).*(lane|cent))"),
    "left_line": ("length", rf"^(?!.*width).*({_LINE}.*{_LEFT}|{_LEFT}.*{_LINE})"),
    "right_line": ("length", rf"^(?!.*width).*({_LINE}.*{_RIGHT}|{_RIGHT}.*{_LINE})"),
    "lane_width": ("length", r"lane.*width|width.*lane"),
    "speed": ("speed", r"^(?!.*(wh?e?e?l|eng|fan|yaw|lat)).*(speed|spd|veloc)"),
    "curvature": ("curvature", r"curv"),
    "yaw_rate": ("yaw rate", r"yaw.*(rate|vel|spd)|gyro.*z"),
    "heading": ("angle", r"^(?!.*(lane|line|rate|acc|valid|qual)).*(heading|course)"),
    "steering": ("angle", r"^(?!.*(rate|sp(ee)?d|vel|tor|val|qual)).*(steer.*(ang|whl|wheel)|st_?whl.*ang|swa)"),
    "lane": ("", r"lane.*(id$|id_|index|num)"),
    "turn_signal": ("", rf"{_NO_SIDE}{_TURN}"),
    "left_signal": ("", rf"{_TURN}.*{_LEFT}|{_LEFT}.*{_TURN}"),
    "right_signal": ("", rf"{_TURN}.*{_RIGHT}|{_RIGHT}.*{_TURN}"),
    "engaged": ("", r"(lka|lks|ldp|lcc|(lat|lane).*(ctrl|contr|assist|keep|cent)).*(activ|_act|act$|engag)"),
    "valid": ("", r"(lane|line).*(valid|qual|conf|prob)"),
}
"""What a map may name: what is measured, empty for a state, and the names of channels that may hold it."""


class Channel(Part):
    """The channel of one quantity; in SI it is the value in its unit times `scale`, plus `offset`."""

    channel: str  # its name in the log
    group: str | int | None = None  # name of its group or source, or the group's number
    occurrence: int | None = Field(default=None, ge=1)  # which of those that share the name in one group
    unit: str | None = None  # None for that of the log
    scale: float = 1.0  # -1 where it is positive to the right
    offset: float = 0.0  # in SI
    values: dict[str, float] | None = None  # number of each text or state; those not listed are missing


class ValidChannel(Channel):
    """A channel that says whether a sample counts."""

    min: float | None = None  # the least value that is valid; None for any above 0


class ChannelMap(Part):
    """Which channel of a log holds what."""

    max_gap: float = Field(default=MAX_GAP, gt=0.0, le=LONGEST_GAP)  # [s] longest time between samples that is bridged
    constant_lane_width: float | None = Field(default=None, gt=0.0)  # [m] in place of any other width
    lane_offset: Channel | None = None
    left_line: Channel | None = None  # position of a line [m] from the vehicle's centre, positive to the left
    right_line: Channel | None = None
    lane_width: Channel | None = None
    speed: Channel
    curvature: Channel | None = None
    yaw_rate: Channel | None = None
    heading: Channel | None = None
    steering: Channel | None = None
    valid: tuple[ValidChannel, ...] = ()  # all must hold
    lane: Channel | None = None
    turn_signal: Channel | None = None
    left_signal: Channel | None = None
    right_signal: Channel | None = None
    engaged: Channel | None = None  # above 0 while a system steers

    def named(self) -> list[tuple[str, Channel]]:
        """Quantities and their channels, that of the lane's position first."""
        single = [(name, one) for name in QUANTITIES if isinstance(one := getattr(self, name), Channel)]
        return single + [("valid", one) for one in self.valid]

    @model_validator(mode="after")
    def _complete(self) -> ChannelMap:
        for name, one in self.named():
            dimension = QUANTITIES[name][0]
            if one.unit is not None and si_factor(one.unit, dimension) is None:
                allowed = ", ".join(UNITS[dimension]) or "none, it is a state"
                raise fail(f"{name}.unit", f"{one.unit!r}, of {one.channel!r}; allowed: {allowed}")
        lines = self.left_line and self.right_line
        if not (self.lane_offset or lines):
            raise fail("lane_offset", "missing; needed: this, or left_line and right_line")
        if not (self.lane_width or lines or self.constant_lane_width):
            raise fail("lane_width", "missing; needed: this, left_line and right_line, or constant_lane_width")
        return self


def read_channel_map(path: Path) -> ChannelMap:
    """Read a channel map in TOML; raises `InputError` naming the file, the key and what is allowed."""
    content = as_tuples(read_toml(path, InputError))
    try:
        return ChannelMap.model_validate(content)
    except ValidationError as error:
        raise InputError(path.name, f"{first_problem(error, content, ChannelMap, 'map')}") from None


@dataclasses.dataclass(frozen=True)
class LogPart:
    """One log: a recording, or several where its clock starts again."""

    path: str
    key: str
    bytes: int
    shown: str  # its name in messages
    channels: ChannelMap

    def read(self) -> Iterator[Recording | Problem]:
        """The recordings, and what of them could not be used."""
        try:
            yield from _ask(self.path, self.bytes, self.shown, self.channels)
        except RecordingError as error:
            yield Problem(self.shown, "", str(error))


@dataclasses.dataclass(frozen=True)
class MdfReader:
    """Reads MDF logs with a channel map; see `RecordingReader`."""

    channels: Path | None = None  # the map, a TOML file
    name: str = "mdf"
    title: str = "ASAM MDF logs (.mf4, .mdf, .dat), with a channel map"
    vehicle_width: float = 1.9
    step: float | None = None

    def recognise(self, paths: Sequence[Path]) -> str:
        """How many logs there are."""
        found = len(_logs(paths))
        return f"{found} MDF log{'s' * (found > 1)}" if found else ""

    def open(self, paths: Sequence[Path]) -> FoundParts[LogPart]:
        """Look through files, or folders that hold them; a log that is no MDF is a problem of its part."""
        logs = _logs(paths)
        if not logs:
            raise RecordingError(f"{paths[0].name}", "no MDF log", allowed=".mf4, .mdf, and .dat that begin with MDF")
        _check_installed()
        if self.channels is None:
            what = "needs a channel map; allowed: --channels MAP.toml (--list-channels prints one to start from)"
            raise RecordingError(f"{logs[0].name}", what)
        channels = read_channel_map(self.channels)
        files = [source_file(path, shown) for path, shown in zip(logs, shown_names(logs), strict=True)]
        parts = tuple(
            LogPart(str(path.absolute()), f"{i:05d}-{path.name}", file.bytes, file.name, channels)
            for i, (path, file) in enumerate(zip(logs, files, strict=True))
        )
        return FoundParts(parts, (*files, source_file(self.channels)), ())


READER: Final = MdfReader()


def _check_installed() -> None:
    if importlib.util.find_spec("asammdf") is None:
        raise LdcError('MDF logs need the package asammdf; install the extra: pip install "ldctoolkit[mdf]"')


def _logs(paths: Sequence[Path]) -> list[Path]:
    """Logs among files and in folders, by their names; any program's data may be called .dat."""
    files = (path for path, _ in find_tables(paths, _NAMES) if os.path.isfile(path))  # noqa: PTH113 - it raises nothing
    return [path for path in files if _NAMES.search(path.name) and _is_log(path)]


def _is_log(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return path.suffix.lower() != ".dat" or stream.read(3) in (b"MDF", b"UnF")  # not finalised
    except (OSError, ValueError):  # no file, or a NUL in the name
        return False


def list_channels(path: Path) -> str:
    """Channels of a log, as comments, and a guess of its channel map, in TOML.

    Raises `RecordingError` for what is no MDF log, `LdcError` without asammdf.
    """
    _check_installed()
    size = source_file(path).bytes  # refuses what cannot be read at all
    try:
        return str(_ask(str(path.absolute()), size, path.name, None))
    except RecordingError as error:
        raise RecordingError(path.name, f"{error}") from None


# In a damaged file the library follows links in circles without end, and its C code may write past its memory: of
# 10,000 files with changed bytes 21 ended the process or never came back. So logs are read in a process of their own.

PATIENCE: Final = 60.0  # [s] for a log to be read, and 1 s more for each megabyte
MEMORY: Final = 4 << 30  # [bytes] that the process may take, and eight times the log's size
_LOCK: Final = threading.Lock()


@functools.cache
def _process(owner: int) -> subprocess.Popen[bytes]:  # noqa: ARG001 - one for each process, also where they are forked
    code = f"import sys; sys.path[:] = {sys.path!r}; from ldctoolkit.recordings.mdf_content import serve; serve()"
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-P", "-c", code], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
    if not (process.stdout and process.stdout.read(1)):
        raise LdcError("MDF logs cannot be read: `import asammdf` fails")
    return process


def _ask(path: str, size: int, shown: str, channels: ChannelMap | None) -> Any:
    """What the reading process makes of a log; raises `RecordingError` with its reason, or where it has to be ended."""
    limit = PATIENCE + size / 1e6
    with _LOCK:
        for _ in range(2):  # once more, since memory that an earlier log has spoilt may end the process, too
            process, answer = _process(os.getpid()), None
            timer, end = threading.Timer(limit, process.kill), time.monotonic() + limit
            timer.start()
            try:
                process.stdin.write(pickle.dumps((path, size, shown, channels)))  # type: ignore[union-attr]
                process.stdin.flush()  # type: ignore[union-attr]
                answer = pickle.load(process.stdout)  # type: ignore[arg-type]
                break
            except (OSError, EOFError, pickle.UnpicklingError):
                if time.monotonic() >= end:
                    what = f"reading it as MDF takes longer than {limit:.0f} s; the file is damaged"
                    raise RecordingError(what) from None
            finally:
                timer.cancel()
                if answer is None:  # also after an interrupt: the next answer would be this one's
                    process.kill()
                    process.communicate()  # closes the pipes
                    _process.cache_clear()
        else:
            raise RecordingError("reading it as MDF ends the process; the file is damaged")
    if isinstance(answer, RecordingError):
        raise answer
    return answer
