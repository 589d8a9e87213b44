"""The subject of a check: a design, the roads that it is driven on, and its commands there."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, Law, LinearLaw, LinearSteps, Preview, RecordedPath, SteeringLaw
from ldctoolkit.declared import check_declared, declared
from ldctoolkit.errors import LdcError
from ldctoolkit.law_checks import check_law, check_step, check_taken
from ldctoolkit.simulation import BOUND
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE

_FARTHEST = (BOUND, 15.0, 1.5, 3.0)
"""|e_y| [m] and |e_psi| [rad] at which the simulation ends a scenario, and rates [m/s, rad/s] beyond any real ones."""


@dataclasses.dataclass(frozen=True)
class Road:
    """States and lane of n scenarios over k samples, as a law is shown them."""

    v: FloatArray  # (n,) [m/s]
    x: FloatArray  # (k, n, 4) State
    yaw_rate: FloatArray  # (k, n) [rad/s] Of the lane, now
    yaw_change: FloatArray  # (k, n) [rad/s^2] Its change with lookahead time
    delta_0: FloatArray  # (n,) [rad] Command before the first
    start: FloatArray  # (n,) [s] Time at the first sample

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return int(self.v.size)

    @property
    def samples(self) -> int:
        """Number of samples, k."""
        return int(self.x.shape[0])

    def preview(self, k: int, times: FloatArray) -> Preview:
        """The lane ahead at sample k; new arrays."""
        now, change = self.yaw_rate[k][:, None], self.yaw_change[k][:, None]
        return Preview(now + change * times, now * times + 0.5 * change * times**2)

    def take(self, rows: IntArray) -> Road:
        """The road of the scenarios `rows`."""
        arrays = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return Road(**{name: a[rows] if a.ndim == 1 else a[:, rows] for name, a in arrays.items()})

    def mirrored(self) -> Road:
        """The mirror image of the road: left and right exchanged."""
        return dataclasses.replace(
            self, x=-self.x, yaw_rate=-self.yaw_rate, yaw_change=-self.yaw_change, delta_0=-self.delta_0
        )

    def ended(self, rows: IntArray) -> Road:
        """The road with scenarios `rows` ended: from the second sample on they are zeros."""
        values = {name: getattr(self, name).copy() for name in ("x", "yaw_rate", "yaw_change")}
        for value in values.values():
            value[1:, rows] = 0.0
        return dataclasses.replace(self, **values)


def bends(n: int, samples: int, seed: int = 1) -> Road:
    """Ordinary departures in bends, on both sides and at ordinary speeds."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0.0, 2.0 * np.pi, (n, 4))
    turn = np.linspace(0.0, 1.0, samples)[:, None, None]
    largest = np.array([1.0, 0.6, 0.03, 0.1]) * rng.uniform(0.3, 1.0, (n, 4))
    return Road(
        v=rng.uniform(8.0, 38.0, n),
        x=largest * np.sin(phase + turn),
        yaw_rate=rng.uniform(-0.05, 0.05, n) * np.ones((samples, 1)),
        yaw_change=rng.uniform(-0.01, 0.01, n) * np.ones((samples, 1)),
        delta_0=rng.uniform(-0.03, 0.03, n),
        start=rng.uniform(0.0, 5.0, n),
    )


def straight(n: int, samples: int) -> Road:
    """A straight road, driven in the lane's centre with straight wheels."""
    zeros, v = np.zeros((samples, n)), np.linspace(*SPEED_RANGE, n)
    return Road(v, np.zeros((samples, n, 4)), zeros, zeros, np.zeros(n), np.zeros(n))


