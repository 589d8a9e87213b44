"""Quality statistics of an extraction: what was read, kept and dropped, and example events."""

import dataclasses
import hashlib
import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT, Departures, DepartureSignals
from ldctoolkit.recordings.find_departures import ACCEPTED, SearchResult
from ldctoolkit.recordings.preparation import MAX_JUMP, coarse_step
from ldctoolkit.recordings.recording import LARGEST, Label, Recording, RecordingTable, printable, usable_samples

WIDTH_STEP: Final = 0.1  # width of a bin of the lane-width histogram [m]
WIDTH_BINS: Final = 80  # bins from 0 to 8 m; the last also holds what is wider

LONGEST: Final = 1e8
"""Time [s] of a recording that is counted at most, three years: the sums stay whole numbers of 64 bits."""

SIDES: Final = 2  # left first, then right


@dataclasses.dataclass(frozen=True)
class Origin:
    """What a recording came from: recordings of one origin are counted together."""

    source: str = ""  # File or folder
    labels: tuple[Label, ...] = ()  # Such as driver, behaviour, road

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", printable(self.source))


@dataclasses.dataclass(frozen=True)
class Account:
    """Counts of all recordings of one origin."""

    origin: Origin  # What they came from
    recordings: int
    samples: int  # After resampling
    usable: int  # Of these samples
    # [ns] Time in steps between neighbours, and between usable neighbours; without gaps. Whole numbers, whose sums do
    # not depend on how the recordings were split.
    read_ns: int
    valid_ns: int
    valid_um: int  # [um] Distance between usable neighbours, without gaps; whole for the same reason
    departures: IntArray  # (2,) Left, right
    refused: IntArray  # (2, k) Candidates by side of their first crossing and by reason, in the order of `REASONS`
    # (80,) Usable samples by lane width, in bins of 0.1 m from 0; the last bin also holds wider ones
    widths: IntArray

    @property
    def candidates(self) -> IntArray:
        """Departures and refused candidates, (2,): left, right."""
        total: IntArray = self.departures + self.refused.sum(axis=1)
        return total

    @property
    def hours_read(self) -> float:
        """Hours of recordings, without gaps."""
        return self.read_ns / 3.6e12

    @property
    def hours_valid(self) -> float:
        """Hours in which a departure could have been seen."""
        return self.valid_ns / 3.6e12


def accounts_of(
    table: RecordingTable, result: SearchResult, origins: tuple[Origin, ...], counted: BoolArray
) -> tuple[Account, ...]:
    """Accounts of one table of r recordings; `origins` has one of each, (r,), and `counted` is false for a piece."""
    distinct = tuple(dict.fromkeys(origins))
    position = {origin: i for i, origin in enumerate(distinct)}
    group = np.array([position[origin] for origin in origins], dtype=np.int64)
    count = len(distinct)
    samples = np.diff(table.offsets)
    sample_group = np.repeat(group, samples)[result.usable]
    bins = np.clip(table.lane_width[result.usable] / WIDTH_STEP, 0, WIDTH_BINS - 1).astype(np.int64)
    widths = np.bincount(sample_group * WIDTH_BINS + bins, minlength=count * WIDTH_BINS).reshape(count, WIDTH_BINS)
    kinds = ACCEPTED + 1
    side = np.where(result.side == LEFT, 0, 1)
    cell = (group[result.recording] * SIDES + side) * kinds + result.reason
    candidates = np.bincount(cell, minlength=count * SIDES * kinds).reshape(count, SIDES, kinds)
    before = np.concatenate([[0], np.cumsum(result.usable)])
    usable = before[table.offsets[1:]] - before[table.offsets[:-1]]
    # a recording of absurd times counts as `LONGEST`, and as 100 m/s for so long
    read, driven = (np.rint(np.minimum(seconds, LONGEST) * 1e9) for seconds in (result.read, result.driven))
    distance = np.rint(np.minimum(result.distance, 100.0 * LONGEST) * 1e6)
    amounts = {"recordings": counted, "samples": samples, "usable": usable}
    amounts |= {"read_ns": read, "valid_ns": driven, "valid_um": distance}
    totals = {name: np.zeros(count, dtype=np.int64) for name in amounts}
    for name, values in amounts.items():
        np.add.at(totals[name], group, values.astype(np.int64))
    return tuple(
        Account(
            origin=origin,
            departures=candidates[i, :, ACCEPTED],
            refused=candidates[i, :, :ACCEPTED],
            widths=widths[i],
            **{name: int(total[i]) for name, total in totals.items()},
        )
        for i, origin in enumerate(distinct)
    )


