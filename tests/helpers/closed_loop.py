"""Closed loops and laws for tests."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import numpy as np
import pytest

from helpers.bits import assert_same_bits
from ldctoolkit import (
    BicycleModel,
    Controller,
    LinearLaw,
    LinearSteps,
    Outcome,
    Plant,
    Preview,
    RecordedPath,
    Scenarios,
    Setup,
    SteeringLaw,
    controller_class,
    controller_names,
    register,
    registry,
)
from ldctoolkit.controllers import LQR
from ldctoolkit.metrics import DRIVER_METRICS, METRIC_UNITS
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import Run, Takeover

frozen = dataclasses.dataclass(frozen=True)

ZOO = [name for name in controller_names() if controller_class(name).__module__.startswith("ldctoolkit.controllers.")]
METRICS = tuple(name for name in METRIC_UNITS if name not in DRIVER_METRICS)  # beside S, without a driver


class Idle(Controller):
    """Leaves the departure alone; a dataclass is made of it where a test needs one."""

    name: ClassVar[str] = "idle"
    title: ClassVar[str] = "Idle"

    def prepare(self, plant: Plant) -> RecordedPath:
        return RecordedPath()


def takeover(
    scenarios: Scenarios, options: PlantOptions | None = None, *, y_s: float = 0.1, dt: float = 0.05,
    settle: float = 3.0, seed: int = 0,
) -> Takeover:  # fmt: skip
    """What `drive` takes, for the default vehicle."""
    setup = Setup(options=options or PlantOptions(), seed=seed, dt=dt, settle=settle)
    return Takeover.build(scenarios, setup, y_s=y_s)


def make_scenarios(n: int, seed: int = 0) -> Scenarios:
    rng = np.random.default_rng(seed)
    v = np.where(rng.random(n) < 0.5, rng.normal(14, 2, n), rng.normal(28, 3, n)).clip(6)
    return Scenarios.from_arrays(
        side=np.where(rng.random(n) < 0.5, 1, -1), T=np.exp(rng.normal(np.log(2), 0.6, n)).clip(0.5, 10),
        d_y=np.exp(rng.normal(np.log(0.3), 0.6, n)).clip(0.02, 1.2), v_mean=v, a_mean=rng.normal(0, 0.3, n).clip(-1, 1),
        c_0=rng.normal(0, 0.5, n) / v**2, dc=rng.normal(0, 0.3, n) / v**2,
    )  # fmt: skip


def with_residuals(scenarios: Scenarios) -> Scenarios:
    rng = np.random.default_rng(77)
    n = scenarios.n
    return dataclasses.replace(scenarios, sigma_y=rng.uniform(0, 0.05, n), sigma_v=rng.uniform(0, 0.3, n))


EVERY_OPTION = PlantOptions(
    speed="profile", actuator=Actuator(delta_max=0.05, rate_max=0.4, lag=0.05, delay=0.03),
    mismatch=Mismatch(m=(0.8, 1.3)), tyres=Tyres(model="magic_formula"), residuals=Residuals(y=True, v=True),
    sensors=Sensors(e_y_noise=0.02, e_psi_step=1e-3, curvature_noise=1e-4, delay=0.1, kalman=KalmanFilter()),
)  # fmt: skip


def values(out: Outcome | Run) -> dict[str, np.ndarray]:
    """Everything that a result holds for each scenario, in the order that it has."""
    scores = ("S", "S_uncorrected", "t_s") if isinstance(out, Outcome) else ("area",)
    found = {name: getattr(out, name) for name in (*scores, "status", "failed_solves")}
    return found | {name: getattr(out.metrics, name) for name in METRIC_UNITS}


def assert_within_the_bound(out: Any, expected: Any, rows: Any = slice(None), between: float = 5e-4) -> None:
    """Two routes to the same numbers within what the Runge-Kutta loop promises: S to 1e-5, the rest to 1e-4. Extremes
    between samples and the time back inside come from polynomials through the ends of a sample or a substep, and may be
    `between` apart."""
    np.testing.assert_allclose(out.S[rows], expected.S[rows], rtol=1e-5, atol=1e-9)
    for name in METRICS:
        ours, theirs = getattr(out.metrics, name)[rows], getattr(expected.metrics, name)[rows]
        size = np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)
        atol = between if name in ("deepest", "dtle", "opposite_crossing", "t_back") else 1e-4 * size
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=atol, err_msg=name)


def assert_same_rows(
    out: Outcome | Run, expected: Outcome | Run, rows: Any = slice(None), of: Any = slice(None)
) -> None:
    """`out`, or its rows `of`, holds the rows of `expected`, bit for bit."""
    ours, theirs = (
        {name: None if value is None else value[part] for name, value in values(result).items()}
        for result, part in ((out, of), (expected, rows))
    )
    assert_same_bits(ours, theirs)


@dataclasses.dataclass(frozen=True)
class Constant(Controller):
    """A linear law that is the same at every speed."""

    name: ClassVar[str] = "constant"
    title: ClassVar[str] = "Constant"
    F: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    f_u: float = 0.0
    f_i: float = 0.0

    def prepare(self, plant: Plant) -> LinearLaw:
        none = np.zeros((plant.n, 0))
        F, f_u, f_i = (np.tile(values, (plant.n, 1)) for values in (self.F, [self.f_u], [self.f_i]))
        return LinearLaw(F, np.zeros(0), none, none, f_u[:, 0], f_i[:, 0] if self.f_i else None)


@dataclasses.dataclass(frozen=True)
class Prepared(Controller):
    """Whatever law a function makes for a plant."""

    name: ClassVar[str] = "prepared"
    title: ClassVar[str] = "Prepared"
    function: Callable[[Plant], Any]

    def prepare(self, plant: Plant) -> Any:
        return self.function(plant)


TABLES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "interp": lambda v: np.interp(v, [5.0, 15.3, 30.0], [-0.03, -0.01, -0.004]),
    "clip": lambda v: -0.2 / np.clip(v, 5.0, 100.0 / 3.6),
    "step": lambda v: np.where(v > 20.0, -0.005, -0.02),
    "bands": lambda v: np.array([-0.03, -0.02, -0.01, -0.004])[np.digitize(v, [10.0, 50.0 / 3.6, 25.0])],
    "notch": lambda v: np.where((v >= 20.0) & (v < 20.3), -0.01, -0.012),
    "noise": lambda v: -0.01 * (1.0 + 1e-6 * np.sin(1e9 * v)),
}


@dataclasses.dataclass(frozen=True)
class Table(Controller):
    """A linear law with gains that have kinks or steps over speed, on e_y and e_psi, and others that have none."""

    name: ClassVar[str] = "table"
    title: ClassVar[str] = "Table"
    kind: str = "interp"

    def prepare(self, plant: Plant) -> LinearLaw:
        law, found = LQR().prepare(plant), TABLES[self.kind](plant.v)
        F = np.column_stack([found, law.F[:, 1], 10.0 * found, law.F[:, 3]])
        return dataclasses.replace(law, F=F)


Fault = Callable[[np.ndarray, int], np.ndarray]  # (commands (n,), number of the sample) -> commands (n,)


@dataclasses.dataclass(frozen=True)
class Stepped(Controller):
    """Any linear law run through the general loop, with a fault."""

    name: ClassVar[str] = "stepped"
    title: ClassVar[str] = "Stepped"
    inner: Controller = dataclasses.field(default_factory=LQR)
    fault: Fault | None = None
    drops: bool = False

    def prepare(self, plant: Plant) -> SteeringLaw:
        law = self.inner.prepare(plant)
        assert isinstance(law, LinearLaw)
        return SteppedLaw(LinearSteps.of(law, plant), self.fault, self.drops)


@dataclasses.dataclass(frozen=True)
class SteppedLaw(SteeringLaw):
    law: LinearSteps
    fault: Fault | None = None
    drops: bool = False

    @property
    def preview_times(self) -> np.ndarray:
        return self.law.preview_times

    def init(self, n: int) -> tuple[int, Any]:
        return 0, self.law.init(n)

    def step(self, t, x, preview, delta_prev, state):  # type: ignore[no-untyped-def]
        delta, own, status = self.law.step(t, x, preview, delta_prev, state[1])
        return delta if self.fault is None else self.fault(delta, state[0]), (state[0] + 1, own), status

    def take(self, rows, state):  # type: ignore[no-untyped-def]
        if not self.drops:
            return None
        law, own = self.law.take(rows, state[1])
        return dataclasses.replace(self, law=law), (state[0], own)


@dataclasses.dataclass(frozen=True)
class InTheRoadFrame(Controller):
    """A law that is shown the road frame of a right departure: everything lateral with its sign turned."""

    name: ClassVar[str] = "in_the_road_frame"
    title: ClassVar[str] = "In the road frame"
    inner: Controller = dataclasses.field(default_factory=LQR)

    def prepare(self, plant: Plant) -> SteeringLaw:
        law = self.inner.prepare(plant)
        return InTheRoadFrameLaw(LinearSteps.of(law, plant) if isinstance(law, LinearLaw) else law)


@dataclasses.dataclass(frozen=True)
class InTheRoadFrameLaw(SteeringLaw):
    law: SteeringLaw

    @property
    def preview_times(self) -> np.ndarray:
        return self.law.preview_times

    def init(self, n: int) -> object:
        return self.law.init(n)

    def step(self, t, x, preview, delta_prev, state):  # type: ignore[no-untyped-def]
        mirrored = Preview(-preview.yaw_rate, -preview.heading)
        delta, state, status = self.law.step(t, -x, mirrored, -delta_prev, state)
        return -delta, state, status


DT = 0.05


def plant_at(*v: float, model: BicycleModel | None = None, dt: float = DT) -> Plant:
    return Plant.build(model or BicycleModel(), np.array(v), dt)


def mpc_situations(n: int, horizon: int, seed: int, size: float = 1.0) -> tuple[Plant, np.ndarray, Preview, np.ndarray]:
    """Plant, states, lane and commands before that a predictive law may meet."""
    rng = np.random.default_rng(seed)
    plant = Plant.build(BicycleModel(), rng.uniform(7, 36, n), DT)
    x = size * rng.normal(size=(n, 4)) * [0.8, 0.4, 0.03, 0.1]
    slope = rng.normal(0, 0.2, (n, 1))
    yaw_rate = size * (rng.normal(0, 0.05, (n, 1)) + slope * np.minimum(np.arange(horizon + 1) * DT, 0.5))
    return plant, x, Preview(yaw_rate, np.zeros_like(yaw_rate)), size * rng.uniform(-0.05, 0.05, n)


def continuous_poles(loop: np.ndarray, dt: float = DT) -> np.ndarray:
    """Of sampled loops (n, k, k)."""
    return np.log(np.linalg.eigvals(loop).astype(complex)) / dt


def weights_of(law: LinearLaw, i: int) -> np.ndarray:
    """Of the state, the wheel angle and the commands on their way, in scenario i."""
    wheel = [] if law.f_wheel is None else [law.f_wheel[i]]
    past = [] if law.f_past is None else law.f_past[i]
    return np.array([*law.F[i], *wheel, *([law.f_u[i]] if law.f_u.any() else []), *past])


def moved(
    plant: Plant, x: np.ndarray, delta: np.ndarray, r: np.ndarray | float = 0.0, r_next: np.ndarray | None = None
) -> np.ndarray:
    """The state (n, 4) one sample later; the lane's yaw rate goes from r to r_next, or stays."""
    step, now = plant.step, np.broadcast_to(r, delta.shape)[:, None]
    after = now if r_next is None else r_next[:, None]
    return np.einsum("nij,nj->ni", step.A, x) + step.B * delta[:, None] + step.E_0 * now + step.E_1 * after


