"""Control barrier function filter: another law's command, changed as little as keeps the vehicle in a corridor.

delta = argmin (delta - delta_inner)^2 subject to |e_y| <= e_y_max being kept, where e_y is the offset of the vehicle's
centre from the lane's centre, positive to the left (ISO 8855); the edge is on the line at e_y = (w_l - w_v)/2, 0.85 m
with the default vehicle. Both sides have a barrier, h = e_y_max - e_y and h = e_y_max + e_y.

The condition on each is psi(k+1) >= (1 - gamma_2) psi(k) with psi = gamma_1 h + dt dh/dt. With w = (gamma_1, dt, 0,
0) and x+ = A x + B delta + E_0 r_0 + E_1 r_1 both are linear in delta: it is clipped to an interval of constant width,

    |w'B delta - ((1 - gamma_2) w'x - w'(A x + E_0 r_0 + E_1 r_1))| <= gamma_1 gamma_2 e_y_max.

Details: `docs/reference/laws.md`.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, LinearLaw, LinearSteps, Preview, SolverCalls, SteeringLaw
from ldctoolkit.declared import gain, option
from ldctoolkit.errors import InputError, UnknownNameError
from ldctoolkit.registry import controller_class
from ldctoolkit.vehicle.bicycle import Plant


def inner_design(inner: str, inner_gains: str, owner: type[Controller]) -> Controller:
    """The design that the options `inner` and `inner_gains` of a law name."""
    try:
        kind = controller_class(inner)
    except UnknownNameError as error:
        raise error.at(f"{owner.name}.inner") from None
    if issubclass(kind, owner):
        raise InputError(f"{owner.name}.inner", value=inner, allowed="a law other than itself")
    if inner == "none":
        raise InputError(f"{owner.name}.inner", value=inner, allowed="a law that steers")
    where = f"{owner.name}.inner_gains"
    declared = {gain.name: gain for gain in kind.gains()}
    gains: dict[str, Any] = {}
    for entry in inner_gains.split(",") if inner_gains.strip() else ():
        name, equals, value = (part.strip() for part in entry.partition("="))
        if not (name and equals and value):
            raise InputError(where, value=entry.strip(), allowed="gain=value, separated by commas")
        if name not in declared:
            raise UnknownNameError(f"{where}: {inner}.{name}", "no such gain", allowed=declared)
        if name in gains:
            raise InputError(f"{where}: {inner}.{name}", "is given twice", allowed="once")
        gains[name] = declared[name].parsed(value)
    try:
        return kind(**gains)
    except InputError as error:
        raise error.within(where, ": ") from None


def steering_law(design: Controller, plant: Plant, owner: str) -> SteeringLaw:
    """Prepare a design as a law that is stepped, whatever its kind."""
    law = design.prepare(plant)
    if isinstance(law, LinearLaw):
        return LinearSteps.of(law, plant)
    if isinstance(law, SteeringLaw):
        return law
    what = type(law).__name__
    raise InputError(f"{owner}.inner", f"prepared a {what}", value=design.name, allowed="a LinearLaw or a SteeringLaw")


@final
@dataclasses.dataclass(frozen=True)
class BarrierFilter(Controller):
    """Barrier function filter around another law.

    Raises `InputError` also for a law inside that cannot be there, or gains of it that are wrong.

    Examples
    --------
    >>> BarrierFilter(inner="lqr", inner_gains="r_delta=3000", e_y_max=1.2).delta_max
    0.1
    """

    name: ClassVar[str] = "barrier_filter"
    title: ClassVar[str] = "Barrier filter"
    law_options: ClassVar[tuple[str, ...]] = ("inner",)

    inner: str = option("preview_proportional", choices=None, description="name of the law inside")
    inner_gains: str = option("", choices=None, description="gains of the law inside: gain=value, gain=value")
    e_y_max: float = gain(1.35, unit="m", lower=0.1, upper=10.0, description="half width of the corridor of e_y")
    gamma_1: float = gain(0.05, unit="1", lower=1e-3, upper=1.0, description="share of h that a sample may lose")
    gamma_2: float = gain(0.1, unit="1", lower=1e-3, upper=1.0, description="share of psi that a sample may lose")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")

    def __post_init__(self) -> None:
        super().__post_init__()
        inner_design(self.inner, self.inner_gains, type(self))

    def prepare(self, plant: Plant) -> BarrierLaw:
        """Prepare the law inside, and both conditions for every scenario's speed."""
        design = inner_design(self.inner, self.inner_gains, type(self))
        law = steering_law(design, plant, self.name)
        step, rate = plant.step, 1.0 - self.gamma_2
        b = _along(step.B, self.gamma_1, plant.dt)
        centre = np.empty((plant.n, 6))
        for i in range(4):
            centre[:, i] = -_along(step.A[:, :, i], self.gamma_1, plant.dt)
        centre[:, 0] += rate * self.gamma_1
        centre[:, 1] += rate * plant.dt
        centre[:, 4] = -_along(step.E_0, self.gamma_1, plant.dt)
        centre[:, 5] = -_along(step.E_1, self.gamma_1, plant.dt)
        return BarrierLaw(
            inner=law,
            inner_name=design.name,
            dt=plant.dt,
            centre=centre / b[:, None],
            half_width=self.gamma_1 * self.gamma_2 * self.e_y_max / np.abs(b),
            delta_max=self.delta_max,
        )


