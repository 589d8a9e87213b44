"""True vehicles: what is driven, where the law is designed on the nominal vehicle."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.option_checks import checked_seed
from ldctoolkit.paths.random_streams import RandomStream, uniforms
from ldctoolkit.plant_options import Mismatch, Tyres
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.vehicle import Convention, SteadyState, VehicleParameters
from ldctoolkit.vehicle.bicycle import checked_speeds, error_dynamics_matrices, steady_cornering
from ldctoolkit.vehicle.parameters import GRAVITY


@dataclasses.dataclass(frozen=True)
class TrueVehicles:
    """The vehicle of each of n scenarios; the axles stand where they do on the nominal one."""

    m: FloatArray  # (n,) [kg] Mass
    I_z: FloatArray  # (n,) [kg m^2] Yaw inertia
    # (n,) [N/rad] Cornering stiffness of one front and one rear tyre
    C_af: FloatArray
    C_ar: FloatArray
    mu: FloatArray  # (n,) Friction coefficient; linear tyres have no use for it
    # [m] Distance from the centre of gravity to the front and rear axle
    l_f: float
    l_r: float

    def matrices(self, v: npt.ArrayLike, convention: Convention) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous-time A, B, E of Rajamani's eq. 2.45, each vehicle at its own speed."""
        return error_dynamics_matrices(self, checked_speeds(v), convention)

    def steady_state(self, v: npt.ArrayLike, convention: Convention) -> SteadyState:
        """Steering angle and heading error that hold a bend on linear tyres, as `BicycleModel.steady_state`."""
        return steady_cornering(*self.matrices(v, convention))

    def turn(
        self,
        v: FloatArray,
        dv: FloatArray,
        rate: FloatArray,
        bend: FloatArray,
        lane: FloatArray,
        yaw_error: FloatArray,
        tyres: Tyres,
        convention: Convention,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """e_psi, de_psi/dt and steering angle at which e_y'' is `bend` and e_psi'' is 0, (n,) each.

        Given speed and its rate, de_y/dt, e_y'', the lane's yaw rate and de_psi/dt. Where tyres saturate, a turn beyond
        the friction is that of the largest force.
        """
        if tyres.ideal:
            # e_psi and delta from the two force balances (Rajamani's eq. 2.45): e_y'' that of the path, e_psi'' = 0
            A, B, E = self.matrices(v, convention)
            A[:, 1, 2] += dv
            system = np.stack([np.stack([A[:, i, 2], B[:, i]], axis=-1) for i in (1, 3)], axis=-2)
            known = np.stack([A[:, i, 1] * rate + A[:, i, 3] * yaw_error + E[:, i] * lane for i in (1, 3)], axis=-1)
            wanted = np.stack([bend, np.zeros_like(v)], axis=-1)
            e_psi, delta = np.linalg.solve(system, (wanted - known)[..., None])[..., 0].T
            return e_psi, yaw_error, delta
        wheelbase, shape = self.l_f + self.l_r, tyres.shape

        def slip(stiffness: FloatArray, arm: float, share: FloatArray) -> FloatArray:
            """Slip angle at which an axle uses this share of its friction; beyond it, that of the largest force."""
            load = self.mu * self.m * GRAVITY * arm / (2.0 * wheelbase)
            return np.tan(np.arcsin(np.clip(share, -1.0, 1.0)) / shape) * shape * load / stiffness

        # without yaw acceleration both axles use the same share; it hardly depends on the angles that follow from it
        omega, v_y, e_psi, delta = lane + yaw_error, np.zeros_like(v), rate / v, np.zeros_like(v)
        for _ in range(_ITERATIONS):
            sine, cosine = np.sin(e_psi), np.cos(e_psi)
            across = (bend - dv * sine - yaw_error * (v * cosine - v_y * sine)) / cosine
            share = (v * omega + across) / (self.mu * GRAVITY)
            v_y = self.l_r * omega - v * np.tan(slip(self.C_ar, self.l_f, share))
            delta = np.arctan((v_y + self.l_f * omega) / v) + slip(self.C_af, self.l_r, share / np.cos(delta))
            e_psi = np.arcsin(np.clip(rate / np.hypot(v, v_y), -1.0, 1.0)) - np.arctan2(v_y, v)
        return e_psi, yaw_error, delta


# fixed-point steps from the small angles to the large ones of saturating tyres
_ITERATIONS = 8

_DRAWN = ("m", "I_z", "C_af", "C_ar", "mu")
"""Quantities with a factor, in the order of the random numbers."""


def true_vehicles(
    parameters: VehicleParameters, mismatch: Mismatch, tyres: Tyres, scenarios: Scenarios, seed: int
) -> TrueVehicles:
    """Draw the true vehicle of every scenario: the nominal one times factors, uniform on their ranges."""
    nominal = {name: getattr(parameters, name) for name in _DRAWN[:-1]} | {"mu": tyres.mu}
    if mismatch.ideal:
        checked_seed(seed)
        draws = np.zeros((scenarios.n, len(_DRAWN)))
    else:
        draws = uniforms(seed, scenarios.index, RandomStream.MISMATCH, len(_DRAWN))
    columns = {}
    for j, name in enumerate(_DRAWN):
        low, high = getattr(mismatch, name)
        factor = np.minimum(low + (high - low) * draws[:, j], high)  # rounding must not leave the range
        columns[name] = nominal[name] * factor
    return TrueVehicles(**columns, l_f=parameters.l_f, l_r=parameters.l_r)
