"""Extraction of departures from recordings: part by part, joined in the order of the source."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.departures import PARAMETER_COLUMNS, PARAMETER_NAMES, Departures, ExtraColumn, Plausibility
from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.departures_table import Extraction, PartResult, Provenance, combined_results
from ldctoolkit.recordings.extraction_statistics import (
    OFFSET_BINS,
    OFFSET_STEP,
    RELATIONS,
    TURN_WINDOW,
    Origin,
    QualityStatistics,
    accounts_of,
    example_events,
    quality_statistics,
    unit_warnings,
)
from ldctoolkit.recordings.find_departures import REASONS, Criteria, Refused, find_departures
from ldctoolkit.recordings.preparation import MAX_JUMP, Preparation, corrected, on_own_clocks, prepare, stretches
from ldctoolkit.recordings.recording import (
    MAX_LANE_WIDTH,
    MIN_LANE_WIDTH,
    OpenedRecordings,
    Problem,
    Recording,
    RecordingPart,
    RecordingTable,
    SourceFile,
    part_name,
)

BATCH: Final = 500_000  # samples that are searched together; no number depends on it
SOURCE: Final = "source"  # column of the departures table that tells the source where there are several

SCALE: Final = "lane_scale"
"""Column of the departures table that tells the factor of offset and width where recordings were scaled."""

GAP_STEPS: Final = 1.5  # resampled recordings leave out samples in gaps: a time of more steps than these is a gap

RESERVED: Final = frozenset(
    {"recording", "side", "start_time_s", "samples", SOURCE, SCALE, *PARAMETER_NAMES, *PARAMETER_COLUMNS.values()}
)
"""Names of the departures table's own columns; no label has one of them."""


def extract_part(
    part: RecordingPart, criteria: Criteria, preparation: Preparation, *, keep_signals: bool = False
) -> PartResult:
    """Departures of one part of a source; what cannot be used is a problem of it."""

    def items() -> Iterator[Recording | Problem]:
        try:
            yield from part.read()
        except LdcError as error:
            yield Problem(part_name(part), "", f"the rest of this part is left out: {error}")

    return extract_items(items(), criteria, preparation, keep_signals=keep_signals)


def extract_items(
    items: Iterable[Recording | Problem], criteria: Criteria, preparation: Preparation, *, keep_signals: bool = False
) -> PartResult:
    """Departures of recordings.

    A recording that cannot be prepared is a problem of the result.
    """
    problems: list[Problem] = []
    if criteria.max_gap is not None and criteria.max_gap < preparation.max_gap:
        preparation = dataclasses.replace(preparation, max_gap=criteria.max_gap)

    def pairs() -> Iterator[Pair]:
        for item in items:
            if isinstance(item, Problem):
                problems.append(item)
            elif isinstance(item, Recording):
                try:
                    yield from _prepared(item, criteria, preparation)
                except RecordingError as error:
                    problems.append(Problem(item.source or item.name, "", f"{error}; it is left out"))
            else:
                raise InputError("recordings", f"an item is a {type(item).__name__}", allowed="Recording")

    results = [_of_batch(batch, criteria, preparation, keep_signals) for batch in _batches(pairs())]
    return combined_results([*results, PartResult(problems=tuple(problems))])


Pair = tuple[Recording, Recording]  # a stretch of a recording as the source has it, and prepared


def _prepared(recording: Recording, criteria: Criteria, preparation: Preparation) -> list[Pair]:
    """The stretches of a recording that hold a sample; raises `RecordingError` for one that cannot be used."""
    for label in recording.labels:
        if not label.name or label.name in RESERVED:
            allowed = "a name that is no column of the departures table"
            raise RecordingError(f"recording {recording.name!r}", f"label {label.name!r}", allowed=allowed)
    if recording.samples > 1 and recording.t[0] == recording.t[-1]:
        raise RecordingError(f"recording {recording.name!r}", f"all times are {float(recording.t[0])!r} s")
    widths = criteria.min_lane_width, criteria.max_lane_width
    raw = [on_own_clocks(piece) for piece in stretches(corrected(recording, preparation))]
    pairs = [(piece, prepare(piece, preparation, criteria.max_jump, widths)) for piece in raw]
    return [pair for pair in pairs if pair[1].samples]


