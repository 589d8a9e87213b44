"""The contract names each fault of a law by the check that it breaks, and finds none where there is none."""

import contextlib
import dataclasses
import math
import pickle
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from helpers.cli import python
from helpers.errors import refused
from ldctoolkit import BicycleModel, Controller, EventStatus, LinearLaw, Plant, Preview, SteeringLaw, gain, option
from ldctoolkit.control import LinearSteps, RecordedPath
from ldctoolkit.controllers import LQR
from ldctoolkit.errors import InputError
from ldctoolkit.simulation import BOUND
from ldctoolkit.testing import (
    CHECKS,
    ContractError,
    ContractSettings,
    ControllerContract,
    Fault,
    check_controller_contract,
    contract_faults,
)
from ldctoolkit.testing.subject import bends, corners

IN_PROCESS = tuple(name for name in CHECKS if name != "picklable")
"""Classes of a test module cannot be loaded by a fresh process."""

MEMORY: list[float] = []
SHARED = np.zeros(64)


@dataclasses.dataclass(frozen=True)
class Steered(SteeringLaw):
    """A law with an integral, limits of angle and rate, and a fault of choice."""

    design: Any
    steady: np.ndarray
    dt: float
    memory: list[float]
    number: np.ndarray

    @property
    def how(self) -> str:
        return str(self.design.how)

    @property
    def preview_times(self) -> np.ndarray:
        return np.array([0.0, 0.5])

    def init(self, n: int) -> Any:
        return SHARED[:n] if self.how == "state of all runs" else np.zeros(n)

    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        d, how, n = self.design, self.how, t.size
        given = x.copy()
        wanted = d.K * x[:, 0] + 3 * d.K * x[:, 2] + self.steady * preview.yaw_rate[:, 0] + d.K_i * state
        match how:
            case "raises":
                raise IndexError("no such row")
            case "exits":
                raise SystemExit(3)
            case "interrupted":
                raise KeyboardInterrupt
            case "nothing":
                return None
            case "bias":
                wanted = wanted + 1e-6
            case "one-sided":
                wanted = np.where(x[:, 0] > 0, wanted, 1.001 * wanted)
            case "not finite far out":
                wanted = np.where(np.abs(x[:, 0]) > 15.0, np.nan, wanted)
            case "counts calls in a module":
                MEMORY.append(1.0)
                wanted = wanted * (1 - 1e-9 * len(MEMORY))
            case "counts calls on itself":
                self.memory.append(1.0)
                wanted = wanted * (1 - 1e-9 * len(self.memory))
            case "neighbours":
                wanted = wanted - 1e-6 * x[:, 0].mean()
            case "its place":
                wanted = wanted * (1 - 1e-9 * np.arange(n))
            case "changes x":
                x[:, 0] = 0.0
            case "changes delta_prev":
                delta_prev += 1.0
                delta_prev -= 1.0 + 1e-15
            case "fails on zeros":
                if (np.abs(x).sum(axis=1) == 0).any() and (x != 0).any():
                    raise ZeroDivisionError("centred")
        step = d.rate_max * self.dt
        before = np.clip(delta_prev, -0.5, 0.5)
        limited = np.clip(wanted, -d.delta_max, d.delta_max) if how != "no limit of the angle" else wanted
        delta = before + np.clip(limited - before, -step, step) if how != "no limit of the rate" else limited
        status: Any = np.full(n, EventStatus.OK, dtype=np.int8)
        new: Any = state + self.dt * given[:, 0]
        match how:
            case "shape":
                delta = delta[:, None]
            case "single precision":
                delta = delta.astype(np.float32)
            case "status of another kind":
                status = [EventStatus.OK] * n
            case "unknown status":
                status = np.full(n, EventStatus.DIVERGED, dtype=np.int8)
            case "unsolved":
                status = np.full(n, EventStatus.SOLVER_FAILED, dtype=np.int8)
            case "changes its state" | "state of all runs":
                state += self.dt * given[:, 0]
                new = state
            case "infinite":
                delta = np.full(n, np.inf) if d.K_i == 0.01 else delta
        return delta, new, status

    def take(self, rows: Any, state: Any) -> Any:
        if self.how == "takes other rows":
            rows = rows[::-1]
        return dataclasses.replace(self, steady=self.steady[rows], number=self.number[rows]), state[rows]


