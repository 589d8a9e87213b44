"""Nonlinear model predictive control on the bicycle with saturating tyres.

At every sample it minimises, over the next N commands, the sum of x~' Q x~ + r_delta u~^2 with the terminal cost
x~_N' P x~_N, subject to the nonlinear bicycle (Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.3) with
the Magic Formula (Pacejka, *Tyre and Vehicle Dynamics*, section 4.3) at friction mu and at the scenario's constant
speed; x~ and u~ are deviations from the nonlinear bicycle's steady cornering at the lane yaw rate previewed for that
sample, P solves the Riccati equation of the linear plant. Hard limits: |u| <= delta_max and
|u_j - u_(j-1)| <= rate_max dt, u_(-1) the previous command. Soft limits, held by exact penalties: lateral acceleration,
lateral jerk, lane corridor. Positive to the left (ISO 8855), radians.

Method, failed solves, delay and lag: `docs/explanation/mpc.md`; steps of the method: `_nmpc_solver`.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus, Preview, SolverCalls, SteeringLaw
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant

from ._mpc_condensing import SHARES, WINDOW, MPCDesign, jerk_window, lane, lookahead
from ._nmpc_solver import SoftLimits, Workspace, pack, steady_cornering, workspace
from .riccati import regulator

_SCALES = (1.0, 10.0, 0.1)  # units of the soft limits' violations: m/s^2, m/s^3, m
_SPEED = 8  # place of v in a column


@final
@dataclasses.dataclass(frozen=True)
class NonlinearMPC(MPCDesign):
    """Nonlinear MPC, solved to convergence at every sample.

    Examples
    --------
    >>> NonlinearMPC(horizon=10, mu=0.3).delta_max
    0.1
    """

    name: ClassVar[str] = "nonlinear_mpc"
    title: ClassVar[str] = "Nonlinear MPC"
    batch: ClassVar[int] = 20  # tens of milliseconds a scenario: about a second of work

    mu: float = gain(1.0, unit="1", lower=0.05, upper=2.0, description="friction coefficient of the law's tyres")

    def prepare(self, plant: Plant) -> NonlinearMPCLaw:
        """Solve the Riccati equation and gather each scenario's numbers."""
        lq = regulator(plant, self.q, self.r_delta)
        columns = pack(plant, self.mu, self.q, self.r_delta, lq.P, lq.K, self.rate_max * plant.dt)
        return NonlinearMPCLaw(design=self, plant=plant, columns=columns, soft=_soft_limits(self, plant.dt))


def _soft_limits(design: NonlinearMPC, dt: float) -> SoftLimits | None:
    """Rows of the limits that are on, each in units of its scale."""
    N, (window, share) = design.horizon, jerk_window(dt)
    # of accelerations before and after each sample, those of the past first, and of e_y
    before_sample, after_sample, offset = np.split(
        np.eye(2 * window + 3 * N + 1), [window + N + 1, 2 * (window + N) + 1]
    )
    a = [after_sample[window:], before_sample[window + 1 :]]
    past = [after_sample[:N], before_sample[1 : N + 1]]
    if share:
        past = [(1.0 - share) * after_sample[k : k + N] + share * before_sample[k + 1 : k + N + 1] for k in (0, 1)]
    blocks = a, [(now - before) / WINDOW for now, before in zip(a, past, strict=True)], [offset]
    limits = zip(design.soft_limits, blocks, strict=True)
    on = [(k, limit, np.concatenate(parts)) for k, (limit, parts) in enumerate(limits) if limit > 0]
    if not on:
        return None
    rows = np.concatenate([part / _SCALES[k] for k, _, part in on])
    bound = np.concatenate([np.full(len(part), limit / _SCALES[k]) for k, limit, part in on])
    # far above what a unit of violation can be worth to the cost
    weight = 1e3 * (design.q_y + design.q_psi * 1e-2 + design.r_delta * 1e-2)
    weights = np.concatenate([np.full(len(part), weight * SHARES[k]) for k, _, part in on])
    before, after, decided = np.split(rows, [window + 1, window + N + 1], axis=1)
    before = np.concatenate([before, decided[:, :window]], axis=1)
    return SoftLimits(np.concatenate([decided[:, window : window + N], after, decided[:, window + N :]], axis=1),
                      bound, weights, before)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class NonlinearMPCState:
    """What one step leaves for the next, a row for each scenario."""

    U: FloatArray  # (n, N) [rad] Last commands planned
    has_plan: BoolArray  # (n,) Whether they are a solution
    # (n,) 1 to 3, the rung of the ladder that the last command came from; 0 before the first
    rung: npt.NDArray[np.int8]
    iterations: IntArray  # (n,) Of the last solve
    residual: FloatArray  # (n,) [rad] Largest change of a command in its last iteration
    cost: FloatArray  # (n,) Of the last plan: the sum of weighted squares, without penalties
    # (n, delay + 1) [rad] The last commands, the oldest first; this and what follows is NaN before the first sample
    sent: FloatArray
    # (n, 2, window) [m/s^2] Lateral acceleration less that of the lane before and after each of the last samples
    past: FloatArray


