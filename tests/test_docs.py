"""Documentation: examples run, links hold."""

import dataclasses
import doctest
import importlib
import inspect
import re
import sys
import tomllib
import types
from collections.abc import Iterator

import numpy as np
import pytest

import controllers
import ldctoolkit
import studies
from helpers.cli import ROOT, blocks, run_python
from helpers.closed_loop import Stepped
from ldctoolkit import Scenarios, controller_class, register, registry, simulate
from ldctoolkit.metrics import METRIC_UNITS
from ldctoolkit.plant_options import KalmanFilter, PlantOptions
from ldctoolkit.testing import contract_faults
from studies import Study


def test_the_readmes_python_runs(capsys: pytest.CaptureFixture[str]) -> None:
    run_python("README.md", {"__name__": "readme"})
    assert len(capsys.readouterr().out.splitlines()) == 3


@pytest.mark.parametrize(
    ("page", "lines"),
    [
        ("docs/explanation/closed-loop.md", 7),
        ("docs/explanation/plant-options.md", 1),
        ("docs/reference/metrics.md", 4),
        ("docs/how-to/reviewing-a-design.md", 2),
    ],
)
def test_the_pages_python_runs(page: str, lines: int, capsys: pytest.CaptureFixture[str]) -> None:
    """All blocks of a page in one go; each prints what it says."""
    run_python(page, {"__name__": "page"})
    printed = capsys.readouterr().out
    assert len(printed.splitlines()) == lines
    assert "nan" not in printed


def test_the_toml_of_the_plant_options_is_its_python() -> None:
    page = "docs/explanation/plant-options.md"
    (code, *_), (text,) = blocks(page, "python"), blocks(page, "toml")
    scope: dict[str, object] = {"__name__": "page"}
    exec(compile(code.partition("scenarios =")[0], "plant-options.md", "exec"), scope)
    study = Study.from_dict({"name": "page", "design": [{"law": "none"}], **tomllib.loads(text)})
    assert isinstance(scope["options"], PlantOptions)
    assert study.plant == scope["options"]


def test_pages_link_to_pages_that_exist() -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        for link in re.findall(r"\]\(([\w/.-]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), (page.name, link)
    for page in re.findall(r"`(docs/[\w/.-]+)`", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / page).exists(), page


def test_metrics_names_every_companion() -> None:
    text = (ROOT / "docs/reference/metrics.md").read_text(encoding="utf-8")
    for name, unit in METRIC_UNITS.items():
        row = re.search(rf"^\| `{name}` \| ([^|]+) \|", text, flags=re.M)
        assert row, name
        assert row[1].strip() == unit.replace("^2", "²").replace("^3", "³"), name


def test_plant_options_names_every_field() -> None:
    text = (ROOT / "docs/explanation/plant-options.md").read_text(encoding="utf-8")
    tables: list[type] = [KalmanFilter]
    for field in dataclasses.fields(PlantOptions):
        assert f"## `{field.name}`" in text, field.name
        if dataclasses.is_dataclass(value := getattr(PlantOptions(), field.name)):
            tables.append(type(value))
    for table in tables:
        for field in dataclasses.fields(table):
            assert f"`{field.name}`" in text, field.name


@pytest.fixture
def guide() -> Iterator[types.ModuleType]:
    """The controllers of the guide, in a module of their own (dataclasses look their module up)."""
    module = types.ModuleType("guide")
    sys.modules["guide"] = module
    run_python("docs/how-to/my-law.md", module.__dict__)
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
        registry.forget(design.name)
    assert contract_faults(design, checks=["batch", "take"]) == ()


def test_the_guides_laws_agree_without_integral_and_limit(guide: types.ModuleType) -> None:
    linear = simulate(Stepped(guide.Offset()), SCENARIOS)
    general = simulate(guide.LimitedOffset(K_i=0.0, delta_max=1.0), SCENARIOS)
    np.testing.assert_allclose(general.S, linear.S, rtol=0, atol=1e-12)  # same sums, another order
    assert (simulate(guide.LimitedOffset(), SCENARIOS).S != linear.S).all()


def modules_with_examples() -> list[str]:
    """Found by their text, so that collecting the tests imports nothing."""
    files = [path for package in ("ldctoolkit", "controllers", "studies") for path in (ROOT / package).rglob("*.py")]
    shown = [path.relative_to(ROOT).with_suffix("") for path in files if ">>>" in path.read_text(encoding="utf-8")]
    return sorted(".".join(path.parts).removesuffix(".__init__") for path in shown)


HEAVY = ("studies.", "ldctoolkit.diagnostics", "ldctoolkit.scenario_model")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name.startswith(HEAVY) else ()) for name in modules_with_examples()],
)
def test_examples_run(name: str) -> None:
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted
    assert result.failed == 0


@pytest.mark.parametrize("package", [ldctoolkit, controllers, studies], ids=lambda p: p.__name__)
def test_public_names_are_documented(package: object) -> None:
    for name in package.__all__:  # type: ignore[attr-defined]
        thing = getattr(package, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert inspect.getdoc(thing), f"{name} has no docstring"
        if inspect.isfunction(thing):
            doc = inspect.getdoc(thing) or ""
            for parameter in inspect.signature(thing).parameters:
                assert parameter in doc, f"{name}: parameter {parameter} is not documented"
