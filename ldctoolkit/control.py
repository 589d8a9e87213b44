"""The shared interface: what a controller is, what it turns into, and how it is found by name.

A controller design is a frozen dataclass with declared gains. ``prepare(plant)`` does all per-scenario work and returns
a law whose type says what it can do:

- `LinearLaw`: delta = F x + G_yaw_rate psi_l' + G_heading dpsi_l + f_u delta_prev + f_i z, arrays of n;
  behind an actuator also with weights of earlier commands and of the wheels' steering angle;
- `SteeringLaw`: any other law, one call a time step for all n scenarios at once, with explicit state;
- `RecordedPath`: no intervention, the departure runs as it was recorded.
"""

from __future__ import annotations

import abc
import dataclasses
import enum
import inspect
import weakref
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.declared import Gain, check_declarations, declared_gains, document_gains
from ldctoolkit.errors import CheckedArguments, InputError, closest
from ldctoolkit.vehicle import Plant

State = tuple[FloatArray, FloatArray | None, FloatArray]
StatusArray = npt.NDArray[np.int8]


class EventStatus(enum.IntEnum):
    """The status of one scenario under one design.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> outcome = ldc.simulate(ldc.LQR(), ldc.load_model("reference").sample(5, 5, seed=1), y_s=0.1)
    >>> bool((outcome.status == ldc.EventStatus.DIVERGED).any())
    False
    """

    OK = 0
    """Triggered and driven to the end."""
    NEVER_TRIGGERED = 1
    """Never deeper than y_s: the recorded path counts."""
    SOLVER_FAILED = 2
    """At least one command came from the stated fallback because a solver did not solve, or gave a non-finite value."""
    DIVERGED = 3
    """|e_y| left the bound of the simulation; from there on the bound counts."""
    TIMED_OUT = 4
    """A time limit ended the scenario; the recorded path counts."""
    INVALID = 5
    """It cannot be driven: a parameter is not finite or has the wrong sign, the speed leaves 1 to 90 m/s. S is NaN."""
    CRASHED = 6
    """The law ended the process that it ran in, in this scenario; the recorded path counts."""
    BEYOND_DELTA_MAX = 7
    """Driven to the end; at first the wheel was so far beyond the law's limit that no command could meet it."""


class AssistState(enum.IntEnum):
    """What the assist does where a driver holds the wheel.

    Examples
    --------
    >>> AssistState.OVERRIDDEN.name
    'OVERRIDDEN'
    """

    ARMED = 0
    """Not triggered: no torque."""
    ACTIVE = 1
    """It steers."""
    OVERRIDDEN = 2
    """The driver's torque was beyond the limit for long enough: its torque leaves within the ramp."""
    RELEASED = 3
    """It has left the wheel to the driver."""


@dataclasses.dataclass(frozen=True)
class Preview:
    """The lane ahead, at the lookahead times that a law requested.

    Examples
    --------
    >>> import numpy as np
    >>> preview = Preview(yaw_rate=np.array([[0.0, 0.02]]), heading=np.array([[0.0, 0.01]]))
    >>> preview.yaw_rate.shape
    (1, 2)
    """

    yaw_rate: FloatArray  # (n, p) [rad/s] psi_l' = v c at each lookahead time
    # (n, p) [rad] Change of the lane's heading from now to each lookahead time, the integral of psi_l'
    heading: FloatArray
    # (n,) [rad] Steering angle of the wheels at the moment of the state that is seen; None where it is not measured
    wheel: FloatArray | None = None
    # (n, 2) e_y [m] and e_psi [rad] of the camera's frame that a Kalman filter took in at this sample; NaN without one
    frame: FloatArray | None = None
    torque: FloatArray | None = None  # (n,) [N m] Driver's torque at the steering wheel; None without a driver
    # (n,) The assist did not follow the command: overridden or released, or it, or the actuator, was at a limit; None
    # where the plant has neither a driver nor a limit of the angle
    yielding: BoolArray | None = None

    def conditioned(self, change: FloatArray) -> FloatArray:
        """The change (n,) of an integral over the sample, 0 where the assist yields: it does not wind up there."""
        return change if self.yielding is None else np.where(self.yielding, 0.0, change)


