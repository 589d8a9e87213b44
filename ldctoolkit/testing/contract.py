"""The contract of a controller: its checks, one call that raises, and a class for pytest."""

import contextlib
import copy
import dataclasses
import json
import math
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller, EventStatus, LinearLaw, RecordedPath, check_class
from ldctoolkit.declared import Gain, GainValue, checked_choice, undeclared_fields
from ldctoolkit.errors import InputError, LdcError, expect
from ldctoolkit.law_checks import check_controller, check_law, check_step, raised
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import simulate
from ldctoolkit.testing.subject import (
    Commands,
    ContractSettings,
    Road,
    Subject,
    arrays_in,
    corners,
    difference,
    first_of,
    plant_at,
    shown,
    straight,
)

Check = Callable[[Subject], Iterator[str]]  # Yields one sentence for each fault


class ControllerContract:
    """The contract as tests: subclass it under pytest, in a class whose name starts with ``Test``.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> class TestLQR(ControllerContract):
    ...     controller = LQR
    ...     designs = (LQR(r_delta=20.0),)
    >>> TestLQR().test_mirrored_input_gives_the_mirrored_command()
    """

    controller: ClassVar[type[Controller] | Controller]  # The law under test
    designs: ClassVar[Sequence[Controller]] = ()  # More designs of it than the one with all defaults
    settings: ClassVar[ContractSettings] = ContractSettings()  # Size and tolerances


CHECKS: Final[dict[str, Check]] = {}
"""Name -> check; the first line of a check's documentation states what it requires."""

_STEERING: Final[set[str]] = set()  # Checks that do not apply to a law that leaves the departure alone


def _check(test_name: str, *, steering: bool = False) -> Callable[[Check], Check]:
    """Add a check to the contract and a test to `ControllerContract`; with `steering`, for laws that steer only."""

    def added(check: Check) -> Check:
        name = check.__name__

        def test(self: ControllerContract) -> None:
            controller = getattr(self, "controller", None)
            if controller is None:
                raise InputError(f"{type(self).__name__}.controller", "missing", allowed="controller = MyLaw")
            check_controller_contract(controller, self.designs, checks=name, settings=self.settings)

        test.__doc__ = f"Check `{name}`."
        setattr(ControllerContract, f"test_{test_name}", test)
        CHECKS[name] = check
        if steering:
            _STEERING.add(name)
        return check

    return added


_LOAD = """
import cloudpickle, pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(cloudpickle.dumps(pickle.loads(pickle.load(sys.stdin.buffer))))
"""


@_check("everything_it_takes_is_declared")
def declared(subject: Subject) -> Iterator[str]:
    """The class follows `Controller`, and everything that it takes is declared and described."""
    kind = type(subject.design)
    check_class(kind)
    for name in undeclared_fields(kind):
        yield f"{kind.__name__}.{name} is a plain field; allowed: gain(...), option(...), or field(init=False)"
    for gain in kind.gains():
        for attribute in ("unit", "description"):
            if not getattr(gain, attribute):
                yield f"{kind.__name__}.{gain.name}: its {attribute} is empty; allowed: a text"


@_check("designs_are_frozen")
def frozen(subject: Subject) -> Iterator[str]:
    """A design cannot be changed, equals its copy, and can be a key."""
    design = subject.design
    for gain in design.gains():
        try:
            setattr(design, gain.name, getattr(design, gain.name))
        except dataclasses.FrozenInstanceError:
            continue
        yield f"{gain.name} can be set on a finished design; allowed: a frozen dataclass"
    again = dataclasses.replace(design)  # type: ignore[type-var]
    if again != design or copy.deepcopy(design) != design:
        yield "a design made from the same values does not equal it; allowed: the comparison of a dataclass"
    elif hash(again) != hash(design):
        yield "two equal designs have different hashes; allowed: the hash of a frozen dataclass"


@_check("designs_reach_worker_processes")
def picklable(subject: Subject) -> Iterator[str]:
    """A design reaches a worker process, also a new one, together with the class of a script or a notebook."""
    import cloudpickle

    design = subject.design
    try:
        sent = cloudpickle.dumps(design)
    except Exception as error:  # a class may raise anything
        yield f"cannot be pickled: {type(error).__name__}: {error}; allowed: fields and names that can be sent"
        return
    if pickle.loads(sent) != design:
        yield "comes back from pickle as another design"
    message = pickle.dumps([word or str(Path.cwd()) for word in sys.path]) + pickle.dumps(sent)
    done = subprocess.run([sys.executable, "-P", "-c", _LOAD], input=message, capture_output=True, check=False)
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        yield f"cannot be loaded in a fresh process: {last}; allowed: a class in a module that can be imported"
    elif pickle.loads(done.stdout) != design:
        yield "comes back from a fresh process as another design"


