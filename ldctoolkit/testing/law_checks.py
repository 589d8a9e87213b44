"""The part of the contract that a law keeps once it is prepared."""

import contextlib
import copy
import dataclasses
import json
import math
import pickle
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller, EventStatus, LinearLaw, RecordedPath, check_class
from ldctoolkit.declared import Gain, GainValue, undeclared_fields
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.law_checks import check_law, check_step
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import simulate
from ldctoolkit.testing.subject import (
    Commands,
    Road,
    Subject,
    Walk,
    arrays_in,
    corners,
    difference,
    plant_at,
    shown,
    straight,
)

_LOAD = """
import cloudpickle, pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(cloudpickle.dumps(pickle.loads(pickle.load(sys.stdin.buffer))))
"""


def declared(subject: Subject) -> Iterator[str]:
    """The class follows `Controller`, and everything that it takes is declared and described."""
    kind = type(subject.design)
    check_class(kind)
    for name in undeclared_fields(kind):
        yield f"{kind.__name__}.{name} is a plain field; allowed: gain(...), option(...), or field(init=False)"
    for one in kind.gains():
        for attribute in ("unit", "description"):
            if not getattr(one, attribute):
                yield f"{kind.__name__}.{one.name}: its {attribute} is empty; allowed: some words"


def frozen(subject: Subject) -> Iterator[str]:
    """A design cannot be changed, equals its copy, and can be a key."""
    design = subject.design
    for one in design.gains():
        try:
            setattr(design, one.name, getattr(design, one.name))
        except dataclasses.FrozenInstanceError:
            continue
        yield f"{one.name} can be set on a finished design; allowed: a frozen dataclass"
    again = _rebuilt(design, {one.name: getattr(design, one.name) for one in design.gains()})
    if again != design or copy.deepcopy(design) != design:
        yield "a design made from the same values does not equal it; allowed: the comparison of a dataclass"
    elif hash(again) != hash(design):
        yield "two equal designs have different hashes; allowed: the hash of a frozen dataclass"


def picklable(subject: Subject) -> Iterator[str]:
    """A design reaches a worker process, also one that is started afresh, as studies send it: a class of a script or
    a notebook goes along.
    """
    import cloudpickle

    design = subject.design
    try:
        sent = cloudpickle.dumps(design)
    except Exception as error:  # whatever a class of its own raises
        yield f"cannot be pickled: {type(error).__name__}: {error}; allowed: fields and names that can be sent"
        return
    if pickle.loads(sent) != design:
        yield "comes back from pickle as another design"
    given = pickle.dumps([word or str(Path.cwd()) for word in sys.path]) + pickle.dumps(sent)
    done = subprocess.run([sys.executable, "-P", "-c", _LOAD], input=given, capture_output=True, check=False)
    if done.returncode:
        last = (done.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
        yield f"cannot be loaded in a fresh process: {last}; allowed: a class in a module that can be imported"
    elif pickle.loads(done.stdout) != design:
        yield "comes back from a fresh process as another design"


def bounds(subject: Subject) -> Iterator[str]:
    """Values outside the declaration are refused."""
    for one in subject.design.gains():
        for value in _outside(one):
            try:
                _rebuilt(subject.design, {one.name: value})
            except InputError:
                continue
            yield f"{one.name} = {value!r} is taken; allowed: an InputError, as __post_init__ of Controller raises it"


def toml(subject: Subject) -> Iterator[str]:
    """The gains, written as a study file and read again, make the same design."""
    design = subject.design
    values = {one.name: getattr(design, one.name) for one in design.gains()}
    text = "\n".join(["[design.gains]", *(f"{name} = {_word(value)}" for name, value in values.items())])
    try:
        read: dict[str, Any] = tomllib.loads(text)["design"]["gains"]
    except tomllib.TOMLDecodeError as error:
        yield f"its gains are no TOML: {error}"
        return
    again = _rebuilt(design, read)
    for name, value in values.items():
        back = getattr(again, name)
        if back != value or type(back) is not type(value):
            yield f"{name} = {value!r} comes back from TOML as {back!r}"
    if again != design:
        yield "comes back from TOML as another design"


def _rebuilt(design: Controller, values: dict[str, Any]) -> Controller:
    own = {one.name: getattr(design, one.name) for one in design.gains()}
    return type(design)(**(own | values))


def _outside(one: Gain) -> Iterator[Any]:
    if one.choices:
        yield "".join(one.choices) + "x"
    elif one.text or isinstance(one.default, bool):
        yield 0.5
    else:
        yield math.nan
        yield from (value for value in (one.lower - 1.0, one.upper + 1.0) if math.isfinite(value))


def _word(value: GainValue) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str) else repr(value)


