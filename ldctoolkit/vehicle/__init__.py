"""The vehicle: parameters, linear error dynamics, exact discretisation, the plant of a scenario set."""

from ldctoolkit.vehicle.bicycle import BicycleModel, Convention, Plant, SteadyState, VehicleParameters
from ldctoolkit.vehicle.discretization import Discretization, discretize
from ldctoolkit.vehicle.vehicle_model import RecordedTurn, VehicleModel

__all__ = [
    "BicycleModel",
    "Convention",
    "Discretization",
    "Plant",
    "RecordedTurn",
    "SteadyState",
    "VehicleModel",
    "VehicleParameters",
    "discretize",
]
