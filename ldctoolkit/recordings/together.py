"""Several readers as one: a folder may hold the tables of two fleets."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.sources import FoundParts, RecordingPart, RecordingReader, RecordingSource
from ldctoolkit.recordings.trips.table_files import find_tables, shown_names


@dataclasses.dataclass(frozen=True)
class ReadersTogether:
    """Readers with the same vehicle width and step, for paths that hold files of each.

    Attributes
    ----------
    readers : tuple of RecordingReader
        Two or more, by name.
    """

    readers: tuple[RecordingReader, ...]

    @property
    def name(self) -> str:
        """Names of all of them."""
        return " + ".join(reader.name for reader in self.readers)

    @property
    def title(self) -> str:
        """Titles of all of them."""
        return "; ".join(reader.title for reader in self.readers)

    @property
    def vehicle_width(self) -> float:
        """The same for all [m]."""
        return self.readers[0].vehicle_width

    @property
    def step(self) -> float | None:
        """The same for all [s]."""
        return self.readers[0].step

    def recognise(self, paths: Sequence[Path]) -> str:
        """What each of them finds."""
        said = ((reader.name, reader.recognise(paths)) for reader in self.readers)
        return "; ".join(f"{name}: {words}" for name, words in said if words)

    def open(self, paths: Sequence[Path]) -> FoundParts[RecordingPart]:
        """Look through the paths with each; each passes over the others' files.

        Raises
        ------
        RecordingError
            If none of them can use anything, or if two of them read the same file, whose departures would count twice.
        """
        sources: list[RecordingSource] = []
        errors: list[RecordingError] = []
        unread: list[Problem] = []
        owner: dict[str, str] = {}
        for reader in self.readers:
            try:
                source = reader.open(paths)
            except RecordingError as error:
                errors.append(error)
                unread.append(Problem(_file_for(reader, paths), "", str(error)))
                continue
            sources.append(source)
            for file in source.files:
                if owner.setdefault(file.sha256, reader.name) != reader.name:
                    raise RecordingError(
                        f"{file.name}: several readers know such files ({self.recognise(paths)}); choose one with "
                        "--format"
                    )
        if not sources:
            raise errors[0]
        names = [{file.name for file in source.files} for source in sources]
        read = set().union(*names)
        problems = [
            problem
            for source, own in zip(sources, names, strict=True)
            for problem in source.problems
            if problem.file in own or problem.file not in read  # else a file that another one is for
        ]
        parts = tuple(part for source in sources for part in source.parts)
        files = tuple(file for source in sources for file in source.files)
        return FoundParts(parts, files, (*problems, *unread))


def _file_for(reader: RecordingReader, paths: Sequence[Path]) -> str:
    """Name of the first file that a reader knows, or else of the first path."""
    found = [path for path, _ in find_tables(paths)]
    for path, name in zip(found, shown_names(found), strict=True):
        if reader.recognise([path]):
            return name
    return paths[0].name
