"""Extractions: plan, parts, workers."""

import contextlib
import dataclasses
import importlib.metadata
import importlib.util
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import ldctoolkit
from helpers.bits import assert_same_bits
from helpers.executors import DyingWorkers
from ldctoolkit.errors import InputError, LdcError, RecordingError, StoreError
from ldctoolkit.recordings import Extraction, extract_departures, read_departures
from ldctoolkit.recordings.departures_table import PartResult
from ldctoolkit.recordings.extract import extract_items
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import (
    CombinedReader,
    FoundParts,
    OpenedRecordings,
    Problem,
    Recording,
    SourceFile,
    recording_reader,
)
from ldctoolkit.studies.extraction import PART_CLASSES, NothingReadError, _program, plan_of, run_extraction
from ldctoolkit.studies.storage.checked_parts import decoded, difference_texts, encoded, locked

HOME = Path(ldctoolkit.__file__).parent


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    shutil.copytree(HOME / "recordings", tmp_path / "recordings", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("departures.py", "errors.py"):
        shutil.copy(HOME / name, tmp_path / name)
    return tmp_path


def test_every_module_that_decides_numbers_is_reached(copied: Path) -> None:
    before = _program(copied)
    assert before == _program(HOME)
    modules = [*(copied / "recordings").rglob("*.py"), copied / "departures.py"]
    assert {"spmd_das1.py", "uah_driveset.py", "table_reader.py", "departures.py"} <= {path.name for path in modules}
    for path in modules:
        content = path.read_bytes()
        path.write_bytes(content + b"# another\n")
        assert _program(copied) != before, path
        path.write_bytes(content)
    assert _program(copied) == before


def test_a_module_in_another_room_is_another(copied: Path) -> None:
    before = _program(copied)
    (copied / "recordings" / "other").mkdir()
    (copied / "recordings" / "uah_driveset.py").rename(copied / "recordings" / "other" / "uah_driveset.py")
    assert _program(copied) != before


READER = """
import dataclasses
from {parts} import Part

class Reader:
    name, title, vehicle_width, step = "made", "made up", 1.8, 0.1
    def open(self, paths): return {of_the_reader}

name, title, vehicle_width, step = "made", "made up", 1.8, 0.1
def recognise(paths): return ""
def open(paths): return Reader().open(paths)
"""
PART = """
import dataclasses

@dataclasses.dataclass(frozen=True)
class Part:
    key: str = "a"
    bytes: int = 1
    def read(self): return {of_the_part}
"""


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    exec(path.read_text(), vars(module))
    return module


@pytest.mark.parametrize("how", ["alone", "together", "module"])
def test_a_readers_own_code_is_reached(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    files = tmp_path / "somebodys_reader.py", tmp_path / "somebodys_parts.py"
    for file in files:
        monkeypatch.setitem(sys.modules, file.stem, ModuleType(file.stem))

    def plan(of_the_reader: int, of_the_part: int, comment: str = "") -> dict[str, Any]:
        """Of code that is written, and loaded by an interpreter that has not seen it."""
        files[0].write_text(READER.format(parts=files[1].stem, of_the_reader=of_the_reader) + comment)
        files[1].write_text(PART.format(of_the_part=of_the_part) + comment)
        parts, module = load(files[1]), load(files[0])
        reader: Any = module if how == "module" else module.Reader()
        if how == "together":
            reader = CombinedReader((recording_reader("table"), reader))
        return plan_of(
            reader, FoundParts((parts.Part(),), (SourceFile("a", 1, "0" * 64),), ()), Criteria(1.8), Preparation()
        )

    before = plan(1, 1)
    assert plan(1, 1, "# a comment") == before
    for other in (plan(2, 1), plan(1, 2)):
        assert [text.partition(":")[0] for text in difference_texts(before, other)] == ["readers"]
    assert plan(1, 1) == before


@pytest.fixture(scope="session")
def make_result(drive: Callable[[int], Recording]) -> Callable[[], PartResult]:
    """Of recordings with labels, scales and notes, one of them without a usable sample."""
    drives = [drive(i) for i in range(3)]
    blind = drives[0].take(slice(0, 50))
    drives.append(dataclasses.replace(blind, name="blind \u00e9 \u4e00", valid=np.zeros(50, dtype=bool)))
    items: list[Recording | Problem] = [*drives, Problem("f", "line 3", 'what "is" wrong\n')]
    return lambda: extract_items(items, Criteria(1.8), Preparation(step=0.1))


@pytest.mark.parametrize("kind", ["nothing", "three drives"])
def test_there_and_back(make_result: Callable[[], PartResult], kind: str) -> None:
    result = PartResult() if kind == "nothing" else make_result()
    content = encoded(result)
    assert_same_bits(decoded(content, PART_CLASSES), result)
    assert encoded(decoded(content, PART_CLASSES)) == encoded(result) == content


Made = Callable[..., OpenedRecordings]
Content = Callable[[Any], tuple[Any, ...]]


def times(source: OpenedRecordings) -> list[int]:
    """How often each part was read."""
    return [part.times for part in source.source.parts]  # type: ignore[attr-defined]


def texts(extraction: Any) -> list[str]:
    return [str(problem) for problem in extraction.problems]


GOOD = ("good",) * 5


def test_parts_in_this_process_are_as_the_library_extracts_them(made: Made, content: Content) -> None:
    source = made(*GOOD)
    extraction = run_extraction(source, workers=1)
    assert (content(extraction), len(extraction.departures)) == (content(extract_departures(source)), 30)
    assert extraction.recordings == 15
    assert texts(extraction) == ["file 9: is empty", *(f"part {i}, line 7: is left out" for i in range(5))]
    assert extraction.provenance.criteria.vehicle_width == 1.8
    assert extraction.provenance.preparation == Preparation(step=0.1)


@pytest.mark.slow
def test_two_processes_give_the_same_bits(made: Made, content: Content, tmp_path: Path) -> None:
    output = tmp_path / "d.parquet"
    extraction = run_extraction(made(*GOOD), workers=2, output=output)
    assert content(extraction) == content(extract_departures(made(*GOOD)))
    departures, provenance = read_departures(output)
    assert (departures.T == extraction.departures.T).all()
    assert provenance == extraction.provenance
    run_extraction(made(*GOOD), workers=1, output=tmp_path / "e.parquet")
    assert (tmp_path / "e.parquet").read_bytes() == output.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "e.parquet", "notes"]


@pytest.mark.slow
def test_a_part_that_ends_its_worker_is_left_out_and_told(made: Made, content: Content, tmp_path: Path) -> None:
    how = ["good", "good", "dies", "good", "dies once", "good"]
    source = made(*how)
    extraction = run_extraction(source, workers=2, output=tmp_path / "d.parquet")
    assert [text for text in texts(extraction) if "worker" in text] == [
        "part 2: ended its worker process each time it was read (out of memory?); it is left out"
    ]
    assert times(source)[2] >= 2
    whole = extract_departures(made(*["good"] * 6))
    others = [not name.startswith("drive 2") or name == "drive 2" for name in whole.departures.recording.tolist()]
    others[:6] = [True] * 6  # drives 0 to 2 are of the first part
    assert extraction.departures.recording.tolist() == whole.departures.take(others).recording.tolist()
    assert extraction.departures.d_y.tolist() == whole.departures.take(others).d_y.tolist()
    assert not (tmp_path / "d.parquet.parts").exists()


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_a_part_raises_is_a_problem_of_that_part(made: Made, tmp_path: Path, workers: int) -> None:
    extraction = run_extraction(
        made("good", "raises", "refused", "good"), workers=workers, output=tmp_path / "d.parquet"
    )
    assert extraction.recordings == 6
    told = [text for text in texts(extraction) if "line 7" not in text]
    assert (told[0], told[1]) == ("file 9: is empty", "part 1: ZeroDivisionError: a reader's own fault")
    assert told[2].startswith("part 2: ")
    assert "nothing here can be used" in told[2]
    assert len(told) == 3


@pytest.mark.parametrize("how", [("refused",), ("refused", "raises", "refused")])
def test_where_nothing_can_be_read_nothing_is_written(made: Made, tmp_path: Path, how: tuple[str, ...]) -> None:
    words = r"\(4 problems in all\)" if len(how) > 1 else "nothing here can be used$"
    with pytest.raises(NothingReadError, match=f"^file 9: is empty; part 0: .*{words}") as told:
        run_extraction(made(*how), workers=1, output=tmp_path / "d.parquet")
    assert (len(told.value.problems), [path.name for path in tmp_path.iterdir()]) == (1 + len(how), ["notes"])


def test_what_cannot_be_right_is_read_once_and_written_if_forced(made: Made, tmp_path: Path) -> None:
    """The finished parts wait for the next run, forced or not."""
    output = tmp_path / "d.parquet"
    source = made("in km/h", "in km/h", "good")
    for _ in range(2):
        with pytest.raises(RecordingError, match=r"^the recordings cannot be right: column 'speed': 67% of"):
            run_extraction(source, workers=1, output=output)
        assert not output.exists()
    extraction = run_extraction(source, workers=1, output=output, force=True)
    assert extraction.warnings[0].startswith("column 'speed': 67% of the samples are above 60 m/s")
    assert (times(source), extraction.recordings) == ([1, 1, 1], 9)
    assert read_departures(output)[1] == extraction.provenance
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "notes"]