@final
@dataclasses.dataclass(frozen=True)
class LinearLaw(CheckedArguments):
    """A law that is linear in what it sees; runs without a call back into Python code of the controller.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> plant = ldc.Plant.build(ldc.BicycleModel(), [20.0, 30.0], 0.05)
    >>> ldc.LQR().prepare(plant).F.shape
    (2, 4)
    """

    F: FloatArray  # (n, 4) [rad per unit of state] Feedback on (e_y, de_y/dt, e_psi, de_psi/dt)
    # A field that is left out from here on has no weight
    # (p,) [s] Lookahead times, 0 is now
    preview_times: FloatArray = dataclasses.field(default_factory=partial(np.zeros, 0))
    # (n, p) [rad per rad/s] Weights of the lane's yaw rate there
    G_yaw_rate: FloatArray = dataclasses.field(default_factory=partial(np.zeros, (0, 0)))
    # (n, p) [rad/rad] Weights of the lane's heading change until there
    G_heading: FloatArray = dataclasses.field(default_factory=partial(np.zeros, (0, 0)))
    # (n,) [rad/rad] Weight of the previous command
    f_u: FloatArray = dataclasses.field(default_factory=partial(np.zeros, 0))
    # (n,) [rad/(m s)] Weight of z, the integral of e_y as the law sees it: z = 0 at the trigger, and z + dt e_y at
    # the next sample
    f_i: FloatArray | None = None
    # (n, q) [rad/rad] Weights of the commands before the previous one, the latest first. Before the trigger every
    # command is the steering angle of the recorded path.
    f_past: FloatArray | None = None
    # (n,) [rad/rad] Weight of the steering angle of the wheels, as measured at the moment of the state that the law
    # sees: now, or `Plant.age` ago where the design knows the camera's delay
    f_wheel: FloatArray | None = None
    conditioned: bool = False  # z stays what it is at samples where the assist yields: `Preview.yielding`

    def __post_init__(self) -> None:
        lookahead = np.shape(self.preview_times)
        for name, shape in (("G_yaw_rate", lookahead), ("G_heading", lookahead), ("f_u", ())):
            if np.size(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros((*np.shape(self.F)[:1], *shape)))

    @property
    def knows_actuator(self) -> bool:
        """It sees more than state, lane and previous command, and is driven by the loop that drives any plant."""
        return self.f_past is not None or self.f_wheel is not None


@dataclasses.dataclass(frozen=True)
class SolverCalls:
    """What a solver did for the commands of one sample: a row for each call.

    Examples
    --------
    >>> import numpy as np
    >>> calls = SolverCalls(np.array([1, 2]), np.zeros(2), np.array([12, 7]), np.full(2, 1e-7), np.full(2, 1e-7))
    >>> calls.of(np.array([2])).iterations
    array([7])
    """

    position: IntArray  # (k,) Of the scenario in the batch
    status: IntArray  # (k,) How the call ended, in the law's own numbers
    iterations: IntArray  # (k,)
    primal_residual: FloatArray  # (k,) In the law's own units; NaN where the solver does not report it
    dual_residual: FloatArray  # (k,) In the law's own units; NaN where the solver does not report it

    def of(self, positions: IntArray) -> SolverCalls:
        """The calls of the scenarios at `positions` in the batch."""
        if not self.position.size:
            return self
        rows = np.isin(self.position, positions)
        return SolverCalls(**{field.name: getattr(self, field.name)[rows] for field in dataclasses.fields(self)})


