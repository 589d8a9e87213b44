"""Reader for the SPMD table HV_Primary (data acquisition system 2): lane tracker, vehicle and GPS in one row."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.sources import FoundParts
from ldctoolkit.recordings.spmd import das2_columns as names
from ldctoolkit.recordings.spmd.das2_columns import layout_of
from ldctoolkit.recordings.table import measured
from ldctoolkit.recordings.trips.look_through import look_through, recognised
from ldctoolkit.recordings.trips.table_header import TableLayout
from ldctoolkit.recordings.trips.table_text import Cells
from ldctoolkit.recordings.trips.trip_index import Stretch
from ldctoolkit.recordings.trips.trip_rows import TripTable, batches, collect_trips, read_trips

PART_BYTES: Final = 32 << 20
"""Text that is read in one go."""

USABLE_PROBABILITY: Final = 500.0
"""Both markers must exist with at least this probability, of 1000."""

WIDTH_TOLERANCE: Final = 0.5
"""The markers must be as far apart as the tracker's lane width says, within this [m]: else one of them is not the
lane's, and the width is an assumed one (12 feet)."""


@dataclasses.dataclass(frozen=True)
class Das2Part:
    """Some trips of a table.

    Attributes
    ----------
    key : str
        Names the file and the first trip.
    table : TripTable
        The file.
    cells : tuple of int
        Allowed numbers of cells in a row.
    trips : tuple of tuple of Stretch
        Where each trip lies.
    """

    key: str
    table: TripTable
    cells: tuple[int, ...]
    trips: tuple[tuple[Stretch, ...], ...]

    @property
    def bytes(self) -> int:
        """Text that is read."""
        return sum(map(_bytes, self.trips))

    def read(self) -> Iterator[Recording | Problem]:
        """Recordings in the order of the table; problems come first."""
        wanted = self.table.spelled((*names.REQUIRED, *names.OPTIONAL))
        rows = read_trips(self.table, self.trips, wanted, time="Time", cells=self.cells)
        yield from rows.problems
        columns = signals_of(rows.cells)
        missing = [name for name in names.OPTIONAL if name not in wanted]
        notes = (f"no column {', '.join(missing)}",) if missing else ()
        ends = np.searchsorted(rows.trip, np.arange(len(self.trips) + 1))
        for stretches, begin, end in zip(self.trips, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            if begin == end:
                continue  # every row was left out, and told
            name = f"{stretches[0].device}/{stretches[0].trip}"
            own: dict[str, Any] = {
                key: None if column is None else column[begin:end] for key, column in columns.items()
            }
            yield Recording(name, source=self.table.name, notes=notes, **own)


def _bytes(trip: Sequence[Stretch]) -> int:
    return sum(one.end - one.begin for one in trip)


def signals_of(cells: Cells) -> dict[str, Any]:
    """Columns of a `Recording` from the cells of rows.

    Numbers of 1e9 or more in size count as missing. The tracker's flags for crossings and lane changes are not used:
    what sets them is not documented.
    """

    def column(name: str) -> FloatArray:
        if name not in cells.names:
            return np.full(cells.row.size, np.nan)
        return measured(cells[name])

    left, right, told = column(names.LEFT) / 1000.0, column(names.RIGHT) / 1000.0, column(names.WIDTH) / 1000.0
    width = right - left
    agree = ~(told > 0.0) | (np.abs(width - told) <= WIDTH_TOLERANCE)  # without a told width nothing contradicts
    seen = np.minimum(column(names.LEFT_PROBABILITY), column(names.RIGHT_PROBABILITY)) >= USABLE_PROBABILITY
    gps = column(names.GPS_VALID) == 1.0
    speed = column(names.SPEED)
    signal = (column(names.LEFT_SIGNAL) > 0.0).astype(np.int64) - (column(names.RIGHT_SIGNAL) > 0.0)
    return {
        "t": cells["Time"] / 1000.0,
        "lane_offset": 0.5 * (left + right),
        "lane_width": width,
        "speed": np.where(np.isfinite(speed), speed, np.where(gps, column(names.GPS_SPEED), np.nan)),
        "valid": seen & agree & (width > 0.0),
        "yaw_rate": np.radians(column(names.YAW_RATE)) if names.YAW_RATE in cells.names else None,
        "heading": np.where(gps, -np.radians(column(names.GPS_HEADING)), np.nan),
        "turn_signal": signal.astype(np.int64),
    }


@dataclasses.dataclass(frozen=True)
class SpmdDas2:
    """The reader ``spmd-das2``.

    Attributes
    ----------
    name, title : str
        How it is called.
    vehicle_width : float [m]
        Twice the distance of 0.91 m from centre to edge that published queries of these tables use.
    step : float [s]
        The table's own.
    part_bytes : int
        About how much text a part reads.

    Examples
    --------
    >>> SpmdDas2().step
    0.1
    """

    name: str = "spmd-das2"
    title: str = "SPMD table HV_Primary"
    vehicle_width: float = 1.82
    step: float | None = 0.1
    part_bytes: int = PART_BYTES

    def recognise(self, paths: Sequence[Path]) -> str:
        """What was found if there is such a table among the files or in the folders."""
        return recognised(paths, _named, _kind)

    def open(self, paths: Sequence[Path]) -> FoundParts[Das2Part]:
        """Look through the tables for where each trip lies.

        Raises
        ------
        RecordingError
            If there is no such table, or no trip in any.
        """
        found, problems = look_through(paths, _named, _layout_and_words)
        trips, odd = collect_trips([(one.table, one.index) for one in found])
        problems += odd
        if not trips:
            told = "".join(f"; {problem}" for problem in problems[:5])
            raise RecordingError(f"spmd-das2: no trip of a table HV_Primary was found{told}")
        files = tuple(SourceFile(one.table.name, one.index.bytes, one.index.sha256) for one in found)
        parts: list[Das2Part] = []
        for number, one in enumerate(found):
            own = [stretches for where, stretches in trips.values() if where == number]
            parts += self._parts(one.table, one.layout, own)
        return FoundParts(tuple(parts), files, tuple(problems))

    def _parts(self, table: TripTable, layout: TableLayout, trips: Sequence[tuple[Stretch, ...]]) -> Iterator[Das2Part]:
        for batch in batches(trips, _bytes, self.part_bytes):
            first = batch[0][0]
            yield Das2Part(f"{table.name}:{first.device}/{first.trip}", table, layout.cells, batch)


def _named(path: Path) -> str:
    """The table, if the file's name speaks of it."""
    return "HV_Primary" if re.search(r"hv[ _-]?primary", path.name, re.IGNORECASE) else ""


def _kind(path: Path) -> str:
    layout = layout_of(path)
    return "" if layout is None else "HV_Primary" if layout.line > 1 else "HV_Primary without a header"


def _layout_and_words(path: Path) -> tuple[TableLayout | None, str]:
    """How a file's rows are laid out, or why it is no such table."""
    layout = layout_of(path)
    cells = " or ".join(map(str, names.CELLS))
    words = f"neither the columns of HV_Primary nor rows of {cells} cells that begin with numbers; the file is left out"
    return layout, "" if layout else words


READER: Final = SpmdDas2()