def _batches(pairs: Iterable[Pair]) -> Iterator[list[Pair]]:
    """Neighbouring pairs that are searched in one table: of the same columns, and not too many samples."""
    batch: list[Pair] = []
    size = 0
    for pair in pairs:
        if batch and (size + pair[0].samples > BATCH or _present(pair) != _present(batch[0])):
            yield batch
            batch, size = [], 0
        batch.append(pair)
        size += pair[0].samples
    if batch:
        yield batch


def _present(recordings: Iterable[Recording]) -> list[bool]:
    """Which of the optional columns that are searched each recording has; a table holds recordings of one kind."""
    optional = ("curvature", "yaw_rate", "lane", "turn_signal", "engaged")
    return [getattr(recording, name) is not None for recording in recordings for name in optional]


def _of_batch(batch: list[Pair], criteria: Criteria, preparation: Preparation, keep_signals: bool) -> PartResult:
    """Departures, accounts and evidence of recordings that are searched together."""
    raw, recordings = [pair[0] for pair in batch], [pair[1] for pair in batch]
    table, step = RecordingTable.of(recordings), preparation.step
    limit = None if step is None else max(GAP_STEPS * step, criteria.max_gap or 0.0)
    result = find_departures(table, criteria, limit)
    origins = tuple(Origin(recording.source, recording.labels) for recording in recordings)
    sources = [origins[i].source for i in result.owner]
    extra = _extra(result.departures, result.owner, recordings)
    departures = dataclasses.replace(result.departures, extra=extra, signals=result.signals if keep_signals else None)
    return PartResult(
        departures=departures,
        accounts=accounts_of(table, result, origins, np.array([not recording.continues for recording in recordings])),
        evidence=quality_statistics(raw, recordings, result, criteria.vehicle_width),
        drawn=example_events(departures, result.signals, sources),
    )


def _extra(departures: Departures, owner: np.ndarray, recordings: list[Recording]) -> tuple[ExtraColumn, ...]:
    """Source, scale and labels of each departure.

    The first two always, so that joined parts do not depend on how recordings were shared out.
    """

    def text(values: list[str]) -> np.ndarray:
        return np.array(values, dtype=np.str_)[owner] if departures.n else np.empty(0, dtype=np.str_)

    scales = np.array([recording.lane_scale for recording in recordings])[owner]
    columns = [ExtraColumn(SOURCE, text([recording.source for recording in recordings])), ExtraColumn(SCALE, scales)]
    for name in dict.fromkeys(label.name for recording in recordings for label in recording.labels):
        labels = [{label.name: label.value for label in reversed(recording.labels)} for recording in recordings]
        values = [of_recording.get(name, "") for of_recording in labels]
        columns.append(ExtraColumn(name, text(values)))
    return tuple(columns)


VEHICLE_WIDTH = 1.9  # default width of the vehicle [m] where no reader states one