def closed_loop_matrices(plant: Plant, command: Callable[[np.ndarray], np.ndarray], small: float = 1e-5) -> np.ndarray:
    """(n, 4, 4) under a law without memory, given as commands (n,) for states (n, 4)."""
    loop = np.zeros((plant.n, 4, 4))
    for i in range(4):
        x = np.zeros((plant.n, 4))
        x[:, i] = small
        loop[:, :, i] = moved(plant, x, command(x)) / small
    return loop


def grid(first: Iterable[Any], second: Iterable[Any], *default: tuple[Any, Any]) -> list[Any]:
    """Every pair; those that are not named are for the longer tier."""
    pairs = list(itertools.product(first, second))
    assert set(default) <= set(pairs)
    return [pair if pair in default else pytest.param(*pair, marks=pytest.mark.slow) for pair in pairs]


def some(cases: Iterable[Any], *default: Any) -> list[Any]:
    """Every case; those that are not named are for the longer tier."""
    listed = list(cases)
    assert set(default) <= set(listed)
    return [case if case in default else pytest.param(case, marks=pytest.mark.slow) for case in listed]


class Unsighted(SteeringLaw):
    """A law that is stepped without a preview; its state is None unless it is made otherwise."""

    @property
    def preview_times(self) -> Any:
        return np.zeros(0)

    def init(self, n: int) -> Any:
        return None


@contextmanager
def known(*laws: type[Controller]) -> Iterator[None]:
    """Laws that have a name for a while."""
    for law in laws:
        register(law)
    try:
        yield
    finally:
        for law in laws:
            registry.forget(law.name)
