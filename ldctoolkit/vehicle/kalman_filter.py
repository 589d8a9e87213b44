"""The Kalman filter of a camera: its gain, a solution of a Riccati equation, and its model at every speed."""

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import KalmanFilter
from ldctoolkit.vehicle.bicycle import Plant
from ldctoolkit.vehicle.speed_schedule import Step, scheduled


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


@dataclasses.dataclass(frozen=True)
class _Filter(Step):
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