def combined_accounts(accounts: Iterable[Account]) -> tuple[Account, ...]:
    """One account an origin, in the order in which the origins first come."""
    by_origin: dict[Origin, list[Account]] = {}
    for account in accounts:
        by_origin.setdefault(account.origin, []).append(account)
    names = [field.name for field in dataclasses.fields(Account) if field.name != "origin"]
    return tuple(
        Account(origin, *(sum(getattr(part, name) for part in parts) for name in names))
        for origin, parts in by_origin.items()
    )


def share_of_widths(widths: IntArray) -> tuple[FloatArray, FloatArray]:
    """Bin edges, (81,) [m], and the share of samples in each bin, (80,)."""
    edges: FloatArray = np.asarray(np.arange(WIDTH_BINS + 1) * WIDTH_STEP, dtype=np.float64)
    return edges, widths / max(int(widths.sum()), 1)


_UNITS: Final = (
    (
        ("speed > 1000", 0.5, "column 'speed': most values are above 1000; the unit looks like mm/s, m/s is needed"),
        ("speed > 60", 0.01, "column 'speed': {share:.0%} of the samples are above 60 m/s (216 km/h); the unit looks "
         "like km/h or mph, m/s is needed (divide by 3.6 or 2.237)"),
        # a city driven at 50 km/h stays below 60 in either unit
        ("speed > 47", 0.5, "column 'speed': most samples are above 47 m/s (169 km/h); if the unit is km/h, divide by "
         "3.6: m/s is needed"),
    ),
    (("speed < 0", 0.5, "column 'speed': most values are negative; speed along the road is positive"),),
    (
        ("width > 1000", 0.5, "column 'lane_width': most values are above 1000; the unit looks like mm, m is needed"),
        ("width > 100", 0.5, "column 'lane_width': most values are above 100; the unit looks like cm, m is needed"),
        ("width > 6", 0.5, "column 'lane_width': most lanes are wider than 6 m; is the unit feet? m is needed"),
        ("width < 2", 0.5, "column 'lane_width': most lanes are narrower than 2 m; full width in m is needed, not "
         "half"),
        ("width <= vehicle", 0.5, "vehicle width {vehicle_width} m: most lanes are no wider than that"),
    ),
    (
        ("offset > 10", 0.5, "column 'lane_offset': most values are beyond 10; the unit looks like mm or cm, m is "
         "needed"),
        ("offset > width", 0.05, "column 'lane_offset': in {share:.0%} of the samples the vehicle's centre is further "
         "than a lane width from the lane's centre; the offset is measured in m from the centre of the vehicle's own "
         "lane"),
    ),
    (("coarse offset > 0", 0.5, "column 'lane_offset': it comes in steps of 0.1 m or more, which departures are hardly "
      "deeper than; a finer signal is needed"),),
    (("step > 12", 0.5, "column 't': the time step is above 12 in most recordings; the unit looks like ms, s is "
      "needed"),),
    (("step < 0.002", 0.5, "column 't': the time step is below 0.002 in most recordings; is the unit minutes or "
      "hours?"),),
    (
        ("curvature > 0.2", 0.01, "column 'curvature': {share:.0%} of the samples are beyond 0.2 1/m (a radius under 5 "
         "m); is it a radius or in 1/km? 1/m is needed"),
        ("tight c > 0.006", 0.03, "column 'curvature': {share:.0%} of the samples have a radius under 167 m at more "
         "than 3 m/s^2; is it in 1/km or degrees, or the speed in km/h? 1/m and m/s are needed"),
    ),
    (
        ("yaw rate > 1.5", 0.01, "column 'yaw_rate': {share:.0%} of the samples are beyond 1.5 rad/s; the unit looks "
         "like deg/s, rad/s is needed"),
        ("tight r > 0.006", 0.03, "column 'yaw_rate': {share:.0%} of the samples ask for a radius under 167 m at more "
         "than 3 m/s^2; the unit looks like deg/s, rad/s is needed"),
    ),
    (("heading > 40", 0.01, "column 'heading': {share:.0%} of the samples are beyond 40; the unit looks like degrees, "
      "rad is needed"),),
    (("steering > 40", 0.01, "column 'steering': {share:.0%} of the samples are beyond 40; the unit looks like "
      "degrees, rad is needed"),),
)  # fmt: skip
"""Groups of rules, of which the first that holds is reported: what is counted, the share from which on it holds, and
what is likely wrong then."""


