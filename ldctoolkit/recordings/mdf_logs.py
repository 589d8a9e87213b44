"""Reader of ASAM MDF logs (.mf4, .mdf, .dat): a channel map says which channel holds what."""

from __future__ import annotations

import contextlib
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

import numpy as np
from pydantic import Field, ValidationError, model_validator

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.checked_files import read_toml
from ldctoolkit.errors import InputError, LdcError, RecordingError, closest, short
from ldctoolkit.recordings.preparation import LIMITS, LONGEST_GAP, MAX_GAP, clock_stretches, cut_at, joins_of, values_at
from ldctoolkit.recordings.recording import (
    LARGEST,
    FoundParts,
    Problem,
    Recording,
    find_tables,
    printable,
    shown_names,
    source_file,
)
from ldctoolkit.validation import Part, as_tuples, first_problem

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
"""Factors to SI, by dimension; a state has none. Upper case and blanks in a unit do not count."""


def si_factor(unit: str, dimension: str) -> float | None:
    """The factor from a unit to SI; None for a unit that is not known."""
    return UNITS[dimension].get(unit.lower().replace(" ", "").replace("⁻¹", "^-1"))


_LEFT, _RIGHT = r"(left|lft|_l_|_l$|^l_)", r"(right|rgt|_r_|_r$|^r_)"
_LINE, _TURN, _NO_SIDE = r"(lane|line|mark|dist)", r"(turn|blink|indicat)", rf"^(?!.*{_LEFT}|.*{_RIGHT}).*"
_COMMAND: Final = r"(cmd|command|req|target|desir|setp|demand)"
QUANTITIES: Final = {
    "steering_command": ("angle", rf"^(?!.*(rate|sp(ee)?d|vel|tor|val|qual)).*(steer.*{_COMMAND}|{_COMMAND}.*steer)"),
    "lane_offset": ("length", rf"{_NO_SIDE}((lane|lat|cent).*(off|dev|pos|dist)|(off|dev).*(lane|cent))"),
    "left_line": ("length", rf"^(?!.*width).*({_LINE}.*{_LEFT}|{_LEFT}.*{_LINE})"),
    "right_line": ("length", rf"^(?!.*width).*({_LINE}.*{_RIGHT}|{_RIGHT}.*{_LINE})"),
    "lane_width": ("length", r"lane.*width|width.*lane"),
    "speed": ("speed", r"^(?!.*(wh?e?e?l|eng|fan|yaw|lat)).*(speed|spd|veloc)"),
    "curvature": ("curvature", r"curv"),
    "yaw_rate": ("yaw rate", r"yaw.*(rate|vel|spd)|gyro.*z"),
    "heading": ("angle", r"^(?!.*(lane|line|rate|acc|valid|qual)).*(heading|course)"),
    "steering": (
        "angle",
        rf"^(?!.*(rate|sp(ee)?d|vel|tor|val|qual|{_COMMAND})).*(steer.*(ang|whl|wheel)|st_?whl.*ang|swa)",
    ),
    "lane": ("", r"lane.*(id$|id_|index|num)"),
    "turn_signal": ("", rf"{_NO_SIDE}{_TURN}"),
    "left_signal": ("", rf"{_TURN}.*{_LEFT}|{_LEFT}.*{_TURN}"),
    "right_signal": ("", rf"{_TURN}.*{_RIGHT}|{_RIGHT}.*{_TURN}"),
    "engaged": ("", r"(lka|lks|ldp|lcc|(lat|lane).*(ctrl|contr|assist|keep|cent)).*(activ|_act|act$|engag)"),
    "valid": ("", r"(lane|line).*(valid|qual|conf|prob)"),
}
"""Quantities of a channel map: the dimension, empty for a state, and a pattern of channel names that may hold it."""


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


