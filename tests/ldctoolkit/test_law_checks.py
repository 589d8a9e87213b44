"""Laws that are wrong: what they raise, hand over, or are called."""

import asyncio
import dataclasses
import types
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

from helpers.errors import assert_fields
from ldctoolkit import (
    Controller,
    EventStatus,
    LinearLaw,
    Plant,
    RecordedPath,
    SteeringLaw,
    controller_names,
    gain,
    option,
    register,
)
from ldctoolkit.controllers import LQR
from ldctoolkit.declared import declared_gains
from ldctoolkit.errors import InputError
from ldctoolkit.law_checks import check_controller, check_law, check_step, raised


class Base(Controller):
    """All that the mistakes below do not get wrong."""

    name: ClassVar[str] = "mistaken"
    title: ClassVar[str] = "Mistaken"

    def prepare(self, plant: Plant) -> RecordedPath:
        return RecordedPath()


frozen = dataclasses.dataclass(frozen=True)


def K(default: Any = -0.2, lower: Any = -1.0, upper: Any = 0.0, **more: Any) -> Any:
    return gain(default, unit="rad/rad", lower=lower, upper=upper, description="", **more)


def refused(cls: type[Controller], message: str) -> None:
    """The same message wherever the class is met first."""
    for use in (lambda: register(cls), lambda: check_controller(cls()), cls):
        with pytest.raises(InputError, match=rf"^{message}$"):
            use()
    assert "mistaken" not in controller_names()


def test_a_class_that_is_no_dataclass() -> None:
    class Plain(Base):
        K: float = K()

    class Bare(Base):
        pass

    @frozen
    class Second(Plain):  # its base's gain is lost on it
        pass

    wanted = r"not a dataclass; write @dataclasses\.dataclass\(frozen=True\) directly above the class"
    for cls in (Plain, Bare):
        with pytest.raises(InputError, match=f"{cls.__name__}: {wanted}"):
            register(cls)
        with pytest.raises(InputError, match=f"{cls.__name__}: {wanted}"):
            check_controller(cls())
    refused(Second, f"Second: {wanted}")


def test_a_subclass_without_fields_of_its_own_needs_no_decorator() -> None:
    class Renamed(LQR):  # type: ignore[misc]
        name = "renamed"

    assert check_controller(Renamed(q_y=2.0)).name == "renamed"


def test_a_class_that_is_not_frozen() -> None:
    @dataclasses.dataclass
    class Thawed(Base):
        K: float = K()

    refused(Thawed, r"Thawed: a dataclass that is not frozen; write @dataclasses\.dataclass\(frozen=True\)")


def test_names() -> None:
    def prepare(self: Controller, plant: Plant) -> RecordedPath:
        return RecordedPath()

    def made(**attributes: Any) -> type[Controller]:
        cls = types.new_class("Made", (Controller,), exec_body=lambda body: body.update(prepare=prepare, **attributes))
        return frozen(cls)

    refused(made(title="T"), r"Made\.name: None; allowed: a non-empty string, ClassVar\[str\]")
    refused(made(name="mistaken"), r"Made\.title: None; allowed: .*")
    refused(made(name="", title="T"), r"Made\.name: ''; allowed: .*")
    refused(made(name="mistaken", title=3), r"Made\.title: 3; allowed: .*")

    @frozen
    class NameIsAField(Base):
        name: str = "mistaken"  # type: ignore[misc]

    refused(NameIsAField, r"NameIsAField\.name: a field of the dataclass; write name: ClassVar\[str\] = \.\.\.")


def test_no_prepare() -> None:
    @frozen
    class Idle(Controller):
        name = "mistaken"
        title = "Idle"

    with pytest.raises(InputError, match=r"^Idle: no prepare; define it$"):
        register(Idle)
    with pytest.raises(TypeError, match=r"abstract class Idle.*prepare"):  # Python's own words say it
        Idle()  # type: ignore[abstract]


@pytest.mark.parametrize(
    ("annotation", "declared", "path", "value"),
    [
        ("float", K(5.0), "K.default", 5.0),
        ("float", K(np.nan), "K.default", np.nan),
        ("float", K(-0.5, 0.0, -1.0), "K", ...),
        ("float", K(-0.5, None), "K", ...),
        ("float", K(0.5, 0.0, 1.0, scale="log"), "K.scale", "log"),
        ("float", K(scale="logarithm"), "K.scale", "logarithm"),
        ("float", K("fast"), "K.default", "fast"),
        ("float", K(True), "K.default", True),
        ("int", K(-0.5), "K.default", -0.5),
        (int, K(False), "K.default", False),
        ("bool", K(0), "K.default", 0),
        ("str", K(-0.5), "K.default", -0.5),
        (float, K(None), "K.default", None),
        ("str", option("c", choices=("a", "b"), description=""), "K.default", "c"),
        ("str", option("a", choices="ab", description=""), "K.choices", "ab"),  # type: ignore[arg-type]
        ("str", option("a", choices=(), description=""), "K.default", "a"),
        ("int", option("a", choices=("a",), description=""), "K", ...),
        ("str", option(5.0, choices=None, description=""), "K.default", 5.0),  # type: ignore[arg-type]
        ("float", option("a", choices=None, description=""), "K", ...),
    ],
)
def test_declarations_that_contradict_themselves(annotation: Any, declared: Any, path: str, value: Any) -> None:
    law: Any = dataclasses.make_dataclass("D", [("K", annotation, declared)], bases=(Base,), frozen=True)
    for use in (law, lambda: register(law)):
        with pytest.raises(InputError) as caught:
            use()
        assert_fields(caught.value, f"D.{path}", value)


