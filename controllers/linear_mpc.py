"""Linear model predictive control with curvature preview, limits on steering angle and rate, and soft limits.

At every sample it minimises, over the next N commands, the sum of x~' Q x~ + r_delta u~^2 with the terminal cost
x~_N' P x~_N, where x~ and u~ are deviations from steady cornering at the lane yaw rate previewed for that sample and P
solves the Riccati equation; subject to |u| <= delta_max and |u_j - u_(j-1)| <= rate_max dt, u_(-1) the previous
command, and softly to limits on lateral acceleration, lateral jerk and lane offset. Without active limits this is the
LQR with curvature preview, exactly. The plant is the one behind the nominal actuator. Positive to the left (ISO 8855),
radians. Use it where limits matter: a designer's choice of comfort or of a weak actuator; where they do not, `lqr`
gives the same commands for nothing.

Form of the QP, soft limits, blocks, solvers, QPs that are not solved: `docs/explanation/mpc.md`.
"""

from __future__ import annotations

import abc
import dataclasses
import enum
from typing import Any, ClassVar, Final, NamedTuple, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import EventStatus, Preview, SolverCalls, SteeringLaw
from ldctoolkit.declared import gain, option
from ldctoolkit.errors import InputError
from ldctoolkit.vehicle.bicycle import Plant

from ._mpc_condensing import Condensed, InitialState, Limits, MPCDesign, condense, lane, limits, lookahead
from .riccati import linear_models


@final
@dataclasses.dataclass(frozen=True)
class LinearMPC(MPCDesign):
    """Linear MPC, one QP a sample.

    Raises `InputError` for a solver that is not installed, and as every design.

    Examples
    --------
    >>> LinearMPC(horizon=10).delta_max
    0.1
    """

    name: ClassVar[str] = "linear_mpc"
    title: ClassVar[str] = "Linear MPC"

    soft_weight: float = gain(
        1e3, unit="rad^2", lower=1e-3, upper=1e6, scale="log", description="weight of going beyond a soft limit"
    )
    blocks: int = gain(0, unit="1", lower=0, upper=100, description="number of free moves; 0 for one a sample")
    solver: str = option("daqp", choices=None, description="QP solver: daqp, osqp, or another of qpsolvers")
    always_solve: bool = gain(False, unit="1", description="call the solver also where the solution is known without")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_solver(self.solver, self.name)

    def prepare(self, plant: Plant) -> MPCLaw:
        """Solve the Riccati equation, and condense what the limits need, for every scenario's speed."""
        condensed, rows = condense(plant, self, self.blocks), limits(plant, self, self.blocks, self.soft_weight)
        return MPCLaw(condensed, rows, plant.dt, plant.lag > 0.0, plant.age, self.solver, self.always_solve)


# ------------------------------------------------------------------------------------------------ solvers
#
# A solver stands behind two calls: make a workspace for a scenario, solve in it. A workspace holds what a solver has
# allocated and factorised, nothing that a result depends on: every solve starts from a point that is passed in. So a
# workspace may be kept, shared between runs or thrown away, and no bit changes.

EPS: Final = 1e-6  # Tolerance of OSQP, absolute and relative


@dataclasses.dataclass(frozen=True)
class QP:
    """minimise |w|^2/2 + q'w subject to low <= A w <= high; the bounds are given with each solve."""

    q: FloatArray
    A: FloatArray


