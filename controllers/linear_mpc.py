"""Linear model predictive control with curvature preview, limits on steering angle and rate, and soft limits.

At every sample it minimises, over the next N commands, the sum of x~' Q x~ + r_delta u~^2 with the terminal cost
x~_N' P x~_N, where x~ and u~ are deviations from steady cornering at the lane yaw rate previewed for that sample and P
solves the Riccati equation; subject to |u| <= delta_max and |u_j - u_(j-1)| <= rate_max dt, u_(-1) the previous
command, and softly to limits on lateral acceleration, lateral jerk and lane offset. Without active limits this is the
LQR with curvature preview, exactly. The plant is the one behind the nominal actuator. Positive to the left (ISO 8855),
radians. Use it where limits matter: a designer's choice of comfort or of a weak actuator; where they do not, `lqr`
gives the same commands for nothing.

Form of the QP. With the LQR gain K and w_j = -K z_j + c_j the cost is s sum (c_j - c*_j)^2 plus a constant, where
s = r + B'PB (completion of squares along the Riccati recursion; c* is the feedforward from the preview). So the QP is:
the smallest correction e = c - c* of the unconstrained plan that meets the limits, with an identity Hessian whatever
the weights and the speed. Where the unconstrained plan meets every limit over the horizon, e = 0 is the QP's solution;
where the rows held at their bounds one sample ago, moved up by one, prove to be the solution's, no solver is called
either. The rest is in `docs/explanation/mpc.md`: soft limits, blocks, solvers, QPs that are not solved.

Sources: D. Mayne, J. Rawlings, C. Rao, P. Scokaert, *Constrained model predictive control: stability and optimality*,
Automatica 36(6), 2000; E. Kerrigan, J. Maciejowski, *Soft constraints and exact penalty functions in model predictive
control*, UKACC Control, 2000.
"""

import dataclasses
from typing import ClassVar, final

from ldctoolkit.control import Controller
from ldctoolkit.declared import gain, option
from ldctoolkit.vehicle.bicycle import Plant

from ._mpc_condensing import Wanted, condense, limits
from ._mpc_law import MPCLaw, check_solver


@final
@dataclasses.dataclass(frozen=True)
class LinearMPC(Controller):
    """Linear MPC, one QP a sample.

    Raises `InputError` for a solver that is not installed, and as every design.

    Examples
    --------
    >>> LinearMPC(horizon=10).delta_max
    0.1
    """

    name: ClassVar[str] = "linear_mpc"
    title: ClassVar[str] = "Linear MPC"

    horizon: int = gain(20, unit="samples", lower=1, upper=100, description="prediction horizon N")
    q_y: float = gain(1.0, unit="1/m^2", lower=1e-6, upper=1e6, scale="log", description="weight on e_y^2")
    q_y_rate: float = gain(0.0, unit="s^2/m^2", lower=0.0, upper=1e6, description="weight on (de_y/dt)^2")
    q_psi: float = gain(1.0, unit="1/rad^2", lower=0.0, upper=1e6, description="weight on e_psi^2")
    q_psi_rate: float = gain(0.0, unit="s^2/rad^2", lower=0.0, upper=1e6, description="weight on (de_psi/dt)^2")
    r_delta: float = gain(20_000.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")
    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")
    rate_max: float = gain(0.2, unit="rad/s", lower=1e-3, upper=10.0, description="limit of the steering rate")
    a_y_max: float = gain(0.0, unit="m/s^2", lower=0.0, upper=20.0, description="soft limit of a_y; 0 for none")
    jerk_max: float = gain(0.0, unit="m/s^3", lower=0.0, upper=1000.0, description="soft limit of jerk; 0 for none")
    e_y_max: float = gain(0.0, unit="m", lower=0.0, upper=20.0, description="soft limit of |e_y|; 0 for none")
    soft_weight: float = gain(
        1e3, unit="rad^2", lower=1e-3, upper=1e6, scale="log", description="weight of going beyond a soft limit"
    )
    blocks: int = gain(0, unit="1", lower=0, upper=100, description="number of free moves; 0 for one a sample")
    solver: str = option("osqp", choices=None, description="QP solver: osqp, daqp, or another of qpsolvers")
    always_solve: bool = gain(False, unit="1", description="call the solver also where the solution is known without")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_solver(self.solver, self.name)

    def prepare(self, plant: Plant) -> MPCLaw:
        """Solve the Riccati equation, and condense what the limits need, for every scenario's speed."""
        wanted = Wanted(
            horizon=self.horizon,
            weights=(self.q_y, self.q_y_rate, self.q_psi, self.q_psi_rate),
            r_delta=self.r_delta,
            delta_max=self.delta_max,
            rate_max=self.rate_max,
            soft_limits=(self.a_y_max, self.jerk_max, self.e_y_max),
            soft_weight=self.soft_weight,
            blocks=self.blocks,
        )
        known = condense(plant, wanted), limits(wanted, plant), plant.dt, plant.lag > 0.0, plant.age
        return MPCLaw(*known, self.solver, self.always_solve)
