"""Sources in parts: what a part that fails leaves, paths, and a reader of somebody else's."""

import dataclasses
import pickle
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.cli import ROOT, blocks, install, run_python
from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import (
    Criteria,
    Preparation,
    Problem,
    Provenance,
    Recording,
    RecordingPart,
    RecordingReader,
    RecordingSource,
    extract_departures,
    extract_part,
    open_recordings,
    reader_names,
    recording_reader,
)
from ldctoolkit.recordings import recording as readers
from ldctoolkit.recordings.find_departures import REASONS


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


@dataclasses.dataclass(frozen=True)
class Shown(Part):
    shown: Any = ""


@pytest.mark.parametrize(("shown", "name"), [("april/x.made", "april/x.made"), ("", "0-x.made"), (None, "0-x.made")])
def test_a_part_is_told_under_the_name_that_it_shows(shown, name):
    result = extract_part(Shown("0-x.made", ("!",), shown=shown), Criteria(1.8), Preparation(0.1))
    assert [problem.file for problem in result.problems] == [name]


def log(path: Path, *, driver: str = "driver Ann", side: int = 1) -> None:
    """What the guide's logger writes; one departure."""
    rows = [f"{round(1000 * t)} {-100 * side * y:.2f} 360 90 {0.6 * side:.3f}" for t, y in zip(T, OFFSET, strict=True)]
    path.write_text("\n".join([driver, *rows, ""]), encoding="utf-8")


@pytest.fixture
def guide(tmp_path, monkeypatch):
    """The guide's package, installed as pip leaves a pure one."""
    project, site = tmp_path / "lane-logs", tmp_path / "site"
    (project / "lane_logs").mkdir(parents=True)
    (project / "pyproject.toml").write_text(blocks("docs/how-to/my-reader.md", "toml")[0])
    (project / "lane_logs" / "__init__.py").write_text("")
    (project / "lane_logs" / "reader.py").write_text(blocks("docs/how-to/my-reader.md", "python")[0], encoding="utf-8")
    install(project, site)
    monkeypatch.syspath_prepend(site)
    for cache in (readers.entry_points, readers.recording_reader):
        cache.cache_clear()
    yield tmp_path
    for cache in (readers.entry_points, readers.recording_reader):
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
    extraction = extract_departures(opened, vehicle_width=1.8)
    d = extraction.departures
    assert (d.recording.tolist(), d.side.tolist()) == (["a", "b"], [1, -1])
    np.testing.assert_allclose(d.d_y, 0.3, atol=2e-3)
    np.testing.assert_allclose(d.T, 1.9, atol=0.01)
    # both bend towards the departed side
    np.testing.assert_allclose(d.c_0, np.radians(0.6) / 25.0, rtol=1e-6)
    assert {column.name: column.values.tolist() for column in d.extra} == {
        "source": ["a.lane", "b.lane"],
        "driver": ["Ann", "Bob"],
    }
    reported = [str(problem) for problem in extraction.problems]
    assert reported[0] == "notes.lane, line 1: no line 'driver NAME'; it is left out"
    assert [words.partition(":")[0] for words in reported[1:3]] == ["b.lane, line 11", "b.lane, line 21"]
    assert "bad.lane: cannot be read" in reported[3] or "bad.lane: cannot be read" in reported[1]
    assert [file.name for file in extraction.provenance.sources] == ["a.lane", "b.lane", "bad.lane"]


def test_the_python_of_the_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_python("docs/how-to/my-recordings.md", {"__name__": "page"})
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert (first[:6], second) == ("table ", "8 1.0 minutes")
    assert (tmp_path / "departures.parquet").is_file()


def test_the_page_names_everything():
    """Every format, every reason, every setting that the metadata hold."""
    text = (ROOT / "docs/how-to/my-recordings.md").read_text(encoding="utf-8")
    names = [*reader_names(), *REASONS]
    names += [field.name for kind in (Preparation, Provenance) for field in dataclasses.fields(kind)]
    for name in names:
        assert f"`{name}`" in text, name
    for name in ("table", "spmd-das1", "spmd-das2", "uah-driveset"):
        reader = recording_reader(name)
        step = "as recorded" if reader.step is None else f"{reader.step:g} s"
        assert re.search(rf"^\| `{name}` \|.*\| {reader.vehicle_width:g} m \| {step} \|$", text, re.M), name
