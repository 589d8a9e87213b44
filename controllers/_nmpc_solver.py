"""Sequential quadratic programming for one predictive controller's problem at a time.

Unknowns are the commands U = (u_0 .. u_(N-1)) and, by multiple shooting, the states Z = (z_1 .. z_N); the gaps
d_j = F(z_j, u_j) - z_(j+1) are zero at the solution. The functions are those of `_nmpc_model`, compiled once.

Each iteration condenses the linearised problem to the N commands and solves the QP with DAQP. The Hessian is that of
the Lagrangian, or Gauss-Newton's; where the QP is not convex, it is made so. A full step of commands and states is
taken if it lowers the merit function J + soft penalties + nu sum |gaps|; if not, the gaps are closed by driving the
model with a shortened step of the commands, until the merit falls. Hard limits are linear in the commands, so that
every iterate meets them. With `move_blocks` the commands are held over each move, and the QP has the moves alone.
"""

import dataclasses
import functools
import threading
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.casadi_code import compiled

from ._nmpc_model import Formulation

MAX_ITERATIONS: Final = 60
_STEP_NEWTON: Final = 1e-5  # [rad] the error after a full Newton step is the square of it, up to a factor
_STEP_LINEAR: Final = 1e-7  # [rad] after a step with another Hessian
_STEP_LAST: Final = 1e-6  # [rad] where the merit cannot fall any more
_GAP: Final = 1e-6
_PRIMAL: Final = 1e-10
_HELD: Final = 1e-8  # [rad] a limit this close is active
_MEMORY: Final = 4  # iterations whose merit a full step may come back to, so that rows that bend do not
# shorten it (the watchdog), and for how many iterations it may
_PATIENCE: Final = 15
_BLIND: Final = 3  # full steps taken where the merit of soft limits cannot fall


@dataclasses.dataclass(frozen=True)
class SoftLimits:
    """Limits that a penalty holds: low <= y + offset <= high for rows y that are linear in the outputs, each violation
    v costs linear v + quadratic v^2/2.
    """

    rows: FloatArray  # (m, no N)
    # (m,)
    offset: FloatArray
    low: FloatArray
    high: FloatArray
    linear: FloatArray
    quadratic: FloatArray

    def penalty(self, values: FloatArray) -> float:
        """Of values of the rows."""
        v = np.maximum(np.maximum(values - self.high, self.low - values), 0.0)
        return float(self.linear @ v + 0.5 * (self.quadratic @ (v * v)))


@dataclasses.dataclass
class Solution:
    """What became of one solve."""

    U: FloatArray  # (N,) [rad] Commands; they meet the limits whatever `solved` says
    Z: FloatArray  # (N, nz) States that they lead to
    solved: bool
    iterations: int
    step: float  # [rad] Largest change of a command in the last iteration
    cost: float  # Of the plan, without the penalties


class _Call:
    """A CasADi function on arrays that stay where they are."""

    def __init__(self, function: Any, inputs: list[FloatArray]) -> None:
        self.outputs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
        self._references = function, inputs, function.buffer()
        buffer, self.run = self._references[2]
        for k, array in enumerate(inputs):
            if array.size != function.nnz_in(k):
                raise ValueError(f"{function.name()}: input {k} has {array.size} numbers, not {function.nnz_in(k)}")
            buffer.set_arg(k, array.data)
        for k, array in enumerate(self.outputs):
            buffer.set_res(k, array.data)


Measure = tuple[float, float, FloatArray | None, float]  # cost, the same with penalties, soft rows, sum of gaps