def interface(subject: Subject) -> Iterator[str]:
    """`prepare` and `step` give what the interface promises, for any number of scenarios; the plant stays as it is."""
    road = subject.bends()
    for n in (road.n, 1, 0):
        part = road.take(np.arange(n))
        plant = plant_at(part.v, subject.settings.dt)
        plant.steady_state()
        before = copy.deepcopy(plant)
        law = check_law(subject.design.prepare(plant), n, subject.name)
        pairs = zip(arrays_in(plant), arrays_in(before), strict=True)
        steady = zip(arrays_in(plant.steady_state()), arrays_in(before.steady_state()), strict=True)
        if not all(_same(a, b) for a, b in (*pairs, *steady)):
            yield "prepare changes the arrays of the plant in place; allowed: new arrays"
        if isinstance(law, LinearLaw | RecordedPath) or n == 0:
            continue  # where nothing triggers, no step is taken
        walk = Walk(law, part, subject.settings.dt, subject.name)
        result = law.step(*walk.seen(), walk.state)
        check_step(result, n, subject.name)
        delta, _, status = result
        for name, value, wanted in (("delta", delta, "float64"), ("status", status, "int8")):
            kind = str(getattr(value, "dtype", type(value).__name__))
            if kind != wanted:
                yield f"step returned {name} of type {kind}; allowed: an array of {wanted}"


def repeatable(subject: Subject) -> Iterator[str]:
    """The same input gives the same output: of one law twice, of a law made anew, and in the closed loop."""
    road, design = subject.bends(), subject.design
    before = copy.deepcopy(design)
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


def mirror(subject: Subject) -> Iterator[str]:
    """Mirrored input gives the mirrored command."""
    road, tolerance = subject.bends(), subject.settings.mirror_tolerance
    one, other = subject.commands(road), subject.commands(road.mirrored())
    if one is None or other is None:
        return
    apart = np.abs(one.delta + other.delta)
    allowed = tolerance * np.maximum(np.abs(one.delta), np.abs(other.delta)).max(axis=0, initial=0.0)
    wrong = apart > allowed
    if wrong.any():
        k, i = (int(place[0]) for place in np.nonzero(wrong))
        yield (
            f"the command is {shown(one.delta[k, i])} rad and {shown(other.delta[k, i])} rad on the mirrored road, at "
            f"sample {k} of scenario {i}; allowed: the negative to {allowed[i]:.3g} rad"
        )


def quiet(subject: Subject) -> Iterator[str]:
    """Nothing to do, nothing done: the command is 0 on a straight road, centred."""
    sent = subject.commands(straight(subject.settings.scenarios, subject.settings.samples))
    if sent is None:
        return
    wrong = ~(np.abs(sent.delta) <= subject.settings.quiet_tolerance)
    if wrong.any():
        k, i = (int(place[0]) for place in np.nonzero(wrong))
        yield f"the command is {shown(sent.delta[k, i])} rad at sample {k} on a straight, centred road; allowed: 0"
    failed = sent.status != EventStatus.OK
    if failed.any():
        yield f"{int(failed.sum())} commands on a straight, centred road have the status SOLVER_FAILED; allowed: none"


def finite(subject: Subject) -> Iterator[str]:
    """Commands are finite for every state that the simulation drives."""
    for road in (subject.bends(), corners(subject.settings.samples)):
        yield from _not_finite(road, subject.commands(road))