def test_a_part_is_told_by_the_name_that_users_know(made: Made, shown_part: type) -> None:
    extraction = run_extraction(made("good", "raises", kind=shown_part), workers=1)
    assert "1.made: ZeroDivisionError: a reader's own fault" in texts(extraction)


def test_a_stopped_extraction_goes_on_with_what_is_missing(made: Made, content: Content, tmp_path: Path) -> None:
    output = tmp_path / "d.parquet"
    how = ("good", "good", "interrupted", "good")
    with pytest.raises(KeyboardInterrupt):
        run_extraction(made(*how), workers=1, output=output)
    assert not output.exists()
    told: list[tuple[int, int]] = []
    source = made(*how)
    extraction = run_extraction(source, workers=1, output=output, progress=lambda *at: told.append(at))
    assert (times(source), told) == ([1, 1, 2, 1], [(200, 400), (300, 400), (400, 400)])
    assert content(extraction) == content(extract_departures(made("good", "good", "good", "good")))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "notes"]


def test_what_is_made_of_the_result_comes_before_the_parts_go(made: Made, tmp_path: Path) -> None:
    """It is stopped, or fails: the table is there, and the next run begins with it."""
    output, folder = tmp_path / "d.parquet", tmp_path / "d.parquet.parts"
    source = made("good", "good")
    seen: list[tuple[int, bool, int]] = []

    def look(extraction: Extraction) -> None:
        seen.append((extraction.recordings, output.exists(), len(list(folder.glob("part-*")))))
        if len(seen) == 1:
            raise KeyboardInterrupt
        if len(seen) == 2:
            raise StoreError("no space left")

    with pytest.raises(KeyboardInterrupt):
        run_extraction(source, workers=1, output=output, before_removal=look)
    with pytest.raises(StoreError, match="no space left"):
        run_extraction(source, workers=1, output=output, before_removal=look)
    run_extraction(source, workers=1, output=output, before_removal=look)
    assert seen == [(6, True, 2)] * 3
    assert times(source) == [1, 1]
    assert not folder.exists()


