"""What is counted while recordings pass, so that at the end it can be said in words what looks wrong with them."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.recordings.recording import Recording
from ldctoolkit.recordings.table import LARGEST, RecordingTable
from ldctoolkit.recordings.units import unit_counts

FLAT: Final = 1e-6
"""A lane that bends less [1/m] counts as straight."""

SHORTEST_TWIN: Final = 100
"""Recordings with fewer usable samples are not compared with others."""

TURN_WINDOW: Final = 2.0
"""Time [s] over which turns by yaw rate and by heading are compared: long enough for a bend to stand out of noise."""

GRAIN: Final = 2.0**-20
"""Sums of squared turns [rad^2] of a recording are rounded to multiples of this, so that the order does not count."""

SMALLEST_TURN: Final = 0.02
"""Turns [rad] up to this are not compared: on a straight road, where most is driven, both are noise."""

TURN_SPEED: Final = 8.0
"""Below this speed [m/s] the course over ground is noise."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """Sums and counts over r recordings.

    Attributes
    ----------
    units : tuple of (str, int)
        From `unit_counts`.
    kinds : tuple of str
        Where the curvature comes from: "measured", "yaw_rate", "none"; sorted.
    lanes : bool
        All of them have a column `lane`.
    turns : (4,)
        Windows, and over them the sums of h^2, h r and r^2 of the turns by heading h and by yaw rate r.
    bends : (2,) int
        Usable samples with a yaw rate or curvature, and those of them that are not straight.
    names : (r,) str
        Names of the recordings.
    fingerprints : (r,) str
        Digest of offset, width and speed of each; empty for short ones.
    median_widths : (r,) [m]
        Median lane width of each, before any scaling; NaN where it has no usable sample.
    notes : tuple of (str, int)
        What recordings lack, in words, and how many lack it.
    """

    units: tuple[tuple[str, int], ...]
    kinds: tuple[str, ...]
    lanes: bool
    turns: FloatArray
    bends: IntArray
    names: npt.NDArray[np.str_]
    fingerprints: npt.NDArray[np.str_]
    median_widths: FloatArray
    notes: tuple[tuple[str, int], ...] = ()


def no_evidence() -> Evidence:
    """Of no recordings."""
    text = np.empty(0, dtype=np.str_)
    return Evidence((), (), True, np.zeros(4), np.zeros(2, dtype=np.int64), text, text, np.empty(0))


def evidence_of(
    table: RecordingTable,
    usable: npt.NDArray[np.bool_],
    median_step: FloatArray,
    vehicle_width: float,
    recordings: Sequence[Recording],
) -> Evidence:
    """Evidence of one table of r recordings, given also one by one; `vehicle_width` [m] is what was taken."""
    count = table.names.size
    medians, prints = np.full(count, np.nan), [""] * count
    for i, recording in enumerate(recordings):
        rows = slice(int(table.offsets[i]), int(table.offsets[i + 1]))
        good = usable[rows]
        widths = table.lane_width[rows][good]
        if widths.size:
            medians[i] = np.median(widths) / recording.lane_scale
        if widths.size >= SHORTEST_TWIN:
            digest = hashlib.blake2b(widths.tobytes(), digest_size=12)
            digest.update(table.lane_offset[rows][good].tobytes())
            digest.update(table.speed[rows][good].tobytes())
            prints[i] = digest.hexdigest()
    bend = table.curvature if table.curvature is not None else table.yaw_rate
    bends = np.zeros(2, dtype=np.int64)
    if bend is not None:
        curved = np.abs(bend[usable]) > (FLAT if table.curvature is not None else FLAT * table.speed[usable])
        bends[:] = curved.size, np.count_nonzero(curved)
    turns = [_turns(recording, float(step)) for recording, step in zip(recordings, median_step, strict=True)]
    notes = Counter(note for recording in recordings for note in recording.notes)
    kind = "measured" if table.curvature is not None else "none" if table.yaw_rate is None else "yaw_rate"
    return Evidence(
        units=unit_counts(table, usable, median_step, vehicle_width),
        kinds=(kind,),
        lanes=table.lane is not None,
        turns=np.sum(turns, axis=0),
        bends=bends,
        names=table.names,
        fingerprints=np.array(prints, dtype=np.str_),
        median_widths=medians,
        notes=tuple(notes.items()),
    )


def _turns(recording: Recording, step: float) -> FloatArray:
    """Windows and sums of one recording: turns by heading against turns by yaw rate."""
    if recording.heading is None or recording.yaw_rate is None or not step > 0.0:
        return np.zeros(4)
    lag = max(1, round(TURN_WINDOW / step))
    if recording.samples <= lag:
        return np.zeros(4)
    t, yaw_rate = recording.t, recording.yaw_rate
    # a window with an unusable number in it is not compared, nor one with a yaw rate that is the heading's own slope
    known = recording.valid & (np.abs(yaw_rate) < LARGEST)
    if recording.yaw_rate_measured is not None:
        known &= recording.yaw_rate_measured
    rate = np.where(known, yaw_rate, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        swept = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    lost = np.cumsum(~known)
    course = np.where(np.abs(recording.heading) < LARGEST, recording.heading, np.nan)
    by_heading = course[lag:] - course[:-lag]
    by_heading -= 2.0 * np.pi * np.rint(by_heading / (2.0 * np.pi))  # into +-pi
    by_yaw_rate = swept[lag:] - swept[:-lag]
    good = np.isfinite(by_heading) & np.isfinite(by_yaw_rate) & (lost[lag:] == lost[:-lag]) & known[:-lag]
    good &= (t[lag:] - t[:-lag] < 1.5 * TURN_WINDOW) & (
        np.fmin(recording.speed[lag:], recording.speed[:-lag]) > TURN_SPEED
    )
    good &= np.abs(by_heading) > SMALLEST_TURN
    h, r = by_heading[good], by_yaw_rate[good]
    squares = np.array([np.sum(h * h), np.sum(h * r), np.sum(r * r)])
    return np.concatenate([[float(h.size)], np.rint(squares / GRAIN) * GRAIN])


def joined_evidence(parts: Iterable[Evidence]) -> Evidence:
    """Evidence of all recordings; in the order of the parts."""
    given = list(parts) or [no_evidence()]
    units: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    for part in given:
        units.update(dict(part.units))
        notes.update(dict(part.notes))
    return Evidence(
        units=tuple(units.items()),
        kinds=tuple(sorted({kind for part in given for kind in part.kinds})),
        lanes=all(part.lanes for part in given),
        turns=np.sum([part.turns for part in given], axis=0),
        bends=np.sum([part.bends for part in given], axis=0),
        names=np.concatenate([part.names for part in given]),
        fingerprints=np.concatenate([part.fingerprints for part in given]),
        median_widths=np.concatenate([part.median_widths for part in given]),
        notes=tuple(notes.items()),
    )
