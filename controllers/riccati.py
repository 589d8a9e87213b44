"""Discrete-time LQR gains as smooth functions of speed, from SciPy's Riccati solver.

The Riccati equation is solved at a few dozen speeds and not once a scenario: `ldctoolkit.scheduled`. With weights many
orders of magnitude apart the solver's answers scatter too much for that; Newton's method (G. Hewer, *An iterative
technique for the computation of the steady state gains for the discrete optimal regulator*, IEEE TAC 16(4), 1971) then
brings them to rounding: each step is one linear equation, the error is squared, and a stable loop stays stable. Weights
at the ends of their ranges, a dozen orders apart, may still be refused.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit import SPEED_RANGE, BicycleModel, LdcError, LinearLaw, Plant, scheduled

FloatArray = npt.NDArray[np.float64]
Weights = tuple[float, float, float, float]

__all__ = ["SPEED_RANGE", "Regulator", "feedback", "in_time", "linear_law", "regulator"]


@dataclasses.dataclass(frozen=True)
class Regulator:
    """Infinite-horizon LQR at n speeds: delta = -K s with the cost s' P s."""

    K: FloatArray  # (n, k)
    P: FloatArray  # (n, k, k)


def regulator(plant: Plant, q: Weights, r: float, *, actuator: bool = False) -> Regulator:
    """LQR gain and cost at every scenario's speed."""
    lag, part = _known(plant) if actuator else (0.0, 0.0)
    values = _scheduled(plant, _Riccati(plant.model, plant.dt, q, r, lag=lag, part=part), slice(None))
    k = int(math.sqrt(values.shape[1]))
    return Regulator(K=values[:, :k].copy(), P=values[:, k:].reshape(-1, k, k).copy())


def feedback(plant: Plant, q: Weights, r: float, q_i: float | None = None) -> FloatArray:
    """Only the gain K (n, k) of a `regulator` behind the actuator, with the same bits and the same errors.

    With a weight `q_i` > 0 [1/(m s)^2] on z^2 the last state is z, the running integral of e_y: z_(k+1) = z_k +
    dt e_y(k). Without a weight z would not be seen by the cost, and the equation would have no stabilising solution.
    """
    lag, part = _known(plant)
    solve = _Riccati(plant.model, plant.dt, q, r, q_i=q_i, lag=lag, part=part, refined=q_i is not None)
    return _scheduled(plant, solve, slice(4 + (lag > 0) + (part > 0) + (q_i is not None)))


def in_time(plant: Plant) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, E_0, E_1 behind the actuator as if the command came `plant.augmented.whole` samples earlier.

    The states are x, the wheel angle where there is a lag, the command before where two act within a sample. Whole
    samples of delay need no states: the best command is that without them, for the state predicted that far ahead.
    """
    return dataclasses.replace(plant.augmented, whole=0).with_commands()


def linear_law(plant: Plant, K: FloatArray, *, integral: bool = False) -> LinearLaw:
    """The law delta = delta_ss psi_l' - K (s - s_ss psi_l'), s that of `in_time` when the command acts, and z.

    s is predicted from the state that is seen, the wheel angle there and the commands on their way, for a bend that
    goes on as it will be at the end of the delay and the lag. It is exact: what `control.dlqr` gives for the plant
    with all these states.
    """
    step, steady = plant.augmented, plant.steady_state()
    A, B, _, _ = in_time(plant)
    k = B.shape[1]
    if integral:
        with_z = np.zeros((plant.n, k + 1, k + 1))
        with_z[:, :k, :k], with_z[:, k, 0], with_z[:, k, k] = A, plant.dt, 1.0
        A, B = with_z, np.append(B, np.zeros((plant.n, 1)), axis=1)
    past = np.zeros((plant.n, max(step.past, 1)))
    for age in range(step.whole):
        past[:, age] = -np.sum(K * B, axis=1)
        K = np.einsum("ni,nij->nj", K, A)
    if step.split:
        past[:, step.whole] = -K[:, k - 1]
    f_wheel = -K[:, 4] if plant.lag > 0 else None
    held = past.sum(axis=1) + (0.0 if f_wheel is None else f_wheel)
    return LinearLaw(
        F=-K[:, :4],
        preview_times=np.array([plant.delay - plant.age + plant.lag]),
        G_yaw_rate=(steady.delta + K[:, 2] * steady.e_psi - held * steady.delta)[:, None],
        G_heading=np.zeros((plant.n, 1)),
        f_u=past[:, 0],
        f_i=-K[:, k] if integral else None,
        f_past=past[:, 1:] if step.past > 1 else None,
        f_wheel=f_wheel,
    )


def _known(plant: Plant) -> tuple[float, float]:
    """Lag, and the part of a sample in the delay."""
    step = plant.augmented
    return plant.lag, plant.delay - step.whole * plant.dt if step.split else 0.0


def _scheduled(plant: Plant, solve: _Riccati, columns: slice) -> FloatArray:
    what = f"LQR gains for {solve.what}"
    return scheduled(_resolved(solve, what), plant.v, what, columns=columns)


@functools.lru_cache(maxsize=256)
def _resolved(solve: _Riccati, what: str) -> _Riccati:
    """The solver's answers as they are wherever these can be scheduled, refined elsewhere."""
    try:
        scheduled(solve, np.empty(0), what)
    except LdcError:
        if solve.refined:
            raise
        return dataclasses.replace(solve, refined=True)
    return solve