class Base(Controller):
    name: ClassVar[str] = "steered"
    title: ClassVar[str] = "Steered"
    how: ClassVar[str] = "well"

    def prepare(self, plant: Plant) -> Any:
        if self.how == "prepare raises":
            raise KeyError("v")
        if self.how == "nothing triggers" and plant.n == 0:
            raise ValueError("no speeds")
        if self.how == "changes the plant":
            plant.v[:] = np.round(plant.v, 3)
        if self.how == "no law":
            return 3.0
        if self.how == "speeds of others":
            return Steered(self, plant.steady_state().delta * plant.v.max(initial=1.0) / 40.0, plant.dt, [], plant.v)
        return Steered(self, plant.steady_state().delta, plant.dt, [], plant.v)


def K(default: float = -0.02, **more: Any) -> Any:
    given = {"unit": "rad/m", "lower": -1.0, "upper": 0.0, "description": "gain"} | more
    return gain(default, **given)


FIELDS: list[Any] = [
    ("K", float, K()), ("K_i", float, K(-0.002, lower=-0.01, upper=0.01)),
    ("delta_max", float, K(0.1, lower=0.01, upper=1.0)), ("rate_max", float, K(0.2, lower=0.01, upper=10.0)),
]  # fmt: skip


def law(how: str, fields: Any = FIELDS, **space: Any) -> type[Controller]:
    space |= {"how": how, "__module__": __name__}
    return dataclasses.make_dataclass("Law", fields, bases=(Base,), namespace=space, frozen=True)


def test_a_law_that_keeps_the_contract() -> None:
    check_controller_contract(law("well"), [law("well")(K=-0.05, K_i=0.0)], checks=IN_PROCESS)
    check_controller_contract(law("one-sided", symmetric=False), checks=IN_PROCESS)


@pytest.mark.parametrize(
    ("how", "check", "sentence", "others"),
    [
        ("shape", "interface", r".* 'steered': step: delta: shape \(12, 1\); allowed: .*", None),
        ("no law", "interface", r".*prepare: returned 3\.0; allowed: a LinearLaw, .*", None),
        ("prepare raises", "interface", r"KeyError: 'v' \(test_testing\.py, line \d+\)", None),
        ("raises", "interface", r"IndexError: no such row \(test_testing\.py, line \d+\)", None),
        ("exits", "interface", r"SystemExit: 3 \(test_testing\.py, line \d+\)", None),
        ("exits", "extremes", r"K = -1\.0: SystemExit: 3; allowed: finite commands", None),
        ("nothing", "interface", r".* 'steered': step: returned None; allowed: a tuple .*", None),
        ("unknown status", "interface", r".*step: status: 3; allowed: EventStatus.OK \(0\), .*", None),
        ("single precision", "interface", r"step returned delta of type float32; allowed: an array of float64", None),
        ("status of another kind", "interface", r"step returned status of type list; allowed: .* int8", ()),
        ("changes the plant", "interface", r"prepare changes the arrays of the plant in place; .*", ()),
        ("nothing triggers", "interface", r"ValueError: no speeds \(test_testing\.py, line \d+\)", ()),
        ("counts calls in a module", "repeatable", r"a second run of the same law: delta is .* differ\); .*", None),
        ("counts calls on itself", "state", r"two runs in turns, against one after the other: delta is .*", None),
        ("counts calls on itself", "repeatable", r"a second run of the same law: delta is .*", None),
        ("state of all runs", "state", r"two runs in turns, against one after the other: delta is .*", None),
        ("bias", "mirror", r"the command is \S+ rad and \S+ rad on the mirrored road, at sample 0 of .*", ("quiet",)),
        ("bias", "quiet", r"the command is 1e-06 rad at sample 0 on a straight, centred road; allowed: 0", ("mirror",)),
        ("unsolved", "quiet", r"\d+ commands on a straight, centred road have the status SOLVER_FAILED; .*", ()),
        ("one-sided", "mirror", r".*; allowed: the negative to \S+ rad; .*: symmetric = False in its class", ()),
        ("not finite far out", "finite", r"the command is nan at 1 m/s, x = \(-20, -15, -1\.5, -3\), .*", ()),
        ("no limit of the angle", "limits", r"the command goes from .*; allowed by delta_max = 0\.1: \S+ rad less", ()),
        ("no limit of the rate", "limits", r"the command goes from .*; allowed by rate_max = 0\.2: \S+ rad less", ()),
        ("changes x", "inputs", r"step changes x in place, at sample 0; allowed: new arrays", ()),
        ("changes delta_prev", "inputs", r"step changes delta_prev in place, at sample 0; .*", ()),
        ("changes its state", "inputs", r"step changes state in place, at sample 0; .*", ()),
        ("neighbours", "batch", r"every other scenario alone: delta is .*; allowed: the same to the bit", None),
        ("its place", "batch", r"the scenarios in reverse order: delta is .*", None),
        ("speeds of others", "batch", r".*: delta is .*; allowed: the same to the bit", ()),
        ("takes other rows", "take", r"after take, at sample 1 of the run: delta is .*", ()),
        ("fails on zeros", "ended", r"ZeroDivisionError: centred \(test_testing\.py, line \d+\)", ()),
        ("infinite", "extremes", r"K_i = 0\.01: the command is inf at .*; allowed: finite commands", ()),
    ],
)  # fmt: skip
def test_each_fault_is_named(how: str, check: str, sentence: str, others: tuple[str, ...] | None) -> None:
    MEMORY.clear()
    SHARED[:] = 0.0
    faults = contract_faults(law(how), checks=IN_PROCESS)
    mine = [fault for fault in faults if fault.check == check]
    assert mine, f"{check} has no findings; faults: {faults}"
    assert any(re.fullmatch(sentence, fault.sentence) for fault in mine), mine
    if others is not None:  # None: a fault that many checks trip over
        assert {fault.check for fault in faults} == {check, *others}