def _along(column: FloatArray, gamma_1: float, dt: float) -> FloatArray:
    """w'B, for columns (n, 4) of the sampled plant."""
    return gamma_1 * column[:, 0] + dt * column[:, 1]


@final
@dataclasses.dataclass(frozen=True)
class BarrierLaw(SteeringLaw):
    """The filter for n scenarios; its state is that of the law inside."""

    inner: SteeringLaw
    inner_name: str
    dt: float  # [s]
    # (n, 6) Centre of the interval of commands, from (x, yaw rate of the lane now, at the next sample)
    centre: FloatArray
    half_width: FloatArray  # (n,) [rad] Half of its width
    delta_max: float  # [rad]

    @property
    def preview_times(self) -> FloatArray:
        """Now, the next sample, and those of the law inside."""
        return np.concatenate([[0.0, self.dt], self.inner.preview_times])

    def init(self, n: int) -> Any:
        """State of the law inside."""
        return self.inner.init(n)

    def interval(self, x: FloatArray, yaw_rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Least and greatest command that meets both conditions."""
        # column by column: the same bits in a batch of any size
        middle = self.centre[:, 4] * yaw_rate[:, 0] + self.centre[:, 5] * yaw_rate[:, 1]
        for i in range(4):
            middle += self.centre[:, i] * x[:, i]
        return middle - self.half_width, middle + self.half_width

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: Any
    ) -> tuple[FloatArray, Any, npt.NDArray[np.int8]]:
        """The command of the law inside, moved into the interval and the limit."""
        lower, upper = self.interval(x, preview.yaw_rate)
        # laid out as when it runs alone: the order of its sums may depend on it
        yaw_rate, heading = (np.ascontiguousarray(each[:, 2:]) for each in (preview.yaw_rate, preview.heading))
        inner_preview = dataclasses.replace(preview, yaw_rate=yaw_rate, heading=heading)
        delta, state, status = self.inner.step(t, x, inner_preview, delta_prev.copy(), state)
        delta, status = np.asarray(delta, dtype=np.float64), np.array(status, dtype=np.int8)
        if delta.shape != lower.shape or status.shape != lower.shape:
            shapes = f"{delta.shape}, {status.shape}"
            raise InputError(f"law {self.inner_name!r}", f"step returned shapes {shapes}", allowed=str(lower.shape))
        wrong = ~np.isfinite(delta)
        status[wrong] = EventStatus.SOLVER_FAILED
        unfiltered = np.where(wrong, delta_prev, delta)
        return np.clip(np.clip(unfiltered, lower, upper), -self.delta_max, self.delta_max), state, status

    def take(self, rows: IntArray, state: Any) -> tuple[BarrierLaw, Any] | None:
        """Only some scenarios, where the law inside can be cut down."""
        smaller = self.inner.take(rows, state)
        if smaller is None:
            return None
        part = dataclasses.replace(self, inner=smaller[0], centre=self.centre[rows], half_width=self.half_width[rows])
        return part, smaller[1]

    def solver_calls(self, state: Any) -> SolverCalls | None:
        """Those of the law inside."""
        return self.inner.solver_calls(state)
