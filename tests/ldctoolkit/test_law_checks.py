"""Laws that are wrong: what they raise, hand over, or are called."""

import asyncio
import dataclasses
import types
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Idle, frozen
from helpers.errors import refused
from ldctoolkit import (
    Controller,
    EventStatus,
    LinearLaw,
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


def K(default: Any = -0.2, lower: Any = -1.0, upper: Any = 0.0, **more: Any) -> Any:
    return gain(default, unit="rad/rad", lower=lower, upper=upper, description="", **more)


class Plain(Idle):
    K: float = K()


class Bare(Idle):
    pass


@frozen
class Second(Plain):  # its base's gain is lost on it
    pass


@dataclasses.dataclass
class Thawed(Idle):
    K: float = K()


@frozen
class NameIsAField(Idle):
    name: str = "idle"  # type: ignore[misc]


def named(**attributes: Any) -> Any:
    body = {"prepare": Idle.prepare, "__module__": __name__} | attributes
    return frozen(types.new_class("Named", (Controller,), exec_body=lambda space: space.update(body)))


WRITE = "write @dataclasses.dataclass(frozen=True)"
TEXT = "a non-empty string, ClassVar[str]"


@pytest.mark.parametrize(
    ("law", "path", "fields"),
    [
        *((law, law.__name__, {"problem": "not a dataclass", "hint": f"{WRITE} directly above the class"})
          for law in (Plain, Bare, Second)),
        (Thawed, "Thawed", {"problem": "a dataclass that is not frozen", "hint": WRITE}),
        (named(title="T"), "Named.name", {"value": None, "allowed": TEXT}),
        (named(name="idle"), "Named.title", {"value": None, "allowed": TEXT}),
        (named(name="", title="T"), "Named.name", {"value": "", "allowed": TEXT}),
        (named(name="idle", title="T", bach=20), "Named.bach", {"hint": "did you mean 'batch'?"}),
        (named(name="idle", title=3), "Named.title", {"value": 3, "allowed": TEXT}),
        (NameIsAField, "NameIsAField.name",
         {"problem": "a field of the dataclass", "hint": "write name: ClassVar[str] = ..."}),
    ],
)  # fmt: skip
def test_a_class_that_does_not_follow_the_interface(law: Any, path: str, fields: dict[str, Any]) -> None:
    """The same error wherever the class is met first."""
    checked = dataclasses.is_dataclass(law) and law is not Plain  # the design itself checks its class
    for use in (lambda: register(law), lambda: check_controller(law()), *([law] if checked else [])):
        with refused(path, **fields):
            use()
    assert "idle" not in controller_names()


def test_a_subclass_without_fields_of_its_own_needs_no_decorator() -> None:
    class Renamed(LQR):  # type: ignore[misc]
        name = "renamed"

    assert check_controller(Renamed(q_y=2.0)).name == "renamed"
    kind = named(name="idle", title="T", names=("a",), prepared=len, weights=(1.0,))  # resemble what it has, or nothing
    assert check_controller(kind()).names == ("a",)  # type: ignore[attr-defined]


def test_no_prepare() -> None:
    @frozen
    class Unprepared(Controller):
        name = "idle"
        title = "Unprepared"

    with refused("Unprepared", problem="no prepare", hint="define it"):
        register(Unprepared)
    with pytest.raises(TypeError, match=r"abstract class Unprepared.*prepare"):  # Python's own words say it
        Unprepared()  # type: ignore[abstract]


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
    law: Any = dataclasses.make_dataclass("D", [("K", annotation, declared)], bases=(Idle,), frozen=True)
    for use in (law, lambda: register(law)):
        with refused(f"D.{path}", value=value):
            use()


@pytest.mark.parametrize("default", [[1.0], np.zeros(4)])
def test_a_default_that_is_no_single_value(default: Any) -> None:
    with refused("default", value=default, allowed="one number, truth value or word"):
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
    D: Any = dataclasses.make_dataclass("D", [("K", annotation, K(default))], bases=(Idle,), frozen=True)
    (declared,) = declared_gains(D).values()
    assert type(declared.default) is kind
    assert type(D().K) is kind
    assert default == D().K
    assert type(D(K=given).K) is kind
    assert kept == D(K=given).K
    if kind is int:
        with refused("idle.K", value=-0.5, allowed="a whole number from -1 to 0 rad/rad"):
            D(K=-0.5)


def test_plain_fields_run_but_have_no_place_in_studies() -> None:
    @frozen
    class Tuned(Idle):
        K: float = K()
        table: str = "a"
        derived: float = dataclasses.field(init=False, default=0.0)

    design = Tuned(table="b")
    assert check_controller(design) is design
    with refused("Tuned.table", problem="a plain field", allowed="one made with gain() or option()"):
        register(Tuned)


@pytest.mark.parametrize(
    ("given", "problem", "example"),
    [
        (LQR, "the class LQR", "LQR()"),
        ("lqr", "'lqr'", "controller_class('lqr')()"),
        (None, "None", "LQR()"),
        ([LQR(r_delta=100.0)], "an object of type list", "LQR()"),
        (int, "the class int", "LQR()"),
    ],
)
def test_what_is_no_design(given: object, problem: str, example: str) -> None:
    with refused("controller", problem=problem, allowed=f"a controller instance, e.g. {example}"):
        check_controller(given)


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


BAD_LAWS = [
    (None, "prepare", "returned None", "SteeringLaw"),
    (RecordedPath, "prepare", "returned the class RecordedPath", "a LinearLaw"),
    (np.zeros((3, 4)), "prepare", "returned an array of shape (3, 4) and dtype float64", ""),
    (linear(F=[[0.0] * 4] * 3), "F", "an object of type list", "an array of shape (3, 4)"),
    (linear(F=np.zeros((3, 3))), "F", "shape (3, 3)", "(3, 4)"),
    (linear(f_u=0.0), "f_u", "0.0", "an array of shape (3,)"),
    (linear(f_past=np.zeros(3)), "f_past", "shape (3,)", "(3, q)"),
    (linear(f_wheel=np.zeros(2)), "f_wheel", "shape (2,)", "(3,)"),
    (linear(conditioned=np.ones(3)), "conditioned", "an array of shape (3,)", "True or False"),
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
]
ZEROS = np.zeros(3)
BAD_STEPS = [
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
]


@pytest.mark.parametrize(
    ("check", "given", "part", "problem", "allowed"),
    [*((check_law, *row) for row in BAD_LAWS), *((check_step, *row) for row in BAD_STEPS)],
)
def test_bad_laws_and_steps(check: Any, given: object, part: str, problem: str | float, allowed: str) -> None:
    """What is given is the value where it is a number, and named in the problem otherwise."""
    with pytest.raises(InputError) as caught:
        check(given, 3, "c")
    error = caught.value
    assert error.path == f"controller 'c': {'step' if check is check_step else ''}{part}"
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