@dataclasses.dataclass(frozen=True)
class SolverLog:
    """The solver calls of a run, by scenario and then by sample; no rows for a law without a solver."""

    row: IntArray  # (k,) The scenario: in a run its position among the triggered ones, in an outcome its row number
    sample: IntArray  # (k,) 0 is the trigger
    # (k,) As in `SolverCalls`
    status: IntArray
    iterations: IntArray
    primal_residual: FloatArray
    dual_residual: FloatArray

    @classmethod
    def of(cls, calls: Sequence[tuple[IntArray, int, SolverCalls]]) -> SolverLog:
        """From the calls of each sample, with their scenarios and the sample's number."""
        none, no_numbers = np.zeros(0, dtype=np.int64), np.zeros(0)
        rows = (
            (row, np.full(row.size, sample), call.status, call.iterations, call.primal_residual, call.dual_residual)
            for row, sample, call in calls
        )
        columns = zip((none, none, none, none, no_numbers, no_numbers), *rows, strict=True)
        return cls(*(np.concatenate(parts, dtype=parts[0].dtype, casting="unsafe") for parts in columns))._in_order()

    def renamed(self, rows: IntArray) -> SolverLog:
        """The log with each scenario's number replaced by its entry of `rows`."""
        return dataclasses.replace(self, row=rows[self.row])._in_order()

    def _in_order(self) -> SolverLog:
        order = np.lexsort((self.sample, self.row))  # stable: two calls for one command stay in their order
        return SolverLog(**{f.name: getattr(self, f.name)[order] for f in dataclasses.fields(self)})


class SteeringLaw(abc.ABC):
    """Any law, as one call per time step for all n scenarios. Implementations are frozen: state is passed, not kept.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> plant = ldc.Plant.build(ldc.BicycleModel(), [20.0], 0.05)
    >>> isinstance(ldc.PID().prepare(plant), SteeringLaw)
    True
    """

    @property
    @abc.abstractmethod
    def preview_times(self) -> FloatArray:
        """Lookahead times (p,) [s] of the preview that `step` receives; empty for none."""

    @abc.abstractmethod
    def init(self, n: int) -> Any:
        """State before the first step of n scenarios."""

    @abc.abstractmethod
    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: Any
    ) -> tuple[FloatArray, Any, StatusArray]:
        """One command for each scenario.

        Parameters
        ----------
        t : (n,) [s]
            Time since each departure's start.
        x : (n, 4)
            State (e_y, de_y/dt, e_psi, de_psi/dt). Scenarios that have ended are passed as zeros and ignored after.
        preview : Preview
            The lane ahead at `preview_times`.
        delta_prev : (n,) [rad]
            Command of the step before; at the trigger the steering angle of the recorded path.
        state : object
            What `init` or the step before returned. It must not be changed in place where a change could be seen
            by another run.

        Returns
        -------
        delta : (n,) [rad]
        state : object
        status : (n,) int8
            `EventStatus.OK`, `SOLVER_FAILED`, or `BEYOND_DELTA_MAX`.
        """

    def take(self, rows: IntArray, state: Any) -> tuple[SteeringLaw, Any] | None:  # noqa: ARG002
        """The law and its state for some of its scenarios, so that those that have ended cost nothing.

        Parameters
        ----------
        rows : (k,) int
            Scenarios that go on, ascending, by their position in the present batch.
        state : object
            What `step` returned last.

        Returns
        -------
        (law, state) or None
            None, as here, where the law cannot be cut down: ended scenarios are then passed as zeros.
        """
        return None

    def solver_calls(self, state: Any) -> SolverCalls | None:  # noqa: ARG002
        """The solver calls behind the commands of the last step, for the record that `Outcome.solver_log` keeps.

        Parameters
        ----------
        state : object
            What `step` returned last.

        Returns
        -------
        SolverCalls or None
            None, as here, for a law without a solver.
        """
        return None

    def plan(self, seen: tuple[Any, ...], after: Any) -> tuple[FloatArray, ...] | None:  # noqa: ARG002
        """Plans behind the commands of a step, `seen` its (x, preview, delta_prev, state), for `ldctoolkit.plans`.

        Returns
        -------
        (t, x, delta) or None
            Times (N + 1,) [s] since the sample, of which the first command acts at the first; predicted states
            (n, N + 1, 4); commands (n, N) [rad]. NaN without a plan. None, as here, for a law that plans nothing.
        """
        return None

    def linearised(self) -> Sequence[tuple[FloatArray, ...]] | None:
        """The law around straight, centred driving, for margins and reviews, which check it with pulses.

        Returns
        -------
        sequence of n (A, B, C, D), or None
            delta = C s + D u, then s+ = A s + B u, u = (e_y, de_y/dt, e_psi, de_psi/dt, delta_prev, lane yaw rate of a
            bend that goes on, measured steering angle of the wheels). None, as here: the review probes the law.
        """
        return None


