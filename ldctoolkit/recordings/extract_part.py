"""Departures of a stream of recordings: prepared one by one, searched many at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from ldctoolkit.departures import PARAMETER_COLUMNS, PARAMETER_NAMES, Departures, ExtraColumn
from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings.account import Origin, accounts_of
from ldctoolkit.recordings.drawn import drawn_of
from ldctoolkit.recordings.evidence import evidence_of
from ldctoolkit.recordings.find_departures import Criteria, find_departures
from ldctoolkit.recordings.preparation import Preparation, prepare
from ldctoolkit.recordings.recording import Problem, Recording, RecordingTable
from ldctoolkit.recordings.result import PartResult, joined_results
from ldctoolkit.recordings.sources import RecordingPart, part_name

BATCH: Final = 500_000
"""Samples that are searched together; no number depends on it."""

SOURCE: Final = "source"
"""Column of the departures table that tells the source where there are several."""

SCALE: Final = "lane_scale"
"""Column of the departures table that tells the factor of offset and width where recordings were scaled."""

GAP_STEPS: Final = 1.5
"""Resampled recordings leave out samples in gaps: a longer step than this many is one."""

TAKEN: Final = frozenset(
    {"recording", "side", "start_time_s", "samples", SOURCE, SCALE, *PARAMETER_NAMES, *PARAMETER_COLUMNS.values()}
)
"""Names of the departures table's own columns; no label has one of them."""


def extract_part(part: RecordingPart, criteria: Criteria, preparation: Preparation) -> PartResult:
    """Departures of one part of a source.

    Parameters
    ----------
    part : RecordingPart
        What is read.
    criteria : Criteria
        What counts as a departure.
    preparation : Preparation
        How recordings are brought to a common form.

    Returns
    -------
    PartResult
        What cannot be used is a problem of it.
    """
    return extract_items(_guarded(part), criteria, preparation)


def _guarded(part: RecordingPart) -> Iterator[Recording | Problem]:
    try:
        yield from part.read()
    except LdcError as error:
        yield Problem(part_name(part), "", f"the rest of this part is left out: {error}")


def extract_items(items: Iterable[Recording | Problem], criteria: Criteria, preparation: Preparation) -> PartResult:
    """Departures of recordings.

    A recording that cannot be prepared is a problem of the result.
    """
    results: list[PartResult] = []
    batch: list[Recording] = []
    problems: list[Problem] = []
    waiting = 0
    if criteria.max_gap is not None and criteria.max_gap < preparation.max_gap:
        preparation = dataclasses.replace(preparation, max_gap=criteria.max_gap)

    def search() -> None:
        nonlocal waiting
        if batch:
            results.append(_of_batch(batch, criteria, preparation))
            batch.clear()
            waiting = 0

    for item in items:
        if isinstance(item, Problem):
            problems.append(item)
        elif isinstance(item, Recording):
            try:
                _check_labels(item)
                recording = prepare(item, preparation, criteria.max_jump)
            except RecordingError as error:
                problems.append(Problem(item.source or item.name, "", f"{error}; it is left out"))
                continue
            if recording.samples == 0:
                continue
            if batch and (waiting + recording.samples > BATCH or not _alike(batch[0], recording)):
                search()
            batch.append(recording)
            waiting += recording.samples
        else:
            raise InputError(f"recordings: an item is a {type(item).__name__}; allowed: Recording")
    search()
    return joined_results([*results, PartResult(problems=tuple(problems))])


def _check_labels(recording: Recording) -> None:
    for label in recording.labels:
        if not label.name or label.name in TAKEN:
            raise RecordingError(
                f"recording {recording.name!r}: label {label.name!r}; allowed: a name that is no column of the "
                "departures table"
            )


_OPTIONAL: Final = ("curvature", "yaw_rate", "lane", "turn_signal")


def _alike(one: Recording, other: Recording) -> bool:
    return all((getattr(one, name) is None) == (getattr(other, name) is None) for name in _OPTIONAL)


def table_of(recordings: list[Recording]) -> RecordingTable:
    """Recordings of the same columns as one table."""

    def joined(name: str) -> np.ndarray | None:
        columns = [getattr(recording, name) for recording in recordings]
        return None if columns[0] is None else np.concatenate(columns)

    columns = {name: joined(name) for name in ("t", "lane_offset", "lane_width", "speed", "valid", *_OPTIONAL)}
    return RecordingTable(
        names=np.array([recording.name for recording in recordings], dtype=np.str_),
        offsets=np.concatenate([[0], np.cumsum([recording.samples for recording in recordings])]).astype(np.int64),
        **columns,  # type: ignore[arg-type]
    )


def _of_batch(recordings: list[Recording], criteria: Criteria, preparation: Preparation) -> PartResult:
    table, step = table_of(recordings), preparation.step
    limit = None if step is None else max(GAP_STEPS * step, criteria.max_gap or 0.0)
    found = find_departures(table, criteria, limit)
    origins = tuple(Origin(recording.source, recording.labels) for recording in recordings)
    sources = [origins[i].source for i in found.owner]
    departures = dataclasses.replace(found.departures, extra=_extra(found.departures, found.owner, recordings))
    return PartResult(
        departures=departures,
        accounts=accounts_of(table, found, origins),
        evidence=evidence_of(table, found.usable, found.median_step, criteria.vehicle_width, recordings),
        drawn=drawn_of(departures, found.signals, sources),
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
        values = [next((one.value for one in own.labels if one.name == name), "") for own in recordings]
        columns.append(ExtraColumn(name, text(values)))
    return tuple(columns)
