"""Driving recordings in, departures out.

`open_recordings` finds the reader for files or folders of any known kind, `read_recordings` reads them one by one,
`extract_departures` finds the lane departures in them, and `write_departures` and `read_departures` keep them in a
departures table. The formats, the rules and the reasons for refusing a candidate are described in
``docs/how-to/my-recordings.md``.
"""

from ldctoolkit.recordings.departures_table import (
    Extraction,
    PartResult,
    Provenance,
    read_all_departures,
    read_departures,
    write_departures,
)
from ldctoolkit.recordings.extract import extract_departures, extract_part, merge_results
from ldctoolkit.recordings.extraction_statistics import Account, Drawn, DrawnEvent, Origin
from ldctoolkit.recordings.find_departures import Criteria, Refused
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import (
    Label,
    OpenedRecordings,
    Problem,
    Recording,
    RecordingPart,
    RecordingReader,
    RecordingSource,
    SourceFile,
    open_recordings,
    read_recordings,
    reader_names,
    recording_reader,
)

__all__ = [
    "Account",
    "Criteria",
    "Drawn",
    "DrawnEvent",
    "Extraction",
    "Label",
    "OpenedRecordings",
    "Origin",
    "PartResult",
    "Preparation",
    "Problem",
    "Provenance",
    "Recording",
    "RecordingPart",
    "RecordingReader",
    "RecordingSource",
    "Refused",
    "SourceFile",
    "extract_departures",
    "extract_part",
    "merge_results",
    "open_recordings",
    "read_all_departures",
    "read_departures",
    "read_recordings",
    "reader_names",
    "recording_reader",
    "write_departures",
]