class Workspace:
    """Arrays and functions for one horizon of a formulation, used by one thread. A solve starts from its arguments
    alone; nothing of the solve before is used.
    """

    def __init__(self, form: Formulation, N: int, starts: IntArray | None = None) -> None:
        self.N, self.form = N, form
        nz, no, np_ = form.size, form.outputs, form.samples
        self.z_0, self.delta_prev, self.c = np.zeros(nz), np.zeros(1), np.zeros(form.layout.size)
        self.P = np.zeros((N, np_))
        self._sample = np.zeros(1), np.zeros(np_)
        self.low, self.high, self.low_change, self.high_change = (np.zeros(N) for _ in range(4))
        self.guess, self.share = np.zeros(N), np.zeros(1)
        self.U, self.Z = np.zeros(N), np.zeros(nz * N)
        self.U_try, self.Z_try = np.zeros(N), np.zeros(nz * N)
        self.M = np.zeros((N, no))
        self.soft: SoftLimits | None = None
        problem = [self.z_0, self.P, self.c]
        predict, roll, value, linearise, gradient, limits = _functions(form, N)
        self._predict = _Call(predict, [self.z_0, *self._sample, self.c])
        bounds = [self.low, self.high, self.low_change, self.high_change]
        self._roll = _Call(roll, [self.z_0, self.guess, self.share, self.delta_prev, self.P, *bounds, self.c])
        self._value = _Call(value, [self.Z_try, self.U_try, *problem])
        self._linearise = _Call(linearise, [self.Z, self.U, *problem, self.M])
        self._gradient = _Call(gradient, [self.Z_try, self.U_try, *problem])
        self._limits = _Call(limits, [self.P, self.c])
        out = self._linearise.outputs
        self.H, self.T = out[0].reshape(N, N), out[2].reshape(nz * N, N)
        self.g, self.t, self.J_t, self.slope = out[1], out[3], out[4], out[5]
        self.Y, self.y_t = out[6].reshape(no * N, N) if no else np.zeros((0, N)), out[7]
        # free moves: the commands are `self.held` times them
        self._starts = None if starts is None or starts.size == N else starts
        self.first = np.arange(N) if self._starts is None else self._starts
        self.held = np.eye(self.first.size)[np.searchsorted(self.first, np.arange(N), side="right") - 1]
        moves = self.first.size
        self._change = np.diff(np.eye(moves), axis=0, prepend=0.0)
        self._hard = np.vstack([np.eye(moves), self._change])
        self._active = np.zeros(2 * moves, dtype=np.bool_)

    def first_move(self) -> float:
        """First command near straight driving, where no limit is active: from dU = -H^-1 g of the plan that is zero."""
        self.U[:], self.Z[:], self.M[:] = 0.0, 0.0, 0.0
        self._linearise.run()
        return -float(np.linalg.solve(self.held.T @ self.H @ self.held, self.held.T @ self.g)[0])

    def predict(self, u: float, p: FloatArray) -> tuple[FloatArray, float, float]:
        """Z after a sample with the command u; a_y just after it and at the end."""
        self._sample[0][0], self._sample[1][:] = u, p
        self._predict.run()
        z, a_0, a_1 = self._predict.outputs
        return z, float(a_0[0]), float(a_1[0])

    def limits(self) -> list[FloatArray]:
        """Bounds of the commands and of their changes (N,), then bounds and weights of the soft rows (ns, N)."""
        self._limits.run()
        out = self._limits.outputs
        return [*out[:4], *(part.reshape(self.N, -1).T for part in out[4:])]

    def unsteered(self) -> tuple[FloatArray, FloatArray]:
        """Gradient of the cost on the commands, and outputs (no N,), at commands of 0."""
        self.share[0], self.guess[:] = 0.0, 0.0
        self.low[:], self.high[:], self.low_change[:], self.high_change[:] = -np.inf, np.inf, -np.inf, np.inf
        self._drive()
        self._gradient.run()
        self._value.run()
        return self._gradient.outputs[0], self._value.outputs[2].reshape(self.N, -1).T.ravel()

    def curvature(self) -> tuple[FloatArray, FloatArray]:
        """Hessian (N, N) of the cost on the commands, and slopes (no N, N) of the outputs, at commands of 0."""
        self.U[:], self.Z[:], self.M[:] = 0.0, 0.0, 0.0
        self._linearise.run()
        return self.H, self.Y

    def solve(self, warm: FloatArray | None, most: int = 0) -> Solution:
        """Solve the problem in the input arrays, to convergence or in `most` iterations."""
        self.M[:], self._active[:] = 0.0, False
        J, merit, rows, _ = self._start(warm)
        step, gap = np.inf, 0.0
        recent, blind = [merit], _BLIND
        for iteration in range(1, (most or MAX_ITERATIONS) + 1):
            direction = self._direction(rows)
            if direction is None:
                return self._end(False, iteration, step, J)
            dU, row_change, newton = direction
            step = float(np.max(np.abs(dU)))
            if self.form.quadratic and self.soft is None and newton:  # the quadratic program was the whole problem
                J, *_ = self._lift(dU)
                self.U[:], self.Z[:] = self.U_try, self.Z_try
                return self._end(True, iteration, step, J)
            pull = self.J_t[0] + self.g @ dU + 0.5 * dU @ (self.H @ dU)
            if self.soft is not None and rows is not None and row_change is not None:
                pull += self.soft.penalty(rows + row_change) - self.soft.penalty(rows)
            nu = 2.0 * self.slope[0] + 1e-6
            before = merit + nu * gap
            drop = max(nu * gap - pull, 0.0)
            trial = self._lift(dU)
            high = max(before, *recent) if iteration <= _PATIENCE else before
            allowed = high - 1e-4 * drop + 1e-12 * (1.0 + abs(before))
            full = trial[1] + nu * trial[3] <= allowed
            if not full:
                shorter = self._shorten(dU, before, drop)
                if shorter is None and gap == 0.0:
                    # the merit cannot fall: rounding, if the step is small, or soft rows whose bend the QP has not seen
                    if step <= _STEP_LAST or self.soft is None or blind == 0:
                        return self._end(step <= _STEP_LAST, iteration, step, J)
                    blind -= 1
                    shorter = self._lift(dU)
                trial = shorter or self._close()
            J, merit, rows, gap = trial
            self.U[:], self.Z[:] = self.U_try, self.Z_try
            recent = [*recent[1 - _MEMORY :], merit + nu * gap]
            if gap <= _GAP and full and step <= (_STEP_NEWTON if newton else _STEP_LINEAR):
                return self._end(True, iteration, step, self._close()[0])
        if most:  # real-time iteration: a plan that is better than the one before
            return self._end(True, most, step, self._close()[0])
        return self._end(step <= _STEP_LAST and gap <= _GAP, MAX_ITERATIONS, step, J)

    def _close(self) -> Measure:
        """The same commands without gaps."""
        self.share[0], self.guess[:] = 0.0, self.U
        self._drive()
        return (*self._measure()[:3], 0.0)

    def _lift(self, dU: FloatArray) -> Measure:
        """The full step of commands and states."""
        np.add(self.U, dU, out=self.U_try)
        self.Z_try[:] = self.Z + self.t + self.T @ dU
        return self._measure()

    def _end(self, solved: bool, iterations: int, step: float, J: float) -> Solution:
        good = solved and bool(np.isfinite(self.U).all())
        return Solution(self.U.copy(), self.Z.reshape(self.N, -1).copy(), good, iterations, step, J)

    def _start(self, warm: FloatArray | None) -> Measure:
        """The better of the warm start and the LQR, both inside the limits and driven by the model."""
        self.share[0] = 1.0
        self._drive()
        if self._starts is not None:
            self._drive_held(self.U_try.copy())
        best = self._measure()
        self.U[:], self.Z[:] = self.U_try, self.Z_try
        if warm is not None:
            self._drive_held(warm)
            trial = self._measure()
            if trial[1] <= best[1] or not np.isfinite(best[1]):
                best = trial
                self.U[:], self.Z[:] = self.U_try, self.Z_try
        return best

    def _drive_held(self, commands: FloatArray) -> None:
        """Drive the model with commands that are held over each move."""
        self.share[0], self.guess[:] = 0.0, commands
        if self._starts is not None:
            command = float(self.delta_prev[0])
            for first, last in zip(self._starts, [*self._starts[1:], self.N], strict=True):
                wanted = min(max(commands[first], self.low[first:last].max()), self.high[first:last].min())
                command = min(max(wanted, command + self.low_change[first]), command + self.high_change[first])
                self.guess[first:last] = command
        self._drive()

    def _drive(self) -> None:
        self._roll.run()
        self.U_try[:], self.Z_try[:] = self._roll.outputs

    def _measure(self) -> Measure:
        """Of the trial."""
        self._value.run()
        J, gap, outputs = self._value.outputs
        if self.soft is None:
            return float(J[0]), float(J[0]), None, float(gap[0])
        rows = self.soft.rows @ outputs.reshape(self.N, -1).T.ravel() + self.soft.offset
        return float(J[0]), float(J[0]) + self.soft.penalty(rows), rows, float(gap[0])

    def _shorten(self, dU: FloatArray, before: float, drop: float) -> Measure | None:
        """The first shortened step, driven by the model, that lowers the merit; None if there is none."""
        start = self.U.copy()
        self.share[0] = 0.0
        length = 1.0
        for _ in range(12):
            self.guess[:] = start + length * dU
            self._drive()
            trial = self._measure()
            if trial[1] < before - 1e-4 * length * drop:
                return trial[0], trial[1], trial[2], 0.0
            length *= 0.5
        return None

    def _direction(self, rows: FloatArray | None) -> tuple[FloatArray, FloatArray | None, bool] | None:
        """Solution of the QP, the change of the soft rows with it, whether the step is Newton's; None if unsolved."""
        self._linearise.run()
        if not (np.isfinite(self.g).all() and np.isfinite(self.H).all()):
            return None
        H = self.H if self._starts is None else self.held.T @ self.H @ self.held
        dU, change, active = self._qp(H, rows)
        if dU is not None:
            self._active = active
            return dU, change, True
        # not convex: stiffen the rows that are active here and were so in the last QP, which changes no solution
        # on them, and what is left of negative curvature
        low, high = self._bounds()
        held = self._active & ((np.abs(low) <= _HELD) | (np.abs(high) <= _HELD))
        C = self._hard[held]
        stiff = H + float(np.abs(H).max()) * (C.T @ C)
        values, vectors = np.linalg.eigh(0.5 * (stiff + stiff.T))
        floor = 1e-8 * float(np.abs(values).max())
        newton = bool(values[0] > floor)
        if not newton:
            stiff = (vectors * np.maximum(np.abs(values), floor)) @ vectors.T
        dU, change, active = self._qp(stiff, rows)
        self._active = active
        return None if dU is None else (dU, change, newton)

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """How far each angle and each change may go down and up."""
        turn = np.diff(self.U, prepend=self.delta_prev)
        first = self.first
        low = np.maximum.reduceat(self.low - self.U, first), (self.low_change - turn)[first]
        high = np.minimum.reduceat(self.high - self.U, first), (self.high_change - turn)[first]
        return np.concatenate(low), np.concatenate(high)

    def _qp(self, H: FloatArray, rows: FloatArray | None) -> tuple[FloatArray | None, FloatArray | None, BoolArray]:
        soft = self.soft
        g = self.g if self._starts is None else self.held.T @ self.g
        low, high = self._bounds()
        if soft is None or rows is None:
            moves, multipliers = quadratic_program(H, g, self._change, low, high)
        else:
            S = soft.rows @ self.Y
            now = rows + soft.rows @ self.y_t
            C = np.concatenate([self._change, S if self._starts is None else S @ self.held])
            low, high = np.concatenate([low, soft.low - now]), np.concatenate([high, soft.high - now])
            moves, multipliers = quadratic_program(H, g, C, low, high, np.stack([soft.linear, soft.quadratic]))
        if moves is None:
            return None, None, self._active
        dU = moves if self._starts is None else self.held @ moves
        hard = self._active.size
        active = multipliers[:hard] != 0.0
        if soft is None or rows is None:
            return dU, None, active
        self.M[:] = (multipliers[hard:] @ soft.rows).reshape(-1, self.N).T
        return dU, now - rows + S @ dU, active


