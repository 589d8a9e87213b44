"""Sources in parts: what a part that fails leaves, opening, and a reader of somebody else's."""

from __future__ import annotations

import dataclasses
import pickle
import re
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, assert_same, drive
from ldctoolkit.errors import InputError, LdcError, RecordingError, UnknownNameError
from ldctoolkit.recordings import (
    Criteria,
    Preparation,
    Problem,
    Provenance,
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
from ldctoolkit.recordings.events import REASONS


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
                yield drive(name, t=-T)
            yield Problem("made.txt", "line 3", "odd") if name == "?" else drive(name, source="made")


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


def test_parts_one_by_one_are_the_whole(made, tmp_path):
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


def test_a_reader_that_fails_is_named(made, monkeypatch, tmp_path):
    path = tmp_path / "x.made"
    path.write_text("a")

    def failing(error: Exception):
        def open(self: Reader, paths: Sequence[Path]) -> Source:
            raise error

        return open

    for error, words in ((KeyError("x"), "KeyError: 'x'"), (OSError(5, "no disk"), r"OSError: \[Errno 5\] no disk")):
        monkeypatch.setattr(Reader, "open", failing(error))
        with pytest.raises(LdcError, match=f"^format 'made': open fails with {words}$"):
            open_recordings(path)
    monkeypatch.setattr(Reader, "open", failing(RecordingError("x.made: nothing in it")))
    with pytest.raises(RecordingError, match=r"^x\.made: nothing in it$"):
        open_recordings(path)
    monkeypatch.setattr(Reader, "open", lambda self, paths: None)
    with pytest.raises(LdcError, match=r"^format 'made': open fails with AttributeError: "):
        open_recordings(path)


def test_two_parts_with_the_same_key(made, monkeypatch, tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.made").write_text(folder)
    with pytest.raises(
        LdcError, match=r"^format 'made': 2 parts have the key 'x\.made'; allowed: a key for each part$"
    ):
        open_recordings([tmp_path / "a" / "x.made", tmp_path / "b" / "x.made"])


@dataclasses.dataclass(frozen=True)
class Shown(Part):
    shown: Any = ""


@pytest.mark.parametrize(("shown", "told"), [("april/x.made", "april/x.made"), ("", "0-x.made"), (None, "0-x.made")])
def test_a_part_is_told_under_the_name_that_it_shows(shown, told):
    result = extract_part(Shown("0-x.made", ("!",), shown=shown), Criteria(1.8), Preparation(0.1))
    assert [problem.file for problem in result.problems] == [told]


DOCS = Path(__file__).resolve().parents[3] / "docs"


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), flags=re.S)


def log(path: Path, *, driver: str = "driver Ann", side: int = 1) -> None:
    """What the guide's logger writes; one departure."""
    rows = [f"{round(1000 * t)} {-100 * side * y:.2f} 360 90 {0.6 * side:.3f}" for t, y in zip(T, OFFSET, strict=True)]
    path.write_text("\n".join([driver, *rows, ""]), encoding="utf-8")


@pytest.fixture
def guide(tmp_path, monkeypatch):
    """The guide's package, installed as pip leaves a pure one."""
    site, point = tmp_path / "site", tomllib.loads(blocks("writing-a-reader.md", "toml")[0])["project"]
    (site / "lane_logs").mkdir(parents=True)
    (site / "lane_logs" / "__init__.py").write_text("")
    (site / "lane_logs" / "reader.py").write_text(blocks("writing-a-reader.md", "python")[0], encoding="utf-8")
    info = site / "lane_logs-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {point['name']}\nVersion: {point['version']}\n")
    lines = [f"{key} = {value}" for key, value in point["entry-points"][readers.GROUP].items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{readers.GROUP}]", *lines]))
    monkeypatch.syspath_prepend(site)
    for cache in (readers._installed, readers.recording_reader):
        cache.cache_clear()
    yield tmp_path
    for cache in (readers._installed, readers.recording_reader):
        cache.cache_clear()
    for name in ("lane_logs.reader", "lane_logs"):
        sys.modules.pop(name, None)


def test_the_guides_reader(guide):
    folder = guide / "logs"
    folder.mkdir()
    log(folder / "a.lane")
    log(folder / "b.lane", driver="driver Bob", side=-1)
    text = (folder / "b.lane").read_text().splitlines()
    text[10], text[20] = "900 x", text[5]
    (folder / "b.lane").write_text("\n".join(text))
    (folder / "notes.lane").write_text("nothing")
    (folder / "bad.lane").write_bytes(b"driver \xff\n0 0 0 0 0\n")

    opened = open_recordings(folder)
    assert (opened.reader.name, opened.found) == ("lane-logs", "3 lane logs")
    assert isinstance(opened.reader, RecordingReader)
    assert isinstance(opened.source, RecordingSource)
    assert all(isinstance(pickle.loads(pickle.dumps(part)), RecordingPart) for part in opened.source.parts)
    found = extract_departures(opened, vehicle_width=1.8)
    d = found.departures
    assert (d.recording.tolist(), d.side.tolist()) == (["a", "b"], [1, -1])
    np.testing.assert_allclose(d.d_y, 0.3, atol=2e-3)
    np.testing.assert_allclose(d.T, 1.9, atol=0.01)
    # both bend towards the departed side
    np.testing.assert_allclose(d.c_0, np.radians(0.6) / 25.0, rtol=1e-6)
    assert {column.name: column.values.tolist() for column in d.extra} == {
        "source": ["a.lane", "b.lane"],
        "driver": ["Ann", "Bob"],
    }
    told = [str(problem) for problem in found.problems]
    assert told[0] == "notes.lane, line 1: no line 'driver NAME'; it is left out"
    assert [words.partition(":")[0] for words in told[1:3]] == ["b.lane, line 11", "b.lane, line 21"]
    assert "bad.lane: cannot be read" in told[3] or "bad.lane: cannot be read" in told[1]
    assert [file.name for file in found.provenance.sources] == ["a.lane", "b.lane", "bad.lane"]


def test_the_python_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("recordings.md", "python")
    exec(compile(code, "recordings.md", "exec"), {"__name__": "page"})
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert first.startswith("table ")
    assert second == "3 1.0 minutes"
    assert (tmp_path / "departures.parquet").is_file()


def test_the_page_names_everything():
    """Every format, every reason, every setting that the metadata hold."""
    text = (DOCS / "recordings.md").read_text(encoding="utf-8")
    names = [*reader_names(), *REASONS]
    names += [field.name for kind in (Preparation, Provenance) for field in dataclasses.fields(kind)]
    for name in names:
        assert f"`{name}`" in text, name
    for name in ("table", "spmd-das1", "spmd-das2", "uah-driveset"):
        reader = recording_reader(name)
        step = "as recorded" if reader.step is None else f"{reader.step:g} s"
        assert re.search(rf"^\| `{name}` \|.*\| {reader.vehicle_width:g} m \| {step} \|$", text, re.M), name