@final
@dataclasses.dataclass(frozen=True)
class RecordedPath:
    """No intervention: the scenario keeps its uncorrected path.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> plant = ldc.Plant.build(ldc.BicycleModel(), [20.0], 0.05)
    >>> ldc.NoControl().prepare(plant)
    RecordedPath()
    """


Law = LinearLaw | SteeringLaw | RecordedPath


_checked: weakref.WeakSet[type] = weakref.WeakSet()  # classes that follow `Controller`


class Controller(CheckedArguments, abc.ABC):
    """A controller design: a frozen dataclass whose fields are made with `gain` and `option`.

    Every declared value is checked when the design is made, so that a wrong one is named where it was written. Raises
    `InputError` from the constructor, for a value outside its declaration, or a class that is not made as described
    here.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.LQR(r_delta=-1.0)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: lqr.r_delta: -1.0; allowed: a number from 0.001 to 1e+06 1/rad^2
    """

    name: ClassVar[str]
    """Registry key, equal to the file name of the law."""

    title: ClassVar[str]
    """Name for people: tables and legends."""

    batch: ClassVar[int] = 1000
    """Scenarios that a study drives as one batch; less for a law that takes long, so that its work can be spread.

    It belongs to the law, so that no number depends on how many workers there are.
    """

    law_options: ClassVar[tuple[str, ...]] = ()
    """Options whose value is the registry name of another law, as the one inside a filter."""

    symmetric: ClassVar[bool] = True
    """Whether mirrored input gives the mirrored command; False where the crossed line is not treated as the other."""

    def __post_init__(self) -> None:
        check_class(type(self))
        for declared in self.gains():
            checked = declared.check(getattr(self, declared.name), self.name)
            object.__setattr__(self, declared.name, checked)

    @classmethod
    def gains(cls) -> tuple[Gain, ...]:
        """Declared gains and options, in field order."""
        return tuple(declared_gains(cls).values())

    @abc.abstractmethod
    def prepare(self, plant: Plant) -> Law:
        """Do all per-scenario work (gain scheduling over speed, condensing) and return the law.

        Parameters
        ----------
        plant : Plant
            Model, speeds (n,) and sample time.
        """


def check_class(controller: type[Controller]) -> None:
    """Raise if a controller class does not follow `Controller`."""
    if controller in _checked:  # a class is looked at once: studies make thousands of designs of it
        return
    called, decorator = controller.__name__, "@dataclasses.dataclass(frozen=True)"
    # a field that is still there as an attribute was never seen by @dataclass
    unseen = any(isinstance(value, dataclasses.Field) for base in controller.__mro__ for value in vars(base).values())
    if unseen or not dataclasses.is_dataclass(controller):
        raise InputError(called, "not a dataclass", hint=f"write {decorator} directly above the class")
    if not controller.__dataclass_params__.frozen:
        raise InputError(called, "a dataclass that is not frozen", hint=f"write {decorator}")
    for attribute in ("name", "title"):
        path, value = f"{called}.{attribute}", getattr(controller, attribute, None)
        if any(field.name == attribute for field in dataclasses.fields(controller)):
            raise InputError(path, "a field of the dataclass", hint=f"write {attribute}: ClassVar[str] = ...")
        if not isinstance(value, str) or not value:
            raise InputError(path, value=value, allowed="a non-empty string, ClassVar[str]")
    own, fields = vars(controller), {field.name for field in dataclasses.fields(controller)}
    known = {name for base in controller.__mro__[1:] for name in vars(base)}
    for name in own.keys() - fields - known:
        if name[0] != "_" and (close := closest(name, sorted(known - own.keys() - fields), 0.85)):
            raise InputError(f"{called}.{name}", "is never used", hint=f"did you mean {close!r}?")
    for field in dataclasses.fields(controller):
        if any(inspect.isroutine(vars(base).get(field.name)) for base in controller.__mro__[1:]):
            raise InputError(f"{called}.{field.name}", "is a method", hint="give the gain another name")
    if inspect.isabstract(controller):
        raise InputError(called, f"no {', '.join(sorted(controller.__abstractmethods__))}", hint="define it")
    check_declarations(controller)
    document_gains(controller)
    _checked.add(controller)


