"""Linear quadratic regulator with finite optimal preview of the lane's curvature, scheduled over speed.

At every sample k the command is the first of the sequence that minimises, over an infinite horizon, the sum of
x~' Q x~ + r_delta u~^2 when the lane's yaw rate psi_l' is known N samples ahead and is held after them. Here
x~_j = x_j - x_ss psi_l'_j and u~_j = delta_j - delta_ss (psi_l'_j + psi_l'_(j+1))/2 are deviations from steady
cornering, so that a constant bend leaves no bias. With w_j = psi_l'_(j+1) - psi_l'_j the deviations obey
x~+ = A x~ + B u~ + D w, D = B delta_ss/2 + E_1 - x_ss, and with the Riccati solution P, its gain K and A_c = A - B K

    u~ = -K x~ + sum over j < N of g_j w_j,    g_j = -B' (A_c')^j P D/(r_delta + B' P B):

feedback does not change with the preview, and what is seen far ahead counts the less the faster the closed loop is.
"""

import dataclasses
import math
from typing import ClassVar, final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import LinearLaw
from ldctoolkit.vehicle.bicycle import Plant

from .riccati import Horizon, QuadraticCost, Regulator, in_time, linear_law, regulator


@final
@dataclasses.dataclass(frozen=True)
class PreviewLQR(QuadraticCost, Horizon):
    """Linear quadratic regulator with optimal preview of the lane's yaw rate.

    Examples
    --------
    >>> from ldctoolkit import BicycleModel, Plant
    >>> law = PreviewLQR(horizon=3).prepare(Plant.build(BicycleModel(), [20.0], 0.05))
    >>> law.G_yaw_rate.shape
    (1, 4)
    """

    name: ClassVar[str] = "preview_lqr"
    title: ClassVar[str] = "Preview LQR"

    def prepare(self, plant: Plant) -> LinearLaw:
        """Schedule feedback and preview gains over the scenarios' speeds."""
        lq = regulator(plant, self.q, self.r_delta, actuator=True)
        steady, first = plant.steady_state(), plant.augmented.whole
        A, B, E_0, E_1 = in_time(plant)
        x_ss = np.repeat(steady.delta[:, None], B.shape[1], axis=1)  # the wheel and the command before
        x_ss[:, :4] = 0.0
        x_ss[:, 2] = steady.e_psi
        # samples from the state that is seen on; the command acts at the one called first
        G = np.zeros((plant.n, first + self.horizon + 1))
        G[:, first] = np.sum(lq.K * x_ss, axis=1)
        G[:, first : first + 2] += 0.5 * steady.delta[:, None]
        # from differences of the yaw rate to the yaw rate itself
        g = _response(A, B, 0.5 * B * steady.delta[:, None] + E_1 - x_ss, lq, self.r_delta, self.horizon)
        G[:, first:-1] -= g
        G[:, first + 1 :] += g
        K = lq.K
        for j in range(first - 1, -1, -1):  # what the bend does until the command acts
            G[:, j] -= np.sum(K * E_0, axis=1)
            G[:, j + 1] -= np.sum(K * E_1, axis=1)
            K = np.einsum("ni,nij->nj", K, A)
        late = math.ceil(plant.age / plant.dt - 1e-9)  # the lane's past counts as it is now
        G[:, late] += G[:, :late].sum(axis=1)
        return dataclasses.replace(
            linear_law(plant, lq.K),
            preview_times=np.maximum(np.arange(late, G.shape[1]) * plant.dt - plant.age, 0.0),
            G_yaw_rate=G[:, late:],
            G_heading=np.zeros_like(G[:, late:]),
        )


def _response(A: FloatArray, B: FloatArray, D: FloatArray, lq: Regulator, r: float, N: int) -> FloatArray:
    """Weights g_j (n, N) of the changes of lane yaw rate from one sample to the next."""
    A_c = A - B[:, :, None] * lq.K[:, None, :]
    s = r + np.einsum("ni,nij,nj->n", B, lq.P, B)
    back = np.einsum("nij,nj->ni", lq.P, D)
    g = np.empty((D.shape[0], N))
    for j in range(N):
        g[:, j] = -np.sum(B * back, axis=1) / s
        back = np.einsum("nji,nj->ni", A_c, back)
    return g