_LANE: Final = ("lane_offset", "left_line", "right_line", "lane_width", "lane")


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
    steering_command: Channel | None = None
    valid: tuple[ValidChannel, ...] = ()  # all must hold
    lane: Channel | None = None
    turn_signal: Channel | None = None
    left_signal: Channel | None = None
    right_signal: Channel | None = None
    engaged: Channel | None = None  # above 0 while a system steers

    def named(self) -> list[tuple[str, Channel]]:
        """Quantities and their channels; that whose clock counts first: of the command, else of the lane's position."""
        single = [(name, channel) for name in QUANTITIES if isinstance(channel := getattr(self, name), Channel)]
        return single + [("valid", channel) for channel in self.valid]

    @model_validator(mode="after")
    def _complete(self) -> ChannelMap:
        for name, channel in self.named():
            dimension = QUANTITIES[name][0]
            if channel.unit is not None and si_factor(channel.unit, dimension) is None:
                allowed = ", ".join(UNITS[dimension]) or "none, it is a state"
                raise InputError(f"{name}.unit", f"of {channel.channel!r}", value=channel.unit, allowed=allowed)
        return self

    def of_lane(self) -> ChannelMap:
        """The map for departures; raises `InputError` where a quantity is missing."""
        lines = self.left_line and self.right_line
        if not (self.lane_offset or lines):
            raise InputError("lane_offset", "missing", hint="needed: this, or left_line and right_line")
        if not (self.lane_width or lines or self.constant_lane_width):
            hint = "needed: this, left_line and right_line, or constant_lane_width"
            raise InputError("lane_width", "missing", hint=hint)
        return self.model_copy(update={"steering_command": None})

    def of_vehicle(self) -> ChannelMap:
        """The map for signals of the vehicle, on the clock of the steering command; without the lane."""
        return self.model_copy(update={"valid": ()} | dict.fromkeys((*_LANE, "constant_lane_width")))


def read_channel_map(path: Path, *, lane: bool = True) -> ChannelMap:
    """Read a channel map in TOML; raises `InputError` naming the file, the key and what is allowed."""
    content = as_tuples(read_toml(path, InputError))
    try:
        channels = ChannelMap.model_validate(content)
        return channels.of_lane() if lane else channels.of_vehicle()
    except ValidationError as error:
        raise first_problem(error, content, ChannelMap, "map").within(path.name, ": ") from None
    except InputError as error:
        raise error.within(path.name, ": ") from None


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
    lane: bool = True  # whether departures are looked for; else signals of the vehicle alone are read
    name: str = "mdf"
    title: str = "ASAM MDF logs (.mf4, .mdf, .dat), with a channel map"
    vehicle_width: float = 1.9
    step: float | None = None

    def recognise(self, paths: Sequence[Path]) -> str:
        """How many logs there are."""
        count = len(_logs(paths))
        return f"{count} MDF log{'s' * (count > 1)}" if count else ""

    def open(self, paths: Sequence[Path]) -> FoundParts[LogPart]:
        """Look through files, or folders that hold them; a log that is no MDF is a problem of its part."""
        logs = _logs(paths)
        if not logs:
            raise RecordingError(paths[0].name, "no MDF log", allowed=".mf4, .mdf, and .dat that begin with MDF")
        _check_installed()
        if self.channels is None:
            allowed = "--channels MAP.toml (--list-channels prints one to start from)"
            raise RecordingError(logs[0].name, "needs a channel map", allowed=allowed)
        channels = read_channel_map(self.channels, lane=self.lane)
        files = [source_file(path, shown) for path, shown in zip(logs, shown_names(logs), strict=True)]
        parts = tuple(
            LogPart(str(path.absolute()), f"{i:05d}-{path.name}", file.bytes, file.name, channels)
            for i, (path, file) in enumerate(zip(logs, files, strict=True))
        )
        return FoundParts(parts, (*files, source_file(self.channels)), ())


READER: Final = MdfReader()


def _check_installed() -> None:
    if importlib.util.find_spec("asammdf") is None:
        hint = 'install the extra: pip install "ldctoolkit[mdf]"'
        raise LdcError("", "MDF logs need the package asammdf", hint=hint)


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
        raise error.within(path.name, ": ") from None


# In a damaged file the library follows links in circles without end, and its C code may write past its memory: of
# 10,000 files with changed bytes 21 ended the process or never came back. So logs are read in a process of their own.

