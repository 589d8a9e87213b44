"""How recordings were read, in words: format, widths, steps, criteria."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import Criteria, Extraction, Preparation, RecordingReader, recording_reader
from ldctoolkit.recordings.extract_part import SCALE, SOURCE
from ldctoolkit.recordings.opened import ReadersTogether
from studies.report.words.text import compact, plural

_CURVATURE = {
    "measured": "recorded by the source",
    "yaw_rate": "from yaw rate and speed",
    "none": "not recorded: taken as 0",
    "mixed": "recorded in some of the recordings, from yaw rate and speed or taken as 0 in others",
}

AnyReader = RecordingReader | ReadersTogether


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


def _reader(name: str) -> AnyReader | None:
    try:
        readers = tuple(map(recording_reader, name.split(" + ")))
    except LdcError:  # a reader that is not installed here: its defaults are not known
        return None
    return readers[0] if len(readers) == 1 else ReadersTogether(readers)


def _width_from(width: float, reader: AnyReader | None) -> str:
    if reader is None:
        return "as given"
    if width == reader.vehicle_width:
        return f"what {reader.name} takes unless another is given"
    return f"given by the user; {reader.name} takes {compact(reader.vehicle_width)} m by itself"


def _step(step: float | None, reader: AnyReader | None) -> str:
    if step is None:
        return "as recorded"
    own = " (the reader's own)" if reader is not None and step == reader.step else ""
    return f"{compact(step)} s{own}, by local medians of valid samples"


def _nominal(extraction: Extraction) -> str:
    nominal = extraction.provenance.preparation.nominal_lane_width
    if nominal is None:
        return "none: lanes as recorded"
    said = f"{compact(nominal)} m: offset and width of each recording scaled to it"
    scales = next((one.values for one in extraction.departures.extra if one.name == SCALE), np.empty(0))
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
