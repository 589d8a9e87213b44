"""Discrete-time LQR gains as smooth functions of speed, from python-control's Riccati solver.

The gain K(v) and the cost P(v) are analytic in the speed, so a Chebyshev interpolant in log v through `control.dlqr` at
a few dozen speeds is exact to rounding at every other speed, and the Riccati equation need not be solved once a
scenario. The range of speeds is fixed: what a scenario gets cannot depend on which others are in its set.
"""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
import numpy.typing as npt

from ldctoolkit import BicycleModel, LdcError, Plant
from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]

SPEED_RANGE = (1.0, 90.0)
"""Speeds [m/s] for which gains are scheduled."""

_TAIL = 1e-9  # largest share that the last coefficients may have: above it the interpolant has not converged


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


def regulator(plant: Plant, q: tuple[float, float, float, float], r: float) -> Regulator:
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
    low, high = SPEED_RANGE
    outside = (plant.v < low) | (plant.v > high)
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"speed at the trigger: {plant.v[i]:g} m/s; allowed for scheduled gains: {low:g} to {high:g}")
    coefficients = _coefficients(plant.model, plant.dt, q, r)
    z = 2.0 * np.log(plant.v / low) / math.log(high / low) - 1.0
    values = np.asarray(np.polynomial.chebyshev.chebval(z, coefficients).T, dtype=np.float64)
    return Regulator(K=np.ascontiguousarray(values[:, :4]), P=values[:, 4:].reshape(-1, 4, 4).copy())


@functools.lru_cache(maxsize=256)
def _coefficients(model: BicycleModel, dt: float, q: tuple[float, float, float, float], r: float) -> FloatArray:
    """Chebyshev coefficients of (K, P) over log v, (nodes, 20)."""
    for nodes in (48, 96, 192):
        z = np.cos(np.pi * (2 * np.arange(nodes) + 1) / (2 * nodes))
        values = _solve(model, SPEED_RANGE[0] * (SPEED_RANGE[1] / SPEED_RANGE[0]) ** ((z + 1) / 2), dt, q, r)
        basis = np.polynomial.chebyshev.chebvander(z, nodes - 1)
        coefficients: FloatArray = 2.0 / nodes * np.einsum("ik,ij->kj", basis, values)  # discrete orthogonality
        coefficients[0] /= 2.0
        scale = np.abs(coefficients).max(axis=0)
        if np.all(np.abs(coefficients[-3:]).max(axis=0) <= _TAIL * np.maximum(scale, 1e-300)):
            return coefficients
    raise LdcError(f"LQR gains for q = {q}, r = {r} change too sharply with speed to be scheduled at dt = {dt:g} s")


def _solve(model: BicycleModel, v: FloatArray, dt: float, q: tuple[float, float, float, float], r: float) -> FloatArray:
    import control

    step = model.discretize(v, dt)
    rows = []
    for i in range(v.size):
        try:
            K, P, _ = control.dlqr(step.A[i], step.B[i][:, None], np.diag(q), np.array([[r]]))
        except (np.linalg.LinAlgError, control.ControlArgument, ValueError) as error:
            raise LdcError(f"no LQR at {v[i]:.3g} m/s for q = {q}, r = {r}, dt = {dt:g} s: {error}") from error
        rows.append(np.concatenate([K[0], P.ravel()]))
    return np.array(rows)