def extract_departures(
    recordings: Iterable[Recording | Problem] | OpenedRecordings,
    *,
    vehicle_width: float | None = None,
    min_duration: float = 0.5,
    max_duration: float = 10.0,
    min_speed: float = 5.0,
    max_gap: float | None = None,
    max_jump: float = MAX_JUMP,
    plausibility: Plausibility | None = None,
    preparation: Preparation | None = None,
    keep_signals: bool = False,
    min_lane_width: float = MIN_LANE_WIDTH,
    max_lane_width: float = MAX_LANE_WIDTH,
    keep_engaged: bool = False,
    force: bool = False,
) -> Extraction:
    """Find the lane departures in driving recordings and reduce each to its eight parameters.

    Raises `InputError` for a criterion outside its range; `RecordingError` for recordings that cannot be used, or whose
    units, signs or references cannot be what is needed.

    Parameters
    ----------
    recordings : OpenedRecordings, or iterable of Recording
        From `open_recordings` or `read_recordings`, or made of arrays.
    vehicle_width : float [m], optional
        Width of the vehicle; the reader's, or 1.9 m, by default.
    min_duration, max_duration : float [s]
        Allowed durations, ends included.
    min_speed : float [m/s]
        The mean speed must lie above.
    max_gap : float [s], optional
        Longest time step that is not a gap; by default 2.5 median steps of the recording, at least 0.25 s. Resampled
        recordings have no values in a gap that `preparation` does not bridge; by default any such hole is a gap.
    max_jump : float [m]
        Largest movement of the offset in 0.1 s, over longer times 1.5 m/s more; a larger one is a jump of the tracker.
    plausibility : Plausibility, optional
        What the fitted path may ask of driver and vehicle; beyond it a candidate is refused as implausible.
    preparation : Preparation, optional
        Common time step, scale, yaw rate; the reader's step, or recordings as they are, by default.
    keep_signals : bool
        Keep y(t), v(t) and c(t) of every departure, so that the recorded path itself can be replayed.
    min_lane_width, max_lane_width : float [m]
        A sample with a narrower or a wider lane is invalid.
    keep_engaged : bool
        Whether departures and hours count, too, while a system steers (`Recording.engaged`).
    force : bool
        Go on where units, signs or references cannot be what is needed; what is doubtful is among the warnings.

    Returns
    -------
    Extraction
        Departures, refused candidates by reason, hours, distance, warnings.

    Notes
    -----
    A departure begins where the edge, y = +-lane_offset + (vehicle_width - lane_width)/2, crosses the line outwards and
    ends where it comes back inside the same lane; both crossings are interpolated linearly. The criteria are those
    of Zhao, Wang, LeBlanc (2017), section III.

    Examples
    --------
    >>> t = np.arange(0, 10, 0.1)
    >>> beyond = np.clip(0.3 - 0.3 * (t - 5) ** 2, -0.5, None)
    >>> ones = np.ones(t.size)
    >>> drive = Recording("a", t, beyond + 0.85, 3.6 * ones, 25.0 * ones, ones > 0, curvature=0.0 * ones)
    >>> extraction = extract_departures([drive])
    >>> len(extraction.departures), extraction.refused.total, round(float(extraction.departures.T[0]), 2)
    (1, 0, 2.0)
    """
    opened = recordings if isinstance(recordings, OpenedRecordings) else None
    width, step = (VEHICLE_WIDTH, None) if opened is None else (opened.reader.vehicle_width, opened.reader.step)
    preparation = preparation or Preparation(step=step)
    criteria = Criteria(
        width if vehicle_width is None else vehicle_width,
        min_duration,
        max_duration,
        min_speed,
        max_gap,
        max_jump,
        plausibility or Plausibility(),
        min_lane_width,
        max_lane_width,
        keep_engaged,
    )
    if not isinstance(recordings, OpenedRecordings):
        result = extract_items(recordings, criteria, preparation, keep_signals=keep_signals)
        return merge_results([result], criteria, preparation, force=force)
    source = recordings.source
    results = [PartResult(problems=tuple(source.problems))]
    results += [extract_part(part, criteria, preparation, keep_signals=keep_signals) for part in source.parts]
    return merge_results(results, criteria, preparation, reader=recordings.reader.name, files=source.files, force=force)


def merge_results(
    results: Iterable[PartResult],
    criteria: Criteria,
    preparation: Preparation,
    *,
    reader: str = "table",
    files: Sequence[SourceFile] = (),
    force: bool = False,
) -> Extraction:
    """The parts of an extraction as a whole, in the order of the source's parts; a part without anything but problems
    may stand for the source's own. Raises `RecordingError` for recordings that cannot be what they should, unless
    forced.
    """
    whole = combined_results(results)
    refused = np.sum([account.refused.sum(axis=0) for account in whole.accounts], axis=0, initial=0)
    counts = np.broadcast_to(refused, (len(REASONS),))
    kinds, samples = whole.evidence.kinds, sum(account.samples for account in whole.accounts)
    usable = sum(account.usable for account in whole.accounts)
    sides = np.sum([account.departures for account in whole.accounts], axis=0, initial=0)
    doubts = quality_doubts(
        whole.evidence,
        criteria.vehicle_width,
        np.broadcast_to(sides, (2,)),
        yaw_rate_factor=preparation.yaw_rate_factor,
    )
    if doubts and not force:
        raise RecordingError(
            "",
            f"the recordings cannot be right: {'; '.join(doubts.values())}",
            hint="correct them, or go on with --force (in Python: force=True)",
        )
    warnings = quality_warnings(
        whole.evidence, preparation.nominal_lane_width, labelled=reader == "table", scaled="width" not in doubts
    )
    provenance = Provenance(
        criteria=criteria,
        refused=Refused(**{reason: int(count) for reason, count in zip(REASONS, counts, strict=True)}),
        sources=tuple(files),
        recordings=sum(account.recordings for account in whole.accounts),
        samples=samples,
        invalid_samples=samples - usable,
        hours=sum(account.valid_ns for account in whole.accounts) / 3.6e12,
        distance=sum(account.valid_um for account in whole.accounts) / 1e6,
        curvature="none" if not kinds else kinds[0] if len(kinds) == 1 else "mixed",
        warnings=(*doubts.values(), *few_usable(samples, usable), *warnings),
        reader=reader,
        preparation=preparation,
        problems=tuple(str(problem) for problem in whole.problems),
    )
    departures = whole.departures
    # a column with one value everywhere is left out
    idle = {SOURCE} if len({account.origin.source for account in whole.accounts}) <= 1 else set()
    scales = [column.values for column in departures.extra if column.name == SCALE]
    if preparation.nominal_lane_width is None and all(bool((values == 1.0).all()) for values in scales):
        idle.add(SCALE)
    departures = dataclasses.replace(departures, extra=tuple(c for c in departures.extra if c.name not in idle))
    return Extraction(departures, provenance, whole.accounts, whole.drawn, whole.problems)


