"""Several readers as one: a folder may hold the tables of two fleets."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.sources import RecordingPart, RecordingReader, RecordingSource
from ldctoolkit.recordings.trips.table_files import find_tables, shown_names


@dataclasses.dataclass(frozen=True)
class SourcesTogether:
    """Several sources, one after the other.

    Attributes
    ----------
    sources : tuple of RecordingSource
        In the order of their readers' names.
    unread : tuple of Problem
        Why other readers found nothing that they can use.
    """

    sources: tuple[RecordingSource, ...]
    unread: tuple[Problem, ...] = ()

    @property
    def parts(self) -> Sequence[RecordingPart]:
        """Of all sources."""
        return tuple(part for source in self.sources for part in source.parts)

    @property
    def files(self) -> Sequence[SourceFile]:
        """Of all sources."""
        return tuple(file for source in self.sources for file in source.files)

    @property
    def problems(self) -> Sequence[Problem]:
        """Of all sources; a file that one of them reads is no problem of another that it is not for."""
        files = [{file.name for file in source.files} for source in self.sources]
        read = set().union(*files)
        own = (
            problem
            for source, names in zip(self.sources, files, strict=True)
            for problem in source.problems
            if problem.file in names or problem.file not in read
        )
        return (*own, *self.unread)


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

    def open(self, paths: Sequence[Path]) -> SourcesTogether:
        """Look through the paths with each; each passes over the others' files.

        Raises
        ------
        RecordingError
            If none of them can use anything, or if two of them read the same file, whose departures would count twice.
        """
        sources: list[RecordingSource] = []
        opened: list[RecordingReader] = []
        errors: list[RecordingError] = []
        unread: list[Problem] = []
        for reader in self.readers:
            try:
                sources.append(reader.open(paths))
                opened.append(reader)
            except RecordingError as error:
                errors.append(error)
                unread.append(Problem(_file_for(reader, paths), "", str(error)))
        if not sources:
            raise errors[0]
        owner: dict[str, str] = {}
        for reader, source in zip(opened, sources, strict=True):
            for file in source.files:
                if owner.setdefault(file.sha256, reader.name) != reader.name:
                    said = self.recognise(paths)
                    raise RecordingError(
                        f"{file.name}: several readers know such files ({said}); choose one with --format"
                    )
        return SourcesTogether(tuple(sources), tuple(unread))


def _file_for(reader: RecordingReader, paths: Sequence[Path]) -> str:
    """Name of the first file that a reader knows, or else of the first path."""
    found = [path for path, _ in find_tables(paths)]
    for path, name in zip(found, shown_names(found), strict=True):
        if reader.recognise([path]):
            return name
    return paths[0].name


def agree(readers: Sequence[RecordingReader]) -> bool:
    """Whether one vehicle width and one step serve all of them."""
    return len({(reader.vehicle_width, reader.step) for reader in readers}) == 1
