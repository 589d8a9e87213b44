"""The bicycle model once more, from its tyre forces, in CasADi symbols.

Written from the force and moment balance (Rajamani, section 2.3) and not from the matrices, so that its Jacobians are
an independent check of `ldctoolkit.vehicle.bicycle`, and so that controllers built on CasADi share one model.
"""

from __future__ import annotations

from typing import Any

from ldctoolkit.vehicle.bicycle import BicycleModel


def error_dynamics(model: BicycleModel) -> Any:
    """Error dynamics as a CasADi function.

    Parameters
    ----------
    model : BicycleModel
        Vehicle parameters and convention.

    Returns
    -------
    casadi.Function
        ``f(x, delta, r, v) -> dx``: state (4), steering angle [rad], lane yaw rate psi_l' [rad/s], speed [m/s]. The
        curvature is taken as constant over the moment balance (no d psi_l'/dt term), as in Rajamani's eq. 2.45.

    Examples
    --------
    >>> f = error_dynamics(BicycleModel())
    >>> f([0, 0, 0, 0], 0.0, 0.0, 20.0)
    DM([0, 0, 0, 0])
    """
    import casadi

    p = model.parameters
    x = casadi.SX.sym("x", 4)
    delta, r, v = casadi.SX.sym("delta"), casadi.SX.sym("r"), casadi.SX.sym("v")
    e_y_rate, e_psi, e_psi_rate = x[1], x[2], x[3]

    v_y = e_y_rate - v * e_psi  # lateral speed in the vehicle's own frame, small angles
    yaw_rate = e_psi_rate + r
    front = 2.0 * p.C_af * (delta - (v_y + p.l_f * yaw_rate) / v)
    rear = 2.0 * p.C_ar * -((v_y - p.l_r * yaw_rate) / v)

    e_y_acceleration = (front + rear) / p.m - v * r
    if model.convention == "as_printed":  # both moments added in the printed A[1, 3]
        e_y_acceleration -= 4.0 * p.C_ar * p.l_r / (p.m * v) * e_psi_rate
    e_psi_acceleration = (p.l_f * front - p.l_r * rear) / p.I_z
    dx = casadi.vertcat(e_y_rate, e_y_acceleration, e_psi_rate, e_psi_acceleration)
    return casadi.Function("error_dynamics", [x, delta, r, v], [dx], ["x", "delta", "r", "v"], ["dx"])
