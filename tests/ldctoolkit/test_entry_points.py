"""Controllers that come from installed packages by entry points."""

import dataclasses
import importlib.metadata
import sys
import types
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from helpers.closed_loop import Idle, frozen
from helpers.errors import refused
from ldctoolkit import Controller, controller_class, gain, register, registry
from ldctoolkit.controllers import LQR
from ldctoolkit.errors import LdcError

TOO_HIGH: Any = gain(5.0, unit="rad/rad", lower=-1.0, upper=0.0, description="")


@frozen
class Listed(Idle):
    name: ClassVar[str] = "listed"


@frozen
class Unlisted(Idle):
    name: ClassVar[str] = "listed"


@pytest.fixture
def listed(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make an entry point of a given value known as 'listed', as an installed package would."""
    registered: dict[str, type[Controller]] = {}
    monkeypatch.setattr(registry, "_registered", registered)

    def install(value: str) -> None:
        point = importlib.metadata.EntryPoint("listed", value, registry.GROUP)
        monkeypatch.setattr(registry, "entry_points", lambda group: {"listed": point})

    return install


@pytest.mark.parametrize("extra", ["", " [fast]"])
def test_a_class_that_is_an_entry_point_may_also_be_registered(listed: Callable[[str], None], extra: str) -> None:
    listed(f"{__name__}:Listed{extra}")
    assert register(Listed) is Listed
    assert register(Listed) is Listed
    assert controller_class("listed") is Listed
    with refused("Unlisted.name", value="listed"):
        register(Unlisted)


def test_a_class_handed_on_by_its_package(listed: Callable[[str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Listed, "__module__", "package.inner.module")
    listed("package.inner:Listed")
    register(Listed)
    registry._registered.clear()
    for other in ("package.in:Listed", "package.inner:Unlisted", "other:Listed"):
        listed(other)
        with refused("Listed.name"):
            register(Listed)


def test_entry_points_are_checked(listed: Callable[[str], None], monkeypatch: pytest.MonkeyPatch) -> None:
    fake = types.ModuleType("fake_package")
    monkeypatch.setitem(sys.modules, "fake_package", fake)
    listed("fake_package:Law")
    with pytest.raises(LdcError, match=r"'listed' \(fake_package:Law\): cannot be loaded: .*Law"):
        controller_class("listed")
    for law, message in (
        (int, "allowed: a subclass of Controller"),
        (dataclasses.make_dataclass("D", [("K", float, TOO_HIGH)], bases=(Idle,), frozen=True), r"D\.K\.default: 5\.0"),
        (dataclasses.make_dataclass("D", [("K", float, -0.2)], bases=(Idle,), frozen=True), "D.K: a plain field"),
        (LQR, r"name: 'lqr'; allowed: 'listed'"),
    ):
        fake.Law = law  # type: ignore[attr-defined]
        with pytest.raises(LdcError, match=message):
            controller_class("listed")
    fake.Law = Listed  # type: ignore[attr-defined]
    assert controller_class("listed") is Listed


def test_a_file_that_raises(listed: Callable[[str], None], tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "broken_law_file.py").write_text("K = 1 / 0\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    listed("broken_law_file:Law")
    with pytest.raises(LdcError, match=r"'listed' \(broken_law_file:Law\): cannot be loaded: ZeroDivisionError: "):
        controller_class("listed")
