"""Nonlinear model predictive control on the bicycle with saturating tyres.

At every sample it minimises, over the next N commands, the sum of x~' Q x~ + r_delta u~^2 with the terminal cost
x~_N' P x~_N, subject to the nonlinear bicycle (Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.3) with
the Magic Formula (Pacejka, *Tyre and Vehicle Dynamics*, section 4.3) at friction mu and at the scenario's constant
speed; x~ and u~ are deviations from the nonlinear bicycle's steady cornering at the lane yaw rate previewed for that
sample, P solves the Riccati equation of the linear plant. Hard limits: |u| <= delta_max and
|u_j - u_(j-1)| <= rate_max dt, u_(-1) the previous command. Soft limits, held by exact penalties: lateral acceleration,
lateral jerk, lane corridor. Positive to the left (ISO 8855), radians.

Method, failed solves, delay and lag: `docs/explanation/mpc.md`.
"""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, Final, final

from ldctoolkit.declared import gain

from ._mpc_condensing import SHARES, MPCDesign
from .predictive import PredictiveController, Soft, Stage

_SCALES: Final = (1.0, 10.0, 0.1)  # units of the soft limits' violations: m/s^2, m/s^3, m


@final
@dataclasses.dataclass(frozen=True)
class NonlinearMPC(MPCDesign, PredictiveController):
    """Nonlinear MPC, solved to convergence at every sample.

    Examples
    --------
    >>> NonlinearMPC(horizon=10, mu=0.3).delta_max
    0.1
    """

    name: ClassVar[str] = "nonlinear_mpc"
    title: ClassVar[str] = "Nonlinear MPC"
    symmetric: ClassVar[bool] = True

    mu: float = gain(1.0, unit="1", lower=0.05, upper=2.0, description="friction coefficient of the law's tyres")

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        """Squares of the deviations from steady cornering, and the limits."""
        cost = self.q_y * x.e_y**2 + self.q_y_rate * x.e_y_rate**2 + self.q_psi_rate * x.e_psi_rate**2
        cost += self.q_psi * (x.e_psi - lane.steady_e_psi) ** 2 + self.r_delta * (u.delta - lane.steady_delta) ** 2
        # far above what a unit of violation can be worth to the cost
        weight = 2e3 * (self.q_y + 1e-2 * self.q_psi + 1e-2 * self.r_delta)
        limited = zip((x.a_y, x.jerk, x.e_y), self.soft_limits, _SCALES, SHARES, strict=True)
        return Stage(
            cost,
            hard=[
                (u.delta, -self.delta_max, self.delta_max),
                (u.change, -self.rate_max * lane.dt, self.rate_max * lane.dt),
            ],
            soft=[
                Soft(value / scale, -most / scale, most / scale, weight * share)
                for value, most, scale, share in limited
                if not self.is_zero(most)
            ],
        )
