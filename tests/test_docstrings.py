"""Every example in a docstring runs, and every public name is documented."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest

import controllers
import ldctoolkit
import studies

ROOT = Path(__file__).resolve().parent.parent


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
