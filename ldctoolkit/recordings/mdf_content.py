"""What MDF logs hold: channels and their guessed map, and recordings; in the process that `mdf_logs` reads in."""

from __future__ import annotations

import contextlib
import difflib
import os
import pickle
import re
import sys
from typing import Any

import numpy as np
import tomli_w

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import RecordingError, short
from ldctoolkit.recordings.mdf_logs import MEMORY, QUANTITIES, UNITS, Channel, ChannelMap, ValidChannel, si_factor
from ldctoolkit.recordings.preparation import LIMITS, clock_stretches, cut_at, joins_of, values_at
from ldctoolkit.recordings.recording import LARGEST, Problem, Recording, printable


def serve() -> None:
    """Answer requests from standard input until it ends."""
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
                answer = RecordingError(f"cannot be read as MDF; it is damaged, or none ({printable(reason)})")
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
    own = getattr(log.groups[group].channels[index], "unit", "")  # of MDF 4; it overrides that of a shared conversion
    return (own or log.get_channel_unit(group=group, index=index) or "").strip()


def _times(log: Any, group: int) -> FloatArray:
    """Times of a group [s]; those that are not finite, or absurd, are NaN."""
    home = getattr(log.groups[group].channel_group, "cg_master_index", None)
    home = group if home is None else home
    master = log.masters_db.get(home)
    if master is None:
        raise RecordingError(f"has no time channel in its group {group}")
    factor = si_factor(_unit(log, home, master), "time")
    channel = log.groups[home].channels[master]
    if factor is None or getattr(channel, "sync_type", 1) != 1:
        raise RecordingError(f"is over {channel.name!r}; allowed: over a time in s, ms, us, ns")
    t = np.asarray(log.get_master(group), dtype=np.float64) * factor
    return np.where(np.abs(t) < 1e12, t, np.nan)


def _listing(log: Any, shown: str) -> str:
    """What `list_channels` gives."""
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
    found: list[_Signal] = []
    for quantity, one in channels.named():
        try:
            lead = f"{quantity}: channel {one.channel!r} "
            group, index = _place(log, one)
            t, values = _times(log, group), _in_si(log, group, index, one, quantity)
            lead += "cannot be placed in time: "
            known = np.flatnonzero(np.isfinite(t))
            if known.size < 1 + bool(QUANTITIES[quantity][0]):
                few = ("no samples", "only one sample")[known.size] + " with a time" * (t.size > known.size)
                raise RecordingError(f"its group {group} has {few}")
            if known.size > 1 and np.ptp(t[known]) == 0.0:
                raise RecordingError(f"all times of its group {group} are equal")
            starts = [known[rows] for rows in clock_stretches(t[known])]
            found.append((quantity, one, t, values, starts))
            if len(starts) != len(found[0][-1]):
                what = f"{len(starts)}, that of {found[0][1].channel!r} is {len(found[0][-1])}; allowed: the same"
                raise RecordingError(f"the number of starts of its clock is {what}")
        except RecordingError as error:
            raise RecordingError(f"{lead}{error}") from None
        if lost := t.size - sum(rows.size for rows in starts):
            what = f"{lost} samples have no time, or one that runs backwards; left out"
            problems[group] = Problem(shown, f"group {group}", what)
    if len(starts) > 1:
        problems[-1] = Problem(shown, "", f"the clock starts again; the log is read as {len(starts)} recordings")
    answer: list[Recording | Problem] = [*problems.values()]
    for k in range(len(starts)):
        name = f"{shown} ({k + 1})" if k else shown
        try:
            answer.append(Recording(name, source=shown, **_columns(found, k, channels)))
        except RecordingError as error:
            answer.append(Problem(name, "", str(error)))
    return answer


def _columns(signals: list[_Signal], k: int, channels: ChannelMap) -> dict[str, Any]:
    """Columns of the recording of one stretch, at the times of the lane's position."""
    found: dict[str, FloatArray] = {}
    base = signals[0][2][signals[0][-1][k]]
    valid = np.ones(base.size, dtype=bool)
    for quantity, one, t, samples, starts in signals:
        values = found[quantity] = _at(base, t[starts[k]], samples[starts[k]], quantity, channels.max_gap)
        if QUANTITIES[quantity][0] and not np.isfinite(values).any():
            what = f"at the times of {signals[0][1].channel!r}, or none within max_gap = {channels.max_gap:g} s"
            raise RecordingError(quantity, f"channel {one.channel!r} has no number {what}")
        if isinstance(one, ValidChannel):
            valid &= values > 0.0 if one.min is None else values >= one.min
    columns: dict[str, Any] = {name: found[name] for name in Recording.COLUMNS if name in found}
    if "lane_offset" not in found:
        columns["lane_offset"] = -0.5 * (found["left_line"] + found["right_line"])
    if channels.constant_lane_width is not None:
        columns["lane_width"] = np.full(base.size, channels.constant_lane_width)
    elif "lane_width" not in found:
        columns["lane_width"] = found["left_line"] - found["right_line"]
    if "lane" in found:
        valid &= np.isfinite(found["lane"])
        columns["lane"] = np.unique(found["lane"], return_inverse=True)[1].astype(np.int64)
    if {"turn_signal", "left_signal", "right_signal"} & found.keys():
        off = np.zeros(base.size)
        turn, left, right = (found.get(name, off) for name in ("turn_signal", "left_signal", "right_signal"))
        # what is missing is none, and so are both at once
        columns["turn_signal"] = ((turn > 0.0) | (left > 0.0)).astype(np.int64) - ((turn < 0.0) | (right > 0.0))
    if "engaged" in found:
        columns["engaged"] = found["engaged"] > 0.0
    joins = np.concatenate([joins_of(t, starts[k]) for _, _, t, _, starts in signals])
    cut, inside = cut_at(base, joins)
    return columns | {"t": base, "valid": valid & ~inside, "cut": cut if joins.size else None}


