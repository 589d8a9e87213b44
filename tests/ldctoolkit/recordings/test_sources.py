"""Readers by name: those that come along, those of third parties, and which one knows a folder."""

import dataclasses
import importlib.metadata
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.errors import refused
from ldctoolkit.errors import LdcError, RecordingError
from ldctoolkit.recordings import recording
from ldctoolkit.recordings.extract import extract_departures
from ldctoolkit.recordings.recording import (
    Problem,
    Recording,
    RecordingPart,
    RecordingSource,
    SourceFile,
    open_recordings,
)

OWN = ("mdf", "spmd-das1", "spmd-das2", "table", "uah-driveset")
INSTALLED = importlib.metadata.entry_points


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    """Nothing that a test installs outlives it."""
    recording.entry_points.cache_clear()
    recording.recording_reader.cache_clear()
    yield
    recording.entry_points.cache_clear()
    recording.recording_reader.cache_clear()


@dataclasses.dataclass(frozen=True)
class FlatPart:
    """One file with one departure, whatever it holds."""

    path: str
    key: str
    bytes: int = 1

    def read(self) -> Iterator[Recording | Problem]:
        t = np.arange(100) * 0.1
        y = np.clip(0.3 * (1.0 - ((t - 5.0) / 0.95) ** 2), -0.4, None)
        full = np.ones(100)
        yield Recording(self.key, t, 0.9 + y, 3.6 * full, 25.0 * full, full > 0, curvature=0.0 * full)
        yield Problem(self.key, "line 7", "odd")


@dataclasses.dataclass(frozen=True)
class FlatSource:
    parts: tuple[FlatPart, ...]
    files: tuple[SourceFile, ...] = ()
    problems: tuple[Problem, ...] = ()


