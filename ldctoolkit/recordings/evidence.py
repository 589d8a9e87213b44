"""What is counted while recordings pass, so that at the end it can be said in words what looks wrong with them."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.recordings.recording import LARGEST, Recording, RecordingTable


def unit_counts(
    table: RecordingTable, usable: BoolArray, median_step: FloatArray, vehicle_width: float
) -> tuple[tuple[str, int], ...]:
    """Count samples and recordings beyond limits."""
    offset, width = np.abs(table.lane_offset[usable]), table.lane_width[usable]
    speed = table.speed[usable]
    steps = median_step[np.isfinite(median_step)]
    beyond = {
        "speed > 60": speed > 60.0,
        "speed > 42": speed > 42.0,
        "speed > 1000": speed > 1000.0,
        "speed < 0": speed < 0.0,
        "width > 1000": width > 1000.0,
        "width > 100": width > 100.0,
        "width > 6": width > 6.0,
        "width < 2": width < 2.0,
        "width <= vehicle": width <= vehicle_width,
        "offset > 10": offset > 10.0,
        "offset > width": offset > width,
        "step > 2": steps > 2.0,
        "step < 0.002": steps < 0.002,
    }
    if table.curvature is not None:
        beyond["curvature > 0.2"] = np.abs(table.curvature[usable]) > 0.2
    elif table.yaw_rate is not None:
        beyond["yaw rate > 1.5"] = np.abs(table.yaw_rate[usable]) > 1.5
    counts = {name: int(np.count_nonzero(mask)) for name, mask in beyond.items()}
    return tuple({"samples": speed.size, "recordings": steps.size, **counts}.items())


def unit_warnings(counts: Mapping[str, int], vehicle_width: float) -> list[str]:
    """Warnings in words, none when everything is plausible."""

    def share(name: str, of: str = "samples") -> float:
        return counts.get(name, 0) / max(counts.get(of, 0), 1)

    found = []
    if share("speed > 1000") > 0.5:
        found.append("column 'speed': most values are above 1000; the unit looks like mm/s, m/s is needed")
    elif share("speed > 60") > 0.01:
        found.append(
            f"column 'speed': {share('speed > 60'):.0%} of the samples are above 60 m/s (216 km/h); the unit looks "
            "like km/h, m/s is needed (divide by 3.6)"
        )
    elif share("speed > 42") > 0.5:  # a city driven at 50 km/h stays below 60 in either unit
        found.append(
            "column 'speed': most samples are above 42 m/s (150 km/h); if the unit is km/h, divide by 3.6: m/s is "
            "needed"
        )
    if share("speed < 0") > 0.5:
        found.append("column 'speed': most values are negative; speed along the road is positive")
    if share("width > 1000") > 0.5:
        found.append("column 'lane_width': most values are above 1000; the unit looks like mm, m is needed")
    elif share("width > 100") > 0.5:
        found.append("column 'lane_width': most values are above 100; the unit looks like cm, m is needed")
    elif share("width > 6") > 0.5:
        found.append("column 'lane_width': most lanes are wider than 6 m; is the unit feet? m is needed")
    elif share("width < 2") > 0.5:
        found.append("column 'lane_width': most lanes are narrower than 2 m; full width in m is needed, not half")
    elif share("width <= vehicle") > 0.5:
        found.append(f"vehicle width {vehicle_width} m: most lanes are no wider than that")
    if share("offset > 10") > 0.5:
        found.append("column 'lane_offset': most values are beyond 10; the unit looks like mm or cm, m is needed")
    elif share("offset > width") > 0.05 and share("width < 2") <= 0.5:
        found.append(
            f"column 'lane_offset': in {share('offset > width'):.0%} of the samples the vehicle's centre is further "
            "than a lane width from the lane's centre; the offset is measured in m from the centre of the vehicle's "
            "own lane"
        )
    if share("step > 2", "recordings") > 0.5:
        found.append("column 't': the time step is above 2 in most recordings; the unit looks like ms, s is needed")
    if share("step < 0.002", "recordings") > 0.5:
        found.append("column 't': the time step is below 0.002 in most recordings; is the unit minutes or hours?")
    if share("curvature > 0.2") > 0.01:
        found.append(
            f"column 'curvature': {share('curvature > 0.2'):.0%} of the samples are beyond 0.2 1/m (a radius under "
            "5 m); is it a radius or in 1/km? 1/m is needed"
        )
    if share("yaw rate > 1.5") > 0.01:
        found.append(
            f"column 'yaw_rate': {share('yaw rate > 1.5'):.0%} of the samples are beyond 1.5 rad/s; the unit looks "
            "like deg/s, rad/s is needed"
        )
    return found


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
    """Sums and counts over r recordings."""

    units: tuple[tuple[str, int], ...]  # (str, int): from `unit_counts`
    kinds: tuple[str, ...]  # where the curvature comes from: "measured", "yaw_rate", "none"; sorted
    lanes: bool  # all of them have a column `lane`
    turns: FloatArray  # (4,)
    bends: IntArray  # (2,): usable samples with a yaw rate or curvature, and those of them that are not straight
    names: npt.NDArray[np.str_]  # (r,): names of the recordings
    fingerprints: npt.NDArray[np.str_]  # (r,): digest of offset, width and speed of each; empty for short ones
    median_widths: FloatArray  # (r,) [m]: median lane width of each, before any scaling
    notes: tuple[tuple[str, int], ...] = ()  # (str, int): what recordings lack, in words, and how many lack it


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
