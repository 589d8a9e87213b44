"""Sequential quadratic programming for one nonlinear MPC problem at a time.

Each iteration condenses the linearised problem to the N commands (`linearise` of the program) and solves the QP with
DAQP. The Hessian is that of the Lagrangian; where the QP is then not convex, Gauss-Newton's. A full step of
commands and states is taken if it lowers the merit function J + soft penalties + nu sum |gaps|; if not, the gaps are
closed by driving the model with a shortened step of the commands, until the merit falls. Hard limits are linear in
the commands, so that every iterate meets them.
"""

from __future__ import annotations

import dataclasses
import functools
import threading
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from controllers._nmpc_compile import compiled
from controllers._nmpc_model import SIZE
from controllers._nmpc_program import build

FloatArray = npt.NDArray[np.float64]

MAX_ITERATIONS: Final = 40
_STEP_NEWTON: Final = 1e-5  # [rad] the error after a full Newton step is the square of it, up to a factor
_STEP_LINEAR: Final = 1e-9  # [rad] after a Gauss-Newton or shortened step
_GAP: Final = 1e-6
_PRIMAL: Final = 1e-10


@dataclasses.dataclass(frozen=True)
class SoftLimits:
    """Limits that a penalty holds: w v + w v^2/2 for each violation v, in units of a scale.

    The rows are linear in y = (a_y just after each of N commands, a_y at each sample's end, e_y there).

    Attributes
    ----------
    rows : (m, 3 N)
    bound : (m,)
    before : (m,)
        Weight of a_y just before the first command.
    weight : float
        w.
    """

    rows: FloatArray
    bound: FloatArray
    before: FloatArray
    weight: float

    @property
    def size(self) -> int:
        """m."""
        return int(self.bound.size)

    def penalty(self, values: FloatArray) -> float:
        """Of values of the rows."""
        v = np.maximum(np.abs(values) - self.bound, 0.0)
        return float(self.weight * (v.sum() + 0.5 * (v @ v)))


@dataclasses.dataclass
class Solution:
    """What became of one solve.

    Attributes
    ----------
    U : (N,) [rad]
        Commands; they meet the limits whatever `solved` says.
    solved : bool
    iterations : int
    step : float [rad]
        Largest change of a command in the last iteration.
    cost : float
        Sum of the weighted squares, without the penalties.
    """

    U: FloatArray
    solved: bool
    iterations: int
    step: float
    cost: float


class _Call:
    """A CasADi function on arrays that stay where they are."""

    def __init__(self, function: Any, inputs: list[FloatArray]) -> None:
        self.outputs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
        self._kept = function, inputs, function.buffer()
        buffer, self.run = self._kept[2]
        for k, array in enumerate(inputs):
            if array.size != function.nnz_in(k):
                raise ValueError(f"{function.name()}: input {k} has {array.size} numbers, not {function.nnz_in(k)}")
            buffer.set_arg(k, memoryview(array))
        for k, array in enumerate(self.outputs):
            buffer.set_res(k, memoryview(array))


