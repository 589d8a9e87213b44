"""Reader for the SPMD tables DataLane and DataWsu (data acquisition system 1).

The lane table has the camera's distances, the other one the vehicle's own signals and its GPS; rows of both belong
together by device, trip and time, which is in centiseconds.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.sources import FoundParts
from ldctoolkit.recordings.spmd.das1_part import LANE, WSU, Das1Part, trip_bytes
from ldctoolkit.recordings.trips.look_through import look_through, recognised
from ldctoolkit.recordings.trips.table_header import TableLayout, check_columns, read_header
from ldctoolkit.recordings.trips.trip_index import TripIndex
from ldctoolkit.recordings.trips.trip_rows import TripTable, batches, collect_trips

PART_BYTES: Final = 24 << 20
"""Text of both tables that is read in one go."""

KEY: Final = ("Device", "Trip")
_COLUMNS: Final = {"DataLane": LANE, "DataWsu": WSU}
_TOLD_BY: Final = {"DataLane": ("LaneDistanceLeft", "LaneDistanceRight"), "DataWsu": ("SpeedWsu", "YawRateWsu")}
_NAMED: Final = re.compile(r"data[ _-]?(lane|wsu)", re.IGNORECASE)


@dataclasses.dataclass(frozen=True)
class SpmdDas1:
    """The reader ``spmd-das1``.

    Attributes
    ----------
    name, title : str
        How it is called.
    vehicle_width : float [m]
        Twice the distance of 0.91 m from centre to edge that published queries of these tables use.
    step : float [s]
        The tables' own.
    part_bytes : int
        About how much text a part reads.

    Examples
    --------
    >>> SpmdDas1().step
    0.1
    """

    name: str = "spmd-das1"
    title: str = "SPMD tables DataLane and DataWsu"
    vehicle_width: float = 1.82
    step: float | None = 0.1
    part_bytes: int = PART_BYTES

    def recognise(self, paths: Sequence[Path]) -> str:
        """What was found if there is such a table among the files or in the folders."""
        return recognised(paths, _named, lambda path: _kind(read_header(path).columns))

    def open(self, paths: Sequence[Path]) -> FoundParts[Das1Part]:
        """Look through the tables for where each trip lies.

        Raises
        ------
        RecordingError
            If there is no lane table or no other table, or no trip in the lane tables. Trips of these alone give
            recordings without a speed.
        """
        found, problems = look_through(paths, _named, _layout_of)
        tables = {kind: [(one.table, one.index) for one in found if one.layout.kind == kind] for kind in _COLUMNS}
        files = tuple(
            SourceFile(one.name, index.bytes, index.sha256) for some in tables.values() for one, index in some
        )
        parts = self._parts(tables["DataLane"], tables["DataWsu"], problems)
        return FoundParts(parts, files, tuple(problems))

    def _parts(
        self,
        lane: Sequence[tuple[TripTable, TripIndex]],
        wsu: Sequence[tuple[TripTable, TripIndex]],
        problems: list[Problem],
    ) -> tuple[Das1Part, ...]:
        for kind, some in (("DataLane", lane), ("DataWsu", wsu)):
            if not some:
                needed = f"no table {kind} (columns {', '.join((*KEY, *_COLUMNS[kind]))}) was found"
                raise RecordingError("; ".join([f"spmd-das1: {needed}", *map(str, problems[:5])]))
        lanes, odd = collect_trips(lane)
        problems += odd
        others, odd = collect_trips(wsu)
        problems += odd
        together = []
        for key, (number, stretches) in lanes.items():
            # a trip that the other table lacks is read as well: it counts, though nothing of it can be used
            other, there = others.get(key, (0, ()))
            together.append((number, other, stretches[0].begin, stretches, there))
        together.sort(key=lambda trip: trip[:3])
        parts: list[Das1Part] = []
        for batch in batches(
            together, lambda trip: trip_bytes(trip[3:]), self.part_bytes, lambda one, after: one[:2] != after[:2]
        ):
            number, other, _, stretches, _ = batch[0]
            key_ = f"{lane[number][0].name}:{stretches[0].device}/{stretches[0].trip}"
            parts.append(Das1Part(key_, lane[number][0], wsu[other][0], tuple(trip[3:] for trip in batch)))
        if not parts:
            told = "".join(f"; {problem}" for problem in problems[:5])
            raise RecordingError(f"spmd-das1: no trip of a table DataLane was found{told}")
        return tuple(parts)


def _kind(columns: Sequence[str]) -> str:
    """Which table has these columns; empty for neither."""
    lower = {name.lower() for name in columns}
    for kind, telling in _TOLD_BY.items():
        if lower.issuperset(name.lower() for name in telling):
            return kind
    return ""


def _named(path: Path) -> str:
    """Which table the file's name speaks of; empty for none."""
    match = _NAMED.search(path.name)
    if match is None or "summary" in path.name.lower():
        return ""
    return "DataLane" if match[1].lower() == "lane" else "DataWsu"


def _unknown(columns: Sequence[str]) -> str:
    shown = ", ".join(columns[:8]) + (", ..." if len(columns) > 8 else "")
    return f"neither the columns of DataLane nor those of DataWsu: {shown[:120]}; the file is left out"


def _layout_of(path: Path) -> tuple[TableLayout | None, str]:
    """Which table a file is, and what is odd about it."""
    header = read_header(path)
    kind = _kind(header.columns)
    if not kind:
        return None, _unknown(header.columns)
    check_columns(header.columns, KEY, _COLUMNS[kind])
    words = f"the columns are those of {kind}, the name is not; read as {kind}. Are two files swapped?"
    return TableLayout(header.columns, header.begin, kind=kind), words if _named(path) not in ("", kind) else ""


READER: Final = SpmdDas1()