PATIENCE: Final = 60.0  # [s] for a log to be read, and 1 s more for each megabyte
MEMORY: Final = 4 << 30  # [bytes] that the process may take, and eight times the log's size
_LOCK: Final = threading.Lock()


@functools.cache
def _process(owner: int) -> subprocess.Popen[bytes]:  # noqa: ARG001 - one for each process, also where they are forked
    """The process that parses logs for this one, ready to answer."""
    code = f"import sys; sys.path[:] = {sys.path!r}; from ldctoolkit.recordings.mdf_logs import serve; serve()"
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-P", "-c", code], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
    if not (process.stdout and process.stdout.read(1)):
        raise LdcError("", "MDF logs cannot be read: `import asammdf` fails")
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
                    raise RecordingError("", what) from None
            finally:
                timer.cancel()
                if answer is None:  # also after an interrupt: the next answer would be this one's
                    process.kill()
                    process.communicate()  # closes the pipes
                    _process.cache_clear()
        else:
            raise RecordingError("", "reading it as MDF ends the process; the file is damaged")
    if isinstance(answer, RecordingError):
        raise answer
    return answer


# What follows runs in that process.


def serve() -> None:
    """In the child process of the MDF reader: answer requests from standard input until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the library prints
    import asammdf  # takes seconds, which are not the first log's

    answers.write(b"!")
    answers.flush()
    with contextlib.suppress(EOFError):
        while True:
            path, size, shown, channels = pickle.load(sys.stdin.buffer)
            with contextlib.suppress(ImportError, ValueError, OSError):  # not every system has such limits
                import resource

                most = MEMORY + 8 * size
                resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
            try:
                with asammdf.MDF(path) as log:
                    answer: Any = _listing(log, shown) if channels is None else _recordings(log, shown, channels)
            except RecordingError as error:
                answer = error
            except BaseException as error:  # whatever a damaged file makes the library raise
                reason = " ".join(f"{type(error).__name__}: {error}".replace(path, shown).split())[:200]
                answer = RecordingError("", f"cannot be read as MDF; it is damaged, or none ({printable(reason)})")
            answers.write(pickle.dumps(answer))
            answers.flush()


def _group_names(group: Any, channel: Any) -> list[str]:
    """Names that a channel's group goes by: its own, in MDF 3 its comment, and those of its sources."""
    block = group.channel_group
    names = [block.acq_name if hasattr(block, "acq_name") else block.comment]
    for source in (getattr(block, "acq_source", None), channel.source):
        names += [getattr(source, "name", ""), getattr(source, "path", "")]
    return [name for name in names if name]


def _unit(log: Any, group: int, index: int) -> str:
    unit = getattr(log.groups[group].channels[index], "unit", "")  # of MDF 4; it overrides that of a shared conversion
    return (unit or log.get_channel_unit(group=group, index=index) or "").strip()


def _times(log: Any, group: int, name: str = "") -> FloatArray:
    """Times of a group [s], which holds the channel of that name; those that are not finite, or absurd, are NaN."""
    home = getattr(log.groups[group].channel_group, "cg_master_index", None)
    home = group if home is None else home
    master = log.masters_db.get(home)
    if master is None:
        raise RecordingError("", f"channel {name!r} has no time channel in its group {group}")
    factor = si_factor(_unit(log, home, master), "time")
    channel = log.groups[home].channels[master]
    if factor is None or getattr(channel, "sync_type", 1) != 1:
        what = f"channel {name!r} is over {channel.name!r}"
        raise RecordingError("", what, allowed="over a time in s, ms, us, ns")
    t = np.asarray(log.get_master(group), dtype=np.float64) * factor
    return np.where(np.abs(t) < 1e12, t, np.nan)


