"""PID control of the offset at a preview point, with curvature feedforward and back-calculation against windup.

With e_p = e_y + T_lp v (e_psi - e_psi_ss psi_l'), the offset that the vehicle would have T_lp seconds ahead on a
straight lane, and its rate e_p' = de_y/dt + T_lp v de_psi/dt,

    u = K_p e_p + I + K_d e_p' + delta_ss psi_l',    delta = u clipped to +-delta_max,
    dI/dt = K_i e_p + (delta - u)/T_t, with `conditioned` without K_i e_p while the assist yields.

(e_psi_ss, delta_ss) is steady cornering with e_y = 0 per unit of lane yaw rate psi_l' (Rajamani, *Vehicle Dynamics and
Control*, 2nd ed., section 3.2), so a bend of constant curvature leaves no offset on the nominal vehicle, and the
integral has nothing to do there. Positive to the left (ISO 8855), radians; the three gains are negative for a stable
loop.
"""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, Preview, SteeringLaw
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant


@final
@dataclasses.dataclass(frozen=True)
class PID(Controller):
    """PID on the offset at the preview point.

    Examples
    --------
    >>> PID(K_i=0.0).K_p
    -0.006
    """

    name: ClassVar[str] = "pid"
    title: ClassVar[str] = "PID"

    K_p: float = gain(-0.006, unit="rad/m", lower=-1.0, upper=0.0, description="gain on the offset at preview point")
    K_i: float = gain(-0.001, unit="rad/(m s)", lower=-1.0, upper=0.0, description="gain on its integral")
    K_d: float = gain(-0.004, unit="rad s/m", lower=-1.0, upper=0.0, description="gain on its rate")
    T_lp: float = gain(1.5, unit="s", lower=0.0, upper=10.0, description="preview time")
    T_t: float = gain(1.0, unit="s", lower=1e-3, upper=1e3, scale="log", description="tracking time against windup")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")
    conditioned: bool = gain(False, unit="1", description="stop the integral of the offset while the assist yields")

    def prepare(self, plant: Plant) -> PIDLaw:
        """Take steady cornering and the preview distance at every scenario's speed."""
        steady = plant.steady_state()
        return PIDLaw(
            design=self, dt=plant.dt, distance=self.T_lp * plant.v, e_psi_ss=steady.e_psi, delta_ss=steady.delta
        )


@final
@dataclasses.dataclass(frozen=True)
class PIDLaw(SteeringLaw):
    """The PID of n scenarios; its state is the integral I (n,) [rad]."""

    design: PID
    dt: float  # [s]
    distance: FloatArray  # (n,) [m] T_lp v
    # (n,) [rad per rad/s] Steady cornering per unit of lane yaw rate
    e_psi_ss: FloatArray
    delta_ss: FloatArray

    @property
    def preview_times(self) -> FloatArray:
        """The lane's yaw rate now is all that is needed."""
        return np.zeros(1)

    def init(self, n: int) -> FloatArray:
        """Nothing is integrated yet."""
        return np.zeros(n)

    def take(self, rows: IntArray, state: FloatArray) -> tuple[PIDLaw, FloatArray]:
        """Only some scenarios, each with its integral."""
        names = ("distance", "e_psi_ss", "delta_ss")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names}), state[rows]

    def step(
        self, t: FloatArray, x: FloatArray, preview: Preview, delta_prev: FloatArray, state: FloatArray
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int8]]:
        """One command for each scenario."""
        d = self.design
        r = preview.yaw_rate[:, 0]
        e_p = x[:, 0] + self.distance * (x[:, 2] - self.e_psi_ss * r)
        e_p_rate = x[:, 1] + self.distance * x[:, 3]
        u = d.K_p * e_p + state + d.K_d * e_p_rate + self.delta_ss * r
        delta = np.clip(u, -d.delta_max, d.delta_max)
        share = -math.expm1(-self.dt / d.T_t)
        change = self.dt * d.K_i * e_p
        integral = state + (preview.conditioned(change) if d.conditioned else change) + share * (delta - u)
        return delta, integral, np.full(delta.size, EventStatus.OK, dtype=np.int8)