@_check("bounds_are_enforced")
def bounds(subject: Subject) -> Iterator[str]:
    """Values outside the declaration are refused."""
    for gain in subject.design.gains():
        for value in _outside(gain):
            try:
                dataclasses.replace(subject.design, **{gain.name: value})  # type: ignore[type-var]
            except InputError:
                continue
            yield f"{gain.name} = {value!r} is taken; allowed: an InputError, as __post_init__ of Controller raises it"


@_check("gains_round_trip_through_toml")
def toml(subject: Subject) -> Iterator[str]:
    """The gains, written as a study file and read again, make the same design."""
    design = subject.design
    values = {gain.name: getattr(design, gain.name) for gain in design.gains()}
    text = "\n".join(["[design.gains]", *(f"{name} = {_word(value)}" for name, value in values.items())])
    try:
        read: dict[str, Any] = tomllib.loads(text)["design"]["gains"]
    except tomllib.TOMLDecodeError as error:
        yield f"its gains are no TOML: {error}"
        return
    again = dataclasses.replace(design, **read)  # type: ignore[type-var]
    for name, value in values.items():
        back = getattr(again, name)
        if back != value or type(back) is not type(value):
            yield f"{name} = {value!r} comes back from TOML as {back!r}"
    if again != design:
        yield "comes back from TOML as another design"


def _outside(gain: Gain) -> Iterator[Any]:
    """Values that a gain must refuse."""
    if gain.choices:
        yield "".join(gain.choices) + "x"
    elif gain.text or isinstance(gain.default, bool):
        yield 0.5
    else:
        yield math.nan
        yield from (value for value in (gain.lower - 1.0, gain.upper + 1.0) if math.isfinite(value))


def _word(value: GainValue) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


@_check("shapes_types_and_the_plant")
def interface(subject: Subject) -> Iterator[str]:
    """`prepare` and `step` give what the interface promises, for any number of scenarios; the plant stays as it is."""
    road = subject.bends()
    for n in (road.n, 1, 0):
        part = road.take(np.arange(n))
        plant = plant_at(part.v, subject.settings.dt)
        plant.steady_state()
        before = copy.deepcopy(plant)
        law = check_law(subject.design.prepare(plant), n, subject.name)
        arrays = [(*arrays_in(state), *arrays_in(state.steady_state())) for state in (plant, before)]
        if not all(map(_same, *arrays)):
            yield "prepare changes the arrays of the plant in place; allowed: new arrays"
        if isinstance(law, LinearLaw | RecordedPath) or n == 0:
            continue  # where nothing triggers, no step is taken
        walk = subject.walk(part, law)
        result = law.step(*walk.seen(), walk.state)
        check_step(result, n, subject.name)
        delta, _, status = result
        for name, value, allowed in (("delta", delta, "float64"), ("status", status, "int8")):
            kind = str(getattr(value, "dtype", type(value).__name__))
            if kind != allowed:
                yield f"step returned {name} of type {kind}; allowed: an array of {allowed}"


@_check("same_input_same_output")
def repeatable(subject: Subject) -> Iterator[str]:
    """The same input gives the same output: of one law twice, of a law prepared anew, and in the closed loop."""
    road, design = subject.bends(), subject.design
    before = copy.deepcopy(design)
    if subject.steers:
        law = subject.law(road)
        first = subject.commands(road, law)
        yield from difference(first, subject.commands(road, law), "a second run of the same law")
        yield from difference(first, subject.commands(road), "a law prepared anew")
    scenarios = Scenarios.from_arrays(T=[1.0, 2.0], d_y=[0.4, 0.6], v_mean=[28.0, 14.0], c_0=1e-3, side=[1, -1])
    S, again = (simulate(design, scenarios, y_s=0.1, dt=subject.settings.dt, settle=0.5).S for _ in range(2))
    if not np.array_equal(S, again, equal_nan=True):
        i = int(np.flatnonzero(again != S)[0])
        yield f"S is {shown(S[i])} and {shown(again[i])} m s in two simulations of the same departure"
    if not np.isfinite(S).all():
        yield f"S of a simulated departure is {shown(S[~np.isfinite(S)][0])}; allowed: a finite number"
    if design != before or vars(design) != vars(before):
        yield "the design changes while it is used; allowed: laws that leave it as it is"


