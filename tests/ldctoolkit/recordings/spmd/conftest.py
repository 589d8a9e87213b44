"""Tables of SPMD for the tests."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SAMPLE = Path(__file__).parents[4].parent / "shared" / "data" / "spmd-20row-heads"


def load(name: str) -> ModuleType:
    """A file beside this one as a module."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their own module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def das1() -> Any:
    """The module `das1_tables`."""
    return load("das1_tables")


@pytest.fixture(scope="session")
def das2() -> Any:
    """The module `das2_tables`."""
    return load("das2_tables")


@pytest.fixture(scope="session")
def sample() -> Path:
    """Folder of the real tables' first lines."""
    if not SAMPLE.is_dir():
        pytest.skip(f"the sample of the real tables is not there: {SAMPLE.name}")
    return SAMPLE
