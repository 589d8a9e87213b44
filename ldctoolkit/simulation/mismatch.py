"""True vehicles: what is driven, where the law is designed on the nominal vehicle."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.option_checks import checked_seed
from ldctoolkit.plant_options import Mismatch, Tyres
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation.random_streams import RandomStream, uniforms
from ldctoolkit.vehicle import Convention, SteadyState, VehicleParameters
from ldctoolkit.vehicle.bicycle import checked_speeds, error_dynamics_matrices, steady_cornering


@dataclasses.dataclass(frozen=True)
class TrueVehicles:
    """The vehicle of each of n scenarios; the axles stand where they do on the nominal one.

    Attributes
    ----------
    m : (n,) [kg]
        Mass.
    I_z : (n,) [kg m^2]
        Yaw inertia.
    C_af, C_ar : (n,) [N/rad]
        Cornering stiffness of one front and one rear tyre.
    mu : (n,)
        Friction coefficient; linear tyres have no use for it.
    l_f, l_r : float [m]
        Distance from the centre of gravity to the front and rear axle.
    """

    m: FloatArray
    I_z: FloatArray
    C_af: FloatArray
    C_ar: FloatArray
    mu: FloatArray
    l_f: float
    l_r: float

    def matrices(self, v: npt.ArrayLike, convention: Convention) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous-time A, B, E of Rajamani's eq. 2.45, each vehicle at its own speed.

        Parameters
        ----------
        v : (n,) [m/s]
            Speeds, > 0.
        convention : {"consistent", "as_printed"}
            As for `BicycleModel`.

        Returns
        -------
        A : (n, 4, 4)
        B : (n, 4)
        E : (n, 4)

        Raises
        ------
        InputError
            For a speed that is not a finite number > 0.
        """
        return error_dynamics_matrices(self, checked_speeds(v), convention)

    def steady_state(self, v: npt.ArrayLike, convention: Convention) -> SteadyState:
        """Steering angle and heading error that hold a bend on linear tyres, as `BicycleModel.steady_state`.

        Parameters
        ----------
        v : (n,) [m/s]
            Speeds, > 0.
        convention : {"consistent", "as_printed"}

        Returns
        -------
        SteadyState
            Per unit of lane yaw rate.
        """
        return steady_cornering(*self.matrices(v, convention))


_DRAWN = ("m", "I_z", "C_af", "C_ar", "mu")
"""Quantities with a factor, in the order of the random numbers."""


def true_vehicles(
    parameters: VehicleParameters, mismatch: Mismatch, tyres: Tyres, scenarios: Scenarios, seed: int
) -> TrueVehicles:
    """Draw the true vehicle of every scenario: the nominal one times factors, uniform on their ranges.

    Parameters
    ----------
    parameters : VehicleParameters
        Nominal vehicle.
    mismatch : Mismatch
        Ranges of the factors; a range (1, 1) leaves the nominal number as it is, to the bit.
    tyres : Tyres
        Holds the nominal friction coefficient.
    scenarios : Scenarios
        n departures.
    seed : int
        0 to 2^63 - 1; with a scenario's number it fixes the factors.

    Returns
    -------
    TrueVehicles
        n vehicles.

    Raises
    ------
    InputError
        For a seed outside what is allowed.

    Examples
    --------
    >>> one = Scenarios.from_arrays(T=[2.0], d_y=[0.3], v_mean=[20.0])
    >>> heavier = true_vehicles(VehicleParameters(), Mismatch(m=(1.2, 1.2)), Tyres(), one, seed=0)
    >>> float(heavier.m[0]), float(heavier.I_z[0])
    (1200.0, 3344.0)
    """
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
