"""``ldc extract`` as people meet it: formats, what was left out, exit codes, restart."""

import dataclasses
import os
import re
import types
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from helpers import cli
from helpers.fuzz import DEPARTURES, SOUND
from helpers.recordings import TABLE_HEADER, table_of
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import extract_departures, read_departures, read_recordings, recording
from ldctoolkit.recordings.recording import Problem, Recording, SourceFile


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


Ldc = Callable[..., tuple[int, str, str]]


@pytest.fixture
def ldc(folder: Path) -> Ldc:
    """Run the command: exit code, stdout, stderr."""

    def run(*words: object) -> tuple[int, str, str]:
        done = cli.ldc("extract", *words, cwd=folder)
        assert "Traceback" not in done.stderr
        return done.returncode, done.stdout, done.stderr

    return run


def test_several_tables_in_one_go(folder: Path, ldc: Ldc) -> None:
    for i, name in enumerate(("a.csv", "b.csv", "c.csv")):
        (folder / name).write_text(table_of(10 * i))
    code, out, err = ldc("a.csv", "b.csv", "c.csv", "-o", "d.parquet", "--workers", "1", "--report", "r.html")
    assert code == 0
    # 237 s at 21.5 m/s
    assert out.startswith("format: table (3 recording tables)\n30 candidates in 30 recordings, 0.1 h, 5 km\n")
    assert out.endswith("30 departures written to d.parquet\npage about the extraction written to r.html\n")
    assert (folder / "r.html").read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
    assert "warning: no column 'lane'" in err
    departures, provenance = read_departures("d.parquet")
    found = extract_departures(read_recordings(["a.csv", "b.csv", "c.csv"]))
    assert departures.recording.tolist() == found.departures.recording.tolist()
    np.testing.assert_array_equal(departures.matrix(), found.departures.matrix())
    assert [file.name for file in provenance.sources] == ["a.csv", "b.csv", "c.csv"]
    assert sorted(path.name for path in folder.iterdir()) == ["a.csv", "b.csv", "c.csv", "d.parquet", "r.html"]


def test_what_cannot_be_used_is_told_and_the_rest_is_written(folder: Path, ldc: Ldc) -> None:
    (folder / "a.csv").write_text(table_of(0))
    (folder / "b.csv").write_text(TABLE_HEADER + "x,0.0,wide,3.6,25\nx,0.1,0.2,3.6,25\n")
    (folder / "c.csv").write_text("")
    code, out, err = ldc("a.csv", "b.csv", "c.csv", "-o", "d.parquet", "--workers", "1", "--format", "table")
    assert code == 3
    assert "10 departures written to d.parquet" in out
    assert re.search(r"ldc: warning: b\.csv, line 2: .*'wide'", err)
    assert re.search(r"ldc: warning: c\.csv.*: ", err)
    _, provenance = read_departures("d.parquet")
    assert len(provenance.problems) == len([line for line in err.splitlines() if re.search(r"[bc]\.csv", line)])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--format", "tabel"], "format: 'tabel' is not a known reader; did you mean 'table'?"),
        (["--format", "spmd"], "format: 'spmd' is not a known reader; did you mean 'spmd-das"),
        (["--format", "spmd-das1"], "a.csv"),
        (["--workers", "0"], "--workers"),
        (["--workers", "2", "--dask", "tcp://h:1"], "workers: 2 with the cluster at tcp://h:1"),
        (["--dask", " "], "allowed: an address such as tcp://host:8786, or 'local'"),
        (["--step", "5"], "step: 5.0; allowed: "),
        (["--nominal-lane-width", "35"], "nominal_lane_width: 35.0; allowed: "),
        (["--yaw-rate-factor", "0"], "yaw_rate_factor: 0.0; allowed: a finite number, not 0"),
        (["--vehicle-width", "18"], "vehicle_width: 18.0; allowed: "),
        (["--min-lane-width", "0"], "min_lane_width: 0.0; allowed: "),
        (["--max-lane-width", "2"], "max_lane_width: 2.0; allowed: more than min_lane_width"),
        (["--report", "r.txt"], "--report r.txt: the name must end in .html"),
        (["--report", "nowhere/r.html"], "--report nowhere/r.html: the folder nowhere does not exist"),
        (["--report", f"{'r' * 300}.html"], "rrr.html: File name too long"),
        (["a.csv"], "a.csv: given twice"),
        (["none.csv"], "none.csv: does not exist"),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else "",
)
def test_wrong_words_get_one_message(folder: Path, ldc: Ldc, words: list[str], message: str) -> None:
    (folder / "a.csv").write_text(table_of(0))
    code, out, err = ldc(*words, "a.csv", "-o", "d.parquet")
    assert (code, out) == (2, "")
    assert re.fullmatch(r"ldc: error: [^\n]+\n", err), err
    assert message in err
    assert [path.name for path in folder.iterdir()] == ["a.csv"]