FEWEST_TURNS: Final = 100  # windows that it takes to compare yaw rate and heading

LEAST_TURNING: Final = 0.02 * TURN_WINDOW
"""Root mean square of the turns by heading [rad in a window] above which they must agree: smaller ones may be noise."""

LEAST_USABLE: Final = 0.25
"""A smaller share of usable samples gives a warning: cameras often see no lane, but not nearly always."""

TWINS_NAMED: Final = 5

PLAUSIBLE_WIDTHS: Final = (2.8, 4.3)
"""Median lane widths [m] that roads are built with, country road and motorway, and a little more."""

METRES: Final = (1.5, 6.0)  # median lane widths that may be in metres at all

UNEVEN: Final = 1.25
"""A larger ratio of the recordings' median lane widths is one of scale, not of roads, if some are odd in themselves."""

EDGE: Final = 0.05  # share of the recordings at either end that may have odd lane widths


def quality_doubts(
    evidence: QualityStatistics, vehicle_width: float, sides: IntArray, *, yaw_rate_factor: float = 1.0
) -> dict[str, str]:
    """Texts about units, signs and references that cannot be right, by subject; `sides` (2,) are the numbers of
    departures to the left and to the right.
    """
    doubts = unit_warnings(dict(evidence.units), vehicle_width)
    # a wrong unit of the offset makes all of these, too
    if not {"width", "offset", "coarse offset"} & doubts.keys() and (text := _reference(evidence, sides)):
        doubts["reference"] = text
    return doubts | {f"turns {i}": text for i, text in enumerate(_turning(evidence, yaw_rate_factor))}


def quality_warnings(
    evidence: QualityStatistics, nominal_lane_width: float | None, *, labelled: bool = True, scaled: bool = True
) -> tuple[str, ...]:
    """Warnings about scale, curvature, lanes and repeated recordings; none when everything is plausible."""
    texts = []
    if "none" in evidence.kinds:
        where = "" if evidence.kinds == ("none",) else " in some recordings"
        texts.append(f"no column 'curvature' or 'yaw_rate'{where}: the lane's curvature is taken as 0 (c_0 = dc = 0)")
    if labelled and not evidence.lanes:
        texts.append("no column 'lane': a lane change is seen only as a jump of the offset by about a lane width")
    (windows, hh, *_), correlation = evidence.turns[0], _correlation(evidence.turns[0])
    if abs(correlation) < 0.5 and windows >= FEWEST_TURNS and hh >= LEAST_TURNING**2 * windows:
        texts.append(f"yaw rate and GPS heading do not agree (correlation {correlation:.2f}): curvatures are doubtful")
    if evidence.bends[0] > 1000 and evidence.bends[1] < 0.001 * evidence.bends[0] and evidence.kinds != ("none",):
        texts.append("the lane is straight in nearly all samples: c_0 and dc tell nothing")
    if nominal_lane_width is None and scaled:
        texts += _scale_warnings(evidence)
    texts += _repeat_warnings(evidence)
    total = np.unique(evidence.names).size
    texts += [f"{note}: {count} of {total} recordings" for note, count in evidence.notes]
    return tuple(texts)


