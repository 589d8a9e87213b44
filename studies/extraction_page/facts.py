"""What the page says in words: summary, tiles, and how the recordings were read."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import Criteria, Extraction, Preparation, RecordingReader, recording_reader
from ldctoolkit.recordings.extract_part import SOURCE
from ldctoolkit.recordings.together import ReadersTogether
from studies.extraction_page.counts import SIDES, Row, reason_title
from studies.report.words.text import compact, number, percent, plural

_CURVATURE = {
    "measured": "recorded by the source",
    "yaw_rate": "from yaw rate and speed",
    "none": "not recorded: taken as 0",
    "mixed": "recorded in some of the recordings, from yaw rate and speed or taken as 0 in others",
}


@dataclasses.dataclass(frozen=True)
class Tile:
    """One large number at the top of the page."""

    value: str
    unit: str
    text: str
    detail: str


def hours(value: float) -> str:
    """Hours with two decimals where they are few.

    Examples
    --------
    >>> hours(0.5), hours(1234.5)
    ('0.50', '1,234')
    """
    return number(value, 2) if value < 10.0 else number(value, 1) if value < 100.0 else f"{value:,.0f}"


def rate(value: float) -> str:
    """Events per hour; a dash without any hours.

    Examples
    --------
    >>> rate(12.34), rate(0.034)
    ('12.3', '0.034')
    """
    if not math.isfinite(value):
        return number(value)
    return number(value, 0 if value >= 100.0 else 1 if value >= 10.0 else 2 if value >= 0.1 or value == 0.0 else 3)


def size(count: int) -> str:
    """Bytes in a unit that gives a short number, powers of ten.

    Examples
    --------
    >>> size(17), size(31_400_000)
    ('17 B', '31.4 MB')
    """
    value, units = float(count), iter(("kB", "MB", "GB", "TB"))
    unit = "B"
    while value >= 999.5 and unit != "TB":
        value, unit = value / 1000.0, next(units)
    return f"{value:.0f} {unit}" if unit == "B" or value >= 99.95 else f"{value:.1f} {unit}"


def side_counts(extraction: Extraction) -> tuple[int, int]:
    """Departures left and right."""
    left = int(np.sum(extraction.departures.side == LEFT))
    return left, extraction.departures.n - left


def summary(extraction: Extraction, whole: Row | None, sources: int) -> list[str]:
    """Parts of the line under the heading."""
    left, right = side_counts(extraction)
    return [
        f"{plural(left + right, 'departure')}: {left:,} left, {right:,} right",
        f"{plural(extraction.recordings, 'recording')} of {plural(sources, 'source')}",
        f"{hours(whole.account.hours_valid if whole else 0.0)} h valid",
        f"format {extraction.provenance.reader}",
    ]


def tiles(extraction: Extraction, whole: Row | None) -> list[Tile]:
    """Departures, how often, hours, refusals, faults."""
    left, right = side_counts(extraction)
    out = [Tile(f"{left + right:,}", "", "departures", f"{left:,} left, {right:,} right")]
    if whole is not None:
        rates = whole.rates
        said = ", ".join(f"{rate(one)} {side}" for one, side in zip(rates, SIDES, strict=True))
        out.append(Tile(rate(sum(rates)), "1/h", "departures in a valid hour", said))
        account = whole.account
        share = f"{percent(whole.valid_share, 0)} of {hours(account.hours_read)} h read"
        out.append(Tile(hours(account.hours_valid), "h", "valid", share))
        out.append(_refused(whole))
    faults = len(extraction.problems)
    said = plural(len(extraction.warnings), "warning")
    out.append(Tile(f"{faults:,}", "", "problem with the files" if faults == 1 else "problems with the files", said))
    return out


def _refused(whole: Row) -> Tile:
    refused, candidates = sum(whole.refused), int(whole.account.candidates.sum())
    reasons = {reason: count + whole.refusals(1)[reason] for reason, count in whole.refusals(0).items()}
    most = max(reasons, key=lambda reason: reasons[reason])
    share = percent(refused / candidates, 0) if candidates else ""
    detail = f"{share}; most often: {reason_title(most)}" if refused else f"of {plural(candidates, 'candidate')}"
    return Tile(f"{refused:,}", "", "candidates refused", detail)


def facts(extraction: Extraction) -> list[tuple[str, str]]:
    """Name and value of format, criteria and preparation."""
    origin = extraction.provenance
    criteria, preparation = origin.criteria, origin.preparation
    reader = _reader(origin.reader)
    valid = origin.samples - origin.invalid_samples
    return [
        ("Format", f"{origin.reader}{f' ({reader.title})' if reader else ''}"),
        (
            "Read",
            f"{plural(origin.recordings, 'recording')}, {plural(origin.samples, 'sample')}, {valid:,} of them valid",
        ),
        ("Vehicle width", f"{compact(criteria.vehicle_width)} m, {_width_from(criteria.vehicle_width, reader)}"),
        ("Time step", _step(preparation.step, reader)),
        ("Nominal lane width", _nominal(extraction)),
        ("Curvature", _curvature(extraction)),
        ("Duration", f"{compact(criteria.min_duration)} to {compact(criteria.max_duration)} s"),
        ("Mean speed", f"above {compact(criteria.min_speed)} m/s"),
        ("Longest step that is no gap", _gap(criteria, preparation)),
        ("Largest jump of the offset", f"{compact(criteria.max_jump)} m from one sample to the next"),
    ]


def _reader(name: str) -> RecordingReader | None:
    try:
        readers = tuple(map(recording_reader, name.split(" + ")))
    except LdcError:  # a reader that is not installed here: its defaults are not known
        return None
    return readers[0] if len(readers) == 1 else ReadersTogether(readers)


def _width_from(width: float, reader: RecordingReader | None) -> str:
    if reader is None:
        return "as given"
    if width == reader.vehicle_width:
        return f"what {reader.name} takes unless another is given"
    return f"given by the user; {reader.name} takes {compact(reader.vehicle_width)} m by itself"


def _step(step: float | None, reader: RecordingReader | None) -> str:
    if step is None:
        return "as recorded"
    own = " (the reader's own)" if reader is not None and step == reader.step else ""
    return f"{compact(step)} s{own}, by local medians of valid samples"


def _nominal(extraction: Extraction) -> str:
    nominal = extraction.provenance.preparation.nominal_lane_width
    if nominal is None:
        return "none: lanes as recorded"
    said = f"{compact(nominal)} m: offset and width of each recording scaled to it"
    scales = next((one.values for one in extraction.departures.extra if one.name == "lane_scale"), np.empty(0))
    if scales.size and scales.dtype.kind == "f":
        low, high = float(scales.min()), float(scales.max())
        said += f", by factors of {low:.3f} to {high:.3f} where there are departures"
    return said


def _curvature(extraction: Extraction) -> str:
    origin = extraction.provenance
    said = _CURVATURE.get(origin.curvature, origin.curvature)
    factor = origin.preparation.yaw_rate_factor
    return said if factor == 1.0 else f"{said}; yaw rate times {compact(factor)}"


def _gap(criteria: Criteria, preparation: Preparation) -> str:
    if criteria.max_gap is not None:
        return f"{compact(criteria.max_gap)} s"
    if preparation.step is not None:
        return f"{compact(preparation.max_gap)} s between valid samples, bridged by resampling"
    return "2.5 median steps of the recording, at least 0.25 s"


def source_column(extraction: Extraction) -> npt.NDArray[np.str_]:
    """Source of each departure; empty texts where all have the same."""
    for column in extraction.departures.extra:
        if column.name == SOURCE:
            return column.values.astype(np.str_)
    return np.zeros(extraction.departures.n, dtype=np.str_)