class Thawed(law("well")):  # type: ignore[misc]
    __setattr__ = object.__setattr__  # type: ignore[assignment]


def doubled(self: Any) -> None:
    object.__setattr__(self, "K", 2 * self.K)
    Controller.__post_init__(self)


@pytest.mark.parametrize(
    ("controller", "check", "sentence"),
    [
        (law("well", [*FIELDS, ("extra", float, 1.0)]), "declared", r"Law\.extra is a plain field; allowed: gain.*"),
        (law("well", [*FIELDS, ("extra", float, K(unit=""))]), "declared", r"Law\.extra: its unit is empty; .*"),
        (Thawed, "frozen", r"K can be set on a finished design; allowed: .*"),
        (law("well", __eq__=object.__eq__), "frozen", r"a design made from the same values does not equal it; .*"),
        (law("well", __hash__=lambda self: id(self)), "frozen", r"two equal designs have different hashes; .*"),
        (law("well", __post_init__=lambda self: None), "bounds", r"K = -2\.0 is taken; allowed: an InputError, .*"),
        (law("well", __post_init__=doubled), "toml", r"K = -0\.04 comes back from TOML as -0\.08"),
    ],
)
def test_faults_of_designs_are_named(controller: type[Controller], check: str, sentence: str) -> None:
    faults = contract_faults(controller, checks=[check])
    assert any(re.fullmatch(sentence, fault.sentence) for fault in faults), faults


def test_designs_on_their_way_to_worker_processes(tmp_path: Path) -> None:
    """As in a study: a class of a script, a notebook or a function goes along; one that holds a lock does not."""

    class Local(LQR):  # type: ignore[misc]
        name = "local"

    class Locked(LQR):  # type: ignore[misc]
        name = "locked"
        lock = threading.Lock()

    assert contract_faults(Local, checks=["picklable"]) == ()
    (fault,) = contract_faults(Locked, checks=["picklable"])
    assert re.fullmatch(r"cannot be pickled: TypeError: .*lock.*; allowed: fields and names that .*", fault.sentence)

    code = (
        "import sys, ldctoolkit.testing; print({'pytest', 'numba', 'scipy', 'polars'} & set(sys.modules))\n"
        "from ldctoolkit.controllers import LQR\nfrom ldctoolkit.testing import contract_faults\n"
        "class Main(LQR):\n    name = 'main'\n"
        "print(*contract_faults(Main, checks=['picklable']))\n"
    )
    assert python("-c", code, cwd=tmp_path).splitlines() == ["set()", ""]