def quadratic_program(
    H: FloatArray, g: FloatArray, C: FloatArray, low: FloatArray, high: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray | None, FloatArray]:
    """Minimiser of d'H d/2 + g'd for low <= (d, C d) <= high, None if unsolved, and multipliers.

    With weights (2, R) of v and v^2/2 the last R rows are soft.
    """
    import daqp

    if weights is None:
        sense = np.zeros(high.size, dtype=np.int32)
        moves, _, flag, info = daqp.solve(H, g, C, high, low, sense, primal_tol=_PRIMAL, eps_prox=0.0)
    else:
        hard = high.size - weights.shape[1]
        sense = np.repeat(np.array([0, 8], dtype=np.int32), [hard, weights.shape[1]])
        model = daqp.Model()
        model.settings = {"primal_tol": _PRIMAL, "eps_prox": 0.0}
        if model.setup(H, g, C, high, low, sense)[0] < 0:
            return None, g
        linear, curve = np.ones(high.size), np.ones(high.size)
        linear[hard:], curve[hard:] = weights[0], 1.0 / weights[1]
        model.soft_weights(rho_l=curve, rho_u=curve, w_l=linear, w_u=linear)
        moves, _, flag, info = model.solve()
    return (moves if flag >= 1 and np.isfinite(moves).all() else None), info["lam"]