def test_a_default_that_is_no_single_value() -> None:
    for default in ([1.0], np.zeros(4)):
        with pytest.raises(InputError, match=r"^default: .*; allowed: one number"):
            K(default)


@pytest.mark.parametrize(
    ("annotation", "default", "kind", "given", "kept"),
    [
        ("float", -1, float, -0.5, -0.5), (float, -1, float, np.float32(-0.5), -0.5),
        ("float", np.float32(-0.5), float, np.int64(0), 0.0), ("int", -1.0, int, np.int64(0), 0),
        (int, np.int64(-1), int, -1.0, -1), ("bool", False, bool, True, True), ("Any", -1, int, 0, 0),
        ("Any", -0.5, float, -1, -1.0),
    ],
)  # fmt: skip
def test_the_annotation_decides_the_kind(annotation: Any, default: Any, kind: type, given: Any, kept: Any) -> None:
    D: Any = dataclasses.make_dataclass("D", [("K", annotation, K(default))], bases=(Base,), frozen=True)
    (declared,) = declared_gains(D)
    assert type(declared.default) is kind
    assert type(D().K) is kind
    assert default == D().K
    assert type(D(K=given).K) is kind
    assert kept == D(K=given).K
    if kind is int:
        with pytest.raises(InputError, match=r"mistaken\.K: -0\.5; allowed: a whole number from -1 to 0"):
            D(K=-0.5)


def test_plain_fields_run_but_have_no_place_in_studies() -> None:
    @frozen
    class Tuned(Base):
        K: float = K()
        table: str = "a"
        derived: float = dataclasses.field(init=False, default=0.0)

    check_controller(Tuned(table="b"))
    with pytest.raises(InputError, match=r"^Tuned\.table: a plain field; allowed: one made with gain\(\) or option"):
        register(Tuned)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (LQR, r"controller: the class LQR; allowed: a controller instance, e\.g\. LQR\(\)"),
        ("lqr", r"controller: 'lqr'; allowed: a controller instance, e\.g\. controller_class\('lqr'\)\(\)"),
        (None, r"controller: None; allowed: a controller instance, e\.g\. LQR\(\)"),
        ([LQR(r_delta=100.0)], r"controller: an object of type list; allowed: .*"),
        (int, r"controller: the class int; allowed: .*"),
    ],
)
def test_what_is_no_design(given: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}$"):
        check_controller(given)


def test_a_design_comes_back() -> None:
    design = LQR(r_delta=100.0)
    assert check_controller(design) is design


# laws, for n = 3 scenarios and p = 2 lookahead times
def linear(**fields: Any) -> LinearLaw:
    good = {
        "F": np.zeros((3, 4)), "preview_times": np.array([0.0, 1.0]), "G_yaw_rate": np.zeros((3, 2)),
        "G_heading": np.zeros((3, 2)), "f_u": np.zeros(3),
    }  # fmt: skip
    return LinearLaw(**(good | fields))


class Steps(SteeringLaw):
    def __init__(self, times: Any) -> None:
        self.times = times

    @property
    def preview_times(self) -> Any:
        return self.times

    def init(self, n: int) -> None:
        return None

    def step(self, *args: Any) -> Any:
        raise NotImplementedError


class NoProperty(Steps):
    def preview_times(self) -> Any:  # type: ignore[override]
        return np.zeros(1)


GOOD_LAWS: list[Callable[[], Any]] = [
    RecordedPath,
    linear,
    lambda: linear(F=np.full((3, 4), np.nan)),  # counted by the loop
    lambda: linear(preview_times=np.arange(2), F=np.zeros((3, 4), dtype=np.float32)),
    lambda: linear(preview_times=np.zeros(0), G_yaw_rate=np.zeros((3, 0)), G_heading=np.zeros((3, 0))),
    lambda: Steps(np.zeros(0)),
    lambda: Steps(np.array([0.0, 2.0])),
]


@pytest.mark.parametrize("make", GOOD_LAWS)
def test_good_laws_come_back(make: Callable[[], Any]) -> None:
    law = make()
    assert check_law(law, 3, "c") is law