def test_gains_that_exclude_each_other_or_depend_on_the_vehicle() -> None:
    def refuse(self: Any) -> None:
        Controller.__post_init__(self)
        if self.delta_max > 0.5:
            raise InputError("steered.delta_max", "too much with this K")

    assert contract_faults(law("well", __post_init__=refuse), checks=["extremes"]) == ()

    def prepare(path: str) -> Any:
        def refusing(self: Any, plant: Plant) -> Any:
            if self.K == 0.0:
                raise InputError(path, "too little at 3 m/s")
            return Base.prepare(self, plant)

        return refusing

    assert contract_faults(law("well", prepare=prepare("steered.K")), checks=["extremes"]) == ()
    (fault,) = contract_faults(law("well", prepare=prepare("steered")), checks=["extremes"])
    assert fault.sentence.startswith("K = 0.0: InputError: steered")


def test_words_and_switches_round_trip() -> None:
    fields = [
        ("word", str, option('a "b"', choices=('a "b"', "c\\d"), description="word")),
        ("text", str, option("ä = [1]\n", choices=None, description="text")),
        ("on", bool, gain(True, unit="1", description="switch")),
        ("N", int, gain(10**6, unit="1", description="count")),
        ("tiny", float, gain(1e-300, unit="1", description="small")),
    ]
    controller = law("well", [*FIELDS, *fields])
    design = controller(word="c\\d", on=False, tiny=-1e22)  # type: ignore[call-arg]
    assert contract_faults(controller, [design], checks=["declared", "frozen", "bounds", "toml", "extremes"]) == ()


@pytest.mark.parametrize("conditioned", [False, True])
def test_a_linear_law_is_called_by_its_formula(conditioned: bool) -> None:
    rng = np.random.default_rng(1)
    n, p = 5, 3
    plant = Plant.build(BicycleModel(), np.full(n, 20.0), 0.05, lag=0.1, delay=0.07)
    linear = LinearLaw(
        F=rng.normal(size=(n, 4)), preview_times=np.arange(p) * 0.1, G_yaw_rate=rng.normal(size=(n, p)),
        G_heading=rng.normal(size=(n, p)), f_u=rng.normal(size=n), f_i=rng.normal(size=n),
        f_past=rng.normal(size=(n, 2)), f_wheel=rng.normal(size=n), conditioned=conditioned,
    )  # fmt: skip
    called, x, last = LinearSteps.of(linear, plant), rng.normal(size=(3, n, 4)), rng.normal(size=(3, n))
    preview = Preview(rng.normal(size=(n, p)), rng.normal(size=(n, p)))
    yielding = np.array([[True, False, True, False, False], [True, True, False, False, True]])  # at the first two
    state = called.init(n)
    for k in range(3):
        shown = preview if k == 2 else dataclasses.replace(preview, yielding=yielding[k])
        delta, state, _ = called.step(np.zeros(n), x[k], shown, last[k], state)
        if k == 1:
            some, of_some = called.take(np.array([1, 3]), state)
            part = Preview(preview.yaw_rate[[1, 3]], preview.heading[[1, 3]])
            taken = some.step(np.zeros(2), x[2][[1, 3]], part, last[2][[1, 3]], of_some)[0]
            assert some.law.conditioned is conditioned
    a = math.exp(-0.03 / 0.1)  # the last 0.03 s of a sample are those of the younger of two commands
    for i in range(n):
        z = 0.05 * sum(x[k, i, 0] for k in range(2) if not (conditioned and yielding[k, i]))
        wheel = a * last[0, i] + (1 - a) * last[1, i]  # before the first command the wheel stood at it
        expected = linear.F[i] @ x[2, i] + linear.f_u[i] * last[2, i] + linear.f_i[i] * z + linear.f_wheel[i] * wheel
        expected += linear.G_yaw_rate[i] @ preview.yaw_rate[i] + linear.G_heading[i] @ preview.heading[i]
        assert delta[i] == pytest.approx(expected + linear.f_past[i] @ [last[1, i], last[0, i]], rel=1e-12)
    np.testing.assert_array_equal(taken, delta[[1, 3]])


