"""Linear quadratic regulator with finite optimal preview of the lane's curvature, scheduled over speed.

At every sample k the command is the first of the sequence that minimises, over an infinite horizon, the sum of
x~' Q x~ + r_delta u~^2 when the lane's yaw rate psi_l' is known N samples ahead and is held after them. Here
x~_j = x_j - x_ss psi_l'_j and u~_j = delta_j - delta_ss (psi_l'_j + psi_l'_(j+1))/2 are deviations from steady
cornering, so that a constant bend leaves no bias. With w_j = psi_l'_(j+1) - psi_l'_j the deviations obey
x~+ = A x~ + B u~ + D w, D = B delta_ss/2 + E_1 - x_ss, and with the Riccati solution P, its gain K and A_c = A - B K

    u~ = -K x~ + sum over j < N of g_j w_j,    g_j = -B' (A_c')^j P D/(r_delta + B' P B):

feedback does not change with the preview, and what is seen far ahead counts the less the faster the closed loop is.

Sources: M. Tomizuka, *Optimal continuous finite preview problem*, IEEE TAC 20(3), 1975; N. Louam, D. A. Wilson,
R. S. Sharp, *Optimal control of a vehicle suspension incorporating the time delay between front and rear wheel inputs*,
Vehicle System Dynamics 17, 1988 (the shift register in discrete time); R. S. Sharp, V. Valtetsiotis, *Optimal preview
car steering control*, Vehicle System Dynamics 35 (supplement), 2001. It is also `linear_mpc` without its limits.

Frame: ISO 8855, positive to the left, radians. Assumptions: the nominal vehicle at the speed of the trigger, all states
and the lane ahead seen, no limits. Use it where the lane's curvature changes during a departure: it steers before the
bend begins. N dt beyond the closed loop's settling time adds nothing; on a constant bend it is the plain LQR. Where
curvature goes on changing, a few samples of preview may do worse than none: what is seen last is taken to be held.
Feedback is that of `lqr`: with an actuator and a camera take r_delta of some thousands.
"""

from __future__ import annotations

import dataclasses
from typing import ClassVar, final

import numpy as np
import numpy.typing as npt

from controllers.riccati import Regulator, regulator
from ldctoolkit import Controller, LinearLaw, Plant, gain

FloatArray = npt.NDArray[np.float64]


@final
@dataclasses.dataclass(frozen=True)
class PreviewLQR(Controller):
    """Linear quadratic regulator with optimal preview of the lane's yaw rate.

    Parameters
    ----------
    horizon : int [samples]
        N, how far ahead the lane is known.
    q_y : float [1/m^2]
        Weight on e_y^2.
    q_y_rate : float [s^2/m^2]
        Weight on (de_y/dt)^2.
    q_psi : float [1/rad^2]
        Weight on e_psi^2.
    q_psi_rate : float [s^2/rad^2]
        Weight on (de_psi/dt)^2.
    r_delta : float [1/rad^2]
        Weight on delta^2.

    Examples
    --------
    >>> from ldctoolkit import BicycleModel, Plant
    >>> law = PreviewLQR(horizon=3).prepare(Plant.build(BicycleModel(), [20.0], 0.05))
    >>> law.G_yaw_rate.shape
    (1, 4)
    """

    name: ClassVar[str] = "preview_lqr"
    title: ClassVar[str] = "Preview LQR"

    horizon: int = gain(20, unit="samples", lower=1, upper=100, description="preview horizon N")
    q_y: float = gain(1.0, unit="1/m^2", lower=1e-6, upper=1e6, scale="log", description="weight on e_y^2")
    q_y_rate: float = gain(0.0, unit="s^2/m^2", lower=0.0, upper=1e6, description="weight on (de_y/dt)^2")
    q_psi: float = gain(1.0, unit="1/rad^2", lower=0.0, upper=1e6, description="weight on e_psi^2")
    q_psi_rate: float = gain(0.0, unit="s^2/rad^2", lower=0.0, upper=1e6, description="weight on (de_psi/dt)^2")
    r_delta: float = gain(100.0, unit="1/rad^2", lower=1e-3, upper=1e6, scale="log", description="weight on delta^2")

    def prepare(self, plant: Plant) -> LinearLaw:
        """Schedule feedback and preview gains over the scenarios' speeds."""
        lq = regulator(plant, (self.q_y, self.q_y_rate, self.q_psi, self.q_psi_rate), self.r_delta)
        steady = plant.steady_state()
        g = _response(plant, lq, self.r_delta, self.horizon)
        G = np.zeros((plant.n, self.horizon + 1))
        G[:, 0] = lq.K[:, 2] * steady.e_psi
        G[:, :2] += 0.5 * steady.delta[:, None]
        # from differences of the yaw rate to the yaw rate itself
        G[:, :-1] -= g
        G[:, 1:] += g
        return LinearLaw(
            F=-lq.K,
            preview_times=np.arange(self.horizon + 1, dtype=np.float64) * plant.dt,
            G_yaw_rate=G,
            G_heading=np.zeros_like(G),
            f_u=np.zeros(plant.n),
        )


def _response(plant: Plant, lq: Regulator, r: float, N: int) -> FloatArray:
    """Weights g_j (n, N) of the changes of lane yaw rate from one sample to the next."""
    step, steady = plant.step, plant.steady_state()
    D = 0.5 * step.B * steady.delta[:, None] + step.E_1
    D[:, 2] -= steady.e_psi
    A_c = step.A - step.B[:, :, None] * lq.K[:, None, :]
    s = r + np.einsum("ni,nij,nj->n", step.B, lq.P, step.B)
    back = np.einsum("nij,nj->ni", lq.P, D)
    g = np.empty((plant.n, N))
    for j in range(N):
        g[:, j] = -np.sum(step.B * back, axis=1) / s
        back = np.einsum("nji,nj->ni", A_c, back)
    return g