def test_settings_reach_the_extraction(folder: Path, ldc: Ldc) -> None:
    (folder / "a.csv").write_text(table_of(0, 30))
    words = {
        "--vehicle-width": 1.7, "--step": 0.2, "--nominal-lane-width": 3.5, "--yaw-rate-factor": -1,
        "--min-duration": 0.6, "--max-duration": 9, "--min-speed": 6, "--max-gap": 0.5, "--max-jump": 0.7,
        "--min-lane-width": 2.5, "--max-lane-width": 6.5,
    }  # fmt: skip
    flat = [word for pair in words.items() for word in pair] + ["--limit", "y_rate=3", "--limit", "a_y=inf"]
    flat += ["--keep-engaged"]
    assert ldc("a.csv", "-o", "d.parquet", *flat)[0] == 0
    departures, provenance = read_departures("d.parquet")
    criteria, preparation = provenance.criteria, provenance.preparation
    assert dataclasses.astuple(criteria) == (1.7, 0.6, 9, 6, 0.5, 0.7, (3, 4, None), 2.5, 6.5, True)
    assert (preparation.step, preparation.nominal_lane_width, preparation.yaw_rate_factor) == (0.2, 3.5, -1)
    scale = next(column for column in departures.extra if column.name == "lane_scale")
    np.testing.assert_allclose(scale.values.astype(float), 3.5 / 3.6)
    assert ldc("a.csv", "-o", "d.parquet")[0] == 0
    _, provenance = read_departures("d.parquet")
    assert (provenance.criteria.vehicle_width, provenance.preparation.step) == (1.9, None)
    assert dataclasses.astuple(provenance.criteria.plausibility) == (2, 4, 6)
    widths = provenance.criteria.min_lane_width, provenance.criteria.max_lane_width
    assert (widths, provenance.criteria.keep_engaged) == ((2.0, 7.0), False)


def test_what_cannot_be_right_is_not_written_unless_forced(folder: Path, ldc: Ldc) -> None:
    """A speed in km/h."""
    table = pl.read_csv(table_of(0, 30).encode()).with_columns(pl.col("speed") * 3.6)
    table.write_csv(folder / "a.csv")
    code, out, err = ldc("a.csv", "-o", "d.parquet", "--report", "r.html")
    assert (code, out) == (2, "")
    doubt = "column 'speed': 80% of the samples are above 60 m/s (216 km/h); the unit looks like km/h or mph, m/s is"
    (line,) = (line for line in err.splitlines() if "error" in line)
    assert line.startswith(f"ldc: error: the recordings cannot be right: {doubt}")
    assert line.endswith("; correct them, or go on with --force (in Python: force=True)")
    assert [path.name for path in folder.iterdir()] == ["a.csv"]
    code, out, err = ldc("a.csv", "-o", "d.parquet", "--force")
    assert code == 0
    assert out.endswith("departures written to d.parquet\n")
    assert f"ldc: warning: {doubt}" in err
    assert read_departures("d.parquet")[1].warnings[0].startswith(doubt)