@final
@dataclasses.dataclass(frozen=True)
class NonlinearMPCLaw(SteeringLaw):
    """The nonlinear MPC of n scenarios."""

    design: NonlinearMPC
    plant: Plant
    columns: FloatArray  # (n, k) Each scenario's numbers, `LAYOUT` of the solver
    soft: SoftLimits | None

    @property
    def preview_times(self) -> FloatArray:
        """Samples from what is seen on, to the N-th after that at which a command arrives; none before now."""
        return lookahead(self._delay + self.design.horizon, self.plant.dt, self.plant.age)

    @property
    def _delay(self) -> int:
        """Samples until a command steers."""
        return round((self.plant.delay + self.plant.lag) / self.plant.dt)

    def init(self, n: int) -> NonlinearMPCState:
        """No plan yet."""
        zero = np.zeros(n)
        return NonlinearMPCState(
            U=np.zeros((n, self.design.horizon)),
            has_plan=np.zeros(n, dtype=np.bool_),
            rung=np.zeros(n, dtype=np.int8),
            iterations=np.zeros(n, dtype=np.int64),
            residual=zero,
            cost=zero.copy(),
            sent=np.full((n, self._delay + 1), np.nan),
            past=np.full((n, 2, jerk_window(self.plant.dt)[0]), np.nan),
        )

    def take(self, rows: IntArray, state: NonlinearMPCState) -> tuple[NonlinearMPCLaw, NonlinearMPCState]:
        """Only some scenarios, each with its last plan."""
        plant = dataclasses.replace(self.plant, v=self.plant.v[rows])
        part = NonlinearMPCState(*(getattr(state, f.name)[rows] for f in dataclasses.fields(state)))
        return dataclasses.replace(self, plant=plant, columns=self.columns[rows]), part

    def solver_calls(self, state: NonlinearMPCState) -> SolverCalls:
        """One call a scenario; status is its rung, the dual residual the last change of a command [rad]."""
        n = state.rung.size
        return SolverCalls(
            np.arange(n), state.rung.astype(np.int64), state.iterations, np.full(n, np.nan), state.residual
        )

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: NonlinearMPCState
    ) -> tuple[FloatArray, NonlinearMPCState, npt.NDArray[np.int8]]:
        """First command of the optimal plan, for every scenario."""
        d, N, n = self.design, self.design.horizon, delta_prev.size
        after = NonlinearMPCState(*(getattr(state, f.name).copy() for f in dataclasses.fields(state)))
        delta = np.empty(n)
        after.sent[:] = np.column_stack([state.sent[:, 1:], delta_prev])
        after.sent[:] = np.where(np.isnan(after.sent), delta_prev[:, None], after.sent)
        lane_rate = lane(preview.yaw_rate, self.plant.dt, self.plant.age)
        r = lane_rate[:, self._delay :]
        steady = steady_cornering(self.plant, d.mu, np.concatenate([r, 0.5 * (r[:, :-1] + r[:, 1:])], axis=1))
        e_ref, u_ref = steady.e_psi[:, : N + 1], steady.delta[:, N + 1 :]
        rate = d.rate_max * self.plant.dt
        reach = np.outer(np.ones(n), np.arange(1, N + 1) * rate)
        high = np.maximum(d.delta_max, delta_prev[:, None] - reach)
        low = np.minimum(-d.delta_max, delta_prev[:, None] + reach)
        relaxed = np.abs(delta_prev) > d.delta_max + rate
        work = workspace(N, self.soft is not None)
        for i in range(n):
            work.x_0[:], work.delta_prev[0], work.c[:] = x[i], delta_prev[i], self.columns[i]
            self._begin(work, lane_rate[i], after, i)
            work.r[:], work.e_ref[:], work.u_ref[:] = r[i], e_ref[i], u_ref[i]
            work.low[:], work.high[:] = low[i], high[i]
            solution = work.solve(np.append(state.U[i, 1:], state.U[i, -1]) if state.has_plan[i] else None, self.soft)
            command = float(solution.U[0])
            if solution.solved:
                after.U[i] = solution.U
                after.rung[i] = 2 if relaxed[i] else 1
            else:
                after.rung[i] = 3
                K = self.columns[i, -5:-1]
                command = float(u_ref[i, 0] - K @ work.x_0 + K[2] * e_ref[i, 0])
                command = min(max(command, low[i, 0]), high[i, 0]) if np.isfinite(command) else 0.0
            after.has_plan[i] = solution.solved
            after.iterations[i], after.residual[i], after.cost[i] = solution.iterations, solution.step, solution.cost
            command = min(max(command, low[i, 0]), high[i, 0])
            # a sum with 0 turns -0 into 0
            delta[i] = min(max(command, delta_prev[i] - rate), delta_prev[i] + rate) + 0.0
            if not self._delay:
                after.past[i, 1, -1] = self._added(work, delta[i], r[i])
        status = np.array([EventStatus.OK, EventStatus.OK, EventStatus.BEYOND_DELTA_MAX, EventStatus.SOLVER_FAILED])
        return delta, after, status[after.rung].astype(np.int8)

    def _added(self, work: Workspace, u: float, r: FloatArray) -> float:
        """Lateral acceleration less that of the lane at the workspace's state, with the command u."""
        return float(work.predict(u, r[0], r[1])[1] - work.c[_SPEED] * r[0])

    def _begin(self, work: Workspace, r: FloatArray, after: NonlinearMPCState, i: int) -> None:
        """Take the workspace's state to where the next command steers, and known accelerations into its `offset`."""
        sent, window, v = after.sent[i], after.past.shape[2], work.c[_SPEED]
        now = self._added(work, sent[0], r)
        past = np.where(np.isnan(after.past[i]), now, after.past[i])
        before, after_command = [*past[0], now], [*past[1]]
        for k, u in enumerate(sent[1:]):
            x, a_0, a_1 = work.predict(u, r[k], r[k + 1])
            after_command.append(a_0 - v * r[k])
            before.append(a_1 - v * r[k + 1])
            work.x_0[:] = x
        after.past[i] = before[1 : window + 1], [*after_command, now][1 : window + 1]
        if self.soft is not None:
            N, k = self.design.horizon, len(sent) - 1
            bend = v * np.concatenate([r[k : k + N], r[k + 1 :], np.zeros(N)])
            work.offset = self.soft.before @ np.array(before[k:] + after_command[k:]) - self.soft.rows @ bend