class Form:
    """The QP as solvers take it: slacks are variables, a soft row is two, and the Hessian is the identity.

    Variables are the corrections and, for each kind of soft limit there is, sqrt(weight) times its slack. Rows are the
    hard ones, the soft ones with their upper bounds, the soft ones with their lower bounds, and the slacks.
    """

    def __init__(self, limits: Limits) -> None:
        self.M = limits.start.size
        self.hard = 2 * self.M - 1
        self.kinds = np.flatnonzero(limits.scale)
        self.root = np.sqrt(limits.weight[self.kinds])
        # what slacks add to the soft rows
        self.slack = (limits.group[self.hard :, None] == self.kinds) / self.root

    def qp(self, C: FloatArray) -> QP:
        """Of the rows C (R, M)."""
        q = np.concatenate([np.zeros(self.M), self.root])
        if not self.kinds.size:
            return QP(q, C)
        hard, soft, kinds = C[: self.hard], C[self.hard :], self.kinds.size
        rows = [
            [hard, np.zeros((self.hard, kinds))],
            [soft, -self.slack],
            [soft, self.slack],
            [np.zeros((kinds, self.M)), np.eye(kinds)],
        ]
        return QP(q, np.block(rows))

    def bounds(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of k QPs, from the bounds (k, R) of the rows."""
        k, soft, kinds = low.shape[0], low.shape[1] - self.hard, self.kinds.size
        open_below, open_above = np.full((k, soft), -np.inf), np.full((k, soft), np.inf)
        below = [low[:, : self.hard], open_below, low[:, self.hard :], np.zeros((k, kinds))]
        above = [high, open_above, np.full((k, kinds), np.inf)]
        return np.concatenate(below, axis=1), np.concatenate(above, axis=1)

    def split(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers (k, R) of the rows, as those of the solver's rows."""
        hard, soft = multipliers[:, : self.hard], multipliers[:, self.hard :]
        nothing = np.zeros((len(multipliers), self.kinds.size))
        return np.concatenate([hard, np.maximum(soft, 0.0), np.minimum(soft, 0.0), nothing], axis=1)

    def join(self, answer: Answer) -> tuple[FloatArray, FloatArray]:
        """Corrections and slacks (M + 3,), and multipliers (R,), of an answer."""
        w = np.zeros(self.M + 3)
        w[: self.M] = answer.w[: self.M]
        w[self.M + self.kinds] = answer.w[self.M :] / self.root
        soft = self.slack.shape[0]
        first, second = self.hard + soft, self.hard + 2 * soft
        upper = answer.y[:first].copy()
        upper[self.hard :] += answer.y[first:second]
        return w, upper


@dataclasses.dataclass(frozen=True)
class Answer:
    """Answer of a solver."""

    solved: bool  # The solver says so; otherwise w and y are not to be used
    w: FloatArray  # (variables,)
    y: FloatArray  # (rows,) Multipliers, positive at an upper bound
    iterations: int


class Workspace(abc.ABC):
    """A solver made for the matrices of one QP."""

    @abc.abstractmethod
    def solve(self, low: FloatArray, high: FloatArray, y: FloatArray) -> Answer:
        """Solve for these bounds."""


class Workspaces(dict[int, tuple[QP, Workspace]]):
    """QPs, whose matrices no sample changes, and their workspaces, by place in the batch.

    A copy or a pickle is empty: they are made again where they are needed.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Workspaces:
        return Workspaces()

    def __reduce__(self) -> tuple[type[Workspaces], tuple[()]]:
        return Workspaces, ()


def check_solver(solver: str, owner: str) -> None:
    """Raise unless a solver of that name is installed: OSQP and DAQP always are, others as qpsolvers names them."""
    if solver not in ("osqp", "daqp"):
        import qpsolvers

        installed = {"osqp", "daqp", *qpsolvers.available_solvers}
        if solver not in installed:
            raise InputError(f"{owner}.solver", "is not installed", value=solver, allowed=sorted(installed))


def make(solver: str, qp: QP) -> Workspace:
    """A workspace of the solver of that name."""
    if solver == "osqp":
        return Osqp(qp)
    if solver == "daqp":
        return Daqp(qp)
    return Reference(solver, qp)


class Osqp(Workspace):
    """OSQP (B. Stellato and others, *OSQP: an operator splitting solver for quadratic programs*, 2020)."""

    rho: Final = 0.1

    def __init__(self, qp: QP) -> None:
        import osqp
        import scipy.sparse

        self.qp, self.solver = qp, osqp.OSQP()
        self.solved, self.interrupted = int(osqp.SolverStatus.OSQP_SOLVED), int(osqp.SolverStatus.OSQP_SIGINT)
        m, n = qp.A.shape
        self.solver.setup(
            P=scipy.sparse.eye(n, format="csc"),
            q=qp.q,
            A=scipy.sparse.csc_matrix(qp.A),
            l=np.full(m, -1.0),
            u=np.full(m, 1.0),
            eps_abs=EPS,
            eps_rel=EPS,
            max_iter=1000,  # what takes longer goes to DAQP
            eps_prim_inf=1e-10,  # what is called is feasible; the default takes slow progress for infeasibility
            warm_starting=True,
            scaling=10 if qp.q.any() else 0,
            rho=self.rho,
            # a fixed interval (a timed one would depend on the machine's load), short since the factorisation is small
            adaptive_rho_interval=25,
            adaptive_rho_tolerance=2.0,
            check_termination=5,
            verbose=False,
        )

    def solve(self, low: FloatArray, high: FloatArray, y: FloatArray) -> Answer:
        """Solve from the corrections that belong to the multipliers y."""
        solver = self.solver
        solver.update(l=low, u=high)
        solver.warm_start(x=-(y @ self.qp.A) - self.qp.q, y=y)
        result = solver.solve(raise_error=False)
        if result.info.status_val == self.interrupted:
            raise KeyboardInterrupt  # OSQP catches the signal itself while it solves
        if result.info.rho_updates:
            solver.update_settings(rho=self.rho)  # the next solve starts as this one did
        # only a solved QP is used: OSQP leaves NaN or a placeholder in x for anything else
        done = result.info.status_val == self.solved and bool(np.isfinite(result.x).all())
        return Answer(done, np.array(result.x), np.array(result.y), int(result.info.iter))


class Daqp(Workspace):
    """DAQP (D. Arnstroem, A. Bemporad, D. Axehill, *A dual active-set solver for embedded quadratic programming using
    recursive LDL' updates*, IEEE TAC 67(8), 2022).
    """

    def __init__(self, qp: QP) -> None:
        import daqp

        m, n = qp.A.shape
        self.model = daqp.Model()
        self.model.settings = {"primal_tol": 1e-9, "dual_tol": 1e-12}
        self.model.setup(np.eye(n), qp.q, qp.A, np.full(m, 1e30), np.full(m, -1e30), np.zeros(m, dtype=np.intc))

    def solve(self, low: FloatArray, high: FloatArray, y: FloatArray) -> Answer:
        """Solve from the rows that the multipliers y hold at a bound."""
        sense = (y != 0).astype(np.intc)
        sense[y < 0] = 3  # held at the lower bound
        self.model.update(bupper=high, blower=low, sense=sense)
        w, _, flag, info = self.model.solve()
        # the model keeps its own arrays
        w, y = np.array(w), np.array(info["lam"])
        return Answer(flag == 1 and bool(np.isfinite(w).all()), w, y, int(info["iterations"]))


class Reference(Workspace):
    """Any solver of qpsolvers, from scratch each time: slow, for comparison."""

    def __init__(self, solver: str, qp: QP) -> None:
        self.solver, self.qp = solver, qp

    def solve(self, low: FloatArray, high: FloatArray, y: FloatArray) -> Answer:
        """Solve from scratch."""
        import qpsolvers
        import scipy.sparse

        A = self.qp.A
        above, below = np.isfinite(high), np.isfinite(low)
        G, h = np.vstack([A[above], -A[below]]), np.concatenate([high[above], -low[below]])
        shaped = np.asarray if self.solver in qpsolvers.dense_solvers else scipy.sparse.csc_matrix
        problem = qpsolvers.Problem(shaped(np.eye(A.shape[1])), self.qp.q, shaped(G), h)
        try:
            solution = qpsolvers.solve_problem(problem, solver=self.solver)
            x, z = solution.x, solution.z
        except (qpsolvers.QPError, ArithmeticError, ValueError):
            x = z = None
        if x is None or z is None or not solution.found or not np.isfinite(x).all():
            return Answer(False, np.zeros(A.shape[1]), np.zeros(A.shape[0]), 0)
        multipliers = np.zeros(A.shape[0])
        multipliers[above] += z[: above.sum()]
        multipliers[below] -= z[above.sum() :]
        return Answer(True, np.asarray(x), multipliers, 0)


_ACCEPTED: Final = 1e-5
"""Largest violation of a limit by an answer that a solver calls solved [rad, or share of a soft limit]."""


class Rung(enum.IntEnum):
    """How a command came about."""

    FREE = 0
    """The plan without limits meets them all: it is the solution."""
    HELD = 1
    """A guess of the rows at their bounds proved to be the solution."""
    SOLVED = 2
    """The solver solved the QP."""
    RELAXED = 3
    """The hard limits cannot be met, and were widened to what can be reached: `EventStatus.BEYOND_DELTA_MAX`."""
    OTHER_SOLVER = 4
    """The solver gave up, DAQP solved the QP."""
    SATURATED = 5
    """Nothing solved the QP: towards the saturated unconstrained command at the rate limit; counted as failed."""


_STATUS = np.zeros(len(Rung), dtype=np.int8)  # `EventStatus` of each rung
_STATUS[Rung.RELAXED], _STATUS[Rung.SATURATED] = EventStatus.BEYOND_DELTA_MAX, EventStatus.SOLVER_FAILED


@dataclasses.dataclass(frozen=True)
class MPCState:
    """What `MPCLaw` carries from sample to sample; one row a scenario."""

    multipliers: FloatArray  # (n, R) Of the last QP's rows, positive at an upper bound; 0 where no limit was active
    slack: FloatArray  # (n, 3) Of the last QP, by kind of soft limit, as a share of the limit
    rung: npt.NDArray[np.int8]  # (n,) `Rung` of the last command
    # Of the last sample; status is 1 where the answer could be used, the residuals are the largest violation of a bound
    # [rad, or share of a soft limit] and the largest |e + C' multipliers|
    calls: SolverCalls
    workspaces: Workspaces  # What solvers have allocated. No result depends on it
    # (n, delay + 1) The last commands, the oldest first [rad]; this and what follows is NaN before the first sample
    sent: FloatArray
    wheel: FloatArray  # (n,) The wheel's angle at the next sample as the law predicts it [rad]
    past: FloatArray  # (n, 2, window) a before and after each of the last samples [m/s^2]


@final
@dataclasses.dataclass(frozen=True)
class MPCLaw(SteeringLaw):
    """The condensed MPC of n scenarios."""

    condensed: Condensed
    limits: Limits
    dt: float  # [s]
    lagging: bool  # The wheel's angle is a state
    age: float  # [s] Of the state that is seen
    solver: str
    always_solve: bool

    @property
    def horizon(self) -> int:
        """N."""
        return int(self.condensed.impulse.shape[1])

    @property
    def preview_times(self) -> FloatArray:
        """Samples from what is seen on, to the N-th after that at which a command arrives; none before now."""
        return lookahead(self.limits.delay + self.horizon, self.dt, self.age)

    def init(self, n: int) -> MPCState:
        """Nothing solved yet."""
        rows = self.limits.group.size
        return MPCState(
            multipliers=np.zeros((n, rows)),
            slack=np.zeros((n, 3)),
            rung=np.zeros(n, dtype=np.int8),
            calls=_calls([]),
            workspaces=Workspaces(),
            sent=np.full((n, self.limits.delay + 1), np.nan),
            wheel=np.full(n, np.nan),
            past=np.full((n, 2, self.limits.window), np.nan),
        )

    def take(self, rows: IntArray, state: MPCState) -> tuple[MPCLaw, MPCState]:
        """Only some scenarios, each with what it has."""
        law = dataclasses.replace(self, condensed=self.condensed.take(rows))
        workspaces = Workspaces({k: state.workspaces[i] for k, i in enumerate(rows.tolist()) if i in state.workspaces})
        parts = (getattr(state, name)[rows] for name in ("multipliers", "slack", "rung", "sent", "wheel", "past"))
        multipliers, slack, rung, *actuator = parts
        return law, MPCState(multipliers, slack, rung, _calls([]), workspaces, *actuator)

    def solver_calls(self, state: MPCState) -> SolverCalls:
        """Of the last sample: status 1 where the answer could be used, residuals as in `MPCState`."""
        return state.calls

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: MPCState
    ) -> tuple[FloatArray, MPCState, npt.NDArray[np.int8]]:
        """First command of the optimal plan, for every scenario."""
        from . import _mpc_kernel as kernel

        n, N, M = x.shape[0], self.horizon, self.limits.start.size
        U, delta, result = np.empty((n, N)), np.empty(n), np.empty(n, dtype=np.int8)
        w, multipliers = np.zeros((n, M + 3)), np.zeros_like(state.multipliers)
        initial = self._initial_state(x, preview.yaw_rate, delta_prev, state)
        before = (state.multipliers, state.slack)
        proves = not self.always_solve
        kernel.sweep(self.condensed, self.limits, proves, initial, *before, U, delta, w, multipliers, result)

        rung = np.where(result == kernel.HELD, np.int8(Rung.HELD), np.int8(Rung.FREE))
        beyond = result == kernel.BEYOND
        if beyond.any():
            # widened to what can be reached, the limits leave one first command: back, as fast as the rate allows
            delta[beyond] = (delta_prev - np.sign(delta_prev) * self.limits.rate_step)[beyond]
            rung[beyond] = Rung.RELAXED
        calls: list[_Call] = []
        workspaces = state.workspaces
        rows = np.flatnonzero(result == kernel.OPEN)
        if rows.size:
            workspaces = Workspaces(workspaces)
            calls = self._solve(rows, initial, U, delta, w, multipliers, rung, workspaces)
        slack = np.maximum(w[:, M:], 0.0)
        state = MPCState(multipliers, slack, rung, _calls(calls), workspaces, *self._after(initial, delta, state))
        return delta, state, _STATUS[rung]

    def linearised(self) -> list[tuple[FloatArray, ...]]:
        """By differences of the step, which is linear where no limit is active."""
        free = dataclasses.replace(self, always_solve=False)
        return linear_models(free._small_signal, self.condensed.B.shape[0], int(self.lagging), self.limits.delay)

    def _small_signal(self, u: FloatArray, wheel: FloatArray, sent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Command, and predicted wheel angle a sample later, for inputs u (n, 7) and earlier commands."""
        state = self.init(u.shape[0])
        state.sent[:, 1:], state.wheel[:], state.past[:] = sent, wheel[:, 0] if self.lagging else 0.0, 0.0
        yaw_rate = np.tile(u[:, 5:6], self.preview_times.size)
        delta, after, _ = self.step(np.zeros(len(u)), u[:, :4], Preview(yaw_rate, yaw_rate), u[:, 4], state)
        return delta, after.wheel[:, None] if self.lagging else wheel

    def _initial_state(self, x: FloatArray, r: FloatArray, delta_prev: FloatArray, state: MPCState) -> InitialState:
        """What the QPs start from; before the first sample the command was what it is at the trigger."""
        sent = np.concatenate([state.sent[:, 1:], delta_prev[:, None]], axis=1)
        if np.isnan(sent).any():
            sent = np.where(np.isnan(sent), delta_prev[:, None], sent)
        m = self.condensed.B.shape[1]
        full = np.empty((x.shape[0], m))
        full[:, :4], full[:, 4:] = x, sent[:, :1]
        if self.lagging:
            full[:, 4] = np.where(np.isnan(state.wheel), delta_prev, state.wheel)
        r = lane(r, self.dt, self.age)
        past = np.empty((x.shape[0], 2, 0))
        if self.limits.window:
            now = self._acceleration(full, sent[:, 0], r)[:, None, None]
            past = np.concatenate([state.past, now.repeat(2, axis=1)], axis=2)
            if np.isnan(past).any():
                past = np.where(np.isnan(past), now, past)
        # arrays laid out in another way would have the kernel compiled once more
        return InitialState(full, np.ascontiguousarray(delta_prev), sent, np.ascontiguousarray(r), past)

    def _acceleration(self, x: FloatArray, u: FloatArray, r: FloatArray) -> FloatArray:
        """A of now with the command u [m/s^2]."""
        a, m = self.condensed.a, x.shape[1]
        result: FloatArray = np.sum(a[:, :m] * x, axis=1) + a[:, m] * u + a[:, m + 1] * r[:, 0]
        return result

    def _after(
        self, initial: InitialState, delta: FloatArray, state: MPCState
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Commands sent, the wheel's angle and accelerations that the next sample starts from."""
        arrived = initial.sent[:, 1] if self.limits.delay else delta
        wheel, past = state.wheel, state.past
        if self.lagging:
            A, B = self.condensed.A, self.condensed.B
            wheel = np.sum(A[:, 4, 4:] * initial.x[:, 4:], axis=1) + B[:, 4] * arrived
        if self.limits.window:
            past = initial.past[:, :, 1:].copy()
            past[:, 1, -1] = self._acceleration(initial.x, arrived, initial.r)
        return initial.sent, wheel, past

    def _solve(
        self,
        rows: IntArray,
        initial: InitialState,
        U: FloatArray,
        delta: FloatArray,
        w: FloatArray,
        multipliers: FloatArray,
        rung: npt.NDArray[np.int8],
        workspaces: Workspaces,
    ) -> list[_Call]:
        """Solve the QPs of some scenarios and enter what comes out; the calls."""
        from . import _mpc_kernel as kernel

        M, R = self.limits.start.size, self.limits.group.size
        C, y, low, high = np.empty((rows.size, R, M)), *(np.empty((rows.size, R)) for _ in range(3))
        kernel.assemble(self.condensed, self.limits, rows, initial, U, C, y, low, high)
        form = Form(self.limits)
        lower, upper = form.bounds(low - y, high - y)
        starts = form.split(multipliers[rows])
        calls = []
        for k, i in enumerate(rows.tolist()):
            if i not in workspaces:
                qp = form.qp(C[k])
                workspaces[i] = qp, make(self.solver, qp)
            qp, workspace = workspaces[i]
            answer = workspace.solve(lower[k], upper[k], starts[k])
            calls.append(_call(i, qp, lower[k], upper[k], answer))
            rung[i] = Rung.SOLVED
            if not calls[-1].usable:
                answer = make("daqp", qp).solve(lower[k], upper[k], np.zeros_like(starts[k]))
                calls.append(_call(i, qp, lower[k], upper[k], answer))
                rung[i] = Rung.OTHER_SOLVER
            if not calls[-1].usable:
                w[i], multipliers[i] = 0.0, 0.0
                saturated = min(max(delta[i], -self.limits.delta_max), self.limits.delta_max)
                step = self.limits.rate_step
                delta[i] = initial.prev[i] + min(max(saturated - initial.prev[i], -step), step)
                rung[i] = Rung.SATURATED
                continue
            w[i], multipliers[i] = form.join(answer)
            # the solver's rows at their bounds give the solution to rounding, if they prove themselves
            exact = not self.always_solve
            delta[i] = kernel.finish(self.limits, exact, kernel.Rows(C[k], y[k], low[k], high[k]), w[i], multipliers[i])
        return calls


class _Call(NamedTuple):
    """A solver call for the scenario at `place`."""

    place: int
    usable: bool
    iterations: int
    primal_residual: float
    dual_residual: float


def _call(place: int, qp: QP, low: FloatArray, high: FloatArray, answer: Answer) -> _Call:
    """What is recorded of one call of the solver: status, iterations, residuals."""
    if not answer.solved:
        return _Call(place, False, answer.iterations, np.nan, np.nan)
    value = qp.A @ answer.w
    primal = max(float(np.max(value - high)), float(np.max(low - value)), 0.0)
    dual = float(np.max(np.abs(answer.w + qp.q + answer.y @ qp.A)))
    return _Call(place, primal <= _ACCEPTED, answer.iterations, primal, dual)


_NONE: Final = np.zeros(0, dtype=np.int64)
_NO_CALLS: Final = SolverCalls(_NONE, _NONE, _NONE, np.zeros(0), np.zeros(0))


def _calls(calls: list[_Call]) -> SolverCalls:
    if not calls:
        return _NO_CALLS
    table = np.array(calls, dtype=np.float64).reshape(-1, 5)
    place, status, iterations = table[:, :3].T.astype(np.int64)
    return SolverCalls(place, status, iterations, table[:, 3], table[:, 4])
