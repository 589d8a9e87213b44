"""Discrete-time LQR gains as smooth functions of speed, from structured doubling on all speeds at once.

The Riccati equation is solved at a few dozen speeds, not once a scenario: `ldctoolkit.scheduled`. Doubling
(B. Anderson, *Second-order convergent algorithms for the steady-state Riccati equation*, Int. J. Control 28(2), 1978)
doubles the horizon in each step by products of small matrices, in a tenth of the time of a Schur decomposition for each
speed. Two steps of Newton's method (G. Hewer, *An iterative technique for the computation of the steady state gains for
the discrete optimal regulator*, IEEE TAC 16(4), 1971) take the answers to rounding where weights are many orders of
magnitude apart. Weights at the ends of their ranges, a dozen orders apart, may still be refused.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.control import Controller, LinearLaw
from ldctoolkit.declared import gain
from ldctoolkit.errors import LdcError
from ldctoolkit.vehicle.bicycle import BicycleModel, Plant
from ldctoolkit.vehicle.discretization import augmented
from ldctoolkit.vehicle.speed_schedule import scheduled

Weights = tuple[float, float, float, float]


@dataclasses.dataclass(frozen=True)
class Horizon(Controller):
    """A design that looks N samples ahead. As the last base of a class its gain comes first."""

    horizon: int = gain(20, unit="samples", lower=1, upper=100, description="horizon N")


@dataclasses.dataclass(frozen=True)
class StateWeights(Controller):
    """A design with a quadratic cost of the error state."""

    q_y: float = gain(1.0, unit="1/m^2", lower=1e-6, upper=1e6, scale="log", description="weight on e_y^2")
    q_y_rate: float = gain(0.0, unit="s^2/m^2", lower=0.0, upper=1e6, description="weight on (de_y/dt)^2")
    q_psi: float = gain(1.0, unit="1/rad^2", lower=0.0, upper=1e6, description="weight on e_psi^2")
    q_psi_rate: float = gain(0.0, unit="s^2/rad^2", lower=0.0, upper=1e6, description="weight on (de_psi/dt)^2")

    @property
    def q(self) -> Weights:
        """Weights of (e_y, de_y/dt, e_psi, de_psi/dt)."""
        return self.q_y, self.q_y_rate, self.q_psi, self.q_psi_rate


@dataclasses.dataclass(frozen=True)
class QuadraticCost(StateWeights):
    """A design with a quadratic cost of error state and steering angle."""

    r_delta: float = gain(20_000.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")


@dataclasses.dataclass(frozen=True)
class Regulator:
    """Infinite-horizon LQR at n speeds: delta = -K s with the cost s' P s."""

    K: FloatArray  # (n, k)
    P: FloatArray  # (n, k, k)


def regulator(plant: Plant, q: Weights, r: float, *, actuator: bool = False) -> Regulator:
    """LQR gain and cost at every scenario's speed."""
    lag, part = _lag_and_split(plant) if actuator else (0.0, 0.0)
    values = _scheduled(plant, _Riccati(plant.model, plant.dt, q, r, lag=lag, part=part), slice(None))
    k = int(math.sqrt(values.shape[1]))
    return Regulator(K=values[:, :k].copy(), P=values[:, k:].reshape(-1, k, k).copy())


def feedback(plant: Plant, q: Weights, r: float, q_i: float | None = None) -> FloatArray:
    """Only the gain K (n, k) of a `regulator` behind the actuator, with the same bits and the same errors.

    With a weight `q_i` > 0 [1/(m s)^2] on z^2 the last state is z, the running integral of e_y: z_(k+1) = z_k +
    dt e_y(k). Without a weight z would not be seen by the cost, and the equation would have no stabilising solution.
    """
    lag, part = _lag_and_split(plant)
    solve = _Riccati(plant.model, plant.dt, q, r, q_i=q_i, lag=lag, part=part)
    return _scheduled(plant, solve, slice(4 + (lag > 0) + (part > 0) + (q_i is not None)))