@_check("mirrored_input_gives_the_mirrored_command", steering=True)
def mirror(subject: Subject) -> Iterator[str]:
    """Mirrored input gives the mirrored command, unless the class says `symmetric = False`."""
    if not subject.design.symmetric:
        return
    road, tolerance = subject.bends(), subject.settings.mirror_tolerance
    delta, mirrored = subject.commands(road).delta, subject.commands(road.mirrored()).delta
    allowed = tolerance * np.maximum(np.abs(delta), np.abs(mirrored)).max(axis=0, initial=0.0)
    wrong = np.abs(delta + mirrored) > allowed
    if wrong.any():
        k, i = first_of(wrong)
        yield (
            f"the command is {shown(delta[k, i])} rad and {shown(mirrored[k, i])} rad on the mirrored road, at "
            f"sample {k} of scenario {i}; allowed: the negative to {allowed[i]:.3g} rad; a law that treats the line "
            "that is crossed in another way than the opposite one says so: symmetric = False in its class"
        )


@_check("quiet_on_a_straight_centred_road", steering=True)
def quiet(subject: Subject) -> Iterator[str]:
    """Nothing to do, nothing done: the command is 0 on a straight road, centred."""
    sent = subject.commands(straight(subject.settings.scenarios, subject.settings.samples))
    wrong = ~(np.abs(sent.delta) <= subject.settings.quiet_tolerance)
    if wrong.any():
        k, i = first_of(wrong)
        yield f"the command is {shown(sent.delta[k, i])} rad at sample {k} on a straight, centred road; allowed: 0"
    failed = sent.status != EventStatus.OK
    if failed.any():
        yield f"{int(failed.sum())} commands on a straight, centred road have the status SOLVER_FAILED; allowed: none"


@_check("commands_are_finite", steering=True)
def finite(subject: Subject) -> Iterator[str]:
    """Commands are finite for every state that the simulation drives."""
    for road in (subject.bends(), corners(subject.settings.samples)):
        yield from _not_finite(road, subject.commands(road))


@_check("declared_limits_are_kept", steering=True)
def limits(subject: Subject) -> Iterator[str]:
    """The law keeps the gains `delta_max` [rad] and `rate_max` [rad/s], where it declares them.

    The rate has priority: from a command beyond `delta_max` a law with a limit of the rate comes back as fast as that
    allows.
    """
    values = {gain.name: float(getattr(subject.design, gain.name)) for gain in subject.design.gains()
              if gain.name in ("delta_max", "rate_max")}  # fmt: skip
    if not values:
        return
    step = values.get("rate_max", np.inf) * subject.settings.dt
    room = subject.settings.limit_tolerance
    for road in (subject.bends(), corners(subject.settings.samples)):
        sent = subject.commands(road)
        before = np.vstack([road.delta_0, sent.delta[:-1]])
        back = np.abs(before) - step if np.isfinite(step) else np.zeros_like(before)
        for excess, name in (
            (np.abs(sent.delta) - np.maximum(values.get("delta_max", np.inf), back), "delta_max"),
            (np.abs(sent.delta - before) - step, "rate_max"),
        ):
            if (excess > room).any():
                k, i = first_of(excess > room)
                yield (
                    f"the command goes from {shown(before[k, i])} to {shown(sent.delta[k, i])} rad in one sample of "
                    f"{subject.settings.dt:g} s, at sample {k} of scenario {i}; allowed by {name} = {values[name]:g}: "
                    f"{excess[k, i]:.3g} rad less"
                )
                break


@_check("inputs_are_left_as_they_are", steering=True)
def inputs(subject: Subject) -> Iterator[str]:
    """A step leaves what it is given as it is: its arguments, and the arrays of the state."""
    road = subject.bends()
    walk = subject.walk(road)
    reported: set[str] = set()
    for k in range(road.samples):
        t, x, preview, delta_prev = arguments = walk.seen()
        arrays = [("t", t), ("x", x), ("preview.yaw_rate", preview.yaw_rate), ("preview.heading", preview.heading),
                  ("delta_prev", delta_prev), *(("state", array) for array in arrays_in(walk.state))]  # fmt: skip
        copies = [array.copy() for _, array in arrays]
        walk.go_on(arguments)
        for (name, array), copied in zip(arrays, copies, strict=True):
            if name not in reported and not _same(array, copied):
                reported.add(name)
                yield f"step changes {name} in place, at sample {k}; allowed: new arrays"