SHARP: Final = 3.0  # [m/s^2] more lateral acceleration than most drivers ever ask for


def unit_counts(
    table: RecordingTable,
    usable: BoolArray,
    median_step: FloatArray,
    vehicle_width: float,
    recordings: Sequence[Recording] = (),
) -> tuple[tuple[str, int], ...]:
    """Count samples and recordings beyond limits."""
    width, step = table.lane_width[usable], median_step[np.isfinite(median_step)]
    values = {"speed": table.speed[usable], "width": width, "offset": np.abs(table.lane_offset[usable]), "step": step}
    v = np.maximum(np.abs(values["speed"]), 0.1)
    with np.errstate(over="ignore", invalid="ignore"):
        if table.curvature is not None:
            c = values["curvature"] = np.abs(table.curvature[usable])
            values["tight c"] = c * (v * v * c > SHARP)
        if table.yaw_rate is not None:
            r = values["yaw rate"] = np.abs(table.yaw_rate[usable])
            values["tight r"] = r / v * (v * r > SHARP)
    for name in ("heading", "steering"):
        columns = [np.abs(column) for recording in recordings if (column := getattr(recording, name)) is not None]
        if columns:
            values[name] = np.concatenate(columns)
    offsets = (recording.lane_offset for recording in recordings)
    coarse = [offset.size for offset in offsets if coarse_step(offset[np.isfinite(offset)]) > COARSEST]
    values["coarse offset"] = np.repeat(1.0, sum(coarse))
    counts = {"samples": width.size, "recordings": step.size}
    for name, _, _ in itertools.chain(*_UNITS):
        quantity, sign, limit = name.rsplit(" ", 2)
        if quantity in values:
            bound: Any = {"vehicle": vehicle_width, "width": width}[limit] if limit.isalpha() else float(limit)
            beyond = {">": np.greater, "<": np.less, "<=": np.less_equal}[sign](values[quantity], bound)
            counts[name] = int(np.count_nonzero(beyond))
    return tuple(counts.items())


def unit_warnings(counts: Mapping[str, int], vehicle_width: float) -> dict[str, str]:
    """Warnings by the quantity that is likely wrong, as "width" or "offset"; none when everything is plausible."""

    def share(name: str) -> float:
        of = "recordings" if name.startswith("step") else "samples"
        return min(counts.get(name, 0) / max(counts.get(of, 0), 1), 1.0)

    warnings: dict[str, str] = {}
    for group in _UNITS:
        holds = (rule for rule in group if share(rule[0]) > rule[1])
        for name, _, text in itertools.islice(holds, 1):
            # with half the lane's width every offset is large
            if name != "offset > width" or share("width < 2") <= 0.5:
                warnings[name.rsplit(" ", 2)[0]] = text.format(share=share(name), vehicle_width=vehicle_width)
    return warnings


FLAT: Final = 1e-6  # a lane that bends less [1/m] counts as straight
SHORTEST_TWIN: Final = 100  # recordings with fewer usable samples are not compared with others

