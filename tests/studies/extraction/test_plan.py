"""What makes the parts of an extraction another's: a change anywhere in the code that decides the numbers."""

import importlib.util
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import ldctoolkit
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.sources import CombinedReader, FoundParts, recording_reader
from studies.extraction import _program, plan_of

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
