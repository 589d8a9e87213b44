"""Predictive controllers whose formulation a designer writes: cost, limits and dynamics in CasADi expressions.

At every sample the law minimises sum stage(x_k, u_k) + terminal(x_N) over the next N commands, subject to the dynamics
and limits of its class, and steers the first command. State, lane, delay, batching, warm start, convergence and the
fallback are the toolkit's. Positive to the left (ISO 8855), towards the line that is crossed; radians.

From formulation to C: `docs/how-to/my-mpc.md`; method: `docs/explanation/mpc.md`, `_nmpc_model`, `_nmpc_solver`.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Final, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.casadi_code import called
from ldctoolkit.code_content import content_of
from ldctoolkit.control import Controller, EventStatus, Preview, SolverCalls, SteeringLaw
from ldctoolkit.errors import InputError, LdcError, plain
from ldctoolkit.law_checks import check_controller
from ldctoolkit.vehicle.bicycle import BicycleModel, Plant
from ldctoolkit.vehicle.discretization import discretize
from ldctoolkit.vehicle.speed_schedule import scheduled

from ._affine_plans import AffinePlans, affine_plans
from ._mpc_condensing import WINDOW, block_starts, jerk_window, lane, lookahead
from ._nmpc_model import LANE, Formulation, Structure, formulation
from ._nmpc_solver import SoftLimits, Solution, Workspace, reachable, workspace
from ._prediction_model import STATES, base_columns, forced, steady_cornering
from .riccati import linear_models, stabilising

_MOST_BYTES: Final = 2.0**30  # of one horizon's matrices


@dataclasses.dataclass(frozen=True)
class Soft:
    """A limit that may be exceeded at a price: lower <= value <= upper, a violation v costs weight (v + v^2/2).

    A value that depends on states holds at the end of each sample, one of x.a_y or x.jerk also just after each command.
    With a weight above what a unit of violation is worth to the cost, a limit that can be kept is kept exactly.

    Examples
    --------
    >>> Soft(value=0.0, upper=3.0).lower
    -inf
    """

    value: Any  # CasADi scalar of x, u, lane, k and gains
    # The same; infinite or None for no limit
    lower: Any = -np.inf
    upper: Any = np.inf
    weight: Any = 1e3  # > 0 on a straight lane, of gains, lane and k; where it reaches 0 there is no limit


@dataclasses.dataclass(frozen=True)
class Stage:
    """Cost and limits of one sample.

    Examples
    --------
    >>> Stage(cost=1.0).soft
    ()
    """

    cost: Any  # CasADi scalar
    # (expression, low, high): of u.delta or of u.change, linear in it; the ends of gains, lane and k, or None
    hard: Sequence[tuple[Any, Any, Any]] = ()
    soft: Sequence[Soft] = ()


class PredictiveController(Controller):
    """A predictive controller: a frozen dataclass of gains, with a `stage` and what else it defines.

    Gains of type `float` are parameters of the compiled functions: sweeping them compiles nothing anew. Whole numbers,
    switches, words, and gains of exactly 0 are numbers in the expressions. `horizon` has to be one of the fields or a
    class variable.

    Examples
    --------
    >>> import dataclasses
    >>> import ldctoolkit as ldc
    >>> @dataclasses.dataclass(frozen=True)
    ... class Offset(ldc.PredictiveController):
    ...     name, title, horizon = "offset_mpc", "Offset MPC", 10
    ...     r: float = ldc.gain(2e4, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")
    ...
    ...     def stage(self, x, u, lane, k):
    ...         return ldc.Stage(x.e_y**2 + self.r * (u.delta - lane.steady_delta) ** 2, hard=[(u.delta, -0.1, 0.1)])
    >>> Offset().r
    20000.0
    """

    batch: ClassVar[int] = 20  # tens of milliseconds a scenario: about a second of work
    symmetric: ClassVar[bool] = False  # a cost or a limit may be of the line that is crossed alone

    states: ClassVar[tuple[str, ...]] = ()
    """States beyond e_y, e_y_rate, e_psi, e_psi_rate; one named ``wheel`` is the angle of the wheels."""

    move_blocks: ClassVar[int] = 0
    """Number of free moves, each held, at most one a sample; 0 for one a sample."""

    iterations: ClassVar[int | str] = "converged"
    """Iterations of each solve, a whole number; ``"converged"``, or 0, for as many as convergence takes."""

    integrator: ClassVar[str] = "exponential"
    """``exponential`` (exact where the dynamics are linear), or ``rk4``."""

    hessian: ClassVar[str] = "exact"
    """``exact``, or ``gauss_newton``: without the curvature of dynamics and soft limits."""

    @abc.abstractmethod
    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        """Cost and limits of sample k = 0 .. N-1.

        Parameters
        ----------
        x : e_y [m], e_y_rate [m/s], e_psi [rad], e_psi_rate [rad/s], the class's states, wheel [rad]
            State at the sample's start; `wheel` is the command before where no state has this name. In limits also
            `a_y` [m/s^2], lateral acceleration less v^2 c, and `jerk` [m/s^3], its mean change over 0.5 s; in costs
            `a_y` just after the command.
        u : delta, change [rad]
            Command, and its change from the one before.
        lane : yaw_rate [rad/s], curvature [1/m], steady_delta [rad], steady_e_psi [rad], offset [m], dt [s], v [m/s]
            Lane at the sample's start; steering angle and heading error of steady cornering there; e_y at which the
            vehicle's edge is on the line that is crossed (on the other one: minus that); sample time; speed.
        k : index of the sample

        Returns
        -------
        Stage
        """

    def terminal(self, x: Any, lane: Any) -> Any:
        """Cost of the last state; None, as here, for that of the Riccati equation of the stage's quadratic part."""
        return None

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Mapping[str, Any]:
        """Time derivatives by state, and `a_y` [m/s^2] where it is not that of e_y_rate.

        Parameters
        ----------
        x, u, lane
            As in `stage`, without `a_y` and `jerk`.
        vehicle : C_af, C_ar [N/rad], l_f, l_r [m], m [kg], I_z [kg m^2], mu, v [m/s], dt [s]
            With ``vehicle.nonlinear(x, delta, lane)``, the bicycle on saturating tyres, the default at u.delta, and
            ``vehicle.linear(x, delta, lane)``; delay, and the lag where no state is named ``wheel``, are outside.
        """
        return vehicle.nonlinear(x, u.delta, lane)  # type: ignore[no-any-return]

    def initial(self, x: FloatArray, delta: FloatArray) -> Mapping[str, Any]:
        """Values of the class's states at the first sample, arrays (n,) by name; 0, or for ``wheel`` delta, if absent.

        Parameters
        ----------
        x : (n, 4)
            State of the vehicle.
        delta : (n,) [rad]
            Steering angle of the recorded path.
        """
        return {}

    @staticmethod
    def is_zero(gain: Any) -> bool:
        """Whether a gain is exactly 0, for limits that 0 switches off; others are symbols in `stage`."""
        return isinstance(gain, int | float) and gain == 0

    def prepare(self, plant: Plant) -> PredictiveLaw:
        """Compile the formulation, solve its Riccati equation, and gather each scenario's numbers."""
        form = formulation(_structure(self))
        N, (window, share) = _horizon(self, form), jerk_window(plant.dt)
        base = base_columns(plant, getattr(self, "mu", 1.0), _gains(self, form))
        A, B, E = _linear_part(form, base)
        _check(self, form, base, N)
        parts = dict(zip(("vehicle", "linear", "gains"), np.split(base, [10, 20], axis=1), strict=True))
        step, half = discretize(A, B, E, plant.dt), discretize(A, B, E, 0.5 * plant.dt)
        responses = forced(A, form.nonlinear_rows, plant.dt)
        parts |= {
            "A": step.A, "B": step.B, "E_0": step.E_0, "E_1": step.E_1, "A_c": A, "B_c": B, "E_c": E,
            "A_h": half.A, "B_h": half.B, "E_0h": half.E_0, "E_1h": half.E_1,
            "H_1": forced(A, form.nonlinear_rows, 0.5 * plant.dt)[0],
            **dict(zip(("G_1", "G_2", "G_3"), responses, strict=True)),
        }  # fmt: skip
        K, P = _regulator(self, plant, form)
        columns = form.layout.pack(**parts, P=P, K=K)
        nx = A.shape[1]
        # e_y = 0 and no change at a lane yaw rate of 1
        system = np.zeros((plant.n, nx + 1, nx + 1))
        system[:, :nx, :nx], system[:, :nx, nx], system[:, nx, 0] = A, B, 1.0
        right = np.concatenate([-E, np.zeros((plant.n, 1))], axis=1)
        steady = (np.linalg.pinv(system) @ right[:, :, None])[:, :, 0]
        lagging = plant.lag if "wheel" not in form.own else 0.0
        delay = round((plant.delay + lagging) / plant.dt)
        rows = _soft_rows(form, N, window, share)
        law = PredictiveLaw(self, plant, form, columns, steady, N, delay, rows)
        if not form.affine:
            return law
        weights = (rows.rows, rows.before) if rows else (np.zeros((0, 0)), np.zeros((0, 2 * window + 1)))
        return dataclasses.replace(law, affine=affine_plans(law.workspace, columns, law.samples, delay, *weights))


def _structure(design: PredictiveController) -> Structure:
    """What decides the form of a design's expressions."""
    kind = type(design)
    check_controller(design)
    gains, zeros, fixed = [], [], []
    for field in dataclasses.fields(design):  # type: ignore[arg-type]
        value = getattr(design, field.name)
        if not isinstance(value, float):
            fixed.append((field.name, value))
        elif value == 0.0:
            zeros.append(field.name)
        else:
            gains.append(field.name)
    for name, choices in (("integrator", ("exponential", "rk4")), ("hessian", ("exact", "gauss_newton"))):
        if getattr(design, name) not in choices:
            raise InputError(f"{design.name}.{name}", value=getattr(design, name), allowed=choices)
    return Structure(kind, content_of(kind), tuple(fixed), tuple(gains), tuple(zeros))


def _gains(design: PredictiveController, form: Formulation) -> tuple[float, ...]:
    return tuple(getattr(design, name) for name in form.structure.gains)


def _horizon(design: PredictiveController, form: Formulation) -> int:
    """N, checked with the memory that it takes; also the other whole numbers of a class."""
    limits = {"horizon": 1, "move_blocks": 0, "iterations": 0}
    for name, least in limits.items():
        value = plain(getattr(design, name, None))
        if isinstance(value, str) and (name, value) == ("iterations", "converged"):
            continue
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            allowed = f"a whole number >= {least}" + ', or "converged"' * (name == "iterations")
            raise InputError(f"{design.name}.{name}", value=value, allowed=allowed)
    N = int(design.horizon)  # type: ignore[attr-defined]
    size = 8.0 * N * N * (4 * form.size + 3 * form.outputs + 4)
    if size > _MOST_BYTES:
        most = int(N * (_MOST_BYTES / size) ** 0.5)
        problem = f"takes {size / 2**30:.1f} GiB for each thread"
        raise InputError(f"{design.name}.horizon", problem, value=N, allowed=f"at most {most} for this formulation")
    return N


def _linear_part(form: Formulation, base: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (n, nx, nx), B and E (n, nx) of the rates at straight driving."""
    n = base.shape[0]
    A, B, E = (np.asarray(part) for part in form.linear_part.map(max(n, 1))(base.T if n else np.ones(base.shape[1])))
    nx = A.shape[0]
    return A.reshape(nx, -1, nx).transpose(1, 0, 2)[:n], B.T[:n].copy(), E.T[:n].copy()


def _check(design: PredictiveController, form: Formulation, base: FloatArray, N: int) -> None:
    """Raise for derivatives at straight driving that are not finite, and for limits that nothing can meet."""
    if not base.shape[0]:
        return
    # with a plant that stays where it is, and no terminal cost of the Riccati equation
    column = np.append(base[0], np.zeros(form.layout.size - base.shape[1]))
    zero, away, p = np.zeros(form.size), 1.0 + 0.1 * np.arange(form.size), np.zeros(form.samples)
    hint = "a root or a quotient at 0 has none: add a small number to it"
    if not all(np.isfinite(np.asarray(part)).all() for part in form.linear_part(base[0])):
        raise InputError(f"{design.name}.dynamics", "has no finite derivative at straight driving", hint=hint)
    for k in range(N):
        p[2] = k
        if not np.isfinite(np.asarray(form.check(zero, 0.0, p, column)[0])).all():
            raise InputError(f"{design.name}.stage", "has no finite derivative at straight driving", hint=hint)
        # slopes on both sides of straight driving come together as these do, unless there is a kink
        slopes = (np.asarray(form.check(e * away, e, p, column)[1]) for e in (1e-6, -1e-6, 1e-7, -1e-7))
        right, left, near_right, near_left = slopes
        jump = np.abs(near_right - near_left)
        if kinks := np.flatnonzero((jump > 0.5 * np.abs(right - left)) & (jump > 1e-9)).tolist():
            path = f"{design.name}.{'stage.cost' if kinks[0] <= form.size else 'terminal'}"
            raise InputError(path, "has a kink at straight driving", hint="write ca.sqrt(x**2 + 1e-6) for abs(x)")
        bounds = [np.asarray(part).ravel() for part in form.limit(p, column)]
        for kind, i in (("u.delta", 0), ("u.change", 2)):
            if not bounds[i] <= 0.0 <= bounds[i + 1]:
                value = f"{bounds[i][0]:g} to {bounds[i + 1][0]:g} rad at k = {k}"
                allowed = f"limits of {kind}, low <= 0 <= high"
                raise InputError(f"{design.name}.stage.hard", value=value, allowed=allowed)
        for row, low, high, linear in zip(form.soft, *bounds[4:7], strict=True):
            path, at = f"{design.name}.stage.soft[{row.soft}]", f"at k = {k + row.end}"
            if not low <= high:
                raise InputError(path, value=f"{low:g} to {high:g} {at}", allowed="lower <= upper")
            if not 0.0 < linear < np.inf:
                raise InputError(f"{path}.weight", value=f"{linear:g} {at}", allowed="a number > 0")


@dataclasses.dataclass(frozen=True)
class _Riccati:
    """(K, P) of a design's quadratic part at given speeds, side by side."""

    design: PredictiveController
    model: BicycleModel
    dt: float

    def __call__(self, v: FloatArray) -> FloatArray:
        form, plant = formulation(_structure(self.design)), Plant.build(self.model, v, self.dt)
        base = base_columns(plant, getattr(self.design, "mu", 1.0), _gains(self.design, form))
        step = discretize(*_linear_part(form, base), self.dt)
        m, nx = step.B.shape
        nz = form.size
        A, B = np.zeros((m, nz, nz)), np.ones((m, nz))
        A[:, :nx, :nx], B[:, :nx] = step.A, step.B
        columns = np.zeros((m, form.layout.size))
        columns[:, : base.shape[1]] = base
        W = np.empty((m, nz + 1, nz + 1))
        for i in range(m):
            W[i] = form.hessian(np.zeros(nz), 0.0, np.zeros(form.samples), columns[i])
        K, P = stabilising(A, B, W[:, :nz, :nz], W[:, :nz, nz], W[:, nz, nz], slice(len(STATES), nx))
        return np.concatenate([K, P.reshape(m, -1)], axis=1)


def _regulator(design: PredictiveController, plant: Plant, form: Formulation) -> tuple[FloatArray, FloatArray]:
    """K (n, nz) and P (n, nz, nz); zeros where a design with a terminal cost has none."""
    nz = form.size
    what = f"terminal costs of {design.name}"
    try:
        values = scheduled(_Riccati(design, plant.model, plant.dt), plant.v, what)
    except LdcError as error:
        if isinstance(error, InputError):
            raise
        if form.riccati:
            hint = "let the cost weigh x.e_y and u.delta or u.change near straight driving, or define terminal()"
            problem = f"has no terminal cost: {error.problem}"
            raise InputError(f"{design.name}.stage", problem, hint=hint) from error
        values = np.zeros((plant.n, nz + nz * nz))
    return values[:, :nz].copy(), values[:, nz:].reshape(-1, nz, nz).copy()


@dataclasses.dataclass(frozen=True)
class _SoftRows:
    """How soft rows come from outputs of the horizon and from accelerations before it."""

    rows: FloatArray  # (m, no N)
    # (m, 2 window + 1) Weights of the accelerations before and after each of the last samples, before the first command
    # the last
    before: FloatArray


def _soft_rows(form: Formulation, N: int, window: int, share: float) -> _SoftRows | None:
    if not form.soft:
        return None
    rows = np.zeros((len(form.soft), N, form.outputs, N))
    past = np.zeros((len(form.soft), N, 2 * window + 1))
    for kind, row in enumerate(form.soft):
        if row.history is None:
            rows[kind, :, row.output] = np.eye(N)
            continue
        # accelerations of the last `window` samples (before them also now's), then those of the horizon
        basis = np.eye(window + N) if row.history == 0 else np.eye(window + N + 1)[1:]
        then = basis[:N]
        if share:
            then = (1.0 - share) * basis[:N] + share * basis[1 : N + 1]
        mean = (basis[window:] - then) / WINDOW
        first = window if row.history == 0 else window + 1
        rows[kind, :, row.output] = mean[:, first:]
        columns = slice(window + 1, None) if row.history == 0 else slice(0, window + 1)
        past[kind, :, columns] = mean[:, :first]
    m = len(form.soft) * N
    return _SoftRows(rows.reshape(m, -1), past.reshape(m, -1))


@dataclasses.dataclass(frozen=True)
class PredictiveState:
    """What one step leaves for the next, a row for each scenario."""

    U: FloatArray  # (n, N) [rad] Last commands planned
    has_plan: BoolArray  # (n,) Whether they are a solution
    # (n,) 1 to 3, the rung of the ladder that the last command came from; 0 before the first
    rung: npt.NDArray[np.int8]
    iterations: IntArray  # (n,) Of the last solve
    residual: FloatArray  # (n,) [rad] Largest change of a command in its last iteration
    cost: FloatArray  # (n,) Of the last plan, without penalties
    # (n, delay + 1) [rad] The last commands, the oldest first; this and what follows is NaN before the first sample
    sent: FloatArray
    # (n, 2, window) [m/s^2] Lateral acceleration less that of the lane before and after each of the last samples
    past: FloatArray
    own: FloatArray  # (n, number of the class's states) At the moment that is seen


@dataclasses.dataclass(frozen=True)
class PlanningLaw(SteeringLaw):
    """A law of n scenarios that plans the next N commands from where they steer, and sends the first."""

    design: Any
    plant: Plant
    form: Formulation
    columns: FloatArray  # (n, nc) Each scenario's numbers
    steady: FloatArray  # (n, nx + 1) Steady cornering of the linear part per unit of lane yaw rate: states, delta
    horizon: int
    delay: int  # Samples until a command steers
    # Of a formulation that is linear-quadratic
    affine: AffinePlans | None = dataclasses.field(default=None, kw_only=True)

    @property
    def limited(self) -> tuple[bool, bool]:
        """Whether limits of angle and of change hold for every command, not for the fallback alone."""
        return True, True

    @abc.abstractmethod
    def _solve(
        self, work: Workspace, history: FloatArray, soft: list[FloatArray], state: Any, after: Any, i: int
    ) -> Solution:
        """The plan of scenario i for the problem in the workspace."""

    def __reduce__(self) -> tuple[Any, ...]:
        return _prepared, (self.design, self.plant)

    @property
    def preview_times(self) -> FloatArray:
        """Samples from what is seen on, to the N-th after that at which a command arrives; none before now."""
        return lookahead(self.delay + self.horizon, self.plant.dt, self.plant.age)

    def init(self, n: int) -> PredictiveState:
        """No plan yet."""
        zero = np.zeros(n)
        return PredictiveState(
            U=np.zeros((n, self.horizon)),
            has_plan=np.zeros(n, dtype=np.bool_),
            rung=np.zeros(n, dtype=np.int8),
            iterations=np.zeros(n, dtype=np.int64),
            residual=zero,
            cost=zero.copy(),
            sent=np.full((n, self.delay + 1), np.nan),
            past=np.full((n, 2, jerk_window(self.plant.dt)[0]), np.nan),
            own=np.full((n, len(self.form.own)), np.nan),
        )

    def take(self, rows: IntArray, state: PredictiveState) -> tuple[PlanningLaw, PredictiveState]:
        """Only some scenarios, each with its last plan."""
        plant = dataclasses.replace(self.plant, v=self.plant.v[rows])
        part = type(state)(*(getattr(state, f.name)[rows] for f in dataclasses.fields(state)))
        affine = self.affine and self.affine.take(rows)
        law = dataclasses.replace(
            self, plant=plant, columns=self.columns[rows], steady=self.steady[rows], affine=affine
        )
        return law, part

    def solver_calls(self, state: PredictiveState) -> SolverCalls:
        """One call a scenario; status is its rung, the dual residual the last change of a command [rad]."""
        n = state.rung.size
        return SolverCalls(
            np.arange(n), state.rung.astype(np.int64), state.iterations, np.full(n, np.nan), state.residual
        )

    @property
    def workspace(self) -> Workspace:
        """Where the calling thread solves."""
        blocks = self.design.move_blocks
        return workspace(self.form, self.horizon, block_starts(self.horizon, blocks) if blocks else None)

    def samples(self, r: FloatArray) -> FloatArray:
        """Columns p (n, k, np) of the samples between lane yaw rates r (n, k + 1), of which the last N are planned."""
        nx, nz = len(STATES) + len(self.form.own), self.form.size
        between = 0.5 * (r[:, :-1] + r[:, 1:])
        states = np.zeros((*r.shape, nz))
        states[:, :, :nx] = r[:, :, None] * self.steady[:, None, :nx]
        delta, delta_node = between * self.steady[:, -1:], r * self.steady[:, -1:]
        if self.form.nonlinear_rows:
            both = steady_cornering(self.plant, getattr(self.design, "mu", 1.0), np.concatenate([r, between], axis=1))
            delta, delta_node = both.delta[:, r.shape[1] :], both.delta[:, : r.shape[1]]
            states[:, :, 2] = both.e_psi[:, : r.shape[1]]
        if "wheel" in self.form.own:
            states[:, :, len(STATES) + self.form.own.index("wheel")] = delta_node
        if self.form.previous:
            states[:, :, nx] = delta_node
        k = np.broadcast_to(np.arange(between.shape[1]) - between.shape[1] + self.horizon, between.shape)
        head = np.stack([r[:, :-1], r[:, 1:], k, delta], axis=2)
        return np.concatenate([head, states[:, :-1], states[:, 1:]], axis=2)

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: PredictiveState
    ) -> tuple[FloatArray, PredictiveState, npt.NDArray[np.int8]]:
        """First command of the optimal plan, for every scenario."""
        n = delta_prev.size
        after = type(state)(*(getattr(state, f.name).copy() for f in dataclasses.fields(state)))
        delta = np.empty(n)
        after.sent[:] = np.column_stack([state.sent[:, 1:], delta_prev])
        after.sent[:] = np.where(np.isnan(after.sent), delta_prev[:, None], after.sent)
        self.see_own(after.own, x, preview, delta_prev)
        r, left = lane(preview.yaw_rate, self.plant.dt, self.plant.age), np.arange(n)
        if self.affine is not None:
            s = np.concatenate([x, after.own, after.sent, r], axis=1)
            plans = self.affine.solve(s, after.past, delta_prev)
            done, left = plans.done, np.flatnonzero(~plans.done)
            delta[:], after.has_plan[:], after.rung[:] = plans.delta, True, 1
            after.residual[done], after.cost[done], after.iterations[:] = 0.0, np.nan, plans.iterations
            after.U[done], after.past[done], after.own[done] = plans.U[done], plans.past[done], plans.own[done]
        if left.size:
            work, samples = self.workspace, self.samples(r)
            for i in left.tolist():
                delta[i] = self._command(work, x[i], samples[i], float(delta_prev[i]), state, after, i)
        status = np.array([EventStatus.OK, EventStatus.OK, EventStatus.BEYOND_DELTA_MAX, EventStatus.SOLVER_FAILED])
        return delta, after, status[after.rung].astype(np.int8)

    def plan(self, seen: tuple[Any, ...], after: PredictiveState) -> tuple[FloatArray, ...]:
        """Commands, and the states that the model drives through with them from where the first one steers."""
        (x, preview, delta_prev, state), work, N, dt = seen, self.workspace, self.horizon, self.plant.dt
        now = dataclasses.replace(after, own=state.own.copy(), past=state.past.copy())
        self.see_own(now.own, x, preview, delta_prev)
        samples = self.samples(lane(preview.yaw_rate, dt, self.plant.age))
        path, delta = np.full((len(x), N + 1, len(STATES)), np.nan), np.where(after.has_plan[:, None], after.U, np.nan)
        for i in np.flatnonzero(after.has_plan).tolist():
            work.c[:] = self.columns[i]
            self._begin(work, x[i], samples[i], now, i)
            path[i, 0] = work.z_0[: len(STATES)]
            for k in range(N):
                work.z_0[:] = work.predict(delta[i, k], samples[i, self.delay + k])[0]
                path[i, k + 1] = work.z_0[: len(STATES)]
        return np.asarray((self.delay + np.arange(N + 1)) * dt - self.plant.age), path, delta

    def linearised(self) -> list[tuple[FloatArray, ...]]:
        """The sensitivity of the first command (that of the plan's KKT system), where no limit is active."""
        return linear_models(self._small_signal, self.plant.n, len(self.form.own), self.delay)

    def _small_signal(self, u: FloatArray, own: FloatArray, sent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """First command, and own states a sample later, for inputs u (n, 7), own states and earlier commands."""
        n, work = u.shape[0], self.workspace
        after = dataclasses.replace(self.init(n), own=own, sent=np.column_stack([sent, u[:, 4]]))
        self.see_own(own, u[:, :4], Preview(u[:, 5:6], u[:, 5:6], u[:, 6]), u[:, 4])
        samples = self.samples(np.tile(u[:, 5:6], self.delay + self.horizon + 1))
        delta, following = np.empty(n), np.empty_like(own)
        for i in range(n):
            work.c[:] = self.columns[i]
            following[i] = self._begin(work, u[i, :4], samples[i], after, i)[0]
            work.P[:] = samples[i, self.delay :]
            delta[i] = work.first_move()
            if not self.delay:
                following[i] = work.predict(delta[i], samples[i, 0])[0][len(STATES) : len(STATES) + own.shape[1]]
        return delta, following

    def see_own(self, own: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray) -> None:
        """Values of the class's states at the first sample; the wheels' angle wherever it is measured."""
        names = self.form.own
        if not names:
            return
        new = np.isnan(own).any(axis=1)
        if new.any():
            path = f"{self.design.name}.initial"
            given = called(path, self.design.initial, x, delta_prev, hint="")
            if not isinstance(given, Mapping) or any(name not in names for name in given):
                raise InputError(path, value=given, allowed=f"a dictionary with keys of {', '.join(names)}")
            for j, name in enumerate(names):
                value = given.get(name, delta_prev if name == "wheel" else 0.0)
                try:
                    own[new, j] = np.broadcast_to(np.asarray(value, dtype=float), (len(own),))[new]
                except (TypeError, ValueError):
                    raise InputError(f"{path}[{name!r}]", value=value, allowed="a number, or an array (n,)") from None
                if not np.isfinite(own[new & np.isfinite(x).all(axis=1), j]).all():
                    raise InputError(f"{path}[{name!r}]", value=value, allowed="finite numbers")
        if "wheel" in names and preview.wheel is not None:
            own[:, names.index("wheel")] = preview.wheel

    def _command(
        self, work: Workspace, x: FloatArray, samples: FloatArray, delta_prev: float, state: PredictiveState,
        after: PredictiveState, i: int,
    ) -> float:  # fmt: skip
        work.delta_prev[0], work.c[:] = delta_prev, self.columns[i]
        own, history = self._begin(work, x, samples, after, i)
        work.P[:] = samples[self.delay :]
        low, high, low_change, high_change, *soft = work.limits()
        # where the command before is so far out that no command meets both limits: what the rate can reach
        low, high, relaxed = reachable(low[None], high[None], low_change[None], high_change[None], work.delta_prev)
        work.low[:], work.high[:] = low[0], high[0]
        work.low_change[:], work.high_change[:] = low_change, high_change
        solution = self._solve(work, history, soft, state, after, i)
        solution.solved &= not bool(np.isnan([work.low, work.high]).any())  # limits that are no numbers
        command = float(solution.U[0])
        after.has_plan[i] = solution.solved
        of_angle, of_change = self.limited if solution.solved else (True, True)
        if solution.solved:
            after.U[i] = solution.U
            after.rung[i] = 2 if relaxed[0] and of_angle else 1
        else:
            after.rung[i] = 3
            K, p = self.form.layout.unpack(self.columns[i])["K"], work.P[0]
            command = float(p[3] - K @ (work.z_0 - p[LANE : LANE + self.form.size]))
            command = command if np.isfinite(command) else 0.0
        after.iterations[i], after.residual[i], after.cost[i] = solution.iterations, solution.step, solution.cost
        if of_angle:
            command = min(max(command, work.low[0]), work.high[0])
        if of_change:
            command = min(max(command, delta_prev + low_change[0]), delta_prev + high_change[0])
        command = float(command + 0.0)  # a sum with 0 turns -0 into 0
        if not self.delay:
            z, a_0, _ = work.predict(command, samples[0])
            after.past[i, 1, -1] = a_0
            own = z[len(STATES) : len(STATES) + len(self.form.own)]
        after.own[i] = own
        return command

    def _begin(
        self, work: Workspace, x: FloatArray, samples: FloatArray, after: PredictiveState, i: int
    ) -> tuple[FloatArray, FloatArray]:
        """Take the workspace's state to where the next command steers.

        Returns the class's states a sample after the moment that is seen, if a command on its way leads there, and
        accelerations before and after each of the last samples, before the first command that is planned the last.
        """
        sent, window, form = after.sent[i], after.past.shape[2], self.form
        work.z_0[:] = np.concatenate([x, after.own[i], sent[:1]])[: form.size]
        now = work.predict(sent[0], samples[0])[1]
        past = np.where(np.isnan(after.past[i]), now, after.past[i])
        before, after_command = [*past[0], now], [*past[1]]
        own = after.own[i].copy()
        for k, u in enumerate(sent[1:]):
            z, a_0, a_1 = work.predict(u, samples[k])
            after_command.append(a_0)
            before.append(a_1)
            work.z_0[:] = z
            if k == 0:
                own[:] = z[len(STATES) : len(STATES) + own.size]
        after.past[i] = before[1 : window + 1], [*after_command, now][1 : window + 1]
        k = len(sent) - 1
        return own, np.array(before[k:] + after_command[k:])


@final
@dataclasses.dataclass(frozen=True)
class PredictiveLaw(PlanningLaw):
    """A predictive controller of n scenarios."""

    rows: _SoftRows | None

    @property
    def most(self) -> int:
        """Iterations of a solve; 0 for convergence."""
        return 0 if self.design.iterations == "converged" else int(self.design.iterations)

    def _solve(
        self, work: Workspace, history: FloatArray, soft: list[FloatArray], state: Any, after: Any, i: int
    ) -> Solution:  # fmt: skip
        """By sequential quadratic programming, warm started from the last plan a sample later."""
        work.soft = None
        if self.rows is not None:
            bounds = np.stack([part.ravel() for part in soft])
            bounds[:, bounds[3] <= 0.0] = [[-np.inf], [np.inf], [1.0], [1.0]]  # what costs nothing is no limit
            work.soft = SoftLimits(self.rows.rows, self.rows.before @ history, *bounds)
        warm = np.append(state.U[i, 1:], state.U[i, -1]) if state.has_plan[i] else None
        return work.solve(warm, self.most)


def _prepared(design: Controller, plant: Plant) -> Any:
    return design.prepare(plant)
