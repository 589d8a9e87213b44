"""The vehicle: parameters, linear error dynamics, exact discretisation, the plant of a scenario set."""

from ldctoolkit.vehicle.bicycle import BicycleModel, Convention, SteadyState
from ldctoolkit.vehicle.discretization import Discretization, discretize
from ldctoolkit.vehicle.parameters import VehicleParameters
from ldctoolkit.vehicle.plant import Plant

__all__ = [
    "BicycleModel",
    "Convention",
    "Discretization",
    "Plant",
    "SteadyState",
    "VehicleParameters",
    "discretize",
]