@final
@dataclasses.dataclass(frozen=True)
class LinearSteps(SteeringLaw):
    """The formula of `LinearLaw`; its state is z, earlier commands (n, c), the latest first, and the wheel angle.

    The wheel angle is not measured here: it is what the nominal actuator makes of the commands, unless `measured`. Sums
    are made term by term: a scenario's command has the same bits in a batch of any size.

    Examples
    --------
    >>> import numpy as np
    >>> from ldctoolkit import LQR, BicycleModel, Plant
    >>> plant = Plant.build(BicycleModel(), [20.0], 0.05)
    >>> LinearSteps.of(LQR().prepare(plant), plant).preview_times
    array([0.])
    """

    law: LinearLaw
    dt: float  # [s]
    held: int  # c, number of earlier commands in the state
    whole: int  # [samples] Age of the younger command that moves the wheel within a sample
    wheel: FloatArray  # (n, 3) Weights of the wheel angle, that command and the older one in the angle a sample later
    measured: bool = False  # The wheel angle is that of the preview, as in the compiled loops

    @classmethod
    def of(cls, law: LinearLaw, plant: Plant) -> LinearSteps:
        """The steps of a linear law that was prepared with a plant."""
        wheel, past, whole = np.tile([0.0, 1.0, 0.0], (plant.n, 1)), 0, 0
        if law.f_wheel is not None:
            step = plant.augmented
            whole = step.whole
            if plant.lag > 0:
                wheel = np.column_stack([step.A[:, 4, 4], step.B[:, 4], step.B_old[:, 4]])
        if law.f_past is not None:
            past = law.f_past.shape[1]
        return cls(law, plant.dt, max(past, whole + 1) if law.knows_actuator else 0, whole, wheel)

    @property
    def preview_times(self) -> FloatArray:
        """Lookahead times of the linear law."""
        return self.law.preview_times

    def init(self, n: int) -> State:
        """No integral; the commands before the trigger are those that the first step is shown."""
        return np.zeros(n), None, np.zeros(n)

    def step(
        self,
        t: FloatArray,  # noqa: ARG002
        x: FloatArray,
        preview: Preview,
        delta_prev: FloatArray,
        state: State,
    ) -> tuple[FloatArray, State, StatusArray]:
        """The command as the weighted sum, and the state for the next sample."""
        law, (z, past, angle) = self.law, state
        if past is None:
            past, angle = np.repeat(delta_prev[:, None], self.held, axis=1), delta_prev
        elif law.f_wheel is not None and not self.measured:
            younger, older = delta_prev if self.whole == 0 else past[:, self.whole - 1], past[:, self.whole]
            angle = self.wheel[:, 0] * angle + self.wheel[:, 1] * younger + self.wheel[:, 2] * older
        if self.measured and preview.wheel is not None:
            angle = preview.wheel
        delta = law.f_u * delta_prev
        if law.f_i is not None:
            delta += law.f_i * z
        if law.f_wheel is not None:
            delta += law.f_wheel * angle
        for i in range(4):
            delta += law.F[:, i] * x[:, i]
        for j in range(law.preview_times.size):
            delta += law.G_yaw_rate[:, j] * preview.yaw_rate[:, j] + law.G_heading[:, j] * preview.heading[:, j]
        if law.f_past is not None:
            for j in range(law.f_past.shape[1]):
                delta += law.f_past[:, j] * past[:, j]
        if self.held:
            past = np.column_stack([delta_prev, past[:, :-1]])
        change = self.dt * x[:, 0]
        z = z + (preview.conditioned(change) if law.conditioned else change)
        return delta, (z, past, angle), np.full(delta.size, EventStatus.OK, dtype=np.int8)

    def take(self, rows: IntArray, state: State) -> tuple[LinearSteps, State]:
        """The law and its state for the scenarios `rows`."""
        law, (z, past, angle) = self.law, state
        columns = [(name, value) for name, value in vars(law).items() if isinstance(value, np.ndarray)]
        of_rows: dict[str, Any] = {name: value[rows] for name, value in columns if name != "preview_times"}
        law_of_rows = dataclasses.replace(law, **of_rows)
        state_of_rows = z[rows], None if past is None else past[rows], angle[rows]
        return dataclasses.replace(self, law=law_of_rows, wheel=self.wheel[rows]), state_of_rows