@dataclasses.dataclass(frozen=True)
class _Riccati:
    """(K, P) at given speeds, side by side; only K with an integral."""

    model: BicycleModel
    dt: float
    q: Weights
    r: float
    q_i: float | None = None
    lag: float = 0.0
    part: float = 0.0
    refined: bool = False

    @property
    def what(self) -> str:
        integral = "" if self.q_i is None else f"q_i = {self.q_i}, "
        actuator = f", lag = {self.lag:g} s" if self.lag else ""
        return f"q = {self.q}, {integral}r = {self.r}, dt = {self.dt:g} s{actuator}"

    def __call__(self, v: FloatArray) -> FloatArray:
        A, B, _, _ = in_time(Plant.build(self.model, v, self.dt, lag=self.lag, delay=self.part))
        k, rows = B.shape[1], []
        q = (*self.q, *(k - 4) * (0.0,), *(() if self.q_i is None else (self.q_i,)))
        full, inputs = np.zeros((len(q), len(q))), np.zeros(len(q))
        full[k:, 0], full[k:, k:] = self.dt, 1.0
        for i in range(v.size):
            full[:k, :k], inputs[:k] = A[i], B[i]
            where = f"at {v[i]:.3g} m/s for {self.what}"
            K, P = _dlqr(full, inputs, q, self.r, where)
            if self.refined:
                K, P = _refined(full, inputs, q, self.r, K, where)
            rows.append(K if self.q_i is not None else np.concatenate([K, P.ravel()]))
        return np.array(rows)


def _dlqr(A: FloatArray, B: FloatArray, q: tuple[float, ...], r: float, where: str) -> tuple[FloatArray, FloatArray]:
    """Gain and cost of one plant with one input."""
    import scipy.linalg  # what control.dlqr calls: to import that takes two seconds

    b = B[:, None]
    try:
        P = scipy.linalg.solve_discrete_are(A, b, np.diag(q), np.array([[r]]))
        K = np.linalg.solve(b.T @ P @ b + r, b.T @ P @ A)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise LdcError(f"no LQR {where}: {error}") from error
    return K[0], P


def _refined(
    A: FloatArray, B: FloatArray, q: tuple[float, ...], r: float, K: FloatArray, where: str
) -> tuple[FloatArray, FloatArray]:
    """Two steps of Newton's method from a gain that is nearly right; the second is below rounding where it was."""
    import scipy.linalg

    for _ in range(2):
        A_c = A - np.outer(B, K)
        if not np.abs(np.linalg.eigvals(A_c)).max() < 1.0:
            raise LdcError(f"no LQR {where}: the solver's gain does not stabilise the loop")
        P = scipy.linalg.solve_discrete_lyapunov(A_c.T, np.diag(q) + r * np.outer(K, K))
        P = 0.5 * (P + P.T)
        PB = P @ B
        K = PB @ A / (r + B @ PB)
    return K, P
