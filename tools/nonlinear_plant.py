"""The nonlinear plant, written once in CasADi: dynamic bicycle with saturating tyres, in lane-error coordinates.

Two forces and one moment balance (Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.3) without the small
angles, with the Magic Formula (Pacejka, *Tyre and Vehicle Dynamics*, section 4.3) for the lateral force. Static wheel
loads, no load transfer, no longitudinal tyre force. At straight driving it linearises to Rajamani's eq. 2.45.

The closed loop does not call CasADi: `compile_nonlinear.py` translates `nonlinear_dynamics` into
`ldctoolkit.vehicle._nonlinear_compiled`.
"""

from __future__ import annotations

from typing import Any, Final

from ldctoolkit.vehicle.bicycle import GRAVITY

INPUTS: Final = ("e_y_rate", "e_psi", "e_psi_rate", "delta", "r", "v", "dv")
PARAMETERS: Final = ("C_af", "C_ar", "l_f", "l_r", "m", "I_z", "mu", "shape")
OUTPUTS: Final = ("e_y_acceleration", "e_psi_acceleration", "a_y")


def nonlinear_dynamics() -> Any:
    """Accelerations of the lane errors as a CasADi function of scalars.

    With v_y the lateral speed in the vehicle's own frame and omega its yaw rate,
    m (dv_y/dt + v omega) = F_f cos delta + F_r and I_z d omega/dt = l_f F_f cos delta - l_r F_r
    (Rajamani, section 2.3, with the front force turned by delta); the rest is the kinematics of
    de_y/dt = v sin e_psi + v_y cos e_psi and de_psi/dt = omega - r. The lane's yaw rate is taken as constant over the
    moment balance (no dr/dt term), as in eq. 2.45.

    Returns
    -------
    casadi.Function
        Inputs, in this order: e_y_rate [m/s], e_psi [rad], e_psi_rate [rad/s], delta (steering angle) [rad], r (yaw
        rate of the lane) [rad/s], v (longitudinal speed, > 0) [m/s], dv (its rate) [m/s^2]; C_af, C_ar (cornering
        stiffness of one tyre) [N/rad], l_f, l_r [m], m [kg], I_z [kg m^2], mu (friction coefficient), shape (Pacejka's
        C, 1 to 2). Outputs: e_y_acceleration [m/s^2], e_psi_acceleration [rad/s^2], a_y (lateral tyre force over
        mass) [m/s^2].

    Examples
    --------
    >>> f = nonlinear_dynamics()
    >>> at_rest = dict.fromkeys(INPUTS, 0.0) | {"v": 20.0}
    >>> vehicle = dict(C_af=8e4, C_ar=8e4, l_f=1.43, l_r=1.47, m=1e3, I_z=3344.0, mu=0.9, shape=1.3)
    >>> {name: float(value) for name, value in f(**at_rest, **vehicle).items()}
    {'a_y': 0.0, 'e_psi_acceleration': 0.0, 'e_y_acceleration': 0.0}
    """
    import casadi

    s = {name: casadi.SX.sym(name) for name in (*INPUTS, *PARAMETERS)}
    v, l_f, l_r = s["v"], s["l_f"], s["l_r"]
    sin, cos = casadi.sin(s["e_psi"]), casadi.cos(s["e_psi"])
    v_y = (s["e_y_rate"] - v * sin) / cos
    omega = s["e_psi_rate"] + s["r"]
    load = s["m"] * GRAVITY / (2.0 * (l_f + l_r))
    front = _axle_force(s["delta"] - casadi.atan((v_y + l_f * omega) / v), s["C_af"], load * l_r, s) * casadi.cos(
        s["delta"]
    )
    rear = _axle_force(-casadi.atan((v_y - l_r * omega) / v), s["C_ar"], load * l_f, s)
    a_y = (front + rear) / s["m"]
    v_y_rate = a_y - v * omega
    e_y_acceleration = s["dv"] * sin + v * cos * s["e_psi_rate"] + v_y_rate * cos - v_y * sin * s["e_psi_rate"]
    e_psi_acceleration = (l_f * front - l_r * rear) / s["I_z"]
    outputs = [e_y_acceleration, e_psi_acceleration, a_y]
    return casadi.Function("nonlinear_dynamics", list(s.values()), outputs, list(s), list(OUTPUTS))


def _axle_force(alpha: Any, C_alpha: Any, F_z: Any, s: dict[str, Any]) -> Any:
    """Lateral force of the two tyres of an axle, F_z the load of one.

    The Magic Formula without curvature factor (Pacejka, section 4.3, E = 0) with D = mu F_z and B C D = C_alpha:
    slope 2 C_alpha at zero, at most 2 mu F_z.
    """
    import casadi

    mu, shape = s["mu"], s["shape"]
    return 2.0 * mu * F_z * casadi.sin(shape * casadi.atan(C_alpha * alpha / (shape * mu * F_z)))
