"""From recordings to departures: every candidate is either a departure or refused for one counted reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from ldctoolkit.recordings.criteria import Criteria
from ldctoolkit.recordings.extract_part import SCALE, SOURCE, extract_items, extract_part
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.opened import OpenedRecordings
from ldctoolkit.recordings.part_result import PartResult, joined_results
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.result import Extraction, Provenance, Refused
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.warnings_in_words import few_usable, warnings_in_words

VEHICLE_WIDTH = 1.9
"""Width [m] of a vehicle that nothing is known of."""


def extract_departures(
    recordings: Iterable[Recording | Problem] | OpenedRecordings,
    *,
    vehicle_width: float | None = None,
    min_duration: float = 0.5,
    max_duration: float = 10.0,
    min_speed: float = 5.0,
    max_gap: float | None = None,
    max_jump: float = 0.6,
    preparation: Preparation | None = None,
) -> Extraction:
    """Find the lane departures in driving recordings and reduce each to its eight parameters.

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
        Largest step of the offset from one sample to the next.
    preparation : Preparation, optional
        Common time step, scale, yaw rate; the reader's step, or recordings as they are, by default.

    Returns
    -------
    Extraction
        Departures, refused candidates by reason, hours, warnings.

    Raises
    ------
    InputError
        For a criterion outside its range.
    RecordingError
        For recordings that cannot be used.

    Notes
    -----
    A departure begins where the edge, y = +-lane_offset + (vehicle_width - lane_width)/2, crosses the line outwards and
    ends where it comes back inside the same lane; both crossings are interpolated linearly. The criteria are those
    of Zhao, Wang, LeBlanc (2017), section III.

    Examples
    --------
    >>> t = np.arange(0, 10, 0.1)
    >>> beyond = np.clip(0.3 - 0.3 * (t - 5) ** 2, -0.5, None)
    >>> one = np.ones(t.size)
    >>> drive = Recording("a", t, beyond + 0.85, 3.6 * one, 25.0 * one, one > 0, curvature=0.0 * one)
    >>> found = extract_departures([drive])
    >>> len(found.departures), found.refused.total, round(float(found.departures.T[0]), 2)
    (1, 0, 2.0)
    """
    opened = recordings if isinstance(recordings, OpenedRecordings) else None
    width, step = (VEHICLE_WIDTH, None) if opened is None else (opened.reader.vehicle_width, opened.reader.step)
    chosen = preparation or Preparation(step=step)
    criteria = Criteria(
        width if vehicle_width is None else vehicle_width, min_duration, max_duration, min_speed, max_gap, max_jump
    )
    if not isinstance(recordings, OpenedRecordings):
        return merge_results([extract_items(recordings, criteria, chosen)], criteria, chosen)
    source = recordings.source
    results = [PartResult(problems=tuple(source.problems))]
    results += [extract_part(part, criteria, chosen) for part in source.parts]
    return merge_results(results, criteria, chosen, reader=recordings.reader.name, files=source.files)


def merge_results(
    results: Iterable[PartResult],
    criteria: Criteria,
    preparation: Preparation,
    *,
    reader: str = "table",
    files: Sequence[SourceFile] = (),
) -> Extraction:
    """The parts of an extraction as a whole.

    Parameters
    ----------
    results : iterable of PartResult
        In the order of the source's parts; a part without anything but problems may stand for the source's own.
    criteria : Criteria
        What counted as a departure.
    preparation : Preparation
        How recordings were brought to a common form.
    reader : str
        Its name.
    files : sequence of SourceFile
        What was read.

    Returns
    -------
    Extraction
        Departures, and the account of everything else.
    """
    whole = joined_results(results)
    refused = np.sum([account.refused.sum(axis=0) for account in whole.accounts], axis=0, initial=0)
    counts = np.broadcast_to(refused, (len(REASONS),))
    kinds, samples = whole.evidence.kinds, sum(account.samples for account in whole.accounts)
    usable = sum(account.usable for account in whole.accounts)
    said = warnings_in_words(
        whole.evidence,
        criteria.vehicle_width,
        preparation.nominal_lane_width,
        yaw_rate_factor=preparation.yaw_rate_factor,
        labelled=reader == "table",
    )
    provenance = Provenance(
        criteria=criteria,
        refused=Refused(**{reason: int(count) for reason, count in zip(REASONS, counts, strict=True)}),
        sources=tuple(files),
        recordings=sum(account.recordings for account in whole.accounts),
        samples=samples,
        invalid_samples=samples - usable,
        hours=sum(account.valid_ns for account in whole.accounts) / 3.6e12,
        curvature="none" if not kinds else kinds[0] if len(kinds) == 1 else "mixed",
        warnings=(*few_usable(samples, usable), *said),
        reader=reader,
        preparation=preparation,
        problems=tuple(str(problem) for problem in whole.problems),
    )
    departures = whole.departures
    # columns that are the same everywhere tell nothing
    idle = {SOURCE} if len({account.origin.source for account in whole.accounts}) <= 1 else set()
    scales = [column.values for column in departures.extra if column.name == SCALE]
    if preparation.nominal_lane_width is None and all(bool((values == 1.0).all()) for values in scales):
        idle.add(SCALE)
    departures = dataclasses.replace(departures, extra=tuple(c for c in departures.extra if c.name not in idle))
    return Extraction(departures, provenance, whole.accounts, whole.drawn, whole.problems)