class Workspace:
    """Arrays and functions for one horizon, used by one thread.

    A solve starts from its arguments alone; nothing of the solve before is used.

    Parameters
    ----------
    N : int
    """

    def __init__(self, N: int) -> None:
        self.N = N
        self.x_0, self.delta_prev, self.c = np.zeros(4), np.zeros(1), np.zeros(SIZE)
        self.r, self.e_ref, self.u_ref = np.zeros(N + 1), np.zeros(N + 1), np.zeros(N)
        self.low, self.high = np.zeros(N), np.zeros(N)
        self.guess, self.share = np.zeros(N), np.zeros(1)
        self.U, self.X, self.exact = np.zeros(N), np.zeros(4 * N), np.ones(1)
        self.U_try, self.X_try = np.zeros(N), np.zeros(4 * N)
        self.m_0, self.m_1, self.m_y = np.zeros(N), np.zeros(N), np.zeros(N)
        known = [self.x_0, self.r, self.e_ref, self.u_ref, self.c]
        roll, value, linearise = _functions(N)
        self._roll = _Call(
            roll,
            [self.x_0, self.guess, self.share, self.delta_prev, *known[1:4], self.low, self.high, self.c],
        )
        self._value = _Call(value, [self.X_try, self.U_try, *known])
        self._linearise = _Call(linearise, [self.X, self.U, *known, self.exact, self.m_0, self.m_1, self.m_y])
        out = self._linearise.outputs
        self.H, self.T = out[0].reshape(N, N), out[2].reshape(4 * N, N)
        self.g, self.t, self.J_t, self.slope = out[1], out[3], out[4], out[5]
        self.Y = [out[6].reshape(N, N), out[7].reshape(N, N)]
        self.y_t = [out[8], out[9]]
        self._change = np.diff(np.eye(N), axis=0, prepend=0.0)
        self._sense = np.zeros(2 * N, dtype=np.int32)

    def solve(self, warm: FloatArray | None, a_before: float, soft: SoftLimits | None) -> Solution:
        """Solve the problem in the input arrays.

        Parameters
        ----------
        warm : (N,) [rad], optional
            Commands to start from, where they promise less than the LQR.
        a_before : float [m/s^2]
            Lateral acceleration just before the first command.
        soft : SoftLimits, optional

        Returns
        -------
        Solution
        """
        self.m_0[:], self.m_1[:], self.m_y[:] = 0.0, 0.0, 0.0
        J, merit, rows = self._start(warm, a_before, soft)
        step, gap = np.inf, 0.0
        for iteration in range(1, MAX_ITERATIONS + 1):
            dU, row_change, newton = self._direction(rows, soft)
            if dU is None:
                return self._end(False, iteration, step, J)
            step = float(np.max(np.abs(dU)))
            pull = self.J_t[0] + self.g @ dU + 0.5 * dU @ (self.H @ dU)
            nu = 2.0 * self.slope[0] + 1e-6
            before = merit + nu * gap
            if soft is not None and rows is not None:
                pull += soft.penalty(rows + row_change) - soft.penalty(rows)
            drop = nu * gap - pull
            np.add(self.U, dU, out=self.U_try)
            self.X_try[:] = self.X + self.t + self.T @ dU
            trial = self._measure(a_before, soft)
            full = trial[1] + nu * trial[3] <= before - 1e-4 * drop + 1e-12 * (1.0 + abs(before))
            if not full:
                trial = self._shorten(dU, merit if gap == 0.0 else before, drop, a_before, soft)
                if trial is None:
                    # the merit cannot fall any more: rounding, if the step is small
                    return self._end(step <= 1e-7 and gap <= _GAP, iteration, step, J)
            J, merit, rows, gap = trial
            self.U[:], self.X[:] = self.U_try, self.X_try
            if gap <= _GAP and full and step <= (_STEP_NEWTON if newton and soft is None else _STEP_LINEAR):
                return self._end(True, iteration, step, J)
        return self._end(False, MAX_ITERATIONS, step, J)

    def _end(self, solved: bool, iterations: int, step: float, J: float) -> Solution:
        return Solution(self.U.copy(), solved and bool(np.isfinite(self.U).all()), iterations, step, 2.0 * J)

    def _start(
        self, warm: FloatArray | None, a_before: float, soft: SoftLimits | None
    ) -> tuple[float, float, FloatArray | None]:
        """The better of the warm start and the LQR, both inside the limits and driven by the model."""
        self.share[0] = 1.0
        self._drive()
        best = self._measure(a_before, soft)
        self.U[:], self.X[:] = self.U_try, self.X_try
        if warm is not None:
            self.share[0], self.guess[:] = 0.0, warm
            self._drive()
            other = self._measure(a_before, soft)
            if other[1] <= best[1] or not np.isfinite(best[1]):
                best = other
                self.U[:], self.X[:] = self.U_try, self.X_try
        return best[:3]

    def _drive(self) -> None:
        self._roll.run()
        self.U_try[:], self.X_try[:] = self._roll.outputs

    def _measure(
        self, a_before: float, soft: SoftLimits | None
    ) -> tuple[float, float, FloatArray | None, float]:
        """Half the cost, the same with penalties, the soft limits' rows, the gaps of the trial."""
        self._value.run()
        J, gap, a_0, a_1 = self._value.outputs
        if soft is None:
            return float(J[0]), float(J[0]), None, float(gap[0])
        rows = soft.rows @ np.concatenate([a_0, a_1, self.X_try[0::4]]) + a_before * soft.before
        return float(J[0]), float(J[0]) + soft.penalty(rows), rows, float(gap[0])

    def _shorten(
        self, dU: FloatArray, before: float, drop: float, a_before: float, soft: SoftLimits | None
    ) -> tuple[float, float, FloatArray | None, float] | None:
        """The first shortened step, driven by the model, that lowers the merit; None if there is none."""
        start = self.U.copy()
        self.share[0] = 0.0
        length = 1.0
        for _ in range(12):
            self.guess[:] = start + length * dU
            self._drive()
            trial = self._measure(a_before, soft)
            if trial[1] < before - 1e-4 * length * max(drop, 0.0):
                return trial[0], trial[1], trial[2], 0.0
            length *= 0.5
        return None

    def _direction(
        self, rows: FloatArray | None, soft: SoftLimits | None
    ) -> tuple[FloatArray | None, FloatArray | None, bool]:
        """Solution of the QP, the change of the soft rows with it, and whether the Hessian was the Lagrangian's."""
        for exact in (1.0, 0.0):
            self.exact[0] = exact
            self._linearise.run()
            if not (np.isfinite(self.g).all() and np.isfinite(self.H).all()):
                return None, None, False
            dU, change = self._qp(rows, soft)
            if dU is not None:
                return dU, change, exact == 1.0
        return None, None, False

    def _qp(self, rows: FloatArray | None, soft: SoftLimits | None) -> tuple[FloatArray | None, FloatArray | None]:
        import daqp

        N, U = self.N, self.U
        C, sense = self._change, self._sense
        turn = np.empty(N)
        turn[0] = U[0] - self.delta_prev[0]
        np.subtract(U[1:], U[:-1], out=turn[1:])
        rate = self.c[-1]
        low, high = [self.low - U, -rate - turn], [self.high - U, rate - turn]
        options: dict[str, float] = {}
        S = now = None
        if soft is not None and rows is not None:
            S = soft.rows @ np.concatenate([*self.Y, self.T[0::4]])
            now = rows + soft.rows @ np.concatenate([*self.y_t, self.t[0::4]])
            C = np.concatenate([C, S])
            sense = np.concatenate([sense, np.full(soft.size, 8, dtype=np.int32)])
            low.append(-soft.bound - now)
            high.append(soft.bound - now)
            options = {"rho_soft": 1.0 / soft.weight, "w_soft": soft.weight}
        dU, _, flag, info = daqp.solve(
            self.H, self.g, C, np.concatenate(high), np.concatenate(low), sense,
            primal_tol=_PRIMAL, eps_prox=0.0, **options,
        )  # fmt: skip
        if flag < 1 or not np.isfinite(dU).all():
            return None, None
        if soft is None or S is None or now is None or rows is None:
            return dU, None
        pressed = info["lam"][2 * N :] @ soft.rows
        self.m_0[:], self.m_1[:], self.m_y[:] = pressed[:N], pressed[N : 2 * N], pressed[2 * N :]
        return dU, now - rows + S @ dU


@functools.lru_cache(maxsize=16)
def _functions(N: int) -> tuple[Any, ...]:
    return compiled(tuple(build(N)), f"nonlinear_mpc_{N}")


_LOCAL = threading.local()


def workspace(N: int) -> Workspace:
    """This thread's workspace for a horizon."""
    kept: dict[int, Workspace] = _LOCAL.__dict__.setdefault("kept", {})
    if N not in kept:
        kept[N] = Workspace(N)
    return kept[N]