class FlatReader:
    name = "flat"
    title = "flat files"
    vehicle_width = 1.8
    step = None

    def recognise(self, paths: Sequence[Path]) -> str:
        files = [path for path in paths if path.suffix == ".flat"]
        return f"{len(files)} flat" if files else ""

    def open(self, paths: Sequence[Path]) -> FlatSource:
        return FlatSource(tuple(FlatPart(str(path), path.name) for path in paths))


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Readers of a third party, as if a package of theirs were installed."""

    def add(**readers: Any) -> None:
        def entry_points(**choice: str) -> Any:
            points = list(INSTALLED(**choice))
            if choice.get("group") == recording.GROUP:
                points += [SimpleNamespace(name=n, value=f"theirs:{n}", load=load) for n, load in readers.items()]
            return points

        monkeypatch.setattr(importlib.metadata, "entry_points", entry_points)
        recording.entry_points.cache_clear()
        recording.recording_reader.cache_clear()

    return add


@pytest.mark.parametrize("loaded", [FlatReader(), FlatReader], ids=["instance", "class"])
def test_a_third_partys_reader(loaded: Any, install: Callable[..., None], tmp_path: Path) -> None:
    install(flat=lambda: loaded)
    path = tmp_path / "drive.flat"
    path.write_text("anything")
    assert recording.reader_names() == tuple(sorted((*OWN, "flat")))
    opened = open_recordings([path])
    assert (opened.reader.name, opened.found) == ("flat", "1 flat")
    assert isinstance(opened.source, RecordingSource)
    assert isinstance(opened.source.parts[0], RecordingPart)
    extraction = extract_departures(opened)
    assert extraction.departures.recording.tolist() == ["drive.flat"]
    assert [str(problem) for problem in extraction.problems] == ["drive.flat, line 7: odd"]


def test_a_reader_that_is_at_fault_is_named(install: Callable[..., None], tmp_path: Path) -> None:
    def load() -> Any:
        raise ZeroDivisionError("oops")

    class Careless(FlatReader):
        def recognise(self, paths: Sequence[Path]) -> str:
            return str(1 / len(paths[1:]))

    install(broken=load, renamed=lambda: FlatReader(), empty=lambda: object())
    with pytest.raises(LdcError, match=r"'empty' \(theirs:empty\): no reader of recordings; allowed: name, title"):
        recording.recording_reader("empty")
    with pytest.raises(LdcError, match=r"'broken' \(theirs:broken\): cannot be loaded: ZeroDivisionError: oops"):
        recording.recording_reader("broken")
    with pytest.raises(LdcError, match="its name is 'flat'"):
        recording.recording_reader("renamed")
    install(flat=lambda: Careless)
    with pytest.raises(LdcError, match="'flat': recognise fails with ZeroDivisionError"):
        open_recordings(tmp_path)


def test_two_parts_with_the_same_key(install: Callable[..., None], tmp_path: Path) -> None:
    install(flat=FlatReader)
    paths = [tmp_path / folder / "x.flat" for folder in "ab"]
    for path in paths:
        path.parent.mkdir()
        path.touch()
    with pytest.raises(
        LdcError, match=r"^format 'flat': 2 parts have the key 'x\.flat'; allowed: a key for each part$"
    ):
        open_recordings(paths)


TABLES = {
    "table": ("drive.csv", "recording,t,lane_offset,lane_width,speed\na,0,0,3.6,25\n"),
    "spmd-das1": (
        "DataLane.csv",
        "Device,Trip,Time,LaneDistanceLeft,LaneDistanceRight,LaneHeading,LaneQualityRight,LaneQualityLeft\n"
        "1,1,0,-1.8,1.8,0,3,3\n",
    ),
    "spmd-das2": ("HV_Primary.csv", ",".join(["10", "7", "0", *["0"] * 42]) + "\n"),
}


@pytest.mark.parametrize("name", TABLES)
def test_recognise_a_file(name: str, tmp_path: Path) -> None:
    file, text = TABLES[name]
    (tmp_path / file).write_text(text)
    readers = map(recording.recording_reader, recording.reader_names())
    assert [reader.name for reader in readers if reader.recognise([tmp_path / file])] == [name]


def test_no_reader_and_several(tmp_path: Path, install: Callable[..., None]) -> None:
    for file, text in TABLES.values():
        (tmp_path / file).write_text(text)
    (tmp_path / "notes.csv").write_text("a,b\n1,2\n")
    with pytest.raises(RecordingError, match=r"^notes.csv: no reader recognises this file; allowed: .*uah-driveset"):
        open_recordings([tmp_path / "notes.csv"])
    # plain tables are of another vehicle and step than the SPMD's
    with pytest.raises(RecordingError, match=r"several readers recognise this file \(.*spmd-das2: .*--format"):
        open_recordings([tmp_path])


WSU = (
    "Device,Trip,Time,GpsValidWsu,GpsSpeedWsu,GpsHeadingWsu,ValidCanWsu,YawRateWsu,SpeedWsu,TurnSngRWsu,TurnSngLWsu\n"
    "1,1,0,1,25,90,1,0,90,0,0\n"
)


def test_two_fleets_in_one_folder(tmp_path: Path) -> None:
    (tmp_path / "HV_Primary.csv").write_text(TABLES["spmd-das2"][1])
    (tmp_path / "DataLane.csv").write_text(TABLES["spmd-das1"][1])
    (tmp_path / "DataWsu.csv").write_text(WSU)
    opened = open_recordings([tmp_path])
    assert opened.reader.name == "spmd-das1 + spmd-das2"
    assert (opened.reader.vehicle_width, opened.reader.step) == (1.82, 0.1)
    assert opened.found == opened.reader.recognise([tmp_path])
    assert [file.name for file in opened.source.files] == ["DataLane.csv", "DataWsu.csv", "HV_Primary.csv"]
    extraction = extract_departures(opened)
    assert {account.origin.source for account in extraction.accounts} == {"DataLane.csv", "HV_Primary.csv"}
    assert extraction.problems == ()


BROKEN = {
    "empty": (b"", "the file is empty"),
    "semicolons": (b"Device;Trip;Time;LaneDistanceLeft\n1;1;0;1\n", "separated by semicolons"),
    "tabs": (b"Device\tTrip\tTime\tLaneDistanceLeft\n1\t1\t0\t1\n", "separated by tab"),
    "UTF-16": ("Device,Trip,Time\n1,1,0\n".encode("utf-16"), "UTF-16"),
    "other columns": (b"a,b\n1,2\n", "neither the columns"),
}


@pytest.mark.parametrize("kind", BROKEN)
@pytest.mark.parametrize("file", ["DataLane.csv", "DataWsu_04.csv", "HV_Primary.csv"])
@pytest.mark.parametrize("path_of", ["file", "folder"])
def test_a_broken_file_with_a_known_name_is_named(path_of: str, file: str, kind: str, tmp_path: Path) -> None:
    content, words = BROKEN[kind]
    (tmp_path / file).write_bytes(content)
    with pytest.raises(RecordingError, match=rf"spmd-das.*{re.escape(file)}.*{words}") as caught:
        open_recordings(tmp_path / file if path_of == "file" else tmp_path)
    if path_of == "file":
        assert "no reader" not in str(caught.value)


def test_if_every_reader_fails_the_first_one_tells(tmp_path: Path) -> None:
    (tmp_path / "DataLane.csv").write_bytes(b"")
    (tmp_path / "HV_Primary.csv").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"^spmd-das1: .*DataLane.csv: the file is empty"):
        open_recordings(tmp_path)


@pytest.mark.parametrize("name", ["DataLane_converted.csv", "HV_Primary_converted.csv"])
def test_a_plain_table_under_the_name_of_another(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(TABLES["table"][1])
    assert open_recordings(tmp_path).reader.name == "table"


def test_the_sample_folders() -> None:
    sample = Path(__file__).parents[3].parent / "shared" / "data" / "spmd-20row-heads"
    if not sample.is_dir():
        pytest.skip("the sample of the real tables is not beside this checkout")
    both = [sample / "one-day" / name for name in ("DataLane_04_11_13.csv", "DataWsu_04_11_13.csv")]
    assert open_recordings(both).reader.name == "spmd-das1"
    assert open_recordings(sample / "two-month" / "HV_Primary.csv").reader.name == "spmd-das2"
    for folder in ("two-month", "one-day"):
        extraction = extract_departures(open_recordings(sample / folder))
        assert (extraction.problems, extraction.provenance.reader) == ((), "spmd-das1 + spmd-das2")


def test_only_mdf_logs_take_a_channel_map(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\n")
    with refused("channels", value="map.toml", allowed="a channel map for MDF logs only"):
        open_recordings(tmp_path / "a.csv", channels=Path("map.toml"))