def test_the_lane_that_laws_are_shown_is_one_lane() -> None:
    """Heading is the integral of yaw rate, and the states reach the bound of the simulation on both sides."""
    times = np.linspace(0.0, 2.0, 401)
    road = bends(5, 4)
    preview = road.preview(2, times)
    middle = 0.5 * (preview.yaw_rate[:, 1:] + preview.yaw_rate[:, :-1])  # exact: the yaw rate is a straight line
    summed = np.cumsum(middle * np.diff(times), axis=1)
    np.testing.assert_allclose(preview.heading[:, 1:], summed, rtol=0, atol=1e-13)  # 400 sums of about 0.1
    for sign in (-1, 1):
        assert (corners(4).x[:, :, 0] == sign * BOUND).any()
    np.testing.assert_array_equal(road.mirrored().preview(1, times).heading, -road.preview(1, times).heading)


@pytest.mark.parametrize(
    ("call", "path", "value"),
    [
        (lambda: contract_faults(LQR, checks=["miror"]), "checks", "miror"),
        (lambda: contract_faults(LQR, checks=[["mirror"]]), "checks", ["mirror"]),  # type: ignore[list-item]
        (lambda: contract_faults(LQR, checks=5), "checks", 5),  # type: ignore[arg-type]
        (lambda: contract_faults(LQR, settings=5), "settings", ...),  # type: ignore[arg-type]
        (lambda: contract_faults("lqr"), "controller", ...),  # type: ignore[arg-type]
        *((lambda name=name, value=value: ContractSettings(**{name: value}), name, value) for name, value in (
            ("scenarios", 3), ("scenarios", True), ("samples", 2.5), ("dt", 0.0), ("dt", "0.05"), ("dt", np.inf),
            ("mirror_tolerance", -1.0), ("limit_tolerance", -1.0), ("quiet_tolerance", None))),
    ],
)  # fmt: skip
def test_arguments_and_settings_are_checked(call: Callable[[], object], path: str, value: Any) -> None:
    with refused(path, value=value):
        call()


def test_a_check_by_its_name_and_interrupts_pass() -> None:
    assert [fault.check for fault in contract_faults(law("one-sided"), checks="mirror")] == ["mirror"]
    for check in ("finite", "extremes"):
        with pytest.raises(KeyboardInterrupt):
            contract_faults(law("interrupted"), checks=check)


def test_a_law_that_steers_only_sometimes() -> None:
    class Sometimes(LQR):  # type: ignore[misc]
        name = "sometimes"
        prepared: ClassVar[int] = 0

        def prepare(self, plant: Plant) -> Any:
            type(self).prepared += 1
            return super().prepare(plant) if type(self).prepared == 1 else RecordedPath()

    (fault,) = contract_faults(Sometimes, checks=["batch"])
    assert fault.sentence.startswith("controller 'sometimes'")


def test_the_error_names_every_fault() -> None:
    with pytest.raises(ContractError) as caught:
        check_controller_contract(law("bias")(K=-0.5), checks=["mirror", "quiet", "finite"])
    assert isinstance(caught.value, AssertionError)
    assert [fault.check for fault in caught.value.faults] == ["mirror", "quiet"]
    assert {fault.design for fault in caught.value.faults} == {"steered, K=-0.5"}
    assert len(str(caught.value).splitlines()) == 2
    assert str(Fault("a", "b", "c")) == "a: b: c"
    back = pickle.loads(pickle.dumps(caught.value))  # from a worker process
    assert (type(back), str(back), back.faults) == (ContractError, str(caught.value), caught.value.faults)


def test_the_class_runs_every_check() -> None:
    class TestBias(ControllerContract):
        controller = law("bias")
        settings = ContractSettings(scenarios=4, samples=4)

    named = {
        name: re.findall(r"Check `(\w+)`", getattr(TestBias, name).__doc__) for name in dir(TestBias) if "test_" in name
    }
    assert sorted(named.values()) == sorted([check] for check in CHECKS)
    for name, (check,) in named.items():
        faulty = pytest.raises(ContractError) if check in ("mirror", "quiet") else contextlib.nullcontext()
        if check != "picklable":
            with faulty as caught:
                getattr(TestBias(), name)()
            assert caught is None or [fault.check for fault in caught.value.faults] == [check]
    with refused("TestNone.controller"):
        type("TestNone", (ControllerContract,), {})().test_commands_are_finite()