def reachable(
    low: FloatArray, high: FloatArray, low_change: FloatArray, high_change: FloatArray, delta_prev: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Limits (n, N) widened to what the rate can reach from a command before; whether the first had to be."""
    reach_low = delta_prev[:, None] + np.cumsum(low_change, axis=-1)
    reach_high = delta_prev[:, None] + np.cumsum(high_change, axis=-1)
    beyond = (high[:, 0] < reach_low[:, 0]) | (low[:, 0] > reach_high[:, 0])
    return np.minimum(low, reach_high), np.maximum(high, reach_low), beyond


@functools.lru_cache(maxsize=32)
def _functions(form: Formulation, N: int) -> tuple[Any, ...]:
    return compiled(tuple(form.program(N)), f"{form.structure.controller.name}_{N}")  # type: ignore[attr-defined]


_LOCAL = threading.local()
_KEPT: Final = 32  # workspaces of a thread


def workspace(form: Formulation, N: int, starts: IntArray | None = None) -> Workspace:
    """Workspace of the calling thread for a formulation and a horizon."""
    workspaces: dict[Any, Workspace] = _LOCAL.__dict__.setdefault("workspaces", {})
    key = form, N, None if starts is None else starts.tobytes()
    if key not in workspaces:
        if len(workspaces) >= _KEPT:
            workspaces.pop(next(iter(workspaces)))
        workspaces[key] = Workspace(form, N, starts)
    return workspaces[key]
