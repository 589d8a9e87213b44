"""The code that the README and the guides show is run as it stands."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from ldctoolkit import Scenarios, simulate

ROOT = Path(__file__).resolve().parent.parent


def blocks(path: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / path).read_text(encoding="utf-8"), flags=re.S)


def test_the_readmes_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks("README.md", "python")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_the_guides_controller_runs() -> None:
    (code,) = blocks("docs/writing-a-controller.md", "python")
    module = types.ModuleType("guide")
    sys.modules["guide"] = module
    try:
        exec(compile(code, "writing-a-controller.md", "exec"), module.__dict__)
        scenarios = Scenarios.from_arrays(T=[3.0, 5.0], d_y=[0.5, 0.6], v_mean=[25.0, 18.0], c_0=1e-3)
        out = simulate(module.Offset(), scenarios)
        assert (out.reduction > 0).all()
        assert np.isfinite(out.S).all()
    finally:
        del sys.modules["guide"]


def test_readme_names_pages_that_exist() -> None:
    for page in re.findall(r"`(docs/[\w/.-]+)`", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / page).exists(), page