@_check("runs_share_no_state", steering=True)
def state(subject: Subject) -> Iterator[str]:
    """Two runs of one law share nothing: in turns, sample by sample, their commands are those of separate runs."""
    road = subject.bends()
    mirrored = road.mirrored()
    reversed_road = dataclasses.replace(mirrored, x=mirrored.x[:, ::-1])
    expected = subject.commands(road), subject.commands(reversed_road)
    law = subject.law(road)
    walks = [subject.walk(path, law) for path in (road, reversed_road)]
    for _ in range(road.samples):
        for walk in walks:
            walk.go_on()
    for alone, walk in zip(expected, walks, strict=True):
        yield from difference(alone, walk.to_the_end(), "two runs in turns, against one after the other")


@_check("scenarios_do_not_depend_on_each_other", steering=True)
def batch(subject: Subject) -> Iterator[str]:
    """A scenario's commands do not depend on its position, on its neighbours, or on how many there are."""
    road = subject.bends()
    whole = subject.commands(road)
    all_rows = np.arange(road.n)
    for rows, comparison in (
        (all_rows[::-1], "the scenarios in reverse order"),
        (all_rows[::2], "every other scenario alone"),
        (all_rows[: road.n // 2], "the first half of the scenarios alone"),
        (all_rows[-1:], "the last scenario alone"),
    ):
        yield from difference(whole.take(rows), subject.commands(road.take(rows)), comparison)


@_check("take_changes_no_command", steering=True)
def take(subject: Subject) -> Iterator[str]:
    """`take` changes no command of those that go on, also a second time."""
    road = subject.bends()
    whole, walk, rows = subject.commands(road), subject.walk(road), np.arange(road.n)
    walk.go_on()
    for part in (slice(1, None, 2), slice(0, None, 2), slice(0, 1)):
        if not walk.take(np.arange(rows.size)[part]):
            return  # ended scenarios are then shown to it as zeros
        rows = rows[part]
        walk.sent.clear()
        first = walk.k
        walk.go_on()
        alone = Commands(whole.delta[first : first + 1, rows], whole.status[first : first + 1, rows])
        yield from difference(alone, walk.commands(), f"after take, at sample {first} of the run")


@_check("ended_scenarios_do_no_harm", steering=True)
def ended(subject: Subject) -> Iterator[str]:
    """Scenarios that have ended, shown as zeros, do no harm: neither to the law nor to those that go on."""
    road = subject.bends()
    over = np.arange(road.n) % 3 == 0
    whole, walk = subject.commands(road), subject.walk(road.ended(np.flatnonzero(over)))
    for _ in range(road.samples):
        walk.go_on()
        walk.previous[over] = 0.0
    going = np.flatnonzero(~over)
    yield from difference(whole.take(going), walk.to_the_end().take(going), "beside scenarios that have ended")


@_check("extreme_gains_give_finite_commands")
def extremes(subject: Subject) -> Iterator[str]:
    """Each gain at the ends of its range, the others as they are: commands stay finite.

    Ends that are infinite are left out. A design that its own class refuses with an `InputError` is no fault, since
    gains may exclude each other; nor one that `prepare` refuses with an `InputError` that names the gain, since what
    is allowed may depend on the vehicle; nor is a word of an option that needs a package which is not installed.
    """
    road = subject.bends().take(np.arange(4))
    for gain in subject.design.gains():
        for design in _variants(subject.design, gain):
            label = f"{gain.name} = {getattr(design, gain.name)!r}"
            try:
                variant = Subject(design, subject.settings)
                faults = list(_not_finite(road, variant.commands(road))) if variant.steers else []
            except (KeyboardInterrupt, GeneratorExit):
                raise
            except BaseException as error:  # a law may also call sys.exit
                named = isinstance(error, InputError) and error.path.endswith(f".{gain.name}")
                absent = bool(gain.choices) and isinstance(error, LdcError | ImportError)
                if not (named or absent):
                    yield f"{label}: {type(error).__name__}: {error}; allowed: finite commands"
                continue
            yield from (f"{label}: {fault}" for fault in faults)


def _variants(design: Controller, gain: Gain) -> Iterator[Controller]:
    """The design with another value of a gain: the ends of its range, or the other words."""
    present = getattr(design, gain.name)
    values: tuple[Any, ...] = () if gain.text else (gain.lower, gain.upper)
    if gain.choices:
        values = gain.choices
    elif isinstance(gain.default, bool):
        values = (not present,)
    for value in values:
        if value != present and (isinstance(value, str) or np.isfinite(value)):
            with contextlib.suppress(InputError):
                yield dataclasses.replace(design, **{gain.name: value})  # type: ignore[type-var]


def _not_finite(road: Road, sent: Commands) -> Iterator[str]:
    wrong = ~np.isfinite(sent.delta)
    if wrong.any():
        k, i = first_of(wrong)
        seen = ", ".join(f"{value:.3g}" for value in road.x[k, i])
        yield (
            f"the command is {shown(sent.delta[k, i])} at {road.v[i]:.3g} m/s, x = ({seen}), sample {k} of scenario "
            f"{i} ({int(wrong.sum())} of {wrong.size} are not finite); allowed: finite commands"
        )


def _same(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> bool:
    return np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")


# ------------------------------------------------------------------------------------------------ the contract


@dataclasses.dataclass(frozen=True)
class Fault:
    """One breach of the contract by a design."""

    design: str  # Name of the law, and the gains that differ from their defaults
    check: str  # Key of `CHECKS`
    sentence: str  # What is wrong, with the numbers, and what is allowed

    def __str__(self) -> str:
        return f"{self.design}: {self.check}: {self.sentence}"


class ContractError(LdcError, AssertionError):
    """A controller breaks its contract; one line of the message for each fault.

    Attributes
    ----------
    faults : tuple of Fault
    """

    def __init__(self, faults: Iterable[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(map(str, self.faults)))


def contract_faults(
    controller: Controller | type[Controller],
    designs: Sequence[Controller] = (),
    *,
    checks: str | Iterable[str] | None = None,
    settings: ContractSettings | None = None,
) -> tuple[Fault, ...]:
    """Every breach of the contract by a controller.

    Raises `InputError` if what is given is not a known control law, or a check is not known.

    Parameters
    ----------
    controller : Controller or type
        A design, or a class, of which the design with all defaults is taken.
    designs : sequence of Controller
        More designs of the same law.
    checks : str or iterable of str, optional
        Keys of `CHECKS`; all by default.
    settings : ContractSettings, optional
        Size and tolerances.

    Returns
    -------
    tuple of Fault
        Empty for a law that keeps the contract. Whatever the law raises is a fault too.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> contract_faults(LQR(r_delta=50.0), checks=["mirror", "quiet", "finite"])
    ()
    """
    several = isinstance(checks, Iterable) and not isinstance(checks, str)
    requested: Any = CHECKS if checks is None else checks if several else (checks,)
    names = tuple(checked_choice("checks", name, CHECKS) for name in requested)
    expect("settings", settings, ContractSettings | None)
    first = controller() if isinstance(controller, type) and issubclass(controller, Controller) else controller
    all_designs = dict.fromkeys(check_controller(design) for design in (first, *designs))
    return tuple(
        fault for design in all_designs for fault in _faults(Subject(design, settings or ContractSettings()), names)
    )


def check_controller_contract(
    controller: Controller | type[Controller],
    designs: Sequence[Controller] = (),
    *,
    checks: str | Iterable[str] | None = None,
    settings: ContractSettings | None = None,
) -> None:
    """Raise a `ContractError` with every fault of a controller; parameters as `contract_faults`.

    Examples
    --------
    >>> from ldctoolkit import LQR
    >>> check_controller_contract(LQR, checks=["batch", "state"])
    """
    faults = contract_faults(controller, designs, checks=checks, settings=settings)
    if faults:
        raise ContractError(faults)


def _faults(subject: Subject, checks: Iterable[str]) -> Iterator[Fault]:
    design = subject.design
    changed = [f"{gain.name}={getattr(design, gain.name)}" for gain in design.gains()
               if getattr(design, gain.name) != gain.default]  # fmt: skip
    label = ", ".join([design.name, *changed])
    for name in checks:
        try:
            if name not in _STEERING or subject.steers:
                for sentence in CHECKS[name](subject):
                    yield Fault(label, name, sentence)
        except (KeyboardInterrupt, GeneratorExit):
            raise
        except BaseException as error:  # a controller may be third-party code, and may call sys.exit
            yield Fault(label, name, raised(error))