def test_a_part_removes_what_another_run_left(made: Made, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    output = tmp_path / "d.parquet"
    folder = stopped(made, output)
    assert folder.is_dir()
    assert run_extraction(made("good"), workers=1, output=output).recordings == 3
    assert not folder.exists()
    assert "its parts are of another plan" in caplog.text
    folder.mkdir()  # somebody's own
    run_extraction(made("good"), workers=1, output=output)
    assert folder.is_dir()


def test_what_a_killed_run_had_not_finished_writing_is_removed(made: Made, tmp_path: Path) -> None:
    output = tmp_path / "d.parquet"
    stays = [".d.parquet.12x.part", ".d.parquet.part", ".dxparquet.12.part", "d.parquet.12.part", ".d.parquet.12.parts"]
    for name in (".d.parquet.12.part", ".d.parquet.4194304.part", *stays):
        (tmp_path / name).write_text("x")
    run_extraction(made("good", "good"), workers=1, output=output)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*stays, "d.parquet", "notes"])


@pytest.mark.parametrize("how", [("interrupted",), ("interrupted", "good")])
def test_nothing_is_left_where_no_part_was_finished(made: Made, tmp_path: Path, how: tuple[str, ...]) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_extraction(made(*how), workers=1, output=tmp_path / "d.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["notes"]


def stopped(made: Made, output: Path, **named: Any) -> Path:
    """A work folder with two finished parts of three."""
    with pytest.raises(KeyboardInterrupt):
        run_extraction(made("good", "good", "interrupted", **named), workers=1, output=output)
    return output.with_name(f"{output.name}.parts")


@pytest.mark.parametrize("damage", ["cut", "flipped", "emptied", "not a part", "another"])
def test_damage_is_told(
    made: Made, content: Content, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str
) -> None:
    output = tmp_path / "d.parquet"
    folder = stopped(made, output)
    part, other = min(folder.glob("part-000001-*")), min(folder.glob("part-000000-*"))
    data = part.read_bytes()
    flipped = bytearray(data)
    flipped[len(data) // 2] ^= 1
    contents = {
        "cut": data[:-9], "flipped": bytes(flipped), "emptied": b"", "not a part": b"hello",
        "another": other.read_bytes(),
    }  # fmt: skip
    part.write_bytes(contents[damage])
    source = made("good", "good", "interrupted")
    extraction = run_extraction(source, workers=1, output=output)
    assert times(source) == [1, 2, 2]
    assert "part-000001" in caplog.text
    assert "broken" in caplog.text
    assert content(extraction) == content(extract_departures(made("good", "good", "good")))


@pytest.mark.parametrize("change", ["files", "preparation", "parts", "manifest", "program", "versions"])
def test_parts_of_another_extraction_are_never_used(
    made: Made, content: Content, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch,
    change: str,
) -> None:  # fmt: skip
    output = tmp_path / "d.parquet"
    folder = stopped(made, output)
    source = made(
        "good", "good", "good", *["good"] * (change == "parts"), digest=("1" if change == "files" else "0") * 64
    )
    preparation = Preparation(step=0.2 if change == "preparation" else 0.1)
    if change == "manifest":
        (folder / "manifest.json").write_text("{")
    if change == "program":
        monkeypatch.setattr("ldctoolkit.studies.extraction._program", lambda *_: "another")
    if change == "versions":
        monkeypatch.setattr("ldctoolkit.studies.extraction.versions", lambda names: dict.fromkeys(names, "0.1"))
    extraction = run_extraction(source, preparation=preparation, workers=1, output=output)
    assert times(source)[:3] == [2, 2, 2]
    monkeypatch.undo()
    words = {
        "files": "the files have changed",
        "preparation": "preparation.step: 0.1 there, 0.2 now",
        "parts": "they are divided in another way",
        "manifest": "its manifest is broken",
        "program": "the program has changed",
        "versions": f"versions.ldctoolkit: '{ldctoolkit.__version__}' there, '0.1' now; versions.numpy: "
        f"'{np.__version__}' there, '0.1' now; versions.polars: '{importlib.metadata.version('polars')}' there, "
        "'0.1' now; and 1 more",
    }
    assert f"its parts are of another plan ({words[change]}) and are removed" in caplog.text
    assert content(extraction) == content(extract_departures(source, preparation=preparation))
    assert not folder.exists()


def test_a_folder_of_something_else_is_left_alone(made: Made, tmp_path: Path) -> None:
    folder = tmp_path / "d.parquet.parts"
    folder.mkdir()
    (folder / "thesis.tex").write_text("x")
    with pytest.raises(StoreError, match=r"is not a folder of finished parts \(it holds thesis.tex\)"):
        run_extraction(made(*GOOD), workers=1, output=tmp_path / "d.parquet")
    assert sorted(path.name for path in folder.iterdir()) == [".lock", "thesis.tex"]
    (tmp_path / "e.parquet.parts").write_text("x")
    with pytest.raises(StoreError, match="is not a folder"):
        run_extraction(made(*GOOD), workers=1, output=tmp_path / "e.parquet")


def test_what_a_user_adds_to_the_folder_stays(made: Made, tmp_path: Path) -> None:
    folder = stopped(made, tmp_path / "d.parquet")
    (folder / "notes.txt").write_text("x")
    run_extraction(made("good", "good", "good"), workers=1, output=tmp_path / "d.parquet")
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_one_run_at_a_time(made: Made, tmp_path: Path) -> None:
    folder = stopped(made, tmp_path / "d.parquet")
    before = sorted(folder.iterdir())
    with locked(folder), pytest.raises(StoreError, match="another run is writing into this folder"):
        run_extraction(made("good", "good", "good"), workers=1, output=tmp_path / "d.parquet")
    assert sorted(folder.iterdir()) == before


@contextlib.contextmanager
def on(executor: DyingWorkers, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.extraction.make_executor", lambda *_: executor)
        yield


@pytest.mark.parametrize("deadly", [{0}, {3}, {1, 2}, {0, 1, 2, 3, 4}])
def test_parts_at_fault_are_found_beside_others(made: Made, monkeypatch: pytest.MonkeyPatch, deadly: set[int]) -> None:
    source = made(*GOOD, "good")
    with on(DyingWorkers(lambda task: getattr(task, "index", -1) in deadly), monkeypatch):
        extraction = run_extraction(source)
    told = [text.partition(":")[0] for text in texts(extraction) if "ended its worker" in text]
    assert (told, extraction.recordings) == ([f"part {i}" for i in sorted(deadly)], 3 * (6 - len(deadly)))


def test_one_death_among_many_is_no_end(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pool that breaks gives up all that it held, here more parts than may be lost one after the other."""
    with on(DyingWorkers(lambda task: getattr(task, "index", -1) == 0, workers=30), monkeypatch):
        extraction = run_extraction(made(*["good"] * 70))
    assert extraction.recordings == 3 * 69


def test_workers_that_cannot_live_are_told_from_parts_that_kill(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    with on(DyingWorkers(lambda _: True), monkeypatch), pytest.raises(LdcError, match="end whatever they run"):
        run_extraction(made(*GOOD))


@dataclasses.dataclass(frozen=True)
class Unsendable:
    """A part that holds what no other process can have."""

    part: Any
    lock: Any
    key: str = "part"
    bytes: int = 1

    def read(self) -> Iterator[Any]:
        yield from self.part.read()


def test_parts_that_cannot_be_sent_are_told(made: Made) -> None:
    source = made("good", "good")
    parts = tuple(Unsendable(part, threading.Lock()) for part in source.source.parts)
    source = dataclasses.replace(source, source=dataclasses.replace(source.source, parts=parts))  # type: ignore[type-var]
    with pytest.raises(LdcError, match=r"parts of the kind Unsendable cannot be sent to other processes \(.*lock.*\)"):
        run_extraction(source, workers=2)
    assert run_extraction(source, workers=1).recordings == 6


@pytest.mark.parametrize("workers", [0, -1, True, 1.5, "2"])
def test_workers_are_a_whole_number(made: Made, workers: Any) -> None:
    with pytest.raises(InputError, match=r"workers: .*allowed: a whole number >= 1"):
        run_extraction(made("good"), workers=workers)


def test_finished_parts_need_no_workers(made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed between the last part and the table: the next run only writes it."""
    source = made("good", "good")

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.extraction.write_departures", killed)
        with pytest.raises(KeyboardInterrupt):
            run_extraction(source, workers=1, output=tmp_path / "d.parquet")
        patch.setattr("ldctoolkit.studies.extraction.make_executor", killed)
        with pytest.raises(KeyboardInterrupt):
            run_extraction(source, workers=1, output=tmp_path / "d.parquet")
    assert run_extraction(source, workers=1, output=tmp_path / "d.parquet").recordings == 6
    assert times(source) == [1, 1]
    assert not (tmp_path / "d.parquet.parts").exists()
