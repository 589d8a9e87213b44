"""Discrete-time LQR gains as smooth functions of speed, from python-control's Riccati solver.

The Riccati equation is solved at a few dozen speeds and not once a scenario: `ldctoolkit.scheduled`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit import SPEED_RANGE, BicycleModel, LdcError, Plant, scheduled

FloatArray = npt.NDArray[np.float64]
Weights = tuple[float, float, float, float]

__all__ = ["SPEED_RANGE", "Regulator", "feedback", "regulator"]


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


def _scheduled(plant: Plant, q: Weights, r: float, columns: slice) -> FloatArray:
    what = f"LQR gains for q = {q}, r = {r}, dt = {plant.dt:g} s"
    return scheduled(_Riccati(plant.model, plant.dt, q, r), plant.v, what, columns=columns)


@dataclasses.dataclass(frozen=True)
class _Riccati:
    """(K, P) at given speeds, side by side."""

    model: BicycleModel
    dt: float
    q: Weights
    r: float

    def __call__(self, v: FloatArray) -> FloatArray:
        import control

        step = self.model.discretize(v, self.dt)
        rows = []
        for i in range(v.size):
            try:
                K, P, _ = control.dlqr(step.A[i], step.B[i][:, None], np.diag(self.q), np.array([[self.r]]))
            except (np.linalg.LinAlgError, control.ControlArgument, ValueError) as error:
                what = f"q = {self.q}, r = {self.r}, dt = {self.dt:g} s"
                raise LdcError(f"no LQR at {v[i]:.3g} m/s for {what}: {error}") from error
            rows.append(np.concatenate([K[0], P.ravel()]))
        return np.array(rows)
