"""Departures of a stream of recordings: prepared one by one, searched many at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from ldctoolkit.departure_columns import ExtraColumn
from ldctoolkit.departures import Departures
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings.account import Origin, accounts_of
from ldctoolkit.recordings.criteria import Criteria
from ldctoolkit.recordings.drawn import drawn_of
from ldctoolkit.recordings.evidence import evidence_of
from ldctoolkit.recordings.find_departures import find_departures
from ldctoolkit.recordings.part_result import PartResult, joined_results
from ldctoolkit.recordings.preparation import Preparation, prepare
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.sources import RecordingPart
from ldctoolkit.recordings.table import RecordingTable
from ldctoolkit.recordings.units import UnitCheck

BATCH: Final = 500_000
"""Samples that are searched together; no number depends on it."""

SOURCE: Final = "source"
"""Column of the departures table that tells the source where there are several."""

GAP_STEPS: Final = 1.5
"""Resampled recordings leave out samples in gaps: a longer step than this many is one."""


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
        yield Problem(part.key, "", f"the rest of this part is left out: {error}")


def extract_items(
    items: Iterable[Recording | RecordingTable | Problem], criteria: Criteria, preparation: Preparation
) -> PartResult:
    """Departures of recordings, given one by one or in tables."""
    results: list[PartResult] = []
    batch: list[Recording] = []
    problems: list[Problem] = []
    samples = 0
    for item in items:
        if isinstance(item, Problem):
            problems.append(item)
        elif isinstance(item, RecordingTable):
            results.append(_of_table(item, [], criteria, preparation))
        else:
            recording = prepare(item, preparation)
            if recording.samples == 0:
                continue
            if batch and (samples + recording.samples > BATCH or not _alike(batch[0], recording)):
                results.append(_of_table(table_of(batch), batch, criteria, preparation))
                batch, samples = [], 0
            batch.append(recording)
            samples += recording.samples
    if batch:
        results.append(_of_table(table_of(batch), batch, criteria, preparation))
    return joined_results([*results, PartResult(problems=tuple(problems))])


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


def _of_table(
    table: RecordingTable, recordings: list[Recording], criteria: Criteria, preparation: Preparation
) -> PartResult:
    step = preparation.step if recordings else None
    found = find_departures(table, criteria, None if step is None else GAP_STEPS * step)
    units = UnitCheck(criteria.vehicle_width)
    units.add(table, found.usable, found.median_step)
    if recordings:
        origins = tuple(Origin(recording.source, recording.labels) for recording in recordings)
    else:
        origins = (Origin(table.source),) * table.names.size
    sources = [origins[i].source for i in found.owner]
    departures = dataclasses.replace(found.departures, extra=_extra(found.departures, found.owner, origins, recordings))
    return PartResult(
        departures=departures,
        accounts=accounts_of(table, found, origins),
        evidence=evidence_of(table, found.usable, found.median_step, units.counts, recordings),
        drawn=drawn_of(departures, found.signals, sources),
    )


def _extra(
    departures: Departures, owner: np.ndarray, origins: tuple[Origin, ...], recordings: list[Recording]
) -> tuple[ExtraColumn, ...]:
    """Source and labels of each departure; the factor where recordings were scaled."""

    def text(values: list[str]) -> np.ndarray:
        return np.array(values, dtype=np.str_)[owner] if departures.n else np.empty(0, dtype=np.str_)

    columns = []
    if any(origin.source for origin in origins):
        columns.append(ExtraColumn(SOURCE, text([origin.source for origin in origins])))
    names = dict.fromkeys(label.name for origin in origins for label in origin.labels)
    for name in names:
        value = [next((label.value for label in origin.labels if label.name == name), "") for origin in origins]
        columns.append(ExtraColumn(name, text(value)))
    scales = np.array([recording.lane_scale for recording in recordings])
    if (scales != 1.0).any():
        columns.append(ExtraColumn("lane_scale", scales[owner]))
    return tuple(columns)