def _place(log: Any, one: Channel) -> tuple[int, int]:
    """Group and place of the one channel that is meant; groups without samples do not count beside others."""
    there = [
        (i, j, _group_names(group, channel))
        for i, group in enumerate(log.groups)
        for j, channel in enumerate(group.channels)
        if channel.name == one.channel
    ]
    fits = [place for place in there if one.group in (None, place[0], *place[2])]
    fits = [place for place in fits if log.groups[place[0]].channel_group.cycles_nr] or fits
    if len({place[0] for place in fits}) == 1:
        chosen = fits if one.occurrence is None else fits[one.occurrence - 1 : one.occurrence]
        if len(chosen) == 1:
            return chosen[0][:2]
        what = f"`occurrence`: {one.occurrence or 'not given'}; allowed: 1 to {len(fits)}, in their order"
        raise RecordingError(f"names {len(fits)} of the channels of group {fits[0][0]}; {what}")
    if there:
        groups = ", ".join(f"{i} ({names[0]})" if names else str(i) for i, _, names in there)
        given = "not given" if one.group is None else repr(one.group)
        raise RecordingError(f"is in the groups {groups}; `group`: {given}; allowed: the name or number of one")
    near = difflib.get_close_matches(one.channel, {other.name for group in log.groups for other in group.channels}, n=1)
    raise RecordingError(f"is not in the log; {f'did you mean {near[0]!r}? ' if near else ''}see --list-channels")


def _in_si(log: Any, group: int, index: int, one: Channel, quantity: str) -> FloatArray:
    """Samples in SI, texts by the map's `values`; invalid ones are NaN."""
    factor, dimension, own = 1.0, QUANTITIES[quantity][0], _unit(log, group, index)
    if dimension:
        known = si_factor(own if one.unit is None else one.unit, dimension)
        if known is None:
            allowed = ", ".join(UNITS[dimension])
            raise RecordingError(f"has the unit {own!r} in the log; allowed: {allowed}, or a `unit` in the map")
        if own and si_factor(own, dimension) != known and any(si_factor(own, other) for other in UNITS):
            what = "the same, or no `unit` and a `scale` where the log is wrong"
            raise RecordingError(f"is in {own} in the log, in {one.unit} in the map; allowed: {what}")
        factor = known
    samples, invalid = log.get(group=group, index=index, samples_only=True, ignore_invalidation_bits=True)
    if samples.dtype.kind not in "biufSUO" or samples.ndim != 1:
        raise RecordingError(f"holds {samples.dtype} of the shape {samples.shape}; allowed: a number or text at a time")
    if one.values is not None:
        table = one.values
        numbers = np.array([table.get(_text(sample), np.nan) for sample in samples.tolist()], dtype=np.float64)
    elif samples.dtype.kind in "biuf":
        numbers = samples.astype(np.float64)
    else:
        some = ", ".join(map(short, list(dict.fromkeys(map(_text, samples.tolist())))[:3]))
        raise RecordingError(f"holds texts ({some}); allowed: numbers, or `values` for them in the map")
    if getattr(log.groups[group].channels[index], "flags", 0) & 1:  # of MDF 4: all are invalid, with or without bits
        numbers[:] = np.nan
    elif invalid is not None:
        numbers[invalid.astype(bool)] = np.nan
    other = numbers[np.abs(numbers) > 1.0]
    if quantity.endswith("_signal") and one.values is None and other.size:  # 2 is to the right in many logs
        raise RecordingError(f"holds the number {other[0]:g}; allowed: -1, 0, 1, or `values` for them in the map")
    return numbers * factor * one.scale + one.offset


def _text(sample: object) -> str:
    if isinstance(sample, bytes):
        try:
            text = sample.decode("utf-8")
        except UnicodeDecodeError:  # of MDF 3 and of some channels of MDF 4
            text = sample.decode("latin-1")
        return text.strip("\0 ")
    return f"{sample:.15g}" if isinstance(sample, int | float) else str(sample)


def _at(base: FloatArray, t: FloatArray, values: FloatArray, quantity: str, max_gap: float) -> FloatArray:
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
        known = np.abs(values) < LARGEST
        values[known] = np.unwrap(values[known])
    between = values_at(base, t, values, longest=max_gap, beyond=0.0)
    beside = np.where(base - t[before] <= t[after] - base, values[before], values[after])
    limits = LIMITS.get(quantity, LIMITS["lane_offset"])  # else of a line
    jump = np.isfinite(between) & (np.abs(values[after] - values[before]) > limits.jump)
    return np.where(jump & (base > t[before]), beside, between)
