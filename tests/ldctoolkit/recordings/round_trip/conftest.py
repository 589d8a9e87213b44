"""The package that makes the recordings, loaded from the folder beside: test folders are not on the path."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

NAME = "round_trip_making"


def load_making() -> ModuleType:
    """The package `making`."""
    if NAME not in sys.modules:
        place = Path(__file__).with_name("making") / "__init__.py"
        spec = importlib.util.spec_from_file_location(NAME, place, submodule_search_locations=[str(place.parent)])
        if spec is None or spec.loader is None:
            raise ImportError(place)
        module = importlib.util.module_from_spec(spec)
        sys.modules[NAME] = module
        spec.loader.exec_module(module)
    return sys.modules[NAME]


@pytest.fixture(scope="session")
def making() -> ModuleType:
    return load_making()
