"""Lateral acceleration along driven paths, on any plant: what the companion a_y_peak is the largest value of."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.simulation import Takeover


def path_acceleration(
    over: Takeover, places: IntArray, t: FloatArray, x: FloatArray, delta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Both limits of a_y at the samples of driven paths.

    Parameters
    ----------
    over : Takeover
        What was driven.
    places : (c,) int
        Of the paths' scenarios among the takeover's m.
    t : (c, k) [s]
        Times of the samples, NaN after the end.
    x : (c, k, 4)
        State (e_y, de_y/dt, e_psi, de_psi/dt).
    delta : (c, k) [rad]
        Steering angle of the wheel just after each sample.

    Returns
    -------
    left, right : (c, k) [m/s^2]
        Just before and just after each sample; the first left one is the right one. NaN where t is.

    Notes
    -----
    The steering angle jumps at a sample only where the actuator is at once and without a part of a sample as delay.
    """
    actuator, dt = over.setup.options.actuator, over.setup.dt
    part = actuator.delay - np.floor(actuator.delay / dt + 1e-9) * dt
    jumps = actuator.lag == 0.0 and actuator.rate_max is None and part <= 1e-9 * dt
    before = np.column_stack([delta[:, :1], delta[:, :-1]]) if jumps else delta
    left, right = (_acceleration(over, places, t, x, wheel) for wheel in (before, delta))
    return left, right


def _acceleration(over: Takeover, places: IntArray, t: FloatArray, x: FloatArray, wheel: FloatArray) -> FloatArray:
    """The sum of the axles' forces over the mass, of the true vehicles."""
    path, cars = over.driven.take(places), over.vehicles
    known = np.isfinite(t)
    times = np.where(known, t, 0.0)
    v = path.speed(times) if over.setup.options.speed == "profile" else over.plant.v[places][:, None] + 0.0 * times
    lane = v * path.curvature(times)
    m, I_z, C_af, C_ar, mu = (
        getattr(cars, name)[places][:, None] + 0.0 * times for name in ("m", "I_z", "C_af", "C_ar", "mu")
    )
    rate, heading, turning = x[..., 1], x[..., 2], x[..., 3]
    if over.setup.options.tyres.ideal:
        v_y, omega = rate - v * heading, turning + lane
        front = 2.0 * C_af * (wheel - (v_y + cars.l_f * omega) / v)
        rear = -2.0 * C_ar * (v_y - cars.l_r * omega) / v
        printed = 4.0 * C_ar * cars.l_r / m if over.setup.convention == "as_printed" else 0.0
        a_y = (front + rear) / m - printed * turning / v
    else:
        from ldctoolkit.vehicle._nonlinear_compiled import nonlinear_rhs

        every = np.vectorize(nonlinear_rhs, otypes=[np.float64] * 3)
        zero = 0.0 * times
        a_y = every(
            *(np.where(known, part, 0.0) for part in (rate, heading, turning, wheel)), lane, v, zero,
            C_af, C_ar, cars.l_f + zero, cars.l_r + zero, m, I_z, mu, over.setup.options.tyres.shape + zero,
        )[2]  # fmt: skip
    return np.where(known, a_y, np.nan)
