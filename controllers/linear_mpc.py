"""Linear model predictive control with curvature preview and limits on steering angle and rate.

At every sample it minimises, over the next N commands, the sum of x~' Q x~ + r_delta u~^2 with the terminal cost
x~_N' P x~_N, where x~ and u~ are deviations from steady cornering at the lane yaw rate previewed for that sample and P
solves the Riccati equation; subject to |u| <= delta_max and |u_j - u_(j-1)| <= rate_max dt, u_(-1) the previous
command. Without active limits this is the LQR with curvature preview, exactly. Positive to the left (ISO 8855).

Form of the QP. With the LQR gain K and w_j = -K z_j + c_j the cost is s sum (c_j - c*_j)^2 plus a constant, where
s = r + B'PB (completion of squares along the Riccati recursion; c* is the feedforward from the preview). So the QP is:
the smallest correction e = c - c* of the unconstrained plan that meets the limits, with an identity Hessian whatever
the weights and the speed. Where the unconstrained plan meets every limit over the horizon, e = 0 is the QP's solution
and no solver is called; elsewhere OSQP solves it to 1e-6, warm started from the scenario's own last solution. Weights
far more aggressive than the limits allow make the rows of the limits ill conditioned; where OSQP does not reach 1e-6,
the QP, a least distance problem, is solved by non-negative least squares (C. Lawson, R. Hanson, *Solving Least Squares
Problems*, chapter 23), and taken if it meets the limits to 1e-6.

The QP is feasible exactly if |delta_prev| <= delta_max + rate_max dt. A QP that is infeasible, or that neither route
solves, gives `EventStatus.SOLVER_FAILED` and the fallback: the unconstrained command, clipped to +-delta_max and then
moved towards from the previous command by at most rate_max dt (the rate limit has priority).
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, final

import numpy as np
import numpy.typing as npt

from controllers.riccati import regulator
from ldctoolkit import Controller, EventStatus, Plant, Preview, SteeringLaw, gain, option

FloatArray = npt.NDArray[np.float64]

# the unconstrained plan counts as inside the limits up to rounding
_ROUNDING = 1e-12


@final
@dataclasses.dataclass(frozen=True)
class LinearMPC(Controller):
    """Linear MPC, one QP a sample, solved by OSQP.

    Parameters
    ----------
    horizon : int [samples]
        N.
    q_y, q_y_rate, q_psi, q_psi_rate, r_delta : float
        Weights as in `LQR`.
    delta_max : float [rad]
        Limit of the steering angle.
    rate_max : float [rad/s]
        Limit of the steering rate.
    solver : {"osqp"}
        QP solver.
    always_solve : bool
        Call the solver even where the unconstrained plan is the solution; for tests and timing.

    Examples
    --------
    >>> LinearMPC(horizon=10).delta_max
    0.1
    """

    name: ClassVar[str] = "linear_mpc"
    title: ClassVar[str] = "Linear MPC"

    horizon: int = gain(20, unit="samples", lower=1, upper=100, description="prediction horizon N")
    q_y: float = gain(1.0, unit="1/m^2", lower=1e-6, upper=1e6, scale="log", description="weight on e_y^2")
    q_y_rate: float = gain(0.0, unit="s^2/m^2", lower=0.0, upper=1e6, description="weight on (de_y/dt)^2")
    q_psi: float = gain(1.0, unit="1/rad^2", lower=0.0, upper=1e6, description="weight on e_psi^2")
    q_psi_rate: float = gain(0.0, unit="s^2/rad^2", lower=0.0, upper=1e6, description="weight on (de_psi/dt)^2")
    r_delta: float = gain(100.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")
    rate_max: float = gain(0.2, unit="rad/s", lower=1e-3, upper=10.0, description="limit of the steering rate")
    solver: str = option("osqp", choices=("osqp",), description="QP solver")
    always_solve: bool = gain(False, unit="1", description="call the solver also where no limit is active")

    def prepare(self, plant: Plant) -> MPCLaw:
        """Solve the Riccati equation, and condense the plan over the horizon, for every scenario's speed."""
        weights = (self.q_y, self.q_y_rate, self.q_psi, self.q_psi_rate)
        lq = regulator(plant, weights, self.r_delta)
        n, N, K = plant.n, self.horizon, lq.K
        A, B = plant.step.A, plant.step.B
        steady = plant.steady_state()
        x_ss = np.zeros((n, 4))
        x_ss[:, 2] = steady.e_psi
        # a change of lane yaw rate over one step pushes the deviation from steady cornering by D
        D = 0.5 * B * steady.delta[:, None] + plant.step.E_1 - x_ss
        A_cl = A - B[:, :, None] * K[:, None, :]

        PB = _apply(lq.P, B)
        s = self.r_delta + np.sum(B * PB, axis=1)
        back = _apply(lq.P, D)  # P D, then carried back by the closed loop
        response, impulse = np.zeros((n, N)), np.zeros((n, N))
        forward = B
        for k in range(N):
            response[:, k] = -np.sum(B * back, axis=1) / s  # c*_j for a change of yaw rate k steps after j
            back = _apply(A_cl.transpose(0, 2, 1), back)
            impulse[:, k] = 1.0 if k == 0 else -np.sum(K * forward, axis=1)  # u_(j+k) for a unit c_j
            forward = forward if k == 0 else _apply(A_cl, forward)

        # the unconstrained plan as a linear map of (z_0, changes of yaw rate)
        plan = np.zeros((n, N, 4 + N))
        Z = np.zeros((n, 4, 4 + N))
        Z[:, np.arange(4), np.arange(4)] = 1.0
        for j in range(N):
            c = np.zeros((n, 4 + N))
            c[:, 4 + j :] = response[:, : N - j]
            plan[:, j] = c - np.einsum("ni,nij->nj", K, Z)
            Z = A_cl @ Z + B[:, :, None] * c[:, None, :]
            Z[:, :, 4 + j] += D
        return MPCLaw(
            dt=plant.dt,
            delta_max=self.delta_max,
            rate_step=self.rate_max * plant.dt,
            always_solve=self.always_solve,
            x_ss=x_ss,
            delta_ss=steady.delta,
            plan=plan,
            impulse=impulse,
        )


