"""Driving recordings in, departures out.

`read_recordings` opens plain recording tables, `extract_departures` finds the lane departures in them, and
`write_departures` and `read_departures` keep them in a departures table. The formats, the rules and the reasons for
refusing a candidate are described in ``docs/recordings.md``.
"""

from ldctoolkit.recordings.departures_table import read_departures, write_departures
from ldctoolkit.recordings.extract import extract_departures
from ldctoolkit.recordings.read import Recordings, SourceFile, read_recordings
from ldctoolkit.recordings.result import Criteria, Extraction, Provenance, Refused
from ldctoolkit.recordings.table import RecordingTable

__all__ = [
    "Criteria",
    "Extraction",
    "Provenance",
    "RecordingTable",
    "Recordings",
    "Refused",
    "SourceFile",
    "extract_departures",
    "read_departures",
    "read_recordings",
    "write_departures",
]
