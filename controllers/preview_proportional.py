"""Preview proportional control, the law of the source paper.

delta = K_y e_y + K_psi e_psi_lp, where e_psi_lp is the vehicle's heading against the lane's heading T_lp seconds ahead:
e_psi_lp = e_psi - integral of psi_l' over [t, t + T_lp]. Positive to the left (ISO 8855), radians; both gains are
negative for a stable loop. Source: Zhao, Wang, LeBlanc (2017), section IV, gains of Table I. The paper prints the
preview with the opposite sign, which steers out of the bend: ``convention="as_printed"``.
"""

import dataclasses
from typing import ClassVar, final

import numpy as np

from ldctoolkit.control import Controller, LinearLaw
from ldctoolkit.declared import gain, option
from ldctoolkit.vehicle.bicycle import Plant


@final
@dataclasses.dataclass(frozen=True)
class PreviewProportional(Controller):
    """Proportional feedback on lateral offset and previewed heading error.

    Examples
    --------
    >>> PreviewProportional(K_y=-0.01).K_psi
    -0.2
    """

    name: ClassVar[str] = "preview_proportional"
    title: ClassVar[str] = "Preview P"

    K_y: float = gain(-0.005, unit="rad/m", lower=-1.0, upper=0.0, description="gain on the lateral offset e_y")
    K_psi: float = gain(-0.2, unit="rad/rad", lower=-5.0, upper=0.0, description="gain on the previewed heading error")
    T_lp: float = gain(2.0, unit="s", lower=0.0, upper=10.0, description="preview time")
    convention: str = option(
        "consistent", choices=("consistent", "as_printed"), description="sign of the preview integral"
    )

    def prepare(self, plant: Plant) -> LinearLaw:
        """The law is linear as it stands and does not depend on speed."""
        n = plant.n
        F = np.tile([self.K_y, 0.0, self.K_psi, 0.0], (n, 1))
        sign = -1.0 if self.convention == "consistent" else 1.0
        return LinearLaw(
            F=F,
            preview_times=np.array([self.T_lp]),
            G_yaw_rate=np.zeros((n, 1)),
            G_heading=np.full((n, 1), sign * self.K_psi),
            f_u=np.zeros(n),
        )