ENOUGH_TIME: Final = 40.0  # [s] of driving that it takes to judge the reference of the offset
SHARE_BEYOND: Final = 0.4  # share of the time beyond a line that no driver reaches
SHARE_LONG: Final = 0.08  # the same of stays of more than five seconds
FEWEST_GRAZES: Final = 3  # an offset without its sign turns back at zero each time the vehicle passes the lane's centre
LARGEST_MEDIAN: Final = 0.55  # [m] of the offset: no driver keeps so far from the lane's centre
FEWEST_ON_A_SIDE: Final = 20  # departures that show whether there are any to the other side
SMALLER_SIDE: Final = 0.05  # share of the departures to the other side


def _reference(evidence: QualityStatistics, sides: IntArray) -> str:
    """Why the offset cannot be that of the vehicle's centre from the lane's centre; empty if it can."""
    driven, beyond, long = evidence.stays_ns / 1e9
    counts, middle = evidence.offsets, OFFSET_BINS // 2
    what, likely, samples = "", "is it a distance to a line, or is the camera beside the vehicle's centre", counts.sum()
    median = OFFSET_STEP * (int(np.searchsorted(np.cumsum(counts), 0.5 * samples)) - middle)
    side = "left" if counts[middle + 1 :].sum() > counts[:middle].sum() else "right"
    if driven >= ENOUGH_TIME and counts.any():
        wide = int(counts[: middle - 6].sum() + counts[middle + 7 :].sum())
        dense = 3.0 * counts[middle] >= 0.3 * (counts[middle - 3 : middle + 4].sum() - counts[middle])
        if evidence.grazes[1:].min() == 0 and dense and evidence.grazes[0] >= FEWEST_GRAZES and wide >= 0.01 * samples:
            what = f"it turns back at zero and never lies to the {'right' if side == 'left' else 'left'}"
            likely = "has it lost its sign"
        elif abs(median) > LARGEST_MEDIAN:
            what = f"half of the time the vehicle is more than {abs(median):.2f} m to the {side}"
        elif beyond > SHARE_BEYOND * driven or long > max(SHARE_LONG * driven, ENOUGH_TIME):
            what = f"a wheel is beyond a line in {beyond / driven:.0%} of the time"
            likely = "is it in feet, from another reference, or is the vehicle width too large"
    if not what and sides.sum() >= FEWEST_ON_A_SIDE and sides.min() <= SMALLER_SIDE * sides.sum():
        what = f"{sides.max()} of {sides.sum()} departures are to the {'left' if sides[0] > sides[1] else 'right'}"
    needed = "The vehicle's centre from the lane's centre is needed, in m, positive to the left"
    return f"column 'lane_offset': {what}; {likely}? {needed}" if what else ""


def few_usable(samples: int, usable: int) -> tuple[str, ...]:
    """A warning where most of what was read cannot be used."""
    if samples == 0 or usable >= LEAST_USABLE * samples:
        return ()
    return (
        f"only {usable:,} of {samples:,} samples can be used ({usable / samples:.1%}): in the others the lane, the "
        "speed or the yaw rate is missing, or the source itself distrusts them",
    )


def _correlation(turns: FloatArray) -> float:
    """Correlation of two signals, from windows and sums."""
    _, hh, hr, rr = turns
    return float(hr / max(np.sqrt(hh * rr), 1e-300))


_SIGNAL_NAMES: Final = {"heading": "the heading", "yaw_rate": "the yaw rate", "curvature": "the curvature",
                "steering": "the steering angle"}  # fmt: skip


