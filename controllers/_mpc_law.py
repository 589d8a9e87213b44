"""The law that `linear_mpc` turns into: one sweep over all scenarios a sample, a solver for the few that are left."""

from __future__ import annotations

import dataclasses
import enum
from typing import Final, NamedTuple, final

import numpy as np
import numpy.typing as npt

from controllers._mpc_condensing import Condensed, Limits
from controllers._mpc_solvers import QP, Answer, Form, Workspaces, make
from ldctoolkit import EventStatus, Preview, SolverCalls, SteeringLaw

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

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
    """The hard limits cannot be met, and were widened to what can be reached; counted as failed."""
    OTHER_SOLVER = 4
    """The solver gave up, DAQP solved the QP."""
    SATURATED = 5
    """Nothing solved the QP: towards the saturated unconstrained command at the rate limit; counted as failed."""


@dataclasses.dataclass(frozen=True)
class MPCState:
    """What `MPCLaw` carries from sample to sample; one row a scenario.

    Attributes
    ----------
    multipliers : (n, R)
        Of the last QP's rows, positive at an upper bound; 0 where no limit was active.
    slack : (n, 3)
        Of the last QP, by kind of soft limit, as a share of the limit.
    rung : (n,) int8
        `Rung` of the last command.
    calls : SolverCalls
        Of the last sample; status is 1 where the answer could be used, the residuals are the largest violation of a
        bound [rad, or share of a soft limit] and the largest |e + C' multipliers|.
    workspaces : Workspaces
        What solvers have allocated. No result depends on it.
    """

    multipliers: FloatArray
    slack: FloatArray
    rung: npt.NDArray[np.int8]
    calls: SolverCalls
    workspaces: Workspaces


