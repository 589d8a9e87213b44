"""The plan of an extraction, and the files of its parts."""

import contextlib
import dataclasses
import importlib.util
import io
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import ldctoolkit
from helpers.bits import assert_same_bits
from helpers.examples import examples
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings.departures_table import PartResult
from ldctoolkit.recordings.extract import extract_items
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.sources import CombinedReader, FoundParts, recording_reader
from studies.extraction import Unread, _program, part_bytes, plan_of, read_part

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
"""
PART = """
import dataclasses

@dataclasses.dataclass(frozen=True)
class Part:
    key: str = "a"
    bytes: int = 1
"""


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def somebodys(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Files of a reader and of its parts, loaded."""
    files = tmp_path / "somebodys_reader.py", tmp_path / "somebodys_parts.py"
    files[0].write_text(READER.format(parts=files[1].stem))
    files[1].write_text(PART)
    load(files[1])
    load(files[0])
    yield files
    for file in files:
        del sys.modules[file.stem]


@pytest.mark.parametrize("how", ["alone", "together", "module"])
def test_a_readers_own_code_is_reached(somebodys: tuple[Path, Path], how: str) -> None:
    module: Any = sys.modules[somebodys[0].stem]
    reader: Any = module.Reader()
    if how == "together":
        reader = CombinedReader((recording_reader("table"), reader))
    elif how == "module":
        reader = module
        for name in ("name", "title", "vehicle_width", "step"):
            setattr(module, name, getattr(module.Reader, name))

    def program() -> str:
        source = FoundParts((module.Part(),), (), ())
        digest = plan_of(reader, source, Criteria(1.8), Preparation())["program"]
        assert isinstance(digest, str)
        return digest

    before = program()
    for file in somebodys:
        content = file.read_text()
        file.write_text(f"{content}# another\n")
        assert program() != before, file
        file.write_text(content)
    assert program() == before
    for file in somebodys:
        file.unlink()  # as code that is in no file
    assert program() != before


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
    content = part_bytes(result)
    assert_same_bits(read_part(content), result)
    assert part_bytes(read_part(content)) == content


def test_the_same_result_makes_the_same_bytes(make_result: Callable[[], PartResult]) -> None:
    assert part_bytes(make_result()) == part_bytes(make_result())


def test_what_is_not_a_part_is_refused(make_result: Callable[[], PartResult]) -> None:
    good = part_bytes(make_result())
    text = io.BytesIO()
    np.savez(
        text, tree=np.frombuffer(b'{"class": "Problem", "fields": {"file": "", "place": "", "what": ""}}', np.uint8)
    )
    objects = io.BytesIO()
    np.savez(objects, tree=np.array([{"a": 1}], dtype=object))
    for content in (b"", b"hello", good[:100], good[:-30], text.getvalue(), objects.getvalue()):
        with pytest.raises(StoreError, match="broken"):
            read_part(content)
    with pytest.raises(TypeError):
        part_bytes(Unread("not a result"))  # type: ignore[arg-type]


@examples(150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_byte_is_refused_or_a_result(make_result: Callable[[], PartResult], data: st.DataObject) -> None:
    """Nothing else comes out, whatever the byte; that numbers are as they were written, the checksum tells."""
    content = bytearray(part_bytes(make_result()))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(StoreError):
        assert isinstance(read_part(bytes(content)), PartResult)
