"""The code that the README and the guides show is run as it stands."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ldctoolkit import Scenarios, controller_class, register, registry, simulate

ROOT = Path(__file__).resolve().parent.parent


def blocks(path: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / path).read_text(encoding="utf-8"), flags=re.S)


def test_the_readmes_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = blocks("README.md", "python")
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert len(capsys.readouterr().out.splitlines()) == 3


@pytest.fixture
def guide() -> Iterator[types.ModuleType]:
    """The controllers of the guide, in a module of their own (dataclasses look their module up)."""
    module = types.ModuleType("guide")
    sys.modules["guide"] = module
    for code in blocks("docs/writing-a-controller.md", "python"):
        exec(compile(code, "writing-a-controller.md", "exec"), module.__dict__)
    yield module
    del sys.modules["guide"]


SCENARIOS = Scenarios.from_arrays(T=[3.0, 5.0], d_y=[0.5, 0.6], v_mean=[25.0, 18.0], c_0=1e-3)


@pytest.mark.parametrize("name", ["Offset", "LimitedOffset"])
def test_the_guides_controllers_run(guide: types.ModuleType, name: str) -> None:
    design = getattr(guide, name)()
    out = simulate(design, SCENARIOS)
    assert (out.reduction > 0).all()
    assert np.isfinite(out.S).all()
    assert not out.failed_solves.any()
    try:
        assert controller_class(register(type(design)).name) is type(design)
    finally:
        registry._registered.pop(design.name, None)


def test_the_guides_laws_agree_without_integral_and_limit(guide: types.ModuleType) -> None:
    linear = simulate(guide.Offset(), SCENARIOS)
    general = simulate(guide.LimitedOffset(K_i=0.0, delta_max=1.0), SCENARIOS)
    np.testing.assert_allclose(general.S, linear.S, rtol=0, atol=1e-12)  # same sums, another order
    assert (simulate(guide.LimitedOffset(), SCENARIOS).S != linear.S).all()


def test_readme_names_pages_that_exist() -> None:
    for page in re.findall(r"`(docs/[\w/.-]+)`", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / page).exists(), page
