"""Sources in parts: what a part that fails leaves, opening, and a reader of somebody else's."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ldctoolkit.errors import InputError, LdcError, RecordingError, UnknownNameError
from ldctoolkit.recordings import (
    Criteria,
    OpenedRecordings,
    Preparation,
    Problem,
    Recording,
    RecordingPart,
    RecordingReader,
    RecordingSource,
    SourceFile,
    extract_departures,
    extract_part,
    merge_results,
    open_recordings,
    reader_names,
    recording_reader,
)
from ldctoolkit.recordings import sources as readers

T = np.arange(100) * 0.1
OFFSET = 0.9 + np.clip(0.3 * (1.0 - ((T - 5.0) / 0.95) ** 2), -0.4, None)


def drive(name: str) -> Recording:
    full = np.full(100, 25.0)
    return Recording(name, T, OFFSET, full - 21.4, full, full > 0.0, curvature=0.0 * full, source="made")


@dataclasses.dataclass(frozen=True)
class Part:
    """Recordings by name; "!" raises, "?" is a problem, "~" a recording that refuses itself."""

    key: str
    names: tuple[str, ...]
    bytes: int = 1

    def read(self) -> Iterator[Recording | Problem]:
        for name in self.names:
            if name == "!":
                raise RecordingError("made.txt, line 7: the file ends in a row")
            if name == "~":
                yield dataclasses.replace(drive(name), t=-T)
            yield Problem("made.txt", "line 3", "odd") if name == "?" else drive(name)


@dataclasses.dataclass(frozen=True)
class Source:
    parts: tuple[Part, ...]
    files: tuple[SourceFile, ...] = (SourceFile("made.txt", 1, "0" * 64),)
    problems: tuple[Problem, ...] = (Problem("readme.md", "", "is no recording"),)


class Reader:
    name = "made"
    title = "made here"
    vehicle_width = 1.8
    step: float | None = 0.1

    def recognise(self, paths: Sequence[Path]) -> str:
        return "made" if all(path.suffix == ".made" for path in paths) else ""

    def open(self, paths: Sequence[Path]) -> Source:
        return Source(tuple(Part(path.name, tuple(path.read_text().split())) for path in paths))


@pytest.fixture
def made(monkeypatch):
    """The reader is installed beside the others."""

    class Point:
        value = "made:READER"

        def load(self) -> Any:
            return Reader()

    points = readers._installed() | {"made": Point()}
    readers.recording_reader.cache_clear()
    monkeypatch.setattr(readers, "_installed", lambda: points)
    yield
    readers.recording_reader.cache_clear()


def test_the_protocols():
    part = Part("a", ("x",))
    assert isinstance(part, RecordingPart)
    assert isinstance(Source((part,)), RecordingSource)
    assert isinstance(Reader(), RecordingReader)
    for name in reader_names():
        reader = recording_reader(name)
        assert isinstance(reader, RecordingReader)
        assert 1.0 < reader.vehicle_width < 2.5
        assert reader.step is None or 0.01 <= reader.step <= 1.0
    assert {"table", "spmd-das1", "spmd-das2", "uah-driveset"} <= set(reader_names())


def test_a_part_that_fails_keeps_what_it_gave():
    result = extract_part(Part("0-made.txt", ("a", "?", "b", "!", "c")), Criteria(1.8), Preparation(0.1))
    assert result.departures.recording.tolist() == ["a", "b"]
    assert [str(problem) for problem in result.problems] == [
        "made.txt, line 3: odd",
        "0-made.txt: the rest of this part is left out: made.txt, line 7: the file ends in a row",
    ]
    result = extract_part(Part("0-made.txt", ("a", "~", "c")), Criteria(1.8), Preparation(0.1))
    assert result.departures.recording.tolist() == ["a"]
    assert "recording '~': t[1] = -0.1 s after -0.0 s" in str(result.problems[0])
    nothing = extract_part(Part("0-made.txt", ("!",)), Criteria(1.8), Preparation(0.1))
    assert (nothing.departures.n, nothing.accounts, len(nothing.problems)) == (0, (), 1)


def test_opening_finds_the_reader(made, tmp_path):
    paths = []
    for i, names in enumerate(("a b", "? c !", "d")):
        paths.append(tmp_path / f"{i}.made")
        paths[-1].write_text(names)
    opened = open_recordings(paths)
    assert (opened.reader.name, opened.found) == ("made", "made")
    found = extract_departures(opened)
    assert found.departures.recording.tolist() == ["a", "b", "c", "d"]
    assert [problem.file for problem in found.problems] == ["readme.md", "made.txt", "1.made"]
    provenance = found.provenance
    assert (provenance.reader, provenance.criteria.vehicle_width) == ("made", 1.8)
    assert provenance.preparation == Preparation(0.1)
    assert provenance.sources == (SourceFile("made.txt", 1, "0" * 64),)
    # the user's word counts more than the reader's
    other = extract_departures(opened, vehicle_width=1.7, preparation=Preparation(0.2))
    assert (other.provenance.criteria.vehicle_width, other.provenance.preparation.step) == (1.7, 0.2)


def test_parts_one_by_one_are_the_whole(made, tmp_path, assert_same):
    """Read anywhere, in any order, also after a trip to another process."""
    for i in range(5):
        (tmp_path / f"{i}.made").write_text(" ".join(f"r{i}{k}" for k in range(i + 1)) + " ?" * (i % 2))
    opened = open_recordings(sorted(tmp_path.iterdir()), format="made")
    criteria, preparation = Criteria(1.8), Preparation(0.1)
    parts = [pickle.loads(pickle.dumps(part)) for part in opened.source.parts]
    results = {part.key: extract_part(part, criteria, preparation) for part in parts[::-1]}
    ordered = [results[part.key] for part in opened.source.parts]
    merged = merge_results(ordered, criteria, preparation, reader="made")
    whole = extract_departures(opened)
    assert_same(merged, whole)
    assert merged.problems == whole.problems[1:]  # those of the source itself come first
    assert len({part.key for part in opened.source.parts}) == 5


def test_paths_that_cannot_be_opened(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="paths: none given"):
        open_recordings([])
    with pytest.raises(RecordingError, match=r"x\.csv: given twice"):
        open_recordings([path, tmp_path / "." / "x.csv"])
    with pytest.raises(RecordingError, match=r"x\.csv: no reader knows such files; allowed: .*table"):
        open_recordings(path)
    with pytest.raises(RecordingError, match="nowhere: does not exist"):
        open_recordings("nowhere")
    with pytest.raises(RecordingError, match=r"cannot be read|does not exist"):
        open_recordings("x\0y")
    with pytest.raises(UnknownNameError, match=r"format 'tabel': no such reader; did you mean 'table'\?"):
        open_recordings(path, format="tabel")


def test_several_readers_may_not_know_the_same(made, monkeypatch, tmp_path):
    path = tmp_path / "x.made"
    path.write_text("a")
    table = recording_reader("table")
    monkeypatch.setattr(type(table), "recognise", lambda self, paths: "anything")
    with pytest.raises(RecordingError, match=r"several readers know such files \(made: made; table: anything\)"):
        open_recordings(path)
    assert open_recordings(path, format="made").reader.name == "made"


@pytest.mark.parametrize(
    ("loaded", "message"),
    [
        (ImportError("no module named x"), r"cannot be loaded: no module named x"),
        (ValueError("bad"), r"cannot be loaded: ValueError: bad"),
        (object(), r"allowed: name, title, vehicle_width, step, recognise, open"),
        (Reader(), r"its name is 'made'; allowed: the same as here"),
    ],
)
def test_readers_that_are_not_readers(monkeypatch, loaded, message):
    class Point:
        value = "somewhere:READER"

        def load(self) -> Any:
            if isinstance(loaded, Exception):
                raise loaded
            return loaded

    monkeypatch.setattr(readers, "_installed", lambda: {"other": Point()})
    readers.recording_reader.cache_clear()
    with pytest.raises(LdcError, match=rf"format 'other' \(somewhere:READER\).*{message}"):
        recording_reader("other")
    readers.recording_reader.cache_clear()


def test_opened_recordings_are_plain():
    opened = OpenedRecordings(Reader(), Source((Part("a", ("x",)),)), "something")
    assert len(extract_departures(opened).departures) == 1
