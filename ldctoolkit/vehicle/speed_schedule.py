"""Solutions of Riccati equations, and the sampled plant, as smooth functions of speed.

They are analytic in the speed, so a Chebyshev interpolant in log v through the solver's answers at a few dozen speeds
is exact to rounding at every other speed, and nothing need be solved once a scenario. The range of speeds is fixed:
what a scenario gets cannot depend on which others are in its set.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.plant_options import KalmanFilter
from ldctoolkit.vehicle.bicycle import BicycleModel, Plant
from ldctoolkit.vehicle.discretization import AugmentedStep, augmented


def filter_gain(plant: Plant, kalman: KalmanFilter, frame_samples: int) -> FloatArray:
    """Gain of the correction z <- z + M (frame - z[[0, 2]]) at every scenario's speed.

    Over one frame the prediction has the transition A^p and the noise sum of A^j Q A^j' for j < p, where A is one
    sample's transition and Q = dt diag(0, q_y^2, 0, q_psi^2). M (n, 4, 2) = P C' (C P C' + R)^-1, with P
    the covariance of the prediction, by `scipy.linalg.solve_discrete_are`.
    """
    what = f"filter gains for {kalman}, {frame_samples} samples of {plant.dt:g} s a frame"
    solve = _Filter(plant.model, plant.dt, plant.lag, plant.delay, kalman, frame_samples)
    return scheduled(solve, plant.v, what).reshape(-1, 4, 2)


def filter_columns(plant: Plant, kalman: KalmanFilter, frame_samples: int) -> FloatArray:
    """The gain, then A and the inputs of the prediction and what the wheel angle adds to it, (n, 8 + 16 + 5 x 4)."""
    step, gains = plant.augmented, filter_gain(plant, kalman, frame_samples).reshape(-1, 8)
    wheel = step.A[:, :4, 4] if plant.lag > 0.0 else np.zeros((plant.n, 4))
    inputs = [weights[:, :4] for weights in (step.B, step.E_0, step.E_1, step.B_old)]
    return np.concatenate([gains, step.A[:, :4, :4].reshape(-1, 16), *inputs, wheel], axis=1)


def sampled(plant: Plant) -> AugmentedStep:
    """One sample behind the actuator at each speed, from an interpolant: about 1e-13 of an entry's largest value beside
    the exponential; that itself at speeds outside `SPEED_RANGE`, and where the interpolant is not that exact.
    """
    solve, (low, high) = _Step(plant.model, plant.dt, plant.lag, plant.delay), SPEED_RANGE
    coefficients = np.abs(chebyshev(solve)[0])
    exact = (coefficients[-3:].max(axis=0) <= _ROUNDING * coefficients.max(axis=0)).all()
    inside = (plant.v >= low) & (plant.v <= high) & exact
    step, j = solve.step(plant.v[:0]), 4 + (plant.lag > 0.0)
    values = np.empty((plant.n, j * (j + 4)))
    values[~inside] = solve(plant.v[~inside])
    if inside.any():
        values[inside] = scheduled(solve, plant.v[inside], "sampled plants")
    A, B, B_old, E_0, E_1 = np.split(values, j * np.arange(j, j + 4), axis=1)
    return AugmentedStep(A.reshape(-1, j, j), B, B_old, E_0, E_1, step.whole, step.split)


@dataclasses.dataclass(frozen=True)
class _Step:
    """A, B, B_old, E_0 and E_1 of one sample at given speeds, side by side."""

    model: BicycleModel
    dt: float
    lag: float
    delay: float

    def step(self, v: FloatArray) -> AugmentedStep:
        return augmented(*self.model.matrices(v), self.dt, lag=self.lag, delay=self.delay)

    def __call__(self, v: FloatArray) -> FloatArray:
        step = self.step(v)
        A = step.A.reshape(v.size, step.A.shape[1] ** 2)
        return np.concatenate([A, step.B, step.B_old, step.E_0, step.E_1], axis=1)


@dataclasses.dataclass(frozen=True)
class _Filter(_Step):
    """The gains at given speeds, (m, 8)."""

    kalman: KalmanFilter
    frame_samples: int

    def __call__(self, v: FloatArray) -> FloatArray:
        import scipy.linalg  # what control.dlqe calls: to import that takes two seconds

        C = np.eye(4)[[0, 2]]  # e_y and e_psi are measured
        R = np.diag([self.kalman.r_y**2, self.kalman.r_psi**2])
        Q = self.dt * np.diag([0.0, self.kalman.q_y**2, 0.0, self.kalman.q_psi**2])
        gains: list[FloatArray] = []
        for A in self.step(v).A[:, :4, :4]:
            A_p, Q_p = np.eye(4), np.zeros((4, 4))
            for _ in range(self.frame_samples):
                Q_p = A @ Q_p @ A.T + Q
                A_p = A @ A_p
            try:
                P = scipy.linalg.solve_discrete_are(A_p.T, C.T, 0.5 * (Q_p + Q_p.T), R)
            except (np.linalg.LinAlgError, ValueError) as error:
                problem = f"has no gain at {v[len(gains)]:.3g} m/s: {error}"
                raise LdcError("sensors.kalman", problem, value=self.kalman) from error
            # P and the innovation's covariance are symmetric
            gains.append(np.linalg.solve(C @ P @ C.T + R, C @ P).T.ravel())
        return np.array(gains)


SPEED_RANGE: Final = (1.0, 90.0)  # speeds [m/s] for which gains are scheduled

_TAIL = 1e-9  # largest share that the last coefficients may have: above it the interpolant has not converged
_ROUNDING = 2e-14  # The same of what an exact function replaces


def scheduled(
    solve: Callable[[FloatArray], FloatArray], v: FloatArray, what: str, *, columns: slice = slice(None)
) -> FloatArray:
    """Values of a smooth function of speed, from an interpolant that is made once.

    Raises `InputError` for a speed outside `SPEED_RANGE`; `LdcError` if the function is not smooth enough over the
    range.

    Parameters
    ----------
    solve : callable
        Speeds (m,) [m/s] to values (m, k), one row a speed whatever the others are. The interpolant is kept by this
        argument: it must be hashable, and equal only to what gives equal values, as a frozen dataclass is.
    v : (n,) [m/s]
        Speeds within `SPEED_RANGE`.
    what : str
        What is scheduled, in the plural, for messages.
    columns : slice
        Which of the k values, all by default; the others cost nothing.

    Returns
    -------
    (n, k)
        Or as many columns as `columns` has.

    Examples
    --------
    >>> import numpy as np
    >>> def steering_per_curvature(v):
    ...     return np.column_stack([2.9 + 1e-3 * v**2])
    >>> scheduled(steering_per_curvature, np.array([20.0]), "angles").round(9)
    array([[3.3]])
    """
    low, high = SPEED_RANGE
    outside = ~((v >= low) & (v <= high))
    if outside.any():
        i = int(np.argmax(outside))
        allowed = f"{low:g} to {high:g} m/s for scheduled gains"
        raise InputError("speed at the trigger", "m/s", value=float(v[i]), allowed=allowed)
    z = 2.0 * np.log(v / low) / math.log(high / low) - 1.0
    from ldctoolkit.vector_math import clenshaw

    coefficients, smooth = chebyshev(solve)
    if not smooth.all():
        raise LdcError(what, "change too sharply with speed to be scheduled")
    used = np.ascontiguousarray(coefficients[:, columns])
    values = np.empty((z.size, used.shape[1]))
    clenshaw(z, used, values)
    return values


@functools.lru_cache(maxsize=1024)
def chebyshev(solve: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, BoolArray]:
    """Chebyshev coefficients over log v, (nodes, k), and whether each column has converged."""
    for nodes in (48, 96, 192):
        z = np.cos(np.pi * (2 * np.arange(nodes) + 1) / (2 * nodes))
        values = solve(SPEED_RANGE[0] * (SPEED_RANGE[1] / SPEED_RANGE[0]) ** ((z + 1) / 2))
        basis = np.polynomial.chebyshev.chebvander(z, nodes - 1)
        coefficients: FloatArray = 2.0 / nodes * np.einsum("ik,ij->kj", basis, values)  # discrete orthogonality
        coefficients[0] /= 2.0
        scale = np.abs(coefficients).max(axis=0)
        smooth: BoolArray = np.abs(coefficients[-3:]).max(axis=0) <= _TAIL * np.maximum(scale, 1e-300)
        if smooth.all():
            break
    coefficients.flags.writeable = smooth.flags.writeable = False
    return coefficients, smooth
