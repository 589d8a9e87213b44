"""The law that `linear_mpc` turns into: one sweep over all scenarios a sample, a solver for the few that are left."""

from __future__ import annotations

import dataclasses
import enum
from typing import Final, NamedTuple, final

import numpy as np
import numpy.typing as npt

from controllers._mpc_condensing import Condensed, Given, Limits
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
    """The hard limits cannot be met, and were widened to what can be reached: `EventStatus.BEYOND_DELTA_MAX`."""
    OTHER_SOLVER = 4
    """The solver gave up, DAQP solved the QP."""
    SATURATED = 5
    """Nothing solved the QP: towards the saturated unconstrained command at the rate limit; counted as failed."""


_STATUS = np.zeros(len(Rung), dtype=np.int8)
"""`EventStatus` of each rung."""
_STATUS[Rung.RELAXED], _STATUS[Rung.SATURATED] = EventStatus.BEYOND_DELTA_MAX, EventStatus.SOLVER_FAILED


def lookahead(samples: int, dt: float, age: float) -> FloatArray:
    """Lookahead times for `lane`."""
    ahead = np.arange(samples + 1) * dt - age
    return np.asarray([0.0, dt, *np.maximum(ahead, 0.0)] if age else ahead, dtype=np.float64)


def lane(r: FloatArray, dt: float, age: float) -> FloatArray:
    """Yaw rate of the lane (n, samples + 1) from the moment on that the law sees, by a straight line before now."""
    if not age:
        return r
    behind = np.minimum(np.arange(r.shape[1] - 2) - age / dt, 0.0)
    result: FloatArray = r[:, 2:] + behind * (r[:, 1:2] - r[:, :1])
    return result


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
        kept = Workspaces({k: state.workspaces[i] for k, i in enumerate(rows.tolist()) if i in state.workspaces})
        own = (getattr(state, name)[rows] for name in ("multipliers", "slack", "rung", "sent", "wheel", "past"))
        multipliers, slack, rung, *actuator = own
        return law, MPCState(multipliers, slack, rung, _calls([]), kept, *actuator)

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
        given = self._given(x, preview.yaw_rate, delta_prev, state)
        before = (state.multipliers, state.slack)
        proves = not self.always_solve
        kernel.sweep(self.condensed, self.limits, proves, given, *before, U, delta, w, multipliers, how)

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
        slack = np.maximum(w[:, M:], 0.0)
        state = MPCState(multipliers, slack, rung, _calls(calls), workspaces, *self._after(given, delta, state))
        return delta, state, _STATUS[rung]

    def _given(self, x: FloatArray, r: FloatArray, delta_prev: FloatArray, state: MPCState) -> Given:
        """What the QPs start from; before the first sample the command was what it is at the trigger."""
        sent = np.column_stack([state.sent[:, 1:], delta_prev])
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
            past = np.concatenate([state.past, np.tile(now, (1, 2, 1))], axis=2)
            past = np.where(np.isnan(past), now, past)
        return Given(full, delta_prev, sent, np.ascontiguousarray(r), past)

    def _acceleration(self, x: FloatArray, u: FloatArray, r: FloatArray) -> FloatArray:
        """A of now with the command u [m/s^2]."""
        a, m = self.condensed.a, x.shape[1]
        result: FloatArray = np.sum(a[:, :m] * x, axis=1) + a[:, m] * u + a[:, m + 1] * r[:, 0]
        return result

    def _after(self, given: Given, delta: FloatArray, state: MPCState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Commands sent, the wheel's angle and accelerations that the next sample starts from."""
        arrived = given.sent[:, 1] if self.limits.delay else delta
        wheel, past = state.wheel, state.past
        if self.lagging:
            A, B = self.condensed.A, self.condensed.B
            wheel = np.sum(A[:, 4, 4:] * given.x[:, 4:], axis=1) + B[:, 4] * arrived
        if self.limits.window:
            past = given.past[:, :, 1:].copy()
            past[:, 1, -1] = self._acceleration(given.x, arrived, given.r)
        return given.sent, wheel, past

    def _solve(
        self,
        rows: IntArray,
        given: Given,
        U: FloatArray,
        delta: FloatArray,
        w: FloatArray,
        multipliers: FloatArray,
        rung: npt.NDArray[np.int8],
        workspaces: Workspaces,
    ) -> list[_Call]:
        """Solve the QPs of some scenarios and enter what comes out; the calls."""
        from controllers import _mpc_kernel as kernel

        M, R = self.limits.start.size, self.limits.group.size
        C, y, low, high = np.empty((rows.size, R, M)), *(np.empty((rows.size, R)) for _ in range(3))
        kernel.assemble(self.condensed, self.limits, rows, given, U, C, y, low, high)
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
                delta[i] = given.prev[i] + min(max(wanted - given.prev[i], -step), step)
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
