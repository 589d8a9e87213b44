"""A report to open, and the browser to open it in."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a Chromium; skips where there is none."""
    for name in ("chromium", "chromium-browser", "google-chrome"):
        found = shutil.which(name)
        if found:
            return found
    pytest.skip("no Chromium on PATH (chromium, chromium-browser, google-chrome)")


@pytest.fixture(scope="session")
def make() -> ModuleType:
    """Functions that invent small studies, shared with the tests of the report."""
    path = Path(__file__).resolve().parents[1] / "studies" / "report" / "conftest.py"
    spec = importlib.util.spec_from_file_location("report_making", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