def _apply(M: FloatArray, x: FloatArray) -> FloatArray:
    """M x for a stack of matrices (n, 4, 4) and vectors (n, 4)."""
    product: FloatArray = np.einsum("nij,nj->ni", M, x)
    return product


@dataclasses.dataclass(frozen=True)
class MPCState:
    """Solvers of one run by place in the batch, for scenarios that ever needed one; each starts from its last solution.

    They belong to the run that `MPCLaw.init` started: a state that is passed twice goes on from the later solution.
    """

    solvers: dict[int, Any]


@final
@dataclasses.dataclass(frozen=True)
class MPCLaw(SteeringLaw):
    """The condensed MPC of n scenarios.

    Attributes
    ----------
    dt : float [s]
    delta_max : float [rad]
    rate_step : float [rad]
        Largest change of the command from one sample to the next.
    always_solve : bool
    x_ss : (n, 4)
        Steady cornering per unit of lane yaw rate.
    delta_ss : (n,)
    plan : (n, N, 4 + N)
        Unconstrained commands relative to steady cornering, from (z_0, N changes of lane yaw rate).
    impulse : (n, N)
        Commands that follow from a unit correction now, under the LQR.
    """

    dt: float
    delta_max: float
    rate_step: float
    always_solve: bool
    x_ss: FloatArray
    delta_ss: FloatArray
    plan: FloatArray
    impulse: FloatArray

    @property
    def horizon(self) -> int:
        """N."""
        return int(self.plan.shape[1])

    @property
    def preview_times(self) -> FloatArray:
        """Now and the N samples ahead."""
        return np.asarray(np.arange(self.horizon + 1) * self.dt, dtype=np.float64)

    def init(self, n: int) -> MPCState:
        """No solver yet."""
        return MPCState({})

    def take(self, rows: npt.NDArray[np.int64], state: MPCState) -> tuple[MPCLaw, MPCState]:
        """Only some scenarios, each with the solver that it has."""
        names = ("x_ss", "delta_ss", "plan", "impulse")
        law = dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names})
        kept = {place: state.solvers[i] for place, i in enumerate(rows.tolist()) if i in state.solvers}
        return law, MPCState(kept)

    def unconstrained(self, x: FloatArray, yaw_rate: FloatArray) -> FloatArray:
        """Optimal commands over the horizon if there were no limits, (n, N) [rad]."""
        z = x - self.x_ss * yaw_rate[:, :1]
        known = np.concatenate([z, np.diff(yaw_rate, axis=1)], axis=1)
        steady = self.delta_ss[:, None] * (0.5 * (yaw_rate[:, :-1] + yaw_rate[:, 1:]))
        return np.asarray((self.plan @ known[:, :, None])[:, :, 0] + steady, dtype=np.float64)

    def step(
        self,
        t: FloatArray,
        x: FloatArray,
        preview: Preview,
        delta_prev: FloatArray,
        state: MPCState,
    ) -> tuple[FloatArray, MPCState, npt.NDArray[np.int8]]:
        """First command of the optimal plan, for every scenario."""
        U = self.unconstrained(x, preview.yaw_rate)
        change = np.diff(U, axis=1, prepend=delta_prev[:, None])
        feasible = np.abs(delta_prev) <= self.delta_max + self.rate_step
        inside = (np.abs(U) <= self.delta_max + _ROUNDING).all(axis=1)
        inside &= (np.abs(change) <= self.rate_step + _ROUNDING).all(axis=1)
        delta = U[:, 0].copy()
        status = np.zeros(delta.size, dtype=np.int8)
        needed = np.ones_like(inside) if self.always_solve else ~inside
        for i in np.flatnonzero(needed):
            correction = self._solve(int(i), U[i], change[i], state) if feasible[i] else None
            if correction is None:
                wanted = min(max(delta[i], -self.delta_max), self.delta_max)
                reach = min(max(wanted - delta_prev[i], -self.rate_step), self.rate_step)
                delta[i] = delta_prev[i] + reach
                status[i] = EventStatus.SOLVER_FAILED
            else:
                delta[i] += correction
        return delta, state, status

    def _solve(self, i: int, U: FloatArray, change: FloatArray, state: MPCState) -> float | None:
        """First entry of the smallest correction that brings the plan inside the limits; None if not solved."""
        lower = np.concatenate([-self.delta_max - U, -self.rate_step - change])
        upper = np.concatenate([self.delta_max - U, self.rate_step - change])
        solver = state.solvers.get(i)
        if solver is None:
            solver = state.solvers[i] = _make_solver(self.impulse[i], lower, upper)
        else:
            solver.update(l=lower, u=upper)
        result = solver.solve(raise_error=False)
        solved, interrupted = _statuses()
        if result.info.status_val == interrupted:
            raise KeyboardInterrupt  # OSQP catches the signal itself while it solves
        # only a solved QP is used: OSQP leaves NaN or a placeholder in x for anything else
        if result.info.status_val == solved and np.isfinite(result.x[0]):
            return float(result.x[0])
        solver.warm_start(x=np.zeros(self.horizon), y=np.zeros(2 * self.horizon))
        return _least_distance(_rows(self.impulse[i]), lower, upper)