TURN_WINDOW: Final = 2.0
"""Time [s] over which turns by yaw rate and by heading are compared: long enough for a bend to stand out of noise."""

GRAIN: Final = 2.0**-20
"""Sums of squared turns [rad^2] of a recording are rounded to multiples of this, so that the order does not count."""

SMALLEST_TURN: Final = 0.02
"""Turns [rad] up to this are not compared: on a straight road, where most is driven, both are noise."""

TURN_SPEED: Final = 8.0  # below this speed [m/s] the course over ground is noise


COARSEST: Final = 0.099  # [m] such steps of the offset are too coarse for departures

OFFSET_STEP: Final = 0.05  # width of a bin of the histogram of offsets [m]
SHORTEST_DRIVE: Final = 20.0
"""[s] of a recording that shows how a vehicle keeps in its lane; shorter ones may be departures that were cut out."""

LONG_STAY: Final = 5.0  # [s] a driver who strays over a line is back sooner
GRAZED: Final = 0.05  # [m]
OFFSET_BINS: Final = 81  # centred bins from -2 to 2 m; the outer ones also hold what is beyond

RELATIONS: Final = (("heading", "yaw_rate"), ("heading", "curvature"), ("yaw_rate", "curvature"),
                    ("heading", "steering"), ("yaw_rate", "steering"), ("curvature", "steering"))  # fmt: skip
"""Pairs of signals that measure how far the vehicle turns: the reference, and the signal compared with it."""


@dataclasses.dataclass(frozen=True)
class QualityStatistics:
    """Sums and counts over r recordings, as the source has them."""

    units: tuple[tuple[str, int], ...] = ()  # (str, int): from `unit_counts`
    kinds: tuple[str, ...] = ()  # where the curvature comes from: "measured", "yaw_rate", "none"; sorted
    lanes: bool = True  # all of them have a column `lane`
    # (6, 4): windows, and the sums of h^2, h r, r^2 over them, for each pair of `RELATIONS`
    turns: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((len(RELATIONS), 4)))
    # (2,): usable samples with a yaw rate or curvature, and those that are not straight
    bends: IntArray = dataclasses.field(default_factory=lambda: np.zeros(2, dtype=np.int64))
    # (r,): names of the recordings
    names: npt.NDArray[np.str_] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.str_))
    # (r,): digest of offset, width and speed of each; empty for a short recording
    fingerprints: npt.NDArray[np.str_] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.str_))
    # (r,) [m]: median lane width of each, before any scaling
    median_widths: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    # (4,): as `turns`, of the offset and of the vehicle's heading
    sway: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(4))
    # (81,): usable samples by offset, in bins of 0.05 m around 0
    offsets: IntArray = dataclasses.field(default_factory=lambda: np.zeros(OFFSET_BINS, dtype=np.int64))
    # (3,): how often the offset turns back within 0.05 m of zero; samples to the left, and to the right
    grazes: IntArray = dataclasses.field(default_factory=lambda: np.zeros(3, dtype=np.int64))
    # (3,) [ns]: time driven, time beyond a line, and the part of that in stays of more than five seconds
    stays_ns: IntArray = dataclasses.field(default_factory=lambda: np.zeros(3, dtype=np.int64))
    notes: tuple[tuple[str, int], ...] = ()  # (str, int): what recordings lack, as text, and how many lack it