def _turning(evidence: QualityStatistics, factor: float) -> list[str]:
    """Pairs of signals that turn against each other, or by different amounts; `factor` has multiplied the yaw rates."""
    doubts: list[str] = []
    doubted: set[str] = set()
    for turns, (reference, compared) in zip(evidence.turns, RELATIONS, strict=True):
        correlation = _correlation(turns)
        if turns[0] < FEWEST_TURNS or abs(correlation) < 0.5 or {reference, compared} & doubted:
            continue
        _, hh, hr, rr = turns
        # the true ratio lies between the two regressions, the first if all noise is the second signal's, the second if
        # it is all the first one's
        low, high = abs(hr) / hh, rr / abs(hr)
        # the lane does not turn as the vehicle does, and steering wheels are geared
        most = {"yaw_rate": 1.25, "curvature": 10.0, "steering": np.inf}[compared]
        scale = 1.0 if low < most and high > 1.0 / most else float(np.sqrt(rr / hh))
        if correlation > 0.0 and scale == 1.0:
            continue
        doubted.add(compared)
        what, of = _SIGNAL_NAMES[compared], _SIGNAL_NAMES[reference]
        of = "the GPS heading" if (reference, compared) == RELATIONS[0] else of
        times = f" times {factor:.3g}, as given," if compared == "yaw_rate" and factor != 1.0 else ""
        if correlation < 0.0:
            text = f"{what}{times} turns against {of} (correlation {correlation:.2f})"
            text += "" if scale == 1.0 else f", and {scale:.3g} times as much: another unit?"
            recorded = "without the factor it" if times else "it" if compared == "yaw_rate" else "one of them"
            text += f"; {recorded} is positive to the {'right' if factor > 0.0 else 'left'}"
        else:
            text = f"{what}{times} is {scale:.3g} times what {of} turns: another unit?"
        if compared == "yaw_rate":
            advice = factor / scale if correlation > 0.0 else -factor / scale
            end = "or all curvatures have the wrong sign" if correlation < 0.0 else "which would make them agree"
            end += "" if correlation > 0.0 or reference != "heading" else "; or is the heading a compass course?"
            text += f" (give --yaw-rate-factor {advice:.3g}, {end})"
        doubts.append(text)
    return doubts if doubted else doubts + _swaying(evidence.sway)


FEWEST_SWAYS: Final = 8  # windows of six seconds
LEAST_SWAY: Final = -0.2
"""Correlation of offset and heading below which they contradict each other, and below -1.7 over the root of the
windows: three times what chance makes of signals that have nothing to do with each other."""


def _swaying(sway: FloatArray) -> list[str]:
    """An offset that moves against the vehicle's heading, or much further or less far than that and the speed say."""
    windows, hh, hr, rr = sway
    correlation = _correlation(sway)
    if windows < FEWEST_SWAYS or abs(correlation) < max(-LEAST_SWAY, 1.7 / np.sqrt(windows)):
        return []
    if correlation < 0.0:
        return [
            f"column 'lane_offset': it goes against the vehicle's heading (correlation {correlation:.2f}); it is "
            "positive to the right, or the heading or yaw rate is"
        ]
    # a path that is longer holds the road's bends, too, if it is not very much like the offset
    if (correlation > 0.6 and hr > 1.6 * hh) or (correlation > 0.85 and rr < 0.6 * hr):
        return [
            f"column 'lane_offset': it moves {np.sqrt(rr / hh):.2g} times as far as the vehicle's heading and speed "
            "say; is it in feet, or the speed in km/h or mph? m and m/s are needed"
        ]
    return []


def _scale_warnings(evidence: QualityStatistics) -> list[str]:
    widths = evidence.median_widths[np.isfinite(evidence.median_widths)]
    if widths.size == 0:
        return []
    low, middle, high = (float(value) for value in np.quantile(widths, [EDGE, 0.5, 1.0 - EDGE]))
    if not METRES[0] < middle < METRES[1]:
        return []  # another unit: the check of units reports it
    implausible = low < PLAUSIBLE_WIDTHS[0] or high > PLAUSIBLE_WIDTHS[1]
    uneven = widths.size >= 3 and implausible and high > UNEVEN * low
    if PLAUSIBLE_WIDTHS[0] <= middle <= PLAUSIBLE_WIDTHS[1] and not uneven:
        return []
    return [
        f"the median lane width of a recording runs from {widths.min():.2f} to {widths.max():.2f} m (middle "
        f"{middle:.2f}): the scale of offset and width is doubtful, as with a single camera; --nominal-lane-width 3.5 "
        "scales each recording"
    ]


def _repeat_warnings(evidence: QualityStatistics) -> list[str]:
    long = np.flatnonzero(evidence.fingerprints != "")
    _, inverse, count = np.unique(evidence.fingerprints[long], return_inverse=True, return_counts=True)
    groups = [long[inverse == i] for i in np.flatnonzero(count > 1)]
    if not groups:
        return []
    groups.sort(key=lambda group: int(group[0]))
    named = "; ".join(" = ".join(str(evidence.names[i]) for i in group[:3]) for group in groups[:TWINS_NAMED])
    unnamed = f"; and {len(groups) - TWINS_NAMED} more" if len(groups) > TWINS_NAMED else ""
    repeated = sum(group.size - 1 for group in groups)
    repeat = "recording repeats" if repeated == 1 else "recordings repeat"
    return [f"{repeated} {repeat} another's samples, and the departures count twice: {named}{unnamed}"]