def limits(subject: Subject) -> Iterator[str]:
    """The law keeps the gains `delta_max` [rad] and `rate_max` [rad/s], where it declares them.

    The rate has priority: from a command beyond `delta_max` a law with a limit of the rate comes back as fast as that
    allows.
    """
    values = {one.name: float(getattr(subject.design, one.name)) for one in subject.design.gains()
              if one.name in ("delta_max", "rate_max")}  # fmt: skip
    if not values:
        return
    step = values.get("rate_max", np.inf) * subject.settings.dt
    room = subject.settings.limit_tolerance
    for road in (subject.bends(), corners(subject.settings.samples)):
        sent = subject.commands(road)
        if sent is None:
            continue
        before = np.vstack([road.delta_0, sent.delta[:-1]])
        back = np.abs(before) - step if np.isfinite(step) else np.zeros_like(before)
        for excess, name in (
            (np.abs(sent.delta) - np.maximum(values.get("delta_max", np.inf), back), "delta_max"),
            (np.abs(sent.delta - before) - step, "rate_max"),
        ):
            if (excess > room).any():
                k, i = (int(place[0]) for place in np.nonzero(excess > room))
                yield (
                    f"the command goes from {shown(before[k, i])} to {shown(sent.delta[k, i])} rad in one sample of "
                    f"{subject.settings.dt:g} s, at sample {k} of scenario {i}; allowed by {name} = {values[name]:g}: "
                    f"{excess[k, i]:.3g} rad less"
                )
                break


def inputs(subject: Subject) -> Iterator[str]:
    """A step leaves what it is given as it is: its arguments, and the arrays of the state."""
    road = subject.bends()
    law = subject.law(road)
    if law is None:
        return
    walk = Walk(law, road, subject.settings.dt, subject.name)
    reported: set[str] = set()
    for k in range(road.samples):
        t, x, preview, delta_prev = walk.seen()
        given = {"t": t, "x": x, "preview.yaw_rate": preview.yaw_rate, "preview.heading": preview.heading}
        given |= {"delta_prev": delta_prev}
        held = [("state", array) for array in arrays_in(walk.state)]
        copies = [(name, array, array.copy()) for name, array in (*given.items(), *held)]
        result = law.step(t, x, preview, delta_prev, walk.state)
        for name, array, copied in copies:
            if name not in reported and not _same(array, copied):
                reported.add(name)
                yield f"step changes {name} in place, at sample {k}; allowed: new arrays"
        delta, walk.state, _ = check_step(result, road.n, subject.name)
        walk.previous, walk.k = np.where(np.isfinite(delta), delta, walk.previous), k + 1


def state(subject: Subject) -> Iterator[str]:
    """Two runs of one law share nothing: sample by sample in turns they say what they say one after the other."""
    road = subject.bends()
    mirrored = road.mirrored()
    other = dataclasses.replace(mirrored, x=mirrored.x[:, ::-1])
    apart = subject.commands(road), subject.commands(other)
    law = subject.law(road)
    if law is None:
        return
    walks = [Walk(law, each, subject.settings.dt, subject.name) for each in (road, other)]
    for _ in range(road.samples):
        for walk in walks:
            walk.go_on()
    for alone, walk in zip(apart, walks, strict=True):
        yield from difference(alone, walk.to_the_end(), "two runs in turns, against one after the other")


