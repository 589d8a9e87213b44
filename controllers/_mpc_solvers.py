"""Solvers of `linear_mpc`'s QP, each behind the same two calls: make a workspace for a scenario, solve in it.

A workspace holds what a solver has allocated and factorised, nothing that a result depends on: every solve starts from
a point that is passed in. So a workspace may be kept, shared between runs or thrown away, and no bit changes.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from controllers._mpc_condensing import Limits
from ldctoolkit.errors import InputError, nearest

FloatArray = npt.NDArray[np.float64]

EPS: Final = 1e-6
"""Tolerance of OSQP, absolute and relative."""

KNOWN: Final = (
    "osqp", "daqp", "clarabel", "copt", "cvxopt", "ecos", "gurobi", "highs", "hpipm", "jaxopt_osqp", "kvxopt", "mosek",
    "nppro", "pdhcg", "piqp", "proxqp", "pyqpmad", "qpalm", "qpax", "qpoases", "qpswift", "qtqp", "quadprog", "scs",
    "sip",
)  # fmt: skip
"""Words for a solver: OSQP and DAQP through their own interfaces, the others as qpsolvers names them."""


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
        hard, soft = C[: self.hard], C[self.hard :]
        return QP(
            q,
            np.block(
                [
                    [hard, np.zeros((self.hard, self.kinds.size))],
                    [soft, -self.slack],
                    [soft, self.slack],
                    [np.zeros((self.kinds.size, self.M)), np.eye(self.kinds.size)],
                ]
            ),
        )

    def bounds(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of k QPs, from the bounds (k, R) of the rows."""
        if not self.kinds.size:
            return low, high
        k, soft, kinds = low.shape[0], low.shape[1] - self.hard, self.kinds.size
        open_below, open_above = np.full((k, soft), -np.inf), np.full((k, soft), np.inf)
        below = [low[:, : self.hard], open_below, low[:, self.hard :], np.zeros((k, kinds))]
        above = [high, open_above, np.full((k, kinds), np.inf)]
        return np.concatenate(below, axis=1), np.concatenate(above, axis=1)

    def split(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers (k, R) of the rows, as those of the solver's rows."""
        if not self.kinds.size:
            return multipliers
        soft = multipliers[:, self.hard :]
        k = multipliers.shape[0]
        parts = [
            multipliers[:, : self.hard],
            np.maximum(soft, 0.0),
            np.minimum(soft, 0.0),
            np.zeros((k, self.kinds.size)),
        ]
        return np.concatenate(parts, axis=1)

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
    """What a solver found."""

    solved: bool  # The solver says so; otherwise w and y are not to be used
    w: FloatArray  # (variables,)
    y: FloatArray  # (rows,) Multipliers, positive at an upper bound
    iterations: int


class Workspace(abc.ABC):
    """A solver made for the matrices of one QP."""

    @abc.abstractmethod
    def solve(self, low: FloatArray, high: FloatArray, y: FloatArray) -> Answer:
        """Solve for these bounds."""


class Workspaces(dict[int, Workspace]):
    """Workspaces by place in the batch. A copy or a pickle is empty: they are made again where they are needed."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Workspaces:
        return Workspaces()

    def __reduce__(self) -> tuple[type[Workspaces], tuple[()]]:
        return Workspaces, ()


def check_solver(word: object, owner: str) -> None:
    """Raise unless a solver of that name is installed."""
    if word in ("osqp", "daqp"):
        return
    there = tuple(name for name in KNOWN if name in ("osqp", "daqp", *_others()))
    if word not in there:
        wrong = "not installed; installed" if word in KNOWN else "no such solver; installed"
        raise InputError(f"{owner}.solver: {word!r} is {wrong}: {', '.join(there)}; {nearest(str(word), there)}")


@functools.cache
def _others() -> tuple[str, ...]:
    import qpsolvers

    return tuple(qpsolvers.available_solvers)


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
        solved, interrupted = _osqp_statuses()
        if result.info.status_val == interrupted:
            raise KeyboardInterrupt  # OSQP catches the signal itself while it solves
        if result.info.rho_updates:
            solver.update_settings(rho=self.rho)  # the next solve starts as this one did
        # only a solved QP is used: OSQP leaves NaN or a placeholder in x for anything else
        done = result.info.status_val == solved and bool(np.isfinite(result.x).all())
        return Answer(done, np.array(result.x), np.array(result.y), int(result.info.iter))


@functools.cache
def _osqp_statuses() -> tuple[int, int]:
    """OSQP's numbers for solved, and for interrupted by the user."""
    import osqp

    return int(osqp.SolverStatus.OSQP_SOLVED), int(osqp.SolverStatus.OSQP_SIGINT)


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
        except (qpsolvers.QPError, ArithmeticError, ValueError):
            return Answer(False, np.zeros(A.shape[1]), np.zeros(A.shape[0]), 0)
        if not solution.found or solution.x is None or solution.z is None or not np.isfinite(solution.x).all():
            return Answer(False, np.zeros(A.shape[1]), np.zeros(A.shape[0]), 0)
        found = np.zeros(A.shape[0])
        found[above] += solution.z[: above.sum()]
        found[below] -= solution.z[above.sum() :]
        return Answer(True, np.asarray(solution.x), found, 0)
