"""Integral of |e_y| over steps in which e_y changes its sign."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import crossing_of_step
from ldctoolkit.vehicle import BicycleModel

FloatArray = npt.NDArray[np.float64]

_STIFF = 2.0
"""Where the lateral mode decays by more than this exponent in one step, a quartic through the step's ends is too crude
(relative error of S above 1e-8) and the crossing is refined on the true path."""

_NEWTON_PASSES = 4


def absolute_area(
    model: BicycleModel,
    v: FloatArray,
    x: FloatArray,
    x_end: FloatArray,
    area: FloatArray,
    delta: FloatArray,
    r_0: FloatArray,
    r_1: FloatArray,
    h: FloatArray,
) -> FloatArray:
    """Integral of |e_y| over steps whose ends have opposite signs of e_y.

    Parameters
    ----------
    model : BicycleModel
    v : (n,) [m/s]
        Speed.
    x, x_end : (n, 4)
        State at the start and the end of the step.
    area : (n,) [m s]
        Exact integral of e_y over the step.
    delta : (n,) [rad]
    r_0, r_1 : (n,) [rad/s]
        Lane yaw rate at the start and the end, a straight line in between.
    h : (n,) [s]
        Length of the step.

    Returns
    -------
    (n,) [m s]
    """
    s, before = crossing_of_step(x[:, 0], x[:, 1], x_end[:, 0], x_end[:, 1], area, h)
    p = model.parameters
    stiff = np.flatnonzero((2.0 * p.C_af + 2.0 * p.C_ar) / (p.m * v) * h > _STIFF)
    if stiff.size:
        before[stiff] = _area_on_the_true_path(
            model, v[stiff], x[stiff], delta[stiff], r_0[stiff], (r_1 - r_0)[stiff] / h[stiff], h[stiff], s[stiff]
        )
    return np.abs(before) + np.abs(area - before)


def _area_on_the_true_path(
    model: BicycleModel,
    v: FloatArray,
    x: FloatArray,
    delta: FloatArray,
    r_0: FloatArray,
    slope: FloatArray,
    h: FloatArray,
    s: FloatArray,
) -> FloatArray:
    """Integral of e_y up to its root, by Newton from the guess s on the exactly discretised path."""
    low, high = np.zeros_like(s), h.copy()
    for _ in range(_NEWTON_PASSES):
        step = model.discretize(v, s)
        r_s = r_0 + slope * s
        e, rate = (
            np.sum(step.A[:, i] * x, axis=1) + step.B[:, i] * delta + step.E_0[:, i] * r_0 + step.E_1[:, i] * r_s
            for i in (0, 1)
        )
        beyond = e * x[:, 0] < 0
        high, low = np.where(beyond, s, high), np.where(beyond, low, s)
        newton = s - np.divide(e, rate, out=np.zeros_like(e), where=rate != 0)
        s = np.where((newton >= low) & (newton <= high), newton, 0.5 * (low + high))
    step = model.discretize(v, s)
    area: FloatArray = np.sum(step.area_x * x, axis=1) + step.area_delta * delta
    return area + step.area_r_0 * r_0 + step.area_r_1 * (r_0 + slope * s)