def batch(subject: Subject) -> Iterator[str]:
    """A scenario's commands do not depend on its place, on its neighbours, or on how many there are."""
    road = subject.bends()
    whole = subject.commands(road)
    if whole is None:
        return
    every = np.arange(road.n)
    for rows, what in (
        (every[::-1], "the scenarios in reverse order"),
        (every[::2], "every other scenario alone"),
        (every[: road.n // 2], "the first half of the scenarios alone"),
        (every[-1:], "the last scenario alone"),
    ):
        yield from difference(whole.take(rows), subject.commands(road.take(rows)), what)


def take(subject: Subject) -> Iterator[str]:
    """`take` changes no command of those that go on, also a second time."""
    road = subject.bends()
    law = subject.law(road)
    whole = subject.commands(road)
    if law is None or whole is None:
        return
    walk = Walk(law, road, subject.settings.dt, subject.name)
    rows = np.arange(road.n)
    walk.go_on()
    for kept in (slice(1, None, 2), slice(0, None, 2), slice(0, 1)):
        chosen = np.arange(rows.size)[kept]
        if not walk.take(chosen):
            return  # ended scenarios are then shown to it as zeros
        rows = rows[chosen]
        walk.sent.clear()
        first = walk.k
        walk.go_on()
        sent = Commands(np.array([walk.sent[0][0]]), np.array([walk.sent[0][1]]))
        part = Commands(whole.delta[first : first + 1, rows], whole.status[first : first + 1, rows])
        yield from difference(part, sent, f"after take, at sample {first} of the run")


def ended(subject: Subject) -> Iterator[str]:
    """Scenarios that have ended, shown as zeros, do no harm: neither to the law nor to those that go on."""
    road = subject.bends()
    over = np.arange(road.n) % 3 == 0
    law = subject.law(road)
    whole = subject.commands(road)
    if law is None or whole is None:
        return
    walk = Walk(law, road.ended(np.flatnonzero(over)), subject.settings.dt, subject.name)
    for _ in range(road.samples):
        walk.go_on()
        walk.previous[over] = 0.0
    going = np.flatnonzero(~over)
    yield from difference(whole.take(going), walk.to_the_end().take(going), "beside scenarios that have ended")


def extremes(subject: Subject) -> Iterator[str]:
    """Each gain at the ends of its range, the others as they are: commands stay finite.

    Ends that are infinite are left out. A design that its own class refuses with an `InputError` is no fault, since
    gains may exclude each other; nor is one that `prepare` refuses with an `InputError` that names the gain, since what
    is allowed may depend on the vehicle; nor is a word of an option that needs a package which is not installed.
    """
    road = subject.bends().take(np.arange(4))
    for one in subject.design.gains():
        for design in _variants(subject.design, one):
            label = f"{one.name} = {getattr(design, one.name)!r}"
            try:
                sent = Subject(design, subject.settings).commands(road)
            except (KeyboardInterrupt, GeneratorExit):
                raise
            except BaseException as error:  # a law may also call sys.exit
                named = isinstance(error, InputError) and f".{one.name}:" in str(error)
                absent = bool(one.choices) and isinstance(error, LdcError | ImportError)
                if not (named or absent):
                    yield f"{label}: {type(error).__name__}: {error}; allowed: finite commands"
                continue
            yield from (f"{label}: {fault}" for fault in _not_finite(road, sent))


def _variants(design: Controller, one: Gain) -> Iterator[Controller]:
    """The design with another value of one gain: the ends of its range, or the other words."""
    own = getattr(design, one.name)
    values: list[Any] = [one.lower, one.upper]
    if one.choices:
        values = list(one.choices)
    elif one.text:
        values = []
    elif isinstance(one.default, bool):
        values = [not own]
    for value in values:
        if value != own and (isinstance(value, str) or np.isfinite(value)):
            with contextlib.suppress(InputError):
                yield dataclasses.replace(design, **{one.name: value})  # type: ignore[type-var]


def _not_finite(road: Road, sent: Commands | None) -> Iterator[str]:
    if sent is None:
        return
    wrong = ~np.isfinite(sent.delta)
    if wrong.any():
        k, i = (int(place[0]) for place in np.nonzero(wrong))
        seen = ", ".join(f"{value:.3g}" for value in road.x[k, i])
        yield (
            f"the command is {shown(sent.delta[k, i])} at {road.v[i]:.3g} m/s, x = ({seen}), sample {k} of scenario "
            f"{i} ({int(wrong.sum())} of {wrong.size} are not finite); allowed: finite commands"
        )


def _same(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> bool:
    return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