def corners(samples: int) -> Road:
    """Every corner of what a state may be before the simulation ends the scenario, at slow, common and fast speeds."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
    v = np.tile([SPEED_RANGE[0], 5.0, 25.0, SPEED_RANGE[1]], 4)
    n = v.size
    turns = np.where(np.arange(n) % 3 == 0, -0.5, 0.5) * np.ones((samples, 1))
    x = np.array(_FARTHEST) * signs * np.ones((samples, 1, 1))
    delta_0 = np.where(np.arange(n) % 2 == 0, 0.4, -0.4)
    return Road(v, x, turns, 0.1 * turns, delta_0, np.linspace(0.0, 30.0, n))


@dataclasses.dataclass(frozen=True)
class Commands:
    """Commands of a law over k samples of n scenarios."""

    delta: FloatArray  # (k, n) [rad]
    status: npt.NDArray[np.int8]  # (k, n)

    def take(self, rows: IntArray) -> Commands:
        """The commands of the scenarios `rows`."""
        return Commands(self.delta[:, rows], self.status[:, rows])


def plant_at(v: FloatArray, dt: float) -> Plant:
    """A new plant of the default vehicle."""
    return Plant.build(BicycleModel(), v.copy(), dt)


class Walk:
    """One run of a law on a road, a sample at a time."""

    def __init__(self, law: SteeringLaw, road: Road, dt: float, name: str) -> None:
        self.law, self.road, self.dt, self.name = law, road, dt, name
        self.times = np.array(law.preview_times, dtype=np.float64)
        self.state: Any = law.init(road.n)
        self.previous = road.delta_0.copy()
        self.k = 0
        self.sent: list[tuple[FloatArray, npt.NDArray[np.int8]]] = []

    def seen(self) -> tuple[FloatArray, FloatArray, Preview, FloatArray]:
        """Arguments of the next step, in new arrays."""
        road, k = self.road, self.k
        return road.start + k * self.dt, road.x[k].copy(), road.preview(k, self.times), self.previous.copy()

    def go_on(self, seen: tuple[FloatArray, FloatArray, Preview, FloatArray] | None = None) -> None:
        """Take the step of one sample."""
        result = self.law.step(*(self.seen() if seen is None else seen), self.state)
        delta, self.state, status = check_step(result, self.road.n, self.name)
        self.sent.append((delta.copy(), status))
        self.previous = np.where(np.isfinite(delta), delta, self.previous)  # as the closed loop does
        self.k += 1

    def take(self, rows: IntArray) -> bool:
        """Continue with the scenarios `rows` only; False where the law does not support it."""
        continued = check_taken(self.law.take(rows, self.state), rows.size, self.name, self.times)
        if continued is None:
            return False
        self.law, self.state = continued
        self.road, self.previous = self.road.take(rows), self.previous[rows]
        return True

    def to_the_end(self) -> Commands:
        """Take all remaining samples, and give the commands of the whole run."""
        while self.k < self.road.samples:
            self.go_on()
        return self.commands()

    def commands(self) -> Commands:
        """The commands of all samples so far."""
        return Commands(np.array([delta for delta, _ in self.sent]), np.array([status for _, status in self.sent]))


@dataclasses.dataclass(frozen=True)
class ContractSettings:
    """Size and tolerances of the checks.

    Raises `InputError` for a value outside what is allowed.

    Examples
    --------
    >>> ContractSettings(mirror_tolerance=0.0).scenarios
    12
    """

    scenarios: int = declared(12, lower=4)  # Scenarios in one batch, 4 or more
    samples: int = declared(6, lower=4)  # Time steps of one run, 4 or more
    dt: float = declared(0.05, unit="s", above=0.0)  # [s] Sample time
    # How far a mirrored command may be from the mirror image, relative to the largest command of the scenario. The
    # default leaves room for sums in another order and for iterative solvers; 0 asks for equal bits.
    mirror_tolerance: float = declared(1e-9, lower=0.0)
    # [rad] How far a command may exceed a declared limit: the accuracy of an iterative solver
    limit_tolerance: float = declared(1e-6, unit="rad", lower=0.0)
    # [rad] How far a command on a straight road may be from 0
    quiet_tolerance: float = declared(0.0, unit="rad", lower=0.0)

    def __post_init__(self) -> None:
        check_declared(self)


@dataclasses.dataclass(frozen=True)
class Subject:
    """A design under the contract."""

    design: Controller
    settings: ContractSettings

    @property
    def name(self) -> str:
        """Registry key of the law."""
        return self.design.name

    def bends(self) -> Road:
        """The road that most checks use."""
        return bends(self.settings.scenarios, self.settings.samples)

    @functools.cached_property
    def steers(self) -> bool:
        """Whether its law steers, or leaves the departure alone."""
        return not isinstance(self._prepared(self.bends()), RecordedPath)

    def _prepared(self, road: Road) -> Law:
        return check_law(self.design.prepare(plant_at(road.v, self.settings.dt)), road.n, self.name)

    def law(self, road: Road) -> SteeringLaw:
        """The law, prepared anew."""
        law = self._prepared(road)
        if isinstance(law, RecordedPath):
            raise LdcError(f"controller {self.name!r}", "a law that steers once and leaves the departure alone later")
        return LinearSteps.of(law, plant_at(road.v, self.settings.dt)) if isinstance(law, LinearLaw) else law

    def walk(self, road: Road, law: SteeringLaw | None = None) -> Walk:
        """A run of the given law, or of the law prepared anew."""
        return Walk(self.law(road) if law is None else law, road, self.settings.dt, self.name)

    def commands(self, road: Road, law: SteeringLaw | None = None) -> Commands:
        """Commands on a road of the given law, or of the law prepared anew."""
        return self.walk(road, law).to_the_end()


def difference(a: Commands, b: Commands, comparison: str) -> Iterator[str]:
    """A sentence on the first command or status that is not the same to the bit; nothing where all are."""
    for field, unit in (("delta", " rad"), ("status", "")):
        x, y = getattr(a, field), getattr(b, field)
        wrong = (x != y) & ~(np.isnan(x) & np.isnan(y))
        if wrong.any():
            k, i = first_of(wrong)
            yield (
                f"{comparison}: {field} is {shown(x[k, i])}{unit} and {shown(y[k, i])}{unit} at sample {k} of scenario "
                f"{i} ({int(wrong.sum())} of {wrong.size} differ); allowed: the same to the bit"
            )
            return


def first_of(wrong: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """Sample and scenario of the first entry that is true."""
    k, i = np.argwhere(wrong)[0]
    return int(k), int(i)


def shown(value: Any) -> str:
    """A number with all the digits that tell it from its neighbours."""
    return repr(value.item() if hasattr(value, "item") else value)


def arrays_in(value: Any, depth: int = 4) -> Iterator[npt.NDArray[Any]]:
    """The arrays of a state: itself, or inside tuples, lists, dictionaries and dataclasses."""
    if isinstance(value, np.ndarray):
        yield value
    elif depth > 0:
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            parts = [getattr(value, field.name, None) for field in dataclasses.fields(value)]
        for part in parts:
            yield from arrays_in(part, depth - 1)