def _statuses() -> tuple[int, int]:
    """OSQP's numbers for solved, and for interrupted by the user."""
    import osqp

    return int(osqp.SolverStatus.OSQP_SOLVED), int(osqp.SolverStatus.OSQP_SIGINT)


def _make_solver(impulse: FloatArray, lower: FloatArray, upper: FloatArray) -> Any:
    """OSQP for: minimise |e|^2/2 subject to limits on the rows of `_rows`."""
    import osqp
    import scipy.sparse

    N = impulse.size
    solver = osqp.OSQP()
    solver.setup(
        P=scipy.sparse.eye(N, format="csc"),
        q=np.zeros(N),
        A=scipy.sparse.csc_matrix(_rows(impulse)),
        l=lower,
        u=upper,
        eps_abs=1e-6,
        eps_rel=1e-6,
        max_iter=4000,
        eps_prim_inf=1e-10,  # what is called is feasible; the default takes slow progress for infeasibility
        warm_starting=True,
        scaling=0,  # the QP is scaled as it stands
        # a fixed interval (a timed one would depend on the machine's load), short since the factorisation is small
        adaptive_rho_interval=25,
        adaptive_rho_tolerance=2.0,
        verbose=False,
    )
    return solver


def _rows(impulse: FloatArray) -> FloatArray:
    """Angles M e and their changes that a correction e causes, (2 N, N); M is lower triangular Toeplitz."""
    import scipy.linalg

    M = scipy.linalg.toeplitz(impulse, np.zeros(impulse.size))
    return np.vstack([M, np.diff(M, axis=0, prepend=0.0)])


def _least_distance(rows: FloatArray, lower: FloatArray, upper: FloatArray) -> float | None:
    """First entry of the smallest e with lower <= rows e <= upper, by non-negative least squares; None if not found."""
    import scipy.optimize

    G, h = np.vstack([rows, -rows]), np.concatenate([lower, -upper])
    E = np.vstack([G.T, h])
    f = np.zeros(E.shape[0])
    f[-1] = 1.0
    try:
        weights, _ = scipy.optimize.nnls(E, f, maxiter=20 * E.shape[1])
    except RuntimeError:  # scipy's word for too many iterations
        return None
    residual = E @ weights - f
    if not residual[-1] < 0:
        return None
    e = -residual[:-1] / residual[-1]
    return float(e[0]) if np.min(G @ e - h) >= -1e-6 else None