@final
@dataclasses.dataclass(frozen=True)
class MPCLaw(SteeringLaw):
    """The condensed MPC of n scenarios.

    Attributes
    ----------
    condensed : Condensed
    limits : Limits
    solver : str
    always_solve : bool
    """

    condensed: Condensed
    limits: Limits
    solver: str
    always_solve: bool

    @property
    def horizon(self) -> int:
        """N."""
        return int(self.condensed.impulse.shape[1])

    @property
    def preview_times(self) -> FloatArray:
        """Now and the N samples ahead."""
        return np.asarray(np.arange(self.horizon + 1) * self.limits.dt, dtype=np.float64)

    def init(self, n: int) -> MPCState:
        """Nothing solved yet."""
        rows = self.limits.group.size
        return MPCState(
            multipliers=np.zeros((n, rows)),
            slack=np.zeros((n, 3)),
            rung=np.zeros(n, dtype=np.int8),
            calls=_calls([]),
            workspaces=Workspaces(),
        )

    def take(self, rows: IntArray, state: MPCState) -> tuple[MPCLaw, MPCState]:
        """Only some scenarios, each with what it has."""
        law = dataclasses.replace(self, condensed=self.condensed.take(rows))
        kept = Workspaces({k: state.workspaces[i] for k, i in enumerate(rows.tolist()) if i in state.workspaces})
        return law, MPCState(state.multipliers[rows], state.slack[rows], state.rung[rows], _calls([]), kept)

    def solver_calls(self, state: MPCState) -> SolverCalls:
        """Of the last sample: status 1 where the answer could be used, residuals as in `MPCState`."""
        return state.calls

    def step(
        self,
        t: FloatArray,
        x: FloatArray,
        preview: Preview,
        delta_prev: FloatArray,
        state: MPCState,
    ) -> tuple[FloatArray, MPCState, npt.NDArray[np.int8]]:
        """First command of the optimal plan, for every scenario."""
        from controllers import _mpc_kernel as kernel

        n, N, M = x.shape[0], self.horizon, self.limits.start.size
        U, delta, how = np.empty((n, N)), np.empty(n), np.empty(n, dtype=np.int8)
        w, multipliers = np.zeros((n, M + 3)), np.zeros_like(state.multipliers)
        given = (np.ascontiguousarray(x), np.ascontiguousarray(preview.yaw_rate), delta_prev)
        before = (state.multipliers, state.slack)
        proves = not self.always_solve
        kernel.sweep(self.condensed, self.limits, proves, *given, *before, U, delta, w, multipliers, how)

        rung = np.where(how == kernel.HELD, np.int8(Rung.HELD), np.int8(Rung.FREE))
        beyond = how == kernel.BEYOND
        if beyond.any():
            # widened to what can be reached, the limits leave one first command: back, as fast as the rate allows
            delta[beyond] = (delta_prev - np.sign(delta_prev) * self.limits.rate_step)[beyond]
            rung[beyond] = Rung.RELAXED
        calls: list[_Call] = []
        workspaces = state.workspaces
        rows = np.flatnonzero(how == kernel.OPEN)
        if rows.size:
            workspaces = Workspaces(workspaces)
            calls = self._solve(rows, given, U, delta, w, multipliers, rung, workspaces)
        state = MPCState(multipliers, np.maximum(w[:, M:], 0.0), rung, _calls(calls), workspaces)
        status = np.where((rung == Rung.RELAXED) | (rung == Rung.SATURATED), EventStatus.SOLVER_FAILED, EventStatus.OK)
        return delta, state, status.astype(np.int8)

    def _solve(
        self,
        rows: IntArray,
        given: tuple[FloatArray, FloatArray, FloatArray],
        U: FloatArray,
        delta: FloatArray,
        w: FloatArray,
        multipliers: FloatArray,
        rung: npt.NDArray[np.int8],
        workspaces: Workspaces,
    ) -> list[_Call]:
        """Solve the QPs of some scenarios and enter what comes out; the calls."""
        from controllers import _mpc_kernel as kernel

        x, r, prev = given
        M, R = self.limits.start.size, self.limits.group.size
        C, y, low, high = np.empty((rows.size, R, M)), *(np.empty((rows.size, R)) for _ in range(3))
        kernel.assemble(self.condensed, self.limits, rows, x, r, prev, U, C, y, low, high)
        form = Form(self.limits)
        lower, upper = form.bounds(low - y, high - y)
        starts = form.split(multipliers[rows])
        calls = []
        for k, i in enumerate(rows.tolist()):
            workspace = workspaces.get(i)
            if workspace is None:
                workspace = workspaces[i] = make(self.solver, form.qp(C[k]))
            answer = workspace.solve(lower[k], upper[k], starts[k])
            calls.append(_call(i, form.qp(C[k]), lower[k], upper[k], answer))
            rung[i] = Rung.SOLVED
            if not calls[-1].usable:
                answer = make("daqp", form.qp(C[k])).solve(lower[k], upper[k], np.zeros_like(starts[k]))
                calls.append(_call(i, form.qp(C[k]), lower[k], upper[k], answer))
                rung[i] = Rung.OTHER_SOLVER
            if not calls[-1].usable:
                w[i], multipliers[i] = 0.0, 0.0
                wanted = min(max(delta[i], -self.limits.delta_max), self.limits.delta_max)
                step = self.limits.rate_step
                delta[i] = prev[i] + min(max(wanted - prev[i], -step), step)
                rung[i] = Rung.SATURATED
                continue
            w[i], multipliers[i] = form.join(answer)
            # the solver's rows at their bounds give the solution to rounding, if they prove themselves
            exact = not self.always_solve
            delta[i] = kernel.finish(self.limits, exact, C[k], y[k], low[k], high[k], w[i], multipliers[i])
        return calls


class _Call(NamedTuple):
    """A solver call for the scenario at `place`."""

    place: int
    usable: bool
    iterations: int
    primal_residual: float
    dual_residual: float


def _call(place: int, qp: QP, low: FloatArray, high: FloatArray, answer: Answer) -> _Call:
    """The record of an answer."""
    if not answer.solved:
        return _Call(place, False, answer.iterations, np.nan, np.nan)
    value = qp.A @ answer.w
    primal = max(float(np.max(value - high)), float(np.max(low - value)), 0.0)
    dual = float(np.max(np.abs(answer.w + qp.q + answer.y @ qp.A)))
    return _Call(place, primal <= _ACCEPTED, answer.iterations, primal, dual)


def _calls(calls: list[_Call]) -> SolverCalls:
    table = np.array(calls, dtype=np.float64).reshape(-1, 5)
    place, status, iterations = table[:, :3].T.astype(np.int64)
    return SolverCalls(place, status, iterations, table[:, 3], table[:, 4])