@pytest.mark.parametrize(
    ("law", "part", "problem", "allowed"),
    [
        (None, "prepare", "returned None", "SteeringLaw"),
        (RecordedPath, "prepare", "returned the class RecordedPath", "a LinearLaw"),
        (np.zeros((3, 4)), "prepare", "returned an array of shape (3, 4) and dtype float64", ""),
        (linear(F=[[0.0] * 4] * 3), "F", "an object of type list", "an array of shape (3, 4)"),
        (linear(F=None), "F", "None", "(3, 4)"),
        (linear(F=np.zeros((3, 3))), "F", "shape (3, 3)", "(3, 4)"),
        (linear(f_u=np.zeros((3, 1))), "f_u", "shape (3, 1)", "(3,)"),
        (linear(f_u=0.0), "f_u", "0.0", "an array of shape (3,)"),
        (linear(f_past=np.zeros(3)), "f_past", "shape (3,)", "(3, q)"),
        (linear(f_wheel=np.zeros(2)), "f_wheel", "shape (2,)", "(3,)"),
        (linear(G_heading=np.zeros((3, 1))), "G_heading", "shape (3, 1)", "(3, 2)"),
        (linear(G_yaw_rate=np.full((3, 2), "a")), "G_yaw_rate", "an array", "an array of real numbers"),
        (linear(F=np.zeros((3, 4), dtype=complex)), "F", "dtype complex128", "real numbers"),
        (linear(preview_times=np.array(1.0)), "preview_times", "shape ()", "(p,)"),
        (linear(preview_times=np.array([0.0, -1.0])), "preview_times", -1.0, "finite times >= 0 [s]"),
        (Steps(np.array([-10.5])), "preview_times", -10.5, ">= -10 [s]"),
        (Steps(np.array([np.inf])), "preview_times", np.inf, "finite times"),
        (Steps(np.float64(0.5)), "preview_times", "np.float64(0.5)", "an array of shape (p,)"),
        (Steps([0.0]), "preview_times", "an object of type list", "(p,)"),
        (NoProperty(None), "preview_times", "a method", ""),
    ],
)
def test_bad_laws(law: object, part: str, problem: str | float, allowed: str) -> None:
    with pytest.raises(InputError) as error:
        check_law(law, 3, "c")
    is_refused(error.value, f"controller 'c': {part}", problem, allowed)


def is_refused(error: InputError, path: str, problem: object, allowed: str) -> None:
    """What is given is the value where it is a number, and named in the problem otherwise."""
    assert error.path == path
    assert problem in error.problem if isinstance(problem, str) else error.value == pytest.approx(problem, nan_ok=True)
    assert allowed in error.allowed


def test_a_good_step_comes_back_as_arrays_of_its_own() -> None:
    given, state = np.array([0.1, np.nan, 0.0]), object()
    delta, same, status = check_step((given, state, [EventStatus.OK, EventStatus.SOLVER_FAILED, 0]), 3, "c")
    np.testing.assert_array_equal(delta, given)
    delta[:] = 9.0
    assert given[0] == 0.1
    assert same is state
    assert status.dtype == np.int8
    np.testing.assert_array_equal(status, [0, 2, 0])


ZEROS = np.zeros(3)


@pytest.mark.parametrize(
    ("result", "part", "problem", "allowed"),
    [
        (ZEROS, "", "returned an array of shape (3,)", "a tuple (delta, state, status)"),
        (None, "", "returned None", "a tuple"),
        ((ZEROS, None), "", "returned a tuple of 2", "a tuple"),
        ((ZEROS, ZEROS, None), ": status", "None", "an array of real numbers"),
        ((ZEROS, None, ZEROS > 0), ": status", "dtype bool", ""),
        ((["a"] * 3, None, ZEROS), ": delta", "an object of type list", "an array of real numbers"),
        (([[1.0], []], None, ZEROS), ": delta", "an object of type list", ""),
        ((ZEROS + 1j, None, ZEROS), ": delta", "dtype complex128", ""),
        ((ZEROS[:2], None, ZEROS), ": delta", "shape (2,)", "(3,)"),
        ((ZEROS[:, None], None, ZEROS), ": delta", "shape (3, 1)", "(3,)"),
        ((ZEROS, None, EventStatus.OK), ": status", "shape ()", "(3,)"),
        ((ZEROS, None, np.array([0, 2, 3])), ": status", 3, "EventStatus.OK (0), EventStatus.SOLVER_FAILED (2), "),
        ((ZEROS, None, ZEROS + EventStatus.INVALID), ": status", 5.0, "EventStatus.BEYOND_DELTA_MAX (7)"),
        ((ZEROS, None, ZEROS - 1), ": status", -1.0, ""),
        ((ZEROS, None, ZEROS + np.nan), ": status", np.nan, ""),
        ((ZEROS, None, ZEROS + 256), ": status", 256.0, ""),  # 0 as an int8
    ],
)
def test_bad_steps(result: object, part: str, problem: str | float, allowed: str) -> None:
    with pytest.raises(InputError) as error:
        check_step(result, 3, "c")
    is_refused(error.value, f"controller 'c': step{part}", problem, allowed)


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (ValueError("a \ud800 b"), r"ValueError: a \ud800 b"),
        (ValueError("a\tb\nc"), "ValueError: a b c"),
        (InputError("K: 'ü'"), "K: 'ü'"),
        (asyncio.CancelledError(), "CancelledError"),
    ],
)
def test_one_clean_line(error: BaseException, line: str) -> None:
    assert raised(error) == line
