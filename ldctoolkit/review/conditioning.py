"""Condition of the condensed Hessian of a linear MPC, built from its gains and not from what its solver sees.

With the states eliminated, x = Phi x_0 + Gamma u, the cost sum x'Q x + r u^2 with the terminal cost x'P x of the
Riccati equation has the Hessian Gamma' diag(Q, .., Q, P) Gamma + r I (J. M. Maciejowski, *Predictive Control with
Constraints*, section 3.1). Its condition number says how many digits a solver loses on it.
"""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.errors import LdcError
from ldctoolkit.vehicle import Plant

_WEIGHTS = ("q_y", "q_y_rate", "q_psi", "q_psi_rate")


def hessian_condition(controller: Controller, plant: Plant) -> FloatArray:
    """Condition number at each of n speeds, (n,); NaN for a design that is no MPC.

    Parameters
    ----------
    controller : Controller
        An MPC is known by its gains: `horizon`, `r_delta` and the four weights on the state. One without inequality
        limits (`delta_max`) solves no QP.
    plant : Plant

    Returns
    -------
    (n,)
    """
    declared = {g.name for g in controller.gains()}
    if not declared >= {"horizon", "r_delta", "delta_max", *_WEIGHTS}:
        return np.full(plant.n, np.nan)
    Q = np.diag([float(getattr(controller, name)) for name in _WEIGHTS])
    horizon, r = int(getattr(controller, "horizon")), float(getattr(controller, "r_delta"))  # noqa: B009
    return np.array([_condition(plant.step.A[i], plant.step.B[i], Q, r, horizon) for i in range(plant.n)])


def _condition(A: FloatArray, B: FloatArray, Q: FloatArray, r: float, horizon: int) -> float:
    import control

    try:
        _, P, _ = control.dlqr(A, B[:, None], Q, np.array([[r]]))
    except (np.linalg.LinAlgError, control.ControlArgument, ValueError) as error:
        raise LdcError(f"no terminal cost for the condensed Hessian: {error}") from error
    columns = [B]
    for _ in range(horizon - 1):
        columns.append(A @ columns[-1])
    impulse = np.array(columns)  # x_(k+1) after a unit command at sample 0
    Gamma = np.zeros((horizon, 4, horizon))
    for j in range(horizon):
        Gamma[j:, :, j] = impulse[: horizon - j]
    weighted = Gamma.copy()
    weighted[:-1] = np.einsum("ij,kjm->kim", Q, Gamma[:-1])
    weighted[-1] = P @ Gamma[-1]
    H = np.einsum("kia,kib->ab", Gamma, weighted) + r * np.eye(horizon)
    return float(np.linalg.cond(0.5 * (H + H.T)))