def quality_statistics(
    recordings: Sequence[Recording], prepared: Sequence[Recording], result: SearchResult, vehicle_width: float
) -> QualityStatistics:
    """Evidence of r recordings as the source has them; `prepared` are the same as they were searched."""
    table = RecordingTable.of(recordings)
    count, usable = table.names.size, usable_samples(table)
    medians, prints = np.full(count, np.nan), [""] * count
    offsets, grazes = np.zeros(OFFSET_BINS, dtype=np.int64), np.zeros(3, dtype=np.int64)
    drive = result.read >= SHORTEST_DRIVE
    for i, recording in enumerate(recordings):
        rows = slice(int(table.offsets[i]), int(table.offsets[i + 1]))
        good = usable[rows]
        widths = table.lane_width[rows][good]
        if widths.size:
            medians[i] = np.median(widths) / recording.lane_scale
        offset = table.lane_offset[rows][good]
        if drive[i]:
            bin_index = np.clip(np.rint(offset / OFFSET_STEP) + OFFSET_BINS // 2, 0, OFFSET_BINS - 1)
            offsets += np.bincount(bin_index.astype(np.int64), minlength=OFFSET_BINS)
            away = np.abs(offset)
            back = (away[1:-1] < away[:-2]) & (away[1:-1] <= away[2:]) & (away[1:-1] < GRAZED)
            grazes += [np.count_nonzero(values) for values in (back, offset > 0.0, offset < 0.0)]
        if widths.size >= SHORTEST_TWIN:
            digest = hashlib.blake2b(widths.tobytes(), digest_size=12)
            digest.update(offset.tobytes())
            digest.update(table.speed[rows][good].tobytes())
            prints[i] = digest.hexdigest()
    bend = table.curvature if table.curvature is not None else table.yaw_rate
    bends = np.zeros(2, dtype=np.int64)
    if bend is not None:
        curved = np.abs(bend[usable]) > (FLAT if table.curvature is not None else FLAT * table.speed[usable])
        bends[:] = curved.size, np.count_nonzero(curved)
    related = [_related(recording) for recording in recordings]
    stays = result.stays[drive[result.stay_recording]]
    times = (result.driven[drive], stays, stays[stays > LONG_STAY])
    # whole numbers, whose sums do not depend on how the recordings were split
    stays_ns = [np.rint(np.minimum(values, LONGEST) * 1e9).astype(np.int64).sum() for values in times]
    searched = prepared[0]  # all have the same columns
    kind = "measured" if searched.curvature is not None else "none" if searched.yaw_rate is None else "yaw_rate"
    return QualityStatistics(
        units=unit_counts(table, usable, result.median_step, vehicle_width, recordings),
        kinds=(kind,),
        lanes=table.lane is not None,
        turns=np.sum([turns for turns, _ in related], axis=0),
        bends=bends,
        names=table.names,
        fingerprints=np.array(prints, dtype=np.str_),
        median_widths=medians,
        sway=np.sum([sway for _, sway in related], axis=0),
        offsets=offsets,
        grazes=grazes,
        stays_ns=np.array(stays_ns, dtype=np.int64),
        notes=tuple(
            Counter(note for recording in prepared if not recording.continues for note in recording.notes).items()
        ),
    )


def _related(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Rows of `turns` and `sway` of one recording."""
    turns, sway = np.zeros((len(RELATIONS), 4)), np.zeros(4)
    swept = _swept(recording)
    steps = np.diff(recording.t[:500])
    steps = steps[steps > 0.5 * np.minimum(steps, 0.5).mean()] if steps.size else steps  # not those inside bursts
    step = float(np.median(steps)) if steps.size else 0.0
    if not step > 0.0 or not swept:
        return turns, sway
    lag = max(1, round(TURN_WINDOW / step))
    for i, (reference, compared) in enumerate(RELATIONS):
        if reference in swept and compared in swept and recording.samples > lag:
            turns[i] = _turns(recording, lag, swept[reference], swept[compared])
    angle = swept.get("heading", swept.get("yaw_rate"))
    return turns, sway if angle is None else _sway(recording, *angle)


Swept = tuple[FloatArray, BoolArray]  # angle that the vehicle turned since the start [rad], and where it is usable


def _swept(recording: Recording) -> dict[str, Swept]:
    """How far the vehicle turned, by each recorded signal of its motion; by the steering angle up to a factor."""
    swept: dict[str, Swept] = {}
    if recording.heading is not None:
        usable = recording.valid & (np.abs(recording.heading) < LARGEST)
        swept["heading"] = np.where(usable, recording.heading, 0.0), usable
    for name in ("yaw_rate", "curvature", "steering"):
        values = getattr(recording, name)
        if values is None:
            continue
        usable = recording.valid & (np.abs(values) < LARGEST)
        if name == "yaw_rate" and recording.yaw_rate_measured is not None:
            usable &= recording.yaw_rate_measured  # else it is the heading's own slope
        if name != "yaw_rate":
            usable &= np.abs(recording.speed) < LARGEST
        with np.errstate(over="ignore", invalid="ignore"):
            rate = np.where(usable, values if name == "yaw_rate" else values * recording.speed, 0.0)
            steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(recording.t)
            swept[name] = np.concatenate([[0.0], np.cumsum(steps)]), usable
    return swept


def _turns(recording: Recording, lag: int, reference: Swept, compared: Swept) -> FloatArray:
    """Windows and sums of one recording: turns by one signal against those by another."""
    t, usable = recording.t, reference[1] & compared[1]
    lost = np.cumsum(~usable)
    with np.errstate(over="ignore", invalid="ignore"):
        h, r = (angle[lag:] - angle[:-lag] for angle, _ in (reference, compared))
        h = h - 2.0 * np.pi * np.rint(h / (2.0 * np.pi))  # a heading into +-pi
    # a window with an unusable number in it is not compared
    good = np.isfinite(h) & np.isfinite(r) & (lost[lag:] == lost[:-lag]) & usable[:-lag]
    good &= (t[lag:] - t[:-lag] < 1.5 * TURN_WINDOW) & (
        np.fmin(recording.speed[lag:], recording.speed[:-lag]) > TURN_SPEED
    )
    good &= np.abs(h) > SMALLEST_TURN
    return _sums(h[good], r[good])


def _sums(h: FloatArray, r: FloatArray) -> FloatArray:
    """Windows, and the rounded sums of h^2, h r and r^2 over them, (4,)."""
    squares = np.array([np.sum(h * h), np.sum(h * r), np.sum(r * r)])
    return np.concatenate([[float(h.size)], np.rint(squares / GRAIN) * GRAIN])


SWAY_WINDOW: Final = 6.0  # [s] over which the offset is held against the vehicle's heading
_SWAY_STEP: Final = 0.2  # [s]
MOST_WINDOWS: Final = 20  # of a recording, spread over it

_SMOOTH: Final = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, round(SWAY_WINDOW / _SWAY_STEP)), 4))[0]
"""Orthonormal cubics: what position, heading and the road's bend add to a path in a window."""


def _sway(recording: Recording, angle: FloatArray, usable: BoolArray) -> FloatArray:
    """Windows and sums: the lateral path by the heading against the offset, both without the part of a bend."""
    t, offset, v = recording.t, recording.lane_offset, recording.speed
    if not SWAY_WINDOW < t[-1] - t[0] < LONGEST:
        return np.zeros(4)
    windows = int((t[-1] - t[0]) / SWAY_WINDOW)
    first = t[0] + SWAY_WINDOW * np.arange(0, windows, -(-windows // MOST_WINDOWS))
    times = first[:, None] + _SWAY_STEP * np.arange(_SMOOTH.shape[0])
    row = np.minimum(np.searchsorted(t, times), t.size - 1)
    # a window with a hole in it, or with a jump of the offset, is left out
    good = usable[row] & recording.valid[row] & (v[row] > TURN_SPEED) & (v[row] < LARGEST) & (t[row] - times <= 0.5)
    with np.errstate(invalid="ignore"):
        good[:, 1:] &= np.abs(np.diff(offset[row], axis=1)) <= MAX_JUMP  # False for NaN
    row = row[good.all(axis=1)]
    heading = angle[row] - angle[row[:, :1]]
    heading -= 2.0 * np.pi * np.rint(heading / (2.0 * np.pi))
    path = np.cumsum(v[row] * heading, axis=1) * _SWAY_STEP
    path, across = (x - (x @ _SMOOTH) @ _SMOOTH.T for x in (path, offset[row]))
    sums = _sums(path.ravel(), across.ravel())
    sums[0] = row.shape[0]
    return sums


def combined_statistics(parts: Iterable[QualityStatistics]) -> QualityStatistics:
    """The statistics of all recordings, in the order of the parts."""
    parts = list(parts) or [QualityStatistics()]
    units: Counter[str] = Counter()
    notes: Counter[str] = Counter()
    for part in parts:
        units.update(dict(part.units))
        notes.update(dict(part.notes))
    summed = ("turns", "bends", "sway", "offsets", "grazes", "stays_ns")
    joined = ("names", "fingerprints", "median_widths")
    arrays: dict[str, Any] = {name: np.sum([getattr(part, name) for part in parts], axis=0) for name in summed}
    arrays |= {name: np.concatenate([getattr(part, name) for part in parts]) for name in joined}
    return QualityStatistics(
        units=tuple(units.items()),
        kinds=tuple(sorted({kind for part in parts for kind in part.kinds})),
        lanes=all(part.lanes for part in parts),
        notes=tuple(notes.items()),
        **arrays,
    )


EXAMPLES: Final = 12  # departures, the deepest and by lot, that are kept of each source and side


@dataclasses.dataclass(frozen=True)
class DrawnEvent:
    """One departure with its signals, outward frame."""

    source: str  # Where it was found
    recording: str
    side: int  # `LEFT` or `RIGHT`
    start_time: float  # [s] Of the crossing outwards, on the recording's clock
    parameters: FloatArray  # (8,) In the order of `PARAMETER_NAMES`
    t: FloatArray  # (k,) [s] From crossing to crossing
    y: FloatArray  # (k,) [m]
    v: FloatArray  # (k,) [m/s]
    c: FloatArray  # (k,) [1/m]
    # Decides which departures are drawn by lot; from recording and time alone, so no split of the work matters
    lot: int

    @property
    def depth(self) -> tuple[float, str, float]:
        """Key that sorts events by depth, the deepest first."""
        return (-float(self.parameters[1]), self.recording, self.start_time)


@dataclasses.dataclass(frozen=True)
class Drawn:
    """Departures that are kept with their signals as examples."""

    deepest: tuple[DrawnEvent, ...] = ()  # Up to 12 of each source and side, deepest first; left before right
    # Up to 12 of each source and side, in the order of their lots; left before right
    by_lot: tuple[DrawnEvent, ...] = ()


def example_events(departures: Departures, signals: DepartureSignals, sources: list[str]) -> Drawn:
    """The departures that are kept as examples, of n departures with their signals and sources."""
    matrix = departures.matrix()
    ends = signals.offsets.tolist()
    events: list[DrawnEvent] = []
    for i, (recording, side, time) in enumerate(
        zip(departures.recording.tolist(), departures.side.tolist(), departures.start_time.tolist(), strict=True)
    ):
        rows = slice(ends[i], ends[i + 1])
        t, y, v, c = (column[rows].copy() for column in (signals.t, signals.y, signals.v, signals.c))
        digest = hashlib.blake2b(f"{recording}|{time!r}".encode(), digest_size=7).digest()
        lot = int.from_bytes(digest, "big")
        events.append(DrawnEvent(sources[i], recording, side, time, matrix[i].copy(), t, y, v, c, lot))
    return combined_examples([Drawn(tuple(events), tuple(events))])


def combined_examples(parts: Iterable[Drawn]) -> Drawn:
    """The departures that are kept as examples, of those that several parts have kept."""
    parts = list(parts)
    return Drawn(
        _best((event for part in parts for event in part.deepest), lambda event: event.depth),
        _best((event for part in parts for event in part.by_lot), lambda event: (event.lot, *event.depth)),
    )


def _best(events: Iterable[DrawnEvent], key: Callable[[DrawnEvent], tuple[object, ...]]) -> tuple[DrawnEvent, ...]:
    """The first few of each source and side: sources as they first come, left before right."""
    groups: dict[str, dict[int, list[DrawnEvent]]] = {}
    for event in events:
        groups.setdefault(event.source, {LEFT: [], RIGHT: []})[event.side].append(event)
    return tuple(
        event for both in groups.values() for group in both.values() for event in sorted(group, key=key)[:EXAMPLES]
    )
