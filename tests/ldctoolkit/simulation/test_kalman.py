"""The stationary filter gain against scipy; the filter in the loop: test_plant_options."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from helpers.grids import grid, some
from helpers.reference_loop import Vehicle
from ldctoolkit import BicycleModel, Plant
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import KalmanFilter
from ldctoolkit.vehicle.speed_schedule import filter_gain

FILTERS = [KalmanFilter(), KalmanFilter(q_y=2.0, q_psi=0.05, r_y=0.1, r_psi=0.001), KalmanFilter(q_y=0.05, r_psi=0.05)]
C = np.eye(4)[[0, 2]]


def noises(kalman: KalmanFilter, dt: float) -> tuple[np.ndarray, np.ndarray]:
    Q = dt * np.diag([0.0, kalman.q_y**2, 0.0, kalman.q_psi**2])
    return Q, np.diag([kalman.r_y**2, kalman.r_psi**2])


@pytest.mark.parametrize("kalman", some(FILTERS, FILTERS[1]))
@pytest.mark.parametrize(("frame_samples", "dt"), grid([1, 2, 7], [0.02, 0.05], (2, 0.05), (7, 0.02)))
def test_gain_equals_scipys_riccati(kalman: KalmanFilter, frame_samples: int, dt: float) -> None:
    """At speeds between the nodes. Gains are up to 50 1/s, and the interpolant is good to 1e-12 of that."""
    v = np.concatenate([[1.0, 90.0], np.exp(np.random.default_rng(0).uniform(0.0, np.log(90.0), 10))])
    M = filter_gain(Plant.build(BicycleModel(), v, dt), kalman, frame_samples)
    Q, R = noises(kalman, dt)
    for i in range(v.size):
        A = scipy.linalg.expm(dt * Vehicle().matrices(v[i])[0])
        powers = [np.linalg.matrix_power(A, j) for j in range(frame_samples + 1)]
        Q_p = sum(power @ Q @ power.T for power in powers[:-1])
        P = scipy.linalg.solve_discrete_are(powers[-1].T, C.T, Q_p, R)
        np.testing.assert_allclose(M[i], P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=0, atol=1e-10)


def test_gain_does_not_depend_on_the_set() -> None:
    v = np.array([9.0, 17.3, 31.0])
    whole = filter_gain(Plant.build(BicycleModel(), v, 0.05), KalmanFilter(), 2)
    one = filter_gain(Plant.build(BicycleModel(), v[1:2], 0.05), KalmanFilter(), 2)
    np.testing.assert_array_equal(whole[1:2], one)


def test_speeds_outside_the_schedule_are_named() -> None:
    with pytest.raises(InputError, match=r"95 m/s; allowed"):
        filter_gain(Plant.build(BicycleModel(), [20.0, 95.0], 0.05), KalmanFilter(), 1)