def in_time(plant: Plant) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, E_0, E_1 behind the actuator as if the command came `plant.augmented.whole` samples earlier.

    The states are x, the wheel angle where there is a lag, the command before where two act within a sample. Whole
    samples of delay need no states: the best command is that without them, for the state predicted that far ahead.
    """
    return dataclasses.replace(plant.augmented, whole=0).with_commands()


def linear_law(plant: Plant, K: FloatArray, *, integral: bool = False, conditioned: bool = False) -> LinearLaw:
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
        conditioned=conditioned,
    )


_SMALL: Final = 1e-6  # [m, m/s, rad, rad/s] of central differences: rounding and curvature stay below 1e-9 of the gain


def linear_models(
    step: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray]], n: int, own: int, delay: int
) -> list[tuple[FloatArray, ...]]:
    """(A, B, C, D) of `SteeringLaw.linearised` for n laws, by central differences.

    `step` takes inputs (n, 7), states of the law (n, own) and the commands (n, delay) before the last, the oldest
    first; it returns commands (n,) and the states a sample later.
    """
    size = 7 + own + delay
    J = np.empty((n, 1 + own, size))
    for j in range(size):
        ends = []
        for sign in (1.0, -1.0):
            values = np.zeros((n, size))
            values[:, j] = sign * _SMALL
            delta, following = step(*(part.copy() for part in np.split(values, [7, 7 + own], axis=1)))
            ends.append(np.column_stack([delta, following]))
        J[:, :, j] = (ends[0] - ends[1]) / (2.0 * _SMALL)
    models: list[tuple[FloatArray, ...]] = []
    for slopes in J:
        A, B = np.eye(own + delay, k=1), np.zeros((own + delay, 7))
        A[:own], B[:own] = slopes[1:, 7:], slopes[1:, :7]
        if delay:  # earlier commands, each the one after it a sample later
            B[-1, 4] = 1.0
        models.append((A, B, slopes[0, 7:], slopes[0, :7]))
    return models


def _lag_and_split(plant: Plant) -> tuple[float, float]:
    """What a law knows of its actuator: the lag, and the part of a sample in the delay."""
    step = plant.augmented
    return plant.lag, plant.delay - step.whole * plant.dt if step.split else 0.0


def _scheduled(plant: Plant, solve: _Riccati, columns: slice) -> FloatArray:
    return scheduled(solve, plant.v, f"LQR gains for {solve.what}", columns=columns)


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

    @property
    def what(self) -> str:
        integral = "" if self.q_i is None else f"q_i = {self.q_i}, "
        actuator = f", lag = {self.lag:g} s" if self.lag else ""
        return f"q = {self.q}, {integral}r = {self.r}, dt = {self.dt:g} s{actuator}"

    def __call__(self, v: FloatArray) -> FloatArray:
        A, B, _, _ = augmented(*self.model.matrices(v), self.dt, lag=self.lag, delay=self.part).with_commands()
        m, k = B.shape
        q = np.array((*self.q, *(k - 4) * (0.0,), *(() if self.q_i is None else (self.q_i,))))
        full, inputs = np.zeros((m, q.size, q.size)), np.zeros((m, q.size))
        full[:, k:, 0], full[:, k:, k:] = self.dt, 1.0
        full[:, :k, :k], inputs[:, :k] = A, B
        with np.errstate(all="ignore"):  # what does not converge is named below
            r = np.full(m, self.r)
            K = _gain(full, inputs, _doubled(full, inputs, np.diag(q), r), r)
            P, K = _newton(full, inputs, np.diag(q), r, K)
        poor: BoolArray = ~np.isfinite(np.concatenate([P, K[:, None]], axis=1)).all(axis=(1, 2))
        closed = full - inputs[:, :, None] * np.where(poor[:, None], 0.0, K)[:, None, :]
        poor |= ~(np.abs(np.linalg.eigvals(closed)).max(axis=1) < 1.0)
        if poor.any():
            raise LdcError(self.what, f"no stabilising LQR gain at {v[poor.argmax()]:.3g} m/s")
        return K if self.q_i is not None else np.concatenate([K, P.reshape(m, -1)], axis=1)


def stabilising(
    A: FloatArray, B: FloatArray, Q: FloatArray, S: FloatArray, r: FloatArray, own: slice
) -> tuple[FloatArray, FloatArray]:
    """K (m, k) and P (m, k, k) of the cost x'Qx + 2 x'S u + r u^2 of m plants; raises `LdcError` if there are none.

    States of `own` that the cost does not see, not even through others, have no part in K and P, and may drift.
    """
    with np.errstate(all="ignore"):  # what does not converge is named below
        shift = S / r[:, None]
        A, Q = A - B[:, :, None] * shift[:, None, :], Q - S[:, :, None] * shift[:, None, :]
        P, K = _newton(A, B, Q, r, _gain(A, B, _doubled(A, B, Q, r), r))
    good = (r > 0) & np.isfinite(P).all(axis=(1, 2)) & np.isfinite(K).all(axis=1)
    weights = np.where(good[:, None], np.diagonal(P, axis1=1, axis2=2), 0.0)
    seen = np.ones_like(weights, dtype=np.bool_)
    seen[:, own] = (weights > _UNSEEN * weights.max(axis=1, keepdims=True))[:, own]
    both = seen[:, :, None] & seen[:, None, :]
    K, P = np.where(seen, K, 0.0), np.where(both, P, 0.0)
    closed = np.where(both, A - B[:, :, None] * K[:, None, :], 0.0)
    if not good.all() or (np.abs(np.linalg.eigvals(closed)).max(axis=1) >= 1.0).any():
        raise LdcError("", "no stabilising solution of the Riccati equation")
    return K + shift, P


_UNSEEN = 1e-24  # a share of the largest weight of a state that is below its rounding
_DOUBLINGS = 50  # a loop with a time constant of 10^14 samples is steady after so many


def _doubled(A: FloatArray, B: FloatArray, Q: FloatArray, r: FloatArray) -> FloatArray:
    """Costs P (m, k, k) of m plants with one input each; Q (m, k, k) or (k, k), r (m,)."""
    k = A.shape[1]
    G, P = B[:, :, None] * B[:, None, :] / r[:, None, None], np.broadcast_to(Q, A.shape)
    unit = np.eye(k)
    for _ in range(_DOUBLINGS):
        try:
            both = np.linalg.solve(unit + G @ P, np.concatenate([A, G], axis=2))
        except np.linalg.LinAlgError:  # singular by rounding: what has been found shows whether it will do
            break
        A_next, G_next = both[:, :, :k], both[:, :, k:]
        change = A.mT @ P @ A_next
        G, P, A = G + A @ G_next @ A.mT, P + 0.5 * (change + change.mT), A @ A_next
        if not (np.abs(change) > 1e-17 * np.abs(P).max(axis=(1, 2), keepdims=True)).any():
            break
    return P


def _gain(A: FloatArray, B: FloatArray, P: FloatArray, r: FloatArray) -> FloatArray:
    PB = (P @ B[:, :, None])[:, :, 0]
    K: FloatArray = (PB[:, None, :] @ A)[:, 0] / (r + np.sum(B * PB, axis=1))[:, None]
    return K


def _newton(A: FloatArray, B: FloatArray, Q: FloatArray, r: FloatArray, K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """P and K after two steps of Newton's method; the second is below rounding where the gain is nearly right."""
    P = np.empty_like(A)
    for _ in range(2):
        F, P = A - B[:, :, None] * K[:, None, :], Q + r[:, None, None] * K[:, :, None] * K[:, None, :]
        for _ in range(_DOUBLINGS):  # the sum of F'^j Q F^j
            change = F.mT @ P @ F
            P, F = P + 0.5 * (change + change.mT), F @ F
            if not (np.abs(change) > 1e-17 * np.abs(P).max(axis=(1, 2), keepdims=True)).any():
                break
        K = _gain(A, B, P, r)
    return P, K