def test_departures_while_a_system_steers(folder: Path, ldc: Ldc) -> None:
    """In every other of ten recordings."""
    table = pl.read_csv(table_of(0).encode())
    odd = pl.col("recording").str.slice(1).cast(pl.Int64) % 2 == 1
    table.with_columns(odd.alias("engaged")).write_csv(folder / "a.csv")
    for words, departures, hours in (((), 5, 5 * 7.9 / 3600.0), (("--keep-engaged",), 10, 10 * 7.9 / 3600.0)):
        code, out, _ = ldc("a.csv", "-o", "d.parquet", *words)
        assert (code, re.findall(r"refused: engaged +│ +(\d+)", out)) == (0, [str(10 - departures)])
        found, provenance = read_departures("d.parquet")
        assert (len(found), provenance.refused.engaged) == (departures, 10 - departures)
        assert provenance.hours == pytest.approx(hours)


@dataclasses.dataclass(frozen=True)
class Part:
    key: str = "a.made"
    bytes: int = 10
    problems: int = 0
    interrupted: bool = False

    def read(self) -> Iterator[Recording | Problem]:
        if self.interrupted:
            raise KeyboardInterrupt
        t = np.arange(0, 8, 0.1)
        offset = np.maximum(0.3 * (1 - (t - 4) ** 2), -0.6) + 0.9
        yield Recording("one", t, offset, np.full(80, 3.6), np.full(80, 25.0), np.ones(80, bool), source="a.made")
        for i in range(self.problems):
            yield Problem("a.made", f"line {i + 1}", "is wrong")


@dataclasses.dataclass(frozen=True)
class MadeReader:
    """A third party's."""

    name: str = "made"
    title: str = "made up"
    vehicle_width: float = 1.8
    step: float | None = 0.1
    suffix: str = ".made"
    problems: int = 0
    interrupted: bool = False

    def recognise(self, paths: Sequence[Path]) -> str:
        return "made-up files" if all(path.suffix == self.suffix for path in paths) else ""

    def open(self, paths: Sequence[Path]) -> Any:
        if paths[0].suffix != self.suffix:
            raise RecordingError(f"{paths[0].name}: is not made up")
        files = tuple(SourceFile(path.name, 10, "0" * 64) for path in paths)
        parts = (Part(problems=self.problems), Part("b", interrupted=True))[: 1 + self.interrupted]
        return types.SimpleNamespace(parts=parts, files=files, problems=())


