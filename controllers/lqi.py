"""Linear quadratic regulator with integral action on the lateral offset, scheduled over speed.

delta = -K(v) (x - x_ss psi_l') - K_i(v) z + delta_ss(v) psi_l', where z is the running integral of e_y since the
trigger, z_0 = 0 and z_(k+1) = z_k + dt e_y(k), and (x_ss, delta_ss) is steady cornering with e_y = 0 per unit of lane
yaw rate. (K, K_i) minimises the sum of the LQR's cost and q_i z^2 over the sampled plant with z as a fifth state.
Source: G. Franklin, J. Powell, M. Workman, *Digital Control of Dynamic Systems*, 3rd ed. (1998), sections 8.5 (integral
control) and 9.3 (the steady-state optimum); the principle is E. J. Davison's servo compensator (IEEE TAC 21(1), 1976).

Frame: ISO 8855, positive to the left, radians. Assumptions: the nominal vehicle at the speed of the trigger, all states
seen, no limits. In the closed loop z comes to rest only where e_y is zero, so a constant lateral disturbance, a vehicle
that is not the nominal one or a biased curvature leaves no offset in a bend, which the plain LQR does not promise. Use
it where such errors outlast a departure. A departure without them pays for it: it starts with e_y on one side, and what
z has gathered there comes back as overshoot on the other. Nothing stops z from winding up behind a saturated actuator.
With r_delta = 100 it is a fast loop for an ideal actuator; behind a steering lag of 0.2 s it diverges from 28 m/s on:
take some thousands there.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, final

import numpy as np

from controllers.riccati import integral_feedback
from ldctoolkit import Controller, LinearLaw, Plant, gain


@final
@dataclasses.dataclass(frozen=True)
class LQI(Controller):
    """Linear quadratic regulator with integral action on e_y.

    Parameters
    ----------
    q_y : float [1/m^2]
        Weight on e_y^2.
    q_y_rate : float [s^2/m^2]
        Weight on (de_y/dt)^2.
    q_psi : float [1/rad^2]
        Weight on e_psi^2.
    q_psi_rate : float [s^2/rad^2]
        Weight on (de_psi/dt)^2.
    q_i : float [1/(m s)^2]
        Weight on the square of the integral of e_y.
    r_delta : float [1/rad^2]
        Weight on delta^2.

    Examples
    --------
    >>> LQI(q_i=0.1).q_y
    1.0
    """

    name: ClassVar[str] = "lqi"
    title: ClassVar[str] = "LQI"

    q_y: float = gain(1.0, unit="1/m^2", lower=1e-6, upper=1e6, scale="log", description="weight on e_y^2")
    q_y_rate: float = gain(0.0, unit="s^2/m^2", lower=0.0, upper=1e6, description="weight on (de_y/dt)^2")
    q_psi: float = gain(1.0, unit="1/rad^2", lower=0.0, upper=1e6, description="weight on e_psi^2")
    q_psi_rate: float = gain(0.0, unit="s^2/rad^2", lower=0.0, upper=1e6, description="weight on (de_psi/dt)^2")
    q_i: float = gain(
        0.05, unit="1/(m s)^2", lower=1e-6, upper=1e6, scale="log", description="weight on (integral of e_y)^2"
    )
    r_delta: float = gain(100.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")

    def prepare(self, plant: Plant) -> LinearLaw:
        """Schedule both gains and the feedforward over the scenarios' speeds."""
        weights = (self.q_y, self.q_y_rate, self.q_psi, self.q_psi_rate)
        K = integral_feedback(plant, weights, self.q_i, self.r_delta)
        steady = plant.steady_state()
        return LinearLaw(
            F=-K[:, :4],
            preview_times=np.zeros(1),
            G_yaw_rate=(steady.delta + K[:, 2] * steady.e_psi)[:, None],
            G_heading=np.zeros((plant.n, 1)),
            f_u=np.zeros(plant.n),
            f_i=-K[:, 4],
        )
