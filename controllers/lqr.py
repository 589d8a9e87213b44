"""Linear quadratic regulator, scheduled over speed, with curvature feedforward.

delta = -K(v) (x - x_ss psi_l') + delta_ss(v) psi_l', where (x_ss, delta_ss) is steady cornering with e_y = 0 per unit
of lane yaw rate, so that a bend of constant curvature leaves no bias (Rajamani, section 3.2). K minimises the sum of
q_y e_y^2 + q_y_rate (de_y/dt)^2 + q_psi e_psi^2 + q_psi_rate (de_psi/dt)^2 + r_delta delta^2 over the sampled plant
(`control.dlqr`). Positive to the left (ISO 8855), radians. Behind an actuator or a camera with lag or delay, x is
joined by the wheel angle and the commands on their way: `ldctoolkit.controllers.riccati.linear_law`.
"""

import dataclasses
from typing import ClassVar, final

from ldctoolkit.control import LinearLaw
from ldctoolkit.vehicle.bicycle import Plant

from .riccati import QuadraticCost, feedback, linear_law


@final
@dataclasses.dataclass(frozen=True)
class LQR(QuadraticCost):
    """Linear quadratic regulator on the full error state.

    Examples
    --------
    >>> LQR(r_delta=200.0).q_y
    1.0
    """

    name: ClassVar[str] = "lqr"
    title: ClassVar[str] = "LQR"

    def prepare(self, plant: Plant) -> LinearLaw:
        """Schedule the gain and the feedforward over the scenarios' speeds."""
        return linear_law(plant, feedback(plant, self.q, self.r_delta))
