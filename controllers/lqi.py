"""Linear quadratic regulator with integral action on the lateral offset, scheduled over speed.

delta = -K(v) (x - x_ss psi_l') - K_i(v) z + delta_ss(v) psi_l', where z is the running integral of e_y since the
trigger, z_0 = 0 and z_(k+1) = z_k + dt e_y(k), and (x_ss, delta_ss) is steady cornering with e_y = 0 per unit of lane
yaw rate. (K, K_i) minimises the sum of the LQR's cost and q_i z^2 over the sampled plant with z as a fifth state.
Source: G. Franklin, J. Powell, M. Workman, *Digital Control of Dynamic Systems*, 3rd ed. (1998), sections 8.5 (integral
control) and 9.3 (the steady-state optimum); the principle is E. J. Davison's servo compensator (IEEE TAC 21(1), 1976).
With `conditioned`, z_(k+1) = z_k at samples where the assist yields (`Preview.yielding`): conditional integration.
"""

import dataclasses
from typing import ClassVar, final

from ldctoolkit.control import LinearLaw
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant

from .riccati import StateWeights, feedback, linear_law


@final
@dataclasses.dataclass(frozen=True)
class LQI(StateWeights):
    """Linear quadratic regulator with integral action on e_y.

    Examples
    --------
    >>> LQI(q_i=0.1).q_y
    1.0
    """

    name: ClassVar[str] = "lqi"
    title: ClassVar[str] = "LQI"

    q_i: float = gain(
        0.05, unit="1/(m s)^2", lower=1e-6, upper=1e6, scale="log", description="weight on (integral of e_y)^2"
    )
    r_delta: float = gain(20_000.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")
    conditioned: bool = gain(False, unit="1", description="stop the integral while the assist yields")

    def prepare(self, plant: Plant) -> LinearLaw:
        """Schedule both gains and the feedforward over the scenarios' speeds."""
        return linear_law(
            plant, feedback(plant, self.q, self.r_delta, self.q_i), integral=True, conditioned=self.conditioned
        )