@pytest.fixture
def third_party(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Install readers for the length of a test."""
    there = dict(recording.entry_points(recording.GROUP))

    def install(*readers: MadeReader) -> None:
        for reader in readers:
            there[reader.name] = types.SimpleNamespace(load=lambda reader=reader: reader, value="made:READER")  # type: ignore[assignment]

    with monkeypatch.context() as patch:
        patch.setattr(recording, "entry_points", lambda group: there)
        recording.recording_reader.cache_clear()
        yield install
    recording.recording_reader.cache_clear()


def test_a_third_partys_reader(folder: Path, ldc: Ldc, third_party: Callable[..., None]) -> None:
    """By its name, and found by itself; its width and step are taken."""
    third_party(MadeReader())
    (folder / "a.made").write_text("x")
    code, out, _ = ldc("a.made", "-o", "d.parquet")
    assert code == 0
    assert out.startswith("format: made (made-up files)\n1 candidates in 1 recordings")
    code, out, _ = ldc("a.made", "-o", "e.parquet", "--format", "made")
    assert code == 0
    assert out.startswith("format: made (made up)\n")
    provenance = read_departures("e.parquet")[1]
    assert (provenance.reader, provenance.criteria.vehicle_width, provenance.preparation.step) == ("made", 1.8, 0.1)
    (folder / "a.csv").write_text(table_of(0))
    code, _, err = ldc("a.csv", "-o", "d.parquet", "--format", "made")
    assert (code, err) == (2, "ldc: error: a.csv: is not made up\n")


@pytest.mark.parametrize(("problems", "told"), [(1, 1), (20, 20), (21, 21), (1500, 21)])
def test_twenty_problems_are_told(folder: Path, ldc: Ldc, third_party: Any, problems: int, told: int) -> None:
    third_party(MadeReader(problems=problems))
    (folder / "a.made").write_text("x")
    code, _, err = ldc("a.made", "-o", "d.parquet")
    lines = [line for line in err.splitlines() if "is wrong" in line or "problems" in line]
    assert (code, len(lines), lines[0]) == (3, told, "ldc: warning: a.made, line 1: is wrong")
    if problems > 20:
        assert lines[-1].startswith(f"ldc: warning: and {problems - 20:,} more problems, {problems:,} in all")
    assert len(read_departures("d.parquet")[1].problems) == problems


def test_an_interrupt_says_where_the_work_is(folder: Path, ldc: Ldc, third_party: Callable[..., None]) -> None:
    third_party(MadeReader(interrupted=True))
    (folder / "a.made").write_text("x")
    code, out, err = ldc("a.made", "-o", "d.parquet")
    assert (code, out) == (130, "")
    assert err == (
        "ldc: warning: what was finished is kept in d.parquet.parts; the same command goes on with the rest\n"
        "ldc: interrupted\n"
    )
    assert sorted(path.name for path in folder.iterdir()) == ["a.made", "d.parquet.parts"]


def test_a_page_that_is_not_finished_loses_no_part(folder: Path, ldc: Ldc, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stopped while the page is made: the same command goes on with it and reads nothing again."""
    words = ["a.csv", "b.csv", "-o", "d.parquet", "--report", "r.html", "--workers", "1"]
    for i, name in enumerate(words[:2]):
        (folder / name).write_text(table_of(10 * i))

    def stopped(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.pages.extraction_page.extraction_page", stopped)
        code, out, err = ldc(*words)
    assert (code, out) == (130, "")
    assert "what was finished is kept in d.parquet.parts; the same command goes on" in err
    assert len(list((folder / "d.parquet.parts").glob("part-*"))) == 2
    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.extraction.make_executor", stopped)  # nothing is left to read
        assert ldc(*words)[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == ["a.csv", "b.csv", "d.parquet", "r.html"]


def test_a_folder_without_write_permission_is_told(folder: Path, ldc: Ldc) -> None:
    (folder / "a.csv").write_text(table_of(0))
    closed = folder / "closed"
    closed.mkdir(mode=0o500)
    if os.access(closed, os.W_OK):
        pytest.skip("this user may write everywhere")
    code, out, err = ldc("a.csv", "-o", "d.parquet", "--report", "closed/r.html")
    assert (code, out) == (2, "")
    assert err == "ldc: error: --report closed/r.html: no permission to write into the folder closed\n"
    assert sorted(path.name for path in folder.iterdir()) == ["a.csv", "closed"]


def test_no_table_is_said_to_hold_problems_where_there_is_none(folder: Path, ldc: Ldc) -> None:
    for i in range(25):
        (folder / f"{i}.csv").write_text(TABLE_HEADER + f"r{i},0.0,wide,3.6,25\n")
    code, out, err = ldc(".", "-o", "d.parquet", "--workers", "1")
    assert (code, out) == (2, "")
    assert re.search(r"^ldc: warning: and [0-9]+ more problems, [0-9]+ in all$", err, re.MULTILINE), err
    assert "holds them all" not in err
    assert "ldc: warning: 0.csv, line 2: " in err
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{i}.csv" for i in range(25))


def table(path: Path) -> bytes:
    """A recording table in Parquet."""
    pl.read_csv(table_of(0).encode()).write_parquet(path)
    return path.read_bytes()


@pytest.mark.parametrize("how", ["same", "another way", "link", "folder", "below"])
def test_what_is_read_is_not_written_over(folder: Path, ldc: Ldc, how: str) -> None:
    (folder / "in").mkdir()
    before = table(folder / "in" / "a.parquet")
    source, target, input_ = "in/a.parquet", "in/a.parquet", "is the input in/a.parquet"
    if how == "another way":
        target = f"in/../{source}"
    elif how == "link":
        target = "b.parquet"
        (folder / target).symlink_to(source)
    elif how in ("folder", "below"):
        source, input_ = "in", "is an input, in in"
    if how == "below":
        (folder / "in" / "more").mkdir()
        (folder / "in" / "more" / "b.parquet").symlink_to(folder / "in" / "a.parquet")
        target = "in/more/b.parquet"
    code, out, err = ldc(source, "-o", target)
    assert (code, out) == (2, "")
    assert err == f"ldc: error: -o {target}: {input_}; allowed: a file that is not read\n"
    assert (folder / "in" / "a.parquet").read_bytes() == before


def test_a_page_is_not_written_over_what_is_read(folder: Path, ldc: Ldc, third_party: Callable[..., None]) -> None:
    third_party(MadeReader(suffix=".html"))
    (folder / "a.html").write_text("x")
    sentence = "ldc: error: --report a.html: is the input a.html; allowed: a file that is not read\n"
    assert ldc("a.html", "-o", "d.parquet", "--report", "a.html") == (2, "", sentence)
    assert [path.name for path in folder.iterdir()] == ["a.html"]


def test_a_table_may_lie_beside_what_it_was_made_of(folder: Path, ldc: Ldc) -> None:
    """The second time it is in the folder that is read, and is replaced."""
    table(folder / "a.parquet")
    for _ in range(2):
        assert ldc(".", "-o", "d.parquet")[0] == 0
    assert sorted(path.name for path in folder.iterdir()) == ["a.parquet", "d.parquet"]


def test_workers_are_processes_where_much_is_read(folder: Path, ldc: Ldc, monkeypatch: pytest.MonkeyPatch) -> None:
    """One file, or little, is read in this process; much in as many as there are cores."""
    import ldctoolkit.studies.extraction as runner
    from ldctoolkit.studies.running.executors import SerialExecutor

    asked: list[Any] = []

    def make(name: Any, workers: Any, dask: Any, packages: Any) -> SerialExecutor:
        asked.append((name, workers, dask))
        return SerialExecutor()

    monkeypatch.setattr(runner, "make_executor", make)
    monkeypatch.setattr(runner, "SMALL", 50_000)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    for i in range(3):
        (folder / f"{i}.csv").write_text(table_of(10 * i))
    assert 20_000 < (folder / "0.csv").stat().st_size < 25_000
    for files in (["0.csv"], ["0.csv", "1.csv"], ["0.csv", "1.csv", "2.csv"], ["0.csv", "1.csv", "--workers", "8"]):
        assert ldc(*files, "-o", "d.parquet")[0] == 0
    assert asked == [(None, 1, None), (None, 1, None), (None, 2, None), (None, 2, None)]


FAULTS = {
    "table": ("drives.csv", b"3.6", b"wide", r"drives\.csv, line 2: column 'lane_width' holds 'wide'"),
    "spmd-das1": ("DataLane.csv", b"7,1,", b"x,1,", r"DataLane\.csv, line 2: it begins with 'x,1'"),
    "spmd-das2": ("HV_Primary.csv", b"\n7,1,", b"\nx,1,", r"HV_Primary\.csv, line 2: it begins with 'x,1'"),
    "uah-driveset": (
        "PROC_LANE_DETECTION.txt", b" 2 \n", b" x \n",
        r"D\d/\S+/PROC_LANE_DETECTION\.txt, line 1: column 'state' holds 'x'",
    ),
}  # fmt: skip


@pytest.mark.parametrize("source", FAULTS)
def test_a_fault_in_any_format_is_told_and_the_rest_is_there(folder: Path, ldc: Ldc, source: str) -> None:
    files = SOUND[source][0]
    for name, content in files.items():
        (folder / "in" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "in" / name).write_bytes(content)
    assert ldc("in", "-o", "d.parquet")[0] == 0
    whole = read_departures("d.parquet")[0]
    assert whole.n == DEPARTURES[source]
    file, good, bad, told = FAULTS[source]
    path = next(path for path in (folder / "in").rglob("*") if path.name == file)
    path.write_bytes(path.read_bytes().replace(good, bad, 1))
    code, out, err = ldc("in", "-o", "d.parquet", "--format", source)
    assert code == 3
    assert out.startswith(f"format: {source} ")
    assert re.search(rf"^ldc: warning: {told}", err, re.MULTILINE), err
    departures, provenance = read_departures("d.parquet")
    assert departures.n == whole.n - (source == "table")  # there a fault costs its recording
    assert all(f"ldc: warning: {problem}\n" in err for problem in provenance.problems)