def _listing(log: Any, shown: str) -> str:
    """What `list_channels` gives."""
    import tomli_w

    rows: list[tuple[str, int, str, str, float, int]] = []  # name, number and name of its group, unit, rate, samples
    for i, group in enumerate(log.groups):
        with contextlib.suppress(RecordingError):
            t = _times(log, i)
            span = float(np.ptp(t)) if t.size else 0.0
            rate = (t.size - 1) / span if span > 0.0 else 0.0
            for j, channel in enumerate(group.channels):
                if j != log.masters_db.get(i):
                    name = next(iter(_group_names(group, channel)), "")
                    rows.append((channel.name, i, name, _unit(log, i, j), rate, t.size))
    lines = [f"{shown}: MDF {log.version}, {len(rows)} channels"]
    cells = [("channel", "group", "unit", "rate [Hz]", "samples")]
    cells += [(name, f"{i} {group}", unit, f"{rate:.4g}", str(n)) for name, i, group, unit, rate, n in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines += ["  ".join(map(str.ljust, row, widths)).rstrip() for row in cells]
    lines += ["A guess by names and units. Check it, and the signs: positive is to the left; scale = -1 turns one."]
    text = "".join(f"# {printable(line)}\n" for line in lines)
    rows.sort(key=lambda row: -row[4])  # of several channels the one that is sampled most often
    for quantity, (dimension, pattern) in QUANTITIES.items():
        for name, i, group, unit, _, _ in rows:
            if re.search(pattern, name.lower()) and (not dimension or not unit or si_factor(unit, dimension)):
                same = [row for row in rows if row[0] == name and group in ("", row[2])]
                units = [row[3] for row in same if row[1] == i]
                home: str | int = group if len(same) == len(units) else i
                guess: dict[str, Any] = {"channel": name} | ({} if home == "" else {"group": home})
                guess |= {"occurrence": units.index(unit) + 1} if len(units) > 1 else {}
                if dimension:
                    guess["unit"] = unit or "?"
                text += f"\n{'[[valid]]' if quantity == 'valid' else f'[{quantity}]'}\n{tomli_w.dumps(guess)}"
                break
        else:
            text += f"\n# {quantity}: no channel looks like it\n"
    return text


# a quantity, its channel, times and values of all samples, and rows for each time that its clock starts
_Signal = tuple[str, Channel, FloatArray, FloatArray, list[IntArray]]


@np.errstate(all="ignore")
def _recordings(log: Any, shown: str, channels: ChannelMap) -> list[Recording | Problem]:
    """The recordings of a log, one for each time that its clock starts, and what of them could not be used."""
    problems: dict[int, Problem] = {}
    signals: list[_Signal] = []
    for quantity, channel in channels.named():
        try:
            group, index = _locate(log, channel)
            t, values = _times(log, group, channel.channel), _in_si(log, group, index, channel, quantity)
        except RecordingError as error:
            raise error.within(quantity) from None
        timed = np.flatnonzero(np.isfinite(t))
        try:
            if timed.size < 1 + bool(QUANTITIES[quantity][0]):
                few = ("no samples", "only one sample")[timed.size] + " with a time" * (t.size > timed.size)
                raise RecordingError("", f"its group {group} has {few}")
            if timed.size > 1 and np.ptp(t[timed]) == 0.0:
                raise RecordingError("", f"all times of its group {group} are equal")
            starts = [timed[rows] for rows in clock_stretches(t[timed])]
            signals.append((quantity, channel, t, values, starts))
            if len(starts) != len(signals[0][-1]):
                what = f"{len(starts)}, that of {signals[0][1].channel!r} is {len(signals[0][-1])}"
                raise RecordingError("", f"the number of starts of its clock is {what}", allowed="the same")
        except RecordingError as error:
            what = f"channel {channel.channel!r} cannot be placed in time: {error.problem}"
            raise RecordingError(quantity, what, allowed=error.allowed) from None
        if lost := t.size - sum(rows.size for rows in starts):
            what = f"{lost} samples have no time, or one that runs backwards; left out"
            problems[group] = Problem(shown, f"group {group}", what)
    if len(starts) > 1:
        problems[-1] = Problem(shown, "", f"the clock starts again; the log is read as {len(starts)} recordings")
    answer: list[Recording | Problem] = [*problems.values()]
    for k in range(len(starts)):
        name = f"{shown} ({k + 1})" if k else shown
        try:
            answer.append(Recording(name, source=shown, **_columns(signals, k, channels)))
        except RecordingError as error:
            answer.append(Problem(name, "", str(error)))
    return answer


def _columns(signals: list[_Signal], k: int, channels: ChannelMap) -> dict[str, Any]:
    """Columns of the recording of one stretch, at the times of the lane's position."""
    values_of: dict[str, FloatArray] = {}
    base = signals[0][2][signals[0][-1][k]]
    valid = np.ones(base.size, dtype=bool)
    for quantity, channel, t, samples, starts in signals:
        values = values_of[quantity] = _resampled(base, t[starts[k]], samples[starts[k]], quantity, channels.max_gap)
        if QUANTITIES[quantity][0] and not np.isfinite(values).any():
            what = f"at the times of {signals[0][1].channel!r}, or none within max_gap = {channels.max_gap:g} s"
            raise RecordingError(quantity, f"channel {channel.channel!r} has no number {what}")
        if isinstance(channel, ValidChannel):
            valid &= values > 0.0 if channel.min is None else values >= channel.min
    columns: dict[str, Any] = {name: values_of[name] for name in Recording.COLUMNS if name in values_of}
    left, right = (values_of.get(name, np.full(base.size, np.nan)) for name in ("left_line", "right_line"))
    columns.setdefault("lane_offset", -0.5 * (left + right))
    if channels.constant_lane_width is not None:
        columns["lane_width"] = np.full(base.size, channels.constant_lane_width)
    elif "lane_width" not in values_of:
        columns["lane_width"] = left - right
    if "lane" in values_of:
        valid &= np.isfinite(values_of["lane"])
        columns["lane"] = np.unique(values_of["lane"], return_inverse=True)[1].astype(np.int64)
    if {"turn_signal", "left_signal", "right_signal"} & values_of.keys():
        off = np.zeros(base.size)
        turn, to_left, to_right = (values_of.get(name, off) for name in ("turn_signal", "left_signal", "right_signal"))
        # what is missing is none, and so are both at once
        columns["turn_signal"] = ((turn > 0.0) | (to_left > 0.0)).astype(np.int64) - ((turn < 0.0) | (to_right > 0.0))
    if "engaged" in values_of:
        columns["engaged"] = values_of["engaged"] > 0.0
    joins = np.concatenate([joins_of(t, starts[k]) for _, _, t, _, starts in signals])
    cut, inside = cut_at(base, joins)
    return columns | {"t": base, "valid": valid & ~inside, "cut": cut}


def _locate(log: Any, entry: Channel) -> tuple[int, int]:
    """Group and index of the channel that an entry of the map means; a group without samples gives way to others."""
    candidates = [
        (i, j, _group_names(group, channel))
        for i, group in enumerate(log.groups)
        for j, channel in enumerate(group.channels)
        if channel.name == entry.channel
    ]
    fits = [candidate for candidate in candidates if entry.group in (None, candidate[0], *candidate[2])]
    fits = [candidate for candidate in fits if log.groups[candidate[0]].channel_group.cycles_nr] or fits
    if len({candidate[0] for candidate in fits}) == 1:
        matches = fits if entry.occurrence is None else fits[entry.occurrence - 1 : entry.occurrence]
        if len(matches) == 1:
            return matches[0][:2]
        what = (
            f"names {len(fits)} of the channels of group {fits[0][0]}; `occurrence`: {entry.occurrence or 'not given'}"
        )
        raise RecordingError("", f"channel {entry.channel!r} {what}", allowed=f"1 to {len(fits)}, in their order")
    if candidates:
        groups = ", ".join(f"{i} ({names[0]})" if names else str(i) for i, _, names in candidates)
        stated = "not given" if entry.group is None else repr(entry.group)
        what = f"channel {entry.channel!r} is in the groups {groups}; `group`: {stated}"
        raise RecordingError("", what, allowed="the name or number of one")
    near = closest(entry.channel, [channel.name for group in log.groups for channel in group.channels], 0.6)
    hint = f"{f'did you mean {near!r}? ' if near else ''}see --list-channels"
    raise RecordingError("", f"channel {entry.channel!r} is not in the log", hint=hint)


def _in_si(log: Any, group: int, index: int, entry: Channel, quantity: str) -> FloatArray:
    """Samples in SI, texts by the map's `values`; invalid ones are NaN."""
    factor, dimension, unit = 1.0, QUANTITIES[quantity][0], _unit(log, group, index)
    name = f"channel {entry.channel!r}"
    if dimension:
        stated_factor = si_factor(unit if entry.unit is None else entry.unit, dimension)
        if stated_factor is None:
            allowed = f"{', '.join(UNITS[dimension])}, or a `unit` in the map"
            raise RecordingError("", f"{name} has the unit {unit!r} in the log", allowed=allowed)
        if unit and si_factor(unit, dimension) != stated_factor and any(si_factor(unit, any_) for any_ in UNITS):
            allowed = "the same, or no `unit` and a `scale` where the log is wrong"
            raise RecordingError("", f"{name} is in {unit} in the log, in {entry.unit} in the map", allowed=allowed)
        factor = stated_factor
    samples, invalid = log.get(group=group, index=index, samples_only=True, ignore_invalidation_bits=True)
    if samples.dtype.kind not in "biufSUO" or samples.ndim != 1:
        what = f"{name} holds {samples.dtype} of the shape {samples.shape}"
        raise RecordingError("", what, allowed="a number or text at a time")
    if entry.values is not None:
        table = entry.values
        numbers = np.array([table.get(_sample_text(sample), np.nan) for sample in samples.tolist()], dtype=np.float64)
    elif samples.dtype.kind in "biuf":
        numbers = samples.astype(np.float64)
    else:
        texts = ", ".join(map(short, list(dict.fromkeys(map(_sample_text, samples.tolist())))[:3]))
        raise RecordingError("", f"{name} holds texts ({texts})", allowed="numbers, or `values` for them in the map")
    if getattr(log.groups[group].channels[index], "flags", 0) & 1:  # of MDF 4: all are invalid, with or without bits
        numbers[:] = np.nan
    elif invalid is not None:
        numbers[invalid.astype(bool)] = np.nan
    beyond = numbers[np.abs(numbers) > 1.0]
    if quantity.endswith("_signal") and entry.values is None and beyond.size:  # 2 is to the right in many logs
        allowed = "-1, 0, 1, or `values` for them in the map"
        raise RecordingError("", f"{name} holds the number {beyond[0]:g}", allowed=allowed)
    return numbers * factor * entry.scale + entry.offset


def _sample_text(sample: object) -> str:
    """A sample of a text or number channel, as text."""
    if isinstance(sample, bytes):
        try:
            text = sample.decode("utf-8")
        except UnicodeDecodeError:  # of MDF 3 and of some channels of MDF 4
            text = sample.decode("latin-1")
        return text.strip("\0 ")
    return f"{sample:.15g}" if isinstance(sample, int | float) else str(sample)


def _resampled(base: FloatArray, t: FloatArray, values: FloatArray, quantity: str, max_gap: float) -> FloatArray:
    """Values at other times: states are held, the rest is interpolated; NaN beyond the ends, in gaps, next to NaN."""
    if np.array_equal(base, t):  # sample by sample, also where several share a time
        return values
    newest = np.append(t[1:] > t[:-1], True)
    t, values = t[newest], values[newest]
    i = np.searchsorted(t, base, "right") - 1
    before, after = np.maximum(i, 0), np.minimum(i + 1, t.size - 1)
    if not QUANTITIES[quantity][0]:
        longest = max_gap if quantity == "valid" else np.inf  # a switch may be recorded only when it changes
        return np.where((i >= 0) & (base - t[before] <= longest), values[before], np.nan)
    if quantity == "heading":
        finite = np.abs(values) < LARGEST
        values[finite] = np.unwrap(values[finite])
    between = values_at(base, t, values, longest=max_gap, beyond=0.0)
    beside = np.where(base - t[before] <= t[after] - base, values[before], values[after])
    limits = LIMITS.get(quantity, LIMITS["lane_offset"])  # else of a line
    jump = np.isfinite(between) & (np.abs(values[after] - values[before]) > limits.jump)
    return np.where(jump & (base > t[before]), beside, between)
