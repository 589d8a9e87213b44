"""The Stanley law: heading error and offset of the front axle, with the terms for a dynamic vehicle.

Source: G. Hoffmann, C. Tomlin, M. Montemerlo, S. Thrun, *Autonomous Automobile Trajectory Tracking for Off-Road
Driving: Controller Design, Experimental Validation and Racing* (ACC 2007), with every term of the published steering
law. There heading and offset are counted from the vehicle to the path; in ISO 8855, positive to the left, it reads

    delta = -(e_psi_f - k_ag v psi_l') - atan(k e_f/(k_soft + v)) - k_d_yaw de_psi/dt - k_d_steer (delta_1 - delta_2),

clipped to +-delta_max. e_f and e_psi_f are offset and heading error at the front axle, against the point of the lane
beside it: e_f = e_y + l_f sin e_psi - c l_f^2/2 and e_psi_f = e_psi - c l_f with the lane's curvature c = psi_l'/v.

Details: `docs/reference/laws.md`.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant


@final
@dataclasses.dataclass(frozen=True)
class Stanley(Controller):
    """The steering law of the vehicle Stanley.

    Examples
    --------
    >>> Stanley(k=2.0).k_soft
    1.0
    """

    name: ClassVar[str] = "stanley"
    title: ClassVar[str] = "Stanley"

    k: float = gain(1.0, unit="1/s", lower=0.0, upper=100.0, description="gain on the offset of the front axle")
    k_soft: float = gain(1.0, unit="m/s", lower=0.0, upper=100.0, description="added to the speed")
    k_d_yaw: float = gain(0.25, unit="s", lower=0.0, upper=10.0, description="gain on the yaw rate error")
    k_d_steer: float = gain(0.0, unit="rad/rad", lower=0.0, upper=0.5, description="gain on the last change of delta")
    k_ag: float = gain(1.0, unit="1", lower=0.0, upper=2.0, description="share of the steady side slip corrected")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")

    def prepare(self, plant: Plant) -> StanleyLaw:
        """Work out the side slip of the front wheels in a steady bend at every scenario's speed."""
        p = plant.model.parameters
        slip = p.m * p.l_r / (2.0 * p.C_af * (p.l_f + p.l_r)) * plant.v
        return StanleyLaw(design=self, l_f=p.l_f, v=plant.v, slip=self.k_ag * slip)


@final
@dataclasses.dataclass(frozen=True)
class StanleyLaw(SteeringLaw):
    """The Stanley law of n scenarios; its state is the command of the step before last, None at the first."""

    design: Stanley
    l_f: float  # [m]
    v: FloatArray  # (n,) [m/s]
    slip: FloatArray  # (n,) [rad per rad/s] Correction of the heading error per unit of lane yaw rate

    @property
    def preview_times(self) -> FloatArray:
        """The lane's yaw rate now is all that is needed."""
        return np.zeros(1)

    def init(self, n: int) -> FloatArray | None:
        """No change of the command is known yet."""
        return None

    def take(self, rows: IntArray, state: FloatArray | None) -> tuple[StanleyLaw, FloatArray | None]:
        """Only some scenarios."""
        law = dataclasses.replace(self, v=self.v[rows], slip=self.slip[rows])
        return law, None if state is None else state[rows]

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: FloatArray | None
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int8]]:
        """One command for each scenario."""
        d, r = self.design, preview.yaw_rate[:, 0]
        to_axle = self.l_f * (r / self.v)  # change of the lane's heading from the centre of gravity to the front axle
        # a sum is contiguous, so that sine and arc tangent take the same route whatever the number of scenarios
        e_psi = x[:, 2] + 0.0
        e_f = x[:, 0] + self.l_f * (np.sin(e_psi) - 0.5 * to_axle)
        unlimited = self.slip * r - (e_psi - to_axle) - np.arctan(d.k * e_f / (d.k_soft + self.v)) - d.k_d_yaw * x[:, 3]
        if state is not None:
            unlimited -= d.k_d_steer * (delta_prev - state)
        delta = np.clip(unlimited, -d.delta_max, d.delta_max)
        return delta, delta_prev.copy(), np.full(delta.size, EventStatus.OK, dtype=np.int8)
