"""Discrete-time LQR gains as smooth functions of speed, from python-control's Riccati solver.

The Riccati equation is solved at a few dozen speeds and not once a scenario: `ldctoolkit.scheduled`. With weights many
orders of magnitude apart the solver's answers scatter too much for that; Newton's method (G. Hewer, *An iterative
technique for the computation of the steady state gains for the discrete optimal regulator*, IEEE TAC 16(4), 1971) then
brings them to rounding: each step is one linear equation, the error is squared, and a stable loop stays stable. Weights
at the ends of their ranges, a dozen orders apart, may still be refused.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import numpy.typing as npt

from ldctoolkit import SPEED_RANGE, BicycleModel, LdcError, Plant, scheduled

FloatArray = npt.NDArray[np.float64]
Weights = tuple[float, float, float, float]

__all__ = ["SPEED_RANGE", "Regulator", "feedback", "integral_feedback", "regulator"]


@dataclasses.dataclass(frozen=True)
class Regulator:
    """Infinite-horizon LQR at n speeds: delta = -K x with the cost x' P x.

    Attributes
    ----------
    K : (n, 4)
    P : (n, 4, 4)
    """

    K: FloatArray
    P: FloatArray


def regulator(plant: Plant, q: Weights, r: float) -> Regulator:
    """LQR gain and cost at every scenario's speed.

    Parameters
    ----------
    plant : Plant
        Model, speeds (n,) and sample time.
    q : tuple of 4 floats
        Weights on e_y^2, (de_y/dt)^2, e_psi^2, (de_psi/dt)^2.
    r : float [1/rad^2]
        Weight on delta^2.

    Returns
    -------
    Regulator

    Raises
    ------
    InputError
        For a speed outside `SPEED_RANGE`.
    LdcError
        If the Riccati equation has no stabilising solution somewhere in the range.
    """
    values = _scheduled(plant, q, r, slice(None))
    return Regulator(K=values[:, :4].copy(), P=values[:, 4:].reshape(-1, 4, 4).copy())


def feedback(plant: Plant, q: Weights, r: float) -> FloatArray:
    """Only the gain K (n, 4) of `regulator`, with the same arguments, the same bits and the same errors."""
    return _scheduled(plant, q, r, slice(4))


def integral_feedback(plant: Plant, q: Weights, q_i: float, r: float) -> FloatArray:
    """LQR gain on the state and on z, the running integral of e_y: z_(k+1) = z_k + dt e_y(k).

    Parameters
    ----------
    plant : Plant
        Model, speeds (n,) and sample time.
    q : tuple of 4 floats
        Weights as in `regulator`.
    q_i : float [1/(m s)^2]
        Weight on z^2, > 0: without it z is not seen by the cost and the Riccati equation has no stabilising solution.
    r : float [1/rad^2]
        Weight on delta^2.

    Returns
    -------
    (n, 5)
        delta = -(K[:, :4] x + K[:, 4] z).

    Raises
    ------
    InputError
        For a speed outside `SPEED_RANGE`.
    LdcError
        If the Riccati equation has no stabilising solution somewhere in the range.
    """
    what = f"LQR gains for q = {q}, q_i = {q_i}, r = {r}, dt = {plant.dt:g} s"
    return scheduled(_IntegralRiccati(plant.model, plant.dt, q, q_i, r), plant.v, what)


def _scheduled(plant: Plant, q: Weights, r: float, columns: slice) -> FloatArray:
    what = f"LQR gains for q = {q}, r = {r}, dt = {plant.dt:g} s"
    return scheduled(_resolved(_Riccati(plant.model, plant.dt, q, r), what), plant.v, what, columns=columns)


@functools.lru_cache(maxsize=256)
def _resolved(solve: _Riccati, what: str) -> _Riccati:
    """The solver's answers as they are wherever these can be scheduled, refined elsewhere."""
    try:
        scheduled(solve, np.empty(0), what)
    except LdcError:
        return dataclasses.replace(solve, refined=True)
    return solve


@dataclasses.dataclass(frozen=True)
class _Riccati:
    """(K, P) at given speeds, side by side."""

    model: BicycleModel
    dt: float
    q: Weights
    r: float
    refined: bool = False

    def __call__(self, v: FloatArray) -> FloatArray:
        step = self.model.discretize(v, self.dt)
        what = f"q = {self.q}, r = {self.r}, dt = {self.dt:g} s"
        rows = []
        for i in range(v.size):
            where = f"at {v[i]:.3g} m/s for {what}"
            K, P = _dlqr(step.A[i], step.B[i], self.q, self.r, where)
            if self.refined:
                K, P = _refined(step.A[i], step.B[i], self.q, self.r, K, where)
            rows.append(np.concatenate([K, P.ravel()]))
        return np.array(rows)


@dataclasses.dataclass(frozen=True)
class _IntegralRiccati:
    """K of the plant with the integral of e_y as a fifth state, at given speeds."""

    model: BicycleModel
    dt: float
    q: Weights
    q_i: float
    r: float

    def __call__(self, v: FloatArray) -> FloatArray:
        step = self.model.discretize(v, self.dt)
        what = f"q = {self.q}, q_i = {self.q_i}, r = {self.r}, dt = {self.dt:g} s"
        A, B = np.zeros((5, 5)), np.zeros(5)
        A[4, 0], A[4, 4] = self.dt, 1.0
        rows = []
        for i in range(v.size):
            A[:4, :4], B[:4] = step.A[i], step.B[i]
            where, q = f"at {v[i]:.3g} m/s for {what}", (*self.q, self.q_i)
            K, _ = _dlqr(A, B, q, self.r, where)
            rows.append(_refined(A, B, q, self.r, K, where)[0])
        return np.array(rows)


def _dlqr(A: FloatArray, B: FloatArray, q: tuple[float, ...], r: float, where: str) -> tuple[FloatArray, FloatArray]:
    """Gain and cost of one plant with one input."""
    import control

    try:
        K, P, _ = control.dlqr(A, B[:, None], np.diag(q), np.array([[r]]))
    except (np.linalg.LinAlgError, control.ControlArgument, ValueError) as error:
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
