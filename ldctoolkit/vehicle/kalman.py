"""Gain of the stationary Kalman filter that rebuilds the whole state from the camera's e_y and e_psi.

The model is the nominal vehicle, dx/dt = A x + B delta + E psi_l' + w, where w is white noise on the lateral and the
yaw acceleration. A frame comes every p samples, so the filter is stationary in steps of p (B. D. O. Anderson and
J. B. Moore, *Optimal Filtering*, 1979, sections 4.1 and 4.4).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import KalmanFilter
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.speed_schedule import scheduled

_MEASURED = (0, 2)  # e_y and e_psi


def filter_gain(plant: Plant, kalman: KalmanFilter, frame_samples: int) -> FloatArray:
    """Gain of the correction z <- z + M (frame - z[[0, 2]]) at every scenario's speed.

    Over one frame the prediction has the transition A^p and the noise sum of A^j Q A^j' for j < p, where A is one
    sample's transition and Q = dt diag(0, q_y^2, 0, q_psi^2). `scipy.linalg.solve_discrete_are` gives P.
    """
    what = f"filter gains for {kalman}, {frame_samples} samples of {plant.dt:g} s a frame"
    return scheduled(_FilterGain(plant.model, plant.dt, kalman, frame_samples), plant.v, what).reshape(-1, 4, 2)


def filter_columns(plant: Plant, kalman: KalmanFilter, frame_samples: int) -> FloatArray:
    """The gain, then A and the inputs of the prediction and what the wheel angle adds to it, (n, 8 + 16 + 5 x 4)."""
    step = plant.augmented
    wheel = step.A[:, :4, 4] if plant.lag > 0.0 else np.zeros((plant.n, 4))
    inputs = [weights[:, :4] for weights in (step.B, step.E_0, step.E_1, step.B_old)]
    gain = filter_gain(plant, kalman, frame_samples).reshape(-1, 8)
    return np.concatenate([gain, step.A[:, :4, :4].reshape(-1, 16), *inputs, wheel], axis=1)


@dataclasses.dataclass(frozen=True)
class _FilterGain:
    """The gain at given speeds, (m, 8)."""

    model: BicycleModel
    dt: float
    kalman: KalmanFilter
    frame_samples: int

    def __call__(self, v: FloatArray) -> FloatArray:
        import scipy.linalg  # what control.dlqe calls: to import that takes two seconds

        C = np.eye(4)[list(_MEASURED)]
        R = np.diag([self.kalman.r_y**2, self.kalman.r_psi**2])
        rows: list[FloatArray] = []
        for A in self.model.discretize(v, self.dt).A:
            A_p, Q_p = self._over_one_frame(A)
            try:
                P = scipy.linalg.solve_discrete_are(A_p.T, C.T, Q_p, R)
            except (np.linalg.LinAlgError, ValueError) as error:
                speed = v[len(rows)]
                raise LdcError(f"no Kalman filter at {speed:.3g} m/s, {self.kalman}: {error}") from error
            rows.append(
                np.linalg.solve(C @ P @ C.T + R, C @ P).T.ravel()
            )  # P and the innovation's covariance: symmetric
        return np.array(rows)

    def _over_one_frame(self, A: FloatArray) -> tuple[FloatArray, FloatArray]:
        Q = self.dt * np.diag([0.0, self.kalman.q_y**2, 0.0, self.kalman.q_psi**2])
        A_p, Q_p = np.eye(4), np.zeros((4, 4))
        for _ in range(self.frame_samples):
            Q_p = A @ Q_p @ A.T + Q
            A_p = A @ A_p
        return A_p, 0.5 * (Q_p + Q_p.T)
