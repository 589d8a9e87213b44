"""Several readers as one: a folder may hold the tables of two fleets."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.sources import RecordingPart, RecordingReader, RecordingSource


@dataclasses.dataclass(frozen=True)
class SourcesTogether:
    """Several sources, one after the other.

    Attributes
    ----------
    sources : tuple of RecordingSource
        In the order of their readers' names.
    """

    sources: tuple[RecordingSource, ...]

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
        """Of all sources."""
        return tuple(problem for source in self.sources for problem in source.problems)


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
            If two of them read the same file, whose departures would count twice.
        """
        sources = tuple(reader.open(paths) for reader in self.readers)
        owner: dict[str, str] = {}
        for reader, source in zip(self.readers, sources, strict=True):
            for file in source.files:
                if owner.setdefault(file.sha256, reader.name) != reader.name:
                    said = self.recognise(paths)
                    raise RecordingError(
                        f"{file.name}: several readers know such files ({said}); choose one with --format"
                    )
        return SourcesTogether(sources)


def agree(readers: Sequence[RecordingReader]) -> bool:
    """Whether one vehicle width and one step serve all of them."""
    return len({(reader.vehicle_width, reader.step) for reader in readers}) == 1
